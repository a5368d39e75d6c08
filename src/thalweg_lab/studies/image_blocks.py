"""Consistency of the covariances of image blocks: blocks of rendered pictures, many seeds, against the truth.

Each seed is a reach, a voyage, boards and pictures of its own. They go the campaign's way: masks, features,
structure from motion, boards measured in the pictures, adjustment with control points. Errors of matches are
then those that pictures have, and no model of them. In short pieces of a voyage and small pictures, because
a study needs many.

The variance of what images tell of the lens (``images.adjustment.interior_variance``) was chosen on one set
of blocks; the others judge it. From a shell: ``make study NAME=image_block_study``.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.stats import chi2

from thalweg.core import ArrayF, LocalFrame, ThalwegError, exp_rotation, root_mean_square, rotation_vector
from thalweg.images import read_control_points
from thalweg.images.bundle import (
    AdjustedBlock,
    Oriented,
    adjust_campaign,
    grey_loader,
    marks_of_campaign,
    mask_loader,
    pose_covariance,
    with_shared_errors,
)
from thalweg.images.masks import make_masks
from thalweg.images.model import ImageBlock, ImagePoses
from thalweg.images.sfm import Known, extract_features, image_table, main_block, map_images, match_images
from thalweg.ingest.photos import list_images
from thalweg.settings.sections import (
    BlockAdjustment,
    ControlSettings,
    FeatureSettings,
    MappingSettings,
    MaskSettings,
)
from thalweg_lab.random_numbers import generator
from thalweg_lab.river import build_scene
from thalweg_lab.settings import TwinConfig, TwinTimeLapse
from thalweg_lab.studies.study import Result, Seed, Study, Tables
from thalweg_lab.time_lapse import simulate_time_lapse

FRAME: Final = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
MOUNTS: Final[dict[str, Any]] = {
    "camera": {"omega_deg": -89.6, "phi_deg": 0.3, "kappa_deg": 179.5, "lever_ics_m": [-0.25, 0.10, -0.18]}
}
PREDICTED_M: Final = 0.1
PREDICTED_RAD: Final = 0.005
"""Errors of the predicted poses: a trajectory, a clock read by eye, a mount by hand."""

FACTORS: Final = (1.0, 1.5, 2.0, 3.0, 4.0)
"""Variances of what images tell of the lens over that by the model of their errors, for each block."""

_NUMBERS: Final = ("single", "joint", "independent", "rms_mm", "sigma_mm", "rms_mdeg", "sigma_mdeg", "check")


def rendered_block(seed: int, folder: Path) -> tuple[Oriented, ImagePoses]:
    """Render, measure and adjust one block, what the images tell of the lens taken as it is; its files stay.

    Returns
    -------
    oriented : the adjusted block.
    truth : true poses of all pictures.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lapse = TwinTimeLapse(size_px=(480, 360), rate_hz=2.0, share=0.6, n_targets=6)
    build_scene(TwinConfig.of_size("tiny"), seed).write(folder / "scene.npz")
    simulate_time_lapse(
        TwinConfig.of_size("tiny"),
        lapse,
        seed,
        FRAME,
        folder / "scene.npz",
        MOUNTS,
        folder / "pictures",
        folder / "targets.csv",
        out_poses=folder / "truth.parquet",
        out_truth=folder / "truth.json",
    )
    truth = ImagePoses.read(folder / "truth.parquet")
    expected = _predicted(truth, seed)
    block, reasons = _mapped(folder, seed)
    control = ControlSettings(board_m=lapse.target_size_m)
    points = read_control_points(folder / "targets.csv", FRAME, crs=None, sigma_m=control.sigma_m)
    measured = marks_of_campaign(
        block,
        points,
        expected,
        control,
        tables=[],
        grey=grey_loader([folder / "pictures"]),
        mask=mask_loader(None),
    )
    measured.table.to_csv(folder / "marks.csv", index=False, float_format="%.4f")
    oriented, _, _ = adjust_campaign(
        block,
        expected,
        frame=FRAME,
        crs=None,
        adjustment=BlockAdjustment(interior_variance=1.0),
        control=control,
        control_points=[folder / "targets.csv"],
        marks=folder / "marks.csv",
        known=None,
        boat=None,
        reasons=reasons,
    )
    return oriented, truth


