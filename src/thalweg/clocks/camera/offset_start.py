"""First value of a camera's offset: a search in time, and names for clocks that are off by whole hours."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.clocks.camera.offset_observations import CameraPoses
from thalweg.clocks.camera.track import Track
from thalweg.core.errors import ClockError, CoverageError
from thalweg.core.timescales import utc_text_from_gps
from thalweg.core.types import ArrayB, ArrayF
from thalweg.ingest.clock_shift import QUARTER_HOUR_S, explain_shift

_STEP_S: Final = 0.1
_LEAST_IMAGES: Final = 8
_ZONES: Final = 14 * 4
_FITS: Final = 3.0
"""A shift of whole hours explains the run if it leaves less than this many times what the sigmas allow."""
_GROSS: Final = 6.0
_GAP: Final = 2.5
"""Steps of the track beyond which nothing is interpolated."""
_CRUDE_M: Final = 2.0
"""Added to the largest lever where the offset is only known to half a second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Start:
    """Approximate offset, antenna in ccs (3,), and images (n,) that do not agree with the rest."""

    offset_s: float
    lever_m: ArrayF
    gross: ArrayB
    misfit_m: float
    overlapping: int


def find_start(poses: CameraPoses, track: Track, *, largest_offset_s: float, largest_lever_m: float) -> Start:
    """The offset at which the antenna stands still most, seen from the camera.

    Parameters
    ----------
    poses : images in order of time.
    track : positions of the antenna.
    largest_offset_s : the offset is looked for between minus and plus this.
    largest_lever_m : no antenna is farther from the camera. A boat that speeds up and slows down in a rhythm
        on a straight course fits as well one period later, with an antenna far ahead.

    Raises
    ------
    ClockError : images and positions do not overlap at any offset, or only with a shift by whole hours.
    CoverageError : they do, but too few images lie where positions are complete.
    """
    if len(poses.t_device_s) < _LEAST_IMAGES:
        raise ClockError(
            f"{len(poses.t_device_s)} images with a pose and a time",
            expected=f"at least {_LEAST_IMAGES}; a run of some minutes at one image a second is good",
        )
    grid: ArrayF = np.arange(-largest_offset_s, largest_offset_s + _STEP_S / 2, _STEP_S)
    best = _best(poses, track, grid, largest_lever_m)
    if best is None and _best(poses, track, grid, np.inf) is not None:
        raise ClockError(
            f"at no offset within {largest_offset_s:g} s is the antenna within {largest_lever_m:g} m of the "
            "camera",
            expected="poses and positions of one boat in one world frame",
            cure="Check the georeferencing of the poses, the offset of the camera from UTC, and the run",
        )
    if best is None:
        covered = int(_seen(poses, track, 0.0)[1].sum())
        within = (poses.t_device_s >= track.t_gps_s[0]) & (poses.t_device_s <= track.t_gps_s[-1])
        if within.any():
            raise CoverageError(
                f"{covered} of {len(poses.t_device_s)} images lie where positions are complete",
                expected=f"at least {_least(poses)}",
                cure="Look at the gaps of the positions in the table of streams",
            )
        raise _apart(poses, track, largest_offset_s, largest_lever_m)
    for step in (_STEP_S / 5, _STEP_S / 50):
        finer = _best(poses, track, best + step * np.arange(-10.0, 11.0), largest_lever_m)
        best = best if finer is None else finer
    seen, inside = _seen(poses, track, best)
    lever = np.median(seen[inside], axis=0)
    away = np.linalg.norm(seen - lever, axis=1)
    scale = 1.4826 * float(np.median(away[inside]))
    return Start(
        offset_s=float(best),
        lever_m=lever,
        gross=inside & (away > _GROSS * max(scale, 1e-3)),
        misfit_m=float(np.median(away[inside])),
        overlapping=int(inside.sum()),
    )


def at_the_end(start: Start, largest_offset_s: float) -> bool:
    """True if the best offset is at an end of what was searched."""
    return abs(start.offset_s) > largest_offset_s - 1.5 * _STEP_S


