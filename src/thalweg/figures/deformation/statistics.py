"""How good the distances are, and what they add up to: stable ground, volumes, lines."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.stats import norm

from thalweg.core import ArrayB, GeometryError, read_json
from thalweg.figures import BLUE, GREY, ORANGE, SKY, VERMILION, count, new_figure, styled
from thalweg.figures.deformation.maps import BankPair, read_pairs, scene, signed

WIDE: Final = float(norm.isf(0.025))
"""Standard deviations of a 95 % band to either side."""
NOT_GROUND: Final = ("vegetation", "object")


@dataclass(frozen=True, slots=True)
class Stable:
    """Core points (k,) of bare ground that a registration rests on, and those that count as unmoved.

    Where no stable areas were drawn, unmoved are those without a significant distance: a registration keeps
    changes that are small against the scatter of the bank.
    """

    registered: ArrayB
    unmoved: ArrayB


def read_stable(
    pairs: Sequence[BankPair], registrations: Sequence[Path], weights: Sequence[Path]
) -> list[Stable]:
    """Stable ground of all pairs from what `thalweg.deformation.write_registration` wrote.

    Raises
    ------
    GeometryError : no core point of a pair lies on stable ground.
    """
    found = []
    for pair, facts, arrays in zip(pairs, registrations, weights, strict=True):
        with np.load(arrays) as stored:
            stable = np.asarray(stored["stable"], dtype=bool)
        stable &= ~np.isin(pair.state, NOT_GROUND) & np.isfinite(pair.table["distance_m"].to_numpy())
        if not stable.any():
            raise GeometryError(
                "no core point lies on stable ground",
                expected="ground that did not move between the epochs",
                cure="Draw it, and name the file as deformation.stable",
            )
        drawn = read_json(facts).get("areas") == "drawn"
        found.append(Stable(stable, stable if drawn else stable & (pair.state == "no significant change")))
    return found


# ---------------------------------------------------------------- stable ground


@styled
def stable_ground(pairs: Sequence[BankPair], stable: Sequence[Stable], *, title: str) -> Figure:
    """Distances over their sigma where nothing moved, and along the bank."""
    n = count(sum(each.unmoved.sum() for each in stable))
    figure = new_figure(104.0 * len(pairs) + 8.0, f"{title}, n = {n} distances")
    panels = figure.subplots(2 * len(pairs), 1, squeeze=False)[:, 0]
    for i, (pair, use) in enumerate(zip(pairs, stable, strict=True)):
        _normalised(panels[2 * i], pair, use)
        _along(panels[2 * i + 1], pair, use.unmoved)
    figure.align_ylabels(panels)
    return figure


def _normalised(ax: Axes, pair: BankPair, stable: Stable) -> None:
    """Histogram of distance over sigma, and the standard normal."""
    z = (pair.table["distance_m"] / pair.table["sigma_m"]).to_numpy()
    edges = np.linspace(-5, 5, 51)
    filled: dict[str, Any] = {"color": SKY, "histtype": "stepfilled"}
    line: dict[str, Any] = {"color": VERMILION, "histtype": "step", "lw": 1.0}
    for use, words, look in (
        (stable.unmoved, "stable ground", filled),
        (stable.registered, "all that the registration rests on", line),
    ):
        part = z[use & np.isfinite(z)]
        if not part.size:
            continue
        nmad = 1.4826 * np.median(np.abs(part - np.median(part)))
        label = (
            f"{words}: n = {count(len(part))}, median {signed(float(np.median(part)), 2)}, NMAD {nmad:.2f}, "
            f"{100 * np.mean(np.abs(part) > WIDE):.1f} % beyond ±1.96"
        )
        ax.hist(
            np.clip(part, -4.99, 4.99), bins=edges.tolist(), density=True, label=label, gid="share", **look
        )
    x = np.linspace(-5, 5, 201)
    ax.plot(x, norm.pdf(x), color="black", lw=1.2, label="standard normal: 5 % beyond ±1.96", gid="normal")
    ax.set_xlim(-5, 5)
    ax.set_ylim(0, 1.6 * ax.get_ylim()[1])
    ax.set_xlabel("distance over its standard deviation (ends: all beyond)")
    ax.set_ylabel("density")
    ax.set_title(pair.words)
    ax.legend(loc="upper center", fontsize=7)


def _along(ax: Axes, pair: BankPair, stable: ArrayB) -> None:
    """Distances of stable ground along the bank, their means, and the band of single distances."""
    s, d = pair.s_m[stable], 100 * pair.table["distance_m"].to_numpy()[stable]
    sigma = 100 * pair.table["sigma_m"].to_numpy()[stable]
    step = max(2.0 * pair.spacing_m, float(np.ptp(pair.s_m)) / 60.0)
    table = pd.DataFrame({"d": d, "sigma": sigma, "s": s}).groupby(np.floor(s / step))
    means = table.agg(d=("d", "median"), sigma=("sigma", "median"), s=("s", "mean"))
    ax.plot(s, d, ".", ms=1.5, color="0.75", rasterized=True, label="core points")
    ax.plot(means["s"], means["d"], color=BLUE, marker="o", ms=2.5, label=f"median of {step:.2g} m")
    band = WIDE * means["sigma"]
    label = "95 % of single distances without change"
    ax.fill_between(means["s"], -band, band, color=ORANGE, alpha=0.35, lw=0, label=label, gid="band")
    ax.axhline(0.0, color="black", lw=0.6)
    limit = max(1.6 * float(band.max()), 1.2 * float(means["d"].abs().max()))
    ax.set_ylim(-limit, 1.5 * limit)
    ax.set_xlim(pair.s_m.min(), pair.s_m.max())
    ax.set_xlabel(pair.scene.along)
    ax.set_ylabel("distance / cm")
    ax.legend(loc="upper center", ncols=3)


def draw_stable_ground(
    *,
    changes: list[Path],
    registrations: list[Path],
    weights: list[Path],
    core_points: Path,
    spacing_m: float,
    by_boat: bool,
    title: str,
) -> Figure:
    """Distances where nothing moved -> their histogram over sigma, and along the bank."""
    pairs = read_pairs(changes, core_points, spacing_m, by_boat=by_boat)
    stable = read_stable(pairs, registrations, weights)
    return stable_ground(pairs, stable, title=f"Stable ground: {title}")


# ---------------------------------------------------------------- volumes along the bank


_BARS: Final[dict[str, Any]] = {"lw": 0.9, "capsize": 1.5}


def _places(stretches: pd.DataFrame, shift: float) -> tuple[pd.Series, pd.Series]:
    """Middles of stretches, moved by a share of their widths, and these."""
    width = stretches["s_to_m"] - stretches["s_from_m"]
    return 0.5 * (stretches["s_from_m"] + stretches["s_to_m"]) + shift * width, width


def _tables(paths: Sequence[Path]) -> list[tuple[str, pd.DataFrame]]:
    """Tables of pairs, whose names end with that of the pair."""
    return [(path.stem.rpartition("_")[2], pd.read_csv(path)) for path in paths]


@styled
def volume_along(tables: Sequence[tuple[str, pd.DataFrame]], *, by_boat: bool, title: str) -> Figure:
    """Eroded, deposited and net volume of each stretch, and the area that was not seen."""
    figure = new_figure(98.0 * len(tables) + 4.0, title)
    heights = [3.0, 1.0] * len(tables)
    panels = figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
    for i, (name, table) in enumerate(tables):
        volumes, unseen = panels[2 * i], panels[2 * i + 1]
        for what, colour, marker, shift in (
            ("erosion", BLUE, "v", -0.22),
            ("deposition", VERMILION, "^", 0.0),
            ("net", "black", "o", 0.22),
        ):
            rows = table[table["what"] == what]
            used = rows[rows["area_m2"] > 0]
            x, width = _places(used, shift)
            if what != "net":
                volumes.bar(x, used["volume_m3"], 0.2 * width, color=colour, alpha=0.6, lw=0, gid=what)
            half = used["high_m3"] - used["volume_m3"]
            label = f"{what}: {signed(rows['volume_m3'].sum(), 1)} m³"
            volumes.errorbar(x, used["volume_m3"], half, fmt=marker, ms=3, color=colour, **_BARS, label=label)
        volumes.axhline(0.0, color="black", lw=0.6)
        volumes.set_ylabel("volume / m³")
        low, high = volumes.get_ylim()
        volumes.set_ylim(low, high + 0.18 * (high - low))
        x, width = _places(rows, 0.0)
        length_m = _places(table, 0.0)[1].iloc[0]
        volumes.set_title(
            f"epochs {name.replace('-', ' to ')}, {len(rows)} stretches of {length_m:g} m, bars: 95 %"
        )
        volumes.legend(loc="upper center", ncols=3)
        volumes.tick_params(labelbottom=False)
        unseen.bar(x, rows["not_seen_m2"], 0.9 * width, color=GREY, gid="not-seen")
        unseen.set(ylabel="no data / m²", xlabel=scene(by_boat).along)
        unseen.sharex(volumes)
    figure.align_ylabels(panels)
    return figure


def draw_volume_along(*, along: list[Path], by_boat: bool, title: str) -> Figure:
    """Volumes of stretches -> bars along the bank or surface."""
    words = f"Volume of change along {scene(by_boat).thing}: {title}"
    return volume_along(_tables(along), by_boat=by_boat, title=words)


@styled
def retreat_along(tables: Sequence[tuple[str, pd.DataFrame]], *, by_boat: bool, title: str) -> Figure:
    """How far bank line and bank top moved in each stretch."""
    words = scene(by_boat)
    figure = new_figure(66.0 * len(tables) + 4.0, title)
    panels = figure.subplots(len(tables), 1, squeeze=False)[:, 0]
    for ax, (name, table) in zip(panels, tables, strict=True):
        for line, colour, marker, shift in (
            ("bank line", BLUE, "v", -0.1),
            ("bank top", VERMILION, "^", 0.1),
        ):
            rows = table[table["line"] == line]
            label = f"{words.lines[line]}, n = {len(rows)} stretches"
            if line == "bank line" and len(rows):
                label += f", at a height of {signed(rows['height_m'].iloc[0], 2)} m"
            x, half = _places(rows, shift)[0], 100 * (rows["high_m"] - rows["nsm_m"])
            ax.errorbar(x, 100 * rows["nsm_m"], half, fmt=marker, ms=3.5, color=colour, **_BARS, label=label)
        ax.axhline(0.0, color="black", lw=0.6)
        ax.set_title(f"epochs {name.replace('-', ' to ')}, bars: 95 %")
        ax.set_ylabel(f"movement across {words.thing} / cm\n(negative: retreat)")
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.2 * (high - low))
        ax.legend(loc="upper center", ncols=2)
        ax.set_xlabel(words.along)
    return figure


def draw_retreat_along(*, retreat: list[Path], by_boat: bool, title: str) -> Figure:
    """Movement of both lines in stretches -> along the bank or surface."""
    words = f"Movement of {scene(by_boat).thing}: {title}"
    return retreat_along(_tables(retreat), by_boat=by_boat, title=words)
