"""Every page with nothing to show: each table and number absent, none, one, all the same, no number.

A function that makes a page is one that builds `thalweg.figures.Page` in a folder called ``figures``. Pages
whose examples are caught from their own tests are tried beside the figures, in `tests.figures.test_panels`.
"""

import ast
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.figures.conftest import make_trajectory, table_of
from tests.figures.panel_states import (
    STATES,
    NoSuchStateError,
    cases,
    faults_of_page,
    function_of,
    in_state,
    warned,
)
from tests.figures.test_panels import PAGES
from thalweg.core import ThalwegError
from thalweg.figures.catalogue import CATALOGUE, CONTROL, Entry
from thalweg.ingest import GNSS_POSITION, IntegrityReport
from thalweg.ingest.ppk import PpkOptions, PpkSolution
from thalweg_lab.reproduction import Results, judged, read_ledger

SOURCE = Path(__file__).parents[2] / "src"
XYZ = {"x": 1.0, "y": 2.0, "z": 3.0}
ENU = {"east": 1.0, "north": 2.0, "up": 3.0}


def _bed(_):
    crossings = {"n": 9, "rms_m": 0.1, "predicted_m": 0.1, "normalised_square": 1.0, "estimated": True}
    crossings |= {"slow_factor": 1.2, "slow_factor_sigma_log": 0.1, "time_s": 9.0, "left_out": 1}
    crossings |= {"normalised_square_after": 1.0}
    crossings["days"] = [{"day": 1, "offset_m": 0.1, "sigma_m": 0.1, "disagrees": True}]
    facts = {"by_reason": {"": 90, "spike": 10}, "pings": 100, "lines": 5, "sound_factor": 1.0}
    facts |= {"sigma_sound_factor": 0.001, "water_temperature_c": 12.0, "place_from": "tape", "lag_s": 0.1}
    facts |= {"position_time_s": 9.0, "crossings": crossings, "orders": [{"order": "1a", "share": 0.9}]}
    bed = {"cells": 50, "area_m2": 9.0, "median sigma_m": 0.1, "median sigma_common_m": 0.1}
    bed |= {"light sheet": 4, "light sheet above the soundings_m": 0.1, "light sheet left out": 0}
    bed |= {"light sheet above the soundings, sigmas": 1.0}
    measured = {"n": 9, "rmse_m": 0.1, "bias_m": 0.1, "normalised_square": 1.0, "outside_95": 0.05}
    validation = measured | {"lines": 5, "reference": {"a.tif": measured | {"classes": {"near": measured}}}}
    water = {"volume_m3": 9.0, "sigma_volume_m3": 1.0, "wet_area_m2": 9.0, "inside_m2": 9.0}
    river = {"water": water | {"without_height_m2": 1.0}, "not_written": {"mesh": "too few"}, "sections": 3}
    river |= {"mesh": {"faces": 9, "least_angle_deg": 20.0, "folded": 0}, "written": ["a.sdf"], "notes": []}
    river["depth_and_width"] = {"sections": 9, "exponent": -0.8, "sigma_exponent": 0.2}
    river["depth_and_width"]["deeper_where_narrower"] = True
    fit = {"fitted_shift_m": [0.1, 0.1, 0.1], "sigma_shift_m": [0.1, 0.1, 0.1], "undetermined": ["up"]}
    fit |= {"sigma_left_alone_m": 0.1, "cells": 9, "blocks": 2, "median_before_m": 0.1}
    fit |= {"median_after_m": 0.1, "spread_after_m": 0.1}
    level = {"level_m": 1.0, "sigma_m": 0.1, "fall_m_per_km": 1.0, "rise_m_per_h": 0.1, "notes": ["told"]}
    return {
        "facts": facts, "level": level, "validation": validation, "river": river, "fit": fit,
        "variogram": {"facts": bed, "reason": "chosen", "compared": {"none": 1.0}},
        "banks": pd.DataFrame({"side": ["left", "right"], "seen": [True, False], "sigma_across_m": 0.1}),
        "methods": pd.DataFrame([{"method": each} | measured for each in ("kriging", "mean")]),
        "pictures": [],
        "truth": pd.DataFrame({"measure": ["a", "b"], "value": [1.0, 2.0], "n": [1, 2]}), "captions": {},
        "title": "a river", "twin": True,
    }  # fmt: skip


def _catalogue(_):
    of = {"double": 1.0, "bool": True, "int64": 1}
    row = {each.name: of.get(str(each.type), "a") for each in CATALOGUE}
    control = {each.name: of.get(str(each.type), "a") for each in CONTROL}
    return {
        "entries": [Entry(row, {}, [], None, {}, {"index.html": "front page"})], "rows": pd.DataFrame([row]),
        "control": pd.DataFrame([control, control | {"campaign": "b", "outside": False}]),
    }  # fmt: skip


