"""A cloud against a mesh: distances, predictions, what is left out, the sample, clouds that lack sigmas."""

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from tests.accuracy import bank_samples as bank
from thalweg.accuracy import (
    CLOUD_TO_MESH,
    ComparisonSettings,
    after_motion,
    compare_with_mesh,
    normalised_distances,
)
from thalweg.accuracy.comparison import _Sample
from thalweg.core import InputError, write_table
from thalweg.surface import Area, Surface

SETTINGS = ComparisonSettings(reference_sigma_m=0.004)
ADDITIVE = (
    "outside_area",
    "far_from_reference",
    "not_in_sample",
    "beyond_max_distance",
    "left_out_at_border",
    "without_normal",
    "compared",
)


def cloud_of(tmp_path: Path, xyz: np.ndarray, **more) -> Path:
    return bank.write_cloud(tmp_path / "points.laz", xyz, **more)


def test_distances_and_their_predictions_are_known(tmp_path, rng):
    """A plane: points 6 cm behind it, covariance C, normal n: distance -6 cm, sigma sqrt(n C n)."""
    xyz = bank.on_bank(rng, 2000) - 0.06 * bank.OUT
    table, facts = compare_with_mesh(
        cloud_of(tmp_path, xyz), bank.bank_mesh(), area=Area(), settings=SETTINGS
    )
    assert len(table) == facts["counts"]["compared"] == 2000
    # LAZ keeps millimetres in each coordinate: half a millimetre along the normal, at most 0.87
    assert abs(table["distance_m"] + 0.06).max() < 0.0009
    normals = table[["normal_east", "normal_north", "normal_up"]].to_numpy()
    np.testing.assert_allclose(normals, np.broadcast_to(bank.OUT, normals.shape), atol=1e-6)
    C = bank.covariance()
    # sigmas are kept to 0.1 mm, correlations to 1e-4
    np.testing.assert_allclose(table["sigma_normal_m"], np.sqrt(bank.OUT @ C @ bank.OUT), rtol=2e-3)
    np.testing.assert_allclose(table["sigma_3d_m"], np.sqrt(np.trace(C)), rtol=2e-3)
    np.testing.assert_allclose(table["sigma_reference_m"], np.hypot(0.002, 0.004), rtol=1e-5)
    assert table["used"].all()
    assert not table["at_border"].any()


def test_every_point_is_accounted_for(tmp_path, rng):
    good = bank.on_bank(rng, 3000) + 0.01 * rng.normal(size=(3000, 3))
    wild = bank.on_bank(rng, 40) + 0.8 * bank.OUT
    far = bank.on_bank(rng, 50) + 2.4 * bank.OUT
    away = bank.on_bank(rng, 60) + 30.0 * bank.OUT
    # beyond the eastern end of the mesh, half of them within 2 m of it
    beside = bank.place(rng.uniform(40.1, 43.9, 70), rng.uniform(0.5, 7.5, 70), 0.0)
    xyz = np.concatenate([good, wild, far, away, beside])
    area = Area(polygon_en_m=np.array([[-15.0, -30], [60, -30], [60, 30], [-15, 30]]))
    path = cloud_of(tmp_path, xyz)
    table, facts = compare_with_mesh(path, bank.bank_mesh(), area=area, settings=SETTINGS)
    counts = facts["counts"]
    assert sum(counts[name] for name in ADDITIVE) == counts["points"] == len(xyz)
    assert counts["outside_area"] == (~area.contains(np.round(xyz, 3))).sum()
    near_end = beside[:, 0] < 22.0
    inside = area.contains(np.round(np.concatenate([wild, far]), 3))
    assert counts["left_out_at_border"] == pytest.approx(near_end.sum(), abs=1)
    assert near_end.sum() > 20
    assert counts["beyond_max_distance"] + counts["far_from_reference"] >= inside[40:].sum()
    assert counts["outliers"] == table["outlier"].sum() == inside[:40].sum()
    low, high = facts["outlier_limits_sigmas"]
    known = normalised_distances(table)[table["used"]]
    nmad = 1.4826 * np.median(abs(known - np.median(known)))
    assert (low, high) == pytest.approx((np.median(known) - 5 * nmad, np.median(known) + 5 * nmad))
    keep = ComparisonSettings(border="keep")
    kept, facts = compare_with_mesh(path, bank.bank_mesh(), area=area, settings=keep)
    assert sum(facts["counts"][name] for name in ADDITIVE) == len(xyz)
    assert facts["counts"]["left_out_at_border"] == 0
    assert facts["counts"]["compared_at_border"] == counts["left_out_at_border"]
    assert kept["used"].sum() == table["used"].sum() + counts["left_out_at_border"]
    assert kept["at_border"].sum() == table["at_border"].sum()


