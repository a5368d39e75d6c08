"""Strips adjusted beside Open3D's point-to-plane ICP on the same pairs of strips, in one run.

Four minutes along a bank and back, in strips of 10 s. Open3D lays each strip of the way back on each strip of
the way out that it overlaps, with normals of its own; Thalweg adjusts all poses and the mount, with their
covariances. CPU seconds of all threads:

    pytest -m slow -s tests/benchmarks/test_speed_strips.py
"""

import numpy as np
import pytest

from tests.benchmarks.turns import SHARE, cpu
from thalweg.core.geometry import _open3d
from thalweg.lidar import CELL_M, adjust_strips
from thalweg.settings.sections import Strips
from thalweg_lab.studies.sensors.strip_surveys import MOUNT, Spec, draw, replaced

pytestmark = pytest.mark.slow
STRIP_S = 10.0
LEAST_COMMON = 40
"""Cells that a pair has in common."""


def test_strips_beside_open3d():
    half_s = max(120.0 * SHARE, 20.0)
    drawn = draw(9000, Spec(length_m=half_s, estimate=False))
    x, t = drawn.sample.xyz_wcs_m, drawn.sample.t_gps_s
    strip = (t / STRIP_S).astype(int)
    cell = np.unique(np.floor(drawn.true_m / CELL_M).astype(int), axis=0, return_inverse=True)[1].ravel()
    seen = {s: set(cell[strip == s]) for s in np.unique(strip)}
    out, back = ([s for s in seen if (s * STRIP_S < half_s) == early] for early in (True, False))
    pairs = [(i, j) for i in out for j in back if len(seen[i] & seen[j]) >= LEAST_COMMON]

    def apart_m(of_pair) -> float:
        """Root mean square along the normals of what the means of common cells lie apart, of all pairs."""
        square = []
        for i, j in pairs:
            means = []
            for s, places in ((i, x_of(i)), (j, of_pair(i, j))):
                k = strip == s
                n = np.bincount(cell[k], minlength=cell.max() + 1)
                d = np.einsum("ni,ni->n", places - drawn.true_m[k], drawn.normal[k])
                means.append(np.where(n >= 8, np.bincount(cell[k], d, len(n)) / np.maximum(n, 1), np.nan))
            square.append((means[0] - means[1]) ** 2)
        return float(np.sqrt(np.nanmean(square)))

    def x_of(s: int) -> np.ndarray:
        return placed[strip == s]

    placed = x
    before = apart_m(lambda i, j: x_of(j))
    o3d, clouds, moved = _open3d(), {}, {}
    begin = cpu()
    for s in seen:
        clouds[s] = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(x[strip == s]))
        clouds[s].estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=CELL_M, max_nn=30))
    to_plane = o3d.pipelines.registration.TransformationEstimationPointToPlane()
    for i, j in pairs:
        T = o3d.pipelines.registration.registration_icp(
            clouds[j], clouds[i], 0.3, np.eye(4), to_plane
        ).transformation
        moved[i, j] = x_of(j) @ T[:3, :3].T + T[:3, 3]
    icp_s = cpu() - begin
    by_icp = apart_m(lambda i, j: moved[i, j])
    begin = cpu()
    found = adjust_strips(drawn.sample, drawn.trajectory, MOUNT, drawn.chains, Strips(knot_s=1.0))
    strips_s = cpu() - begin
    placed = replaced(drawn, found)
    by_strips = apart_m(lambda i, j: x_of(j))
    print(
        f"\n{t[-1]:.0f} s, {len(x):,} points, {len(pairs)} pairs of strips: Open3D {icp_s:.1f} CPU s, "
        f"{1e3 * before:.1f} -> {1e3 * by_icp:.1f} mm; strips {strips_s:.1f} CPU s, {len(found.knots)} "
        f"knots, -> {1e3 * by_strips:.1f} mm; ratio {icp_s / strips_s:.2f}"
    )
    assert by_strips < before
    assert by_strips < 1.2 * by_icp
