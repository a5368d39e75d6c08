"""Levels of the water from the boat's heights, and plans of surveys, against sums written out here."""

import json
import xml.etree.ElementTree as ET

import numpy as np
import pandas as pd
import pytest
import rasterio
from pyproj import CRS, Transformer

from thalweg.bathymetry import (
    Banks,
    CovarianceModel,
    FlowLine,
    Observations,
    WaterLevel,
    krige,
    level_water,
    plan_survey,
)
from thalweg.core import CoverageError, InputError, LocalFrame, Trajectory
from thalweg.navigation.ins_gnss import PoseCorrelation

UTM = CRS("EPSG:32633")
ORIGIN = np.array([500_000.0, 5_400_000.0])

# ---------------------------------------------------------------- the level


def boat(along_m: np.ndarray, up_m: np.ndarray, sigma_m: np.ndarray, gap: slice = slice(0)) -> Trajectory:
    """An epoch a second along the first axis."""
    n = len(along_m)
    cov = np.zeros((n, 6, 6))
    cov[:, 2, 2] = sigma_m**2
    valid = np.ones(n, dtype=bool)
    valid[gap] = False
    return Trajectory(
        frame=LocalFrame(lat_deg=51.0, lon_deg=13.0, h_ell_m=0.0),
        t_gps_s=1000.0 + np.arange(n),
        position_wcs_m=np.column_stack([along_m, np.zeros(n), up_m]),
        quaternion_wcs_ics=np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)),
        cov_pose_wcs=cov,
        valid=valid,
    )


SHARE, LASTS_S, HEAVE_M, LINE_M = 0.2, 6.0, 0.02, 0.4
EVEN = (np.array([1000.0, 1040.0]), np.array([0.0, 60.0]))
"""Errors decay in half the time that passes."""
CORRELATION = PoseCorrelation(
    position_s=LASTS_S, attitude_s=20.0, white_share=SHARE, receiver_s=1.0, even=EVEN
)


def by_hand(t: np.ndarray, s: np.ndarray, up: np.ndarray, sigma: np.ndarray, columns: list[int]) -> tuple:
    """Generalised least squares of level, fall and rise; the scale of the residuals; heave."""
    jitter = 1.4826 * np.median(np.abs(up[1:] - up[:-1])[np.diff(t) == 1.0]) / np.sqrt(2)
    heave = np.sqrt(max(jitter**2 - np.median(SHARE * sigma**2), 0.002**2))
    even = np.interp(t, *EVEN)
    lasts = np.exp(-np.abs(np.subtract.outer(even, even)) / LASTS_S) * (1 - SHARE)
    cov = lasts * np.outer(sigma, sigma) + np.diag(SHARE * sigma**2 + heave**2)
    A = np.vander(s - s.mean(), 2, increasing=True)
    A = np.column_stack([A, t - t.mean()])[:, columns]
    weight = np.linalg.inv(cov)
    inverse = np.linalg.inv(A.T @ weight @ A)
    value = inverse @ A.T @ weight @ up
    rest = up - A @ value
    return value, inverse, max(rest @ weight @ rest / (len(t) - len(columns)), 1.0), heave


@pytest.mark.parametrize("noise_m", [0.03, 0.3])
def test_level_fall_and_rise_with_their_covariance(noise_m):
    """There and back, with a gap; heights that scatter more than stated enlarge the covariance."""
    rng = np.random.default_rng(5)
    k = np.arange(40.0)
    along = 3.0 * np.minimum(k, 50.0 - k) + 5.0 * np.sin(k)
    sigma = 0.01 + 0.0005 * k
    up = 2.0 - 0.02 * along + 0.015 * k + noise_m * rng.standard_normal(40)
    found = level_water(
        boat(along, up, sigma, slice(11, 14)),
        CORRELATION,
        lambda p: p[:, 0] + 100.0,
        water_line_ics_m=LINE_M,
        sigma_datum_m=0.05,
    )
    # the last epoch ends the span; none is between the tenth and a missing one
    used = np.setdiff1d(np.arange(39), [10, 11, 12, 13])
    t, s = 1000.0 + used, along[used] + 100.0
    columns = [0, *([1] if found.slope else []), *([2] if found.rise_m_per_s else [])]
    assert columns == ([0, 1, 2] if noise_m < 0.1 else columns)
    value, inverse, size, heave = by_hand(t, s, up[used] - LINE_M, sigma[used], columns)
    assert (found.s0_m, found.t0_gps_s) == pytest.approx((s.mean(), t.mean()))
    assert found.sigma_heave_m == pytest.approx(heave)
    full = np.zeros(3)
    full[columns] = value
    assert [found.level_m, found.slope, found.rise_m_per_s] == pytest.approx(full)
    cov = np.zeros((3, 3))
    cov[np.ix_(columns, columns)] = inverse * size
    cov[0, 0] += 0.05**2
    assert found.cov == pytest.approx(cov)
    # at places and times, all cross terms in the variance
    level, sigma_level = found.at(np.array([found.s0_m + 4.0]), found.t0_gps_s + 7.0)
    row = np.array([1.0, 4.0, 7.0])
    assert level[0] == pytest.approx(row @ full)
    assert sigma_level[0] == pytest.approx(np.sqrt(row @ cov @ row))
    assert found.at(np.array([found.s0_m + 4.0]))[0][0] == pytest.approx(full[0] + 4 * full[1])
    told = found.report()
    assert told["fall_m_per_km"] == pytest.approx(-1000 * full[1])
    assert told["sigma_fall_m_per_km"] == pytest.approx(1000 * np.sqrt(cov[1, 1]))
    assert told["rise_m_per_h"] == pytest.approx(3600 * full[2])
    assert told["sigma_m"] == pytest.approx(np.sqrt(cov[0, 0]))
    again = WaterLevel.of_report(json.loads(json.dumps(told)))
    assert again.report() == told


