"""What README and docs say must be so: commands, graph of the packages, example campaign, links, terms."""

import contextlib
import io
import json
import re
import runpy
import shlex
import subprocess
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest
import yaml

from thalweg.cli import _parser
from thalweg.commands import EXAMPLES
from thalweg.core import InputError
from thalweg.settings.load import load_campaign
from thalweg.workflow import codehash


def test_the_graph_names_the_packages_that_data_pass(repository):
    text = (repository / "docs/architecture.md").read_text().split("## How data flow")[1]
    graph = re.search(r"```mermaid\n(.*?)```", text, re.S)
    assert graph
    drawn = set(
        re.findall(r"\b[a-z]{4,}\b", re.sub(r"flowchart|\[.*?\]|-\..*?\.->|logs", "", graph.group(1)))
    )
    packages = {path.parent.name for path in (repository / "src/thalweg").glob("*/__init__.py")}
    assert drawn == packages - {"core", "settings", "workflow", "budgets", "commands"}


def test_the_front_page_names_the_commands_that_check_the_software(repository):
    """Demo and tests stand where a stranger tries the software; `.ci/run` calls the latter."""
    block = (repository / "README.md").read_text().split("## Try it")[1].split("\n## ")[0]
    named = re.findall(r"(?m)^    (make \w+)", block)
    assert {"make demo", "make test"} <= set(named)
    assert (repository / ".ci/run").read_text().rstrip().endswith("exec make test")


def test_the_front_page_is_read_in_five_minutes(repository):
    words = [word for word in (repository / "README.md").read_text().split() if re.search(r"\w", word)]
    assert 700 <= len(words) <= 900


def test_the_page_of_the_rules_is_in_step(repository):
    made = runpy.run_path(str(repository / "docs/make_rules.py"))["page"](repository / "workflow/rules")
    assert (repository / "docs/rules.md").read_text() == made, "run .venv/bin/python docs/make_rules.py"
    assert not re.search(r"(?m)^\| `\w+` \|  \|$", made), "a rule without a word on what it does"


def documents(repository: Path) -> dict[str, str]:
    """Pages that people read, by their place; those of docs/pages are written as templates."""
    places = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "config/README.md"]
    pages = [repository / place for place in places] + sorted((repository / "docs").rglob("*.md"))
    return {
        path.relative_to(repository).as_posix(): path.read_text(encoding="utf-8")
        for path in pages
        if "pages" not in path.parts
    }


def commands(text: str) -> Iterator[str]:
    """Command lines of a page: in code blocks, continued lines joined, and in tables of tasks."""
    text = text.replace("\\\n", " ")
    blocks = re.findall(r"(?m)^    (.*)$", text)
    tasks = re.findall(r"(?m)^\| [^|]* \| `((?:thalweg|make|snakemake) [^`|]*)` \|$", text)
    for line in [*blocks, *tasks]:
        words = line.split("  #")[0].removeprefix(".venv/bin/").strip()
        if re.match(r"(thalweg|make|snakemake) ", words):
            yield words


def as_a_shell_splits(line: str, folder: Path) -> list[str]:
    """Words of a printed command, called in ``folder``, which is the home of its caller as well."""
    words = shlex.split(line.replace("~", str(folder)), comments=True)
    found = {word: sorted(Path("/").glob(str(folder / word)[1:])) for word in words if "*" in word}
    return [str(each) for word in words for each in found.get(word, [word])]


def test_the_commands_exist(repository, capsys):
    """Each command of a page is one that its own program understands, options and all."""
    makefile = (repository / "Makefile").read_text()
    seen: Counter[str] = Counter()
    for place, text in documents(repository).items():
        for target in set(re.findall(r"(?m)(?:`|^    )make ([a-z][a-z-]*)", text)):
            assert re.search(rf"(?m)^{target}:", makefile), f"{place}: make {target}"
        for line in commands(text):
            words = shlex.split(line, comments=True)
            if words[0] == "thalweg" and "..." not in words:
                with contextlib.suppress(SystemExit):
                    _parser().parse_args(words[1:])
                assert capsys.readouterr().err == "", f"{place}: {line}"
                seen[words[1]] += place in ("README.md", "docs/commands.md")
    names = re.findall(r"(?m)^    ([a-z]+(?:-[a-z]+)*)(?: |$)", _parser().format_help())
    # the page of single commands names their neighbours, others the rest
    beside = {"import-calibration", "export-camera", "schema", "catalogue", "cluster", "costs", "verify"} | {
        "workflow-path"
    }
    assert {name for name in names if not seen[name]} <= beside


