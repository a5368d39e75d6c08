"""One page on a calibration: what was found and how well, what it rests on, what was left out, its limits."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.accuracy import verdict_of, verdict_of_ratio
from thalweg.core import AnyArray, read_json
from thalweg.core.calibration import Block, Calibration, read_calibration, unit_of
from thalweg.figures import Finding, Page, count, plural, sentence
from thalweg.figures.calibration.tables import read_figure_table
from thalweg.ingest.registry import largest_correlations, with_sigma

# ---------------------------------------------------------------- what the reports of a calibration's jobs
# say, in sentences for its page


HELD_PPM: Final = 1e-3
"""A drift with a smaller sigma was not estimated."""


def clock_words(facts: Mapping[str, Any]) -> str:
    """Offset, drift and jitter of a camera's clock, from the report of its synchronisation."""
    keys = ("sigma_offset_s", "jitter_s", "sigma_jitter_s")
    offset_ms, jitter_ms, of_jitter_ms = (1e3 * facts[key] for key in keys)
    words = (
        f"GPS time minus the camera's stamp is {facts['offset_s']:+.4f} s, sigma {offset_ms:.1f} ms, at the "
        f"middle of the run; drift {facts['drift_ppm']:+.0f} ppm, sigma {facts['sigma_drift_ppm']:.0f} ppm. "
        f"Single images are off by {jitter_ms:.1f} ms (standard deviation, sigma {of_jitter_ms:.1f} ms). It "
        f"rests on {plural(facts['images_used'], 'image')} and on {facts['variant']}; sigma0 squared "
        f"{facts['sigma0_squared']:.2f}."
    )
    low, high = facts["sigma0_squared_band"]
    return words + f" Right sigmas would leave it between {low:.2f} and {high:.2f}."


def clock_variants(facts: Mapping[str, Any]) -> pd.DataFrame:
    """Table of the same clock under different assumptions; refused ones have no numbers."""
    columns = {
        "variant": ("variant", 1.0),
        "offset_s": ("offset_s", 1.0),
        "sigma_offset_s": ("sigma_offset_ms", 1e3),
        "drift_ppm": ("drift_ppm", 1.0),
        "sigma_drift_ppm": ("sigma_drift_ppm", 1.0),
        "jitter_s": ("jitter_ms", 1e3),
        "sigma0_squared": ("sigma0_squared", 1.0),
        "images_used": ("images", 1.0),
    }
    rows = pd.DataFrame(list(facts.get("variants", [])))
    out = {
        name: rows[key] if factor == 1.0 else factor * rows[key].astype(np.float64)
        for key, (name, factor) in columns.items()
        if key in rows
    }
    table = pd.DataFrame(out)
    if "sigma_drift_ppm" in table:  # held at zero: no result
        table.loc[table["sigma_drift_ppm"] < HELD_PPM, ["drift_ppm", "sigma_drift_ppm"]] = np.nan
    return table


def stability_words(facts: Mapping[str, Any]) -> str:
    """How evenly a camera takes its images, from the report on photographs of a running clock."""
    words = (
        f"Of {count(facts['photographs'])} photographs of a running clock "
        f"{count(facts['read'])} were read. Intervals: mean {facts['mean_s']:.4f} s, standard deviation "
        f"{1e3 * facts['std_s']:.1f} ms without the share of the display's step "
        f"({1e3 * facts['raw_std_s']:.1f} ms as read), from {plural(facts['pairs'], 'pair')} of "
        "neighbours."
    )
    return " ".join([words, *facts.get("notes", [])])


def left_out(facts: Mapping[str, Any]) -> list[str]:
    """Remarks of the report of a field or of a camera: its notes; without any, what it rejected by reason."""
    lines = [sentence(note) for note in facts.get("notes", [])]
    if lines:  # they name what was rejected
        return lines
    rejected = pd.DataFrame(list(facts.get("rejected", [])), columns=["what", "name", "reason"])
    for (what, reason), part in rejected.groupby(["what", "reason"], sort=True):
        names = ", ".join(part["name"].astype(str).head(5)) + (" ..." if len(part) > 5 else "")
        lines.append(f"{plural(len(part), str(what))} left out, {reason}: {names}.")
    return lines


def process_words(facts: Mapping[str, Any]) -> str:
    """What a run about the cones says of the errors of its poses, and where the prior counts; "" if nothing.

    Parameters
    ----------
    facts : of `thalweg.calibration.ins_lidar.file.read_mount_result`.
    """
    processes = facts.get("processes", {})
    if not processes:
        return ""
    found, open_ = (
        [name.replace("_", " ") for name, fact in processes.items() if fact["determined_by_survey"] is known]
        for known in (True, False)
    )
    words = ["Errors of the poses are estimated from the run; what the campaign states of them is a prior."]
    words += [f"The run determines {', '.join(found)}."] if found else []
    words += (
        [
            f"It says little of {', '.join(open_)}: there the width of the prior counts. The sigmas hold all "
            "values that run and prior leave possible."
        ]
        if open_
        else []
    )
    return " ".join(words)


