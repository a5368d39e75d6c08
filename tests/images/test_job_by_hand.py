"""Pieces, gaps, tables and facts of an adjusted block, against values written by hand."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from tests.images.block_scene import predictions, without_points
from tests.images.sfm_scene import PERSPECTIVE, longer
from thalweg.core import Camera, GeometryError, Rigid
from thalweg.core.calibration import Source
from thalweg.images import Measured
from thalweg.images.bundle import job
from thalweg.images.bundle.adjustment import ControlResult
from thalweg.settings.sections import ControlSettings


def block_of(names, cameras=(PERSPECTIVE,), camera=None):
    n = len(names)
    found = without_points(cameras, names, np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)))
    return found if camera is None else replace(found, camera=np.array(camera))


def poses_of(oriented, value=1.0, reasons=None):
    """Poses whose numbers tell image and piece."""
    n, at = len(oriented), np.array(oriented, bool)
    of = value + np.arange(n)
    return predictions(
        np.where(at, of, np.nan)[:, None] * np.ones(3),
        of[:, None, None] * np.eye(3),
        oriented=at,
        reasons=tuple(reasons or ("" if a else "none" for a in at)),
        cov_pose_wcs=of[:, None, None] * np.eye(6),
        cov_next=np.where(np.r_[at[1:], False], of, 0.0)[:, None, None] * np.ones((6, 6)),
        n_marks=of,
        rms_px=of,
    )


def test_the_first_piece_that_has_an_image_gives_its_pose():
    first = poses_of([1, 0, 1, 1, 0, 0, 0], 1.0)
    second = poses_of([0, 1, 1, 0, 1, 1, 0], 101.0)
    found, piece = job._joined([first, second], {"0006.jpg": "blurred"})
    assert piece.tolist() == [0, 1, 0, 0, 1, 1, -1]
    expected = [1.0, 102.0, 3.0, 4.0, 105.0, 106.0]
    for name in ("n_marks", "rms_px"):
        assert getattr(found, name)[:6].tolist() == expected
    assert found.centre_wcs_m[:6, 2].tolist() == expected
    assert found.R_wcs_ccs[:6, 1, 1].tolist() == expected
    assert found.cov_pose_wcs[:6, 5, 5].tolist() == expected
    # 2 and 3 are of the first piece, 4 and 5 of the second; others are beside an image of another piece
    assert found.cov_next[:, 0, 5].tolist() == [0, 0, 3.0, 0, 105.0, 0, 0]
    assert found.reasons == ("",) * 6 + ("blurred",)
    assert found.oriented.tolist() == [True] * 6 + [False]
    alone, piece = job._joined([first], {})
    assert piece.tolist() == [0, -1, 0, 0, -1, -1, -1]
    assert alone.reasons[1] == "none"
    assert alone.cov_next[2, 0, 0] == 3.0


def test_gaps_in_words():
    """Images without a time before the first one that has one come first."""
    t = np.r_[np.nan, 10.0, 11.0, 14.0, np.nan, 16.5]
    poses = replace(
        poses_of([0, 1, 0, 0, 0, 1]), t_gps_s=t, reasons=("unknown", "", "dark", "blurred", "blurred", "")
    )
    gaps = job.time_gaps(poses)
    assert [tuple(gap.values()) for gap in gaps] == [
        ("0000.jpg", "0000.jpg", 1, None, "unknown"),
        ("0002.jpg", "0004.jpg", 3, 6.5, "blurred"),
    ]
    assert job._gap_notes(gaps) == [
        "3 images without pose (0002.jpg to 0004.jpg, a gap of 6.5 s): blurred",
        "1 image without pose (0000.jpg, at the end): unknown",
    ]
    many = job._gap_notes([gaps[0] | {"images": k} for k in range(1, 8)])
    assert [note[:8] for note in many[:-1]] == [f"{k} images" for k in (7, 6, 5, 4, 3)]
    assert many[-1] == "2 more gaps: see the report of the images"
    assert len(job._gap_notes([gaps[0]] * 5)) == 5


def adjusted_pieces(monkeypatch, blocks, adjusted, own_frame=False, **options):
    """Pieces whose adjustments are given: what is left out, or the block's facts and poses."""
    told = []

    def adjust(block, predictions, *, reasons, elsewhere, own_frame, **options):
        told.append((block.images, dict(reasons), elsewhere, own_frame, options))
        result = adjusted[block.images[0]]
        if isinstance(result, str):
            raise GeometryError(result, expected="more")
        left, poses = result
        facts = {
            "sigma_position_mm": {"east": 1e3, "north": 2e3, "up": 3e3},
            "sigma_rotation_mdeg": {"east": 4.0, "north": 5.0, "up": 6.0},
            "check_points": {"points": len(block.images)},
            "left_out_points": dict(left),
            "notes": [f"of {block.images[0]}"],
        }
        return SimpleNamespace(left_out=left, datum="the first photograph"), poses, facts

    monkeypatch.setattr(job, "adjust_campaign", adjust)
    found = job.adjust_pieces(
        blocks, poses_of([0] * 9), reasons={"0008.jpg": "lost"}, own_frame=own_frame, **options
    )
    return found, told


