"""Images, continuous integration, citation and catalogue name what there is."""

import json
import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

import thalweg
from tests.test_house import CONDA_NAMES


@pytest.mark.parametrize("name", ["Containerfile", "envs/thalweg.def"])
def test_images_hold_the_locked_environment(repository, name):
    text = (repository / name).read_text()
    assert "--require-hashes -r envs/requirements.lock" in text
    assert len(re.findall(r"(?m)^OSVersion: bookworm$|debian:bookworm-slim$", text)) == 1
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    assert "3.11" in SpecifierSet(project["requires-python"])  # of Debian 12
    assert "touch .venv/.complete" in text  # else `make` in the image would begin anew


def test_the_conda_environment_is_the_locked_one_with_what_the_package_asks_for(repository):
    """Names as `pyproject.toml` asks for them, with all extras; versions, where stated, of the lock."""
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    (everything,) = map(Requirement, extras["all"])
    asked = [*project["dependencies"], *(each for name in everything.extras for each in extras[name])]
    wanted = {
        canonicalize_name(each.name)
        for each in map(Requirement, asked)
        if each.marker is None
        or each.marker.evaluate({"sys_platform": "linux", "platform_machine": "x86_64"})
    }
    listed = yaml.safe_load((repository / "envs/thalweg.yaml").read_text())["dependencies"]
    texts = [text for entry in listed for text in (entry["pip"] if isinstance(entry, dict) else [entry])]
    on_pypi = {conda: name for name, conda in CONDA_NAMES.items()}
    stated = {
        canonicalize_name(on_pypi.get(name, name)): version
        for name, version in (re.fullmatch(r"([\w-]+)=*([\d.]*)", text).groups() for text in texts)
    }
    assert wanted - set(stated) == {"snakemake"}  # forks or starts the jobs, from an environment of its own
    assert set(stated) - wanted == {"python", "pip", "lazrs"}  # lazrs: behind laspy[lazrs]
    lock = (repository / "envs/requirements.lock").read_text()
    locked: dict[str, str] = {}  # a package with a version for each Python: that of the lowest comes first
    for name, version in re.findall(r"(?m)^([\w.-]+)==([\w.+]+)", lock):
        locked.setdefault(canonicalize_name(name), f"{version}.")
    assert {n: v for n, v in stated.items() if not locked.get(n, f"{v}.").startswith(f"{v}.")} == {}
    assert stated["python"] in SpecifierSet(project["requires-python"])


def test_both_images_are_the_same(repository):
    taken = [
        set(re.findall(r"--no-install-recommends (.*?)(?: \\)?$", text, re.M)[0].split())
        - {"ca-certificates"}
        for text in ((repository / name).read_text() for name in ("Containerfile", "envs/thalweg.def"))
    ]
    assert taken[0] == taken[1] != set()


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("mmdebstrap") or os.geteuid() != 0, reason="needs mmdebstrap and root")
def test_the_image_is_built_in_a_chroot(repository, tmp_path):
    """What Apptainer would do, without it: a minimal Debian, the files, `%post`; then a dry run inside."""
    text = (repository / "envs/thalweg.def").read_text()
    head = dict(re.findall(r"(?m)^(\w+): (.*)$", text.split("%files")[0]))
    root, place = tmp_path / "root", tmp_path / "root/opt/thalweg"
    words = ("--variant=minbase", f"--include={head['Include']}", head["OSVersion"])
    subprocess.run(["mmdebstrap", *words, str(root)], check=True)  # from its own mirror
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=repository, capture_output=True, check=True).stdout
    for name in filter(None, listed.decode().split("\0")):
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(repository / name, place / name)
    for name in ("resolv.conf", "ssl/certs/ca-certificates.crt"):  # of this computer: its network
        if Path("/etc", name).exists():
            shutil.copy(Path("/etc", name), root / "etc" / name)
    (root / "post.sh").write_text(text.split("%post\n")[1].split("%environment")[0])
    proxies = [f"{key}={value}" for key, value in os.environ.items() if key.lower().endswith("_proxy")]
    inside = ["chroot", str(root), "/usr/bin/env", "-i", "HOME=/root", "PATH=/usr/sbin:/usr/bin:/sbin:/bin"]
    subprocess.run(["mount", "-t", "proc", "proc", str(root / "proc")], check=True)
    try:
        subprocess.run([*inside, *proxies, "sh", "-e", "/post.sh"], check=True)
        dry = "cd /opt/thalweg && .venv/bin/snakemake --dry-run --quiet rules --config campaign=tiny"
        run = subprocess.run([*inside, "sh", "-c", dry], capture_output=True, text=True, check=True)
    finally:
        subprocess.run(["umount", str(root / "proc")], check=True)
    assert re.search(r"(?m)^total +\d{2,}$", run.stdout), run.stdout


def test_continuous_integration_runs_the_own_command(repository):
    jobs = yaml.safe_load((repository / ".github/workflows/ci.yml").read_text())["jobs"]
    runs = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    assert runs == [".ci/run", "make demo", "make dist", "make docs"]
    assert (repository / ".ci/run").stat().st_mode & 0o111
    targets = re.findall(r"(?m)^(\w+):", (repository / "Makefile").read_text())
    assert {run.removeprefix("make ") for run in runs[1:]} <= set(targets)
    assert jobs["test"]["strategy"]["matrix"]["python"] == ["3.11", "3.13"]


def test_citation_is_of_this_version(repository):
    citation = yaml.safe_load((repository / "CITATION.cff").read_text())
    for name in ("codemeta.json", ".zenodo.json"):
        other = json.loads((repository / name).read_text())
        assert (other["version"], other["license"].split("/")[-1]) == (
            citation["version"],
            citation["license"],
        )
    assert citation["version"] == thalweg.__version__
    assert (
        citation["license"]
        == tomllib.loads((repository / "pyproject.toml").read_text())["project"]["license"]
    )


def test_a_version_of_the_changelog_is_short(repository):
    _, *versions = re.split(r"(?m)^## ", (repository / "CHANGELOG.md").read_text(encoding="utf-8"))
    assert versions[0].startswith(f"[{thalweg.__version__}]")
    assert {each.split()[0]: n for each in versions if (n := len(each.split())) > 600} == {}


def test_the_catalogue_names_a_campaign_that_is_there(repository):
    usage = yaml.safe_load((repository / ".snakemake-workflow-catalog.yml").read_text())["usage"]
    (campaign,) = re.findall(r"campaign=(\w+)", usage["mandatory-flags"]["flags"])
    assert (repository / f"config/campaigns/{campaign}.yaml").is_file()
    assert usage["software-stack-deployment"]["conda"] == (repository / "envs/thalweg.yaml").is_file()


def test_the_site_is_locked_beside_the_rest(repository):
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
