"""The report of survey: its sections by what there is, its words as they are, the same bytes again."""

import json
import re
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest
import typst
from PIL import Image

from tests.figures.conftest import make_trajectory
from thalweg.bathymetry import REASONS, s44_orders
from thalweg.figures.survey_report import write_survey_report

HOSTILE = 'Mulde #1 *x* $y^2$ "q" <tag> @ref ~ _a_ [b] // \\u{41}'
SETTINGS = {
    "campaign": {"crs": "EPSG:25833"},
    "orientation": {"position_source": "ppk"},
    "echo_sounder": {"beam_deg": 5.0, "sigma_depth_m": 0.02, "dead_zone_m": 0.2},
    "filters": {"water_line_ics_m": 0.2},
    "epochs": ["spring", "autumn"],
    "sensors": ["echo_sounder"],
}
STREAM = {
    "stream": "depth", "model": "", "format": "NMEA 0183", "rate_hz": 10.0, "duration_s": 40.0, "n_gaps": 0,
    "lost_records": 3, "lost_bytes": 7,
}  # fmt: skip
SURVEY = (
    "Summary", "Area and dates", "Instruments and records", "Offsets and calibration",
    "Geodesy and vertical reference", "Processing", "Uncertainty", "Order of the soundings (IHO S-44)",
    "Coverage",
)  # fmt: skip


@pytest.fixture
def written(tmp_path, monkeypatch):
    """A function that writes a report of these tables, and gives the file and what Typst got."""
    got = []
    compiled = typst.compile

    def compile_and_keep(*args, **kwargs):
        got.append(json.loads(kwargs["sys_inputs"]["report"]))
        return compiled(*args, **kwargs)

    monkeypatch.setattr(typst, "compile", compile_and_keep)
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    folder = tmp_path / "results" / "mulde"

    def write(tables, *, name="report.pdf", title=HOSTILE, boat=True, twin=False):
        paths = []
        for file, content in tables.items():
            path = folder / file
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, pd.DataFrame):
                content.to_csv(path, index=False)
            else:
                path.write_text(json.dumps(content))
            paths.append(path)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "figures").mkdir(exist_ok=True)
        Image.new("RGB", (400, 300), "white").save(folder / "figures/survey_map.png")
        make_trajectory().write(folder / "trajectory.parquet")
        product = folder / "bed.tif"
        product.write_bytes(b"bed")
        write_survey_report(
            tables=paths,
            trajectory=[folder / "trajectory.parquet"] if boat else [],
            pictures=[folder / "figures/survey_map.png"],
            products=[product],
            words={product.as_posix(): "the #bed"},
            captions={"survey_map": "The survey. Compare Figure 3 of somebody et al. 2018."},
            settings=SETTINGS,
            title=title,
            twin=twin,
            report=folder / name,
        )
        return folder / name, got[-1]

    return write


def of_soundings(*, square=1.0, lines=40, light_sheet=0, sigma=0.03):
    """Tables of a survey with an echo sounder, its 100 soundings 2 m deep."""
    n = 100
    used = pd.DataFrame({"used": np.full(n, True), "depth_m": 2.0, "sigma_horizontal_m": 0.05})
    used[["sigma_white_m", "sigma_slow_m", "sigma_common_m"]] = sigma, 0.0, 0.0
    facts = {
        "by_reason": dict.fromkeys(REASONS, 0) | {"": n, "weeds": 5}, "pings": n + 5, "lines": lines,
        "sound_factor": 1.0, "sigma_sound_factor": 0.001, "water_temperature_c": None, "place_from": "ruler",
        "lag_s": 0.1, "crossings": {"n": 0}, "orders": s44_orders(used).to_dict("records"),
    }  # fmt: skip
    validation = {
        "rmse_m": 0.05, "bias_m": 0.01, "normalised_square": square, "outside_95": 0.05, "lines": lines,
        "n": n,
    }  # fmt: skip
    bed = {"area_m2": 900.0, "median sigma_m": 0.04, "light sheet left out": light_sheet}
    bed["light sheet above the soundings_m"] = 1.2
    lever = {"lever_ics_m": [0.2, 0.0, -1.5], "sigma_lever_m": [0.005, 0.005, 0.01], "source": "campaign"}
    return {
        "timing/streams.csv": pd.DataFrame([STREAM]),
        "calibration/mounts.json": {"mounts": {"lidar": {}, "echo_sounder": lever}},
        "bathymetry/soundings.json": facts,
        "bathymetry/soundings.csv": pd.DataFrame(
            {
                "depth": np.full(n, 2.0),
                "sigma": 0.03,
                "sigma_horizontal": 0.05,
                "tvu_95": 0.06,
                "thu_95": 0.12,
            }
        ),
        "bathymetry/validation.json": validation,
        "bathymetry/variogram.json": {"facts": bed},
    }


def section(document, title):
    """Parts of a section."""
    return next(each["parts"] for each in document["sections"] if each["title"] == title)


def words(document, title):
    """All text of a section."""
    return json.dumps(section(document, title), ensure_ascii=False)