def test_outliers_are_judged_by_their_own_sigmas(tmp_path, rng):
    """Sigmas grow with the range: consistent points far away stay, small bushes near the boat do not."""
    n = 40_000
    range_m = rng.uniform(5.0, 75.0, n)
    sigma = 0.0025 * range_m
    out = sigma * rng.normal(size=n)
    bush = (range_m < 10.0) & (rng.random(n) < 0.3)
    out[bush] += 0.2  # 8 sigma of its own and more, but one of the points at 75 m
    sigmas = tuple(np.broadcast_to(sigma, (3, n)))
    path = cloud_of(
        tmp_path,
        bank.on_bank(rng, n) + out[:, None] * bank.OUT,
        range_m=range_m,
        sigmas=sigmas,
        correlations=(0.0, 0.0, 0.0),
    )
    settings = ComparisonSettings(reference_sigma_m=0.0)
    table, facts = compare_with_mesh(path, bank.bank_mesh(sigma_m=0.0), area=Area(), settings=settings)
    assert table["used"].all()
    outlier = table["outlier"].to_numpy()
    # a bush 8 sigma in front, 5.2 NMAD with what the bushes add: those at the rim of the rule may stay
    assert outlier[bush].mean() > 0.99
    # of normal values 6e-7 lie beyond five sigma
    assert outlier[~bush].sum() <= 1
    low, high = facts["outlier_limits_sigmas"]
    assert (low, high) == pytest.approx((-5.0, 5.0), abs=0.5)
    kept = table[~outlier]
    for first in (15.0, 35.0, 55.0, 70.0):
        part = kept[(kept["range_m"] >= first) & (kept["range_m"] < first + 5.0)]
        ratio = np.sqrt(np.mean(part["sigma_normal_m"] ** 2) / np.mean(part["distance_m"] ** 2))
        # 2850 values know a ratio to 1.3 %, millimetres of the LAZ file add nothing: three of them
        assert ratio == pytest.approx(1.0, abs=0.04)


def test_a_motion_keeps_the_rule(tmp_path, rng):
    """Nothing moves: the same points are outliers."""
    xyz = bank.on_bank(rng, 2000) + 0.02 * rng.standard_t(2, size=(2000, 1)) * bank.OUT
    mesh = bank.bank_mesh()
    table, _ = compare_with_mesh(cloud_of(tmp_path, xyz), mesh, area=Area(), settings=SETTINGS)
    same = after_motion(table, table[["east_m", "north_m", "up_m"]].to_numpy(), Surface(mesh), SETTINGS)
    assert table["outlier"].sum() > 20
    assert same["outlier"].equals(table["outlier"])


def test_facts_about_what_was_compared(tmp_path, rng):
    xyz = bank.on_bank(rng, 40_000) + 0.3 * bank.OUT
    xyz = xyz[xyz[:, 0] < 0.0]
    corners = np.array([[-20.0, -20.0], [20.0, -20.0], [20.0, -6.5], [-20.0, -6.5]])
    path = cloud_of(tmp_path, xyz, correlations=(0.0, 0.0, 0.0))
    _, facts = compare_with_mesh(
        path, bank.bank_mesh(), area=Area(polygon_en_m=corners), settings=ComparisonSettings()
    )
    # the bank reaches from north -10 to -16.9 m, seen from above; the polygon from -20 to -6.5 m
    assert facts["coverage"]["without_reference"] == pytest.approx(
        1 - 8 * np.cos(bank.SLOPE) / 13.5, abs=0.01
    )
    # no point east of zero, and none within half a metre of the rims: a share of 19.5 x 7 m2 at least has
    # points, and no more than what a cell of half a metre, cut by the slope, adds on all sides
    assert 1 - 20.5 * 8 / 320 <= facts["coverage"]["without_points"] < 1 - 19.5 * 7 / 320
    assert facts["coverage"]["reference_area_m2"] == pytest.approx(320.0, rel=0.01)
    # along the vertical 0.3 m of the normal are 0.3 / cos 30 degrees
    assert facts["height_above_reference_m"] == pytest.approx(0.3 / np.cos(bank.SLOPE), abs=0.01)
    first, last = facts["survey_gps_s"]
    assert bank.START_S <= first < last <= bank.START_S + 1000.0
    predicted = facts["predicted_95"]
    # sigmas of 3, 4 and 2 cm: quantile of Rayleigh's distribution 2.448, of the normal 1.960
    assert predicted["plan_median_m"] == pytest.approx(2.4477 * np.sqrt((0.03**2 + 0.04**2) / 2), rel=1e-4)
    assert predicted["height_p95_m"] == pytest.approx(1.96 * 0.02, rel=1e-4)


