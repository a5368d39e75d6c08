"""Heights of levels that are not those of the object, at the limit where they are refused."""

from types import SimpleNamespace

import numpy as np
import pytest

from thalweg.core import GeometryError
from thalweg.lightsheet.scanning.compare import _require_heights


def levels(off_mm, own_mm=(0.2, 0.4)):
    """Two levels of 13 and 33 points, plane to ``own_mm``, together ``off_mm`` off; one point on none."""
    return SimpleNamespace(
        plane_n=np.array([13, 33]),
        plane_rms_mm=np.array(own_mm),
        distance_mm=np.array([off_mm, -off_mm, off_mm, 99.0]),
        used=np.array([True, True, True, False]),
    )


def test_levels_are_refused_beyond_three_times_their_own_roughness():
    """Pooled over 10 and 30 degrees of freedom: sqrt((10 0.04 + 30 0.16) / 40) = 0.3606 mm."""
    _require_heights(levels(3 * 0.3605), (0.0, 10.0))
    with pytest.raises(
        GeometryError, match=r"each level is plane to 0\.36 mm, but together they lie 1\.09 mm"
    ):
        _require_heights(levels(3 * 0.3635), (0.0, 10.0))
    _require_heights(levels(0.39, (0.01, 0.01)), (0.0, 10.0))  # less than 0.4 mm is never refused
    with pytest.raises(GeometryError, match=r"0\.41 mm off planes at 0, 10 mm"):
        _require_heights(levels(0.41, (0.01, 0.01)), (0.0, 10.0))
