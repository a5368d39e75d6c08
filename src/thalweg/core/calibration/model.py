"""Calibrated quantities of a boat: values, one joint covariance, and the equations that they stand in.

A calibration is a set of *blocks*: the place of a sensor, the interior orientation of a camera, the offset of
a clock. All quantities of all blocks share one covariance matrix: one adjustment gives them together.

The place of a sensor with axes is a *pose block* with the quantities omega, phi, kappa, x, y, z of::

    x_target = R_x(omega) R_y(phi) R_z(kappa) x_source + (x, y, z)

The errors of its angles are a small rotation vector about the x, y and z axes of the *target* frame, not
errors of omega, phi and kappa: at phi = -90 degrees, the nominal mount of the lidar (T 3.1.1), omega and
kappa turn about the same axis, and no finite covariance of the three angles describes every error.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, ValidationInfo, field_validator, model_validator

from thalweg.core import (
    ArrayF,
    GeometryError,
    Mistake,
    Part,
    Rigid,
    Text,
    checked,
    did_you_mean,
    opk_axes,
    opk_of,
    read_yaml,
    refuse,
    rotation_opk,
    validated,
    wrong,
)

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

__all__ = [
    "Block",
    "Calibration",
    "Source",
    "check_calibration",
    "lever_block",
    "pose_block",
    "read_calibration",
    "write_calibration",
]
VERSION: Final = 1
MARK: Final = "thalweg_calibration"
ANGLES_THEMSELVES: Final = "angles"
TARGET: Final = re.compile(r"\s*x_([a-z]+)\s*=")
"""How the equation of a pose begins: with its target frame."""
HEAD: Final = """\
# Calibration: value, standard deviation (sigma) and unit of each quantity.
# Correlations that are not named are zero. May be edited by hand; `thalweg describe` checks and prints it.
"""

MAX_LEVER_M: Final = 20.0
"""Components of a lever arm in a calibration; a longer one is in millimetres or centimetres."""


# ---------------------------------------------------------------- model


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
    return np.clip(_scaled(cov), -1.0, 1.0)


def _scaled(cov: ArrayF) -> ArrayF:
    """The same of any matrix: beyond -1 to 1 where it is no covariance."""
    sigma = np.sqrt(np.clip(np.diag(cov), 0.0, None))
    safe = np.where(sigma > 0, sigma, 1.0)
    out = np.asarray(cov / np.outer(safe, safe))
    np.fill_diagonal(out, 1.0)
    return out


def lowest_eigenvalue(cov: ArrayF) -> tuple[float, ArrayF]:
    """Lowest eigenvalue of the correlation matrix of a covariance, and its eigenvector (n,)."""
    values, vectors = np.linalg.eigh(_scaled(0.5 * (cov + cov.T)))
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


# ---------------------------------------------------------------- YAML files that people read and edit
#
# ::
#
#     thalweg_calibration: 1
#     title: Lidar on the boat
#     source: {run: field, method: cones from a moving boat, created: 2026-05-01, observations: 81234}
#     blocks:
#       lidar:
#         equation: x_ics = R_ics_scs @ x_scs + (x, y, z), R_ics_scs = R_x(omega) R_y(phi) R_z(kappa)
#         sigma_axes: ics values:
#           omega_deg: {value: 0.12, sigma: 0.01, unit: deg}
#           phi_deg: {value: -90.2, sigma: 0.01, unit: deg}
#           ...
#     correlations:
#       lidar.phi_deg: {lidar.omega_deg: -0.31}
#
# ``sigma_axes`` of a pose block says what the sigmas of its angles are: small rotations about the axes of the
# target frame (its name), or errors of omega, phi and kappa themselves (``angles``), which are converted on
# reading. Correlations that are not named are zero. Numbers are written with 12 digits or more.


def write_calibration(path: Path, calibration: Calibration) -> None:
    """Write a calibration; the same calibration gives the same bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(calibration_text(calibration), encoding="utf-8")


