"""Published numbers beside those of this pipeline on the digital twin; verdicts.

What each verdict says stands in `MEANINGS`. It follows from the rule, basis, ``put_in`` and source that an
entry declares and from the number found, never from the row itself. A tolerance is half a unit of the last
printed digit, in some rules and three sigmas of our own number, never what would make a number fit.

Some printed numbers are compared in several quantities (the sigma of a parameter by the image alone and in
all). `distinct` has them once, with the weakest of their verdicts.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import yaml

from thalweg.budgets import read_budget, rmse_mm
from thalweg.core import ROOT, ArrayF, InputError, read_parquet
from thalweg.core.geometry import read_mesh
from thalweg.lightsheet.budget import SIGMA_LINE_PX, TOTAL, TOTAL_CORRELATED, budget_on_lines, budget_table
from thalweg.lightsheet.calibration import SINGULAR
from thalweg.lightsheet.optics import (
    PARAMETERS,
    LightSheet,
    Sensor,
    Window,
    depth_lines,
    intersect,
    measurement_volume,
    paper_3,
    paper_4,
    refract,
    refract_to_water,
    refractive_index,
)
from thalweg_lab.multi_line import Kind, NominalDiode, line_model
from thalweg_lab.reproduction.files import BY_ARITHMETIC, CLASSES, NAMES, NOT_COMPARED, PUT_IN, Entry, Ours
from thalweg_lab.reproduction.paper_models import (
    PAPER_3,
    calibration_rows,
    halved,
    paper_3_sigmas,
    paper_3_table,
    plane_error_mm,
    pose_source_table,
    refract_as_printed,
)

NOT_MATCHED: Final = "not matched"
REPRODUCED: Final = "reproduced"
BELOW: Final = "below a bound"
ABOVE: Final = "above a bound"
BY_DEFINITION: Final = "by definition"
THERE: Final = "there"
INPUT: Final = "input"
NO_RESULT: Final = "no result yet"
NOT_REPRODUCIBLE: Final = "not reproducible"
WAIVED: Final = "waived"
OPEN: Final = "open"
MEANINGS: Final = {
    NOT_MATCHED: "our number misses its rule, by the amount told, or the figure or part is not there",
    REPRODUCED: "a measurement or computation gave the printed number, or the order of two numbers that the "
    "text states, and could have given another",
    BELOW: "the print is an upper bound, and our number is the share of it that is told: a twin that lacks "
    "what spoiled the experiment meets it easily",
    ABOVE: "the same of a lower bound",
    BY_DEFINITION: "true by arithmetic of printed numbers or by our own definitions; no measurement could "
    "make it false",
    THERE: "no number is printed: a figure or procedure of that kind exists, which says nothing of how good "
    "it is",
    INPUT: "put into the twin, a constant of a stored instrument, or fitted to the number or its neighbours; "
    "it confirms nothing",
    NO_RESULT: "the campaign or study that gives our number was not run here; the reason has the command",
    NOT_REPRODUCIBLE: "the original data are not published, nothing here takes the number, or published "
    "numbers contradict each other",
    WAIVED: "nothing that software could show: photographs of hardware, slips of words",
    OPEN: "an idea for future work that is not done",
}
"""What each verdict says; misses first, as in counts and on pages."""
VERDICTS: Final = tuple(MEANINGS)
WEAKEST_FIRST: Final = (
    *(NOT_MATCHED, NO_RESULT, NOT_REPRODUCIBLE, WAIVED, OPEN, INPUT, BY_DEFINITION, THERE, ABOVE, BELOW),
    REPRODUCED,
)
"""Which verdict counts for a printed number that is compared in several quantities."""
COULD_FAIL: Final = "could have failed"
FAILED: Final = "of these failed"
FAR_BELOW: Final = 1.0 / 3.0
"""Share of a bound that an error-free twin would meet as well: the match says little."""
SAMPLING_SIGMAS: Final = 3.0
"""Sigmas of our own number that the basis ``sampling error`` adds: one of 370 normal numbers lies beyond."""
DIRECTION_SIGMAS: Final = 2.0
"""Sigmas by which a number must lie on the side that the text states; within them it says nothing."""
NO_SIGMA: Final = "the number has no sigma, or is none"
VERDICTS_NOTE: Final = "; ".join(f"*{verdict}*: {meaning}" for verdict, meaning in MEANINGS.items()) + "."
"""What the verdicts mean, for pages."""
COLUMNS: Final = (
    "rows",
    "name",
    "section",
    "where",
    "quantity",
    "printed",
    "value",
    "unit",
    "half_unit",
    "kind",
    "rule",
    "basis",
    "put_in",
    "ours",
    "sigma",
    "n",
    "difference",
    "tolerance",
    "missed_by",
    "of_bound",
    "verdict",
    "reason",
    "command",
    "source",
    "note",
    "file",
)
_AS_WRITTEN: Final = (
    "name", "section", "where", "quantity", "printed", "unit", "kind", "rule", "basis", "put_in", "note",
)  # fmt: skip
BUDGETS: Final = ROOT / "resources" / "budgets"
HALVING_STEP_PX: Final = 16
"""Every so many-th pixel is intersected by the halving of the papers."""
OFF_MM: Final = 1e-3
SKEW_MM: Final = 1e-9
Published = Mapping[str, Any]

MM_PER_M: Final = 1000.0
SPREADS: Final = ("binomial", "scatter", "unit")
"""Sigmas that are no column, see `thalweg_lab.reproduction.files.Ours`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """Our number: ``value`` a number or word, None if there is none, and then ``absent`` says why and
    ``command`` what makes it; ``sigma`` and ``n`` where the result has them; ``file`` that it was read from.
    """

    value: float | str | None = None
    sigma: float = float("nan")
    n: float = float("nan")
    absent: str = ""
    command: str = ""
    file: str = ""


