"""Signed distance of the cloud to the reference surface, mapped on the bank (P2 Fig. 14, T Fig. 3.2).

The map is drawn in the plane of the bank: along the bank to the right as one looks at it from the river, and
up its slope. A long bank is cut into strips that lie below each other, all at one scale.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from thalweg.accuracy import CLOUD_TO_MESH
from thalweg.core import ArrayF, ArrayI, read_json, read_table
from thalweg.core.geometry import RayCaster, TriangleMesh, read_mesh
from thalweg.figures import WIDTH_MM, colour_bar, count, new_figure, round_length, scale_bar, styled, thinned
from thalweg.figures.accuracy.distances import bank_frame_of, compared, round_limit_m, statistics_text
from thalweg.surface import BankFrame

DISTANCE_MAP: Final[Colormap] = ListedColormap(cm.vik(np.linspace(0.08, 0.92, 256)), "thalweg_distance")
"""Blue behind the reference, brown in front of it, light in between; without the ends: both are black."""

BEHIND: Final = "behind the reference\n(into the bank)"
FRONT: Final = "in front of the reference\n(toward the river)"

MOST_STRIPS: Final = 8
STRIPS_MM: Final = 165.0
"""Most strips of a map, and the height that they share at most."""

STRIP_MM: Final = 8.0
"""Height of what stands about a strip, its numbers."""

CELL_MM: Final = 0.2
"""Least size on paper of a cell of which the median is drawn."""

POINTS_IN_CELL: Final = 3.0
"""Cells are large enough to hold so many points on the mean."""

STRAYS: Final = 0.01
"""Share of the points of a strip that may lie above its upper edge, and below its lower one."""

LEFT_OUT: Final = (0.25, 0.25, 0.25)
"""Colour of cells whose points were all left out."""

_DRAWN_MM: Final = WIDTH_MM - 22.0
_LIGHT: Final = np.array([-0.45, 0.55, 0.70])
"""Direction to the light in the bank's frame: from the upper left, in front."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Strip:
    """A piece of the map: its ends along the bank and up the slope, metres in the bank's frame."""

    along_m: tuple[float, float]
    up_slope_m: tuple[float, float]

    @property
    def size_m(self) -> tuple[float, float]:
        """Length along the bank and height up the slope."""
        return self.along_m[1] - self.along_m[0], self.up_slope_m[1] - self.up_slope_m[0]


def strips(bank_m: ArrayF) -> list[Strip]:
    """Pieces of equal length that show points at the largest scale that the height of the page allows.

    Parameters
    ----------
    bank_m : (n, 2 or 3) points in the bank's frame.
    """
    along = bank_m[:, 0]
    low, high = float(along.min()), float(along.max())
    best: list[Strip] = []
    for n in range(1, MOST_STRIPS + 1):
        edges = np.linspace(low, max(high, low + 1.0), n + 1)
        index = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, n - 1)
        margin = 0.02 * float(edges[1] - edges[0])
        found = []
        for k in range(n):
            up = bank_m[index == k, 1]
            if up.size:
                # Single strays up or down the slope would make the strip high and empty.
                bottom, top = (float(v) for v in np.percentile(up, [100 * STRAYS, 100 * (1 - STRAYS)]))
                ends = (float(edges[k]), float(edges[k + 1]))
                found.append(Strip(along_m=ends, up_slope_m=(bottom - margin, top + margin)))
        height_mm = sum(s.size_m[1] for s in found) / (edges[1] - edges[0]) * _DRAWN_MM + STRIP_MM * n
        if best and height_mm > STRIPS_MM:
            break
        best = found
    return best


