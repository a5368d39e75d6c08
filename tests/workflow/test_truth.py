"""Rules that process never see the truth of the digital twin, however its path reaches them."""

import contextlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import laspy
import numpy as np
import pandas as pd
import pytest
import yaml
from PIL import Image
from snakemake.iocontainers import InputFiles, Log, OutputFiles, Params

from thalweg.core import InputError, LocalFrame, Trajectory, iter_laz, laz_header, read_parquet
from thalweg.workflow import run_job
from thalweg.workflow.truth import may_read_truth, truth_closed

REFUSED = r"rule process: the truth of the digital twin is closed to this rule, which opens \S*truth"


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    """A small truth in each format of the twin, beside a log."""
    folder = tmp_path_factory.mktemp("campaign") / "simulation" / "truth"
    folder.mkdir(parents=True)
    (folder.parent / "logs").mkdir()
    (folder.parent / "logs" / "depth.nmea").write_text("$\n")
    Trajectory(
        frame=LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0),
        t_gps_s=np.arange(2.0),
        position_wcs_m=np.zeros((2, 3)),
        quaternion_wcs_ics=np.tile([0.0, 0.0, 0.0, 1.0], (2, 1)),
        cov_pose_wcs=np.zeros((2, 6, 6)),
        valid=np.ones(2, bool),
    ).write(folder / "trajectory.parquet")
    np.savez(folder / "scene.npz", a=np.arange(2.0))
    (folder / "mounts.json").write_text("{}")
    (folder / "field.yaml").write_text("a: 1\n")
    pd.DataFrame({"a": [1.0]}).to_csv(folder / "shots.csv")
    Image.fromarray(np.zeros((8, 8), np.uint8)).save(folder / "mask.png")
    cloud = laspy.LasData(laspy.LasHeader(point_format=6, version="1.4"))
    cloud.x = cloud.y = cloud.z = np.arange(2.0)
    cloud.write(str(folder / "cloud.laz"))
    return folder


READERS: dict[str, Callable[[Path], Any]] = {
    "trajectory": lambda truth: Trajectory.read(truth / "trajectory.parquet"),
    "any Parquet": lambda truth: read_parquet(truth / "trajectory.parquet"),
    "NumPy": lambda truth: np.load(truth / "scene.npz"),
    "bytes by NumPy": lambda truth: np.fromfile(truth / "scene.npz", np.uint8),
    "JSON": lambda truth: json.loads((truth / "mounts.json").read_text()),
    "YAML": lambda truth: yaml.safe_load((truth / "field.yaml").read_text()),
    "CSV": lambda truth: pd.read_csv(truth / "shots.csv"),
    "picture": lambda truth: Image.open(truth / "mask.png").load(),
    "picture by OpenCV": lambda truth: cv2.imdecode(np.fromfile(truth / "mask.png", np.uint8), 0),
    "LAZ": lambda truth: list(iter_laz(truth / "cloud.laz")),
    "LAZ header": lambda truth: laz_header(truth / "cloud.laz"),
    "LAZ by laspy": lambda truth: laspy.read(truth / "cloud.laz"),
    "copy": lambda truth: shutil.copy(truth / "mounts.json", truth.parent / "logs" / "copy.json"),
    "list": lambda truth: list(truth.iterdir()),
    "pattern": lambda truth: sorted(truth.parent.glob("truth/*.json")),
    "detour": lambda truth: (truth.parent / "logs/../truth/mounts.json").read_text(),
}
"""Ways to open a file, with a path that the script computes itself."""


class Job:
    """What Snakemake hands to a script."""

    threads = 1

    def __init__(self, folder: Path, rule: str, *, scene: Path, **params: object) -> None:
        self.rule = rule
        self.input = InputFiles(fromdict={"scene": str(scene)})
        self.output = OutputFiles(fromdict={"result": str(folder / "out.txt")})
        self.log = Log([])
        self.params = Params(fromdict={"code": "abc", **params})


@pytest.fixture(autouse=True)
def _no_log(monkeypatch):
    monkeypatch.setattr("thalweg.workflow.job._start_log", lambda path: None)
    monkeypatch.setattr("thalweg.workflow.job._limit_threads", lambda threads: None)


def copy_text(*, scene: Path, result: Path, mounts: str = "", deep: Any = None) -> None:
    result.write_text(scene.read_text())


def test_a_declared_input_is_refused(truth, tmp_path):
    with pytest.raises(InputError, match=REFUSED + r"/mounts.json; expected .* compare_\.\.\._with_truth"):
        run_job(copy_text, Job(tmp_path, "process", scene=truth / "mounts.json"))
    assert not (tmp_path / "out.txt").exists()


@pytest.mark.parametrize("params", [{"mounts": "{}"}, {"deep": {"files": ["a", "{}"]}}])
def test_a_path_among_the_params_is_refused(truth, tmp_path, params):
    path = str(truth / "mounts.json")
    params = json.loads(json.dumps(params).replace("{}", path))
    with pytest.raises(InputError, match=REFUSED):
        run_job(copy_text, Job(tmp_path, "process", scene=truth.parent / "logs/depth.nmea", **params))
    assert not (tmp_path / "out.txt").exists()


@pytest.mark.parametrize("read", READERS.values(), ids=READERS)
def test_a_path_that_the_script_computes_is_refused(truth, tmp_path, read):
    def main(*, scene: Path, result: Path) -> None:
        read(scene.parents[1] / "truth")
        result.write_text("done")

    log = truth.parent / "logs/depth.nmea"
    with pytest.raises(InputError, match=REFUSED):
        run_job(main, Job(tmp_path, "process", scene=log))
    assert not (tmp_path / "out.txt").exists()
    # what may read it can, after as before
    run_job(main, Job(tmp_path, "compare_with_truth", scene=log))
    assert (tmp_path / "out.txt").read_text() == "done"


def test_an_error_that_the_script_catches_counts_all_the_same(truth):
    def hushed():
        with contextlib.suppress(Exception):
            (truth / "mounts.json").read_text()

    with pytest.raises(InputError, match=REFUSED), truth_closed("process"):
        hushed()


def test_a_link_does_not_hide_the_truth(truth, tmp_path):
    inward, outward = tmp_path / "harmless", tmp_path / "simulation" / "truth"
    inward.symlink_to(truth)
    outward.parent.mkdir()
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk/mounts.json").write_text("{}")
    outward.symlink_to(tmp_path / "disk")  # results on another disk
    for folder in (inward, outward):
        with pytest.raises(InputError, match="closed to this rule"), truth_closed("process"):
            (folder / "mounts.json").read_text()


def test_all_else_stays_open(truth, tmp_path):
    (tmp_path / "accuracy").mkdir()
    (tmp_path / "accuracy/truth_statistics.csv").write_text("a\n")
    with truth_closed("process", [{"title": "simulation of truth", "n": 3}]):
        assert (truth.parent / "logs/depth.nmea").read_text() == "$\n"
        assert (tmp_path / "accuracy/truth_statistics.csv").read_text() == "a\n"
    assert (truth / "mounts.json").read_text() == "{}"


@pytest.mark.parametrize(
    ("rule", "may"),
    [
        ("simulate_lidar", True),
        ("compare_with_truth", True),
        ("compare_bed_with_truth", True),
        ("chain_study", True),
        ("plot_chain_study", False),
        ("compare_with_reference", False),
        ("georeference_lidar", False),
        ("plot_compare_with_truth", False),
        ("summarise", False),
    ],
)
def test_only_the_twin_and_its_judges_may_read_the_truth(rule, may):
    assert may_read_truth(rule) is may
