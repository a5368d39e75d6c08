"""The truth of the digital twin; only the room ``accuracy`` and the tests may read it."""

import json
from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from thalweg.core import (
    ArrayF,
    ConfigError,
    LocalFrame,
    Trajectory,
    exp_rotation,
    opk_of,
    read_marked,
    rotation_opk,
    rotation_vector,
    write_marked,
)
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage.motion import LEAD_S, Motion, motion_of

TRUTH_RATE_HZ: Final = 200.0

KIND: Final = "thalweg twin mounts"
ANGLES: Final = ("omega_deg", "phi_deg", "kappa_deg")


# ---------------------------------------------------------------- truth


def true_trajectory(motion: Motion, frame: LocalFrame) -> Trajectory:
    """The true poses at 200 Hz, from 2.5 s before to 2.5 s after the lidar log, with zero sigmas."""
    span = motion.config.duration_s + 2 * LEAD_S + 1.0
    steps = np.arange(int(np.ceil(span * TRUTH_RATE_HZ)) + 1) / TRUTH_RATE_HZ
    t = motion.start_gps_s - LEAD_S - 0.5 + steps
    return Trajectory(
        frame=frame,
        t_gps_s=t,
        position_wcs_m=motion.position_wcs_m(t),
        quaternion_wcs_ics=Rotation.from_matrix(motion.R_wcs_ics(t)).as_quat(),
        cov_pose_wcs=np.zeros((len(t), 6, 6)),
        valid=np.ones(len(t), dtype=np.bool_),
    )


def longest_correlation_s(twin: Mapping[str, Any], position_source: str) -> float:
    """Longest correlation time among the errors of the poses, as far as the stated sigmas hold them.

    Parameters
    ----------
    twin : section ``twin`` as plain values.
    position_source : ``orientation.position_source``.
    """
    config = TwinConfig(**twin)
    if position_source == "ins":
        positions_s = config.ins.position_time_s
    elif config.gnss.mode == "single_frequency":
        positions_s = config.gnss.single_time_s
    else:
        positions_s = config.gnss.correlation_time_s
    return max(config.ins.attitude_time_s, positions_s)


def simulate_voyage(config: TwinConfig, seed: int, frame: LocalFrame, out_trajectory: Path) -> None:
    """Write the true trajectory of the voyage or of the run about a field, table kind ``trajectory``.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    frame : the world frame.
    out_trajectory : target, ``.parquet``.
    """
    true_trajectory(motion_of(config, seed), frame).write(out_trajectory, {"source": "digital twin, truth"})


