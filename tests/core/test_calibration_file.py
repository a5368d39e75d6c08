"""Calibration files: nothing is lost on the way to a file and back; every mistake is named with its line."""

import re

import numpy as np
import pytest

from thalweg.core import ConfigError, GeometryError, Rigid, opk_axes, rotation_opk
from thalweg.core.calibration import (
    POSE,
    Block,
    Calibration,
    Source,
    lever_block,
    pose_block,
    read_calibration,
    unit_of,
    write_calibration,
)
from thalweg.core.calibration.model import calibration_text, lever_doubt
from thalweg.settings.sections.mounts import LidarMount

SOURCE = Source(
    run="field",
    method="cones, moving boat",
    created="2026-05-01T10:00:00Z",
    observations=81_234,
    sigma0=1.02,
    twin=True,
)


def random_cov(rng, sigma):
    a = rng.normal(size=(len(sigma), 2 * len(sigma)))
    cov = a @ a.T / (2 * len(sigma))
    return cov * np.outer(sigma, sigma)


def make_pose(rng, angles_deg=(0.06, -90.2, 0.17)):
    sigma = np.array([5e-4, 2e-4, 1e-4, 3e-4, 1.6e-4, 7e-5])
    R = rotation_opk(*np.deg2rad(angles_deg))
    return Rigid(R=R, shift_m=np.array([-0.35, 0.001, -0.25]), cov=random_cov(rng, sigma))


@pytest.fixture
def boat(rng):
    """Lidar and antenna with one joint covariance, and the clock of a camera."""
    lidar, cov = pose_block("lidar", make_pose(rng))
    antenna = lever_block("antenna", [0.1, 0.0, -0.45])
    clock = Block(
        name="camera_clock",
        quantities=("offset_s", "drift_ppm"),
        values=np.array([0.123456789012345, -3.5]),
        equation="t_gps_s = t_camera_s + offset_s + 1e-6 drift_ppm (t_camera_s - reference_s)",
        facts={"reference_s": 178_649_913.4, "camera": "left: port", "images": 512, "triggered": False},
    )
    sigma = np.concatenate([np.sqrt(np.diag(cov)), [1e-3, 1e-3, 2e-3], [4e-3, 0.0]])
    joint = random_cov(rng, sigma)
    return Calibration(title="Boat: port", blocks=(lidar, antenna, clock), cov=joint, source=SOURCE)


def test_a_file_gives_back_what_was_written(boat, tmp_path):
    path = tmp_path / "boat.yaml"
    write_calibration(path, boat)
    back = read_calibration(path)
    assert back.labels == boat.labels
    assert np.array_equal(back.values, boat.values)
    scale = np.outer(boat.sigmas, boat.sigmas)
    # sigmas and correlations have 12 digits: 1e-11 of the product of the sigmas
    assert np.all(np.abs(back.cov - boat.cov) <= 1e-11 * scale)
    assert back.source == boat.source
    assert back.title == boat.title
    assert [b.facts for b in back.blocks] == [b.facts for b in boat.blocks]
    assert [b.equation for b in back.blocks] == [b.equation for b in boat.blocks]
    # writing what was read gives the same bytes but for the last digits of correlations
    assert calibration_text(read_calibration(path)) == calibration_text(back)


@pytest.mark.parametrize("phi_deg", [0.0, 35.0, -90.0, -90.3, -89.99999, 90.0, 179.0])
@pytest.mark.parametrize("kappa_deg", [0.0, 0.4, -170.0])
def test_a_pose_survives_whatever_its_angles(rng, tmp_path, phi_deg, kappa_deg):
    """At phi = -90 degrees, the nominal mount, omega and kappa are one; the covariance must not notice."""
    pose = make_pose(rng, (0.3, phi_deg, kappa_deg))
    block, cov = pose_block("lidar", pose)
    path = tmp_path / "lidar.yaml"
    write_calibration(path, Calibration(title="x", blocks=(block,), cov=cov, source=SOURCE))
    back = read_calibration(path).pose("lidar")
    # near +-90 degrees omega and kappa share 1e-16 / cos(phi): 1e-9 rad at 1e-5 degrees from it
    assert np.abs(back.R - pose.R).max() < 1e-8
    assert np.array_equal(back.shift_m, pose.shift_m)
    sigma = np.sqrt(np.diag(pose.cov))
    assert np.abs((back.cov - pose.cov) / np.outer(sigma, sigma)).max() < 1e-10


