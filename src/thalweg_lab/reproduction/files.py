"""The ledger of published numbers: what is printed where, how it is judged, and where our number comes from.

``resources/published/*.yaml`` is written by hand. A printed number is an *entry*: the rows of the
project's list of published items that it belongs to, its place, its text, value and unit, half a unit of its
last digit, the rule of its verdict with a reason, and a pointer to the number that this pipeline measures.

Rows are published items (C001 to C328), misprints (E01 to E30) and ideas for future work (FW01 to FW39).
A file with a ``campaign`` points to results of that campaign; in all others a path begins with the campaign.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
import pandas as pd
from pydantic import AfterValidator, BeforeValidator, Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from thalweg.core import ConfigError, Part, Text, checked, one_of, read_mapping, read_yaml, refuse, wrong

KINDS: Final = ("input constant", "exact", "statistic on the twin", "procedure only", "figure")
CLASSES: Final = dict(zip(KINDS, "IABCD", strict=True))
"""Class of a number by its kind: input, exact, statistic on the twin, procedure only, figure."""
RULES: Final = (
    "equal",
    "at most",
    "at least",
    "inside",
    "same word",
    "present",
    "not checkable",
    "misprint",
    "waived",
    "open",
)
"""``misprint``: our number is the one that was ``decided`` on, and not the printed one. ``waived``: nothing
that software could show, such as a photograph of hardware. ``open``: an idea for future work, not done."""
NOT_COMPARED: Final = ("present", "not checkable", "waived", "open")
"""Rules under which no number can fail."""
BASES: Final = ("printed digits", "sampling error", "goal", "direction", "identity")
"""Where a tolerance comes from: half a unit of the last digit; that and three sigmas of our own number; a
bound, printed or set by the project (with half a unit); which of two is larger, or on which side of zero, as
the text says in words; or the arithmetic of float64, stated as ``tolerance``.
Printed digits state a ``tolerance`` where several printed numbers make one, with the reason in ``why``."""

TAKES: Final = ("one", "mean", "median", "rms", "sum", "count", "least", "largest", "largest size")
NAMES: Final = ("rule", "function", "figure")
"""Sources that name parts of the project: its rules, ``module:function``, rows of workflow/figures.yaml."""
SOURCES: Final = ("file", "study", "setting", "computed", *NAMES, "none")

PUT_IN: Final[dict[str, tuple[str, tuple[str, ...]]]] = {
    "setting": ("an input of the twin or of the computation", ("input constant", "statistic on the twin")),
    "constant": ("a constant of the stored instrument", ("input constant",)),
    "arithmetic": ("arithmetic of printed numbers", ("exact", "procedure only")),
    "decoded": ("a stored table turned back", ("exact",)),
    "definition": ("holds whatever is measured", ("exact", "statistic on the twin")),
    "fitted": ("fitted to it or to its neighbours", KINDS),
}
"""Why a number is no finding of this project, in words, and of which kinds it may be: no measurement could
have given it otherwise, or geometry or inputs were fitted to it or to its neighbours."""
BY_ARITHMETIC: Final = ("arithmetic", "definition")
"""Classes of `PUT_IN` that hold by arithmetic or definition; the others are inputs."""

ALWAYS_PUT_IN: Final = {
    "normal_share": "arithmetic",
    "root_of_squares": "arithmetic",
    "root_of_named": "arithmetic",
    "largest_of": "arithmetic",
    "distances_led_by": "arithmetic",
    "distances_below": "arithmetic",
    "cone_unknowns": "definition",
    "cone_parameters": "definition",
    "published_budget": "fitted",
    "budget_lever": "fitted",
    "budget_ratio": "fitted",
    "lidar_constant": "constant",
    "arithmetic": "arithmetic",
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
"""Functions of `ledger` and `verdicts` whose numbers are put in, whatever the entry says."""

FITTED: Final = (("chain_study_goals.csv", "found_m"),)
"""Files and columns that rest on inputs which were fitted to published figures: the magnetic fields, drift
and multipath of the study of chains."""

TWIN_SECTION: Final = "twin.light_sheet"
"""Section of the campaign that settings of a file with a ``campaign`` stand in."""

POINTERS: Final = {".csv": "column", ".parquet": "column", ".json": "key", ".yaml": "key", ".ply": "axis"}
"""What says where a number stands, by the kind of file."""

_NEEDS_VALUE: Final = ("equal", "at most", "at least", "inside", "misprint")


def read_ledger(path: Path) -> "tuple[Entry, ...]":
    """The entries of a ledger in their order.

    Raises
    ------
    ConfigError : the file is missing or holds mistakes; all are told, each with its line.
    """
    ledger = checked(_Ledger, read_yaml(path), what="ledger", where=path)
    return tuple(
        entry.model_copy(update={"section": section.title})
        for section in ledger.sections
        for entry in (*section.entries, *_cells(section, path.parent))
    )


def read_ledgers(folder: Path) -> "tuple[Entry, ...]":
    """All entries of a folder of ledgers, files in order of their names; paths and settings of a file with a
    ``campaign`` begin with it.

    Raises
    ------
    ConfigError : a file holds mistakes, or two entries of different files have one name.
    """
    entries: dict[str, Entry] = {}
    for path in sorted(folder.glob("*.yaml")):
        campaign = str(read_mapping(path)[0].get("campaign", ""))
        for entry in read_ledger(path):
            if entry.name in entries:
                raise ConfigError(f"{entry.name!r} stands twice", where=path, expected="names that differ")
            entries[entry.name] = entry.model_copy(update={"ours": _of_campaign(entry.ours, campaign)})
    return tuple(entries.values())


def _of_campaign(ours: "Ours", campaign: str) -> "Ours":
    if not campaign or ours.source not in ("file", "setting"):
        return ours
    if ours.setting:
        return ours.model_copy(update={"setting": f"{campaign}.{TWIN_SECTION}.{ours.name}"})
    spread = ours.sigma_of
    return ours.model_copy(
        update={
            "file": f"{campaign}/{ours.name}",
            "against": ours.against and f"{campaign}/{ours.against}",
            "sigma_of": spread and spread.model_copy(update={"file": f"{campaign}/{spread.file}"}),
        }
    )


def result_files(entries: "tuple[Entry, ...]", source: str = "file") -> list[str]:
    """Files that entries point to, once each: ``file`` below a campaign's results, ``study`` below
    ``results/reproduction``.
    """
    pointed = [e.ours for e in entries if e.ours.source == source]
    names = [name for o in pointed for name in (o.name, o.against, o.sigma_of.file if o.sigma_of else "")]
    return list(dict.fromkeys(filter(None, names)))


# ---------------------------------------------------------------- file

_Row = Annotated[str, Field(pattern="^(C[0-9]{3}|E[0-9]{2}|FW[0-9]{2})$")]
_Size = Annotated[float, Field(ge=0.0)]
_Several = Annotated[list[Any], BeforeValidator(lambda value: value if isinstance(value, list) else [value])]


def _value(value: Any) -> Any:
    """A number, a word, or two numbers."""
    if isinstance(value, list):
        if len(value) != 2 or not all(map(_is_number, value)) or value[0] >= value[1]:
            raise wrong(f"found {value!r}", "two numbers, the smaller first")
        return float(value[0]), float(value[1])
    return float(value) if _is_number(value) else value


class SigmaOf(Part):
    """Sigmas of another column: those of a mean of independent rows."""

    file: Text
    column: Text


class Ours(Part):
    """Where our number comes from.

    One of `SOURCES` is named: a ``file`` below the campaign's results, a table of a ``study`` below
    ``results/reproduction``, a ``setting`` of the twin, a function of this package (``computed``), parts of
    the project (`NAMES`), or ``none`` with the reason.

    Parameters
    ----------
    where : column of a table -> text or number that its rows must have.
    near : column -> value and how far from it a row may lie.
    column, key : of a table, several are put together; path into a JSON or YAML file.
    over : column or key by whose value the number is divided.
    against, against_where : another file below the results, other rows: the same number of that one is the
        divisor.
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

    file: Text | None = None
    study: Text | None = None
    setting: Text | None = None
    computed: Text | None = None
    rule: _Several = Field(default=[])
    function: _Several = Field(default=[])
    figure: _Several = Field(default=[])
    none: Text | None = None
    where: dict[str, Any] = Field(default={})
    near: dict[str, Annotated[list[float], Field(min_length=2, max_length=2)]] = Field(
        default={}, description="column: [value, how far off]"
    )
    column: _Several = Field(default=[])
    key: _Several = Field(default=[])
    over: str = ""
    against: str = ""
    against_where: dict[str, Any] = Field(default={})
    take: Annotated[str, one_of(TAKES)] = "one"
    times: float = 1.0
    n: str = ""
    sigma: str = ""
    sigma_of: SigmaOf | None = None
    words: dict[str, float] | None = None
    axis: int = 0
    extra: dict[str, Any] | None = Field(default=None, alias="with")

    @property
    def source(self) -> str:
        """Which of `SOURCES` is named."""
        return next(name for name in SOURCES if getattr(self, name))

    @property
    def name(self) -> str:
        """What the source is called."""
        named = getattr(self, self.source)
        return ", ".join(map(str, named)) if isinstance(named, list) else str(named)

    @model_validator(mode="after")
    def _one_number(self) -> Self:
        named = [name for name in SOURCES if getattr(self, name)]
        if len(named) != 1:
            found = f"found {' and '.join(named) or 'no source'}"
            raise wrong(found, f"one of {', '.join(SOURCES)}, with a text")
        if self.source not in ("file", "study"):
            return self
        mistakes, file = [], Path(self.name)
        if file.is_absolute() or ".." in file.parts:
            mistakes.append(wrong(f"found {self.name!r}", "a path below the results", at=(self.source,)))
        pointer = POINTERS.get(file.suffix)
        given = [key for key in ("column", "key", "axis") if key in self.model_fields_set]
        if pointer is None or given != [pointer]:
            found = f"which number of a {file.suffix or 'file'}?"
            mistakes.append(wrong(found, pointer or "another file"))
        if self.sigma == "binomial" and not self.n:
            mistakes.append(wrong("a share without n", "the column of n"))
        refuse(mistakes)
        return self


