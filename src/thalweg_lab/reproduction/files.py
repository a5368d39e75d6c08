"""The ledger of published numbers: what is printed where, how it is judged, and where our number comes from.

``resources/published/ledger.yaml`` is written by hand. A printed number is an *entry*: the rows of the
project's list of published items that it belongs to, its place, its text, value and unit, half a unit of its
last digit, the rule of its verdict with a reason, and a pointer to the number that this pipeline measures.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core import ConfigError, Document, Key, Mistake, read_yaml

VERSION: Final = 1
KINDS: Final = ("input constant", "exact", "statistic on the twin", "procedure only")
RULES: Final = ("equal", "at most", "at least", "inside", "same word", "present", "not checkable")
BASES: Final = ("printed digits", "sampling error", "goal", "identity")
"""Where a tolerance comes from: half a unit of the last digit; that and three sigmas of our own number; a
bound that the project sets itself (with half a unit); or the arithmetic of float64, stated as ``tolerance``.
Printed digits state a ``tolerance`` where several printed numbers make one, with the reason in ``why``."""

TAKES: Final = ("one", "mean", "median", "rms", "sum", "count", "least", "largest", "largest size")
SOURCES: Final = ("file", "study", "setting", "computed", "none")

PUT_IN: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "setting": ("an input of the twin or of the computation", ("input constant", "statistic on the twin")),
    "constant": ("a constant of the stored instrument", ("input constant",)),
    "arithmetic": ("arithmetic of printed numbers", ("exact", "procedure only")),
    "decoded": ("a stored table turned back", ("exact",)),
    "definition": ("true by definition", ("exact", "statistic on the twin")),
    "fitted": ("met by an input chosen for it", KINDS),
}
"""Why a number is no finding of this project, in words, and of which kinds it may be: no measurement could
have given it otherwise, or geometry or inputs were fitted to it or to its neighbours."""

ALWAYS_PUT_IN: Final = {
    "times": "arithmetic",
    "percent": "arithmetic",
    "difference": "arithmetic",
    "ratio": "arithmetic",
    "opening_of_all_lines": "arithmetic",
    "table_1_of_p3": "decoded",
    "unknowns": "definition",
    "picture_px": "constant",
    "picture_mm": "constant",
    "principal_distance": "constant",
    "opening": "constant",
    "total_to": "fitted",
    "shrinking_causes": "fitted",
    "least_in_centre": "fitted",
    "depth_lines_seen": "fitted",
    "survey_rmse": "fitted",
}
"""Functions of `thalweg_lab.reproduction.ledger` whose numbers are put in, whatever the entry says."""

FITTED: Final = (("triangulation/budget_published.csv", "computed_mm"), ("chain_study_goals.csv", "found_m"))
"""Files and columns that rest on geometry or inputs which were fitted to published figures: the prototype of
P4, and the magnetic fields, drift and multipath of the study of chains."""

POINTERS: Final = {".csv": "column", ".parquet": "column", ".json": "key", ".yaml": "key", ".ply": "axis"}
"""What says where a number stands, by the kind of file."""

_ENTRY: Final = {
    "rows": True, "part": False, "where": True, "quantity": True, "printed": True, "value": False,
    "unit": False, "half_unit": False, "tolerance": False, "kind": True, "rule": True, "basis": False,
    "put_in": False, "why": True, "ours": True, "note": False,
}  # fmt: skip
_OURS: Final = {
    *SOURCES,
    "where",
    "near",
    "column",
    "key",
    "over",
    "against",
    "take",
    "times",
    "n",
    "sigma",
    "sigma_of",
    "words",
    "axis",
    "with",
}
_NEEDS_VALUE: Final = ("equal", "at most", "at least", "inside")


@dataclass(frozen=True, slots=True, kw_only=True)
class Ours:
    """Where our number comes from.

    Parameters
    ----------
    source : one of `SOURCES`: a file below the campaign's results, a study's table below
        ``results/reproduction``, a setting of the twin, a function of `thalweg_lab.reproduction.ledger`,
        or nothing yet.
    name : path of the file, dotted path of the setting, name of the function, or why there is nothing.
    where : column of a table -> text or number that its rows must have.
    near : column -> value and how far from it a row may lie.
    columns, key : of a table, several are put together; path into a JSON or YAML file.
    over : column or key by whose value the number is divided.
    against : another file below the results: the same number of that one is the divisor.
    take : how several numbers become one, see `TAKES`.
    times : factor to the printed unit.
    n, sigma : column or key of the number of observations and of the sigma, in the file's unit; instead of a
        sigma also ``binomial``, that of a share of n observations, ``scatter``, that of the rows themselves,
        or ``unit`` for a number that is in its own sigmas.
    sigma_of : file and column whose sigmas, as of a mean of independent rows, are that of the number.
    words : text in the file -> number, by the first that the text begins with.
    axis : of a mesh: its 1st, 2nd or 3rd longest extent.
    extra : arguments of a function.
    """

    source: str
    name: str
    where: Mapping[str, str | float]
    near: Mapping[str, tuple[float, float]]
    columns: tuple[str, ...] = ()
    key: tuple[str | int, ...] = ()
    over: str = ""
    against: str = ""
    take: str = "one"
    times: float = 1.0
    n: str = ""
    sigma: str = ""
    sigma_of: tuple[str, str] | None = None
    words: Mapping[str, float] | None = None
    axis: int = 0
    extra: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A published number.

    Parameters
    ----------
    rows : items of the project's list that it belongs to, such as C286.
    part : which number of these rows it is; empty if it is the only one.
    section : heading under which it stands.
    where : paper and section or table: P4 6.3.
    quantity : in words.
    printed : as it stands in the text.
    value : number or word that is compared; two for ``inside``; None if there is none.
    unit : of the value.
    half_unit : half a unit of the last printed digit; 0 for words and counts that are exact.
    tolerance : instead of that; 0 if the half unit counts.
    kind, rule, basis : see `KINDS`, `RULES`, `BASES`.
    put_in : of a number that this project put in, why it is no finding, see `PUT_IN`; else empty.
    why : reason of the rule; of ``not checkable``, why it cannot be checked.
    ours : where our number comes from.
    note : what a reader of the verdict should know.
    """

    rows: tuple[str, ...]
    part: str
    section: str
    where: str
    quantity: str
    printed: str
    value: float | str | tuple[float, float] | None
    unit: str
    half_unit: float
    tolerance: float
    kind: str
    rule: str
    basis: str
    put_in: str
    why: str
    ours: Ours
    note: str

    @property
    def name(self) -> str:
        """First row and part: what other entries and functions call it by."""
        return f"{self.rows[0]} {self.part}".strip()


