"""Soundings in the world: geometry of the beam, speed of sound, reasons, three parts of the error."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from pyproj import CRS
from scipy.spatial.transform import Rotation

from tests.conftest import check_whole
from thalweg.bathymetry import (
    Sound,
    Transducer,
    axis_range_m,
    locate_soundings,
    s44_orders,
    speed_of_sound_mps,
    with_bed_normals,
)
from thalweg.bathymetry.soundings import (
    SOUNDINGS,
    _judge_neighbours,
    _lines,
    _turning,
    _velocity,
    soundings_on_map,
)
from thalweg.core import (
    ErrorChain,
    InputError,
    LocalFrame,
    Trajectory,
    even_time,
    utc_text_from_gps,
    write_table,
)
from thalweg.figures.bathymetry.pictures import draw_sounding_lines
from thalweg.navigation.ins_gnss import PoseCorrelation
from thalweg.settings.sections import Bathymetry, EchoSounder

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
CORRELATION = PoseCorrelation(position_s=10.0, attitude_s=20.0, white_share=0.25, receiver_s=0.1)
DOWN = np.array([1.0, 0.0, 0.0, 0.0])  # quaternion about x by 180 degrees: forward east, right south, down


def straight(seconds: float = 60.0, speed_mps: float = 1.0, sigma_m: float = 0.03) -> Trajectory:
    t = np.arange(0.0, seconds + 0.02, 0.02)
    cov = np.zeros((len(t), 6, 6))
    cov[:] = np.diag([sigma_m**2] * 3 + [np.deg2rad(0.1) ** 2] * 3)
    return Trajectory(
        frame=FRAME,
        t_gps_s=t,
        position_wcs_m=np.column_stack([speed_mps * t, np.zeros_like(t), np.full_like(t, 0.2)]),
        quaternion_wcs_ics=np.tile(DOWN, (len(t), 1)),
        cov_pose_wcs=cov,
        valid=np.ones(len(t), dtype=bool),
    )


def depths(depth_m: np.ndarray, rate_hz: float = 10.0, start_s: float = 2.0) -> pd.DataFrame:
    n = len(depth_m)
    return pd.DataFrame(
        {
            "t_gps_s": start_s + np.arange(n) / rate_hz,
            "depth_m": depth_m,
            "sentence": "DPT",
            "line": np.arange(1, n + 1),
        }
    )


TRANSDUCER = Transducer(lever_ics_m=np.array([0.5, 0.0, 0.3]), cov_m2=np.diag([0.005**2] * 3))


def located(depth_m: np.ndarray, trajectory: Trajectory | None = None, **changes):
    settings = {
        "echo": EchoSounder(beam_deg=0.0),
        "transducer": TRANSDUCER,
        "settings": Bathymetry(),
    } | changes
    return locate_soundings(
        depths(depth_m), trajectory or straight(), CORRELATION, water_line_ics_m=0.2, **settings
    )


def test_slow_errors_by_camera_are_those_of_the_chain():
    """The chain forgets in 3 s at first and in 12 s later; two pings have the covariance that it says."""
    path = straight()
    keep = np.exp(-0.5 / np.where(np.arange(0.0, 60.5, 0.5) <= 30.0, 3.0, 12.0))
    chain = ErrorChain(
        name="all",
        t_gps_s=np.arange(0.0, 60.5, 0.5),
        root=np.tile(np.diag([0.03] * 3 + [0.0] * 3), (len(keep), 1, 1)),
        link=keep[:, None, None] * np.eye(6),
    )
    at, even, time_s = even_time([chain])
    correlation = PoseCorrelation(
        position_s=time_s, attitude_s=np.nan, white_share=0.0, receiver_s=0.1, even=(at, even)
    )
    found, facts = locate_soundings(
        depths(np.full(500, 2.0)),
        replace(path, cov_pose_wcs=np.tile(np.diag([0.03**2] * 3 + [0.0] * 3), (len(path.t_gps_s), 1, 1))),
        correlation,
        TRANSDUCER,
        EchoSounder(beam_deg=0.0),
        Bathymetry(),
        water_line_ics_m=0.2,
    )
    assert found["sigma_slow_m"].to_numpy() == pytest.approx(0.03, abs=1e-6)
    assert found["sigma_white_m"].to_numpy() == pytest.approx(EchoSounder().sigma_depth_m, abs=1e-6)
    assert facts["position_time_s"] == pytest.approx(time_s)
    told = found.set_index(found["t_gps_s"].round(6))["t_even_s"]
    for first, second, alike in ((6.0, 9.0, np.exp(-1)), (36.0, 48.0, np.exp(-1)), (10.0, 20.0, 0.036)):
        assert np.exp(-(told[second] - told[first]) / time_s) == pytest.approx(alike, abs=0.04)


def test_speed_of_sound_of_published_tables():
    # Marczak 1997 against Del Grosso's table of pure water; UNESCO 44's polynomial against its own table
    assert speed_of_sound_mps(20.0) == pytest.approx(1482.34, abs=0.05)
    assert speed_of_sound_mps(0.0) == pytest.approx(1402.39, abs=0.03)
    assert speed_of_sound_mps(0.0, 35.0) == pytest.approx(1449.1, abs=0.1)
    assert speed_of_sound_mps(10.0, 35.0) == pytest.approx(1489.8, abs=0.1)


@pytest.mark.parametrize("slope_deg", [0.0, 1.0, 2.5, 10.0, 33.0])
def test_first_return_over_a_plane(slope_deg):
    """The nearest place of the cone, sought among many rays, gives back the distance along the axis."""
    half, depth = np.deg2rad(2.5), 2.5
    slope = np.tan(np.deg2rad(slope_deg))
    normal = np.array([-slope, 0.0, 1.0]) / np.hypot(slope, 1.0)
    out, around = np.meshgrid(np.linspace(0, half, 200), np.linspace(0, 2 * np.pi, 721))
    rays = np.stack([np.sin(out) * np.cos(around), np.sin(out) * np.sin(around), -np.cos(out)], axis=-1)
    # bed: points with (p - (0, 0, -depth)) . normal = 0
    along = (-depth * normal[2]) / (rays @ normal)
    first = along.min()
    axis, _ = axis_range_m(np.array([first]), np.array([[0.0, 0.0, -1.0]]), normal, half)
    assert axis[0] == pytest.approx(depth, abs=1e-4)
    if slope_deg == 33.0:
        assert first - depth == pytest.approx(-0.067, abs=0.001)  # what a wide beam hides at 2.5 m


def test_place_level_and_depth():
    table, facts = located(np.full(100, 2.0))
    assert facts["pings"] == facts["by_reason"][""] == 100
    first = table.iloc[0]
    assert (first["east_m"], first["north_m"]) == pytest.approx((2.5, 0.0), abs=1e-9)
    assert first["up_m"] == pytest.approx(0.2 - 0.3 - 2.0, abs=1e-9)
    assert (first["level_m"], first["depth_m"]) == pytest.approx((0.0, 2.1), abs=1e-9)


def test_sound_speed_scales_depths_and_its_sigma_counts():
    echo = EchoSounder(
        set_sound_speed_mps=1500.0, water_temperature_c=10.0, sigma_temperature_c=2.0, sigma_sound_speed=0.0
    )
    sound = Sound.of(echo, None)
    assert 2.5 * (1 - sound.factor) == pytest.approx(0.088, abs=0.002)  # too deep by 9 cm at 2.5 m
    warm = Sound.of(echo.replace(water_temperature_c=12.0), None).factor
    assert sound.sigma == pytest.approx(warm - sound.factor, rel=0.05)
    assert Sound.of(echo.replace(water_temperature_c=None), 10.0).factor == sound.factor
    with pytest.raises(InputError, match="unknown temperature") as told:
        Sound.of(echo.replace(water_temperature_c=None), None)
    check_whole(told.value)


def test_every_reason_is_found_and_only_there():
    rng = np.random.default_rng(3)
    d = 1.5 + 0.3 * np.sin(np.arange(400) / 60) + 0.02 * rng.standard_normal(400)
    d[40] = 0.0
    d[80] = 0.15
    d[120:122] *= 2.0
    d[200] += 1.2
    d[300:308] -= [0.6, 0.3, 0.7, 0.25, 0.6, 0.3, 0.65, 0.35]
    d[350] = 120.0
    table, facts = located(d)
    reasons = table["reason"].to_numpy()
    assert reasons[40] == "no bottom"
    assert reasons[80] == "dead zone"
    assert set(reasons[120:122]) == {"second echo"}
    assert reasons[200] == "spike"
    assert set(reasons[300:308]) == {"weeds"}
    assert reasons[350] == "too deep"
    assert facts["by_reason"][""] == 400 - 1 - 1 - 2 - 1 - 8 - 1
    assert sum(facts["by_reason"].values()) == facts["pings"] == 400


@pytest.mark.parametrize("instrument_median", [False, True])
def test_weeds_are_found_where_they_are_most_of_the_echoes(instrument_median):
    """Patches of up to 4 m in which every other echo comes from a plant, on an uneven bed; and none."""
    rng = np.random.default_rng(0)
    x = 0.2 * np.arange(4000)
    bed = 1.5 + 0.5 * np.sin(x / 9) ** 2 + 0.05 * np.interp(x, x[::8], rng.standard_normal(500))
    centre = rng.uniform(10.0, x[-1] - 10.0, 60)[:, None]
    tall = 0.4 * np.clip((2.0 - np.abs(x - centre)) / 0.7, 0.0, 1.0).max(axis=0)
    plants = tall * rng.uniform(0.4, 1.0, len(x)) * (rng.uniform(size=len(x)) < 0.5)

    def judged(d, **settings) -> np.ndarray:
        """Which soundings do not count."""
        reason = np.full(len(x), "", dtype=object)
        places = np.column_stack([x, np.zeros((len(x), 2))])
        _judge_neighbours(d, places, reason, EchoSounder(sigma_depth_m=0.02), Bathymetry(**settings))
        return reason != ""

    def stated(true) -> np.ndarray:
        """What the instrument says, with its own median of three echoes or without."""
        d = true + 0.02 * rng.standard_normal(len(x))
        if instrument_median:
            d[1:-1] = np.median(np.lib.stride_tricks.sliding_window_view(d, 3), axis=1)
        return d

    assert judged(stated(bed)).mean() < 0.005
    d = stated(bed - plants)
    weeds, out = bed - d > 0.12, judged(d)
    assert weeds.sum() > 400
    # an instrument that takes a median itself hides how rough they are
    assert out[weeds].mean() > (0.75 if instrument_median else 0.9)
    assert out[~weeds].mean() < 0.025
    # turns over steep banks, once as wide as a patch, are none
    steep = 1.4 - 0.9 * np.abs(np.sin(np.pi * x / 14)) ** 3
    assert judged(stated(steep)).mean() < 0.005
    # the median alone; patches that are narrower than eleven pings are not told from relief
    assert judged(d, weeds_m=0.0)[weeds].mean() < 0.6
    assert (judged(d, weeds_m=2.1) == judged(d, weeds_m=0.0)).all()


def test_pings_without_pose_or_time_are_counted():
    table, facts = locate_soundings(
        pd.concat([depths(np.full(50, 2.0), start_s=58.0), depths(np.full(3, 2.0)).assign(t_gps_s=np.nan)]),
        straight(),
        CORRELATION,
        TRANSDUCER,
        EchoSounder(),
        Bathymetry(),
        water_line_ics_m=0.2,
    )
    assert facts["by_reason"]["no time"] == 3
    assert facts["by_reason"]["no pose"] == 50 - facts["by_reason"][""] > 20
    assert table.loc[table["reason"] == "no pose", "up_m"].isna().all()


def test_decisions_by_hand_are_obeyed(tmp_path):
    path = tmp_path / "decisions.csv"
    path.write_text("t_from_s,t_to_s,keep,remark\n3.95,4.05,false,fish\n5.95,6.05,true,a stone\n")
    d = np.full(100, 2.0)
    d[40] = 1.0  # at 6 s: a spike that somebody saw and kept
    table, facts = located(d, decisions=path)
    assert table["reason"].iloc[20] == "by hand"
    assert table["used"].iloc[40]
    assert facts["decisions_by_hand"] == 2
    path.write_text("from,to\n1,2\n")
    with pytest.raises(InputError, match="t_from_s"):
        located(d, decisions=path)


def test_nothing_left_says_why():
    with pytest.raises(InputError, match="none of 30 soundings counts; 30 of them: shallower") as told:
        located(np.full(30, 0.1))
    check_whole(told.value)


def test_lines_end_at_turns():
    t = np.arange(0.0, 120.02, 0.02)
    leg = (t // 20).astype(int)
    north = np.where(leg % 2 == 0, t % 20, 20 - t % 20)
    trajectory = replace(
        straight(120.0), position_wcs_m=np.column_stack([0.5 * t, north, np.full_like(t, 0.2)])
    )
    table, facts = located(np.full(1150, 2.0), trajectory)
    assert facts["lines"] == 6
    middle = table[(table["t_gps_s"] % 20 > 4) & (table["t_gps_s"] % 20 < 16)]
    number = middle.groupby((middle["t_gps_s"] // 20).astype(int))["line"].nunique()
    assert (number == 1).all()


def test_slopes_are_put_in_once():
    """A second correction with the same slopes changes nothing: the first is not counted twice."""
    echo = EchoSounder(beam_deg=5.0)
    table, _ = located(np.full(100, 2.5), echo=echo)
    steep = np.full(len(table), np.tan(np.deg2rad(33.0)))
    once = with_bed_normals(table, steep, np.zeros(len(table)), echo)
    assert (once["up_m"] - table["up_m"]).to_numpy() == pytest.approx(-0.0687, abs=0.001)
    assert (once["sigma_slow_m"] > table["sigma_slow_m"]).all()
    twice = with_bed_normals(once, steep, np.zeros(len(table)), echo)
    for name in ("up_m", "sigma_slow_m", "depth_m"):
        np.testing.assert_allclose(twice[name], once[name], atol=1e-12)


def test_a_ping_without_bottom_has_no_slope():
    """It has a transducer and no bed below it: nothing to divide by."""
    echo = EchoSounder(beam_deg=5.0)
    table, _ = located(np.where(np.arange(100) == 50, 0.0, 2.5), echo=echo)
    again = with_bed_normals(table, np.full(100, 0.2), np.zeros(100), echo)
    assert again["reason"][50] == "no bottom"
    assert again["up_m"][50] == again["transducer_up_m"][50]
    assert np.isfinite(again["up_m"]).all()


@pytest.mark.parametrize(
    ("order", "tvu_m", "thu_m"),
    [("exclusive", 0.3354, 1.0), ("special", 0.3905, 2.0), ("1a", 0.7214, 7.0), ("2", 1.3588, 24.0)],
)
def test_limits_of_s44_in_40_m_of_water(order, tvu_m, thu_m):
    """sqrt(a^2 + (b d)^2) and c + e d of the standard's table 1; three soundings in and out."""
    table = pd.DataFrame(
        {
            "used": [True, True, True, False],
            "depth_m": 40.0,
            "sigma_white_m": 0.0,
            "sigma_slow_m": [0.999 * tvu_m / 1.96, 1.001 * tvu_m / 1.96, 0.0, 9.0],
            "sigma_common_m": 0.0,
            "sigma_horizontal_m": [0.999 * thu_m / 2.45, 0.0, 1.001 * thu_m / 2.45, 9.0],
        }
    )
    row = s44_orders(table).set_index("order").loc[order]
    assert (row["share_tvu"], row["share_thu"], row["share"]) == pytest.approx((2 / 3, 2 / 3, 1 / 3))