def _cloud(_):
    measured = {"n": 90, "bias_m": 0.1, "rmse_m": 0.1, "median_m": 0.1, "nmad_m": 0.1}
    moved = {"done": True, "all": measured, "without_outliers": measured, "f": 9.0, "cells": 9, "cell_m": 1.0}
    moved |= {"f_exceeded_in_5_percent": 3.0, "shift_m": XYZ, "rotation_deg": XYZ, "sigma_shift_m": XYZ}
    moved |= {"sigma_rotation_deg": None, "undetermined": ["z"]}
    counts = {"points": 100, "compared": 90, "outliers": 3}
    facts = {"counts": counts, "all": measured, "without_outliers": measured, "registration": moved}
    return {"facts": facts | {"notes": ["told"]}, "pictures": {}, "captions": {}, "title": "a cloud"}


def _surveyed():
    numbers = [f"{s}without_{a}_mm" for s in ("", "sigma_") for a in ENU]
    rows = {name: [1.0, 2.0] for name in (*numbers, "rms_px", "normalised")}
    names = {"point": ["1", "2"], "role": ["control", "check"], "images": [3, 4]}
    return pd.DataFrame(names | {"suspect": ["", ""], "reason": ["", ""]} | rows)


def _poses():
    numbers = {name: [1.0, 2.0] for name in ("east_m", "rms_px", "qx", "qy", "qz", "qw")}
    return pd.DataFrame({"image": ["a.jpg", "b.jpg"], "refused": ["", "no mark"], **numbers})


_CHECK = {"points": 2, "rmse_mm": ENU, "predicted_mm": ENU, "normalised": 1.0, "independent": 6}
_LENS = {"c_px": {"value": 1.0, "sigma": 0.1}}
_NAMED = {"pictures": {}, "captions": {}, "title": "photographs"}


def _finished(_):
    facts = {"check_points": _CHECK, "files": [{"program": "x"}], "sigmas_from_settings": {"a": True}}
    facts |= {"oriented": 2, "images": 2, "sigma_position_mm": ENU, "notes": ["told"]}
    return {"facts": facts, "poses": _poses(), "control": _surveyed(), **_NAMED}


def _orientation(_):
    facts = {"check_points": _CHECK, "images": 2, "sigma_position_mm": ENU, "sigma0": 1.0, "redundancy": 9}
    facts |= {"tie_points": 9, "marks_a_point": 3.0, "cameras": {"a": _LENS}, "notes": ["told"]}
    images = pd.DataFrame({"image": ["a", "b"], "reason": ["", "no"], "rms_px": [1.0, 2.0]})
    return {"facts": facts, "images": images, "control": _surveyed(), **_NAMED}


def _fixed(_):
    facts = {"normalised": 1.0, "degrees": 9, "pictures": 2, "with_pose": 1, "notes": ["told"]}
    facts |= {"spread_m": XYZ, "predicted_m": XYZ, "place_m": XYZ, "sigma_m": XYZ, "rms_px": 1.0}
    return {"facts": facts | {"lens": _LENS}, "poses": _poses(), **_NAMED}


def _front(folder):
    summary = pd.DataFrame({"quantity": ["a", "b"], "value": [1.0, 2.0], "unit": ["m", "1"]})
    (folder / "a.html").write_text("<h1>A</h1>\n<p>Words.</p>")
    summary.to_csv(folder / "summary.csv", index=False)
    return {
        "page": folder / "index.html", "title": "a", "twin": True, "crs": "EPSG:25833",
        "lacking": [("a", "b")],
        "results": [folder / "a.html", folder / "summary.csv"], "pictures": [], "figures": {"a": ("b", "c")},
    }  # fmt: skip


def _gnss(_):
    track = make_trajectory()
    lat, lon, h = track.frame.to_geodetic(track.position_wcs_m)
    sigma = {f"sigma_{a}_m": 0.02 for a in ENU}
    table = table_of(
        GNSS_POSITION, len(lat), t_gps_s=track.t_gps_s, lat_deg=lat, lon_deg=lon, h_ell_m=h,
        fix=np.where(np.arange(len(lat)) < 90, "float", "fixed"), **sigma,
    )  # fmt: skip
    report = IntegrityReport(stream="positions", format="RINEX", files=["a"], notes=["told"])
    report.details |= {"fix_ratio": 0.9, "n_rover_epochs": 400, "n_float": 90, "n_none": 0}
    report.details |= {"baseline_m": 900.0, "n_fixes_refused": {"float": 3}}
    return {"solution": _solution(table, report), "title": "a track"}