def test_messages_of_the_questions_are_printed(repository):
    quoted = re.findall(r"(?m)^> (.+)$", (repository / "docs/faq.md").read_text())
    folders = ("src/thalweg", "workflow")
    text = " ".join(
        path.read_text(encoding="utf-8")
        for folder in folders
        for path in (repository / folder).rglob("*")
        if path.suffix in {".py", ".smk"}
    )
    joined = re.sub(r'"\s+f?"', "", text)
    of_snakemake = {"Config entries have to be defined as name=value pairs", "Directory cannot be locked"}
    assert len(quoted) > 8
    assert [words for words in quoted if words not in joined] == sorted(of_snakemake)


def test_help_and_the_page_of_single_commands_show_the_same_calls(repository):
    printed = re.findall(r"`thalweg ([a-z-]+) ([^`]*)`", (repository / "docs/commands.md").read_text())
    assert len(printed) > 15
    assert {name: EXAMPLES[name] for name, _ in printed} == dict(printed)


def test_the_example_campaign_is_valid(repository, tmp_path):
    text = re.search(r"```yaml\n(.*?)```", (repository / "docs/tutorial.md").read_text(), re.S)
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


# ---------------------------------------------------------------- links, terms, codes


def anchors(text: str) -> set[str]:
    """Names of the headings of a page, as code hosts and mkdocs make them."""
    headings = re.findall(r"(?m)^#+ (.+)$", re.sub(r"```.*?```", "", text, flags=re.S))
    plain = [re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).lower() for heading in headings]
    return {re.sub(r"[^\w\- ]", "", heading).strip().replace(" ", "-") for heading in plain}


def dead_links(root: Path, place: str, text: str) -> list[str]:
    """Links of a page to files or headings that are not there."""
    dead = []
    for target in re.findall(r"\]\(([^)\s]+)\)", re.sub(r"```.*?```|`[^`\n]*`", "", text, flags=re.S)):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, heading = target.partition("#")
        path = (root / place).parent / name if name else root / place
        if not path.exists() or (heading and heading not in anchors(path.read_text(encoding="utf-8"))):
            dead.append(target)
    return dead


def test_no_link_is_dead(repository):
    dead = {place: dead_links(repository, place, text) for place, text in documents(repository).items()}
    assert {place: links for place, links in dead.items() if links} == {}


def test_a_dead_link_is_seen(tmp_path):
    (tmp_path / "a.md").write_text("# One, two `three`\n")
    text = (
        "[x](a.md) [x](a.md#one-two-three) [x](a.md#two) ![x](b.png) [x](https://example.org/c) `[x](d.md)`"
    )
    assert dead_links(tmp_path, "page.md", text) == ["a.md#two", "b.png"]


CITED = r"\b(?:P[1-4]|T)(?= (?:\d|eq\.|Table|Fig|section)|\b[,)]| and | to P)"
"""Short names of the thesis and its papers, as docs/bibliography.md lists them."""


def unresolved(text: str) -> set[str]:
    """Codes of a page that nothing on it resolves: P1 to P4 and T want a link to the bibliography."""
    plain = re.sub(r"```.*?```|`[^`\n]*`|(?m:^    .*$)|\]\([^)]*\)", "", text, flags=re.S)
    codes = set(re.findall(r"\b(?:[PTCE]|FW)\d+\b", plain)) - {"E57"}
    if "bibliography.md" in text:
        codes -= {"P1", "P2", "P3", "P4"}
    elif re.search(CITED, plain):
        codes.add("T or P1 to P4")
    return codes


def test_no_code_is_undefined(repository):
    found = {
        place: unresolved(text)
        for place, text in documents(repository).items()
        if place not in {"docs/bibliography.md", "docs/validation/mutants.md"}  # a list of source lines
    }
    assert {place: codes for place, codes in found.items() if codes} == {}
    captions = yaml.safe_load((repository / "workflow/figures.yaml").read_text())
    spelled = [
        row["caption"]
        for rows in captions.values()
        for row in rows.values()
        if unresolved(row.get("caption", ""))
    ]
    assert spelled == []  # captions stand alone in reports: author and year, not a short name


