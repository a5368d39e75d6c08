"""Report of a survey, or of a change between epochs, as PDF in the order that hydrographers use.

Numbers come from the tables and JSON files of the campaign, words from here, looks from
``report.typ``. All text goes to Typst as JSON, never as markup. Source of the limits of soundings:
IHO S-44, edition 6.1, table 1.
"""

import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence
from itertools import zip_longest
from math import hypot
from os.path import relpath
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from PIL import Image
from pyproj import CRS

from thalweg import __version__
from thalweg.accuracy import verdict_of, verdict_of_ratio
from thalweg.bathymetry import REASONS, S44
from thalweg.core import Trajectory, final_path, optional, read_json, unix_from_gps, utc_text_from_gps
from thalweg.figures import TWIN_MARK, count, note_of, number, plural, sentence
from thalweg.figures.survey import centre_in_words, track_length_m
from thalweg.ingest.registry import with_sigma

typst = optional("typst")

_TYPE_AREA_MM: Final = (165.0, 150.0)
"""Width of the text, and the height that a picture may take of it."""
_COVER_MM: Final = (165.0, 105.0)
_COVERS: Final = ("cloud_overview", "bed_map", "change_map", "height_difference", "survey_map", "trajectory")
"""On the title page: the first of these that there is."""
_ORDER_NAMES: Final = {
    "exclusive": "Exclusive Order",
    "special": "Special Order",
    "1a": "Orders 1a and 1b",
    "2": "Order 2",
}
_SHARE_OF_ORDER: Final = 0.95
_PATCHES: Final = 12
"""So many patches of change stand in a table."""
_OF_TRUTH: Final = 10
"""Rows for all soundings and the whole bed, which come first."""
_DETAILS: Final = (
    "serial number", "firmware", "hardware", "product", "return_mode", "DPT offsets", "size", "fixes",
)  # fmt: skip
"""What integrity reports tell of instruments."""
_PLAIN: Final = str.maketrans("", "", '"{}')
_Row = Sequence[object]
_VERDICTS: Final = {
    "consistent": "agree with what was observed",
    "too optimistic": "are too small for what was observed",
    "too pessimistic": "are too large for what was observed",
    "too few data": "could be tested by too few independent values to tell",
}
"""What standard deviations do, by the words of `thalweg.accuracy.verdict_of`."""


class _Report:
    """Sections of the report, and the results that they are made of."""

    def __init__(
        self, folder: Path, tables: Sequence[Path], pictures: Sequence[Path], captions: Mapping[str, str]
    ):
        self.files = {Path(relpath(path, folder)).as_posix(): path for path in tables}
        self.pictures = {
            path.stem: path for path in pictures if path.suffix == ".png" and note_of(path) is None
        }
        self.captions = captions
        self.sections: list[dict[str, Any]] = []

    def json(self, name: str) -> Any:
        """A JSON file of the results, or None."""
        return read_json(self.files[name]) if name in self.files else None

    def integrity(self) -> list[Any]:
        """The reports of the readers of logs."""
        return [self.json(name) for name in sorted(self.files) if name.endswith(".integrity.json")]

    def records(self, name: str) -> list[dict[Any, Any]]:
        """Rows of a table of the results; none without the table."""
        table = self.csv(name)
        return [] if table is None else table.to_dict("records")

    def csv(self, name: str) -> pd.DataFrame | None:
        """A table of the results, or None."""
        return pd.read_csv(self.files[name]) if name in self.files else None

    def section(self, title: str) -> None:
        """Begin a section."""
        self.sections.append({"title": title, "parts": []})

    def add(self, kind: str, **part: Any) -> None:
        """A part of the section; typst shows it by its kind."""
        self.sections[-1]["parts"].append({"kind": kind, **part})

    def text(self, *sentences: str) -> None:
        """One paragraph."""
        self.add("text", text=" ".join(each for each in sentences if each))

    def table(self, columns: Sequence[str], rows: Sequence[_Row], caption: str, *, words: int = 1) -> None:
        """A table: first columns of words, the last of them as wide as there is room, then numbers."""
        if rows:
            widths = ["fill" if i == words - 1 else "auto" for i in range(len(columns))]
            self.add(
                "table", columns=list(columns), rows=[[str(cell) for cell in row] for row in rows],
                caption=caption, widths=widths, right=list(range(words, len(columns))),
            )  # fmt: skip

    def figures(self, *names: str) -> None:
        """Those pictures that there are."""
        for name in names:
            if name in self.pictures:
                self.add("figure", **self.picture(name, _TYPE_AREA_MM))

    def picture(self, name: str, most_mm: tuple[float, float]) -> dict[str, Any]:
        """Path, caption and width of a picture that fits."""
        path = self.pictures[name]
        with Image.open(path) as image:
            width, height = image.size
        # comparisons with publications are for the pages
        caption = re.sub(r"\s*Compare .*$", "", self.captions.get(name, name)).replace("`", "")
        return {
            "path": path.absolute().as_posix(), "caption": caption,
            "width_mm": min(most_mm[0], most_mm[1] * width / height),
        }  # fmt: skip


