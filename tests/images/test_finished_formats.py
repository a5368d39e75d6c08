"""Poses from tables of angles and models of COLMAP, written by hand from known ones and read back."""

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.images.finished_scene import (
    EXACT,
    FLIP,
    FRAME,
    TRUTH,
    UTM33,
    Scene,
    angles_deg,
    assert_poses,
    geocentric,
    geodetic,
    imported,
    in_grid,
    predictions,
    table,
    write_colmap_text,
)
from thalweg.core import InputError, LocalFrame, opk_of, rotation_vector
from thalweg.images.imports.poses import _MODELS, read_model
from thalweg.images.imports.source import AXES, ORDERS, Angles, angle_covariance, ccs_rotations

# ---------------------------------------------------------------- angles


def angles_of(values: np.ndarray, unit: str = "deg", **how: str) -> Angles:
    """Angles in the usual order and direction, of the usual axes, but for what is said."""
    usual = {"rotation": "omega_phi_kappa", "direction": "image_to_world", "axes": "right_up_back"}
    return Angles(values=values, unit=unit, **usual | how)


def test_the_published_example_of_pix4d():
    """Angles and matrix of one image in Pix4D's two files, as a user printed them in its forum (topic 19555).

    ``calibrated_camera_parameters.txt`` holds the world-to-camera matrix of the axes right, down, forward.
    """
    R = ccs_rotations(angles_of(np.array([[91.277233, -45.714811, 0.991059]])))[0]
    R_ccs_world = [
        [6.9608e-01, -7.1796e-01, 7.4567e-04],
        [1.0111e-02, 8.7643e-03, -9.9991e-01],
        [7.1789e-01, 6.9603e-01, 1.3360e-02],
    ]
    # its angles and its matrix are 0.2 degrees apart
    np.testing.assert_allclose(R.T, R_ccs_world, atol=5e-3)


def test_a_camera_that_looks_down_with_its_top_to_the_north_has_no_angles():
    np.testing.assert_array_equal(ccs_rotations(angles_of(np.zeros((1, 3))))[0], np.diag([1.0, -1.0, -1.0]))


@pytest.mark.parametrize("direction", ["image_to_world", "world_to_image"])
@pytest.mark.parametrize("rotation", sorted(ORDERS))
def test_sigmas_of_angles_become_those_of_the_rotation_vector(rotation, direction):
    values = np.array([[97.0, -33.0, 12.0], [-10.0, 5.0, 170.0]])
    sigma = np.array([[0.03, 0.05, 0.02], [0.01, 0.02, 0.04]])
    how = {"unit": "gon", "rotation": rotation, "direction": direction}
    J = np.empty((2, 3, 3))
    for k, step in enumerate(1e-4 * np.eye(3)):
        plus, minus = (ccs_rotations(angles_of(values + s * step, **how)) for s in (1, -1))
        J[:, :, k] = rotation_vector(plus @ np.swapaxes(minus, 1, 2)) / 2e-4
    J *= sigma[:, None, :]
    # central differences over 1.6e-6 rad: 1e-10 relative
    found = angle_covariance(angles_of(values, **how), sigma)
    np.testing.assert_allclose(found, J @ np.swapaxes(J, 1, 2), rtol=1e-7, atol=1e-16)


def test_all_image_axes_are_right_handed():
    for rows in AXES.values():
        R = np.array(rows, float)
        np.testing.assert_array_equal(R @ R.T, np.eye(3))
        assert np.linalg.det(R) == 1.0


# ---------------------------------------------------------------- tables