def test_soundings_on_the_map_are_those_that_count():
    table, _ = located(np.append(np.full(60, 2.0), 0.0))
    found = soundings_on_map(table, FRAME, CRS.from_epsg(25833))
    assert len(found) == 60
    expected = FRAME.to_map(table[["east_m", "north_m", "up_m"]].to_numpy()[:60], CRS.from_epsg(25833))
    np.testing.assert_allclose(found[["east", "north", "height"]], expected, atol=1e-9)
    first = table.iloc[0]
    total = first["sigma_white_m"] ** 2 + first["sigma_slow_m"] ** 2 + first["sigma_common_m"] ** 2
    assert found["sigma"].iloc[0] == pytest.approx(np.sqrt(total))
    same = {
        "depth": "depth_m",
        "sigma_horizontal": "sigma_horizontal_m",
        "t_gps_s": "t_gps_s",
        "line": "line",
    }
    for ours, theirs in same.items():
        assert (found[ours].to_numpy() == table[theirs].to_numpy()[:60]).all()
    assert found["tvu_95"].iloc[0] == pytest.approx(1.96 * np.sqrt(total))
    assert found["thu_95"].iloc[0] == pytest.approx(2.45 * first["sigma_horizontal_m"])
    assert set(found["order"]) == {"exclusive"}
    rough = table.assign(sigma_white_m=np.where(np.arange(61) < 30, 0.2, 0.9))
    assert soundings_on_map(rough, FRAME, CRS.from_epsg(25833))["order"].tolist() == ["1a"] * 30 + [""] * 30