def test_what_a_survey_cannot_tell_of_the_water():
    k = np.arange(40.0)
    sigma = np.full(40, 0.01)
    flat = np.tile([0.02, -0.02], 20)
    how = {"water_line_ics_m": 0.0, "sigma_datum_m": 0.0}
    there_and_back = np.minimum(k, 39.0 - k)
    words = level_water(boat(there_and_back, flat, sigma), CORRELATION, lambda p: p[:, 0], **how).notes
    assert ["taken as none" in note for note in words] == [True, True]
    assert [note.split(":")[0] for note in words] == ["fall along the river", "rise in time"]
    once = level_water(boat(k, flat, sigma), CORRELATION, lambda p: p[:, 0], **how)
    assert once.notes[1] == "rise in time: not told, the boat went down the river only once"
    rest = level_water(boat(0 * k, flat, sigma), CORRELATION, lambda p: p[:, 0], **how)
    assert rest.notes[0] == "fall along the river: not told, the boat went down the river only once"
    assert rest.cov[1:, 1:].tolist() == [[0.0, 0.0], [0.0, 0.0]]
    # place and time that hang together by 0.94 tell both, by 0.96 not
    for mixed, told in ((0.94, False), (0.96, True)):
        wave = np.sin(2.3 * k[:-1])
        other = wave - np.polyval(np.polyfit(k[:-1], wave, 1), k[:-1])
        even = (k[:-1] - k[:-1].mean()) / k[:-1].std()
        s = np.append(mixed * even + np.sqrt(1 - mixed**2) * other / other.std(), 0.0)
        found = level_water(boat(10 * s, flat, sigma), CORRELATION, lambda p: p[:, 0], **how)
        assert ("only once" in found.notes[1]) == told
    with pytest.raises(CoverageError, match="2 seconds with a pose"):
        level_water(boat(k[:3], flat[:3], sigma[:3]), CORRELATION, lambda p: p[:, 0], **how)
    assert level_water(boat(k[:4], flat[:4], sigma[:4]), CORRELATION, lambda p: p[:, 0], **how).s0_m == 1.0


# ---------------------------------------------------------------- plans


@pytest.fixture(scope="module")
def straight():
    """100 m of a river, 10 m wide to the left of its line and 6 m to the right, known from 20 m on."""
    line = FlowLine.through(ORIGIN + np.column_stack([np.linspace(0.0, 120.0, 13), np.zeros(13)]))
    s = np.arange(20.0, 121.0, 2.0)
    sides = [
        pd.DataFrame({"side": side, "s_m": s, "n_m": n, "east_m": ORIGIN[0] + s, "north_m": ORIGIN[1] + n})
        for side, n in (("left", 10.0), ("right", -6.0))
    ]
    return Banks(table=pd.concat(sides, ignore_index=True), line=line)


MODEL = CovarianceModel(kind="exponential", sill_m2=0.3, range_s_m=20.0, range_n_m=6.0)


