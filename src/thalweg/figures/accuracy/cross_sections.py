"""Cross sections through cloud and reference, the cloud coloured by the place of the boat (P2 Fig. 15).

A section is a vertical plane across the bank. Points within half of the slab's thickness on either side of it
are drawn as if they lay in it. Looked at along the bank, the river is on the left.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from thalweg.accuracy import CLOUD_TO_MESH
from thalweg.core import ArrayF, Trajectory, iter_laz, read_json, read_table
from thalweg.core.geometry import TriangleMesh, read_mesh
from thalweg.figures import BLUE, TIME_MAP, WIDTH_MM, colour_bar, count, new_figure, scale_bar, styled
from thalweg.figures.accuracy.distances import bank_frame_of, compared, round_above
from thalweg.surface import BankFrame

PLACE_MAP: Final[Colormap] = ListedColormap(TIME_MAP(np.linspace(0.05, 0.88, 256)), "thalweg_place")
"""From dark to light along the bank; without the end that vanishes on paper."""

ZOOM_SHARE: Final = 0.1
"""Width of the magnified piece, as a share of the section's width."""

LEAST_ZOOM_M: Final = 1.0
MOST_ZOOM_M: Final = 1.6
"""A magnified piece is so wide: errors of centimetres are to be seen, and some of the bank about them."""

ZOOM_SHAPE: Final = 0.85
"""Height over width of the magnified piece."""

WIDEST_M: Final = 25.0
"""Most metres of a section that are drawn: those that hold most points."""

STRAYS: Final = 0.01
"""Share of the points near a section that may lie beyond either end of its picture."""

MARGIN_M: Final = 0.5
"""Free border about the compared points of a section."""

LEAST_ROW_MM: Final = 36.0
MOST_ROW_MM: Final = 75.0
_LEFT_SHARE: Final = 0.62
_FRAME_MM: Final = 16.0

ABOUT_AS_MANY: Final = 0.6
"""A piece this good, in units of the best, may be magnified: root of its points times places of the boat."""

ABREAST_M: Final = 5.0
"""Boat positions are told apart by so many metres when the piece to be magnified is looked for."""


@dataclass(slots=True, kw_only=True)
class Section:
    """A slab across the bank and what was found in it.

    Parameters
    ----------
    along_m : place of the plane along the bank, in the bank's frame.
    across_m, height_m : ends of the picture: metres from the bank frame's origin away from the river, and
        heights in wcs.
    """

    along_m: float
    across_m: tuple[float, float]
    height_m: tuple[float, float]
    cloud: list[ArrayF] = field(default_factory=list)
    reference: list[ArrayF] = field(default_factory=list)

    def points(self, which: str) -> ArrayF:
        """Points (n, 3) of ``cloud`` or ``reference``: across, height, and GPS time (NaN if unknown)."""
        parts: list[ArrayF] = getattr(self, which)
        return np.concatenate(parts) if parts else np.empty((0, 3))