def test_a_tilt_of_the_beam_moves_it_sideways_and_an_unknown_one_counts():
    """10 degrees forward at a range of 2 m: 2 sin 10 ahead, 2 cos 10 down; 1 degree of sigma: 3.5 cm."""
    flat, tilted = (
        EchoSounder(beam_deg=0.0, tilt_deg=[pitch, 0.0], sigma_tilt_deg=0.0) for pitch in (0.0, 10.0)
    )
    tilt = np.deg2rad(10.0)
    table, _ = located(np.full(30, 2.0), echo=tilted)
    level, _ = located(np.full(30, 2.0), echo=flat)
    for name, by in (("east_m", 2 * np.sin(tilt)), ("north_m", 0.0), ("up_m", 2 * (1 - np.cos(tilt)))):
        assert table[name].iloc[5] - level[name].iloc[5] == pytest.approx(by, abs=1e-9)
    unknown, _ = located(np.full(30, 2.0), echo=flat.replace(sigma_tilt_deg=1.0))
    for name, by in (("cov_ee_m2", 4 * np.deg2rad(1.0) ** 2), ("cov_uu_m2", 0.0)):
        assert unknown[name].iloc[5] - level[name].iloc[5] == pytest.approx(by, abs=1e-9)


def test_the_width_of_the_beam_on_a_level_bed():
    table, _ = located(np.full(30, 2.0), echo=EchoSounder(beam_deg=10.0))
    assert table["footprint_m"].iloc[5] == pytest.approx(2 * 2.0 * np.tan(np.deg2rad(5.0)))


