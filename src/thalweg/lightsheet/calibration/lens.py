"""Interior orientation of the sensor's camera from pictures of a field of markers in air (P3 2.4, P4 6.2).

The self-calibrating bundle is that of the calibration field (`thalweg.calibration.field.job.measure`). Before
it runs, its normal equations at the approximate values tell whether these pictures can give an interior
orientation at all: pictures from one direction leave the camera constant to the distance, and pictures that
are not rolled the principal point to the tilt. What cannot be had is refused, with the unknown that it is
taken for.

The table of the marks is read here, the report is written here.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy import sparse

from thalweg.calibration import MARKS, block_of, nominal_camera
from thalweg.calibration.field import (
    FieldDescription,
    Layout,
    MeasuredField,
    Problem,
    Start,
    State,
    inner_constraints,
    marks_model,
    measure,
    misfit_px,
    start_network,
    start_state,
    thinned,
    with_overview,
)
from thalweg.clocks import read_text_columns
from thalweg.core import (
    ArrayF,
    Camera,
    GeometryError,
    InputError,
    LocalFrame,
    Rigid,
    read_table,
    root_mean_square,
)
from thalweg.lightsheet.calibration.camera_over_window import COLUMNS, mark_numbers
from thalweg.lightsheet.optics import LENS, Sensor

# tell about a camera: correlations, how they were taken


GOOD_MARK_PX: Final = 0.1
"""Standard deviation of a crossing of black and white in a sharp picture."""

ONE_DIRECTION: Final = float(np.deg2rad(30.0))
"""Largest angle between views that count as one direction."""

_POSE: Final = (
    "place along the rows",
    "place along the columns",
    "distance",
    "tilt about the rows",
    "tilt about the columns",
    "roll",
)
_TILTED: Final = float(np.deg2rad(5.0))
_ROLLED: Final = float(np.deg2rad(45.0))
_LEAST_EIGENVALUE: Final = 1e-15


# refuses, each with its cause


LEAST_PICTURES: Final = 6
"""With fewer hardly a mark is checked by another."""

LARGEST_SIGMA: Final = 1e-3
"""Of camera constant and principal point over the camera constant: three times P4's 0.004 mm of 12 mm; that
alone makes 0.15 mm in depth, as much as P4's whole budget near the window (P4 6.6)."""

_LARGEST_SCATTER_PX: Final = 1.0
_LARGEST_START_PX: Final = 2.0
"""A lens that is 0.4 % off its design and has 16 px of distortion in the corners leaves 0.4 px."""
_FAR: Final = 0.1
"""Relative difference of the camera constant from the design at which it is another camera."""
_LEVEL: Final = 1e-4
"""Probability with which a steady camera is called changed."""
_AT_LARGE: Final = (
    "Check that markers and corners have the same numbers in all pictures (corner 0 is the upper left one of "
    "the printed sheet), that the field stood still, and that size and camera constant of the design are "
    "those of the pictures"
)


NAME: Final = "sheet_camera"
"""Of the camera in tables; with the ending ``_interior`` of its block in files, as a sensor's file has it."""

GOOD_PICTURES: Final = 12
_REACHES: Final = 0.8
"""Share of the way from the middle to a corner of the picture that marks should reach."""

_CORNERS: Final = 4
_MOST_MIRRORED: Final = 0.5