def write_survey_report(
    *,
    tables: list[Path],
    trajectory: list[Path],
    pictures: list[Path],
    products: list[Path],
    words: dict[str, str],
    captions: dict[str, str],
    settings: dict[str, Any],
    title: str,
    twin: bool,
    report: Path,
) -> None:
    """Write ``report.pdf``; a section without data says so in a sentence, or is left out.

    Its date is ``SOURCE_DATE_EPOCH``, else the end of the survey: the same results give the same bytes.

    Parameters
    ----------
    tables : JSON and CSV files of the campaign, as far as there are, below the folder of `report`.
    trajectory : that of the boat, or none.
    pictures, captions : PNG files, and by stem what stands below them.
    products, words : files to hand over, and in their order by name what they are.
    settings : sections ``campaign``, ``orientation``, ``echo_sounder``, ``filters`` as plain values,
        names of the ``sensors`` on board and of ``epochs``.
    title : of the campaign.
    twin : whether a digital twin wrote the logs.
    report : file to write.
    """
    folder = final_path(report).parent
    page = _Report(folder, tables, pictures, captions)
    crs = CRS.from_user_input(settings["campaign"]["crs"])
    path = Trajectory.read(trajectory[0]) if trajectory else None
    facts, end_s = _survey(page, path, crs, settings) if path is not None else _change(page, crs, settings)
    _products(page, folder, dict(zip(products, words.values(), strict=True)))
    _limits(page, twin=twin)
    cover = next((name for name in _COVERS if name in page.pictures), None)
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    document = {
        "genre": f"Report of {'survey' if path is not None else 'change'}", "title": title, "facts": facts,
        "lead": "Simulated instruments on a simulated river wrote these logs (digital twin)." if twin else "",
        "mark": TWIN_MARK if twin else "", "made_by": f"Thalweg {__version__}",
        "dated": path is not None or epoch is not None, "sections": page.sections,
        "cover": None if cover is None else page.picture(cover, _COVER_MM),
    }  # fmt: skip
    made = int(epoch) if epoch else int(end_s)
    # fonts of the system would make the pages of each machine different ones
    typst.compile(
        Path(__file__).with_suffix(".typ"), output=report, format="pdf", root=Path("/"), timestamp=made,
        ignore_system_fonts=True, sys_inputs={"report": json.dumps(document)},
    )  # fmt: skip


# ---------------------------------------------------------------- survey


def _survey(
    page: _Report, path: Trajectory, crs: CRS, settings: Mapping[str, Any]
) -> tuple[list[tuple[str, str]], float]:
    """All sections of a survey; facts of the title page, and its end in Unix seconds."""
    times = path.t_gps_s[path.valid]
    length_m = track_length_m(path)
    first, last = (utc_text_from_gps(float(t), 0) for t in times[[0, -1]])
    day, end = first[:10], (last[11:19] if last[:10] == first[:10] else f"{last[:10]} {last[11:19]}")
    when = f"{day}, {first[11:19]} to {end} UTC"
    found = _streams(page.records("timing/streams.csv"))
    order = _order(page)
    facts = [
        ("Survey", when),
        ("Place", centre_in_words(path)),
        ("Track", f"{count(length_m)} m in {(times[-1] - times[0]) / 60:.1f} min"),
        ("Instruments", ", ".join(dict.fromkeys(f"{row[1]} ({row[0]})" for row in found))),
        ("Map grid", f"{crs.name} ({settings['campaign']['crs']})"),
        ("Heights", _heights(page)),
        *([("IHO S-44", order[0])] if order else []),
    ]
    _summary(page, path, order)
    _area(page, path, crs, when, length_m)
    _instruments(page, found)
    _offsets(page, settings)
    _geodesy(page, path, crs, settings)
    _processing(page, path)
    _uncertainty(page, path)
    _orders(page, order)
    _coverage(page)
    _results(page)
    return facts, float(unix_from_gps(times[-1]))