def calibration_text(calibration: Calibration) -> str:
    """The text of a calibration file."""
    source = calibration.source
    facts: dict[str, Any] = {"run": source.run, "method": source.method}
    facts |= {"created": source.created} if source.created else {}
    facts |= {"observations": source.observations} if source.observations else {}
    lines = [f"{MARK}: {VERSION}", f"title: {_text(calibration.title)}", "source:"]
    lines += [f"  {key}: {_text(value)}" for key, value in facts.items()]
    lines += [f"  sigma0: {_number(source.sigma0, 12)}"] if np.isfinite(source.sigma0) else []
    lines += ["  twin: true"] if source.twin else []
    lines.append("blocks:")
    sigma = dict(zip(calibration.labels, calibration.sigmas, strict=True))
    for block in calibration.blocks:
        lines += [f"  {block.name}:", f"    equation: {_text(block.equation)}"]
        lines += [f"    convention: {_text(block.convention)}"] if block.convention else []
        lines += [f"    sigma_axes: {_target(block.equation)}"] if block.is_pose else []
        lines += ["    facts:"] if block.facts else []
        lines += [f"      {key}: {_text(value)}" for key, value in block.facts.items()]
        lines.append("    values:")
        for name, label, value in zip(block.quantities, block.labels, block.values, strict=True):
            numbers = f"value: {_number(value, 17)}, sigma: {_number(sigma[label], 12)}"
            lines.append(f"      {name}: {{{numbers}, unit: {_text(unit_of(name))}}}")
    lines += _correlation_lines(calibration)
    return HEAD + "\n".join(lines) + "\n"


def _correlation_lines(calibration: Calibration) -> list[str]:
    """Lower triangle of the correlation matrix, without zeros."""
    labels, matrix, lines = calibration.labels, calibration.correlation(), []
    for i, label in enumerate(labels):
        row = [f"    {labels[j]}: {_number(matrix[i, j], 14)}" for j in range(i) if matrix[i, j] != 0.0]
        lines += [f"  {label}:", *row] if row else []
    return ["correlations:", *lines] if lines else []


def _target(equation: str) -> str:
    """Target frame of a pose: ``ics`` of ``x_ics = R_ics_scs @ x_scs + ...``; "" if none is named."""
    found = TARGET.match(equation)
    return found[1] if found else ""


def _number(value: float, digits: int) -> str:
    """A number that every version of YAML reads as one: with a point before an exponent."""
    text = repr(float(value)) if digits >= 17 else f"{value:.{digits}g}"
    head, mark, exponent = text.partition("e")
    return head + ("" if "." in head or not mark else ".0") + mark + exponent


def _text(value: Any) -> str:
    """A scalar or a list of scalars as it stands in YAML; words in quotes, as JSON has them."""
    if isinstance(value, bool) or value is None:
        return json.dumps(value)
    if isinstance(value, float):
        return _number(value, 17)
    if isinstance(value, list | tuple):
        return f"[{', '.join(_text(item) for item in value)}]"
    if isinstance(value, int):
        return str(value)
    text = str(value)
    return (
        text
        if text.isidentifier() and text not in {"true", "false", "null"}
        else json.dumps(text, ensure_ascii=False)
    )


class _Source(Part):
    run: Text
    method: Text
    created: Annotated[str, BeforeValidator(str)] = ""
    observations: int = Field(default=0, ge=0, description="a number of observations")
    sigma0: Annotated[float, Field(ge=0.0)] = float("nan")
    twin: bool = False


class _Entry(Part):
    value: float
    sigma: Annotated[float, Field(ge=0.0)]
    unit: Annotated[str, BeforeValidator(str)]