NAMES = tuple(f"{k:04d}.jpg" for k in range(9))


def test_what_becomes_of_each_piece(monkeypatch):
    rows = [(0, 1, 2), (3, 4), (4, 5, 6), (2, 5, 7)]
    blocks = [block_of([NAMES[k] for k in part]) for part in rows]
    done = {
        NAMES[0]: ({"P": "unmarked", "Q": "unmarked"}, poses_of([1, 1, 1] + 6 * [0])),
        NAMES[4]: "contradicts",
        NAMES[2]: ({"Q": "elsewhere"}, poses_of([0, 0, 1, 0, 0, 1, 0, 1, 0], 101.0)),
    }
    found, told = adjusted_pieces(monkeypatch, blocks, done, rig=None)
    assert [images for images, *_ in told] == [blocks[0].images, blocks[2].images, blocks[3].images]
    assert told[0][2] == {NAMES[k] for k in (3, 4, 5, 6, 7)}
    assert told[2][2] == {NAMES[k] for k in (0, 1, 3, 4, 6)}
    assert [own for *_, own, options in told if options == {"rig": None}] == [False] * 3
    small, wrong = "in a piece of 2 images: 2 images, 3 are needed", "in a piece of 3 images: contradicts"
    assert told[2][1] == {
        "0008.jpg": "lost", "0003.jpg": small, "0004.jpg": wrong, "0005.jpg": wrong, "0006.jpg": wrong
    }  # fmt: skip
    assert found.piece.tolist() == [0, 0, 0, -1, -1, 1, -1, 1, -1]
    assert found.poses.reasons == ("", "", "", small, wrong, "", wrong, "", "lost")
    facts = found.facts
    # a point is left out that no piece has
    assert facts["left_out_points"] == {"Q": "unmarked"}
    assert (facts["images"], facts["images_without_pose"]) == (5, 4)
    sigma = {"east": 1e3, "north": 2e3, "up": 3e3}
    assert facts["pieces"] == [
        {"images": 3, "first": NAMES[0], "last": NAMES[2], "sigma_position_mm": sigma,
         "check_points": {"points": 3}},
        {"images": 2, "first": NAMES[3], "last": NAMES[4], "left_out": "2 images, 3 are needed"},
        {"images": 3, "first": NAMES[4], "last": NAMES[6], "left_out": "contradicts"},
        {"images": 3, "first": NAMES[2], "last": NAMES[7], "sigma_position_mm": sigma,
         "check_points": {"points": 3}},
    ]  # fmt: skip
    assert facts["notes"] == [
        "of 0000.jpg",
        "The block fell into 4 pieces: 3 images (0000.jpg to 0002.jpg): adjusted by itself; 2 images "
        "(0003.jpg to 0004.jpg): left out, 2 images, 3 are needed; 3 images (0004.jpg to 0006.jpg): left "
        "out, contradicts; 3 images (0002.jpg to 0007.jpg): adjusted by itself",
        "of 0002.jpg",
        f"2 images without pose (0003.jpg to 0004.jpg, a gap of 3.0 s): {small}",
        f"1 image without pose (0006.jpg, a gap of 2.0 s): {wrong}",
        "1 image without pose (0008.jpg, at the end): lost",
    ]
    with pytest.raises(GeometryError, match="contradicts"):
        adjusted_pieces(monkeypatch, blocks[1:3][::-1], done)