class Entry(Part):
    """A published number.

    Parameters
    ----------
    rows : items of the project's list that it belongs to, such as C286.
    part : which number of these rows it is; empty if it is the only one.
    where : paper and section or table: P4 6.3.
    quantity : in words.
    printed : as it stands in the text.
    value : number or word that is compared; two for ``inside``; None if there is none.
    unit : of the value.
    half_unit : half a unit of the last printed digit; 0 for words and counts that are exact.
    tolerance : instead of that; 0 if the half unit counts.
    decided : of a misprint, the number that this project takes instead; else NaN.
    kind, rule, basis : see `KINDS`, `RULES`, `BASES`.
    put_in : of a number that this project put in, why it is no finding, see `PUT_IN`; else empty.
    why : reason of the rule; of ``not checkable``, why it cannot be checked.
    ours : where our number comes from.
    note : what a reader of the verdict should know.
    section : heading under which it stands, given by the file.
    """

    rows: Annotated[list[_Row], Field(min_length=1, description="a list such as [C286]")]
    part: Text = ""
    where: Text
    quantity: Text
    printed: Annotated[Text, BeforeValidator(str)]
    value: Annotated[Any, AfterValidator(_value)] = None
    unit: Annotated[str, BeforeValidator(str)] = ""
    half_unit: _Size = 0.0
    tolerance: _Size = 0.0
    decided: float = float("nan")
    kind: Annotated[str, one_of(KINDS)]
    rule: Annotated[str, one_of(RULES)]
    basis: Annotated[str, one_of(BASES)] = ""
    put_in: Annotated[str, one_of(tuple(PUT_IN))] = ""
    why: Text
    ours: Ours
    note: Text = ""
    section: str = ""

    @property
    def name(self) -> str:
        """First row and part: what other entries and functions call it by."""
        return f"{self.rows[0]} {self.part}".strip()

    @model_validator(mode="after")
    def _fits(self) -> Self:
        refuse([*self._value_fits(), *self._basis_fits(), *self._put_in_fits(), *self._rule_fits()])
        return self

    def _rule_fits(self) -> Iterator[PydanticCustomError]:
        if (self.rule == "misprint") != ("decided" in self.model_fields_set):
            yield wrong(f"found {self.decided} for the rule {self.rule!r}", "decided, of misprints alone")
        if self.rule == "open" and not all(row.startswith("FW") for row in self.rows):
            yield wrong(f"found open for {self.rows}", "open for future work (FW) alone", at=("rule",))
        if self.rule in ("waived", "open") and self.ours.source != "none":
            yield wrong(f"found a {self.ours.source}", "none, with a reason", at=("ours",))
        if self.ours.source in NAMES and self.rule != "present":
            yield wrong(f"found the rule {self.rule!r}", f"present: a {self.ours.source} is there or not")

    def _value_fits(self) -> Iterator[PydanticCustomError]:
        found, pair = f"found {self.value!r}", isinstance(self.value, tuple)
        if self.rule == "inside" and not pair:
            yield wrong(found, "two numbers for the rule 'inside'", at=("value",))
        elif self.rule in _NEEDS_VALUE and not pair and not _is_number(self.value):
            yield wrong(found, f"a number for the rule {self.rule!r}", at=("value",))
        elif self.rule == "same word" and not isinstance(self.value, str):
            yield wrong(found, "a word", at=("value",))

    def _basis_fits(self) -> Iterator[PydanticCustomError]:
        if self.rule in _NEEDS_VALUE and not self.basis:
            yield wrong("basis is missing", f"one of: {'; '.join(BASES)}")
        tolerated = "tolerance" in self.model_fields_set
        if (self.basis == "identity" and not tolerated) or (
            tolerated and self.basis not in ("identity", "printed digits")
        ):
            yield wrong(
                "tolerance and basis do not fit",
                "a tolerance with the basis identity, or one that follows from several printed numbers",
            )
        if self.basis in ("printed digits", "sampling error") and "half_unit" not in self.model_fields_set:
            yield wrong("half_unit is missing", "half a unit of the last printed digit")
        if self.basis == "direction" and self.rule not in ("at most", "at least"):
            yield wrong(f"found direction for the rule {self.rule!r}", "at most or at least")
        if self.basis == "sampling error" and not (self.ours.sigma or self.ours.sigma_of):
            yield wrong("no sigma", "a sigma for the basis 'sampling error'", at=("ours",))

    def _put_in_fits(self) -> Iterator[PydanticCustomError]:
        """A number that was put in says so, in the class that its source implies; others must not."""
        given, found = self.put_in, f"found {self.put_in!r}"
        if self.rule in NOT_COMPARED:
            if given:
                expected = "no put_in where nothing is compared"
                yield wrong(f"{found} with the rule {self.rule!r}", expected, at=("put_in",))
            return
        needed = _must_be_put_in(self.ours)
        if not given:
            if needed or self.kind == "input constant":
                because = f"its number comes from {needed[1]}" if needed else "its kind is 'input constant'"
                yield wrong(f"put_in is missing: {because}", f"put_in: {needed[0] if needed else 'setting'}")
        elif needed and given != needed[0]:
            yield wrong(f"{found} for {needed[1]}", f"put_in: {needed[0]}", at=("put_in",))
        elif self.kind not in PUT_IN[given][1]:
            expected = f"one of the kinds {', '.join(PUT_IN[given][1])}"
            yield wrong(f"{found} for the kind {self.kind!r}", expected, at=("put_in",))