class _Block(Part):
    equation: Text
    convention: Text = ""
    sigma_axes: Any = None
    facts: dict[str, Any] = Field(default={})
    values: dict[str, _Entry] = Field(min_length=1)

    @property
    def quantities(self) -> tuple[str, ...]:
        """Those of a pose in the order of `POSE`, others as in the file."""
        return POSE if self.is_pose else tuple(self.values)

    @property
    def is_pose(self) -> bool:
        """True if it holds an angle of a pose."""
        return not set(ANGLES).isdisjoint(self.values)

    @field_validator("values")
    @classmethod
    def _units_and_places(cls, values: dict[str, _Entry]) -> dict[str, _Entry]:
        mistakes = [
            wrong(
                f"found unit {entry.unit}",
                f"unit {unit_of(name)}, as the name of the quantity says",
                "Convert value and sigma, do not only rename the unit",
                at=(name, "unit"),
            )
            for name, entry in values.items()
            if entry.unit != unit_of(name)
        ]
        if not set(ANGLES).isdisjoint(values) and set(values) != set(POSE):
            mistakes.append(wrong(f"a pose with the quantities {', '.join(values)}", ", ".join(POSE)))
        if set(LEVER) <= set(values):
            doubt = lever_doubt([values[name].value for name in LEVER])
            longest = max(LEVER, key=lambda name: abs(values[name].value))
            mistakes += [wrong(*doubt, at=(longest,))] if doubt else []
        refuse(mistakes)
        return values

    @model_validator(mode="after")
    def _axes(self) -> Self:
        axes, target = self.sigma_axes, _target(self.equation)
        if not self.is_pose:
            if axes is not None:
                raise wrong(
                    f"found {axes!r} in a block without angles", "no such key here", at=("sigma_axes",)
                )
        elif not target:
            raise wrong(
                f"found {self.equation!r}, which names no target frame",
                "such as x_ics = R_ics_scs @ x_scs + (x, y, z)",
                at=("equation",),
            )
        elif axes not in (target, ANGLES_THEMSELVES):
            raise wrong(
                "sigma_axes is missing" if axes is None else f"found {axes!r}",
                f"{target}, if the sigmas of the angles are about the axes of {target}; "
                f"{ANGLES_THEMSELVES}, if they are those of omega, phi, kappa themselves",
                at=("sigma_axes",),
            )
        return self


_Rows = dict[str, dict[str, Annotated[float, Field(ge=-1.0, le=1.0)]]]


class _File(Part):
    thalweg_calibration: Literal[1] = Field(description=f"the line `{MARK}: {VERSION}`")
    title: Text
    source: _Source
    blocks: dict[str, _Block] = Field(min_length=1)
    correlations: _Rows = Field(default={}, description="pairs of quantities with numbers from -1 to 1")

    @field_validator(MARK, mode="before")
    @classmethod
    def _version(cls, version: Any) -> Any:
        if version != VERSION:
            raise wrong(
                f"found version {version!r}",
                f"version {VERSION}",
                "Make the file again, or use the version of Thalweg that wrote it",
            )
        return version

    @field_validator("correlations")
    @classmethod
    def _possible(cls, rows: _Rows, info: ValidationInfo) -> _Rows:
        if "blocks" not in info.data:
            return rows
        sigma = _sigmas(info.data["blocks"])
        mistakes = []
        for first, row in rows.items():
            for second, rho in row.items():
                unknown = [name for name in (first, second) if name not in sigma]
                other = rows.get(second, {}).get(first, rho)
                if unknown or first == second:
                    found = f"unknown quantity {unknown[0]}" if unknown else "a quantity with itself"
                    expected = "two quantities of the file, such as lidar.x_m"
                    cure = did_you_mean(unknown[0], sigma) if unknown else ""
                elif other != rho and list(rows).index(first) > list(rows).index(second):
                    found = f"found {rho:g}, but {other:g} the other way round"
                    expected = "one value for a pair: the matrix is symmetric"
                    cure = "Remove one of them"
                elif rho != 0.0 and 0.0 in (sigma[first], sigma[second]):
                    found, expected = "a correlation with a quantity whose sigma is 0", "zero, or a sigma"
                    cure = ""
                else:
                    continue
                mistakes.append(wrong(found, expected, cure, at=(first, second)))
        refuse(mistakes)
        lowest, vector = lowest_eigenvalue(_matrix(rows, list(sigma)))
        if lowest < SMALLEST_EIGENVALUE:
            guilty = [list(sigma)[i] for i in np.argsort(-np.abs(vector))[:3] if abs(vector[i]) > 0.1]
            raise wrong(
                f"no errors can be correlated like this: the matrix has the eigenvalue {lowest:.3g}; "
                f"look at {', '.join(guilty)}",
                "a matrix without negative eigenvalues",
                "Check the signs, and write at least six digits",
            )
        return rows


