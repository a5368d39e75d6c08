"""What the papers did otherwise: the misprinted law, the search for a sub-beam by halving, a plane."""

import math

import numpy as np
import pytest

from thalweg.lightsheet.optics import intersect, paper_4
from thalweg_lab.reproduction.paper_models import halved, plane_error_mm, refract_as_printed

UP = np.array([0.0, 0.0, 1.0])


def test_the_printed_law_is_wrong() -> None:
    """E02: printed vectors at 30, 45, 60 degrees from air to glass are too long; 20.5 for 22.0 degrees in
    water."""
    for degrees, excess in ((30, 0.056), (45, 0.120), (60, 0.197)):
        a = math.radians(degrees)
        out = refract_as_printed([[math.sin(a), 0.0, -math.cos(a)]], UP, 1.0, 1.52)
        assert np.linalg.norm(out) - 1 == pytest.approx(excess, abs=5e-4)  # three digits are stated
    a = math.radians(30)
    glass = refract_as_printed([[math.sin(a), 0.0, -math.cos(a)]], UP, 1.0, 1.52)
    water = refract_as_printed(glass, UP, 1.52, 1.335)[0]
    assert math.degrees(math.atan(water[0] / -water[2])) == pytest.approx(20.5, abs=0.05)
    # where total reflection is, it finds a ray
    assert np.isfinite(refract_as_printed([[math.sin(1.2), 0.0, -math.cos(1.2)]], UP, 1.52, 1.0)).all()


def test_the_papers_halving_loses_pixels() -> None:
    """At any threshold: some 0.3 % of the pixels and 0.12 mm; a distance between the rays is left."""
    sensor = paper_4()
    xy = np.random.default_rng(1).uniform(0.0, 2048.0, (40_000, 2))
    true = intersect(sensor, xy)
    for threshold in (1e-3, 1e-6):
        points, skew = halved(sensor, xy[true.ok], threshold)
        error = np.linalg.norm(points - true.xyz_lcs_mm[true.ok], axis=1)
        bad = skew > threshold
        assert 0.002 < bad.mean() < 0.005
        assert error[bad].max() > 0.08
        # the others end within the threshold, stretched by the obliqueness of ray and sheet
        assert error[~bad].max() < 3 * threshold


def test_the_sheet_is_no_plane() -> None:
    """P4 2: the study found errors from -5.5 to 3.4 mm in depth."""
    assert plane_error_mm(paper_4(), (40.0, 80.0, 125.0, 170.0, 220.0)) == pytest.approx(5.5, abs=0.8)
