"""The page on the light-sheet sensor, and that on a strip of the bed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.accuracy import verdict_of
from thalweg.core import InputError, read_json
from thalweg.figures import JUDGED, Finding, Page, Pictures, count, plural
from thalweg.figures.calibration import TWIN_NOTE, with_units
from thalweg.ingest.registry import with_sigma
from thalweg.lightsheet.budget import TOTAL, TOTAL_CORRELATED, budget_table
from thalweg.lightsheet.lines import LineFlag

PICTURES: Final = {
    "sheet_image_": "sheet_image",
    "setup_of_": "scan_setup",
    "reference_of_": "scan_reference",
    "profile_of_": "scan_profile",
    "scan_": "scan_distances",
}
"""What names of a scan's pictures begin with, and the stem of the caption that belongs to them."""
SCAN_NOTE: Final = (
    "Distances are signed, positive in front of the reference, after the scan was fitted to it. Standard "
    "deviations are those before and after each outlier rule. The first rule is that of "
    "P4 Tables 2 and 3, three standard deviations of all points; the robust one takes median and NMAD."
)
STRIP_NOTE: Final = (
    "Each line is georeferenced with the boat's trajectory at the time of its pulse and the mount of the "
    "sensor. Sigmas of heights hold the errors of both; those within a line are of its measurement alone."
)
STRIP_TRAJECTORY: Final = {
    "fused": "The trajectory is that of INS, antenna positions and image poses together.",
    "ins": "The trajectory is that of the INS and the antenna positions: there are no images of the bank.",
}
LOST: Final = {
    "far": "points not on the object",
    "at_border": "points at a border of the mesh",
    "on_bad_lines": "points of lines with a bad pose",
}
"""Counts of `facts.json` that say why a point of a scan was not compared."""

LENS_PX: Final = ("fx", "fy", "cx", "cy")
"""Parameters in pixels whose names do not say so."""
STRONG_SHOWN: Final = 12
"""Correlations that the page names."""
SHEET_NOTE: Final = (
    "The rotation of the laser in the plane of its own fan moves no point of the sheet. It is fixed by the "
    "design, and five parameters of the laser are estimated. Parameters that were held fixed have sigmas "
    "that were stated beforehand; their share in the estimated ones is in the column sigma, not in that of "
    "the image alone."
)
TRUTH_NOTE: Final = (
    "Each error is the calibrated value minus the true one; normalised errors are errors over their sigmas. "
    "The rows of depths compare both sensors over the image: root mean square of the difference, beside "
    "that of the predicted sigma; the image of a ray does so for the lens alone. Heading and position along "
    "the window come from the design and are aligned."
)
PANEL_NOTE: Final = (
    "Distances are measured minus reference depth. P3 3.1.2 states one mean and one standard deviation for "
    "its two deepest panels. The standard deviation within an image is that of the line; an error of the "
    "calibration is common to all points of a depth and shows in the mean."
)
BUDGET_NOTE: Final = (
    "Standard deviations of the depth by cause, least and largest along lines of equal depth, of this "
    "sensor. The total adds squares as P4 6.6 does; the total with correlations takes the joint covariance."
)
LENS_NOTE: Final = (
    "Sigmas are those of the adjustment: they follow from noise of image points and geometry of images, "
    "not from a lens that moves between the field and the housing."
)


# ---------------------------------------------------------------- scans


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanFiles:
    """What is known about one scan: tables and reports by stem, pictures with their captions."""

    name: str
    tables: Mapping[str, pd.DataFrame]
    facts: Mapping[str, Mapping[str, Any]]
    pictures: Sequence[tuple[Path, str]] = field(default_factory=tuple)


