"""Made-up chains: trajectories with holes, and distances whose sigmas grow with the range."""

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from thalweg.accuracy import Chain, ComparisonSettings, by_range_table
from thalweg.accuracy.comparison_tables import statistics_table
from thalweg.core import LocalFrame, Trajectory

T0 = 3.0e8
SETTINGS = ComparisonSettings(correlation_s=0.5, reference_sigma_m=0.004)


def trajectory(*, n=1001, step_s=0.02, valid=None, sigma_m=0.02, sigma_rad=1e-3, error=None):
    """A boat that drives a curve for 20 s and turns; ``error`` (n, 6) moves it away from the truth."""
    t = T0 + step_s * np.arange(n)
    s = step_s * np.arange(n)
    position = np.column_stack([1.2 * s, 3 * np.sin(0.3 * s), np.full(n, 0.5)])
    turn = Rotation.from_rotvec(np.outer(0.1 * s, [0, 0, 1])) * Rotation.from_euler("x", np.pi)
    if error is not None:
        # an error moves the estimate to the truth
        position = position - error[:, :3]
        turn = Rotation.from_rotvec(-error[:, 3:]) * turn
    return Trajectory(
        frame=LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0),
        t_gps_s=t,
        position_wcs_m=position,
        quaternion_wcs_ics=turn.as_quat(),
        cov_pose_wcs=np.tile(np.diag([sigma_m**2] * 3 + [sigma_rad**2] * 3), (n, 1, 1)),
        valid=np.ones(n, bool) if valid is None else valid,
    )


def distances(rng, *, sigma_m, per_metre, n=12_000, mean_m=0.0, span=(0.0, 20.0)):
    """Distances whose sigma grows with the range, some plants, and a few points at the border."""
    range_m = rng.uniform(4.5, 30.5, n)
    sigma = np.hypot(sigma_m, per_metre * range_m)
    distance = mean_m + sigma * rng.standard_normal(n)
    distance[: n // 50] = rng.uniform(0.8, 1.8, n // 50)
    used = np.arange(n) % 40 != 0
    return pd.DataFrame(
        {
            "t_gps_s": T0 + rng.uniform(*span, n),
            "east_m": 0.0,
            "north_m": 0.0,
            "up_m": 0.0,
            "range_m": range_m.astype(np.float32),
            "distance_m": distance,
            "normal_east": 0.0,
            "normal_north": 1.0,
            "normal_up": 0.0,
            "sigma_normal_m": sigma.astype(np.float32),
            "sigma_reference_m": np.float32(0.004),
            "sigma_3d_m": (1.7 * sigma).astype(np.float32),
            "at_border": ~used,
            "used": used,
            "outlier": used & (distance > 0.7),
        }
    )


def chain(rng, name, *, sigma_m, per_metre, kept, no_pose=0, valid=None, span=(0.0, 20.0)):
    table = distances(rng, sigma_m=sigma_m, per_metre=per_metre, span=span)
    counts = pd.DataFrame(
        {
            "reason": ["kept", "no_gps_time", "no_pose", "too_near"],
            "n": [kept, 0, no_pose, 100_000 - kept - no_pose],
        }
    )
    facts = {
        "counts": {
            "points": 50_000,
            "outside_area": 9_000,
            "far_from_reference": 1_000,
            "not_in_sample": 20_000,
            "compared": int(table["used"].sum()),
        },
        "coverage": {"reference_area_m2": 400.0, "without_points": 0.25},
    }
    return Chain(
        name=name,
        counts=counts,
        trajectory=trajectory(valid=valid),
        statistics=statistics_table(table, SETTINGS),
        by_range=by_range_table(table, SETTINGS),
        distances=table,
        facts=facts,
    )


def frames_of_images():
    """Nodes that a camera has: 0.1 s about each second."""
    t = 0.02 * np.arange(1001)
    return np.abs(t - np.round(t)) < 0.055


def three_chains(rng):
    """INS: 6 cm and 2 mm per metre, with a hole; camera: 2 cm and 4 mm per metre; fused better than both."""
    hole = np.ones(1001, bool)
    hole[400:500] = False
    frames = frames_of_images()
    return [
        chain(rng, "ins", sigma_m=0.06, per_metre=0.002, kept=60_000, no_pose=9_000, valid=hole),
        chain(rng, "camera", sigma_m=0.02, per_metre=0.004, kept=6_000, no_pose=90_000, valid=frames),
        chain(rng, "fused", sigma_m=0.015, per_metre=0.0015, kept=66_000),
    ]
