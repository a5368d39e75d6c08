"""Two lenses that look apart in one file: their views, their relative orientation, one joint covariance.

The frame of the rig is that of its front lens; ``x_back = R_back_front @ x_front + (x, y, z)``. A lens is a
view of a file: a box of its pixels, turned upright. Pixels of a lens count from the upper left corner of its
upright view, so its interior orientation stays the same whichever way the sensor lies in the file.

`calibrate_rig` adjusts all pictures of both lenses on one field (`orient_on_field`): interiors and poses of
all views with their joint covariance. Each exposure then gives ``T_back_front`` once, and one adjustment of
interiors and all of these, with the whole covariance, gives what is common to them. As the pose of each
exposure is free, that is the same as one adjustment with the relative orientation as an unknown.

Marks are measured anew as a perspective camera would see them, once both fisheyes are roughly known: the
edges of a sheet are bent in a fisheye, and a fit of straight edges then puts a crossing towards the inside of
the bend: in the pictures of the digital twin by up to 0.07 px at 95 degrees and 50 px of a sheet, which moved
the base of a rig by 0.4 mm. Each crossing is therefore resampled onto the plane across its own ray, where
straight edges are straight, measured there, and taken back (after Datta, Kim and Kanade 2009, Accurate camera
calibration using iterative refinement of control points, ICCV workshops).
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.linalg import block_diag

from thalweg.calibration.camera import orient_on_field, starting_boat_camera
from thalweg.calibration.camera_files import camera_of, interior_calibration
from thalweg.calibration.field import FieldNetwork, FieldPoints
from thalweg.calibration.marker_sheets import SADDLES_MODULES, MarkerLayout
from thalweg.calibration.markers import SADDLE_SIGNS, detect, fit_saddles, require_unmirrored
from thalweg.core import (
    PARAMETERS,
    Adjusted,
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayI,
    ArrayU8,
    Camera,
    CoverageError,
    GeometryError,
    InputError,
    Linear,
    Observations,
    Rigid,
    adjust,
    optional,
)
from thalweg.core.calibration import Calibration, Source, pose_block, read_calibration
from thalweg.ingest.photos import read_mask
from thalweg.settings.sections import Rig as RigSettings, RigLens

cv2 = optional("cv2")

# ---------------------------------------------------------------- marks on the plane across their ray

_HALF_PX: Final = 28
"""Half a side of a patch: the largest window of a fit, and what the coarse search needs around it."""
_LARGEST_MOVE_PX: Final = 1.0
"""A crossing that moves farther was another one."""


def remeasured(image: ArrayU8, marks: pd.DataFrame, camera: Camera) -> pd.DataFrame:
    """The marks of one view, each measured on the plane across its ray.

    Parameters
    ----------
    image : (h, w) grey values of the view.
    marks : marker, corner, x_px, y_px, sigma_px, size_px of this view.
    camera : its interior orientation; some pixels of error do no harm.

    Returns
    -------
    The rows of markers with all four crossings that could be measured again, other columns as before.
    """
    whole = marks.groupby("marker")["corner"].transform("size") == len(SADDLES_MODULES)
    table = marks[whole].sort_values(["marker", "corner"], kind="stable").reset_index(drop=True)
    n = len(table)
    if n == 0:
        return table
    rays = camera.rays(table[["x_px", "y_px"]].to_numpy(np.float64))
    known = np.isfinite(rays).all(axis=1).reshape(-1, 4).all(axis=1).repeat(4)
    table, rays = table[known].reset_index(drop=True), rays[known]
    n = len(table)
    side = 2 * _HALF_PX
    columns = max(1, int(np.ceil(np.sqrt(n))))
    atlas = np.full((-(-n // columns) * side, columns * side), 128, dtype=np.uint8)
    grid = (np.mgrid[0:side, 0:side][::-1].reshape(2, -1).T + 0.5 - _HALF_PX).astype(np.float64)
    corner = np.empty((n, 2))
    steps, start = np.empty((n, 2, 2)), np.empty((n, 2))
    axes, scale = np.empty((n, 3, 3)), np.empty(n)
    good = np.ones(n, dtype=np.bool_)
    for i in range(n):
        e = _across(rays[i])
        by_point = camera.project_with_derivatives(rays[i][None])[1][0]
        s = float(np.sqrt(abs(np.linalg.det(by_point @ e[:, :2]))))
        first = i - i % 4
        local = rays[first : first + 4] @ e
        corner[i] = (i % columns) * side, (i // columns) * side
        axes[i], scale[i] = e, s
        start[i] = corner[i] + _HALF_PX
        steps[i] = np.eye(2)
        if (local[:, 2] < 0.2).any() or not s > 0:
            good[i] = False
            continue
        flat = local[:, :2] / local[:, 2:]
        H = cv2.getPerspectiveTransform(SADDLES_MODULES.astype(np.float32), flat.astype(np.float32))
        h = H @ np.append(SADDLES_MODULES[i % 4], 1.0)
        steps[i] = s * (H[:2, :2] - np.outer(h[:2] / h[2], H[2, :2])) / h[2]
        xy = camera.project(np.column_stack([grid / s, np.ones(len(grid))]) @ e.T)
        flat_xy = np.nan_to_num(xy, nan=-10.0).astype(np.float32).reshape(side, side, 2) - np.float32(0.5)
        patch = cv2.remap(
            image, flat_xy[..., 0], flat_xy[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
        )
        x, y = corner[i].astype(int)
        atlas[y : y + side, x : x + side] = patch
    fit = fit_saddles(atlas, start, steps, np.tile(SADDLE_SIGNS, n // 4))
    good &= fit.good
    off = np.where(good[:, None], fit.xy_px - start, 0.0)
    moved = np.column_stack([off / scale[:, None], np.ones(n)])
    xy = camera.project(np.einsum("nij,nj->ni", axes, moved))
    before = table[["x_px", "y_px"]].to_numpy(np.float64)
    good &= np.linalg.norm(xy - before, axis=1) < _LARGEST_MOVE_PX
    out = table.assign(x_px=xy[:, 0], y_px=xy[:, 1], sigma_px=fit.sigma_px)
    return out[good].reset_index(drop=True)


def _across(ray: ArrayF) -> ArrayF:
    """Axes (3, 3) as columns: two across a ray, and the ray."""
    other = np.array([1.0, 0.0, 0.0]) if abs(ray[0]) < 0.9 else np.array([0.0, 1.0, 0.0])
    e2 = np.cross(ray, other)
    e2 /= np.linalg.norm(e2)
    return np.stack([np.cross(e2, ray), e2, ray], axis=1)


# ---------------------------------------------------------------- the rig

LENSES: Final = ("front", "back")
RELATIVE: Final = "back_front"
"""Block of the relative orientation."""
LEAST_COMMON: Final = 3
"""Exposures that both lenses must be oriented in."""
_GATE: Final = 4.0
"""Standardised length beyond which the relative orientation of an exposure contradicts the others."""
_DARK: Final = 4.0
"""Grey value up to which a view shows nothing."""
_CORNER: Final = 30.0
"""Grey value from which the corners of a box, which no image circle reaches, show a picture."""
_OPPOSITE_DEG: Final = 90.0


# ---------------------------------------------------------------- views


def lens_view(picture: AnyArray, lens: RigLens) -> AnyArray:
    """The upright view (h, w, ...) of a lens in the pixels (H, W, ...) of a file; a copy of nothing."""
    left, top, width, height = lens.box_px
    return np.rot90(picture[top : top + height, left : left + width], -lens.turn_deg // 90)


def view_size_px(lens: RigLens) -> tuple[int, int]:
    """Width and height of the upright view."""
    width, height = lens.box_px[2:]
    return (height, width) if lens.turn_deg in (90, 270) else (width, height)


def read_views(path: Path, settings: RigSettings) -> dict[str, ArrayU8]:
    """Upright views (h, w, 3) uint8 of both lenses in a file.

    Raises
    ------
    InputError : the file is no whole picture, has another size than `settings.size_px`, is a stitched
        panorama, or one of the lenses shows nothing.
    """
    from PIL import Image

    try:
        with Image.open(path) as file:
            xmp = file.info.get("xmp", b"")
            size = file.size
            picture = np.asarray(file.convert("RGB"), dtype=np.uint8) if size == settings.size_px else None
    except (OSError, ValueError, SyntaxError) as error:
        raise InputError(
            f"no whole picture ({error})",
            expected="a JPEG with both image circles",
            where=path,
            cure="Copy it from the camera again",
        ) from error
    text = xmp if isinstance(xmp, bytes) else str(xmp).encode()
    if b"equirectangular" in text:
        raise _stitched(path, "its XMP says that it is an equirectangular panorama")
    if picture is None:
        raise InputError(
            f"a picture of {size[0]} x {size[1]} pixels",
            expected=f"{settings.size_px[0]} x {settings.size_px[1]}, as rig.size_px has it",
            where=path,
            cure="Use the original files, in the mode in which the rig was calibrated",
        )
    found = {}
    for name in LENSES:
        lens: RigLens = getattr(settings, name)
        view = np.ascontiguousarray(lens_view(picture, lens))
        _check_view(view, name, path, circle=settings.model == "fisheye")
        found[name] = view
    return found


def check_rig(settings: RigSettings) -> None:
    """Refuse boxes that do not lie in the file, or on each other.

    Raises
    ------
    InputError : see above.
    """
    boxes = {name: getattr(settings, name).box_px for name in LENSES}
    for name, (left, top, width, height) in boxes.items():
        if left + width > settings.size_px[0] or top + height > settings.size_px[1]:
            raise InputError(
                f"rig.{name}.box_px {boxes[name]} in files of {settings.size_px[0]} x {settings.size_px[1]}",
                expected="left, top, width, height of a box inside the file",
            )
    a, b = (np.array(box) for box in boxes.values())
    if (np.minimum(a[:2] + a[2:], b[:2] + b[2:]) > np.maximum(a[:2], b[:2])).all():
        raise InputError(
            f"the boxes {boxes['front']} and {boxes['back']} of the lenses lie on each other",
            expected="a box of its own for each image circle",
            where="rig",
        )


def _check_view(view: ArrayU8, name: str, path: Path, *, circle: bool) -> None:
    h, w = view.shape[:2]
    y, x = np.mgrid[0:h:4, 0:w:4]
    off = np.hypot((x + 0.5) / w - 0.5, (y + 0.5) / h - 0.5)
    grey = view[::4, ::4].mean(axis=2)
    inside, corners = grey[off < 0.4], grey[off > 0.6]
    if np.percentile(inside, 90) < _DARK:
        raise InputError(
            f"the view of the lens {name} is black",
            expected="two image circles in each file",
            where=path,
            cure=f"Check rig.{name}.box_px, or that both lenses were recorded",
        )
    # flare reaches beyond the rim of an image circle, but not into all four corners
    if circle and np.percentile(corners, 20) > _CORNER:
        raise _stitched(path, f"the corners of the box of the lens {name} show a picture")


def _stitched(path: Path, found: str) -> InputError:
    return InputError(
        f"this is no dual fisheye: {found}",
        expected="both image circles side by side, as the lenses gave them",
        where=path,
        cure="Switch the stitching of the camera off, or use its original files",
    )


# ---------------------------------------------------------------- rig


def _axes_deg(T_back_front: Rigid) -> float:
    return float(np.rad2deg(np.arccos(np.clip(T_back_front.R[2, 2], -1.0, 1.0))))


@dataclass(frozen=True, slots=True, kw_only=True)
class Rig:
    """A calibrated rig.

    Parameters
    ----------
    cameras : interior orientation by lens, front and back.
    T_back_front : relative orientation with covariance.
    settings : views of the lenses.
    cov : joint covariance of the parameters of front and back and of the errors of ``T_back_front`` (shift,
        rotation about the axes of the back lens; metres, radians); None: that of each by itself is all that
        is known.
    """

    cameras: Mapping[str, Camera]
    T_back_front: Rigid
    settings: RigSettings
    cov: ArrayF | None = None

    @property
    def base_m(self) -> float:
        """Distance of both projection centres, metres."""
        return float(np.linalg.norm(self.T_back_front.shift_m))

    @property
    def axes_deg(self) -> float:
        """Angle between both views, degrees."""
        return _axes_deg(self.T_back_front)

    @property
    def T_front_lens(self) -> dict[str, Rigid]:
        """Place of each lens in the frame of the rig."""
        return {"front": Rigid(), "back": self.T_back_front.inverse()}

    @property
    def centre_front_m(self) -> ArrayF:
        """(3,) middle between both projection centres, in the frame of the rig."""
        return np.asarray(self.T_front_lens["back"].shift_m / 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class RigCalibration:
    """What `calibrate_rig` found.

    Parameters
    ----------
    rig : interiors and relative orientation with one joint covariance.
    residuals : file, lens, marker, corner, vx_px, vy_px (observed minus computed), sigma_px, angle_deg from
        the axis, azimuth_deg about it, used.
    exposures : file, base_m, axes_deg, length (of its contradiction to the others, in sigmas), used.
    rejected : what, name, reason.
    sigma0, redundancy : of the relative orientations of all exposures; where the global test fails, the
        covariance is multiplied by sigma0 squared.
    report : of the adjustment on the field.
    """

    rig: Rig
    residuals: pd.DataFrame
    exposures: pd.DataFrame
    rejected: pd.DataFrame
    sigma0: float
    redundancy: float
    report: dict[str, Any]

    @property
    def cov(self) -> ArrayF:
        """(22, 22) joint covariance, see `Rig`."""
        assert self.rig.cov is not None
        return self.rig.cov


def detect_rig_marks(files: Sequence[Path], settings: RigSettings, layout: MarkerLayout) -> pd.DataFrame:
    """Marks of a field in both views of all files.

    Parameters
    ----------
    files : with both image circles.
    settings : views of the lenses.
    layout : dictionary of the tags.

    Returns
    -------
    image (``front/NAME``), file, camera (the lens), marker, corner, x_px, y_px, sigma_px, size_px.

    Raises
    ------
    InputError : see `read_views`; two files of one name; or most markers of a lens are read only in the
        mirror.
    """
    twice = [name for name, n in Counter(path.name for path in files).items() if n > 1]
    if twice:
        raise InputError(
            f"two files are called {twice[0]}",
            expected="a name of its own for each exposure",
            cure="Name each file once",
        )
    parts = []
    for path in files:
        for name, view in read_views(path, settings).items():
            found = detect(_grey(view), layout)
            require_unmirrored(
                found.marks.drop_duplicates("marker"), found.rejected, f"in {path}, lens {name}"
            )
            parts.append(found.marks.assign(image=f"{name}/{path.name}", file=path.name, camera=name))
    return pd.concat(parts, ignore_index=True)


def remeasure_rig_marks(
    files: Sequence[Path], settings: RigSettings, marks: pd.DataFrame, cameras: Mapping[str, Camera]
) -> pd.DataFrame:
    """The same marks without the bend that a fisheye gives to edges, see `thalweg.calibration.rig`.

    Parameters
    ----------
    files, settings : as of `detect_rig_marks`.
    marks : found by it.
    cameras : rough interiors by lens.
    """
    parts = []
    for path in files:
        for name, view in read_views(path, settings).items():
            mine = marks[marks["image"] == f"{name}/{path.name}"]
            parts.append(remeasured(_grey(view), mine, cameras[name]))
    return pd.concat(parts, ignore_index=True)


def _grey(view: AnyArray) -> ArrayU8:
    return np.rint(view @ _GREY).astype(np.uint8)


_GREY: Final = np.array([0.299, 0.587, 0.114])


def calibrate_rig(
    marks: pd.DataFrame,
    points: FieldPoints,
    settings: RigSettings,
    *,
    nominal: Mapping[str, Camera] | None = None,
) -> RigCalibration:
    """Interiors of both lenses and their relative orientation, from one field around the rig.

    Parameters
    ----------
    marks : `detect_rig_marks`.
    points : of the field, with their joint covariance.
    settings : views of the lenses.
    nominal : start values of the interiors; None: found by trial.

    Raises
    ------
    GeometryError : pictures that do not determine the rig, or lenses that do not look apart.
    CoverageError : a lens without marks, or fewer than three exposures that orient both lenses.
    """
    missing = [name for name in LENSES if not (marks["camera"] == name).any()]
    if missing:
        raise CoverageError(
            f"no mark of the field in any view of the lens {missing[0]}",
            expected="marks in the views of both lenses",
            cure=f"Check rig.{missing[0]}.box_px, and that the field stands around the rig",
        )
    start = nominal or {
        name: starting_boat_camera(
            marks[marks["camera"] == name],
            points,
            name,
            view_size_px(getattr(settings, name)),
            model=settings.model,
        )
        for name in LENSES
    }
    network = orient_on_field(marks, start, points)
    common = [
        file
        for file in dict.fromkeys(marks["file"])
        if all(f"{name}/{file}" in network.poses for name in LENSES)
    ]
    if len(common) < LEAST_COMMON:
        told = "; ".join(f"{r.name}: {r.reason}" for r in network.rejected.head(3).itertuples())
        raise CoverageError(
            f"{len(common)} exposures in which both lenses can be oriented" + (f" ({told})" if told else ""),
            expected=f"at least {LEAST_COMMON}",
            cure="Take more pictures amid the field, so that both lenses see marks on several sides",
        )
    observed, cov, relative = _relative(network, common)
    used = np.ones(len(common), dtype=np.bool_)
    length = np.zeros(len(common))
    while True:
        rows = np.concatenate([np.ones(len(observed) - 6 * len(common), dtype=np.bool_), np.repeat(used, 6)])
        some = [T for T, ok in zip(relative, used, strict=True) if ok]
        found = _common(observed[rows], cov[np.ix_(rows, rows)], some, settings.model)
        length[used] = _contradictions(found, cov[np.ix_(rows, rows)])
        worst = int(np.where(used, length, -1.0).argmax())
        # one exposure moves what all have in common: the worst goes, then the others are judged anew
        if length[worst] <= _GATE:
            break
        used[worst] = False
        if used.sum() < max(LEAST_COMMON, len(common) / 2):
            raise GeometryError(
                f"the relative orientations of {len(common)} exposures contradict each other",
                expected="one that most of them share",
                where="rig",
                cure="Take the pictures again with a rig that is fixed, and marks that stay where they are",
            )
    k = len(PARAMETERS[settings.model])
    # exposures that differ more than their sigmas say: the rig moves, or marks of an exposure err alike
    cov_rig = found.global_test().factor ** 2 * found.cov
    cameras = {
        name: network.cameras[name].with_parameters(
            found.x.parameters[i * k : (i + 1) * k], cov_rig[i * k : (i + 1) * k, i * k : (i + 1) * k]
        )
        for i, name in enumerate(LENSES)
    }
    T = found.x.T.with_cov(cov_rig[2 * k :, 2 * k :])
    if _axes_deg(T) < _OPPOSITE_DEG:
        raise GeometryError(
            f"both lenses look the same way within {_axes_deg(T):.1f} degrees",
            expected="lenses that look apart",
            where="rig",
            cure="Check that rig.front.box_px and rig.back.box_px are not boxes of the same lens",
        )
    exposures = pd.DataFrame(
        {
            "file": common,
            "base_m": [float(np.linalg.norm(T.shift_m)) for T in relative],
            "axes_deg": [_axes_deg(T) for T in relative],
            "length": length,
            "used": used,
        }
    )
    lost = [
        {
            "what": "exposure",
            "name": file,
            "reason": f"its relative orientation is {size:.1f} sigmas off the others: lenses or marks moved",
        }
        for file, size, ok in zip(common, length, used, strict=True)
        if not ok
    ]
    return RigCalibration(
        rig=Rig(cameras=cameras, T_back_front=T, settings=settings, cov=cov_rig),
        residuals=_residuals(network, marks, cameras, points),
        exposures=exposures,
        rejected=pd.concat([network.rejected, pd.DataFrame(lost)], ignore_index=True),
        sigma0=float(np.sqrt(found.sigma0_squared)),
        redundancy=found.redundancy,
        report=network.report,
    )


@dataclass(frozen=True, slots=True)
class _State:
    """Parameters of both interiors, and the relative orientation."""

    parameters: ArrayF
    T: Rigid


def _relative(network: FieldNetwork, common: Sequence[str]) -> tuple[ArrayF, ArrayF, list[Rigid]]:
    """Interiors and an error of zero of each exposure's relative orientation, joint covariance, the poses."""
    images = {name: i for i, name in enumerate(network.poses)}
    u = len(network.adjusted.names)
    values: list[ArrayF] = []
    rows: list[ArrayF] = []
    for name in LENSES:
        camera = network.cameras[name]
        number = [c.name for c in network.adjusted.x.cameras].index(camera.name)
        J = np.zeros((len(camera.parameters), u))
        J[:, network.layout.lens[number]] = network.layout.change[number]
        values.append(camera.parameters)
        rows.append(J)
    relative = []
    for file in common:
        front, back = (network.poses[f"{name}/{file}"] for name in LENSES)
        inverse = back.inverse()
        T = inverse @ front
        by_inverse, by_front = inverse.by_product(front)
        J = np.zeros((6, u))
        J[:, network.layout.pose(images[f"front/{file}"])] = by_front
        J[:, network.layout.pose(images[f"back/{file}"])] = by_inverse @ back.by_inverse()
        rows.append(J)
        relative.append(Rigid(R=T.R, shift_m=T.shift_m))
        values.append(np.zeros(6))
    all_rows = np.concatenate(rows)
    cov = all_rows @ network.adjusted.cov @ all_rows.T
    return np.concatenate(values), (cov + cov.T) / 2, relative