def read_scans(
    names: Sequence[str], files: Sequence[Path], pictures: Sequence[Path], captions: Mapping[str, str]
) -> list[ScanFiles]:
    """Read the files of all scans, sorted by scan.

    Parameters
    ----------
    names : of the scans in the order of the page.
    files : tables ``<scan>/<stem>.csv`` and reports ``<scan>/<stem>.json``.
    pictures : ``<kind>_<scan>.png``, see `PICTURES`, or ``<scan>/<stem>.png``.
    captions : stem of a caption -> its words.

    Raises
    ------
    InputError : a file that belongs to none of the scans.
    """
    found = []
    for name in names:
        mine = [path for path in files if path.parent.name == name]
        kinds = [(path, kind_of(path, name)) for path in pictures]
        found.append(
            ScanFiles(
                name=name,
                tables={path.stem: pd.read_csv(path) for path in mine if path.suffix == ".csv"},
                facts={path.stem: read_json(path) for path in mine if path.suffix == ".json"},
                pictures=[(path, captions.get(kind, _words(kind))) for path, kind in kinds if kind],
            )
        )
    lost = [path for path in files if path.parent.name not in names]
    lost += [path for path in pictures if not any(kind_of(path, name) for name in names)]
    if lost:
        raise InputError(
            f"{lost[0].name} in '{lost[0].parent.name}' belongs to no scan",
            expected=f"files of {', '.join(names) or 'no scan'}",
            where="page on a light-sheet sensor",
        )
    return found


def kind_of(picture: Path, scan: str) -> str:
    """Stem of the caption of a picture of that scan; empty if the picture is not one of it.

    Examples
    --------
    >>> kind_of(Path("figures/scan_old_wreck.png"), "old_wreck"), kind_of(Path("scan_old_wreck.png"), "wreck")
    ('scan_distances', '')
    """
    if picture.parent.name == scan:
        return picture.stem
    return next((kind for start, kind in PICTURES.items() if picture.stem == f"{start}{scan}"), "")


def scan_section(page: Page, scan: ScanFiles) -> None:
    """One scanned object: what was found and left out, statistics beside P4's, levels, pictures."""
    page.section(f"Scan: {_words(scan.name)}").text(scan_words(scan))
    table, facts = scan.tables, scan.facts
    for warning in facts.get("facts", {}).get("warnings", ()):
        page.text(f"Warning: {warning}.")
    if "statistics" in table:
        page.text(SCAN_NOTE)
        _units(page, table["statistics"], "All lines, beside P4 Table 3 (statistics.csv)")
    if "profile" in table:
        _units(page, table["profile"], "The middle line by itself, beside P4 Table 2 (profile.csv)")
    levels = facts.get("facts", {}).get("levels")
    if levels:
        words = "Levels of the object; root mean square from the points' own plane of each (facts.json)"
        _units(page, pd.DataFrame(levels), words, digits=5)
    words = "Images, lines and points that were left out (counts.json, facts.json, lines.csv)"
    page.table(left_out(scan), words)
    for picture, words in scan.pictures:
        page.figure(picture, words)


def scan_words(scan: ScanFiles) -> str:
    """The scan in sentences: points, lines, poses, what was predicted, whether two modes were found."""
    merged = scan.facts["counts"]["merged"]
    words = [f"{plural(merged['images'], 'image')} with {count(merged['points'])} points of the line."]
    facts, profile = scan.facts.get("facts"), scan.facts.get("profile")
    if facts is None:
        return " ".join([*words, "There is no reference to compare with."])
    bad = len(facts["images_with_bad_pose"])
    words.append(
        f"{count(facts['counts']['used'])} points lie on the {facts['reference']}; "
        f"{plural(bad, 'line')} with a bad pose."
    )
    consistency = facts["consistency"]
    words.append(
        f"Root mean square of the distances {consistency['rms_mm']:.3f} mm, predicted "
        f"{consistency['predicted_mm']:.3f} mm; of the distances over their sigmas "
        f"{consistency['rms_over_sigma']:.2f}."
    )
    if profile is not None:
        words.append(
            f"Middle line: {profile['rms_mm']:.3f} mm root mean square; distribution with "
            f"{profile['bimodality']}."
        )
    return " ".join(words)


