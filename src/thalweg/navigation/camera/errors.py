"""How INS and images err between images, estimated from both.

Images and INS alone, without any position, go through the smoother of the fused trajectory
(`thalweg.navigation.fusion.errors`): the innovations of its filter tell the sizes of the errors of velocity,
attitude, image poses and image times, and how long those of the INS last. The covariances of the camera's
trajectory are linear in the variances, so their mean over what the errors may be is that of the variances.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayB
from thalweg.images.model.poses import ImagePoses
from thalweg.navigation.camera.settings import CarriedErrors, CloudSettings
from thalweg.navigation.fusion.errors import ErrorModel, Prior, with_errors
from thalweg.navigation.fusion.inputs import camera_of, place_nodes
from thalweg.navigation.fusion.screen import jumped_images
from thalweg.navigation.fusion.settings import FusionSettings, Layout
from thalweg.navigation.fusion.solver import Observed, solve
from thalweg.navigation.ins_gnss.reference import Reference, make_reference
from thalweg.navigation.ins_gnss.selection import ATTITUDE_INITIALISED, TrajectorySummary, usable_states

LEAST_IMAGES = 3
"""With fewer, what is stated counts alone."""

OF_POSITIONS = ("position_time_s", "position_white_share")
"""What images and INS do not show: errors of the trajectory of INS and positions."""


def carried_errors(
    poses: ImagePoses,
    T_ics_ccs: Rigid,
    settings: CloudSettings,
    states: pd.DataFrame,
    *,
    sigma_attitude_rad: ArrayLike,
    max_attitude_gap_s: float,
    common_time_s: float,
) -> tuple[CloudSettings, ErrorModel]:
    """Settings with what the errors may be (``draws``), and how well they are known.

    Parameters
    ----------
    poses : of the images, with sigmas of their times.
    T_ics_ccs : mount of the camera with its covariance.
    settings : what is stated.
    states : table kind ``ins_state``.
    sigma_attitude_rad, max_attitude_gap_s : as for `thalweg.navigation.camera.trajectory.camera_trajectory`.
    common_time_s : sigma of the part of the times' errors that all images share.
    """
    known = poses.oriented & np.isfinite(poses.t_gps_s) & np.isfinite(poses.cov_pose_wcs).all(axis=(1, 2))
    ins = usable_states(states, TrajectorySummary(), max_attitude_gap_s, ATTITUDE_INITIALISED)
    order = np.flatnonzero(known)[np.argsort(poses.t_gps_s[known], kind="stable")]
    reference = make_reference(
        ins, poses.frame, sigma_attitude_rad=sigma_attitude_rad, max_attitude_gap_s=max_attitude_gap_s,
        use_velocity=True, near_t_s=poses.t_gps_s[order], near_wcs_m=poses.centre_wcs_m[order],
    )  # fmt: skip
    model = _estimated(
        poses, known & reference.inside(poses.t_gps_s), T_ics_ccs, settings, reference, common_time_s
    )
    if settings.motion == "trajectory" and settings.estimate_errors:
        model = _with_positions(model, settings)
    draws = tuple(_draw(model.values(h), settings) for h in model.points())
    return replace(settings, draws=draws), model


def errors_facts(model: ErrorModel) -> dict[str, Any]:
    """Estimates by name, see `ErrorModel.facts`, without what does not enter the camera's trajectory."""
    return {name: fact for name, fact in model.facts().items() if name != "acceleration"}


def scaled(poses: ImagePoses, settings: CloudSettings, common_time_s: float) -> ImagePoses:
    """Poses with covariances, and sigmas of times, that are the mean over what the errors may be.

    The part of the times' errors that all images share stays as it is.
    """
    camera = float(np.mean([e.camera**2 for e in settings.errors]))
    jitter = float(np.mean([e.jitter**2 for e in settings.errors]))
    shared = np.minimum(poses.sigma_t_s**2, common_time_s**2)
    sigma_t = np.sqrt(shared + jitter * (poses.sigma_t_s**2 - shared))
    changed = replace(poses, cov_pose_wcs=camera * poses.cov_pose_wcs, cov_next=camera * poses.cov_next)
    return changed.with_times(poses.t_gps_s, sigma_t)


def _estimated(
    poses: ImagePoses,
    use: ArrayB,
    T_ics_ccs: Rigid,
    settings: CloudSettings,
    reference: Reference,
    common_time_s: float,
) -> ErrorModel:
    """The errors of INS and images; the prior alone where there are too few images."""
    fusion = FusionSettings(
        sigma_velocity_mps=settings.sigma_velocity_mps, velocity_time_s=settings.velocity_time_s,
        attitude_time_s=settings.attitude_time_s, heading_disturbance_deg=0.0,
        sigma_clock_offset_s=common_time_s, sigma_jitter_s=settings.sigma_time_s,
        estimate_errors=settings.estimate_errors, fixed=settings.fixed, spread=settings.spread,
    )  # fmt: skip
    layout = Layout.of(gnss=False, camera=True)
    nothing = np.zeros(0)
    none = np.zeros(0, dtype=np.bool_)
    if not settings.estimate_errors or use.sum() < LEAST_IMAGES:
        nodes = place_nodes(reference, fusion, nothing, poses.t_gps_s[use])[0]
        return ErrorModel.stated(fusion, layout, nodes)
    single = np.sqrt(np.clip(poses.sigma_t_s**2 - common_time_s**2, 0.0, None))
    camera = camera_of(
        poses.with_times(poses.t_gps_s, single), use, T_ics_ccs.inverse(), settings.sigma_time_s
    )
    nodes, _, of_camera = place_nodes(reference, fusion, nothing, camera.t_gps_s)
    camera = replace(camera, node=of_camera)
    observed = Observed.of(None, camera, none, jumped_images(camera, reference, fusion))
    first = solve(reference, nodes, observed, layout, fusion)
    return with_errors(reference, nodes, observed, first, layout, fusion, clock_start_s=0.0)[-1]


def _with_positions(model: ErrorModel, settings: CloudSettings) -> ErrorModel:
    """The errors with those of the trajectory's positions, of which only what is stated is known."""
    spread = settings.spread
    stated = {name: getattr(settings, name) for name in OF_POSITIONS if name not in settings.fixed}
    # a share of 0 or 1 is no prior: it is meant
    kinds = {name: "time" if name == "position_time_s" else "share" for name in stated}
    more = {
        name: Prior(kind=kinds[name], centre=value, width=spread.get(name, spread[kinds[name]]))
        for name, value in stated.items()
        if kinds[name] == "time" or 0 < value < 1
    }
    n, k = len(model.h), len(more)
    cov = np.zeros((n + k, n + k))
    cov[:n, :n] = model.cov
    cov[n:, n:] = np.diag([np.log(p.width) ** 2 for p in more.values()])
    at = np.append(model.h, [p.at for p in more.values()])
    return replace(model, priors={**model.priors, **more}, h=at, cov=cov)


def _draw(values: dict[str, float], settings: CloudSettings) -> CarriedErrors:
    """What is not estimated is as stated."""
    names = CarriedErrors.__dataclass_fields__
    stated = {name: getattr(settings, name) for name in ("velocity_time_s", "attitude_time_s", *OF_POSITIONS)}
    return CarriedErrors(**{**stated, **{name: v for name, v in values.items() if name in names}})
