"""The stacked error budget: shares, totals and published points."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from thalweg.budgets import GROUPS, read_budget
from thalweg.core import InputError
from thalweg_lab.figures.error_budget import STYLE, error_budget
from thalweg_lab.reproduction.published_budgets import read_published


@pytest.fixture(scope="module")
def both(repository: Path):
    names, folder = ("p2_table1", "t_table3_1"), repository / "resources"
    return (
        [read_budget(folder / "budgets" / f"{name}.yaml") for name in names],
        [read_published(folder / "published" / f"{name}.csv") for name in names],
    )


def test_the_stack_ends_at_the_total_and_at_100_percent(both) -> None:
    figure = error_budget(*both)
    assert set(STYLE) == set(GROUPS)
    for ax in figure.axes[:2]:
        (total,) = [line for line in ax.lines if line.get_gid() == "total"]
        (points,) = [line for line in ax.lines if line.get_gid() == "published"]
        at = np.interp(points.get_xdata(), *total.get_data())
        # the tolerance of a total, and what a step of 0.25 m leaves
        np.testing.assert_allclose(points.get_ydata(), at, rtol=0.0105, atol=0.55)
        assert points.get_xdata().tolist() == [5, 10, 25, 50]


def test_budgets_that_cannot_be_stacked(both) -> None:
    with pytest.raises(InputError, match="no budget"):
        error_budget([], [])
    correlated = replace(both[0][0], correlations={("ccs.omega", "ccs.phi"): 0.5})
    with pytest.raises(InputError, match="correlated"):
        error_budget([correlated], [None])