class Slabs:
    """Slabs at the wanted stations; points come in chunks.

    Parameters
    ----------
    table : of kind ``cloud_to_mesh``: its compared points say where the area of the comparison is.
    bank : frame of the bank.
    options : section ``accuracy.sections``: ``count`` sections spread evenly over the area, or ``stations_m``
        from its middle; ``thickness_m`` of a slab.

    Raises
    ------
    CoverageError : no point was compared.
    """

    def __init__(self, table: pd.DataFrame, bank: BankFrame, options: Mapping[str, Any]) -> None:
        self.bank = bank
        self.thickness_m = float(options["thickness_m"])
        points_m = compared(table)[["east_m", "north_m", "up_m"]].to_numpy()
        along, across = self._place(points_m)
        low, high = np.percentile(along, [0.5, 99.5])
        self.middle_m = float(0.5 * (low + high))
        wanted = options["stations_m"]
        if wanted is None:
            n = int(options["count"])
            wanted = (np.arange(n) + 0.5 - 0.5 * n) * (high - low) / n
        self.sections = [
            self._section(self.middle_m + float(station), along, across, points_m[:, 2]) for station in wanted
        ]

    def add(self, which: str, points_wcs_m: ArrayF, t_gps_s: ArrayF | None = None) -> None:
        """Add the points of a chunk that lie in a slab and in its picture to ``cloud`` or ``reference``."""
        along, across = self._place(points_wcs_m)
        t = np.full(len(along), np.nan) if t_gps_s is None else t_gps_s
        points = np.stack([across, points_wcs_m[:, 2], t], axis=1)
        for section in self.sections:
            low, high = np.transpose([section.across_m, section.height_m])
            inside = np.abs(along - section.along_m) <= 0.5 * self.thickness_m
            inside &= np.all((points[:, :2] >= low) & (points[:, :2] <= high), axis=1)
            getattr(section, which).append(points[inside])

    def boat_along_m(self, section: Section, trajectory: Trajectory) -> ArrayF:
        """Place (n,) of the boat along the bank, from the section, when it measured a point; NaN: unknown."""
        t = section.points("cloud")[:, 2]
        track, valid = trajectory.position_wcs_m, trajectory.valid
        if not len(t) or valid.sum() < 2:
            return np.full(len(t), np.nan)
        along = self._place(track[valid])[0] - section.along_m
        return np.interp(t, trajectory.t_gps_s[valid], along, left=np.nan, right=np.nan)

    def water_m(self, section: Section, trajectory: Trajectory, water_line_ics_m: float) -> float | None:
        """Height of the water where the boat passed nearest to a section; None without a pose."""
        track = trajectory.position_wcs_m[trajectory.valid]
        if not len(track):
            return None
        nearest = int(np.argmin(np.abs(self._place(track)[0] - section.along_m)))
        return float(track[nearest, 2]) - water_line_ics_m

    def cut(self, section: Section, mesh: TriangleMesh) -> ArrayF:
        """Where a section's plane cuts the reference: pieces of line (m, 2, 2) of across and height."""
        ahead = self._place(mesh.vertices_m)[0] - section.along_m
        corners = ahead[mesh.faces]
        crossed = mesh.faces[(corners.min(axis=1) < 0) & (corners.max(axis=1) >= 0)]
        ends = []
        side = ahead[crossed] >= 0
        # The corner that is alone on its side: both edges that meet there are cut.
        alone = np.where(side.sum(axis=1) == 1, np.argmax(side, axis=1), np.argmin(side, axis=1))
        rows = np.arange(len(crossed))
        tip = crossed[rows, alone]
        for k in (1, 2):
            other = crossed[rows, (alone + k) % 3]
            share = (ahead[tip] / (ahead[tip] - ahead[other]))[:, None]
            place = mesh.vertices_m[tip] * (1.0 - share) + mesh.vertices_m[other] * share
            ends.append(np.stack([self._place(place)[1], place[:, 2]], axis=1))
        return np.stack(ends, axis=1)

    def _place(self, points_wcs_m: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Metres along the bank, and horizontal ones across it away from the river: up x along."""
        a, off = self.bank.R_bank_wcs[0], points_wcs_m - self.bank.origin_m
        return off @ a, off[:, :2] @ np.array([-a[1], a[0]])

    def _section(self, at_m: float, along: ArrayF, across: ArrayF, height: ArrayF) -> Section:
        near = np.abs(along - at_m) <= max(0.5 * self.thickness_m, 0.5)
        if not near.any():
            return Section(along_m=at_m, across_m=(0.0, 1.0), height_m=(0.0, 1.0))
        start = _fullest(across[near], WIDEST_M)
        near &= (across >= start) & (across <= start + WIDEST_M)
        (left, right), (bottom, top) = _ends(across[near]), _ends(height[near])
        return Section(along_m=at_m, across_m=(left, right), height_m=(bottom, top))


@styled
def cross_sections(
    slabs: Slabs,
    mesh: TriangleMesh,
    trajectory: Trajectory,
    *,
    water_line_ics_m: float | None = None,
    title: str = "Cross sections of cloud and reference",
) -> Figure:
    """A row for each section: the whole of it on the left, a piece of it magnified on the right.

    Parameters
    ----------
    slabs : with the points of cloud and reference.
    mesh : the reference surface.
    trajectory : the boat.
    water_line_ics_m : depth of the water line below the ics origin; None: no water is drawn.
    title : first words of the title.
    """
    places = [slabs.boat_along_m(section, trajectory) for section in slabs.sections]
    n = sum(len(place) for place in places)
    known = np.abs(np.concatenate(places))
    known = known[np.isfinite(known)]
    reach = round_above(max(float(np.percentile(known, 95.0)), 1.0)) if known.size else 1.0
    norm = Normalize(-reach, reach)
    rows = [_row_mm(section) for section in slabs.sections]
    head = f"{title}, slabs of {100 * slabs.thickness_m:g} cm, n = {count(n)} points"
    figure = new_figure(sum(rows) + 30.0, head)
    panels = figure.subplots(
        len(rows), 2, squeeze=False, height_ratios=rows, width_ratios=[_LEFT_SHARE, 1.0 - _LEFT_SHARE]
    )
    for (whole, zoom), section, place in zip(panels, slabs.sections, places, strict=True):
        water = None if water_line_ics_m is None else slabs.water_m(section, trajectory, water_line_ics_m)
        _draw_row(whole, zoom, section, place, slabs, mesh, norm, water)
    panels[-1][0].set_xlabel("across the bank, away from the river / m")
    panels[-1][1].set_xlabel("across the bank / m")
    words = "distance of the boat along the bank from the section / m"
    look = {"location": "bottom", "aspect": 55, "shrink": 0.8, "pad": 0.02}
    colour_bar(panels, PLACE_MAP, norm, words, **look, extend="both" if (known > reach).any() else "neither")
    figure.align_ylabels(list(panels[:, 0]))
    looks: list[dict[str, Any]] = [
        {"color": "black", "lw": 1.2, "label": "reference surface"},
        {"ls": "none", "marker": ".", "color": "0.55", "label": "reference points"},
        {"color": BLUE, "lw": 0.8, "ls": (0, (6, 2)), "label": "water level at the boat"},
        {"ls": "none", "marker": "s", "mfc": "none", "mec": "black", "label": "magnified piece"},
    ]
    shown = [look for look in looks if water_line_ics_m is not None or "water" not in look["label"]]
    handles = [Line2D([], [], **look) for look in shown]
    figure.legend(handles=handles, loc="outside lower left", ncols=len(handles))
    return figure


def _draw_row(
    whole: Axes,
    zoom: Axes,
    section: Section,
    place: ArrayF,
    slabs: Slabs,
    mesh: TriangleMesh,
    norm: Normalize,
    water_m: float | None,
) -> None:
    points, reference = section.points("cloud"), section.points("reference")
    station = section.along_m - slabs.middle_m
    name = f"station {station:+.0f} m".replace("-", "\N{MINUS SIGN}") if round(station) else "station 0 m"
    whole.set_title(f"{name}: cloud n = {count(len(points))}, reference n = {count(len(reference))}")
    whole.set_ylabel("height / m")
    if not len(points):
        whole.text(0.5, 0.5, "no point of the cloud", transform=whole.transAxes, ha="center", va="center")
        zoom.set_axis_off()
        return
    lines = slabs.cut(section, mesh)
    box = zoom_box(section, place)
    for ax, size in ((whole, 1.2), (zoom, 9.0)):
        if water_m is not None:
            ax.axhline(water_m, color=BLUE, lw=0.8, ls=(0, (6, 2)), zorder=1)
        ax.scatter(
            reference[:, 0], reference[:, 1], s=0.5 * size, color="0.55", lw=0, zorder=2, rasterized=True
        )
        # A fixed shuffle: no place of the boat lies on top of the others.
        order = np.argsort((np.arange(len(points)) * 2_654_435_761) % 2**32)
        ax.scatter(
            points[order, 0],
            points[order, 1],
            c=place[order],
            s=size,
            cmap=PLACE_MAP,
            norm=norm,
            lw=0,
            zorder=3,
            rasterized=True,
            plotnonfinite=False,
        )
        width = 0.8 if ax is whole else 1.3
        ax.add_collection(LineCollection(list(lines), colors="black", linewidths=width, zorder=4))
        ax.set_aspect("equal")
        ax.xaxis.set_major_locator(MaxNLocator(8 if ax is whole else 4, steps=[1, 2, 5, 10]))
        ax.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    whole.set(xlim=section.across_m, ylim=section.height_m)
    zoom.set(xlim=box[:2], ylim=box[2:])
    frame = Rectangle((box[0], box[2]), box[1] - box[0], box[3] - box[2], fill=False, ec="black", lw=0.9)
    frame.set(zorder=6)
    whole.add_patch(frame)
    for spine in zoom.spines.values():
        spine.set_visible(True)
        spine.set_edgecolor("black")
    inside = np.all((points[:, :2] >= box[::2]) & (points[:, :2] <= box[1::2]), axis=1)
    zoom.set_title(f"magnified, n = {count(inside.sum())}")
    # The bank rises to the right: the lower right corner is free.
    scale_bar(zoom, span_m=box[1] - box[0], xy=(0.72, 0.07))


def zoom_box(section: Section, place: ArrayF) -> tuple[float, float, float, float]:
    """The piece of a section that is magnified: left, right, bottom, top.

    Of the pieces with many points from many places of the boat it is the one nearest to the middle of the
    points: there the errors of the poses show, and neither the water's edge nor a crown is in the way.
    """
    points = section.points("cloud")
    wide = float(np.clip(ZOOM_SHARE * (section.across_m[1] - section.across_m[0]), LEAST_ZOOM_M, MOST_ZOOM_M))
    tall = ZOOM_SHAPE * wide
    cell = np.floor(points[:, :2] / (0.5 * wide)).astype(np.int64)
    seen_from = np.floor(np.nan_to_num(place, nan=-1e6) / ABREAST_M).astype(np.int64)
    distinct = np.unique(np.column_stack([cell, seen_from]), axis=0)
    cells, n_places = np.unique(distinct[:, :2], axis=0, return_counts=True)
    _, n_points = np.unique(cell, axis=0, return_counts=True)
    score = np.sqrt(n_places * n_points)
    many = cells[score >= ABOUT_AS_MANY * score.max()]
    aside = np.linalg.norm((many + 0.5) * 0.5 * wide - np.median(points[:, :2], axis=0), axis=1)
    there = (cell == many[np.argmin(aside)]).all(axis=1)
    x, y = np.median(points[there, :2], axis=0)
    return float(x - 0.5 * wide), float(x + 0.5 * wide), float(y - 0.5 * tall), float(y + 0.5 * tall)


def _fullest(values: ArrayF, width: float) -> float:
    """Where the piece of a width begins that holds most of the values."""
    ordered = np.sort(values)
    n = np.searchsorted(ordered, ordered + width, side="right") - np.arange(ordered.size)
    return float(ordered[np.argmax(n)])


def _ends(values: ArrayF) -> tuple[float, float]:
    low, high = np.percentile(values, [100 * STRAYS, 100 * (1 - STRAYS)])
    return float(low) - MARGIN_M, float(high) + MARGIN_M


def _row_mm(section: Section) -> float:
    """Height on paper of a row whose left panel fills its width at equal scales."""
    width_m = section.across_m[1] - section.across_m[0]
    height_m = section.height_m[1] - section.height_m[0]
    drawn_mm = _LEFT_SHARE * WIDTH_MM - _FRAME_MM
    return float(np.clip(drawn_mm * height_m / width_m + 6.0, LEAST_ROW_MM, MOST_ROW_MM))


def draw_cross_sections(
    *,
    comparison: Path,
    mesh: Path,
    mesh_facts: Path,
    points: Path,
    reference: Path,
    trajectory: Path,
    sections: dict[str, Any],
    water_line_ics_m: float | None,
    title: str,
) -> Figure:
    """Cloud, reference and their comparison -> cross sections through both."""
    table, _ = read_table(comparison, CLOUD_TO_MESH)
    slabs = Slabs(table, bank_frame_of(read_json(mesh_facts)), sections)
    for chunk in iter_laz(points, 1_000_000):
        slabs.add("cloud", chunk["xyz_m"], chunk["t_gps_s"])
    for chunk in iter_laz(reference, 1_000_000):
        slabs.add("reference", chunk["xyz_m"])
    return cross_sections(
        slabs,
        read_mesh(mesh)[0],
        Trajectory.read(trajectory),
        water_line_ics_m=water_line_ics_m,
        title=f"Cross sections of cloud and reference: {title}",
    )