def test_metashape_omega_phi_kappa_in_a_map_grid(tmp_path):
    """Convergence -1.4 degrees and scale 0.9997 between the grid and wcs."""
    grid = in_grid()
    assert np.rad2deg(np.linalg.norm(rotation_vector(grid.R[0] @ TRUTH.R[0].T))) > 1.2
    matrix = np.swapaxes(grid.R @ FLIP, 1, 2).reshape(-1, 9)
    rows = np.column_stack([angles_deg(grid.R), matrix])
    head = f"# CoordinateSystem: {UTM33.to_wkt('WKT1_GDAL')}\n# Cameras (12)\n"
    head += "# PhotoID, X, Y, Z, Omega, Phi, Kappa, r11, r12, r13, r21, r22, r23, r31, r32, r33"
    names = [Path(name).stem for name in TRUTH.images]
    path = table(tmp_path / "cameras.txt", angles=rows, head=head, of=grid, names=names)
    found = imported(path, crs=None)
    # convergence by PROJ's numerical derivatives: 1e-8 rad; the map and back: 1e-8 m
    assert_poses(found, atol_m=1e-7, atol=3e-8)
    assert found.camera is None
    np.testing.assert_array_equal(found.poses.t_gps_s, 1e9 + np.arange(12))


def test_true_north_is_an_option(tmp_path):
    head = "image,easting,northing,height,omega,phi,kappa"
    path = table(tmp_path / "eo.csv", in_grid().C, angles_deg(geodetic()[1]), head, ",")
    assert_poses(imported(path, campaign="EPSG:25833", crs=None, north="true"), atol_m=1e-7)


def test_pix4d_in_geographic_coordinates(tmp_path):
    names = [Path(name).name.lower() for name in TRUTH.images]
    head = "imageName X Y Z Omega Phi Kappa"
    path = table(tmp_path / "external.txt", head=head, separator=" ", of=Scene((), *geodetic()), names=names)
    # degrees with 17 digits: 1e-9 m
    found = imported(path, crs="EPSG:4326")
    assert_poses(found, atol_m=5e-9)
    assert "angles are taken from true north" in " ".join(found.facts["notes"])


@pytest.mark.parametrize("unit", ["deg", "gon", "rad"])
def test_units_by_the_header_and_by_the_setting(tmp_path, unit):
    factor = {"deg": 1.0, "gon": 10 / 9, "rad": np.pi / 180}[unit]
    rows = angles_deg(TRUTH.R) * factor
    head = f"image;east_m;north_m;up_m;omega [{unit}];phi_{unit};kappa ({unit})"
    path = table(tmp_path / "eo.txt", angles=rows, head=head, separator=";")
    assert_poses(imported(path, crs=None))
    assert_poses(imported(table(path, angles=rows), angle_unit=unit))


@pytest.mark.parametrize(
    ("head", "remark", "unit"),
    [
        ("omega (radians),phi (radians),kappa (radians)", "", "rad"),
        ("omega_radians,phi_radians,kappa_radians", "", "rad"),
        ("omega [grads],phi [grads],kappa [grads]", "", "gon"),
        ("omega,phi,kappa", "# rotation angles in gon\n", "gon"),
    ],
)
def test_units_in_other_words(tmp_path, head, remark, unit):
    rows = angles_deg(TRUTH.R) * {"gon": 10 / 9, "rad": np.pi / 180}[unit]
    path = table(
        tmp_path / "eo.csv", angles=rows, head=f"{remark}image,east_m,north_m,up_m,{head}", separator=","
    )
    found = imported(path, crs=None)
    assert_poses(found)
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
def test_units_that_are_not_known_are_refused(tmp_path, head, factor, answer):
    rows = np.column_stack([angles_deg(TRUTH.R) * factor, np.full((12, head.count(",") - 2), 3.0)])
    path = table(tmp_path / "eo.csv", angles=rows, head=f"image,east_m,north_m,up_m,{head}", separator=",")
    with pytest.raises(InputError, match=answer):
        imported(path, crs=None)


def test_angles_without_a_unit_and_images_that_are_switched_off_are_told(tmp_path):
    rows = np.column_stack([angles_deg(TRUTH.R), [1] * 11 + [0]])
    head = "image,east_m,north_m,up_m,omega,phi,kappa,Enable"
    path = table(tmp_path / "eo.csv", angles=rows, head=head, separator=",")
    path.write_text(path.read_text().replace(",1.0\n", ",1\n").replace(",0.0\n", ",0\n"))
    found = imported(path, crs=None)
    assert found.poses.reasons[11] == "switched off in the table"
    assert found.poses.oriented.tolist() == [True] * 11 + [False]
    assert any("states no unit of the angles: taken as degrees" in note for note in found.facts["notes"])