def left_out(scan: ScanFiles) -> pd.DataFrame:
    """Reasons and numbers of what was not compared."""
    rows = _lost_points(scan.facts["counts"])
    facts = scan.facts.get("facts")
    if facts is not None:
        rows += [(words, int(facts["counts"][name])) for name, words in LOST.items()]
    if "lines" in scan.tables:
        reasons = scan.tables["lines"]["reason"].dropna().astype(str).value_counts()
        rows += [(f"lines not judged: {reason}", int(n)) for reason, n in reasons.items()]
    return pd.DataFrame(rows, columns=["left out", "number"])


def strip_page(
    counts: Mapping[str, Any],
    pictures: Pictures,
    *,
    captions: Mapping[str, str],
    title: str = "Bed strip by light sheet",
    twin: bool = False,
) -> Page:
    """The page on a strip of the bed under the boat.

    Parameters
    ----------
    counts : ``counts.json`` of the strip: ``lines, merged, images_left_out, times, trajectory``.
    pictures, captions : PNG files, and by stem what stands below them.
    title : heading.
    twin : true if the digital twin made the recordings.
    """
    merged, times = counts["merged"], counts.get("times", {})
    words = (
        f"{plural(merged['images'], 'image')} of the bed by the light-sheet sensor under the boat, with "
        f"{count(merged['points'])} georeferenced points (bed.laz)."
    )
    page = Page(title, words)
    if twin:
        page.text(TWIN_NOTE)
    page.text(f"{STRIP_NOTE} {STRIP_TRAJECTORY[counts['trajectory']]}")
    rows = [
        *_lost_points(counts),
        ("images without a pulse", len(times.get("images_without_pulse", ()))),
        ("pulses without an image", len(times.get("pulses_without_image_s", ()))),
    ]
    page.section("Rejected observations")
    page.table(pd.DataFrame(rows, columns=["left out", "number"]), "Images, pulses and points (counts.json)")
    return page.pictures(pictures, captions)


def _lost_points(counts: Mapping[str, Any]) -> list[tuple[str, int]]:
    """Images by reason, line points by status, and points whose image has no pose."""
    rows = [(f"images: {reason}", n) for reason, n in _numbers(counts.get("images_left_out", {})).items()]
    rows += [
        (f"line points: {_words(name)}", int(n))
        for name, n in counts.get("lines", {}).items()
        if name not in ("line_points", "points")
    ]
    return [*rows, ("points of images without a pose", int(counts["merged"]["points_without_pose"]))]


def _numbers(images: Mapping[str, Any]) -> dict[str, int]:
    """Number of images by reason, from the reason of each image."""
    return {str(reason): int(n) for reason, n in pd.Series(images, dtype=object).value_counts().items()}


def _words(stem: str) -> str:
    return stem.replace("_", " ")


def _units(page: Page, table: pd.DataFrame, caption: str, *, digits: int = 4) -> None:
    shown, units = with_units(table)
    page.table(shown, caption, units, digits=digits)


# ---------------------------------------------------------------- page


