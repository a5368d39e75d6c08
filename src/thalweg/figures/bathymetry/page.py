"""One page on the riverbed: how deep, how sure, what it rests on, what was left out."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from thalweg.accuracy import verdict_of
from thalweg.bathymetry import REASONS
from thalweg.figures import JUDGED, Finding, Page, count, number, plural, sentence


def bed_page(
    facts: Mapping[str, Any],
    variogram: Mapping[str, Any],
    level: Mapping[str, Any],
    banks: pd.DataFrame,
    validation: Mapping[str, Any],
    methods: pd.DataFrame,
    river: Mapping[str, Any],
    fit: Mapping[str, Any],
    *,
    pictures: Sequence[Path],
    captions: Mapping[str, str],
    truth: pd.DataFrame | None = None,
    title: str = "Riverbed",
    twin: bool,
) -> Page:
    """The page of a riverbed.

    Parameters
    ----------
    facts, variogram, level, validation : JSON files of the rules of `workflow/rules/bathymetry.smk`.
    banks, methods : their tables.
    river, fit : ``fusion/river.json``, ``fusion/fit.json``.
    pictures, captions : PNG files, and by stem what stands below them.
    truth : of a twin, columns measure, value, n; None: there is none.
    title : heading.
    twin : whether a digital twin wrote the logs.

    Raises
    ------
    InputError : a picture is missing.
    """
    found = variogram["facts"]
    told = verdict_of(validation["normalised_square"], validation["lines"])
    findings = [
        Finding("soundings that count", f"{count(facts['by_reason'][''])} of {count(facts['pings'])}"),
        Finding("bed", f"{count(found['area_m2'])} m²", f"{count(found['cells'])} cells"),
        Finding(
            "standard deviation of a cell, median",
            f"{100 * found['median sigma_m']:.1f} cm",
            f"of which all share {100 * found['median sigma_common_m']:.1f} cm",
        ),
        Finding(
            f"RMSE of {validation['lines']} left-out lines",
            f"{100 * validation['rmse_m']:.1f} cm",
            f"squares over predicted variances {validation['normalised_square']:.2f}; {told}",
        ),
        Finding("outside the 95 % interval", f"{100 * validation['outside_95']:.1f} %"),
    ]
    page = Page(
        title,
        f"Cross-validation with {plural(validation['lines'], 'left-out line')}: {JUDGED[told]}.",
        findings,
    )
    if twin:
        page.text("The digital twin made these data: a simulated river, simulated instruments.")
    page.pictures(pictures, captions, "bed_map")
    page.section("Cross-validation")
    page.table(
        methods.assign(outside_95=100 * methods["outside_95"]).rename(columns=_METHODS),
        "Cross-validation: left-out lines predicted by each method.",
        {"RMSE": "m", "mean": "m", "outside 95 %": "%"},
        digits=3,
    )
    page.section("Soundings")
    rows = [
        (REASONS[name], n, 100 * n / max(facts["pings"], 1)) for name, n in facts["by_reason"].items() if n
    ]
    page.table(pd.DataFrame(rows, columns=["pings", "n", "share"]), "Pings by class.", {"share": "%"})
    temperature = facts["water_temperature_c"]
    page.text(
        f"{facts['lines']} lines. Depths are multiplied by {facts['sound_factor']:.5f} ± "
        f"{facts['sigma_sound_factor']:.5f} for the speed of sound"
        + (f" (water of {temperature:.1f} °C)" if temperature is not None else "")
        + f". The lever arm of the transducer is that of the {facts['place_from']}; its time stamps are "
        f"corrected by {facts['lag_s']:+.3f} s. The correlation time of position errors is "
        f"{facts['position_time_s']:.1f} s."
    )
    page.text(_crossings(facts["crossings"]))
    page.table(
        pd.DataFrame(facts["orders"]).rename(columns=_SHARES),
        "Share of the used soundings that meet the orders of IHO S-44 (edition 6.1, at 95 %).",
    )
    page.section("Water and banks")
    seen = banks.groupby("side")["seen"].agg(["sum", "size"])
    page.text(
        f"Water level {level['level_m']:.3f} ± {level['sigma_m']:.3f} m (local frame), fall "
        f"{level['fall_m_per_km']:.2f} m/km, rise {level['rise_m_per_h']:.3f} m/h. "
        + " ".join(map(sentence, level["notes"]))
        + " "
        + "; ".join(
            f"{side} bank: {row['sum']} of {row['size']} places seen" for side, row in seen.iterrows()
        )
        + f". Their standard deviation across is {banks['sigma_across_m'].median():.2f} m in the median."
    )
    water, missing = river["water"], river["not_written"]
    page.section("Water and files for hydraulic programs").text(
        f"The water fills {count(water['volume_m3'])} ± {count(water['sigma_volume_m3'])} m³ over "
        f"{count(water['wet_area_m2'])} m²; of the {count(water['inside_m2'])} m² inside the water line "
        f"{number(water['without_height_m2'], decimals=1)} m² have no height. {river['sections']} sections. "
        + (
            f"Triangles: {count(river['mesh']['faces'])}, least angle {river['mesh']['least_angle_deg']:.0f} "
            f"degrees, {river['mesh']['folded']} folded. "
            if "mesh" in river
            else ""
        )
        + f"In fusion/exports: {', '.join(river['written'])}."
        + _depth_and_width(river.get("depth_and_width", {}))
        + "".join(f" {note}" for note in river["notes"])
        + "".join(f" Not written, {name}: {why}" for name, why in missing.items())
    )
    page.section("Cloud of the surroundings").text(_surroundings(fit))
    page.section("Covariance of the bed").text(f"{variogram['reason']}.{_light_sheet(found)}")
    compared = sorted(variogram["compared"].items(), key=lambda item: item[1])
    page.table(
        pd.DataFrame(compared, columns=["drift, model", "mean log score"]),
        "Drifts and models by their cross-validation with left-out lines; smaller is better.",
        digits=3,
    )
    for name, each in validation.get("reference", {}).items():
        words = (
            f"Bed less {name}, which was not used for it. The standard deviation is that of the bed with its "
            "common part, and of the reference (its own column, else bathymetry.table)."
        )
        page.section(f"Against {name}").table(_beside(each), words, digits=3)
    if truth is not None:
        page.section("Against the truth of the twin").table(truth, "Errors against the true bed.", digits=3)
    page.section("Limits").text(
        "A sounding is the nearest return within its beam, so that a stone hides the bed around it. Between "
        "lines the bed is interpolated: a groyne or a wreck that no line crossed is missing. One covariance "
        "function holds for the whole channel, with one factor for the margins. Bank lines are as accurate "
        "as the ground that the lidar measured beside the water."
    )
    return page


def _depth_and_width(found: Mapping[str, Any]) -> str:
    """What sections of different width say of the depth."""
    if "not_told" in found:
        return f" Depth against width: {found['not_told']}"
    if not found:
        return ""
    said = (
        "it is deeper where it is narrower"
        if found["deeper_where_narrower"]
        else "a relation of depth and width is not significant"
    )
    return (
        f" The mean depth of {found['sections']} sections goes with the width to the power of "
        f"{found['exponent']:+.2f} ± {found['sigma_exponent']:.2f}: {said}."
        + (
            f" At the weir it is {found['ratio_at_weir']:.2f} ± {found['sigma_ratio_at_weir']:.2f} times as "
            "deep as elsewhere at the same width."
            if "ratio_at_weir" in found
            else ""
        )
    )


def _beside(measured: Mapping[str, Any]) -> pd.DataFrame:
    """Measures of the bed beside a reference: all cells, and by distance to the nearest datum."""
    rows = {"all cells": measured} | dict(measured["classes"])
    return pd.DataFrame(
        [
            (name, of["n"], of["rmse_m"], of["bias_m"], of["normalised_square"], 100 * of["outside_95"])
            for name, of in rows.items()
        ],
        columns=["cells", "n", "RMSE / m", "mean / m", "squared error over variance", "outside 95 % / %"],
    )


def _surroundings(fit: Mapping[str, Any]) -> str:
    """How the cloud of the surroundings lies on the ground of the banks."""
    if "fitted_shift_m" not in fit:
        return sentence(fit["why"])
    shift = ", ".join(
        f"{100 * value:+.1f} ± {100 * sigma:.1f}"
        for value, sigma in zip(fit["fitted_shift_m"], fit["sigma_shift_m"], strict=True)
    )
    held = (
        f" Not shown by the ground, and left alone: {', '.join(fit['undetermined'])}; each may move "
        f"its points by {100 * fit['sigma_left_alone_m']:.1f} cm (standard deviation), which the sigmas hold."
        if fit["undetermined"]
        else ""
    )
    return (
        f"It was moved by {shift} cm east, north and up, on {count(fit['cells'])} cells of ground in "
        f"{fit['blocks']} blocks that it shares with the banks. Its distance from them was "
        f"{100 * fit['median_before_m']:+.1f} cm in the median before and {100 * fit['median_after_m']:+.1f} "
        f"cm after, with a robust standard deviation of {100 * fit['spread_after_m']:.1f} cm.{held}"
    )


def _light_sheet(found: Mapping[str, Any]) -> str:
    """What the light sheet adds to the bed, or why it does not."""
    if "light sheet" not in found:
        return ""
    above = found["light sheet above the soundings_m"]
    sigmas = found["light sheet above the soundings, sigmas"]
    where = (
        f" {count(found['light sheet'])} places of the light sheet lie {100 * above:+.1f} cm from the bed of "
        f"the soundings in the median ({sigmas:+.1f} standard deviations)"
    )
    if found["light sheet left out"]:
        return where + ": one of both is wrong or shows another bed. They have no part in this one."
    return where + " and are part of it."


_METHODS = {
    "rmse_m": "RMSE",
    "bias_m": "mean",
    "normalised_square": "squared error over variance",
    "outside_95": "outside 95 %",
    "not_foretold": "not predicted",
}
_SHARES = {"share_tvu": "vertical", "share_thu": "horizontal", "share": "both"}


def _crossings(found: Mapping[str, Any]) -> str:
    """What the crossings of lines say, in words."""
    if not found["n"]:
        return "No lines cross, so that the time-correlated errors are not checked."
    words = (
        f"Lines cross {count(found['n'])} times, with height differences of "
        f"{100 * found['rms_m']:.1f} cm RMS, predicted {100 * found['predicted_m']:.1f} cm; the mean "
        "of squared differences over predicted variances is "
        f"{found['normalised_square']:.2f}."
    )
    if found["estimated"]:
        words += (
            f" Time-correlated errors are {found['slow_factor']:.2f} times the stated ones (uncertain by a "
            f"factor of {np.exp(found['slow_factor_sigma_log']):.2f}), with a correlation time of "
            f"{found['time_s']:.1f} s; with these the mean is {found['normalised_square_after']:.2f}. "
            f"{count(found['left_out'])} crossings "
            "were left out as gross errors."
        )
    else:
        which = "Those within one run" if "steps" in found.get("agreement", {}) else "They"
        words += f" {which} are too few to estimate the time-correlated errors: the stated ones are used."
    words += "".join(f" {sentence(note)}" for note in found.get("notes", []))
    return words