def test_a_boat_that_turns_too_fast_takes_no_soundings():
    """A turn of 30 degrees within a second at t = 30: 15 degrees a second over two seconds."""
    t = straight().t_gps_s
    heading = np.deg2rad(np.clip(30.0 * (t - 29.5), 0.0, 30.0))
    turned = (Rotation.from_euler("z", heading[:, None]) * Rotation.from_quat(DOWN)).as_quat()
    trajectory = replace(straight(), quaternion_wcs_ics=turned)
    quick, _ = located(np.full(500, 2.0), trajectory, settings=Bathymetry(max_turn_deg_per_s=14.9))
    assert set(np.round(quick.loc[quick["reason"] == "turn", "t_gps_s"], 6)) == {
        29.5 + k / 10 for k in range(11)
    }
    slow, _ = located(np.full(500, 2.0), trajectory, settings=Bathymetry(max_turn_deg_per_s=15.1))
    assert slow["used"].all()


def test_velocity_and_turns_over_two_seconds_by_hand():
    """East grows by 0.1 t2: from a to b by 0.1 (a + b) a second; the heading by 2 t2 degrees, past south."""
    t = straight().t_gps_s
    heading = np.deg2rad(170.0 + 2.0 * (t - t[0]) ** 2)
    turned = (Rotation.from_euler("z", heading[:, None]) * Rotation.from_quat(DOWN)).as_quat()
    east = 0.1 * (t - t[0]) ** 2
    trajectory = replace(
        straight(), position_wcs_m=np.column_stack([east, -3.0 * t, 0.5 * t]), quaternion_wcs_ics=turned
    )
    at = t[0] + np.array([0.0, 0.5, 4.0])
    expected = np.column_stack([[0.1, 0.15, 0.8], np.full(3, -3.0), np.full(3, 0.5)])
    assert _velocity(trajectory, at) == pytest.approx(expected, abs=1e-6)
    for limit, quick in ((1.9, [True, True, True]), (2.1, [False, True, True]), (15.9, [False, False, True])):
        assert _turning(trajectory, at, limit).tolist() == quick
    assert not _turning(trajectory, at, 16.1).any()


