"""Tables of a camera-lidar calibration: what was used, what was not and why, what is left over."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from thalweg.calibration.camera_lidar.model import Layout, LidarRows, Unknowns
from thalweg.calibration.cones.cone import Cone
from thalweg.calibration.cones.fit import ConeFit, ConeReference
from thalweg.calibration.cones.selection import WORDS, ConeScan, Position, Selection, Verdict
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF

if TYPE_CHECKING:
    from thalweg.calibration.camera_lidar.adjustment import CameraLidar

FOUND: Final = "found"
_ON_SIGMAS: Final = 4.0
"""Distance from a cone, up to which a point counts as one on it."""
_CORNERS: Final = 3
"""Saddles of a marker, of four, by which it is judged as a whole."""


def detection_table(
    layout: Layout,
    selections: Sequence[Selection],
    out: Mapping[tuple[int, int], str],
    refused: Mapping[str, str],
) -> pd.DataFrame:
    """One line a position and cone: ``predicted`` beams, how many had which verdict, ``found``, ``reason``.

    ``predicted`` counts returned beams whose nominal direction meets the cone; the numbers behind it add up
    to it: ``used``, ``grazing``, too near to the ``outline`` or an ``end``, reflected ``in_front`` or
    ``behind``, or passing ``beside`` what is in front. Points of a cone that takes no part count as
    ``left_out`` instead of ``used``.
    """
    lines: list[dict[str, Any]] = []
    for p, (name, selection) in enumerate(zip(layout.positions, selections, strict=True)):
        for k, cone in enumerate(layout.cones):
            n = selection.counts(k)
            reason = out.get((p, k), "")
            if not reason and n[Verdict.USED] == 0:
                reason = (
                    f"none of {sum(n.values())} beams that should meet it ended on it: it fell over or was "
                    "moved, or it is hidden. Measure the field again, or leave the cone out"
                )
            line: dict[str, Any] = {"position": name, "cone": cone, "predicted": sum(n.values())}
            line |= {WORDS[v]: n[v] for v in WORDS}
            line["left_out"] = n[Verdict.USED] if reason else 0
            line["used"] = 0 if reason else n[Verdict.USED]
            lines.append({**line, FOUND: not reason, "reason": reason})
        none = {"predicted": 0, **dict.fromkeys(WORDS.values(), 0), "left_out": 0, FOUND: False}
        lines += [
            {"position": name, "cone": cone, **none, "reason": f"no reference: {why}"}
            for cone, why in refused.items()
        ]
    return pd.DataFrame(lines)


def residual_table(layout: Layout, scans: Sequence[ConeScan], rows: Sequence[LidarRows]) -> pd.DataFrame:
    """One line a position and cone: number of points, and mean, RMS and greatest distance in millimetres.

    ``standardised`` is the RMS of the distances over their sigmas. Distances are those left by the
    adjustment, less their expectation for noisy beams.
    """
    lines = []
    for name, scan, row in zip(layout.positions, scans, rows, strict=True):
        # Along the outward normal: positive outside.
        distance = row.residual * row.slope
        variance = scan.variance_m2 * row.slope**2
        for k, cone in enumerate(layout.cones):
            on = scan.cone == k
            if on.any():
                d = distance[on]
                lines.append(
                    {
                        "position": name,
                        "cone": cone,
                        "points": int(on.sum()),
                        "mean_mm": 1e3 * float(d.mean()),
                        "sigma_mean_mm": 1e3 * float(np.sqrt(variance[on].mean() / on.sum())),
                        "rms_mm": 1e3 * float(np.sqrt(np.mean(d**2))),
                        "greatest_mm": 1e3 * float(np.abs(d).max()),
                        "standardised": float(np.sqrt(np.mean(d**2 / variance[on]))),
                    }
                )
    return pd.DataFrame(lines)


def point_table(
    layout: Layout,
    positions: Sequence[Position],
    x: Unknowns,
    selections: Sequence[Selection],
    out: Mapping[tuple[int, int], str],
) -> pd.DataFrame:
    """One line a beam that should meet a cone: place of its point in pcs, distance from the cone, verdict.

    ``residual_m`` is positive outside, and less its expectation where the point is used.
    """
    parts = []
    for p, (position, selection) in enumerate(zip(positions, selections, strict=True)):
        T = x.poses[p] @ x.T_ccs_scs
        for k, name in enumerate(layout.cones):
            rows = np.flatnonzero(selection.cone == k)
            at = T.apply(position.points_scs_m[rows])
            reach = np.linalg.norm(position.points_scs_m[rows], axis=1)
            met = x.cones[k].meet(T.shift_m, (at - T.shift_m) / reach[:, None])
            residual = -(reach - met.range_m - np.nan_to_num(selection.excess_m[rows])) * met.cosine
            verdict = selection.verdict[rows]
            parts.append(
                pd.DataFrame(
                    {
                        "cone": name,
                        "position": position.name,
                        **{f"{a}_m": at[:, i] for i, a in enumerate("xyz")},
                        "residual_m": residual,
                        "used": (verdict == Verdict.USED) & ((p, k) not in out),
                        "verdict": [WORDS[Verdict(v)] for v in verdict],
                    }
                )
            )
    return pd.concat(parts, ignore_index=True)


def sensor_table(positions: Sequence[str], poses: Sequence[Rigid], T_ccs_scs: Rigid) -> pd.DataFrame:
    """Where camera and lidar were in pcs at each position: origin, and rotation from the sensor's frame."""
    lines = []
    for name, pose in zip(positions, poses, strict=True):
        for sensor, T in (("camera", pose), ("lidar", pose @ T_ccs_scs)):
            q = Rotation.from_matrix(T.R).as_quat(canonical=True)
            place = dict(zip(("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"), [*T.shift_m, *q], strict=True))
            lines.append({"position": name, "sensor": sensor, **place})
    return pd.DataFrame(lines)


