"""What the README says must be so: its commands, its graph of the rooms, its example campaign."""

import json
import re
import runpy
from pathlib import Path
from typing import Any

import pytest
import yaml

from thalweg.core import InputError
from thalweg.settings.load import load_campaign


def test_the_graph_names_the_packages_that_data_pass(repository: Path) -> None:
    text = (repository / "README.md").read_text()
    graph = re.search(r"```mermaid\n(.*?)```", text, re.S)
    assert graph
    drawn = set(
        re.findall(r"\b[a-z]{4,}\b", re.sub(r"flowchart|\[.*?\]|-\..*?\.->|logs", "", graph.group(1)))
    )
    packages = {path.parent.name for path in (repository / "src/thalweg").glob("*/__init__.py")}
    assert drawn == packages - {"core", "settings", "workflow", "budgets"}


def test_the_page_of_the_rules_is_in_step(repository: Path) -> None:
    made = runpy.run_path(str(repository / "docs/make_rules.py"))["page"](repository / "workflow/rules")
    assert (repository / "docs/rules.md").read_text() == made, "run .venv/bin/python docs/make_rules.py"
    assert not re.search(r"(?m)^\| `\w+` \|  \|$", made), "a rule without a word on what it does"


def test_the_commands_exist(repository: Path) -> None:
    readme = (repository / "README.md").read_text()
    makefile = (repository / "Makefile").read_text()
    for target in set(re.findall(r"(?m)(?:`|^    )make ([a-z][a-z-]*)", readme)):
        assert re.search(rf"(?m)^{target}:", makefile), target


def test_the_example_campaign_is_valid(repository: Path, tmp_path: Path) -> None:
    text = re.search(r"```yaml\n(.*?)```", (repository / "README.md").read_text(), re.S)
    assert text
    example = yaml.safe_load(text.group(1))
    folder = tmp_path / "thalweg/config/campaigns"
    folder.mkdir(parents=True)
    for log in ("scan.pcap", "ins.anpp", "rover.sbp", "base.obs", "base.nav", "echo.nmea"):
        path = tmp_path / "thalweg/surveys/mulde" / log
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"x")
    (folder / "mulde_2026.yaml").write_text(text.group(1))
    campaign = load_campaign(folder / "mulde_2026.yaml")
    assert campaign.orientation.position_source == example["orientation"]["position_source"]
    assert [p.name for p in campaign.log_files("base")] == ["base.obs"]


def test_no_placeholder_is_left(repository: Path) -> None:
    assert "@@" not in (repository / "README.md").read_text()


# ---------------------------------------------------------------- numbers of the twin


def validation(repository: Path) -> dict[str, Any]:
    return runpy.run_path(str(repository / "docs/make_validation.py"))


def filled(repository: Path) -> tuple[dict[Path, str], int]:
    return runpy.run_path(str(repository / "docs/make_pages.py"))["pages"](repository)