def _predicted(truth: ImagePoses, seed: int) -> ImagePoses:
    """What trajectory, clock and mount would tell of the poses."""
    rng, n = generator(seed, "study predicted poses"), len(truth.images)
    sigma = np.repeat([PREDICTED_M, PREDICTED_RAD], 3)
    error = sigma * rng.standard_normal((n, 6))
    return replace(
        truth,
        centre_wcs_m=truth.centre_wcs_m + error[:, :3],
        R_wcs_ccs=exp_rotation(error[:, 3:]) @ truth.R_wcs_ccs,
        cov_pose_wcs=np.tile(np.diag(sigma**2), (n, 1, 1)),
    )


def _mapped(folder: Path, seed: int) -> tuple[ImageBlock, dict[str, str]]:
    """The block by structure from motion, and why a picture is not in it."""
    files, mapping = list_images([folder / "pictures"]), MappingSettings()
    make_masks(files, folder / "masks", MaskSettings(), None, seed=seed)
    features = extract_features(files, masks=folder / "masks", settings=FeatureSettings(), threads=1)
    matches = match_images(features, files, known=Known(), section=mapping, threads=1)
    mapped = map_images(matches, settings=mapping, threads=1)
    table = image_table(matches, mapped)
    reasons = dict(zip(table["image"], table["reason"], strict=True))
    return main_block(mapped, reasons), reasons


def counted(adjusted: AdjustedBlock, factor: float) -> AdjustedBlock:
    """A block adjusted with a factor of 1, as if ``images.adjustment.interior_variance`` had been another.

    Parts of the block that contradict each other have raised the factor already; both add up.
    """
    present = adjusted.interior_variance
    cov = with_shared_errors(
        adjusted.problem,
        adjusted.layout,
        adjusted.x,
        adjusted.cov / adjusted.cov_scale,
        (present - 1.0 + factor) / present,
    )
    return replace(adjusted, cov=cov * adjusted.cov_scale, interior_variance=present - 1.0 + factor)


def pose_errors(adjusted: AdjustedBlock, truth: ImagePoses) -> tuple[ArrayF, ArrayF]:
    """Errors (i, 6) that move the poses to the true ones, and their joint covariance (6 i, 6 i)."""
    row = {name: k for k, name in enumerate(truth.images)}
    kept = np.flatnonzero(~adjusted.lost_images)
    at = [row[adjusted.problem.block.images[k]] for k in kept]
    shift = truth.centre_wcs_m[at] - adjusted.x.C[kept] - adjusted.origin_m
    turn = rotation_vector(truth.R_wcs_ccs[at] @ np.swapaxes(adjusted.x.R[kept], 1, 2))
    rows = (6 * kept[:, None] + np.arange(6)).ravel()
    return np.concatenate([shift, turn], axis=1), pose_covariance(adjusted)[np.ix_(rows, rows)]


def normalised(error: ArrayF, cov: ArrayF) -> tuple[float, float, float]:
    """Mean normalised square of single poses, that of all poses together, and what the former is worth.

    Parameters
    ----------
    error : (i, 6).
    cov : (6 i, 6 i), of all of them.

    Returns
    -------
    single, joint : both 1 on average if the covariance is right.
    independent : number of independent errors whose mean square scatters as ``single`` does. Images of a
        block err alike, so these are much fewer than 6 i; ``joint`` has 6 i.
    """
    n = len(error)
    own = cov.reshape(n, 6, n, 6)[np.arange(n), :, np.arange(n)]
    weight = np.linalg.inv(own)
    single = np.einsum("ka,kab,kb->k", error, weight, error)
    whole = error.ravel()
    # the variance of a quadratic form e^T W e of normal errors is twice the trace of (W C)^2
    product = np.einsum("iab,ibjc->iajc", weight, cov.reshape(n, 6, n, 6)).reshape(6 * n, 6 * n)
    independent = (6 * n) ** 2 / float(np.einsum("ij,ji->", product, product))
    return float(single.mean() / 6), float(whole @ np.linalg.solve(cov, whole) / len(whole)), independent


