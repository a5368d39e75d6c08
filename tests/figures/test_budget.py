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
    upper, lower = figure.axes[:2], figure.axes[2:]
    assert set(STYLE) == set(GROUPS)
    for k, ax in enumerate(upper):
        (total,) = [line for line in ax.lines if line.get_gid() == "total"]
        (points,) = [line for line in ax.lines if line.get_gid() == "published"]
        at = np.interp(points.get_xdata(), *total.get_data())
        # the tolerance of a total, and what a step of 0.25 m leaves
        np.testing.assert_allclose(points.get_ydata(), at, rtol=0.0105, atol=0.55)
        assert points.get_xdata().tolist() == [5, 10, 25, 50]
        for axes, end in ((ax, total.get_ydata()), (lower[k], np.full(len(total.get_ydata()), 100.0))):
            bands = [c for c in axes.collections if c.get_gid() in GROUPS]
            assert [band.get_gid() for band in bands] == list(STYLE)
            top = bands[-1].get_paths()[0].vertices[:, 1].max()
            assert top == pytest.approx(end.max(), rel=1e-9)
    assert all(artist.get_gid() != "twin-mark" for artist in figure.texts)


def test_budgets_that_cannot_be_stacked(both) -> None:
    with pytest.raises(InputError, match="no budget"):
        error_budget([], [])
    correlated = replace(both[0][0], correlations={("ccs.omega", "ccs.phi"): 0.5})
    with pytest.raises(InputError, match="correlated"):
        error_budget([correlated], [None])


def test_a_budget_without_published_cells(both) -> None:
    figure = error_budget(both[0][:1], [None])
    assert len(figure.axes) == 2
    assert not [line for line in figure.axes[0].lines if line.get_gid() == "published"]
