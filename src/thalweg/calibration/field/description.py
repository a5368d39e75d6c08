"""The description of a calibration field by its owner: markers, cones, scale bars, targets, antenna.

A YAML file, ``thalweg_field: 1``; docs/calibration.md shows one. All mistakes in it are told at once, each
with its line.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from thalweg.calibration.markers.sheets import MarkerLayout, parse_mark
from thalweg.core.errors import ConfigError, InputError
from thalweg.core.mistakes import Key, Mistake
from thalweg.core.yaml_lines import Document, parse_yaml, read_yaml

VERSION: Final = 1
_SECTIONS: Final = ("thalweg_field", "markers", "cones", "scale_bars", "targets", "antenna")


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
    reader = _Reader(document)
    field = reader.field() if not document.mistakes or isinstance(document.data, dict) else None
    if reader.mistakes or field is None:
        told = sorted(reader.mistakes, key=lambda m: m.line)
        count = f"{len(told)} mistake{'s' if len(told) > 1 else ''} in the description of the field"
        lines = [
            str(Mistake(path=m.path, found=m.found, expected=m.expected, cure=m.cure, line=m.line))
            for m in told
        ]
        raise ConfigError(count + "\n  " + "\n  ".join(lines), where=path or "")
    return field


class _Reader:
    """Takes a document apart and notes every mistake on the way."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.mistakes = list(document.mistakes)

    def wrong(self, path: tuple[Key, ...], found: str, expected: str = "", cure: str = "") -> None:
        """Note a mistake with the line where it stands."""
        line = self.document.line(path)
        self.mistakes.append(Mistake(path=path, found=found, expected=expected, cure=cure, line=line))

    def field(self) -> FieldDescription | None:
        """What the document describes, None if it holds no keys."""
        data = self.document.data
        if not isinstance(data, dict):
            self.wrong((), "no keys with values", "a field description that begins with thalweg_field: 1")
            return None
        if data.get("thalweg_field") != VERSION:
            found = f"found {data.get('thalweg_field')!r}"
            self.wrong(("thalweg_field",), found, f"thalweg_field: {VERSION}", "Add this line at the top")
        self._known((), data, _SECTIONS)
        layout = self._layout(data.get("markers"))
        self.n_ids = layout.n_ids
        cones = [self._cone(i, item) for i, item in self._list("cones", data)]
        bars = [self._bar(i, item) for i, item in self._list("scale_bars", data)]
        targets = [self._target(i, item) for i, item in self._list("targets", data)]
        antenna = self._antenna(data["antenna"]) if data.get("antenna") is not None else None
        self._twice("cones", [(c.name, c.markers) for c in cones if c])
        self._twice("scale_bars", [(b.name, ()) for b in bars if b])
        self._twice("targets", [(t.name, (t.marker,)) for t in targets if t])
        return FieldDescription(
            layout=layout,
            cones=tuple(c for c in cones if c),
            scale_bars=tuple(b for b in bars if b),
            targets=tuple(t for t in targets if t),
            antenna=antenna,
        )

    def _known(self, path: tuple[Key, ...], data: dict[str, Any], keys: tuple[str, ...]) -> None:
        for key in data:
            if key not in keys:
                self.wrong((*path, key), "unknown key", f"one of {', '.join(keys)}")

    def _list(self, name: str, data: dict[str, Any]) -> list[tuple[int, dict[str, Any]]]:
        value = data.get(name) or []
        if not isinstance(value, list):
            self.wrong((name,), f"found a {type(value).__name__}", "a list, each entry with a dash")
            return []
        entries = []
        for i, item in enumerate(value):
            if isinstance(item, dict):
                entries.append((i, item))
            else:
                self.wrong((name, i), f"found {item!r}", "keys with values")
        return entries

    def _number(
        self, path: tuple[Key, ...], data: dict[str, Any], key: str, low: float, high: float
    ) -> float:
        value: Any = data.get(key)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not math.isfinite(value) or not low <= value <= high:
            found = "missing" if key not in data else f"found {value!r}"
            self.wrong(
                (*path, key) if key in data else path, f"{key}: {found}", f"a number from {low:g} to {high:g}"
            )
            return math.nan
        return float(value)

    def _text(self, path: tuple[Key, ...], data: dict[str, Any], key: str) -> str:
        value = data.get(key)
        if not isinstance(value, str) or not value:
            found = "missing" if key not in data else f"found {value!r}"
            self.wrong((*path, key) if key in data else path, f"{key}: {found}", "a name")
            return ""
        return value

    def _marker(self, path: tuple[Key, ...], value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < self.n_ids:
            self.wrong(path, f"marker {value!r}", f"an id from 0 to {self.n_ids - 1}")
            return -1
        return value

    def _range(self, path: tuple[Key, ...], value: Any) -> tuple[int, ...]:
        if not isinstance(value, list) or len(value) != 2:
            self.wrong(path, f"found {value!r}", "first and last id in brackets, [0, 7]")
            return ()
        first, last = (self._marker(path, item) for item in value)
        if first > last:
            self.wrong(path, f"from {first} to {last}", "the smaller id first")
        return tuple(range(first, last + 1))

    def _layout(self, data: Any) -> MarkerLayout:
        path: tuple[Key, ...] = ("markers",)
        if not isinstance(data, dict):
            found = "missing" if data is None else f"found {data!r}"
            self.wrong(path, found, "a section with dictionary and module_m")
            return MarkerLayout()
        self._known(path, data, ("dictionary", "module_m", "sizes"))
        dictionary = data.get("dictionary", "DICT_4X4_250")
        try:
            self.n_ids = MarkerLayout(str(dictionary)).n_ids
        except InputError as error:
            self.wrong((*path, "dictionary"), error.found, error.expected)
            dictionary = "DICT_4X4_250"
            self.n_ids = MarkerLayout().n_ids
        module = self._number(path, data, "module_m", 0.001, 0.5)
        sizes = []
        for i, item in enumerate(data.get("sizes") or []):
            here = (*path, "sizes", i)
            if not isinstance(item, dict):
                self.wrong(here, f"found {item!r}", "ids and module_m")
                continue
            ids = self._range((*here, "ids"), item.get("ids"))
            side = self._number(here, item, "module_m", 0.001, 0.5)
            if ids and math.isfinite(side):
                sizes.append((ids[0], ids[-1], side))
        return MarkerLayout(dictionary, module if math.isfinite(module) else 0.012, tuple(sizes))

    def _cone(self, i: int, data: dict[str, Any]) -> FieldCone | None:
        path: tuple[Key, ...] = ("cones", i)
        before = len(self.mistakes)
        self._known(path, data, ("name", "markers", "half_angle_deg", "length_m"))
        cone = FieldCone(
            name=self._text(path, data, "name"),
            markers=self._range((*path, "markers"), data.get("markers")),
            half_angle_rad=math.radians(self._number(path, data, "half_angle_deg", 2.0, 80.0)),
            length_m=self._number(path, data, "length_m", 0.05, 20.0),
        )
        return cone if len(self.mistakes) == before else None

    def _bar(self, i: int, data: dict[str, Any]) -> ScaleBar | None:
        path: tuple[Key, ...] = ("scale_bars", i)
        before = len(self.mistakes)
        self._known(path, data, ("name", "from", "to", "length_m", "sigma_m"))
        ends = [self._text(path, data, key) for key in ("from", "to")]
        for key, end in zip(("from", "to"), ends, strict=True):
            try:
                if end:
                    self._marker((*path, key), parse_mark(end)[0])
            except InputError as error:
                self.wrong((*path, key), error.found, error.expected)
        if ends[0] and ends[0] == ends[1]:
            self.wrong((*path, "to"), f"the bar ends where it begins, at {ends[0]}", "two different marks")
        bar = ScaleBar(
            name=self._text(path, data, "name"),
            start=ends[0],
            end=ends[1],
            length_m=self._number(path, data, "length_m", 0.01, 100.0),
            sigma_m=self._number(path, data, "sigma_m", 1e-7, 1.0),
        )
        return bar if len(self.mistakes) == before else None

    def _target(self, i: int, data: dict[str, Any]) -> Target | None:
        path: tuple[Key, ...] = ("targets", i)
        before = len(self.mistakes)
        self._known(path, data, ("name", "marker", "lat_deg", "lon_deg", "h_ell_m", "sigma_m"))
        sigma = data.get("sigma_m")
        if not isinstance(sigma, list) or len(sigma) != 3:
            self.wrong(
                (*path, "sigma_m"), f"found {sigma!r}", "sigmas of east, north and up, [0.01, 0.01, 0.02]"
            )
            sigma = [1.0, 1.0, 1.0]
        checked = [self._number((*path, "sigma_m"), {"sigma_m": s}, "sigma_m", 1e-6, 100.0) for s in sigma]
        target = Target(
            name=self._text(path, data, "name"),
            marker=self._marker((*path, "marker"), data.get("marker")),
            lat_deg=self._number(path, data, "lat_deg", -90.0, 90.0),
            lon_deg=self._number(path, data, "lon_deg", -180.0, 360.0),
            h_ell_m=self._number(path, data, "h_ell_m", -500.0, 9000.0),
            sigma_m=(checked[0], checked[1], checked[2]),
        )
        return target if len(self.mistakes) == before else None

    def _antenna(self, data: Any) -> AntennaMarker | None:
        path: tuple[Key, ...] = ("antenna",)
        before = len(self.mistakes)
        if not isinstance(data, dict):
            self.wrong(path, f"found {data!r}", "marker, offset_m and sigma_m")
            return None
        self._known(path, data, ("marker", "offset_m", "sigma_m"))
        antenna = AntennaMarker(
            marker=self._marker((*path, "marker"), data.get("marker")),
            offset_m=self._number(path, data, "offset_m", -1.0, 1.0),
            sigma_m=self._number(path, data, "sigma_m", 1e-6, 1.0),
        )
        return antenna if len(self.mistakes) == before else None

    def _twice(self, section: str, entries: list[tuple[str, tuple[int, ...]]]) -> None:
        names: dict[str, int] = {}
        markers: dict[int, str] = {}
        for i, (name, ids) in enumerate(entries):
            if name in names:
                self.wrong((section, i), f"the name '{name}' stands twice", "each name once")
            names[name] = i
            for marker in ids:
                if marker in markers:
                    found = f"marker {marker} belongs to {markers[marker]} and to {name}"
                    self.wrong((section, i), found, "each marker at one place")
                markers[marker] = name
