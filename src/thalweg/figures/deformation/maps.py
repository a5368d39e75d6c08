"""Maps of change on a bank or surface: distance, state, and what was not seen.

Both views of a bank have s, the length along it, to the right as one looks from the river: from above, with
the river below, and from the river, with the height upward. Of files without a boat s is the longest extent.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from thalweg.core import ArrayB, ArrayF, read_table
from thalweg.deformation import CHANGES, CORE_POINTS, STATES
from thalweg.figures import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    WIDTH_MM,
    colour_bar,
    count,
    new_figure,
    north_arrow,
    number,
    styled,
)
from thalweg.figures.accuracy import DISTANCE_MAP, round_above

STATE_STYLE: Final[dict[str, tuple[str, str]]] = {
    "erosion": (BLUE, "v"),
    "deposition": (VERMILION, "^"),
    "no significant change": ("0.8", "s"),
    "vegetation": (GREEN, "x"),
    "object": (PURPLE, "D"),
    "not seen in first": (ORANGE, "+"),
    "not seen in second": (SKY, "+"),
    "not seen": ("black", "+"),
    "no normal": (GREY, "1"),
}
"""Colour and marker of each state."""
NOT_SEEN: Final = ("not seen", "not seen in first", "not seen in second")
"""States of places that one epoch or both did not see."""
BARE: Final = ("erosion", "deposition", "no significant change")
"""States whose distances are those of the ground."""
FACE_MM: Final = 34.0
"""Height of a view from the side; heights are drawn larger than lengths."""
DRAWN_MM: Final = WIDTH_MM - 24.0
"""Width of a panel that takes the whole page."""
SCALE_SHARE: Final = 99.0
"""Percentage of the distances that the scale of colours holds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Words for what is compared: a bank that a boat saw, or any surface of files without a boat.

    Attributes
    ----------
    along, away, across : labels of axes; across also tells the side in a profile.
    view : of a view with the height upward.
    thing : short name.
    lines : names of `thalweg.deformation.core_points.LINES`.
    """

    along: str
    away: str
    across: str
    view: str
    thing: str
    lines: Mapping[str, str]


_BANK: Final = Scene(
    along="along the bank, to the right as seen from the river / m",
    away="away from\nthe river / m",
    across="across the bank, the river to the left / m",
    view="seen from the river, heights not to scale",
    thing="the bank",
    lines={"bank line": "bank line", "bank top": "bank top"},
)
_SURFACE: Final = Scene(
    along="along the longest extent / m",
    away="across / m",
    across="across the longest extent / m",
    view="seen from the side, heights not to scale",
    thing="the surface",
    lines={"bank line": "contour", "bank top": "upper edge"},
)


def scene(by_boat: bool) -> Scene:
    """The words of a campaign; ``by_boat``: an epoch of it has the trajectory of a boat."""
    return _BANK if by_boat else _SURFACE


@dataclass(frozen=True, slots=True, kw_only=True)
class BankPair:
    """Core points of a pair of epochs in the frame of the bank or surface.

    Attributes
    ----------
    name : such as ``1-2``.
    table : `thalweg.deformation.CHANGES`.
    s_m, into_m, up_m : (k,) along the bank, away from the river, height.
    area_m2 : (k,) that each core point stands for.
    spacing_m : edge of the cells of the core points.
    along : (2,) unit vector east, north along the bank; into : (2,) the one away from the river.
    scene : words for what is compared.
    """

    name: str
    table: pd.DataFrame
    s_m: ArrayF
    into_m: ArrayF
    up_m: ArrayF
    area_m2: ArrayF
    spacing_m: float
    along: ArrayF
    into: ArrayF
    scene: Scene

    @property
    def words(self) -> str:
        """``epochs 1 to 2``."""
        return f"epochs {self.name.replace('-', ' to ')}"

    @property
    def state(self) -> ArrayF:
        """State (k,) of each core point."""
        return self.table["state"].to_numpy(dtype=object)

    @property
    def bare(self) -> ArrayB:
        """Core points (k,) with a distance of the ground."""
        return np.isin(self.state, BARE) & np.isfinite(self.table["distance_m"].to_numpy())

    def on_bank(self, east_north_m: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Along the bank and away from the river (n,) of places (n, 2), as `s_m` and `into_m` count them."""
        place = self.table[["east_m", "north_m"]].to_numpy()
        delta = np.asarray(east_north_m) - place.mean(axis=0)
        return delta @ self.along, delta @ self.into


