"""The shape of the workflow: what depends on what, and what must not."""

import csv
import re

import pytest

pytestmark = pytest.mark.workflow

MAY_READ_TRUTH = {"compare_with_truth"}


def jobs(house, campaign: str) -> list[dict[str, str]]:
    """Rows of the detailed summary: output file, rule, inputs."""
    run = house.snakemake("--detailed-summary", "--config", f"campaign={campaign}")
    lines = run.stdout.splitlines()
    head = next(i for i, line in enumerate(lines) if line.startswith("output_file"))
    return list(csv.DictReader(lines[head:], delimiter="\t"))


@pytest.mark.parametrize("campaign", ["tiny", "demo", "mulde"])
def test_no_processing_rule_reads_the_truth(empty_house, campaign: str) -> None:
    rows = jobs(empty_house, campaign)
    readers = {row["rule"] for row in rows if "/truth/" in row["input-file(s)"]}
    simulating = {rule for rule in readers if rule.startswith("simulate_")}
    assert readers - simulating == MAY_READ_TRUTH
    # and what the comparison yields feeds tables and pictures only
    consumers = {row["rule"] for row in rows if "/accuracy/truth" in row["input-file(s)"]}
    assert all(rule == "summarise" or rule.startswith("plot_") for rule in consumers)
    assert consumers


def test_every_rule_has_its_script_log_and_code_version(repository) -> None:
    scripts = {p.stem for p in (repository / "workflow/scripts").glob("*.py")}
    rules: set[str] = set()
    for path in sorted((repository / "workflow/rules").glob("*.smk")):
        for text in re.split(r"(?m)^rule ", path.read_text())[1:]:
            name = text.split(":", 1)[0]
            rules.add(name)
            assert f'code=code_version("{name}")' in text, name
            assert f'"../scripts/{name}.py"' in text, name
            for field in ("log:", "benchmark:", "threads:", "mem_mb=", "runtime=", "conda:", "message:"):
                assert field in text, f"{name} has no {field}"
    assert rules == scripts


def test_a_wrong_campaign_stops_before_the_first_job(empty_house) -> None:
    campaign = empty_house.root / "config/campaigns/wrong.yaml"
    campaign.write_text(
        "campaign: {id: wrong, title: x, crs: EPSG:4326, origin: {lat_deg: 51, lon_deg: 13, h_ell_m: 300}}\n"
        "twin: {size: tiny}\nlidr: {}\n"
    )
    run = empty_house.snakemake("--dry-run", "--config", "campaign=wrong", check=False)
    campaign.unlink()
    text = run.stdout + run.stderr
    assert run.returncode != 0
    assert "lidr" in text
    assert "campaign.crs" in text
    assert "Traceback" not in text


def test_an_unknown_campaign_is_answered_with_the_known_ones(empty_house) -> None:
    run = empty_house.snakemake("--dry-run", "--config", "campaign=tinny", check=False)
    text = run.stdout + run.stderr
    assert run.returncode != 0
    assert "tinny" in text
    assert "tiny" in text
    assert "mulde" in text