def reference_table(
    references: Sequence[ConeReference], fits: Mapping[str, ConeFit], refused: Mapping[str, str]
) -> pd.DataFrame:
    """One line a reference point: distance from its cone in millimetres, whether it was used, why not.

    ``lies_on`` names another cone on which a point lies that is not on its own.
    """
    lines = []
    for r in references:
        fit = fits.get(r.name)
        others = _lies_on(r, {name: f for name, f in fits.items() if name != r.name}, references)
        for i, label in enumerate(r.labels):
            used = fit is not None and bool(fit.used[i])
            elsewhere = "" if used or fit is None else others[i]
            far = "not on the cone: moved, or read wrongly"
            if elsewhere:
                far = f"not on the cone but on {elsewhere}"
            reason = "" if used else refused.get(r.name, far)
            distance = np.nan if fit is None else 1e3 * float(fit.distance_m[i])
            lines.append(
                {"cone": r.name, "point": label, "distance_mm": distance, "used": used, "lies_on": elsewhere,
                 "reason": reason}
            )  # fmt: skip
    return pd.DataFrame(lines)


def _lies_on(
    reference: ConeReference, fits: Mapping[str, ConeFit], references: Sequence[ConeReference]
) -> list[str]:
    """For each point the other cone on whose surface it lies; empty if there is none."""
    out = [""] * len(reference.points_m)
    lengths = {r.name: r.length_m for r in references}
    sigma = np.hypot(reference.sigma_m, reference.form_sigma_m)
    for name, fit in fits.items():
        seen = fit.cone.see(reference.points_m)
        slant = lengths[name] / np.cos(fit.cone.half_angle_rad)
        on = (np.abs(seen.distance_m) < _ON_SIGMAS * sigma) & (seen.slant_m > 0) & (seen.slant_m < slant)
        for i in np.flatnonzero(on):
            out[i] = name
    return out