def read_pairs(
    changes: Sequence[Path], core_points: Path, spacing_m: float, *, by_boat: bool
) -> list[BankPair]:
    """Tables ``changes_<pair>.parquet`` of all pairs with the core points that they share.

    Parameters
    ----------
    changes : one file a pair.
    core_points : table `thalweg.deformation.CORE_POINTS`.
    spacing_m : edge of the cells of the core points.
    by_boat : an epoch has the trajectory of a boat, see `scene`.

    Raises
    ------
    InputError : a file is missing or of another kind.
    """
    cores = read_table(core_points, CORE_POINTS)[0]
    place = cores[["east_m", "north_m"]].to_numpy()
    plan = place - place.mean(axis=0)
    s = cores["s_m"].to_numpy()
    along = np.linalg.lstsq(plan, s, rcond=None)[0]
    along = along / max(np.linalg.norm(along), 1e-12)
    into = np.array([-along[1], along[0]])
    return [
        BankPair(
            name=path.stem.rpartition("_")[2],
            table=read_table(path, CHANGES)[0],
            s_m=s,
            into_m=plan @ into,
            up_m=cores["up_m"].to_numpy(),
            area_m2=cores["area_m2"].to_numpy(),
            spacing_m=spacing_m,
            along=along,
            into=into,
            scene=scene(by_boat),
        )
        for path in changes
    ]


def signed(value: float, digits: int) -> str:
    """A number with its sign, a true minus, and thousands apart."""
    text = f"{round(value, digits) + 0.0:+,.{digits}f}"
    return text.replace("-", "\N{MINUS SIGN}").replace(",", "\N{NO-BREAK SPACE}")


def marker_pt(pair: BankPair, width_mm: float = DRAWN_MM) -> float:
    """Width of a core point's cell on paper, points; never too small to see."""
    return float(max(pair.spacing_m / max(np.ptp(pair.s_m), 1e-6) * width_mm / 25.4 * 72.0, 1.2))


def view_from_side(ax: Axes, pair: BankPair) -> None:
    """Limits and labels of a view with the height upward."""
    ax.set_xlim(pair.s_m.min() - pair.spacing_m, pair.s_m.max() + pair.spacing_m)
    ax.set_ylim(pair.up_m.min() - 0.5 * pair.spacing_m, pair.up_m.max() + 0.5 * pair.spacing_m)
    ax.set_xlabel(pair.scene.along)
    ax.set_ylabel("height / m")


def _view_from_above(ax: Axes, pair: BankPair) -> None:
    """Limits, labels and north of a plan; a river is at its lower edge."""
    ax.set_aspect("equal")
    ax.set_xlim(pair.s_m.min() - pair.spacing_m, pair.s_m.max() + pair.spacing_m)
    ax.set_ylim(pair.into_m.min() - pair.spacing_m, pair.into_m.max() + pair.spacing_m)
    ax.set_ylabel(pair.scene.away)
    north_arrow(ax, xy=(0.965, 0.5), towards=(20.0 * pair.along[1], 20.0 * pair.into[1]))


def _plan_mm(pair: BankPair) -> float:
    return float(np.ptp(pair.into_m) / max(np.ptp(pair.s_m), 1e-6) * DRAWN_MM)


def _two_views(pairs: Sequence[BankPair], title: str, extra_mm: float) -> tuple[Figure, list[Axes]]:
    """A figure with a plan and a view from the side for each pair; axes (2 pairs,)."""
    plans = [max(1.12 * _plan_mm(pair), 16.0) for pair in pairs]
    heights = [height for plan in plans for height in (plan, FACE_MM)]
    figure = new_figure(sum(heights) + len(pairs) * 24.0 + extra_mm, title)
    panels = figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    for pair, plan, face in zip(pairs, panels[::2], panels[1::2], strict=True):
        _view_from_above(plan, pair)
        view_from_side(face, pair)
        plan.tick_params(labelbottom=False)
    figure.align_ylabels(panels)
    return figure, list(panels)


