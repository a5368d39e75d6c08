"""Clouds of epochs as they are: from above, and in profiles."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from thalweg.core import ArrayF, read_json, utc_text_from_gps
from thalweg.figures import (
    BLUE,
    HEIGHT_MAP,
    VERMILION,
    count,
    legend_below,
    new_figure,
    raster_maps,
    robust_limits,
    styled,
)
from thalweg.figures.deformation.maps import BankPair, read_pairs, scene, signed

PIXELS: Final = 700
"""Of the longer side of a cloud from above."""
SHOWN: Final = 6000
"""Points of an epoch in a profile at most."""
LEAST_IN_CELL: Final = 4
"""Points that a mean in a profile needs."""
HALF_WIDTH_M: Final = 2.5
"""Of a profile to both sides of its place; wider where the change is large."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudOfEpoch:
    """Points (n, 3) and track (m, 3) of an epoch, its number, name and start."""

    number: int
    name: str
    start_gps_s: float
    xyz_m: ArrayF
    boat_m: ArrayF


def read_clouds(points: Sequence[Path], errors: Sequence[Path]) -> list[CloudOfEpoch]:
    """Prepared epochs in the order of time: ``points.npz`` and ``errors.json``."""
    found = []
    for i, (path, beside) in enumerate(zip(points, errors, strict=True)):
        facts = read_json(beside)
        with np.load(path) as stored:
            found.append(
                CloudOfEpoch(
                    number=i + 1,
                    name=facts["name"],
                    start_gps_s=facts["start_gps_s"],
                    xyz_m=stored["xyz_m"],
                    boat_m=stored["boat_m"],
                )
            )
    return found


# ---------------------------------------------------------------- from above


