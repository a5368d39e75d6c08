"""A rig of two lenses in a block: a pose for each exposure, places of lenses weighted by a calibration."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from tests.images.block_scene import dense
from tests.images.test_block_pieces import predictions_of
from thalweg.calibration import LENSES, Rig
from thalweg.core import GeometryError, LocalFrame, Rigid, exp_rotation
from thalweg.images.bundle import adjust_block, pose_covariance, rig_frames
from thalweg.images.bundle.adjustment import FEW_MARKS, image_poses
from thalweg.images.bundle.checks import interior_notes
from thalweg.images.bundle.job import _places
from thalweg.images.bundle.normals import Correlation, linearised, reduced_system, tracks_of, views
from thalweg.images.bundle.problem import Antenna, Layout, Problem, moved, start_state
from thalweg.settings.sections import BlockAdjustment, Rig as RigSettings
from thalweg_lab.dual_fisheye import TrueRig, true_rig
from thalweg_lab.settings import TwinDualFisheye
from thalweg_lab.studies.sensors.rig import (
    EXPOSURES,
    lenses_of,
    one_lens,
    plain_block,
    pose_errors,
    pose_sigmas,
    simulated_block,
    way_of,
)

SIGMA = np.r_[np.tile([0.05, 0.05, 0.05, 0.05, 3e-4, 3e-4, 2e-4, 1e-4], 2), [5e-3] * 3, [2.5e-3] * 3]
"""Standard deviations of a calibration that the places of the lenses matter in: 5 mm, 0.14 degrees."""


def calibrated(true: TrueRig, rng: np.random.Generator) -> Rig:
    """The rig with errors of a calibration whose unknowns are correlated."""
    common = rng.standard_normal((len(SIGMA), 4)) / 2
    cov = common @ common.T + 0.5 * np.eye(len(SIGMA))
    unit = SIGMA / np.sqrt(np.diag(cov))
    cov *= np.outer(unit, unit)
    error = np.linalg.cholesky(cov) @ rng.standard_normal(len(SIGMA))
    return Rig(
        cameras={
            name: true.cameras[name].with_parameters(
                true.cameras[name].parameters + error[8 * k : 8 * k + 8],
                cov[8 * k : 8 * k + 8, 8 * k : 8 * k + 8],
            )
            for k, name in enumerate(LENSES)
        },
        T_back_front=true.T_back_front.moved(error[16:]).with_cov(cov[16:, 16:]),
        settings=RigSettings(),
        cov=cov,
    )


def block(seed: int, **options: Any) -> tuple[Problem, list[Rigid]]:
    true = true_rig(TwinDualFisheye(), seed)
    rig = calibrated(true, np.random.default_rng(seed))
    return simulated_block(lenses_of(true, rig), seed, rig=rig, **options)


def test_derivatives_are_those_of_finite_differences(rng):
    problem, _ = block(1, points=40)
    layout = Layout(problem)
    x = start_state(problem, layout)
    b = problem.block
    widest = max(
        np.rad2deg(np.arccos(ray[2])) for ray in b.cameras[0].rays(b.mark_px[b.camera[b.mark_image] == 0])
    )
    assert widest > 90
    at = b.mark_image, x.X[b.mark_point], b.mark_px
    here = linearised(problem, layout, x, *at)
    assert layout.n_interior == 22
    for column in (*range(6), *(layout.n_poses + np.arange(22))):
        step = 1e-6
        d = np.zeros(len(layout.names))
        d[column : layout.n_poses if column < 6 else column + 1 : 6] = step
        up, down = (linearised(problem, layout, moved(x, s * d, 0 * x.X, layout), *at) for s in (1, -1))
        numeric = -(up.residual - down.residual) / (2 * step)
        by = here.by_pose[:, :, column] if column < 6 else here.by_rest[:, :, column - layout.n_poses]
        np.testing.assert_allclose(by, numeric, rtol=1e-5, atol=3e-4)


def test_normal_equations_are_those_of_all_points_as_unknowns():
    """Lenses that see one point in one exposure share its six unknowns."""
    problem, _ = block(2, points=60)
    layout = Layout(problem)
    x, b, u = start_state(problem, layout), problem.block, len(layout.names)
    seen = np.column_stack([layout.exposure[b.mark_image], b.mark_point])
    assert np.unique(seen, axis=0, return_counts=True)[1].max() == 2
    view = views(x.X[b.mark_point], x.C[b.mark_image])
    tracks = tracks_of(problem, np.ones(len(view), np.bool_), b.sigma_px, view)
    found = reduced_system(problem, layout, x, tracks, Correlation(), problem.marks.sigma_px, 0.0)
    N, g = dense(problem, layout, x, Correlation(), np.tile([1.0, 0.0], (len(view), 1)))
    # points with a single mark tell nothing: two coordinates for three unknowns
    through = N[:u, u:] @ np.linalg.pinv(N[u:, u:], rcond=1e-10, hermitian=True)
    S, s = N[:u, :u] - through @ N[u:, :u], g[:u] - through @ g[u:]
    scale = np.sqrt(np.maximum(np.diag(S), 1.0))
    np.testing.assert_allclose(found.N / np.outer(scale, scale), S / np.outer(scale, scale), atol=1e-8)
    np.testing.assert_allclose(found.g / scale, s / scale, atol=1e-6)


def test_a_rig_of_one_lens_is_no_rig():
    """The same images with and without a rig whose only lens is its frame: the same numbers."""
    problem = one_lens(block(3)[0], 0)
    b = problem.block
    rig = replace(
        block(3)[0].rig,
        exposures=b.images,
        exposure=np.arange(len(b.images)),
        T_rig_lens=(Rigid(R=np.eye(3), shift_m=np.zeros(3)),),
        cov=np.pad(b.cameras[0].cov, (0, 6)),
    )
    without, within = plain_block(problem), plain_block(replace(problem, rig=rig))
    np.testing.assert_allclose(within.x.C, without.x.C, atol=1e-10)
    np.testing.assert_allclose(within.x.R, without.x.R, atol=1e-11)
    np.testing.assert_allclose(within.cov, without.cov, rtol=1e-7, atol=1e-16)
    assert within.sigma0 == pytest.approx(without.sigma0, rel=1e-9)


def squares(places: str, seeds: int) -> float:
    """Mean square of all poses in units of their joint covariance."""
    out = []
    for seed in range(seeds):
        problem, fronts = block(100 + seed, points=200)
        found = plain_block(replace(problem, rig=replace(problem.rig, places=places)))
        error = pose_errors(found, fronts)
        out.append(error @ np.linalg.solve(pose_covariance(found), error) / len(error))
    return float(np.mean(out))


def test_poses_are_within_their_covariance_from_both_sides():
    low, high = chi2.ppf([0.0005, 0.9995], 12 * 6 * EXPOSURES) / (12 * 6 * EXPOSURES)
    assert low < squares("weighted", 12) < high
    # places that are taken as known do not err that little
    assert squares("fixed", 4) > chi2.ppf(0.9995, 4 * 6 * EXPOSURES) / (4 * 6 * EXPOSURES)


def test_places_of_lenses_are_found_by_the_block_if_asked():
    problem, _ = block(7)
    true = true_rig(TwinDualFisheye(), 7).T_front_lens["back"]
    found = plain_block(replace(problem, rig=replace(problem.rig, places="free")))
    at = found.layout.places[1]
    assert (found.layout.places[0] == -1).all()
    error = found.x.T_rig_lens[1].error_from(true)
    square = error @ np.linalg.solve(found.cov[np.ix_(at, at)], error)
    assert chi2.ppf(0.0005, 6) < square < chi2.ppf(0.9995, 6)
    sigma = np.sqrt(np.diag(found.cov)[at])
    assert _places(found) == {
        "back": {
            "shift_m": found.x.T_rig_lens[1].shift_m.tolist(),
            "sigma_shift_m": sigma[:3].tolist(),
            "sigma_rotation_deg": pytest.approx(sigma[3:] * 180 / np.pi),
        }
    }
    # what a calibration says narrows it
    weighted = plain_block(problem)
    assert (np.diag(weighted.cov)[at] < np.diag(found.cov)[at]).all()
    assert (np.diag(weighted.cov)[at] < np.diag(problem.rig.cov)[22:]).all()


def test_exposures_come_out_as_poses_of_the_front_lens():
    problem, fronts = block(12)
    # the front lens of one exposure was lost, of another one both see next to nothing
    b = problem.block
    name = np.array(b.images)[b.mark_image]
    gone = np.isin(name, ["front/003.jpg", "front/005.jpg", "back/005.jpg"])
    few = gone & ~(np.isin(name, ["front/005.jpg"]) & (np.cumsum(name == "front/005.jpg") <= 2))
    thin = replace(
        b,
        mark_image=b.mark_image[~few],
        mark_point=b.mark_point[~few],
        mark_px=b.mark_px[~few],
        sigma_px=b.sigma_px[~few],
    )
    own = problem.marks.chosen(~np.isin(np.array(b.images)[problem.marks.image], np.unique(name[gone])))
    found = plain_block(replace(problem, block=thin, marks=own))
    frame = LocalFrame(lat_deg=50.9, lon_deg=13.3, h_ell_m=300.0)
    names = (*(f"{k:03d}.jpg" for k in range(EXPOSURES)), "absent.jpg")
    poses = image_poses(found, frame, names, {}, {})
    assert poses.images == names
    assert poses.oriented.tolist() == [k not in (5, 12) for k in range(13)]
    assert poses.reasons[5] == FEW_MARKS
    away = np.linalg.norm(poses.centre_wcs_m[:12] - [T.shift_m for T in fronts], axis=1)
    assert np.nanmax(away) < 0.06
    # the exposure without front lens is held by the other one
    assert 0 < poses.n_marks[3] < poses.n_marks[2]
    following = poses.cov_next[2]
    k = found.layout.exposures.index("002.jpg")
    j = found.layout.exposures.index("003.jpg")
    np.testing.assert_array_equal(following, pose_covariance(found)[6 * k : 6 * k + 6, 6 * j : 6 * j + 6])


def test_poses_of_lenses_have_the_covariance_of_their_exposures(rng):
    """A turn of the boat moves a lens by its arm: against differences of an independent formula."""
    T = (
        Rigid(R=np.eye(3), shift_m=np.zeros(3)),
        Rigid(R=exp_rotation([0.1, 2.0, 0.3]), shift_m=[0.3, -0.2, 1.0]),
    )
    root = rng.normal(size=(32, 6, 6))
    truth = SimpleNamespace(C=rng.normal(size=(32, 3)), R=exp_rotation(rng.normal(size=(32, 3))))
    poses = replace(
        predictions_of(truth), cov_pose_wcs=root @ np.swapaxes(root, 1, 2), oriented=np.arange(32) != 1
    )
    frames = replace(
        block(3)[0].rig, exposures=("0001.jpg", "0000.jpg"), exposure=np.array([1, 0, 0]), T_rig_lens=T
    )
    found = frames.lens_poses(poses, ("b/0", "a/1", "b/1"), np.array([1, 0, 1]))
    assert found.images == ("b/0", "a/1", "b/1")
    for k, (row, lens) in enumerate([(0, 1), (1, 0), (1, 1)]):
        R, C = poses.R_wcs_ccs[row], poses.centre_wcs_m[row]
        np.testing.assert_allclose(found.centre_wcs_m[k], C + R @ T[lens].shift_m)
        np.testing.assert_allclose(found.R_wcs_ccs[k], R @ T[lens].R)
        J = np.eye(6)
        for a in range(3):
            J[:3, 3 + a] = (exp_rotation(1e-6 * np.eye(3)[a]) @ R - R) @ T[lens].shift_m / 1e-6
        np.testing.assert_allclose(
            found.cov_pose_wcs[k], J @ poses.cov_pose_wcs[row] @ J.T, rtol=1e-4, atol=1e-5
        )
        assert found.t_gps_s[k] == poses.t_gps_s[row]
    assert found.oriented.tolist() == [True, False, False]
    assert np.isnan(found.cov_next).all(axis=(1, 2)).tolist() == [False, True, True]
    assert not found.cov_next[0].any()


def test_an_antenna_holds_the_pose_of_the_rig_once():
    problem, fronts = block(13)
    lever = np.array([0.3, -0.5, -0.2])
    layout = Layout(problem)
    order = [int(name[:3]) for name in layout.exposures]
    antenna = Antenna(
        image=np.arange(EXPOSURES),
        t_s=np.arange(EXPOSURES) * 1.0,
        position_wcs_m=np.array([fronts[k].apply(lever[None])[0] for k in order]),
        sigma_m=np.full((EXPOSURES, 3), 0.002),
        lever_ccs_m=lever,
    )
    with_it, without = plain_block(replace(problem, antenna=antenna)), plain_block(problem)
    assert with_it.n_observations == without.n_observations + 3 * EXPOSURES
    assert with_it.costs["antenna"] < 3 * EXPOSURES * 1.8
    assert (pose_sigmas(with_it)[:, 0] < 0.5 * pose_sigmas(without)[:, 0]).all()


def test_names_of_images_tell_their_exposure():
    true = true_rig(TwinDualFisheye(), 1)
    rig = calibrated(true, np.random.default_rng(1))
    cameras = [rig.cameras["back"], rig.cameras["front"]]
    frames = rig_frames(rig, ["back/a.jpg", "back/b.jpg", "front/b.jpg"], cameras)
    assert frames.exposures == ("a.jpg", "b.jpg")
    assert frames.exposure.tolist() == [0, 1, 1]
    assert frames.sought.tolist() == [True, False]
    # the order of the block: parameters of back and front, then the places of back and front
    np.testing.assert_allclose(np.diag(frames.cov)[:8], np.diag(rig.cov)[8:16])
    np.testing.assert_allclose(frames.cov[16:22, 16:22], rig.T_back_front.inverse().cov)
    with pytest.raises(GeometryError, match=r"the image or camera b\.jpg"):
        rig_frames(rig, ["front/a.jpg", "b.jpg"], cameras)
    with pytest.raises(GeometryError, match="1 cameras in a block of a rig"):
        rig_frames(rig, ["front/a.jpg"], cameras[1:])


def test_parts_of_a_block_agree_on_the_lenses_of_a_rig():
    """With all options of a survey, and enough exposures to compare parts of the block."""
    problem, fronts = block(16, fronts=way_of(16, 18), points=400)
    found = adjust_block(problem, BlockAdjustment())
    assert found.interior_variance == BlockAdjustment().interior_variance
    assert not found.notes
    error, cov = pose_errors(found, fronts), pose_covariance(found)
    assert error @ np.linalg.solve(cov, error) / len(error) < chi2.ppf(0.9995, len(error)) / len(error)


def test_a_rig_that_was_opened_since_its_calibration_is_told():
    problem, _ = block(17)
    rig = problem.rig
    assert interior_notes(plain_block(problem), None) == []
    slipped = rig.T_rig_lens[1].moved([0.0, 0.0, 0.0, 0.02, 0.0, 0.0])
    wrong = replace(problem, rig=replace(rig, T_rig_lens=(rig.T_rig_lens[0], slipped)))
    (note,) = interior_notes(plain_block(wrong), None)
    assert note.startswith("The images put the lens back")
    assert "times what its sigma allows" in note