def lines_of(t: np.ndarray, east: np.ndarray, north: np.ndarray) -> list[int]:
    return _lines(t, np.column_stack([east, north, 0 * t]), np.ones(len(t), dtype=bool), 30.0).tolist()


def test_a_line_ends_at_a_gap_and_scraps_join_the_line_before():
    t = np.concatenate([np.arange(0.0, 20.0), np.arange(31.0, 50.0)])
    assert lines_of(t, t, 0 * t) == [0] * 20 + [1] * 19
    t = np.concatenate([np.arange(0.0, 20.0), np.arange(29.0, 50.0)])
    assert lines_of(t, t, 0 * t) == [0] * 41
    t = np.concatenate([np.arange(0.0, 20.0), np.arange(31.0, 35.0), np.arange(60.0, 80.0)])
    assert lines_of(t, t, 0 * t) == [0] * 24 + [1] * 20
    assert lines_of(np.array([3.0]), np.zeros(1), np.zeros(1)) == [0]


def test_a_bend_stays_one_line_and_a_corner_makes_two():
    """A curve of one degree a metre is followed, 45 degrees at once are not; who stands has no course."""
    t = np.arange(0.0, 120.0)
    course = np.deg2rad(t)
    bend = lines_of(t, np.cumsum(np.cos(course)), np.cumsum(np.sin(course)))
    assert set(bend) == {0}
    corner = np.deg2rad(np.where(t < 60, 170.0, 215.0))  # across 180 degrees
    found = lines_of(t, np.cumsum(np.cos(corner)), np.cumsum(np.sin(corner)))
    assert (found[10], found[110]) == (0, 1)
    assert found == sorted(found)
    small = np.deg2rad(np.where(t < 60, 170.0, 195.0))
    assert set(lines_of(t, np.cumsum(np.cos(small)), np.cumsum(np.sin(small)))) == {0}
    noise = 0.01 * np.random.default_rng(2).standard_normal((2, 120))
    assert set(lines_of(t, *noise)) == {0}


def test_each_line_is_drawn_with_what_it_lost(tmp_path):
    """Two lines with a gap; what does not count stands on the line before it."""
    d = np.full(120, 2.0)
    d[90] = 3.1
    table, _ = located(d)
    table["line"] = np.where(table["used"], (np.arange(120) >= 60).astype(int), -1)
    write_table(tmp_path / "soundings.parquet", table, SOUNDINGS)
    figure = draw_sounding_lines(soundings=tmp_path / "soundings.parquet", title="two lines", twin=True)
    drawn = [{str(a.get_label()): len(a.get_xdata()) for a in ax.get_lines()} for ax in figure.axes]
    assert drawn == [{"used": 60}, {"used": 59, "spike": 1}]
    assert figure.axes[0].get_ylim()[0] > figure.axes[0].get_ylim()[1]  # deeper is lower
    first, last = (utc_text_from_gps(t, 0)[11:19] for t in table["t_gps_s"].iloc[[60, -1]])
    assert f"{first} to {last} UTC" in figure.axes[1].get_title(loc="left")