@dataclass(slots=True)
class Results:
    """Files that the ledger may read, each read once.

    Parameters
    ----------
    files : path below the campaign's results -> file.
    studies : path below ``results/reproduction`` -> file.
    settings : section ``twin.light_sheet`` of the campaign, as plain values; None for a campaign that is no
        twin. Of several campaigns, all their sections by the names of the campaigns.
    records : what takes the place of a file that is not there: a recorded table or tree, and its file.
    parts : rules, functions and figures of the project by `thalweg_lab.reproduction.files.NAMES`.
    """

    files: Mapping[str, Path]
    studies: Mapping[str, Path]
    settings: Mapping[str, Any] | None
    records: Mapping[str, tuple[Any, Path]] = field(default_factory=dict)
    parts: Mapping[str, Callable[[str], bool]] = field(default_factory=dict)
    _read: dict[Path, Any] = field(default_factory=dict)

    def find(self, ours: Ours) -> Found:
        """The number of a pointer to a file, a study or a setting.

        Raises
        ------
        InputError : a file that cannot be read at all.
        """
        if ours.source == "none":
            return Found(absent=ours.name)
        if ours.source == "setting":
            return _setting(self.settings, ours)
        if ours.source in NAMES:
            return self._parts(ours)
        found = self._in_file(ours, ours.name)
        if ours.sigma_of and found.value is not None:
            of = ours.sigma_of
            mean: dict[str, Any] = {ours.source: of.file, "column": [of.column], "take": "mean error"}
            spread = self._in_file(Ours.model_construct(**mean), of.file)
            found = replace(found, sigma=spread.value if isinstance(spread.value, float) else float("nan"))
        if not (ours.against or ours.against_where) or not isinstance(found.value, float):
            return found
        other = ours.model_copy(update={"where": ours.against_where or ours.where})
        divisor = self._in_file(other, ours.against or ours.name)
        if not isinstance(divisor.value, float):
            return divisor
        return Found(value=found.value / divisor.value, file=found.file)

    def _in_file(self, ours: Ours, name: str) -> Found:
        path = (self.files if ours.source == "file" else self.studies).get(name)
        here = path is not None and path.is_file()
        if path is not None and here:
            if path not in self._read:
                self._read[path] = _content(path)
            content = self._read[path]
        elif name in self.records:
            content, path = self.records[name]
        else:
            return Found(absent=f"{name} is not there", command=self._command(ours.source, name))
        try:
            if ours.axis:
                found = Found(value=float(np.sort(np.ptp(content, axis=0))[-ours.axis]) * ours.times)
            elif isinstance(content, pd.DataFrame):
                found = _of_table(content, ours)
            else:
                found = _of_tree(content, ours)
        except _AbsentError as absent:
            command = "" if here else self._command(ours.source, name)
            return Found(absent=f"{name if here else path}: {absent}", command=command)
        return replace(found, file=path.as_posix())

    def _command(self, source: str, name: str) -> str:
        """What makes a file; nothing for one that this campaign does not make."""
        if source == "study":
            return f"snakemake results/reproduction/{name}"
        return f"snakemake --config campaign={name.split('/')[0]}" if self.parts else ""

    def _parts(self, ours: Ours) -> Found:
        names = ours.name.split(", ")
        is_there = self.parts.get(ours.source)
        absent = [name for name in names if is_there is None or not is_there(name)]
        if absent:
            return Found(absent=f"no {ours.source} {' and '.join(absent)}")
        return Found(value="there", file=f"{ours.source} {ours.name}")


# ---------------------------------------------------------------- ledger