def write_effects(path: Path | None, stream: str, facts: Mapping[str, Any]) -> None:
    """Write what was done to a log as JSON, beside the truth; nothing if ``path`` is None."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps({"stream": stream, **facts}, indent=2) + "\n")


# ---------------------------------------------------------------- where the sensors really sit
#
# The processing reads the estimates from the campaign file, the instruments of the twin sit at the true
# mounts. An error of a mount is constant over the whole recording, so it can be told from noise only over
# many seeds.


def true_mounts(mounts: Mapping[str, Any], seed: int, *, on: bool) -> dict[str, Any]:
    """The true mounts: the campaign's values plus normal errors of the stated sigmas.

    Parameters
    ----------
    mounts : section ``mounts`` or a part of it as plain values: a mapping of sensors, each with
        ``lever_ics_m`` and ``sigma_lever_m``; lidar and camera also with ``omega_deg``, ``phi_deg``,
        ``kappa_deg``, their sigmas, ``sigma_axes`` that tells what these mean, and, if given,
        ``correlation``: the (6, 6) matrix of omega, phi, kappa (or rotations about x, y, z), x, y, z.
    seed : seed of the campaign. Each sensor has a stream of its own, so the sensors that are asked for
        do not change each other.
    on : ``twin.effects.mount_errors``; False gives the campaign's values.

    Returns
    -------
    true : the same structure with the true angles and lever arms; the sigmas are untouched.

    Raises
    ------
    ConfigError : a correlation matrix that is none.
    """
    true = deepcopy({name: dict(mount) for name, mount in mounts.items() if isinstance(mount, Mapping)})
    for name, mount in true.items():
        keys = ANGLES if ANGLES[0] in mount else ()
        sigmas = [mount[f"sigma_{key}"] for key in keys] + list(mount["sigma_lever_m"])
        white = generator(seed, f"mount {name}").standard_normal(len(sigmas))
        if not on:
            continue
        errors = np.asarray(sigmas) * (_root(mount.get("correlation"), len(sigmas), name) @ white)
        if keys and mount.get("sigma_axes", "angles") == "ics":
            mount |= _turned(mount, errors[:3])
        else:
            mount |= {k: float(mount[k]) + e for k, e in zip(keys, errors.tolist(), strict=False)}
        lever = np.asarray(mount["lever_ics_m"], dtype=np.float64) + errors[-3:]
        mount["lever_ics_m"] = lever.tolist()
    return true


def mount_errors(true: Mapping[str, Any], estimated: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """True minus estimated, for each sensor: angles in degrees, lever arms in metres.

    ``rotation_ics_deg`` is the small rotation vector v of ``R_true = exp([v]x) R_estimated``.
    """
    errors: dict[str, dict[str, Any]] = {}
    for name, mount in true.items():
        known = estimated[name]
        errors[name] = {key: float(mount[key] - known[key]) for key in ANGLES if key in mount}
        if ANGLES[0] in mount:
            R_true, R_known = (rotation_opk(*np.deg2rad([m[k] for k in ANGLES])) for m in (mount, known))
            errors[name]["rotation_ics_deg"] = np.rad2deg(rotation_vector(R_true @ R_known.T)).tolist()
        off = np.asarray(mount["lever_ics_m"]) - np.asarray(known["lever_ics_m"])
        errors[name]["lever_ics_m"] = off.tolist()
    return errors


def _turned(mount: Mapping[str, Any], vector_ics_deg: ArrayF) -> dict[str, float]:
    """Angles after a small turn about the axes of ics, ``exp([v]x) R``.

    Near phi = -90 degrees omega and kappa turn about the same axis: they may come out far from the estimated
    ones, and still stand for nearly the same rotation.
    """
    angles = np.deg2rad([mount[key] for key in ANGLES])
    R = exp_rotation(np.deg2rad(vector_ics_deg)) @ rotation_opk(*angles)
    return dict(zip(ANGLES, np.rad2deg(opk_of(R)).tolist(), strict=True))


def write_true_mounts(path: Path, true: Mapping[str, Any], estimated: Mapping[str, Any]) -> None:
    """Write the true mounts as JSON beside the truth, with their differences from the campaign's.

    Parameters
    ----------
    path : target.
    true : what `true_mounts` gave.
    estimated : the campaign's mounts that it was drawn around.
    """
    content = {"mounts": true, "true_minus_estimated": mount_errors(true, estimated)}
    write_marked(path, kind=KIND, version=1, content=content)


def read_true_mounts(path: Path) -> dict[str, Any]:
    """Read the mounts that `write_true_mounts` wrote, in the structure of the section ``mounts``.

    Raises
    ------
    InputError : the file is missing or something else.
    """
    return read_marked(
        path,
        "mounts",
        kind=KIND,
        version=1,
        what="true mounts of the twin",
        cure="Build it again with the rule that simulates the mounts",
    )


def _root(correlation: Sequence[Sequence[float]] | None, n: int, name: str) -> ArrayF:
    """Symmetric square root of a correlation matrix (n, n); the identity where none is given."""
    if correlation is None:
        return np.eye(n)
    matrix = np.asarray(correlation, dtype=np.float64)
    where = f"mounts.{name}.correlation"
    if matrix.shape != (n, n):
        raise ConfigError(f"a matrix of shape {matrix.shape}", expected=f"({n}, {n})", where=where)
    fits = (
        np.isfinite(matrix).all()
        and np.allclose(matrix, matrix.T, atol=1e-6)
        and np.allclose(np.diag(matrix), 1.0)
    )
    values, vectors = np.linalg.eigh(matrix) if fits else (np.array([-1.0]), np.eye(n))
    # Estimated matrices are rounded: an eigenvalue may be a rounding error below zero.
    if values.min() < -1e-6:
        raise ConfigError(
            "a matrix that is no correlation matrix",
            expected="a symmetric matrix with a diagonal of ones and without negative eigenvalues",
            where=where,
            cure="Take the correlations from the adjustment's covariance: C_ij / sqrt(C_ii C_jj)",
        )
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)
