"""A block that fell into pieces, and a track whose positions take the place of control points."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.images import block_scene
from thalweg.core import GeometryError, exp_rotation
from thalweg.images.bundle import adjust_pieces, marks_of_pieces, pieces_tables, read_pieces
from thalweg.images.bundle.job import time_gaps
from thalweg.images.bundle.problem import Problem
from thalweg.images.model import ImageBlock, ImagePoses
from thalweg.images.sfm.mapping import part_of_block
from thalweg.settings.sections import BlockAdjustment, ControlSettings

N = 32


@pytest.fixture(scope="module")
def survey():
    return block_scene.scene(np.random.default_rng(8), images=N, points=400, control=9, check=5)


def predictions_of(truth) -> ImagePoses:
    at = truth.C + np.array([0.3, -0.3, 0.1])
    return block_scene.predictions(at, truth.R, sigma_t_s=np.full(N, 0.005))


def tables(folder: Path, problem: Problem) -> dict[str, object]:
    return block_scene.campaign_tables(folder, problem) | {"reasons": {}}


def piece(block: ImageBlock, rows, *, turn: float) -> ImageBlock:
    part, _ = part_of_block(block, np.array(rows))
    return part.transformed(exp_rotation([turn, -0.4, 2.0]), np.array([3.0, -5.0, turn]), 0.1 + 0.1 * turn)


def test_pieces_are_adjusted_by_themselves_and_losses_counted_in_seconds(survey, tmp_path):
    problem, truth = survey
    blocks = [piece(problem.block, range(14, N), turn=1.0), piece(problem.block, range(11), turn=0.5)]
    for path, block in zip(("block.npz", "pieces/piece_1.npz"), blocks, strict=True):
        block.write(tmp_path / path)
    read = read_pieces(tmp_path / "block.npz", tmp_path / "pieces")
    assert [b.images for b in read] == [b.images for b in blocks]
    options = tables(tmp_path, problem) | {"adjustment": BlockAdjustment()}
    found = adjust_pieces(read, predictions_of(truth), **options)
    assert found.poses.oriented.sum() == N - 3
    assert found.piece.tolist() == [1] * 11 + [-1] * 3 + [0] * (N - 14)
    off = found.poses.centre_wcs_m - truth.C
    for k in (0, 1):
        rows = np.flatnonzero(found.piece == k)
        each = [off[i] @ np.linalg.solve(found.poses.cov_pose_wcs[i, :3, :3], off[i]) / 3 for i in rows]
        # each stands in the same world by its own control points; some six independent errors of a piece
        assert np.mean(each) < 3.0
    # errors of the last image of one piece and the first of the other are independent
    assert not found.poses.cov_next[10].any()
    assert found.poses.cov_next[9].any()
    (gap,) = found.facts["gaps"]
    assert (gap["first"], gap["last"], gap["images"]) == ("0011.jpg", "0013.jpg", 3)
    assert gap["seconds"] == pytest.approx(4.0)
    assert found.facts["images_without_pose"] == 3
    assert any("a gap of 4.0 s" in note for note in found.facts["notes"])
    assert any("fell into 2 pieces: 18 images (0014.jpg to 0031.jpg)" in n for n in found.facts["notes"])
    images, control = pieces_tables(found)
    assert images["piece"].tolist() == found.piece.tolist()
    assert images["tie_marks"].notna().sum() == N - 3
    assert set(control["piece"]) == {0, 1}


def test_a_piece_without_control_points_is_left_with_its_reason(survey, tmp_path):
    problem, truth = survey
    blocks = [piece(problem.block, range(14, N), turn=1.0), piece(problem.block, range(9), turn=0.5)]
    late = problem.marks.image >= 14
    options = tables(tmp_path, replace(problem, marks=problem.marks.chosen(late)))
    found = adjust_pieces(blocks, predictions_of(truth), adjustment=BlockAdjustment(), **options)
    assert found.poses.oriented.sum() == N - 14
    assert "0 usable control points" in found.poses.reasons[3]
    assert found.facts["pieces"][1]["left_out"].startswith("0 usable control points")
    # no image before it: its length in time is not known
    assert found.facts["gaps"][0]["seconds"] is None
    with pytest.raises(GeometryError, match="0 usable control points"):
        adjust_pieces(blocks[1:], predictions_of(truth), adjustment=BlockAdjustment(), **options)


def test_marks_of_a_table_belong_to_the_piece_of_their_image(survey, tmp_path):
    problem, truth = survey
    blocks = [piece(problem.block, range(14, N), turn=1.0), piece(problem.block, range(11), turn=0.5)]
    tables(tmp_path, problem)
    lost = int(((problem.marks.image >= 11) & (problem.marks.image < 14)).sum())
    measured = partial(
        marks_of_pieces,
        blocks,
        problem.control,
        predictions_of(truth),
        ControlSettings(),
        tables=[tmp_path / "marks.csv"],
        grey=lambda n: None,
        mask=lambda n: None,
    )
    found = measured()
    assert found.counts["used"] == len(problem.marks.image) - lost
    assert found.counts["in images without a pose"] == lost
    assert len(found.table) == found.counts["used"]
    assert not found.table.duplicated(["image", "point"]).any()
    # all marks in images of the main piece: the other one has none, and none is without a pose
    late = problem.marks.image >= 14
    tables(tmp_path, replace(problem, marks=problem.marks.chosen(late)))
    assert measured().counts == {"used": late.sum()}


def test_gaps_of_images_without_time_and_at_the_end(survey):
    _, truth = survey
    poses = predictions_of(truth)
    lost = np.isin(np.arange(N), [4, 5, 9, N - 1])
    t = poses.t_gps_s.copy()
    t[5] = np.nan
    poses = replace(
        poses,
        oriented=~lost,
        t_gps_s=t,
        reasons=tuple("blurred" if k == 9 else "masked" if x else "" for k, x in enumerate(lost)),
    )
    gaps = time_gaps(poses)
    assert [(g["images"], g["seconds"], g["reason"]) for g in gaps] == [
        (2, pytest.approx(3.0), "masked"),
        (1, pytest.approx(2.0), "blurred"),
        (1, None, "masked"),
    ]