@styled
def change_map(pairs: Sequence[BankPair], *, title: str) -> Figure:
    """Distance of each core point of bare ground, from above and from the side."""
    inside = [np.abs(pair.table["distance_m"].to_numpy()[pair.bare]) for pair in pairs]
    limit = round_above(max(float(np.percentile(np.concatenate(inside), SCALE_SHARE)), 1e-3))
    norm = Normalize(-100 * limit, 100 * limit)
    n = sum(len(each) for each in inside)
    figure, panels = _two_views(pairs, f"{title}, n = {count(n)} core\N{NO-BREAK SPACE}points", 20.0)
    for i, pair in enumerate(pairs):
        distance = 100 * pair.table["distance_m"].to_numpy()
        order = np.argsort(np.abs(distance[pair.bare]))
        size = marker_pt(pair) ** 2
        for ax, y in ((panels[2 * i], pair.into_m), (panels[2 * i + 1], pair.up_m)):
            other = ~pair.bare
            ax.scatter(pair.s_m[other], y[other], s=0.3 * size, c="0.6", marker="x", lw=0.4, gid="others")
            x, z, d = (values[pair.bare][order] for values in (pair.s_m, y, distance))
            drawn = ax.scatter(x, z, c=d, s=size, marker="s", lw=0, cmap=DISTANCE_MAP, norm=norm)
            drawn.set_gid("distances")
            drawn.set_rasterized(True)
        beyond = np.abs(distance[pair.bare]) > 100 * limit
        ends = " to ".join(signed(end(distance[pair.bare]), 0) for end in (np.min, np.max))
        panels[2 * i].set_title(
            f"{pair.words} from above, n = {count(pair.bare.sum())}, from {ends} cm, "
            f"{count(beyond.sum())} beyond the scale"
        )
        panels[2 * i + 1].set_title(
            f"{pair.scene.view}; ×: plants, objects and places without distance, "
            f"n = {count((~pair.bare).sum())}"
        )
    look = {"location": "bottom", "aspect": 55, "shrink": 0.8, "pad": 0.02, "extend": "both"}
    words = "distance / cm; negative: erosion, positive: deposition"
    colour_bar(panels, DISTANCE_MAP, norm, words, **look)
    return figure


def draw_change_map(
    *, changes: list[Path], core_points: Path, spacing_m: float, by_boat: bool, title: str
) -> Figure:
    """Compared core points -> distances from above and from the side."""
    pairs = read_pairs(changes, core_points, spacing_m, by_boat=by_boat)
    return change_map(pairs, title=f"Change: {title}")


def _with_styles(
    ax: Axes, pair: BankPair, y_m: ArrayF, names: ArrayF, looks: Mapping[str, tuple[str, str]]
) -> None:
    """Core points by name, each with its colour and marker; labels carry n, share and area."""
    size = marker_pt(pair) ** 2
    area = pair.area_m2.sum()
    for name, (colour, marker) in looks.items():
        use = names == name
        if not use.any():
            continue
        n, own = int(use.sum()), float(pair.area_m2[use].sum())
        ax.scatter(
            pair.s_m[use],
            y_m[use],
            s=size if marker == "s" else 1.2 * size,
            c=colour,
            marker=marker,
            lw=0.7 if marker in "x+1" else 0,
            zorder=1 if name in ("no significant change", "seen") else 2,
            rasterized=True,
            gid=name,
            label=f"{name}: n = {count(n)}, {number(own)} m² ({100 * own / area:.2g} %)",
        )


def _legend_under(ax: Axes) -> None:
    legend = ax.legend(loc="upper left", bbox_to_anchor=(0.0, -0.32), ncols=2, frameon=False, borderpad=0)
    for handle in legend.legend_handles:
        handle.set_sizes([18.0])  # type: ignore[union-attr]


@styled
def significance_map(pairs: Sequence[BankPair], *, title: str) -> Figure:
    """What is known of each core point, from above and from the side."""
    n = count(len(pairs[0].s_m))
    figure, panels = _two_views(pairs, f"{title}, n = {n} core\N{NO-BREAK SPACE}points", 26.0 * len(pairs))
    looks = {state: STATE_STYLE[state] for state in STATES}
    for i, pair in enumerate(pairs):
        for ax, y in ((panels[2 * i], pair.into_m), (panels[2 * i + 1], pair.up_m)):
            _with_styles(ax, pair, y, pair.state, looks)
        panels[2 * i].set_title(f"{pair.words} from above")
        panels[2 * i + 1].set_title(pair.scene.view)
        _legend_under(panels[2 * i + 1])
    return figure


def draw_significance_map(
    *, changes: list[Path], core_points: Path, spacing_m: float, by_boat: bool, title: str
) -> Figure:
    """Compared core points -> what is known of each."""
    pairs = read_pairs(changes, core_points, spacing_m, by_boat=by_boat)
    return significance_map(pairs, title=f"Change: {title}")