def test_angles_are_those_that_people_expect(rng):
    """-90.2 degrees shall not become -89.8 with half turns about x and z."""
    block, _ = pose_block("lidar", make_pose(rng, (0.06, -90.2, 0.17)))
    assert block.values[:3] == pytest.approx([0.06, -90.2, 0.17], abs=1e-9)


def test_mounts_are_those_of_a_campaign(rng, boat):
    section = boat.to_mounts()
    assert set(section) == {"lidar", "antenna"}
    lidar = LidarMount.model_validate(section["lidar"])
    mount = Rigid.from_mount(lidar.model_dump())
    pose = boat.pose("lidar")
    sigma = np.sqrt(np.diag(mount.cov))
    assert np.abs(mount.R - pose.R).max() < 1e-15
    # float64
    assert np.abs((mount.cov - pose.cov) / np.outer(sigma, sigma)).max() < 1e-12
    assert section["antenna"]["sigma_lever_m"] == pytest.approx(boat.sigmas[6:9])
    rho = np.array(section["antenna"]["correlation"])
    assert rho == pytest.approx(boat.correlation()[6:9, 6:9])


def test_sigmas_of_the_angles_themselves_are_converted(rng, tmp_path):
    values = np.array([2.0, 35.0, -20.0, 0.1, 0.2, 0.3])
    cov = random_cov(rng, np.array([0.01, 0.02, 0.03, 1e-3, 2e-3, 3e-3]))
    block = Block(name="camera", quantities=POSE, values=values, equation="x_ics = R x_ccs + (x, y, z)")
    path = tmp_path / "camera.yaml"
    write_calibration(path, Calibration(title="x", blocks=(block,), cov=cov, source=SOURCE))
    path.write_text(path.read_text().replace("sigma_axes: ics", "sigma_axes: angles"))
    found = read_calibration(path).pose("camera").cov
    J = np.eye(6)
    J[:3, :3] = opk_axes(*np.deg2rad(values[:2]))
    expected = J @ cov @ J.T
    assert found[:3, :3] == pytest.approx(expected[3:, 3:], rel=1e-9)
    assert found[3:, 3:] == pytest.approx(expected[:3, :3] * np.deg2rad(1.0) ** 2, rel=1e-9)


def test_joint_picks_blocks_and_quantities(boat):
    values, cov = boat.joint(["antenna", "lidar.x_m"])
    at = [boat.labels.index(f"antenna.{axis}_m") for axis in "xyz"] + [boat.labels.index("lidar.x_m")]
    assert np.array_equal(values, boat.values[at])
    assert np.array_equal(cov, boat.cov[np.ix_(at, at)])
    assert cov[0, 3] != 0.0  # lidar and antenna are correlated
    with pytest.raises(GeometryError, match=r"no block 'sonar'.*expected one of lidar, antenna"):
        boat.block("sonar")
    with pytest.raises(GeometryError, match=r"no quantity lidar\.q"):
        boat.joint(["lidar.q"])
    with pytest.raises(GeometryError, match="is no pose"):
        boat.pose("antenna")


def test_parts_are_merged_without_correlation(boat):
    echo = Calibration(
        title="e", blocks=(lever_block("echo_sounder", [0, 0, 0.2]),), cov=np.eye(3) * 25e-6, source=SOURCE
    )
    both = Calibration.merged([boat, echo], title="both", source=SOURCE)
    assert both.labels == boat.labels + echo.labels
    assert np.array_equal(both.cov[:11, :11], boat.cov)
    assert not both.cov[:11, 11:].any()
    with pytest.raises(GeometryError, match="each once"):
        Calibration.merged([boat, boat], title="both", source=SOURCE)