def light_sheet_page(
    calibration: Mapping[str, Any],
    budget: pd.DataFrame,
    *,
    panels: pd.DataFrame | None = None,
    truth: pd.DataFrame | None = None,
    camera: Mapping[str, Any] | None = None,
    lens: Mapping[str, Any] | None = None,
    counts: Mapping[str, pd.DataFrame] | None = None,
    points: Mapping[str, pd.DataFrame] | None = None,
    scans: Sequence[ScanFiles] = (),
    pictures: Sequence[Path] = (),
    captions: Mapping[str, str] | None = None,
    title: str = "Light-sheet sensor",
    twin: bool = False,
) -> Page:
    """The page.

    Parameters
    ----------
    calibration : report of `thalweg.lightsheet.calibration.report.calibration_report`.
    budget : `thalweg.lightsheet.budget.budget.budget_on_lines` of the sensor.
    panels : `thalweg.lightsheet.poses.panels.compare_panels`; None if there were none.
    truth : for a twin, `thalweg_lab.truth.calibration.compare_sensor`.
    camera : report on the camera over the window; None if it was oriented elsewhere.
    lens : report on the lens from pictures of a marker field; None if the lens was given.
    counts : by series, what line detection found and dropped in each image.
    points : by series, line points with ``flags``.
    scans : what is known about each scanned object, with its pictures.
    pictures : PNG files of the sensor, its calibration and the panels, in their order.
    captions : stem of a picture -> its caption.
    title : heading.
    twin : true if the digital twin made the images.

    Raises
    ------
    InputError : a picture is missing.
    """
    page = Page(title, *_head(calibration, budget, panels))
    if twin:
        page.text(TWIN_NOTE)
    if panels is not None and len(panels):
        page.section("Panel in known depths").text(PANEL_NOTE)
        _units(page, panels, "Measured minus reference depth, beside published values (panels.csv)")
    page.pictures(pictures, captions, "panel_distances")
    _calibrated(page, calibration, camera)
    if lens:
        lens_section(page, lens)
    if truth is not None and len(truth):
        page.section("Against the truth of the digital twin").text(TRUTH_NOTE)
        shown = truth.rename(columns={"estimated_minus_true": "calibrated minus true"})
        page.table(
            shown.assign(what=shown["what"].str.replace("_", " ")),
            "Errors of the calibration (light_sheet_truth.csv)",
        )
    for scan in scans:
        scan_section(page, scan)
    _budget(page, budget)
    _rejected(page, calibration, counts or {}, points or {}, panels)
    return page


def _head(
    calibration: Mapping[str, Any], budget: pd.DataFrame, panels: pd.DataFrame | None
) -> tuple[str, list[Finding]]:
    """The first sentence and the numbers that matter most, each with its verdict."""
    lines, pairs = calibration["line_points"], calibration["pairs"]
    findings = [
        Finding(
            f"calibrated on {calibration['object']}",
            f"{count(lines['used'])} line points, {plural(pairs['used'], 'pair')} of ends; "
            f"{count(lines['rejected'] + pairs['rejected'])} rejected",
        )
    ]
    for name, found in (("line points", lines), ("pairs of ends", pairs)):
        if np.isfinite(sigma0 := float(found.get("sigma0", np.nan))):
            told = verdict_of(sigma0**2, found["used"] / found.get("neighbours_with_one_error", 1.0))
            findings.append(Finding(f"residuals of {name} over their sigmas", f"{sigma0:.2f}", told))
    whole = budget[budget["cause"] == TOTAL_CORRELATED]
    if len(whole):
        low, high = whole["sigma_depth_mm"].min(), whole["sigma_depth_mm"].max()
        depths = sorted(whole["depth_mm"].unique())
        span = f"{depths[0]:g} to {depths[-1]:g} mm"
        findings.append(Finding(f"predicted sigma of depths of {span}", f"{low:.3f} to {high:.3f} mm"))
    if panels is None or not len(panels):
        return "No panel in known depths judges the sigmas of the depths.", findings
    most, scatter = float(panels["mean_mm"].abs().max()), float(panels["std_mm"].max())
    # means err by the calibration, which is common to a panel: each panel is one value
    square = panels["rms_mm"] ** 2 / (panels["predicted_mm"] ** 2 + panels["sigma_mm"] ** 2)
    told = verdict_of(float(square.mean()), int(square.notna().sum()))
    findings.append(
        Finding(
            f"panel in {plural(len(panels), 'depth')}",
            f"means off by at most {most:.3f} mm, standard deviations at most {scatter:.3f} mm",
            told,
        )
    )
    return f"Depth check on panels: {JUDGED[told]}.", findings


