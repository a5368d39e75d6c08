"""Poses from tables of angles and models of COLMAP, written by hand from known ones and read back."""

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.images.finished_scene import (
    EXACT,
    FLIP,
    FRAME,
    UTM33,
    angles_deg,
    angles_text,
    assert_poses,
    geocentric,
    grid_rotations,
    predictions,
    scene,
    settings,
    write_colmap_text,
)
from thalweg.core import InputError, LocalFrame, opk_of, rotation_vector
from thalweg.images.imports import import_orientations
from thalweg.images.imports.poses import read_model
from thalweg.images.imports.source import AXES, ORDERS, Angles, angle_covariance, ccs_rotations
from thalweg.images.model import ImagePoses


@pytest.fixture
def truth():
    return scene()


# ---------------------------------------------------------------- angles


def test_the_published_example_of_pix4d():
    """Angles and matrix of one image in Pix4D's two files, as a user printed them in its forum (topic 19555).

    ``calibrated_camera_parameters.txt`` holds the world-to-camera matrix of the axes right, down, forward.
    """
    angles = Angles(
        values=np.array([[91.277233, -45.714811, 0.991059]]),
        unit="deg",
        rotation="omega_phi_kappa",
        direction="image_to_world",
        axes="right_up_back",
    )
    R_ccs_world = [
        [6.9608e-01, -7.1796e-01, 7.4567e-04],
        [1.0111e-02, 8.7643e-03, -9.9991e-01],
        [7.1789e-01, 6.9603e-01, 1.3360e-02],
    ]
    # its angles and its matrix are 0.2 degrees apart
    np.testing.assert_allclose(ccs_rotations(angles)[0].T, R_ccs_world, atol=5e-3)


def test_a_camera_that_looks_down_with_its_top_to_the_north_has_no_angles():
    angles = Angles(
        values=np.zeros((1, 3)),
        unit="deg",
        rotation="omega_phi_kappa",
        direction="image_to_world",
        axes="right_up_back",
    )
    R = ccs_rotations(angles)[0]
    np.testing.assert_array_equal(R @ [0.0, 0.0, 1.0], [0.0, 0.0, -1.0])
    np.testing.assert_array_equal(R @ [1.0, 0.0, 0.0], [1.0, 0.0, 0.0])
    np.testing.assert_array_equal(R @ [0.0, 1.0, 0.0], [0.0, -1.0, 0.0])


@pytest.mark.parametrize("direction", ["image_to_world", "world_to_image"])
@pytest.mark.parametrize("rotation", sorted(ORDERS))
def test_sigmas_of_angles_become_those_of_the_rotation_vector(rotation, direction):
    values = np.array([[97.0, -33.0, 12.0], [-10.0, 5.0, 170.0]])
    sigma = np.array([[0.03, 0.05, 0.02], [0.01, 0.02, 0.04]])
    angles = Angles(values=values, unit="gon", rotation=rotation, direction=direction, axes="right_up_back")
    J = np.empty((2, 3, 3))
    for k in range(3):
        step = np.zeros(3)
        step[k] = 1e-4
        plus, minus = (
            ccs_rotations(
                Angles(
                    values=values + s * step,
                    unit="gon",
                    rotation=rotation,
                    direction=direction,
                    axes="right_up_back",
                )
            )
            for s in (1, -1)
        )
        J[:, :, k] = rotation_vector(plus @ np.swapaxes(minus, 1, 2)) / 2e-4
    expected = (J * sigma[:, None, :]) @ np.swapaxes(J * sigma[:, None, :], 1, 2)
    # central differences over 1.6e-6 rad: 1e-10 relative
    np.testing.assert_allclose(angle_covariance(angles, sigma), expected, rtol=1e-7, atol=1e-16)


def test_all_image_axes_are_right_handed():
    for rows in AXES.values():
        R = np.array(rows, float)
        np.testing.assert_array_equal(R @ R.T, np.eye(3))
        assert np.linalg.det(R) == 1.0


# ---------------------------------------------------------------- tables


