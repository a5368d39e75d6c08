"""The reach as a camera on the boat would see it, and a detail of the water line."""

import json
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from thalweg.core.errors import InputError
from thalweg.core.types import ArrayU8
from thalweg.figures.style import WIDTH_MM, count, new_figure, scale_bar, styled


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A picture and what is known of it.

    Parameters
    ----------
    image : (h, w, 3) uint8, sRGB.
    distance_m : distance of what is in the middle.
    pixel_mm : size of a pixel there.
    height_above_water_m : of the camera.
    utc : time, ISO text.
    """

    image: ArrayU8
    distance_m: float
    pixel_mm: float
    height_above_water_m: float
    utc: str


def read_view(path: Path) -> View:
    """Read a picture that the twin has written.

    Raises
    ------
    InputError : the file is missing or no such picture.
    """
    cure = "Make it again with the rule simulate_view"
    if not path.is_file():
        raise InputError("file not found", expected="a picture of the digital twin", where=path, cure=cure)
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as data:
            facts, image = json.loads(str(data["facts"])), data["image"]
        view = View(
            image=image,
            distance_m=float(facts["distance_m"]),
            pixel_mm=float(facts["pixel_mm"]),
            height_above_water_m=float(facts["height_above_water_m"]),
            utc=str(facts["utc"]),
        )
    except (KeyError, TypeError, ValueError, OSError, EOFError, BadZipFile) as error:
        raise InputError(
            f"not a picture ({error})", expected="a picture of the digital twin", where=path, cure=cure
        ) from error
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise InputError(
            f"image of shape {image.shape} and type {image.dtype}",
            expected="(h, w, 3) of uint8",
            where=path,
            cure=cure,
        )
    return view


@styled
def scene_view(bank: View, detail: View, *, title: str = "View from the boat", twin: bool = False) -> Figure:
    """The right bank from mid-river above, its water line below.

    Parameters
    ----------
    bank : wide picture from mid-river.
    detail : picture of the water line.
    title : first words of the title.
    twin : true if the digital twin made the pictures.
    """
    shares = [view.image.shape[0] / view.image.shape[1] for view in (bank, detail)]
    day, time = bank.utc[:10], bank.utc[11:19]
    pixels = sum(view.image.shape[0] * view.image.shape[1] for view in (bank, detail))
    head = f"{title}, {day} {time} UTC, n = {count(pixels)} pixels"
    figure = new_figure(WIDTH_MM * sum(shares) + 26.0, head, twin=twin)
    axes = figure.subplots(2, 1, gridspec_kw={"height_ratios": shares})
    _show(axes[0], bank, "a  Right bank from mid-river")
    _show(axes[1], detail, "b  Water line from the boat's nearest place")
    return figure


def _show(ax: Axes, view: View, name: str) -> None:
    h, w = view.image.shape[:2]
    ax.imshow(view.image, aspect="equal", interpolation="antialiased", interpolation_stage="rgba")
    ax.set_xlim(0, w)
    ax.set_ylim(h, 0)
    ax.set_xticks([])
    ax.set_yticks([])
    ax.set_title(
        f"{name}: {view.distance_m:.1f} m away, {view.pixel_mm:.1f} mm a pixel, "
        f"camera {view.height_above_water_m:.1f} m above the water",
        loc="left",
        fontsize=8,
    )
    scale_bar(ax, span_m=w * view.pixel_mm / 1000.0)
