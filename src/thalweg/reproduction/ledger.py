"""Published numbers of the light-sheet sensor beside those of this pipeline on the digital twin; verdicts.

Four verdicts: ``matched``; ``missed``, with the amount beyond the tolerance; ``not checkable``, because the
original data are not published, the number was chosen by the operator, or published lines contradict each
other; ``no result yet``, if the file or number is not there. A tolerance is half a unit of the last printed
digit, in some rules and three sigmas of our own number, never what would make a number fit.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core.errors import InputError
from thalweg.reproduction.ledger_computed import FUNCTIONS, computed
from thalweg.reproduction.ledger_file import KINDS, Entry
from thalweg.reproduction.ledger_values import Found, Results

MATCHED: Final = "matched"
MISSED: Final = "missed"
NOT_CHECKABLE: Final = "not checkable"
NO_RESULT: Final = "no result yet"
VERDICTS: Final = (MATCHED, MISSED, NOT_CHECKABLE, NO_RESULT)

SAMPLING_SIGMAS: Final = 3.0
"""Sigmas of our own number that the basis ``sampling error`` adds: one of 370 normal numbers lies beyond."""

NO_SIGMA: Final = "the number has no sigma, or is none"

HOW: Final = {
    "equal": "equal", "inside": "equal", "same word": "equal", "at most": "no worse than a bound",
    "at least": "no worse than a bound", "present": "shown, without a printed number",
}  # fmt: skip
"""What a match says, by rule: to be no worse than a published figure is less than to reproduce it."""

COLUMNS: Final = (
    "rows", "name", "section", "where", "quantity", "printed", "value", "unit", "half_unit", "kind", "rule",
    "basis", "ours", "sigma", "n", "difference", "tolerance", "missed_by", "verdict", "reason", "source",
    "note",
)  # fmt: skip


def judged(entries: Sequence[Entry], results: Results) -> pd.DataFrame:
    """A row for each entry, see `COLUMNS`.

    ``missed_by`` is signed: above zero where our number is too large. ``reason`` says why the rule is what it
    is, why a number cannot be checked, or what is absent.

    Raises
    ------
    InputError : a result cannot be read, or an entry names a function that does not exist.
    """
    unknown = [
        f"{e.name}: {e.ours.name}"
        for e in entries
        if e.ours.source == "computed" and e.ours.name not in FUNCTIONS
    ]
    if unknown:
        raise InputError(
            f"no such functions: {', '.join(unknown)}",
            where="ledger",
            expected=f"one of {', '.join(FUNCTIONS)}",
        )
    published = {e.name: e.value for e in entries if e.value is not None}
    return pd.DataFrame([_row(e, _found(e, results, published)) for e in entries], columns=list(COLUMNS))


def verdict_of(entry: Entry, found: Found) -> tuple[str, float, float]:
    """Verdict, tolerance and the signed amount beyond it; NaN where there is none.

    A number on the border itself is inside: 1e-9 of the value is left to rounding.
    """
    nan = float("nan")
    if entry.rule == "not checkable":
        return NOT_CHECKABLE, nan, nan
    if found.value is None:
        return NO_RESULT, nan, nan
    if entry.rule == "present":
        return MATCHED, nan, nan
    if entry.rule == "same word":
        return (MATCHED if found.value == entry.value else MISSED), nan, nan
    if isinstance(found.value, str) or not np.isfinite(found.value):
        return NO_RESULT, nan, nan
    low, high = _bounds(entry)
    tolerance = entry.tolerance if entry.basis == "identity" or entry.tolerance else entry.half_unit
    if entry.basis == "sampling error":
        if not np.isfinite(found.sigma):
            return NO_RESULT, nan, nan
        tolerance += SAMPLING_SIGMAS * found.sigma
    rounding = 1e-9 * max(abs(b) for b in (low, high) if np.isfinite(b))
    above, below = found.value - (high + tolerance), (low - tolerance) - found.value
    if max(above, below) <= rounding:
        return MATCHED, tolerance, nan
    return MISSED, tolerance, above if above > rounding else -below


def count(table: pd.DataFrame) -> dict[str, int]:
    """Entries of a table of `judged` by verdict, in the order of `VERDICTS`."""
    return {verdict: int((table["verdict"] == verdict).sum()) for verdict in VERDICTS}


def summary(table: pd.DataFrame) -> str:
    """Counts in one sentence.

    Examples
    --------
    >>> summary(pd.DataFrame({"verdict": ["matched", "missed", "missed"]}))
    '3 published numbers: 1 matched, 2 missed, 0 not checkable, 0 no result yet'
    """
    return f"{len(table)} published numbers: " + ", ".join(f"{n} {word}" for word, n in count(table).items())


def matches(table: pd.DataFrame) -> str:
    """What the matches consist of, in one sentence.

    Examples
    --------
    >>> matches(pd.DataFrame({"verdict": ["matched", "missed"], "rule": ["at most", "equal"]}))
    '1 matched: 0 equal, 1 no worse than a bound, 0 shown, without a printed number'
    """
    rules = table.loc[table["verdict"] == MATCHED, "rule"].map(HOW)
    parts = [f"{int((rules == how).sum())} {how}" for how in dict.fromkeys(HOW.values())]
    return f"{len(rules)} matched: " + ", ".join(parts)


def by_kind(table: pd.DataFrame) -> pd.DataFrame:
    """Numbers of entries by kind (rows) and verdict (columns)."""
    found = pd.crosstab(table["kind"], table["verdict"])
    found = found.reindex(index=[k for k in KINDS if k in found.index], columns=list(VERDICTS), fill_value=0)
    return found.reset_index().rename_axis(columns=None)


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
        f"{summary(table)}. {matches(table)}.",
        "",
        *_grid(by_kind(table)),
        "",
        "Tolerances: *printed digits*, half a unit of the last printed digit; *sampling error*, that and "
        "three sigmas of our number; *goal*, a bound with half a unit; *identity*, the arithmetic of "
        "float64. A number is *missed by* what lies beyond its tolerance, above zero where ours is larger.",
    ]
    for section in dict.fromkeys(table["section"]):
        part = table[table["section"] == section]
        lines += ["", f"## {section}", "", summary(part) + ".", ""]
        lines += _grid(readable(part))
    for verdict, head in (
        (MISSED, "Missed"), (NO_RESULT, "No result yet"), (NOT_CHECKABLE, "Not checkable, and why"),
    ):  # fmt: skip
        part = table[table["verdict"] == verdict]
        if not len(part):
            continue
        lines += ["", f"## {head}", ""]
        for row in part.to_dict("records"):
            told = [verdict_words(row), f"rule: {row['reason']}", row["note"]]
            words = " ".join(_sentence(text) for text in told if text) if verdict == MISSED else row["reason"]
            lines.append(f"- {row['name']}, {row['quantity']}: {words}")
    return "\n".join(lines) + "\n"


def readable(table: pd.DataFrame) -> pd.DataFrame:
    """Columns to read: rows, where, quantity, printed, rule, ours, verdict."""
    names = ["rows", "where", "quantity", "printed", "rule", "ours", "verdict"]
    return pd.DataFrame(
        [
            [*(row[name] for name in names[:4]), rule_words(row), ours_words(row), verdict_words(row)]
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
    """Verdict, and by how much a number was missed."""
    amount = row["missed_by"]
    if row["verdict"] != MISSED or not np.isfinite(amount):
        return str(row["verdict"])
    unit = "" if row["unit"] in ("", "1") else f" {row['unit']}"
    return f"missed by {amount:+.3g}{unit}"


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:] + "." * (text[-1] != ".")


def _grid(table: pd.DataFrame) -> list[str]:
    """A table in Markdown; bars inside cells would part them."""
    rows = [list(table.columns), ["---"] * table.shape[1], *table.astype(str).to_numpy().tolist()]
    return ["| " + " | ".join(str(cell).replace("|", "/") for cell in row) + " |" for row in rows]


def _found(entry: Entry, results: Results, published: Mapping[str, Any]) -> Found:
    if entry.ours.source == "computed":
        return computed(entry.ours, published)
    return results.find(entry.ours)


def _bounds(entry: Entry) -> tuple[float, float]:
    value = entry.value
    if isinstance(value, tuple):
        return value
    number = float(value) if isinstance(value, float | int) else float("nan")
    return {
        "at most": (-np.inf, number), "at least": (number, np.inf), "equal": (number, number),
    }[entry.rule]  # fmt: skip


def _row(entry: Entry, found: Found) -> dict[str, Any]:
    verdict, tolerance, missed_by = verdict_of(entry, found)
    value = entry.value
    numbers = isinstance(value, float) and isinstance(found.value, float)
    pair = isinstance(value, tuple)
    return {
        "rows": " ".join(entry.rows), "name": entry.name, "section": entry.section, "where": entry.where,
        "quantity": entry.quantity, "printed": entry.printed,
        "value": f"{value[0]:g} to {value[1]:g}" if isinstance(value, tuple) else value,
        "unit": entry.unit, "half_unit": entry.half_unit if numbers or pair else float("nan"),
        "kind": entry.kind, "rule": entry.rule, "basis": entry.basis, "ours": found.value,
        "sigma": found.sigma, "n": found.n,
        "difference": found.value - value
        if isinstance(value, float) and isinstance(found.value, float) else float("nan"),
        "tolerance": tolerance, "missed_by": missed_by, "verdict": verdict,
        "reason": (found.absent or NO_SIGMA) if verdict == NO_RESULT else entry.why,
        "source": _source(entry), "note": entry.note,
    }  # fmt: skip


def _source(entry: Entry) -> str:
    ours = entry.ours
    if ours.source == "none":
        return ""
    if ours.source == "setting":
        return f"setting twin.light_sheet.{ours.name}"
    if ours.source == "computed":
        return f"computed: {ours.name}"
    at = " and ".join(filter(None, ours.columns)) or ".".join(str(part) for part in ours.key) or "extent"
    rows = ", ".join(
        [*(f"{k} = {v}" for k, v in ours.where.items()), *(f"{k} ~ {v[0]:g}" for k, v in ours.near.items())]
    )
    base = "reproduction/" if ours.source == "study" else ""
    return f"{base}{ours.name}: {ours.take + ' of ' if ours.take != 'one' else ''}{at}" + (
        f" ({rows})" if rows else ""
    )