def _sigmas(blocks: Mapping[str, _Block]) -> dict[str, float]:
    """Sigma of each quantity by its label, in the order of the covariance."""
    return {f"{name}.{q}": block.values[q].sigma for name, block in blocks.items() for q in block.quantities}


def _matrix(rows: _Rows, labels: Sequence[str]) -> ArrayF:
    """(n, n) correlation matrix of the pairs that a file names."""
    matrix = np.eye(len(labels))
    for first, row in rows.items():
        for second, rho in row.items():
            i, j = labels.index(first), labels.index(second)
            matrix[i, j] = matrix[j, i] = rho
    return matrix


def read_calibration(path: Path) -> Calibration:
    """Read and check a calibration file.

    Raises
    ------
    ConfigError : lists every mistake with its line.
    """
    cure = "docs/calibration.md says more"
    return _calibration(checked(_File, read_yaml(path), what="calibration", where=path, cure=cure))


def check_calibration(path: Path) -> tuple[Calibration | None, list[Mistake]]:
    """The calibration of a file, or None and all its mistakes with their lines."""
    found, mistakes = validated(_File, read_yaml(path), what="calibration")
    return None if found is None else _calibration(found), mistakes


def _calibration(found: _File) -> Calibration:
    blocks = tuple(
        Block(
            name=name,
            quantities=block.quantities,
            values=np.array([block.values[q].value for q in block.quantities]),
            equation=block.equation,
            convention=block.convention,
            facts=block.facts,
        )
        for name, block in found.blocks.items()
    )
    sigmas = _sigmas(found.blocks)
    sigma = np.array(list(sigmas.values()))
    turn = _about_target_axes(blocks, [b.sigma_axes == ANGLES_THEMSELVES for b in found.blocks.values()])
    cov = turn @ (_matrix(found.correlations, list(sigmas)) * np.outer(sigma, sigma)) @ turn.T
    source = Source(**dict(found.source))
    return Calibration(title=found.title, blocks=blocks, cov=0.5 * (cov + cov.T), source=source)


def _about_target_axes(blocks: Sequence[Block], euler: Sequence[bool]) -> ArrayF:
    """(n, n) matrix: errors of omega, phi, kappa into rotations about the axes of the target frame."""
    matrix = np.eye(sum(len(block.quantities) for block in blocks))
    at = 0
    for block, convert in zip(blocks, euler, strict=True):
        if convert and block.is_pose:
            omega, phi = np.deg2rad(block.values[:2])
            matrix[at : at + 3, at : at + 3] = opk_axes(omega, phi)
        at += len(block.quantities)
    return matrix


# ---------------------------------------------------------------- lever arms in another unit than metres


def lever_doubt(lever_m: Sequence[float]) -> tuple[str, str, str] | None:
    """Found, expected and cure if a lever arm is too long to be in metres, else None.

    Parameters
    ----------
    lever_m : its components as they stand in a file that has metres.

    Examples
    --------
    >>> lever_doubt([-0.351, 0.002, -0.249])
    >>> found, _, cure = lever_doubt([-351.0, 2.0, -249.0])
    >>> found
    'a lever arm of (-351, 2, -249) m'
    >>> cure
    'Are these millimetres? Then write (-0.351, 0.002, -0.249), and the sigmas in metres, too'
    """
    longest = max((abs(value) for value in lever_m), default=0.0)
    if longest <= MAX_LEVER_M:
        return None
    as_mm, as_cm = (_listed([value / factor for value in lever_m]) for factor in (1000.0, 100.0))
    # Nobody mounts a sensor 35 mm away by the decimetre: below a metre centimetres are as likely.
    units = f"millimetres? Then write {as_mm}, or {as_cm} if centimetres" if longest < 100 else ""
    return (
        f"a lever arm of {_listed(lever_m)} m",
        f"components up to {MAX_LEVER_M:g} m",
        f"Are these {units or f'millimetres? Then write {as_mm}'}, and the sigmas in metres, too",
    )


def _listed(values: Sequence[float]) -> str:
    return f"({', '.join(f'{value:.9g}' for value in values)})"