def test_pages_hold_the_recorded_numbers(repository: Path) -> None:
    """A digit that is changed in a page or in a record is found here."""
    made, _ = filled(repository)
    assert repository / "README.md" in made
    for path, text in made.items():
        assert path.read_text() == text, f"{path.name}: run .venv/bin/python docs/make_pages.py"


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A repository with one study, its result as a job leaves it, and a page that quotes it."""
    for folder in ("config/studies", "docs/pages", "results"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "config/studies/wave_study.yaml").write_text(
        "parameters: {first_seed: 1, seeds: 3}\nsurvey: A wave.\nknown: Nothing.\n"
        "tables: {waves: {file: results/waves.csv, keys: [of]}}\n"
    )
    (tmp_path / "results/waves.csv").write_text("of,ratio,low,high\nall,-1.2345,0.9,1.1\n")
    job = {
        "rule": "wave_study",
        "commit": "abc",
        "code": "123",
        "params": {"first_seed": 1, "seeds": 3},
        "wall_s": 120.0,
        "cpu_s": 90.0,
        "written_utc": "2026-05-01T10:00:00Z",
        "output": "results/waves.csv",
    }
    (tmp_path / "results/waves.csv.meta.json").write_text(json.dumps(job))
    (tmp_path / "docs/pages/README.md").write_text(
        '{{ waves["all"].ratio | d(1) }} {{ waves["all"].ratio | judged(0.9, 1.1) }} '
        "{{ run.wave_study.parameters.seeds }} {{ run.wave_study.cpu_min }}\n\n"
        "| wave | ratio |\n| --- | --- |\n| all | {{ waves['all'].ratio | d }} |\n\n"
        "Seeds: {{ run.wave_study.parameters.seeds }}.\n"
    )
    return tmp_path


def test_a_record_says_how_it_was_made_and_fills_the_page(repository: Path, small: Path) -> None:
    of = validation(repository)

    def page() -> str:
        return filled_of(small)[0][small / "README.md"]

    filled_of = runpy.run_path(str(repository / "docs/make_pages.py"))["pages"]
    # rows and paragraphs without their numbers are left out, and a table without rows with them
    assert (page(), filled_of(small)[1]) == ("Seeds: 3.\n", 4)
    (entry,) = of["studies"](small).values()
    of["record"]("wave_study", entry, small, small / "docs/validation")
    assert of["front_matter"](small / "docs/validation/wave_study.md") == {
        "command": "make study NAME=wave_study",
        "commit": "abc",
        "code": {"wave_study": "123"},
        "parameters": {"first_seed": 1, "seeds": 3},
        "date": "2026-05-01",
        "jobs": 1,
        "wall_min": 2.0,
        "cpu_min": 1.5,
    }
    rest = "| wave | ratio |\n| --- | --- |\n| all | −1 |\n\nSeeds: 3.\n"
    assert page() == f"−1.2 **−1.23** (0.90–1.10) 3 1.5\n\n{rest}"
    table = small / "docs/validation/waves.csv"
    table.write_text(table.read_text().replace("-1.2345", "-1.1345"))
    assert page() == f"−1.1 **−1.13** (0.90–1.10) 3 1.5\n\n{rest}"


def test_a_reference_to_nothing_is_refused(repository: Path, small: Path) -> None:
    of = validation(repository)
    of["record"]("wave_study", of["studies"](small)["wave_study"], small, small / "docs/validation")
    page = small / "docs/pages/README.md"
    pages = runpy.run_path(str(repository / "docs/make_pages.py"))["pages"]
    for wrong, answer in (('waves["non"].ratio', "no row"), ('waves["all"].rati', "no column 'rati'")):
        page.write_text("{{ " + wrong + " | d }}")
        with pytest.raises(ValueError, match=answer):
            pages(small)


def test_a_result_of_other_sizes_is_not_recorded(repository: Path, small: Path) -> None:
    of = validation(repository)
    path = small / "config/studies/wave_study.yaml"
    path.write_text(path.read_text().replace("seeds: 3", "seeds: 60"))
    with pytest.raises(InputError, match="make study NAME=wave_study"):
        of["record"]("wave_study", of["studies"](small)["wave_study"], small, small / "docs/validation")


def test_a_row_of_timings_replaces_that_of_its_campaign(repository: Path, tmp_path: Path) -> None:
    of = runpy.run_path(str(repository / "docs/make_timings.py"))
    for name in ("tiny", "demo", "tiny"):
        table = of["with_row"](tmp_path / "t.csv", {"campaign": name, "wall_min": 1.0})
        table.to_csv(tmp_path / "t.csv", index=False)
    assert table["campaign"].tolist() == ["demo", "tiny"]


def test_records_are_of_the_sizes_of_the_rules(repository: Path) -> None:
    of = validation(repository)
    for name, entry in of["studies"](repository).items():
        assert entry["survey"], name
        assert entry["known"], name
        assert name.endswith("_study") == ("campaign" not in entry), name
        if "campaign" not in entry:
            assert {"study", "jobs", "outputs"} <= set(entry), f"{name}: what its rules take"
        page = repository / f"docs/validation/{name}.md"
        if page.exists():
            assert of["front_matter"](page)["parameters"] == entry.get("parameters", {}), f"run {name} again"


TWIN = (
    "Where do the sensors sit",
    "Where was the boat",
    "Below the water",
    "How accurate is it",
    "Does it know",
    "Time and memory",
)
"""Sections of the README that quote the twin."""
GIVEN = "|".join(
    [
        r"P[1-4] (?:eq\. |Table )?\d[\d.]*",
        r"T (?:Table |Fig\. )?\d[\d.]*",  # places in papers
        r"0\.1 (?:and 0\.2 )?degrees",
        r"0\.2 degrees",
        r"0\.05 px",
        r"2\.5 min",  # what is simulated
        r"true: [^)]*",
        r"12\.8 mm on the board .* 12\.5",
        r"0\.4 degrees of the",
        r"2\.5D",
        r"1\.7 GB",
    ]
)
"""Numbers that are not of the twin, or its input."""


def typed(template: str) -> list[str]:
    """Numbers in sections on the twin that come from no record; names of rows and published columns may."""
    text = re.sub(r"```.*?```|\{\{.*?\}\}|\{%.*?%\}|\{#.*?#\}", " ", template, flags=re.S)
    found = []
    for section in re.split(r"(?m)^## ", text):
        if not section.startswith(TWIN):
            continue
        published: set[int] = set()
        for line in section.splitlines():
            cells = line.split("|") if line.startswith("|") else [line]
            if any("published" in cell for cell in cells) and len(cells) > 1:
                published = {k for k, cell in enumerate(cells) if "published" in cell}
            kept = " ".join(c for k, c in enumerate(cells) if len(cells) == 1 or k not in {1} | published)
            found += re.findall(r"\d+\.\d+|± \d+|\d+ (?:surveys|seeds|runs)\b", re.sub(GIVEN, " ", kept))
    return found


def test_no_number_of_the_twin_is_typed(repository: Path) -> None:
    assert typed((repository / "docs/pages/README.md").read_text()) == []


def test_a_typed_number_is_seen() -> None:
    table = "## Does it know\n\n| case | ours | published |\n| --- | --- | --- |\n| a 0.1 | 1.98 | 2.5 |\n"
    assert typed(table) == ["1.98"]
    assert typed("## Does it know\n\nThe sigma is 0.93 here, {{ x | d(2) }}, P4 4.1 has 15.\n") == ["0.93"]
    assert typed("## Speed\n\n3.2\n") == []