def foreign_markers(references: pd.DataFrame) -> list[str]:
    """What to tell about markers that are not on the cone that the description of the field names.

    Parameters
    ----------
    references : of `reference_table`.
    """
    marker = references["point"].str.split("/").str[0]
    where: dict[tuple[str, str], str] = {}
    bad: dict[tuple[str, str], str] = {}
    for key, part in references.assign(marker=marker).groupby(["cone", "marker"], sort=False):
        cone, name = (str(k) for k in key)
        places = part["lies_on"][part["lies_on"] != ""]
        if len(places) >= _CORNERS:
            where[cone, name] = str(places.mode().iloc[0])
        elif int((~part["used"]).sum()) >= _CORNERS and part["distance_mm"].notna().all():
            off = float(part["distance_mm"].abs().median())
            bad[cone, name] = (
                f"marker {name} of cone {cone} is {off:.1f} mm off its surface: it is not glued on it, or "
                "was moved between the pictures of the field. Photograph the field again, or leave it out"
            )
    lines, told = [], set()
    for (cone, name), place in where.items():
        back = [m for (c, m), p in where.items() if (c, p) == (place, cone)]
        if back and (cone, name) not in told:
            told |= {(place, m) for m in back}
            lines.append(
                f"marker {name} is stated for cone {cone} but lies on {place}, and marker {', '.join(back)} "
                f"is stated for {place} but lies on {cone}: they are swapped, and take no part. Exchange the "
                "sheets and photograph the field again, or leave them out of the description of the field"
            )
        elif (cone, name) not in told:
            lines.append(
                f"marker {name} is stated for cone {cone} but lies on {place}, and takes no part. Correct "
                f"the markers of {cone} and {place} in the description of the field"
            )
    return [*lines, *bad.values()]


def cone_table(cones: Mapping[str, Cone]) -> pd.DataFrame:
    """One line a cone: apex in pcs, P2's angles, half angle, and sigmas, those of the axis across itself."""
    lines = []
    for name, cone in cones.items():
        s = np.sqrt(np.maximum(np.diag(cone.cov), 0.0))
        lam, theta = np.rad2deg(cone.angles_rad)
        lines.append(
            {
                "cone": name,
                **{f"apex_{a}_m": float(v) for a, v in zip("xyz", cone.apex_m, strict=True)},
                "lambda_deg": lam,
                "theta_deg": theta,
                "half_angle_deg": float(np.rad2deg(cone.half_angle_rad)),
                **{f"sigma_apex_{a}_mm": 1e3 * float(v) for a, v in zip("xyz", s[:3], strict=True)},
                "sigma_axis_1_deg": float(np.rad2deg(s[3])),
                "sigma_axis_2_deg": float(np.rad2deg(s[4])),
                "sigma_half_angle_deg": float(np.rad2deg(s[5])),
            }
        )
    return pd.DataFrame(lines)


def correlation_table(names: Sequence[str], correlation: ArrayF) -> pd.DataFrame:
    """Correlations of the unknowns as a square table with their names."""
    return pd.DataFrame(correlation, index=list(names), columns=list(names))


def report(result: "CameraLidar", nominal: Rigid) -> dict[str, Any]:
    """What a person reads first, as plain values: orientation, sigmas, correlations, groups, verdict."""
    T = result.T_ccs_scs
    s = np.sqrt(np.diag(T.cov))
    back = T.error_from(nominal)
    low, high = result.adjusted.global_test()
    return {
        "lever_ccs_scs_m": T.shift_m.tolist(),
        "lever_length_m": float(np.linalg.norm(T.shift_m)),
        "sigma_lever_mm": (1e3 * T.sigma_shift_m).tolist(),
        "sigma_rotation_deg": np.rad2deg(T.sigma_rotation_rad).tolist(),
        "R_ccs_scs": T.R.tolist(),
        "correlation": (T.cov / np.outer(s, s)).tolist(),
        "from_nominal": {
            "shift_mm": (1e3 * back[:3]).tolist(),
            "rotation_deg": np.rad2deg(back[3:]).tolist(),
        },
        "unknowns": len(result.adjusted.names),
        "iterations": result.adjusted.n_iterations,
        "sigma0": float(np.sqrt(result.adjusted.sigma0_squared)),
        "sigma0_band": [float(np.sqrt(low)), float(np.sqrt(high))],
        "group_sigma0": result.group_sigma0,
        "lidar_sigma_factor": float(np.sqrt(result.variance_factor)),
        "points": int(result.residuals["points"].sum()),
        "positions": int(result.residuals["position"].nunique()),
        "cones": len(result.cones),
        "single_shot_claim": {
            "expected": "sigmas below 1 mm and 0.1 deg (P2 section 7)",
            "kept": bool((T.sigma_shift_m < 1e-3).all() and (np.rad2deg(T.sigma_rotation_rad) < 0.1).all()),
        },
    }
