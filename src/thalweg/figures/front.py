"""Front page of a campaign: the survey at a glance, its state, every page, file and picture."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from html import unescape
from os.path import relpath
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import numpy as np
import pandas as pd
from pyproj import CRS

from thalweg.accuracy import AS_MEASURED, WITHOUT_OUTLIERS, verdict_of, verdict_of_ratio
from thalweg.core import InputError, Trajectory, final_path, read_json, utc_text_from_gps
from thalweg.figures.accuracy import centimetres
from thalweg.figures.page import Finding, Page, escape, findings_html, findings_of, small_picture
from thalweg.figures.products import MAP_FILES, OWN_FILES, Product, products_of
from thalweg.figures.style import count, duration, note_of, number, plural
from thalweg.figures.survey import centre_in_words, track_gaps, track_length_m
from thalweg.ingest import IntegrityReport

_HEADING: Final = re.compile(r"<h1>(.*?)</h1>\s*(?:<p>(.*?)</p>)?", re.DOTALL)
_SENTENCE: Final = re.compile(r"^.*?[.!?](?=\s|$)", re.DOTALL)
_SOURCE: Final = re.compile(r" \((?:T|P\d)\b[^)]*\)")
"""Where the thesis and its papers show the same: each figure says so itself."""
_HEAD_LETTERS: Final = 60_000
"""Of a page its head is read, no pictures."""
MOST_FINDINGS: Final = 7
LEAD_PX: Final = 1100
VIEWERS: Final = ("viewer/index.html", "panorama/index.html")
"""What the leading picture opens."""
LEADS: Final = (
    "from_above",
    "change_map",
    "field_positions",
    "rig_field",
    "measurement_volume",
    "block_positions",
    "finished_positions",
    "pose_history",
    "distances_in_plan",
)
"""The picture that leads a campaign of each kind: the first of these that shows anything."""
CHAINS: Final = {"trajectory_fused": "all sensors", "trajectory": "INS and GNSS"}
"""Trajectories by the name of their file, the best one first."""
STREAMS: Final = {
    "lidar": "Lidar",
    "ins": "INS",
    "gnss": "GNSS",
    "positions": "Positions",
    "depth": "Echo sounder",
    "camera": "Camera",
    "rig": "Panoramas",
    "reference": "Reference cloud",
}
_LARGE: Final = 0.05
"""More of a recording that is missing than this share is said in another colour."""
GEOREFERENCED: Final = (".laz", ".tif", ".gpkg", ".ply", ".parquet")


def write_front_page(
    *,
    results: list[Path],
    pictures: list[Path],
    figures: dict[str, tuple[str, str]],
    lacking: list[tuple[str, str]],
    title: str,
    twin: bool,
    crs: str,
    page: Path,
) -> None:
    """Write the page that a person opens first.

    Parameters
    ----------
    results : pages and tables of the campaign. Each HTML file gets a link with its own heading and the first
        sentence of its lead; reports of streams, trajectories and statistics give the head. Files to take
        away are those of `thalweg.figures.products` that are in the folder.
    pictures : PNG files.
    figures : by stem of a picture its group, and what it shows.
    lacking : what more logs would add, and which.
    title : heading.
    twin : whether a digital twin wrote the logs.
    crs : map of the exports.
    page : where it will stand; links are relative to its folder.

    Raises
    ------
    InputError : a page without a heading.
    """
    folder = final_path(page).parent

    def at(path: Path) -> str:
        """Address from the front page."""
        return Path(relpath(path, folder)).as_posix()

    files = {at(path): path for path in results}
    pages = [each for each in files if each.endswith(".html")]
    pages.sort(key=lambda each: VIEWERS.index(each) if each in VIEWERS else len(VIEWERS))
    heads = {address: _head(files[address], title) for address in pages}
    drawn = {path: figures.get(path.stem, ("Others", path.stem)) for path in pictures}
    drawn = {path: (group, _SOURCE.sub("", shows)) for path, (group, shows) in drawn.items()}
    reasons = {path: why for path in pictures if (why := note_of(path)) is not None}
    shown = [path for path in pictures if path not in reasons]
    chain = next((name for name in CHAINS if f"orientation/{name}.parquet" in files), "")
    track = Trajectory.read(files[f"orientation/{chain}.parquet"]) if chain else None
    mark = ["Digital twin: simulated instruments wrote these logs"] if twin else []
    epochs = [read_json(path) for path in results if path.name == "errors.json"]
    front = Page(title, " · ".join([*mark, *_facts(track, epochs, crs)]), folded=False)
    for address, (name, _, _) in heads.items():
        front.entry(address, name)
    found = [] if track is None else list(_of_survey(files, track, chain))
    found = found or [replace(each, href=address) for address in pages for each in heads[address][2]]
    glance = findings_html(found[:MOST_FINDINGS])
    if lead := next((path for stem in LEADS for path in shown if path.stem == stem), None):
        shown.remove(lead)
        address = next((each for each in pages if each in VIEWERS), at(lead))
        words = f"Open in three dimensions: {heads[address][0].lower()}" if address in heads else "Enlarge"
        glance = (
            f'<a class="lead" href="{quote(address)}"><img alt="{escape(drawn[lead][1])}" '
            f'src="{small_picture(lead, LEAD_PX, 80)}"><span>{escape(words)}</span></a>\n{glance}'
        )
    front.raw(f'<div class="glance">\n{glance}</div>')
    if streams := [_stream(path) for name, path in files.items() if name.endswith(".integrity.json")]:
        front.raw(f'<ul class="streams" id="recordings">\n{"".join(streams)}</ul>')
    if heads:
        front.raw("<h2>Results</h2>").links({address: head[:2] for address, head in heads.items()})
    on_map, own = _downloads(folder, MAP_FILES, crs), _downloads(folder, OWN_FILES, "local frame")
    front.section("Downloads").raw(on_map or own)
    if on_map and own:
        with front.fold("Files in the local frame, calibrations, tables"):
            front.raw(own)
    front.raw('<p><a href="./">Folder of all results</a></p>')
    if shown:
        front.section("Figures")
    for group in dict.fromkeys(drawn[path][0] for path in shown):
        front.raw(f"<h3>{escape(group)}</h3>")
        front.thumbnails({at(path): (path, drawn[path][1]) for path in shown if drawn[path][0] == group})
    tables = {
        "All numbers of the survey": _numbers(files.get("summary.csv")),
        "Figures without data": pd.DataFrame(
            [(drawn[path][1], why) for path, why in reasons.items()], columns=["figure", "reason"]
        ),
        "Products of further logs": pd.DataFrame(list(lacking), columns=["result", "needs"]),
    }
    for words, table in tables.items():
        if not table.empty:
            with front.fold(words):
                front.table(table, words)
    front.write(page)


def _head(path: Path, title: str) -> tuple[str, str, list[Finding]]:
    """Heading of a page without the campaign's title, the first sentence below it, and its findings."""
    with path.open(encoding="utf-8") as stream:
        text = stream.read(_HEAD_LETTERS)
    found = _HEADING.search(text)
    if found is None:
        raise InputError("a page without a heading", expected="a page that Thalweg wrote", where=path)
    lead = unescape(re.sub(r"<[^>]+>", "", found[2] or ""))
    sentence = _SENTENCE.match(lead)
    return unescape(found[1]).removesuffix(f": {title}"), sentence[0] if sentence else lead, findings_of(text)


