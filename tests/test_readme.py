"""What the README says must be so: its commands, its rule graph, its example campaign."""

import re
from pathlib import Path

import yaml

from thalweg.config.load import load_campaign


def test_the_graph_names_every_rule_of_a_campaign(repository: Path) -> None:
    text = (repository / "README.md").read_text()
    graphs = "\n".join(re.findall(r"```mermaid\n(.*?)```", text, re.S))
    drawn = set(re.findall(r"^        (\w+)$", graphs, re.M))
    rules = {
        name
        for path in (repository / "workflow/rules").glob("*.smk")
        if path.stem not in ("real_logs", "reproduction")  # targets of their own
        for name in re.findall(r"(?m)^(?:rule|use rule \w+ as) (\w+)", path.read_text())
    }
    assert drawn == rules
    arrows = set(re.findall(r"(\w+) --> (\w+)", graphs))
    alone = {"calibrate_board"}  # from files of the user
    assert {end for arrow in arrows for end in arrow} == rules - alone


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