@pytest.mark.parametrize("axes", sorted(AXES))
@pytest.mark.parametrize("direction", ["image_to_world", "world_to_image"])
def test_other_axes_and_directions(tmp_path, axes, direction):
    R = TRUTH.R @ np.array(AXES[axes], float).T
    R = np.swapaxes(R, 1, 2) if direction == "world_to_image" else R
    path = table(tmp_path / "eo.txt", angles=np.rad2deg([opk_of(M) for M in R]))
    assert_poses(imported(path, axes=axes, direction=direction))


@pytest.mark.parametrize("rotation", ["phi_omega_kappa", "kappa_phi_omega"])
def test_other_orders_of_the_rotations(tmp_path, rotation):
    order = "".join({"omega": "X", "phi": "Y", "kappa": "Z"}[name] for name in rotation.split("_"))
    turns = Rotation.from_matrix(TRUTH.R @ FLIP).as_euler(order, degrees=True)
    path = table(tmp_path / "eo.txt", angles=turns[:, [order.index(axis) for axis in "XYZ"]])
    assert_poses(imported(path, rotation=rotation))


def test_sigmas_of_a_table_are_taken_over(tmp_path):
    angles = angles_deg(TRUTH.R)
    rows = np.column_stack([angles, np.tile([0.01, 0.02, 0.03, 0.004, 0.005, 0.006], (12, 1))])
    names = "sigma_x,sigma_y,sigma_z,sigma_omega,sigma_phi,sigma_kappa"
    path = table(
        tmp_path / "eo.csv",
        angles=rows,
        head=f"image,east_m,north_m,up_m,omega,phi,kappa,{names}",
        separator=",",
    )
    found = imported(path, crs=None, neighbour_correlation=0.5)
    cov = found.poses.cov_pose_wcs
    np.testing.assert_allclose(np.sqrt(np.diagonal(cov, axis1=1, axis2=2))[:, :3], [[0.01, 0.02, 0.03]] * 12)
    # volume of the rotation's covariance: the axes of omega and kappa are phi away from a right angle
    volume = np.deg2rad([0.004, 0.005, 0.006]).prod() * np.cos(np.deg2rad(angles[:, 1]))
    np.testing.assert_allclose(np.linalg.det(cov[:, 3:, 3:]), volume**2, rtol=1e-6)
    assert found.facts["sigmas_from_settings"] == {"positions": 0, "rotations": 0}
    np.testing.assert_allclose(found.poses.cov_next[0, :3, :3], 0.5 * cov[0, :3, :3], rtol=1e-9)
    assert not found.poses.cov_next[-1].any()


def test_sigmas_of_the_settings_where_the_file_states_none(tmp_path):
    path = table(tmp_path / "eo.csv", angles=angles_deg(TRUTH.R))
    found = imported(path, sigma_position_m=0.03, sigma_angle_deg=0.1, neighbour_correlation=0.8)
    expected = np.diag([0.03**2] * 3 + [np.deg2rad(0.1) ** 2] * 3)
    np.testing.assert_allclose(found.poses.cov_pose_wcs, np.tile(expected, (12, 1, 1)), rtol=1e-12, atol=0)
    np.testing.assert_allclose(found.poses.cov_next[:-1], np.tile(0.8 * expected, (11, 1, 1)), atol=1e-18)
    assert found.facts["sigmas_from_settings"] == {"positions": 12, "rotations": 12}