def _calibrated(page: Page, calibration: Mapping[str, Any], camera: Mapping[str, Any] | None) -> None:
    page.section("Calibrated parameters").text(SHEET_NOTE)
    if camera:
        rows = [
            {"name": f"camera_{name}", "treated": "resection over the window", **found}
            for name, found in camera["camera"].items()
        ]
        flat = f"the targets on the window lie within {camera['window_flatness_mm']:.3f} mm of one plane"
        page.table(
            parameter_rows(rows).drop(columns="sigma by the image alone"),
            f"The camera over the window; {flat} (camera.json)",
        )
    page.table(parameter_rows(calibration["parameters"]), "Parameters of the sensor (parameters.csv)")
    if calibration.get("water"):
        page.text(water_words(calibration["water"]))
    levels = pd.DataFrame([{"level": name, **facts} for name, facts in calibration["levels"].items()])
    if len(levels):
        _units(page, levels, "Levels of the calibration object, with the residuals of the line on them")
    for warning in calibration["warnings"]:
        page.text(f"Warning: {warning}.")
    page.section("Strong correlations")
    strong = calibration["correlations"]
    if strong:
        shown = [f"{rho:+.3f}  {_name(a)}, {_name(b)}" for a, b, rho in strong[:STRONG_SHOWN]]
        page.lines(shown)
        if len(strong) > STRONG_SHOWN:
            page.text(f"{len(strong) - STRONG_SHOWN} further ones are in calibration.json.")
    else:
        page.text("No pair of parameters is correlated by more than 0.9.")
    if calibration.get("sigma_of_depth"):
        sigmas = pd.DataFrame(calibration["sigma_of_depth"]).dropna()
        _units(
            page,
            sigmas,
            "Largest standard deviation of a depth by the calibration alone, without the noise of the line; "
            "uncorrelated: correlations neglected",
        )


def water_words(water: Mapping[str, Any]) -> str:
    """Where the index of the water comes from.

    Examples
    --------
    >>> water_words({"n_water": 1.33551, "sigma": 1.4e-4, "source": "file of the sensor"})
    'Refractive index of the water 1.33551 ± 0.00014, from the file of the sensor.'
    """
    value = f"Refractive index of the water {with_sigma(water['n_water'], water['sigma'])}"
    if "temperature_c" not in water:
        return f"{value}, from the {water['source']}."
    before = water["instead_of"]
    return (
        f"{value}, from {water['temperature_c']:g} °C, {water['salinity_psu']:g} psu and "
        f"{water['wavelength_nm']:g} nm; the file of the sensor has "
        f"{with_sigma(before['n_water'], before['sigma'])}."
    )


