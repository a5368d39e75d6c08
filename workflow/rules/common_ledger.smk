"""What the ledger of published numbers reads."""

import hashlib
from functools import cache

from thalweg_lab.reproduction.files import read_ledger, result_files

LEDGER = ROOT / "resources" / "published" / "ledger.yaml"
STORED = [
    str(ROOT / "resources" / "light_sheet" / "paper_3.yaml"),
    str(ROOT / "resources" / "light_sheet" / "paper_4.yaml"),
    str(ROOT / "resources" / "budgets" / "p2_table1.yaml"),
    str(ROOT / "resources" / "budgets" / "sajo_2019.yaml"),
    str(ROOT / "resources" / "budgets" / "sajo_2021.yaml"),
]
"""Prototypes and budgets that computed numbers come from."""


@cache
def ledger_files(source):
    """What the ledger points to: files of the campaign, or studies."""
    return result_files(read_ledger(LEDGER), source)


def has_ledger(name):
    """True for a digital twin of the light-sheet sensor in a basin."""
    return CAMPAIGNS[name].is_basin and is_twin(name)


def ledger_results(wildcards):
    """Input function: the files below the campaign's results that the ledger points to and the campaign makes."""
    name = wildcards.campaign
    known = {"sheet": True, "panels": "panels" in sheet_series(name)}
    known |= {scan: scan in compared_scans(name) for scan in TWIN_SCANS}
    of_panels = ("triangulation/panels.csv", "triangulation/line_methods.csv")
    found = []
    for file in ledger_files("file"):
        parts = [part for part in Path(file).parts if part in known]
        series = "panels" if file in of_panels else parts[0] if parts else "sheet"
        if known[series]:
            found.append(f"results/{name}/{file}")
    return found


def ledger_studies(wildcards):
    """Params function: studies that the ledger points to, as far as they were made, and what is in them.

    They are no inputs, so that no study of an hour is made or made again for the ledger's sake; a study that was
    made anew changes this value and with it the ledger.
    """
    files = [Path("results/reproduction") / file for file in ledger_files("study")]
    return {
        file.as_posix(): hashlib.sha256(file.read_bytes()).hexdigest()[:12]
        for file in files
        if file.is_file()
    }


def ledger_outputs(name):
    """The ledger, where there is one."""
    return [f"results/{name}/triangulation/ledger.md"] if has_ledger(name) else []


def sheet_ledger(wildcards):
    """Input function: the ledger for the page on the light-sheet sensor, where there is one."""
    name = wildcards.campaign
    return [f"results/{name}/triangulation/ledger.csv"] if has_ledger(name) else []
