"""One page on a light-sheet sensor: calibration, panels, budget with verdicts, models, what was rejected."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import pandas as pd

from thalweg.figures.calibration.page import TWIN_NOTE, short, with_units
from thalweg.figures.page import Page
from thalweg.figures.style import count, plural
from thalweg.ingest.registry.describe_calibration import with_sigma
from thalweg.lightsheet.budget.budget import TOTAL, TOTAL_CORRELATED, budget_table
from thalweg.lightsheet.figures.scans import ScanFiles, scan_section
from thalweg.lightsheet.lines.settings import LineFlag

# ---------------------------------------------------------------- part of the light-sheet page: the lens of
# the sensor's camera from pictures of a field of markers


LENS_NOTE: Final = (
    "Sigmas are those of the adjustment: they tell of the marks' noise and of the geometry of the pictures, "
    "not of a lens that moves between the field and the housing."
)


def lens_section(page: Page, report: Mapping[str, Any]) -> Page:
    """Pictures, scale bars and precision of the self-calibrating bundle.

    Parameters
    ----------
    page : to which the section is added.
    report : ``camera_interior.json``, see `thalweg.lightsheet.lens.report`.
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
            short(pd.DataFrame(report[rows]).rename(columns={"largest": "largest over its sigma"}))
        )
        page.table(shown, caption, units)
    return page


# ---------------------------------------------------------------- page


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
    "that of the predicted sigma; the image of a ray does so for the lens alone. Heading and place along the "
    "window come from the design and are aligned."
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
PUBLISHED_NOTE: Final = (
    "P4 does not print its geometry. The figures are those of the geometry that fits its published values "
    "best; what differs may be due to that geometry, except where published figures contradict each other."
)
CORRELATION_NOTE: Final = (
    "Sigmas of the depth with the joint covariance of a calibration on two levels, and with the same sigmas "
    "and no correlations, for the best-fit geometry of P4. P4 6.6 leaves correlations out."
)
MODEL_NOTE: Final = (
    "Depths by simpler models minus those of the strict intersection of image ray and refracted sub-beam. "
    "Palomer et al. (2017) state errors of about 2 mm for an elliptical cone."
)