def test_an_undefined_code_is_seen():
    assert unresolved("As C320 and FW28 say, E57 clouds are read.") == {"C320", "FW28"}
    assert unresolved("The budget of P2 Table 1.") == {"P2", "T or P1 to P4"}
    assert unresolved("The budget of [P2](bibliography.md) Table 1.") == set()


PRIVATE = re.compile(
    r"\b(?:honest(?:y|ly)?(?!_)|normalised squares?|foretell\w*|foretold|restless|consents?|strangers)\b",
    re.IGNORECASE,
)
"""Words for which docs/glossary.md has a term of the field."""


def test_pages_use_the_terms_of_the_field(repository):
    texts = documents(repository) | {
        "workflow/figures.yaml": (repository / "workflow/figures.yaml").read_text()
    }
    for command in re.findall(r"(?m)^    ([a-z]+(?:-[a-z]+)*)(?: |$)", _parser().format_help()):
        with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()) as said:
            _parser().parse_args([command, "--help"])
        texts[f"thalweg {command}"] = said.getvalue()
    texts = {place: text for place, text in texts.items() if "validation/" not in place}  # columns of tables
    texts.pop("docs/glossary.md")
    found = {place: PRIVATE.findall(re.sub(r"`[^`\n]*`", "", text)) for place, text in texts.items()}
    assert {place: words for place, words in found.items() if words} == {}


def test_names_in_the_glossary_exist(repository):
    rows = [line.split("|") for line in (repository / "docs/glossary.md").read_text().splitlines()]
    names = {name for row in rows if len(row) == 6 for name in re.findall(r"`([^`]+)`", row[4])}
    assert len(names) > 80
    folders = ("src", "workflow", "config")
    text = "".join(
        path.read_text(encoding="utf-8")
        for folder in folders
        for path in (repository / folder).rglob("*")
        if path.suffix in {".py", ".smk", ".yaml"}
    ) + " ".join(path.stem for path in (repository / "config/studies").iterdir())
    parts = {part for name in names for part in re.split(r"…|/|^thalweg ", name) if part}
    assert {part for part in parts if part not in text} == set()


def test_no_placeholder_is_left(repository):
    assert "@@" not in (repository / "README.md").read_text()


# ---------------------------------------------------------------- numbers of the twin


def validation(repository: Path) -> dict[str, Any]:
    return runpy.run_path(str(repository / "docs/make_validation.py"))


def filled(repository: Path) -> tuple[dict[Path, str], int]:
    return runpy.run_path(str(repository / "docs/make_pages.py"))["pages"](repository)


def test_pages_hold_the_recorded_numbers(repository):
    """A digit that is changed in a page or in a record is found here."""
    made, _ = filled(repository)
    assert repository / "README.md" in made
    for path, text in made.items():
        assert path.read_text() == text, f"{path.name}: run .venv/bin/python docs/make_pages.py"


def test_pages_say_of_which_code_their_numbers_are(repository):
    """A record is of the code of its day: a page that quotes one names its version (of 0.1.0 its commit)."""
    pages = runpy.run_path(str(repository / "docs/make_pages.py"))
    of, environment = validation(repository), pages["environment"]()
    named = 0
    for path, text in pages["pages"](repository)[0].items():
        template = (repository / "docs/pages" / path.name).read_text()
        for name in pages["quoted"](template, environment, repository):
            head = of["front_matter"](repository / f"docs/validation/{name}.md")
            code = f"version {head['version']}" if "version" in head else head["commit"][:7]
            assert re.search(rf"{code}[^()]* \([^)]*`{name}`", text), (
                f"{path.name} quotes {name}: write {{{{ measured }}}}"
            )
            named += 1
    assert named > 20


