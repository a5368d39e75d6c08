"""Where the sensors sit on the boat of a campaign: as its file says, or as a calibration found.

One file a campaign, ``mounts.json``, is what every consumer reads, so that none of them asks where the
numbers come from. It has the structure of the section ``mounts``.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from thalweg.core.calibration.model import SENSORS, Calibration
from thalweg.core.errors import ConfigError
from thalweg.core.json_files import read_marked, write_marked

KIND: Final = "thalweg mounts"
VERSION: Final = 1


def resolve_mounts(section: Mapping[str, Any], calibration: Calibration | None) -> dict[str, dict[str, Any]]:
    """The place of each sensor: the calibration's where it holds one, else the campaign file's.

    Parameters
    ----------
    section : section ``mounts`` as plain values.
    calibration : what ``mounts.calibration`` names, or None.

    Returns
    -------
    mounts : by sensor, with ``source``: ``campaign`` or the run of the calibration.

    Raises
    ------
    ConfigError : the calibration holds no lidar or no antenna, so that their places would be defaults.
    """
    mounts = {name: {**section[name], "source": "campaign"} for name in SENSORS if name in section}
    if calibration is None:
        return mounts
    found = calibration.to_mounts()
    # A sensor of the chain that neither states would silently sit at the origin.
    absent = [name for name in ("lidar", "antenna") if name not in found and not _stated(section, name)]
    if not found or absent:
        raise ConfigError(
            f"the calibration '{calibration.title}' holds the blocks "
            f"{', '.join(block.name for block in calibration.blocks)}"
            + (f", and the campaign states no place of the {' and the '.join(absent)}" if absent else ""),
            expected=f"at least one of {', '.join(SENSORS)}; lidar and antenna here or in the campaign file",
            where=str(section.get("calibration") or ""),
            cure="Name the calibration of the boat, boat.yaml",
        )
    for name, mount in found.items():
        mounts[name] = {**mount, "source": calibration.source.run}
    return mounts


def _stated(section: Mapping[str, Any], name: str) -> bool:
    """Whether a campaign file places a sensor: zeros stand where nothing is written."""
    return any(float(value) != 0.0 for value in section.get(name, {}).get("lever_ics_m", ()))


def write_mounts(path: Path, mounts: Mapping[str, Any]) -> None:
    """Write what `resolve_mounts` gave."""
    write_marked(path, kind=KIND, version=VERSION, content={"mounts": mounts})


def read_mounts(path: Path) -> dict[str, Any]:
    """Read what `write_mounts` wrote.

    Raises
    ------
    InputError : the file is missing or something else.
    """
    return read_marked(
        path, "mounts", kind=KIND, version=VERSION, what="mounts of a campaign",
        cure="Build it again with the rule collect_mounts",
    )  # fmt: skip
