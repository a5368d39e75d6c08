"""Published numbers of the light-sheet sensor beside those of this pipeline on the digital twin; verdicts.

A number that meets its rule is ``found`` if a measurement or computation could have given another one;
``put in`` if it is an input, a constant, arithmetic of printed numbers or true by definition; ``met by an
input chosen for it`` if geometry or inputs were fitted to it or to its neighbours; ``below a bound`` or
``above a bound``, with its share of the bound, if the print only says how good or bad something is;
``shown`` if no number is printed. All others are ``missed``, with the amount beyond the tolerance; ``not
checkable``, because the original data are not published, the number was chosen by the operator, or
published lines contradict each other; or ``no result yet``, if the file or number is not there. A tolerance
is half a unit of the last printed digit, in some rules and three sigmas of our own number, never what would
make a number fit.

Some printed numbers are compared in several quantities (the sigma of a parameter by the image alone and in
all). They are counted once, with the weakest of their verdicts.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.budgets.published import BY_CHOICE
from thalweg.core.errors import InputError
from thalweg_lab.reproduction.computed import FUNCTIONS, computed
from thalweg_lab.reproduction.files import KINDS, PUT_IN, Entry
from thalweg_lab.reproduction.values import Found, Results

FOUND: Final = "found"
WAS_PUT_IN: Final = "put in"
BELOW: Final = "below a bound"
ABOVE: Final = "above a bound"
SHOWN: Final = "shown"
MISSED: Final = "missed"
NOT_CHECKABLE: Final = "not checkable"
NO_RESULT: Final = "no result yet"
VERDICTS: Final = (
    FOUND, WAS_PUT_IN, BY_CHOICE, BELOW, ABOVE, SHOWN, MISSED, NOT_CHECKABLE, NO_RESULT,
)  # fmt: skip
WEAKEST_FIRST: Final = (
    MISSED, NO_RESULT, NOT_CHECKABLE, BY_CHOICE, WAS_PUT_IN, SHOWN, ABOVE, BELOW, FOUND,
)  # fmt: skip
"""Which verdict counts for a printed number that is compared in several quantities."""

FAR_BELOW: Final = 1.0 / 3.0
"""Share of a bound that an error-free twin would meet as well: the match says little."""

SAMPLING_SIGMAS: Final = 3.0
"""Sigmas of our own number that the basis ``sampling error`` adds: one of 370 normal numbers lies beyond."""

NO_SIGMA: Final = "the number has no sigma, or is none"

VERDICTS_NOTE: Final = (
    "*Found*: a measurement or computation gave the printed number and could have given another. *Put "
    "in*: an input of the twin, a constant of a stored instrument, arithmetic of printed numbers, a "
    "stored table turned back, or true by definition; it confirms nothing. *Met by an input chosen for "
    "it*: geometry or inputs were fitted to the figure or to its neighbours. *Below* or *above a bound*: "
    "with the share of the bound that our number is; a twin without errors meets every upper bound. "
    "*Shown*: no number is printed. A printed number that is compared in several quantities is counted "
    "once, with the weakest verdict."
)
"""What the verdicts mean, for pages."""

COLUMNS: Final = (
    "rows", "name", "section", "where", "quantity", "printed", "value", "unit", "half_unit", "kind", "rule",
    "basis", "put_in", "ours", "sigma", "n", "difference", "tolerance", "missed_by", "of_bound", "verdict",
    "reason", "source", "note",
)  # fmt: skip


def judged(entries: Sequence[Entry], results: Results) -> pd.DataFrame:
    """A row for each entry, see `COLUMNS`.

    ``missed_by`` is signed: above zero where our number is too large. ``of_bound`` is our number over the
    printed one, for the rules ``at most`` and ``at least``. ``reason`` says why the rule is what it is, why a
    number cannot be checked, or what is absent.

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
        return SHOWN, nan, nan
    if entry.rule == "same word":
        return (_met(entry) if found.value == entry.value else MISSED), nan, nan
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
        return _met(entry), tolerance, nan
    return MISSED, tolerance, above if above > rounding else -below