def test_a_record_is_older_when_its_code_is_another(repository, small):
    """Judged by the code at the commit of the record, not by the measure of code of that day."""
    of = validation(repository)
    git = ["git", "-C", str(small), "-c", "user.name=a", "-c", "user.email=a@b.c"]
    for folder in ("src", "workflow/scripts"):
        (small / folder).mkdir(parents=True)
    script = small / "workflow/scripts/wave_study.py"
    (small / "src/waves.py").write_text("HIGH = 1\n")
    script.write_text("import waves\n")
    for words in (["init", "-q"], ["add", "."], ["commit", "-qm", "waves"]):
        subprocess.run([*git, *words], check=True)
    commit = subprocess.run([*git, "rev-parse", "HEAD"], check=True, capture_output=True, text=True)
    record = small / "results/waves.csv.meta.json"
    record.write_text(record.read_text().replace("abc", commit.stdout.strip()))
    (entry,) = of["studies"](small).values()
    of["record"]("wave_study", entry, small, small / "docs/validation")
    assert of["changed_rules"]("wave_study", entry, small) == []  # "123" is of another measure
    (small / "src/high.py").write_text("HIGH = 2\n")
    script.write_text("import high\n")
    for kept in vars(codehash).values():  # files as they were
        if hasattr(kept, "cache_clear"):
            kept.cache_clear()
    assert of["changed_rules"]("wave_study", entry, small) == ["wave_study"]


def test_the_table_of_a_release(repository):
    of = runpy.run_path(str(repository / "docs/release_check.py"))
    studies = validation(repository)["studies"](repository)
    names = of["order"](studies)
    assert sorted(names) == sorted(studies)
    assert names[-2:] == ["basin", "ledger"]  # their ledgers read the other records
    assert names.index("ins_lidar_study") < names.index("full")
    assert of["words"]("offset_study", studies["offset_study"]) == ["offset_study"]
    picture = "results/reproduction/figures/bed_patterns.png"
    assert of["words"]("bed_findings_study", studies["bed_findings_study"]) == ["bed_findings_study", picture]
    assert of["words"]("field", studies["field"]) == ["all", "--config", "campaign=[field]"]
    before = {"waves": pd.DataFrame({"of": ["a", "b"], "ratio": [1.00004, 2.0], "met": [True, True]})}
    after = {"waves": pd.DataFrame({"of": ["a", "b"], "ratio": [1.00001, 2.1], "met": [True, False]})}
    assert of["verdict"](after) == "1 of 2"
    assert of["changed_digits"](before, after) == "2 of 6"  # 2.1 and False; five digits nobody prints
    assert of["changed_digits"]({}, after) == "waves.csv has other rows or columns"
    made, again = {"state": "made again", "changed": "2 of 6"}, {"state": "as recorded", "changed": ""}
    assert (
        of["kept"](again, made) == made
    )  # a second run, after a stop, does not lose what the first one said
    assert of["kept"](again, {"state": "failed (1)"}) == of["kept"](again, {}) == again
    assert of["kept"](made, again) == made
    same = {"state": "first survey as before", "changed": ""}
    assert of["kept"](same, made) == same | {"changed": "2 of 6"}
    assert of["kept"](again, same) == same


def test_a_study_of_other_code_is_made_again_where_its_first_survey_is(repository, small, monkeypatch):
    of = runpy.run_path(str(repository / "docs/release_check.py"))
    rules, heights_m, targets = ["wave_study"], [1.0, 2.0], []
    validation = {**of["validation"], "changed_rules": lambda *_: rules}
    (entry,) = validation["studies"](small).values()
    entry |= {"study": "waves:STUDY", "jobs": {"seeds_a_job": 2}}
    assert validation["first_jobs"](entry) == ["survey_1_to_2"]
    assert validation["first_jobs"]({"campaign": ["tiny"]}) == []

    def run(command, **_):
        targets.append(command[3])
        rows = small / "results/reproduction/wave_study/survey_1_to_2/rows.parquet"
        rows.parent.mkdir(parents=True, exist_ok=True)
        pd.DataFrame({"height_m": heights_m}).to_parquet(rows)
        return subprocess.CompletedProcess(command, 0)

    inside = of["check"].__globals__
    monkeypatch.setitem(inside, "validation", validation)
    monkeypatch.setitem(inside, "subprocess", SimpleNamespace(run=run))

    def state() -> str:
        return str(of["check"]("wave_study", entry, [], small)["state"])

    first, whole = "results/reproduction/wave_study/survey_1_to_2", "wave_study"
    assert state() == "made again"  # nothing is recorded
    rules.clear()
    assert (state(), targets) == ("as recorded", [whole, first])
    rules.append("wave_study")
    monkeypatch.setitem(validation["confirm"].__globals__, "now", lambda *_: "456")
    assert (state(), targets[2:]) == ("first survey as before", [first])
    head = validation["front_matter"](small / "docs/validation/wave_study.md")
    assert head["code"] == {"wave_study": "456"}
    assert head["date"] == "2026-05-01"  # of the numbers
    assert head["first_survey_as_before"][:2] == "20"
    heights_m[1] = 2.01
    assert (state(), targets[3:]) == ("made again", [first, whole, first])
    assert "first_survey_as_before" not in validation["front_matter"](small / "docs/validation/wave_study.md")


