"""One thread: with few points, starting threads on a busy machine costs more than they gain."""

import numba as nb
import pytest


@pytest.fixture(autouse=True)
def one_thread():
    """Kernels in one thread."""
    before = nb.get_num_threads()
    nb.set_num_threads(1)
    yield
    nb.set_num_threads(before)
