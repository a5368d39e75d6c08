"""Water level, banks, and the bed of a channel whose shape is known."""

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from pyproj import CRS

from tests.bands import band
from tests.conftest import check_whole
from thalweg import core
from thalweg.bathymetry import (
    OBSERVATIONS,
    SOUNDINGS,
    Across,
    BedModel,
    CovarianceModel,
    Drift,
    FlowLine,
    Observations,
    WaterLevel,
    against_reference,
    bed_observations,
    choose_model,
    error_lengths,
    flow_of_survey,
    krige_bed,
    level_water,
    read_other_soundings,
    validate_bed,
)
from thalweg.bathymetry.banks import axis_of_track, centre_of, onto_line, shore_points, trace_banks
from thalweg.core import (
    CoverageError,
    GeometryError,
    InputError,
    LazWriter,
    LocalFrame,
    Trajectory,
    frame_of,
    write_raster,
)
from thalweg.navigation.ins_gnss import PoseCorrelation
from thalweg.settings.sections import Bathymetry, EchoSounder

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
UTM = CRS("EPSG:25833")
CORRELATION = PoseCorrelation(position_s=10.0, attitude_s=20.0, white_share=0.25, receiver_s=0.1)
HALF_M = 12.0


def river(step: float = 2.0) -> FlowLine:
    x = np.arange(-20.0, 182.0, step)
    return FlowLine.through(np.column_stack([x, 8 * np.sin(x / 30)]))


def depth_m(s: np.ndarray, n: np.ndarray) -> np.ndarray:
    """A parabola with pools."""
    return np.maximum(1 - (n / HALF_M) ** 2, 0) * (1.6 + 0.3 * np.sin(s / 12))


def track(line: FlowLine, margin_m: float = 3.0, leg_m: float = 15.0, n: int = 900) -> np.ndarray:
    s = np.linspace(25, line.length_m - 25, n)
    phase = (s / leg_m) % 2
    across = np.where(phase < 1, 2 * phase - 1, 3 - 2 * phase) * (HALF_M - margin_m)
    return np.column_stack([s, across])


