"""The whole ledger: every published item with one of six verdicts.

`thalweg_lab.reproduction.ledger` says how near our number is and what that is worth; here the numbers of all
files of ``resources/published`` come together, an item a row, in six words:

- *matched*: our number meets its rule, a part of the project is there, or a misprint is confirmed;
- *not matched*: it does not, or the part is not there;
- *not reproducible*: the original is not published, contradicts itself, or its result is not there;
- *input*: what was put in, or met by an input that was chosen for it: it confirms nothing;
- *waived*: nothing that software could show;
- *open*: an idea for future work that is not done.
"""

import importlib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import yaml

from thalweg.core import ConfigError
from thalweg_lab.reproduction.arithmetic import ARITHMETIC
from thalweg_lab.reproduction.files import CLASSES, NAMES, PUT_IN, Entry
from thalweg_lab.reproduction.ledger import (
    ABOVE,
    BELOW,
    FUNCTIONS,
    MISSED,
    NO_RESULT,
    NOT_CHECKABLE,
    Results,
    judged,
    ours_words,
    verdict_words,
)

MATCHED: Final = "matched"
NOT_MATCHED: Final = "not matched"
NOT_REPRODUCIBLE: Final = "not reproducible"
INPUT: Final = "input"
WAIVED: Final = "waived"
OPEN: Final = "open"
SIX: Final = (NOT_MATCHED, MATCHED, INPUT, NOT_REPRODUCIBLE, WAIVED, OPEN)
"""Verdicts in the order of the page: misses first."""
LEDGER_COLUMNS: Final = (
    "id",
    "part",
    "source",
    "quantity",
    "published",
    "unit",
    "found",
    "sigma",
    "tolerance",
    "verdict",
    "reason",
    "file",
    "class",
)
ITEMS: Final = (
    *(f"C{i:03d}" for i in range(1, 329)),
    *(f"E{i:02d}" for i in range(1, 31)),
    *(f"FW{i:02d}" for i in range(1, 40)),
)
"""Published items, misprints and ideas for future work."""
COMPUTED: Final = {**FUNCTIONS, **ARITHMETIC}
"""What entries of all files may name as ``computed``."""
_EXACT: Final = ("arithmetic", "definition")


def whole_ledger(entries: Iterable[Entry], results: Results, pages: Mapping[str, int]) -> pd.DataFrame:
    """A row for each item and entry, see `LEDGER_COLUMNS`; misses first, then in the order of the items.

    Parameters
    ----------
    entries : of all files, see `thalweg_lab.reproduction.files.read_ledgers`.
    results : of all campaigns, with records and parts of the project.
    pages : section, figure or table of a source -> its page in the thesis, see `read_pages`.

    Raises
    ------
    InputError : a result cannot be read, or an entry names a function that does not exist.
    ConfigError : an entry stands at a place without a page.
    """
    entries = tuple(entries)
    table = judged(entries, results, COMPUTED)
    rows = [
        _ledger_row(item, entry, row, pages)
        for entry, row in zip(entries, table.to_dict("records"), strict=True)
        for item in entry.rows
    ]
    ledger = pd.DataFrame(rows, columns=list(LEDGER_COLUMNS))
    order = ledger["verdict"].map(SIX.index), ledger["id"].map(ITEMS.index)
    return ledger.iloc[np.lexsort([o.to_numpy() for o in reversed(order)])].reset_index(drop=True)


def verdict_in_six(row: Mapping[Any, Any], entry: Entry) -> str:
    """The verdict of a row of `judged` in the six words."""
    if entry.rule in (WAIVED, OPEN):
        return entry.rule
    verdict = row["verdict"]
    if verdict == MISSED or (verdict == NO_RESULT and entry.ours.source in NAMES):
        return NOT_MATCHED
    if verdict in (NOT_CHECKABLE, NO_RESULT):
        return NOT_REPRODUCIBLE
    if entry.put_in:
        return MATCHED if entry.kind == "exact" and entry.put_in in _EXACT else INPUT
    return MATCHED


def _ledger_row(item: str, entry: Entry, row: Mapping[Any, Any], pages: Mapping[str, int]) -> dict[str, Any]:
    verdict = verdict_in_six(row, entry)
    told = []
    if row["verdict"] in (MISSED, BELOW, ABOVE):
        told.append(verdict_words(row))
    if verdict in (INPUT, MATCHED) and entry.put_in:
        told.append(PUT_IN[entry.put_in][0])
    if row["verdict"] == NOT_CHECKABLE and entry.ours.source == "none" and entry.ours.name != row["reason"]:
        told.append(entry.ours.name)
    told += [row["reason"], entry.note]
    return {
        "id": item,
        "part": entry.part,
        "source": f"{entry.where} (p. {page_of(entry.where, pages)})",
        "quantity": entry.quantity,
        "published": entry.printed,
        "unit": entry.unit,
        "found": row["ours"],
        "sigma": row["sigma"],
        "tolerance": row["tolerance"],
        "verdict": verdict,
        "reason": "; ".join(dict.fromkeys(text.rstrip(".") for text in told if text)),
        "file": row["file"] or row["source"],
        "class": CLASSES[entry.kind],
    }


