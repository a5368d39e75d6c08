"""Read an error budget from YAML; all mistakes are told at once. `docs/budgets.md` describes the format.

A file may name another one in ``based_on`` and state only what differs: its frames and inputs are merged by
name, each replaced as a whole, so that the source of a number is stated anew; ``null`` takes an input away.
Everything else is replaced.
"""

import difflib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.budgets.budget import (
    ANGLE_UNITS,
    ANGLES,
    BEAM,
    COORDINATES,
    LENGTH_UNITS,
    PROVENANCE,
    STATUS,
    TIME_UNITS,
    Budget,
    Frame,
    Input,
    Motion,
    Survey,
)
from thalweg.core import ConfigError, read_mapping

KEYS: Final = {
    "based_on": False, "title": True, "source": True, "status": True, "remarks": False, "world": False,
    "frames": True, "direction": False, "distances_m": True, "motion": False, "inputs": True,
    "correlations": False, "survey": False,
}  # fmt: skip
"""Keys of a budget, and whether one is needed."""

OWN: Final = ("title", "source", "status", "remarks", "survey")
"""Keys that are not taken over from the file in ``based_on``: they speak of one budget."""

Lines = dict[tuple[str, ...], tuple[Path, int]]


@dataclass(slots=True)
class _Reader:
    """Takes values out of plain data and notes what is wrong with them."""

    file: Path
    lines: Lines
    mistakes: list[str] = field(default_factory=list)

    def wrong(self, path: tuple[str, ...], found: str, expected: str, cure: str = "") -> None:
        """Note a mistake at a place, with its line or that of the key around it."""
        place = path
        while place and place not in self.lines:
            place = place[:-1]
        file, line = self.lines.get(place, (self.file, 1))
        cure = f" {cure}." if cure else ""
        self.mistakes.append(f"{file}:{line}: {'.'.join(path)}: {found}; expected {expected}.{cure}")

    def mapping(self, data: Any, path: tuple[str, ...], keys: dict[str, bool]) -> dict[str, Any]:
        """A mapping without unknown keys; needed ones are missed by name."""
        if not isinstance(data, dict):
            self.wrong(path, f"found {data!r}", f"the keys {', '.join(keys)}")
            return {}
        for key in data.keys() - keys.keys():
            near = difflib.get_close_matches(key, keys, 1)
            self.wrong(
                (*path, key),
                "unknown key",
                f"one of {', '.join(keys)}",
                f"Did you mean {near[0]}?".rstrip(".") if near else "",
            )
        for key, needed in keys.items():
            if needed and data.get(key) is None:
                self.wrong((*path, key) if key in data else path, f"{key} is missing", f"the key {key}")
        return {key: value for key, value in data.items() if key in keys and value is not None}

    def text(self, data: Any, path: tuple[str, ...], choice: tuple[str, ...] = ()) -> str:
        """A text that is not empty, one of ``choice`` if that is given."""
        if not isinstance(data, str) or not data.strip() or (choice and data not in choice):
            self.wrong(path, f"found {data!r}", f"one of: {'; '.join(choice)}" if choice else "a text")
            return ""
        return " ".join(data.split())

    def number(self, data: Any, path: tuple[str, ...], low: float = -np.inf, high: float = np.inf) -> float:
        """A finite number from ``low`` to ``high``."""
        if (
            isinstance(data, bool)
            or not isinstance(data, int | float)
            or not low <= data <= high
            or (not np.isfinite(data))
        ):
            bounds = (
                ""
                if np.isinf(low)
                else f" of at least {low:g}" + ("" if np.isinf(high) else f", at most {high:g}")
            )
            self.wrong(path, f"found {data!r}", f"a finite number{bounds}")
            return 1.0
        return float(data)

    def numbers(
        self, data: Any, path: tuple[str, ...], count: int = 0, low: float = -np.inf
    ) -> tuple[float, ...]:
        """A list of numbers, of a fixed length if ``count`` is not 0."""
        if not isinstance(data, list) or not data or (count and len(data) != count):
            self.wrong(
                path, f"found {data!r}", f"a list of {count or 'at least one'} number{'s' * (count != 1)}"
            )
            return (1.0,) * max(count, 1)
        return tuple(self.number(value, (*path, str(i)), low) for i, value in enumerate(data))


def read_budget(path: Path | str) -> Budget:
    """Read and check a budget file.

    Raises
    ------
    ConfigError : lists every mistake with its file and line.
    """
    path = Path(path)
    data, lines = _inherited(path, ())
    reader = _Reader(path, lines)
    budget = _budget(reader, data, path.stem)
    if reader.mistakes:
        n = len(reader.mistakes)
        raise ConfigError(
            f"{n} mistake{'s' * (n > 1)} in the error budget:\n  " + "\n  ".join(reader.mistakes).rstrip("."),
            where=path,
            cure="docs/budgets.md describes the format",
        )
    return budget