def soundings(
    line: FlowLine, flow: np.ndarray, rng: np.random.Generator, sigma_m: float = 0.02
) -> pd.DataFrame:
    xy = line.to_map(flow[:, 0], flow[:, 1])
    up = -depth_m(flow[:, 0], flow[:, 1]) + sigma_m * rng.standard_normal(len(flow))
    n = len(flow)
    values = {name: np.zeros(n) for name in SOUNDINGS.names} | {
        "t_gps_s": np.arange(n) * 0.1,
        "t_even_s": np.arange(n) * 0.1,
        "east_m": xy[:, 0],
        "north_m": xy[:, 1],
        "up_m": up,
        "transducer_east_m": xy[:, 0],
        "transducer_north_m": xy[:, 1],
        "transducer_up_m": np.full(n, -0.1),
        "range_m": -0.1 - up,
        "depth_m": -up,
        "sigma_white_m": np.full(n, sigma_m),
        "sigma_slow_m": np.full(n, 0.002),
        "sigma_common_m": np.full(n, 0.005),
        "cov_uu_m2": np.full(n, sigma_m**2 + 0.002**2 + 0.005**2),
        "line": (flow[:, 0] // 15).astype(int),
        "used": np.ones(n, dtype=bool),
        "reason": np.full(n, ""),
        "row": np.arange(n),
    }
    return frame_of(SOUNDINGS, values)


def shore_cloud(line: FlowLine, rng: np.random.Generator, slope: float = 0.4, n: int = 60_000):
    """Ground that rises from the water on both sides, unseen on the left between 60 and 80 m."""
    s, h = rng.uniform(10, line.length_m - 10, n), rng.uniform(0, 1.0, n)
    side = rng.choice([-1.0, 1.0], n)
    unseen = (side > 0) & (s > 60) & (s < 80)
    across = side * (HALF_M + h / slope) + 0.02 * rng.standard_normal(n)
    xy = line.to_map(s, across)
    points = np.column_stack([xy, h + 0.02 * rng.standard_normal(n)])[~unseen]
    return points, np.full(len(points), 0.02), np.full(len(points), 0.02)


LEVEL = WaterLevel(level_m=0.0, cov=np.diag([0.005**2, 0, 0]))


@pytest.fixture(scope="module")
def survey():
    rng = np.random.default_rng(4)
    line = river()
    flow = track(line)
    banks, level = flow_of_survey(
        line.to_map(flow[:, 0], flow[:, 1]), shore_cloud(line, rng), lambda _: LEVEL, Bathymetry()
    )
    return line, banks, level, soundings(line, flow, rng)


@pytest.fixture(scope="module")
def bed(survey):
    _, banks, level, table = survey
    return krige_bed(
        table,
        banks.line,
        banks,
        level,
        None,
        frame=FRAME,
        crs=UTM,
        echo=EchoSounder(beam_deg=0.0),
        settings=Bathymetry(cell_m=1.0, model="matern32"),
        slow_time_s=10.0,
        seed=1,
    )


def test_points_of_the_shore_are_bounded_and_show_the_same(tmp_path, monkeypatch):
    """Of a long log as many as of a short one, spread over all of it, in the order of the file."""
    line, sigmas = river(), ("sigma_east", "sigma_north", "sigma_up")
    points, up, _ = shore_cloud(line, np.random.default_rng(8))
    with LazWriter(
        tmp_path / "a.laz", FRAME, scale_m=1e-6, extra_dimensions=dict.fromkeys(sigmas, ("f8", "m"))
    ) as writer:
        for part in np.array_split(np.arange(len(points)), 7):
            writer.append(points[part], extra=dict.fromkeys(sigmas, up[part]))
    monkeypatch.setattr("thalweg.bathymetry.banks.iter_laz", lambda path: core.iter_laz(path, 1000))
    whole = shore_points([tmp_path / "a.laz"], 0.0)
    np.testing.assert_allclose(whole[0], points, atol=1e-6)
    np.testing.assert_allclose(whole[2], 0.02)
    monkeypatch.setattr("thalweg.bathymetry.banks._SHORE_POINTS", 10_000)
    some = shore_points([tmp_path / "a.laz", tmp_path / "a.laz"], 0.0)
    twice = np.concatenate([whole[0], whole[0]])
    assert 10_000 <= len(some[0]) <= 20_000
    np.testing.assert_array_equal(some[0], twice[::8])
    table = [
        trace_banks(*each, line, LEVEL, (0.0, line.length_m), Bathymetry()).set_index(["side", "s_m"])
        for each in (whole, some)
    ]
    both = table[0].join(table[1], how="inner", suffixes=("", "_some"))
    assert len(both) == len(table[0]) > 50
    off = (both["n_m_some"] - both["n_m"]) / np.hypot(both["sigma_across_m"], both["sigma_across_m_some"])
    assert np.abs(off).max() < 2.0


# ---------------------------------------------------------------- water


def floating(fall: float, rise: float, sigma_m: float, rng: np.random.Generator, *, back: bool) -> Trajectory:
    t = np.arange(0.0, 600.0, 0.5)
    s = np.where(t < 300, t, 600 - t) if back else t
    last = np.linalg.cholesky(np.exp(-np.abs(t[:, None] - t[None]) / 10.0) + 1e-9 * np.eye(len(t)))
    up = 0.2 - fall * s + rise * t + sigma_m * (last @ rng.standard_normal(len(t)))
    cov = np.zeros((len(t), 6, 6))
    cov[:] = np.diag([sigma_m**2] * 3 + [1e-6] * 3)
    return Trajectory(
        frame=FRAME,
        t_gps_s=t,
        position_wcs_m=np.column_stack([s, np.zeros(len(t)), up]),
        quaternion_wcs_ics=np.tile([1.0, 0.0, 0.0, 0.0], (len(t), 1)),
        cov_pose_wcs=cov,
        valid=np.ones(len(t), dtype=bool),
    )


def levelled(trajectory: Trajectory) -> WaterLevel:
    whole = replace(CORRELATION, white_share=0.0)
    return level_water(trajectory, whole, lambda p: p[:, 0], water_line_ics_m=0.2, sigma_datum_m=0.0)


def test_fall_and_rise_of_the_water_with_their_sigmas():
    rng = np.random.default_rng(8)
    z = []
    for _ in range(25):
        found = levelled(floating(1e-3, 2e-4, 0.02, rng, back=True))
        true = -1e-3 * found.s0_m + 2e-4 * found.t0_gps_s
        z.append(
            [
                (found.level_m - true) / np.sqrt(found.cov[0, 0]),
                (found.slope + 1e-3) / np.sqrt(found.cov[1, 1]),
                (found.rise_m_per_s - 2e-4) / np.sqrt(found.cov[2, 2]),
            ]
        )
    assert np.mean(np.square(z)) == pytest.approx(1.0, abs=0.35)  # 75 values


def test_one_way_down_cannot_tell_a_rise_from_a_fall():
    found = levelled(floating(1e-3, 0.0, 0.01, np.random.default_rng(1), back=False))
    assert found.slope == pytest.approx(-1e-3, abs=2e-4)
    assert found.rise_m_per_s == 0.0
    assert any("rise in time: not told" in note for note in found.notes)


def test_level_water_needs_a_trajectory():
    whole = floating(0.0, 0.0, 0.01, np.random.default_rng(1), back=False)
    blind = replace(whole, valid=np.zeros(len(whole.t_gps_s), dtype=bool))
    with pytest.raises((CoverageError, GeometryError)):
        levelled(blind)


# ---------------------------------------------------------------- banks


def test_banks_where_the_ground_meets_the_water(survey):
    line, banks, _, _ = survey
    s, n, _ = line.to_flow(banks.table[["east_m", "north_m"]].to_numpy())
    error = np.abs(n) - HALF_M
    seen = banks.table["seen"].to_numpy()
    assert np.sqrt(np.mean(error[seen] ** 2)) < 0.1
    # One-sided: sigmas are those of a cell, the errors of so clean a bank a third of them (square 0.12)
    z = error[seen] / banks.table["sigma_across_m"].to_numpy()[seen]
    assert np.mean(z**2) < 1.0
    gap = (n > 0) & (s > 63) & (s < 77)
    assert gap.any()
    assert not seen[gap].any()
    assert banks.table["sigma_across_m"].to_numpy()[gap].max() > 0.5


def test_a_gap_that_is_too_long_has_no_bank(survey):
    line, _, _, _ = survey
    cloud = shore_cloud(line, np.random.default_rng(4))
    table = trace_banks(*cloud, line, LEVEL, (30.0, 150.0), Bathymetry(bank_gap_m=5.0))
    left = table[(table["side"] == "left") & (table["s_m"] > 63) & (table["s_m"] < 77)]
    assert not len(left)


def test_axis_without_its_zigzag_and_centre_between_the_banks(survey):
    line, banks, _, _ = survey
    flow = track(line)
    axis = axis_of_track(line.to_map(flow[:, 0], flow[:, 1]))
    at = line.to_map(np.linspace(40, 150, 50), 0.0)
    assert np.abs(axis.to_flow(at)[1]).max() < 0.6 * HALF_M
    assert np.abs(banks.line.to_flow(at)[1]).max() < 1.0
    assert np.abs(centre_of(banks.table, banks.line).to_flow(at)[1]).max() < 1.0


def test_a_long_track_has_its_axis_in_seconds():
    """A zigzag over 14 km of bends; with a filter whose cost grows with its width it took minutes."""
    x = np.arange(0.0, 13_500.0, 5.0)
    line = FlowLine.through(np.column_stack([x, 150 * np.sin(x / 400)]))
    s = np.linspace(20, line.length_m - 20, 50_000)
    flow = np.column_stack([s, 80 / np.pi * np.arcsin(np.sin(2 * np.pi * s / 160))])
    start = time.process_time()
    axis = axis_of_track(line.to_map(flow[:, 0], flow[:, 1]))
    assert time.process_time() - start < 8.0
    off = axis.to_flow(line.to_map(np.linspace(100, line.length_m - 100, 300), 0.0))[1]
    assert np.abs(off).max() < 10.0


def test_swapped_and_missing_banks_are_named(survey):
    line, banks, _, _ = survey
    swapped = banks.table.assign(side=banks.table["side"].map({"left": "right", "right": "left"}))
    with pytest.raises(GeometryError, match="100% of the bank's places lie on the other side") as told:
        onto_line(swapped, line)
    check_whole(told.value)
    nothing = (np.empty((0, 3)), np.empty(0), np.empty(0))
    flow = track(line)
    with pytest.raises(CoverageError, match="no bank") as told:
        flow_of_survey(line.to_map(flow[:, 0], flow[:, 1]), nothing, lambda _: LEVEL, Bathymetry())
    check_whole(told.value)
    with pytest.raises(GeometryError, match="a boat that went along") as told:
        axis_of_track(np.zeros((100, 2)))
    check_whole(told.value)


# ---------------------------------------------------------------- bed


def errors(bed, line: FlowLine) -> tuple[np.ndarray, np.ndarray]:
    known = np.isfinite(bed.up_m)
    places = FRAME.from_map(np.column_stack([bed.grid.centres_m()[known], np.full(known.sum(), 300.0)]), UTM)[
        :, :2
    ]
    s, n, _ = line.to_flow(places)
    return bed.up_m[known] + depth_m(s, n), np.hypot(bed.sigma_m[known], bed.sigma_common_m[known])


def test_bed_of_a_channel_and_its_sigmas(survey, bed):
    error, sigma = errors(bed, survey[0])
    assert np.sqrt(np.mean(error**2)) < 0.06
    # One observation, of a bed that is smoother than the model's: squares of 0.4. The guard is `bed_study`,
    # of 40 rivers.
    assert 0.3 < np.mean((error / sigma) ** 2) < 1.0
    assert bed.model.covariance.range_s_m > 2 * bed.model.covariance.range_n_m  # rivers are long


def test_no_bed_outside_the_banks(survey, bed):
    line = survey[0]
    known = np.isfinite(bed.up_m)
    places = FRAME.from_map(np.column_stack([bed.grid.centres_m()[known], np.full(known.sum(), 300.0)]), UTM)[
        :, :2
    ]
    assert np.abs(line.to_flow(places)[1]).max() < HALF_M + 0.5
    bands = bed.bands(FRAME)
    assert np.nanmedian(bands["height_m"]) == pytest.approx(300.0 + np.nanmedian(bed.up_m), abs=0.01)
    assert np.array_equal(np.isfinite(bands["height_m"]), known)


def test_left_out_lines_judge_the_methods(survey, bed):
    _, banks, _, _ = survey
    facts, predicted, methods = validate_bed(bed.data, bed.model, banks.half_widths_m, Bathymetry())
    assert facts["lines"] == predicted.loc[predicted["group"] == "line", "number"].nunique() >= 8
    # one observation of some ten lines; 0.89, within a factor of two. The guard is `bed_study`
    assert 0.45 < facts["normalised_square"] < 1.8
    # each foretold place: its distance to the nearest datum of another line, and which lie near the shore
    of = predicted[predicted["group"] == "line"].iloc[::7]
    number, s, n = (of[[name]].to_numpy() for name in ("number", "s_m", "n_m"))
    off = np.hypot(s - bed.data["s_m"].to_numpy(), n - bed.data["n_m"].to_numpy())
    off[number == bed.data["line"].to_numpy()] = np.inf
    assert of["distance_m"].to_numpy() == pytest.approx(off.min(axis=1))
    left, right = banks.half_widths_m(s)
    assert of["margin"].tolist() == (np.where(n > 0, n / left, -n / right) > 0.7).ravel().tolist()
    rmse = methods.set_index("method")["rmse_m"]
    assert rmse["kriging"] < 0.6 * rmse["kriging, same range along and across"]
    assert rmse["kriging"] < rmse["inverse distance"]
    # a sigma ten times too small is seen
    of = bed.model.covariance
    sure = replace(bed.model, covariance=replace(of, sill_m2=of.sill_m2 / 100, micro_m2=0.0))
    assert validate_bed(bed.data, sure, banks.half_widths_m, Bathymetry())[0]["normalised_square"] > 3


def test_data_of_the_bed_by_source(survey):
    _, banks, level, table = survey
    strip = pd.DataFrame(
        {
            "t_gps_s": np.repeat([5.0, 6.0], 40),
            "east_m": np.tile(np.linspace(0, 0.4, 40), 2),
            "north_m": 0.0,
            "up_m": -1.0,
            "sigma_line_m": 0.001,
            "cov_uu_m2": 0.03**2,
        }
    )
    found, counts = bed_observations(table, banks.line, banks, level, strip, bank_as_data=True)
    assert list(found.columns) == OBSERVATIONS.names
    assert counts["soundings"] == len(table)
    assert counts["light sheet"] == (found["source"] == "light sheet").sum() == 4
    sheet = found[found["source"] == "light sheet"]
    assert sheet["sigma_slow_m"].to_numpy() == pytest.approx(0.03, abs=1e-4)
    assert (found.loc[found["source"] == "bank", "line"] < 0).all()
    without = bed_observations(table, banks.line, banks, level, None, bank_as_data=False)[0]
    assert set(without["source"]) == {"sounding"}


# ---------------------------------------------------------------- model


def field(n_lines: int, rng: np.random.Generator) -> tuple[Observations, Callable]:
    line = np.repeat(np.arange(n_lines), 40)
    s, n = 12.0 * line + rng.uniform(-0.5, 0.5, len(line)), np.tile(np.linspace(-11, 11, 40), n_lines)
    h = np.hypot((s[:, None] - s[None]) / 60.0, (n[:, None] - n[None]) / 8.0)
    root = np.linalg.cholesky(0.09 * np.exp(-3 * h) + 1e-9 * np.eye(len(s)))
    white = 0.02
    data = Observations(
        s_m=s,
        n_m=n,
        height_m=root @ rng.standard_normal(len(s)) + white * rng.standard_normal(len(s)),
        sigma_white_m=np.full(len(s), white),
        sigma_slow_m=np.zeros(len(s)),
        t_s=np.full(len(s), np.nan),
        line=line,
    )
    return data, lambda at: (np.full(np.shape(at), 12.0), np.full(np.shape(at), 12.0))


def test_four_lines_are_no_reason_for_small_sigmas():
    """Four sections between level shorelines: the bed between them is as uncertain as it is wrong."""
    settings, squares = Bathymetry(drift="none"), []
    for seed in range(6):
        rng = np.random.default_rng(40 + seed)
        line = np.repeat(np.arange(4), 40)
        known = np.column_stack(
            [15.0 * line + rng.uniform(-0.5, 0.5, 160), np.tile(np.linspace(-9, 9, 40), 4)]
        )
        hidden = np.column_stack([rng.uniform(0, 45, 300), rng.uniform(-9, 9, 300)])
        places = np.vstack([known, hidden])
        h = np.hypot(*((places[:, None, k] - places[None, :, k]) / r for k, r in ((0, 90.0), (1, 12.0))))
        a = 4.743864518104397 * h
        root = np.linalg.cholesky(0.09 * (1 + a) * np.exp(-a) + 1e-7 * np.eye(len(h)))
        z = root @ rng.standard_normal(len(h)) - 1.5 * (1 - (places[:, 1] / 12) ** 2)
        shore = np.arange(-4.0, 50.0, 2.0)
        n = len(known) + 2 * len(shore)
        white = np.concatenate([np.full(len(known), 0.02), np.full(2 * len(shore), 0.05)])
        data = Observations(
            s_m=np.concatenate([known[:, 0], shore, shore]),
            n_m=np.concatenate([known[:, 1], np.full(len(shore), 12.0), np.full(len(shore), -12.0)]),
            height_m=np.concatenate(
                [z[: len(known)] + 0.02 * rng.standard_normal(160), 0 * shore, 0 * shore]
            ),
            sigma_white_m=white,
            sigma_slow_m=np.zeros(n),
            t_s=np.full(n, np.nan),
            line=np.concatenate([line, np.full(len(shore), -2), np.full(len(shore), -3)]),
        )

        def widths(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return np.full(np.shape(at), 12.0), np.full(np.shape(at), 12.0)

        model = choose_model(data, widths, settings, slow_time_s=0.0, seed=seed)
        height, sigma = model.predict(data, hidden, neighbours=48)
        squares.append(float(np.mean(((height - z[len(known) :]) / sigma) ** 2)))
    low, high = band(6 * 8)  # six beds, each with some eight places between the lines that err by themselves
    assert low < np.mean(squares) < high
    assert max(squares) < 4.0


def test_a_river_that_is_deeper_where_it_is_narrower_says_so():
    """Nine sections far apart: a mean section that knows the width is chosen, and is better between them."""
    rng = np.random.default_rng(9)

    def widths(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        half = 20.0 * np.exp(0.3 * np.sin(np.asarray(at) / 60.0))
        return half, half

    def true_m(s: np.ndarray, q: np.ndarray) -> np.ndarray:
        return -2.0 * (widths(s)[0] / 20.0) ** -1.5 * (1 - q**2)

    s, q = np.repeat(np.arange(0.0, 900.0, 100.0), 20), np.tile(np.linspace(-0.98, 0.98, 20), 9)
    data = Observations(
        s_m=s,
        n_m=q * widths(s)[0],
        height_m=true_m(s, q) + 0.05 * rng.standard_normal(len(s)),
        sigma_white_m=np.full(len(s), 0.05),
        sigma_slow_m=np.zeros(len(s)),
        t_s=np.full(len(s), np.nan),
        line=(s // 100).astype(int),
    )
    chosen = choose_model(data, widths, Bathymetry(model="exponential"), slow_time_s=0.0, seed=1)
    assert chosen.drift.kind == "section_width"
    assert chosen.compared["section_width, exponential"] < chosen.compared["section, exponential"] - 0.2
    deep = dict(zip(range(6), chosen.drift.coefficients, strict=True))
    assert deep[4] + deep[5] < -1.0  # metres in the middle of the river for a narrowness of one
    between = np.column_stack([s + 50.0, q * widths(s + 50.0)[0]])[s < 800]
    height, sigma = chosen.predict(data, between, neighbours=48)
    error = height - true_m(between[:, 0], q[s < 800])
    beside = [chosen.predict(data, between + step, neighbours=48)[0] for step in ([0.5, 0.0], [0.0, 0.5])]
    slope = np.hypot(*(np.array(beside) - height)) / 0.5
    with_slope = chosen.predict_slope(data, between, neighbours=48, step_m=0.5)
    np.testing.assert_allclose(with_slope, (height, sigma, slope), rtol=1e-9)
    plain = choose_model(
        data, widths, Bathymetry(model="exponential", drift="section"), slow_time_s=0.0, seed=1
    )
    other = plain.predict(data, between, neighbours=48)[0] - true_m(between[:, 0], q[s < 800])
    assert np.sqrt(np.mean(error**2)) < 0.7 * np.sqrt(np.mean(other**2))


def test_margins_that_are_rougher_than_the_channel_get_their_own_sigma():
    """Relief 2.5 times as large near the banks: normalised squares with one relief for all, and with two."""
    squares: dict[str, list[float]] = {"one": [], "two": [], "channel": []}
    found = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        data, widths = field(20, rng)
        hidden = np.column_stack([rng.uniform(0, 228, 400), rng.uniform(-11, 11, 400)])
        places = np.vstack([data.places_m, hidden])
        share = Across.of(data, widths).margin(places)
        h = np.hypot(*((places[:, None, k] - places[None, :, k]) / r for k, r in ((0, 60.0), (1, 8.0))))
        root = np.linalg.cholesky(0.01 * np.exp(-3 * h) + 1e-9 * np.eye(len(h)))
        z = (1 + 1.5 * share) * (root @ rng.standard_normal(len(h)))
        data = data.lifted(z[: len(data)] + 0.02 * rng.standard_normal(len(data)))
        # one relief for all errs so much that one river shows it
        for name, kw in (("two", {}), ("one", {"margin_roughness": 1.0}))[: 2 if seed == 0 else 1]:
            settings = Bathymetry(drift="none", model="exponential", **kw)
            model = choose_model(data, widths, settings, slow_time_s=0.0, seed=seed)
            height, sigma = model.predict(data, hidden, neighbours=48)
            square = ((height - z[len(data) :]) / sigma) ** 2
            squares[name].append(float(np.mean(square[share[len(data) :] > 0.9])))
            if name == "two":
                found.append(model.margin)
                squares["channel"].append(float(np.mean(square[share[len(data) :] < 0.1])))
    assert np.mean(found) == pytest.approx(2.5, rel=0.25)
    assert np.mean(squares["two"]) == pytest.approx(1.0, abs=0.25)
    assert np.mean(squares["channel"]) == pytest.approx(1.0, abs=0.25)
    assert np.mean(squares["one"]) > 1.4


def test_a_single_line_is_refused():
    data, widths = field(1, np.random.default_rng(0))
    with pytest.raises(GeometryError, match="1 line of soundings") as told:
        choose_model(data, widths, Bathymetry(), slow_time_s=0.0, seed=0)
    check_whole(told.value)


def test_a_mean_section_needs_data_across_the_width():
    data, widths = field(4, np.random.default_rng(0))
    deep = data.lifted(data.height_m + 3 * (data.n_m / 12) ** 2)
    chosen = choose_model(deep, widths, Bathymetry(model="exponential"), slow_time_s=0.0, seed=0)
    assert "section, exponential" in chosen.compared
    narrow = deep.where(np.abs(deep.n_m) < 5)
    chosen = choose_model(narrow, widths, Bathymetry(model="exponential"), slow_time_s=0.0, seed=0)
    assert "section, exponential" not in chosen.compared


def test_model_written_and_read_is_the_same():
    import json

    data, widths = field(4, np.random.default_rng(0))
    model = BedModel(
        drift=Drift.fitted("section", data, Across.of(data, widths)),
        covariance=CovarianceModel(kind="matern32", sill_m2=0.1, range_s_m=30.0, range_n_m=5.0),
        margin=1.5,
        compared={"a": 1.0},
        reason="",
    ).fitted_to(data)
    assert len(model.drift.cov) == len(model.drift.coefficients) == 4
    again = BedModel.of_report(json.loads(json.dumps(model.report())))
    for name in ("drift", "covariance", "margin", "compared"):
        assert getattr(again, name) == getattr(model, name)


def test_a_light_sheet_that_contradicts_the_soundings_is_left_out(survey, monkeypatch):
    """Points of the same bed stay; those of ground 30 cm above it go: the bed is as without them."""
    monkeypatch.setattr("thalweg.bathymetry.variogram._STEPS", 12)
    line, banks, level, table = survey
    s, n = np.repeat(np.arange(40.0, 60.0, 0.5), 5), np.tile(np.linspace(-1.0, 1.0, 5), 40)
    xy = line.to_map(s, n)

    def kriged(strip: pd.DataFrame | None):
        return krige_bed(
            table,
            banks.line,
            banks,
            level,
            strip,
            frame=FRAME,
            crs=UTM,
            echo=EchoSounder(),
            settings=Bathymetry(cell_m=2.0, model="matern32", drift="none"),
            slow_time_s=10.0,
            seed=1,
        )

    def strip(lift_m: float) -> pd.DataFrame:
        return pd.DataFrame(
            {
                "t_gps_s": 1000.0 + s,
                "east_m": xy[:, 0],
                "north_m": xy[:, 1],
                "up_m": lift_m - depth_m(s, n),
                "sigma_line_m": 0.002,
                "cov_uu_m2": 0.01**2,
            }
        )

    without, right, wrong = kriged(None), kriged(strip(0.0)), kriged(strip(0.3))
    assert right.facts["light sheet left out"] == 0
    assert abs(right.facts["light sheet above the soundings_m"]) < 0.03
    assert (right.data["source"] == "light sheet").sum() == right.facts["light sheet"]
    assert wrong.facts["light sheet left out"] == wrong.facts["light sheet"] > 100
    assert wrong.facts["light sheet above the soundings_m"] == pytest.approx(0.3, abs=0.03)
    np.testing.assert_array_equal(wrong.up_m, without.up_m)
    assert not np.array_equal(right.up_m, without.up_m, equal_nan=True)


def test_lengths_over_which_errors_are_alike_give_the_sigma_of_a_mean():
    """Mean error over the river, and over cross-sections, of 60 fields: normalised squares."""
    true = CovarianceModel(kind="exponential", sill_m2=0.09, range_s_m=60.0, range_n_m=8.0)
    model = BedModel(drift=Drift(kind="none"), covariance=true, compared={}, reason="")
    line = np.repeat(np.arange(6), 25)
    known = np.column_stack([20.0 * line, np.tile(np.linspace(-11, 11, 25), 6)])
    cells = np.stack(np.meshgrid(np.arange(2.0, 100.0, 4.0), np.linspace(-11, 11, 15)), -1).reshape(-1, 2)
    places = np.vstack([known, cells])
    h = np.hypot(
        (places[:, None, 0] - places[None, :, 0]) / 60, (places[:, None, 1] - places[None, :, 1]) / 8
    )
    root = np.linalg.cholesky(0.09 * np.exp(-3 * h) + 1e-9 * np.eye(len(h)))
    rng, squares, of_sections = np.random.default_rng(12), [], []
    for _ in range(60):
        z = root @ rng.standard_normal(len(places))
        data = Observations(
            s_m=known[:, 0],
            n_m=known[:, 1],
            height_m=z[:150] + 0.02 * rng.standard_normal(150),
            sigma_white_m=np.full(150, 0.02),
            sigma_slow_m=np.zeros(150),
            t_s=np.full(150, np.nan),
            line=line,
        )
        height, sigma = model.predict(data, cells, neighbours=48)
        if not squares:
            lengths = error_lengths(model, data, cells)
            apart = np.linalg.norm(cells[:, None] - cells[None], axis=-1)
            alike = [np.exp(-apart / lengths[name]) for name in ("area", "section")]
        error = height - z[150:]
        squares.append(error.sum() ** 2 / (sigma @ alike[0] @ sigma))
        for s in (10.0, 50.0, 90.0):
            of = cells[:, 0] == s
            cross = sigma[of] @ alike[1][np.ix_(of, of)] @ sigma[of]
            of_sections.append(error[of].sum() ** 2 / cross)
    assert 0.2 < lengths["section"] < lengths["area"] < 20.0
    assert np.mean(squares) == pytest.approx(1.0, abs=0.4)  # 60 values
    assert np.mean(of_sections) == pytest.approx(1.0, abs=0.3)


def test_soundings_outside_the_banks_are_counted_and_most_of_them_refused(survey):
    line, banks, level, table = survey
    # a bank line that was drawn too near cuts off the outermost soundings
    near = replace(banks, table=banks.table.assign(n_m=banks.table["n_m"] * 0.7))
    _, counts = bed_observations(table, line, near, level, None, bank_as_data=True)
    s, n, _ = line.to_flow(table[["east_m", "north_m"]].to_numpy())
    beyond = near.outside(s, n)
    assert 0 < counts["outside the banks"] == beyond.sum() < 0.4 * len(table)
    wrong = replace(banks, table=banks.table.assign(n_m=banks.table["n_m"] * 0.1))
    with pytest.raises(InputError, match="soundings lie outside the banks") as told:
        bed_observations(table, line, wrong, level, None, bank_as_data=True)
    check_whole(told.value)


# ---------------------------------------------------------------- soundings and beds of others


def table_of_others(path, line: FlowLine, *, depth: bool, lift_m: float = 0.0):
    """Four lines across the river where the boat was not, as somebody else would hand them over."""
    s, n = np.repeat([40.0, 70.0, 100.0, 130.0], 15), np.tile(np.linspace(-11, 11, 15), 4)
    xy = line.to_map(s, n)
    at = FRAME.to_map(np.column_stack([xy, -depth_m(s, n)]), UTM)
    value = depth_m(s, n) if depth else at[:, 2] + lift_m
    table = pd.DataFrame({"x": at[:, 0], "y": at[:, 1], "z": value, "sigma": 0.02, "line": s})
    table.to_csv(path, index=False, float_format="%.4f")
    return path


@pytest.mark.parametrize("depth", [False, True])
def test_soundings_of_others_are_data_of_the_bed(survey, tmp_path, depth):
    line, banks, level, own = survey
    settings = Bathymetry(table={"column": "z", "depth": depth, "line_column": "line"})
    path = table_of_others(tmp_path / "others.csv", line, depth=depth)
    others = read_other_soundings([path, path], FRAME, UTM, settings)
    table, counts = bed_observations(own, banks.line, banks, level, None, bank_as_data=True, others=others)
    of = table[table["source"] == "table"]
    assert counts["soundings of others"] == len(of) == 120
    s, n, _ = line.to_flow(of[["east_m", "north_m"]].to_numpy())
    # depths count from a water level that is known to some millimetres
    assert np.abs(of["up_m"].to_numpy() + depth_m(s, n)).max() < 0.03
    assert others["line"].tolist() == np.repeat(np.arange(8), 15).tolist()
    assert (others["sigma_white_m"] == 0.02).all()
    assert (others["sigma_common_m"] == settings.table.sigma_common_m).all()
    assert others["up_m" if depth else "depth_m"].isna().all()
    if depth:
        assert others["depth_m"].to_numpy() == pytest.approx(np.tile(depth_m(s[:60], n[:60]), 2), abs=1e-3)
    assert of["line"].nunique() == 8
    assert of["line"].min() > own["line"].max()
    assert (of["sigma_common_m"] >= settings.table.sigma_common_m).all()


def test_heights_of_another_datum_are_refused(survey, tmp_path):
    path = table_of_others(tmp_path / "others.csv", survey[0], depth=False, lift_m=-45.0)
    with pytest.raises(InputError, match="ellipsoidal heights") as told:
        read_other_soundings([path], FRAME, UTM, Bathymetry())
    check_whole(told.value)


def test_a_reference_bed_tells_how_far_off_the_bed_is(survey, bed, tmp_path):
    write_raster(tmp_path / "bed.tif", bed.grid, bed.bands(FRAME), tags={})
    at = FRAME.from_map(
        np.column_stack([bed.grid.centres_m(), np.full(bed.grid.rows * bed.grid.columns, 300.0)]), UTM
    )
    s, n, _ = survey[0].to_flow(at[:, :2])
    true = FRAME.to_map(np.column_stack([at[:, :2], -depth_m(s, n)]), UTM)[:, 2]
    write_raster(tmp_path / "multibeam.tif", bed.grid, {"height": true}, tags={})
    write_raster(tmp_path / "high.tif", bed.grid, {"height": true + 0.5}, tags={})
    paths = [
        tmp_path / "multibeam.tif",
        tmp_path / "high.tif",
        table_of_others(tmp_path / "p.csv", survey[0], depth=False),
    ]
    found = against_reference(tmp_path / "bed.tif", paths, UTM, Bathymetry())
    assert found["multibeam.tif"]["n"] == np.isfinite(bed.up_m).sum()
    assert found["multibeam.tif"]["rmse_m"] == pytest.approx(
        np.sqrt(np.mean(errors(bed, survey[0])[0] ** 2)), abs=2e-3
    )
    assert found["multibeam.tif"]["normalised_square"] < 1.6
    assert found["high.tif"]["bias_m"] == pytest.approx(found["multibeam.tif"]["bias_m"] - 0.5, abs=1e-3)
    assert found["high.tif"]["normalised_square"] > 10
    assert found["p.csv"]["n"] > 40
    assert found["p.csv"]["rmse_m"] < 0.15
    far = table_of_others(tmp_path / "far.csv", survey[0], depth=False)
    table = pd.read_csv(far)
    table.assign(x=table["x"] + 5000).to_csv(far, index=False)
    with pytest.raises(InputError, match="none of 60 heights") as told:
        against_reference(tmp_path / "bed.tif", [far], UTM, Bathymetry())
    check_whole(told.value)
