"""The ledger of published numbers as a section of a page."""

import json
from pathlib import Path
from typing import Any, Final

import pandas as pd

from thalweg.core import read_parquet
from thalweg.figures import Page
from thalweg.lightsheet.figures import light_sheet_page, read_scans
from thalweg_lab.reproduction import (
    MISSED,
    NO_RESULT,
    NOT_MATCHED,
    SIX,
    VERDICTS_NOTE,
    counts,
    found_words,
    ledger_counts,
    readable,
    sentence,
)

LEDGER_NOTE: Final = (
    "Numbers that P3, P4 and T 4.2 print, beside those that this project measures on the digital twin or "
    "computes without it. A tolerance is half a unit of the last printed digit, where it says so with three "
    "sigmas of our own number. " + VERDICTS_NOTE.replace("*", "") + " All entries with their reasons are in "
    "ledger.md."
)


def ledger_section(page: Page, ledger: pd.DataFrame | None) -> Page:
    """Add the counts of verdicts, and each number that was missed or has no result.

    Parameters
    ----------
    page : to which the section is added.
    ledger : `thalweg_lab.reproduction.ledger.judged`; None leaves the page as it is.
    """
    if ledger is None:
        return page
    table = ledger.fillna({"note": "", "basis": "", "reason": "", "printed": "", "unit": "", "put_in": ""})
    page.section("Published numbers").text(LEDGER_NOTE)
    words = sentence(table)
    page.text(words[0].upper() + words[1:] + ".")
    page.table(counts(table).query("entries > 0"), "Verdicts on published numbers (ledger_counts.csv)")
    missed = table[table["verdict"] == MISSED]
    if len(missed):
        notes = missed["note"].where(missed["note"] != "", missed["reason"]).to_numpy()
        page.table(readable(missed).assign(remark=notes), "Published numbers that were missed (ledger.csv)")
    absent = table[table["verdict"] == NO_RESULT]
    if len(absent):
        page.table(
            absent[["rows", "where", "quantity", "printed", "reason"]], "Without a result yet (ledger.csv)"
        )
    return page


SIX_NOTE: Final = (
    "Matched: our number meets its rule, a rule or picture of the project is there, or a computation "
    "confirms a misprint. Not matched: it does not. Input: what was put into the twin or a stored "
    "instrument, or is met by an input that was chosen for it; it confirms nothing. Not reproducible: the "
    "original is not published, contradicts itself, or its result is not there yet. Waived: nothing that "
    "software could show. Open: an idea for future work that is not done. A tolerance is half a unit of the "
    "last printed digit, with three sigmas of our own number where the reason says so. Classes: A exact, B "
    "statistic on the digital twin, C procedure only, D figure, I input."
)


def write_ledger(ledger: pd.DataFrame, path: Path) -> None:
    """Page of the whole ledger: misses first, then the counts, then all other items by verdict and source.

    Parameters
    ----------
    ledger : `thalweg_lab.reproduction.whole_ledger`.
    path : target.
    """
    entries = _joined(ledger)
    missed = entries[entries["verdict"] == NOT_MATCHED]
    page = Page(
        "Published numbers and what became of them",
        f"{len(missed)} of {len(entries)} entries are not matched. Numbers of the digital twin speak of the "
        "software, not of a boat.",
    )
    page.section("Not matched")
    if len(missed):
        page.table(missed[list(_READ)], "Every printed number that was missed, and by how much (ledger.csv)")
    else:
        page.text("None.")
    page.section("Counts").text(SIX_NOTE)
    page.table(ledger_counts(entries), "Entries by class and verdict; ledger.csv has a row for each item")
    for verdict in SIX[1:]:
        part = entries[entries["verdict"] == verdict]
        for source in dict.fromkeys(part["chapter"]):
            rows = part[part["chapter"] == source]
            name = f"{verdict.capitalize()}: {source}"
            page.section(name).table(rows[list(_READ)], f"{name} (ledger.csv)")
    page.write(path)


_READ: Final = ("items", "source", "quantity", "published", "found", "reason and file")


def _joined(ledger: pd.DataFrame) -> pd.DataFrame:
    """An entry a row, its items together; ``chapter`` is the source, or the list of misprints or ideas."""
    table = ledger.fillna({"part": "", "unit": "", "reason": "", "file": ""})
    table = table.assign(found=[found_words(row) for row in table.to_dict("records")])
    same = ["part", "source", "quantity", "published", "found", "reason", "file", "verdict", "class"]
    rows = []
    for values, part in table.groupby(same, sort=False):
        row = dict(zip(same, values, strict=True))
        first = str(part["id"].iloc[0])
        lists = {"F": "future work", "E": "misprints", "C": str(row["source"]).split()[0]}
        row |= {"items": " ".join(part["id"]), "chapter": lists[first[0]]}
        rows.append(row | {"reason and file": f"{row['reason']} [{row['file']}]"})
    return pd.DataFrame(rows)


def write_light_sheet_page(
    *,
    calibration: Path,
    budget: Path,
    published: Path,
    contradictions: Path,
    correlations: Path,
    models: Path,
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
        *(pd.read_csv(path) for path in (budget, published, contradictions, correlations, models)),
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
