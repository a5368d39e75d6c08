"""The noise of the yard is that of the river's scenes, though kernels that are cached cannot share it."""

import inspect

import numpy as np
import pytest

from thalweg_lab.river_images import appearance
from thalweg_lab.yard_images import yard_look


@pytest.mark.parametrize("name", ["_mixed", "_seen"])
def test_both_copies_of_a_kernel_are_the_same(name: str) -> None:
    """Numba caches compiled code by its own file only, so that a shared kernel would go stale unnoticed."""
    here, there = (getattr(module, name) for module in (yard_look, appearance))
    assert inspect.getsource(here.py_func) == inspect.getsource(there.py_func)


def test_both_value_noises_are_the_same() -> None:
    rng = np.random.default_rng(1)
    for x, y, z in rng.uniform(-50, 50, (200, 3)):
        # the one sums eight corners, the other interpolates three times: rounding of numbers below 2
        assert yard_look._value(x, y, z, 7) == pytest.approx(appearance._value(x, y, z, 7)[0], abs=1e-12)