def _common(observed: ArrayF, cov: ArrayF, relative: Sequence[Rigid], model: str) -> Adjusted[_State]:
    """The interiors and the one relative orientation that all exposures share."""
    n = len(relative)
    k = len(observed) - 6 * n

    def differences(x: _State) -> Linear:
        """Differences from what each exposure says."""
        off = [x.T.error_from(T) for T in relative]
        residual = np.concatenate([x.parameters - observed[:k], *off])
        return Linear(residual=residual, jacobian=_by_common(k, n), cov=cov[None])

    names = [*(f"{lens} {p}" for lens in LENSES for p in PARAMETERS[model]), *_POSE]
    return adjust(
        [Observations("exposures", differences)],
        _State(observed[:k].copy(), relative[0]),
        names,
        update=lambda x, dx: _State(x.parameters + dx[:k], x.T.moved(dx[k:])),
        cure="Take more pictures of the field",
    )


def _by_common(k: int, n: int) -> ArrayF:
    """Derivatives of k interior parameters and n relative orientations by what all exposures share."""
    return block_diag(np.eye(k), np.tile(np.eye(6), (n, 1)))


_POSE: Final = ("x", "y", "z", "rotation about x", "rotation about y", "rotation about z")


def _contradictions(found: Adjusted[_State], cov: ArrayF) -> ArrayF:
    """Standardised contradiction (n,) of each exposure to all, as of a normal error."""
    from scipy.stats import chi2, norm

    v = found.residuals["exposures"]
    k = len(found.x.parameters)
    n = (len(v) - k) // 6
    J = _by_common(k, n)
    Q = cov - J @ found.cov @ J.T
    lengths = np.zeros(n)
    for i in range(n):
        at = slice(k + 6 * i, k + 6 * i + 6)
        values, vectors = np.linalg.eigh(Q[at, at] / np.outer(*(np.sqrt(np.diag(cov[at, at])),) * 2))
        w = vectors.T @ (v[at] / np.sqrt(np.diag(cov[at, at])))
        good = values > 1e-6
        squares = float((w[good] ** 2 / values[good]).sum())
        tail = float(chi2.sf(squares, max(int(good.sum()), 1)))
        lengths[i] = float(norm.isf(max(tail, 1e-300) / 2))
    return lengths