def _streams(streams: list[dict[Any, Any]]) -> list[list[str]]:
    """Name, instrument or format, rate, duration, gaps and losses of each stream."""
    rows = []
    for row in streams:
        model = row["model"] if isinstance(row["model"], str) and row["model"] else row["format"]
        lost = f"{count(row['lost_records'])} records, {count(row['lost_bytes'])} bytes"
        lost = lost if row["lost_records"] or row["lost_bytes"] else "none"
        rates = (_n(row["rate_hz"], 1), _n(row["duration_s"], 1))
        rows.append([row["stream"], model, *rates, count(row["n_gaps"]), lost])
    return rows


def _heights(page: _Report) -> str:
    """The vertical reference in words."""
    model = page.json("fusion/dtm.json")
    if model is None or model["heights"] == "ellipsoidal":
        return "ellipsoidal"
    return f"ellipsoidal; of the terrain model: {model['heights']}"


def _order(page: _Report) -> tuple[str, str] | None:
    """The order of IHO S-44 that the survey can claim, and why; None without soundings."""
    facts, bed = page.json("bathymetry/soundings.json"), page.json("bathymetry/validation.json")
    if facts is None:
        return None
    met = next((row["order"] for row in facts["orders"] if row["share"] >= _SHARE_OF_ORDER), None)
    if met is None:
        return "no order claimed", "Fewer than 95 % of the soundings keep the limits of any order."
    verdict = "too few data" if bed is None else verdict_of(bed["normalised_square"], bed["lines"])
    if verdict == "too optimistic":
        return "no order claimed", (
            "Left-out lines show errors larger than the predicted standard deviations, on which an order "
            "would rest."
        )
    model = page.json("bathymetry/variogram.json")
    if model is not None and model["facts"].get("light sheet left out"):
        return "no order claimed", (
            "The light sheet contradicts the soundings by more than both standard deviations explain (see "
            "Limits): until that is explained, no order is claimed."
        )
    claimed = "2" if met == "2" else "1b"
    return f"Order {claimed}, by predicted uncertainties", (
        f"At least 95 % of the soundings keep the limits of uncertainty of {_ORDER_NAMES[met]}. An order "
        "also asks for a search of the bed: soundings along lines leave the bed between them unsearched, "
        f"so that no order stricter than 1b can be claimed. What the survey supports is Order {claimed}."
        + (" Too few lines test the predicted uncertainties." if verdict == "too few data" else "")
    )


def _summary(page: _Report, path: Trajectory, order: tuple[str, str] | None) -> None:
    """What the survey gave and how good it is, in one table."""
    page.section("Summary")
    sigma_m = np.median(path.sigma_position_m[path.valid], axis=0)
    rows = [
        ("Processing", "poses of the boat", f"{count(path.valid.sum())} of {count(len(path.valid))}"),
        ("Uncertainty", "sigma of a position, east, north, up", ", ".join(map(_length, sigma_m))),
    ]
    if (cloud := page.csv("lidar/counts.csv")) is not None:
        kept = cloud.loc[cloud["reason"] == "kept", "n"].sum()
        rows.append(("Processing", "points of the banks by the lidar", count(kept)))
    if (facts := page.json("bathymetry/soundings.json")) is not None:
        used = f"{count(facts['by_reason'][''])} of {count(facts['pings'])}"
        rows.append(("Processing", "soundings that count", used))
    if (bed := page.json("bathymetry/variogram.json")) is not None:
        rows.append(("Coverage", "area of the bed", f"{count(bed['facts']['area_m2'])} m²"))
        rows.append(
            ("Uncertainty", "sigma of a cell of the bed, median", _length(bed["facts"]["median sigma_m"]))
        )
    if (left := page.json("bathymetry/validation.json")) is not None:
        rows.append(("Uncertainty", f"bed at {left['lines']} left-out lines, RMSE", _length(left["rmse_m"])))
    if (distances := _reference(page)) is not None:
        rows.append(("Uncertainty", "cloud against a reference, RMSE", _length(distances["rmse"])))
    if order is not None:
        rows.append(("Order", "IHO S-44", order[0]))
    page.table(("section", "quantity", "value"), rows, "The survey in figures.", words=2)