class _Table(Part):
    """A published table of an error budget: cells stand in the CSV, ours in the table of `budget_tables`."""

    name: Text
    where: Text
    rows: dict[str, _Row] = Field(description="input of the budget: row of the list")


class _Section(Part):
    title: Text
    entries: list[Entry] = Field(default=[])
    table: _Table | None = None

    @model_validator(mode="after")
    def _holds_something(self) -> Self:
        if not self.entries and self.table is None:
            raise wrong("an empty section", "entries, or a table")
        return self


class _Ledger(Part):
    thalweg_ledger: Literal[1]
    campaign: str = ""
    sections: list[_Section] = Field(min_length=1)

    @field_validator("sections")
    @classmethod
    def _each_once(cls, sections: list[_Section]) -> list[_Section]:
        names: set[str] = set()
        twice = []
        for i, section in enumerate(sections):
            for k, entry in enumerate(section.entries):
                if entry.name in names:
                    found = f"{entry.name!r} stands twice"
                    twice.append(wrong(found, "names that differ", "Give it a part", at=(i, "entries", k)))
                names.add(entry.name)
        refuse(twice)
        return sections


_TRANSLATIONS: Final = (".x", ".y", ".z")


def _cells(section: _Section, folder: Path) -> Iterator[Entry]:
    """Cells of a budget's published table as entries.

    A cell is known to half a unit of its last digit, and so is the sigma that it was computed from: the
    tolerance is the larger of that of the CSV and what the rounding of the sigma does to the cell. A
    translation moves a point by its own sigma in any geometry; all other cells rest on angles and lever arms
    that were fitted to the table.
    """
    if section.table is None:
        return
    name, rows = section.table.name, section.table.rows
    for cell in pd.read_csv(folder / f"{name}.csv").to_dict("records"):
        distance = f"{cell['distance_m']:g}"
        sigma, half = cell["sigma_printed"], cell["sigma_half_unit"]
        by_sigma = cell["half_unit_mm"] + cell["value_mm"] * half / sigma if sigma > 0.0 else 0.0
        yield Entry(
            rows=[rows[str(cell["input"])]],
            part=f"{distance} m",
            where=section.table.where,
            quantity=f"influence of {cell['input']} on a point at {distance} m",
            printed=str(cell["printed"]),
            value=float(cell["value_mm"]),
            unit="mm",
            half_unit=float(cell["half_unit_mm"]),
            tolerance=max(float(cell["tolerance_mm"]), by_sigma),
            kind="exact",
            rule="equal",
            basis="printed digits",
            put_in="definition" if str(cell["input"]).endswith(_TRANSLATIONS) else "fitted",
            why="half a unit or 1 % of the cell, and the rounding of the sigma that it was computed from",
            ours=Ours(
                study=f"budgets/{name}.csv",
                where={"input": str(cell["input"])},
                near={"distance_m": [float(cell["distance_m"]), 0.01]},
                column=["influence_mm"],
            ),
        )


def _must_be_put_in(ours: Ours) -> tuple[str, str] | None:
    """Class of `PUT_IN` that a pointer implies, and its source in words; None where it implies none."""
    if ours.setting:
        return "setting", "a setting of the twin"
    if ours.computed in ALWAYS_PUT_IN:
        return ALWAYS_PUT_IN[ours.computed], f"the function {ours.computed}"
    if any((ours.name, column) in FITTED for column in ours.column) and ours.take != "count":
        return "fitted", f"{ours.name}, column {ours.column[0]}"
    return None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))