PUBLISHED_SIGMA: Final = 0.004 / 12.0
"""Of the camera constant over itself (P4 6.2)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """State, layout, covariance, pictures of a bundle at approximate values; how badly these fit, pixels.

    ``start``: the approximate values of all pictures.
    """

    start: Start
    x: State
    layout: Layout
    cov: ArrayF
    images: tuple[str, ...]
    misfit_px: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LensCalibration:
    """A calibrated camera and what its calibration rests on.

    Parameters
    ----------
    camera : with the covariance (9, 9) of its parameters.
    measured : the bundle.
    images : image, marks, rejected, rms_px, largest (residual in sigmas).
    bars : name, stated_m, residual_mm (adjusted minus stated), off_mm and sigma_off_mm (stated minus what the
        other bars say), used.
    correlations : parameter, with, correlation; see `lens_correlations`.
    views : see `view_facts`.
    notes : for people.
    """

    camera: Camera
    measured: MeasuredField
    images: pd.DataFrame
    bars: pd.DataFrame
    correlations: pd.DataFrame
    views: dict[str, Any]
    notes: list[str]


def predicted(marks: pd.DataFrame, camera: Camera, field: FieldDescription) -> Prediction:
    """What the free bundle would know, at approximate values.

    Marks count with `GOOD_MARK_PX` where their table states more: the bundle estimates their sigma anyway,
    and here only the geometry is judged.

    Raises
    ------
    GeometryError : no approximate values, with what the pictures show.
    """
    try:
        block = block_of(marks, {camera.name: camera})
        block = replace(block, sigma_px=np.minimum(block.sigma_px, GOOD_MARK_PX))
        start = start_network(block, field.layout)
        misfit = misfit_px(block, start, float(camera.parameters[0]))
        n = len(block.images)
        oriented = np.array([i in start.poses for i in range(n)])
        nowhere = Rigid()
        poses = {i: start.poses.get(i, nowhere) for i in range(n)}
        problem = Problem(
            block, np.zeros(n, np.int64), np.ones(len(block.image), np.bool_), (camera.parameter_names,)
        )
        x = start_state(block.images, (camera,), poses, start.points)
        problem, x, _ = thinned(
            problem, x, oriented, np.ones(len(block.points), np.bool_), set(), doubt=False
        )
    except GeometryError as error:
        raise with_overview(error, marks) from error
    layout = Layout(problem, x.cameras)
    rows = (
        sparse.diags_array(1.0 / np.repeat(problem.block.sigma_px, 2))
        @ marks_model(problem, layout, x).jacobian
    )
    N = np.asarray((rows.T @ rows).todense())
    scale = np.sqrt(np.maximum(np.diag(N), 1e-30))
    Q = np.linalg.qr((inner_constraints(x.X, layout, scale=True) / scale).T)[0]
    w, V = np.linalg.eigh(N / np.outer(scale, scale) + Q @ Q.T)
    # a free combination has next to no eigenvalue: its unknowns get sigmas that nobody takes for small
    cov = (V / np.maximum(w, _LEAST_EIGENVALUE)) @ V.T / np.outer(scale, scale)
    return Prediction(start=start, x=x, layout=layout, cov=cov, images=problem.block.images, misfit_px=misfit)


def lens_cov(layout: Layout, cov: ArrayF) -> ArrayF:
    """(9, 9) part of the first camera of a joint covariance; all its parameters are unknowns."""
    at = [layout.at_camera[0][k] for k in sorted(layout.at_camera[0])]
    return cov[np.ix_(at, at)]


def lens_correlations(x: State, layout: Layout, cov: ArrayF, images: Sequence[str]) -> pd.DataFrame:
    """What each parameter of the camera is most correlated with: another one, and an element of a pose.

    Parameters
    ----------
    x, layout, cov : of a bundle with one camera.
    images : names of its pictures, in order.

    Returns
    -------
    Columns parameter, with, correlation; two rows a parameter, the pose in the
    second. Poses are taken in the camera's own frame:
    places along rows and columns, distance along the view, tilts, roll.
    """
    lens = lens_cov(layout, cov)
    at = [layout.at_camera[0][k] for k in sorted(layout.at_camera[0])]
    names = x.cameras[0].parameter_names
    sigma = np.sqrt(np.maximum(np.diag(lens), 1e-300))
    own = lens / np.outer(sigma, sigma) - np.eye(len(names))
    poses = np.empty((len(names), len(images), 6))
    for i in range(len(images)):
        turn = np.kron(np.eye(2), x.R[i].T)
        pose = layout.pose(i)
        spread = np.sqrt(np.maximum(np.diag(turn @ cov[pose, pose] @ turn.T), 1e-300))
        poses[:, i] = cov[at, pose] @ turn.T / np.outer(sigma, spread)
    rows = []
    for k, name in enumerate(names):
        j = int(np.abs(own[k]).argmax())
        rows.append((name, names[j], float(own[k, j])))
        i, part = divmod(int(np.abs(poses[k]).argmax()), len(_POSE))
        rows.append((name, f"{_POSE[part]} of {images[i]}", float(poses[k, i, part])))
    return pd.DataFrame(rows, columns=["parameter", "with", "correlation"])


def view_facts(x: State) -> dict[str, Any]:
    """How the pictures were taken.

    Returns
    -------
    ``pictures``; ``largest_angle_deg`` between the views of any two; ``rolled``: those in which the field is
    turned by more than 45 degrees against most others. Where the views differ, only tilted ones count, and
    the turn is that of the field's upright; in one direction it is that of the picture over the field.
    """
    views = x.R[:, :, 2]
    angle = np.arccos(np.clip(views @ views.T, -1.0, 1.0)).max()
    if angle < ONE_DIRECTION:
        rows = x.R[:, :, 0] @ x.R[0][:, :2]
        way = np.arctan2(rows[:, 1], rows[:, 0])
    else:
        solved = x.X[np.isfinite(x.X).all(axis=1)]
        normal = np.linalg.svd(solved - solved.mean(axis=0), full_matrices=False)[2][2]
        upright = np.einsum("ikj,k->ij", x.R, normal)
        upright *= -np.sign(upright[:, 2:])
        tilted = np.hypot(upright[:, 0], upright[:, 1]) > np.sin(_TILTED)
        way = np.arctan2(upright[:, 0], upright[:, 1])[tilted]
    alike = (np.abs(np.angle(np.exp(1j * (way[:, None] - way)))) < _ROLLED).sum(axis=1)
    rolled = int(len(way) - alike.max()) if len(way) else 0
    return {"pictures": len(views), "largest_angle_deg": float(np.rad2deg(angle)), "rolled": rolled}


def require_determined(
    camera: Camera, cov: ArrayF, correlations: pd.DataFrame, views: dict[str, Any], *, where: str = ""
) -> None:
    """Refuse an interior orientation whose camera constant or principal point is not determined.

    Parameters
    ----------
    camera, cov : values, and covariance (9, 9).
    correlations, views : see `lens_correlations` and `view_facts`.
    where : name of the table of marks.

    Raises
    ------
    GeometryError : names the parameters, their sigmas and what they are correlated with.
    """
    sigma = np.sqrt(np.maximum(np.diag(cov)[:4], 0.0))
    free = np.flatnonzero(~(sigma <= LARGEST_SIGMA * camera.parameters[0]))
    if not free.size:
        return
    told = []
    for k in free:
        name = camera.parameter_names[k]
        # that fx goes with fy, or cx with p2, is nothing that pictures could change
        most = correlations[correlations["parameter"] == name].iloc[-1]
        size = f"{sigma[k]:.1f} px" if sigma[k] < camera.size_px[0] else "more than the picture's width"
        told.append(f"{name} (sigma {size}, correlation {most['correlation']:+.4f} with {most['with']})")
    raise GeometryError(
        f"the pictures do not determine {', '.join(told)}; {_view_words(views)}",
        expected=f"sigmas below {LARGEST_SIGMA * camera.parameters[0]:.1f} px",
        where=where,
        cure="Take more pictures: tilted by 30 to 45 degrees from all sides, each second one with the camera "
        "rolled by 90 degrees about its view, and put some markers on posts of different heights",
    )


def require_pictures(marks: pd.DataFrame, where: str) -> None:
    """Refuse a table of marks of too few pictures."""
    n = int(marks["image"].nunique())
    if n < LEAST_PICTURES:
        raise GeometryError(
            f"{n} picture{'s' * (n != 1)} of the field",
            expected=f"at least {LEAST_PICTURES}, better 20",
            where=where,
            cure="Take more pictures of the field: tilted by 30 to 45 degrees from all sides, each second "
            "one with the camera rolled by 90 degrees",
        )


def require_design(camera: Camera, design: Camera, where: str) -> None:
    """Refuse a camera whose constant is another one than the design's."""
    ratio = float(camera.parameters[0] / design.parameters[0])
    if abs(ratio - 1) > _FAR:
        raise GeometryError(
            f"by the pictures the camera constant is {camera.parameters[0]:.0f} px, {ratio:.3g} times that "
            "of the design",
            expected="pictures of the sensor's camera, in the mode and at the focus of the sensor",
            where=where,
            cure="Check which camera and which lens took the pictures, or correct fx and fy in the design",
        )


