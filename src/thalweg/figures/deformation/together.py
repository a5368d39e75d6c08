"""Two epochs together: how each was surveyed, both clouds, and their point to point distances."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from thalweg.core import ArrayF
from thalweg.deformation import cloud_to_cloud
from thalweg.figures import BLUE, RANGE_MAP, SIGMA_MAP, VERMILION, count, legend_below, new_figure, styled
from thalweg.figures.deformation.maps import BankPair, read_pairs
from thalweg.figures.deformation.views import CloudOfEpoch, read_clouds

SHOWN: Final = 40_000
"""Points of an epoch in a panel at most."""


@styled
def epochs_together(clouds: Sequence[CloudOfEpoch], pair: BankPair, *, title: str) -> Figure:
    """First and last epoch in four panels.

    Parameters
    ----------
    clouds : all epochs, in the order of time.
    pair : any pair of them, for the axes along and across, and their words.
    """
    first, last = clouds[0], clouds[-1]
    shown = [_thinned(each.xyz_m) for each in (first, last)]
    table = cloud_to_cloud(first.xyz_m, shown[1], towards=np.array([*-pair.into, 0.0]))
    nearest = table["distance_m"].to_numpy()
    bank = [pair.on_bank(xyz[:, :2]) for xyz in shown]
    tall = float(np.ptp(np.concatenate([xyz[:, 2] for xyz in shown])))
    deep = float(np.ptp(np.concatenate([into for _, into in bank])))
    wide = float(np.ptp(np.concatenate([s for s, _ in bank])))
    heights = np.clip(np.array([tall, tall, deep, deep]) / max(wide, 1e-9), 0.16, 0.55)
    n = count(len(first.xyz_m) + len(last.xyz_m))
    figure = new_figure(118.0 * float(heights.sum()) + 92.0, f"{title}, n = {n} points")
    panels = figure.subplots(4, 1, height_ratios=heights.tolist(), sharex=True)
    far = [
        cKDTree(each.boat_m).query(xyz)[0] if len(each.boat_m) else None
        for each, xyz in zip((first, last), shown, strict=True)
    ]
    known = [part for part in far if part is not None]
    limit = float(np.quantile(np.concatenate(known), 0.99)) if known else 0.0
    for ax, letter, each, xyz, (s, _), distance in zip(
        panels, "ab", (first, last), shown, bank, far, strict=False
    ):
        drawn = ax.scatter(
            s, xyz[:, 2], c="0.4" if distance is None else distance, s=0.6, cmap=RANGE_MAP if limit else None,
            vmin=0.0 if limit else None, vmax=limit or None, lw=0, rasterized=True, gid=f"cloud {letter}",
        )  # fmt: skip
        ax.set_title(f"{letter}) epoch {each.number}, {each.name}, {pair.scene.view}")
        ax.set_ylabel("height / m")
        if distance is not None:
            _bar(figure, ax, drawn, "from the boat / m")
    ax = panels[2]
    rng = np.random.default_rng(0)
    both = np.concatenate([np.stack(part, axis=1) for part in bank])
    later = np.repeat([False, True], [len(part[0]) for part in bank])
    order = rng.permutation(len(both))  # neither epoch hides the other
    colours = np.where(later, VERMILION, BLUE)[order]
    ax.scatter(*both[order].T, c=colours, s=0.6, lw=0, rasterized=True, gid="both")
    for each, colour in ((first, BLUE), (last, VERMILION)):
        ax.plot([], [], "o", ms=4, color=colour, label=f"epoch {each.number}, {each.name}")
    ax.set_title("c) both epochs from above")
    ax = panels[3]
    order = np.argsort(nearest)
    drawn = ax.scatter(
        *(part[order] for part in bank[1]), c=nearest[order], s=0.8, cmap=SIGMA_MAP, vmin=0.0,
        vmax=float(np.quantile(nearest, 0.995)), lw=0, rasterized=True, gid="distances",
    )  # fmt: skip
    spacing = float(table["spacing_m"].median())
    ax.set_title(
        f"d) point to point: epoch {last.number} to the nearest point of epoch {first.number},\n"
        f"largest {nearest.max():.2f} m; points of epoch {first.number} lie {100 * spacing:.1f} cm apart"
    )
    _bar(figure, ax, drawn, "distance / m", extend="max")
    for ax in panels[2:]:
        ax.set_ylabel(pair.scene.away)
    for ax in panels:
        ax.margins(x=0.01)
    panels[3].set_xlabel(pair.scene.along)
    legend_below(figure, panels[2])
    return figure


def _bar(figure: Figure, ax: Axes, drawn: object, words: str, extend: str = "neither") -> None:
    figure.colorbar(drawn, ax=ax, label=words, extend=extend, pad=0.01, aspect=12)  # type: ignore[arg-type]


def _thinned(xyz_m: ArrayF) -> ArrayF:
    """Every so many-th point."""
    return np.asarray(xyz_m[:: -(-len(xyz_m) // SHOWN)])


def draw_epochs_together(
    *,
    points: list[Path],
    errors: list[Path],
    changes: list[Path],
    core_points: Path,
    spacing_m: float,
    by_boat: bool,
    title: str,
) -> Figure:
    """Prepared epochs -> first and last of them together (T Fig. 4.2)."""
    pair = read_pairs(changes[:1], core_points, spacing_m, by_boat=by_boat)[0]
    clouds = read_clouds(points, errors)
    return epochs_together(clouds, pair, title=f"Two epochs and their distances: {title}")