def test_other_readers_of_yaml_see_the_same_numbers(boat):
    import yaml

    data = yaml.safe_load(calibration_text(boat))
    entries = data["blocks"]["lidar"]["values"]
    assert all(isinstance(entry["sigma"], float) for entry in entries.values())
    assert entries["x_m"] == {"value": -0.35, "sigma": pytest.approx(boat.sigmas[3]), "unit": "m"}


def test_units_come_from_names():
    assert [unit_of(n) for n in ("x_m", "offset_s", "k1", "cx", "drift_ppm")] == ["m", "s", "1", "px", "ppm"]


MISTAKES = [
    (r"sigma: ([\d.e-]+), unit: deg", r"sigma: -\1, unit: deg", "omega_deg.sigma: found -", "at least 0"),
    (r"unit: deg", "unit: rad", "found unit rad; expected unit deg", "do not only rename"),
    (r"unit: m\b", "unit: mm", "found unit mm; expected unit m", "Convert value and sigma"),
    (r"value: -0\.35\b", "value: .nan", "x_m.value: found nan", "a finite number"),
    (r"value: -0\.35\b", "value: 35 cm", "x_m.value: found '35 cm'", "a number"),
    (r"sigma: [\d.e-]+, unit: m}", "unit: m}", "x_m: sigma is missing", "a number of at least 0"),
    (r"    equation: .*x_scs.*\n", "", "equation is missing", "the key equation"),
    (r"equation: .*x_scs.*", "equation: from the yard", "names no target frame", "x_ics ="),
    (r"    sigma_axes: ics\n", "", "sigma_axes is missing", "angles, if they are those of omega"),
    (r"sigma_axes: ics", "sigma_axes: scs", "found 'scs'", "about the axes of ics"),
    (r"      phi_deg: .*\n", "", "a pose with the quantities", "omega_deg, phi_deg, kappa_deg"),
    (r"calibration: 1", "calibration: 7", "found version 7; expected version 1", "Make the file"),
    (r"thalweg_calibration: 1\n", "", "thalweg_calibration is missing", "the line `thalweg_calibration: 1`"),
    (r"    lidar\.omega_deg: -?[\d.]+", "    lidar.omega_deg: 1.2", "found 1.2", "from -1 to 1"),
    (r"    lidar\.omega_deg:", "    lidar.omgea_deg:", "unknown quantity lidar.omgea", "lidar.omega_deg?"),
    (
        r"correlations:\n",
        "correlations:\n  lidar.omega_deg:\n    lidar.phi_deg: 0.9\n",
        "the other way round",
        "symmetric",
    ),
    (r"lidar\.x_m:\n", "lidar.x_m:\n    lidar.x_m: 1.0\n", "a quantity with itself", "two"),
    (
        r"correlations:\n",
        "correlations:\n  camera_clock.drift_ppm:\n    lidar.x_m: 0.1\n",
        "whose sigma is 0",
        "zero, or a sigma",
    ),
    (r"\n  run: field", "\n  runn: field", "unknown key", "Did you mean run?"),
    (r"observations: 81234", "observations: many", "found 'many'", "a number of observations"),
    (
        r"value: -0\.35\b",
        "value: -350.0",
        "lidar.values.x_m: a lever arm of (-350,",
        "Are these millimetres? Then write (-0.35,",
    ),
    (r"value: -0\.35\b", "value: -35.0", "a lever arm of (-35,", "(-0.35, 1e-05, -0.0025) if centimetres"),
    (r"values:\n      offset_s", "sigma_axes: ics\n    values:\n      offset_s", "without angles", "no such"),
]