def with_misfit(error: GeometryError, start_px: float) -> GeometryError:
    """The error; where already the approximate values do not fit, with what may be wrong at large."""
    if start_px < _LARGEST_START_PX:
        return error
    found = f"{error.found}; already the approximate values leave {start_px:.0f} px (median)"
    cure = f"{_AT_LARGE}; else: {error.cure}"
    return GeometryError(found, expected=error.expected, where=error.where, cure=cure)


def require_fit(scatter_px: float, where: str) -> None:
    """Refuse marks that scatter by more than a pixel after the adjustment."""
    if scatter_px > _LARGEST_SCATTER_PX:
        raise GeometryError(
            f"the marks fit one rigid field to {scatter_px:.1f} px only",
            expected=f"less than {_LARGEST_SCATTER_PX:g} px, in sharp pictures 0.1 px",
            where=where,
            cure=_AT_LARGE,
        )


def require_steady(measured: MeasuredField, where: str) -> None:
    """Refuse a change of the camera: even if it leaves the field as it is, the result mixes two cameras."""
    for change in measured.network.changes:
        if change.probability < _LEVEL:
            raise GeometryError(
                f"the camera changed between {change.before} and {change.since}: camera constant by "
                f"{change.constant:+.2%} (sigma {change.sigma_constant:.2%}), principal point by "
                f"{change.shift_px[0]:+.1f} and {change.shift_px[1]:+.1f} pixels",
                expected="one focus and one mount of the lens for all pictures, those of the sensor",
                where=where,
                cure="Take all pictures again with the focus ring fixed, or leave out those before or since",
            )


