"""The description of a calibration field by its owner: markers, cones, scale bars, targets, antenna.

A YAML file, ``thalweg_field: 1``; docs/calibration.md shows one. All mistakes in it are told at once, each
with its line.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, field_validator, model_validator

from thalweg.calibration import MarkerLayout, parse_mark
from thalweg.core import Document, InputError, Name, Part, checked, parse_yaml, read_yaml, wrong

_DICTIONARY: Final = MarkerLayout().dictionary


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldCone:
    """A cone with the ids of the sheets on it and its nominal shape: half angle, length along the axis."""

    name: str
    markers: tuple[int, ...]
    half_angle_rad: float
    length_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ScaleBar:
    """A known distance between two marks, as ``80/0`` and ``81/0``."""

    name: str
    start: str
    end: str
    length_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A marker whose centre (mean of its saddles) was measured by RTK; sigmas of east, north, up."""

    name: str
    marker: int
    lat_deg: float
    lon_deg: float
    h_ell_m: float
    sigma_m: tuple[float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class AntennaMarker:
    """A marker that lies flat on the antenna; its phase centre is ``offset_m`` off it, out of the print."""

    marker: int
    offset_m: float
    sigma_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldDescription:
    """What is known of a calibration field before it is measured."""

    layout: MarkerLayout
    cones: tuple[FieldCone, ...] = ()
    scale_bars: tuple[ScaleBar, ...] = ()
    targets: tuple[Target, ...] = ()
    antenna: AntennaMarker | None = None

    @property
    def boat_markers(self) -> set[int]:
        """Markers that go with the boat and are no part of the field."""
        return set() if self.antenna is None else {self.antenna.marker}

    def cone_of(self, marker: int) -> str:
        """Name of the cone that carries a marker, empty if none does."""
        return next((cone.name for cone in self.cones if marker in cone.markers), "")


# ---------------------------------------------------------------- file


def _marker(value: Any, info: ValidationInfo) -> Any:
    n_ids = info.context["n_ids"] if info.context else 0
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < n_ids:
        raise wrong(f"marker {value!r}", f"an id from 0 to {n_ids - 1}")
    return value


def _range(value: list[int]) -> list[int]:
    if value[0] > value[1]:
        raise wrong(f"from {value[0]} to {value[1]}", "the smaller id first")
    return value


def _mark(value: str, info: ValidationInfo) -> str:
    try:
        _marker(parse_mark(value)[0], info)
    except InputError as error:
        raise wrong(error.found, error.expected) from error
    return value


def _dictionary(value: str) -> str:
    try:
        MarkerLayout(value)
    except InputError as error:
        raise wrong(error.found, error.expected) from error
    return value


_Marker = Annotated[int, BeforeValidator(_marker)]
_Range = Annotated[list[_Marker], Field(min_length=2, max_length=2), AfterValidator(_range)]
_Mark = Annotated[Name, AfterValidator(_mark)]
_Module = Annotated[float, Field(ge=0.001, le=0.5)]


class _Size(Part):
    ids: _Range
    module_m: _Module


class _Markers(Part):
    dictionary: Annotated[str, AfterValidator(_dictionary)] = _DICTIONARY
    module_m: _Module
    sizes: list[_Size] = Field(default_factory=list)


class _Cone(Part):
    name: Name
    markers: _Range
    half_angle_deg: Annotated[float, Field(ge=2.0, le=80.0)]
    length_m: Annotated[float, Field(ge=0.05, le=20.0)]


class _Bar(Part):
    name: Name
    start: _Mark = Field(alias="from")
    end: _Mark = Field(alias="to")
    length_m: Annotated[float, Field(ge=0.01, le=100.0)]
    sigma_m: Annotated[float, Field(ge=1e-7, le=1.0)]

    @model_validator(mode="after")
    def _two_ends(self) -> Self:
        if self.start == self.end:
            raise wrong(f"the bar ends where it begins, at {self.end}", "two different marks", at=("to",))
        return self


class _Target(Part):
    name: Name
    marker: _Marker
    lat_deg: Annotated[float, Field(ge=-90.0, le=90.0)]
    lon_deg: Annotated[float, Field(ge=-180.0, le=360.0)]
    h_ell_m: Annotated[float, Field(ge=-500.0, le=9000.0)]
    sigma_m: list[Annotated[float, Field(ge=1e-6, le=100.0)]] = Field(
        min_length=3, max_length=3, description="sigmas of east, north and up, [0.01, 0.01, 0.02]"
    )


class _Antenna(Part):
    marker: _Marker
    offset_m: Annotated[float, Field(ge=-1.0, le=1.0)]
    sigma_m: Annotated[float, Field(ge=1e-6, le=1.0)]


class _Field(Part):
    thalweg_field: Literal[1]
    markers: _Markers
    cones: list[_Cone] | None = None
    scale_bars: list[_Bar] | None = None
    targets: list[_Target] | None = None
    antenna: _Antenna | None = None

    @field_validator("cones", "scale_bars", "targets")
    @classmethod
    def _each_once(cls, entries: Sequence["_Cone | _Bar | _Target"] | None) -> Any:
        names: set[str] = set()
        places: dict[int, str] = {}
        for i, entry in enumerate(entries or []):
            if entry.name in names:
                raise wrong(f"the name '{entry.name}' stands twice", "each name once", at=(i,))
            names.add(entry.name)
            for marker in _markers_of(entry):
                if marker in places:
                    found = f"marker {marker} belongs to {places[marker]} and to {entry.name}"
                    raise wrong(found, "each marker at one place", at=(i,))
                places[marker] = entry.name
        return entries


def _markers_of(entry: _Cone | _Bar | _Target) -> tuple[int, ...]:
    if isinstance(entry, _Cone):
        return tuple(range(entry.markers[0], entry.markers[1] + 1))
    return (entry.marker,) if isinstance(entry, _Target) else ()


def read_field(path: Path) -> FieldDescription:
    """Read the description of a field.

    Raises
    ------
    ConfigError : the file is missing or holds mistakes; all are told, each with its line.
    """
    return _described(read_yaml(path), path)


def parse_field(text: str) -> FieldDescription:
    """The same from text."""
    return _described(parse_yaml(text), None)


def _described(document: Document, path: Path | None) -> FieldDescription:
    data = document.data if isinstance(document.data, dict) else {}
    markers = data.get("markers")
    dictionary = markers.get("dictionary", _DICTIONARY) if isinstance(markers, dict) else _DICTIONARY
    try:
        n_ids = MarkerLayout(str(dictionary)).n_ids
    except InputError:  # told by its field
        n_ids = MarkerLayout().n_ids
    found = checked(_Field, document, what="description of the field", where=path, context={"n_ids": n_ids})
    sizes = tuple((size.ids[0], size.ids[1], size.module_m) for size in found.markers.sizes)
    antenna = found.antenna
    return FieldDescription(
        layout=MarkerLayout(found.markers.dictionary, found.markers.module_m, sizes),
        cones=tuple(
            FieldCone(
                name=cone.name,
                markers=_markers_of(cone),
                half_angle_rad=math.radians(cone.half_angle_deg),
                length_m=cone.length_m,
            )
            for cone in found.cones or ()
        ),
        scale_bars=tuple(ScaleBar(**dict(bar)) for bar in found.scale_bars or ()),
        targets=tuple(
            Target(**{**dict(target), "sigma_m": tuple(target.sigma_m)}) for target in found.targets or ()
        ),
        antenna=None if antenna is None else AntennaMarker(**dict(antenna)),
    )
