"""The ledger of published numbers as a section of a page."""

import json
from pathlib import Path
from typing import Any, Final

import pandas as pd

from thalweg.core import read_parquet
from thalweg.figures import Page
from thalweg.lightsheet.figures import light_sheet_page, read_scans
from thalweg_lab.reproduction import (
    MEANINGS,
    NO_RESULT,
    NOT_MATCHED,
    VERDICTS,
    VERDICTS_NOTE,
    by_class,
    counts,
    distinct,
    missing_words,
    readable,
    sentence,
)

LEDGER_NOTE: Final = (
    "Numbers that P3, P4 and T 4.2 print, beside those that this project measures on the digital twin or "
    "computes without it. A tolerance is half a unit of the last printed digit, where it says so with three "
    "sigmas of our own number. " + VERDICTS_NOTE.replace("*", "") + " All entries with their reasons are in "
    "ledger.md."
)
_WORDS: Final = ("note", "basis", "reason", "command", "printed", "unit", "put_in", "file", "source")


def _read(ledger: pd.DataFrame) -> pd.DataFrame:
    """A ledger as its CSV gives it, with empty words where it has none."""
    return ledger.assign(**{name: ledger[name].astype(object).fillna("") for name in _WORDS})


def ledger_section(page: Page, ledger: pd.DataFrame | None) -> Page:
    """Add the counts of verdicts, and each number that was missed or has no result.

    Parameters
    ----------
    page : to which the section is added.
    ledger : `thalweg_lab.reproduction.ledger.judged`; None leaves the page as it is.
    """
    if ledger is None:
        return page
    table = _read(ledger)
    page.section("Published numbers").text(LEDGER_NOTE)
    page.text(f"Of printed numbers, each counted once, {sentence(distinct(table))}.")
    page.table(counts(table).query("entries > 0"), "Verdicts on published numbers (ledger_counts.csv)")
    missed = table[table["verdict"] == NOT_MATCHED]
    if len(missed):
        page.table(readable(missed), "Published numbers that are not matched (ledger.csv)")
    absent = table[table["verdict"] == NO_RESULT]
    if len(absent):
        page.table(readable(absent).drop(columns=["rule", "ours"]), "Without a result yet (ledger.csv)")
    return page


def write_ledger(ledger: pd.DataFrame, headlines: pd.DataFrame, path: Path) -> None:
    """Page of the whole ledger: what could have failed, headlines, counts, then all entries by verdict.

    Parameters
    ----------
    ledger : `thalweg_lab.reproduction.whole_ledger`.
    headlines : `thalweg_lab.reproduction.headlines`.
    path : target.
    """
    table = _read(ledger)
    missing = "; ".join(missing_words(table))
    page = Page(
        "Published numbers and what became of them",
        (f"Not run here: {missing}. " if missing else "")
        + f"Of the published numbers {sentence(table)}. Numbers of the digital twin speak of the software, "
        "not of a boat. T and P1 to P4 are the thesis and its papers.",
        folded=False,
    )
    page.section("Headlines").table(headlines, "Main results of the thesis and its papers")
    page.section("Counts")
    counted = by_class(table)
    counted["what it says"] = counted["verdict"].map(MEANINGS).fillna("")
    page.table(counted, "Rows of ledger.csv by class and verdict (ledger_verdicts.csv)")
    page.text(
        "Classes: A exact, B statistic on the digital twin, C procedure only, D figure, I input. A tolerance "
        "is half a unit of the last printed digit, with three sigmas of our own number where the rule says "
        "sampling error."
    )
    lists = {"F": "future work", "E": "misprints"}
    chapters = table["rows"].str[0].map(lists).fillna(table["where"].str.split().str[0])
    for verdict in VERDICTS:
        part = table[table["verdict"] == verdict]
        if len(part):
            page.section(verdict.capitalize())
        for chapter, rows in part.groupby(chapters, sort=False):
            shown = readable(rows).assign(
                file=rows["file"].where(rows["file"] != "", rows["source"]).to_numpy()
            )
            page.table(shown, f"{verdict.capitalize()}: {chapter} (ledger.csv)")
    page.write(path)


def write_light_sheet_page(
    *,
    calibration: Path,
    budget: Path,
    camera: list[Path],
    lens: list[Path],
    panels: list[Path],
    truth: list[Path],
    counts: list[Path],
    line_points: list[Path],
    scan_files: list[Path],
    scan_pictures: list[Path],
    scans: list[str],
    ledger: list[Path],
    pictures: list[Path],
    captions: dict[str, str],
    title: str,
    twin: bool,
    page: Path,
) -> None:
    """Page of a light-sheet sensor from files, with the ledger where the campaign has one.

    Parameters
    ----------
    camera, lens, panels, truth, ledger : none, or one.
    counts, line_points : one a series of images, in the folder of its name.
    scan_files, scan_pictures : of all scans.
    title : of the campaign.
    page : target.
    """

    def table(files: list[Path]) -> pd.DataFrame | None:
        """The table that may be absent."""
        return pd.read_csv(files[0]) if files else None

    def report(files: list[Path]) -> dict[str, Any] | None:
        """The report that may be absent."""
        return json.loads(files[0].read_text(encoding="utf-8")) if files else None

    built = light_sheet_page(
        json.loads(calibration.read_text(encoding="utf-8")),
        pd.read_csv(budget),
        panels=table(panels),
        truth=table(truth),
        camera=report(camera),
        lens=report(lens),
        counts={path.parent.name: pd.read_csv(path) for path in counts},
        points={path.parent.name: read_parquet(path) for path in line_points},
        scans=read_scans(scans, scan_files, scan_pictures, captions),
        pictures=pictures,
        captions=captions,
        title=f"Light-sheet sensor: {title}",
        twin=twin,
    )
    ledger_section(built, table(ledger)).write(page)
