"""Part of the light-sheet page: the lens of the sensor's camera from pictures of a field of markers."""

from collections.abc import Mapping
from typing import Any, Final

import pandas as pd

from thalweg.figures.calibration.page import short, with_units
from thalweg.figures.page import Page
from thalweg.figures.style import count, plural

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