def _solution(table, report):
    options = PpkOptions(base_llh=(51.0, 13.0, 300.0))
    return PpkSolution(positions=table, report=report, options=options, base_ecef_m=np.zeros(3))


def _ledger(folder):
    entries = read_ledger(SOURCE.parent / "resources/published/light_sheet.yaml")
    rows = judged(entries, Results({}, {}, None)).groupby("verdict").head(2)
    rows.to_csv(folder / "ledger.csv", index=False)
    headlines = pd.DataFrame({"result": ["RMSE", "mean"], "printed": ["1 mm", "2"], "ours": ["1 mm", "none"]})
    return {"ledger": pd.read_csv(folder / "ledger.csv"), "headlines": headlines, "path": folder / "l.html"}


OWN = {
    "figures.accuracy.cloud:cloud_page": _cloud,
    "figures.bathymetry.page:bed_page": _bed,
    "figures.catalogue:catalogue_page": _catalogue,
    "figures.front:write_front_page": _front,
    "figures.images.fixed_camera:fixed_camera_page": _fixed,
    "figures.images.photographs:finished_page": _finished,
    "figures.images.photographs:orientation_page": _orientation,
    "figures.survey.gnss:gnss_page": _gnss,
    "thalweg_lab.figures.ledger_table:write_ledger": _ledger,
}
"""Arguments by function."""


def page_functions():
    """All that build a page, as ``module:function``; ``thalweg.`` is left out."""
    for file in sorted(SOURCE.glob("**/figures/**/*.py")):
        module = ".".join(file.relative_to(SOURCE).with_suffix("").parts).removeprefix("thalweg.")
        for function in ast.parse(file.read_text(encoding="utf-8")).body:
            calls = [each.func for each in ast.walk(function) if isinstance(each, ast.Call)]
            if isinstance(function, ast.FunctionDef) and "Page" in {
                getattr(each, "id", "") for each in calls
            }:
                yield f"{module}:{function.name}"


def test_every_function_that_makes_a_page_is_tried():
    tried = [*OWN, *(name for of in PAGES.values() for name in of)]
    assert sorted(tried) == sorted(page_functions()), "add an example of it"


def facts_in(value, state):
    """Facts of a JSON file without a number, or whose counts are zero and lists empty."""
    if isinstance(value, Mapping):
        return {key: facts_in(each, state) for key, each in value.items()}
    if isinstance(value, list):
        return [facts_in(each, state) for each in value] if state == "nan" else []
    if isinstance(value, float) and state == "nan":
        return np.nan
    return 0 if type(value) is int and state == "empty" else value


def tried(name, example):
    """Cases of tables, and of the facts beside them."""
    yield "all as it is", lambda: dict(example)
    yield "all none", lambda: {key: [] if isinstance(v, list) else v for key, v in example.items()}
    facts = [key for key, each in example.items() if isinstance(each, Mapping) and each]
    alike = ("reports", "titles", "pictures") if "reports" in example else ()  # lists of one length
    for case, make in cases(name, example):
        if case not in {f"{key} none" for key in (*facts, *alike)}:  # files have all of their fields
            yield case, make
    for key in facts:
        for state in ("empty", "nan"):
            yield f"{key} {state}", lambda k=key, s=state: {**example, k: facts_in(example[k], s)}
    if "solution" in example:
        found = example["solution"]
        for state in STATES:
            solution = _solution(in_state(found.positions, state), found.report)
            yield f"positions {state}", lambda s=solution: {**example, "solution": s}


@pytest.mark.parametrize("name", OWN)
def test_a_page_says_what_there_is_none_of(name, tmp_path, monkeypatch):
    """No table without a row and no word of no number; pictures are drawn and not written."""
    monkeypatch.setattr("thalweg.figures.page.save", lambda *_, **__: None)
    build, found = function_of(name), []
    for case, make in tried(name, OWN[name](tmp_path)):
        try:
            arguments = make()
            page, wrong = warned(lambda arguments=arguments: build(**arguments))
            html = (
                page.html() if page is not None else (arguments.get("path") or arguments["page"]).read_text()
            )
            wrong += faults_of_page(html)
        except NoSuchStateError:
            continue
        except ThalwegError as error:
            wrong = [] if len(str(error)) > 20 and case != "all as it is" else [f"no reason: {error}"]
        except Exception as error:
            wrong = [f"{type(error).__name__}: {error}"]
        found += [f"{case}: {words}" for words in wrong]
    assert not found, "\n".join(found)
