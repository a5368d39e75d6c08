"""Speed of distances between two clouds beside py4dgeo's M3C2: the same points, the same cylinders, CPU time.

Two clouds of a million points each, 100,000 core points, normals at one radius. Beside py4dgeo's distances,
spreads and roughness, Thalweg computes the weights of every moment of the platform in each distance and the
covariance that follows (`thalweg.deformation.field`). py4dgeo is no part of the locked environment:

    pip install --no-deps --target FOLDER py4dgeo pooch platformdirs dateparser pytz regex tzlocal \
        scikit-learn joblib threadpoolctl seaborn xdg geojson cloudpickle loky
    THALWEG_PY4DGEO=FOLDER pytest -m slow -s tests/benchmarks/test_speed_m3c2.py

Each program has a process of its own; CPU seconds are those of all its threads, without start and reading.
Thalweg's loops were compiled in a run before.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks import turns

pytestmark = pytest.mark.slow


SIZE_M = (200.0, 50.0)
MOMENTS = 2000  # of the platform: a tenth of a second each
RADIUS_M, REACH_M = 0.5, 2.5  # with an even number of segments (3 m) py4dgeo 1.2.0 miscounts

TIMED = (
    turns.MEASURES
    + """
import os
import numpy as np
before, after, cores = (np.load(f"{name}.npy") for name in ("before", "after", "cores"))
"""
)
OURS = """
from thalweg.deformation.field import ErrorField, ErrorGroup
from thalweg.deformation.m3c2 import ColumnIndex, cut_cylinders, multiscale_normals, pose_weights
boat = np.load("boat.npy")
t = np.arange(len(boat)) * 0.1
position = ErrorGroup.from_sigmas("position", t, np.array([0.02, 0.02, 0.03]), 30.0)
attitude = ErrorGroup.from_sigmas("attitude", t, np.radians([0.05, 0.05, 0.1]), 30.0)
nodes = [np.load(f"node_{name}.npy") for name in ("before", "after")]
shape = {"radius_m": RADIUS, "half_length_m": REACH}
def run(n):
    clock = [cpu()]
    at = cores[:n]
    indices = [ColumnIndex.of(each, RADIUS) for each in (before, after)]
    normals, _ = multiscale_normals(at, indices[0], (RADIUS,), towards=np.array([0.0, 0.0, 1.0]))
    cuts = [cut_cylinders(at, normals, each, **shape) for each in indices]
    distance = cuts[1].along_m - cuts[0].along_m
    clock.append(cpu())
    variance = 0.0
    for index, node in zip(indices, nodes):
        weights = pose_weights(at, normals, index, node, boat, **shape)
        variance = variance + ErrorField.of_distances(weights, position, attitude).variances()
    clock.append(cpu())
    return distance, np.sqrt(variance), normals, np.diff(clock).tolist()
run(300)
begin = time.perf_counter()
distance, sigma, normals, spent = run(None)
np.savez("ours.npz", distance=distance, sigma=sigma, normals=normals)
print(json.dumps({"cpu": spent, "wall": time.perf_counter() - begin}))
"""
THEIRS = """
import py4dgeo
begin, start = time.perf_counter(), cpu()
epochs = tuple(py4dgeo.Epoch(each) for each in (before, after))
m3c2 = py4dgeo.M3C2(
    epochs=epochs, corepoints=cores, cyl_radius=RADIUS, max_distance=REACH, normal_radii=(RADIUS,)
)
distance, uncertainty = m3c2.run()
spent = cpu() - start
np.savez("theirs.npz", distance=distance, n=uncertainty["num_samples1"])
print(json.dumps({"cpu": [spent], "wall": time.perf_counter() - begin}))
"""
EP_CORES = 1000
ERROR_PROPAGATION = """
import py4dgeo
scanner = [{"origin": [100.0, -20.0, 5.0], "sigma_range": 0.02, "sigma_scan": 0.0005, "sigma_yaw": 0.001}]
def both():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return cpu() + used.ru_utime + used.ru_stime
if __name__ == "__main__":
    epochs = tuple(py4dgeo.Epoch(each) for each in (before, after))
    for each in epochs:
        each.scanpos_info = scanner
        each.scanpos_id = np.ones(len(before), np.int32)
        each.build_kdtree()
    normals = np.load("ours.npz")["normals"]
    some = np.linspace(0, len(cores) - 1, CORES).astype(int)
    begin, start = time.perf_counter(), both()
    m3c2 = py4dgeo.M3C2EP(
        epochs=epochs, corepoints=cores[some], corepoint_normals=normals[some], cyl_radius=RADIUS,
        max_distance=REACH, refPointMov=np.zeros(3), perform_trans=False, tfM=np.eye(4)[:3],
        Cxx=np.zeros((12, 12)),
    )
    found = m3c2.run()
    print(json.dumps({"cpu": [both() - start], "wall": time.perf_counter() - begin}))
