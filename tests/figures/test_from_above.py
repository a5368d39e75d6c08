"""The survey from above: what is drawn where, and what is left out."""

import numpy as np
import pandas as pd
import pytest
from pyproj import CRS

from thalweg.core import LazWriter
from thalweg.figures.cloud import Splat, from_above
from thalweg.figures.cloud.from_above import LAND, WATER, draw_from_above, view_of


def survey(trajectory, *, bed=True, lidar=True):
    """A bed of 0.5 m cells that deepens to 4 m in the east, and a bank 8 m high at 30 m beside the track."""
    track = trajectory.position_wcs_m[trajectory.valid]
    along, aside = np.meshgrid(np.arange(0.0, 100, 0.5), np.arange(-5.0, 5.1, 0.5))
    wet = np.column_stack([along.ravel(), 0.36 * along.ravel() + aside.ravel(), np.zeros(along.size)])
    wet = wet if bed else np.empty((0, 3))
    view = view_of(np.vstack([track, wet]))
    land = Splat(view) if lidar else None
    if land is not None:
        x, y = np.meshgrid(np.arange(20.0, 60, 0.1), np.arange(-8.0, 2, 0.1))
        bank = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, 8.0)])
        land.add(bank, bank[:, 2])
    return from_above(trajectory, view, land, wet, 0.04 * wet[:, 0], cell_m=0.5, twin=True), view


def colour_at(figure, place):
    """Colour of the picture at a place, 0 to 255."""
    (image,) = figure.axes[0].images
    left, right, bottom, top = image.get_extent()
    picture = image.get_array()
    row = int((top - place[1]) / (top - bottom) * picture.shape[0])
    return np.asarray(picture[row, int((place[0] - left) / (right - left) * picture.shape[1])], float)


def test_bed_and_bank_have_the_colours_of_their_bars(trajectory):
    figure, _ = survey(trajectory)
    for place, colours, share in (
        ((90.0, 32.4), WATER, 0.9),
        ((5.0, 1.8), WATER, 0.05),
        ((40.0, -4.0), LAND, 2 / 3),
    ):
        expected = 255 * np.array(colours(share)[:3])
        assert np.abs(colour_at(figure, place) - expected).max() < 12, place
    assert (colour_at(figure, (5.0, 45.0)) == 255).all()
    assert [ax.get_xlabel() for ax in figure.axes[1:]] == ["water depth / m", "height / m"]


@pytest.mark.parametrize(
    ("bed", "lidar", "bars"),
    [(True, False, ["water depth / m"]), (False, True, ["height / m"]), (False, False, [])],
)
def test_what_is_absent_has_no_bar(trajectory, look, bed, lidar, bars):
    figure, view = survey(trajectory, bed=bed, lidar=lidar)
    assert [ax.get_xlabel() for ax in figure.axes[1:]] == bars
    assert view.pixel_m * view.width_px > 100  # the track lies in it


def test_soundings_lie_on_the_track_from_files(trajectory, tmp_path):
    track = trajectory.position_wcs_m[trajectory.valid]
    east, north, height = trajectory.frame.to_map(track, CRS.from_epsg(25833)).T
    pd.DataFrame({"east": east, "north": north, "height": height, "depth": 1.5}).to_csv(tmp_path / "s.csv")
    trajectory.write(tmp_path / "t.parquet")
    with LazWriter(tmp_path / "c.laz", trajectory.frame) as writer:
        writer.append(track + np.array([0.0, 20.0, 3.0]))
    figure = draw_from_above(
        trajectory=tmp_path / "t.parquet", points=[tmp_path / "c.laz"], bed=[], line=[], level=[],
        soundings=[tmp_path / "s.csv"], crs="EPSG:25833",
    )  # fmt: skip
    expected = 255 * np.array(WATER(2 / 3)[:3])  # the bar of equal values ends at one and a half of them
    for place in track[[5, 200, 350]]:
        assert np.abs(colour_at(figure, place) - expected).max() < 12
    assert [ax.get_xlabel() for ax in figure.axes[1:]] == ["water depth / m", "height / m"]
