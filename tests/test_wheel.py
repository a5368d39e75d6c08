"""The wheel of the library works on its own: outside the repository, without the laboratory."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from thalweg_lab import writers

# As in an environment that holds the wheel and its dependencies, and nothing of the repository.
RUN = """\
import sys
sys.path[:] = [{place!r}, *(p for p in sys.path if not p.endswith("/src"))]
sys.modules["thalweg_lab"] = None
import thalweg
assert thalweg.__file__.startswith({place!r}), thalweg.__file__
from thalweg.cli import main
raise SystemExit(main({arguments!r}))
"""


@pytest.fixture(scope="module")
def wheel(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the unpacked wheel, built as `pip wheel` does, by the locked hatchling."""
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=repository,
        check=True,
        capture_output=True,
        timeout=120,
    )
    (built,) = folder.glob("thalweg-*.whl")
    with zipfile.ZipFile(built) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


def run(wheel: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    text = RUN.format(place=str(wheel), arguments=list(arguments))
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    return subprocess.run(
        [sys.executable, "-c", text], cwd=wheel.parent, env=environment, capture_output=True, text=True,
        check=False, timeout=120,
    )  # fmt: skip


def test_the_wheel_holds_the_library_and_not_the_laboratory(wheel: Path, repository: Path) -> None:
    library = repository / "src"
    shipped = {
        p.relative_to(library) for p in (library / "thalweg").rglob("*") if p.suffix not in {"", ".pyc"}
    }
    found = {p.relative_to(wheel) for p in (wheel / "thalweg").rglob("*") if p.is_file()}
    assert {p for p in shipped - found if "__pycache__" not in p.parts} == set()
    assert not (wheel / "thalweg_lab").exists()


def test_commands_run_from_the_wheel(wheel: Path, repository: Path, tmp_path: Path) -> None:
    assert run(wheel, "--version").stdout.startswith("thalweg ")
    log = tmp_path / "echo.nmea"
    log.write_bytes(writers.dbt(2.01).encode())
    described = run(wheel, "describe", str(log))
    assert described.returncode == 0, described.stderr
    assert "NMEA" in described.stdout
    budget = run(wheel, "budget", str(repository / "resources/budgets/p2_table1.yaml"))
    assert budget.returncode == 0, budget.stderr
    assert "total                      39.0" in budget.stdout