def test_a_model_has_the_frame_of_its_main_piece_alone(monkeypatch):
    blocks = [block_of(NAMES[:3]), block_of(NAMES[3:6])]
    done = {NAMES[0]: ({}, poses_of([1, 1, 1] + 6 * [0]))}
    found, told = adjusted_pieces(monkeypatch, blocks, done, own_frame=True)
    assert (len(told), told[0][3]) == (1, True)
    reason = "no common points join it to the main one, and a model has one frame"
    assert found.facts["pieces"][1]["left_out"] == reason
    assert found.facts["model_frame"]["datum"] == "the first photograph"
    assert found.facts["sigma_position_model"] == {"x": 1.0, "y": 2.0, "z": 3.0}
    one, _ = adjusted_pieces(monkeypatch, blocks[:1], done)
    assert "pieces" not in one.facts
    assert one.facts["notes"][0] == "of 0000.jpg"


def test_tables_of_pieces(monkeypatch):
    """Each image has the row of its piece; a model has units and no millimetres."""
    names = [
        f"sigma_{word}{a}_{unit}" for word, unit in (("", "mm"), ("rotation_", "mdeg")) for a in job._AXES
    ]

    def images(adjusted, *given):
        assert given == (("a", "b", "c"), {"a": "", "b": "", "c": "dark"})
        return pd.DataFrame({"image": list("abc")} | {n: adjusted * 1e3 + np.arange(3.0) for n in names})

    monkeypatch.setattr(job, "image_table", images)
    monkeypatch.setattr(
        job, "control_table", lambda adjusted, *_: pd.DataFrame({"point": ["P"] * (adjusted != 3)})
    )
    oriented = [SimpleNamespace(adjusted=k, control=None, left_out={}) for k in (1, 2, 3)]
    poses = SimpleNamespace(images=("a", "b", "c"), reasons=("", "", "dark"))
    found = SimpleNamespace(poses=poses, oriented=oriented, piece=np.array([0, 1, -1]), facts={})
    table, control = job.pieces_tables(found)
    assert table["piece"].tolist() == [0, 1, -1]
    for name in names:
        assert table[name].tolist() == [1000.0, 2001.0, 1002.0]
    assert control.values.tolist() == [["P", 0], ["P", 1]]
    found.facts = {"model_frame": {}}
    table, _ = job.pieces_tables(found)
    for a in "xyz":
        assert table[f"sigma_{a}"].tolist() == [1.0, 2.001, 1.002]
        assert table[f"sigma_rotation_{a}_mdeg"].tolist() == [1000.0, 2001.0, 1002.0]
    assert not {*names} & {*table.columns}
    found.oriented = oriented[2:]
    assert len(job.pieces_tables(found)[1]) == 0


def result_of(n, rng):
    A, B = rng.normal(0, 0.01, (2, n, 3, 3))
    return ControlResult(
        off_m=rng.normal(0, 0.01, (n, 3)),
        cov_m2=A @ np.swapaxes(A, 1, 2) + 1e-6 * np.eye(3),
        without_m=rng.normal(0, 0.01, (n, 3)),
        cov_without_m2=B @ np.swapaxes(B, 1, 2),
        test=np.array([3.0, 6.0, 1.5, 12.0])[:n],
        n_marks=np.array([4, 5, 0, 2])[:n],
        rms_px=np.array([0.25, 0.5, np.nan, 1.0])[:n],
        suspect=np.arange(n) == 1,
        notes=[],
    )


def test_control_points_column_by_column(rng):
    control = SimpleNamespace(names=("A", "B", "C", "D"), check=np.array([False, True, True, True]))
    adjusted = SimpleNamespace(problem=SimpleNamespace(control=control))
    result = result_of(4, rng)
    table = job.control_table(adjusted, result, {"Q": "in no image"})
    assert list(table.columns) == job.CONTROL_COLUMNS
    assert table["point"].tolist() == ["A", "B", "C", "D", "Q"]
    assert table["role"].tolist() == ["control", "check", "check", "check", "left out"]
    assert table["images"].tolist() == [4, 5, 0, 2, 0]
    assert table["rms_px"].tolist()[:2] == [0.25, 0.5]
    assert table["normalised"].tolist()[:4] == [1.0, 2.0, 0.5, 4.0]
    assert table["suspect"].tolist() == [False, True, False, False, False]
    assert table["reason"].tolist() == ["", "", "", "", "in no image"]
    for i, axis in enumerate(("east", "north", "up")):
        for name, values in (
            (f"off_{axis}_mm", 1000 * result.off_m[:, i]),
            (f"without_{axis}_mm", 1000 * result.without_m[:, i]),
            (f"sigma_off_{axis}_mm", 1000 * result.cov_m2[:, i, i] ** 0.5),
            (f"sigma_without_{axis}_mm", 1000 * result.cov_without_m2[:, i, i] ** 0.5),
        ):
            np.testing.assert_allclose(table[name][:4], values)