def _residuals(
    network: FieldNetwork, marks: pd.DataFrame, cameras: Mapping[str, Camera], points: FieldPoints
) -> pd.DataFrame:
    table = network.residuals.copy()
    lens, file = table["image"].str.split("/", n=1).str[0], table["image"].str.split("/", n=1).str[1]
    table.insert(0, "file", file)
    table.insert(1, "lens", lens)
    xy = (
        table[["image", "marker", "corner"]]
        .merge(
            marks[["image", "marker", "corner", "x_px", "y_px"]], on=["image", "marker", "corner"], how="left"
        )[["x_px", "y_px"]]
        .to_numpy(np.float64)
    )
    angle, azimuth = np.full(len(table), np.nan), np.full(len(table), np.nan)
    for name, camera in cameras.items():
        mine = (lens == name).to_numpy()
        ray = camera.rays(xy[mine])
        angle[mine] = np.rad2deg(np.arctan2(np.hypot(ray[:, 0], ray[:, 1]), ray[:, 2]))
        azimuth[mine] = np.rad2deg(np.arctan2(ray[:, 1], ray[:, 0]))
    return table.assign(angle_deg=angle, azimuth_deg=azimuth)


def read_rig_masks(rig: Rig) -> dict[str, ArrayB]:
    """Where views may be used (h, w), of the lenses that have a mask.

    Raises
    ------
    InputError : a mask cannot be read, or has another size than the view.
    """
    masks: dict[str, ArrayB] = {}
    for name in LENSES:
        path = getattr(rig.settings, name).mask
        if path is None:
            continue
        width, height = rig.cameras[name].size_px
        mask = read_mask(path, (width, height))
        if mask.shape != (height, width):
            raise InputError(
                f"a mask of {mask.shape[1]} x {mask.shape[0]} pixels",
                expected=f"{width} x {height}, as the upright view of the lens {name}",
                where=path,
            )
        masks[name] = mask
    return masks