def _area(page: _Report, path: Trajectory, crs: CRS, when: str, length_m: float) -> None:
    page.section("Area and dates")
    on_map = path.frame.to_map(path.position_wcs_m[path.valid], crs)
    low, high = on_map.min(axis=0), on_map.max(axis=0)
    page.text(
        f"The boat recorded {when}, over {count(length_m)} m. Its track lies between {count(low[0])} and "
        f"{count(high[0])} m east, {count(low[1])} and {count(high[1])} m north ({crs.name})."
    )
    page.figures("survey_map")


def _instruments(page: _Report, found: list[list[str]]) -> None:
    page.section("Instruments and records")
    page.table(
        ("stream", "instrument or format", "rate [1/s]", "duration [s]", "gaps", "lost"), found,
        "Streams as recorded; the trajectory rests on the stream of positions.", words=2,
    )  # fmt: skip
    details = [
        (found["stream"], key.replace("_", " "), json.dumps(found["details"][key]).translate(_PLAIN))
        for found in page.integrity()
        for key in _DETAILS
        if key in found["details"]
    ]
    page.table(
        ("stream", "detail", "as recorded"), details, "What the instruments state of themselves.", words=3
    )
    clocks = [
        (row["stream"], row["stamped_by"], _n(row["offset_s"], 4, "+"), _n(1000 * row["sigma_time_s"], 1))
        for row in page.records("timing/time_report.csv")
    ]
    columns = ("stream", "stamped by", "offset [s]", "sigma of a stamp [ms]")
    page.table(
        columns, clocks, "Clocks against GPS time; a dash: not measured against another stream.", words=2
    )
    page.figures("streams_in_time")


def _offsets(page: _Report, settings: Mapping[str, Any]) -> None:
    page.section("Offsets and calibration")
    # a file of mounts holds presumptions on sensors that the boat did not carry
    found = (page.json("calibration/mounts.json") or {"mounts": {}})["mounts"]
    mounts = {name: of for name, of in found.items() if name in settings["sensors"]}
    page.text(
        "Offsets are given in the body frame: x forward, y to starboard, z down, from the reference point "
        "of the INS, or of the boat where there is none. Angles turn a sensor's frame into it, about x, "
        "then y, then z (omega, phi, kappa)."
    )
    levers = [
        (name.replace("_", " "), *_with_sigma(of["lever_ics_m"], of["sigma_lever_m"]), of["source"])
        for name, of in mounts.items()
    ]
    page.table(("sensor", "x [m]", "y [m]", "z [m]", "from"), levers, "Lever arms with their sigmas.")
    angles = ("omega", "phi", "kappa")
    turned = []
    for name, of in mounts.items():
        if "omega_deg" in of:
            values, sigmas = ([of[f"{part}{angle}_deg"] for angle in angles] for part in ("", "sigma_"))
            turned.append((name.replace("_", " "), *_with_sigma(values, sigmas)))
    page.table(
        ("sensor", *(f"{angle} [°]" for angle in angles)), turned, "Mounting angles with their sigmas."
    )
    facts = page.json("bathymetry/soundings.json")
    if facts is None:
        return
    echo, water = settings["echo_sounder"], facts["water_temperature_c"]
    page.text(
        f"Echo sounder: beam of {echo['beam_deg']:g}°, noise of a depth {_length(echo['sigma_depth_m'])}, "
        f"dead zone {echo['dead_zone_m']:g} m. Depths are multiplied by {facts['sound_factor']:.5f} ± "
        f"{facts['sigma_sound_factor']:.5f} for the speed of sound"
        + (f" (water of {water:.1f} °C)." if water is not None else " (its temperature was not recorded)."),
        f"The position of the transducer is that of the {facts['place_from']}; its stamps are corrected by "
        f"{_n(facts['lag_s'], 3, '+')} s. The water line lies "
        f"{settings['filters']['water_line_ics_m']:.3f} m below the reference point at rest.",
    )
    calibration = page.json("calibration/echo_sounder.json")
    if calibration is not None and calibration.get("refused"):
        page.text(
            "A run over a surveyed bed could not determine all of its offsets; the rest is as measured by "
            "hand:"
        )
        page.add("list", items=calibration["refused"])