def test_metashape_omega_phi_kappa_in_a_map_grid(tmp_path, truth):
    """Convergence -1.4 degrees and scale 0.9997 between the grid and wcs."""
    R_grid = grid_rotations(truth)
    assert np.rad2deg(np.linalg.norm(rotation_vector(R_grid[0] @ truth.R[0].T))) > 1.2
    matrix = np.swapaxes(R_grid @ FLIP, 1, 2).reshape(-1, 9)
    rows = np.column_stack([angles_deg(R_grid), matrix])
    head = f"# CoordinateSystem: {UTM33.to_wkt('WKT1_GDAL')}\n# Cameras (12)\n"
    head += "# PhotoID, X, Y, Z, Omega, Phi, Kappa, r11, r12, r13, r21, r22, r23, r31, r32, r33"
    names = [Path(name).stem for name in truth.images]
    path = tmp_path / "cameras.txt"
    path.write_text(angles_text(names, FRAME.to_map(truth.C, UTM33), rows, head))
    found = import_orientations([path], predictions(truth), settings())
    # convergence by PROJ's numerical derivatives: 1e-8 rad; the map and back: 1e-8 m
    assert_poses(found.poses, truth, atol_m=1e-7, atol=3e-8)
    assert found.camera is None
    np.testing.assert_array_equal(found.poses.t_gps_s, 1e9 + np.arange(12))


def test_true_north_is_an_option(tmp_path, truth):
    lat, lon, _ = FRAME.to_geodetic(truth.C)
    R_enu = np.swapaxes(FRAME.R_wcs_enu(lat, lon), 1, 2) @ truth.R
    path = tmp_path / "eo.csv"
    head = "image,easting,northing,height,omega,phi,kappa"
    path.write_text(angles_text(truth.images, FRAME.to_map(truth.C, UTM33), angles_deg(R_enu), head, ","))
    found = import_orientations([path], predictions(truth), settings(north="true"), crs="EPSG:25833")
    assert_poses(found.poses, truth, atol_m=1e-7)


def test_pix4d_in_geographic_coordinates(tmp_path, truth):
    lat, lon, h = FRAME.to_geodetic(truth.C)
    R_enu = np.swapaxes(FRAME.R_wcs_enu(lat, lon), 1, 2) @ truth.R
    path = tmp_path / "calibrated_external_camera_parameters.txt"
    names = [Path(name).name.lower() for name in truth.images]
    xyz = np.column_stack([lon, lat, h])
    path.write_text(angles_text(names, xyz, angles_deg(R_enu), "imageName X Y Z Omega Phi Kappa", " "))
    found = import_orientations([path], predictions(truth), settings(crs="EPSG:4326"))
    # degrees with 17 digits: 1e-9 m
    assert_poses(found.poses, truth, atol_m=5e-9)


@pytest.mark.parametrize("unit", ["deg", "gon", "rad"])
def test_units_by_the_header_and_by_the_setting(tmp_path, truth, unit):
    factor = {"deg": 1.0, "gon": 10 / 9, "rad": np.pi / 180}[unit]
    path = tmp_path / "eo.txt"
    rows = angles_deg(truth.R) * factor
    head = f"image;east_m;north_m;up_m;omega [{unit}];phi_{unit};kappa ({unit})"
    path.write_text(angles_text(truth.images, truth.C, rows, head, ";"))
    assert_poses(import_orientations([path], predictions(truth), settings()).poses, truth)
    path.write_text(angles_text(truth.images, truth.C, rows))
    found = import_orientations([path], predictions(truth), settings(crs="world", angle_unit=unit))
    assert_poses(found.poses, truth)


@pytest.mark.parametrize(
    ("head", "remark", "unit"),
    [
        ("omega (radians),phi (radians),kappa (radians)", "", "rad"),
        ("omega_radians,phi_radians,kappa_radians", "", "rad"),
        ("omega [grads],phi [grads],kappa [grads]", "", "gon"),
        ("omega,phi,kappa", "# rotation angles in gon\n", "gon"),
    ],
)
def test_units_in_other_words(tmp_path, truth, head, remark, unit):
    rows = angles_deg(truth.R) * {"gon": 10 / 9, "rad": np.pi / 180}[unit]
    path = tmp_path / "eo.csv"
    path.write_text(
        angles_text(truth.images, truth.C, rows, f"{remark}image,east_m,north_m,up_m,{head}", ",")
    )
    found = import_orientations([path], predictions(truth), settings())
    assert_poses(found.poses, truth)
    assert not any("no unit of the angles" in note for note in found.facts["notes"])