def test_check_points_err_alike_where_the_datum_is_weak(rng):
    """B and D count, C is in no image and A holds the block; the joint covariance has cross terms."""
    A = rng.normal(0, 0.01, (12, 12))
    control = SimpleNamespace(names=("A", "B", "C", "D"), check=np.array([False, True, True, True]))
    adjusted = SimpleNamespace(
        problem=SimpleNamespace(control=control),
        layout=SimpleNamespace(point=lambda k: slice(3 * k, 3 * k + 3)),
        cov=A @ A.T,
    )
    result = result_of(4, rng)
    found = job.check_statistics(adjusted, result)
    S = [result.cov_m2[k] for k in (1, 3)]
    cross = adjusted.cov[3:6, 9:12]
    # tr((D C)^2) block by block: the identity twice, and twice the blocks beside the diagonal
    trace = 6 + 2 * np.trace(np.linalg.inv(S[0]) @ cross @ np.linalg.inv(S[1]) @ cross.T)
    assert found.pop("independent") == pytest.approx(36 / trace)
    rmse = [np.hypot(*result.off_m[[1, 3], i]) / 2**0.5 for i in range(3)]
    predicted = [((S[0][i, i] + S[1][i, i]) / 2) ** 0.5 for i in range(3)]
    ratio = (sum(v**2 for v in rmse) / sum(v**2 for v in predicted)) ** 0.5
    for name, values in (("rmse_mm", rmse), ("predicted_mm", predicted)):
        np.testing.assert_allclose([found[name][a] for a in ("east", "north", "up")], np.array(values) * 1000)
    assert found["ratio"] == pytest.approx(ratio)
    assert (found["points"], found["normalised"]) == (2, 3.0)
    assert job.check_statistics(adjusted, result, ["B"])["points"] == 1
    assert job.check_statistics(adjusted, result, ["B", "D"]) == {}


def test_places_of_lenses_that_are_sought():
    shift = np.array([0.1, 0.2, 0.3])
    adjusted = SimpleNamespace(
        layout=SimpleNamespace(places=np.array([[-1] * 6, [0, 1, 2, 3, 4, 5]])),
        x=SimpleNamespace(
            cameras=(replace(PERSPECTIVE, name="front"), replace(PERSPECTIVE, name="left")),
            T_rig_lens=[Rigid(R=np.eye(3), shift_m=k * shift) for k in (0, 1)],
        ),
        cov=np.diag([1.0, 4.0, 9.0, *np.radians([1.0, 2.0, 3.0]) ** 2]),
    )
    (place,) = job._places(adjusted).values()
    assert place["shift_m"] == shift.tolist()
    assert place["sigma_shift_m"] == [1.0, 2.0, 3.0]
    np.testing.assert_allclose(place["sigma_rotation_deg"], [1.0, 2.0, 3.0])
    assert list(job._places(adjusted)) == ["left"]


FACTS = {
    "images": 30,
    "tie_points": 100,
    "tie_marks": 456,
    "marks_a_point": 4.56,
    "control_points": 5,
    "sigma0": 1.0234,
    "redundancy": 999,
    "iterations": 7,
    "correlation": {
        "white": 0.5, "white_across": 0.6, "slow": 0.7, "slow_across": 0.8, "reach_deg": 2.5, "power": 1.5,
    },
    "sigma_position_mm": {"east": 1.25, "north": 2.5, "up": 3.75},
    "sigma_rotation_mdeg": {"east": 4.0, "north": 5.0, "up": 6.0},
    "check_points": {
        "points": 4,
        "rmse_mm": {"east": 1.0, "north": 2.0, "up": 3.0},
        "predicted_mm": {"east": 4.0, "north": 5.0, "up": 6.0},
        "ratio": 0.75,
    },
    "left_out": {"marks of other points": 3, "none": 0},
    "notes": ["a note"],
}  # fmt: skip