def process_table(facts: Mapping[str, Any]) -> pd.DataFrame:
    """A row for each parameter of the errors of the poses: stated, estimated, range of 95 %."""
    rows = [
        {
            "parameter": name.replace("_", " "),
            **{key: float(fact[key]) for key in ("stated", "estimated", "low", "high")},
            "determined by": "run" if fact["determined_by_survey"] else "prior and run",
        }
        for name, fact in facts.get("processes", {}).items()
    ]
    return pd.DataFrame(rows)


# ---------------------------------------------------------------- page


PUBLISHED: Final = {
    "camera_lidar": "Sardemann et al. (2023), Table 1, state 1.0, 0.4 and 0.2 mm and 0.067, 0.035 and 0.015 "
    "degrees for their camera and lidar from six cones and three positions.",
    "lidar": "Sardemann (2024), section 3.1.1, states 0.1 to 0.5 mm and 0.004 to 0.018 degrees for the lidar "
    "on the INS, taking the errors of all poses as independent.",
    "camera_clock": "Sardemann et al. (2023), section 5.2, state 0.004 s for the offset of the camera clock.",
}
"""What the papers state for the same block."""

MOST_ROWS: Final = 30
"""Longer tables are shortened."""

LONG_REASON: Final = 60
"""Letters that a column of a table holds."""

UNITS: Final = ("mm", "m", "deg", "px", "ms", "s", "ppm")

FRAMES_NOTE: Final = (
    "Errors of rotations are small rotations about the axes of the target frame. They are not errors of "
    "omega, phi and kappa: at phi = -90 degrees, the mount of the lidar, omega and kappa turn about one axis."
)
TWIN_NOTE: Final = (
    "The digital twin made these recordings. The figures speak of the software and of the models of the "
    "instruments, not of a real boat."
)


def calibration_page(
    calibrations: Sequence[Calibration],
    tables: Sequence[tuple[str, pd.DataFrame]] = (),
    *,
    pictures: Sequence[Path] = (),
    captions: Mapping[str, str] | None = None,
    truth: pd.DataFrame | None = None,
    facts: Mapping[str, Mapping[str, Any]] | None = None,
    notes: Sequence[str] = (),
    title: str = "Calibration",
    twin: bool = False,
) -> Page:
    """The page of a calibration campaign.

    Parameters
    ----------
    calibrations : shown block by block, in this order.
    tables : caption, which names the file, and table of what was used, left out and found on the way; empty
        ones are said to be so, long ones shortened.
    pictures : PNG files, shown in their order.
    captions : stem of a picture -> its caption.
    truth : for a twin, errors against the true places, columns of `thalweg_lab.truth.calibration`.
    facts : reports of the jobs by name: ``camera_clock``, ``clock_stability``, ``ins_lidar``; what ``field``
        and ``camera`` left out.
    notes : sentences for the end: limits, warnings.
    title : heading.
    twin : true if the digital twin made the recordings.

    Raises
    ------
    InputError : a picture is missing.
    """
    facts = facts or {}
    page = Page(title, *head(calibrations, facts))
    if twin:
        page.text(TWIN_NOTE)
    shown: dict[str, tuple[str, AnyArray]] = {}
    for calibration in calibrations:
        _result(page, calibration, shown)
    _clock(page, facts)
    run = facts.get("ins_lidar", {}).get("facts", {})
    if words := process_words(run):
        page.section("Errors of the poses in the run").text(words)
        page.table(
            process_table(run), "Sizes in metres and degrees, times in seconds; range of 95 %", digits=3
        )
    if truth is not None and len(truth):
        _truth(page, truth)
    page.pictures(pictures, captions)
    remarks = [line for name in ("field", "camera") for line in left_out(facts.get(name, {}))]
    if tables or remarks:
        page.section("Observations used and left out")
    if remarks:
        page.text("\n\n".join(remarks))
    for caption, table in tables:
        _table(page, caption, table)
    if notes:
        page.section("Limits").text("\n\n".join(notes))
    return page