def _met(entry: Entry) -> str:
    """Verdict of an entry whose rule is met."""
    if entry.put_in:
        return BY_CHOICE if entry.put_in == "fitted" else WAS_PUT_IN
    return {"at most": BELOW, "at least": ABOVE}.get(entry.rule, FOUND)


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
    Columns ``what, distinct, entries``: all; each verdict; what was put in and met, by class (`PUT_IN`);
    numbers below a third of their bound; and those without a result that only studies of an hour give.
    ``distinct`` counts printed numbers, ``entries`` the quantities that are compared with them.
    """
    parts = [(t, count(t)) for t in (distinct(table), table)]
    rows = [("all", *(len(t) for t, _ in parts))]
    rows += [(verdict, *(found[verdict] for _, found in parts)) for verdict in VERDICTS]
    rows += [
        (f"put in: {name}", *(int((_is_met(t) & (t["put_in"] == name)).sum()) for t, _ in parts))
        for name in PUT_IN
    ]
    rows.append(("below a third of a bound", *(int(_far_below(t).sum()) for t, _ in parts)))
    rows.append(("only by long studies", *(int(_by_study(t).sum()) for t, _ in parts)))
    return pd.DataFrame(rows, columns=["what", "distinct", "entries"])


def _is_met(table: pd.DataFrame) -> "pd.Series[bool]":
    return table["verdict"].isin([WAS_PUT_IN, BY_CHOICE])


def _far_below(table: pd.DataFrame) -> "pd.Series[bool]":
    return (table["verdict"] == BELOW) & (table["of_bound"] < FAR_BELOW)


def _by_study(table: pd.DataFrame) -> "pd.Series[bool]":
    studies = table["source"].astype(str).str.startswith("reproduction/")
    return (table["verdict"] == NO_RESULT) & studies


def sentence(table: pd.DataFrame) -> str:
    """What became of the printed numbers, each counted once.

    Examples
    --------
    >>> sentence(
    ...     pd.DataFrame(
    ...         {
    ...             "rows": ["C068", "C069", "C069"],
    ...             "printed": ["0.5", "0.1", "0.1"],
    ...             "value": [0.5, 0.1, 0.1],
    ...             "verdict": ["found", "below a bound", "missed"],
    ...             "of_bound": [float("nan"), 0.2, 1.5],
    ...             "source": ["", "", ""],
    ...             "put_in": ["", "", ""],
    ...         }
    ...     )
    ... )
    'of 2 distinct numbers: 1 found, 0 put in, 0 below a bound, 1 missed, 0 not checkable'
    """
    found = counts(table)
    n = dict(zip(found["what"].astype(str), found["distinct"].astype(int), strict=True))
    studies, absent = n["only by long studies"], n[NO_RESULT]
    chosen, far = n[BY_CHOICE], n["below a third of a bound"]
    parts = [
        f"{n[FOUND]} found",
        f"{n[WAS_PUT_IN] + chosen} put in" + f" ({chosen} of them {BY_CHOICE})" * bool(chosen),
        f"{n[BELOW]} below a bound" + f" ({far} of them below a third of it)" * bool(far),
        f"{n[ABOVE]} above a bound" * bool(n[ABOVE]),
        f"{n[SHOWN]} shown without a printed number" * bool(n[SHOWN]),
        f"{n[MISSED]} missed",
        f"{n[NOT_CHECKABLE]} not checkable",
        f"{studies} that only long studies give" * bool(studies),
        f"{absent - studies} without a result yet" * (absent > studies),
    ]
    return f"of {n['all']} distinct numbers: " + ", ".join(filter(None, parts))


def summary(table: pd.DataFrame) -> str:
    """Counts of the entries in one sentence, without those that are zero.

    Examples
    --------
    >>> summary(pd.DataFrame({"verdict": ["found", "missed", "missed"]}))
    '3 entries: 1 found, 2 missed'
    """
    parts = [f"{n} {word}" for word, n in count(table).items() if n]
    return f"{len(table)} entr{'y' if len(table) == 1 else 'ies'}: " + ", ".join(parts)


def by_kind(table: pd.DataFrame) -> pd.DataFrame:
    """Numbers of entries by kind (rows) and verdict (columns)."""
    found = pd.crosstab(table["kind"], table["verdict"])
    found = found.reindex(
        index=[k for k in KINDS if k in found.index], columns=[v for v in VERDICTS if v in found.columns]
    )
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
        f"{_sentence(sentence(table))}",
        "",
        *_grid(counts(table).query("entries > 0")),
        "",
        VERDICTS_NOTE,
        "",
        f"By kind of number, {summary(table)}:",
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
    """Verdict, with why a number was put in, its share of the bound, or by how much it was missed."""
    amount, put_in = row["missed_by"], row["put_in"]
    if row["verdict"] == WAS_PUT_IN and put_in in PUT_IN:
        return f"{WAS_PUT_IN}: {PUT_IN[put_in][0]}"
    if row["verdict"] in (BELOW, ABOVE) and np.isfinite(row["of_bound"]):
        return f"{row['verdict']}: {100.0 * row['of_bound']:.3g} % of it"
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
    bound = value if isinstance(value, float) and entry.rule in ("at most", "at least") else 0.0
    pair = isinstance(value, tuple)
    return {
        "rows": " ".join(entry.rows), "name": entry.name, "section": entry.section, "where": entry.where,
        "quantity": entry.quantity, "printed": entry.printed,
        "value": f"{value[0]:g} to {value[1]:g}" if isinstance(value, tuple) else value,
        "unit": entry.unit, "half_unit": entry.half_unit if numbers or pair else float("nan"),
        "kind": entry.kind, "rule": entry.rule, "basis": entry.basis, "put_in": entry.put_in,
        "ours": found.value,
        "sigma": found.sigma, "n": found.n,
        "difference": found.value - value
        if isinstance(value, float) and isinstance(found.value, float) else float("nan"),
        "tolerance": tolerance, "missed_by": missed_by,
        "of_bound": found.value / bound if bound and isinstance(found.value, float) else float("nan"),
        "verdict": verdict,
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