def test_a_table_in_feet_with_decimal_commas_and_windows_letters(tmp_path):
    """The forms that every other table may have; the angles state gon, the coordinates feet."""
    rows = zip(TRUTH.images, TRUTH.C / 0.3048, angles_deg(TRUTH.R) * 10 / 9, strict=True)
    text = "Image;X_ft;Y_ft;Z_ft;Omega [gon];Phi [gon];Kappa [gon];Gerät\r\n"
    for name, place, angles in rows:
        numbers = ";".join(repr(float(v)).replace(".", ",") for v in (*place, *angles))
        text += f"{name};{numbers};ü\r\n"
    path = tmp_path / "eo.txt"
    path.write_bytes(text.encode("cp1252"))
    found = imported(path)
    assert_poses(found)
    assert any("Windows-1252" in note for note in found.facts["notes"])


def test_estimated_places_of_metashapes_reference_pane_are_taken(tmp_path):
    """Its stated longitudes and angles are 1e-3 degrees off, the estimated ones are right."""
    xyz, R_enu_ccs = geodetic()
    angles = angles_deg(R_enu_ccs)
    head = "#Label,X/Longitude,Y/Latitude,Z/Altitude,Omega,Phi,Kappa,Accuracy_X/Y/Z_(m)"
    head += ",X_est,Y_est,Z_est,Omega_est,Phi_est,Kappa_est"
    rows = np.column_stack([angles + 1e-3, np.full(12, 0.05), xyz, angles])
    path = table(tmp_path / "reference.csv", xyz + 1e-3, rows, head, ",")
    # degrees with 17 digits: 1e-9 m
    assert_poses(imported(path, crs=None), atol_m=5e-9)


# ---------------------------------------------------------------- COLMAP


def test_colmap_text_and_binary_agree_with_pycolmap(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    folder = write_colmap_text(tmp_path / "text", points=False)
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
        np.testing.assert_allclose(found.cameras[0].project(rays), pixels, atol=1e-9)
        assert_poses(imported(place))
    assert [int(getattr(pycolmap.CameraModelId, name)) for name in _MODELS] == list(range(len(_MODELS)))


def test_colmap_counts_tie_points_and_takes_any_of_its_files(tmp_path):
    folder = write_colmap_text(tmp_path / "model")
    found = imported(*(folder / f"{name}.txt" for name in ("images", "cameras", "points3D")))
    assert_poses(found)
    assert found.poses.n_marks.tolist() == [0, 2] * 6
    assert found.camera.size_px == (720, 540)
    assert len(found.facts["files"]) == 1


def test_colmap_binary_with_points(tmp_path):
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


def test_own_poses_of_a_campaign_with_another_origin(tmp_path):
    other = LocalFrame(lat_deg=51.06, lon_deg=13.23, h_ell_m=95.0)
    turn = other.R_ecef_enu.T @ FRAME.R_ecef_enu
    own = predictions()
    following = np.tile(np.diag([4e-4, 3e-4, 2e-4, 1e-8, 2e-8, 3e-8]) * 0.3, (12, 1, 1))
    J = np.kron(np.eye(2), turn)
    moved = replace(
        own,
        frame=other,
        centre_wcs_m=other.from_ecef(geocentric().C),
        R_wcs_ccs=turn @ TRUTH.R,
        cov_pose_wcs=J @ own.cov_pose_wcs @ J.T,
        cov_next=J @ following @ J.T,
    )
    moved.write(tmp_path / "image_poses.parquet")
    found = imported(tmp_path / "image_poses.parquet", given=own, crs=None)
    assert_poses(found, atol_m=1e-8)
    np.testing.assert_allclose(found.poses.cov_pose_wcs, own.cov_pose_wcs, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(found.poses.cov_next[:-1], following[:-1], rtol=1e-9, atol=1e-15)


def test_two_files_are_joined(tmp_path):
    files = [
        table(tmp_path / f"{k}.txt", of=Scene(TRUTH.images[part], TRUTH.C[part], TRUTH.R[part]))
        for k, part in enumerate((slice(0, 7), slice(7, 12)))
    ]
    found = imported(*files)
    assert_poses(found)
    # errors of two adjustments have nothing in common
    assert not found.poses.cov_next[6].any()
    assert found.poses.cov_next[5].any()
    with pytest.raises(InputError, match=r"has a pose in 0\.txt, too"):
        imported(files[0], write_colmap_text(tmp_path / "m"))