# ---------------------------------------------------------------- files


def rig_calibration_file(found: RigCalibration, source: Source) -> Calibration:
    """Calibration with ``front_interior``, ``back_interior``, ``back_front`` and their joint covariance."""
    interiors = [
        interior_calibration(found.rig.cameras[name], source, block=name).blocks[0] for name in LENSES
    ]
    for i, name in enumerate(LENSES):
        mine = found.residuals[(found.residuals["lens"] == name) & found.residuals["used"]]
        facts = {
            "marks": len(mine),
            "rms_px": round(float(np.sqrt(np.square(mine[["vx_px", "vy_px"]].to_numpy()).mean())), 4),
            "largest_angle_deg": round(float(mine["angle_deg"].max()), 1),
        }
        interiors[i] = replace(interiors[i], facts={**interiors[i].facts, **facts})
    pose, _ = pose_block(
        RELATIVE,
        found.rig.T_back_front,
        target="back",
        source="front",
        facts={
            "base_m": round(found.rig.base_m, 6),
            "axes_deg": round(found.rig.axes_deg, 4),
            "exposures": int(found.exposures["used"].sum()),
            "rejected": [f"{r.what} {r.name}: {r.reason}" for r in found.rejected.itertuples()][:20],
        },
    )
    order, unit = _of_the_file(len(found.cov) - 6)
    cov = found.cov[np.ix_(order, order)] * np.outer(unit, unit)
    return Calibration(
        title="Rig of two lenses", blocks=(*interiors, pose), cov=(cov + cov.T) / 2, source=source
    )


