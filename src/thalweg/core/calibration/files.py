"""Calibrations as YAML files that people read and edit.

::

    thalweg_calibration: 1
    title: Lidar on the boat
    source: {run: field, method: cones from a moving boat, created: 2026-05-01, observations: 81234}
    blocks:
      lidar:
        equation: x_ics = R_ics_scs @ x_scs + (x, y, z), R_ics_scs = R_x(omega) R_y(phi) R_z(kappa)
        sigma_axes: ics values:
          omega_deg: {value: 0.12, sigma: 0.01, unit: deg}
          phi_deg: {value: -90.2, sigma: 0.01, unit: deg}
          ...
    correlations:
      lidar.phi_deg: {lidar.omega_deg: -0.31}

``sigma_axes`` of a pose block says what the sigmas of its angles are: small rotations about the axes of the
target frame (its name), or errors of omega, phi and kappa themselves (``angles``), which are converted on
reading. Correlations that are not named are zero. Numbers are written with 12 digits or more.
"""

import difflib
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core.calibration.model import (
    LEVER,
    POSE,
    SMALLEST_EIGENVALUE,
    Block,
    Calibration,
    Source,
    lever_block,
    lowest_eigenvalue,
    pose_block,
    unit_of,
)
from thalweg.core.errors import ConfigError
from thalweg.core.frames import opk_axes
from thalweg.core.lever_arms import lever_doubt
from thalweg.core.mistakes import Key, Mistake
from thalweg.core.types import ArrayF
from thalweg.core.yaml_lines import Document, read_yaml

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
    "run": True, "method": True, "created": False, "observations": False, "sigma0": False, "twin": False,
}  # fmt: skip
BLOCK_KEYS: Final = {
    "equation": True, "convention": False, "sigma_axes": False, "facts": False, "values": True,
}  # fmt: skip
ENTRY_KEYS: Final = {"value": True, "sigma": True, "unit": True}
"""Keys of each part of a file, and whether one is needed."""

ANGLES_THEMSELVES: Final = "angles"
TARGET: Final = re.compile(r"\s*x_([a-z]+)\s*=")
"""How the equation of a pose begins: with its target frame."""

HEAD: Final = """\
# Calibration: value, standard deviation (sigma) and unit of each quantity.
# Correlations that are not named are zero. May be edited by hand; `thalweg describe` checks and prints it.
"""


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
            self.wrong(path, "nothing stands here" if data is None else f"found {data!r}",
                       f"the keys {', '.join(keys)}" if keys else "names with values")  # fmt: skip
            return {}
        for key in [key for key in data if keys is not None and key not in keys]:
            near = difflib.get_close_matches(key, keys or (), 1)
            self.wrong((*path, key), "unknown key", f"one of {', '.join(keys or ())}",
                       f"Did you mean {near[0]}?" if near else "Remove it")  # fmt: skip
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
        reader.wrong((MARK,), f"found version {data[MARK]!r}", f"version {VERSION}",
                     "Make the file again, or use the version of Thalweg that wrote it")  # fmt: skip
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
        run=words.get("run", ""), method=words.get("method", ""), created=created,
        observations=observations, sigma0=sigma0, twin=twin is True,
    )  # fmt: skip


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
        name=name, quantities=POSE if pose else tuple(entries), values=np.array(values)[order],
        equation=equation, convention=convention, facts=facts,
    )  # fmt: skip
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
        reader.wrong((*path, "equation"), f"found {equation!r}, which names no target frame",
                     "such as x_ics = R_ics_scs @ x_scs + (x, y, z)")  # fmt: skip
    elif axes not in (target, ANGLES_THEMSELVES):
        found = "sigma_axes is missing" if axes is None else f"found {axes!r}"
        reader.wrong((*path, "sigma_axes"), found,
                     f"{target}, if the sigmas of the angles are about the axes of {target}; "
                     f"{ANGLES_THEMSELVES}, if they are those of omega, phi, kappa themselves")  # fmt: skip


def _entry(reader: _Reader, quantity: str, data: Any, path: tuple[Key, ...]) -> tuple[float, float]:
    found = reader.mapping(data, path, ENTRY_KEYS)
    unit, right = found.get("unit"), unit_of(quantity)
    if unit is not None and str(unit) != right:
        reader.wrong((*path, "unit"), f"found unit {unit}", f"unit {right}, as the name of the quantity says",
                     "Convert value and sigma, do not only rename the unit")  # fmt: skip
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
                reader.wrong(path, f"unknown quantity {unknown[0]}" if unknown else "a quantity with itself",
                             "two quantities of the file, such as lidar.x_m",
                             f"Did you mean {near[0]}?" if near else "")  # fmt: skip
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
