"""Reports of an adjusted image block: per image, per control point, facts as JSON, and a text for people."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core.types import ArrayF
from thalweg.images.bundle.adjustment import Adjusted
from thalweg.images.bundle.result import (
    FEW_MARKS,
    ControlResult,
    adjusted_cameras,
    image_statistics,
    pose_covariance,
)

_AXES: Final = ("east", "north", "up")


def image_table(adjusted: Adjusted, images: Sequence[str], reasons: Mapping[str, str]) -> pd.DataFrame:
    """One row an image: whether it is oriented, marks, rms of residuals, sigmas of place and rotation.

    Sigmas are those of the pose about the axes of wcs, in mm and thousandths of a degree.
    """
    block = adjusted.problem.block
    at = {name: k for k, name in enumerate(block.images)}
    n = len(block.images)
    sigma = np.sqrt(np.diag(pose_covariance(adjusted))).reshape(-1, 6)
    tie = np.bincount(block.mark_image[adjusted.used], minlength=n)
    dropped = np.bincount(block.mark_image[~adjusted.used], minlength=n)
    control = np.bincount(adjusted.problem.marks.image[adjusted.control_used], minlength=n)
    rms = image_statistics(adjusted)[1]
    rows: list[dict[str, Any]] = []
    for name in images:
        k = at.get(name)
        if k is not None and adjusted.lost_images[k]:
            rows.append({"image": name, "oriented": False, "reason": FEW_MARKS})
            continue
        row: dict[str, Any] = {"image": name, "oriented": k is not None, "reason": ""}
        if k is None:
            row["reason"] = reasons.get(name, "not in the block")
        else:
            row |= {
                "tie_marks": int(tie[k]),
                "dropped_marks": int(dropped[k]),
                "control_marks": int(control[k]),
                "rms_px": rms[k],
            }
            row |= {f"sigma_{a}_mm": 1e3 * sigma[k, i] for i, a in enumerate(_AXES)}
            row |= {
                f"sigma_rotation_{a}_mdeg": 1e3 * math.degrees(sigma[k, 3 + i]) for i, a in enumerate(_AXES)
            }
        rows.append(row)
    columns = [
        "image", "oriented", "reason", "tie_marks", "dropped_marks", "control_marks", "rms_px",
        *(f"sigma_{a}_mm" for a in _AXES), *(f"sigma_rotation_{a}_mdeg" for a in _AXES),
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=columns)


def control_table(adjusted: Adjusted, result: ControlResult, left_out: Mapping[str, str]) -> pd.DataFrame:
    """One row a point: role, images, rms in pixels, adjusted minus surveyed and its predicted sigma, test.

    ``without_*`` is the same difference if the point's own coordinates had taken no part; for a check point
    both are one. ``normalised`` is the chi-square of the difference over its three degrees of freedom.

    Parameters
    ----------
    left_out : reasons of points that took no part at all.
    """
    control = adjusted.problem.control
    rows: list[dict[str, Any]] = []
    for k, name in enumerate(control.names):
        row: dict[str, Any] = {
            "point": name,
            "role": "check" if control.check[k] else "control",
            "images": int(result.n_marks[k]),
            "rms_px": result.rms_px[k],
        }
        for what, off, cov in (
            ("off", result.off_m, result.cov_m2),
            ("without", result.without_m, result.cov_without_m2),
        ):
            sigma = np.sqrt(np.maximum(np.diag(cov[k]), 0.0))
            row |= {f"{what}_{a}_mm": 1e3 * off[k, i] for i, a in enumerate(_AXES)}
            row |= {f"sigma_{what}_{a}_mm": 1e3 * sigma[i] for i, a in enumerate(_AXES)}
        row |= {"normalised": result.test[k] / 3, "suspect": bool(result.suspect[k]), "reason": ""}
        rows.append(row)
    rows += [
        {"point": name, "role": "left out", "images": 0, "suspect": False, "reason": reason}
        for name, reason in left_out.items()
    ]
    return pd.DataFrame(rows, columns=_CONTROL_COLUMNS)


_CONTROL_COLUMNS: Final = [
    "point", "role", "images", "rms_px",
    *(f"{s}{w}_{a}_mm" for w in ("off", "without") for s in ("", "sigma_") for a in _AXES),
    "normalised", "suspect", "reason",
]  # fmt: skip


def check_statistics(
    adjusted: Adjusted, result: ControlResult, demoted: Sequence[str] = ()
) -> dict[str, Any]:
    """RMSE of check points, its prediction, their ratio, and the mean normalised error; empty without any.

    Parameters
    ----------
    demoted : control points that became check points because they contradict the others: they do not count.
    """
    control = adjusted.problem.control
    check = control.check & (result.n_marks > 0) & ~np.isin(np.array(control.names, object), list(demoted))
    if not check.any():
        return {}
    rmse = np.sqrt(np.square(result.off_m[check]).mean(axis=0))
    predicted = np.sqrt(np.diagonal(result.cov_m2[check], axis1=1, axis2=2).mean(axis=0))
    return {
        "points": int(check.sum()),
        "rmse_mm": dict(zip(_AXES, (1e3 * rmse).tolist(), strict=True)),
        "predicted_mm": dict(zip(_AXES, (1e3 * predicted).tolist(), strict=True)),
        "ratio": float(np.linalg.norm(rmse) / np.linalg.norm(predicted)),
        "normalised": float(result.test[check].mean() / 3),
    }


def facts_of(
    adjusted: Adjusted, result: ControlResult, notes: Sequence[str], demoted: Sequence[str] = ()
) -> dict[str, Any]:
    """JSON-able facts of an adjustment; ``demoted`` as in `check_statistics`."""
    sigma = np.sqrt(np.diag(pose_covariance(adjusted))).reshape(-1, 6)[~adjusted.lost_images]
    cameras = {
        camera.name: {
            name: {"value": float(value), "sigma": float(s)}
            for name, value, s in zip(
                camera.parameter_names, camera.parameters, np.sqrt(np.diag(camera.cov)), strict=True
            )
        }
        for camera in adjusted_cameras(adjusted)
    }
    layout = adjusted.layout
    extras = {
        name: {"value": float(v), "sigma": float(s)}
        for name, v, s in zip(
            layout.names[layout.extras : layout.control],
            adjusted.x.extras,
            np.sqrt(np.diag(adjusted.cov)[layout.extras : layout.control]),
            strict=True,
        )
    }
    return {
        "sigma0": adjusted.sigma0,
        "redundancy": adjusted.redundancy,
        "observations": adjusted.n_observations,
        "unknowns": adjusted.n_unknowns,
        "iterations": adjusted.iterations,
        "images": int((~adjusted.lost_images).sum()),
        "tie_points": len(adjusted.tracks.point),
        "tie_marks": len(adjusted.tracks.mark),
        "marks_a_point": len(adjusted.tracks.mark) / max(len(adjusted.tracks.point), 1),
        "rms_px": float(np.sqrt(np.square(adjusted.residual_px[adjusted.used]).mean()))
        if adjusted.used.any()
        else None,
        "control_points": int((~adjusted.problem.control.check).sum()),
        "square_sums": adjusted.costs,
        "correlation": adjusted.correlation.facts(),
        "control_marks": {"n": int(adjusted.control_used.sum()), "scale": adjusted.control_scale},
        "left_out": adjusted.left_out,
        "cameras": cameras,
        "antenna": extras,
        "sigma_position_mm": dict(zip(_AXES, _typical(1e3 * sigma[:, :3]), strict=True)),
        "sigma_rotation_mdeg": dict(zip(_AXES, _typical(1e3 * np.degrees(sigma[:, 3:])), strict=True)),
        "check_points": check_statistics(adjusted, result, demoted),
        "contradicting_points": list(demoted),
        "notes": list(notes),
    }


def summary_text(facts: Mapping[str, Any]) -> str:
    """A few lines for the log."""
    lines = [
        f"{facts['images']} images, {facts['tie_points']} tie points with {facts['tie_marks']} marks "
        f"({facts['marks_a_point']:.1f} each), {facts['control_points']} control points",
        f"sigma0 {facts['sigma0']:.3f}, redundancy {facts['redundancy']}, {facts['iterations']} iterations",
        "errors of a mark in units of its sigma, along / across the parallax: white {white:.2f} / "
        "{white_across:.2f}, slow {slow:.2f} / {slow_across:.2f} over {reach_deg:.1f} degrees to the power "
        "{power:.1f}".format(**facts["correlation"]),
        "position " + " / ".join(f"{v:.1f}" for v in facts["sigma_position_mm"].values()) + " mm, rotation "
        + " / ".join(f"{v:.1f}" for v in facts["sigma_rotation_mdeg"].values())
        + " thousandths of a degree (median over the images, east / north / up)",
    ]  # fmt: skip
    check = facts["check_points"]
    if check:
        lines.append(
            f"{check['points']} check points: RMSE "
            + " / ".join(f"{v:.1f}" for v in check["rmse_mm"].values())
            + " mm, predicted "
            + " / ".join(f"{v:.1f}" for v in check["predicted_mm"].values())
            + f" mm, ratio {check['ratio']:.2f}"
        )
    lines += [f"{n} {what}" for what, n in facts["left_out"].items() if n]
    return "\n".join([*lines, *facts["notes"]])


def _typical(values: ArrayF) -> list[float]:
    return [float(v) for v in np.median(values, axis=0)]
