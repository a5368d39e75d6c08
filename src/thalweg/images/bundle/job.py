"""The adjustment of a campaign's images: from its files to an oriented block."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from thalweg.core.frames import LocalFrame
from thalweg.core.rigid import Rigid
from thalweg.images.bundle.antenna import antenna_at_images, antenna_lever_ccs
from thalweg.images.bundle.consent import Interiors
from thalweg.images.bundle.problem import Antenna
from thalweg.images.bundle.report import facts_of
from thalweg.images.bundle.result import image_poses
from thalweg.images.bundle.run import BlockSettings, Oriented, orient_block
from thalweg.images.control.tables import matched_marks, read_all_control_points, read_marks
from thalweg.images.model.block import ImageBlock
from thalweg.images.model.control_points import ControlMarks, ControlPoints
from thalweg.images.model.poses import ImagePoses


@dataclass(frozen=True, slots=True, kw_only=True)
class Boat:
    """What antenna positions need: table kind ``gnss_position``, mount of the camera, lever arm in ics."""

    positions: pd.DataFrame
    T_ics_ccs: Rigid
    lever_ics_m: Sequence[float]
    sigma_lever_m: Sequence[float]


def adjust_campaign(
    block: ImageBlock,
    predictions: ImagePoses,
    *,
    frame: LocalFrame,
    crs: str | None,
    adjustment: Mapping[str, Any],
    control: Mapping[str, Any],
    control_points: Sequence[Path],
    marks: Path | None,
    known: Interiors,
    boat: Boat | None,
    reasons: Mapping[str, str],
    elsewhere: frozenset[str] = frozenset(),
    progress: Callable[[str], None] | None = None,
) -> tuple[Oriented, ImagePoses, dict[str, Any]]:
    """Adjust the images of a campaign.

    Parameters
    ----------
    adjustment, control : sections ``images.adjustment`` and ``images.control``.
    reasons : why an image is not in the block, by name.
    elsewhere : images of other pieces of the block, whose marks are not lost.

    Returns
    -------
    oriented : the adjusted block.
    poses : of all images that ``predictions`` names, with its times.
    facts : JSON-able.
    """
    points, observed = ControlPoints.none(), ControlMarks.none()
    dropped: dict[str, int] = {}
    if control_points:
        points = read_all_control_points(
            control_points, frame, crs=control["crs"] or crs, sigma_m=control["sigma_m"],
            height_offset_m=control["height_offset_m"],
        )  # fmt: skip
        if marks is not None:
            observed, dropped = matched_marks(
                read_marks(marks).without(elsewhere), points, block.images,
                [block.cameras[c].size_px for c in block.camera], predictions.images,
                sigma_px=control["sigma_px"], where=marks,
            )  # fmt: skip
    row = {name: k for k, name in enumerate(predictions.images)}
    antenna: Antenna | None = None
    seen: dict[str, Any] = {}
    if boat is not None:
        at = np.array([row.get(name, -1) for name in block.images])
        t = np.where(at >= 0, predictions.t_gps_s[at], np.nan)
        options = adjustment["antenna"]
        antenna, seen = antenna_at_images(
            boat.positions, frame, t, predictions.sigma_t_s[at],
            sigma_clock_s=float(predictions.facts.get("sigma_common_s", 0.0)),
            lever_ccs_m=antenna_lever_ccs(boat.T_ics_ccs, boat.lever_ics_m),
            sigma_lever_m=np.asarray(boat.sigma_lever_m, np.float64),
            accept_fixes=options["accept_fixes"], max_gap_s=options["max_gap_s"],
            correlation_time_s=options["correlation_time_s"], shift=options["shift"], drift=options["drift"],
        )  # fmt: skip
    oriented = orient_block(
        block, points, observed, BlockSettings.from_section(adjustment),
        predictions=predictions, antenna=antenna, known=known, progress=progress,
    )  # fmt: skip
    facts = facts_of(oriented.adjusted, oriented.control, oriented.notes, oriented.demoted)
    facts |= {"dropped_marks": dropped, "antenna_positions": seen, "left_out_points": oriented.left_out}
    times = {
        name: (float(predictions.t_gps_s[k]), float(predictions.sigma_t_s[k])) for name, k in row.items()
    }
    poses = image_poses(
        oriented.adjusted, frame, predictions.images, dict(reasons), times,
        {"source": "block adjustment", "sigma0": facts["sigma0"], "redundancy": facts["redundancy"]},
    )  # fmt: skip
    return oriented, poses, facts
