"""What the fused trajectory made of its inputs: counts, groups of residuals, clock, mount."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import chi2

from thalweg.core.trajectory import Trajectory
from thalweg.images.model.poses import ImagePoses
from thalweg.navigation.fusion.model import clock_unit
from thalweg.navigation.fusion.settings import GROUPS, FusionSettings, Layout
from thalweg.navigation.fusion.solver import Observed, Solved

_KINDS = {"position": "antenna positions", "image": "image poses"}


@dataclass(slots=True)
class Counts:
    """How many observations of each kind were given, and why some could not enter."""

    given: dict[str, int] = field(default_factory=dict)
    dropped: dict[str, dict[str, int]] = field(default_factory=dict)

    def words(self) -> list[str]:
        """One phrase for each kind of observation: how many there were, and what became of them."""
        out = []
        for kind, name in _KINDS.items():
            why = ", ".join(f"{n} {text}" for text, n in self.dropped.get(kind, {}).items() if n)
            n = self.given.get(kind, 0)
            out.append(f"{n} {name}" + (f" ({why})" if why else "") if n else f"no {name}")
        return out

    def missing(self) -> list[str]:
        """Kinds of observations that there are none of."""
        return [name for kind, name in _KINDS.items() if not self.given.get(kind, 0)]


def group_facts(solved: Solved, level: float = 0.01) -> dict[str, dict[str, float | bool]]:
    """By group: normalised squares of the residuals, redundancy, chi-square band and factor of the sigma.

    ``chi_square`` is the weighted sum of squares over the redundancy; 1 if the sigmas, times their factor,
    are right. ``inside`` its band of 99 %.
    """
    out: dict[str, dict[str, float | bool]] = {}
    for group in GROUPS:
        square, redundancy = solved.groups[group]
        if redundancy < 1e-6:
            continue
        low, high = (float(chi2.ppf(p, redundancy)) / redundancy for p in (level / 2, 1 - level / 2))
        ratio = square / redundancy
        out[group] = {
            "chi_square": ratio,
            "redundancy": redundancy,
            "band_low": low,
            "band_high": high,
            "inside": bool(low <= ratio <= high),
            "sigma_factor": solved.factors[group],
        }
    return out


def camera_facts(
    solved: Solved, observed: Observed, layout: Layout, settings: FusionSettings, clock_shift_s: float
) -> dict[str, Any]:
    """Clock offset, and the mount's correction between camera and INS, each with its sigma."""
    camera = observed.camera
    if camera is None:
        return {}
    unit = clock_unit(settings)
    mount = slice(layout.mount, layout.mount + 6)
    units = np.array([1e3, 1e3, 1e3, *np.rad2deg([1.0, 1.0, 1.0])])
    correction = camera.mount_root @ solved.x[-1, mount]
    cov = camera.mount_root @ solved.last[mount, mount] @ camera.mount_root.T
    sigma = np.sqrt(np.maximum(np.diag(cov), 0.0)) * units
    prior = np.linalg.norm(camera.mount_root, axis=1) * units
    correction = correction * units
    clock = solved.x[camera.node, layout.clock] * unit + clock_shift_s
    jitter = solved.x[camera.node, layout.jitter] * camera.jitter_s
    return {
        "clock_offset_s": float(np.mean(clock)),
        "clock_offset_sigma_s": float(np.sqrt(solved.last[layout.clock, layout.clock]) * unit),
        "clock_offset_range_s": float(np.ptp(clock)),
        "jitter_rms_s": float(np.sqrt(np.mean(jitter**2))),
        "boresight": {
            "meaning": "correction of T_ccs_ics by INS against camera, in ccs: shift; rotation vector",
            "shift_mm": correction[:3].tolist(),
            "sigma_shift_mm": sigma[:3].tolist(),
            "prior_sigma_shift_mm": prior[:3].tolist(),
            "rotation_deg": correction[3:].tolist(),
            "sigma_rotation_deg": sigma[3:].tolist(),
            "prior_sigma_rotation_deg": prior[3:].tolist(),
        },
    }


def facts_of(
    solved: Solved,
    observed: Observed,
    layout: Layout,
    settings: FusionSettings,
    counts: Counts,
    trajectory: Trajectory,
    *,
    clock_shift_s: float,
    notes: list[str],
) -> dict[str, Any]:
    """All facts of a fused trajectory, JSON-able."""
    weights = {"position": observed.weight_antenna, "image": observed.weight_camera}
    observations = {}
    for kind, weight in weights.items():
        observations[kind] = {
            "given": counts.given.get(kind, 0),
            "used": int((weight > 0).sum()),
            "rejected": int((weight == 0).sum()),
            "dropped": {k: n for k, n in counts.dropped.get(kind, {}).items() if n},
        }
    valid = trajectory.valid
    sigma = np.median(trajectory.sigma_position_m[valid], axis=0)
    angles = np.rad2deg(np.median(trajectory.sigma_roll_pitch_heading_rad()[valid], axis=0))
    return {
        "observations": observations,
        "groups": group_facts(solved),
        **camera_facts(solved, observed, layout, settings, clock_shift_s),
        "n_nodes": len(trajectory.t_gps_s),
        "n_valid": int(valid.sum()),
        "median_sigma_east_north_up_m": sigma.tolist(),
        "median_sigma_roll_pitch_heading_deg": angles.tolist(),
        "solutions": solved.n_solutions,
        "settled": solved.settled,
        "notes": list(notes),
    }


def observation_table(
    observed: Observed,
    solved: Solved,
    layout: Layout,
    images: ImagePoses | None,
    settings: FusionSettings,
    *,
    clock_shift_s: float,
) -> pd.DataFrame:
    """One line an observation that could enter.

    Columns ``kind`` (position, image), ``name``, ``t_gps_s`` (of images as their table has it),
    ``normalised`` (root of the total error's quadratic form over its components; expected below 1), ``used``,
    and for images ``time_error_s``: offset and jitter together.
    """
    parts = []
    if observed.antenna is not None:
        n = len(observed.antenna.t_gps_s)
        parts.append(pd.DataFrame({
            "kind": "position", "name": "", "t_gps_s": observed.antenna.t_gps_s,
            "normalised": observed.normalised_antenna / np.sqrt(3.0), "used": observed.weight_antenna > 0,
            "time_error_s": np.full(n, np.nan),
        }))  # fmt: skip
    camera = observed.camera
    if camera is not None and images is not None:
        x = solved.x[camera.node]
        late = x[:, layout.clock] * clock_unit(settings) + x[:, layout.jitter] * camera.jitter_s
        parts.append(pd.DataFrame({
            "kind": "image", "name": [images.images[i] for i in camera.index.tolist()],
            "t_gps_s": images.t_gps_s[camera.index],
            "normalised": observed.normalised_camera / np.sqrt(7.0), "used": observed.weight_camera > 0,
            "time_error_s": late + clock_shift_s,
        }))  # fmt: skip
    return pd.concat(parts, ignore_index=True)


def count_table(facts: dict[str, Any]) -> pd.DataFrame:
    """Columns ``kind, what, n``: how many observations were given, used, rejected, or dropped and why."""
    rows: list[tuple[str, str, int]] = []
    for kind, found in facts["observations"].items():
        rows += [(kind, what, int(found[what])) for what in ("given", "used", "rejected")]
        rows += [(kind, why, n) for why, n in found["dropped"].items()]
    return pd.DataFrame(rows, columns=["kind", "what", "n"])
