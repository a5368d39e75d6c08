"""The door to COLMAP."""

import re
import sys
from pathlib import Path

import pytest

from thalweg.core import InputError
from thalweg.images.sfm import colmap


def test_it_is_the_locked_version(repository: Path) -> None:
    text = (repository / "pyproject.toml").read_text()
    (pinned,) = re.findall(r'"pycolmap==([\d.]+)"', text)
    assert colmap().__version__ == pinned


def test_its_log_is_quiet(capfd: pytest.CaptureFixture[str]) -> None:
    pc = colmap()
    pc.FeatureExtractor.create(pc.FeatureExtractionOptions(), pc.Device.cpu)  # tells that it was made
    pc.logging.error("an error that the callers tell in their own words")
    assert capfd.readouterr() == ("", "")


def test_a_missing_module_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(InputError, match=r"needs the package pycolmap.*thalweg\[images\]"):
        colmap()