@pytest.mark.parametrize(
    ("head", "factor", "answer"),
    [
        ("omega (mrad),phi (mrad),kappa (mrad)", 1.0, r"the column omega \(mrad\); expected degrees, gon"),
        ("omega,phi,kappa,sigma_omega (arcsec),sigma_phi,sigma_kappa", 1.0, r"sigma_omega \(arcsec\)"),
        ("omega_gon,phi_gon,kappa_gon,sigma_omega_deg,sigma_phi_deg,sigma_kappa_deg", 1.0, "in another unit"),
        ("omega,phi,kappa", 4.0, r"angles up to \d+\.?\d* without a unit; expected degrees up to 360"),
    ],
)
def test_units_that_are_not_known_are_refused(tmp_path, truth, head, factor, answer):
    rows = np.column_stack([angles_deg(truth.R) * factor, np.full((12, head.count(",") - 2), 3.0)])
    path = tmp_path / "eo.csv"
    path.write_text(angles_text(truth.images, truth.C, rows, f"image,east_m,north_m,up_m,{head}", ","))
    with pytest.raises(InputError, match=answer):
        import_orientations([path], predictions(truth), settings())


def test_angles_without_a_unit_and_images_that_are_switched_off_are_told(tmp_path, truth):
    path = tmp_path / "eo.csv"
    rows = np.column_stack([angles_deg(truth.R), [1] * 11 + [0]])
    head = "image,east_m,north_m,up_m,omega,phi,kappa,Enable"
    path.write_text(angles_text(truth.images, truth.C, rows, head, ",").replace(",1.0\n", ",1\n"))
    path.write_text(path.read_text().replace(",0.0\n", ",0\n"))
    found = import_orientations([path], predictions(truth), settings())
    assert found.poses.reasons[11] == "switched off in the table"
    assert found.poses.oriented.tolist() == [True] * 11 + [False]
    assert any("states no unit of the angles: taken as degrees" in note for note in found.facts["notes"])


@pytest.mark.parametrize("axes", sorted(AXES))
@pytest.mark.parametrize("direction", ["image_to_world", "world_to_image"])
def test_other_axes_and_directions(tmp_path, truth, axes, direction):
    R_ccs_image = np.array(AXES[axes], float).T
    R = truth.R @ R_ccs_image
    R = np.swapaxes(R, 1, 2) if direction == "world_to_image" else R
    path = tmp_path / "eo.txt"
    path.write_text(angles_text(truth.images, truth.C, np.rad2deg([opk_of(M) for M in R])))
    found = import_orientations(
        [path], predictions(truth), settings(crs="world", axes=axes, direction=direction)
    )
    assert_poses(found.poses, truth)


@pytest.mark.parametrize("rotation", ["phi_omega_kappa", "kappa_phi_omega"])
def test_other_orders_of_the_rotations(tmp_path, truth, rotation):
    order = "".join({"omega": "X", "phi": "Y", "kappa": "Z"}[name] for name in rotation.split("_"))
    turns = Rotation.from_matrix(truth.R @ FLIP).as_euler(order, degrees=True)
    path = tmp_path / "eo.txt"
    path.write_text(angles_text(truth.images, truth.C, turns[:, [order.index(axis) for axis in "XYZ"]]))
    found = import_orientations([path], predictions(truth), settings(crs="world", rotation=rotation))
    assert_poses(found.poses, truth)


def test_sigmas_of_a_table_are_taken_over(tmp_path, truth):
    angles = angles_deg(truth.R)
    rows = np.column_stack([angles, np.tile([0.01, 0.02, 0.03, 0.004, 0.005, 0.006], (12, 1))])
    names = "sigma_x,sigma_y,sigma_z,sigma_omega,sigma_phi,sigma_kappa"
    path = tmp_path / "eo.csv"
    path.write_text(
        angles_text(truth.images, truth.C, rows, f"image,east_m,north_m,up_m,omega,phi,kappa,{names}", ",")
    )
    found = import_orientations([path], predictions(truth), settings(neighbour_correlation=0.5))
    cov = found.poses.cov_pose_wcs
    np.testing.assert_allclose(np.sqrt(np.diagonal(cov, axis1=1, axis2=2))[:, :3], [[0.01, 0.02, 0.03]] * 12)
    # volume of the rotation's covariance: the axes of omega and kappa are phi away from a right angle
    volume = np.deg2rad(0.004) * np.deg2rad(0.005) * np.deg2rad(0.006) * np.cos(np.deg2rad(angles[:, 1]))
    expected = volume**2
    np.testing.assert_allclose(np.linalg.det(cov[:, 3:, 3:]), expected, rtol=1e-6)
    assert found.facts["sigmas_from_settings"] == {"positions": 0, "rotations": 0}
    np.testing.assert_allclose(found.poses.cov_next[0, :3, :3], 0.5 * cov[0, :3, :3], rtol=1e-9)
    assert not found.poses.cov_next[-1].any()


