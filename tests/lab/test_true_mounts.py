"""True mounts lie around the campaign's with the stated sigmas, and nothing else changes."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

from thalweg.core import InputError
from thalweg.settings.sections import Mounts
from thalweg_lab.voyage import read_true_mounts, true_mounts, write_true_mounts
from thalweg_lab.voyage.truth import mount_errors

SEEDS = 400


def campaign(**lidar):
    """Mounts as a campaign file gives them, with sigmas that differ from each other."""
    mounts = Mounts().model_dump(mode="json", exclude={"calibration"})
    mounts["lidar"] |= {"lever_ics_m": [-0.35, 0.0, -0.25], **lidar}
    mounts["antenna"] |= {"lever_ics_m": [0.1, 0.0, -0.45], "sigma_lever_m": [0.002, 0.003, 0.004]}
    return mounts


def drawn(mounts, sensor):
    """Errors over the seeds, angles in degrees first."""
    rows = []
    for seed in range(SEEDS):
        error = mount_errors(true_mounts(mounts, seed, on=True), mounts)[sensor]
        angles = [error[key] for key in ("omega_deg", "phi_deg", "kappa_deg") if key in error]
        rows.append([*angles, *error["lever_ics_m"]])
    return np.array(rows)


def test_errors_have_the_stated_sigmas_two_sided():
    lidar = drawn(campaign(), "lidar")
    sigmas = np.array([0.018, 0.009, 0.004, 0.0005, 0.0002, 0.0001])
    # 400 seeds: a sigma is known to 3.5 %, a mean to sigma / 20; four times that.
    assert_allclose(lidar.std(axis=0), sigmas, rtol=0.14)
    assert (np.abs(lidar.mean(axis=0)) < 4 * sigmas / 20).all()
    # Uncorrelated without a matrix: a correlation is known to 0.05.
    assert np.abs(np.corrcoef(lidar.T) - np.eye(6)).max() < 0.21
    assert_allclose(drawn(campaign(), "antenna").std(axis=0), [0.002, 0.003, 0.004], rtol=0.14)


def test_correlations_of_the_calibration_are_kept():
    C = np.eye(6)
    C[0, 2] = C[2, 0] = -0.95
    C[1, 3] = C[3, 1] = 0.7
    found = np.corrcoef(drawn(campaign(correlation=C.tolist()), "lidar").T)
    # sigma of a correlation of 0 over 400 seeds: 0.05, less for the others.
    assert_allclose(found, C, atol=0.21)
    fully = np.eye(6)
    fully[0, 2] = fully[2, 0] = 1.0
    errors = drawn(campaign(correlation=fully.tolist()), "lidar")
    assert_allclose(errors[:, 0] / 0.018, errors[:, 2] / 0.004, atol=1e-6)


def test_the_file_beside_the_truth(tmp_path):
    mounts = campaign()
    true = true_mounts(mounts, 3, on=True)
    path = tmp_path / "truth" / "mounts.json"
    write_true_mounts(path, true, mounts)
    assert read_true_mounts(path) == json.loads(json.dumps(true))
    errors = json.loads(path.read_text())["true_minus_estimated"]
    assert errors["lidar"]["phi_deg"] == true["lidar"]["phi_deg"] + 90.0
    with pytest.raises(InputError, match="not found"):
        read_true_mounts(tmp_path / "none.json")
    for text in (
        "{",
        "[]",
        '{"kind": "other", "version": 1, "mounts": {}}',
        '{"kind": "thalweg twin mounts"}',
    ):
        path.write_text(text)
        with pytest.raises(InputError):
            read_true_mounts(path)


def test_sigmas_about_the_axes_of_the_body_turn_the_sensor_there():
    """At phi = -90 degrees errors of omega and kappa are one; rotations about x, y and z are not."""
    mounts = campaign(sigma_axes="ics", sigma_omega_deg=0.5, sigma_phi_deg=0.3, sigma_kappa_deg=0.2)
    assert mounts["lidar"]["phi_deg"] == -90.0
    vectors, levers = [], []
    for seed in range(SEEDS):
        error = mount_errors(true_mounts(mounts, seed, on=True), mounts)
        vectors.append(error["lidar"]["rotation_ics_deg"])
        levers.append(error["camera"]["lever_ics_m"])
    # 400 seeds: a sigma is known to 3.5 %; four times that.
    assert_allclose(np.std(vectors, axis=0), [0.5, 0.3, 0.2], rtol=0.14)
    assert_allclose(np.std(levers, axis=0), [0.01, 0.01, 0.01], rtol=0.14)
    assert np.abs(np.corrcoef(np.transpose(vectors)) - np.eye(3)).max() < 0.21