def light_sheet_page(
    calibration: Mapping[str, Any],
    budget: pd.DataFrame,
    published: pd.DataFrame,
    contradictions: pd.DataFrame,
    correlations: pd.DataFrame,
    models: pd.DataFrame,
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
    published : `thalweg.lightsheet.budget.checks.verdicts`.
    contradictions : `thalweg.lightsheet.budget.checks.inequality_table`.
    correlations : `thalweg.lightsheet.budget.correlations.depth_sigmas`.
    models : `thalweg.lightsheet.optics.sheet_models.model_errors`.
    panels : `thalweg.lightsheet.poses.panels.compare_panels`; None if there were none.
    truth : for a twin, `thalweg_lab.truth.light_sheet.compare_sensor`.
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
    page = Page(title, _lead(calibration, budget, panels))
    if twin:
        page.text(TWIN_NOTE)
    _calibrated(page, calibration, camera)
    if lens:
        lens_section(page, lens)
    if truth is not None and len(truth):
        page.section("Against the truth of the digital twin").text(TRUTH_NOTE)
        shown = truth.rename(columns={"estimated_minus_true": "calibrated minus true"})
        page.table(
            short(shown.assign(what=shown["what"].str.replace("_", " ")), 3),
            "Errors of the calibration (light_sheet_truth.csv)",
        )
    if panels is not None and len(panels):
        page.section("Panel in known depths").text(PANEL_NOTE)
        _units(page, panels, "Measured minus reference depth, beside published values (panels.csv)")
    for scan in scans:
        scan_section(page, scan)
    _budget(page, budget, published, contradictions, correlations)
    page.section("Simpler models").text(MODEL_NOTE)
    _units(page, models.drop(columns="lost") if not models["lost"].any() else models,
           "Errors in depth of each model (models.csv)")  # fmt: skip
    _rejected(page, calibration, counts or {}, points or {}, panels)
    if pictures:
        page.section("Figures")
    for picture in pictures:
        page.figure(picture, (captions or {}).get(picture.stem, picture.stem.replace("_", " ")))
    return page


def _lead(calibration: Mapping[str, Any], budget: pd.DataFrame, panels: pd.DataFrame | None) -> str:
    lines, pairs = calibration["line_points"], calibration["pairs"]
    words = [
        f"Calibrated on {calibration['object']} from {count(lines['used'])} line points and "
        f"{plural(pairs['used'], 'pair')} of ends; "
        f"{plural(lines['rejected'] + pairs['rejected'], 'observation')} rejected."
    ]
    whole = budget[budget["cause"] == TOTAL_CORRELATED]
    if len(whole):
        low, high = whole["sigma_depth_mm"].min(), whole["sigma_depth_mm"].max()
        depths = sorted(whole["depth_mm"].unique())
        words.append(
            f"Predicted sigma of the depth {low:.3f} to {high:.3f} mm between {depths[0]:g} and "
            f"{depths[-1]:g} mm."
        )
    if panels is not None and len(panels):
        most = float(panels["mean_mm"].abs().max())
        words.append(
            f"On a panel in {plural(len(panels), 'depth')} the means are off by at most {most:.3f} mm, with "
            f"standard deviations of at most {float(panels['std_mm'].max()):.3f} mm."
        )
    return " ".join(words)


def _calibrated(page: Page, calibration: Mapping[str, Any], camera: Mapping[str, Any] | None) -> None:
    page.section("What was calibrated").text(SHEET_NOTE)
    if camera:
        rows = [{"name": f"camera_{name}", "treated": "resection over the window", **found}
                for name, found in camera["camera"].items()]  # fmt: skip
        flat = f"the marks on the window lie within {camera['window_flatness_mm']:.3f} mm of one plane"
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
    page.section("Correlations worth naming")
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
        _units(page, sigmas, "Sigma of a depth that the calibration leaves, without the noise of the line; "
               "uncorrelated: the same sigmas without correlations")  # fmt: skip


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
        rows.append({
            "parameter": (stem if known else str(one["name"])).replace("_", " "),
            "value": with_sigma(float(one["value"]), sigma).partition(" ")[0],
            "unit": {"deg": "°"}.get(unit, unit) if known else "px" if one["name"] in LENS_PX else "",
            "sigma": "fixed" if sigma == 0.0 else f"{sigma:.2g}",
            "sigma by the image alone": "" if alone is None else f"{float(alone):.2g}",
            "treated": one["treated"],
        })  # fmt: skip
    return pd.DataFrame(rows)


def _budget(
    page: Page, budget: pd.DataFrame, published: pd.DataFrame, contradictions: pd.DataFrame,
    correlations: pd.DataFrame,
) -> None:  # fmt: skip
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
    page.section("Beside the budget of P4").text(PUBLISHED_NOTE)
    met = int((published["verdict"] == "met").sum())
    words = ", ".join(f"{n} {word}" for word, n in published["verdict"].value_counts().items())
    page.text(f"{met} of {len(published)} published figures are met within a fifth: {words}.")
    _units(page, published, "Published maxima and minima beside those of the geometry (budget_published.csv)")
    page.text("Inequalities that published figures would have to obey, whatever the geometry:")
    page.lines([inequality(row) for row in contradictions.to_dict("records")])
    page.section("What correlations change").text(CORRELATION_NOTE)
    _units(page, correlations, "Sigma of the depth by the calibration; factor: largest without correlations "
           "over largest with them (budget_correlations.csv)")  # fmt: skip


def inequality(row: Mapping[Any, Any]) -> str:
    """An inequality in one line: both sides in words and values, and whether it holds.

    Examples
    --------
    >>> row = {
    ...     "name": "size",
    ...     "left": "as published",
    ...     "right": "the least",
    ...     "left_value": 0.03,
    ...     "right_value": 0.06,
    ...     "unit": "mm",
    ...     "condition": "",
    ... }
    >>> inequality(row)
    'size: as published 0.03 mm >= the least 0.06 mm? Contradicted, by a factor of 2.0'
    """
    left, right = float(row["left_value"]), float(row["right_value"])
    held = "Holds" if left >= right else f"Contradicted, by a factor of {right / left:.1f}"
    raw = row.get("condition")
    condition = f" (for {raw})" if isinstance(raw, str) and raw else ""
    unit = row["unit"]
    return (
        f"{row['name']}: {row['left']} {left:.3g} {unit} >= {row['right']} {right:.3g} {unit}? "
        f"{held}{condition}"
    )


def _rejected(
    page: Page, calibration: Mapping[str, Any], counts: Mapping[str, pd.DataFrame],
    points: Mapping[str, pd.DataFrame], panels: pd.DataFrame | None,
) -> None:  # fmt: skip
    page.section("What was left out")
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
        found = {flag.name.lower().replace("_", " "): int(((flags & flag) != 0).sum())
                 for flag in LineFlag if flag.name}  # fmt: skip
        rows.append({"series": series, "points": len(table), **found})
    return pd.DataFrame(rows)


def _units(page: Page, table: pd.DataFrame, caption: str) -> None:
    shown, units = with_units(short(table))
    page.table(shown, caption, units)


def _name(parameter: str) -> str:
    stem, _, unit = parameter.rpartition("_")
    return (stem if unit in ("mm", "rad", "deg", "px") else parameter).replace("_", " ")