@styled
def epochs_from_above(clouds: Sequence[CloudOfEpoch], *, title: str) -> Figure:
    """Highest points of each epoch from above with the tracks of the boat."""
    everything = np.concatenate([part[:, :2] for each in clouds for part in (each.xyz_m, each.boat_m)])
    low, high = everything.min(axis=0), everything.max(axis=0)
    margin = 0.03 * float(np.max(high - low))
    low, high = low - margin, high + margin
    sample = [each.xyz_m[:: -(-len(each.xyz_m) // 200_000), 2] for each in clouds]
    least, most = robust_limits(np.concatenate(sample))
    look = {"cmap": HEIGHT_MAP, "vmin": least, "vmax": most, "origin": "lower", "gid": "heights"}
    n = count(sum(len(each.xyz_m) for each in clouds))
    figure, panels = raster_maps(
        f"{title}, n = {n} points",
        (low[0], high[0], low[1], high[1]),
        [(_highest(each.xyz_m, low, high), "height / m", look) for each in clouds],
        crs="local frame",
    )
    for ax, each in zip(panels, clouds, strict=False):
        if len(each.boat_m):
            ax.plot(*each.boat_m[:, :2].T, color=VERMILION, lw=1.2, gid="track")
            ax.plot(*each.boat_m[0, :2], "o", color=VERMILION, ms=4, gid="start")
        track = "line: the boat from the circle" if len(each.boat_m) else "files, no trajectory"
        ax.set_title(
            f"epoch {each.number}, {each.name}: {utc_text_from_gps(each.start_gps_s, 0)},\n"
            f"n = {count(len(each.xyz_m))}; {track}"
        )
    return figure


def _highest(xyz_m: ArrayF, low: ArrayF, high: ArrayF) -> ArrayF:
    """Height of the highest point of each pixel, which a thin cloud or raster fills; NaN without any."""
    some = xyz_m[:: -(-len(xyz_m) // 2000), :2]
    near = np.asarray(cKDTree(xyz_m[:, :2]).query(some, k=2)[0])
    apart = np.median(near[:, 1]) if len(xyz_m) > 1 else 0.0
    pixel = max(float(np.max(high - low)) / PIXELS, 1.5 * float(apart))
    columns, rows = (int(np.ceil(span / pixel)) for span in high - low)
    at = ((xyz_m[:, :2] - low) / pixel).astype(np.int64)
    picture = np.full(rows * columns, -np.inf)
    np.maximum.at(picture, at[:, 1] * columns + at[:, 0], xyz_m[:, 2])
    return np.where(np.isfinite(picture), picture, np.nan).reshape(rows, columns)


def draw_epochs_from_above(*, points: list[Path], errors: list[Path], title: str) -> Figure:
    """Prepared epochs -> their clouds from above."""
    clouds = read_clouds(points, errors)
    return epochs_from_above(clouds, title=f"Epochs from above: {title}")


# ---------------------------------------------------------------- profiles


@dataclass(frozen=True, slots=True)
class Place:
    """Core point that a profile goes through, and why."""

    words: str
    core: int


def places_of(pair: BankPair, patches: pd.DataFrame) -> list[Place]:
    """Where to cut: the patches that lost and that gained most, and the lowest one that lost: a niche.

    A profile goes through the core point with the largest distance of its patch.
    """
    found: list[Place] = []
    distance = pair.table["distance_m"].to_numpy()
    eroded = patches[patches["what"] == "erosion"].dropna(subset=["largest_distance_m"])
    grown = patches[patches["what"] == "deposition"].dropna(subset=["largest_distance_m"])
    for words, rows, order in (
        ("largest erosion", eroded, eroded["volume_m3"]),
        ("lowest erosion", eroded, eroded["up_m"]),
        ("largest deposition", grown, -grown["volume_m3"]),
    ):
        if len(rows):
            core = int(
                np.nanargmin(
                    np.abs(distance - rows["largest_distance_m"].to_numpy()[int(order.to_numpy().argmin())])
                )
            )
            same = [i for i, each in enumerate(found) if each.core == core]
            if same:
                found[same[0]] = Place(f"{found[same[0]].words}, {words}", core)
            else:
                found.append(Place(words, core))
    return found


def without_motion(xyz_m: ArrayF, parameters: dict[str, float], middle_m: ArrayF) -> ArrayF:
    """Points (n, 3) of a second epoch without the motion that the registration found, see `Registration`."""
    shift = np.array([parameters[f"{axis}_m"] for axis in ("east", "north", "up")])
    turn = np.array([parameters[f"turn_{axis}"] for axis in ("east", "north", "up")])
    return np.asarray(xyz_m - shift - np.cross(turn, xyz_m - middle_m))


@styled
def profiles(cuts: Sequence[tuple[BankPair, Place, ArrayF, ArrayF]], *, title: str) -> Figure:
    """Points of both epochs within slabs across the bank or surface.

    Parameters
    ----------
    cuts : pair, place, points (n, 3) of the first and of the registered second epoch.
    """
    if not cuts:
        figure = new_figure(30.0, title)
        figure.text(0.5, 0.4, "no patch of change: no profile", ha="center")
        return figure
    figure = new_figure(68.0 * len(cuts) + 20.0, title)
    panels = figure.subplots(len(cuts), 1, squeeze=False)[:, 0]
    for ax, cut in zip(panels, cuts, strict=True):
        _profile(ax, *cut)
    panels[-1].set_xlabel(cuts[0][0].scene.across)
    legend_below(figure, panels[0])
    return figure


def _profile(ax: Axes, pair: BankPair, place: Place, first_m: ArrayF, second_m: ArrayF) -> None:
    """One slab: points, means of cells, and significant distances."""
    core = place.core
    s, into, up = pair.s_m[core], pair.into_m[core], pair.up_m[core]
    distance = pair.table["distance_m"].to_numpy()
    half = max(HALF_WIDTH_M, 1.5 * abs(float(distance[core])) + 1.0)
    tall = 0.42 * half
    n = []
    for xyz, colour, marker, words in (
        (first_m, BLUE, "o", "first epoch"),
        (second_m, VERMILION, "^", "second epoch, registered"),
    ):
        along, across = pair.on_bank(xyz[:, :2])
        inside = (np.abs(along - s) < pair.spacing_m) & (np.abs(across - into) < half)
        inside &= np.abs(xyz[:, 2] - up) < tall
        x, z = across[inside], xyz[inside, 2]
        n.append(len(x))
        step = -(-max(len(x), 1) // SHOWN)
        ax.plot(x[::step], z[::step], ".", ms=1.0, color=colour, alpha=0.35, rasterized=True, zorder=1)
        mean = _cell_means(x, z, 0.5 * pair.spacing_m)
        label = f"{words}: points and means of cells of {50 * pair.spacing_m:.0f} cm"
        ax.plot(*mean.T, marker, ms=4.0, color=colour, mec="white", mew=0.4, zorder=3, gid=words, label=label)
    near = np.abs(pair.s_m - s) < pair.spacing_m
    near &= np.isin(pair.state, ("erosion", "deposition")) & np.isfinite(distance)
    normals = pair.table[[f"normal_{axis}" for axis in ("east", "north", "up")]].to_numpy()
    across = normals[:, :2] @ pair.into
    for k, row in enumerate(np.flatnonzero(near)):
        ax.plot(
            pair.into_m[row] + np.array([0.0, distance[row]]) * across[row],
            pair.up_m[row] + np.array([0.0, distance[row]]) * normals[row, 2],
            color="black",
            lw=0.9,
            zorder=4,
            gid="distance",
            label="significant distance along the normal" if k == 0 else None,
        )
    ax.set_aspect("equal")
    ax.set_xlim(into - half, into + half)
    ax.set_ylim(up - tall, up + tall)
    ax.set_ylabel("height / m")
    sigma = 100 * pair.table["sigma_m"].iloc[core]
    ax.set_title(
        f"{pair.words}, {place.words}: {signed(100 * distance[core], 0)} ± {sigma:.0f} cm (1 sigma)\n"
        f"at {signed(s, 1)} m along {pair.scene.thing}, slab of {2 * pair.spacing_m:.2g} m, "
        f"n = {count(n[0])} and {count(n[1])} points"
    )


def _cell_means(x: ArrayF, z: ArrayF, edge_m: float) -> ArrayF:
    """Means (c, 2) of the points in square cells that hold enough of them."""
    cells = pd.DataFrame({"x": x, "z": z, "i": np.floor(x / edge_m), "j": np.floor(z / edge_m)})
    found = cells.groupby(["i", "j"]).agg(x=("x", "mean"), z=("z", "mean"), n=("x", "size"))
    return found.loc[found["n"] >= LEAST_IN_CELL, ["x", "z"]].to_numpy()


def draw_change_profiles(
    *,
    points: list[Path],
    errors: list[Path],
    changes: list[Path],
    patches: list[Path],
    registrations: list[Path],
    core_points: Path,
    spacing_m: float,
    by_boat: bool,
    title: str,
) -> Figure:
    """Prepared epochs and what changed -> profiles through the largest changes."""
    clouds = read_clouds(points, errors)
    cuts = []
    for pair, patch, moved in zip(
        read_pairs(changes, core_points, spacing_m, by_boat=by_boat), patches, registrations, strict=True
    ):
        first, second = (clouds[int(i) - 1] for i in pair.name.split("-"))
        motion = read_json(moved).get("parameters")
        middle = pair.table[["east_m", "north_m", "up_m"]].to_numpy().mean(axis=0)
        after = second.xyz_m if motion is None else without_motion(second.xyz_m, motion, middle)
        cuts += [(pair, place, first.xyz_m, after) for place in places_of(pair, pd.read_csv(patch))]
    return profiles(cuts, title=f"Profiles across {scene(by_boat).thing}: {title}")