def calibrate_lens(
    marks: pd.DataFrame, design: Camera, field: FieldDescription, frame: LocalFrame, *, where: str = ""
) -> LensCalibration:
    """Interior orientation with covariance by a self-calibrating bundle.

    Parameters
    ----------
    marks : image, camera (`NAME`), marker, corner, x_px, y_px, sigma_px of all pictures.
    design : of the camera; its size, and its camera constant as approximate value, count.
    field : sizes of the sheets and scale bars.
    frame : of wcs, if the field has targets there.
    where : name of the table of marks.

    Raises
    ------
    GeometryError : too few pictures; pictures that do not determine camera constant or principal point, with
        what these are correlated; a camera that changed in their course; another camera than the design's;
        all that the bundle refuses.
    """
    require_pictures(marks, where)
    start = nominal_camera(NAME, "perspective", design.size_px, float(design.parameters[:2].mean()))
    expected = predicted(marks, start, field)
    correlations = lens_correlations(expected.x, expected.layout, expected.cov, expected.images)
    lens = lens_cov(expected.layout, expected.cov)
    require_determined(start, lens, correlations, view_facts(expected.x), where=where)
    try:
        measured = measure(marks, {NAME: start}, field, frame, start=expected.start)
    except GeometryError as error:
        raise with_misfit(error, expected.misfit_px) from error
    network = measured.network
    require_fit(float(network.report["mark_sigma_px"]), where)
    require_steady(measured, where)
    x, cov = network.adjusted.x, network.adjusted.cov
    views = view_facts(x)
    camera = network.cameras[NAME]
    correlations = lens_correlations(x, network.layout, cov, tuple(network.poses))
    require_determined(camera, camera.cov, correlations, views, where=where)
    require_design(camera, design, where)
    return LensCalibration(
        camera=camera,
        measured=measured,
        images=image_table(network.residuals),
        bars=bar_table(measured, field),
        correlations=correlations,
        views=views,
        notes=measured.notes + _notes(camera, network.residuals, marks, views),
    )


def with_lens(sensor: Sensor, camera: Camera) -> Sensor:
    """The sensor with a calibrated interior orientation, whose errors are independent of all others.

    Raises
    ------
    GeometryError : a camera of another picture size.
    """
    if camera.size_px != sensor.camera.size_px:
        raise GeometryError(
            f"an interior orientation for pictures of {camera.size_px[0]} x {camera.size_px[1]} pixels",
            expected=f"{sensor.camera.size_px[0]} x {sensor.camera.size_px[1]}, as the design says",
            cure="Calibrate the camera in the mode in which the sensor uses it",
        )
    cov = sensor.cov.copy()
    cov[LENS], cov[:, LENS] = 0.0, 0.0
    cov[LENS, LENS] = camera.cov
    own = Camera(
        model=camera.model,
        size_px=camera.size_px,
        parameters=camera.parameters,
        cov=camera.cov,
        name=sensor.camera.name,
    )
    return sensor.with_camera(own).with_vector(sensor.with_camera(own).vector(), cov=cov)


