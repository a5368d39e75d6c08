"""Files of a measured field: points with their covariance, facts, cameras."""

import json

import numpy as np
import pandas as pd
import pytest

from tests.calibration import field_blocks as blocks
from thalweg.calibration import camera_of, interior_calibration, read_camera, same_size
from thalweg.calibration.field import (
    FieldPoints,
    measure,
    point_table,
    read_facts,
    read_place,
    read_points,
    starting_camera,
    write_facts,
    write_points,
)
from thalweg.calibration.field.description import FieldCone, Target
from thalweg.calibration.field.points import covariance_file
from thalweg.core import (
    GeometryError,
    InputError,
    LocalFrame,
    Rigid,
    exp_rotation,
    write_colmap,
    write_opencv,
)
from thalweg.core.calibration import Source, read_calibration, write_calibration

FRAME = LocalFrame(lat_deg=51.028, lon_deg=13.721, h_ell_m=160.0)
PLACE = Rigid(R=exp_rotation([0, 0, 0.7]), shift_m=np.array([30.0, -20.0, 1.0]))


def points() -> FieldPoints:
    rng = np.random.default_rng(1)
    B = rng.normal(size=(24, 24)) * 1e-4
    names = tuple((m, c) for m in (3, 17) for c in range(4))
    return FieldPoints(points=names, points_pcs=rng.normal(size=(8, 3)), cov=B @ B.T)


def test_points_and_their_covariance(tmp_path):
    path = tmp_path / "field_points.csv"
    write_points(path, points())
    found = read_points(path)
    assert found.points == points().points
    np.testing.assert_array_equal(found.points_pcs, points().points_pcs)
    np.testing.assert_array_equal(found.cov, points().cov)
    head = ["mark", "x_m", "y_m", "z_m", "sigma_x_m", "sigma_y_m", "sigma_z_m"]
    assert path.read_text().splitlines()[0] == ",".join(head)
    table = pd.read_csv(path)
    assert table["mark"].tolist() == [f"{m}/{c}" for m in (3, 17) for c in range(4)]
    np.testing.assert_allclose(table.to_numpy()[:, 1:4].astype(float), points().points_pcs, atol=1e-7)
    sigma = np.sqrt(np.diag(points().cov)).reshape(-1, 3)
    np.testing.assert_allclose(table.to_numpy()[:, 4:].astype(float), sigma, atol=1e-7)
    assert list(found.table().columns) == head
    assert found.index == {(3, 0): 0, (3, 1): 1, (3, 2): 2, (3, 3): 3} | {(17, c): 4 + c for c in range(4)}
    first = covariance_file(path).read_bytes()
    write_points(path, points())
    assert covariance_file(path).read_bytes() == first
    covariance_file(path).unlink()
    alone = read_points(path)
    np.testing.assert_allclose(np.sqrt(np.diag(alone.cov)), np.sqrt(np.diag(points().cov)), atol=1e-7)
    assert np.count_nonzero(alone.cov) == 24


def test_files_that_do_not_belong_together(tmp_path):
    path = tmp_path / "field_points.csv"
    write_points(path, points())
    table = pd.read_csv(path)
    table.iloc[1:].to_csv(path, index=False)
    with pytest.raises(InputError, match="belongs to other points"):
        read_points(path)
    table.drop(columns="z_m").to_csv(path, index=False)
    with pytest.raises(InputError, match="z_m"):
        read_points(path)
    for moved_m, same in ((0.9e-6, True), (1e-5, False)):
        table.assign(x_m=table["x_m"] + moved_m).to_csv(path, index=False, float_format="%.9f")
        if same:
            assert len(read_points(path).points) == 8
        else:
            with pytest.raises(InputError, match="belongs to other points"):
                read_points(path)
    with pytest.raises(InputError, match="file not found"):
        read_points(tmp_path / "none.csv")


def test_the_centre_of_a_marker():
    centre, cov = points().centre(17)
    np.testing.assert_allclose(centre, points().points_pcs[4:].mean(axis=0))
    mean = np.hstack([np.zeros((3, 12)), np.tile(np.eye(3), 4) / 4])
    np.testing.assert_allclose(cov, mean @ points().cov @ mean.T)
    with pytest.raises(InputError, match="0 of the four saddles of marker 5"):
        points().centre(5)
    less = points().without({3})
    assert {m for m, _ in less.points} == {17}
    np.testing.assert_array_equal(less.points_pcs, points().points_pcs[4:])
    np.testing.assert_array_equal(less.cov, points().cov[12:, 12:])


