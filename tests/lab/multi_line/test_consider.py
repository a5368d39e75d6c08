"""What an uncertain sensor does to lines that were calibrated with it, and to their depths."""

from dataclasses import replace

import numpy as np
import pytest

from thalweg.lightsheet.optics import PARAMETERS, paper_4
from thalweg_lab.multi_line import calibrate_lines, compare_models, line_model
from thalweg_lab.multi_line.adjustment import level_depths
from thalweg_lab.multi_line.comparison import consider_sensor, depth_errors
from thalweg_lab.studies.sensors.laser_lines import (
    LEVELS_MM,
    PAIRED,
    PLANES_MM,
    calibrated_sensor,
    nominal_diode,
)
from thalweg_lab.tank import GratingErrors, calibration_points, make_grating

IDEAL = GratingErrors(
    tilt_deg=(0.0, 0.0),
    grooves_deg=0.0,
    cover_mm=0.0,
    sigma_spacing_deg=0.0,
    sigma_rotation_deg=0.0,
    sigma_origin_mm=(0.0, 0.0, 0.0),
    sigma_bow=0.0,
)
"""The diode describes it exactly."""


@pytest.fixture(scope="module")
def quiet():
    """A sensor, and points without noise on two levels and on a plane."""
    sensor = paper_4()
    grating = make_grating(sensor, 1, errors=IDEAL)
    points, planes = (
        replace(
            calibration_points(
                sensor, grating, levels, 1, points_per_line=15, sigma_px=1e-9, sigma_along_px=1e-9, **own
            )
        )
        for levels, own in ((LEVELS_MM, {}), ((100.0,), {"pairs_per_line": 0}))
    )
    points = replace(
        points, sigma_px=np.full(len(points.line), 0.3), sigma_along_px=np.full(len(points.pairs), 1.0)
    )
    return sensor, points, planes


@pytest.mark.parametrize("name", ["camera_z_mm", "camera_omega_rad", "fx", "n_water"])
def test_a_wrong_parameter_moves_depths_as_predicted(quiet, name: str) -> None:
    """The whole calibration again with a sensor that is wrong by a sigma."""
    sensor, points, planes = quiet
    model = line_model("diode", nominal_diode(sensor))
    base = calibrate_lines(sensor, points, model)
    considered = consider_sensor(sensor, points, base)
    told = depth_errors(sensor, base, considered, planes)
    i = considered.names.index(name)
    x = sensor.vector()
    x[PARAMETERS.index(name)] += considered.sigma[i]
    wrong = sensor.with_vector(x)
    moved = calibrate_lines(wrong, points, model)
    change = level_depths(wrong, moved.lines, planes) - level_depths(sensor, base.lines, planes)
    predicted = told.by_sensor[:, i] * considered.sigma[i]
    assert np.abs(predicted).max() > 1e-5
    # what is left is of the second order
    np.testing.assert_allclose(change, predicted, atol=0.03 * np.abs(predicted).max() + 1e-7)


def test_predicted_errors_of_planes_hold_with_a_calibrated_sensor() -> None:
    """Six lines, the sensor as its own calibration knows it: a model that fits is right about itself."""
    found = []
    for seed in (3, 4):
        pair = calibrated_sensor(seed)
        grating = make_grating(pair.true, seed)
        points = calibration_points(
            pair.true, grating, LEVELS_MM, seed, points_per_line=30, paired_lines=PAIRED
        )
        planes = calibration_points(
            pair.true,
            grating,
            PLANES_MM,
            seed,
            points_per_line=30,
            pairs_per_line=0,
            sigma_px=0.2,
            name="plane",
        )
        seen = points.of(np.isin(points.line, PAIRED))
        six = nominal_diode(pair.known, PAIRED)
        table = compare_models(pair.known, seen, six, ("regular", "hierarchical"), planes=planes)
        found.append(table.set_index("model"))
    nees = {
        model: np.mean([t.loc[model, "plane_nees"] for t in found]) for model in ("regular", "hierarchical")
    }
    # points of a plane share the errors of their lines; measured over 10 lasers: see the study
    assert 0.8 < nees["hierarchical"] < 1.25
    assert nees["regular"] > 1.3
    for table in found:
        assert 0 < table.loc["hierarchical", "plane_sigma_sensor_mm"] < 0.02
