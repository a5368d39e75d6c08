"""Calibrated quantities of a boat: values, one joint covariance, and the equations that they stand in.

A calibration is a set of *blocks*: the place of a sensor, the interior orientation of a camera, the offset of
a clock. All quantities of all blocks share one covariance matrix: one adjustment gives them together.

The place of a sensor with axes is a *pose block* with the quantities omega, phi, kappa, x, y, z of::

    x_target = R_x(omega) R_y(phi) R_z(kappa) x_source + (x, y, z)

The errors of its angles are a small rotation vector about the x, y and z axes of the *target* frame, not
errors of omega, phi and kappa: at phi = -90 degrees, the nominal mount of the lidar (T 3.1.1), omega and
kappa turn about the same axis, and no finite covariance of the three angles describes every error.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Self

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.frames import rotation_opk
from thalweg.core.rigid import Rigid, opk_of
from thalweg.core.types import ArrayF

ANGLES: Final = ("omega_deg", "phi_deg", "kappa_deg")
LEVER: Final = ("x_m", "y_m", "z_m")
POSE: Final = (*ANGLES, *LEVER)
"""Quantities of a pose block, in this order."""

FRAMES: Final[dict[str, tuple[str, str]]] = {
    "lidar": ("ics", "scs"),
    "camera": ("ics", "ccs"),
    "camera_lidar": ("ccs", "scs"),
}
"""Block of a pose -> target and source frame."""

SENSORS: Final = ("lidar", "camera", "antenna", "echo_sounder")
"""Blocks that are mounts of the boat: places in ics."""

UNIT_OF_NAME: Final = {"fx": "px", "fy": "px", "cx": "px", "cy": "px"}
UNIT_OF_SUFFIX: Final = {"deg": "deg", "m": "m", "s": "s", "px": "px", "ppm": "ppm", "mps": "mps"}

SMALLEST_EIGENVALUE: Final = -1e-6
"""Of a correlation matrix: people write six digits, or more."""


def unit_of(quantity: str) -> str:
    """Unit that a quantity's name states; "1" for pure numbers.

    Examples
    --------
    >>> [unit_of(name) for name in ("omega_deg", "offset_s", "fx", "k1")]
    ['deg', 's', 'px', '1']
    """
    return UNIT_OF_NAME.get(quantity) or UNIT_OF_SUFFIX.get(quantity.rpartition("_")[2], "1")


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """Quantities that belong together.

    Parameters
    ----------
    name : ``lidar``, ``camera``, ``antenna``, ``camera_clock`` and so on.
    quantities : names with their units, such as ``x_m``; see `unit_of`.
    values : (k,) in those units.
    equation : what the quantities mean, with its frames.
    convention : what else one must know to use them.
    facts : plain values that go with them: model and size of a camera, reference time of a clock.

    Raises
    ------
    GeometryError : no equation, not one finite value a quantity, or a quantity twice.
    """

    name: str
    quantities: tuple[str, ...]
    values: ArrayF
    equation: str
    convention: str = ""
    facts: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        k = len(self.quantities)
        if np.shape(self.values) != (k,) or k == 0 or not np.isfinite(self.values).all():
            raise GeometryError(
                f"values {np.asarray(self.values).tolist()}",
                expected=f"a finite value for each of {', '.join(self.quantities) or 'some names'}",
                where=f"calibration block {self.name}",
            )
        if len(set(self.quantities)) < k or not self.equation.strip():
            raise GeometryError(
                "no equation" if not self.equation.strip() else "a quantity stands twice",
                expected="the equation of the frame, and each quantity once",
                where=f"calibration block {self.name}",
            )

    @property
    def is_pose(self) -> bool:
        """True if the quantities are those of a pose."""
        return self.quantities == POSE

    @property
    def labels(self) -> tuple[str, ...]:
        """Quantities with the name of the block: ``lidar.omega_deg``."""
        return tuple(f"{self.name}.{quantity}" for quantity in self.quantities)


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Where a calibration comes from.

    Parameters
    ----------
    run : campaign or recording.
    method : how the values were found.
    created : ISO time of the recording or of the calculation; "" if not stated.
    observations : number of observations; 0 if not stated.
    sigma0 : standard deviation of unit weight; NaN if not stated.
    twin : true if the digital twin made the recording.
    """

    run: str
    method: str
    created: str = ""
    observations: int = 0
    sigma0: float = float("nan")
    twin: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """Blocks of quantities with one joint covariance.

    Parameters
    ----------
    title : for people.
    blocks : in the order of the covariance.
    cov : (n, n) covariance of all quantities in their units; errors of the angles of a pose block are small
        rotations about the axes of its target frame, in degrees.
    source : where it comes from.

    Raises
    ------
    GeometryError : a block stands twice, or the covariance is none.

    Examples
    --------
    >>> antenna = lever_block("antenna", [0.1, 0.0, -0.45])
    >>> mast = Calibration(
    ...     title="Mast", blocks=(antenna,), cov=np.eye(3) * 1e-6, source=Source(run="yard", method="ruler")
    ... )
    >>> mast.to_mounts()["antenna"]["sigma_lever_m"]
    (0.001, 0.001, 0.001)
    """

    title: str
    blocks: tuple[Block, ...]
    cov: ArrayF
    source: Source

    def __post_init__(self) -> None:
        names = [block.name for block in self.blocks]
        if len(set(names)) < len(names) or not names:
            raise GeometryError(f"blocks {names}", expected="one or more blocks, each once")
        n = len(self.labels)
        cov = np.asarray(self.cov, dtype=np.float64)
        if cov.shape != (n, n) or not np.isfinite(cov).all():
            raise GeometryError(
                f"covariance of shape {cov.shape}", expected=f"finite numbers, ({n}, {n})", where=self.title
            )
        sigma = np.sqrt(np.clip(np.diag(cov), 0.0, None))
        scale = np.outer(sigma, sigma)
        unlike = np.abs(cov - cov.T) > 1e-9 * np.maximum(scale, np.finfo(float).tiny)
        if unlike.any() or (np.diag(cov) < 0).any() or lowest_eigenvalue(cov)[0] < SMALLEST_EIGENVALUE:
            raise GeometryError(
                "this is no covariance matrix",
                expected="symmetric, without negative variances or eigenvalues",
                where=self.title,
            )

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of all quantities in the order of the covariance: ``lidar.omega_deg``."""
        return tuple(label for block in self.blocks for label in block.labels)

    @property
    def values(self) -> ArrayF:
        """(n,) all values in their units."""
        return np.concatenate([block.values for block in self.blocks])

    @property
    def sigmas(self) -> ArrayF:
        """(n,) standard deviations in the units of the values."""
        return np.sqrt(np.diag(self.cov))

    def __contains__(self, name: object) -> bool:
        return any(block.name == name for block in self.blocks)

    def find(self, name: str) -> Block:
        """The block of a name.

        Raises
        ------
        GeometryError : there is none.
        """
        for block in self.blocks:
            if block.name == name:
                return block
        raise GeometryError(
            f"no block '{name}'",
            expected=f"one of {', '.join(block.name for block in self.blocks)}",
            where=self.title,
            cure="Name a calibration that holds it",
        )

    def block(self, name: str) -> tuple[ArrayF, ArrayF]:
        """Values (k,) and covariance (k, k) of a block, in the units of its quantities."""
        return self.joint([name])

    def joint(self, names: Sequence[str]) -> tuple[ArrayF, ArrayF]:
        """Values and joint covariance of blocks (``lidar``) or single quantities (``lidar.x_m``).

        Raises
        ------
        GeometryError : a name is unknown.
        """
        labels = self.labels
        wanted = [label for name in names for label in ([name] if "." in name else self.find(name).labels)]
        unknown = [label for label in wanted if label not in labels]
        if unknown:
            raise GeometryError(
                f"no quantity {', '.join(unknown)}", expected=f"some of {', '.join(labels)}", where=self.title
            )
        at = [labels.index(label) for label in wanted]
        return self.values[at], self.cov[np.ix_(at, at)]

    def correlation(self) -> ArrayF:
        """(n, n) correlation matrix; a quantity without error is uncorrelated."""
        return correlation_of(self.cov)

    def pose(self, name: str) -> Rigid:
        """Transform ``T_target_source`` of a pose block, with its covariance (6, 6).

        Raises
        ------
        GeometryError : there is no such block, or it is no pose.
        """
        block = self.find(name)
        if not block.is_pose:
            raise GeometryError(f"block '{name}' is no pose", expected=f"the quantities {', '.join(POSE)}")
        values, cov = self.block(name)
        R = rotation_opk(*(float(angle) for angle in np.deg2rad(values[:3])))
        return Rigid(R=R, shift_m=values[3:].copy(), cov=_turned_round(cov, np.pi / 180.0))

    def to_mounts(self) -> dict[str, dict[str, Any]]:
        """Section ``mounts`` of a campaign: for each sensor its place, sigmas and correlations.

        Correlations between sensors have no place there; `joint` has them. ``sigma_axes: ics`` says that
        the sigmas of the angles are about the axes of ics.
        """
        mounts: dict[str, dict[str, Any]] = {}
        for name in (block.name for block in self.blocks if block.name in SENSORS):
            values, cov = self.block(name)
            if self.find(name).is_pose and not self.find(name).equation.startswith("x_ics = "):
                raise GeometryError(
                    f"block '{name}' is {self.find(name).equation.split(',')[0]}",
                    expected="a place on the boat, x_ics = R_ics_sensor @ x_sensor + (x, y, z)",
                    where=self.title,
                    cure="Invert it, or import it with the frames in the other order",
                )
            sigma = np.sqrt(np.diag(cov))
            mount: dict[str, Any] = {}
            if self.find(name).is_pose:
                mount |= dict(zip(ANGLES, values[:3].tolist(), strict=True))
                mount |= {f"sigma_{a}": s for a, s in zip(ANGLES, sigma[:3].tolist(), strict=True)}
                mount["sigma_axes"] = "ics"
            mount["lever_ics_m"] = tuple(values[-3:].tolist())
            mount["sigma_lever_m"] = tuple(sigma[-3:].tolist())
            mount["correlation"] = tuple(tuple(row) for row in correlation_of(cov).tolist())
            mounts[name] = mount
        return mounts

    @classmethod
    def merged(cls, parts: Sequence[Self], *, title: str, source: Source) -> Self:
        """Several calibrations in one; between them nothing is correlated.

        Raises
        ------
        GeometryError : two of them hold a block of the same name.
        """
        sizes = np.cumsum([0, *(len(part.labels) for part in parts)])
        cov = np.zeros((sizes[-1], sizes[-1]))
        for a, b, part in zip(sizes[:-1], sizes[1:], parts, strict=True):
            cov[a:b, a:b] = part.cov
        blocks = tuple(block for part in parts for block in part.blocks)
        return cls(title=title, blocks=blocks, cov=cov, source=source)


def correlation_of(cov: ArrayF) -> ArrayF:
    """Correlation matrix (n, n) of a covariance; a quantity without error is uncorrelated."""
    sigma = np.sqrt(np.clip(np.diag(cov), 0.0, None))
    safe = np.where(sigma > 0, sigma, 1.0)
    out = np.clip(cov / np.outer(safe, safe), -1.0, 1.0)
    np.fill_diagonal(out, 1.0)
    return out


def lowest_eigenvalue(cov: ArrayF) -> tuple[float, ArrayF]:
    """Lowest eigenvalue of the correlation matrix of a covariance, and its eigenvector (n,)."""
    values, vectors = np.linalg.eigh(correlation_of(0.5 * (cov + cov.T)))
    return float(values[0]), vectors[:, 0]


def pose_block(
    name: str, pose: Rigid, *, target: str = "", source: str = "", facts: Mapping[str, Any] | None = None
) -> tuple[Block, ArrayF]:
    """A pose block and its covariance (6, 6) in the order and units of the block.

    Parameters
    ----------
    name : of the block; `FRAMES` knows the frames of the usual ones.
    pose : ``T_target_source`` with its covariance.
    target, source : frames, where the name does not say them.
    facts : see `Block`.
    """
    target, source = target or FRAMES[name][0], source or FRAMES[name][1]
    block = Block(
        name=name,
        quantities=POSE,
        values=np.concatenate([_plain_angles_deg(pose.R), pose.shift_m]),
        equation=f"x_{target} = R_{target}_{source} @ x_{source} + (x, y, z), "
        f"R_{target}_{source} = R_x(omega) R_y(phi) R_z(kappa)",
        convention=f"errors of the angles are small rotations about the x, y, z axes of {target}",
        facts=dict(facts or {}),
    )
    return block, _turned_round(pose.cov, 180.0 / np.pi)


def lever_block(name: str, lever_ics_m: Sequence[float] | ArrayF) -> Block:
    """Block of a sensor without axes: its place (3,) in ics, metres."""
    return Block(
        name=name,
        quantities=LEVER,
        values=np.asarray(lever_ics_m, dtype=np.float64),
        equation=f"x_ics_{name} = (x, y, z)",
        convention="ics: x forward, y right, z down",
    )


def _plain_angles_deg(R: ArrayF) -> ArrayF:
    """Omega, phi, kappa (3,) of a rotation; of the two sets that it has, the one that people expect.

    (omega, phi, kappa) and (omega + 180, 180 - phi, kappa + 180) are the same rotation: -90.2 degrees about y
    shall not appear as -89.8 with half turns about x and z.
    """
    first = np.rad2deg(opk_of(R))
    second = np.array([first[0] + 180.0, 180.0 - first[1], first[2] + 180.0])
    second = (second + 180.0) % 360.0 - 180.0
    turns = [float(np.abs(angles[[0, 2]]).sum()) for angles in (first, second)]
    return first if turns[0] <= turns[1] else second


def _turned_round(cov: ArrayF, angle: float) -> ArrayF:
    """(6, 6) covariance with its halves changed over, the half of the angles in another unit.

    ``angle`` = pi/180: (rotation; shift) in degrees to (shift; rotation) in radians; 180/pi the way back.
    """
    order = [3, 4, 5, 0, 1, 2]
    factor = np.ones(6)
    factor[slice(3, 6) if angle < 1 else slice(0, 3)] = angle
    return np.asarray(cov[np.ix_(order, order)] * np.outer(factor, factor))
