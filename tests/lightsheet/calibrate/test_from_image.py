"""From a rendered picture of the grid object, with speckle and noise, to the light sheet."""

import numpy as np
import pytest

from thalweg.core import rotation_opk
from thalweg.lightsheet.calibration import CalibrationSettings, calibrate_sheet, parse_grid
from thalweg.lightsheet.lines import LineFlag, LineSettings, detect_lines
from thalweg.lightsheet.optics import paper_4, sheet_in_water
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import SheetImage
from thalweg_lab.tank import Posed, render_sheet_image
from thalweg_lab.tank.objects import GridPattern, grid_object
from thalweg_lab.tank.record import grid_text


@pytest.mark.slow
def test_a_rendered_picture_gives_the_sheet(lines):
    """The whole chip; small pictures of two and three levels go the same way in test_sheet_jobs.py."""
    levels_mm = (0.0, -45.0, -90.0)
    truth = lines.without_sigmas(paper_4())
    pattern = GridPattern.regular()
    pattern = GridPattern(gaps_mm=pattern.gaps_mm, levels_mm=levels_mm)
    place = sheet_in_water(truth, [60.0], [0.0])[0, 0]
    surface = Posed(
        surface=grid_object(pattern), R_lcs_obj=rotation_opk(0.0, 0.0, np.deg2rad(-2.0)), shift_lcs_mm=place
    )
    image = render_sheet_image(truth, surface, SheetImage(), generator(1, "grid picture"))
    points = detect_lines(image, LineSettings(lines=2, layout="rggb")).to_frame()
    grid = parse_grid(grid_text(pattern, [60.0 - height for height in levels_mm]))
    found = calibrate_sheet(
        lines.off_start(truth, 7), points, grid, CalibrationSettings(drop_flags=int(LineFlag.NEAR_JUMP))
    )
    off = found.sensor.sheet.origin_lcs_mm - truth.sheet.origin_lcs_mm
    # depths of this object are exact: what is left is the picture, and the sigmas of its line and ends
    sigma = np.array([found.adjusted.sigma(f"laser_{axis}_mm") for axis in "xyz"])
    assert (np.abs(off) < 4.0 * sigma).all(), (off, sigma)
    assert (sigma < [0.06, 0.03, 0.03]).all()  # study, white noise of 0.15 px: .035 .008 .013 mm
    assert found.misfit_px < 0.15
    # eleven gaps, of which the last ones may lie at the edge of the picture
    assert found.adjusted.used["pairs"].sum() >= 18
    # patches of 17 to 21 rows overlap
    assert found.shared_points > 5
