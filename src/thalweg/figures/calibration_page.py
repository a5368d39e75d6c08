"""One page on a calibration: what was found and how well, what it rests on, what was left out, its limits."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core.calibration import Block, Calibration, unit_of
from thalweg.figures.page import Page
from thalweg.ingest.describe_calibration import largest_correlations, with_sigma

PUBLISHED: Final = {
    "camera_lidar": "Sardemann et al. (2023), Table 1, state 1.0, 0.4 and 0.2 mm and 0.067, 0.035 and 0.015 "
    "degrees for their camera and lidar from six cones and three positions.",
    "lidar": "Sardemann (2024), section 3.1.1, states 0.1 to 0.5 mm and 0.004 to 0.018 degrees for the lidar "
    "on the INS, taking the errors of all poses as independent.",
    "camera_clock": "Sardemann et al. (2023), section 5.2, state 0.004 s for the offset of the camera clock.",
}
"""What the papers state for the same block."""

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
    notes: Sequence[str] = (),
    title: str = "Calibration",
    twin: bool = False,
) -> Page:
    """The page of a calibration campaign.

    Parameters
    ----------
    calibrations : shown block by block, in this order.
    tables : caption and table of what was used, left out and found on the way; empty ones are said to be so.
    pictures : PNG files, shown in their order.
    captions : stem of a picture -> its caption.
    truth : for a twin, errors against the true places, columns of `thalweg.accuracy.calibration_truth`.
    notes : sentences for the end: limits, warnings.
    title : heading.
    twin : true if the digital twin made the recordings.

    Raises
    ------
    InputError : a picture is missing.
    """
    page = Page(title, summary(calibrations))
    if twin:
        page.text(TWIN_NOTE)
    for calibration in calibrations:
        _result(page, calibration)
    if pictures:
        page.section("Figures")
    for picture in pictures:
        page.figure(picture, (captions or {}).get(picture.stem, picture.stem.replace("_", " ")))
    if tables:
        page.section("What was used, and what was not")
    for caption, table in tables:
        if len(table):
            page.table(short(table), caption)
        else:
            page.text(f"{caption}: none.")
    if truth is not None and len(truth):
        _truth(page, truth)
    if notes:
        page.section("Limits").text("\n\n".join(notes))
    return page


def summary(calibrations: Sequence[Calibration]) -> str:
    """The first sentences: each block with its sigmas in words."""
    sentences = []
    for calibration in calibrations:
        for block in calibration.blocks:
            words = _block_in_words(calibration, block)
            if words:
                sentences.append(words)
    return " ".join(sentences) or "No block has sigmas of its own."


def _block_in_words(calibration: Calibration, block: Block) -> str:
    values, cov = calibration.block(block.name)
    sigma = np.sqrt(np.diag(cov))
    name = block.name.replace("_", " ")
    if block.is_pose and sigma.any():
        turn = ", ".join(f"{s:.3g}" for s in sigma[:3])
        lever = ", ".join(f"{1e3 * s:.2g}" for s in sigma[3:])
        length = 100 * float(np.linalg.norm(values[3:]))
        return (
            f"{name.capitalize()}: lever arm of {length:.1f} cm with sigmas of {lever} mm, "
            f"rotation with sigmas of {turn} degrees."
        )
    if "offset_s" in block.quantities:
        k = block.quantities.index("offset_s")
        return f"{name.capitalize()}: offset {values[k]:+.4f} s, sigma {1e3 * sigma[k]:.2g} ms."
    return ""


def _result(page: Page, calibration: Calibration) -> None:
    source = calibration.source
    facts = [f"Run {source.run}", source.method]
    facts += (
        [f"{source.observations:,} observations".replace(",", "\N{NO-BREAK SPACE}")]
        if source.observations
        else []
    )
    facts += [f"sigma0 {source.sigma0:.3f}"] if np.isfinite(source.sigma0) else []
    facts += [source.created] if source.created else []
    page.section(calibration.title).text("; ".join(facts) + ".")
    for block in calibration.blocks:
        page.table(block_table(calibration, block), f"{block.name}: {block.equation}")
        remarks = [block.convention, ", ".join(f"{key}: {value}" for key, value in block.facts.items())]
        remarks += [PUBLISHED.get(block.name, "")]
        if any(remarks):
            page.text("\n\n".join(remark for remark in remarks if remark))
    if any(block.is_pose for block in calibration.blocks):
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
        rows.append({
            "quantity": quantity.removesuffix(f"_{unit}"),
            "value": value_text,
            "unit": "" if unit == "1" else unit,
            "sigma": "fixed" if sigma == 0 else f"{factor * sigma:.3g}",
            "unit of sigma": "" if shown == "1" else shown,
        })  # fmt: skip
    return pd.DataFrame(rows)


def short(frame: pd.DataFrame, digits: int = 4) -> pd.DataFrame:
    """Fractions rounded to significant digits; whole numbers stay."""
    return pd.DataFrame({
        name: column.map(lambda x: float(f"{x:.{digits}g}")) if column.dtype.kind == "f" else column
        for name, column in frame.items()
    })  # fmt: skip


def _truth(page: Page, truth: pd.DataFrame) -> None:
    page.section("Against the truth of the digital twin").text(
        "Each error is the calibrated value minus the true one, for rotations a small rotation vector about "
        "the axes of the target frame. Normalised errors are errors over their sigmas; those of honest ones "
        "have a standard deviation of 1. The row of all six is the normalised square, whose expectation is 1."
    )
    out = truth.copy()
    metres = out["unit"] == "m"
    for name in ("estimated_minus_true", "sigma"):
        out.loc[metres, name] = 1e3 * out.loc[metres, name]
    out.loc[metres, "unit"] = "mm"
    out["quantity"] = out["quantity"].str.replace(r"_(?:m|deg)$", "", regex=True).str.replace("_", " ")
    out = out.rename(columns={"estimated_minus_true": "calibrated minus true"})
    page.table(short(out, 3), "Errors of the calibrated places")
