"""Budgets of the repository."""

from pathlib import Path

import pytest

from thalweg.budgets import Budget, read_budget


@pytest.fixture(scope="session")
def budgets(repository: Path) -> dict[str, Budget]:
    return {path.stem: read_budget(path) for path in (repository / "resources/budgets").glob("*.yaml")}
