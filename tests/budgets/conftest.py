"""Budgets of the repository."""

import pytest

from thalweg.budgets import read_budget


@pytest.fixture(scope="session")
def budgets(repository):
    return {path.stem: read_budget(path) for path in (repository / "resources/budgets").glob("*.yaml")}