def judged(
    entries: Sequence[Entry], results: Results, functions: Mapping[str, Callable[..., Found]] | None = None
) -> pd.DataFrame:
    """A row for each entry, see `COLUMNS`.

    ``functions`` are what entries may name as ``computed``; `FUNCTIONS` if not given.

    ``missed_by`` is signed: above zero where our number is too large. ``of_bound`` is our number over the
    printed one, for the rules ``at most`` and ``at least``. ``reason`` says why the rule is what it is, why a
    number cannot be checked, or what is absent.

    Raises
    ------
    InputError : a result cannot be read, or an entry names a function that does not exist.
    """
    known = FUNCTIONS if functions is None else functions
    unknown = [
        f"{e.name}: {e.ours.name}"
        for e in entries
        if e.ours.source == "computed" and e.ours.name not in known
    ]
    if unknown:
        raise InputError(
            f"no such functions: {', '.join(unknown)}", where="ledger", expected=f"one of {', '.join(known)}"
        )
    published = {e.name: e.value for e in entries if e.value is not None}
    rows = [
        _row(
            e,
            known[e.ours.name](published, **dict(e.ours.extra or {}))
            if e.ours.source == "computed"
            else results.find(e.ours),
        )
        for e in entries
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def verdict_of(entry: Entry, found: Found) -> tuple[str, float, float]:
    """Verdict, tolerance and the signed amount beyond it; NaN where there is none.

    A number on the border itself is inside: 1e-9 of the value is left to rounding.
    """
    nan = float("nan")
    if entry.rule in (WAIVED, OPEN):
        return entry.rule, nan, nan
    if entry.rule == "not checkable":
        return NOT_REPRODUCIBLE, nan, nan
    if found.value is None:
        return (NOT_MATCHED if entry.ours.source in NAMES else NO_RESULT), nan, nan
    if entry.rule == "present":
        return THERE, nan, nan
    if entry.rule == "same word":
        return (_met(entry) if found.value == entry.value else NOT_MATCHED), nan, nan
    if isinstance(found.value, str) or not np.isfinite(found.value):
        return NO_RESULT, nan, nan
    low, high = _bounds(entry)
    if entry.rule == "misprint" and isinstance(entry.value, float):
        right = abs(found.value - entry.decided) <= entry.half_unit + 1e-9 * abs(entry.decided)
        as_printed = abs(found.value - entry.value) <= entry.half_unit
        # what lies apart is that from the number that was decided on
        return (
            (_met(entry), entry.half_unit, nan)
            if right and not as_printed
            else (NOT_MATCHED, entry.half_unit, found.value - entry.decided)
        )
    tolerance = entry.tolerance if entry.basis == "identity" or entry.tolerance else entry.half_unit
    if entry.basis == "sampling error":
        if not np.isfinite(found.sigma):
            return NO_RESULT, nan, nan
        tolerance += SAMPLING_SIGMAS * found.sigma
    if entry.basis == "direction" and np.isfinite(found.sigma):
        tolerance = -DIRECTION_SIGMAS * found.sigma
    rounding = 1e-9 * max(abs(b) for b in (low, high) if np.isfinite(b))
    above, below = found.value - (high + tolerance), (low - tolerance) - found.value
    if max(above, below) <= rounding:
        return _met(entry), tolerance, nan
    return NOT_MATCHED, tolerance, above if above > rounding else -below


def _met(entry: Entry) -> str:
    """Verdict of an entry whose rule is met."""
    if entry.put_in:
        return BY_DEFINITION if entry.put_in in BY_ARITHMETIC else INPUT
    if entry.basis == "direction":
        return REPRODUCED
    return {"at most": BELOW, "at least": ABOVE}.get(entry.rule, REPRODUCED)


def could_fail(table: pd.DataFrame) -> "pd.Series[bool]":
    """Rows of a table of `judged` with a number that was not put in and has a result to compare."""
    compared = ~table["rule"].isin(NOT_COMPARED) & (table["put_in"].fillna("") == "")
    return compared & table["verdict"].isin([NOT_MATCHED, REPRODUCED, BELOW, ABOVE])


def distinct(table: pd.DataFrame) -> pd.DataFrame:
    """Rows of a table of `judged`, one for each printed number: that of its weakest verdict.

    A printed number is an item of the project's list (the first of ``rows``), its text and its value. Of
    equal verdicts the one nearest to its bound stands.
    """
    names = ["_item", "_printed", "_value"]
    keyed = table.assign(
        _item=table["rows"].str.split().str[0],
        _printed=table["printed"].astype(str),
        _value=table["value"].astype(str),
        _weak=table["verdict"].map(WEAKEST_FIRST.index),
        _near=-table["of_bound"].fillna(0.0),
    )
    first = keyed.sort_values(["_weak", "_near"], kind="stable").drop_duplicates(names)
    return table.loc[first.index.sort_values()]


def count(table: pd.DataFrame) -> dict[str, int]:
    """Rows of a table of `judged` by verdict, in the order of `VERDICTS`."""
    return {verdict: int((table["verdict"] == verdict).sum()) for verdict in VERDICTS}


def counts(table: pd.DataFrame) -> pd.DataFrame:
    """How many numbers have which verdict, to be quoted.

    Returns
    -------
    Columns ``what, distinct, entries``: all; those that could have failed by a number, and that did; each
    verdict; numbers below a third of their bound. ``distinct`` counts printed numbers, ``entries`` the
    quantities that are compared with them.
    """
    found = {}
    for name, part in (("distinct", distinct(table)), ("entries", table)):
        free = could_fail(part)
        failed = int((part.loc[free, "verdict"] == NOT_MATCHED).sum())
        found[name] = {"all": len(part), COULD_FAIL: int(free.sum()), FAILED: failed}
        found[name] |= count(part) | {"below a third of a bound": int(_far_below(part).sum())}
    return pd.DataFrame(found).rename_axis(index="what").reset_index()


def _far_below(table: pd.DataFrame) -> "pd.Series[bool]":
    return (table["verdict"] == BELOW) & (table["of_bound"] < FAR_BELOW)


def sentence(table: pd.DataFrame) -> str:
    """How many rows could have failed by a number, how many did, and what all others are.

    Examples
    --------
    >>> words = sentence(
    ...     pd.DataFrame(
    ...         {
    ...             "rule": ["equal", "at most", "at most", "equal", "present"],
    ...             "put_in": ["", "", "", "setting", ""],
    ...             "verdict": ["reproduced", "below a bound", "not matched", "input", "there"],
    ...             "of_bound": [float("nan"), 0.2, 1.5, float("nan"), float("nan")],
    ...         }
    ...     )
    ... )
    >>> words.split(". ")[1]
    'The others: 1 there, 1 input'
    >>> words.split(", ")[:2]
    ['3 of 5 could have failed by a number: 1 did', '1 are reproduced']
    """
    free = could_fail(table)
    able = count(table[free])
    far = int(_far_below(table).sum())
    told = [f"{free.sum()} of {len(table)} could have failed by a number: {able.pop(NOT_MATCHED)} did"]
    told += [
        f"{n} are {verdict}" + f" ({far} of them below a third of it)" * (verdict == BELOW and far > 0)
        for verdict, n in able.items()
        if n
    ]
    differs = " (put in otherwise, or printed numbers that contradict each other)"
    others = [
        f"{n} {verdict}" + differs * (verdict == NOT_MATCHED)
        for verdict, n in count(table[~free]).items()
        if n
    ]
    return ", ".join(told) + f". The others: {', '.join(others)}" * bool(others)


def missing_words(table: pd.DataFrame) -> list[str]:
    """What was not run: which command gives how many rows a result, that for most of them first."""
    waiting = table.loc[(table["verdict"] == NO_RESULT) & (table["command"].fillna("") != ""), "command"]
    return [f"{command} for {n} row{'s' * (n > 1)}" for command, n in waiting.value_counts().items()]


def summary(table: pd.DataFrame) -> str:
    """Counts of the entries in one sentence, without those that are zero.

    Examples
    --------
    >>> summary(pd.DataFrame({"verdict": ["reproduced", "not matched", "not matched"]}))
    '3 entries: 2 not matched, 1 reproduced'
    """
    parts = [f"{n} {word}" for word, n in count(table).items() if n]
    return f"{len(table)} entr{'y' if len(table) == 1 else 'ies'}: " + ", ".join(parts)


def by_class(table: pd.DataFrame) -> pd.DataFrame:
    """Rows by verdict (lines) and class (columns); below them all, those that could have failed, and did."""
    free = could_fail(table)
    classes = table["kind"].map(CLASSES)
    lines = {verdict: table["verdict"] == verdict for verdict in VERDICTS}
    lines |= {"all": table["verdict"] != "", COULD_FAIL: free, FAILED: free & lines[NOT_MATCHED]}
    found = pd.DataFrame({line: classes[rows].value_counts() for line, rows in lines.items()}).T
    found = found.reindex(columns=sorted(CLASSES.values())).fillna(0).astype(int)
    return found.assign(all=found.sum(axis=1)).rename_axis(index="verdict").reset_index()


def markdown(table: pd.DataFrame, *, title: str, twin: bool) -> str:
    """The ledger as a page to read: a table for each section, then all that was missed or is absent."""
    lines = [f"# Published numbers beside {title}", ""]
    if twin:
        lines += [
            "Numbers in the column *ours* were measured on the **digital twin**, or computed from the stored "
            "prototypes and from printed numbers; none comes from a real instrument.",
            "",
        ]
    lines += [
        f"Of printed numbers, each counted once, {sentence(distinct(table))}.",
        "",
        *_grid(counts(table).query("entries > 0")),
        "",
        *(f"- *{verdict}*: {meaning}" for verdict, meaning in MEANINGS.items()),
        "",
        "A printed number that is compared in several quantities is counted once, with the weakest verdict.",
        "",
        f"By class of number, {summary(table)}:",
        "",
        *_grid(by_class(table)),
        "",
        "Tolerances: *printed digits*, half a unit of the last printed digit; *sampling error*, that and "
        "three sigmas of our number; *goal*, a bound with half a unit; *direction*, which of two is larger; "
        "*identity*, the arithmetic of float64. A number is *off by* what lies beyond its tolerance, above "
        "zero where ours is larger.",
    ]
    for section in dict.fromkeys(table["section"]):
        part = table[table["section"] == section]
        lines += ["", f"## {section}", "", summary(part) + ".", ""]
        lines += _grid(readable(part))
    for verdict, head in (
        (NOT_MATCHED, "Not matched"),
        (NO_RESULT, "No result yet"),
        (NOT_REPRODUCIBLE, "Not reproducible, and why"),
    ):
        part = table[table["verdict"] == verdict]
        if not len(part):
            continue
        lines += ["", f"## {head}", ""]
        for row in part.to_dict("records"):
            amount = f"{verdict_words(row)}; " * (verdict == NOT_MATCHED)
            lines.append(f"- {row['name']}, {row['quantity']}: {amount}{why_words(row)}.")
    return "\n".join(lines) + "\n"


def readable(table: pd.DataFrame) -> pd.DataFrame:
    """Columns to read: rows, where, quantity, printed, rule, ours, verdict, why."""
    names = ["rows", "where", "quantity", "printed", "rule", "ours", "verdict", "why"]
    return pd.DataFrame(
        [
            [
                *(row[n] for n in names[:4]),
                *(f(row) for f in (rule_words, ours_words, verdict_words, why_words)),
            ]
            for row in table.to_dict("records")
        ],
        columns=names,
    )


def rule_words(row: Mapping[Any, Any]) -> str:
    """Rule and basis: ``equal, printed digits``."""
    return f"{row['rule']}, {row['basis']}" if row["basis"] else str(row["rule"])


def ours_words(row: Mapping[Any, Any]) -> str:
    """Our number with unit, sigma and n; a word as it is. A CSV that holds both gives numbers as text."""
    raw = row["ours"]
    if raw is None or raw == "" or (isinstance(raw, float) and np.isnan(raw)):
        return ""
    try:
        value = float(raw)
    except ValueError:
        return str(raw)
    sigma, n = float(row["sigma"]), float(row["n"])
    unit = "" if row["unit"] in ("", "1") else f" {row['unit']}"
    told = f"{value:.4g}" + (f" +- {sigma:.2g}" if np.isfinite(sigma) else "") + unit
    return told + (f", n = {n:.0f}" if np.isfinite(n) else "")


def verdict_words(row: Mapping[Any, Any]) -> str:
    """Verdict, with why a number was put in, its share of the bound, or by how much it is off."""
    verdict, amount = str(row["verdict"]), row["missed_by"]
    if verdict in (INPUT, BY_DEFINITION):
        return f"{verdict}: {PUT_IN[row['put_in']][0]}"
    if verdict in (BELOW, ABOVE) and np.isfinite(row["of_bound"]):
        return f"{verdict}: {100.0 * row['of_bound']:.3g} % of it"
    if verdict != NOT_MATCHED or not np.isfinite(amount):
        return verdict
    unit = "" if row["unit"] in ("", "1") else f" {row['unit']}"
    put_in = f"; put in: {PUT_IN[row['put_in']][0]}" if row["put_in"] else ""
    return f"{verdict}: off by {amount:+.3g}{unit}{put_in}"


def why_words(row: Mapping[Any, Any]) -> str:
    """Reason of the rule, or what is absent and the command that makes it; what a reader should know."""
    told = (row["reason"], row["command"], row["note"])
    return "; ".join(text.rstrip(".") for text in told if isinstance(text, str) and text)


def _grid(table: pd.DataFrame) -> list[str]:
    """A table in Markdown; bars inside cells would part them."""
    rows = [list(table.columns), ["---"] * table.shape[1], *table.astype(str).to_numpy().tolist()]
    return ["| " + " | ".join(str(cell).replace("|", "/") for cell in row) + " |" for row in rows]


def _bounds(entry: Entry) -> tuple[float, float]:
    value = entry.value
    if isinstance(value, tuple):
        return value
    number = float(value) if isinstance(value, float | int) else float("nan")
    return {"at most": (-np.inf, number), "at least": (number, np.inf)}.get(entry.rule, (number, number))


def _row(entry: Entry, found: Found) -> dict[str, Any]:
    verdict, tolerance, missed_by = verdict_of(entry, found)
    value = entry.value
    numbers = isinstance(value, float) and isinstance(found.value, float)
    bound = value if isinstance(value, float) and entry.rule in ("at most", "at least") else 0.0
    pair = isinstance(value, tuple)
    return {
        **{key: getattr(entry, key) for key in _AS_WRITTEN},
        "rows": " ".join(entry.rows),
        "value": f"{value[0]:g} to {value[1]:g}" if isinstance(value, tuple) else value,
        "half_unit": entry.half_unit if numbers or pair else float("nan"),
        "ours": found.value,
        "sigma": found.sigma,
        "n": found.n,
        "difference": found.value - value
        if isinstance(value, float) and isinstance(found.value, float)
        else float("nan"),
        "tolerance": tolerance,
        "missed_by": missed_by,
        "of_bound": found.value / bound if bound and isinstance(found.value, float) else float("nan"),
        "verdict": verdict,
        "reason": _reason(entry, found, verdict),
        "command": found.command if verdict == NO_RESULT else "",
        "source": _source(entry),
        "file": found.file,
    }


def _reason(entry: Entry, found: Found, verdict: str) -> str:
    if verdict == NO_RESULT:
        return found.absent or NO_SIGMA
    told = [found.absent, entry.why] if entry.ours.source in ("none", *NAMES) else [entry.why]
    return "; ".join(dict.fromkeys(filter(None, told)))


def _source(entry: Entry) -> str:
    ours = entry.ours
    if ours.source == "none":
        return ""
    if ours.source == "setting":
        return f"setting {ours.name}"
    if ours.source == "computed":
        return f"computed: {ours.name}"
    if ours.source in NAMES:
        return f"{ours.source}: {ours.name}"
    at = " and ".join(filter(None, ours.column)) or _dotted(ours.key) or "extent"
    rows = ", ".join(
        [*(f"{k} = {v}" for k, v in ours.where.items()), *(f"{k} ~ {v[0]:g}" for k, v in ours.near.items())]
    )
    base = "reproduction/" if ours.source == "study" else ""
    return f"{base}{ours.name}: {ours.take + ' of ' if ours.take != 'one' else ''}{at}" + (
        f" ({rows})" if rows else ""
    )


# ---------------------------------------------------------------- numbers of the ledger that need no
# campaign: optics, the stored prototypes, arithmetic of printed numbers
#
# Each function takes the published numbers by the names of their entries, so that nothing printed is typed in
# here, and the arguments of its entry (``with:``).


def bends(published: Published, *, about_y_deg: float, about_x_deg: float) -> Found:
    """How often the line of a tilted sheet on a plane in the water changes the side to which it bends.

    A fan along y, first turned about the y axis and then about the x axis (P3 Fig. 1, P4 Fig. 1).
    """
    window = Window(thickness_mm=5.0, n_glass=1.52, n_water=1.335)
    angles = np.deg2rad([about_x_deg, about_y_deg, 90.0])
    sheet = LightSheet(
        origin_lcs_mm=np.array([0.0, 0.0, 70.0]), angles_rad=angles, half_angle_rad=np.deg2rad(32.0)
    )
    a = np.linspace(-sheet.half_angle_rad, sheet.half_angle_rad, 401)
    d = np.diff(refract_to_water(sheet.origin_lcs_mm, sheet.beams(a), window).at_depth(100.0)[:, :2], axis=0)
    turn = d[:-1, 0] * d[1:, 1] - d[:-1, 1] * d[1:, 0]
    # relative to the largest: a straight line would turn by rounding alone
    sides = np.sign(turn[np.abs(turn) > 1e-9 * np.abs(turn).max()])
    return Found(value=float((np.diff(sides) != 0).sum()), n=float(len(a)))


def snell(published: Published) -> Found:
    """Largest |n_1 sin t_1 - n_2 sin t_2| of vector Snell, air to glass to water, up to 89 degrees."""
    t = np.deg2rad(np.linspace(0.0, 89.0, 2001))
    d, N = np.stack([np.sin(t), 0 * t, -np.cos(t)], axis=1), np.array([0.0, 0.0, 1.0])
    worst = 0.0
    for n_1, n_2 in ((1.0, 1.52), (1.52, 1.335)):
        out, lost = refract(d, N, n_1, n_2)
        sines = [np.linalg.norm(np.cross(v, N), axis=1) for v in (d, out)]
        worst = max(worst, float(np.abs(n_1 * sines[0] - n_2 * sines[1])[~lost].max()))
    return Found(value=worst, n=float(2 * len(t)))


def printed_snell(published: Published, *, angle_deg: float) -> Found:
    """Length of the refracted unit vector by the root as P3 and P4 print it, air to glass."""
    t = np.deg2rad(angle_deg)
    v = refract_as_printed(np.array([[np.sin(t), 0.0, -np.cos(t)]]), np.array([0.0, 0.0, 1.0]), 1.0, 1.52)
    return Found(value=float(np.linalg.norm(v)))


@cache
def _halved() -> tuple[ArrayF, ArrayF]:
    """Distances (n,) of points by halving from exact ones, and what the halving left between the rays."""
    sensor = paper_4()
    side = np.arange(0.5, sensor.camera.size_px[0], HALVING_STEP_PX)
    xy = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    exact = intersect(sensor, xy)
    xyz, skew = halved(sensor, xy[exact.ok], SKEW_MM)
    return np.linalg.norm(xyz - exact.xyz_lcs_mm[exact.ok], axis=1), skew


def halving_where_it_ends(published: Published) -> Found:
    """Largest distance of points by halving from exact ones, where the halving meets its threshold."""
    off, skew = _halved()
    return Found(value=float(off[skew <= SKEW_MM].max()), n=float((skew <= SKEW_MM).sum()))


def halving_misses(published: Published) -> Found:
    """Percent of the pixels whose point by halving lies more than a micrometre from the exact one."""
    off, _ = _halved()
    return Found(value=100.0 * float((off > OFF_MM).mean()), n=float(len(off)))


def volume(published: Published, *, paper: int, side: str, unit_mm: float = 1.0) -> Found:
    """A side of the measurement volume: least and largest depth from the dry face of the window for P3
    (whose origin lies there), below its wet face for P4; widths along and across the base for P4.
    """
    sensor = _paper(paper)
    found = measurement_volume(sensor)
    glass = sensor.window.thickness_mm if paper == 3 else 0.0
    size_mm = {
        "least depth": found.depth_mm[0] + glass,
        "largest depth": found.depth_mm[1] + glass,
        "x": float(found.size_mm[0]),
        "y": float(found.size_mm[1]),
    }[side]
    return Found(value=size_mm / unit_mm)


def seeing_pixels(published: Published, *, paper: int) -> Found:
    """Percent of the pixels that see the sheet in the water."""
    return Found(value=100.0 * measurement_volume(_paper(paper)).share)


def depth_lines_seen(published: Published, *, depths_mm: list[float]) -> Found:
    """How many lines of equal depth are in the picture, counted as long as they lie right to left."""
    middles = [np.median(line.xy_px[:, 0]) for line in depth_lines(paper_4(), depths_mm) if len(line.xy_px)]
    ordered = 1 + int(np.cumprod(np.diff(middles) < 0).sum()) if middles else 0
    return Found(value=float(ordered))


def table_1_of_p3(published: Published, *, what: str) -> Found:
    """A value of P3 Table 1, out of the stored prototype in our own frame."""
    sensor = paper_3()
    values = dict(zip(PAPER_3, paper_3_table(sensor.vector()).tolist(), strict=True))
    # frame of P3 has Z downwards, its fan lies along y
    values |= {
        "laser x": float(sensor.sheet.origin_lcs_mm[0]),
        "laser y": float(sensor.sheet.origin_lcs_mm[1]),
        "laser omega": float(np.rad2deg(sensor.sheet.angles_rad[0])),
        "laser kappa": 90.0 - float(np.rad2deg(sensor.sheet.angles_rad[2])),
    }
    return Found(value=values[what])


@cache
def _calibrated_p3() -> dict[str, float]:
    """Sigmas of P3 Table 1 by its own plan: 8 pairs, 152 line points, levels 75 and 129 mm, lines of 0.15 px
    and ends of pieces measured by hand to one pixel.
    """
    sensor = paper_3()
    names = ("laser_z_mm", "laser_phi_rad", *PARAMETERS[:6])
    J = calibration_rows(sensor, (75.0, 129.0), names, points=(100, 52), pairs=8)
    cov = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    at = [PARAMETERS.index(name) for name in names]
    cov[np.ix_(at, at)] = np.linalg.inv(J.T @ J)
    return paper_3_sigmas(sensor.vector(), cov)


def sigma_of_p3(published: Published, *, what: str) -> Found:
    """A sigma of P3 Table 1, predicted from its own plan of observations."""
    return Found(value=_calibrated_p3()[what], n=168.0)


def rank_defect(published: Published, *, paper: int) -> Found:
    """Unknowns of a published calibration that its observations leave free.

    P3: laser z, phi, kappa and six of the camera. P4: six of the laser.
    """
    sensor = _paper(paper)
    levels = (75.0, 129.0) if paper == 3 else (60.0, 150.0)
    names = (
        ("laser_z_mm", "laser_phi_rad", "laser_kappa_rad", *PARAMETERS[:6])
        if paper == 3
        else PARAMETERS[15:21]
    )
    J = calibration_rows(sensor, levels, names)
    values = np.linalg.svd(J / np.linalg.norm(J, axis=0), compute_uv=False)
    return Found(value=float((values <= SINGULAR).sum()))


def base(published: Published, *, paper: int) -> Found:
    """Distance of camera and laser, mm."""
    sensor = _paper(paper)
    return Found(value=float(np.linalg.norm(sensor.camera_origin_lcs_mm - sensor.sheet.origin_lcs_mm)))


def picture_px(published: Published, *, paper: int, axis: int) -> Found:
    """Size of the picture along x (0) or y (1), px."""
    return Found(value=float(_paper(paper).camera.size_px[axis]))


def picture_mm(published: Published, *, paper: int, axis: int) -> Found:
    """Size of the sensor of the camera: pixels times the principal distance in mm over that in px."""
    camera = _paper(paper).camera
    c_mm = float(published["C279 lens" if paper == 3 else "C228"])
    return Found(value=camera.size_px[axis] * c_mm / float(camera.parameters[0]))


def principal_distance(published: Published) -> Found:
    """Of the prototype of P4, mm: in pixels times the published pixel."""
    return Found(value=float(paper_4().camera.parameters[0]) * float(published["C227"]) * 1e-3)


def opening(published: Published, *, paper: int) -> Found:
    """Angle of the fan, degrees."""
    return Found(value=2.0 * float(np.rad2deg(_paper(paper).sheet.half_angle_rad)))


def pixel_on_plane(published: Published, *, depth_mm: float, longest: bool) -> Found:
    """Longer or shorter step between neighbouring pixels on a level plane, in mid-fan at a depth, mm."""
    sensor = paper_4()
    (line,) = depth_lines(sensor, [depth_mm])
    middle = line.xy_px[int(np.abs(line.fan_angle_rad).argmin())]
    xy = middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    rays = sensor.camera.rays(xy) @ sensor.R_lcs_ccs.T
    water = refract_to_water(sensor.camera_origin_lcs_mm, rays, sensor.window)
    plane = water.at_depth(depth_mm)
    sides = np.sort(np.linalg.norm(plane[1:] - plane[0], axis=1))
    return Found(value=float(sides[1 if longest else 0]))


@cache
def _budget_to(depth_mm: float) -> pd.DataFrame:
    depths = np.linspace(50.0, depth_mm, 5)
    return budget_table(budget_on_lines(paper_4(), depths_mm=depths.tolist()))


def total_to(published: Published, *, depth_mm: float, bound: str) -> Found:
    """Least or largest sigma of the depth from 50 mm to a depth, correlations left out, mm."""
    table = _budget_to(depth_mm)
    total = table[table["cause"] == TOTAL]
    return Found(value=float(total["least_mm"].min() if bound == "least" else total["most_mm"].max()))


def shrinking_causes(published: Published) -> Found:
    """Causes whose largest sigma of the depth does not grow from 50 over 125 to 200 mm."""
    most = _p4_budget_table().pivot(index="cause", columns="depth_mm", values="most_mm")
    steps = np.diff(most.drop(index=[TOTAL, TOTAL_CORRELATED]).to_numpy(), axis=1)
    return Found(value=float((steps <= 0.0).any(axis=1).sum()), n=float(len(steps)))


def least_in_centre(published: Published, *, causes: list[str]) -> Found:
    """Lines of equal depth (three for each cause) on which a sigma is least nearer to the picture's centre
    than where it is largest.
    """
    sensor = paper_4()
    lines = budget_on_lines(sensor)
    falls = []
    for _, line in lines[lines["cause"].isin(causes)].groupby(["cause", "depth_mm"]):
        # along the longer side of the line in the picture
        axis = int(np.ptp(line["y_px"]) >= np.ptp(line["x_px"]))
        half = 0.5 * sensor.camera.size_px[axis]
        off = (line[["x_px", "y_px"][axis]] - half).abs().to_numpy()
        sigma = line["sigma_depth_mm"].to_numpy()
        falls.append(off[np.nanargmin(sigma)] < off[np.nanargmax(sigma)])
    return Found(value=float(sum(falls)), n=float(len(falls)))


def published_budget(published: Published, *, cause: str, bound: str = "most") -> Found:
    """Least or largest sigma of the depth by one cause or several, in P4's stored prototype, mm."""
    table = _p4_budget_table()
    figures = table.loc[table["cause"].isin(cause.split(" or ")), f"{bound}_mm"]
    return Found(value=float(figures.max() if bound == "most" else figures.min()))


def budget_causes(published: Published) -> Found:
    """How many causes the budget of P4's stored prototype has."""
    return Found(value=float(_p4_budget_table()["cause"].nunique()))


def line_sigma(published: Published) -> Found:
    """Sigma of the line that the budget takes, px."""
    return Found(value=SIGMA_LINE_PX[0])


def plane_leaves(published: Published) -> Found:
    """Largest error in depth of a plane fitted to the sheet of P4's stored prototype, mm."""
    return Found(value=plane_error_mm(paper_4(), (40.0, 80.0, 125.0, 170.0, 220.0)))


@cache
def _p4_budget_table() -> pd.DataFrame:
    return budget_table(budget_on_lines(paper_4()))


def index_change(published: Published, *, low_c: float, high_c: float, wavelength_nm: float) -> Found:
    """Change of the water's refractive index between two temperatures (IAPWS)."""
    low, high = (refractive_index.water(wavelength_nm, t) for t in (low_c, high_c))
    return Found(value=abs(low - high))


def pose_spoils(published: Published, *, source: str, depth_mm: float) -> Found:
    """Sigma of a point in space by a source of poses, at a depth, mm."""
    table = pose_source_table(paper_4(), depths_mm=(depth_mm,))
    return Found(value=float(table["sigma_3d_mm"].to_numpy()[table["source"] == source][0]))


def unknowns(published: Published, *, kind: Kind, lines: int, fixed_fans: bool = False) -> Found:
    """Unknowns of a model of a laser with several lines."""
    nominal = NominalDiode(
        labels=np.arange(lines),
        middle=(lines - 1) / 2,
        origin_lcs_mm=np.zeros(3),
        angles_rad=np.zeros(3),
        step_rad=float(np.deg2rad(published["C303 step"])),
        half_angle_rad=0.5 * float(np.deg2rad(published["C303 width"])),
    )
    return Found(value=float(len(line_model(kind, nominal, fixed_fans=fixed_fans).names)))


def arithmetic(published: Published, *, formula: str, n: str = "", **names: str | float) -> Found:
    """A formula of published numbers and of constants, by the names that the entry gives them.

    Parameters
    ----------
    published : numbers by the names of their entries.
    formula : as Python writes it, with ``sqrt`` and the like.
    n : entry with the number of observations.
    names : of the formula: name of an entry, or a constant.
    """
    known = {name: float(published[of]) if isinstance(of, str) else of for name, of in names.items()}
    value: Any = pd.eval(formula, local_dict=known, engine="python")
    return Found(value=float(value), n=float(published[n]) if n else float("nan"))


def survey_rmse(published: Published, *, name: str) -> Found:
    """RMSE over a survey by a stored budget, cm."""
    return Found(value=0.1 * rmse_mm(read_budget(BUDGETS / f"{name}.yaml")))


def _paper(number: int) -> Sensor:
    return {3: paper_3, 4: paper_4}[number]()


FUNCTIONS: Final[dict[str, Callable[..., Found]]] = {
    function.__name__: function
    for function in (
        bends,
        snell,
        printed_snell,
        halving_where_it_ends,
        halving_misses,
        volume,
        seeing_pixels,
        depth_lines_seen,
        table_1_of_p3,
        sigma_of_p3,
        rank_defect,
        base,
        picture_px,
        picture_mm,
        principal_distance,
        opening,
        pixel_on_plane,
        total_to,
        shrinking_causes,
        least_in_centre,
        published_budget,
        budget_causes,
        line_sigma,
        plane_leaves,
        index_change,
        pose_spoils,
        unknowns,
        arithmetic,
        survey_rmse,
    )
} | {"conversion": arithmetic}
"""What the ledger may name in ``computed``; a ``conversion`` of a unit may tell a misprint."""


# ---------------------------------------------------------------- numbers that the ledger points to


class _AbsentError(Exception):
    """A row, column or key is not in the file."""


def _content(path: Path) -> Any:
    try:
        if path.suffix == ".csv":
            return pd.read_csv(path)
        if path.suffix == ".parquet":
            return read_parquet(path)
        if path.suffix == ".ply":
            return read_mesh(path)[0].vertices_m * MM_PER_M
        text = path.read_text(encoding="utf-8")
        return yaml.safe_load(text) if path.suffix == ".yaml" else json.loads(text)
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise InputError(
            f"cannot be read: {error}", where=path, expected="a table, JSON or YAML", cure="Make it again"
        ) from error


def _of_table(table: pd.DataFrame, ours: Ours) -> Found:
    chosen = pd.Series(data=True, index=table.index)
    for name, wanted in ours.where.items():
        column = _column(table, name)
        chosen &= (column == wanted) if not isinstance(wanted, str) else (column.astype(str) == wanted)
    for name, (value, reach) in ours.near.items():
        chosen &= (pd.to_numeric(_column(table, name), errors="coerce") - value).abs() <= reach
    rows = table[chosen]
    if not len(rows):
        raise _AbsentError(f"no row with {_selection(ours)}")
    if ours.take == "count":
        known = _column(rows, ours.column[0]).notna().sum()
        return Found(value=float(known), n=float(known))
    first = _column(rows, ours.column[0])
    if not pd.api.types.is_numeric_dtype(first):
        return Found(value=_word(first.astype(str).tolist(), ours))
    values = np.stack([_column(rows, name).to_numpy(np.float64) for name in ours.column], axis=1)
    if ours.over:
        values = values / _column(rows, ours.over).to_numpy(np.float64)[:, None]
    n = float(_column(rows, ours.n).sum()) if ours.n else float("nan")
    return _taken(values, ours, n, _column(rows, ours.sigma) if _named(ours.sigma) else None)


def _of_tree(content: Any, ours: Ours) -> Found:
    found = _at(content, ours.key)
    if isinstance(found, str):
        return Found(value=_word([found], ours))
    if isinstance(found, bool) or found is None:
        raise _AbsentError(f"{_dotted(ours.key)} is {found}")
    if ours.take == "count":
        return Found(value=float(len(found)))
    values = np.atleast_1d(np.asarray(found, dtype=np.float64))
    if ours.over:
        values = values / float(_at(content, _beside(ours.key, ours.over)))
    n = float(_at(content, _beside(ours.key, ours.n))) if ours.n else float("nan")
    sigma = pd.Series([_at(content, _beside(ours.key, ours.sigma))]) if _named(ours.sigma) else None
    return _taken(values, ours, n, sigma)


def _taken(values: ArrayF, ours: Ours, n: float, sigma: "pd.Series[Any] | None") -> Found:
    known = values[np.isfinite(values)].ravel()
    if not len(known):
        raise _AbsentError("no number there")
    if ours.take == "one" and len(known) != 1:
        raise _AbsentError(f"{len(known)} numbers with {_selection(ours)} instead of one")
    functions: dict[str, Callable[[ArrayF], Any]] = {
        "one": np.max,
        "mean": np.mean,
        "median": np.median,
        "sum": np.sum,
        "least": np.min,
        "largest": np.max,
        "rms": lambda v: np.sqrt(np.mean(v * v)),
        "mean error": lambda v: np.sqrt(np.mean(v * v) / len(v)),
        "largest size": lambda v: np.max(np.abs(v)),
    }
    value = float(functions[ours.take](known))
    spread = float("nan")
    if ours.sigma == "binomial":
        if not (0.0 <= value <= 1.0 and n > 0.0):
            raise _AbsentError(f"{value:g} of {n:g} is no share")
        spread = float(np.sqrt(value * (1.0 - value) / n))
    elif ours.sigma == "unit":
        spread = 1.0
    elif ours.sigma == "scatter" and len(known) > 1:
        spread = float(known.std(ddof=1))
    elif sigma is not None:
        spread = float(sigma.astype(float).max())
    return Found(value=value * ours.times, sigma=spread * ours.times, n=n)


def _setting(settings: Mapping[str, Any] | None, ours: Ours) -> Found:
    if settings is None:
        return Found(absent="the campaign is no twin")
    try:
        keys = (int(part) if part.isdigit() else part for part in ours.name.split("."))
        value = _at(settings, tuple(keys))
    except _AbsentError as absent:
        return Found(absent=f"settings: {absent}")
    if isinstance(value, str):
        return Found(value=value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return Found(absent=f"settings: {ours.name} is {value}")
    return Found(value=float(value) * ours.times)


def _word(words: list[str], ours: Ours) -> float | str:
    if len(set(words)) != 1:
        raise _AbsentError(f"{len(set(words))} words with {_selection(ours)} instead of one")
    if ours.words is None:
        return words[0]
    for begin, number in ours.words.items():
        if words[0].startswith(begin):
            return float(number)
    raise _AbsentError(f"found {words[0]!r}, which begins with none of {list(ours.words)}")


def _column(table: pd.DataFrame, name: str) -> "pd.Series[Any]":
    if name not in table.columns:
        raise _AbsentError(f"no column {name!r}")
    return table[name]


def _at(content: Any, key: Sequence[Any]) -> Any:
    here = content
    for part in key:
        known = isinstance(here, Mapping) and part in here
        known |= isinstance(here, list | tuple) and isinstance(part, int) and part < len(here)
        if not known:
            raise _AbsentError(f"no {_dotted(key)}")
        here = here[part]
    return here


def _beside(key: Sequence[Any], name: str) -> tuple[Any, ...]:
    return (*key[:-1], name)


def _named(sigma: str) -> bool:
    return sigma not in ("", *SPREADS)


def _dotted(key: Sequence[Any]) -> str:
    return ".".join(str(part) for part in key)


def _selection(ours: Ours) -> str:
    parts = [f"{name} {wanted}" for name, wanted in ours.where.items()]
    parts += [f"{name} within {reach:g} of {value:g}" for name, (value, reach) in ours.near.items()]
    return ", ".join(parts) or "any content"
