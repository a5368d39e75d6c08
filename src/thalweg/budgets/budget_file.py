"""Read an error budget from YAML; all mistakes are told at once. `docs/budgets.md` describes the format.

A file may name another one in ``based_on`` and state only what differs: its frames and inputs are merged by
name, each replaced as a whole, so that the source of a number is stated anew; ``null`` takes an input away.
Everything else is replaced.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final, Self

import numpy as np
from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

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
from thalweg.core import (
    ConfigError,
    Document,
    Key,
    Part,
    Text,
    checked,
    did_you_mean,
    one_of,
    read_yaml,
    refuse,
    wrong,
)

OWN: Final = ("title", "source", "status", "remarks", "survey")
"""Keys that are not taken over from the file in ``based_on``: they speak of one budget."""

_Three = Annotated[list[float], Field(min_length=3, max_length=3, description="a list of 3 numbers")]
_Distance = Annotated[float, Field(ge=1e-3)]
_Provenance = Annotated[Text, one_of(PROVENANCE)]


def _frame_name(name: str) -> str:
    if name in ("point", "time") or "." in name:
        expected = "a name other than point and time, without a dot"
        raise wrong("this name cannot be a frame's", expected)
    return name


def _input_name(key: str, info: ValidationInfo) -> str:
    units = info.context["units"] if info.context else {}
    if key not in units:
        raise wrong("no such input", f"one of {', '.join(units)}", did_you_mean(key, units))
    if key == "time" and not (info.context and info.context["motion"]):
        raise wrong("an error of time, but no motion", "the section motion")
    return key


class _Angles(Part):
    omega: float | None = None
    phi: float | None = None
    kappa: float | None = None
    roll: float | None = None
    pitch: float | None = None
    heading: float | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The three angles that are meant."""
        return _angle_names(self.model_fields_set)

    @model_validator(mode="after")
    def _three_of_a_kind(self) -> Self:
        given = self.model_fields_set
        lacking = [wrong(f"{name} is missing", f"the key {name}") for name in self.names if name not in given]
        others = sorted(given - set(self.names))
        expected = f"{', '.join(self.names)} alone"
        refuse(lacking + [wrong("an angle of the other kind", expected, at=(name,)) for name in others])
        return self


class _Frame(Part):
    angles_deg: _Angles
    lever_m: _Three


class _Motion(Part):
    angles_deg_per_s: _Three
    axes_m_per_s: _Three


class _Input(Part):
    sigma: Annotated[float, Field(ge=0.0)]
    unit: Text
    provenance: _Provenance
    source: Text


class _Correlation(Part):
    between: list[str]
    value: Annotated[float, Field(ge=-1.0, le=1.0)]

    @field_validator("between")
    @classmethod
    def _two_inputs(cls, pair: list[str], info: ValidationInfo) -> list[str]:
        known = info.context["known"] if info.context else []
        if len(pair) != 2 or pair[0] == pair[1] or not set(pair) <= set(known):
            raise wrong(f"found {pair!r}", f"two different inputs of {', '.join(known)}")
        return sorted(pair, key=known.index)


class _Survey(Part):
    from_m: _Distance
    to_m: _Distance
    provenance: _Provenance
    source: Text

    @model_validator(mode="after")
    def _some_length(self) -> Self:
        if self.to_m <= self.from_m:
            raise wrong(f"found {self.to_m:g}", f"a distance above {self.from_m:g} m", at=("to_m",))
        return self


class _Budget(Part):
    title: Text
    source: Text
    status: Annotated[Text, one_of(STATUS)]
    based_on: str | None = None
    remarks: Text = ""
    world: Text = "wcs"
    frames: dict[Annotated[str, AfterValidator(_frame_name)], _Frame] = Field(min_length=1)
    direction: _Three = Field(default=[1.0, 1.0, 1.0])
    distances_m: list[_Distance] = Field(min_length=1)
    motion: _Motion | None = None
    inputs: dict[Annotated[str, AfterValidator(_input_name)], _Input] = Field(min_length=1)
    correlations: list[_Correlation] = Field(default=[])
    survey: _Survey | None = None

    @field_validator("direction")
    @classmethod
    def _some_direction(cls, direction: list[float]) -> list[float]:
        if not any(direction):
            raise wrong("found a vector without length", "the direction of the point")
        return direction

    @field_validator("frames")
    @classmethod
    def _attitude_outside(cls, frames: dict[str, _Frame]) -> dict[str, _Frame]:
        refuse(
            [
                wrong(
                    "roll, pitch, heading of an inner frame",
                    "omega, phi, kappa",
                    "Roll, pitch and heading are those of the outermost frame in the world",
                    at=(name, "angles_deg"),
                )
                for name in list(frames)[1:]
                if frames[name].angles_deg.names == ANGLES[1]
            ]
        )
        return frames

    @field_validator("inputs")
    @classmethod
    def _units(cls, inputs: dict[str, _Input], info: ValidationInfo) -> dict[str, _Input]:
        units = info.context["units"] if info.context else {}
        refuse(
            [
                wrong(f"found {item.unit!r}", f"one of: {'; '.join(units[key])}", at=(key, "unit"))
                for key, item in inputs.items()
                if item.unit not in units[key]
            ]
        )
        return inputs

    @field_validator("correlations")
    @classmethod
    def _possible(cls, pairs: list[_Correlation], info: ValidationInfo) -> list[_Correlation]:
        known = info.context["known"] if info.context else []
        matrix = np.eye(len(known))
        for i, pair in enumerate(pairs):
            if any(pair.between == other.between for other in pairs[:i]):
                found = f"the correlation of {' and '.join(pair.between)} stands twice"
                raise wrong(found, "each pair once", at=(i,))
            a, b = map(known.index, pair.between)
            matrix[a, b] = matrix[b, a] = pair.value
        # -1e-12: a correlation of exactly 1 leaves an eigenvalue of zero, known to 1e-16 times the inputs
        if pairs and float(np.linalg.eigvalsh(matrix)[0]) < -1e-12:
            raise wrong(
                "these cannot hold together",
                "a matrix without negative eigenvalues",
                "Check their signs: if a goes with b and b with c, a cannot go against c",
            )
        return pairs