def test_a_survey_has_the_sections_of_a_report_in_their_order(written):
    report, document = written(of_soundings(), twin=True)
    assert report.read_bytes().startswith(b"%PDF-1.7")
    titles = [each["title"] for each in document["sections"]]
    assert titles == [*SURVEY, "Products", "Limits"]
    [pings] = [part["rows"] for part in section(document, "Processing") if part["kind"] == "table"]
    assert pings == [["used", "100", "95.24"], [REASONS["weeds"], "5", "4.76"]]
    assert "3 records, 7 bytes" in words(document, "Instruments and records")
    assert document["mark"] == "digital twin"
    # the lidar was not on board
    [levers] = [
        part["rows"] for part in section(document, "Offsets and calibration") if part["kind"] == "table"
    ]
    assert levers == [["echo sounder", "0.2000 ± 0.0050", "0.0000 ± 0.0050", "−1.500 ± 0.010", "campaign"]]
    facts = dict(document["facts"])
    # 40 s from the example of core.timescales
    assert facts["Survey"] == "2017-05-12, 18:44:55 to 18:45:35 UTC"
    assert facts["Instruments"] == "NMEA 0183 (depth)"
    picture = section(document, "Area and dates")[-1]
    assert picture["caption"] == "The survey."
    assert picture["width_mm"] == pytest.approx(165.0)
    [files] = [part["files"] for part in section(document, "Products") if part["kind"] == "files"]
    # of the bytes `bed`, by sha256sum
    assert files[0]["sha256"] == "c5052532c2206140dfdc3b0d756cce0831ac00fd978f2bfd150858e7ee217a8c"


def test_the_order_needs_more_than_small_sigmas(written):
    """Lines of soundings search no bed; too small sigmas, or a sensor that disagrees, forbid any order."""
    ways = {
        "Order 1b, by predicted uncertainties": of_soundings(),
        "Order 2, by predicted uncertainties": of_soundings(sigma=0.4),
    }
    for order, tables in ways.items():
        assert dict(written(tables)[1]["facts"])["IHO S-44"] == order
    for tables in (of_soundings(square=9.0), of_soundings(light_sheet=7), of_soundings(sigma=2.0)):
        assert dict(written(tables)[1]["facts"])["IHO S-44"] == "no order claimed"
    few = written(of_soundings(lines=4))[1]
    assert "Too few lines test" in words(few, "Order of the soundings (IHO S-44)")
    _, document = written(of_soundings())
    assert "Too few lines test" not in words(document, "Order of the soundings (IHO S-44)")
    [table] = [
        part for part in section(document, "Order of the soundings (IHO S-44)") if part["kind"] == "table"
    ]
    # at 2 m: sqrt(0.15^2 + 0.015^2), 1 m; sqrt(0.5^2 + 0.026^2), 5.1 m
    assert [row[1:3] for row in table["rows"]][::2] == [["0.151", "1.00"], ["0.501", "5.10"]]
    assert "2.00 m" in table["caption"]


def test_a_survey_without_echo_sounder_or_lidar_says_so(written):
    _, document = written({})
    assert "No lidar recorded." in words(document, "Processing")
    assert "no soundings to classify" in words(document, "Order of the soundings (IHO S-44)")
    assert "IHO S-44" not in dict(document["facts"])
    assert "mark" in document
    assert document["mark"] == ""


def test_a_change_reports_its_volumes(written):
    volumes = {
        "what": ["erosion"],
        "volume_m3": [-12.6],
        "sigma_m3": [0.64],
        "low_m3": [-13.9],
        "high_m3": [-11.3],
    }
    patches = {"what": ["erosion"], "area_m2": [29.7], "volume_m3": [-5.0], "mean_distance_m": [-0.168]}
    tables = {
        "deformation/volumes_1-2.csv": pd.DataFrame(volumes).assign(area_m2=77.2, not_seen_m2=24.3),
        "deformation/patches_1-2.csv": pd.DataFrame(patches),
        "deformation/registration_1-2.json": {"model": "none"},
    }
    _, document = written(tables, boat=False)
    assert document["genre"] == "Report of change"
    assert dict(document["facts"])["Epochs"] == "spring, autumn"
    volume, patch = (part["rows"][0] for part in section(document, "Change"))
    assert volume[:3] == ["erosion", "−12.60 ± 0.64", "−13.90 to −11.30"]
    assert patch == ["erosion", "29.7", "−5.00", "−16.8 cm"]


def test_a_title_is_no_markup_and_the_same_results_give_the_same_bytes(written, monkeypatch):
    one, document = written(of_soundings())
    two, _ = written(of_soundings(), name="again.pdf")
    assert one.read_bytes() == two.read_bytes()
    assert b"D:20170512184535" in one.read_bytes()
    assert document["title"] == HOSTILE
    if shutil.which("pdftotext"):
        text = subprocess.run(["pdftotext", one, "-"], capture_output=True, text=True, check=True).stdout
        shown = re.sub(r"\s+", " ", text)
        assert HOSTILE in shown
        assert "the #bed" in shown
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    assert b"D:19700101" in written(of_soundings())[0].read_bytes()
