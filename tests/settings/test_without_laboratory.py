"""The library without its laboratory: surveys load, twins are refused with what is missing."""

import subprocess
import sys
from pathlib import Path

RUN = """\
import sys
sys.modules["thalweg_lab"] = None
from thalweg.cli import main
raise SystemExit(main(sys.argv[1:]))
"""


def run(*arguments: str, repository: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", RUN, *arguments], cwd=repository, capture_output=True, text=True, check=False
    )


def test_a_twin_without_the_laboratory_is_refused_with_what_is_missing(repository):
    result = run("check-config", "tiny", repository=repository)
    assert result.returncode == 2
    assert "twin: a digital twin, but the laboratory that simulates it (package thalweg_lab)" in result.stderr
    assert "is not installed" in result.stderr
    assert result.stderr.startswith("1 mistake")


def test_a_survey_needs_no_laboratory(repository, tmp_path):
    points = "\n".join(f"{x} {y} {(x * y) % 3}" for x in range(12) for y in range(12))
    for name in ("cloud.xyz", "reference.xyz"):
        (tmp_path / name).write_text(points, encoding="utf-8")
    campaign = tmp_path / "bank.yaml"
    campaign.write_text(
        "campaign: {id: bank, title: A bank, crs: local}\n"
        "logs: {cloud: [cloud.xyz], reference: [reference.xyz]}\n",
        encoding="utf-8",
    )
    result = run("check-config", str(campaign), repository=repository)
    assert result.returncode == 0, result.stderr
    assert result.stdout.startswith("bank: ok. A bank")
