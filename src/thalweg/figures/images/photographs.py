"""Photographs of the bank: positions with control points, masks."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from string import ascii_lowercase
from typing import Any, Final

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from thalweg.accuracy import verdict_of
from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayU8,
    CoverageError,
    GeometryError,
    InputError,
    Trajectory,
)
from thalweg.figures import (
    BLUE,
    GREEN,
    GREY,
    HALO,
    JUDGED,
    ORANGE,
    PURPLE,
    RED,
    SIGMA_MAP,
    SKY,
    VERMILION,
    WIDTH_MM,
    Finding,
    Page,
    Pictures,
    count,
    legend_below,
    marks_in_free_corners,
    new_figure,
    plan_height_mm,
    plural,
    read_picture,
    styled,
)
from thalweg.figures.accuracy import round_above
from thalweg.figures.calibration import with_units
from thalweg.figures.survey import map_extent, plain_numbers, sigma_norm, track_of
from thalweg.images import read_all_control_points
from thalweg.images.model import ControlPoints, ImagePoses
from thalweg.ingest.photos import Images, named_images

ROLES: Final = {"control": (PURPLE, "^"), "check": (GREEN, "s")}
"""Colour and marker of points that took part and of points that only checked."""
ARROW_SHARE: Final = 0.07
"""Length of the longest residual vector over the width of the map."""
MOST_NAMES: Final = 40
MAP_MM: Final = 110.0
_BARS_MM: Final = 52.0
_AXES: Final = (("east", BLUE, "o"), ("north", VERMILION, "s"), ("up", GREEN, "^"))

EXAMPLES: Final = 3
_COLUMNS: Final = 4
_LONGEST_PX: Final = 900
"""Side of a picture in the figure; more would not be seen."""
_DARKER: Final = 0.42
_LINES: Final = {
    "usable_share": ("usable", VERMILION, "-"),
    "water_share": ("water", BLUE, "--"),
    "sky_share": ("sky", SKY, "-."),
    "hull_share": ("own boat", ORANGE, ":"),
    "moved_share": ("moved while the camera stayed", PURPLE, (0, (3, 1, 1, 1))),
}


# ---------------------------------------------------------------- positions and control points (P2 Fig. 6 and
# 10)


@styled
def image_positions(
    poses: ImagePoses,
    control: ControlPoints,
    report: pd.DataFrame,
    *,
    trajectory: Trajectory | None = None,
    title: str = "Images and control points",
) -> Figure:
    """Map of the images and of the control and check points with residual vectors; all components below.

    A residual is adjusted minus surveyed, as if the point's own coordinates had taken no part: so control and
    check points can be compared.

    Parameters
    ----------
    poses : of the images; those without a pose are marked on the trajectory at their time.
    control : surveyed points.
    report : see `thalweg.images.bundle.job.control_table`.
    trajectory : of the boat by INS, drawn behind the images.
    title : first words of the title.

    Raises
    ------
    GeometryError : no image has a pose.
    """
    if not poses.oriented.any():
        raise GeometryError(f"none of {len(poses.images)} images has a pose", expected="at least one")
    points = _with_places(control, report)
    centres = poses.centre_wcs_m[poses.oriented]
    measured = points[np.isfinite(points["without_east_mm"].to_numpy())]
    shown = [centres[:, :2], points[["east_m", "north_m"]].to_numpy()]
    low, high = map_extent(np.concatenate(shown), None)
    scale = _scale(measured, float(high[0] - low[0]))
    low, high = map_extent(np.concatenate([*shown, *_ellipse_ends(measured, scale)]), None)
    map_mm = min(plan_height_mm(high[0] - low[0], high[1] - low[1]), MAP_MM)
    oriented = int(poses.oriented.sum())
    head = f"{title}, n = {count(oriented)} of {plural(len(poses.images), 'image')}"
    roles = points["role"].value_counts()
    head += "".join(f", {plural(roles[role], f'{role} point')}" for role in ROLES if role in roles)
    figure = new_figure(map_mm + (_BARS_MM if len(measured) else 0.0), head)
    if len(measured):
        plan, bars = figure.subplots(2, 1, height_ratios=[map_mm, _BARS_MM])
        _draw_components(bars, measured)
    else:
        plan = figure.add_subplot()
    plan.set_aspect("equal")
    plan.set_xlim(low[0], high[0])
    plan.set_ylim(low[1], high[1])
    _draw_images(figure, plan, poses, trajectory)
    _draw_points(plan, points)
    if len(measured):
        _draw_vectors(plan, measured, scale)
    named = points if len(points) <= MOST_NAMES else points.iloc[:0]
    for name, east, north in named[["point", "east_m", "north_m"]].to_numpy():
        plan.annotate(
            name,
            (east, north),
            xytext=(4, 4),
            textcoords="offset points",
            fontsize=7,
            zorder=9,
            path_effects=HALO,
        )
    plan.ticklabel_format(style="plain", useOffset=False)
    plan.set_xlabel("east / m")
    plan.set_ylabel("north / m")
    plan.set_title(_words(points))
    marks_in_free_corners(plan, np.concatenate(shown))
    legend_below(figure, plan)
    return figure


def _with_places(control: ControlPoints, report: pd.DataFrame) -> pd.DataFrame:
    """The report with the surveyed places of its points; points that took no part have no residual."""
    place = pd.DataFrame(control.points_wcs_m[:, :2], columns=["east_m", "north_m"]).assign(
        point=np.array(control.names, object)
    )
    # a table without points has columns without a type
    east_mm = report["without_east_mm"].astype(float)
    typed = report.assign(point=report["point"].astype(str), without_east_mm=east_mm)
    return typed.merge(place, on="point")


def _draw_images(figure: Figure, ax: Axes, poses: ImagePoses, trajectory: Trajectory | None) -> None:
    use = poses.oriented
    centres = poses.centre_wcs_m[use]
    variance = np.diagonal(poses.cov_pose_wcs[use], axis1=1, axis2=2)[:, :3]
    sigma_mm = 1e3 * np.sqrt(variance.sum(axis=1))
    if trajectory is not None:
        ax.plot(*track_of(trajectory).T, color="0.65", lw=0.8, zorder=2, label="trajectory by INS")
        _draw_lost(ax, poses, trajectory)
    # views to see where the camera looked; z of ccs is the view
    ends = centres[:, :2] + 0.02 * float(np.ptp(ax.get_xlim())) * poses.R_wcs_ccs[use][:, :2, 2]
    ax.plot(*np.stack([centres[:, :2], ends]).transpose(2, 0, 1), color="0.35", lw=0.5, zorder=3)
    norm = sigma_norm(sigma_mm)
    dots = ax.scatter(
        centres[:, 0],
        centres[:, 1],
        s=16,
        c=sigma_mm,
        cmap=SIGMA_MAP,
        norm=norm,
        edgecolors="black",
        lw=0.4,
        zorder=4,
        label="image, with its view",
    )
    bar = figure.colorbar(
        dots, ax=ax, shrink=0.9, aspect=25, pad=0.01, extend="max", label="3D position sigma of an image / mm"
    )
    plain_numbers(bar.ax.yaxis, norm)


def _draw_lost(ax: Axes, poses: ImagePoses, trajectory: Trajectory) -> None:
    lost = ~poses.oriented & np.isfinite(poses.t_gps_s)
    if lost.any():
        place, _, known = trajectory.at(poses.t_gps_s[lost])
        words = f"image without a pose, n = {count(known.sum())}"
        ax.plot(*place[known, :2].T, "x", ms=4.5, color=RED, zorder=5, label=words)


def _draw_points(ax: Axes, points: pd.DataFrame) -> None:
    unused = ~points["role"].isin(list(ROLES)) | (points["images"] == 0)
    kinds = [(points["role"] == role, look, f"{role} point", role) for role, look in ROLES.items()]
    words = "point seen in no image, or left out"
    for use, (colour, marker), label, gid in (*kinds, (unused, ("0.4", "x"), words, "left-out")):
        if use.any():
            places = points.loc[use, ["east_m", "north_m"]].to_numpy().T
            ax.plot(
                *places,
                marker,
                ms=6,
                mfc=colour,
                mec=colour if marker == "x" else "black",
                zorder=7,
                label=label,
                gid=gid,
            )


def _scale(points: pd.DataFrame, width_m: float) -> float:
    """Metres on the map for a millimetre of a residual."""
    off = _components(points, "without_")
    return ARROW_SHARE * width_m / float(max([*np.hypot(off[:, 0], off[:, 1]), 1e-3]))


def _ellipse_ends(points: pd.DataFrame, scale: float) -> tuple[ArrayF, ArrayF]:
    """Lower left and upper right of all vectors with their ellipses (n, 2)."""
    off, sigma = _components(points, "without_")[:, :2], _components(points, "sigma_without_")[:, :2]
    end = points[["east_m", "north_m"]].to_numpy() + scale * off
    return end - scale * np.nan_to_num(sigma), end + scale * np.nan_to_num(sigma)


def _draw_vectors(ax: Axes, points: pd.DataFrame, scale: float) -> None:
    """Horizontal residuals, enlarged, with the ellipse that their sigmas predict at their ends."""
    off, sigma = _components(points, "without_"), _components(points, "sigma_without_")
    start = points[["east_m", "north_m"]].to_numpy()
    key_mm = round_above(0.5 * float(max(np.hypot(off[:, 0], off[:, 1]).max(), 1e-3)))
    arrows = ax.quiver(
        *start.T, *(scale * off[:, :2]).T, angles="xy", scale_units="xy", scale=1.0, width=0.0028, zorder=8
    )
    for place, spread in zip(start + scale * off[:, :2], sigma[:, :2], strict=True):
        if np.isfinite(spread).all():
            ax.add_patch(
                Ellipse(
                    place,
                    *(2 * scale * spread),
                    facecolor="none",
                    edgecolor="0.3",
                    lw=0.7,
                    zorder=7,
                    gid="sigma-ellipse",
                )
            )
    suspect = points["suspect"].to_numpy(bool)
    if suspect.any():
        ax.plot(*start[suspect].T, "o", ms=12, mfc="none", mec=RED, zorder=8, label="suspect")
    ax.quiverkey(
        arrows,
        0.985,
        1.035,
        scale * key_mm,
        f"{key_mm:g} mm",
        labelpos="W",
        coordinates="axes",
        fontproperties={"size": 7},
    )


def _draw_components(ax: Axes, points: pd.DataFrame) -> None:
    off, sigma = _components(points, "without_"), _components(points, "sigma_without_")
    x = np.arange(len(points), dtype=np.float64)
    for k, (axis, colour, marker) in enumerate(_AXES):
        ax.errorbar(
            x + 0.22 * (k - 1),
            off[:, k],
            sigma[:, k],
            fmt=marker,
            ms=3.6,
            color=colour,
            elinewidth=1.0,
            capsize=1.5,
            label=axis,
        )
    ax.axhline(0.0, color="black", lw=0.7, zorder=1)
    ax.set_xlim(-0.6, len(points) - 0.4)
    reach = float(np.nanmax(np.abs(off) + np.nan_to_num(sigma)))
    # the legend stands above the bars
    ax.set_ylim(-1.1 * reach, 1.6 * reach)
    names = points["point"].tolist()
    step = -(-len(names) // MOST_NAMES)
    ax.set_xticks(x[::step], names[::step], rotation=90 if len(names) > 12 else 0)
    for tick, role in zip(ax.get_xticklabels(), points["role"].tolist()[::step], strict=True):
        tick.set_color(ROLES.get(role, ("black", ""))[0])
    ax.set_ylabel("adjusted minus\nsurveyed / mm")
    ax.set_title("b: as if the point had taken no part, with its predicted sigma; colour of a name: role")
    ax.grid(axis="y")
    ax.legend(loc="upper right", ncols=3)


def _components(points: pd.DataFrame, prefix: str) -> ArrayF:
    return points[[f"{prefix}{axis}_mm" for axis, _, _ in _AXES]].to_numpy()


def _words(points: pd.DataFrame) -> str:
    measured = np.isfinite(points["without_east_mm"].to_numpy())
    check: AnyArray = ((points["role"] == "check") & (points["images"] > 0)).to_numpy() & measured
    words = "a: residual vectors with the ellipses of their sigmas"
    if not check.any():
        return words
    rmse = np.sqrt(np.mean(_components(points[check], "without_") ** 2, axis=0))
    numbers = ", ".join(f"{axis} {value:.1f}" for (axis, _, _), value in zip(_AXES, rmse, strict=True))
    return f"{words}\nRMSE of {plural(check.sum(), 'check point')}: {numbers} mm"


def draw_image_positions(
    *,
    poses: Path,
    control_points: list[Path],
    report: Path,
    trajectory: list[Path],
    crs: str,
    sigma_m: list[float],
    title: str,
) -> Figure:
    """Image poses, control points and their report -> map of both with residual vectors.

    ``trajectory``: none, or the boat's.
    """
    images = ImagePoses.read(poses)
    points = read_all_control_points(control_points, images.frame, crs=crs, sigma_m=sigma_m)
    return image_positions(
        images,
        points,
        pd.read_csv(report, dtype={"point": str}),
        trajectory=Trajectory.read(trajectory[0]) if trajectory else None,
        title=f"Images and control points: {title}",
    )


# ---------------------------------------------------------------- masks (P2 Fig. 12)


@styled
def mask_view(
    table: pd.DataFrame, pictures: Mapping[str, tuple[ArrayU8, ArrayB]], *, title: str = "Masks"
) -> Figure:
    """Example images with masked parts dark and hatched, and shares of all images below.

    Parameters
    ----------
    table : of `thalweg.images.masks.make_masks`, one row per image in order of time.
    pictures : by the names of some images, picture (h, w[, 3]) uint8 and its usable pixels (h, w).
    title : first words of the title.
    """
    share = table["usable_share"].to_numpy()
    numbers = {str(name): k for k, name in enumerate(table["image"])}
    for name, (picture, usable) in pictures.items():
        if name not in numbers or picture.shape[:2] != usable.shape:
            raise InputError(f"picture {name} of shape {picture.shape} with a mask of {usable.shape}")
    n = int(np.isfinite(share).sum())
    columns = min(len(pictures), _COLUMNS)
    rows = -(-len(pictures) // columns)
    high = max(p.shape[0] / p.shape[1] for p, _ in pictures.values())
    tall = rows * min(WIDTH_MM / columns * high, 110.0)
    head = f"{title}: median usable share {100 * np.nanmedian(share):.0f} %, n = {plural(n, 'image')}"
    figure = new_figure(tall + 62.0, head)
    upper, lower = np.ravel(np.asarray(figure.subfigures(2, 1, height_ratios=[tall + 10.0, 46.0])))
    axes = np.ravel(upper.subplots(rows, columns))
    for letter, ax, name in zip(ascii_lowercase, axes, pictures, strict=False):
        _picture(ax, *pictures[name])
        ax.set_title(f"{letter}: image {numbers[name] + 1}, {100 * share[numbers[name]]:.0f} % usable")
    for ax in axes[len(pictures) :]:
        ax.set_axis_off()
    _shares(
        lower.subplots(), table, sorted(numbers[name] for name in pictures), ascii_lowercase[len(pictures)]
    )
    return figure


def example_names(table: pd.DataFrame, n: int = EXAMPLES, tail: float = 0.1) -> list[str]:
    """Images from one tail of the usable share to the other (10th, 50th, 90th percentile), in order of time.

    Raises
    ------
    CoverageError : no image has a mask.
    """
    order = table["usable_share"].dropna().sort_values(kind="stable").index
    if order.empty:
        raise CoverageError("no image has a mask", expected="at least one")
    chosen = {order[round(q * (len(order) - 1))] for q in np.linspace(tail, 1.0 - tail, n)}
    return [str(table.loc[k, "image"]) for k in sorted(chosen)]


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
    files = named_images(images)
    out = {}
    for name in names:
        picture, mask = read_picture(files[name]), read_picture(masks / f"{name}.png")
        if picture.shape[:2] != mask.shape[:2]:
            raise InputError(
                f"a mask of {mask.shape[:2]} for an image of {picture.shape[:2]} rows and columns",
                expected="equal sizes",
                where=masks / f"{name}.png",
            )
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
    ax.set(xticks=[], yticks=[])


def _shares(ax: Axes, rows: pd.DataFrame, examples: list[int], letter: str) -> None:
    number: ArrayF = np.arange(1, len(rows) + 1, dtype=np.float64)
    # A series of one image has points, no lines.
    marker = "." if len(rows) < 40 else ""
    for column, (label, colour, style) in _LINES.items():
        percent = 100 * rows.get(column, pd.Series(np.nan, rows.index)).to_numpy()
        if np.isfinite(percent).any() and (np.nanmax(percent) > 0 or column != "moved_share"):
            ax.plot(number, percent, color=colour, ls=style, marker=marker, ms=4, label=label, gid=column)
    for k in examples:
        ax.axvline(k + 1, color=GREY, lw=0.7, ls=":")
    ax.set_xlim(0.5, len(rows) + 0.5)
    ax.set_ylim(0, None)
    ax.set(xlabel="image", ylabel="share of the image / %")
    ax.set_title(f"{letter}: parts of all images; dotted: those above")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    ax.grid()


def draw_mask_view(*, images: list[Path], masks: Path, table: Path, title: str) -> Figure:
    """Images and their masks -> figure of what is usable for matching."""
    rows = pd.read_csv(table, keep_default_na=True).fillna({"note": ""})
    pictures = read_examples(example_names(rows), named_images(images), masks)
    return mask_view(rows, pictures, title=title)


# ---------------------------------------------------------------- page of photographs oriented without a boat


def _three(values: Mapping[str, float]) -> str:
    return " / ".join(f"{v:.1f}" for v in values.values())


def _sigma_finding(facts: Mapping[str, Any], stated: str = "") -> Finding:
    if "model_frame" in facts:
        sigma = " / ".join(f"{v:.2g}" for v in facts["sigma_position_model"].values())
        return Finding("position sigma, x / y / z, median", f"{sigma} units of the model")
    sigma = _three(facts["sigma_position_mm"])
    return Finding("position sigma, x / y / z, median", f"{sigma} mm", stated)


def _check_finding(check: Mapping[str, Any], judged: str, worth: str = "") -> Finding:
    """What check points say, with the verdict on the predicted standard deviations."""
    return Finding(
        f"RMSE of {plural(check['points'], 'check point')}, x / y / z",
        f"{_three(check['rmse_mm'])} mm",
        f"predicted {_three(check['predicted_mm'])} mm{worth}; {judged}",
    )


def _add_points(page: Page, control: pd.DataFrame, axes: tuple[str, str, str], words: str) -> None:
    """Table of surveyed points, whose columns get the names of the axes."""
    names = {
        f"{s}without_{a}_mm": f"{s}{b}"
        for a, b in zip(("east", "north", "up"), axes, strict=True)
        for s in ("", "sigma_")
    }
    shown = control[["point", "role", "images", "rms_px", *names, "normalised", "suspect", "reason"]]
    units = dict.fromkeys(names.values(), "mm") | {"rms": "px"}
    page.table(shown.rename(columns=names | {"rms_px": "rms"}), words, units, digits=3)


def orientation_page(
    facts: Mapping[str, Any],
    images: pd.DataFrame,
    control: pd.DataFrame,
    pictures: Pictures,
    *,
    captions: Mapping[str, str],
    title: str = "Photographs",
) -> Page:
    """The page of photographs that were oriented by control points or positions.

    Parameters
    ----------
    facts, images, control : of ``orientation.json``, ``images.csv``, ``control_points.csv`` that
        `thalweg.images.PhotographBlock.write` writes.
    pictures : by name.
    captions : of them.
    title : heading.
    """
    check = facts["check_points"]
    n = len(images)
    findings = [
        Finding(
            "photographs with a pose",
            f"{facts['images']} of {n}",
            "" if facts["images"] == n else "see why below",
        ),
        _sigma_finding(facts),
        Finding(
            "sigma0 of the adjustment", f"{facts['sigma0']:.2f}", f"redundancy {count(facts['redundancy'])}"
        ),
        Finding(
            "tie points", count(facts["tie_points"]), f"each in {facts['marks_a_point']:.1f} photographs"
        ),
    ]
    if check:
        judged = verdict_of(check["normalised"], check["independent"])
        findings.append(_check_finding(check, judged, f", effective n = {check['independent']:.0f}"))
        lead = f"Check points: {JUDGED[judged]}."
    else:
        findings.append(Finding("check points", "none", "too few data"))
        lead = "No check point judges the standard deviations; give some of the points the role check."
    if "model_frame" in facts:
        lead = f"{facts['notes'][0]}."
    page = Page(title, lead, findings)
    page.pictures(pictures, captions, section="Positions")
    if len(control):
        _add_points(
            page.section("Control and check points"),
            control,
            ("x", "y", "z"),
            "Adjusted minus surveyed, without the point's own coordinates; normalised: its square over the "
            "predicted one.",
        )
    page.section("Lens")
    for name, parameters in facts["cameras"].items():
        lens = pd.DataFrame(
            [(key, p["value"], p["sigma"]) for key, p in parameters.items()],
            columns=["parameter", "value", "sigma"],
        )
        page.table(lens, f"Interior orientation of {name}: focal lengths and principal point in pixels.")
    shown, units = with_units(images)
    words = "Each photograph: image points, residuals, standard deviations of its pose."
    page.section("Photographs").table(shown, words, units, digits=3)
    page.section("Notes").lines(list(facts["notes"]) or ["none"])
    return page


def finished_page(
    facts: Mapping[str, Any],
    poses: pd.DataFrame,
    control: pd.DataFrame,
    pictures: Pictures,
    *,
    captions: Mapping[str, str],
    title: str = "Photographs",
) -> Page:
    """The page of photographs without a boat that another program has oriented.

    Parameters
    ----------
    facts, poses, control : of ``finished.json``, ``finished.csv``, ``finished_points.csv``, see
        `thalweg.images.place_files`.
    pictures, captions : by name.
    title : heading.
    """
    check, sources = facts["check_points"], facts["files"]
    stated = (
        "" if not any(facts["sigmas_from_settings"].values()) else "some from images.finished, not the file"
    )
    findings = [
        Finding("photographs with a pose", f"{facts['oriented']} of {facts['images']}"),
        Finding("oriented by", ", ".join(sorted({each["program"] for each in sources}))),
        _sigma_finding(facts, stated),
    ]
    lead = "No check point judges the poses; give control points and their marks."
    if check:
        judged = verdict_of(check["normalised"], check["independent"])
        findings.append(_check_finding(check, judged))
        lead = f"Surveyed points: {JUDGED[judged]}."
    page = Page(title, lead, findings).pictures(pictures, captions, section="Positions")
    if len(control):
        _add_points(
            page.section("Surveyed points"),
            control,
            ("east", "north", "up"),
            "Intersected minus surveyed; normalised: its square over the predicted one. Poses of different "
            "photographs count as independent.",
        )
    # millimetres of coordinates on a map
    shown, units = with_units(poses.drop(columns=[f"q{a}" for a in "xyzw"]).round(3))
    page.section("Photographs").table(shown, "Poses.", units, digits=10)
    page.section("Notes").lines(list(facts["notes"]) or ["none"])
    return page