@styled
def distance_map(
    table: pd.DataFrame,
    mesh: TriangleMesh,
    bank: BankFrame,
    *,
    limit_m: float | None = None,
    max_distance_m: float = np.inf,
    max_points: int = 2_000_000,
    title: str = "Distance of the cloud to the reference",
) -> Figure:
    """Median signed distance of the points in each cell of the bank, over the shaded reference.

    Parameters
    ----------
    table : of kind ``cloud_to_mesh``.
    mesh : the reference surface, shown in grey where no point lies.
    bank : frame of the map.
    limit_m : distance at both ends of the colour scale; from median and NMAD by default.
    max_distance_m : points farther off were left out for that, whether near the border or not.
    max_points : points drawn at most, evenly thinned; the numbers in the titles are those of all points.
    title : first words of the title.

    Raises
    ------
    InputError : a column is missing.
    CoverageError : no point was compared.
    """
    used = compared(table)
    distance_m = used["distance_m"].to_numpy()
    drawn = thinned(used, max_points)
    aside = table[table["at_border"] & ~table["used"] & (table["distance_m"].abs() <= max_distance_m)]
    place, place_aside = (
        bank.to_bank(each[["east_m", "north_m", "up_m"]].to_numpy())
        for each in (drawn, thinned(aside, max_points))
    )
    pieces = strips(np.concatenate([place, place_aside]))
    # strips fill the width unless they would be too high
    m_per_mm = max(
        max(piece.size_m[0] for piece in pieces) / _DRAWN_MM,
        sum(piece.size_m[1] for piece in pieces) / (STRIPS_MM - STRIP_MM * len(pieces)),
    )
    limit, cell_m = limit_m or round_limit_m(distance_m), _cell_m(place, m_per_mm)
    heights = [piece.size_m[1] / m_per_mm for piece in pieces]
    head = f"{title}, n = {count(len(used))} points, {statistics_text(distance_m)}"
    figure = new_figure(sum(heights) + STRIP_MM * len(pieces) + 54.0, head)
    panels = list(figure.subplots(len(pieces), 1, height_ratios=heights, squeeze=False)[:, 0])
    caster = RayCaster(bank.to_bank(mesh.vertices_m), mesh.faces)
    shown = np.zeros(len(place), dtype=bool)
    for ax, piece in zip(panels, pieces, strict=True):
        _draw_reference(ax, caster, piece)
        _draw_cells(ax, piece, place, drawn["distance_m"].to_numpy(), place_aside, limit, cell_m)
        low, high = np.transpose([piece.along_m, piece.up_slope_m])
        shown |= np.all((place[:, :2] >= low) & (place[:, :2] <= high), axis=1)
        ax.set(aspect="equal", xlim=piece.along_m, ylim=piece.up_slope_m, ylabel="up slope / m")
        ax.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    panels[0].set_title(_subtitle(used, len(aside), bank, 1.0 - float(np.mean(shown))))
    panels[-1].set_xlabel("along the bank, to the right as seen from the river / m")
    scale_bar(panels[-1], span_m=pieces[-1].size_m[0], xy=(0.02, 0.08))
    words = f"signed distance to the reference, median of each cell of {100 * cell_m:g} cm / cm"
    look = {"location": "bottom", "aspect": 55, "shrink": 0.8, "pad": 0.02, "extend": "both"}
    bar = colour_bar(panels, DISTANCE_MAP, (-100 * limit, 100 * limit), words, **look)
    for x, side, words, beyond in (
        (0.0, "left", BEHIND, distance_m < -limit),
        (1.0, "right", FRONT, distance_m > limit),
    ):
        bar.ax.annotate(
            f"{words}\nbeyond the end: n = {count(beyond.sum())}", (x, 1.0), (0, 3), "axes fraction",
            "offset points", ha=side, va="bottom", fontsize=7, gid=f"end-{side}",
        )  # fmt: skip
    figure.align_ylabels(panels)
    return figure


def view_text(bank: BankFrame) -> str:
    """``looking toward 187°``: from the river onto the bank."""
    along = bank.R_bank_wcs[0]
    azimuth = np.rad2deg(np.arctan2(-along[1], along[0])) % 360.0
    return f"looking toward {azimuth:.0f}°"


