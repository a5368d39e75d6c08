"""The cloud by sigma and by range: what is drawn and what is counted."""

import numpy as np
import pytest

from thalweg.core import InputError
from thalweg.figures import save
from thalweg.figures.cloud import Splat
from thalweg.figures.cloud.overview import (
    THESIS_RANGE_M,
    THESIS_SIGMA_CM,
    cloud_by_range,
    cloud_by_sigma,
    sigma_3d_m,
)
from thalweg.figures.cloud.views import ObliqueView


def by_gid(figure, gid):
    return figure.findobj(lambda artist: artist.get_gid() == gid)


def splat_of(points, values):
    splat = Splat(ObliqueView.fit(points, width_px=300))
    splat.add(points, values)
    return splat


@pytest.fixture
def surveyed(rng, bank):
    """Ranges of 5 to 60 m, and sigmas of 3 cm + 2 mm/m."""
    range_m = rng.uniform(5, 60, len(bank.points))
    return bank.points, range_m, 0.03 + 0.002 * range_m


def test_sigma_is_the_root_of_the_trace():
    np.testing.assert_allclose(sigma_3d_m([0.02, 0.0], [0.03, 0.0], [0.06, 0.5]), [0.07, 0.5])


def test_median_line_follows_the_sigmas(surveyed, trajectory):
    points, range_m, sigma_m = surveyed
    figure = cloud_by_sigma(splat_of(points, sigma_m), range_m, sigma_m, trajectory, title="Test", twin=True)
    (median,) = by_gid(figure, "median")
    r, s = median.get_xydata().T
    drawn = np.isfinite(s)
    # Classes of about 1.6 m (60 m / 40): the median may lie half a class, 1.6 mm, beside the middle.
    np.testing.assert_allclose(s[drawn], 100 * (0.03 + 0.002 * r[drawn]), atol=0.17)
    assert drawn.sum() > 30
    assert "median 9.5 cm" in figure.axes[1].get_title(loc="left")  # 3 cm + 2 mm/m at the mean of 32.5 m
    assert "n = 40\N{NO-BREAK SPACE}000 points," in figure.axes[1].get_title(loc="left")
    labels = [ax.get_ylabel() for ax in figure.axes]
    assert labels.count("predicted 3D sigma / cm") == 2  # axis and colour bar
    assert len(by_gid(figure, "twin-mark")) == len(by_gid(figure, "scale-bar")) == 1


def test_colour_bar_is_in_centimetres(surveyed):
    points, range_m, sigma_m = surveyed
    figure = cloud_by_sigma(splat_of(points, sigma_m), range_m, sigma_m)
    bar = next(ax for ax in figure.axes[2:] if ax.get_ylabel() == "predicted 3D sigma / cm")
    low, high = np.percentile(100 * sigma_m, [0.5, 99.0])
    assert bar.get_ylim() == (pytest.approx(low), pytest.approx(high))


def test_density_counts_every_point_once(surveyed):
    points, range_m, sigma_m = surveyed
    figure = cloud_by_sigma(splat_of(points, sigma_m), range_m, sigma_m)
    (mesh,) = by_gid(figure, "density")
    assert int(mesh.get_array().sum()) == len(range_m)


def test_thesis_is_drawn_as_printed(surveyed):
    points, range_m, sigma_m = surveyed
    splat = splat_of(points, sigma_m)
    (line,) = by_gid(cloud_by_sigma(splat, range_m, sigma_m), "thesis")
    # T Table 3.1, last row: 54, 62, 101, 183 mm at 5, 10, 25, 50 m.
    np.testing.assert_allclose(line.get_xydata(), [(5, 5.4), (10, 6.2), (25, 10.1), (50, 18.3)])
    assert line.get_label() == "T Table 3.1"
    assert len(THESIS_RANGE_M) == len(THESIS_SIGMA_CM) == 4
    assert by_gid(cloud_by_sigma(splat, range_m, sigma_m, thesis=False), "thesis") == []


def test_points_without_sigma_and_beyond_the_axes_are_counted(surveyed):
    points, range_m, sigma_m = surveyed
    sigma_m = sigma_m.copy()
    sigma_m[:30], sigma_m[30:35], sigma_m[35:40] = np.nan, 0.0, 50.0
    title = cloud_by_sigma(splat_of(points, sigma_m), range_m, sigma_m).axes[1].get_title(loc="left")
    assert "5 beyond the axes; 35 without a sigma" in title
    half = cloud_by_sigma(splat_of(points, sigma_m), range_m[::2], sigma_m[::2]).axes[1].get_title(loc="left")
    assert "points sampled" in half


def test_no_sigma_is_refused(surveyed):
    points, range_m, _ = surveyed
    nothing = np.zeros(len(range_m))
    with pytest.raises(InputError, match=r"none of 40000 points has a sigma.*Georeference"):
        cloud_by_sigma(splat_of(points, nothing), range_m, nothing)
    with pytest.raises(InputError, match="of one length"):
        cloud_by_sigma(splat_of(points, nothing), range_m, nothing[:-1])


def test_histogram_holds_all_ranges(surveyed, trajectory):
    points, range_m, _ = surveyed
    figure = cloud_by_range(splat_of(points, range_m), range_m, trajectory, title="Test")
    (steps,) = by_gid(figure, "histogram")
    values, edges, _ = steps.get_data()
    np.testing.assert_allclose(np.diff(edges), 1.0)
    n, _ = np.histogram(range_m, edges)
    np.testing.assert_allclose(values, 100 * n / len(range_m))
    assert figure.axes[1].get_xlabel() == "measured range / m"
    assert "median 32" in figure.axes[1].get_title(loc="left")
    assert any(ax.get_ylabel() == "measured range / m" for ax in figure.axes[2:])


def test_no_range_is_refused(bank):
    nothing = np.full(len(bank.points), np.nan)
    with pytest.raises(InputError, match="none of 40000 points has a range"):
        cloud_by_range(splat_of(bank.points, np.zeros(len(nothing))), nothing)


def test_one_point_makes_both_figures(tmp_path):
    point, one = np.array([[1.0, 2.0, 3.0]]), np.array([0.1])
    save(cloud_by_sigma(splat_of(point, one), 100 * one, one), tmp_path / "sigma.png", dpi=50)
    save(cloud_by_range(splat_of(point, one), 100 * one), tmp_path / "range.png", dpi=50)
    assert all((tmp_path / name).stat().st_size > 5_000 for name in ("sigma.png", "range.png"))
