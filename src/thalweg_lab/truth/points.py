"""Points of the twin against the truth: errors of a cloud, true returns, strip of the bed.

The beam of each point is cast again from the true pose and mount at its time: seven rays, in the middle and
on a ring inside the footprint. The plane through what they meet is the true surface as a beam of that width
sees it. The error of the point is its signed distance from that plane along the normal: the part of a point's
error that displaces a surface, and the part that remains defined when a beam is a little off its nominal
direction. Its prediction is ``n^T C n`` with the covariance that the cloud itself carries. Only this room may
read the truth.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pandas as pd

from thalweg.accuracy import by_range_class, chi_square_band, describe_errors, independent_squares
from thalweg.calibration import read_mounts
from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayI,
    CoverageError,
    Rigid,
    Trajectory,
    iter_laz,
    read_table,
    root_mean_square,
)
from thalweg.core.geometry import RayCaster, TriangleMesh, read_mesh
from thalweg.ingest.velodyne import VLP16
from thalweg.lidar import cloud_covariance
from thalweg.lightsheet.scanning import BED_POINTS
from thalweg_lab.instruments import LIDAR_SHOTS, EchoKind
from thalweg_lab.river import BARE_GROUND, Scene
from thalweg_lab.voyage import longest_correlation_s, read_true_mounts

LEAST_COSINE: Final = 0.2
"""Cosine of the incidence angle below which a beam grazes: 78 degrees from the normal."""
GROSS_SIGMAS: Final = 6.0
"""An error of more than that many sigmas belongs to another surface; of normal errors 2e-9 are lost."""
POINT_CLASSES: Final = ("all", "bare ground with gross errors", "bare ground")
"""The sets of points for which every number is given; the last is the second one with the outlier rule."""
_RING: Final = 6
_RING_SHARE: Final = 1.0 / np.sqrt(2.0)
"""Radius of the ring of rays over that of the footprint: the mean square distance in a uniform disc."""

SAME_SHOT_S: Final = 1.1e-6
"""Times this near belong to one shot: shots are 2.304 us apart, stamps are resolved to 1 us."""

_MOST_POINTS: Final = 300_000
"""So many points of a cloud are compared, evenly spread over it."""

ABOVE_M: Final = 1.0
"""Heights of the bed are looked up from so far above a point."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueReturns:
    """Returns of the shots whose truth was written, in order of time and of return number.

    Parameters
    ----------
    t_gps_s : (n,) adjusted standard GPS time.
    return_number : (n,) 1 is the nearest return of the shot.
    kind : (n,) what the return is.
    material : (n,) number of the material that it came from.
    point_wcs_m : (n, 3) where the echo arose: the beam's offset across itself and the echo's place in the
        footprint are in it, the noise of the range is not.
    kinds : number -> name of the kinds; 0 is a single surface.
    """

    t_gps_s: ArrayF
    return_number: AnyArray
    kind: AnyArray
    material: AnyArray
    point_wcs_m: ArrayF
    kinds: Mapping[int, str]

    @classmethod
    def from_table(cls, shots: pd.DataFrame, kinds: Mapping[int, str]) -> Self:
        """From table kind ``twin_lidar_shots``."""
        ordered = shots.sort_values(["t_gps_s", "return_number"], kind="stable")
        columns = {n: ordered[n].to_numpy() for n in ("t_gps_s", "return_number", "kind", "material")}
        point = ordered[["east_m", "north_m", "up_m"]].to_numpy(dtype=np.float64)
        return cls(kinds=kinds, point_wcs_m=point, **columns)

    def index(self, t_gps_s: ArrayF, return_number: AnyArray) -> ArrayI:
        """Row (m,) of each point of a cloud, -1 where its shot was not written."""
        out = np.full(len(t_gps_s), -1, dtype=np.int64)
        first = np.searchsorted(self.t_gps_s, t_gps_s - SAME_SHOT_S)
        for row in (first, first + 1, first + 2):
            inside = row < len(self.t_gps_s)
            k = np.where(inside, row, 0)
            same = inside & (np.abs(self.t_gps_s[k] - t_gps_s) <= SAME_SHOT_S)
            same &= self.return_number[k] == return_number
            out[same & (out < 0)] = k[same & (out < 0)]
        return out