def _subtitle(used: pd.DataFrame, n_border: int, bank: BankFrame, share_beyond: float) -> str:
    kept = used.loc[~used["outlier"].to_numpy(bool), "distance_m"].to_numpy()
    first = f"without {count(len(used) - len(kept))} outliers: {statistics_text(kept)}" if kept.size else ""
    beyond = f"beyond the map: {100 * share_beyond:.2g} % of n" if share_beyond else ""
    grey = "light grey: reference without points"
    grey += f"; dark grey: left out at its border, n = {count(n_border)}" if n_border else ""
    return "\n".join(
        ["; ".join(filter(None, [first, beyond])), f"seen from the river, {view_text(bank)}", grey]
    )


def _cell_m(place: ArrayF, m_per_mm: float) -> float:
    """Size of the cells: seen on paper, and large enough for a median, rounded to 1, 2, 5."""
    on_paper = CELL_MM * m_per_mm
    coarse = np.unique(np.floor(place[:, :2] / (4 * on_paper)).astype(np.int64), axis=0)
    density = len(place) / (len(coarse) * (4 * on_paper) ** 2)
    wanted = max(on_paper, float(np.sqrt(POINTS_IN_CELL / density)))
    low = round_length(wanted)
    return low if low >= 0.999 * wanted else round_length(2.5 * low)


def _draw_reference(ax: Axes, caster: RayCaster, piece: Strip, width_px: int = 1600) -> None:
    """The reference in grey, lit from the upper left; white where it has a hole."""
    pixel = piece.size_m[0] / width_px
    height_px = max(int(np.ceil(piece.size_m[1] / pixel)), 1)
    along = piece.along_m[0] + (np.arange(width_px) + 0.5) * pixel
    up = piece.up_slope_m[1] - (np.arange(height_px) + 0.5) * pixel
    origins = np.empty((height_px * width_px, 3))
    origins[:, 0], origins[:, 1], origins[:, 2] = np.tile(along, height_px), np.repeat(up, width_px), 1000.0
    hits = caster.cast(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape))
    light = np.clip(hits.normal @ (_LIGHT / np.linalg.norm(_LIGHT)), 0.0, 1.0)
    grey = np.where(hits.primitive >= 0, 0.62 + 0.33 * light, 1.0).reshape(height_px, width_px)
    box = (*piece.along_m, piece.up_slope_m[1] - height_px * pixel, piece.up_slope_m[1])
    ax.imshow(grey, extent=box, cmap="gray", vmin=0, vmax=1, interpolation="antialiased")


def _draw_cells(
    ax: Axes, piece: Strip, place: ArrayF, distance_m: ArrayF, aside: ArrayF, limit_m: float, cell_m: float
) -> None:
    """The median of each cell; dark grey where all points were left out."""
    left, bottom = piece.along_m[0], piece.up_slope_m[0]
    columns, rows = (int(np.ceil(size / cell_m)) for size in piece.size_m)

    def cells(points: ArrayF) -> ArrayI:
        """Cell of each point, -1 outside the strip."""
        column, row = np.floor((points[:, :2] - [left, bottom]) / cell_m).astype(np.int64).T
        inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        return np.where(inside, row * columns + column, -1)

    index, left_out = cells(place), cells(aside)
    medians = pd.Series(distance_m[index >= 0]).groupby(index[index >= 0]).median()
    picture = np.zeros((rows * columns, 4))
    picture[left_out[left_out >= 0]] = (*LEFT_OUT, 1.0)
    picture[medians.index] = DISTANCE_MAP(Normalize(-limit_m, limit_m)(medians.to_numpy()))
    ax.imshow(
        picture.reshape(rows, columns, 4),
        extent=(left, left + columns * cell_m, bottom, bottom + rows * cell_m),
        origin="lower",
        interpolation="nearest",
        zorder=2,
        gid="distances",
    )


def draw_distance_map(
    *, comparison: Path, mesh: Path, mesh_facts: Path, max_points: int, title: str
) -> Figure:
    """Comparison and reference mesh -> map of the distances on the bank."""
    table, facts = read_table(comparison, CLOUD_TO_MESH)
    return distance_map(
        table,
        read_mesh(mesh)[0],
        bank_frame_of(read_json(mesh_facts)),
        max_distance_m=facts["max_distance_m"],
        max_points=max_points,
        title=f"Distance to the reference: {title}",
    )