def read_budget(path: Path | str) -> Budget:
    """Read and check a budget file.

    Raises
    ------
    ConfigError : lists every mistake with its file and line.
    """
    path = Path(path)
    document = _inherited(path, ())
    cure = "docs/budgets.md describes the format"
    found = checked(
        _Budget, document, what="error budget", where=path, context=_names(document.data), cure=cure
    )
    return Budget(
        name=path.stem,
        title=found.title,
        source=found.source,
        status=found.status,
        remarks=found.remarks,
        world=found.world,
        frames=tuple(
            Frame(
                name=name,
                angles_deg={key: float(getattr(frame.angles_deg, key)) for key in frame.angles_deg.names},
                lever_m=_three(frame.lever_m),
            )
            for name, frame in found.frames.items()
        ),
        direction=_three(found.direction),
        distances_m=tuple(found.distances_m),
        inputs=tuple(Input(key=key, **dict(item)) for key, item in found.inputs.items()),
        correlations={(pair.between[0], pair.between[1]): pair.value for pair in found.correlations},
        motion=None
        if found.motion is None
        else Motion(
            angles_deg_per_s=_three(found.motion.angles_deg_per_s),
            axes_m_per_s=_three(found.motion.axes_m_per_s),
        ),
        survey=None if found.survey is None else Survey(**dict(found.survey)),
    )


def _three(values: list[float]) -> tuple[float, float, float]:
    x, y, z = values
    return x, y, z


def _angle_names(given: Any) -> tuple[str, ...]:
    return ANGLES["heading" in given]


def _names(data: Any) -> dict[str, Any]:
    """Inputs that the frames of a file allow with their units, those that may be correlated, and motion."""
    data = data if isinstance(data, dict) else {}
    units: dict[str, Mapping[str, float]] = {"time": TIME_UNITS, "point.across": LENGTH_UNITS | ANGLE_UNITS}
    units |= {f"point.{part}": LENGTH_UNITS for part in (*COORDINATES, BEAM[0])}
    for name, frame in _mapping(data.get("frames")).items():
        angles = _angle_names(_mapping(_mapping(frame).get("angles_deg")))
        units |= {f"{name}.{angle}": ANGLE_UNITS for angle in angles}
        units |= {f"{name}.{part}": LENGTH_UNITS for part in COORDINATES}
    known = [key for key in _mapping(data.get("inputs")) if key in units and key != "point.across"]
    return {"units": units, "known": known, "motion": data.get("motion") is not None}


def _mapping(data: Any) -> dict[str, Any]:
    return data if isinstance(data, dict) else {}


def _inherited(path: Path, seen: tuple[Path, ...]) -> Document:
    """Data of a file upon those of the file that it is based on, and where each key stands."""
    if path.resolve() in seen:
        chain = " -> ".join(p.name for p in (*seen, path))
        raise ConfigError(
            f"budgets are based on each other: {chain}", where=path, expected="an end of the chain"
        )
    own = read_yaml(path)
    own.mistakes = [replace(mistake, file=path) for mistake in own.mistakes]
    own.files = dict.fromkeys(own.lines, path)
    base = _mapping(own.data).get("based_on")
    if base is None:
        return own
    if not isinstance(base, str):
        raise ConfigError(f"based_on: found {base!r}", where=path, expected="the path of a budget file")
    if not (path.parent / base).is_file():
        raise ConfigError(
            f"based_on: there is no file {base}",
            where=f"{path}:{own.line(('based_on',))}",
            expected="the path of a budget file, relative to this one",
            cure="Check the name",
        )
    below = _inherited(path.parent / base, (*seen, path.resolve()))
    merged = {key: value for key, value in _mapping(below.data).items() if key not in OWN}
    replaced: set[tuple[Key, ...]] = set()
    for key, value in own.data.items():
        parts = key in ("frames", "inputs") and isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = merged[key] | value if parts else value
        replaced |= {(key, name) for name in value} if parts else {(key,)}
    inputs = merged.get("inputs")
    if isinstance(inputs, dict):
        merged["inputs"] = {key: value for key, value in inputs.items() if value is not None}
    kept = [at for at in below.lines if at[:2] not in replaced and at[:1] not in replaced]
    return Document(
        data=merged,
        lines={at: below.lines[at] for at in kept} | own.lines,
        files={at: below.files[at] for at in kept} | own.files,
        mistakes=below.mistakes + own.mistakes,
    )