def _inherited(path: Path, seen: tuple[Path, ...]) -> tuple[dict[str, Any], Lines]:
    """Data of a file upon those of the file that it is based on, and where each key stands."""
    if path.resolve() in seen:
        chain = " -> ".join(p.name for p in (*seen, path))
        raise ConfigError(
            f"budgets are based on each other: {chain}", where=path, expected="an end of the chain"
        )
    data, own = read_mapping(path)
    lines: Lines = {key: (path, line) for key, line in own.items()}
    base = data.get("based_on")
    if base is None:
        return data, lines
    if not isinstance(base, str):
        raise ConfigError(f"based_on: found {base!r}", where=path, expected="the path of a budget file")
    if not (path.parent / base).is_file():
        raise ConfigError(
            f"based_on: there is no file {base}",
            where=f"{path}:{own.get(('based_on',), 1)}",
            expected="the path of a budget file, relative to this one",
            cure="Check the name",
        )
    merged, base_lines = _inherited(path.parent / base, (*seen, path.resolve()))
    merged = {key: value for key, value in merged.items() if key not in OWN}
    for key, value in data.items():
        parts = key in ("frames", "inputs") and isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = merged[key] | value if parts else value
        replaced = {(key, name) for name in value} if parts else {(key,)}
        base_lines = {k: v for k, v in base_lines.items() if k[:2] not in replaced and k[:1] not in replaced}
    if isinstance(merged.get("inputs"), dict):
        taken = [key for key, value in merged["inputs"].items() if value is None]
        merged["inputs"] = {key: value for key, value in merged["inputs"].items() if key not in taken}
    return merged, base_lines | lines


def _budget(reader: _Reader, data: dict[str, Any], name: str) -> Budget:
    values = reader.mapping(data, (), KEYS)
    frames = _frames(reader, values.get("frames"))
    motion = _motion(reader, values["motion"]) if "motion" in values else None
    inputs = _inputs(reader, values.get("inputs"), frames, motion)
    direction = reader.numbers(values.get("direction", [1, 1, 1]), ("direction",), 3)
    if not any(direction):
        reader.wrong(("direction",), "found a vector without length", "the direction of the point")
    distances = values.get("distances_m", [1.0])
    return Budget(
        name=name,
        title=reader.text(values.get("title", "-"), ("title",)),
        source=reader.text(values.get("source", "-"), ("source",)),
        status=reader.text(values.get("status", STATUS[0]), ("status",), STATUS),
        remarks=reader.text(values["remarks"], ("remarks",)) if "remarks" in values else "",
        world=reader.text(values.get("world", "wcs"), ("world",)),
        frames=frames,
        direction=(direction[0], direction[1], direction[2]),
        distances_m=reader.numbers(distances, ("distances_m",), low=1e-3),
        inputs=inputs,
        correlations=_correlations(reader, values.get("correlations", []), inputs),
        motion=motion,
        survey=_survey(reader, values["survey"]) if "survey" in values else None,
    )


def _frames(reader: _Reader, data: Any) -> tuple[Frame, ...]:
    if data is None:
        return ()
    if not isinstance(data, dict) or not data:
        reader.wrong(("frames",), f"found {data!r}", "frames by name, from the world inwards")
        return ()
    frames: list[Frame] = []
    for name, value in data.items():
        at = ("frames", name)
        if name in ("point", "time") or "." in name:
            reader.wrong(
                at, "this name cannot be a frame's", "a name other than point and time, without a dot"
            )
        fields = reader.mapping(value, at, {"angles_deg": True, "lever_m": True})
        given = fields.get("angles_deg", {})
        names = ANGLES[1] if isinstance(given, dict) and "heading" in given else ANGLES[0]
        if names == ANGLES[1] and frames:
            reader.wrong(
                (*at, "angles_deg"),
                "roll, pitch, heading of an inner frame",
                "omega, phi, kappa",
                "Roll, pitch and heading are those of the outermost frame in the world",
            )
        angles = reader.mapping(given, (*at, "angles_deg"), dict.fromkeys(names, True))
        lever = reader.numbers(fields.get("lever_m", [0, 0, 0]), (*at, "lever_m"), 3)
        frames.append(
            Frame(
                name=name,
                angles_deg={k: reader.number(angles.get(k, 0.0), (*at, "angles_deg", k)) for k in names},
                lever_m=(lever[0], lever[1], lever[2]),
            )
        )
    return tuple(frames)


