"""The door to COLMAP."""

import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from thalweg.core import InputError
from thalweg.images.sfm import colmap, extract_features, mapping, matching
from thalweg.images.sfm.colmap import uses_gpu
from thalweg.settings.sections import MappingSettings


def test_it_is_the_locked_version(repository):
    text = (repository / "pyproject.toml").read_text()
    (pinned,) = re.findall(r'"pycolmap==([\d.]+)"', text)
    assert colmap().__version__ == pinned


def test_its_log_is_quiet(capfd):
    pc = colmap()
    pc.FeatureExtractor.create(pc.FeatureExtractionOptions(), pc.Device.cpu)  # tells that it was made
    pc.logging.error("an error that the callers tell in their own words")
    assert capfd.readouterr() == ("", "")


def test_a_missing_module_is_said(monkeypatch):
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(InputError, match=r"needs the package pycolmap.*thalweg\[images\]"):
        colmap()


def test_a_graphics_card_is_used_where_it_is_asked_for_or_there(monkeypatch, tmp_path):
    pc = colmap()
    monkeypatch.setattr(pc, "has_cuda", False)
    assert [uses_gpu("auto"), uses_gpu("cpu")] == [False, False]
    with pytest.raises(InputError, match=r"pycolmap without CUDA.*images\.device.*to auto or cpu"):
        extract_features([], device="cuda")
    monkeypatch.setattr(pc, "has_cuda", True)
    door = sys.modules[uses_gpu.__module__]
    monkeypatch.setattr(door, "_CARDS", (tmp_path / "none",))
    assert [uses_gpu(each) for each in ("auto", "cpu", "cuda")] == [False, False, True]
    monkeypatch.setattr(door, "_CARDS", (tmp_path,))
    assert [uses_gpu(each) for each in ("auto", "cpu", "cuda")] == [True, False, True]


@pytest.mark.parametrize("device", ["cpu", "cuda"])
def test_the_device_reaches_each_step_of_colmap(device, monkeypatch, tmp_path):
    """Options and device with which COLMAP would be called: none of it runs on a card here."""
    pc, on_gpu, called = colmap(), device == "cuda", {}
    monkeypatch.setattr(pc, "has_cuda", True)
    steps = ("extract_features", "match_image_pairs", "incremental_mapping", "global_mapping")
    for name in (*steps, "bundle_adjustment"):

        def call(*words: object, name: str = name) -> dict:
            called[name] = words
            return {}

        monkeypatch.setattr(pc, name, call)
    noise = np.random.default_rng(1).integers(0, 256, (200, 200), np.uint8)
    Image.fromarray(noise).save(tmp_path / "a.png")
    extract_features([tmp_path / "a.png"], device=device)
    matching._run_matching(tmp_path / "a.db", tmp_path / "pairs", MappingSettings(), 1.0, 1, on_gpu)
    block = SimpleNamespace(order=[0, 1], starts=(), scale=lambda: 1.0)
    for run in (mapping._incremental, mapping._global):
        (tmp_path / run.__name__).mkdir()
        run(tmp_path / run.__name__, block, MappingSettings(), 1, on_gpu)
    wanted = getattr(pc.Device, device)
    assert called["extract_features"][-1] == called["match_image_pairs"][-1] == wanted
    assert called["extract_features"][-2].use_gpu is on_gpu
    assert called["match_image_pairs"][1].use_gpu is on_gpu
    assert called["incremental_mapping"][-1].ba_use_gpu is on_gpu
    found = called["global_mapping"][-1].mapper
    assert found.global_positioning.use_gpu is found.bundle_adjustment.ceres.use_gpu is on_gpu
