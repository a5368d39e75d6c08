"""The wheel works on its own, outside the repository: commands, workflow, example campaigns, extras."""

import os
import re
import site
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path
from typing import Final

import pytest

from thalweg.core import EXTRAS
from thalweg_lab import writers

MAPPED: Final = ("workflow/", "config/", "profiles/", "resources/", "envs/thalweg.yaml", "Snakefile")
"""What of the repository a folder of one's own needs."""
WITHOUT_EXTRAS: Final = f"""\
import importlib, pkgutil, sys
for name in {sorted(EXTRAS)}:
    sys.modules[name] = None
import thalweg, thalweg_lab
for package in (thalweg, thalweg_lab):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
from thalweg.cli import main
raise SystemExit(main(["print-markers", "markers.pdf", "--ids", "0-3"]))
"""


@pytest.fixture(scope="module")
def built(repository, tmp_path_factory):
    """The wheel, built as `pip wheel` does, by the locked hatchling."""
    folder = tmp_path_factory.mktemp("wheel")
    return build(repository, folder, "wheel")


def build(repository: Path, folder: Path, kind: str) -> Path:
    command = [sys.executable, "-m", "hatchling", "build", "-t", kind, "-d", str(folder)]
    subprocess.run(command, cwd=repository, check=True, capture_output=True, timeout=300)
    (made,) = folder.glob("thalweg-*")
    return made


@pytest.fixture(scope="module")
def python(built):
    """Interpreter of an empty environment with the wheel, and the packages of this one beside it."""
    folder = built.parent / "venv"
    venv.create(folder)
    (packages,) = folder.glob("lib/python*/site-packages")
    with zipfile.ZipFile(built) as archive:  # what pip does with a wheel of pure Python
        archive.extractall(packages)
    (packages / "beside.pth").write_text("\n".join(site.getsitepackages()))
    return folder / "bin" / "python"


def run(python: Path, *words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    command = [str(python), "-m", "thalweg", *words] if words[0] != "-c" else [str(python), *words]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=1800
    )  # fmt: skip


def test_the_wheel_holds_what_the_repository_tracks(built, repository):
    git = ["git", "ls-files", "src", *MAPPED]
    tracked = subprocess.run(git, cwd=repository, capture_output=True, text=True, check=True).stdout.split()
    wanted = {each.removeprefix("src/") for each in tracked if each.startswith("src/")}
    wanted |= {f"thalweg/workflow_files/{each}" for each in tracked if not each.startswith("src/")}
    held = set(zipfile.ZipFile(built).namelist())
    assert len(wanted) > 700
    assert wanted - held == set()
    others = {each for each in held - wanted if ".dist-info/" not in each and "/docs/validation/" not in each}
    assert {each for each in others if not (repository / "src" / each).exists()} == set()


def test_the_same_bytes_twice(built, repository, tmp_path):
    again = build(repository, tmp_path, "wheel")
    assert again.name == built.name
    assert again.read_bytes() == built.read_bytes()


def test_commands_run_from_the_wheel(python, repository, tmp_path):
    assert run(python, "--version", folder=tmp_path).stdout.startswith("thalweg ")
    (tmp_path / "echo.nmea").write_bytes(writers.dbt(2.01).encode())
    described = run(python, "describe", "echo.nmea", folder=tmp_path)
    assert described.returncode == 0, described.stderr
    assert "NMEA" in described.stdout
    budget = run(python, "budget", str(repository / "resources/budgets/p2_table1.yaml"), folder=tmp_path)
    assert budget.returncode == 0, budget.stderr
    assert "total                        39.0" in budget.stdout


def test_a_campaign_runs_in_a_new_folder(python, tmp_path):
    laid = run(python, "init", "surveys", folder=tmp_path)
    assert laid.returncode == 0, laid.stderr
    assert "thalweg run tiny" in laid.stdout
    folder = tmp_path / "surveys"
    dry = run(python, "run", "tiny", "-n", "--quiet", "all", folder=folder)
    assert dry.returncode == 0, dry.stderr
    assert "This was a dry-run" in dry.stdout + dry.stderr
    assert "georeference_lidar" in dry.stdout + dry.stderr
    again = run(python, "init", "surveys", folder=tmp_path)
    assert again.returncode == 2
    assert "the folder is laid already" in again.stderr
    unknown = run(python, "run", "tinny", "-n", folder=folder)
    assert unknown.returncode == 1
    assert "tiny" in unknown.stdout + unknown.stderr


def test_another_workflow_takes_it_as_a_module(python, repository, tmp_path):
    """The declaration of docs/howto/install.md, as Snakedeploy writes it."""
    page = (repository / "docs/howto/install.md").read_text(encoding="utf-8")
    (declared,) = re.findall(r"```python\n(configfile:.+?)```", page, re.S)
    assert run(python, "init", ".", folder=tmp_path).returncode == 0
    place = run(python, "workflow-path", folder=tmp_path).stdout.strip()
    assert Path(place).is_relative_to(python.parents[1])
    (tmp_path / "Snakefile").write_text(declared.replace("/path/of/thalweg/workflow_files/Snakefile", place))
    words = ["-n", "--quiet", "all", "--cores", "1", "--config", "campaign=tiny"]
    code = f"import sys; sys.argv = ['snakemake', *{words}]; from snakemake.cli import main; main()"
    dry = run(python, "-c", code, folder=tmp_path)
    assert dry.returncode == 0, dry.stderr
    assert "georeference_lidar" in dry.stdout + dry.stderr


def test_without_extras_all_modules_load_and_a_product_names_its_extra(python, tmp_path):
    refused = run(python, "-c", WITHOUT_EXTRAS, folder=tmp_path)
    assert refused.returncode == 2, refused.stderr
    assert "needs the package cv2, which is not installed" in refused.stderr
    assert 'pip install "thalweg[images]"' in refused.stderr


def test_extras_are_those_of_the_project(repository):
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    assert set(EXTRAS.values()) <= set(extras)
    # all but the one that goes with no lock
    (everything,) = re.findall(r"\[(.+)\]", extras["all"][0])
    assert set(everything.split(",")) == set(EXTRAS.values()) - {"ouster"}