def parameter_rows(parameters: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Parameters in words: value with as many places as its sigma warrants, sigmas, unit, treatment."""
    rows = []
    for one in parameters:
        stem, _, unit = str(one["name"]).rpartition("_")
        known = bool(stem) and unit in ("mm", "deg", "px")
        sigma = float(one["sigma"])
        alone = one.get("sigma_image")
        rows.append(
            {
                "parameter": (stem if known else str(one["name"])).replace("_", " "),
                "value": with_sigma(float(one["value"]), sigma).partition(" ")[0],
                "unit": {"deg": "°"}.get(unit, unit) if known else "px" if one["name"] in LENS_PX else "",
                "sigma": "fixed" if sigma == 0.0 else f"{sigma:.2g}",
                "sigma by the image alone": "" if alone is None else f"{float(alone):.2g}",
                "treated": one["treated"],
            }
        )
    return pd.DataFrame(rows)


def _budget(page: Page, budget: pd.DataFrame) -> None:
    page.section("Budget of the depth").text(BUDGET_NOTE)
    table = budget_table(budget)
    wide = table.pivot(index="cause", columns="depth_mm", values=["least_mm", "most_mm"])
    rows = pd.DataFrame({"cause": list(dict.fromkeys(table["cause"]))})
    for depth in sorted(table["depth_mm"].unique()):
        low, high = (
            wide[(bound, depth)].reindex(rows["cause"]).to_numpy() for bound in ("least_mm", "most_mm")
        )
        rows[f"{depth:g} mm deep"] = [f"{a:.3f} to {b:.3f}" for a, b in zip(low, high, strict=True)]
    last = rows["cause"].isin((TOTAL, TOTAL_CORRELATED))
    page.table(pd.concat([rows[~last], rows[last]]), "Sigma of the depth in millimetres (budget.csv)")


def _rejected(
    page: Page,
    calibration: Mapping[str, Any],
    counts: Mapping[str, pd.DataFrame],
    points: Mapping[str, pd.DataFrame],
    panels: pd.DataFrame | None,
) -> None:
    page.section("Rejected observations")
    rows = [
        ("calibration", "line points rejected by the adjustment", calibration["line_points"]["rejected"]),
        ("calibration", "pairs rejected by the adjustment", calibration["pairs"]["rejected"]),
        *(("calibration", reason, n) for reason, n in calibration["dropped"].items()),
    ]
    for series, table in counts.items():
        rows.append((series, "images without a line", int((table["points"] == 0).sum())))
        reasons = [c for c in table.columns if c not in ("file", "points", "reason", "candidates")]
        rows += [(series, name.replace("_", " "), int(table[name].sum())) for name in reasons]
    if panels is not None and "n_off_sheet" in panels:
        rows.append(
            ("panels", "line points that do not meet the light sheet", int(panels["n_off_sheet"].sum()))
        )
    page.table(
        pd.DataFrame(rows, columns=["series", "left out", "number"]),
        "Observations that were left out, by series and reason (calibration.json, line_counts.csv)",
    )
    flagged = flag_counts(points)
    if len(flagged):
        page.table(flagged, "Line points that carry a flag; they are kept (line_points.parquet)")


def flag_counts(points: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Points of each series and how many carry each flag; a point may carry several."""
    rows = []
    for series, table in points.items():
        flags = table["flags"].to_numpy()
        found = {
            flag.name.lower().replace("_", " "): int(((flags & flag) != 0).sum())
            for flag in LineFlag
            if flag.name
        }
        rows.append({"series": series, "points": len(table), **found})
    return pd.DataFrame(rows)


def _name(parameter: str) -> str:
    stem, _, unit = parameter.rpartition("_")
    return (stem if unit in ("mm", "rad", "deg", "px") else parameter).replace("_", " ")


# ---------------------------------------------------------------- part of the light-sheet page: the lens of
# the sensor's camera from pictures of a field of markers


def lens_section(page: Page, report: Mapping[str, Any]) -> Page:
    """Pictures, scale bars and precision of the self-calibrating bundle.

    Parameters
    ----------
    page : to which the section is added.
    report : ``camera_interior.json``, see `thalweg.lightsheet.calibration.lens`.
    """
    views, fit, share = report["views"], report["adjustment"], report["sigma_over_constant"]
    low, high = fit["sigma0_band"]
    page.section("Lens").text(
        f"{plural(views['pictures'], 'picture')} of a field of {plural(fit['markers'], 'marker')}, "
        f"directions up to {views['largest_angle_deg']:.0f}° apart, {count(views['rolled'])} rolled against "
        f"the others: {count(fit['marks'])} marks, {count(fit['marks_rejected'])} rejected; "
        f"sigma0 {fit['sigma0']:.3f} (95 % band {low:.3f} to {high:.3f}). The camera constant is known to "
        f"{share['camera_constant']:.2g} of its length, that of P4 to "
        f"{share['published_camera_constant']:.2g}."
    ).text(LENS_NOTE)
    for note in report["notes"]:
        page.text(f"Note: {note}.")
    for rows, caption in (
        ("images", "Pictures of the marker field (camera_interior.json)"),
        ("scale_bars", "Scale bars of the marker field"),
    ):
        shown, units = with_units(
            pd.DataFrame(report[rows]).rename(columns={"largest": "largest over its sigma"})
        )
        page.table(shown, caption, units)
    return page