def test_sigmas_of_the_settings_where_the_file_states_none(tmp_path, truth):
    path = tmp_path / "eo.csv"
    path.write_text(angles_text(truth.images, truth.C, angles_deg(truth.R)))
    chosen = settings(crs="world", sigma_position_m=0.03, sigma_angle_deg=0.1, neighbour_correlation=0.8)
    found = import_orientations([path], predictions(truth), chosen)
    expected = np.diag([0.03**2] * 3 + [np.deg2rad(0.1) ** 2] * 3)
    np.testing.assert_allclose(found.poses.cov_pose_wcs, np.tile(expected, (12, 1, 1)), rtol=1e-12, atol=0)
    np.testing.assert_allclose(found.poses.cov_next[:-1], np.tile(0.8 * expected, (11, 1, 1)), atol=1e-18)
    assert found.facts["sigmas_from_settings"] == {"positions": 12, "rotations": 12}


def test_a_table_in_feet_with_decimal_commas_and_windows_letters(tmp_path, truth):
    """The forms that every other table may have; the angles state gon, the coordinates feet."""
    rows = zip(truth.images, truth.C / 0.3048, angles_deg(truth.R) * 10 / 9, strict=True)
    text = "Image;X_ft;Y_ft;Z_ft;Omega [gon];Phi [gon];Kappa [gon];Gerät\r\n"
    for name, place, angles in rows:
        numbers = ";".join(repr(float(v)).replace(".", ",") for v in (*place, *angles))
        text += f"{name};{numbers};ü\r\n"
    path = tmp_path / "eo.txt"
    path.write_bytes(text.encode("cp1252"))
    found = import_orientations([path], predictions(truth), settings(crs="world"))
    assert_poses(found.poses, truth)
    assert any("Windows-1252" in note for note in found.facts["notes"])


def test_estimated_places_of_metashapes_reference_pane_are_taken(tmp_path, truth):
    """Its stated longitudes and angles are 1e-3 degrees off, the estimated ones are right."""
    lat, lon, h = FRAME.to_geodetic(truth.C)
    angles = angles_deg(np.swapaxes(FRAME.R_wcs_enu(lat, lon), 1, 2) @ truth.R)
    xyz = np.column_stack([lon, lat, h])
    head = "#Label,X/Longitude,Y/Latitude,Z/Altitude,Omega,Phi,Kappa,Accuracy_X/Y/Z_(m)"
    head += ",X_est,Y_est,Z_est,Omega_est,Phi_est,Kappa_est"
    rows = np.column_stack([angles + 1e-3, np.full(12, 0.05), xyz, angles])
    path = tmp_path / "reference.csv"
    path.write_text(angles_text(truth.images, xyz + 1e-3, rows, head, ","))
    found = import_orientations([path], predictions(truth), settings())
    # degrees with 17 digits: 1e-9 m
    assert_poses(found.poses, truth, atol_m=5e-9)


# ---------------------------------------------------------------- COLMAP


def test_colmap_text_and_binary_agree_with_pycolmap(tmp_path, truth):
    pycolmap = pytest.importorskip("pycolmap")
    folder = write_colmap_text(tmp_path / "text", truth.images, truth.C, truth.R, points=False)
    model = pycolmap.Reconstruction(str(folder))
    binary = tmp_path / "binary"
    binary.mkdir()
    model.write_binary(str(binary))
    oracle = {image.name: image for image in model.images.values()}
    for place in (folder, binary):
        found = read_model(place, "world")
        for k, name in enumerate(found.names):
            pose = oracle[name].cam_from_world()
            np.testing.assert_allclose(found.R_place_ccs[k].T, pose.rotation.matrix(), atol=EXACT)
            np.testing.assert_allclose(found.coordinates[k], oracle[name].projection_center(), atol=EXACT)
        rays = np.array([[0.2, -0.1, 1.0], [-0.4, 0.3, 1.0]])
        pixels = np.array([model.cameras[7].img_from_cam(ray) for ray in rays]).reshape(-1, 2)
        assert found.cameras[0] is not None
        np.testing.assert_allclose(found.cameras[0].project(rays), pixels, atol=1e-9)
        assert_poses(import_orientations([place], predictions(truth), settings(crs="world")).poses, truth)
    for number, name in ((4, "OPENCV"), (5, "OPENCV_FISHEYE"), (11, "RAD_TAN_THIN_PRISM_FISHEYE")):
        assert int(getattr(pycolmap.CameraModelId, name)) == number


