"""Places, water and banks of a river in the map, against the frame's own turn of each point."""

import numpy as np
import pandas as pd
import pytest

from tests.fusion.conftest import FRAME, GRID, Arc
from thalweg.core import CoverageError, InputError
from thalweg.fusion import River, read_river

LONG = Arc(length_m=9000.0, radius_m=np.inf)
"""So far from the origin of the frame that a metre of height moves a place of the map by more than 1 mm."""
UP = np.array([-2.0, -2.0, -2.0, 28.0])


@pytest.fixture
def falling():
    """Banks 12 m apart, one end 30 m above the rest; the left one is given from its end."""
    s = np.array([0.0, 3000.0, 6000.0, 9000.0])
    sides = [
        pd.DataFrame({"side": side, "s_m": s, "east_m": s, "north_m": n, "up_m": UP})
        for side, n in (("left", [7.0, 8.0, 9.0, 10.0]), ("right", [-5.0, -4.0, -3.0, -2.0]))
    ]
    sides[0] = sides[0][::-1]
    sides[1] = sides[1][1:]
    return pd.concat(sides, ignore_index=True).assign(sigma_across_m=0.1, seen=True)


@pytest.fixture
def long_river(falling):
    return River(flow=LONG, banks=falling, frame=FRAME, crs=GRID, separation=(40.0, 1e-6, -2e-6))


def test_places_along_and_across_are_those_of_the_map(long_river):
    """At the mean height of the banks' places."""
    mean = (2 * UP.sum() + 2.0) / 7
    s, n = np.array([100.0, 8900.0]), np.array([4.0, -3.0])
    local = np.column_stack([s, n, np.full(2, mean)])
    expected = FRAME.to_map(local, GRID)
    assert long_river.to_map(s, n) == pytest.approx(expected[:, :2], abs=1e-6)
    assert long_river.to_map(8900.0, [-3.0, 0.0])[0] == pytest.approx(expected[1, :2], abs=1e-6)
    # heights above the ellipsoid on the way back: 30 m more by the frame's origin, 6 m of it by the curvature
    back = long_river.to_flow(expected[:, :2])
    height = np.full(2, FRAME.h_ell_m + mean)
    places = FRAME.from_map(np.column_stack([expected[:, :2], height]), GRID)[:, :2]
    assert np.column_stack(back[:2]) == pytest.approx(places, abs=1e-6)
    assert not back[2].any()


def test_banks_span_and_outline(long_river, falling):
    left, right = long_river.offsets_m([0.0, 4500.0, 9000.0])
    assert left == pytest.approx([7.0, 8.5, 10.0])
    assert right == pytest.approx([-4.0, -3.5, -2.0])
    assert long_river.span_m == (3000.0, 9000.0)
    assert long_river.shore_m() == pytest.approx(falling[["east_m", "north_m", "up_m"]].to_numpy())
    s = np.array([0.0, 3000.0, 6000.0, 9000.0])
    ring = np.column_stack([[*s, *s[:0:-1]], [7.0, 8.0, 9.0, 10.0, -2.0, -3.0, -4.0], [*UP, *UP[:0:-1]]])
    assert long_river.outline_m() == pytest.approx(FRAME.to_map(ring, GRID)[:, :2], abs=1e-6)


def test_the_level_is_smoothed_over_five_places_and_counts_from_the_zero_of_the_model(long_river):
    """Seven places in order of s; means of those within two places: of the last three 18 m, of five -2 m."""
    up = np.array([-2.0, -2, -2, -2, -2, 28, 28])
    s = np.array([0.0, 3000, 3000, 6000, 6000, 9000, 9000])
    means = [up[max(k - 2, 0) : k + 3].mean() for k in range(7)]
    for at, expected in ((0.0, means[0]), (1500.0, (means[0] + means[1]) / 2), (9000.0, means[6])):
        place = FRAME.to_map(np.array([[at, 0.0, expected]]), GRID)[0]
        zero = 40.0 + 1e-6 * place[0] - 2e-6 * place[1]
        assert long_river.level_m(at) == pytest.approx(place[2] - zero, abs=1e-6)
        assert np.shape(long_river.level_m(at)) == ()
    assert long_river.level_m([0.0, 9000.0]).shape == (2,)
    assert s[-1] == LONG.length_m


def test_rivers_that_cannot_be(falling, tmp_path):
    known = {"flow": LONG, "frame": FRAME, "crs": GRID}
    with pytest.raises(InputError, match="banks without up_m, seen"):
        River(banks=falling.drop(columns=["up_m", "seen"]), **known)
    one = falling[(falling["side"] == "left") | (falling["s_m"] == 6000.0)]
    with pytest.raises(InputError, match="no right bank line"):
        River(banks=one, **known)
    two = falling[(falling["side"] == "left") | (falling["s_m"] >= 6000.0)]
    assert len(River(banks=two, **known).banks) == 6
    crossed = falling.assign(north_m=falling["north_m"].where(falling["s_m"] < 8000, -falling["north_m"]))
    with pytest.raises(InputError, match=r"lies right of the right one at (\d+) m") as told:
        River(banks=crossed, **known)
    # 9 to -10 m on the left, -3 to 2 m on the right: they meet half way
    assert int(str(told.value).split(" one at ")[1].split()[0]) == pytest.approx(
        6000 + 3000 * 12 / 24, abs=46
    )
    with pytest.raises(InputError, match="no such file"):
        read_river(LONG, tmp_path / "b.csv", FRAME, GRID)
    falling.to_csv(tmp_path / "b.csv", index=False)
    read = read_river(LONG, tmp_path / "b.csv", FRAME, GRID, separation=(1.0, 2.0, 3.0))
    pd.testing.assert_frame_equal(read.banks, falling)
    assert read.separation == (1.0, 2.0, 3.0)
    for column in ("s_m", "east_m", "north_m", "up_m"):
        falling.assign(**{column: [np.nan, *falling[column][1:]]}).to_csv(tmp_path / "b.csv", index=False)
        with pytest.raises(CoverageError, match="empty places"):
            read_river(LONG, tmp_path / "b.csv", FRAME, GRID)
