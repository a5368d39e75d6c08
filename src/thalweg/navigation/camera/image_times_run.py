"""The clock of a camera by the images of a survey, some hundred of them at a time.

The estimate holds the covariance of all images' residuals at once and costs the cube of their number, so long
surveys are cut into parts in order of time, each with an offset of its own; one line through these is the
clock.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from thalweg.clocks.camera.offset import CameraOffset, camera_offset
from thalweg.clocks.camera.offset_fit import OffsetOptions
from thalweg.clocks.camera.offset_observations import CameraPoses, InsAttitude
from thalweg.clocks.camera.track import Track
from thalweg.clocks.ties.model import ClockModel
from thalweg.core.errors import ThalwegError
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class RunClock:
    """``clock`` of the survey; ``sigma_run_offset_s`` of the mean time of its images; ``images``, a row an
    image as of `thalweg.clocks.camera.offset.CameraOffset`; ``facts`` for a report.
    """

    clock: ClockModel
    sigma_run_offset_s: float
    images: pd.DataFrame
    facts: dict[str, Any]


def run_clock(
    poses: CameraPoses,
    track: Track,
    *,
    ins: InsAttitude | None,
    options: OffsetOptions,
    images_together: int,
) -> RunClock:
    """Clock of a camera by a survey.

    Errors that neighbouring images share count in each pose as if they were its own: at some millimetres and
    hundredths of a degree they are far below those of positions and INS.

    Parameters
    ----------
    poses : images in order of their stamps.
    track : antenna positions.
    ins : attitudes, or None.
    options : of the estimate.
    images_together : images of a part at most.

    Raises
    ------
    ThalwegError : no part tells the clock; the error of the first one.
    """
    n = len(poses.t_device_s)
    parts = np.array_split(np.arange(n), max(1, -(-n // images_together)))
    found: list[CameraOffset] = []
    tables: list[pd.DataFrame] = []
    refused: list[ThalwegError] = []
    for part in parts:
        try:
            done = camera_offset(poses.take(part), track, ins=ins, options=options)
        except ThalwegError as error:
            refused.append(error)
            continue
        found.append(done)
        tables.append(done.images)
    if not found:
        raise refused[0]
    clock = found[0].clock if len(found) == 1 else _line(found, options)
    sigma_run = np.array([done.sigma_run_offset_s for done in found])
    facts = {
        "parts": len(parts),
        "parts_refused": [error.found for error in refused],
        "images_in_refused_parts": n - sum(len(table) for table in tables),
        "images_used": int(sum(table["used"].sum() for table in tables)),
        "offset_s": clock.offset_s,
        "sigma_offset_s": clock.sigma_offset_s,
        "drift_ppm": clock.drift * 1e6,
        "sigma_drift_ppm": clock.sigma_drift * 1e6,
        "jitter_s": clock.jitter_s,
        "sigma_jitter_s": clock.sigma_jitter_s,
        "sigma0_squared": [done.sigma0_squared for done in found],
        "sigma0_squared_bands": [[done.sigma0_low, done.sigma0_high] for done in found],
        "with_attitude": ins is not None,
        "notes": list(dict.fromkeys(note for done in found for note in done.clock.notes)),
    }
    return RunClock(
        clock=clock,
        sigma_run_offset_s=float(np.median(sigma_run)),
        images=pd.concat(tables, ignore_index=True),
        facts=facts,
    )


def antenna_in_camera(
    T_ics_ccs: Rigid, lever_ics_antenna_m: ArrayLike, sigma_lever_m: ArrayLike
) -> tuple[ArrayF, ArrayF]:
    """The antenna in the frame of the camera (3,) and its covariance (3, 3), by the mounts of both.

    Known places of both let a straight course tell the time, too: along it a shift of time is no longer the
    same as another place of the antenna.

    Parameters
    ----------
    T_ics_ccs : mount of the camera with covariance.
    lever_ics_antenna_m, sigma_lever_m : (3,) place of the antenna and its standard deviations.
    """
    T_ccs_ics = T_ics_ccs.inverse()
    lever = np.asarray(lever_ics_antenna_m, dtype=np.float64)[None]
    J = T_ccs_ics.by_error(lever)[0]
    own = T_ccs_ics.R * np.asarray(sigma_lever_m, dtype=np.float64)
    return T_ccs_ics.apply(lever)[0], np.asarray(J @ T_ccs_ics.cov @ J.T + own @ own.T)


def _line(found: list[CameraOffset], options: OffsetOptions) -> ClockModel:
    """One clock from those of parts: their information adds, prior knowledge of the drift counts once."""
    clocks = [done.clock for done in found]
    reference = float(np.mean([clock.reference_s for clock in clocks]))
    N, y = np.zeros((2, 2)), np.zeros(2)
    start = clocks[0].offset_s
    for clock in clocks:
        # offset and drift at the part's own reference
        J = np.array([[1.0, clock.reference_s - reference], [0.0, 1.0]])
        weight = np.linalg.inv(clock.cov)
        N += J.T @ weight @ J
        y += J.T @ weight @ np.array([clock.offset_s - start, clock.drift])
    if options.sigma_drift > 0:
        N[1, 1] -= (len(clocks) - 1) / options.sigma_drift**2
    cov = np.linalg.inv(N)
    value = cov @ y
    used = np.array([int(done.images["used"].sum()) for done in found], dtype=np.float64)
    jitter = np.sqrt(np.average([clock.jitter_s**2 for clock in clocks], weights=used))
    of_jitter = np.array([clock.sigma_jitter_s for clock in clocks])
    return ClockModel(
        offset_s=start + float(value[0]),
        drift=float(value[1]),
        reference_s=reference,
        cov=(cov + cov.T) / 2,
        jitter_s=float(jitter),
        sigma_jitter_s=float(np.sqrt(np.sum(np.square(used * of_jitter))) / used.sum()),
        source=f"survey, {int(used.sum())} images in {len(clocks)} parts",
        t_first_s=min(clock.t_first_s for clock in clocks),
        t_last_s=max(clock.t_last_s for clock in clocks),
        notes=tuple(dict.fromkeys(note for clock in clocks for note in clock.notes)),
    )