def _facts(track: Trajectory | None, epochs: Sequence[Mapping[str, Any]], crs: str) -> Iterator[str]:
    """When and where a boat surveyed, the days of the epochs of a change, and the map."""
    if track is not None:
        first, last = (utc_text_from_gps(t, 0) for t in track.span())
        yield f"{first[:10]}, {first[11:19]} to {last[11:19]} UTC"
        yield f"track of {count(track_length_m(track))} m"
        yield centre_in_words(track)
    if epochs:
        days = sorted(utc_text_from_gps(each["start_gps_s"], 0)[:10] for each in epochs)
        yield f"{len(days)} epochs, {days[0]} to {days[-1]}"
    if crs != "local":
        system = CRS.from_user_input(crs)
        heights = f"heights {system.sub_crs_list[1].name}" if system.is_compound else "ellipsoidal heights"
        yield f"map {crs}, {heights}"


def _of_survey(files: Mapping[str, Path], track: Trajectory, chain: str) -> Iterator[Finding]:
    """The numbers that tell how good a survey is, each with its verdict and what it rests on."""
    sigma_m = float(np.median(np.sqrt(track.cov_pose_wcs[track.valid][:, range(3), range(3)].sum(axis=1))))
    gaps = track_gaps(track)
    missing = f"{plural(len(gaps), 'gap')}, {duration(sum(s for _, s in gaps))}" if gaps else "no gap"
    compared = "accuracy/trajectories.html" if "accuracy/trajectories.html" in files else ""
    words = "GNSS" if chain == "trajectory" and "ingest/ins.integrity.json" not in files else CHAINS[chain]
    sigma = centimetres(sigma_m) if sigma_m < 1 else f"{sigma_m:.1f} m"
    evidence = compared or "figures/trajectory.png"
    yield Finding(f"position of the boat, median 3D σ, {words}", sigma, missing, evidence)
    for name, of in CHAINS.items():
        folder = "by_fused/" if name == "trajectory_fused" else ""
        if statistics := files.get(f"accuracy/{folder}statistics.csv"):
            table = pd.read_csv(statistics)
            table = table[(table["registration"] == AS_MEASURED) & (table["points"] == WITHOUT_OUTLIERS)]
            value = table.set_index("quantity")["value"]
            told = verdict_of_ratio(value["ratio"], value["ratio_low95"], value["ratio_high95"])
            evidence = compared if folder else "accuracy/index.html"
            judged = told.replace("too few data", "too few independent values to judge")
            foretold = f"predicted {centimetres(value['predicted_rmse'])}: {judged}"
            yield Finding(f"cloud to reference, RMSE, {of}", centimetres(value["rmse"]), foretold, evidence)
    if validation := files.get("bathymetry/validation.json"):
        bed = read_json(validation)
        told = verdict_of(bed["normalised_square"], bed["lines"])
        words = (
            "too few lines to judge its sigma" if told == "too few data" else f"standard deviations: {told}"
        )
        side = "high" if bed["bias_m"] > 0 else "low"
        words = f"on average {centimetres(abs(bed['bias_m']))} too {side}; {words}"
        quantity = f"riverbed, RMSE of {bed['lines']} left-out lines"
        yield Finding(quantity, centimetres(bed["rmse_m"]), words, "bathymetry/index.html")
    if counts := files.get("lidar/counts.csv"):
        n = pd.read_csv(counts).set_index("reason")["n"]
        yield Finding(
            "points in the cloud", count(n["kept"]), f"of {count(n.sum())} decoded", "viewer/index.html"
        )
    if soundings := files.get("bathymetry/soundings.json"):
        pings = read_json(soundings)
        used = f"of {count(pings['pings'])} pings; the others with their reasons"
        bed_page = "bathymetry/index.html" if validation else "figures/sounding_lines.png"
        yield Finding("soundings used", count(pings["by_reason"][""]), used, bed_page)
    reports = [IntegrityReport.read(path) for name, path in files.items() if name.endswith(".integrity.json")]
    clean = sum(report.clean for report in reports)
    words = "nothing lost or damaged" if clean == len(reports) else "of the others something is missing"
    yield Finding("inputs without loss", f"{clean} of {len(reports)}", words, "#recordings")


