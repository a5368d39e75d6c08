"""Speed of signed cloud-to-mesh distances beside CloudCompare, Open3D and trimesh: whole programs.

218,000 points and 5 million faces (P2 section 6.2). Each program starts anew, reads the same PLY mesh and the
points, and leaves with the distances. Peak memory is that of the program. Thalweg's loops were compiled in a
run before.
"""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.benchmarks import turns
from tests.surface import rough_bank
from thalweg.core import LocalFrame
from thalweg.core.geometry import write_mesh
from thalweg.surface import Surface

pytestmark = pytest.mark.slow


FACES, POINTS, ROWS = 5e6, 218_000, 397  # along a bank of 200 m; 12 m from its foot to its top
STEP_M, ROUGH_M = 0.0316, 0.01

OURS = """
import sys
from pathlib import Path
import numpy as np
from thalweg.surface.cloud_to_mesh import Surface
from thalweg.core.geometry.mesh import read_mesh
np.save("ours.npy", Surface(read_mesh(Path("ours.ply"))[0]).distances(np.load("points.npy")).distance_m)
"""
OPEN3D = """
import numpy as np
from thalweg.core.geometry.raycast import _open3d
o3d = _open3d()
scene = o3d.t.geometry.RaycastingScene()
scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(o3d.io.read_triangle_mesh("mesh.ply")))
points = o3d.core.Tensor(np.load("points.npy").astype(np.float32))
np.save("open3d.npy", scene.compute_distance(points).numpy())
"""
TRIMESH = """
import numpy as np, trimesh
mesh = trimesh.load("mesh.ply", process=False)
np.save("trimesh.npy", trimesh.proximity.closest_point(mesh, np.load("points.npy"))[1])
"""
CLOUD_COMPARE = (
    *("-SILENT", "-AUTO_SAVE", "OFF", "-C_EXPORT_FMT", "PLY", "-PLY_EXPORT_FMT", "BINARY_LE"),
    *("-O", "points.ply", "-O", "mesh.ply", "-C2M_DIST"),
)
SAVE = ("-SAVE_CLOUDS", "FILE", "out.ply")


def run(folder: Path, command: list[str]) -> tuple[float, float]:
    """Seconds by the clock and peak memory in GB of a program."""
    begin = time.perf_counter()
    with (folder / "log.txt").open("w") as log:
        program = subprocess.Popen(
            command,
            cwd=folder,
            env={**os.environ, "QT_QPA_PLATFORM": "offscreen"},
            stdout=log,
            stderr=subprocess.STDOUT,
        )
        peak = 0
        while program.poll() is None:
            try:  # the program alone; ru_maxrss would begin with that of this process
                status = Path(f"/proc/{program.pid}/status").read_text()
                peak = max(peak, int(status.split("VmHWM:")[1].split()[0]))
            except (OSError, IndexError):
                pass
            time.sleep(0.01)
    wall = time.perf_counter() - begin
    assert program.returncode == 0, (folder / "log.txt").read_text()[-3000:]
    return wall, peak * 1024 / 1e9


def cloud_compare_distances(folder: Path, n: int) -> np.ndarray:
    _, body = (folder / "out.ply").read_bytes().split(b"end_header\n", 1)
    return np.frombuffer(body, dtype="<f4").reshape(n, 4)[:, 3].astype(np.float64)


def test_cloud_to_mesh_beside_other_programs(tmp_path, capsys):
    columns = turns.sized(FACES) // (2 * (ROWS - 1)) + 2
    bank = rough_bank.RoughBank(columns, ROWS, step_m=STEP_M, rough_m=ROUGH_M)
    points = bank.points(turns.sized(POINTS))
    np.save(tmp_path / "points.npy", points)
    rough_bank.write_ply(tmp_path / "points.ply", points)
    rough_bank.write_ply(tmp_path / "mesh.ply", bank.mesh.vertices_m, bank.mesh.faces)
    write_mesh(tmp_path / "ours.ply", bank.mesh, LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0), {})

    python = [sys.executable, "-W", "ignore", "-c"]
    programs = {"Thalweg": [*python, OURS], "Open3D, unsigned, float32": [*python, OPEN3D]}
    if (program := shutil.which("CloudCompare")) is not None:
        programs["CloudCompare, octree level 10"] = [program, *CLOUD_COMPARE, "-OCTREE_LEVEL", "10", *SAVE]
        programs["CloudCompare"] = [program, *CLOUD_COMPARE, *SAVE]
    run(tmp_path, programs["Thalweg"])  # compiles
    took = {name: [] for name in programs}
    for _ in range(3):
        for name, command in programs.items():
            took[name].append(run(tmp_path, command))
    took["trimesh"] = [run(tmp_path, [*python, TRIMESH])]  # once: it takes its time
    wall = {name: float(np.median([seconds for seconds, _ in runs])) for name, runs in took.items()}
    inside = turns.in_turns(
        {"build": lambda: Surface(bank.mesh), "both": lambda: Surface(bank.mesh).distances(points)}
    )

    ours = np.load(tmp_path / "ours.npy")
    size = f"{len(points):,} points, {len(bank.mesh.faces):,} faces"
    rows = [f"\nCloud-to-mesh, {size}; whole programs, peak memory:"]
    rows += [
        f"  {name:<30} {seconds:6.1f} s, {took[name][0][1]:.2f} GB: ratio {seconds / wall['Thalweg']:.1f}"
        for name, seconds in wall.items()
    ]
    rows.append(
        f"  Thalweg's function alone {inside['both']:.2f} s, of which building {inside['build']:.2f} s"
    )
    found = Surface(bank.mesh).distances(points)
    assert np.array_equal(found.distance_m, ours)
    side = bank.above(points)
    sure = ~found.at_border & (side != 0)
    assert (np.sign(ours) == side)[sure].all()
    if program is not None:
        theirs = cloud_compare_distances(tmp_path, len(points))
        wrong = int((np.sign(theirs) != side)[sure].sum())
        off = np.median(np.abs(np.abs(theirs) - np.abs(ours)))
        rows.append(
            f"  CloudCompare's distances differ by {off:.1e} m in the median; of {sure.sum():,} signs inside "
            f"the border {wrong:,} of its are wrong, none of Thalweg's"
        )
        np.testing.assert_allclose(np.abs(theirs), np.abs(ours), rtol=0, atol=1e-6)  # float32
    with capsys.disabled():
        print("\n".join(rows))
    # 5e-4: float32 coordinates of 200 m have steps of 15 um, and slim faces multiply them
    np.testing.assert_allclose(np.load(tmp_path / "open3d.npy"), np.abs(ours), rtol=0, atol=5e-4)
    # 1.01e-8: squares nearer than 1e-8 are the same to trimesh, which then takes either face
    np.testing.assert_allclose(np.load(tmp_path / "trimesh.npy") ** 2, ours**2, rtol=0, atol=1.01e-8)
    if turns.SHARE >= 1:  # a small mesh takes less time than the start of Python
        assert wall["Thalweg"] < min(seconds for name, seconds in wall.items() if name != "Thalweg")