def page_of(where: str, pages: Mapping[str, int]) -> int:
    """Page of the thesis on which the first place of ``where`` stands (its papers have the thesis's pages).

    ``P2 6.1.2, eq. 6`` is looked up as such, then shorter by a word or a number, to the paper itself.

    Raises
    ------
    ConfigError : not even the paper has a page.
    """
    words = where.split(",")[0].split(" and ")[0]
    while words:
        if words in pages:
            return pages[words]
        cut = max(words.rfind(" "), words.rfind("."))
        words = words[:cut].rstrip() if cut > 0 else ""
    raise ConfigError(
        f"no page of {where!r}", where="pages.yaml", expected="a section, figure or table of it"
    )


def read_pages(path: Path) -> dict[str, int]:
    """Pages by places such as ``P4 6.3`` and ``T Fig. 3.5``."""
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    return {
        (paper if place == "title" else f"{paper} {place}"): int(page)
        for paper, places in tree["pages"].items()
        for place, page in places.items()
    }


def ledger_counts(ledger: pd.DataFrame) -> pd.DataFrame:
    """Rows by class (lines) and verdict (columns), and all of them."""
    found = pd.crosstab(ledger["class"], ledger["verdict"])
    found = found.reindex(index=sorted(CLASSES.values()), columns=list(SIX), fill_value=0)
    found.loc["all"] = found.sum()
    found["all"] = found.sum(axis=1)
    return found.rename_axis(index="class", columns=None).reset_index()


def missing_items(entries: Iterable[Entry]) -> list[str]:
    """Items without an entry, and rows that are no item."""
    found = {row for entry in entries for row in entry.rows}
    return [item for item in ITEMS if item not in found] + sorted(found - set(ITEMS))


def found_words(row: Mapping[Any, Any]) -> str:
    """Our number with unit and sigma, of a row of the ledger."""
    return ours_words({"ours": row["found"], "sigma": row["sigma"], "n": float("nan"), "unit": row["unit"]})


# ---------------------------------------------------------------- what entries may point to


def recorded(root: Path) -> dict[str, tuple[Any, Path]]:
    """Tables of ``docs/validation`` by the result that they were taken from: ``full/accuracy/chains.csv``
    below the results, ``chain_study.csv`` below ``results/reproduction``.

    A picked JSON file comes back as the tree that its keys were picked from.
    """
    found: dict[str, tuple[Any, Path]] = {}
    for study in sorted((root / "config/studies").glob("*.yaml")):
        entry = yaml.safe_load(study.read_text(encoding="utf-8"))
        for table, wanted in entry.get("tables", {}).items():
            path = root / "docs/validation" / f"{table}.csv"
            if not path.is_file():
                continue
            content = pd.read_csv(path, keep_default_na=False, na_values=["", "nan", "NaN"])
            name = wanted["file"].removeprefix("results/").removeprefix("reproduction/")
            picked = wanted.get("pick")
            found[name] = (_tree(content, picked) if picked else content), path.relative_to(root)
    return found


def _tree(content: pd.DataFrame, picked: Mapping[str, str]) -> dict[Any, Any]:
    values = dict(zip(content["key"], content["value"], strict=True))
    tree: dict[Any, Any] = {}
    for key, dotted in picked.items():
        *parents, last = (int(part) if part.isdigit() else part for part in dotted.split("."))
        here = tree
        for part in parents:
            here = here.setdefault(part, {})
        here[last] = values.get(key)
    return tree


def is_function(name: str) -> bool:
    """True if ``module:name`` can be imported."""
    module, _, attribute = name.partition(":")
    try:
        return hasattr(importlib.import_module(module), attribute)
    except ImportError:
        return False


def parts_of(rules: Iterable[str], figures: Iterable[str]) -> dict[str, Callable[[str], bool]]:
    """Whether rules, functions and figures exist, by `thalweg_lab.reproduction.files.NAMES`."""
    known_rules, known_figures = frozenset(rules), frozenset(figures)
    return {"rule": known_rules.__contains__, "figure": known_figures.__contains__, "function": is_function}
