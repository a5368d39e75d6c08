"""The truth of the digital twin; only the room ``accuracy`` and the tests may read it."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from thalweg.core.frames import LocalFrame
from thalweg.core.trajectory import Trajectory
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.voyage.motion import LEAD_S, Motion
from thalweg_lab.voyage.motions import motion_of

TRUTH_RATE_HZ: Final = 200.0


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