def _stream(path: Path) -> str:
    """A recording as one coloured cell: what recorded, and whether anything is missing."""
    report = IntegrityReport.read(path)
    missing = [f"{count(n)} {what.replace('_', ' ')}" for what, n in report.losses.items() if n]
    tone = "unsure" if missing or report.gaps else "good"
    if report.gaps and report.t_first_s is not None and report.t_last_s is not None:
        without_s = sum(gap.duration_s for gap in report.gaps)
        missing.insert(0, f"{plural(len(report.gaps), 'gap')}, {duration(without_s)}")
        tone = "bad" if without_s > _LARGE * (report.t_last_s - report.t_first_s) else tone
    state = f"{'✖' if tone == 'bad' else '▲'} {'; '.join(missing)}" if missing else "✔ complete"
    name = path.name.split(".")[0]
    of = escape(report.model or report.format)
    return f'<li class="{tone}"><b>{STREAMS.get(name, name)}</b> {of}<span>{escape(state)}</span></li>\n'


def _downloads(folder: Path, known: Sequence[Product], frame: str) -> str:
    """Links of the files that are there, each with format, frame, size and what opens it."""
    items = ""
    for path, words, use in products_of(folder, known):
        parts = [each for each in path.rglob("*") if each.is_file()] if path.is_dir() else [path]
        size = sum(each.stat().st_size for each in parts)
        kind = "folder" if path.is_dir() else path.suffix.lstrip(".").upper()
        on = [frame] if path.suffix in GEOREFERENCED else []
        facts = ", ".join([kind, *on, f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{size / 1e3:.0f} kB"])
        address = quote(path.relative_to(folder).as_posix()) + "/" * path.is_dir()
        items += (
            f'<li><a href="{address}">{escape(words)}</a><span>{escape(facts)}</span>'
            f"<span>{escape(use)}</span></li>\n"
        )
    return f'<ul class="downloads">\n{items}</ul>' if items else ""


def _numbers(summary: Path | None) -> pd.DataFrame:
    """The summary as people read it."""
    if summary is None:
        return pd.DataFrame()
    table = pd.read_csv(summary)[["quantity", "value", "unit"]]
    values = [count(v) if float(v).is_integer() else number(v) for v in table["value"]]
    return table.assign(value=values, unit=table["unit"].replace("1", ""))
