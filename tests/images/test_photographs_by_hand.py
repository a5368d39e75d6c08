"""Tables, clouds and measured tie points of oriented photographs, against values written by hand."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import laspy
import numpy as np
import pandas as pd
import pytest
from pyproj import CRS

from tests.images.block_scene import FRAME, predictions, without_points
from thalweg.core import Camera, InputError, exp_rotation
from thalweg.images import photographs
from thalweg.images.bundle.job import Pieces
from thalweg.images.model import ControlPoints
from thalweg.images.photographs import PhotographBlock, in_crs, pose_table, with_measured_points
from thalweg.images.sfm import features
from thalweg.settings.sections import LOCAL, ControlSettings

PINHOLE = Camera(
    model="perspective", size_px=(400, 300), parameters=np.array([200.0, 200.0, 200.0, 150.0, 0, 0, 0, 0, 0])
)


def piece(names, X, marks, used, origin):
    return SimpleNamespace(
        adjusted=SimpleNamespace(
            problem=SimpleNamespace(
                block=SimpleNamespace(images=names, mark_point=np.array(marks, np.int64))
            ),
            used=np.array(used, bool),
            x=SimpleNamespace(X=np.array(X, float)),
            origin_m=np.array(origin, float),
        )
    )


def block(crs, marked=None, **changes):
    """Two pieces; of the first piece the second point has one used mark."""
    poses = predictions(
        np.array([[1.0, 2, 3], [np.nan] * 3]),
        np.array([exp_rotation([0.2, -0.4, 0.6]), np.full((3, 3), np.nan)]),
        oriented=np.array([True, False]),
        reasons=("", "dark"),
        cov_pose_wcs=np.array(
            [np.diag(np.square([1.0, 2, 3, *np.deg2rad([4, 5, 6])])), np.full((6, 6), np.nan)]
        ),
        rms_px=np.array([0.25, np.nan]),
    )  # fmt: skip
    oriented = (
        piece(("a", "b"), [[1, 2, 3], [4, 5, 6], [7, 8, 9]], [0, 0, 1, 1, 2, 2, 2], [1, 1, 0, 1, 1, 1, 1],
              [10, 0, 0]),
        piece(("c", "d"), [[0, 0, 1]], [0, 0], [1, 1], [0, 20, 0]),
    )  # fmt: skip
    facts = {"observations": 7, "sigma0": 1.25, "notes": ["n"], "images": 1} | changes
    found = Pieces(oriented=oriented, poses=poses, facts=facts, piece=np.array([0, -1]))
    return PhotographBlock(found=found, control=ControlPoints.none(), crs=crs, marked=marked or {})


def test_tie_points_that_two_photographs_show():
    table = block(LOCAL).point_table()
    assert list(table.columns) == ["x_m", "y_m", "z_m", "images", "piece"]
    assert table.values.tolist() == [[11, 2, 3, 2, 0], [17, 8, 9, 3, 0], [0, 20, 1, 2, 1]]
    named = block(None, {("a", "b"): ("P", "Q"), ("x", "y"): ("R",)}).point_table()
    assert list(named.columns) == ["x", "y", "z", "images", "piece", "point"]
    # the last two points of the first piece have names, the first of these has no two used marks
    assert named["point"].tolist() == ["", "Q", ""]


def test_poses_column_by_column():
    poses = block(LOCAL).found.poses
    grid = FRAME.to_map(np.array([[1.0, 2, 3]]), CRS("EPSG:25833"))[0]
    for crs, places, axes in (
        (LOCAL, [1, 2, 3], ("x_m", "y_m", "z_m")),
        (None, [1, 2, 3], ("x", "y", "z")),
        ("EPSG:25833", grid, ("x_m", "y_m", "z_m")),
    ):
        table = pose_table(poses, crs)
        assert table["image"].tolist() == ["0000.jpg", "0001.jpg"]
        np.testing.assert_allclose(table.loc[0, list(axes)].astype(float), places)
        assert table.loc[1, list(axes)].isna().all()
        assert table.loc[0, [f"sigma_{a}" for a in axes]].tolist() == pytest.approx([1, 2, 3])
        turned = [f"sigma_rotation_{a}_deg" for a in "xyz"]
        assert table.loc[0, turned].tolist() == pytest.approx([4, 5, 6])
        assert (table["rms_px"][0], table["reason"].tolist()) == (0.25, ["", "dark"])
    # half of the angle about the axis
    q = table.loc[0, ["qx", "qy", "qz", "qw"]].to_numpy(float)
    v, size = np.array([0.2, -0.4, 0.6]), np.sqrt(0.56)
    np.testing.assert_allclose(q * np.sign(q[3]), [*(v / size * np.sin(size / 2)), np.cos(size / 2)])
    assert np.isnan(in_crs(np.full((2, 3), np.nan), FRAME, "EPSG:25833")).all()


@pytest.mark.parametrize("crs", [None, LOCAL, "EPSG:25833"])
def test_files_of_a_block(crs, tmp_path, monkeypatch):
    """A model has no files in metres, more digits, and a finer cloud; a map grid is stated."""
    told = {}
    monkeypatch.setattr(photographs, "write_cameras", lambda *words: told.setdefault("cameras", words))
    tables = (pd.DataFrame({"a": [1 / 3]}), pd.DataFrame({"b": [2 / 3]}))
    monkeypatch.setattr(photographs, "pieces_tables", lambda found: tables)
    made = block(crs, rms=1 / 3)
    folder = tmp_path / "deep" / "out"
    files = made.write(folder, name="survey")
    assert [f.name for f in files] == [
        f for f in photographs.FILES if crs or f not in ("image_poses.parquet", "control_points.csv")
    ]
    *_, source = told["cameras"]
    assert (source.run, source.observations, source.sigma0) == ("survey", 7, 1.25)
    assert json.loads((folder / "orientation.json").read_text()) == {"crs": crs, **made.found.facts}
    assert (folder / "image_poses.parquet").exists() == (folder / "control_points.csv").exists() == bool(crs)
    points = (folder / "points.csv").read_text().splitlines()
    if crs != "EPSG:25833":
        assert points[1] == ("11.000,2.000,3.000,2,0" if crs else "11,2,3,2,0")
    cloud = laspy.read(folder / "points.laz")
    np.testing.assert_allclose(cloud.xyz, made.point_table().iloc[:, :3].to_numpy(float), atol=6e-4)
    assert cloud.header.scales.tolist() == [0.001 if crs else 1e-5] * 3
    assert (np.array(cloud["images"]).tolist(), np.array(cloud["piece"]).tolist()) == ([2, 3, 2], [0, 0, 1])
    found = cloud.header.parse_crs()
    assert (found is not None) == (crs == "EPSG:25833")


def test_tie_points_measured_by_hand(tmp_path):
    """Named in any case; a point in one photograph, or with parallel rays, is none."""
    C = np.array([[0.0, 0, 0], [2, 0, 0], [0, 1, 0]])
    own = without_points((PINHOLE,), ("a.jpg", "b.jpg", "c.jpg"), C, np.tile(np.eye(3), (3, 1, 1)))
    own = replace(
        own,
        points_block_m=np.array([[0.0, 0, 9], [1.0, 0, 9]]),
        mark_image=np.array([0]),
        mark_point=np.array([1]),
        mark_px=np.array([[7.0, 8.0]]),
        sigma_px=np.array([0.75]),
    )
    P, Q = np.array([1.0, 0.5, 4.0]), np.array([-1.0, 0.25, 5.0])
    rows = ["image,point,x_px,y_px,sigma_px"]

    def seen(image, point, name, sigma=""):
        d = point - C[image]
        rows.append(f"{'abc'[image]}.jpg,{name},{200 + 200 * d[0] / d[2]},{150 + 200 * d[1] / d[2]},{sigma}")

    seen(2, Q, "Q")
    seen(0, P, "p ", 0.5)
    seen(1, Q, "alone")
    seen(1, P, "P")
    seen(0, Q, "q")
    rows += ["a.jpg,far,200,150,", "b.jpg,far,200,150,"]
    path = tmp_path / "marks.csv"
    path.write_text("\n".join(rows) + "\n")
    found, names = with_measured_points(own, path, ("a.jpg", "b.jpg", "c.jpg"), sigma_px=0.25)
    # of a name in several cases the last one is shown, at the place of the first
    assert names == ("q", "P")
    np.testing.assert_allclose(found.points_block_m, [[0, 0, 9], [1, 0, 9], Q, P], atol=1e-6)
    assert found.mark_image.tolist() == [0, 0, 2, 0, 1]
    assert found.mark_point.tolist() == [1, 2, 2, 3, 3]
    assert found.sigma_px.tolist() == [0.75, 0.25, 0.25, 0.5, 0.25]
    np.testing.assert_allclose(found.mark_px[0], [7, 8])
    np.testing.assert_allclose(found.mark_px[3], [250, 175])


def test_what_is_given_is_looked_at_before_the_photographs(tmp_path):
    names = ["points", "positions", "marks"]
    points, positions, marks = (tmp_path / f"{name}.csv" for name in names)
    points.write_text("id,x,y,z\nA,1,2,3\nB,4,5,6\n")
    positions.write_text("image,x,y,z,accuracy\na.jpg,1,2,3,0.25\n")
    marks.write_text("image,point,x_px,y_px\na.jpg,A,5,6\n")
    section = ControlSettings(sigma_m=(0.5, 0.5, 1.0), height_offset_m=10.0)
    (tmp_path / "a.jpg").write_bytes(b"no picture")
    images = {"a.jpg": tmp_path / "a.jpg"}
    given = (images, LOCAL, [points], None, positions, section)
    frame, found, centres, files = photographs.what_is_given(*given)
    assert (frame.lat_deg, list(files)) == (0.0, ["a.jpg"])
    np.testing.assert_array_equal(found.points_wcs_m, [[1, 2, 13], [4, 5, 16]])
    np.testing.assert_array_equal(found.cov_wcs_m2[1], np.diag([0.25, 0.25, 1.0]))
    np.testing.assert_array_equal(centres.centre_wcs_m, [[1, 2, 13]])
    np.testing.assert_array_equal(centres.sigma_m, [[0.25] * 3])
    # a photograph whose size nobody knows has no pixels to mark
    with pytest.raises(InputError, match=r"pixels inside of 0 x 0"):
        photographs.what_is_given(images, LOCAL, [points], marks, None, section)
    with pytest.raises(InputError, match="coordinates without a CRS; expected a map grid, or local"):
        photographs.what_is_given(images, None, [], None, positions, section)
    assert photographs.what_is_given(images, None, [], None, None, section)[2] is None
    with pytest.raises(InputError, match="projected"):
        photographs.what_is_given(images, "EPSG:4326", [points], None, None, section)


def test_the_files_of_a_campaign_are_handed_on(tmp_path, monkeypatch, caplog):
    """The first of each kind, or none; notes are told as warnings."""
    told = {}

    def orient(images, **how):
        told.update(how, images=images)
        return SimpleNamespace(
            found=SimpleNamespace(facts={"notes": ["a note"]}),
            write=lambda folder, *, name: told.update(folder=folder, name=name),
        )

    monkeypatch.setattr(photographs, "orient_photographs", orient)
    monkeypatch.setattr(photographs, "find_images", lambda images: SimpleNamespace(files=images))
    monkeypatch.setattr(photographs, "summary_text", lambda facts: "one\ntwo")
    two = {name: [Path(f"{name}1"), Path(f"{name}2")] for name in ("marks", "positions", "interior", "masks")}
    same = dict(
        zip(("features", "mapping", "adjustment", "control", "device", "threads"), range(6), strict=True)
    )
    words = {"images": [tmp_path], "control_points": [Path("c")], "folder": tmp_path}
    words |= {"campaign": {"id": "x", "crs": LOCAL}, **same}
    photographs.orient_files(**words, **two)
    expected = {name.replace("interior", "camera"): paths[0] for name, paths in two.items()}
    expected |= same | {"images": [tmp_path], "control_points": [Path("c")], "crs": LOCAL, "name": "x"}
    assert {name: told[name] for name in expected} == expected
    assert [r.message for r in caplog.records if r.levelname == "WARNING"] == ["a note"]
    photographs.orient_files(**words, **{key: [] for key in two})
    assert [told[n] for n in ("marks", "positions", "camera", "masks")] == [None] * 4


def test_features_of_the_largest_scale_and_pictures_with_few():
    place = np.array([[0, 0, 2.0], [0, 0, 9.0], [0, 0, 5.0], [0, 0, 2.0], [0, 0, 7.0]], np.float32)
    free = np.array([True, False, True, True, True])
    assert features._largest(place, free, 4).tolist() == [0, 2, 3, 4]
    assert features._largest(place, free, 3).tolist() == [0, 2, 4]  # of equals the first
    assert features._largest(place, free, 1).tolist() == [4]
    how = SimpleNamespace(min_features=100)

    def told(n, contrast, share):
        return features._few(SimpleNamespace(contrast=contrast, usable_share=share), n, how)

    assert told(100, 0.0, 0.0) == ""
    assert told(99, 2.9, 0.2) == "99 features: the usable part is blank (contrast 2.9 of 255)"
    assert told(99, 3.0, 0.5) == "99 features: too blurred or without texture"
    assert told(99, 3.0, 0.25) == "99 features: too blurred or without texture, 75 % are masked"
