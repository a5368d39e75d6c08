"""The bank in the colours of photographs, and which points have none."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from thalweg.core import ArrayF, CoverageError, Trajectory
from thalweg.figures import BLUE, GREY, WIDTH_MM, count, leave_out, new_figure, robust_limits, styled
from thalweg.lidar import sample_cloud


def draw_coloured_bank(
    *, points: Path, counts: Path, trajectory: Path, max_points: int, title: str, twin: bool
) -> Figure:
    """Coloured cloud and its counts -> the bank seen from the boat."""
    path = Trajectory.read(trajectory)
    cloud = sample_cloud(points, max_points)
    colours = sample_colours(points, max_points)
    return coloured_bank(
        cloud["xyz_m"],
        colours,
        cloud["n_views"],
        path.position_wcs_m[path.valid],
        pd.read_csv(counts),
        title=f"Bank in the colours of photographs: {title}",
        twin=twin,
    )


def sample_colours(points: Path, max_points: int) -> ArrayF:
    """Colours (n, 3), 0 to 1, of the points of `sample_cloud`."""
    return sample_cloud(points, max_points)["rgb"].astype(np.float64) / 65535


@styled
def coloured_bank(
    xyz_m: ArrayF,
    rgb: ArrayF,
    n_views: ArrayF,
    track_m: ArrayF,
    counts: pd.DataFrame,
    *,
    title: str,
    twin: bool,
) -> Figure:
    """The bank as the boat passes it: along its way and upward, in colour and by the number of views.

    Parameters
    ----------
    xyz_m, rgb, n_views : (n, 3), (n, 3) from 0 to 1, (n,) of the points.
    track_m : (k, 3) of the boat.
    counts : columns words, n of `thalweg.lidar.colour_cloud`.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    CoverageError : no point has a colour.
    """
    has = n_views > 0
    if not has.any():
        raise CoverageError("no point has a colour", expected="photographs that show the cloud")
    middle = track_m.mean(axis=0)
    axis = np.linalg.svd(track_m[:, :2] - middle[:2], full_matrices=False)[2][0]
    axis = axis if (track_m[-1, :2] - track_m[0, :2]) @ axis > 0 else -axis
    along = (xyz_m[:, :2] - middle[:2]) @ axis
    across = (xyz_m[:, :2] - middle[:2]) @ np.array([-axis[1], axis[0]])
    # the side that the camera saw more of; far points first, so that near ones cover them
    side = 1.0 if np.sum(across[has] > 0) >= np.sum(across[has] < 0) else -1.0
    mine = np.flatnonzero(across * side > 0)
    mine = mine[np.argsort(-np.abs(across[mine]), kind="stable")]
    low, high = robust_limits(along[mine][has[mine]])
    top = np.quantile(xyz_m[mine, 2][has[mine]], 0.999) + 0.5
    bottom = np.quantile(xyz_m[mine, 2][has[mine]], 0.001) - 0.3
    each_mm = float(np.clip(0.8 * WIDTH_MM * (top - bottom) / (high - low), 25.0, 80.0))
    figure = new_figure(
        2 * each_mm + 50.0,
        f"{title}, n = {count(int(has.sum()))} coloured points of {count(len(has))} drawn",
        twin=twin,
    )
    above, below, text = figure.subplots(3, 1, height_ratios=[each_mm, each_mm, 22.0])
    for ax in (above, below):
        ax.set_xlim((low, high) if side > 0 else (high, low))
        ax.set_ylim(bottom, top)
        ax.set_aspect("equal", adjustable="box")
        ax.set_ylabel("up / m")
    seen = mine[has[mine]]
    above.scatter(along[seen], xyz_m[seen, 2], c=rgb[seen], s=0.6, linewidths=0, rasterized=True)
    above.set_facecolor("white")
    shown = below.scatter(
        along[mine], xyz_m[mine, 2], c=n_views[mine], s=0.6, linewidths=0, cmap="cividis", rasterized=True
    )
    figure.colorbar(
        shown, ax=[above, below], label="number of photographs", shrink=0.5, ticks=MaxNLocator(integer=True)
    )
    below.set_xlabel("along the boat's way / m (local frame), seen from the boat")
    text.axis("off")
    lines = [f"{count(n)}  {words}" for n, words in zip(counts["n"].tolist(), counts["words"], strict=True)]
    text.text(0.0, 1.0, "All points of the cloud:\n" + "\n".join(lines), va="top", fontsize=8)
    return figure


def draw_colour_check(*, check: Path, curves: Path, title: str, twin: bool) -> Figure:
    """Test of clock and mount by intensity and brightness -> dependence over what was tried."""
    return colour_check(
        pd.read_csv(check), pd.read_csv(curves), title=f"Intensity against brightness: {title}", twin=twin
    )


@styled
def colour_check(check: pd.DataFrame, curves: pd.DataFrame, *, title: str, twin: bool) -> Figure:
    """How much intensity and brightness depend on each other over shifts of clock and mount.

    Parameters
    ----------
    check, curves : of `thalweg.lidar.check_colours`.
    title : first words of the title.
    twin : true if the digital twin made the data.
    """
    n = int(check["photographs"].max())
    figure = new_figure(100.0, f"{title}, n = {n} photographs", twin=twin)
    words = {
        "clock_s": "camera time shift / s",
        **{f"turn_{a}_deg": f"camera rotation about its {a} axis / °" for a in "xyz"},
    }
    panels = figure.subplots(2, 2, sharey=True).ravel()
    for ax in panels[len(check) :]:
        leave_out(ax, "not tested")
    for ax, row in zip(panels, check.to_dict("records"), strict=False):
        curve = curves[curves["quantity"] == row["quantity"]]
        ax.axvline(0.0, color=GREY, linewidth=0.8)
        ax.plot(curve["shift"], 1e3 * curve["dependence"], ".-", color=BLUE, markersize=4)
        told = str(row["verdict"]).replace("fits", "consistent with 0")
        if np.isfinite(row["optimum"]):
            ax.axvspan(
                row["optimum"] - 2 * row["sigma"], row["optimum"] + 2 * row["sigma"], color=BLUE, alpha=0.2
            )
            told = f"shift {row['optimum']:+.3f} ± {row['sigma']:.3f}: {told}"
        ax.set_title(told, fontsize=9)
        ax.set_xlabel(words[str(row["quantity"])])
    figure.supylabel("mutual information / millinat", fontsize=9)
    return figure