@pytest.mark.parametrize(("pattern", "to", "found", "more"), MISTAKES)
def test_a_mistake_is_named_with_its_line(boat, tmp_path, pattern, to, found, more):
    text = calibration_text(boat)
    wrong, n = re.subn(pattern, to, text, count=1)
    assert n == 1
    path = tmp_path / "boat.yaml"
    path.write_text(wrong)
    with pytest.raises(ConfigError) as error:
        read_calibration(path)
    message = str(error.value)
    assert found in message
    assert more in message
    line = max(int(x) for x in re.findall(r"line (\d+):", message))
    first = next(
        i for i, (a, b) in enumerate(zip(text.split("\n"), wrong.split("\n"), strict=False)) if a != b
    )
    # a missing key is told at the section that lacks it, a pair that stands twice at the second place
    assert abs(line - (first + 1)) <= 4


def test_all_mistakes_are_told_at_once(boat, tmp_path):
    path = tmp_path / "boat.yaml"
    text = calibration_text(boat).replace("unit: s}", "unit: ms}").replace("unit: ppm", "unit: s/day")
    path.write_text(text.replace("method:", "metod:"))
    with pytest.raises(ConfigError) as error:
        read_calibration(path)
    # two units, an unknown key and a missing one
    assert "4 mistakes in the calibration" in str(error.value)


def test_impossible_correlations_are_refused_by_name(tmp_path):
    antenna = lever_block("antenna", [0, 0, 0])
    text = calibration_text(Calibration(title="x", blocks=(antenna,), cov=np.eye(3) * 1e-6, source=SOURCE))
    text += (
        "correlations:\n  antenna.y_m: {antenna.x_m: 0.9}\n"
        "  antenna.z_m: {antenna.x_m: 0.9, antenna.y_m: -0.9}\n"
    )
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"eigenvalue -0\.8; look at antenna\.") as error:
        read_calibration(path)
    assert "line 20: correlations" in str(error.value)


def test_a_covariance_that_is_none_is_refused():
    antenna = lever_block("antenna", [0, 0, 0])
    for cov in (np.diag([1.0, 1.0, -1.0]), np.triu(np.ones((3, 3))), np.full((3, 3), np.nan), np.eye(2)):
        with pytest.raises(GeometryError):
            Calibration(title="x", blocks=(antenna,), cov=cov, source=SOURCE)
    with pytest.raises(GeometryError, match="a quantity stands twice"):
        Block(name="a", quantities=("x_m", "x_m"), values=np.zeros(2), equation="x")
    with pytest.raises(GeometryError, match="no equation"):
        Block(name="a", quantities=("x_m",), values=np.zeros(1), equation=" ")


def test_files_that_are_no_calibration(tmp_path):
    for text, found in (
        ("", "nothing stands here"),
        ("- 1\n", "no keys with values; expected a calibration that begins"),
        ("a: [1\n", "Close the bracket"),
    ):
        path = tmp_path / "x.yaml"
        path.write_text(text)
        with pytest.raises(ConfigError, match=found):
            read_calibration(path)
    with pytest.raises(ConfigError, match="no such file"):
        read_calibration(tmp_path / "none.yaml")


@pytest.mark.parametrize(
    ("lever_m", "cure"),
    [
        ([20.0, -20.0, 0.0], None),
        ([], None),
        ([-20.1, 2.0, 0.0], "(-0.0201, 0.002, 0), or (-0.201, 0.02, 0) if centimetres, and the sigmas"),
        ([0.0, 99.9, 0.0], "(0, 0.0999, 0), or (0, 0.999, 0) if centimetres, and the sigmas"),
        ([0.0, 1.0, 100.0], "(0, 0.001, 0.1), and the sigmas"),
    ],
)
def test_lever_arms_too_long_for_metres(lever_m, cure):
    doubt = lever_doubt(lever_m)
    assert (doubt is None) == (cure is None)
    if doubt is not None:
        assert doubt[1] == "components up to 20 m"
        assert doubt[2] == f"Are these millimetres? Then write {cure} in metres, too"
