"""Capture files of the static positions."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from thalweg.core.errors import ConfigError
from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayF
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.instruments.lidar import simulate_lidar
from thalweg_lab.voyage.yard_motion import standing, static_seed
from thalweg_lab.yard.layout import field_of
from thalweg_lab.yard.scene import recorded_scene


def simulate_positions(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    out_pcaps: Sequence[Path],
    *,
    R_ics_scs: ArrayF,
    lever_ics_scs_m: ArrayF,
    out_effects: Path | None = None,
) -> list[dict[str, Any]]:
    """Record each static position with the lidar and write its capture file.

    Parameters
    ----------
    config : section ``twin`` with ``field``.
    seed : seed of the campaign; each position has noise of its own.
    frame : the world frame.
    out_pcaps : one target a position, in their order.
    R_ics_scs, lever_ics_scs_m : true mount of the scanner.
    out_effects : where to write what was done to the logs (JSON), beside the truth.

    Returns
    -------
    facts : of each position, see `simulate_lidar`.

    Raises
    ------
    ConfigError : not as many targets as positions.
    """
    wanted = len(field_of(config).positions)
    if len(out_pcaps) != wanted:
        raise ConfigError(
            f"{len(out_pcaps)} capture files for {wanted} positions",
            expected="one file for each of twin.field.positions",
            where="twin.field.positions",
        )
    facts = []
    for number, path in enumerate(out_pcaps, start=1):
        motion = standing(config, number)
        facts.append(
            simulate_lidar(
                motion.config,
                static_seed(seed, number),
                frame,
                recorded_scene(config, seed, f"position {number}").scene,
                path,
                R_ics_scs=R_ics_scs,
                lever_ics_scs_m=lever_ics_scs_m,
                motion=motion,
            )
        )
    if out_effects is not None:
        out_effects.parent.mkdir(parents=True, exist_ok=True)
        out_effects.write_text(
            json.dumps({"stream": "static positions", "positions": facts}, indent=2) + "\n"
        )
    return facts