def test_a_plan_of_given_legs_in_all_its_files(straight, tmp_path, monkeypatch):
    monkeypatch.setattr("thalweg.bathymetry.plan._CELLS", 900)
    plan = plan_survey(
        straight, UTM, MODEL, pattern="zigzag", sigma_m=9.0, leg_m=20.0, margin_m=2.0, sigma_sounding_m=0.1
    )
    east, north = (plan.waypoints_m - ORIGIN).T
    assert east == pytest.approx(20.0 + 20.0 * np.arange(6), abs=0.06)
    assert north == pytest.approx([8.0, -4.0] * 3)
    assert plan.length_m == pytest.approx(5 * np.hypot(20.0, 12.0), abs=0.1)
    assert (plan.pattern, plan.leg_m) == ("zigzag", 20.0)
    # 1,600 m2 in 900 cells: 1.33 m, in whole tenths of its size 2 m
    assert plan.grid.cell_m == 2.0
    known = np.isfinite(plan.sigma_m)
    x, y = (plan.grid.centres_m() - ORIGIN).T
    assert known.tolist() == ((x >= 20) & (x <= 120) & (y > -6) & (y < 10)).tolist()
    assert plan.sigma_95_m == np.quantile(plan.sigma_m[known], 0.95)
    # soundings a metre apart along the way, a twentieth of a leg
    way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(east), np.diff(north)))])
    at = np.arange(0.0, way[-1], 1.0)
    nothing = np.zeros(len(at))
    soundings = Observations(
        s_m=np.interp(at, way, east),
        n_m=np.interp(at, way, north),
        height_m=nothing,
        sigma_white_m=nothing + 0.1,
        sigma_slow_m=nothing,
        t_s=nothing * np.nan,
        line=nothing.astype(int),
    )
    expected = krige(soundings, np.column_stack([x, y])[known], MODEL)[1]
    assert plan.sigma_m[known] == pytest.approx(expected, rel=1e-6)
    plan.write(tmp_path / "p", {"leg_m": 20.0})
    lon, lat = Transformer.from_crs(32633, 4326, always_xy=True).transform(*plan.waypoints_m.T)
    features = json.loads((tmp_path / "p/waypoints.geojson").read_text())["features"]
    assert features[0]["properties"] == {"pattern": "zigzag", "length_m": round(plan.length_m, 1)}
    assert np.array(features[0]["geometry"]["coordinates"]) == pytest.approx(
        np.column_stack([lon, lat]), abs=1e-8
    )
    assert [f["properties"]["number"] for f in features[1:]] == [1, 2, 3, 4, 5, 6]
    assert features[3]["geometry"]["coordinates"] == features[0]["geometry"]["coordinates"][2]
    space = {"g": "http://www.topografix.com/GPX/1/1"}
    route = ET.parse(tmp_path / "p/waypoints.gpx").getroot().find("g:rte", space)
    assert route.find("g:name", space).text == "zigzag, 20.0 m"
    points = route.findall("g:rtept", space)
    assert [p.find("g:name", space).text for p in points] == list("123456")
    assert float(points[1].get("lat")) == pytest.approx(lat[1], abs=1e-8)
    assert float(points[1].get("lon")) == pytest.approx(lon[1], abs=1e-8)
    with rasterio.open(tmp_path / "p/sigma.tif") as file:
        assert file.descriptions == ("sigma_m",)
        assert file.read(1).ravel() == pytest.approx(plan.sigma_m, abs=1e-6, nan_ok=True)
    assert json.loads((tmp_path / "p/plan.json").read_text()) == {"leg_m": 20.0}


def test_the_widest_legs_that_reach_a_sigma(straight, monkeypatch):
    """A few percent wider ones miss it; along the river legs are at most as far apart as it is wide."""
    monkeypatch.setattr("thalweg.bathymetry.plan._CELLS", 400)
    how = {"margin_m": 0.5, "sigma_sounding_m": 0.05}
    plan = plan_survey(straight, UTM, MODEL, pattern="sections", sigma_m=0.4, **how)
    assert plan.sigma_95_m <= 0.4
    assert 3.0 < plan.leg_m < 40.0
    wider = plan_survey(straight, UTM, MODEL, pattern="sections", sigma_m=0.4, leg_m=1.35 * plan.leg_m, **how)
    assert wider.sigma_95_m > 0.4
    with pytest.raises(
        InputError, match=r"along with legs of 0\.5 m leaves 95 % of the bed known to 0\.\d+ m"
    ):
        plan_survey(straight, UTM, MODEL, pattern="along", sigma_m=0.01, **how)
    loose = plan_survey(straight, UTM, MODEL, pattern="along", sigma_m=9.0, **how)
    assert 0.9 * 16 < loose.leg_m <= 16.0
    loose = plan_survey(straight, UTM, MODEL, pattern="zigzag", sigma_m=9.0, **how)
    assert 90.0 < loose.leg_m <= 100.1
    apart = Banks(
        table=straight.table[(straight.table["side"] == "left") ^ (straight.table["s_m"] > 60)],
        line=straight.line,
    )
    with pytest.raises(CoverageError, match="the banks do not lie beside each other anywhere"):
        plan_survey(apart, UTM, MODEL, pattern="zigzag", sigma_m=1.0, **how)