@pytest.fixture
def small(tmp_path):
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
        "thalweg": "1.0.0",
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


def test_a_record_says_how_it_was_made_and_fills_the_page(repository, small):
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
        "version": "1.0.0",
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


def test_a_reference_to_nothing_is_refused(repository, small):
    of = validation(repository)
    of["record"]("wave_study", of["studies"](small)["wave_study"], small, small / "docs/validation")
    page = small / "docs/pages/README.md"
    pages = runpy.run_path(str(repository / "docs/make_pages.py"))["pages"]
    for wrong, answer in (('waves["non"].ratio', "no row"), ('waves["all"].rati', "no column 'rati'")):
        page.write_text("{{ " + wrong + " | d }}")
        with pytest.raises(ValueError, match=answer):
            pages(small)


def test_a_result_of_other_sizes_is_not_recorded(repository, small):
    of = validation(repository)
    path = small / "config/studies/wave_study.yaml"
    path.write_text(path.read_text().replace("seeds: 3", "seeds: 60"))
    with pytest.raises(InputError, match="make study NAME=wave_study"):
        of["record"]("wave_study", of["studies"](small)["wave_study"], small, small / "docs/validation")


def test_a_row_of_timings_replaces_that_of_its_campaign(repository, tmp_path):
    of = runpy.run_path(str(repository / "docs/make_timings.py"))
    for name in ("tiny", "demo", "tiny"):
        table = of["with_row"](tmp_path / "t.csv", {"campaign": name, "wall_min": 1.0})
        table.to_csv(tmp_path / "t.csv", index=False)
    assert table["campaign"].tolist() == ["demo", "tiny"]


def test_records_are_of_the_sizes_of_the_rules(repository):
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
    *("# Thalweg", "How good is it"),  # README.md
    *("Calibration", "Trajectories", "Clouds", "Consistency", "Light sheet", "Change"),  # docs/accuracy.md
)
"""Sections of the pages that quote the twin."""
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
        r"3\.1[13](?= )",  # versions of Python
        r"0\.1 m or more",  # size of a simulated change
    ]
)
"""Numbers that are not of the twin, or its input."""


def typed(template: str) -> list[str]:
    """Numbers in sections on the twin that come from no record; names of rows and published columns may."""
    text = re.sub(r"```.*?```|`[^`\n]*`|\{\{.*?\}\}|\{%.*?%\}|\{#.*?#\}", " ", template, flags=re.S)
    found = []
    for section in re.split(r"(?m)^## ", text):
        if not section.startswith(TWIN):
            continue
        published: set[int] = set()  # counted from the end: a macro may fill several cells
        for line in section.splitlines():
            cells = line.split("|") if line.startswith("|") else [line]
            given = {
                k - len(cells) for k, cell in enumerate(cells) if re.match(r" (?:published|target)\b", cell)
            }
            if given and len(cells) > 1:
                published = given
            kept = " ".join(
                c
                for k, c in enumerate(cells)
                if len(cells) == 1 or (k != 1 and k - len(cells) not in published)
            )
            found += re.findall(r"\d+\.\d+|± \d+|\d+ (?:surveys|seeds|runs)\b", re.sub(GIVEN, " ", kept))
    return found


def test_no_number_of_the_twin_is_typed(repository):
    for page in ("README.md", "accuracy.md"):
        text = (repository / "docs/pages" / page).read_text()
        assert typed(text) == [], page
        assert sum(section.startswith(TWIN) for section in re.split(r"(?m)^## ", text)) >= 2, page


def test_a_typed_number_is_seen():
    table = "## Consistency\n\n| case | ours | published |\n| --- | --- | --- |\n| a 0.1 | 1.98 | 2.5 |\n"
    assert typed(table) == ["1.98"]
    assert typed("## Consistency\n\nThe sigma is 0.93 here, {{ x | d(2) }}, P4 4.1 has 15.\n") == ["0.93"]
    assert typed("## Speed\n\n3.2\n") == []
