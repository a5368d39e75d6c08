"""A camera that stays: history of its place from picture to picture, and its page."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from thalweg.accuracy import verdict_of
from thalweg.figures import (
    BLUE,
    GREEN,
    GREY,
    VERMILION,
    Finding,
    Page,
    Pictures,
    count,
    new_figure,
    plural,
    styled,
)
from thalweg.figures.calibration import with_units

_AXES: Final = (("x", BLUE, "o"), ("y", VERMILION, "s"), ("z", GREEN, "^"))
_MOST_NAMES: Final = 24


@styled
def pose_history(poses: pd.DataFrame, *, title: str = "Place of the fixed camera") -> Figure:
    """Place in each picture less the mean, with the standard deviation by the marks; residuals below.

    Parameters
    ----------
    poses : of `thalweg.images.resect_pictures`.
    title : first words of the title.
    """
    good = (poses["refused"].fillna("") == "").to_numpy()
    number = np.arange(1, len(poses) + 1, dtype=np.float64)
    head = f"{title}, n = {count(good.sum())} of {plural(len(poses), 'picture')}"
    figure = new_figure(130.0, head)
    axes = np.ravel(figure.subplots(4, 1, sharex=True))
    for ax, (axis, colour, marker) in zip(axes, _AXES, strict=False):
        sigma = poses[f"sigma_change_{axis}_m"].to_numpy(float)[good]
        value = poses[f"{axis}_m"].to_numpy(float)[good]
        off = value - np.average(value, weights=sigma**-2)
        ax.errorbar(number[good], off, yerr=sigma, fmt=marker, ms=4, color=colour, capsize=2)
        ax.axhline(0.0, color="black", lw=0.7)
        ax.set_ylabel(f"{axis} less mean\n/ m")
        ax.grid(axis="y")
    axes[0].set_title("standard deviations of the marks alone: points and lens are common to all pictures")
    axes[3].plot(
        number[good], poses["rms_px"].to_numpy(float)[good], "o", ms=4, color="black", label="control points"
    )
    check = poses["check_rms_px"].to_numpy(float)
    if np.isfinite(check).any():
        axes[3].plot(number, check, "s", ms=4, color=GREEN, label="check points")
        axes[3].legend()
    axes[3].set_ylim(0, None)
    axes[3].set_ylabel("rms of the\nmarks / px")
    axes[3].grid(axis="y")
    for k in number[~good]:
        for ax in axes:
            ax.axvline(k, color=GREY, lw=0.8, ls=":")
    step = -(-len(poses) // _MOST_NAMES)
    axes[3].set_xticks(
        number[::step], poses["image"].astype(str).tolist()[::step], rotation=90 if len(poses) > 6 else 0
    )
    axes[3].set_xlabel("picture; dotted: refused")
    return figure


def fixed_camera_page(
    facts: Mapping[str, Any],
    poses: pd.DataFrame,
    pictures: Pictures,
    *,
    captions: Mapping[str, str],
    title: str = "Fixed camera",
) -> Page:
    """The page of a camera that stays.

    Parameters
    ----------
    facts, poses : of `thalweg.images.resect_pictures`.
    pictures, captions : by name.
    title : heading.
    """

    def metres(name: str) -> str:
        """Three coordinates of the facts, to the millimetre."""
        return " / ".join(f"{v:.3f}" for v in facts[name].values())

    still = "too few data"
    if facts["normalised"] is not None:
        told = verdict_of(facts["normalised"], facts["degrees"])
        still = {
            "consistent": "the camera stood still",
            "too optimistic": "the camera moved, or marks are worse than stated",
            "too pessimistic": "the camera stood still; marks are better than stated",
        }.get(told, told)
    missing = facts["pictures"] - facts["with_pose"]
    spread = (
        f"{metres('spread_m')} m, predicted {metres('predicted_m')} m" if facts["spread_m"] else "one picture"
    )
    findings = [
        Finding(
            "pictures with a pose",
            f"{facts['with_pose']} of {facts['pictures']}",
            f"{missing} refused" if missing else "",
        ),
        Finding("position, mean, x, y, z", f"{metres('place_m')} m"),
        Finding("its standard deviation, one picture", f"{metres('sigma_m')} m"),
        Finding("spread from picture to picture", spread, still),
        Finding("rms of the marks", f"{facts['rms_px']:.2f} px"),
        *(
            Finding(f"lens, {name}", f"{p['value']:.6g}", f"± {p['sigma']:.2g}")
            for name, p in facts["lens"].items()
        ),
    ]
    page = Page(title, f"From picture to picture: {still}.", findings)
    page.pictures(pictures, captions, section="History")
    shown = poses.filter(regex="^(?!q.$|sigma_change)").fillna({"refused": ""})
    shown.insert(1, "refused", shown.pop("refused"))
    shown, units = with_units(shown)
    page.section("Pictures").table(shown, "Pose of each picture, or why there is none.", units, digits=5)
    if facts["notes"]:
        page.section("Notes").lines(facts["notes"])
    return page
