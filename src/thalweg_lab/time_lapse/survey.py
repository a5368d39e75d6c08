"""The survey of the control points as a user would bring it, and the truth about points and camera."""

import json
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core.errors import ConfigError
from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayB, ArrayF
from thalweg.images.model.poses import ImagePoses
from thalweg.settings.twin.time_lapse import TwinTimeLapse
from thalweg_lab.base.random import generator
from thalweg_lab.time_lapse.plan import Plan
from thalweg_lab.time_lapse.targets import Targets

KIND: Final = "thalweg twin time lapse"
"""Kind of the JSON file of the truth."""

_AXES: Final = ("east", "north", "up")


def surveyed(targets: Targets, settings: TwinTimeLapse, seed: int) -> tuple[pd.DataFrame, list[list[str]]]:
    """The table of control points, and the pairs whose names are swapped in it.

    Columns ``id``, ``east_m``, ``north_m``, ``up_m`` in wcs, ``sigma_east_m``, ``sigma_north_m``,
    ``sigma_up_m``, ``role`` (``control`` or ``check``).

    Raises
    ------
    ConfigError : more pairs of names to swap than there are.
    """
    n = len(targets.names)
    sigma = np.asarray(settings.sigma_target_m)
    error = sigma * generator(seed, "control points survey").standard_normal((n, 3))
    place = np.round(targets.centre_wcs_m + error, 4)
    names = list(targets.names)
    pairs = settings.effects.swapped_points
    if 2 * pairs > n:
        raise ConfigError(
            f"{pairs} pairs of {n} control points",
            expected="at most half as many pairs as points",
            where="twin.time_lapse.effects.swapped_points",
            cure="Lower it, or raise n_targets",
        )
    order = generator(seed, "control points swapped").permutation(n)[: 2 * pairs].tolist()
    swapped = [[names[a], names[b]] for a, b in zip(order[::2], order[1::2], strict=True)]
    for a, b in zip(order[::2], order[1::2], strict=True):
        names[a], names[b] = names[b], names[a]
    columns: dict[str, Any] = {"id": names}
    columns |= {f"{axis}_m": place[:, i] for i, axis in enumerate(_AXES)}
    columns |= {f"sigma_{axis}_m": np.full(n, sigma[i]) for i, axis in enumerate(_AXES)}
    columns["role"] = np.where(targets.check, "check", "control")
    return pd.DataFrame(columns), swapped


def write_survey(path: Path, table: pd.DataFrame) -> None:
    """Write the table of `surveyed` as CSV, coordinates to a tenth of a millimetre."""
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path, index=False, float_format="%.4f", lineterminator="\n")


def write_poses(path: Path, plan: Plan, frame: LocalFrame) -> None:
    """True poses and times of all files, table kind ``image_poses`` with covariances of zero."""
    files = [(name, shot) for shot in plan.shots for name in (shot.name, shot.copy_name) if name]
    n = len(files)
    ImagePoses(
        frame=frame,
        images=tuple(name for name, _ in files),
        t_gps_s=np.array([shot.t_gps_s for _, shot in files]),
        sigma_t_s=np.zeros(n),
        oriented=np.ones(n, dtype=np.bool_),
        reasons=("",) * n,
        centre_wcs_m=np.array([shot.T_wcs_ccs.shift_m for _, shot in files]).reshape(n, 3),
        R_wcs_ccs=np.array([shot.T_wcs_ccs.R for _, shot in files]).reshape(n, 3, 3),
        cov_pose_wcs=np.zeros((n, 6, 6)),
        cov_next=np.zeros((n, 6, 6)),
        n_marks=np.zeros(n),
        rms_px=np.full(n, np.nan),
        facts={"source": "digital twin, true poses"},
    ).write(path)


def write_truth(path: Path, plan: Plan, targets: Targets, swapped: list[list[str]], clock: ArrayF) -> None:
    """True interior orientation, true control points, and what is wrong with which file, as JSON.

    Parameters
    ----------
    path : target.
    plan : of the images.
    targets : the boards.
    swapped : pairs of names that are swapped in the survey's table.
    clock : (n,) what the camera's clock was ahead of UTC at each exposure, seconds.
    """
    camera = plan.camera
    facts = {
        "kind": KIND,
        "version": 1,
        "camera": {
            "model": camera.model,
            "size_px": list(camera.size_px),
            "parameters": dict(zip(camera.parameter_names, camera.parameters.tolist(), strict=True)),
        },
        "target_size_m": targets.size_m,
        "targets": [
            {
                "id": name,
                "role": "check" if check else "control",
                **{f"{axis}_m": float(place[i]) for i, axis in enumerate(_AXES)},
                "normal_wcs": normal.tolist(),
                "right_wcs": right.tolist(),
                "images": int(seen),
            }
            for name, check, place, normal, right, seen in zip(
                targets.names, _plain(targets.check), targets.centre_wcs_m, targets.normal_wcs,
                targets.right_wcs, targets.seen, strict=True,
            )
        ],
        "swapped_points": swapped,
        "images": [
            {
                "file": shot.name,
                "t_gps_s": shot.t_gps_s,
                "stamp_us": shot.stamp_us,
                "clock_minus_utc_s": float(ahead),
                "stamped": shot.stamped,
                "sharp": shot.sharp,
                "copy": shot.copy_name or None,
            }
            for shot, ahead in zip(plan.shots, clock, strict=True)
        ],
    }  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(facts, indent=1) + "\n")


def _plain(flags: ArrayB) -> list[bool]:
    return [bool(flag) for flag in flags]
