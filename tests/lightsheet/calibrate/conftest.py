"""One thread: with few points, starting threads on a busy machine costs more than they gain."""

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numba as nb
import pytest


def _module(name: str) -> ModuleType:
    full = f"triangulation_calibrate_{name}"
    if full not in sys.modules:
        spec = importlib.util.spec_from_file_location(full, Path(__file__).with_name(f"{name}.py"))
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[full] = module
        spec.loader.exec_module(module)
    return sys.modules[full]


@pytest.fixture(scope="session")
def lines() -> ModuleType:
    """Simulated line points."""
    return _module("lines")


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Kernels in one thread."""
    before = nb.get_num_threads()
    nb.set_num_threads(1)
    yield
    nb.set_num_threads(before)