# ---------------------------------------------------------------- errors of a georeferenced cloud


@dataclass(frozen=True, slots=True, kw_only=True)
class PointErrors:
    """Errors of points against the truth, one row a point whose true beam hits anything.

    ``error_m`` (n,) is the signed distance from the true surface along its normal, ``sigma_m`` (n,) its
    prediction; ``on_ground`` (n,) is true for points that came from bare ground alone, at no grazing angle.
    """

    t_gps_s: ArrayF
    range_m: ArrayF
    error_m: ArrayF
    sigma_m: ArrayF
    on_ground: ArrayB

    @property
    def gross(self) -> ArrayB:
        """Errors above `GROSS_SIGMAS`."""
        return np.abs(self.error_m) >= GROSS_SIGMAS * self.sigma_m

    @property
    def bare_ground(self) -> ArrayB:
        """Points on bare ground without gross errors."""
        return self.on_ground & ~self.gross


@dataclass(frozen=True, slots=True, kw_only=True)
class PointErrors3d:
    """Errors of points in three dimensions, one row a point.

    ``error_m`` (n, 3) is the point minus the place where its echo arose, east, north and up; ``cov_m2``
    (n, 3, 3) is its prediction.
    """

    t_gps_s: ArrayF
    range_m: ArrayF
    error_m: ArrayF
    cov_m2: ArrayF

    @property
    def squared_m2(self) -> ArrayF:
        """Square of the length of each error (n,)."""
        return np.asarray(np.sum(self.error_m**2, axis=1))

    @property
    def predicted_m2(self) -> ArrayF:
        """Its expectation (n,): the trace of the covariance, the square of P2 eq. 9."""
        return np.asarray(np.trace(self.cov_m2, axis1=1, axis2=2))

    @property
    def normalised(self) -> ArrayF:
        """Normalised squared error ``e^T C^-1 e / 3`` (n,), of expectation 1.

        It sees the shape of the covariance too: an error across a flat ellipsoid counts more than one along
        it.
        """
        solved = np.linalg.solve(self.cov_m2, self.error_m[:, :, None])[:, :, 0]
        return np.asarray(np.einsum("ni,ni->n", self.error_m, solved) / 3.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """What the twin knows and the processing must not.

    Parameters
    ----------
    trajectory : the true poses.
    mount : the true mount of the scanner.
    surface : the true surface.
    bare_ground : (m,) for each of its triangles: is it bare ground?
    divergence_rad : full divergence of the beam.
    """

    trajectory: Trajectory
    mount: Rigid
    surface: RayCaster
    bare_ground: ArrayB
    divergence_rad: float


def point_errors(
    points_wcs_m: ArrayF,
    t_gps_s: ArrayF,
    cov_m2: ArrayF,
    beam_offset_m: ArrayF,
    *,
    estimated: Trajectory,
    mount: Rigid,
    truth: Truth,
    from_ground: ArrayB | None = None,
) -> PointErrors:
    """Compare georeferenced points with the surface that their beams truly hit.

    Parameters
    ----------
    points_wcs_m, t_gps_s, cov_m2 : (n, 3), (n,), (n, 3, 3) the cloud.
    beam_offset_m : (n,) height of each beam's origin above the scs origin (VLP-16 vertical offsets).
    estimated, mount : the trajectory and the mount that made the cloud.
    truth : the twin's own.
    from_ground : (n,) whether all of the echo came from bare ground; by default only the rays decide.
    """
    position, R_est, known = estimated.at(t_gps_s)
    true_position, R_true, known_true = truth.trajectory.at(t_gps_s)
    keep = known & known_true
    position, R_est, true_position, R_true = (a[keep] for a in (position, R_est, true_position, R_true))
    points, t, cov = points_wcs_m[keep], t_gps_s[keep], cov_m2[keep]
    offset = np.zeros_like(points)
    offset[:, 2] = beam_offset_m[keep]
    body = np.einsum("nji,nj->ni", R_est, points - position)
    beam = (body - mount.shift_m) @ mount.R - offset
    range_m = np.linalg.norm(beam, axis=1)
    R_wcs_scs = R_true @ truth.mount.R
    origin = true_position + np.einsum("nij,j->ni", R_true, truth.mount.shift_m)
    origin += np.einsum("nij,nj->ni", R_wcs_scs, offset)
    direction = np.einsum("nij,nj->ni", R_wcs_scs, beam / range_m[:, None])
    centre, normal, hit, ground = _surface_in_footprint(origin, direction, truth)
    error = np.einsum("ni,ni->n", normal, points - centre)
    sigma = np.sqrt(np.einsum("ni,nij,nj->n", normal, cov, normal))
    steep = -np.einsum("ni,ni->n", normal, direction) > LEAST_COSINE
    ground &= steep
    if from_ground is not None:
        ground &= from_ground[keep]
    return PointErrors(
        t_gps_s=t[hit], range_m=range_m[hit], error_m=error[hit], sigma_m=sigma[hit], on_ground=ground[hit]
    )


def point_errors_3d(cloud: Mapping[str, AnyArray], true_wcs_m: ArrayF, *, where: Path) -> PointErrors3d:
    """Compare points with the places where their echoes arose.

    The true place is that of the twin's own table of shots. The difference holds all that the covariance
    predicts: the noise of the range along the beam; across it the beam's offset and the echo's place in its
    footprint, as both are in the true place and the processing knows neither; and the errors of pose, mount
    and stamp. Points whose echo is a mixed one or a mirror ghost have no such place: leave them out.

    Parameters
    ----------
    cloud : ``xyz_m`` (n, 3), ``t_gps_s``, ``range``, standard deviations and correlations.
    true_wcs_m : (n, 3) where their echoes arose, see `thalweg_lab.truth.points.TrueReturns`.
    where : file of the cloud, for messages.

    Raises
    ------
    InputError : the cloud does not carry the full covariance of its points.
    """
    return PointErrors3d(
        t_gps_s=np.asarray(cloud["t_gps_s"]),
        range_m=np.asarray(cloud["range"], dtype=np.float64),
        error_m=np.asarray(cloud["xyz_m"] - true_wcs_m),
        cov_m2=cloud_covariance(cloud, where),
    )


def _surface_in_footprint(
    origin: ArrayF, direction: ArrayF, truth: Truth
) -> tuple[ArrayF, ArrayF, ArrayB, ArrayB]:
    """Centre and unit normal of the surface in each footprint, whether its middle is hit, and bare ground.

    The normal points to the side that the beam comes from. Where a ray of the ring meets nothing, the
    triangle that the middle ray meets gives the normal.
    """
    middle = truth.surface.cast(origin, direction)
    hit = np.isfinite(middle.t_hit_m)
    centre = origin + np.where(hit, middle.t_hit_m, 0.0)[:, None] * direction
    ground = hit & truth.bare_ground[np.clip(middle.primitive, 0, None)]
    helper = np.eye(3)[np.argmin(np.abs(direction), axis=1)]
    right = np.cross(direction, helper)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    up = np.cross(right, direction)
    radius = _RING_SHARE * truth.divergence_rad / 2
    ring, complete = [], hit.copy()
    for angle in 2 * np.pi * np.arange(_RING) / _RING:
        ray = direction + radius * (np.cos(angle) * right + np.sin(angle) * up)
        found = truth.surface.cast(origin, ray)
        there = np.isfinite(found.t_hit_m)
        complete &= there
        ground &= there & truth.bare_ground[np.clip(found.primitive, 0, None)]
        ring.append(origin + np.where(there, found.t_hit_m, 0.0)[:, None] * ray)
    corners = np.stack(ring, axis=1)
    corners -= centre[:, None, :]
    # Newell's normal of the ring, and the mean of all seven points as the place of the plane.
    newell = np.sum(np.cross(corners, np.roll(corners, -1, axis=1)), axis=1)
    length = np.linalg.norm(newell, axis=1, keepdims=True)
    plane = complete & (length[:, 0] > 0)
    normal = np.where(plane[:, None], newell / np.where(length > 0, length, 1.0), middle.normal)
    normal *= -np.sign(np.einsum("ni,ni->n", normal, direction))[:, None]
    return np.where(plane[:, None], centre + corners.sum(axis=1) / (_RING + 1), centre), normal, hit, ground


def compare_cloud(
    points: Path,
    *,
    estimated: Trajectory,
    mount: Rigid,
    truth: Truth,
    returns: TrueReturns,
    bare_materials: ArrayB,
    vertical_corrections: bool,
    correlation_s: float,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Errors of a cloud on disk: an even sample of its points, see `point_errors` and `error_tables`.

    Only points whose shots are known are taken, so that bare ground can be told from ground with a blade of
    grass in the footprint: the echo must have come from one surface, and that must be bare.

    Parameters
    ----------
    points : LAZ in the world frame with the extra dimension ``ring``, standard deviations and correlations.
    estimated, mount, truth : as in `point_errors`.
    returns : the twin's own returns.
    bare_materials : for each number of a material: is it bare ground?
    vertical_corrections : were the lasers' vertical offsets applied?
    correlation_s : longest correlation time among the errors of the poses.

    Raises
    ------
    InputError : the cloud does not carry the full covariance of its points.
    CoverageError : no point lies on bare ground.
    """
    cloud = sample_of_known_points(points, returns, _MOST_POINTS)
    row = cloud["true_row"]
    # materials beyond the scene's own (the boat) are no ground
    bare = np.zeros(256, dtype=np.bool_)
    bare[: len(bare_materials)] = bare_materials
    by_ring = VLP16.vertical_by_ring_m * vertical_corrections
    errors = point_errors(
        cloud["xyz_m"],
        cloud["t_gps_s"],
        cloud_covariance(cloud, points),
        by_ring[cloud["ring"]],
        estimated=estimated,
        mount=mount,
        truth=truth,
        from_ground=(returns.kind[row] == 0) & bare[returns.material[row]],
    )
    return error_tables(errors, correlation_s=correlation_s)


def error_tables(errors: PointErrors, *, correlation_s: float) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Statistics of errors with and without the outlier rule, and observed against predicted by range.

    Parameters
    ----------
    errors : from `point_errors`.
    correlation_s : longest correlation time among the errors of the poses: points that share a pose error are
        no independent samples.

    Returns
    -------
    statistics : columns ``quantity``, ``points`` (see `POINT_CLASSES`), ``value``, ``unit``.
        ``normalised_squared_error`` is the mean of squared error over predicted variance, ``normalised_nmad``
        the NMAD of error over predicted sigma. Consistent sigmas leave the former between
        ``consistent_low95`` and ``consistent_high95``: with a probability of 95 % if one error of that
        correlation time made all of it, of more if several errors add up. ``gross_errors`` counts what the
        outlier rule takes.
    by_range : see `by_range_class`; bare ground. ``ratio_low95`` and ``ratio_high95`` are the band of
        observed over predicted RMSE, the same for all classes: they share the poses.

    Raises
    ------
    CoverageError : no point lies on bare ground.
    """
    if not errors.bare_ground.any():
        raise CoverageError(
            f"none of {len(errors.error_m):,} points lies on bare ground",
            expected="points whose whole footprint meets soil, grass, gravel or bed",
            cure="Check the poses: is the cloud where the banks are?",
        )
    rows: list[tuple[str, str, float, str]] = []
    sets = (np.ones_like(errors.on_ground), errors.on_ground, errors.bare_ground)
    for label, use in zip(POINT_CLASSES, sets, strict=True):
        e, sigma = errors.error_m[use], errors.sigma_m[use]
        for quantity, value in describe_errors(e).items():
            bare, _, unit = quantity.rpartition("_")
            rows.append((bare or quantity, label, value, unit if bare else "1"))
        rows.append(("predicted_rmse", label, root_mean_square(sigma), "m"))
        rows.append(("normalised_squared_error", label, float(np.mean((e / sigma) ** 2)), "1"))
        rows.append(("normalised_nmad", label, describe_errors(e / sigma).get("nmad_m", np.nan), "1"))
    ground = errors.bare_ground
    # each normalised square has the same weight; in the RMSE of a class large sigmas weigh more
    n = independent_squares(errors.t_gps_s[ground], np.ones(int(ground.sum())), correlation_s)
    low, high = chi_square_band(n)
    rows += [
        ("independent_values", POINT_CLASSES[2], n, "1"),
        ("consistent_low95", POINT_CLASSES[2], low, "1"),
        ("consistent_high95", POINT_CLASSES[2], high, "1"),
        ("share_of_points", POINT_CLASSES[2], float(np.mean(errors.bare_ground)), "1"),
        ("gross_errors", POINT_CLASSES[1], float(np.sum(errors.on_ground & errors.gross)), "1"),
    ]
    statistics = pd.DataFrame(rows, columns=["quantity", "points", "value", "unit"])
    variance = errors.sigma_m[ground] ** 2
    by_range = by_range_class(errors.range_m[ground], errors.error_m[ground] ** 2, variance)
    low, high = chi_square_band(independent_squares(errors.t_gps_s[ground], variance, correlation_s))
    by_range["ratio_low95"], by_range["ratio_high95"] = np.sqrt(low), np.sqrt(high)
    return statistics, by_range


# ---------------------------------------------------------------- true returns beside the points of a cloud


def known_points(points: Path, returns: TrueReturns) -> Iterator[dict[str, AnyArray]]:
    """The points of a cloud whose shots are known, chunk by chunk, with their row as ``true_row``."""
    for chunk in iter_laz(points):
        row = returns.index(chunk["t_gps_s"], chunk["return_number"])
        yield {name: values[row >= 0] for name, values in (chunk | {"true_row": row}).items()}


def sample_of_known_points(points: Path, returns: TrueReturns, max_points: int) -> dict[str, AnyArray]:
    """At most ``max_points`` points of a cloud whose shots are known, evenly spread over them.

    Raises
    ------
    CoverageError : no point belongs to a known shot.
    """
    chunks = [chunk for chunk in known_points(points, returns) if len(chunk["t_gps_s"])]
    if not chunks:
        raise CoverageError(
            f"no point of the cloud belongs to one of the {len(returns.t_gps_s):,} true returns",
            expected="a cloud made from the twin's own lidar log",
            where=points,
            cure="Run the rules simulate_lidar and georeference_lidar again",
        )
    joined = {name: np.concatenate([chunk[name] for chunk in chunks]) for name in chunks[0]}
    step = -(-len(joined["t_gps_s"]) // max_points)
    return {name: values[::step] for name, values in joined.items()}


def filter_scores(points: Path, returns: TrueReturns, has_pose: ArrayB) -> pd.DataFrame:
    """What the filters kept and took of each kind of return.

    Parameters
    ----------
    points : the filtered cloud.
    returns : the true returns.
    has_pose : (n,) whether the estimated trajectory has a pose at the time of each of them; what was lost for
        want of a pose or of a packet is no fault of a filter, but packets that got lost count as taken.

    Returns
    -------
    Columns ``kind``, ``n``, ``kept``, ``share_kept``; one row a kind.
    """
    kept = np.zeros(len(returns.t_gps_s), dtype=np.bool_)
    for chunk in known_points(points, returns):
        kept[chunk["true_row"]] = True
    rows = []
    for number, name in sorted(returns.kinds.items()):
        of_kind = (returns.kind == number) & has_pose
        n, n_kept = int(of_kind.sum()), int((of_kind & kept).sum())
        rows.append((name, n, n_kept, n_kept / n if n else np.nan))
    return pd.DataFrame(rows, columns=["kind", "n", "kept", "share_kept"])


def judge_cloud(
    *,
    points: Path,
    trajectory: Path,
    scene: Path,
    voyage: Path,
    shots: Path,
    true_mounts: Path,
    mounts: Path,
    statistics: Path,
    by_range: Path,
    scores: Path,
    twin: dict[str, Any],
    vertical_corrections: bool,
    position_source: str,
) -> None:
    """Errors of a campaign's cloud, and what the filters took, from files; see `compare_cloud`.

    Parameters
    ----------
    points, trajectory, mounts : cloud, and what georeferenced it.
    scene, voyage, shots, true_mounts : the truth.
    statistics, by_range, scores : targets, CSV.
    twin : sections ``lidar``, ``ins`` and ``gnss`` of the twin.
    vertical_corrections, position_source : as the cloud was made.
    """
    reach, estimated = Scene.read(scene), Trajectory.read(trajectory)
    returns = TrueReturns.from_table(read_table(shots, LIDAR_SHOTS)[0], {int(k): k.name for k in EchoKind})
    numbers, classes = compare_cloud(
        points,
        estimated=estimated,
        mount=Rigid.from_mount(read_mounts(mounts)["lidar"]),
        truth=Truth(
            trajectory=Trajectory.read(voyage),
            mount=Rigid.from_mount(read_true_mounts(true_mounts)["lidar"]),
            surface=reach.caster(),
            bare_ground=BARE_GROUND[reach.material],
            divergence_rad=twin["lidar"]["divergence_mrad"] / 1000.0,
        ),
        returns=returns,
        bare_materials=BARE_GROUND,
        vertical_corrections=vertical_corrections,
        correlation_s=longest_correlation_s(twin, position_source),
    )
    filter_scores(points, returns, estimated.at(returns.t_gps_s)[2]).to_csv(scores, index=False)
    numbers.to_csv(statistics, index=False)
    classes.to_csv(by_range, index=False)


# ---------------------------------------------------------------- bed points by the light sheet (T 3.2)


def compare_bed(points: pd.DataFrame, bed: TriangleMesh) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Heights of bed points over the true bed below them, positive above it.

    The nearest place of the bed would not do: stones reach into the ground, and a point below the bed may be
    nearest to the underside of one. Errors of the mount and slow errors of the positions are alike in all
    lines of a strip that lasts a second and shift it as a whole, so ``ratio`` is hardly more than one draw;
    errors of single epochs of the positions, interpolated between them, move neighbouring lines up and down.
    Where the bed is rough a shift sideways scatters the heights within a line as well.

    Parameters
    ----------
    points : `thalweg.lightsheet.scanning.world.BED_POINTS`.
    bed : true bed in wcs.

    Returns
    -------
    One row: points, off_bed (beside the true bed), lines, mean_m, std_m, rms_m, predicted_sigma_m (root mean
    square of the predicted sigmas of the height), ratio (RMS of height over sigma), std_within_lines_m, and
    sigma_line_m (predicted by the image alone, median). And a row a line: file, n, mean_m, std_m.

    Raises
    ------
    CoverageError : no point lies over the bed.
    """
    xyz = points[["east_m", "north_m", "up_m"]].to_numpy(np.float64)
    above = xyz + np.array([0.0, 0.0, ABOVE_M])
    down = np.tile([0.0, 0.0, -1.0], (len(xyz), 1))
    hits = RayCaster(bed.vertices_m, bed.faces).cast(above, down)
    use = hits.primitive >= 0
    if use.sum() < 2:
        raise CoverageError(
            f"{int(use.sum())} of {len(xyz)} points lie over the true bed",
            expected="points of this strip",
            where="bed strip",
        )
    d = hits.t_hit_m[use].astype(np.float64) - ABOVE_M
    sigma = np.sqrt(points["cov_uu_m2"].to_numpy(np.float64)[use])
    own = pd.DataFrame({"file": points["file"].to_numpy()[use], "d": d})
    by_line = own.groupby("file", sort=False)["d"].agg(n="size", mean_m="mean", std_m="std").reset_index()
    within = d - own.groupby("file", sort=False)["d"].transform("mean").to_numpy()
    row = {
        "points": len(xyz),
        "off_bed": int((~use).sum()),
        "lines": len(by_line),
        "mean_m": d.mean(),
        "std_m": d.std(ddof=1),
        "rms_m": root_mean_square(d),
        "predicted_sigma_m": root_mean_square(sigma),
        "ratio": np.sqrt(np.mean((d / sigma) ** 2)),
        "std_within_lines_m": within.std(ddof=1),
        "sigma_line_m": float(np.median(points["sigma_line_m"].to_numpy()[use])),
    }
    return pd.DataFrame([row]), by_line


def judge_bed_strip(*, points: Path, truth: Path, statistics: Path, lines: Path) -> None:
    """Errors of the bed points under the boat from files; ``truth``: folder with the mesh of the true bed."""
    table, by_line = compare_bed(read_table(points, BED_POINTS)[0], read_mesh(truth / "bed.ply")[0])
    table.to_csv(statistics, index=False, float_format="%.6g")
    by_line.to_csv(lines, index=False, float_format="%.6g")