"""

WHOLE = """
from thalweg.deformation.compare import Comparison, measure_distances
how = Comparison(scales_m=(RADIUS,), radius_m=RADIUS, half_length_m=REACH)
found = measure_distances(cores, before, after, how, towards=np.array([0.0, 0.0, 1.0]), tiles=TILES)
np.savez("tiles_TILES.npz", distance=found.distance_m, roughness=found.roughness_m)
print(json.dumps({"gb": peak_gb(), "cpu": [cpu()]}))
"""


def a_bank(rng: np.random.Generator, n: int, lift_m: float) -> np.ndarray:
    xy = rng.uniform(0.0, SIZE_M, (n, 2))
    z = 0.4 * xy[:, 1] + 0.3 * np.sin(xy[:, 0] / 4.0) + rng.normal(0.0, 0.02, n) + lift_m
    return np.column_stack([xy, z])


def run(folder: Path, text: str, path: str) -> dict[str, list[float]]:
    """Figures that a program of its own prints in its last line."""
    text = TIMED + text.replace("RADIUS", str(RADIUS_M)).replace("REACH", str(REACH_M))
    program = folder / "program.py"  # processes that a program starts read it again
    program.write_text(text)
    done = subprocess.run(
        [sys.executable, "-W", "ignore", str(program)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path, "XDG_DATA_HOME": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout.splitlines()[-1])


def test_distances_beside_py4dgeo(tmp_path, capsys):
    folder = os.environ.get("THALWEG_PY4DGEO")
    if not folder:
        pytest.skip("set THALWEG_PY4DGEO to a folder with py4dgeo (head of this file)")
    rng = np.random.default_rng(1)
    n = turns.sized(1e6)
    np.save(tmp_path / "boat.npy", np.column_stack([np.linspace(0, 200, MOMENTS), np.full((MOMENTS, 2), -5)]))
    for name, lift in (("before", 0.0), ("after", 0.05)):
        points = a_bank(rng, n, lift)
        np.save(tmp_path / f"{name}.npy", points)
        # a spinning scanner sees a place for some seconds
        seen = points[:, 0] / SIZE_M[0] * MOMENTS + rng.normal(0.0, 15.0, n)
        np.save(tmp_path / f"node_{name}.npy", np.clip(seen, 0, MOMENTS - 1).astype(np.int64))
    np.save(tmp_path / "cores.npy", np.load(tmp_path / "before.npy")[:: n // turns.sized(1e5)])

    source = str(Path(__file__).parents[2] / "src")
    took = {"ours": [], "theirs": []}
    for _ in range(3):
        took["ours"].append(run(tmp_path, OURS, source))
        took["theirs"].append(run(tmp_path, THEIRS, folder))
    ours, theirs = (np.load(tmp_path / f"{name}.npz") for name in took)
    cpu = {name: np.median([each["cpu"] for each in runs], axis=0) for name, runs in took.items()}
    wall = {name: np.median([each["wall"] for each in runs]) for name, runs in took.items()}
    propagated = run(tmp_path, ERROR_PROPAGATION.replace("CORES", str(EP_CORES)), folder)
    each_ms = {
        "ours": 1e3 * cpu["ours"].sum() / len(ours["distance"]),
        "ep": 1e3 * propagated["cpu"][0] / EP_CORES,
    }
    apart = np.abs(ours["distance"] - theirs["distance"])
    with capsys.disabled():
        print(
            f"\nDistances, 2 x {n:,} points, {len(apart):,} core points, {theirs['n'].mean():.0f} a cylinder:"
        )
        print(
            f"  Thalweg {cpu['ours'].sum():.1f} s CPU ({wall['ours']:.1f} s by the clock): distances "
            f"{cpu['ours'][0]:.1f} s, weights and covariance of {MOMENTS:,} moments {cpu['ours'][1]:.1f} s"
        )
        print(
            f"  py4dgeo {cpu['theirs'].sum():.1f} s CPU ({wall['theirs']:.1f} s by the clock): ratio "
            f"{cpu['ours'].sum() / cpu['theirs'].sum():.2f}, of distances alone "
            f"{cpu['ours'][0] / cpu['theirs'].sum():.2f}"
        )
        print(
            f"  py4dgeo with error propagation (M3C2-EP) {each_ms['ep']:.2f} ms CPU a core point, Thalweg "
            f"with covariance {each_ms['ours']:.3f} ms: {each_ms['ep'] / each_ms['ours']:.0f} times"
        )
        print(f"  {np.mean(apart < 1e-6):.4%} of the distances agree within 1e-6 m")
    assert np.mean(apart < 1e-6) > 0.99
    assert np.isfinite(ours["sigma"]).all()
    assert each_ms["ep"] > 20.0 * each_ms["ours"]


def test_large_clouds_in_pieces(tmp_path, capsys):
    """2 x 10 million points: below 1.5 GB, and the same numbers however many pieces there are."""
    rng = np.random.default_rng(2)
    n = turns.sized(1e7)
    for name, lift in (("before", 0.0), ("after", 0.05)):
        np.save(tmp_path / f"{name}.npy", a_bank(rng, n, lift))
    np.save(tmp_path / "cores.npy", np.load(tmp_path / "before.npy")[:: n // turns.sized(2e4)])
    source = str(Path(__file__).parents[2] / "src")
    used = {}
    for tiles in ("None", "1", "3", "7"):
        used[tiles] = run(tmp_path, WHOLE.replace("TILES", tiles), source)
    with capsys.disabled():
        print(f"\n2 x {n:,} points: " + ", ".join(f"{k} pieces {v['gb']:.2f} GB" for k, v in used.items()))
    assert used["None"]["gb"] < 1.5
    one = np.load(tmp_path / "tiles_1.npz")
    for tiles in ("None", "3", "7"):
        other = np.load(tmp_path / f"tiles_{tiles}.npz")
        for name in ("distance", "roughness"):
            assert other[name] == pytest.approx(one[name], abs=1e-9, nan_ok=True)
