"""Images, continuous integration, citation and catalogue name what there is."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

import thalweg


@pytest.mark.parametrize("name", ["Containerfile", "envs/thalweg.def"])
def test_images_hold_the_locked_environment(repository: Path, name: str) -> None:
    text = (repository / name).read_text()
    assert "--require-hashes -r envs/requirements.lock" in text
    (python,) = re.findall(r"python:(3\.\d+)-slim", text)
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    assert python in SpecifierSet(project["requires-python"])
    assert "touch .venv/.complete" in text  # else `make` in the image would begin anew


def test_both_images_are_the_same(repository: Path) -> None:
    taken = [
        re.findall(
            r"python:\S+|--no-install-recommends (.*?)(?: \\)?$", (repository / name).read_text(), re.M
        )
        for name in ("Containerfile", "envs/thalweg.def")
    ]
    assert taken[0] == taken[1] != []


def test_continuous_integration_runs_the_own_command(repository: Path) -> None:
    jobs = yaml.safe_load((repository / ".github/workflows/ci.yml").read_text())["jobs"]
    runs = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    assert runs == [".ci/run", "make docs"]
    assert (repository / ".ci/run").stat().st_mode & 0o111
    assert re.search(r"(?m)^docs:", (repository / "Makefile").read_text())


def test_citation_is_of_this_version(repository: Path) -> None:
    citation = yaml.safe_load((repository / "CITATION.cff").read_text())
    assert citation["version"] == thalweg.__version__
    assert (
        citation["license"]
        == tomllib.loads((repository / "pyproject.toml").read_text())["project"]["license"]
    )


def test_the_catalogue_names_a_campaign_that_is_there(repository: Path) -> None:
    usage = yaml.safe_load((repository / ".snakemake-workflow-catalog.yml").read_text())["usage"]
    (campaign,) = re.findall(r"campaign=(\w+)", usage["mandatory-flags"]["flags"])
    assert (repository / f"config/campaigns/{campaign}.yaml").is_file()
    assert usage["software-stack-deployment"]["conda"] == (repository / "envs/thalweg.yaml").is_file()


def test_the_site_is_locked_beside_the_rest(repository: Path) -> None:
    """Both locks fill one environment: no package may have two versions, and each has its hashes."""
    versions: dict[str, dict[str, set[str]]] = {}
    for name in ("requirements", "docs"):
        text = (repository / f"envs/{name}.lock").read_text()
        for package, version in re.findall(r"(?m)^([\w.-]+)==([\w.+]+)", text):
            versions.setdefault(canonicalize_name(package), {}).setdefault(name, set()).add(version)
    both = {package: each for package, each in versions.items() if len(each) == 2}
    assert {"jinja2", "pyyaml"} <= set(both)
    assert {package: each for package, each in both.items() if not each["docs"] <= each["requirements"]} == {}
    lock = (repository / "envs/docs.lock").read_text()
    assert not re.search(r"https?:|index-url|file:", lock)
    for block in re.split(r"(?m)^(?=[\w.-]+==)", lock)[1:]:
        assert "--hash=sha256:" in block, block.splitlines()[0]
    wanted = tomllib.loads((repository / "pyproject.toml").read_text())["dependency-groups"]["docs"]
    for requirement in map(Requirement, wanted):
        found = versions[canonicalize_name(requirement.name)]["docs"]
        assert all(version in requirement.specifier for version in found), requirement