def block_study(seed: int, folder: Path) -> pd.DataFrame:
    """One line for each factor of `FACTORS`.

    Columns ``seed, factor, images``; ``single, joint, independent`` as of `normalised`; ``rms_mm, sigma_mm,
    rms_mdeg, sigma_mdeg`` (root mean squares of coordinates and angles and of their sigmas); ``check,
    check_points`` (mean normalised square of a coordinate, and how many points); ``notes``; ``failure``: why
    there is no result, else empty.
    """
    row: dict[str, Any] = {"seed": seed, "images": 0, **dict.fromkeys(_NUMBERS, np.nan), "check_points": 0}
    try:
        oriented, truth = rendered_block(seed, folder)
    except ThalwegError as failure:
        told = {"notes": "", "failure": " ".join(str(failure).split())}
        return pd.DataFrame([{**row, "factor": factor} | told for factor in FACTORS])
    return pd.DataFrame([{**row, "factor": factor} | _numbers(oriented, truth, factor) for factor in FACTORS])


def _numbers(oriented: Oriented, truth: ImagePoses, factor: float) -> dict[str, Any]:
    """Of one block with one factor."""
    error, cov = pose_errors(counted(oriented.adjusted, factor), truth)
    single, joint, independent = normalised(error, cov)
    sigma = np.sqrt(np.diag(cov)).reshape(-1, 6)
    check = oriented.adjusted.problem.control.check
    told = oriented.control.test[check & np.isfinite(oriented.control.test)]
    return {
        "images": len(error),
        "single": single,
        "joint": joint,
        "independent": independent,
        "rms_mm": 1e3 * root_mean_square(error[:, :3]),
        "sigma_mm": 1e3 * root_mean_square(sigma[:, :3]),
        "rms_mdeg": 1e3 * root_mean_square(np.degrees(error[:, 3:])),
        "sigma_mdeg": 1e3 * root_mean_square(np.degrees(sigma[:, 3:])),
        "check": float(told.mean() / 3) if len(told) else np.nan,
        "check_points": len(told),
        "notes": "; ".join(oriented.notes),
        "failure": "",
    }


def pooled(table: pd.DataFrame) -> pd.DataFrame:
    """What all blocks say together, by one factor.

    Returns
    -------
    table : rows ``single poses``, ``all poses jointly``, ``check points``; columns ``normalised`` (mean
        normalised square), ``independent`` (independent errors behind it), ``low, high``: where it lies with
        95 % if the covariances are right. Blocks count alike for single poses, and by their number of errors
        otherwise; three coordinates of a check point count as independent.
    """
    good = table[table["single"].notna()]
    errors = 6 * good["images"].to_numpy(np.float64)
    checks = 3 * good["check_points"].to_numpy(np.float64)
    n = len(good)
    rows = {
        "single poses": (good["single"].mean(), n**2 / float((1 / good["independent"]).sum()) if n else 0.0),
        "all poses jointly": _weighted(good["joint"], errors),
        "check points": _weighted(good["check"].fillna(0.0), checks),
    }
    out = pd.DataFrame(rows.values(), index=pd.Index(rows, name="of"), columns=["normalised", "independent"])
    out["low"], out["high"] = chi2.ppf([[0.025], [0.975]], out["independent"]) / out["independent"].to_numpy()
    return out


def _weighted(values: pd.Series, degrees: ArrayF) -> tuple[float, float]:
    total = float(degrees.sum())
    return float(np.sum(values.to_numpy() * degrees)) / total if total else np.nan, total


def by_factor(table: pd.DataFrame) -> pd.DataFrame:
    """`pooled` for each factor: columns ``of, factor, normalised, independent, low, high``."""
    rows = [pooled(own).reset_index().assign(factor=factor) for factor, own in table.groupby("factor")]
    out = pd.concat(rows, ignore_index=True)
    return out[["of", "factor", "normalised", "independent", "low", "high"]]


def summary(fit: pd.DataFrame, judged: pd.DataFrame) -> pd.DataFrame:
    """`by_factor` of both sets of blocks, with a column ``blocks``: ``fitted`` or ``judged``."""
    parts = [by_factor(table).assign(blocks=name) for name, table in (("fitted", fit), ("judged", judged))]
    return pd.concat(parts, ignore_index=True)[
        ["blocks", "of", "factor", "normalised", "independent", "low", "high"]
    ]


def _study_rows(seed: Seed) -> Tables:
    return {seed.kind: block_study(seed.number, seed.folder)}


def _study_results(tables: Tables, files: Sequence[Path]) -> dict[str, Result]:
    fit, judged = tables["fitted"], tables["judged"]
    blocks = pd.concat([rows.assign(blocks=name) for name, rows in (("fitted", fit), ("judged", judged))])
    return {"table": summary(fit, judged), "blocks": blocks}


STUDY: Final = Study(rows=_study_rows, results=_study_results)