def test_colmap_counts_tie_points_and_takes_any_of_its_files(tmp_path, truth):
    folder = write_colmap_text(tmp_path / "model", truth.images, truth.C, truth.R)
    files = [folder / "images.txt", folder / "cameras.txt", folder / "points3D.txt"]
    found = import_orientations(files, predictions(truth), settings(crs="world"))
    assert_poses(found.poses, truth)
    assert found.poses.n_marks.tolist() == [0, 2] * 6
    assert found.camera is not None
    assert found.camera.size_px == (720, 540)
    assert len(found.facts["files"]) == 1


def test_colmap_binary_with_points(tmp_path, truth):
    data = struct.pack("<Q", 1)
    data += struct.pack("<i7di", 3, 1.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 7) + b"a b.jpg\0"
    data += struct.pack("<Q", 2) + struct.pack("<ddQ", 1.0, 2.0, 5) + struct.pack("<ddQ", 1.0, 2.0, 2**64 - 1)
    (tmp_path / "images.bin").write_bytes(data)
    found = read_model(tmp_path, None)
    assert found.names == ("a b.jpg",)
    np.testing.assert_array_equal(found.coordinates, [[-1.0, -2.0, -3.0]])
    assert found.n_marks.tolist() == [1.0]
    for cut in (4, 20, 70, 80, len(data) - 10):
        (tmp_path / "images.bin").write_bytes(data[:cut])
        with pytest.raises(InputError, match=r"ends inside|no model"):
            read_model(tmp_path, None)
    (tmp_path / "images.bin").write_bytes(data + b"xx")
    with pytest.raises(InputError, match="2 bytes behind"):
        read_model(tmp_path, None)


# ---------------------------------------------------------------- own table


def test_own_poses_of_a_campaign_with_another_origin(tmp_path, truth):
    other = LocalFrame(lat_deg=51.06, lon_deg=13.23, h_ell_m=95.0)
    turn = other.R_ecef_enu.T @ FRAME.R_ecef_enu
    own = predictions(truth)
    following = np.tile(np.diag([4e-4, 3e-4, 2e-4, 1e-8, 2e-8, 3e-8]) * 0.3, (12, 1, 1))
    J = np.kron(np.eye(2), turn)
    values = {name: getattr(own, name) for name in own.__dataclass_fields__}
    moved = ImagePoses(
        **{
            **values,
            "frame": other,
            "centre_wcs_m": other.from_ecef(geocentric(truth)[0]),
            "R_wcs_ccs": turn @ truth.R,
            "cov_pose_wcs": J @ own.cov_pose_wcs @ J.T,
            "cov_next": J @ following @ J.T,
        }
    )
    moved.write(tmp_path / "image_poses.parquet")
    found = import_orientations([tmp_path / "image_poses.parquet"], own, settings())
    assert_poses(found.poses, truth, atol_m=1e-8)
    np.testing.assert_allclose(found.poses.cov_pose_wcs, own.cov_pose_wcs, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(found.poses.cov_next[:-1], following[:-1], rtol=1e-9, atol=1e-15)


def test_two_files_are_joined(tmp_path, truth):
    for k, part in enumerate((slice(0, 7), slice(7, 12))):
        path = tmp_path / f"{k}.txt"
        path.write_text(angles_text(truth.images[part], truth.C[part], angles_deg(truth.R[part])))
    files = [tmp_path / "0.txt", tmp_path / "1.txt"]
    found = import_orientations(files, predictions(truth), settings(crs="world"))
    assert_poses(found.poses, truth)
    # errors of two adjustments have nothing in common
    assert not found.poses.cov_next[6].any()
    assert found.poses.cov_next[5].any()
    with pytest.raises(InputError, match=r"has a pose in 0\.txt, too"):
        import_orientations(
            [files[0], write_colmap_text(tmp_path / "m", truth.images, truth.C, truth.R)],
            predictions(truth),
            settings(crs="world"),
        )
