"""The section on published numbers: counts, what was missed, what is absent."""

import pandas as pd
import pytest

from thalweg.figures import Page
from thalweg_lab.figures import ledger_section
from thalweg_lab.reproduction import NOT_MATCHED, Results, distinct, judged, read_ledger, sentence


@pytest.fixture(scope="module")
def table(repository, tmp_path_factory):
    """As a page reads it: from the file."""
    path = tmp_path_factory.mktemp("ledger") / "ledger.csv"
    entries = read_ledger(repository / "resources/published/light_sheet.yaml")
    judged(entries, Results({}, {}, None)).to_csv(path, index=False, float_format="%.6g")
    return pd.read_csv(path)


def test_the_section_names_counts_misses_and_absent_numbers(table):
    html = ledger_section(Page("Sensor"), table).html()
    assert "digital twin" in html
    said = sentence(distinct(table))
    assert said in html
    assert " of 192 could have failed by a number" in said
    assert "(ledger_counts.csv)" in html
    # its own number with its unit, the amount and the remark
    assert "225.6 mm" in html
    assert "not matched: off by +0.102 mm" in html
    assert "cut, not rounded" in html
    assert "snakemake results/reproduction/multi_line_models.csv" in html
    assert ">nan<" not in html


def test_a_campaign_without_a_ledger_has_no_section():
    page = Page("Sensor")
    before = page.html()
    assert ledger_section(page, None).html() == before


def test_a_ledger_without_a_miss_has_no_table_of_misses(table):
    html = ledger_section(Page("Sensor"), table[table["verdict"] != NOT_MATCHED]).html()
    assert "by a number: 0 did" in html
    assert "that are not matched" not in html