def test_a_summary_in_words():
    lines = [
        "30 images, 100 tie points with 456 marks (4.6 each), 5 control points",
        "sigma0 1.023, redundancy 999, 7 iterations",
        "errors of a mark in units of its sigma, along / across the parallax: white 0.50 / 0.60, slow 0.70 / "
        "0.80 over 2.5 degrees to the power 1.5",
        "position 1.2 / 2.5 / 3.8 mm, rotation 4.0 / 5.0 / 6.0 thousandths of a degree (median over the "
        "images, east / north / up)",
        "4 check points: RMSE 1.0 / 2.0 / 3.0 mm, predicted 4.0 / 5.0 / 6.0 mm, ratio 0.75",
        "3 marks of other points",
        "a note",
    ]
    assert job.summary_text(FACTS).splitlines() == lines
    model = FACTS | {"model_frame": {}, "sigma_position_model": {"x": 0.0123, "y": 2.0, "z": 3.0}}
    model |= {"check_points": {}}
    lines[3] = (
        "position 0.012 / 2 / 3 units of the model, rotation 4.0 / 5.0 / 6.0 thousandths of a degree (median "
        "over the images, x / y / z)"
    )
    assert job.summary_text(model).splitlines() == [*lines[:4], *lines[5:]]


@pytest.mark.parametrize(
    ("camera", "fits"),
    [
        (longer(1.24), True),
        (longer(1.26), False),
        (longer(1 / 1.24), True),
        (longer(1 / 1.26), False),
        (replace(PERSPECTIVE, size_px=(640, 480)), False),
        (Camera(model="fisheye", size_px=PERSPECTIVE.size_px, parameters=PERSPECTIVE.parameters[:8]), False),
    ],
)
def test_a_common_calibration_is_of_cameras_alike(camera, fits):
    """Of one size and model, and a focal length within a quarter."""
    block = block_of(["a/1.jpg", "b/1.jpg"], (camera, longer(3.0)), [0, 1])
    found = job.given_interiors(block, PERSPECTIVE, {})
    assert [c is not None for c in found] == [fits, False]
    # that of its folder is taken as it is, scaled to the picture; the wrong shape gives none
    (own, none) = job.given_interiors(block, None, {"a": PERSPECTIVE})
    assert none is None
    assert own.size_px == camera.size_px
    assert own.parameters[0] == PERSPECTIVE.parameters[0] * camera.size_px[0] / PERSPECTIVE.size_px[0]
    odd = block_of(["a/1.jpg"], (replace(camera, size_px=(640, 400)),))
    assert job.given_interiors(odd, None, {"a": PERSPECTIVE}) == (None,)


def test_the_innermost_folder_has_the_calibration():
    cameras = (longer(1.1), longer(1.2), longer(1.3))
    block = block_of(["a/b/1.jpg", "a/2.jpg"], cameras, [0, 1])
    folders = {"a": longer(2.0), "a/b": longer(3.0), "c": PERSPECTIVE}
    found = job.given_interiors(block, PERSPECTIVE, folders)
    # the third camera has no image; the common one does not fit it
    assert [None if c is None else round(c.parameters[0]) for c in found] == [810, 540, None]


def test_calibrations_of_a_campaign(tmp_path):
    source = Source(run="r", method="m")
    paths = [tmp_path / f"{k}.yaml" for k in range(3)]
    for k, path in enumerate(paths):
        job.write_calibration(path, job.interior_calibration(longer(1.0 + k), source))
    common, given = job.read_interiors(paths[:1], ["left", "right"], paths[1:])
    assert common.parameters[0] == pytest.approx(270.0)
    assert {name: round(c.parameters[0]) for name, c in given.items()} == {"left": 540, "right": 810}
    assert job.read_interiors([], [], []) == (None, {})