def _of_the_file(k: int) -> tuple[ArrayI, ArrayF]:
    """Order and units of the joint covariance in the file: behind k parameters angles first, in degrees."""
    order = np.r_[np.arange(k), k + np.r_[3:6, 0:3]]
    return order, np.r_[np.ones(k), np.full(3, 180.0 / np.pi), np.ones(3)]


def rig_of(calibration: Calibration, settings: RigSettings) -> Rig:
    """The rig of a calibration file.

    Raises
    ------
    InputError : the file was made for views of another size.
    GeometryError : a block is missing.
    """
    cameras = {name: camera_of(calibration, name) for name in LENSES}
    for name, camera in cameras.items():
        wanted = view_size_px(getattr(settings, name))
        if camera.size_px != wanted:
            raise InputError(
                f"the lens {name} was calibrated for views of {camera.size_px[0]} x {camera.size_px[1]}",
                expected=f"{wanted[0]} x {wanted[1]}, as rig.{name}.box_px has it",
                cure="Calibrate in the mode of the survey, or correct the box",
            )
    _, cov = calibration.joint([*(f"{name}_interior" for name in LENSES), RELATIVE])
    # the file has angles first, in degrees
    order, unit = _of_the_file(len(cov) - 6)
    back = np.argsort(order)
    return Rig(
        cameras=cameras,
        T_back_front=calibration.pose(RELATIVE),
        settings=settings,
        cov=(cov / np.outer(unit, unit))[np.ix_(back, back)],
    )


def read_rig(path: Path, settings: RigSettings) -> Rig:
    """The rig of a file, see `rig_of`."""
    return rig_of(read_calibration(path), settings)
