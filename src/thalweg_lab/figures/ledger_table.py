"""The ledger of published numbers as a section of a page."""

from typing import Final

import pandas as pd

from thalweg.figures import Page
from thalweg_lab.reproduction import MISSED, NO_RESULT, VERDICTS_NOTE, counts, readable, sentence

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