def image_table(residuals: pd.DataFrame) -> pd.DataFrame:
    """Marks, rejected ones and residuals of each picture; see `LensCalibration`."""
    rows = []
    for image, part in residuals.groupby("image", sort=True):
        used = part[part["used"]]
        rms = root_mean_square(used[["vx_px", "vy_px"]].to_numpy()) if len(used) else np.nan
        largest = float(used["standardised"].max()) if len(used) else np.nan
        rows.append((str(image), len(part), int((~part["used"]).sum()), rms, largest))
    return pd.DataFrame(rows, columns=["image", "marks", "rejected", "rms_px", "largest"])


def bar_table(measured: MeasuredField, field: FieldDescription) -> pd.DataFrame:
    """Scale bars whose ends were measured; see `LensCalibration`."""
    points, scale = measured.points, measured.network.scale
    columns = ["name", "stated_m", "residual_mm", "off_mm", "sigma_off_mm", "used"]
    at = {f"{m}/{c}": k for k, (m, c) in enumerate(points.points)}
    bars = [bar for bar in field.scale_bars if bar.start in at and bar.end in at]
    if scale is None or len(bars) != len(scale.used):
        return pd.DataFrame(columns=columns)
    rows = []
    for k, bar in enumerate(bars):
        length = float(np.linalg.norm(points.points_pcs[at[bar.end]] - points.points_pcs[at[bar.start]]))
        off, sigma = float(scale.off_m[k]), float(scale.sigma_off_m[k])
        residual = 1e3 * (length - bar.length_m)
        rows.append((bar.name, bar.length_m, residual, 1e3 * off, 1e3 * sigma, bool(scale.used[k])))
    return pd.DataFrame(rows, columns=columns)


def read_lens_marks(path: Path, size_px: tuple[int, int]) -> pd.DataFrame:
    """Marks of all pictures: image, camera, marker, corner, x_px, y_px, sigma_px.

    Parameters
    ----------
    path : CSV with file, marker, corner, x_px, y_px, sigma_px, as for the camera over the window; or a
        table of kind ``marks`` that a detection has written (Parquet).
    size_px : of the pictures.

    Raises
    ------
    InputError : the file is missing, no table or lacks columns; a cell holds no number, or one that is
        impossible; a mark stands twice in a picture; marks outside the pictures; sheets that run the wrong
        way round.
    """
    if path.suffix == ".parquet":
        table, meta = read_table(path, MARKS)
        _require_sizes(meta["sizes_px"].values(), size_px, path)
        table = table[["image", *COLUMNS]]
    else:
        table = mark_numbers(path)
        table.insert(0, "image", read_text_columns(path, ("file",))[0])
    table.insert(1, "camera", NAME)
    keys = ["image", "marker", "corner"]
    twice = table[table.duplicated(keys)]
    if len(twice):
        row = twice.iloc[0]
        raise InputError(
            f"mark {row['marker']}/{row['corner']} stands twice in {row['image']}",
            expected="each mark once in a picture",
            where=path,
            cure="Name the pictures apart; a marker that exists twice must be taken out of the field",
        )
    corner = table.loc[~table["corner"].between(0, _CORNERS - 1), "corner"]
    if len(corner):
        raise InputError(
            f"corner {corner.iloc[0]}",
            expected="0 upper left, 1 upper right, 2 lower right, 3 lower left of the printed sheet",
            where=path,
        )
    if (table["marker"] < 0).any():
        raise InputError(
            f"marker {table['marker'].min()}", expected="a number from 0, as printed", where=path
        )
    _require_inside(table, size_px, path)
    _require_clockwise(table, path)
    return table


def lens_report(found: LensCalibration) -> dict[str, Any]:
    """Facts for JSON.

    Parameters
    ----------
    found : of `thalweg.lightsheet.calibration.lens.calibrate_lens`.

    Returns
    -------
    ``camera``: value, sigma and unit of each parameter; ``sigma_over_constant``: of the camera constant and
    of the principal point over it, beside P4's; ``correlations``, ``images``, ``scale_bars`` as rows;
    ``views``; ``adjustment``: counts, sigma0 with its band, object sigmas; ``rejected``; ``notes``.
    """
    camera = found.camera
    sigma = np.sqrt(np.maximum(np.diag(camera.cov), 0.0))
    values = {
        name: {"value": float(v), "sigma": float(s), "unit": "px" if k < 4 else "1"}
        for k, (name, v, s) in enumerate(zip(camera.parameter_names, camera.parameters, sigma, strict=True))
    }
    share = sigma[:4] / camera.parameters[0]
    network = found.measured.network
    return {
        "camera": values,
        "sigma_over_constant": {
            "camera_constant": float(share[:2].max()),
            "principal_point": float(share[2:].max()),
            "published_camera_constant": PUBLISHED_SIGMA,
            "over_published": float(share[:2].max() / PUBLISHED_SIGMA),
        },
        "correlations": _rows(found.correlations),
        "views": found.views,
        "images": _rows(found.images),
        "scale_bars": _rows(found.bars),
        "adjustment": network.report,
        "rejected": _rows(network.rejected),
        "notes": found.notes,
    }