def _geodesy(page: _Report, path: Trajectory, crs: CRS, settings: Mapping[str, Any]) -> None:
    page.section("Geodesy and vertical reference")
    frame, geodetic = path.frame, crs.geodetic_crs
    source = settings["orientation"]["position_source"]
    track = page.json("orientation/trajectory.json") or {"fixes": {}}
    rows = [
        ("Map grid", f"{crs.name} ({settings['campaign']['crs']})"),
        ("Datum", geodetic.datum.name if geodetic is not None and geodetic.datum is not None else "–"),
        (
            "Origin of the local frame",
            f"{frame.lat_deg:.6f}°, {frame.lon_deg:.6f}°, {frame.h_ell_m:.3f} m (ellipsoid)",
        ),
        ("Heights", _heights(page)),
        (
            "Positions",
            f"{source}, read as {(page.json('ingest/positions.integrity.json') or {}).get('format', '–')}",
        ),
        ("Fixes", ", ".join(f"{name} {count(n)}" for name, n in track["fixes"].items()) or "not recorded"),
    ]
    page.table(("item", "value"), rows, "Reference systems.", words=2)
    level = page.json("bathymetry/water_level.json")
    if level is not None:
        up_m = np.array([[*path.position_wcs_m[path.valid][:, :2].mean(axis=0), level["level_m"]]])
        height_m = float(frame.to_map(up_m, crs)[0, 2])
        page.text(
            f"Water level during the survey: {height_m:.3f} ± {level['sigma_m']:.3f} m (ellipsoidal height "
            f"at the middle of the track), fall {_n(level['fall_m_per_km'], 2)} m/km, rise "
            f"{_n(level['rise_m_per_h'], 3)} m/h. Soundings are heights by GNSS and INS, not depths below "
            "a gauge.",
            *map(sentence, level["notes"]),
        )
    else:
        page.text("No water level was derived.")