def _best(poses: CameraPoses, track: Track, offsets: ArrayF, largest_lever_m: float) -> float | None:
    """The offset at which the antenna is nearest to one place in the median; None if there is none."""
    least = _least(poses)
    best, found = float("inf"), None
    for offset in offsets:
        seen, inside = _seen(poses, track, float(offset))
        if inside.sum() >= least:
            seen = seen[inside]
            middle = np.median(seen, axis=0)
            misfit = float(np.median(np.linalg.norm(seen - middle, axis=1)))
            if misfit < best and np.linalg.norm(middle) <= largest_lever_m:
                best, found = misfit, float(offset)
    return found


def _least(poses: CameraPoses) -> int:
    """Images that must overlap with the track."""
    return max(_LEAST_IMAGES, len(poses.t_device_s) // 5)


def _seen(poses: CameraPoses, track: Track, offset_s: float) -> tuple[ArrayF, ArrayB]:
    """Antenna in ccs (n, 3) at an offset, linearly between epochs, and which images the track covers (n,)."""
    t = poses.t_device_s + offset_s
    right = np.clip(np.searchsorted(track.t_gps_s, t), 1, len(track.t_gps_s) - 1)
    step = track.t_gps_s[right] - track.t_gps_s[right - 1]
    inside = (t >= track.t_gps_s[0]) & (t <= track.t_gps_s[-1]) & (step < _GAP * track.step_s)
    at = np.column_stack([np.interp(t, track.t_gps_s, track.position_m[:, i]) for i in range(3)])
    return np.einsum("nji,nj->ni", poses.R_wcs_ccs, at - poses.centre_wcs_m), inside


def _apart(poses: CameraPoses, track: Track, largest_offset_s: float, largest_lever_m: float) -> ClockError:
    """The error about runs that share no time; a shift by whole hours that would fit is named."""
    spans = [
        f"{utc_text_from_gps(float(t[0]), 0)} .. {utc_text_from_gps(float(t[-1]), 0)}"
        for t in (poses.t_device_s, track.t_gps_s)
    ]
    found = f"the images (camera's clock {spans[0]}) and the positions ({spans[1]}) do not overlap"
    near: ArrayF = np.arange(-largest_offset_s, largest_offset_s + 0.5, 0.5)
    noise = float(np.sqrt(np.trace(track.cov_m2, axis1=1, axis2=2).mean()))
    fitting: list[tuple[float, float]] = []
    days = round(float(track.t_gps_s[0] - poses.t_device_s[0]) / 86_400.0)
    for day in sorted({0, days - 1, days, days + 1}):
        for zone in range(-_ZONES, _ZONES + 1):
            shift = day * 86_400.0 + zone * QUARTER_HOUR_S
            first, last = poses.t_device_s[[0, -1]] + shift
            if not shift or first > track.t_gps_s[-1] or last < track.t_gps_s[0]:
                continue
            offset = _best(poses, track, shift + near, largest_lever_m + _CRUDE_M)
            if offset is None:
                continue
            finer = _best(poses, track, offset + 0.05 * np.arange(-10.0, 11.0), largest_lever_m + _CRUDE_M)
            seen, inside = _seen(poses, track, offset if finer is None else finer)
            misfit = float(np.median(np.linalg.norm(seen[inside] - np.median(seen[inside], axis=0), axis=1)))
            fitting.append((misfit, offset))
    if not fitting:
        return ClockError(
            found,
            expected="images and positions of one run",
            cure="Check that both are of the same run and day, and the camera's offset from UTC",
        )
    misfit, offset = min(fitting)
    words = explain_shift(offset, largest_offset_s + 1.0)
    fits = misfit < _FITS * noise + 0.1
    return ClockError(
        f"{found}; shifted by {offset:+.1f} s ({words}) they would, and the antenna would "
        + (
            f"stand still on the boat within {misfit:.2f} m"
            if fits
            else f"wander by {misfit:.1f} m on the boat"
        ),
        expected="images and positions on one time scale",
        cure="State the camera's offset from UTC, or the right date; nothing is corrected silently"
        if fits
        else "Check that both are of the same run, and the date of the camera",
    )
