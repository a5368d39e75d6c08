"""What the README says must be so: its commands, its graph of the rooms, its example campaign."""

import re
import runpy
from pathlib import Path

import yaml

from thalweg.config.load import load_campaign


def test_the_graph_names_the_rooms(repository: Path) -> None:
    text = (repository / "README.md").read_text()
    graph = re.search(r"```mermaid\n(.*?)```", text, re.S)
    assert graph
    drawn = set(
        re.findall(r"\b[a-z]{4,}\b", re.sub(r"flowchart|\[.*?\]|-\..*?\.->|logs", "", graph.group(1)))
    )
    own = {"real_logs", "reproduction"}  # targets of their own
    rooms = {
        path.stem.split("_")[0]
        for path in (repository / "workflow/rules").glob("*.smk")
        if path.stem not in own
    }
    assert drawn == rooms - {"common"}


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
