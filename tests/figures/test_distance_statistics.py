"""Histogram of the distances, and observed against predicted by range."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.figures.conftest import artists as by_gid
from thalweg.accuracy import ComparisonSettings, by_range_table
from thalweg.figures import count
from thalweg.figures.accuracy.distances import distance_by_range, distance_histogram, robust_fit


@pytest.fixture
def by_range(made):
    return by_range_table(made.table, ComparisonSettings(correlation_s=0.2))


# ---------------------------------------------------------------- histogram


def test_every_point_is_a_bar_or_counted_beyond(made):
    figure = distance_histogram(made.table, limit_m=0.4)
    (steps,) = by_gid(figure, "histogram")
    values, edges, _ = steps.get_data()
    d = made.table.loc[made.table["used"], "distance_m"].to_numpy()
    assert_allclose([edges[0], edges[-1]], [-40.0, 40.0])
    assert values.sum() == (np.abs(d) <= 0.4).sum()
    title = figure.axes[0].get_title(loc="left")
    assert f"{count(int((d < -0.4).sum()))} behind, {count(int((d > 0.4).sum()))} in front" in title


def test_the_fits_have_the_parameters_that_are_printed(made):
    figure = distance_histogram(made.table, limit_m=0.4)
    d = made.table.loc[made.table["used"], "distance_m"].to_numpy()
    kept = made.table.loc[made.table["used"] & ~made.table["outlier"], "distance_m"].to_numpy()
    expected = [(d.mean(), d.std()), (kept.mean(), kept.std()), robust_fit(d)]
    for k, (middle, spread) in enumerate(expected):
        (line,) = by_gid(figure, f"fit-{k}")
        x, y = line.get_data()
        # The peak of the curve is at the mean, to the step of 0.13 cm at which it is drawn.
        assert abs(x[np.argmax(y)] - 100 * middle) < 0.1
        assert f"{100 * spread:.1f}\N{NO-BREAK SPACE}cm" in line.get_label()
        # Counts, not a density: bars of 80 cm / 81 under n points.
        n = kept.size if k == 1 else d.size
        assert_allclose(y.max(), n * 0.8 / 81 / (spread * np.sqrt(2 * np.pi)), rtol=1e-3)
    title = figure.get_suptitle().replace("\n", " ").replace("\N{NO-BREAK SPACE}", " ")
    assert f"mean {100 * d.mean():+.1f} cm, std {100 * d.std():.1f} cm" in title


# ---------------------------------------------------------------- by range


def test_the_curves_are_those_of_the_table(by_range):
    figure = distance_by_range(by_range, title="Test", twin=True)
    kept = by_range[by_range["points"] == "without outliers"]
    for gid, column in (("normal", "rmse_predicted_m"), ("3d", "rmse_predicted_3d_m")):
        (line,) = by_gid(figure, gid)
        assert_allclose(line.get_ydata(), 1e3 * kept[column])
    (ratio,) = by_gid(figure, "ratio")
    assert_allclose(ratio.get_ydata(), kept["ratio"])
    # Predicted are 5.0 and 0.6 cm, observed 5 cm about a mean of 3: 5.04 / 5.83. With 780 points a class the
    # ratio of one class varies by 2.5 %, the median of 26 of them by 0.6 %; four of those.
    assert_allclose(np.median(ratio.get_ydata()), 0.864, rtol=0.025)
    assert f"n = {count(int(kept['n'].sum()))}" in figure.get_suptitle()


def test_classes_outside_their_band_are_ringed(by_range):
    by_range.loc[:, "inside"] = True
    by_range.loc[by_range["range_m"].isin([10, 20]), "inside"] = False
    figure = distance_by_range(by_range)
    titles = [ax.get_title(loc="left") for ax in figure.axes]
    assert any("ringed: 2 of 26 classes outside" in title for title in titles)