def test_cameras_of_two_pieces_as_one_table():
    names, values = PERSPECTIVE.parameter_names, PERSPECTIVE.parameters
    cov = np.diag(np.square(np.arange(1.0, len(values) + 1)))
    cov[1, 1] = -1.0
    left, right = replace(PERSPECTIVE, name="left", cov=cov), replace(LONG := longer(2.0), name="right")
    blocks = [block_of(["a", "b", "c"], (left, right), [1, 0, 1]), block_of(["d"], (right,))]
    table = job.camera_table([(left, right), (right,)], blocks)
    columns = ["piece", "camera", "images", "first", "model", "width_px", "height_px"]
    assert table[columns].values.tolist() == [
        [0, "left", 1, "b", "perspective", 320, 240],
        [0, "right", 2, "a", "perspective", 320, 240],
        [1, "right", 1, "d", "perspective", 320, 240],
    ]
    for k, name in enumerate(names):
        assert table[name].tolist() == [values[k], LONG.parameters[k], LONG.parameters[k]]
        assert table[f"sigma_{name}"][0] == (0.0 if k == 1 else k + 1)
    assert job.camera_table([(left,)], [block_of([], (left,))])["first"].tolist() == [""]


def marked(images, counts, notes=()):
    rows = {name: [""] * len(images) for name in ("image", "point")} | {"used": [True] * len(images)}
    return Measured(table=pd.DataFrame(rows | {"image": images}), counts=dict(counts), notes=list(notes))


def test_boards_measured_in_pieces(monkeypatch):
    """A mark in an image of two pieces is that of the first; a piece without any is told."""
    found = {
        "a": marked(["a", "b"], {"used": 2, "masked": 0, "too small": 1}, ["n"]),
        "c": GeometryError("nothing to see", expected="boards"),
        "d": marked(["b", "e", "d"], {"used": 3, "too small": 2, "new": 1}, ["m"]),
        "f": marked(["d", "f"], {"used": 1}),
    }
    asked = []

    def measure(block, control, predictions, section, **options):
        asked.append((control, predictions, section, options))
        result = found[block.images[0]]
        if isinstance(result, Exception):
            raise result
        return result

    monkeypatch.setattr(job, "marks_of_campaign", measure)
    blocks = [block_of(list(names)) for names in ("ab", "c", "de", "f")]
    measured = partial(job.marks_of_pieces, blocks, 1, 2, 3, grey=4, mask=5)
    result = measured(tables=[])
    assert asked == [(1, 2, 3, {"tables": [], "grey": 4, "mask": 5})] * 4
    assert result.table["image"].tolist() == ["a", "b", "e", "d", "f"]
    assert result.counts == {"used": 6, "too small": 3, "new": 1}
    assert result.notes == ["n", "piece 1 of 1 images: no control points (nothing to see)", "piece 2: m"]
    # what a table has in images of further pieces is not without a pose
    found["a"] = marked(["a", "b"], {"used": 2, "in images without a pose": 3})
    result = measured(tables=["t"])
    assert result.counts == {"used": 5}
    empty = marked([], {"used": 0})
    found |= dict.fromkeys("acdf", empty)
    assert (len(measured(tables=[]).table), measured(tables=[]).counts) == (0, {"used": 0})


def test_marks_of_two_tables(tmp_path, monkeypatch):
    """Counted together, by reason; without a table and without detection there is a note."""
    control = job.ControlPoints(
        names=("P", "Q"),
        points_wcs_m=np.zeros((2, 3)),
        cov_wcs_m2=np.tile(np.eye(3), (2, 1, 1)),
        check=np.zeros(2, bool),
    )
    head = "image,point,x_px,y_px,sigma_px,used\n"
    paths = [tmp_path / "a.csv", tmp_path / "b.csv"]
    paths[0].write_text(head + "a.jpg,P,5,6,0.25,1\na.jpg,Q,1,2,,0\nlost.jpg,Q,1,2,,1\n")
    paths[1].write_text(head + "b.jpg,Q,7,8,,1\nb.jpg,P,7,8,,0\n")
    given = SimpleNamespace(images=("a.jpg", "b.jpg", "lost.jpg"))
    found = job.marks_of_campaign(
        block_of(["a.jpg", "b.jpg"]), control, given, ControlSettings(sigma_px=0.75),
        tables=paths, grey=None, mask=None,
    )  # fmt: skip
    assert found.counts == {"used": 2, "not to be used": 2, "in images without a pose": 1}
    assert found.table.drop(columns="score").values.tolist() == [
        ["a.jpg", "P", 5.0, 6.0, 0.25, True, ""],
        ["b.jpg", "Q", 7.0, 8.0, 0.75, True, ""],
    ]
    assert found.table["score"].isna().all()
    assert found.notes == []