def _processing(page: _Report, path: Trajectory) -> None:
    page.section("Processing")
    rows: list[_Row]
    made = [read_json(meta) for file in page.files.values() if (meta := Path(f"{file}.meta.json")).is_file()]
    if made:
        first = made[0]
        libraries = ", ".join(f"{name} {first['libraries'][name]}" for name in ("python", "numpy", "pyproj"))
        page.text(
            f"Processed by Thalweg {first['thalweg']}, revision "
            f"{str(first['commit'] or 'unknown')[:12]}, with "
            f"{libraries}. Each file has its parameters and the checksums of its inputs beside it "
            "(.meta.json)."
        )
        steps = sorted({(each["rule"].replace("_", " "), each["code"]) for each in made})
        half = -(-len(steps) // 2)
        rows = [one + two for one, two in zip_longest(steps[:half], steps[half:], fillvalue=("", ""))]
        caption = "Steps of the processing and the version of their code."
        page.table(("step", "code", "step", "code"), rows, caption, words=4)
    track = page.json("orientation/trajectory.json")
    if track is not None:
        used = f"{count(track['n_positions_used'])} of {count(track['n_positions'])} positions used"
        poses = f"{count(path.valid.sum())} of {count(len(path.valid))} poses valid"
        page.text(
            f"Trajectory: {used}, {poses}, {plural(len(track['gaps']), 'gap')}.",
            *map(sentence, track["notes"]),
        )
    page.figures("trajectory")
    cloud = page.records("lidar/counts.csv")
    if not cloud:
        page.text("No lidar recorded.")
    rows = [(r["words"], count(r["n"]), _n(100 * r["share"], 2)) for r in cloud if r["n"]]
    page.table(("returns of the lidar", "n", "share [%]"), rows, "What became of the returns.")
    facts = page.json("bathymetry/soundings.json")
    if facts is not None:
        by_reason, pings = facts["by_reason"].items(), max(facts["pings"], 1)
        rows = [(REASONS[name], count(n), _n(100 * n / pings, 2)) for name, n in by_reason if n]
        page.table(("pings of the echo sounder", "n", "share [%]"), rows, "What became of the pings.")
    images = page.json("orientation/adjustment.json")
    if images is not None:
        page.text(
            f"Photographs: {count(images['images'])} oriented with {count(images['tie_points'])} tie "
            f"points, sigma naught {images['sigma0']:.2f}, {count(images['control_points'])} control "
            "points."
        )


def _uncertainty(page: _Report, path: Trajectory) -> None:
    page.section("Uncertainty")
    page.text(
        "Every point, sounding and cell carries a standard deviation, propagated from positions, "
        "attitudes, offsets, clocks and ranges with their correlations. The following tests compare them "
        "with errors that were observed."
    )
    attitude = np.rad2deg(np.median(path.sigma_roll_pitch_heading_rad()[path.valid], axis=0))
    position_m = np.median(path.sigma_position_m[path.valid], axis=0)
    poses = [
        (f"position {name}", _length(v)) for name, v in zip(("east", "north", "up"), position_m, strict=True)
    ]
    poses += [(name, f"{_n(v, 3)}°") for name, v in zip(("roll", "pitch", "heading"), attitude, strict=True)]
    page.table(("pose of the boat", "sigma"), poses, "Standard deviations of the trajectory, medians.")
    soundings = page.csv("bathymetry/soundings.csv")
    if soundings is not None:
        rows = [
            (words, *(_length(v) for v in soundings[column].quantile([0.5, 0.95])))
            for column, words in (
                ("sigma", "height, standard deviation"), ("sigma_horizontal", "position, standard deviation"),
                ("tvu_95", "total vertical uncertainty, 95 %"),
                ("thu_95", "total horizontal uncertainty, 95 %"),
            )
        ]  # fmt: skip
        page.table(("sounding", "median", "95 % are below"), rows, "Predicted uncertainty of the soundings.")
        found = (page.json("bathymetry/soundings.json") or {})["crossings"]
        page.text(
            f"Lines cross at {count(found['n'])} places, where heights differ by {_length(found['rms_m'])} "
            f"(root mean square); {_length(found['predicted_m'])} were predicted."
            if found["n"]
            else "No line crosses another: slow errors were not checked by crossings."
        )
    left = page.json("bathymetry/validation.json")
    if left is not None:
        page.text(
            f"Left-out lines: each of {left['lines']} lines was predicted from the others. The differences "
            f"have an RMSE of {_length(left['rmse_m'])} and a mean of {_length(left['bias_m'], '+')}; their "
            f"squares are {left['normalised_square']:.2f} times the predicted variances, and "
            f"{100 * left['outside_95']:.1f} % lie outside their interval of 95 %. The predicted standard "
            f"deviations of the bed {_VERDICTS[verdict_of(left['normalised_square'], left['lines'])]}."
        )
        rows = [
            (name, count(of["n"]), _length(of["rmse_m"]), f"{of['normalised_square']:.2f}")
            for name, of in left.get("classes", {}).items()
        ]
        page.table(("class", "n", "RMSE", "square / variance"), rows, "Left-out lines by class.")
        page.figures("bed_left_out")
    distances = _reference(page)
    if distances is None:
        page.text("No independent reference was compared.")
    else:
        verdict = verdict_of_ratio(*(distances[name] for name in ("ratio", "ratio_low95", "ratio_high95")))
        page.text(
            f"Against a reference, {count(distances['n'])} points without outliers "
            f"({count(distances['outliers'])} outliers): mean distance {_length(distances['bias'], '+')}, "
            f"RMSE {_length(distances['rmse'])}, predicted {_length(distances['predicted_rmse'])}. "
            f"The predicted standard deviations {_VERDICTS[verdict]}."
        )
        page.figures("distance_map")
    truth = page.records("accuracy/truth_riverbed.csv")[:_OF_TRUTH]
    rows = [(r["measure"], number(r["value"]), count(r["n"])) for r in truth]
    page.table(("measure", "value", "n"), rows, "Digital twin: errors against the true bed.")


def _orders(page: _Report, order: tuple[str, str] | None) -> None:
    page.section("Order of the soundings (IHO S-44)")
    facts, soundings = page.json("bathymetry/soundings.json"), page.csv("bathymetry/soundings.csv")
    if order is None or soundings is None:
        page.text("No echo sounder recorded: there are no soundings to classify.")
        return
    depth_m = float(soundings["depth"].median())
    rows = []
    for row in facts["orders"]:
        a, b, c, e = S44[row["order"]]
        shares = (f"{100 * row[key]:.1f}" for key in ("share_tvu", "share_thu", "share"))
        limits = (f"{hypot(a, b * depth_m):.3f}", f"{c + e * depth_m:.2f}")
        rows.append((_ORDER_NAMES[row["order"]], *limits, *shares))
    page.table(
        ("order", "TVU [m]", "THU [m]", "vertical [%]", "horizontal [%]", "both [%]"), rows,
        f"Limits at the median depth of {depth_m:.2f} m and 95 % confidence, and share of the used "
        "soundings that keep those of their own depth (edition 6.1).",
    )  # fmt: skip
    page.text(order[1])


def _coverage(page: _Report) -> None:
    page.section("Coverage")
    facts, bed = page.json("bathymetry/soundings.json"), page.json("bathymetry/variogram.json")
    if facts is not None:
        page.text(f"{count(facts['by_reason'][''])} soundings in {plural(facts['lines'], 'line')}.")
    river, model = page.json("fusion/river.json"), page.json("fusion/dtm.json")
    if bed is not None and river is not None:
        water = river["water"]
        page.text(
            f"The bed covers {count(bed['facts']['area_m2'])} m². Of {count(water['inside_m2'])} m² inside "
            f"the water line {number(water['without_height_m2'], decimals=1)} m² have no height. Between "
            "lines the bed is predicted, not observed."
        )
    if model is not None:
        rows = [(name, count(n), count(n * model["cell_m"] ** 2)) for name, n in model["by_source"].items()]
        page.table(
            ("source of the terrain model", "cells", "area [m²]"), rows, "What the terrain model rests on."
        )
    banks = page.csv("bathymetry/banks.csv")
    if banks is not None:
        seen = banks.groupby("side")["seen"].agg(["sum", "size"])
        page.text(
            "Places of the bank lines that were seen: "
            + ", ".join(f"{side} bank {n['sum']} of {n['size']}" for side, n in seen.iterrows())
            + "."
        )
    if facts is None and model is None:
        page.text("No bed was surveyed: what the lidar saw of the banks stands in the survey map.")
    page.figures("sounding_lines")


def _results(page: _Report) -> None:
    river = page.json("fusion/river.json")
    names = ("bed_map", "bed_sections", "long_profile", "terrain_model", "cloud_detail")
    if river is None and not set(names) & set(page.pictures):
        return
    page.section("Results")
    if river is not None:
        water = river["water"]
        page.text(
            f"The water fills {count(water['volume_m3'])} ± {count(water['sigma_volume_m3'])} m³ over "
            f"{count(water['wet_area_m2'])} m². {river['sections']} cross sections."
        )
    page.figures(*names)


# ---------------------------------------------------------------- change


def _change(page: _Report, crs: CRS, settings: Mapping[str, Any]) -> tuple[list[tuple[str, str]], float]:
    """Sections of a comparison of epochs; facts of the title page, and a date, Unix seconds."""
    pairs = sorted(name.split("_")[1][:-4] for name in page.files if name.startswith("deformation/volumes_"))
    rows: list[_Row]
    page.section("Epochs and registration")
    for pair in pairs:
        found, words = (
            page.json(f"deformation/registration_{pair}.json"),
            f"epochs {pair.replace('-', ' to ')}",
        )
        if "parameters" not in found:
            page.text(f"The {words} were compared without a registration.")
            continue
        rows = [
            (name.replace("_m", " [mm]").replace("_", " "), _n(1000 * value, 2, "+"), _n(1000 * sigma, 2))
            for (name, value), sigma in zip(
                found["parameters"].items(), found["sigmas"].values(), strict=True
            )
        ]
        caption = f"Registration on stable ground, {words}, model {found['model']}."
        page.table(("parameter (turns in mrad)", "value", "sigma"), rows, caption)
    page.figures("epochs_from_above", "stable_ground")
    page.section("Change")
    for pair in pairs:
        words = f"epochs {pair.replace('-', ' to ')}"
        rows = [
            (r["what"], f"{_n(r['volume_m3'], 2)} ± {_n(r['sigma_m3'], 2)}",
             f"{_n(r['low_m3'], 2)} to {_n(r['high_m3'], 2)}", _n(r["area_m2"], 1), _n(r["not_seen_m2"], 1))
            for r in page.records(f"deformation/volumes_{pair}.csv")
        ]  # fmt: skip
        columns: tuple[str, ...] = ("what", "volume [m³]", "95 % [m³]", "area [m²]", "not seen [m²]")
        page.table(columns, rows, f"Volumes of change, {words}.")
        patches = page.records(f"deformation/patches_{pair}.csv")
        rows = [
            (r["what"], _n(r["area_m2"], 1), _n(r["volume_m3"], 2, "+"), _length(r["mean_distance_m"], "+"))
            for r in patches[:_PATCHES]
        ]
        columns = ("patch", "area [m²]", "volume [m³]", "mean distance")
        page.table(columns, rows, f"Largest of {count(len(patches))} patches of significant change, {words}.")
    page.figures("change_map", "significance_map", "height_difference", "volume_along")
    page.figures("retreat_along", "change_profiles")
    return [("Epochs", ", ".join(settings["epochs"])), ("Map grid", crs.name)], 0.0


# ---------------------------------------------------------------- products, limits, numbers


def _products(page: _Report, folder: Path, products: Mapping[Path, str]) -> None:
    page.section("Products")
    page.text("Files of this report, with checksums. Heights in clouds, layers and bed are ellipsoidal.")
    files = []
    for path, words in products.items():
        meta = Path(f"{path}.meta.json")
        checksum = (
            read_json(meta)["sha256"] if meta.is_file() else hashlib.sha256(path.read_bytes()).hexdigest()
        )
        size = path.stat().st_size
        files.append({
            "name": Path(relpath(path, folder)).as_posix(), "words": words,
            "sha256": checksum, "size": f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{size / 1e3:.1f} kB",
        })  # fmt: skip
    page.add("files", files=files)


def _limits(page: _Report, *, twin: bool) -> None:
    page.section("Limits")
    items = []
    if twin:
        items.append(
            "The logs are those of a digital twin: the report shows the processing, and is no survey of a "
            "river."
        )
    facts, bed = page.json("bathymetry/soundings.json"), page.json("bathymetry/variogram.json")
    if facts is not None:
        items.append(
            "A sounding is the nearest return of its cone: stones narrower than the beam hide the bed "
            "about them."
        )
    if bed is not None:
        items.append(
            "Between lines the bed is predicted by its covariance; what no line crossed, a groyne or a "
            "wreck, is not in it."
        )
    if bed is not None and bed["facts"].get("light sheet left out"):
        above_m = bed["facts"]["light sheet above the soundings_m"]
        items.append(
            f"The light sheet lies {_length(above_m, '+')} from the bed of the soundings, more than both "
            "standard deviations explain: one of both is wrong. It has no part in the bed."
        )
    if page.csv("lidar/counts.csv") is not None:
        items.append(
            "Banks are as the lidar saw them from the water: what plants, walls or the boat hid is not in "
            "the cloud."
        )
    # streams of one file have the same notes
    streams: dict[str, list[str]] = {}
    for found in page.integrity():
        for note in found["notes"]:
            streams.setdefault(note, []).append(found["stream"])
    items += [f"{', '.join(names)}, as read: {note}" for note, names in streams.items()]
    if any(name.startswith("deformation/") for name in page.files):
        items.append(
            "What an epoch did not see is not called eroded: its area stands in the table of volumes."
        )
    page.add("list", items=items)


def _reference(page: _Report) -> "pd.Series[float] | None":
    """Statistics of the distances from a reference, without outliers."""
    table = page.csv("accuracy/statistics.csv")
    if table is None:
        return None
    chosen = table[(table["registration"] == "as measured") & (table["points"] == "without outliers")]
    return chosen.set_index("quantity")["value"]


def _n(value: float, digits: int, sign: str = "") -> str:
    """A number with thousands apart, without the sign of a zero; nan: a dash."""
    return "–" if pd.isna(value) else f"{round(value, digits) + 0.0:{sign},.{digits}f}".replace("-", "−")


def _length(metres: float, sign: str = "") -> str:
    return f"{_n(metres, 2, sign)} m" if abs(metres) >= 1 else f"{_n(100 * metres, 1, sign)} cm"


def _with_sigma(values: Sequence[float], sigmas: Sequence[float]) -> list[str]:
    return [with_sigma(*each).replace("-", "−") for each in zip(values, sigmas, strict=True)]