def write_calibration_page(
    *,
    calibrations: list[Path],
    tables: list[Path],
    facts: list[Path],
    truth: list[Path],
    pictures: list[Path],
    captions: dict[str, str],
    title: str,
    twin: bool,
    page: Path,
) -> None:
    """The same from files, as the workflow has them; `truth`: none or one, `title`: of the campaign."""
    calibration_page(
        [read_calibration(path) for path in calibrations],
        [
            (f"{path.stem.replace('_', ' ').capitalize()} ({path.name})", read_figure_table(path))
            for path in tables
        ],
        pictures=pictures,
        captions=captions,
        truth=read_figure_table(truth[0]) if truth else None,
        facts={path.stem: read_json(path) for path in facts},
        title=f"Calibration: {title}",
        twin=twin,
    ).write(page)


def _table(page: Page, caption: str, table: pd.DataFrame) -> None:
    if not len(table):
        page.text(f"{caption}: none.")
        return
    if len(table) > MOST_ROWS and "reason" in table:
        groups = table.groupby(table["reason"].fillna("").astype(str), sort=True).size()
        counts = pd.DataFrame({"reason": groups.index, "rows": groups.to_numpy()})
        caption = f"{caption}: {count(len(table))} rows, counted by reason"
        table = counts.sort_values("rows", ascending=False, kind="stable")
    elif len(table) > MOST_ROWS:
        caption = f"{caption}: first {MOST_ROWS} of {count(len(table))} rows, all of them in the file"
    shown, units = with_units(table.head(MOST_ROWS))
    if "reason" in shown:
        shown = shown.assign(reason=shown["reason"].fillna("").astype(str).map(_first_clause))
    page.table(shown, caption, units)


def _first_clause(words: str) -> str:
    """Long reasons up to their first semicolon: the whole stands in the file."""
    head, cut, _ = words.partition(";")
    return f"{head} ..." if cut and len(words) > LONG_REASON else words


def with_units(table: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, str]]:
    """Columns with words for names, and their units, which the names of a file end with.

    Examples
    --------
    >>> with_units(pd.DataFrame({"sigma_x_mm": [0.3]}))[1]
    {'sigma x': 'mm'}
    """
    names, units = {}, {}
    for name in table.columns:
        stem, _, unit = str(name).rpartition("_")
        known = bool(stem) and unit in UNITS
        names[name] = (stem if known else str(name)).replace("_", " ")
        if known:
            units[names[name]] = "°" if unit == "deg" else unit
    if len(set(names.values())) < len(names):  # two units of one quantity
        return table, {}
    return table.rename(columns=names), units


def _clock(page: Page, facts: Mapping[str, Mapping[str, Any]]) -> None:
    clock, stability = facts.get("camera_clock"), facts.get("clock_stability")
    if clock or stability:
        page.section("Clock of the camera")
    if clock:
        page.text(clock_words(clock) + "\n\n" + PUBLISHED["camera_clock"])
        variants = clock_variants(clock)
        if len(variants):
            shown, units = with_units(variants)
            page.table(shown, "The same run under different assumptions", units)
    if stability:
        page.text(stability_words(stability))


def head(
    calibrations: Sequence[Calibration], facts: Mapping[str, Mapping[str, Any]] | None = None
) -> tuple[str, list[Finding]]:
    """The first sentence, and each block once: its sigmas, and what its residuals say of them."""
    findings: dict[str, Finding] = {}
    judged: dict[str, str] = {}
    for calibration in calibrations:
        source = calibration.source
        told = ""
        if np.isfinite(source.sigma0) and source.observations:
            told = verdict_of(source.sigma0**2, source.observations)
        for block in calibration.blocks:
            found = _finding(calibration, block, told)
            if found and (found.quantity not in findings or (told and not judged[found.quantity])):
                findings[found.quantity], judged[found.quantity] = found, told
    clock = (facts or {}).get("camera_clock")
    if clock:
        low, high = clock["sigma0_squared_band"]
        told = verdict_of_ratio(*(value**-0.5 for value in (clock["sigma0_squared"], high, low)))
        found = Finding(
            "clock of the camera, offset",
            f"{clock['offset_s']:+.4f} s",
            f"σ {1e3 * clock['sigma_offset_s']:.1f} ms; {told}",
        )
        findings[found.quantity], judged[found.quantity] = found, told
    if not findings:
        return "No block has sigmas of its own.", []
    sigmas = {
        "consistent": "agree with the residuals",
        "too optimistic": "are too small",
        "too pessimistic": "are too large",
        "too few data": "rest on too few data to judge",
    }
    verdicts = [told for told in judged.values() if told]
    counts = ", ".join(
        f"{verdicts.count(word)} of {len(findings)} {sigmas[word]}" for word in dict.fromkeys(verdicts)
    )
    sentence = f"Predicted standard deviations: {counts or 'too few data to judge'}."
    return sentence, list(findings.values())


