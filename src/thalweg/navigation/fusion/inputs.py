"""Observations of the fused trajectory, and the nodes of its states."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from thalweg.core.errors import ConfigError
from thalweg.core.frames import LocalFrame
from thalweg.core.propagation import cross_matrix
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.images.model.poses import ImagePoses
from thalweg.navigation.fusion.settings import WHITE_SHARE, FusionSettings
from thalweg.navigation.ins_gnss.reference import Reference

INS, MODEL, RESET = 0, 1, 2
"""How position and rate pass from node to node: along the INS's velocity, by a random walk of the boat's own
velocity, and the step of no length with which the INS's velocity begins again."""

_MOST_ALIKE: Final = 0.9995
"""Greatest correlation of two images' errors: at 1 their difference would be free of error."""

_SAME_S: Final = 1e-6
"""Times that differ by less share a node."""

_LEAST_SIGMA: Final = 1e-7
"""Least sigma of an image's coordinate or angle, metres or radians: none is free of error."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Antenna:
    """Antenna positions: ``t_gps_s`` (n,), ``position_wcs_m`` (n, 3), ``root_m`` (n, 3, 3) with
    ``root root^T`` the stated covariance, ``node`` (n,); ``lever_ics_m``, ``sigma_lever_m`` (3,);
    ``begins`` (n,) the kind of solution is another than before: its slow error tells nothing of that one's.
    """

    t_gps_s: ArrayF
    position_wcs_m: ArrayF
    root_m: ArrayF
    lever_ics_m: ArrayF
    sigma_lever_m: ArrayF
    node: ArrayI
    begins: ArrayB


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """Image poses as observed poses of the body.

    ``index`` (n,) rows of the table of poses; ``t_gps_s``, ``jitter_s`` (n,); ``position_wcs_m`` (n, 3) and
    ``R_wcs_ics`` (n, 3, 3) of the body by image and mount; ``root`` (n, 6, 6) with ``root root^T`` the
    covariance of the image's error, moved to the body; ``by_mount`` (n, 6, 6) derivative of the body's pose
    by the mount's error in units of ``mount_root`` (6, 6); ``G``, ``W`` (n, 6, 6) transition of the error, in
    units of its root, from the image before, and its noise; ``node`` (n,).
    """

    index: ArrayI
    t_gps_s: ArrayF
    jitter_s: ArrayF
    position_wcs_m: ArrayF
    R_wcs_ics: ArrayF
    root: ArrayF
    by_mount: ArrayF
    mount_root: ArrayF
    G: ArrayF
    W: ArrayF
    node: ArrayI


@dataclass(frozen=True, slots=True, kw_only=True)
class Nodes:
    """Times (m,) of the nodes and the kind (m,) of the transition into each.

    ``walk`` (m, 3) factors, east, north, up, of the noise of position and rate in these transitions.
    """

    t_gps_s: ArrayF
    kind: ArrayI
    walk: ArrayF


def antenna_of(
    positions: pd.DataFrame, frame: LocalFrame, lever_ics_m: ArrayLike, sigma_lever_m: ArrayLike
) -> Antenna:
    """Observed antenna positions of usable rows of the table kind ``gnss_position``."""
    sigma = positions[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].to_numpy()
    correlation = np.tile(np.eye(3), (len(positions), 1, 1))
    for name, i, j in (("cov_en_m2", 0, 1), ("cov_eu_m2", 0, 2), ("cov_nu_m2", 1, 2)):
        value = np.nan_to_num(positions[name].to_numpy()) / (sigma[:, i] * sigma[:, j])
        correlation[:, i, j] = correlation[:, j, i] = value
    return Antenna(
        t_gps_s=positions["t_gps_s"].to_numpy(),
        position_wcs_m=frame.from_geodetic(positions["lat_deg"], positions["lon_deg"], positions["h_ell_m"]),
        root_m=sigma[:, :, None] * _root(correlation),
        lever_ics_m=np.asarray(lever_ics_m, dtype=np.float64),
        sigma_lever_m=np.asarray(sigma_lever_m, dtype=np.float64),
        node=np.zeros(len(positions), dtype=np.int64),
        begins=_changes(positions["fix"]),
    )


def _changes(fix: pd.Series) -> ArrayB:
    """Rows (n,) of another kind than the row before; the first is none."""
    kinds = fix.to_numpy(dtype=object)
    return np.append(False, kinds[1:] != kinds[:-1])


def camera_of(poses: ImagePoses, use: ArrayB, T_ccs_ics: Rigid, sigma_jitter_s: float) -> Camera:
    """Observed poses of the body by the images that may be used.

    Errors of images follow each other as a Markov chain with the covariances and neighbours' covariances that
    the table states; an image that is not used keeps its link in the chain.

    Parameters
    ----------
    poses : of all images.
    use : (n,) oriented, timed and within the INS.
    T_ccs_ics : mount with its covariance.
    sigma_jitter_s : stands in where the table states no sigma of a time.
    """
    oriented = np.flatnonzero(poses.oriented)
    t = np.where(np.isfinite(poses.t_gps_s), poses.t_gps_s, -np.inf)
    root, inverse = _pose_roots(poses.cov_pose_wcs[oriented], least=_LEAST_SIGMA)
    chosen: list[int] = []
    G, W = [], []
    link, noise = np.zeros((6, 6)), np.eye(6)
    for k, image in enumerate(oriented.tolist()):
        if k:
            M = _alike(inverse[k] @ poses.cov_next[oriented[k - 1]].T @ inverse[k - 1].T)
            link, noise = M @ link, M @ noise @ M.T + np.eye(6) - M @ M.T
        if use[image]:
            # images out of order in time cannot follow each other in a chain
            if chosen and t[image] < t[oriented[chosen[-1]]]:
                link, noise = np.zeros((6, 6)), np.eye(6)
            chosen.append(k)
            G.append(link)
            W.append(noise)
            link, noise = np.eye(6), np.zeros((6, 6))
    at = np.array(chosen, dtype=np.int64)
    order = np.argsort(t[oriented[at]], kind="stable")
    at, index = at[order], oriented[at][order]
    links, noises = np.array(G).reshape(-1, 6, 6)[order], np.array(W).reshape(-1, 6, 6)[order]
    broken = np.append(False, np.diff(order) != 1)
    links[broken], noises[broken] = 0.0, np.eye(6)
    R_wcs_ccs = poses.R_wcs_ccs[index]
    by_image = np.tile(np.eye(6), (len(index), 1, 1))
    by_image[:, :3, 3:] = -cross_matrix(R_wcs_ccs @ T_ccs_ics.shift_m)
    by_mount = np.zeros((len(index), 6, 6))
    by_mount[:, :3, :3] = by_mount[:, 3:, 3:] = R_wcs_ccs
    mount_root = _pose_roots(T_ccs_ics.cov[None])[0][0]
    jitter = poses.sigma_t_s[index]
    return Camera(
        index=index,
        t_gps_s=poses.t_gps_s[index],
        jitter_s=np.where(np.isfinite(jitter), jitter, sigma_jitter_s),
        position_wcs_m=poses.centre_wcs_m[index] + R_wcs_ccs @ T_ccs_ics.shift_m,
        R_wcs_ics=R_wcs_ccs @ T_ccs_ics.R,
        root=by_image @ root[at],
        by_mount=by_mount @ mount_root,
        mount_root=mount_root,
        G=links,
        W=noises,
        node=np.zeros(len(index), dtype=np.int64),
    )


def with_own_jitter(poses: ImagePoses) -> ImagePoses:
    """Poses whose ``sigma_t_s`` is the scatter of single images: the offset of the clock is a state here.

    Raises
    ------
    ConfigError : the times were estimated with the INS and the positions, which would then count twice.
    """
    told = poses.facts.get("image_times", {})
    if not told.get("independent_of_ins", True):
        raise ConfigError(
            "times of images that were estimated from positions and INS",
            expected="images.cloud.image_times: clock",
            cure="The fused trajectory estimates these times itself; take those of the camera's clock",
        )
    common_s = float(told.get("sigma_common_s", 0.0))
    single = np.sqrt(np.clip(poses.sigma_t_s**2 - common_s**2, 0.0, None))
    return poses.with_times(poses.t_gps_s, single)


def place_nodes(
    reference: Reference, settings: FusionSettings, antenna_t_s: ArrayF, image_t_s: ArrayF
) -> tuple[Nodes, ArrayI, ArrayI]:
    """Nodes at all observations, at most ``node_s`` apart, and at both ends of stretches without velocity.

    Returns
    -------
    nodes, node of each antenna position, node of each image : images have nodes of their own.
    """
    first, last = float(reference.t_gps_s[0]), float(reference.t_gps_s[-1])
    spans = reference.blind_spans()
    fixed = np.unique(np.concatenate([[first, last], antenna_t_s, image_t_s, spans.ravel()]))
    fixed = fixed[np.append(True, np.diff(fixed) > _SAME_S)]
    pieces = np.ceil(np.diff(fixed) / settings.node_s).astype(np.int64)
    left = np.repeat(np.arange(len(pieces)), pieces)
    place = np.arange(len(left)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    base = np.append(fixed[left] + place / pieces[left] * np.diff(fixed)[left], fixed[-1])
    middle = (base[1:] + base[:-1]) / 2
    k = np.searchsorted(spans[:, 0], middle) - 1
    blind = (k >= 0) & (middle < spans[np.maximum(k, 0), 1]) if len(spans) else np.zeros(len(middle), bool)
    begins_again = np.flatnonzero(blind[:-1] & ~blind[1:]) + 1
    at = np.concatenate([base, base[begins_again], image_t_s])
    # beside each other: a node, the step with which the velocity begins again, images of that time
    rank = np.repeat([0, 1, 2], [len(base), len(begins_again), len(image_t_s)])
    near = np.searchsorted(base, at - _SAME_S)
    shared = np.where(np.abs(base[np.minimum(near, len(base) - 1)] - at) <= _SAME_S, base[near], at)
    order = np.lexsort((rank, shared))
    kinds = np.full(len(at), INS)
    into = np.append(False, blind)
    kinds[: len(base)] = np.where(into, MODEL, INS)
    kinds[len(base) : len(base) + len(begins_again)] = RESET
    place_of = np.empty(len(at), dtype=np.int64)
    place_of[order] = np.arange(len(at))
    kind = kinds[order]
    antenna_node = place_of[np.searchsorted(base, antenna_t_s - _SAME_S)]
    nodes = Nodes(t_gps_s=shared[order], kind=kind, walk=np.ones((len(at), 3)))
    return nodes, antenna_node, place_of[len(at) - len(image_t_s) :]


def _root(cov: ArrayF) -> ArrayF:
    """Symmetric roots (n, k, k) of correlation matrices, negative eigenvalues of bad ones cut."""
    value, vector = np.linalg.eigh(cov)
    return np.asarray(vector * np.sqrt(np.maximum(value, 1e-9))[:, None, :] @ np.swapaxes(vector, 1, 2))


def _pose_roots(cov: ArrayF, least: float = 0.0) -> tuple[ArrayF, ArrayF]:
    """Roots (n, 6, 6) of covariances of poses, and their inverses; zero rows where nothing varies."""
    sigma = np.sqrt(np.maximum(np.diagonal(cov, axis1=1, axis2=2), 0.0))
    scale = np.where(sigma > 0, sigma, 1.0)
    correlation = np.nan_to_num(cov) / scale[:, :, None] / scale[:, None, :]
    every = np.arange(6)
    correlation[:, every, every] = 1.0
    root = _root(correlation)
    sigma = np.maximum(np.nan_to_num(sigma), least)
    inverse = np.linalg.inv(root) / np.where(sigma > 0, sigma, 1.0)[:, None, :]
    return sigma[:, :, None] * root, inverse


def _alike(correlation: ArrayF) -> ArrayF:
    """Correlation (6, 6) of two images' errors in units of their roots, with singular values below 1."""
    known = np.where(np.isfinite(correlation), correlation, 0.0) / (1.0 - WHITE_SHARE)
    left, value, right = np.linalg.svd(known)
    return np.asarray(left * np.minimum(value, _MOST_ALIKE) @ right)
