"""Calibrated quantities of a boat: values, one joint covariance, and the equations that they stand in.

A calibration is a set of *blocks*: the place of a sensor, the interior orientation of a camera, the offset of
a clock. All quantities of all blocks share one covariance matrix: one adjustment gives them together.

The place of a sensor with axes is a *pose block* with the quantities omega, phi, kappa, x, y, z of::

    x_target = R_x(omega) R_y(phi) R_z(kappa) x_source + (x, y, z)

The errors of its angles are a small rotation vector about the x, y and z axes of the *target* frame, not
errors of omega, phi and kappa: at phi = -90 degrees, the nominal mount of the lidar (T 3.1.1), omega and
kappa turn about the same axis, and no finite covariance of the three angles describes every error.
"""

import difflib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from thalweg.core import (
    ArrayF,
    ConfigError,
    Document,
    GeometryError,
    Key,
    Mistake,
    Rigid,
    opk_axes,
    opk_of,
    read_yaml,
    rotation_opk,
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
KEYS: Final = {MARK: True, "title": True, "source": True, "blocks": True, "correlations": False}
SOURCE_KEYS: Final = {
    "run": True,
    "method": True,
    "created": False,
    "observations": False,
    "sigma0": False,
    "twin": False,
}
BLOCK_KEYS: Final = {
    "equation": True,
    "convention": False,
    "sigma_axes": False,
    "facts": False,
    "values": True,
}
ENTRY_KEYS: Final = {"value": True, "sigma": True, "unit": True}
"""Keys of each part of a file, and whether one is needed."""
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


@dataclass(slots=True)
class _Reader:
    """Takes values out of a document and notes what is wrong with them."""

    document: Document
    mistakes: list[Mistake] = field(default_factory=list)

    def wrong(self, path: tuple[Key, ...], found: str, expected: str = "", cure: str = "") -> None:
        """Note a mistake with the line at which it stands."""
        self.mistakes.append(
            Mistake(path=path, found=found, expected=expected, cure=cure, line=self.document.line(path))
        )

    def mapping(
        self, data: Any, path: tuple[Key, ...], keys: dict[str, bool] | None = None
    ) -> dict[str, Any]:
        """A mapping; with ``keys`` one without unknown keys, whose needed ones are there."""
        if not isinstance(data, dict) or not data:
            self.wrong(
                path,
                "nothing stands here" if data is None else f"found {data!r}",
                f"the keys {', '.join(keys)}" if keys else "names with values",
            )
            return {}
        for key in [key for key in data if keys is not None and key not in keys]:
            near = difflib.get_close_matches(key, keys or (), 1)
            self.wrong(
                (*path, key),
                "unknown key",
                f"one of {', '.join(keys or ())}",
                f"Did you mean {near[0]}?" if near else "Remove it",
            )
        for key, needed in (keys or {}).items():
            if needed and data.get(key) is None:
                self.wrong((*path, key) if key in data else path, f"{key} is missing", f"the key {key}")
        return data if keys is None else {key: data[key] for key in keys if data.get(key) is not None}

    def text(self, data: Any, path: tuple[Key, ...]) -> str:
        """A text that is not empty."""
        if not isinstance(data, str) or not data.strip():
            self.wrong(path, f"found {data!r}", "a text")
            return "?"
        return " ".join(data.split())

    def number(self, data: Any, path: tuple[Key, ...], low: float = -np.inf, high: float = np.inf) -> float:
        """A finite number from ``low`` to ``high``."""
        good = isinstance(data, int | float) and not isinstance(data, bool) and np.isfinite(data)
        if not good or not low <= data <= high:
            bounds = "" if np.isinf(low) else f" of at least {low:g}"
            bounds += "" if np.isinf(high) else f", at most {high:g}"
            self.wrong(path, f"found {data!r}", f"a finite number{bounds}")
            return 0.0
        return float(data)


def read_calibration(path: Path) -> Calibration:
    """Read and check a calibration file.

    Raises
    ------
    ConfigError : lists every mistake with its line.
    """
    found, mistakes = check_calibration(path)
    if mistakes or found is None:
        n = len(mistakes)
        lines = "\n".join(f"  {mistake}" for mistake in mistakes)
        raise ConfigError(
            f"{n} mistake{'s' * (n > 1)} in the calibration:\n{lines}".rstrip("."),
            where=path,
            cure="docs/calibration.md says more",
        )
    return found


def check_calibration(path: Path) -> tuple[Calibration | None, list[Mistake]]:
    """The calibration of a file, or None and all its mistakes with their lines."""
    document = read_yaml(path)
    reader = _Reader(document, list(document.mistakes))
    found = _calibration(reader) if document.data is not None or not reader.mistakes else None
    return (None if reader.mistakes else found), reader.mistakes


def _calibration(reader: _Reader) -> Calibration | None:
    data = reader.document.data
    if isinstance(data, dict) and data.get(MARK) is not None and data[MARK] != VERSION:
        reader.wrong(
            (MARK,),
            f"found version {data[MARK]!r}",
            f"version {VERSION}",
            "Make the file again, or use the version of Thalweg that wrote it",
        )
        return None
    if isinstance(data, dict) and MARK not in data:
        reader.wrong((), f"the mark {MARK} is missing", f"the line `{MARK}: {VERSION}`")
        return None
    top = reader.mapping(data, (), KEYS)
    blocks: list[Block] = []
    sigmas: list[ArrayF] = []
    euler: list[bool] = []
    sections = reader.mapping(top["blocks"], ("blocks",)) if "blocks" in top else {}
    for name, section in sections.items():
        block, sigma, themselves = _block(reader, name, section)
        if block is not None:
            blocks.append(block)
            sigmas.append(sigma)
            euler.append(themselves)
    title = reader.text(top["title"], ("title",)) if "title" in top else ""
    source = _source(reader, top["source"]) if "source" in top else Source(run="", method="")
    if not blocks or len(blocks) < len(sections):
        return None
    labels = [label for block in blocks for label in block.labels]
    sigma = np.concatenate(sigmas)
    correlation = _correlations(reader, top.get("correlations"), labels, sigma)
    if reader.mistakes:
        return None
    turn = _about_target_axes(blocks, euler)
    cov = turn @ (correlation * np.outer(sigma, sigma)) @ turn.T
    return Calibration(title=title, blocks=tuple(blocks), cov=0.5 * (cov + cov.T), source=source)


def _source(reader: _Reader, data: Any) -> Source:
    found = reader.mapping(data, ("source",), SOURCE_KEYS)
    words = {key: reader.text(found[key], ("source", key)) for key in ("run", "method") if key in found}
    observations, twin = found.get("observations", 0), found.get("twin", False)
    if isinstance(observations, bool) or not isinstance(observations, int) or observations < 0:
        reader.wrong(("source", "observations"), f"found {observations!r}", "a number of observations")
        observations = 0
    if not isinstance(twin, bool):
        reader.wrong(("source", "twin"), f"found {twin!r}", "true or false")
    sigma0 = reader.number(found["sigma0"], ("source", "sigma0"), 0.0) if "sigma0" in found else float("nan")
    created = str(found.get("created", ""))
    return Source(
        run=words.get("run", ""),
        method=words.get("method", ""),
        created=created,
        observations=observations,
        sigma0=sigma0,
        twin=twin is True,
    )


def _block(reader: _Reader, name: str, data: Any) -> tuple[Block | None, ArrayF, bool]:
    """A block, its sigmas, and whether these are of omega, phi and kappa themselves."""
    path: tuple[Key, ...] = ("blocks", name)
    section = reader.mapping(data, path, BLOCK_KEYS)
    equation = reader.text(section["equation"], (*path, "equation")) if "equation" in section else ""
    convention = reader.text(section["convention"], (*path, "convention")) if "convention" in section else ""
    facts = reader.mapping(section["facts"], (*path, "facts")) if "facts" in section else {}
    entries = reader.mapping(section["values"], (*path, "values")) if "values" in section else {}
    values, sigmas = [], []
    for quantity, entry in entries.items():
        value, sigma = _entry(reader, quantity, entry, (*path, "values", quantity))
        values.append(value)
        sigmas.append(sigma)
    missing = [quantity for quantity in POSE if quantity not in entries]
    pose = bool(set(POSE[:3]) & set(entries))
    if pose and (missing or len(entries) != len(POSE)):
        reader.wrong((*path, "values"), f"a pose with the quantities {', '.join(entries)}", ", ".join(POSE))
    _check_lever(reader, dict(zip(entries, values, strict=True)), (*path, "values"))
    axes = section.get("sigma_axes")
    if pose and equation:
        _check_axes(reader, axes, equation, path)
    elif axes is not None and not pose:
        reader.wrong((*path, "sigma_axes"), f"found {axes!r} in a block without angles", "no such key here")
    if reader.mistakes or not entries:
        return None, np.zeros(0), False
    order = [list(entries).index(quantity) for quantity in (POSE if pose else entries)]
    block = Block(
        name=name,
        quantities=POSE if pose else tuple(entries),
        values=np.array(values)[order],
        equation=equation,
        convention=convention,
        facts=facts,
    )
    return block, np.array(sigmas)[order], axes == ANGLES_THEMSELVES


def _check_lever(reader: _Reader, values: dict[str, float], path: tuple[Key, ...]) -> None:
    """A lever arm in millimetres is told at its longest component."""
    doubt = lever_doubt([values[name] for name in LEVER]) if set(LEVER) <= set(values) else None
    if doubt is not None:
        longest = max(LEVER, key=lambda name: abs(values[name]))
        reader.wrong((*path, longest), *doubt)


def _check_axes(reader: _Reader, axes: Any, equation: str, path: tuple[Key, ...]) -> None:
    target = _target(equation)
    if not target:
        reader.wrong(
            (*path, "equation"),
            f"found {equation!r}, which names no target frame",
            "such as x_ics = R_ics_scs @ x_scs + (x, y, z)",
        )
    elif axes not in (target, ANGLES_THEMSELVES):
        found = "sigma_axes is missing" if axes is None else f"found {axes!r}"
        reader.wrong(
            (*path, "sigma_axes"),
            found,
            f"{target}, if the sigmas of the angles are about the axes of {target}; "
            f"{ANGLES_THEMSELVES}, if they are those of omega, phi, kappa themselves",
        )


def _entry(reader: _Reader, quantity: str, data: Any, path: tuple[Key, ...]) -> tuple[float, float]:
    found = reader.mapping(data, path, ENTRY_KEYS)
    unit, right = found.get("unit"), unit_of(quantity)
    if unit is not None and str(unit) != right:
        reader.wrong(
            (*path, "unit"),
            f"found unit {unit}",
            f"unit {right}, as the name of the quantity says",
            "Convert value and sigma, do not only rename the unit",
        )
    value = reader.number(found["value"], (*path, "value")) if "value" in found else 0.0
    sigma = reader.number(found["sigma"], (*path, "sigma"), 0.0) if "sigma" in found else 0.0
    return value, sigma


def _correlations(reader: _Reader, data: Any, labels: Sequence[str], sigma: ArrayF) -> ArrayF:
    """(n, n) correlation matrix of the pairs that a file names."""
    matrix = np.eye(len(labels))
    place = {label: i for i, label in enumerate(labels)}
    rows = {} if data is None else reader.mapping(data, ("correlations",))
    for first, row in rows.items():
        for second, value in reader.mapping(row, ("correlations", first)).items():
            path = ("correlations", first, second)
            unknown = [name for name in (first, second) if name not in place]
            if unknown or first == second:
                near = difflib.get_close_matches(unknown[0], labels, 1) if unknown else []
                reader.wrong(
                    path,
                    f"unknown quantity {unknown[0]}" if unknown else "a quantity with itself",
                    "two quantities of the file, such as lidar.x_m",
                    f"Did you mean {near[0]}?" if near else "",
                )
                continue
            i, j = place[first], place[second]
            rho = reader.number(value, path, -1.0, 1.0)
            if matrix[i, j] not in (0.0, rho):
                reader.wrong(
                    path,
                    f"found {rho:g}, but {matrix[i, j]:g} the other way round",
                    "one value for a pair: the matrix is symmetric",
                    "Remove one of them",
                )
            if rho != 0.0 and (sigma[i] == 0.0 or sigma[j] == 0.0):
                reader.wrong(path, "a correlation with a quantity whose sigma is 0", "zero, or a sigma")
            matrix[i, j] = matrix[j, i] = rho
    lowest, vector = lowest_eigenvalue(matrix)
    if lowest < SMALLEST_EIGENVALUE and not reader.mistakes:
        guilty = [labels[i] for i in np.argsort(-np.abs(vector))[:3] if abs(vector[i]) > 0.1]
        reader.wrong(
            ("correlations",),
            f"no errors can be correlated like this: the matrix has the eigenvalue {lowest:.3g}; "
            f"look at {', '.join(guilty)}",
            "a matrix without negative eigenvalues",
            "Check the signs, and write at least six digits",
        )
    return matrix


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
