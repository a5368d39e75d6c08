"""What the geometry cannot give is named and refused (underwater.md, acceptance 10)."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.lightsheet.calibrate import lines
from thalweg.core import UnobservableError
from thalweg.core.adjustment import Linear, Observations
from thalweg.lightsheet.calibration import CalibrationSettings, fit_sheet
from thalweg.lightsheet.calibration.rank import (
    ABOUT_NORMAL,
    ALONG_X,
    ALONG_Y,
    IN_PLANE,
    FreeDirectionError,
    estimable_laser,
    null_directions,
)
from thalweg.lightsheet.optics import PARAMETERS, paper_3, paper_4

KNOWN_3, KNOWN_4 = lines.without_sigmas(paper_3()), lines.without_sigmas(paper_4())
SIX = PARAMETERS[15:21]
CAMERA = PARAMETERS[:6]


def fit(sensor, estimate, paper):
    if paper == 3:
        grid = lines.grid_object(75.0, 129.0)
        points = lines.line_points(sensor, grid, axis=1, along=1, every=6)
    else:
        grid = lines.grid_object()
        points = lines.line_points(sensor, grid, every=4)
    return fit_sheet(sensor, points, grid, CalibrationSettings(estimate=estimate, least_gap_px=12.0))


def test_six_laser_parameters_leave_the_turn_of_the_sheet_in_its_plane():
    with pytest.raises(FreeDirectionError) as error:
        fit(KNOWN_4, SIX, 4)
    assert isinstance(error.value, UnobservableError)
    (direction,) = error.value.directions
    assert direction.motion == IN_PLANE
    # P4's laser is turned by 0.4 degrees about y only, so that phi is nearly that rotation
    assert next(iter(direction.change)) == "laser_phi_rad"
    # exact derivatives leave rounding
    assert direction.singular_value < 1e-9
    for word in (IN_PLANE, "laser_phi_rad", "Hold one unknown"):
        assert word in str(error.value)


def test_the_nine_unknowns_of_paper_3_leave_the_turn_about_the_normal():
    nine = ("laser_z_mm", "laser_phi_rad", "laser_kappa_rad", *CAMERA)
    with pytest.raises(FreeDirectionError) as error:
        fit(KNOWN_3, nine, 3)
    (direction,) = error.value.directions
    assert direction.motion == ABOUT_NORMAL
    # study, section 4: Yc, wc, kl, kc take part
    assert set(list(direction.change)[:4]) == {
        "camera_y_mm",
        "camera_kappa_rad",
        "laser_kappa_rad",
        "camera_omega_rad",
    }
    assert direction.singular_value < 1e-9


def test_without_one_of_each_direction_it_works():
    eight = ("laser_z_mm", "laser_phi_rad", *CAMERA)
    assert fit(KNOWN_3, eight, 3).misfit_px < 0.16
    assert estimable_laser(KNOWN_4) == tuple(name for name in SIX if name != "laser_phi_rad")
    assert fit(KNOWN_4, estimable_laser(KNOWN_4), 4).misfit_px < 0.16
    # P3 3.1.1 fixes omega of its laser, too
    assert estimable_laser(paper_3()) == tuple(name for name in SIX if name != "laser_omega_rad")


def test_an_unknown_is_free_if_nothing_depends_on_it_however_small_the_dependence():
    """Derivatives of 0.001 and 0.002 sigmas, and none."""
    for b, free in ((2e-3, []), (0.0, [{"b": 1.0}])):
        part = Linear(residual=np.zeros(2), jacobian=np.diag([1e-3, b]), cov=np.ones(2))
        problem = SimpleNamespace(
            free=("a", "b"), observations=lambda part=part: [Observations("line", lambda x: part)]
        )
        assert [d.change for d in null_directions(problem, np.zeros(2))] == free


def test_several_defects_are_all_told():
    with pytest.raises(FreeDirectionError) as error:
        fit(KNOWN_4, (*SIX, *CAMERA), 4)
    assert error.value.defects == 4
    assert "4 directions" in str(error.value)
    motions = {direction.motion for direction in error.value.directions}
    # a basis of the four motions may mix them; each of its directions is explained by them
    assert motions <= {IN_PLANE, ABOUT_NORMAL, ALONG_X, ALONG_Y}


def test_shifts_along_the_window_are_named():
    with pytest.raises(FreeDirectionError) as error:
        fit(KNOWN_4, (*estimable_laser(KNOWN_4), "camera_x_mm", "camera_y_mm"), 4)
    directions = error.value.directions
    assert {direction.motion for direction in directions} == {ALONG_X, ALONG_Y}
    for direction in directions:
        # camera and laser go the same way
        for axis in "xy":
            pair = [direction.change.get(f"{what}_{axis}_mm", 0.0) for what in ("camera", "laser")]
            assert pair[0] == pytest.approx(pair[1], abs=2e-3)  # parts below 1e-3 are not listed