def _view_words(views: dict[str, Any]) -> str:
    angle = views["largest_angle_deg"]
    if np.deg2rad(angle) < ONE_DIRECTION:
        words = f"all look in one direction within {angle:.2g} degrees"
    else:
        words = f"they look in directions that differ by up to {angle:.0f} degrees"
    rolled = f"{views['rolled']} of {views['pictures']} are" if views["rolled"] else "none is"
    return f"{words}, and {rolled} rolled"


def _notes(camera: Camera, residuals: pd.DataFrame, marks: pd.DataFrame, views: dict[str, Any]) -> list[str]:
    notes = []
    if views["pictures"] < GOOD_PICTURES:
        notes.append(f"{views['pictures']} pictures: {GOOD_PICTURES} or more check each other better")
    keys = ["image", "marker", "corner"]
    good = residuals.loc[residuals["used"], keys].merge(marks, on=keys)[["x_px", "y_px"]].to_numpy()
    half = np.array(camera.size_px) / 2
    reach = float(np.linalg.norm(good - half, axis=1).max() / np.linalg.norm(half))
    if reach < _REACHES:
        notes.append(
            f"the marks reach {reach:.0%} of the way to the corners of the picture: what lies beyond is "
            "extrapolated. Let the field fill the picture"
        )
    return notes


def _require_sizes(found: Iterable[Sequence[int]], size_px: tuple[int, int], path: Path) -> None:
    for size in found:
        if tuple(size) != size_px:
            raise InputError(
                f"pictures of {size[0]} x {size[1]} pixels",
                expected=f"{size_px[0]} x {size_px[1]}, as the design of the sensor says",
                where=path,
                cure="Take them with the sensor's camera in the mode of the sensor",
            )


def _require_inside(table: pd.DataFrame, size_px: tuple[int, int], path: Path) -> None:
    xy = table[["x_px", "y_px"]].to_numpy()
    out = np.flatnonzero(((xy < 0) | (xy > np.array(size_px))).any(axis=1))
    if out.size:
        row = table.iloc[int(out[0])]
        raise InputError(
            f"{out.size} of {len(table)} marks lie outside the picture, such as "
            f"{row['marker']}/{row['corner']} in {row['image']} at ({row['x_px']:.1f}, {row['y_px']:.1f})",
            expected=f"pixels from 0 to {size_px[0]} and {size_px[1]}, as the design of the sensor says",
            where=path,
            cure="Take the pictures with the sensor's camera in the mode of the sensor, or correct the size "
            "of the picture in the design",
        )


def _require_clockwise(table: pd.DataFrame, path: Path) -> None:
    """The corners of a sheet follow each other clockwise in a picture; a mirror turns all round."""
    whole = table.sort_values(["image", "marker", "corner"], kind="stable")
    whole = whole[whole.groupby(["image", "marker"])["corner"].transform("size") == _CORNERS]
    if not len(whole):
        raise InputError(
            "no marker with all four corners in any picture",
            expected="four rows a marker and picture",
            where=path,
            cure="List the corners 0 to 3 of each marker",
        )
    corners = whole[["x_px", "y_px"]].to_numpy().reshape(-1, _CORNERS, 2)
    a, b = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    # with y downwards a clockwise quadrilateral has a positive area
    wrong = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] <= 0
    if wrong.mean() > _MOST_MIRRORED:
        raise InputError(
            f"the corners of {int(wrong.sum())} of {len(wrong)} markers run anticlockwise in their pictures",
            expected="clockwise: upper left, upper right, lower right, lower left of the printed sheet",
            where=path,
            cure="The pictures are mirrored, y counts upwards, x and y are exchanged, or the corners are "
            "numbered the other way round: pixels count from the upper left, y downwards",
        )


def _rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a table; what is no number is none in JSON."""
    return [
        {str(key): None if isinstance(v, float) and not np.isfinite(v) else v for key, v in row.items()}
        for row in table.to_dict("records")
    ]