def _finding(calibration: Calibration, block: Block, told: str) -> Finding | None:
    """Lever arm or offset of a block, with its sigmas about and along the axes; None if it has none."""
    values, cov = calibration.block(block.name)
    sigma = np.sqrt(np.diag(cov))
    name = block.name.replace("camera_lidar", "camera to lidar").replace("_", " ")
    verdict = f"; {told}" if told else ""
    if block.is_pose and sigma.any():
        turn = ", ".join(f"{s:.2g}" for s in sigma[:3])
        lever = ", ".join(f"{1e3 * s:.2g}" for s in sigma[3:])
        length = 100 * float(np.linalg.norm(values[3:]))
        words = f"σ in x, y, z: {lever} mm, about them: {turn}°{verdict}"
        return Finding(f"{name}, length of the lever arm", f"{length:.1f} cm", words)
    if "offset_s" in block.quantities:
        k = block.quantities.index("offset_s")
        return Finding(f"{name}, offset", f"{values[k]:+.4f} s", f"σ {1e3 * sigma[k]:.2g} ms{verdict}")
    return None


def _result(page: Page, calibration: Calibration, shown: dict[str, tuple[str, AnyArray]]) -> None:
    """A section on a calibration; a block that stood in one before is only named."""
    source = calibration.source
    facts = [f"Run {source.run}", source.method]
    facts += [f"{count(source.observations)} observations"] if source.observations else []
    facts += [f"sigma0 {source.sigma0:.3f}"] if np.isfinite(source.sigma0) else []
    facts += [source.created] if source.created else []
    page.section(calibration.title).text("; ".join(facts) + ".")
    first = not shown
    new = False
    for block in calibration.blocks:
        values, _ = calibration.block(block.name)
        before, known = shown.get(block.name, ("", None))
        if known is not None and np.array_equal(values, known):
            page.text(f"Block {block.name}: as under {before}.")
            continue
        shown[block.name], new = (calibration.title, values), True
        page.table(block_table(calibration, block), f"{block.name}: {block.equation}".replace(" @ ", " "))
        known_facts = ", ".join(f"{key.replace('_', ' ')}: {value}" for key, value in block.facts.items())
        remarks = [sentence(block.convention), sentence(known_facts), PUBLISHED.get(block.name, "")]
        if any(remarks):
            page.text("\n\n".join(remark for remark in remarks if remark))
    if not new:
        return
    if any(block.is_pose for block in calibration.blocks) and first:
        page.text(FRAMES_NOTE)
    page.text("Largest correlations:").lines(largest_correlations(calibration, 8))


def block_table(calibration: Calibration, block: Block) -> pd.DataFrame:
    """Value, sigma and unit of each quantity of a block, in words of as many places as the sigma warrants."""
    values, cov = calibration.block(block.name)
    rows: list[dict[str, Any]] = []
    for quantity, value, sigma in zip(block.quantities, values, np.sqrt(np.diag(cov)), strict=True):
        unit = unit_of(quantity)
        factor, shown = (1e3, "mm") if unit == "m" else (1e3, "ms") if quantity == "offset_s" else (1.0, unit)
        value_text, _, _ = with_sigma(float(value), float(sigma)).partition(" ")
        rows.append(
            {
                "quantity": quantity.removesuffix(f"_{unit}"),
                "value": value_text,
                "unit": "" if unit == "1" else unit,
                "sigma": "fixed" if sigma == 0 else f"{factor * sigma:.3g}",
                "unit of sigma": "" if shown == "1" or sigma == 0 else shown,
            }
        )
    return pd.DataFrame(rows)


def _truth(page: Page, truth: pd.DataFrame) -> None:
    page.section("Against the truth of the digital twin").text(
        "Each error is the calibrated value minus the true one, for rotations a small rotation vector about "
        "the axes of the target frame. Normalised errors are errors over their sigmas; those of consistent "
        "ones have a standard deviation of 1. The row of all six is the NEES, whose expectation is 1."
    )
    out = truth.copy()
    for unit in ("m", "s"):  # shown in thousandths
        rows = out["unit"] == unit
        out.loc[rows, ["estimated_minus_true", "sigma"]] *= 1e3
        out.loc[rows, "unit"] = f"m{unit}"
    out["quantity"] = out["quantity"].str.replace(r"_(?:m|deg|s|ppm)$", "", regex=True).str.replace("_", " ")
    out["block"] = out["block"].str.replace("_", " ")
    out = out.rename(columns={"estimated_minus_true": "calibrated minus true"})
    page.table(out, "Errors of the calibration (calibration_truth.csv)")
