"""Images with what of them is usable for matching (P2 Fig. 12), and the usable share of the whole series."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure

from thalweg.core.errors import CoverageError, InputError
from thalweg.core.types import ArrayB, ArrayF, ArrayU8
from thalweg.figures.calibration.tables import checked, filled
from thalweg.figures.images.pictures import read_picture
from thalweg.figures.style import BLUE, GREY, ORANGE, SKY, VERMILION, WIDTH_MM, new_figure, plural, styled
from thalweg.ingest.photos.files import Images, named_images

COLUMNS: Final = ("image", "usable_share", "water_share", "sky_share", "hull_share", "source", "note")
"""Columns of the table of masks, see `thalweg.images.masks.images`."""

EXAMPLES: Final = 3
_LONGEST_PX: Final = 900
"""Side of a picture in the figure; more would not be seen."""

_DARKER: Final = 0.42
_LINES: Final = {
    "usable_share": ("usable", VERMILION, "-"),
    "water_share": ("water", BLUE, "--"),
    "sky_share": ("sky", SKY, "-."),
    "hull_share": ("own boat", ORANGE, ":"),
}


@styled
def mask_view(
    table: pd.DataFrame,
    pictures: Mapping[str, tuple[ArrayU8, ArrayB]],
    *,
    title: str = "Masks",
    twin: bool = False,
) -> Figure:
    """Example images with masked parts dark and hatched, and shares of all images below.

    Parameters
    ----------
    table : `COLUMNS`, one row per image in order of time.
    pictures : by the names of some images, picture (h, w[, 3]) uint8 and its usable pixels (h, w).
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : a column is missing, a picture is not in the table, or differs from its mask in size.
    CoverageError : no image has a mask, or no picture is given.
    """
    rows = filled(checked(table, COLUMNS), "mask")
    share = rows["usable_share"].to_numpy(np.float64)
    if not np.isfinite(share).any() or not pictures:
        raise CoverageError("no mask to draw", expected="at least one image with its mask")
    numbers = {str(name): k for k, name in enumerate(rows["image"])}
    for name, (picture, usable) in pictures.items():
        if name not in numbers or picture.dtype != np.uint8 or picture.shape[:2] != usable.shape:
            raise InputError(
                f"picture {name} of shape {picture.shape} with a mask of {usable.shape}",
                expected="an image of the table, uint8, and a mask of its size",
            )
    n = int(np.isfinite(share).sum())
    high = max(p.shape[0] / p.shape[1] for p, _ in pictures.values())
    head = f"{title}: median usable share {100 * np.nanmedian(share):.0f} %, n = {plural(n, 'image')}"
    figure = new_figure(min(WIDTH_MM / len(pictures) * high, 110.0) + 62.0, head, twin=twin)
    parts = figure.subfigures(2, 1, height_ratios=[min(WIDTH_MM / len(pictures) * high, 110.0) + 10, 46.0])
    upper, lower = np.asarray(parts).ravel()
    axes = np.atleast_1d(upper.subplots(1, len(pictures)))
    for letter, ax, name in zip("abcdefgh", axes, pictures, strict=False):
        _picture(ax, *pictures[name])
        words = f"{letter}: image {numbers[name] + 1}, {100 * share[numbers[name]]:.0f} % usable"
        ax.set_title(words)
    _shares(lower.subplots(), rows, sorted(numbers[name] for name in pictures), "abcdefgh"[len(pictures)])
    return figure


def example_names(table: pd.DataFrame, n: int = EXAMPLES) -> list[str]:
    """Images at the 10th, 50th and 90th percentile of the usable share, in order of time.

    Raises
    ------
    CoverageError : no image has a mask.
    """
    known = table[np.isfinite(table["usable_share"].to_numpy(np.float64))]
    if not len(known):
        raise CoverageError("no image has a mask", expected="at least one")
    order = known["usable_share"].sort_values(kind="stable").index
    chosen = {order[round(q * (len(order) - 1))] for q in np.linspace(0.1, 0.9, n)}
    return [str(known["image"][k]) for k in known.index if k in chosen]


def read_examples(names: Sequence[str], images: Images, masks: Path) -> dict[str, tuple[ArrayU8, ArrayB]]:
    """Reduced pictures and usable pixels of some images.

    Parameters
    ----------
    names : of the images.
    images : of the series, by name or as files.
    masks : folder of ``<image>.png``.

    Raises
    ------
    InputError : a picture or a mask is missing, or their sizes differ.
    """
    files = named_images(images) if images else {}
    out = {}
    for name in names:
        if name not in files:
            raise InputError(f"no image {name}", expected="the images that were masked")
        picture, mask = read_picture(files[name]), read_picture(masks / f"{name}.png")
        if picture.shape[:2] != mask.shape[:2]:
            raise InputError(
                f"a mask of {mask.shape[:2]} for an image of {picture.shape[:2]} rows and columns",
                expected="equal sizes", where=masks / f"{name}.png",
            )  # fmt: skip
        step = max(-(-max(picture.shape[:2]) // _LONGEST_PX), 1)
        usable = mask[::step, ::step] if mask.ndim == 2 else mask[::step, ::step, 0]
        out[name] = (np.ascontiguousarray(picture[::step, ::step]), np.asarray(usable > 0))
    return out


def _picture(ax: Axes, picture: ArrayU8, usable: ArrayB) -> None:
    h, w = usable.shape
    rgb = picture if picture.ndim == 3 else np.repeat(picture[..., None], 3, axis=2)
    # Grey and dark: what is usable keeps its colour.
    grey = _DARKER * rgb.mean(axis=2, keepdims=True)
    shown = np.where(usable[..., None], rgb, grey).astype(np.uint8)
    ax.imshow(shown, extent=(0, w, h, 0), interpolation="antialiased")
    places = np.arange(w) + 0.5, np.arange(h) + 0.5
    if not usable.all():
        drawn = ax.contourf(*places, (~usable).astype(float), levels=[0.5, 1.5])
        look = {"facecolor": "none", "edgecolor": (1, 1, 1, 0.35), "linewidth": 0.0, "hatch": "////"}
        _replaced(ax, drawn, "masked", **look)
    if usable.any() and not usable.all():
        drawn = ax.contour(*places, usable.astype(float), levels=[0.5])
        _replaced(ax, drawn, "border", facecolor="none", edgecolor=VERMILION, linewidth=0.6)
    ax.set_xlim(0, w)
    ax.set_ylim(h, 0)
    ax.set_xticks([])
    ax.set_yticks([])


def _replaced(ax: Axes, drawn: QuadContourSet, gid: str, **look: Any) -> None:
    """Contours as plain paths: their own artist cannot be hatched without a frame."""
    paths = drawn.get_paths()
    drawn.remove()
    ax.add_collection(PathCollection(paths, gid=gid, **look), autolim=False)


def _shares(ax: Axes, rows: pd.DataFrame, examples: list[int], letter: str) -> None:
    number: ArrayF = np.arange(1, len(rows) + 1, dtype=np.float64)
    # A series of one image has points, no lines.
    marker = "." if len(rows) < 40 else ""
    for column, (label, colour, style) in _LINES.items():
        percent = 100 * rows[column].to_numpy(np.float64)
        if np.isfinite(percent).any():
            ax.plot(number, percent, color=colour, ls=style, marker=marker, ms=4, label=label, gid=column)
    for k in examples:
        ax.axvline(k + 1, color=GREY, lw=0.7, ls=":")
    ax.set_xlim(0.5, len(rows) + 0.5)
    ax.set_ylim(0, None)
    ax.set(xlabel="image / 1", ylabel="share of the image / %")
    ax.set_title(f"{letter}: parts of all images; dotted: those above")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    ax.grid()
