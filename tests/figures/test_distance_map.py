"""The map of distances: signs, sides, counts, and what is drawn where."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.figures.conftest import artists as by_gid
from thalweg.core import CoverageError, InputError
from thalweg.figures import count
from thalweg.figures.accuracy import centimetres, compared, round_above, round_limit_m
from thalweg.figures.accuracy.distance_map import distance_map, strips, view_text
from thalweg.figures.accuracy.distances import bank_frame_of


def test_the_title_states_n_mean_and_rmse(made, look):
    figure = distance_map(made.table, made.mesh, made.frame, title="Test", twin=True)
    used = made.table[made.table["used"]]
    d = used["distance_m"].to_numpy()
    title = look.texts(figure)
    assert f"n = {len(used):,}".replace(",", " ") in title
    assert f"mean {100 * d.mean():+.1f} cm, RMSE {100 * np.sqrt(np.mean(d**2)):.1f} cm" in title


def test_the_ends_of_the_scale_name_and_count_their_sides(made):
    made.table["distance_m"] = np.where(made.bank[:, 0] > 0, 0.3, -0.08)
    figure = distance_map(made.table, made.mesh, made.frame, limit_m=0.1)
    (left,), (right,) = by_gid(figure, "end-left"), by_gid(figure, "end-right")
    assert left.get_text().startswith("behind")
    assert left.get_text().endswith("n = 0")
    n = int((made.table["used"] & (made.bank[:, 0] > 0)).sum())
    assert right.get_text().startswith("in front")
    assert right.get_text().endswith(f"n = {count(n)}")


def test_points_left_out_at_the_border_are_dark_and_counted(made):
    figure = distance_map(made.table, made.mesh, made.frame)
    n = int((made.table["at_border"] & ~made.table["used"]).sum())
    assert f"left out at its border, n = {count(n)}" in figure.axes[0].get_title(loc="left")
    # Those that are too far are counted for that, and not for the border.
    near = distance_map(made.table, made.mesh, made.frame, max_distance_m=0.0)
    assert "border" not in near.axes[0].get_title(loc="left")


def test_strips_cover_the_bank_at_one_scale(rng):
    bank = np.stack([rng.uniform(-200, 200, 50_000), rng.uniform(0, 9, 50_000)], axis=1)
    # A bend: up the slope the bank lies elsewhere at every place.
    bank[:, 1] += 0.0002 * bank[:, 0] ** 2
    pieces = strips(bank)
    assert len(pieces) > 3
    assert pieces[0].along_m[0] == bank[:, 0].min()
    assert pieces[-1].along_m[1] == bank[:, 0].max()
    assert_allclose([p.size_m[0] for p in pieces], pieces[0].size_m[0])
    assert [a.along_m[1] for a in pieces[:-1]] == [b.along_m[0] for b in pieces[1:]]
    for piece in pieces:
        inside = (bank[:, 0] >= piece.along_m[0]) & (bank[:, 0] <= piece.along_m[1])
        up = bank[inside, 1]
        shown = (up >= piece.up_slope_m[0]) & (up <= piece.up_slope_m[1])
        assert shown.mean() >= 0.98  # 1 % above and below at most
    assert len(strips(bank[:, ::-1])) == 1


def test_nothing_compared_is_refused(made):
    with pytest.raises(CoverageError, match=r"none of 20000 points was compared.*accuracy\.area"):
        compared(made.table.assign(used=False))


def test_the_bank_frame_comes_from_the_facts(made):
    facts = {"bank_frame": {"origin_m": [1.0, 2.0, 3.0], "R_bank_wcs": made.frame.R_bank_wcs.tolist()}}
    frame = bank_frame_of(facts)
    assert_array_equal(frame.R_bank_wcs, made.frame.R_bank_wcs)
    assert_array_equal(frame.origin_m, [1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="bank frame"):
        bank_frame_of({})


def test_words_and_limits(made):
    assert view_text(made.frame) == "looking toward 180°"  # the bank lies south of the river
    assert centimetres(-0.0412, sign=True) == "\N{MINUS SIGN}4.1\N{NO-BREAK SPACE}cm"
    assert [round_above(x) for x in (0.1, 0.101, 0.16, 0.5, 0.51)] == [0.1, 0.15, 0.2, 0.5, 1.0]
    # Mean 3 cm and three NMAD of 5 cm are 18 cm.
    assert round_limit_m(made.table["distance_m"].to_numpy()) == 0.2
    assert round_limit_m(np.zeros(5)) == 1e-3