def test_a_field_from_marks_to_files(tmp_path):
    """Nobody states a focal length, and the field comes out in the world with a place and its covariance."""
    sheets, field = blocks.yard(2, cones=5, per_cone=6, flat=12)
    marks = blocks.observe(sheets, blocks.stations(2, 14, 7.0), blocks.SLR, 2).assign(file="x")
    centres = blocks.rtk_targets(sheets, [80, 83, 86, 89])
    lat, lon, h = FRAME.to_geodetic(PLACE.apply(np.array(list(centres.values()))))
    targets = tuple(
        Target(
            name=f"T{k}",
            marker=m,
            lat_deg=lat[k],
            lon_deg=lon[k],
            h_ell_m=h[k],
            sigma_m=(0.008, 0.008, 0.012),
        )
        for k, m in enumerate(centres)
    )
    cones = (
        FieldCone(name="C1", markers=tuple(range(6)), half_angle_rad=0.4, length_m=0.7),
        FieldCone(name="C9", markers=(240, 241), half_angle_rad=0.4, length_m=0.7),
    )
    field = type(field)(layout=field.layout, scale_bars=field.scale_bars, targets=targets, cones=cones)
    camera = starting_camera(marks, field, "slr", blocks.SLR.size_px)
    # tried focal lengths stand 25 % apart
    assert 0.75 < camera.parameters[0] / blocks.SLR.parameters[0] < 1.35
    found = measure(marks, {"slr": camera}, field, FRAME)
    assert found.datum is not None
    # pcs lies along east, north and up, about the middle of the targets; RTK of 8 mm over 8 m
    assert np.abs(found.datum.T_wcs_pcs.R - np.eye(3)).max() < 0.01
    assert any(note.startswith("cone C9: 0 of 2 markers were measured") for note in found.notes)
    facts = tmp_path / "field_points.json"
    write_facts(facts, found.network, found.datum, found.notes)
    place = read_place(facts)
    np.testing.assert_allclose(place.matrix, found.datum.T_wcs_pcs.matrix)
    np.testing.assert_allclose(place.cov, found.datum.T_wcs_pcs.cov)
    assert read_facts(facts)["adjustment"]["object_sigma_mean_mm"] < 1.0
    table = point_table(field, found)
    assert set(table["cone"]) == {"", "C1"}
    assert table["images"].min() >= 3
    write_facts(facts, found.network, None, [])
    with pytest.raises(GeometryError, match="names no RTK targets"):
        read_place(facts)
    facts.write_text(json.dumps({"kind": "other", "version": 1}))
    with pytest.raises(InputError, match="other, version 1"):
        read_facts(facts)
    facts.write_text("{")
    with pytest.raises(InputError, match=r"no JSON .*; expected facts of a calibration field"):
        read_facts(facts)


def test_cameras_of_every_kind_of_file(tmp_path):
    sigma = np.r_[np.full(4, 0.1), np.full(5, 1e-4)]
    camera = blocks.SLR.with_parameters(blocks.SLR.parameters, np.diag(sigma**2))
    ours = tmp_path / "camera.yaml"
    write_calibration(ours, interior_calibration(camera, Source(run="yard", method="bundle")))
    found = read_camera(ours)
    assert (found.model, found.size_px) == (camera.model, camera.size_px)
    np.testing.assert_allclose(found.parameters, camera.parameters)
    np.testing.assert_allclose(found.cov, camera.cov, rtol=1e-6)
    assert camera_of(read_calibration(ours)).name == "camera"
    write_opencv(tmp_path / "opencv.yml", camera)
    write_colmap(tmp_path / "cameras.txt", {1: camera})
    for name in ("opencv.yml", "cameras.txt"):
        np.testing.assert_allclose(read_camera(tmp_path / name).parameters, camera.parameters)
        assert not read_camera(tmp_path / name).cov.any()
    write_colmap(tmp_path / "cameras.txt", {1: camera, 2: camera})
    with pytest.raises(InputError, match="2 cameras"):
        read_camera(tmp_path / "cameras.txt")
    with pytest.raises(InputError, match="file not found"):
        read_camera(tmp_path / "none.yaml")
    with pytest.raises(InputError, match="pictures of 3000 x 2000 pixels"):
        same_size(camera, (3000, 2000))
    assert same_size(camera, camera.size_px) is camera