def read_ledger(path: Path) -> tuple[Entry, ...]:
    """The entries of a ledger in their order.

    Raises
    ------
    ConfigError : the file is missing or holds mistakes; all are told, each with its line.
    """
    reader = _Reader(read_yaml(path))
    entries = reader.entries() if not reader.mistakes else ()
    if reader.mistakes:
        told = sorted(reader.mistakes, key=lambda mistake: mistake.line)
        count = f"{len(told)} mistake{'s' * (len(told) > 1)} in the ledger"
        raise ConfigError(count + "".join(f"\n  {mistake}" for mistake in told), where=path)
    return entries


def result_files(entries: tuple[Entry, ...], source: str = "file") -> list[str]:
    """Files that entries point to, once each: ``file`` below a campaign's results, ``study`` below
    ``results/reproduction``.
    """
    pointed = [e.ours for e in entries if e.ours.source == source]
    names = [name for o in pointed for name in (o.name, o.against, o.sigma_of[0] if o.sigma_of else "")]
    return list(dict.fromkeys(filter(None, names)))


class _Reader:
    """Takes the document apart and notes every mistake on the way."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.mistakes = list(document.mistakes)

    def wrong(self, path: tuple[Key, ...], found: str, expected: str, cure: str = "") -> None:
        """Note a mistake with its line."""
        line = self.document.line(path)
        self.mistakes.append(Mistake(path=path, found=found, expected=expected, cure=cure, line=line))

    def entries(self) -> tuple[Entry, ...]:
        """All entries of the file; mistakes are collected."""
        data = self.document.data
        if not isinstance(data, dict) or data.get("thalweg_ledger") != VERSION:
            self.wrong((), "not a ledger", f"thalweg_ledger: {VERSION}, and sections")
            return ()
        for key in data.keys() - {"thalweg_ledger", "sections"}:
            self.wrong((key,), "unknown key", "thalweg_ledger, sections")
        found: dict[str, Entry] = {}
        for path, section in self.list(("sections",), data.get("sections")):
            if not isinstance(section, dict) or set(section) != {"title", "entries"}:
                self.wrong(path, "no section", "title and entries")
                continue
            for place, one in self.list((*path, "entries"), section["entries"]):
                entry = self.entry(place, one, str(section["title"]))
                if entry is None:
                    continue
                if entry.name in found:
                    self.wrong(place, f"{entry.name!r} stands twice", "names that differ", "Give it a part")
                found[entry.name] = entry
        return tuple(found.values())

    def list(self, path: tuple[Key, ...], data: Any) -> list[tuple[tuple[Key, ...], Any]]:
        """Elements of a list with their paths; a mistake if it is none or empty."""
        if not isinstance(data, list) or not data:
            self.wrong(path, "nothing there", "a list")
            return []
        return [((*path, i), item) for i, item in enumerate(data)]

    def entry(self, path: tuple[Key, ...], data: Any, section: str) -> Entry | None:
        """One entry, or None after a mistake in it."""
        before = len(self.mistakes)
        if not isinstance(data, dict):
            self.wrong(path, f"found {data!r}", "an entry with the keys " + ", ".join(_ENTRY))
            return None
        for key in data.keys() - _ENTRY.keys():
            self.wrong((*path, key), "unknown key", ", ".join(_ENTRY))
        for key, needed in _ENTRY.items():
            if needed and data.get(key) in (None, "", []):
                self.wrong(path, f"{key} is missing", f"the key {key}")
        for key, choice in (("kind", KINDS), ("rule", RULES), ("basis", BASES)):
            if data.get(key) is not None and data[key] not in choice:
                self.wrong((*path, key), f"found {data[key]!r}", f"one of: {'; '.join(choice)}")
        rows = data.get("rows")
        if rows is not None and (not isinstance(rows, list) or not all(_is_row(row) for row in rows)):
            self.wrong((*path, "rows"), f"found {rows!r}", "a list such as [C286]")
        if len(self.mistakes) > before:
            return None
        self.judged(path, data)
        self.put_in(path, data)
        ours = self.ours((*path, "ours"), data["ours"])
        if data.get("basis") == "sampling error" and ours and not (ours.sigma or ours.sigma_of):
            self.wrong((*path, "ours"), "no sigma", "a sigma for the basis 'sampling error'")
        if len(self.mistakes) > before or ours is None:
            return None
        value = data.get("value")
        words = {key: " ".join(str(data.get(key) or "").split()) for key in _ENTRY}
        return Entry(
            rows=tuple(rows or ()),
            part=words["part"],
            section=section,
            where=words["where"],
            quantity=words["quantity"],
            printed=words["printed"],
            unit=words["unit"],
            value=(float(value[0]), float(value[1]))
            if isinstance(value, list)
            else value
            if value is None or isinstance(value, str)
            else float(value),
            half_unit=float(data.get("half_unit") or 0.0),
            tolerance=float(data.get("tolerance") or 0.0),
            kind=words["kind"],
            rule=words["rule"],
            basis=words["basis"],
            put_in=words["put_in"],
            why=words["why"],
            ours=ours,
            note=words["note"],
        )

    def judged(self, path: tuple[Key, ...], data: dict[str, Any]) -> None:
        """Value, half unit, tolerance and basis must fit the rule."""
        rule, basis = data["rule"], data.get("basis")
        value: Any = data.get("value")
        pair = isinstance(value, list)
        if pair and not (len(value) == 2 and all(map(_is_number, value)) and value[0] < value[1]):
            self.wrong((*path, "value"), f"found {value!r}", "two numbers, the smaller first")
        elif rule == "inside" and not pair:
            self.wrong((*path, "value"), f"found {value!r}", "two numbers for the rule 'inside'")
        elif rule in _NEEDS_VALUE and not pair and not _is_number(value):
            self.wrong((*path, "value"), f"found {value!r}", f"a number for the rule {rule!r}")
        elif rule == "same word" and not isinstance(value, str):
            self.wrong((*path, "value"), f"found {value!r}", "a word")
        for key in ("half_unit", "tolerance"):
            if data.get(key) is not None and not (_is_number(data[key]) and data[key] >= 0):
                self.wrong((*path, key), f"found {data[key]!r}", "a number of 0 or more")
        if rule in _NEEDS_VALUE and basis is None:
            self.wrong(path, "basis is missing", f"one of: {'; '.join(BASES)}")
        tolerated = data.get("tolerance") is not None
        if (basis == "identity" and not tolerated) or (
            tolerated and basis not in ("identity", "printed digits")
        ):
            self.wrong(
                path,
                "tolerance and basis do not fit",
                "a tolerance with the basis identity, or one that follows from several printed numbers",
            )
        if basis in ("printed digits", "sampling error") and data.get("half_unit") is None:
            self.wrong(path, "half_unit is missing", "half a unit of the last printed digit")

    def put_in(self, path: tuple[Key, ...], data: dict[str, Any]) -> None:
        """A number that was put in says so, in the class that its source implies; others must not."""
        given, kind = data.get("put_in"), data["kind"]
        if data["rule"] in ("present", "not checkable"):
            if given is not None:
                self.wrong(
                    (*path, "put_in"),
                    f"found {given!r} with the rule {data['rule']!r}",
                    "no put_in where nothing is compared",
                )
            return
        needed = _must_be_put_in(data["ours"])
        if given is None and (needed or kind == "input constant"):
            because = f"its number comes from {needed[1]}" if needed else "its kind is 'input constant'"
            self.wrong(path, f"put_in is missing: {because}", f"put_in: {needed[0] if needed else 'setting'}")
        elif given is not None and given not in PUT_IN:
            self.wrong((*path, "put_in"), f"found {given!r}", f"one of: {', '.join(PUT_IN)}")
        elif given is not None and needed and given != needed[0]:
            self.wrong((*path, "put_in"), f"found {given!r} for {needed[1]}", f"put_in: {needed[0]}")
        elif given is not None and kind not in PUT_IN[given][1]:
            self.wrong(
                (*path, "put_in"),
                f"found {given!r} for the kind {kind!r}",
                f"one of the kinds {', '.join(PUT_IN[given][1])}",
            )

    def ours(self, path: tuple[Key, ...], data: Any) -> Ours | None:
        """Where the pipeline's own value comes from, or None after a mistake."""
        before = len(self.mistakes)
        given = [key for key in SOURCES if isinstance(data, dict) and key in data]
        if len(given) != 1 or not isinstance(data[given[0]], str) or not data[given[0]].strip():
            self.wrong(path, f"found {data!r}", f"one of {', '.join(SOURCES)}, with a text")
            return None
        (source,) = given
        for key in data.keys() - _OURS:
            self.wrong((*path, key), "unknown key", ", ".join(sorted(_OURS)))
        if data.get("take", "one") not in TAKES:
            self.wrong((*path, "take"), f"found {data['take']!r}", f"one of: {', '.join(TAKES)}")
        if source in ("file", "study"):
            name = Path(data[source])
            if name.is_absolute() or ".." in name.parts:
                self.wrong((*path, source), f"found {data[source]!r}", "a path below the results")
            pointer = POINTERS.get(name.suffix)
            if pointer is None or [key for key in ("column", "key", "axis") if key in data] != [pointer]:
                self.wrong(
                    path, f"which number of a {name.suffix or 'file'}?", f"{pointer or 'another file'}"
                )
            if data.get("sigma") == "binomial" and "n" not in data:
                self.wrong(path, "a share without n", "the column of n")
        for key in ("where", "near", "words", "with", "sigma_of"):
            if key in data and not isinstance(data[key], dict):
                self.wrong((*path, key), f"found {data[key]!r}", "keys with values")
        near = data.get("near") or {}
        if isinstance(near, dict) and any(not isinstance(v, list) or len(v) != 2 for v in near.values()):
            self.wrong((*path, "near"), f"found {near!r}", "column: [value, how far off]")
        spread = data.get("sigma_of")
        if isinstance(spread, dict) and set(spread) != {"file", "column"}:
            self.wrong((*path, "sigma_of"), f"found {spread!r}", "file and column")
        if len(self.mistakes) > before:
            return None
        return Ours(
            source=source,
            name=" ".join(data[source].split()),
            where=dict(data.get("where") or {}),
            near={k: (float(v[0]), float(v[1])) for k, v in near.items()},
            columns=_several(data.get("column", [])),
            key=_several(data.get("key", [])),
            over=str(data.get("over", "")),
            against=str(data.get("against", "")),
            take=data.get("take", "one"),
            times=float(data.get("times", 1.0)),
            n=str(data.get("n", "")),
            sigma=str(data.get("sigma", "")),
            sigma_of=(spread["file"], spread["column"]) if spread else None,
            words=data.get("words"),
            axis=int(data.get("axis", 0)),
            extra=data.get("with"),
        )


def _must_be_put_in(ours: Any) -> tuple[str, str] | None:
    """Class of `PUT_IN` that a pointer implies, and its source in words; None where it implies none."""
    if not isinstance(ours, dict):
        return None
    if "setting" in ours:
        return "setting", "a setting of the twin"
    function = ours.get("computed")
    if function in ALWAYS_PUT_IN:
        return ALWAYS_PUT_IN[function], f"the function {function}"
    file = ours.get("file") or ours.get("study")
    if (file, ours.get("column")) in FITTED and ours.get("take") != "count":
        return "fitted", f"{file}, column {ours['column']}"
    return None


def _several(value: Any) -> tuple[Any, ...]:
    return tuple(value) if isinstance(value, list) else (value,)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _is_row(value: Any) -> bool:
    return isinstance(value, str) and len(value) == 4 and value[0] == "C" and value[1:].isdigit()
