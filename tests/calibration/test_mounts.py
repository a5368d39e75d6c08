"""The mounts of a campaign: its own values, or those of a calibration, in one file."""

import numpy as np
import pytest

from thalweg.calibration import read_mounts, resolve_mounts, write_mounts
from thalweg.core import ConfigError, GeometryError, InputError, Rigid, rotation_opk
from thalweg.core.calibration import Calibration, Source, lever_block, pose_block
from thalweg.settings.sections import Mounts


@pytest.fixture
def section():
    return Mounts().model_dump(mode="json")


def calibrated() -> tuple[Calibration, np.ndarray]:
    """A lidar at phi = -90 degrees whose rotation errs about every axis, and its covariance."""
    rng = np.random.default_rng(5)
    root = rng.normal(size=(6, 6)) * np.array([1e-3, 1e-3, 1e-3, 1e-4, 1e-4, 1e-4])[:, None]
    cov = root @ root.T
    true = Rigid(R=rotation_opk(0.0, -np.pi / 2, 0.0), shift_m=np.array([-0.35, 0, -0.25]), cov=cov)
    block, of_block = pose_block("lidar", true)
    source = Source(run="yard", method="cones")
    return Calibration(title="boat", blocks=(block,), cov=of_block, source=source), cov


def test_without_a_calibration_the_campaign_file_speaks(section):
    mounts = resolve_mounts(section, None)
    assert set(mounts) == {"lidar", "camera", "antenna", "echo_sounder"}
    assert all(mount["source"] == "campaign" for mount in mounts.values())


def test_a_calibration_replaces_what_it_holds_and_nothing_else(section):
    section["antenna"]["lever_ics_m"] = [0.1, 0.0, -0.45]
    mounts = resolve_mounts(section, calibrated()[0])
    assert mounts["lidar"]["source"] == "yard"
    assert mounts["lidar"]["lever_ics_m"] == pytest.approx((-0.35, 0.0, -0.25))
    assert mounts["antenna"]["source"] == "campaign"


def test_the_covariance_reaches_the_consumer_with_every_axis_and_correlation(section, tmp_path):
    # At phi = -90 degrees sigmas of omega, phi, kappa cannot describe an error about ics z.
    calibration, cov = calibrated()
    section["antenna"]["lever_ics_m"] = [0.1, 0.0, -0.45]
    write_mounts(tmp_path / "mounts.json", resolve_mounts(section, calibration))
    mount = Rigid.from_mount(read_mounts(tmp_path / "mounts.json")["lidar"])
    # 1e-9: numbers pass through degrees, sigmas and correlations as float64 text.
    np.testing.assert_allclose(mount.cov, cov, rtol=1e-9, atol=1e-18)


def test_a_calibration_without_sensors_is_refused(section):
    block = lever_block("target", [0.0, 0.0, 0.0])
    other = Calibration(
        title="a target", blocks=(block,), cov=np.eye(3) * 1e-6, source=Source(run="yard", method="ruler")
    )
    with pytest.raises(ConfigError, match=r"'a target' holds the blocks target, and the campaign states no"):
        resolve_mounts(section, other)


def test_a_sensor_that_nobody_places_is_refused(section):
    # A lidar at the origin with the default sigmas would be a plausible and wrong cloud.
    with pytest.raises(ConfigError, match="states no place of the antenna"):
        resolve_mounts(section, calibrated()[0])


def test_a_pose_the_other_way_round_is_refused(section):
    true = calibrated()[0].pose("lidar")
    block, cov = pose_block("lidar", true.inverse(), target="scs", source="ics")
    turned = Calibration(title="boat", blocks=(block,), cov=cov, source=Source(run="yard", method="cones"))
    with pytest.raises(GeometryError, match=r"block 'lidar' is x_scs = R_scs_ics @ x_ics"):
        resolve_mounts(section, turned)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, "file not found"),
        ("{", "no JSON"),
        ('{"kind": "thalweg mounts", "version": 9, "mounts": {}}', "version 9; expected thalweg mounts"),
        ('{"kind": "thalweg mounts"}', "no mounts"),
    ],
)
def test_bad_files_are_named(tmp_path, text, message):
    path = tmp_path / "mounts.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_mounts(path)
    assert "collect_mounts" in str(caught.value)
