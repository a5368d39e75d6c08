"""Where the refusal of rasters in two units begins and ends."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from thalweg.core import InputError
from thalweg.deformation.foreign.surfaces import _refuse_other_units


def told(factor: float, n: int = 100, *, noise: float = 0.0, second_first: bool = False) -> str:
    """What is said of one relief in two units."""
    rng = np.random.default_rng(23)
    relief = rng.standard_normal(n)
    one, two = (
        SimpleNamespace(height_m=values, path=Path(name))
        for values, name in (
            (relief, "one.tif"),
            (factor * relief + noise * rng.standard_normal(n), "two.tif"),
        )
    )
    try:
        _refuse_other_units(*((two, one) if second_first else (one, two)), np.ones(n, dtype=bool))
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("factor", "unit"), [(1 / 0.3048, "feet"), (1000.0, "millimetres"), (100.0, "centimetres")]
)
@pytest.mark.parametrize("second_first", [False, True])
def test_the_raster_in_other_units_is_named(factor, unit, second_first):
    words = told(factor, second_first=second_first)
    assert unit in words
    assert "two.tif" in words
    assert f"{factor:.2f} times" in words


def test_what_might_be_a_real_difference_is_let_through():
    feet = 1 / 0.3048
    assert told(1.0) == told(2.0) == ""
    assert told(feet, n=99) == ""
    assert told(1.02 * feet) != ""
    assert told(1.04 * feet) == ""
    assert told(feet, noise=0.5) != ""  # correlation 0.989
    assert told(0.9 * feet, noise=0.45 * feet) == ""  # as steep, but another relief: 0.89
    assert told(0.0) == ""  # a plane
