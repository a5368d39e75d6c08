"""Budgets of the repository with their published cells."""

from pathlib import Path

import pandas as pd
import pytest

from thalweg.budgets import Budget, read_budget, read_published

NAMES = (
    "p2_table1",
    "t_table3_1",
    "p2_perfect_trigger",
    "p2_trigger_4ms",
    "p1_direct",
    "p1_direct_one_sigma",
    "sajo_2019",
    "sajo_2021",
)


@pytest.fixture(scope="session")
def budgets(repository: Path) -> dict[str, tuple[Budget, pd.DataFrame]]:
    folder = repository / "resources"
    assert {p.stem for p in (folder / "budgets").glob("*.yaml")} == set(NAMES)
    return {
        name: (
            read_budget(folder / "budgets" / f"{name}.yaml"),
            read_published(folder / "published" / f"{name}.csv"),
        )
        for name in NAMES
    }
