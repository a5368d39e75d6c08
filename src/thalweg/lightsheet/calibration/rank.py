"""Which combinations of unknowns a calibration leaves free, and what they are called.

Two defects are part of the method, and the papers state finite sigmas across both of them. A fan of light has
no mark in its own plane, so that its rotation there changes nothing: of six laser parameters five are
estimable (P4 6.3 states all six). And nothing on parallel planes shows a rotation of the whole sensor about
the normal of the window, which the nine unknowns of P3 2.4 contain. Shifts along the window come to the same.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core import ArrayF, GeometryError, UnobservableError, exp_rotation, opk_of, whitened
from thalweg.lightsheet.calibration.model import Problem
from thalweg.lightsheet.optics import CAMERA, FLIP, LASER, PARAMETERS, Sensor

SINGULAR: Final = 1e-5
"""Smallest singular value, of columns of unit length, that counts; as `RANK_TOLERANCE` for eigenvalues."""
_EXPLAINED: Final = 1e-2
"""Share of a null direction that may remain beside the known motions."""
_ARM_MM: Final = 100.0
_STILL: Final = 1e-6
"""Share of a motion that counts as none."""
_STEP: Final = 1e-6

IN_PLANE: Final = "the light sheet turned in its own plane"
ABOUT_NORMAL: Final = "camera and laser turned together about the normal of the window"
ALONG_X: Final = "camera and laser shifted together along the window in x"
ALONG_Y: Final = "camera and laser shifted together along the window in y"


@dataclass(frozen=True, slots=True, kw_only=True)
class NullDirection:
    """A change of the unknowns that changes no observation.

    Parameters
    ----------
    change : names and amounts of the unknowns that take part, the largest 1 (mm and degrees).
    motion : what it is, in words; "" if it is none of the known motions.
    singular_value : of the derivatives with columns of unit length.
    """

    change: dict[str, float]
    motion: str
    singular_value: float


class FreeDirectionError(UnobservableError):
    """The observations leave unknowns free; says along which directions.

    Parameters
    ----------
    directions : null directions.
    """

    def __init__(self, directions: list[NullDirection]) -> None:
        self.directions = tuple(directions)
        self.parameters = tuple(dict.fromkeys(name for d in directions for name in d.change))
        self.defects = len(directions)
        told = "; ".join(
            (f"{d.motion}: " if d.motion else "")
            + ", ".join(f"{name} {amount:+.3g}" for name, amount in d.change.items())
            for d in directions
        )
        strong = ", ".join(f"{next(iter(d.change))}" for d in directions)
        GeometryError.__init__(
            self,
            f"{len(directions)} direction{'s' if len(directions) > 1 else ''} of the unknowns change"
            f"{'' if len(directions) > 1 else 's'} no observation ({told})",
            expected="unknowns that the lines on the levels determine",
            cure=f"Hold one unknown of each direction fixed, such as {strong}: any sigma of it would be made "
            "up",
        )


def null_directions(problem: Problem, x: ArrayF) -> list[NullDirection]:
    """Null directions of the unknowns of a problem at a state."""
    J = np.concatenate([whitened(group.model(x), group.name)[1] for group in problem.observations()])
    scale = np.linalg.norm(J, axis=0)
    blind = scale <= 0
    found = [
        NullDirection(change={problem.free[i]: 1.0}, motion="", singular_value=0.0)
        for i in np.flatnonzero(blind)
    ]
    seen = np.flatnonzero(~blind)
    if len(seen) == 0:
        return found
    _, values, vectors = np.linalg.svd(J[:, seen] / scale[seen], full_matrices=True)
    values = np.concatenate([values, np.zeros(len(seen) - len(values))])
    free = values <= SINGULAR
    if not free.any():
        return found
    # null space in columns of unit length, one row a direction, smallest singular value first
    null = np.zeros((int(free.sum()), len(problem.free)))
    null[:, seen] = vectors[free][::-1]
    scale = np.where(blind, 1.0, scale)
    named = _explained(problem.with_sensor(problem.sensor.with_vector(x[: len(PARAMETERS)])), null, scale)
    for _, direction in named:
        null = null - np.outer(null @ direction, direction)
    # what the known motions do not explain, as an orthonormal rest
    rest = np.linalg.svd(null, full_matrices=False)[2][: len(null) - len(named)]
    directions = [*named, *(("", direction) for direction in rest)]
    for (name, direction), value in zip(directions, np.sort(values[free]), strict=True):
        found.append(_null_direction(problem, direction / scale, name, float(value)))
    return found


def require_full_rank(problem: Problem, x: ArrayF) -> None:
    """Refuse unknowns that the observations leave free.

    Raises
    ------
    FreeDirectionError : names the directions.
    """
    directions = null_directions(problem, x)
    if directions:
        raise FreeDirectionError(directions)


def estimable_laser(sensor: Sensor) -> tuple[str, ...]:
    """The five laser parameters that a calibration estimates: position, and the angles but one.

    Held fixed is the angle that takes the largest part in the rotation of the sheet in its own plane (P3
    3.1.1: "the same effect that a wider opening angle would have"): phi of P4's laser, omega of P3's.
    """
    names = PARAMETERS[LASER]
    turn = _in_plane(sensor)[LASER][3:]
    fixed = names[3 + int(np.abs(turn).argmax())]
    return tuple(name for name in names if name != fixed)


def _explained(problem: Problem, null: ArrayF, scale: ArrayF) -> list[tuple[str, ArrayF]]:
    """Known motions, or mixtures of them named after the first, that lie in a null space.

    A motion that would move a parameter which is held fixed is none; a mixture may leave that parameter
    alone. Directions (u,) are in columns of unit length, orthonormal.
    """
    motions = _motions(problem)
    held = [i for i, name in enumerate(PARAMETERS) if name not in problem.free]
    # an angle moves what it turns by some hundred millimetres
    weight = np.array([_ARM_MM if name.endswith("_rad") else 1.0 for name in PARAMETERS])
    G = np.stack(list(motions.values()), axis=1)
    weighted = G * weight[:, None]
    _, sizes, mixtures = np.linalg.svd(weighted[held])
    sizes = np.concatenate([sizes, np.zeros(len(motions) - len(sizes))])
    rows = _echelon(mixtures[sizes < _STILL * max(float(np.linalg.norm(weighted)), 1e-300)])
    found: list[tuple[str, ArrayF]] = []
    for row in rows:
        change = G @ row
        direction = scale * np.array(
            [change[PARAMETERS.index(name)] if name in PARAMETERS else 0.0 for name in problem.free]
        )
        length = float(np.linalg.norm(direction))
        inside = null.T @ (null @ direction)
        if len(found) < len(null) and np.linalg.norm(inside - direction) < _EXPLAINED * length:
            found.append((list(motions)[int(np.flatnonzero(np.abs(row) > _STILL)[0])], direction / length))
    return found


def _echelon(rows: ArrayF) -> ArrayF:
    """Reduced echelon form of independent rows: each begins with a one, above and below which are zeros."""
    out, at = rows.copy(), 0
    for column in range(out.shape[1]):
        if at == len(out):
            break
        best = at + int(np.abs(out[at:, column]).argmax())
        if abs(out[best, column]) < 1e-8:
            continue
        out[[at, best]] = out[[best, at]]
        out[at] /= out[at, column]
        for other in range(len(out)):
            if other != at:
                out[other] -= out[other, column] * out[at]
        at += 1
    return out


def _null_direction(problem: Problem, change: ArrayF, motion: str, singular_value: float) -> NullDirection:
    """A null direction in mm and degrees, the largest part first."""
    amounts = {
        name: float(np.rad2deg(amount) if name.endswith("_rad") else amount)
        for name, amount in zip(problem.free, change, strict=True)
    }
    ordered = sorted(amounts.items(), key=lambda item: -abs(item[1]))
    largest = ordered[0][1]
    return NullDirection(
        change={name: amount / largest for name, amount in ordered if abs(amount) > 1e-3 * abs(largest)},
        motion=motion,
        singular_value=singular_value,
    )


def _motions(problem: Problem) -> dict[str, ArrayF]:
    """Changes (26,) of the parameters that change no observation."""
    sensor = problem.sensor
    R = sensor.window.R_lcs_window
    found = {
        ABOUT_NORMAL: _derivative(sensor, lambda h: _turned(sensor, exp_rotation(h * R[:, 2]))),
        ALONG_X: _shifted(R[:, 0]),
        ALONG_Y: _shifted(R[:, 1]),
    }
    if sensor.sheet.v == 0.0:
        found[IN_PLANE] = _in_plane(sensor)
    return found


def _in_plane(sensor: Sensor) -> ArrayF:
    """Change of the parameters by a rotation of the fan in its own plane."""

    def turned(h: float) -> ArrayF:
        """Parameters of the sensor with its fan turned in the plane of the sheet by ``h``, radians."""
        x = sensor.vector()
        x[LASER][3:] = opk_of(sensor.sheet.R_lcs_las @ exp_rotation([0.0, h, 0.0]))
        return x

    return _derivative(sensor, turned)


def _turned(sensor: Sensor, turn: ArrayF) -> ArrayF:
    x = sensor.vector()
    x[CAMERA][:3] = turn @ sensor.camera_origin_lcs_mm
    x[CAMERA][3:] = opk_of(turn @ sensor.R_lcs_ccs @ FLIP)
    x[LASER][:3] = turn @ sensor.sheet.origin_lcs_mm
    x[LASER][3:] = opk_of(turn @ sensor.sheet.R_lcs_las)
    return x


def _shifted(direction: ArrayF) -> ArrayF:
    change = np.zeros(len(PARAMETERS))
    change[CAMERA][:3] = direction
    change[LASER][:3] = direction
    return change


def _derivative(sensor: Sensor, moved: Callable[[float], ArrayF]) -> ArrayF:
    off = moved(_STEP) - moved(-_STEP)
    angles = np.array([name.endswith("_rad") for name in PARAMETERS])
    # the angles of both ends may lie a full turn apart
    off[angles] = (off[angles] + np.pi) % (2 * np.pi) - np.pi
    return np.asarray(off / (2 * _STEP))
