"""Where the base of a PPK stands and what is said of the solution, by hand; no engine runs."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from tests.ingest.writers import files_of, sbp
from thalweg.core import InputError, ecef_of, read_table, rotation_ecef_enu
from thalweg.ingest import GNSS_POSITION, IntegrityReport
from thalweg.ingest.ppk import PpkOptions
from thalweg.ingest.ppk.exports import write_solution, write_track
from thalweg.ingest.ppk.solution import EngineAnswer, PpkSolution, _base_position, _check_base, _report
from thalweg.ingest.sbp import collect

PLACE = (51.0, 13.75, 150.0)
BASE = ecef_of(*PLACE)
EAST, NORTH, UP = rotation_ecef_enu(*PLACE[:2]).T


def inputs(**more: Any) -> Any:
    """What the scans of the files would tell: one base whose header has an antenna offset."""
    scan = SimpleNamespace(
        antenna_delta_hen_m=(1.5, 0.25, 0.5), approx_ecef_m=BASE, version="3.04", text=lambda *_: "Piksi"
    )
    known = {"base": [scan], "rover": [scan], "nav": [], "sbp": {}, "losses": {}}
    times = {"rover_t_gps_s": np.arange(20.0), "base_t_gps_s": np.arange(7.0), "bytes_read": 99}
    return SimpleNamespace(**(known | times | more))


def positions(away_m: np.ndarray, fix: list[str]) -> pd.DataFrame:
    """Positions so far east, north and up of the base (n, 3), about (flat earth)."""
    lat = PLACE[0] + away_m[:, 1] / 111_250.0
    lon = PLACE[1] + away_m[:, 0] / 70_200.0
    n = len(fix)
    sigma = {f"sigma_{axis}_m": np.full(n, 0.01 * k) for k, axis in enumerate(("east", "north", "up"), 1)}
    cov = {name: np.zeros(n) for name in ("cov_en_m2", "cov_eu_m2", "cov_nu_m2")}
    more = {"n_sats": np.full(n, 12), "ratio": np.full(n, 3.5), "age_s": np.zeros(n)}
    table = {
        "t_gps_s": 1e9 + np.arange(n),
        "lat_deg": lat,
        "lon_deg": lon,
        "h_ell_m": PLACE[2] + away_m[:, 2],
    }
    frame = pd.DataFrame({**table, "fix": fix, **sigma, **cov, **more})
    for name in GNSS_POSITION.names:
        if name not in frame:
            frame[name] = np.nan
    return frame


@pytest.mark.parametrize(
    ("options", "expected", "words"),
    [
        ({"base_ecef_m": tuple(BASE)}, BASE, "offset of 0.2500, 0.5000, 1.5000 m (east, north, up)"),
        ({"base_llh": PLACE}, BASE, "used is 0.0000, 0.0000, 0.0000 m."),
        (
            {"base_llh": PLACE, "base_antenna_delta_enu_m": (1.0, 2.0, 3.0)},
            BASE + EAST + 2 * NORTH + 3 * UP, "used is 1.0000, 2.0000, 3.0000 m.",
        ),
        # the offset of the header itself needs no words
        (
            {"base_llh": PLACE, "base_antenna_delta_enu_m": (0.25, 0.5, 1.5)},
            BASE + 0.25 * EAST + 0.5 * NORTH + 1.5 * UP, None,
        ),
        # the approximate position is that of the marker: the header's offset comes on top, and what is stated
        (
            {"base_source": "rinex_header", "base_antenna_delta_enu_m": (1.0, 0.0, 0.0)},
            BASE + 1.25 * EAST + 0.5 * NORTH + 1.5 * UP, "it may be metres off",
        ),
    ],
)  # fmt: skip
def test_the_base_stands_where_it_is_stated(options, expected, words):
    found, notes = _base_position(inputs(), PpkOptions(**options), Path("base.obs"))
    assert_allclose(found, expected, atol=1e-6)
    assert len(notes) == (words is not None)
    assert words is None or words in notes[0]


def test_a_header_without_a_position_is_refused():
    options = PpkOptions(base_source="rinex_header")
    for place, words in (
        (None, "is absent"),
        (np.zeros(3), "is all zero"),
        (0.9 * BASE, "no place on the ground"),
    ):
        scan = replace_scan(approx_ecef_m=place)
        with pytest.raises(InputError, match=f"APPROX POSITION XYZ of the base .*{words}"):
            _base_position(inputs(base=[scan]), options, Path("base.obs"))


def replace_scan(**changes: Any) -> Any:
    return SimpleNamespace(**(vars(inputs().base[0]) | changes))


def test_the_base_of_sbp_logs_is_the_median_of_what_they_state(tmp_path):
    options = PpkOptions(base_source="from_sbp")
    scan = replace_scan(antenna_delta_hen_m=(0.0, 0.0, 0.0))
    rows = BASE + np.outer([0.004, 0.0, 0.0, 0.0, 0.0], EAST)
    rows[3:] = [[1000.0] * 3, [0.0] * 3]  # inside the earth, not yet set

    def found(*logs):
        rover, base = (
            collect(files_of(tmp_path, b"".join(sbp(0x0048, row.tobytes(), 0) for row in log)))
            for log in logs
        )
        sbp_logs = {"rover": rover, "base": base}
        return _base_position(inputs(base=[scan], sbp=sbp_logs), options, Path("base.sbp"))

    place, notes = found(rows[:2], rows[2:])
    assert_allclose(place, BASE, atol=1e-6)
    assert notes == []
    place, notes = found(rows, BASE[None] + 0.5 * UP)
    assert_allclose(place, BASE, atol=1e-6)
    assert notes == [
        "The base positions stated in the SBP log differ by up to 0.500 m; their median is used."
    ]
    with pytest.raises(InputError, match="no valid position of the base"):
        found(np.zeros((1, 3)), np.zeros((1, 3)))


def test_the_base_is_compared_with_its_own_single_positions():
    def check(east_m):
        away = np.column_stack([east_m, np.zeros(len(east_m)), np.zeros(len(east_m))])
        return _check_base(positions(away, ["single"] * len(east_m)), BASE, Path("base.obs"))

    distance, notes = check([24.0, 25.0, 26.0, 400.0])
    assert distance == pytest.approx(25.5, rel=0.01)
    assert notes == []
    distance, notes = check([35.0, 36.0, 37.0])
    assert distance == pytest.approx(36.0, rel=0.01)
    assert notes == ["The base position lies 36 m from the base's own single-point position: check it."]
    check([0.0, 10.0, 24.0])  # 10 m from its middle in the median
    with pytest.raises(
        InputError, match="its single-point positions lie 16 m from their middle, median"
    ) as caught:
        check([0.0, 16.0, 33.0])
    assert "exchanged" in caught.value.cure
    with pytest.raises(InputError, match=r"the base position lies 70\.2 km from where its own"):
        check([70_200.0] * 3)
    assert check([])[0] is None
    assert "could not be checked" in check([])[1][0]


def solution() -> PpkSolution:
    """Seven epochs of twenty: four fixed, one float, one single, one of another kind."""
    away = np.outer(np.arange(100.0, 800.0, 100.0), [1.0, 0.0, 0.0])
    table = positions(away, ["fixed"] * 4 + ["float", "single", "dgnss"])
    options = PpkOptions(base_llh=PLACE, direction="combined", ambiguity="instantaneous")
    answer = EngineAnswer(engine="2.5", answers=[], output="")
    report = _report(table, inputs(losses={"bytes": 3}), options, BASE, answer, ["a.obs"])
    return PpkSolution(positions=table, report=report, options=options, base_ecef_m=BASE)


def test_a_solution_says_what_it_has_and_how_far_it_reaches():
    found = solution()
    report = found.report
    assert isinstance(report, IntegrityReport)
    assert (found.fix_ratio, len(found.fixed), found.fixed.index.tolist()) == (0.2, 4, [0, 1, 2, 3])
    facts = {
        k: report.details[k]
        for k in ("n_rover_epochs", "n_fixed", "n_float", "n_single", "n_other", "n_none")
    }
    assert list(facts.values()) == [20, 4, 1, 1, 1, 13]
    assert report.details["baseline_m"] == pytest.approx(400.0, rel=1e-3)
    assert report.details["baseline_max_m"] == pytest.approx(700.0, rel=1e-3)
    assert report.details["base_ecef_m"] == BASE.tolist()
    assert report.details["engine"].endswith("(2.5)")
    assert report.losses == {"bytes": 3, "rover epochs without solution": 13}
    assert report.counts == {"rover epochs": 20, "base epochs": 7, "ephemerides": 0, "positions": 7}
    assert (report.format, report.model, report.synchronised, report.bytes_read) == (
        "RINEX 3.04",
        "Piksi",
        True,
        99,
    )
    for words in ("fixes next to nothing", "up to 1.4 times too small", "1 positions are single-point"):
        assert sum(words in note for note in report.notes) == 1
    floats = replace(found.options, direction="forward", ambiguity="continuous")
    table = positions(np.ones((2, 3)), ["float", "float"])
    report = _report(table, inputs(rover_t_gps_s=np.arange(2.0)), floats, BASE, EngineAnswer("", [], ""), [])
    assert report.notes == [
        "No position is fixed: the ambiguities stayed float; expect decimetres, not centimetres."
    ]
    assert report.losses == {}


def test_a_solution_as_files(tmp_path):
    found = solution()
    files = write_solution(found, tmp_path / "new/ppk", name="Elbe & Mulde")
    assert [file.name for file in files] == [
        "positions.csv", "positions.parquet", "positions.geojson", "positions.kml", "ppk.json",
    ]  # fmt: skip
    rows = files[0].read_text().splitlines()
    assert rows[0] == (
        "time_utc,t_gps_s,lat_deg,lon_deg,h_ell_m,fix,sigma_east_m,sigma_north_m,sigma_up_m,n_sats,ratio"
    )
    lon = round(13.75 + 200 / 70_200.0, 10)
    assert rows[2] == f"2043-05-23T03:33:03.000Z,1000000001.0,51.0,{lon},150.0,fixed,0.01,0.02,0.03,12,3.5"
    assert len(rows) == 8
    assert read_table(files[1], GNSS_POSITION)[0]["lon_deg"].tolist() == found.positions["lon_deg"].tolist()
    shape = json.loads(files[2].read_text())
    assert (shape["type"], shape["name"]) == ("FeatureCollection", "Elbe & Mulde")
    assert [f["properties"] for f in shape["features"]] == [
        {"fix": "fixed", "epochs": 4}, {"fix": "float", "epochs": 2}, {"fix": "other", "epochs": 3},
    ]  # fmt: skip
    first = shape["features"][0]["geometry"]["coordinates"][0]
    assert first == pytest.approx([13.75 + 100 / 70_200.0, 51.0, 150.0], abs=1e-9)
    kml = files[3].read_text()
    assert "<name>Elbe &amp; Mulde</name>" in kml
    assert '<Style id="fixed"><LineStyle><color>ff73a100</color><width>3</width>' in kml
    assert kml.count("<Placemark>") == 3
    assert (
        "<styleUrl>#float</styleUrl><LineString><tessellate>1</tessellate>"
        f"<coordinates>{13.75 + 400 / 70_200:.9f},51" in kml
    )
    facts = json.loads(files[4].read_text())
    assert (facts["fix_ratio"], facts["losses"]["bytes"], len(facts["notes"])) == (
        0.2,
        3,
        len(found.report.notes),
    )
    write_track(files[1], tmp_path / "t.geojson", tmp_path / "t.kml", name="Elbe & Mulde")
    assert json.loads((tmp_path / "t.geojson").read_text()) == shape
    assert (tmp_path / "t.kml").read_text() == kml
