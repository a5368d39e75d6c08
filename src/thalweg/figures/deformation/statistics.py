"""How good the distances are, and what they add up to: levels of detection, stable ground, volumes."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from scipy.stats import norm

from thalweg.core import ArrayB, GeometryError, read_table
from thalweg.deformation import CORE_POINTS, HEIGHTS, SERIES
from thalweg.figures import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    SIGMA_MAP,
    SKY,
    VERMILION,
    count,
    new_figure,
    robust_limits,
    styled,
)
from thalweg.figures.deformation.maps import BankPair, marker_pt, read_pairs, scene, signed, view_from_side

WIDE: Final = float(norm.isf(0.025))
"""Standard deviations of a 95 % band to either side."""
PARTS: Final = (
    ("sigma_field_m", "shared errors", BLUE, "-"),
    ("sigma_white_m", "noise and roughness", VERMILION, "--"),
    ("sigma_registration_m", "registration", GREEN, ":"),
)
"""Parts of the standard deviation of a distance: column, words, colour, line."""
PUBLISHED_M: Final = (0.15, 0.19)
"""RMSE of the points of both epochs in T 4.1."""
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
        drawn = json.loads(facts.read_text()).get("areas") == "drawn"
        found.append(Stable(stable, stable if drawn else stable & (pair.state == "no significant change")))
    return found


# ---------------------------------------------------------------- level of detection


@styled
def level_of_detection(pairs: Sequence[BankPair], *, title: str, twin: bool) -> Figure:
    """Level of detection at each core point, and how it is made up."""
    every = np.concatenate([100 * pair.table["lod95_m"].to_numpy() for pair in pairs])
    scale = Normalize(*robust_limits(every))
    n = count(int(np.isfinite(every).sum()))
    figure = new_figure(112.0 * len(pairs) + 12.0, f"{title}, n = {n} distances", twin=twin)
    panels = figure.subplots(2 * len(pairs), 1, height_ratios=[1.0, 1.6] * len(pairs), squeeze=False)[:, 0]
    for i, pair in enumerate(pairs):
        face, shares = panels[2 * i], panels[2 * i + 1]
        lod = 100 * pair.table["lod95_m"].to_numpy()
        known = np.isfinite(lod)
        face.scatter(
            pair.s_m[known],
            pair.up_m[known],
            c=lod[known],
            s=marker_pt(pair, 128.0) ** 2,
            marker="s",
            lw=0,
            cmap=SIGMA_MAP,
            norm=scale,
            rasterized=True,
        )
        view_from_side(face, pair)
        face.set_title(f"{pair.words}, {pair.scene.view}")
        bar = ScalarMappable(scale, SIGMA_MAP)
        figure.colorbar(bar, ax=face, extend="both", pad=0.01, label="level of detection / cm")
        _lod_shares(shares, pair)
    return figure


def _lod_shares(ax: Axes, pair: BankPair) -> None:
    """Shares of the core points below a level of detection, and below each of its parts alone."""
    lod = 100 * pair.table["lod95_m"].dropna().to_numpy()
    share = 100 * (np.arange(len(lod)) + 1) / len(lod)
    middle, most = np.percentile(lod, [50, 95])
    label = f"level of detection: median {middle:.1f} cm, 95 % below {most:.1f} cm"
    ax.plot(np.sort(lod), share, color="black", lw=1.8, label=label, gid="total")
    for name, words, colour, style in PARTS:
        part = 100 * WIDE * pair.table[name].dropna().to_numpy()
        text = f"{words} alone: median {np.median(part):.2g} cm"
        ax.plot(np.sort(part), share, color=colour, ls=style, label=text, gid=name)
    for rmse, place in zip(PUBLISHED_M, (("right", -2.0), ("left", 2.0)), strict=True):
        ax.axvline(100 * rmse, color=GREY, lw=0.8, ls=(0, (6, 3)), gid="published")
        ax.annotate(
            f"{100 * rmse:.0f} cm",
            (100 * rmse, 3.0),
            xytext=(place[1], 0.0),
            textcoords="offset points",
            ha=place[0],
            fontsize=7,
            color=GREY,
        )
    ax.plot([], [], color=GREY, lw=0.8, ls=(0, (6, 3)), label="RMSE of each epoch in T 4.1")
    ax.set_xscale("log")
    ax.set_xlim(0.01, max(100.0, 1.2 * lod.max()))
    ax.set_xticks([0.01, 0.1, 1.0, 10.0, 100.0], ["0.01", "0.1", "1", "10", "100"])
    ax.set_ylim(0, 101)
    ax.grid(visible=True)
    ax.set_xlabel("1.96 standard deviations of a distance / cm")
    ax.set_ylabel("core points below / %")
    ax.legend(loc="upper left", bbox_to_anchor=(0.0, -0.2), ncols=2, frameon=False)


def draw_level_of_detection(
    *, changes: list[Path], core_points: Path, spacing_m: float, by_boat: bool, title: str, twin: bool
) -> Figure:
    """Compared core points -> the smallest change that counts, place by place."""
    pairs = read_pairs(changes, core_points, spacing_m, by_boat=by_boat)
    return level_of_detection(pairs, title=f"Level of detection: {title}", twin=twin)


# ---------------------------------------------------------------- stable ground


@styled
def stable_ground(pairs: Sequence[BankPair], stable: Sequence[Stable], *, title: str, twin: bool) -> Figure:
    """Distances over their sigma where nothing moved, and along the bank."""
    n = count(int(sum(each.unmoved.sum() for each in stable)))
    figure = new_figure(104.0 * len(pairs) + 8.0, f"{title}, n = {n} distances", twin=twin)
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
    twin: bool,
) -> Figure:
    """Distances where nothing moved -> their histogram over sigma, and along the bank."""
    pairs = read_pairs(changes, core_points, spacing_m, by_boat=by_boat)
    stable = read_stable(pairs, registrations, weights)
    return stable_ground(pairs, stable, title=f"Stable ground: {title}", twin=twin)


# ---------------------------------------------------------------- variogram


# ---------------------------------------------------------------- volumes along the bank


@styled
def volume_along(
    tables: Sequence[tuple[str, pd.DataFrame]], *, by_boat: bool, title: str, twin: bool
) -> Figure:
    """Eroded, deposited and net volume of each stretch, and the area that was not seen."""
    figure = new_figure(98.0 * len(tables) + 4.0, title, twin=twin)
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
            width = (rows["s_to_m"] - rows["s_from_m"]).to_numpy()
            x = 0.5 * (rows["s_from_m"] + rows["s_to_m"]).to_numpy() + shift * width
            v = rows["volume_m3"].to_numpy()
            use = rows["area_m2"].to_numpy() > 0
            half = (rows["high_m3"] - rows["volume_m3"]).to_numpy()
            bars = what != "net"
            if bars:
                volumes.bar(x[use], v[use], 0.2 * width[use], color=colour, alpha=0.6, lw=0, gid=what)
            volumes.errorbar(
                x[use],
                v[use],
                half[use],
                fmt=marker,
                ms=3,
                color=colour,
                lw=0.9,
                capsize=1.5,
                label=f"{what}: {signed(v.sum(), 1)} m³",
            )
        volumes.axhline(0.0, color="black", lw=0.6)
        volumes.set_ylabel("volume / m³")
        low, high = volumes.get_ylim()
        volumes.set_ylim(low, high + 0.18 * (high - low))
        length_m = float((table["s_to_m"] - table["s_from_m"]).iloc[0])
        volumes.set_title(
            f"epochs {name.replace('-', ' to ')}, {len(rows)} stretches of {length_m:g} m, bars: 95 %"
        )
        volumes.legend(loc="upper center", ncols=3)
        volumes.tick_params(labelbottom=False)
        unseen.bar(
            0.5 * (rows["s_from_m"] + rows["s_to_m"]),
            rows["not_seen_m2"],
            0.9 * width,
            color=GREY,
            gid="not-seen",
        )
        unseen.set_ylabel("no data / m²")
        unseen.set_xlabel(scene(by_boat).along)
        unseen.sharex(volumes)
    figure.align_ylabels(panels)
    return figure


def draw_volume_along(*, along: list[Path], by_boat: bool, title: str, twin: bool) -> Figure:
    """Volumes of stretches -> bars along the bank or surface."""
    tables = [(path.stem.rpartition("_")[2], pd.read_csv(path)) for path in along]
    words = f"Volume of change along {scene(by_boat).thing}: {title}"
    return volume_along(tables, by_boat=by_boat, title=words, twin=twin)


@styled
def retreat_along(
    tables: Sequence[tuple[str, pd.DataFrame]], *, by_boat: bool, title: str, twin: bool
) -> Figure:
    """How far bank line and bank top moved in each stretch."""
    words = scene(by_boat)
    figure = new_figure(66.0 * len(tables) + 4.0, title, twin=twin)
    panels = figure.subplots(len(tables), 1, squeeze=False)[:, 0]
    for ax, (name, table) in zip(panels, tables, strict=True):
        for line, colour, marker, shift in (
            ("bank line", BLUE, "v", -0.1),
            ("bank top", VERMILION, "^", 0.1),
        ):
            rows = table[table["line"] == line]
            width = rows["s_to_m"] - rows["s_from_m"]
            label = f"{words.lines[line]}, n = {len(rows)} stretches"
            if line == "bank line" and len(rows):
                label += f", at a height of {signed(rows['height_m'].iloc[0], 2)} m"
            ax.errorbar(
                0.5 * (rows["s_from_m"] + rows["s_to_m"]) + shift * width,
                100 * rows["nsm_m"],
                100 * (rows["high_m"] - rows["nsm_m"]),
                fmt=marker,
                ms=3.5,
                color=colour,
                lw=0.9,
                capsize=1.5,
                label=label,
            )
        ax.axhline(0.0, color="black", lw=0.6)
        ax.set_title(f"epochs {name.replace('-', ' to ')}, bars: 95 %")
        ax.set_ylabel(f"movement across {words.thing} / cm\n(negative: retreat)")
        low, high = ax.get_ylim()
        ax.set_ylim(low, high + 0.2 * (high - low))
        ax.legend(loc="upper center", ncols=2)
        ax.set_xlabel(words.along)
    return figure


def draw_retreat_along(*, retreat: list[Path], by_boat: bool, title: str, twin: bool) -> Figure:
    """Movement of both lines in stretches -> along the bank or surface."""
    tables = [(path.stem.rpartition("_")[2], pd.read_csv(path)) for path in retreat]
    words = f"Movement of {scene(by_boat).thing}: {title}"
    return retreat_along(tables, by_boat=by_boat, title=words, twin=twin)


# ---------------------------------------------------------------- more than two epochs

SHOWN: Final = 6
"""Core points whose series are drawn."""


def chosen_places(series: pd.DataFrame, n_epochs: int) -> list[int]:
    """Core points that all epochs saw: three with the largest trends in their sigma, three of all others.

    These lie at the quarters of the others' trends, so that stable ground is among them.
    """
    whole = series[(series["n_epochs"] == n_epochs) & series["trend_m_a"].notna()]
    if whole.empty:
        return []
    ratio = (whole["trend_m_a"] / whole["sigma_trend_m_a"]).abs().sort_values(ascending=False)
    largest = list(ratio.index[: SHOWN // 2])
    rest = ratio.iloc[SHOWN // 2 :]
    middle = [rest.index[int(share * (len(rest) - 1))] for share in (0.25, 0.5, 0.75)] if len(rest) else []
    return [int(series.loc[row, "place"]) for row in dict.fromkeys([*largest, *middle])]


@styled
def time_series(
    heights: pd.DataFrame, series: pd.DataFrame, cores: pd.DataFrame, *, title: str, twin: bool
) -> Figure:
    """Distances of some core points from the first epoch over time, with their trends."""
    figure = new_figure(112.0, title, twin=twin)
    places = chosen_places(series, int(heights["epoch"].max()))
    for ax, place in zip(figure.subplots(2, 3, sharex=True).ravel(), places, strict=False):
        rows = heights[heights["place"] == place]
        fit = series[series["place"] == place].iloc[0]
        t, d = rows["t_a"].to_numpy(), 100 * rows["distance_m"].to_numpy()
        sigma = 100 * WIDE * rows["sigma_m"].to_numpy()
        ax.errorbar(t, d, sigma, fmt="o", ms=3.5, color=BLUE, lw=0.9, capsize=1.5, gid="series")
        weights = 1.0 / rows["sigma_m"].to_numpy()
        slope = 100 * fit["trend_m_a"]
        level = np.average(d - slope * t, weights=weights**2)
        ax.plot(t, level + slope * t, color=VERMILION, lw=1.0, gid="trend")
        at = cores.loc[cores["core"] == place].iloc[0]
        ax.set_title(
            f"s {signed(at['s_m'], 1)} m, height {signed(at['up_m'], 1)} m\n"
            f"{signed(slope, 1)} ± {100 * fit['sigma_trend_m_a']:.1f} cm/a"
        )
        ax.grid(visible=True)
    for ax in figure.axes[len(places) :]:
        ax.set_axis_off()
    figure.supxlabel("years since the first epoch", fontsize="medium")
    figure.supylabel("distance from the first epoch / cm (bars: 95 % of each epoch)", fontsize="medium")
    return figure


def draw_time_series(*, heights: Path, series: Path, core_points: Path, title: str, twin: bool) -> Figure:
    """Distances at core points over time -> six of them."""
    table = read_table(heights, HEIGHTS)[0]
    n = count(table["place"].nunique())
    return time_series(
        table,
        read_table(series, SERIES)[0],
        read_table(core_points, CORE_POINTS)[0],
        title=f"Six of {n} core points over time: {title}",
        twin=twin,
    )
