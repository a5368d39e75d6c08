"""Registration, volumes, patches and retreat of four to eight core points, with full covariances by hand."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp
from pyproj import CRS

from thalweg.core import Dsm, GeometryError, robust_sigma
from thalweg.core.values import read_vectors
from thalweg.deformation import coregistration, volumes
from thalweg.deformation.changes import N_DRAWS, difference_of, draw_errors
from thalweg.deformation.core_points import bank_line_m, lines_of_bank
from thalweg.deformation.coregistration import coregister, design_of
from thalweg.deformation.field import ErrorField, ErrorGroup
from thalweg.deformation.foreign import (
    SurfaceDifference,
    difference_on_lines,
    read_difference,
    write_difference,
)
from thalweg.deformation.foreign.clouds import point_spacing_m, sigma_of_mean
from thalweg.deformation.series import heights_table
from thalweg.deformation.volumes import _patches, _rows, estimate_retreat, estimate_volumes
from thalweg.settings.sections import Deformation

# ---------------------------------------------------------------- registration


def test_a_registration_has_the_covariance_of_weighted_least_squares(monkeypatch):
    """Parameters S d, covariance S (shared + white) S' with all cross terms, and the statistic of both."""
    monkeypatch.setattr(coregistration, "_LEAST", 20)
    rng = np.random.default_rng(21)
    k = 60
    cores = rng.uniform(-20.0, 20.0, (k, 3))
    normals = rng.standard_normal((k, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    true = np.array([0.02, -0.01, 0.03, 1e-3, -5e-4, 8e-4])
    middle = cores.mean(axis=0)
    arm = cores - middle
    # a small rotation w moves a point by w x arm: n . (w x arm) = w . (arm x n)
    H = np.array([[*n, *np.cross(a, n)] for n, a in zip(normals, arm, strict=True)])
    assert design_of(cores, normals, middle) == pytest.approx(H)
    white = rng.uniform(0.001, 0.003, k)
    group = ErrorGroup.from_sigmas("position", np.array([0.0, 1.0]), np.array([0.002, 0.001, 0.003]), 2.0)
    rows = rng.standard_normal((k, 6)) / 2
    field = ErrorField((group,), (sp.csr_matrix(rows),))
    distance = H @ true + white * rng.standard_normal(k)
    found = coregister(
        cores, normals, distance, white, np.ones(k, dtype=bool), field, Deformation(registration="rigid")
    )
    S = found.weights
    assert found.parameters == pytest.approx(S @ distance)
    np.testing.assert_allclose(S @ H, np.eye(6), atol=1e-9)
    assert found.parameters == pytest.approx(true, abs=0.01)
    sigma2 = np.array([0.002, 0.001, 0.003]) ** 2
    C = np.kron(np.array([[1.0, np.exp(-0.5)], [np.exp(-0.5), 1.0]]), np.diag(sigma2))
    total = rows @ C @ rows.T + np.diag(white**2)
    assert found.cov == pytest.approx(S @ total @ S.T)
    assert list(found.facts["sigmas"].values()) == pytest.approx(np.sqrt(np.diag(S @ total @ S.T)))
    statistic = found.parameters @ np.linalg.solve(S @ total @ S.T, found.parameters)
    assert found.facts["test_statistic"] == pytest.approx(statistic)
    assert found.facts["degrees_of_freedom"] == 6
    assert found.facts["model"] == "rigid"
    assert found.registered(distance) == pytest.approx(distance - H @ found.parameters)
    error = rng.standard_normal(k)
    assert found.of_errors(error) == pytest.approx(error - H @ (S @ error))


# ---------------------------------------------------------------- volumes

AREA = np.array([1.0, 2.0, 1.5, 0.5, 3.0])
DISTANCE = np.array([-0.5, -0.2, 0.4, 0.01, np.nan])
STATE = ["erosion", "erosion", "deposition", "no significant change", "not seen in second"]


@pytest.fixture
def compared():
    """Five core points at 2, 7, 12, 13 and 14 m along the bank; errors that hang together."""
    rng = np.random.default_rng(22)
    root = 0.02 * rng.standard_normal((5, 5))
    shared, white = root @ root.T, np.diag(rng.uniform(0.01, 0.03, 5) ** 2)
    return SimpleNamespace(
        pair=SimpleNamespace(cores=pd.DataFrame({"area_m2": AREA, "s_m": [2.0, 7.0, 12.0, 13.0, 14.0]})),
        distance_m=DISTANCE,
        sigma_m=np.sqrt(np.diag(shared + white)),
        variances=lambda P: (np.diag(P @ shared @ P.T), np.diag(P @ white @ P.T)),
        draws=lambda n, seed: [np.array([0.3, 0.0, -0.3, 0.0, 0.0])] * n,
        cov=shared + white,
    )


@pytest.fixture
def table():
    return pd.DataFrame(
        {
            "distance_m": DISTANCE,
            "state": STATE,
            "significant": [True, True, True, False, False],
            "east_m": [2.0, 7.0, 12.0, 13.0, 14.0],
            "north_m": 1.0,
            "up_m": [0.0, 0.5, 1.0, 1.5, 2.0],
        }
    )


def test_volumes_and_their_sigmas_by_hand(table, compared):
    found, along = estimate_volumes(table, compared, Deformation(station_m=10.0), 1)
    assert found["what"].tolist() == ["erosion", "deposition", "net"]
    assert found["volume_m3"].tolist() == pytest.approx([-0.9, 0.6, -0.295])
    weights = np.array([[1, 2, 0, 0, 0], [0, 0, 1.5, 0, 0], [1, 2, 1.5, 0.5, 0]])
    sigma = np.sqrt(np.diag(weights @ compared.cov @ weights.T))
    assert found["sigma_m3"].to_numpy() == pytest.approx(sigma)
    assert found["low_m3"].to_numpy() == pytest.approx(found["volume_m3"] - 1.959964 * sigma)
    assert found["high_m3"].to_numpy() == pytest.approx(found["volume_m3"] + 1.959964 * sigma)
    assert found["area_m2"].tolist() == pytest.approx([3.0, 1.5, 5.0])
    assert found["not_seen_m2"].tolist() == [3.0] * 3
    keys = ["what", "s_from_m", "s_to_m", "volume_m3", "area_m2", "not_seen_m2"]
    rows = along[keys].to_numpy(dtype=object).tolist()
    assert rows == [
        ["erosion", 0.0, 10.0, pytest.approx(-0.9), 3.0, 0.0],
        ["erosion", 10.0, 20.0, 0.0, 0.0, 3.0],
        ["deposition", 0.0, 10.0, 0.0, 0.0, 0.0],
        ["deposition", 10.0, 20.0, pytest.approx(0.6), 1.5, 3.0],
        ["net", 0.0, 10.0, pytest.approx(-0.9), 3.0, 0.0],
        ["net", 10.0, 20.0, pytest.approx(0.605), 2.0, 3.0],
    ]


def test_what_a_threshold_does_to_sums_by_hand(table, compared):
    """The limit is the smallest significant ratio, that of the second point: -0.2 m over its sigma."""
    compared.sigma_m = np.full(5, 0.1)
    found, _ = estimate_volumes(table, compared, Deformation(station_m=10.0), 1)
    # -0.5 + 0.3 is as far as the limit of 0.2 and counts; 0.4 - 0.3 is not
    assert found["bias_m3"].tolist() == pytest.approx([0.3, -0.6, 0.0])


def test_patches_and_their_columns_by_hand(table):
    places = table[["east_m", "north_m", "up_m"]].to_numpy()
    state = np.array(STATE, dtype=object)
    assert _patches(places, state, 5.1).tolist() == [0, 0, 1, -1, -1]  # sqrt(25.25) m apart
    apart = _patches(places, state, 5.0)
    assert apart.tolist() == [0, 1, 2, -1, -1]
    rows = _rows(table, AREA, _patches(places, state, 5.1), SimpleNamespace(least_patch_m2=1.5))
    assert rows.to_numpy(dtype=object).tolist() == [
        ["erosion", 2, 3.0, pytest.approx(-0.9), pytest.approx(-0.35), -0.5, 4.5, 1.0, 0.25],
        ["deposition", 1, 1.5, pytest.approx(0.6), pytest.approx(0.4), 0.4, 12.0, 1.0, 1.0],
    ]
    assert len(_rows(table, AREA, apart, SimpleNamespace(least_patch_m2=1.6))) == 1


def test_retreat_of_a_line_by_hand(table, compared, monkeypatch):
    """Two stretches, the second the mean of two points, in half a year."""
    products = np.array([[1.0, 0, 0, 0, 0], [0, 0.5, 0.5, 0, 0]])
    rows = pd.DataFrame({"line": ["bank line", "bank line"], "height_m": [1.0, 1.0]})
    monkeypatch.setattr(volumes, "lines_of_bank", lambda *_: (rows, products))
    found = estimate_retreat(table, compared, Deformation(), water_m=0.5, years=0.5)
    sigma = np.sqrt(np.diag(products @ compared.cov @ products.T))
    moved = np.array([-0.5, 0.1])
    assert found["nsm_m"].to_numpy() == pytest.approx(moved)
    assert found["sigma_m"].to_numpy() == pytest.approx(sigma)
    assert found["low_m"].to_numpy() == pytest.approx(moved - 1.959964 * sigma)
    assert found["high_m"].to_numpy() == pytest.approx(moved + 1.959964 * sigma)
    assert found["epr_m_a"].to_numpy() == pytest.approx(moved / 0.5)
    assert found["sigma_epr_m_a"].to_numpy() == pytest.approx(sigma / 0.5)


# ---------------------------------------------------------------- what is written


def test_a_registration_goes_to_disk_with_its_facts(tmp_path):
    rng = np.random.default_rng(8)
    k = 40
    cores = np.column_stack([rng.uniform(-9.0, 9.0, (k, 2)), np.zeros(k)])
    normals = np.tile([0.0, 0.0, 1.0], (k, 1))
    group = ErrorGroup.from_sigmas("position", np.array([0.0]), np.full(3, 1e-6), 2.0)
    field = ErrorField((group,), (sp.csr_matrix(normals),))
    bare = np.arange(k) != 3
    distance = np.where(np.arange(k) == 5, np.nan, 0.02) + 0.002 * rng.standard_normal(k)
    ring = [(-9.0, -9.0), (9.0, -9.0), (9.0, 9.0), (-9.0, 9.0)]
    words = {}
    for name, stable in (("all", None), ("drawn", [ring, [(x + 100.0, y) for x, y in ring]])):
        settings = Deformation(registration="shift", stable=stable)
        found = coregister(cores, normals, distance, np.full(k, 0.002), bare, field, settings)
        coregistration.write_registration(tmp_path / "r.json", tmp_path / "r.npz", found)
        facts = json.loads((tmp_path / "r.json").read_text())
        words[name] = facts["areas"], facts["n_areas"]
        assert facts["candidates"] == k - 2
        assert facts["stable_cores"] == int(found.stable.sum())
        with np.load(tmp_path / "r.npz") as stored:
            for array in ("parameters", "cov", "design", "weights", "stable"):
                np.testing.assert_array_equal(stored[array], getattr(found, array))
    assert words == {"all": ("what most of the bank agrees on", 1), "drawn": ("drawn", 2)}


def test_drawn_errors_and_heights_of_a_series_are_tables():
    compared = SimpleNamespace(
        distance_m=np.array([0.1, np.nan, 0.2]),
        draws=lambda n, seed: [seed + i + np.array([0.1, 0.2, 0.3]) for i in range(n)],
    )
    table = draw_errors(compared, 7)
    assert table["core"].tolist() == [0, 1, 2]
    assert table.shape[1] == 1 + N_DRAWS
    for i in (0, N_DRAWS - 1):
        expected = [7.1 + i, np.nan, 7.3 + i]
        assert table[f"draw_{i:02d}_m"].tolist() == pytest.approx(expected, nan_ok=True, rel=1e-6)

    height = np.array([[0.0, np.nan], [0.1, 0.4], [np.nan, 0.5]])
    heights = heights_table(np.array([2020.5, 2021.0, 2023.0]), height, height / 10 + 0.01)
    assert heights["place"].tolist() == [0, 0, 1, 1]
    assert heights["epoch"].tolist() == [1, 2, 2, 3]
    assert heights["t_a"].tolist() == pytest.approx([0.0, 0.5, 0.5, 2.5])
    assert heights["distance_m"].tolist() == pytest.approx([0.0, 0.1, 0.4, 0.5])
    assert heights["sigma_m"].tolist() == pytest.approx([0.01, 0.02, 0.05, 0.06])


def test_the_sigma_of_a_mean_of_three_unequal_ones():
    """Places 0.5 and 12 m apart with a radius of 0.5 m: two cylinders overlap, all share the field."""
    table = pd.DataFrame(
        {
            "east_m": [0.0, 0.3, 0.3],
            "north_m": [0.0, 0.4, 0.4],
            "up_m": [0.0, 0.0, 12.0],
            "sigma_m": 0.1,
            "sigma_field_m": [0.01, 0.02, 0.06],
            "sigma_white_m": [0.03, 0.01, 0.08],
            "sigma_registration_m": [0.02, 0.02, 0.05],
        }
    )
    lag = np.array([[0.0, 0.5, np.sqrt(144.25)], [0.5, 0.0, 12.0], [np.sqrt(144.25), 12.0, 0.0]])
    half = np.minimum(lag / 1.0, 1.0)  # of a diameter
    lens = 2 / np.pi * (np.arccos(half) - half * np.sqrt(1 - half**2))
    for correlation_m, alike in ((4.0, np.exp(-lag / 4.0)), (0.0, np.eye(3))):
        variance = 0.0
        for name, rho in (("field", alike), ("white", lens), ("registration", np.ones((3, 3)))):
            s = table[f"sigma_{name}_m"].to_numpy()
            variance += s @ rho @ s / 9
        unmeasured = pd.concat([table, table.assign(sigma_m=np.nan, sigma_field_m=9.0)])
        assert sigma_of_mean(unmeasured, 0.5, correlation_m) == pytest.approx(np.sqrt(variance))


def test_a_difference_is_read_as_it_was_written(tmp_path):
    values = np.array([[0.1, np.nan, -0.3], [0.4, 0.5, 0.6]])
    raster = Dsm(values, np.array([500.0, 900.0]), np.array([2.0, 3.0]), CRS.from_epsg(25833), tmp_path)
    write_difference(tmp_path / "d.tif", SurfaceDifference(raster, values**2, pd.DataFrame(), []))
    back = read_difference(tmp_path / "d.tif")
    np.testing.assert_allclose(back.raster.height_m, values, rtol=1e-6)
    np.testing.assert_allclose(back.sigma_m, values**2, rtol=1e-6)
    assert back.raster.corner_m.tolist() == [500.0, 900.0]
    assert back.raster.cell_m.tolist() == [2.0, 3.0]
    assert back.raster.frame.to_epsg() == 25833
    assert len(back.volumes) == 0


def test_differences_on_lines_of_stable_ground(tmp_path):
    """A road of 6 m along three cells of 2 m: the median of 1, 2 and 6 cm, and their scatter about it."""
    line = {"type": "LineString", "coordinates": [[500_000.5, 5_699_999.0], [500_006.6, 5_699_999.0]]}
    feature = {"type": "Feature", "properties": {}, "geometry": line}
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25833"}}
    path = tmp_path / "road.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "crs": crs, "features": [feature]}))
    corner, cell, frame = np.array([500_000.0, 5_700_000.0]), np.full(2, 2.0), CRS.from_epsg(25833)
    before = Dsm(np.full((1, 3), 10.0), corner, cell, frame, tmp_path / "a.tif")
    after = Dsm(np.array([[10.01, 10.02, 10.06]]), corner, cell, frame, tmp_path / "b.tif")
    found = difference_on_lines(before, after, read_vectors(path), step_m=2.0)
    assert found.n == 3
    assert found.median_m == pytest.approx(0.02)
    assert found.nmad_m == pytest.approx(robust_sigma(np.array([0.01, 0.02, 0.06]), 0.02))
    hole = replace(after, height_m=np.array([[10.01, np.nan, 10.06]]))
    assert difference_on_lines(before, hole, read_vectors(path), step_m=2.0).n == 2
    with pytest.raises(GeometryError, match="no point of the lines"):
        difference_on_lines(before, replace(after, height_m=np.full((1, 3), np.nan)), read_vectors(path))


def test_errors_of_a_difference_are_those_of_the_second_less_those_of_the_first():
    """Poses of both epochs for themselves; the mount is one error of both where the boat is the same."""
    rng = np.random.default_rng(4)
    sigmas = {"position": 0.02, "mount of the lidar": 0.01}
    fields, rows = [], []
    for _ in range(2):
        groups = tuple(
            ErrorGroup.from_sigmas(name, np.array([0.0]), np.full(3, s), 2.0) for name, s in sigmas.items()
        )
        rows.append(rng.standard_normal((2, 4, 3)))
        fields.append(ErrorField(groups, tuple(sp.csr_matrix(each) for each in rows[-1])))
    for common in (False, True):
        found = difference_of(*fields, common_mounts=common)
        whole = np.hstack([each.toarray() for each in found.rows])
        assert whole.sum() == pytest.approx(rows[1].sum() - rows[0].sum())
        (a, b), (c, d) = rows
        mounts = (d - b) @ (d - b).T if common else b @ b.T + d @ d.T
        C = 0.02**2 * (a @ a.T + c @ c.T) + 0.01**2 * mounts
        assert found.variances() == pytest.approx(np.diag(C))


# ---------------------------------------------------------------- lines of a bank


def test_lines_of_a_bank_are_weighted_sums_of_the_distances_of_its_face():
    """A face of 45 degrees and one turned by 60 degrees about the plumb line; flat ground has no line."""
    slant = np.sqrt(0.5)
    normals = (
        [[slant, 0.0]] * 4 + [[slant / 2, slant * np.sqrt(0.75)]] * 2 + [[np.sin(np.deg2rad(19.0)), 0.0]] * 2
    )
    cores = pd.DataFrame(np.array(normals), columns=["normal_east", "normal_north"]).assign(
        s_m=[0.5, 1.0, 1.5, 1.9, 0.2, 3.0, 1.0, 1.2], up_m=[0.75, 1.24, 1.26, 3.0, 1.0, 3.1, 1.0, 1.0]
    )
    use = np.array([True] * 8)
    settings = Deformation(station_m=2.0)
    assert bank_line_m(settings, 0.4) == pytest.approx(0.9)
    assert bank_line_m(settings.replace(line_height_m=7.0), 0.4) == 7.0
    rows, products = lines_of_bank(cores, use, settings, 1.0)
    # of the first stretch 0, 1 and 4 lie within 25 cm of 1 m; of the upper edge of the face fewer than three
    assert rows["line"].tolist() == ["bank line"]
    assert rows.iloc[0, 1:].tolist() == [1.0, 0.0, 2.0, 3]
    here = np.array([0, 1, 4])
    n = np.array(normals)[here]
    across = n.mean(axis=0) / np.linalg.norm(n.mean(axis=0))
    share = n @ across
    expected = np.zeros(8)
    expected[here] = share / np.sum(share**2)
    np.testing.assert_allclose(products, expected[None])
    # a movement of 0.3 m across shows as distances n'c m, and comes back
    assert products[0] @ (0.3 * np.array(normals) @ across) == pytest.approx(0.3)
    assert lines_of_bank(cores, use & (np.arange(8) != 4), settings, 1.0)[0].empty
    # the upper edge: what 5 % of the face lies above, less the width of the band
    high = cores.assign(up_m=[1.0, 2.9, 3.0, 3.0, 3.0, 3.1, 9.0, 9.0])
    top, _ = lines_of_bank(high, use, settings, 9.0)
    assert top["line"].tolist() == ["bank top"]
    assert top["height_m"][0] == pytest.approx(np.quantile([1.0, 2.9, 3.0, 3.0, 3.0], 0.95) - 0.25)
    assert top["cores"][0] == 4


def test_the_spacing_of_a_cloud_is_asked_all_over_it(tmp_path):
    """5,000 points in a row, 1 m apart at first and 2 m from the tenth on; a point that is there twice."""
    x = np.concatenate([np.arange(10.0), 10.0 + 2.0 * np.arange(4990), [3.0]])
    np.savetxt(tmp_path / "row.xyz", np.column_stack([x, np.zeros((len(x), 2))]))
    assert point_spacing_m(tmp_path / "row.xyz") == pytest.approx(2.0)
    (tmp_path / "one.xyz").write_text("1000 2.5 3\n1000 2.5 3\n")
    assert point_spacing_m(tmp_path / "one.xyz") is None