def _motion(reader: _Reader, data: Any) -> Motion:
    values = reader.mapping(data, ("motion",), {"angles_deg_per_s": True, "axes_m_per_s": True})
    turn, move = (
        reader.numbers(values.get(key, [0, 0, 0]), ("motion", key), 3)
        for key in ("angles_deg_per_s", "axes_m_per_s")
    )
    return Motion(angles_deg_per_s=(turn[0], turn[1], turn[2]), axes_m_per_s=(move[0], move[1], move[2]))


def _inputs(
    reader: _Reader, data: Any, frames: tuple[Frame, ...], motion: Motion | None
) -> tuple[Input, ...]:
    if not isinstance(data, dict) or not data:
        if data is not None:
            reader.wrong(("inputs",), f"found {data!r}", "inputs by name, such as point.x")
        return ()
    units: dict[str, dict[str, float]] = {"time": TIME_UNITS, "point.across": LENGTH_UNITS | ANGLE_UNITS}
    units |= {f"point.{part}": LENGTH_UNITS for part in (*COORDINATES, BEAM[0])}
    for frame in frames:
        units |= {f"{frame.name}.{angle}": ANGLE_UNITS for angle in frame.angles_deg}
        units |= {f"{frame.name}.{part}": LENGTH_UNITS for part in COORDINATES}
    inputs = []
    for key, value in data.items():
        at = ("inputs", key)
        if key not in units:
            near = difflib.get_close_matches(key, units, 1)
            reader.wrong(
                at, "no such input", f"one of {', '.join(units)}", f"Did you mean {near[0]}" if near else ""
            )
            continue
        if key == "time" and motion is None:
            reader.wrong(at, "an error of time, but no motion", "the section motion")
        fields = reader.mapping(value, at, dict.fromkeys(("sigma", "unit", "provenance", "source"), True))
        inputs.append(
            Input(
                key=key,
                sigma=reader.number(fields.get("sigma", 1.0), (*at, "sigma"), 0.0),
                unit=reader.text(
                    fields.get("unit", next(iter(units[key]))), (*at, "unit"), tuple(units[key])
                ),
                provenance=reader.text(fields.get("provenance", "assumed"), (*at, "provenance"), PROVENANCE),
                source=reader.text(fields.get("source", "-"), (*at, "source")),
            )
        )
    return tuple(inputs)


def _correlations(reader: _Reader, data: Any, inputs: tuple[Input, ...]) -> dict[tuple[str, str], float]:
    if not isinstance(data, list):
        reader.wrong(("correlations",), f"found {data!r}", "a list of entries with `between` and `value`")
        return {}
    known = [item.key for item in inputs if item.part != "across"]
    out: dict[tuple[str, str], float] = {}
    for i, entry in enumerate(data):
        at = ("correlations", str(i))
        values = reader.mapping(entry, at, {"between": True, "value": True})
        value = reader.number(values.get("value", 0.0), (*at, "value"), -1.0, 1.0)
        pair = values.get("between")
        if not isinstance(pair, list) or len(pair) != 2 or pair[0] == pair[1] or not set(pair) <= set(known):
            reader.wrong((*at, "between"), f"found {pair!r}", f"two different inputs of {', '.join(known)}")
            continue
        a, b = sorted(pair, key=known.index)
        if (a, b) in out:
            reader.wrong(at, f"the correlation of {a} and {b} stands twice", "each pair once")
        out[a, b] = value
    place = {key: i for i, key in enumerate(known)}
    matrix = np.eye(len(known))
    for (a, b), value in out.items():
        matrix[place[a], place[b]] = matrix[place[b], place[a]] = value
    # -1e-12: a correlation of exactly 1 leaves an eigenvalue of zero, known to 1e-16 times the inputs
    if out and float(np.linalg.eigvalsh(matrix)[0]) < -1e-12:
        reader.wrong(
            ("correlations",),
            "these cannot hold together",
            "a matrix without negative eigenvalues",
            "Check their signs: if a goes with b and b with c, a cannot go against c",
        )
    return out


def _survey(reader: _Reader, data: Any) -> Survey:
    at = ("survey",)
    keys = dict.fromkeys(("from_m", "to_m", "provenance", "source"), True)
    values = reader.mapping(data, at, keys)
    low = reader.number(values.get("from_m", 1.0), (*at, "from_m"), 1e-3)
    high = reader.number(values.get("to_m", low), (*at, "to_m"), 1e-3)
    if high <= low and "to_m" in values:
        reader.wrong((*at, "to_m"), f"found {high:g}", f"a distance above {low:g} m")
    return Survey(
        from_m=low,
        to_m=high,
        provenance=reader.text(values.get("provenance", "assumed"), (*at, "provenance"), PROVENANCE),
        source=reader.text(values.get("source", "-"), (*at, "source")),
    )
