"""An error budget: a chain of frames, its inputs with their sigmas, and where each of them comes from.

The chain goes from the world inwards; the point lies in the innermost frame at a distance along one
direction. Inputs are named after what they are of:

``<frame>.omega`` and so on, ``<frame>.x``
    an angle or a coordinate of the origin of a frame in the next outer one;
``point.x``, ``point.along``, ``point.across``
    a coordinate of the point in the innermost frame, or its error along the beam and in each of two
    directions across it; a sigma in degrees or milliradians across a beam grows with the distance;
``time``
    the stamp of the point against the pose (P2 eq. 6): what the outermost frame moves meanwhile.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from thalweg.core import (
    SHIFT,
    TURN,
    ArrayF,
    Chain,
    GeometryError,
    Link,
    attitude_axes,
    beam_axes,
    chain_derivatives,
    opk_axes,
    propagated,
    root_mean_square,
    rotation_enu_body,
    rotation_opk,
)

STATUS: Final = ("published geometry", "reconstructed, not published", "assumed")
PROVENANCE: Final = ("published", "assumed", "fitted")
"""``fitted``: chosen so that a published result is met, so that result is no test of it."""
ANGLES: Final = (("omega", "phi", "kappa"), ("roll", "pitch", "heading"))
COORDINATES: Final = ("x", "y", "z")
BEAM: Final = ("along", "across")
ANGLE_UNITS: Final = {"deg": np.pi / 180, "mrad": 1e-3, "rad": 1.0, "arcsec": np.pi / 648_000}
LENGTH_UNITS: Final = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
TIME_UNITS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
UNITS: Final = ANGLE_UNITS | LENGTH_UNITS | TIME_UNITS
GROUPS: Final = ("position", "attitude", "timing", "boresight", "lever arm", "lidar")

TOTAL = "total"
CORRELATIONS = "correlations"


# ---------------------------------------------------------------- budget


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """A frame of the chain: its angles (degrees, named) and the origin in the next outer frame (metres)."""

    name: str
    angles_deg: dict[str, float]
    lever_m: tuple[float, float, float]

    def rotation(self) -> ArrayF:
        """Rotation (3, 3) from this frame into the next outer one."""
        a, b, c = (float(np.deg2rad(value)) for value in self.angles_deg.values())
        if tuple(self.angles_deg) == ANGLES[1]:
            return rotation_enu_body(a, b, c)
        return rotation_opk(a, b, c)

    def axes(self) -> ArrayF:
        """Axes (3, 3), as columns, in the next outer frame, about which the three angles turn."""
        if tuple(self.angles_deg) == ANGLES[1]:
            return np.asarray(attitude_axes(self.rotation()[None])[0].T)
        omega, phi, _ = (float(np.deg2rad(value)) for value in self.angles_deg.values())
        return opk_axes(omega, phi)


@dataclass(frozen=True, slots=True, kw_only=True)
class Input:
    """One row of a budget. ``source`` says where the sigma stands, or how it was chosen."""

    key: str
    sigma: float
    unit: str
    provenance: str
    source: str

    @property
    def frame(self) -> str:
        """Name of the frame, ``point``, or nothing for ``time``."""
        return self.key.rpartition(".")[0]

    @property
    def part(self) -> str:
        """What of the frame: ``omega``, ``x``, ``along``, ``time``."""
        return self.key.rpartition(".")[2]

    @property
    def sigma_si(self) -> float:
        """Sigma in metres, radians or seconds."""
        return self.sigma * UNITS[self.unit]

    @property
    def grows_with_distance(self) -> bool:
        """True for an angle across the beam."""
        return self.part == "across" and self.unit in ANGLE_UNITS


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Speed of the outermost frame: of its three angles (deg/s) and along the world's axes (m/s)."""

    angles_deg_per_s: tuple[float, float, float]
    axes_m_per_s: tuple[float, float, float]

    def rates(self) -> tuple[ArrayF, ArrayF]:
        """(3,) rad/s of the angles and (3,) m/s along the axes."""
        return np.deg2rad(self.angles_deg_per_s), np.asarray(self.axes_m_per_s, dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Survey:
    """Distances over which an RMSE is taken, uniform between two ends."""

    from_m: float
    to_m: float
    provenance: str
    source: str

    def distances_m(self) -> ArrayF:
        """Middles (200,) of equal steps: finer than any budget changes."""
        edges = np.linspace(self.from_m, self.to_m, 201)
        return np.asarray((edges[1:] + edges[:-1]) / 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Budget:
    """An error budget, see the head of this module; `thalweg.budgets.budget_file` reads it."""

    name: str
    title: str
    source: str
    status: str
    frames: tuple[Frame, ...]
    direction: tuple[float, float, float]
    distances_m: tuple[float, ...]
    inputs: tuple[Input, ...]
    correlations: dict[tuple[str, str], float] = field(default_factory=dict)
    motion: Motion | None = None
    survey: Survey | None = None
    world: str = "wcs"
    remarks: str = ""

    def group(self, item: Input) -> str:
        """One of `GROUPS`."""
        if item.frame in ("", "point"):
            return "lidar" if item.frame else "timing"
        outermost = item.frame == self.frames[0].name
        if item.part in COORDINATES:
            return "position" if outermost else "lever arm"
        return "attitude" if outermost else "boresight"

    def correlation_matrix(self) -> ArrayF:
        """(k, k) in the order of the inputs."""
        place = {item.key: i for i, item in enumerate(self.inputs)}
        out = np.eye(len(place))
        for (a, b), value in self.correlations.items():
            out[place[a], place[b]] = out[place[b], place[a]] = value
        return out


def frame_columns(
    chain: Chain, axes: Sequence[ArrayF], rates: tuple[ArrayF, ArrayF] | None = None
) -> tuple[list[ArrayF], ArrayF | None]:
    """Derivatives of points by the angles and coordinates of each frame, and by time.

    Parameters
    ----------
    chain : derivatives by shifts and rotation vectors of its links.
    axes : of each frame from the world inwards, the axes of its three angles as columns, (3, 3) or (n, 3, 3).
    rates : of the outermost frame, (3,) rad/s of its angles and (3,) m/s along the world's axes.

    Returns
    -------
    list
        For each frame (n, 3, 6): by its three angles, by x, y, z.
    ArrayF or None
        (n, 3) by time (P2 eq. 6), None without rates.
    """
    frames = [
        np.concatenate([J[:, :, TURN] @ A, J[:, :, SHIFT]], axis=2)
        for J, A in zip(chain.by_link, axes, strict=True)
    ]
    return frames, None if rates is None else frames[0] @ np.concatenate(rates)


def jacobian(budget: Budget, distances_m: ArrayLike) -> list[ArrayF]:
    """For each input of a budget its derivative times one sigma, (n, 3, 1), or (n, 3, 2) across a beam.

    Parameters
    ----------
    distances_m : (n,) from the origin of the innermost frame.
    """
    d = np.asarray(distances_m, dtype=np.float64)
    points = d[:, None] * (np.asarray(budget.direction) / np.linalg.norm(budget.direction))
    chain = chain_derivatives(
        [Link(rotation=frame.rotation(), shift_m=np.asarray(frame.lever_m)) for frame in budget.frames],
        points,
    )
    rates = None if budget.motion is None else budget.motion.rates()
    frames, time = frame_columns(chain, [frame.axes() for frame in budget.frames], rates)
    beam = beam_axes(np.einsum("nij,nj->ni", chain.by_point, points))
    place = {frame.name: k for k, frame in enumerate(budget.frames)}
    out = []
    for item in budget.inputs:
        if item.key == "time":
            if time is None:
                raise GeometryError("an error of time, but no motion", where=budget.name)
            J = time[:, :, None]
        elif item.frame == "point":
            if item.part in COORDINATES:
                J = chain.by_point[:, :, [COORDINATES.index(item.part)]]
            else:
                J = beam[:, :, :1] if item.part == "along" else beam[:, :, 1:]
        else:
            k = place[item.frame]
            names = [*budget.frames[k].angles_deg, *COORDINATES]
            J = frames[k][:, :, [names.index(item.part)]]
        out.append(J * (item.sigma_si * (d[:, None, None] if item.grows_with_distance else 1.0)))
    return out


def covariance(budget: Budget, distances_m: ArrayLike) -> ArrayF:
    """Covariance (n, 3, 3) of the point in the world at distances (n,), m^2: ``J S J^T``."""
    parts = jacobian(budget, distances_m)
    owner = np.repeat(np.arange(len(parts)), [J.shape[2] for J in parts])
    correlation = budget.correlation_matrix()[np.ix_(owner, owner)]
    # both directions across a beam share one sigma, not one error
    correlation[(owner[:, None] == owner) & ~np.eye(len(owner), dtype=bool)] = 0.0
    return propagated(np.concatenate(parts, axis=2), correlation)


# ---------------------------------------------------------------- what each input does to a point


def influences(
    budget: Budget, distances_m: ArrayLike | None = None, *, normal: ArrayLike | None = None
) -> pd.DataFrame:
    """Influence of each input on the 3D standard deviation of a point (P2 eq. 8-9).

    Parameters
    ----------
    distances_m : (n,); the budget's own if None.
    normal : (3,) in the world; with it, the influences on the component along this direction, which is what a
        comparison with a surface sees.

    Returns
    -------
    DataFrame
        Columns ``input, group, sigma, unit, provenance, distance_m, influence_mm``: a row for each input and
        distance, then the sum of the covariance terms where there are correlations (the root of its size with
        its sign, for it may reduce the total), then the total.

    Raises
    ------
    GeometryError : a distance is not positive, or a normal has no length.
    """
    d = np.atleast_1d(np.asarray(budget.distances_m if distances_m is None else distances_m, dtype=float))
    if d.ndim != 1 or not d.size or not (np.isfinite(d) & (d > 0)).all():
        raise GeometryError(f"distances {d.tolist()}", expected="at least one, above 0 m")
    along = None if normal is None else _unit(normal)
    rows = []
    alone = np.zeros(len(d))
    for item, J in zip(budget.inputs, jacobian(budget, d), strict=True):
        variance = np.sum((J if along is None else along @ J) ** 2, axis=(1, 2) if along is None else 1)
        alone += variance
        facts = (item.key, budget.group(item), item.sigma, item.unit, item.provenance)
        rows += [(*facts, at, 1e3 * v**0.5) for at, v in zip(d, variance, strict=True)]
    cov = covariance(budget, d)
    total = np.einsum("nii->n", cov) if along is None else np.einsum("i,nij,j->n", along, cov, along)
    none = (np.nan, "", "")
    if budget.correlations:
        shared = total - alone
        rows += [
            (CORRELATIONS, CORRELATIONS, *none, at, 1e3 * float(np.sign(v) * abs(v) ** 0.5))
            for at, v in zip(d, shared, strict=True)
        ]
    rows += [(TOTAL, TOTAL, *none, at, 1e3 * v**0.5) for at, v in zip(d, total, strict=True)]
    names = ["input", "group", "sigma", "unit", "provenance", "distance_m", "influence_mm"]
    return pd.DataFrame(rows, columns=names)


def totals_mm(budget: Budget, distances_m: ArrayLike) -> ArrayF:
    """3D standard deviation (n,) in millimetres."""
    return np.asarray(1e3 * np.sqrt(np.einsum("nii->n", covariance(budget, distances_m))))


def rmse_mm(budget: Budget) -> float:
    """RMSE over the distances of the budget's survey.

    Raises
    ------
    GeometryError : the budget has no survey.
    """
    if budget.survey is None:
        raise GeometryError(
            "a budget without a survey", where=budget.name, expected="`survey` with `from_m` and `to_m`"
        )
    return root_mean_square(totals_mm(budget, budget.survey.distances_m()))


def _unit(normal: ArrayLike) -> ArrayF:
    n = np.asarray(normal, dtype=np.float64)
    length = float(np.linalg.norm(n)) if n.shape == (3,) else 0.0
    if not 0 < length < np.inf:
        raise GeometryError(f"normal {n.tolist()}", expected="three numbers with a length above 0")
    return np.asarray(n / length)
