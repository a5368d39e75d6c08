"""Fixtures shared by all tests."""

import os
from pathlib import Path

import numpy as np
import pytest

REPOSITORY = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def repository() -> Path:
    """Root of the checkout under test."""
    return REPOSITORY


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of the real recordings, from THALWEG_DATA or beside the repository; skips where absent."""
    folder = Path(os.environ.get("THALWEG_DATA", REPOSITORY.parent / "shared" / "data"))
    if not (folder / "README.md").is_file():
        pytest.skip(f"no real recordings at {folder}: set THALWEG_DATA to their folder")
    return folder


@pytest.fixture(scope="session")
def fuzz_count() -> int:
    """Mutated inputs per binary reader: 300 in the suite, THALWEG_FUZZ=10000 for the long run."""
    return int(os.environ.get("THALWEG_FUZZ", "300"))


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Generator seeded by the name of the test: another test never changes its numbers."""
    return np.random.default_rng(list(request.node.name.encode()))