def test_a_large_cloud_is_sampled_without_preference(tmp_path, rng):
    """Beams follow one another in a fixed order: every 16th point would always be of one beam."""
    n = 32_000
    ring = (np.arange(n) % 16).astype(np.uint8)
    xyz = bank.on_bank(rng, n) + (ring[:, None] - 7.5) * 0.002 * bank.OUT
    path = cloud_of(tmp_path, xyz, ring=ring)
    settings = ComparisonSettings(max_points=2000)
    table, facts = compare_with_mesh(path, bank.bank_mesh(), area=Area(), settings=settings)
    assert len(table) == 2000
    assert facts["counts"]["not_in_sample"] == n - 2000
    assert (np.diff(table["t_gps_s"]) > 0).all()
    beam = np.rint(table["distance_m"] / 0.002 + 7.5).clip(0, 15).astype(int)
    # 125 of each beam, binomial: 11; rounding of coordinates moves some to the next beam
    assert np.bincount(beam, minlength=16).min() > 70
    again, _ = compare_with_mesh(path, bank.bank_mesh(), area=Area(), settings=settings)
    assert again.equals(table)


def test_the_sample_does_not_depend_on_the_chunks(rng):
    xyz = rng.normal(size=(10_000, 3))
    samples = []
    for size in (10_000, 700, 33):
        sample = _Sample(900, seed=4)
        for first in range(0, len(xyz), size):
            sample.add({"xyz_m": xyz[first : first + size]})
        samples.append(sample.columns()["xyz_m"])
    assert len(samples[0]) == 900
    for other in samples[1:]:
        np.testing.assert_array_equal(samples[0], other)
    few = _Sample(900, seed=4)
    few.add({"xyz_m": xyz[:900]})
    np.testing.assert_array_equal(few.columns()["xyz_m"], xyz[:900])


def test_points_that_were_moved_are_measured_anew(tmp_path, rng):
    xyz = bank.on_bank(rng, 1000) - 0.06 * bank.OUT
    mesh = bank.bank_mesh()
    table, _ = compare_with_mesh(cloud_of(tmp_path, xyz), mesh, area=Area(), settings=SETTINGS)
    places = table[["east_m", "north_m", "up_m"]].to_numpy()
    moved = after_motion(table, places + 0.06 * bank.OUT, Surface(mesh), SETTINGS)
    assert abs(moved["distance_m"]).max() < 0.0009
    assert moved["sigma_normal_m"].equals(table["sigma_normal_m"])
    assert moved["t_gps_s"].equals(table["t_gps_s"])


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"correlations": None}, ["corr_east_north", "georeferencing.correlations"]),
        ({"sigmas": (0.03, 0.0, 0.03)}, ["standard deviation of zero", "lidar_accuracy"]),
    ],
)
def test_clouds_that_lack_their_covariance_are_refused(tmp_path, rng, more, words):
    path = cloud_of(tmp_path, bank.on_bank(rng, 500), **more)
    with pytest.raises(InputError) as refused:
        compare_with_mesh(path, bank.bank_mesh(), area=Area(), settings=SETTINGS)
    for word in ("points.laz", *words):
        assert word in str(refused.value)


def test_every_column_of_the_distances_by_hand(tmp_path):
    """Names and units, read with pyarrow alone."""
    values = {
        "t_gps_s": 4.0e8, "range_m": 12.5, "east_m": 1.0, "north_m": 2.0, "up_m": 3.0, "distance_m": -0.25,
        "normal_east": 0.5, "normal_north": 0.25, "normal_up": 0.75, "sigma_normal_m": 0.125,
        "sigma_reference_m": 0.0625, "sigma_3d_m": 0.375, "at_border": False, "used": True, "outlier": False,
    }  # fmt: skip
    write_table(tmp_path / "c2m.parquet", pd.DataFrame({k: [v] for k, v in values.items()}), CLOUD_TO_MESH)
    table = pq.read_table(tmp_path / "c2m.parquet")
    assert table.to_pylist() == [values]
    units = {field.name: field.metadata[b"unit"].decode() for field in table.schema}
    assert units == {k: "s" if k == "t_gps_s" else "m" if k.endswith("_m") else "1" for k in values}
