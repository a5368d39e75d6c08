"""INS, antenna positions and image poses -> one trajectory of the boat."""

from pathlib import Path
from typing import Any

import numpy as np

from thalweg.calibration import read_mounts
from thalweg.core import LocalFrame, Rigid, read_table, write_chains, write_json
from thalweg.images.model import ImagePoses
from thalweg.ingest import GNSS_POSITION, INS_STATE
from thalweg.navigation.fusion import FusionSettings, count_table, fuse_trajectory, with_own_jitter
from thalweg.settings.sections import Fused
from thalweg.workflow import run_job


def main(
    *,
    states: Path,
    mounts: Path,
    trajectory: Path,
    observations: Path,
    counts: Path,
    facts: Path,
    errors: Path,
    adjusted: Path,
    frame: LocalFrame,
    fused: Fused,
    orientation: dict[str, Any],
    ins: dict[str, Any],
    images_hold_positions: bool,
    positions: Path | None = None,
    images: Path | None = None,
) -> None:
    places = read_mounts(mounts)
    T_ics_ccs = Rigid.from_mount(places["camera"])
    # positions of `ins` and `sbet` are no antenna: they would count the INS twice
    antenna = positions is not None and orientation["position_source"] not in ("ins", "sbet")
    found = fuse_trajectory(
        read_table(states, INS_STATE)[0],
        frame,
        FusionSettings.of(fused),
        positions=read_table(positions, GNSS_POSITION)[0] if antenna and positions else None,
        lever_ics_antenna_m=places["antenna"]["lever_ics_m"],
        sigma_lever_m=places["antenna"]["sigma_lever_m"],
        images=None if images is None else with_own_jitter(ImagePoses.read(images)),
        T_ccs_ics=T_ics_ccs.inverse(),
        images_hold_positions=images_hold_positions,
        sigma_attitude_rad=np.deg2rad([ins[f"sigma_{a}_deg"] for a in ("roll", "pitch", "heading")]),
        max_attitude_gap_s=orientation["max_attitude_gap_s"],
    )
    found.trajectory.write(trajectory)
    whole = found.whole()
    found.observations.to_csv(observations, index=False, float_format="%.6f")
    count_table(found.facts).to_csv(counts, index=False)
    write_json(facts, found.facts)
    write_chains(errors, found.error_chains(whole))
    if images is not None:
        found.image_poses(ImagePoses.read(images), whole).write(adjusted)


if "snakemake" in globals():
    run_job(main, snakemake)
