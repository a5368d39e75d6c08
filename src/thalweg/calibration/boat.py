"""All sensors of the boat in one calibration with one joint covariance, and where its file puts them.

The lidar comes from the run, the camera through the lidar,

    T_ics_ccs = T_ics_scs T_scs_ccs

and the antenna is where it is defined to be: its lever arm has no error, because it says where the origin of
ics is (`thalweg.calibration.ins_lidar.adjustment`). The mount of the lidar depends on the camera-lidar
orientation where the antenna was seen by a marker, and that of the camera on both.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from thalweg.calibration.ins_lidar import AntennaLever
from thalweg.core import ArrayF, ConfigError, GeometryError, Rigid, read_marked, write_marked
from thalweg.core.calibration import SENSORS, Block, Calibration, Source, lever_block, pose_block

DEFINED: Final = "its place defines the origin of ics: no error of its own"
"""Fact of the antenna's block."""
_DEGREES: Final = np.zeros((6, 6))

KIND: Final = "thalweg mounts"
VERSION: Final = 1


# ---------------------------------------------------------------- joint calibration


class CalibratedMount(Protocol):
    """Mount of the lidar with covariance, and its derivative (6, 3) by the antenna seen from the scanner."""

    @property
    def T_ics_scs(self) -> Rigid:
        """With consistent covariance."""

    @property
    def by_antenna(self) -> ArrayF:
        """Zero if the antenna's marker was not used."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EchoPlace:
    """Where the echo sounder is.

    Parameters
    ----------
    lever_m : (3,) from what it was measured from, along the axes of ics, metres.
    cov_m2 : (3, 3).
    measured_from : the antenna, whose place is defined; the scanner; or the origin of ics itself.
    method : how, for people.
    """

    lever_m: ArrayF
    cov_m2: ArrayF
    measured_from: Literal["antenna", "lidar", "ics"] = "antenna"
    method: str = "ruler"

    @classmethod
    def ruled_from_ins(
        cls, lever_ics_m: ArrayLike, *, sigma_lever_m: ArrayLike, sigma_antenna_m: ArrayLike
    ) -> Self:
        """An echo sounder measured from the INS, as the antenna was.

        The antenna defines the origin of ics and has no error there. What its own ruler errs is therefore an
        error of everything that was measured from the INS: both variances add.

        Parameters
        ----------
        lever_ics_m, sigma_lever_m : (3,) place of the echo sounder and what its ruler errs, metres.
        sigma_antenna_m : (3,) what the ruler of the antenna's lever arm errs, metres.
        """
        variance = np.square(np.asarray(sigma_lever_m)) + np.square(np.asarray(sigma_antenna_m))
        return cls(
            lever_m=np.asarray(lever_ics_m, dtype=np.float64),
            cov_m2=np.diag(variance),
            measured_from="ics",
            method="ruler from the INS, with the error of the antenna's",
        )


def assemble(
    ins_lidar: CalibratedMount,
    *,
    lever_ics_antenna_m: ArrayF,
    T_ccs_scs: Rigid | None,
    antenna: AntennaLever | None,
    echo_sounder: EchoPlace | None,
    source: Source,
    title: str = "Boat",
) -> Calibration:
    """One calibration of the boat.

    Parameters
    ----------
    ins_lidar : mount of the lidar.
    lever_ics_antenna_m : (3,) by which the trajectory of the run was made.
    T_ccs_scs : relative orientation of the lidar in the camera with covariance, or None without a camera.
    antenna : the antenna seen from the sensors, if the run used it.
    echo_sounder : its place, or None.
    source, title : of the calibration.

    Raises
    ------
    GeometryError : the antenna was used in the run but is not given, so that correlations would be lost.
    """
    if np.any(ins_lidar.by_antenna) and antenna is None:
        raise GeometryError(
            "the run used the antenna's marker, which is not given here",
            expected="the antenna as it entered the run",
        )
    relative = T_ccs_scs or Rigid()
    echo_cov = np.zeros((3, 3)) if echo_sounder is None else echo_sounder.cov_m2
    cov = _independent(ins_lidar, relative.cov, antenna, echo_cov)
    mount = ins_lidar.T_ics_scs
    blocks: list[Block] = []
    rows: list[ArrayF] = []
    block, _ = pose_block("lidar", mount)
    blocks.append(block)
    rows.append(_DEGREES @ _columns(lidar=np.eye(6)))
    if T_ccs_scs is not None:
        back = relative.inverse()
        first, second = mount.by_product(back)
        block, _ = pose_block("camera", mount @ back)
        blocks.append(block)
        rows.append(_DEGREES @ _columns(lidar=first, relative=second @ relative.by_inverse()))
    blocks.append(replace(lever_block("antenna", lever_ics_antenna_m), facts={"note": DEFINED}))
    rows.append(np.zeros((3, 15)))
    if echo_sounder is not None:
        starts = {"antenna": np.asarray(lever_ics_antenna_m), "lidar": mount.shift_m, "ics": np.zeros(3)}
        by_lidar = np.eye(3, 6) * (echo_sounder.measured_from == "lidar")
        place = lever_block("echo_sounder", starts[echo_sounder.measured_from] + echo_sounder.lever_m)
        facts = {"method": echo_sounder.method, "measured_from": echo_sounder.measured_from}
        blocks.append(replace(place, facts=facts))
        rows.append(_columns(lidar=by_lidar, echo=np.eye(3)))
    J = np.concatenate(rows)
    joint = J @ cov @ J.T
    return Calibration(title=title, blocks=tuple(blocks), cov=(joint + joint.T) / 2, source=source)


_DEGREES[:3, 3:] = np.eye(3) * 180 / np.pi


_DEGREES[3:, :3] = np.eye(3)
"""From (shift, m; rotation vector, rad) to the order and units of a pose block."""


def _columns(
    *, lidar: ArrayF | None = None, relative: ArrayF | None = None, echo: ArrayF | None = None
) -> ArrayF:
    """Derivatives by the errors of the lidar's mount (6), of ``T_ccs_scs`` (6), of the echo sounder (3)."""
    given = [part for part in (lidar, relative, echo) if part is not None]
    m = len(given[0])
    parts = [np.zeros((m, k)) if part is None else part for part, k in ((lidar, 6), (relative, 6), (echo, 3))]
    return np.concatenate(parts, axis=1)


def _independent(
    ins_lidar: CalibratedMount, cov_relative: ArrayF, antenna: AntennaLever | None, cov_echo: ArrayF
) -> ArrayF:
    """Joint covariance (15, 15) of lidar, camera-lidar and echo sounder as measured."""
    cov = np.zeros((15, 15))
    cov[:6, :6] = ins_lidar.T_ics_scs.cov
    cov[6:12, 6:12] = cov_relative
    cov[12:, 12:] = cov_echo
    if antenna is not None:
        cross = ins_lidar.by_antenna @ antenna.by_camera_lidar @ cov_relative
        cov[:6, 6:12], cov[6:12, :6] = cross, cross.T
    return cov


# ---------------------------------------------------------------- mounts of a campaign: as its file says, or
# as a calibration found
#
# One file a campaign, ``mounts.json``, is what every consumer reads, so that none of them asks where the
# numbers come from. It has the structure of the section ``mounts``.


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
        path,
        "mounts",
        kind=KIND,
        version=VERSION,
        what="mounts of a campaign",
        cure="Build it again with the rule collect_mounts",
    )
