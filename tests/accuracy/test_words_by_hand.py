"""What is said of a comparison, at the limits of its verdicts, and tables of a few cells by hand."""

import json
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from thalweg.accuracy import comparison as c, reference_comparison as r
from thalweg.accuracy.comparison_tables import ALL, WITHOUT_OUTLIERS
from thalweg.core import CoverageError, InputError
from thalweg.core.geometry import TriangleMesh
from thalweg.surface import Area

VALUE = {
    "moran_i": 0.1234, "moran_i_expected": -0.012, "moran_p": 0.5, "share_of_variance": 0.01,
    "std_of_places": 0.0123, "correlation_length": 7.4, "spread_moran_i": 0.2345, "spread_moran_p": 0.5,
    "spread_variation": 0.05, "spread_over_sigma": 0.0,
}  # fmt: skip
FACTS = "Moran's I 0.123, expected -0.01, {}; the place explains {} % of the variance, 12 mm"


@pytest.mark.parametrize(
    ("p", "share", "words"),
    [
        (0.01, 0.049, "no local accuracy dependency of the mean distance: {}"),
        (0.01, 0.05, "places differ (5.0 %), but neighbours are not alike: {}; one pass cannot tell the "
         "place from the moment"),
        (0.0099, 0.049, "a local accuracy dependency of the mean distance that is significant, but "
         "negligible: {}"),
        (0.0004, 0.05, "mean distances differ by place, or by the moment at which it was measured: {}, over "
         "7 m; one pass cannot tell the place from the moment"),
    ],
)  # fmt: skip
def test_verdicts_on_means(p, share, words):
    told = r._means_in_words(VALUE | {"moran_p": p, "share_of_variance": share})
    p_words = "p < 0.001" if p < 0.0005 else f"p = {p:.3f}"
    assert told == words.format(FACTS.format(p_words, f"{100 * share:.1f}"))


def test_a_length_that_is_not_known_is_not_told():
    told = r._means_in_words(VALUE | {"moran_p": 0.0, "share_of_variance": 0.5, "correlation_length": np.nan})
    assert "over" not in told


@pytest.mark.parametrize(
    ("p", "variation", "words"),
    [
        (0.0099, 0.1, "The spread depends on the place: {}"),
        (0.0099, 0.099, "A dependency of the spread on the place is significant, but negligible: {}"),
        (0.01, 0.1, "The spread differs by place, but neighbours are not alike: {}"),
        (0.01, 0.099, "No local dependency of the spread: {}"),
    ],
)
def test_verdicts_on_spreads(p, variation, words):
    facts = f"Moran's I 0.234, p = {p:.3f}; it varies by {100 * variation:.0f} %"
    value = VALUE | {"spread_moran_p": p, "spread_variation": variation, "spread_moran_i": 0.2341}
    assert r._spread_in_words(value) == words.format(facts)
    over = r._spread_in_words(value | {"spread_over_sigma": 1.0})
    assert over == words.format(facts).replace("spread", "spread over sigma", 1)


def test_verdicts_on_repeated_places():
    few = r._repeated_in_words({"repeated_cells": 12.0})
    assert few.startswith("12 cells that were measured again are worth too few independent ones")
    value = {"repeated_cells": 40.0, "repeated_gap": 60.4, "repeated_correlation": 0.456,
             "repeated_independent_cells": 9.6, "repeated_std_of_places": 0.0214}  # fmt: skip
    facts = (
        "40 cells measured again after 60 s and more: correlation 0.46, worth 10 independent cells, p = 0.0{}"
    )
    assert r._repeated_in_words(value | {"repeated_p": 0.05}) == (
        f"it is not shown that it is the place ({facts.format('50')})"
    )
    assert r._repeated_in_words(value | {"repeated_p": 0.049}) == (
        f"it is the place, at least in part: 21 mm come back ({facts.format('49')})"
    )


def test_the_length_of_a_correlogram():
    """Between 2 m with 0.8 and 4 m with 0.1: where it falls to 0.8 / e."""
    classes = [(1.0, 9, 0.8, 0.0), (2.0, 9, 0.7, 0.0), (4.0, 9, 0.1, 0.0), (6.0, 9, 0.0, 0.0)]
    limit = 0.8 / np.e
    assert r._length(classes) == pytest.approx(2.0 + (0.7 - limit) / 0.6 * 2.0)
    assert np.isnan(r._length(classes[:2]))
    assert np.isnan(r._length(classes[:1]))
    assert np.isnan(r._length([(1.0, 9, 0.0, 0.0), *classes[2:]]))


def cells_at(x, mean, width=1.0):
    n = len(x)
    middle = np.column_stack([x, np.zeros(n), np.zeros(n)])
    return r.Cells(middle_m=middle, mean_m=np.array(mean), std_m=np.ones(n), n=np.full(n, 20), width_m=width,
                   n_left_out=0)  # fmt: skip


def test_a_correlogram_by_hand():
    """Places 0, 1, 5 and 100 m: pairs of 1 m, of 4 and 5 m, and three beyond all classes."""
    mean = np.array([1.0, 2.0, -3.0, 0.0])
    found = r.correlogram_of(cells_at([0.0, 1, 5, 100], mean), seed=1)
    z = mean - mean.mean()
    variance = np.mean(z**2)
    expected = [
        (1.0, 1, z[0] * z[1] / variance, 0.5),
        (4.5, 2, (z[0] + z[1]) * z[2] / 2 / variance, (16 + 25) / 4),
    ]
    assert np.array(found) == pytest.approx(np.array(expected))
    assert r.correlogram_of(cells_at([0.0, 1], [2.0, 2.0]), seed=1) == [(1.0, 1, 0.0, 0.0)]
    # classes are two widths, the last one of 25 ends at 50 of them
    assert [n for _, n, _, _ in r.correlogram_of(cells_at([0.0, 49.9], [1.0, 2]), seed=1)] == [1]
    assert r.correlogram_of(cells_at([0.0, 50.1], [1.0, 2]), seed=1) == []


def test_shares_of_variance_by_hand():
    """Means 0 and 4 of 10 and 30 points with a spread of 1 and 2."""
    cells = r.Cells(
        middle_m=np.zeros((2, 3)), mean_m=np.array([0.0, 4.0]), std_m=np.array([1.0, 2.0]),
        n=np.array([10, 30]), width_m=1.0, n_left_out=0,
    )  # fmt: skip
    between = 10 * 9.0 + 30 * 1.0
    within = (9 * 1 + 29 * 4) / 38
    place = (between - within) / (40 - (100 + 900) / 40)
    assert r.share_of_variance(cells) == pytest.approx((place / (place + within), np.sqrt(place)))
    alike = r.Cells(middle_m=np.zeros((2, 3)), mean_m=np.zeros(2), std_m=np.ones(2), n=np.array([10, 30]),
                    width_m=1.0, n_left_out=0)  # fmt: skip
    assert r.share_of_variance(alike) == (0.0, 0.0)


def test_wider_cells_where_there_would_be_too_many(monkeypatch):
    x = np.repeat(np.arange(8.0) + 0.2, 10)
    places = np.column_stack([x, np.zeros(80), np.zeros(80)])
    assert (len(r.cells_of(places, x).n), r.cells_of(places, x).width_m) == (8, 1.0)
    monkeypatch.setattr(r, "_MOST_CELLS", 4)
    found = r.cells_of(places, x)
    assert (found.width_m, len(found.n)) == (2.25, 4)
    few = r.cells_of(places[:19], x[:19])
    assert (few.n.tolist(), few.n_left_out) == ([10], 9)


def test_times_of_visits_and_what_is_said_of_too_few():
    """30 cells twice, 60 s apart: maps that are one and the same."""
    rng = np.random.default_rng(1)
    cell = np.repeat(np.arange(40), 20)
    value = rng.normal(0, 1, 40)
    places = np.column_stack([cell + 0.5, 0 * cell, 0 * cell])
    t = np.tile(np.r_[np.arange(10.0), 70.0 + np.arange(10)], 40)
    how = {"width_m": 1.0, "correlation_s": 20.0, "least_points": 10}
    found = r.repeated_places(places, value[cell], t, **how)
    assert (found.n_cells, found.gap_s, found.correlation) == (40, 60.0, pytest.approx(1.0))
    assert found.std_of_places_m == pytest.approx(value.std())
    assert found.p < 1e-6
    against = r.repeated_places(places, np.where(t > 50, -1, 1) * value[cell], t, **how)
    assert (against.correlation, against.std_of_places_m) == (pytest.approx(-1.0), 0.0)
    assert against.p > 0.99
    assert r.repeated_places(places, 0 * t, t, **how).correlation is None
    assert r.repeated_places(places, value[cell], t, **how | {"correlation_s": 20.4}).n_cells == 0
    assert r.repeated_places(places, value[cell], t, **how | {"least_points": 11}).n_cells == 0


# ---------------------------------------------------------------- registration


def registration(shift=(0.003, 0.004, 0.0), cov=None, blocks=9.0, undetermined=(), f=None):
    return SimpleNamespace(
        motion=SimpleNamespace(centre_m=np.array([1.0, 2, 3]), shift_m=np.array(shift), R=np.eye(3)),
        rotation_rad=np.deg2rad([0.0, 0.3, 0.4]), cov=cov, undetermined=undetermined,
        visibility=np.arange(6.0), iterations=4, last_step_m=1e-5, n=99, blocks=blocks, blocks_needed=7,
        block_s=20.0, spread_m=5.0, significance=lambda: f,
    )  # fmt: skip


def table_of(d, outlier=None):
    n = len(d)
    return pd.DataFrame(
        {"distance_m": d, "used": True, "outlier": np.zeros(n, bool) if outlier is None else outlier}
    )


def test_what_a_registration_did():
    before, after = table_of([0.03, 0.05, 0.9], [False, False, True]), table_of([-0.01, 0.02, 0.3])
    cov = np.diag(np.square([0.001, 0.002, 0.003, *np.deg2rad([0.1, 0.2, 0.3])]))
    facts = r.registration_facts(registration(cov=cov, f=(9.0, 3.0)), before, after)
    assert json.loads(json.dumps(facts)) == facts
    axes = ("east", "north", "up")
    assert facts["centre_m"] == dict(zip(axes, (1.0, 2.0, 3.0), strict=True))
    assert list(facts["shift_m"].values()) == [0.003, 0.004, 0.0]
    assert list(facts["sigma_shift_m"].values()) == pytest.approx([0.001, 0.002, 0.003])
    assert list(facts["rotation_deg"].values()) == pytest.approx([0, 0.3, 0.4])
    assert list(facts["sigma_rotation_deg"].values()) == pytest.approx([0.1, 0.2, 0.3])
    assert (facts["hotelling_f"], facts["hotelling_f_exceeded_in_5_percent"]) == (9.0, 3.0)
    assert facts["covariance"] == cov.tolist()
    change = facts["change"][WITHOUT_OUTLIERS]
    assert (change["n_before"], change["n_after"]) == (2, 3)
    assert (change["bias_before_m"], change["bias_after_m"]) == pytest.approx((0.04, 0.31 / 3))
    assert change["share_of_bias_removed"] == pytest.approx(1 - 0.31 / 3 / 0.04)
    assert facts["change"][ALL]["bias_before_m"] == pytest.approx(0.98 / 3)
    assert facts["words"].startswith(
        "A motion of 5 mm and 0.500 degrees takes the mean offset from 40 to 103 mm (-158 % removed) and the "
        "RMSE from 41 to 174 mm. This is more than errors that change with time explain, by 9 time blocks of "
        "20 s (F = 9.0, exceeded by chance in 5 % of cases: 3.0)."
    )
    none = r.registration_facts(registration(), table_of([0.0, 0.0]), after)
    assert none["covariance"] is none["hotelling_f"] is none["hotelling_f_exceeded_in_5_percent"] is None
    assert list(none["sigma_shift_m"].values()) == [None] * 3
    assert none["change"][ALL]["share_of_bias_removed"] == 0.0


@pytest.mark.parametrize(
    ("blocks", "f", "words"),
    [
        (
            6.9,
            None,
            "too short to test that, or to give its sigmas: it is worth 7 time blocks of 20 s, 7 are",
        ),
        (7.1, None, "Sigmas cannot be given: of 7 time blocks of 20 s one alone determines"),
        (9.0, (3.0, 3.0), "This is within what errors that change with time explain, by 9"),
        (9.0, (3.01, 3.0), "This is more than errors that change with time explain"),
    ],
)
def test_whether_a_motion_is_needed(blocks, f, words):
    found = registration(blocks=blocks, f=f)
    assert words in r._significance(found, f)
    change = dict.fromkeys(("bias_before_m", "bias_after_m", "rmse_before_m", "rmse_after_m"), 0.01)
    change["share_of_bias_removed"] = 0.5
    found.undetermined = ("a shift along the bank", "a turn")
    left = " Not determined by this surface, and left: a shift along the bank; a turn."
    assert r._words(found, change, f).endswith(left)


# ---------------------------------------------------------------- clouds that do not belong to a mesh


@pytest.mark.parametrize(("offset", "told"), [(1.99, False), (2.01, True), (-2.01, True)])
def test_heights_that_are_apart_are_told(offset, told):
    words = c.heights_apart(np.array([offset, offset, 99.0]), 2.0)
    assert bool(words) == told
    if told:
        side = "above" if offset > 0 else "below"
        assert words.startswith(f"the cloud lies 2.0 m {side} the reference (median of 3 points over it)")
    assert c.heights_apart(np.zeros(0), 2.0) == ""


def test_boxes_and_distances_in_words():
    a, b = np.array([[0.0, 0], [1, 1]]), np.array([[4.0, 5], [6, 6]])
    assert c._box_distance(a, b) == c._box_distance(b, a) == 5.0
    assert c._box_distance(a, np.array([[0.5, 1.5], [2, 2]])) == 0.5
    assert c._box_distance(a, np.array([[0.5, 0.5], [2, 2]])) == 0.0
    assert (c._far(1999.9), c._far(2000.0), c._far(12345.0)) == ("1,999.9 m", "2.0 km", "12.3 km")
    assert (
        c._box(np.array([[1.0, 2, 3], [1004.5, 5, 6]]))
        == "east 1.0 to 1,004.5 m, north 2.0 to 5.0 m, up 3.0 to 6.0 m"
    )


def square_mesh():
    """10 m by 4 m: level at 1 m west of x = 0, at 3 m east of it."""
    x, y = [a.ravel() for a in np.meshgrid([-5.0, 0, 5], [0.0, 4], indexing="ij")]
    corners = np.column_stack([x, y, np.where(x > 0, 3.0, 1.0)])
    faces = np.array([[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5]])
    return TriangleMesh(vertices_m=corners, faces=faces, sigma_m=np.zeros(6))


def test_heights_over_the_mean_of_a_cell():
    """Corners of one cell of a metre have a mean height; points elsewhere have none."""
    mesh = square_mesh()
    corners = np.vstack([mesh.vertices_m, [[-4.7, 0.2, 2.0]]])
    made = TriangleMesh(vertices_m=corners, faces=mesh.faces, sigma_m=np.zeros(7))
    points = np.array([[-4.6, 0.1, 9.0], [4.9, 2.0, 9.0], [2.5, 2.0, 9.0], [-99.0, 0, 9.0]])
    assert c.HeightMap(made).above(points) == pytest.approx([9.0 - 1.5])


def test_coverage_of_an_area():
    """The western half of the mesh in a polygon of twice its size; one of its two triangles is seen."""
    mesh = square_mesh()
    area = Area(polygon_en_m=np.array([[-5.0, -4], [-0.01, -4], [-0.01, 4], [-5.0, 4]]))
    middle = mesh.vertices_m[mesh.faces].mean(axis=1)
    found = c.coverage(middle[:1], mesh, area)
    assert found == pytest.approx(
        {"reference_area_m2": 20.0, "without_points": 0.5, "without_reference": 1 - 20 / (4.99 * 8)}
    )
    assert c.coverage(np.zeros((0, 3)), mesh, area)["without_points"] == 1.0
    # the whole mesh: the eastern triangles rise by 2 m over 5 m
    whole = c.coverage(middle, mesh, Area())
    assert whole == pytest.approx({"reference_area_m2": 20 + 20 * np.hypot(1, 0.4), "without_points": 0.0})
    small = Area(polygon_en_m=np.array([[-4.0, 1], [-3, 1], [-3, 1.99], [-4, 1.99]]))
    assert "without_reference" not in c.coverage(middle, mesh, small)
    wide = Area(polygon_en_m=np.array([[-6.0, -1], [6, -1], [6, 5], [-6, 5]]))
    assert c.coverage(middle, mesh, wide)["without_reference"] == pytest.approx(1 - 40 / 72)


def test_a_few_sigmas_as_errors_that_95_percent_stay_below():
    sigmas = {
        "sigma_east": np.array([0.03, 0.0, 1.0]), "sigma_north": np.array([0.04, 0.02, 1.0]),
        "sigma_up": np.array([0.01, 0.02, 0.06]),
    }  # fmt: skip
    found = c._predicted_95(sigmas)
    circle = np.sqrt(-2 * np.log(0.05))
    plan = circle * np.sqrt([0.0025 / 2, 0.0004 / 2, 1.0])
    assert found["plan_median_m"] == pytest.approx(plan[0], rel=1e-4)
    assert found["plan_p95_m"] == pytest.approx(plan[0] + 0.9 * (plan[2] - plan[0]), rel=1e-4)
    assert found["height_median_m"] == pytest.approx(1.95996 * 0.02, rel=1e-4)
    assert c._predicted_95({name: np.zeros(0) for name in sigmas}) == {}


def test_settings_of_a_comparison():
    accuracy = c.Accuracy(correlation_s="auto", max_distance_m=1.5)
    made = c.ComparisonSettings.of(
        accuracy, c.ReferenceSettings(sigma_m=0.25), 7, estimated_correlation_s=3.5
    )
    assert (made.correlation_s, made.reference_sigma_m, made.seed, made.max_distance_m) == (3.5, 0.25, 7, 1.5)
    own = c.ComparisonSettings.of(
        c.Accuracy(correlation_s=9.0), c.ReferenceSettings(), estimated_correlation_s=3.5
    )
    assert (own.correlation_s, own.seed) == (9.0, 0)


def test_why_no_point_lies_in_an_area(tmp_path):
    cloud = np.array([[0.0, 0, 5], [10, 10, 8]])
    near = np.array([[20.0, 0], [30, 0], [30, 10]])
    for area, words in (
        (Area(polygon_en_m=near), "the area is 10.0 m away from it"),
        (Area(polygon_en_m=near + np.array([30_000.0, 0])), "set accuracy.area.frame to map"),
        (Area(lowest_m=8.5), "its heights, 5.0 to 8.0 m, miss those of the area by 0.5 m"),
        (Area(highest_m=4.5), "miss those of the area by 0.5 m"),
        (Area(lowest_m=6.0), "the area lies in a gap of it"),
    ):
        with pytest.raises(CoverageError, match=words):
            c._refuse_area(tmp_path, area, cloud)
    with pytest.raises(CoverageError) as told:
        c._refuse_area(tmp_path, Area(polygon_en_m=near + np.array([19_000.0, 0])), cloud)
    assert "frame to map" not in told.value.cure
    for offset, lower, higher in ((20.0, "reference", "cloud"), (-20.0, "cloud", "reference")):
        with pytest.raises(InputError) as told:
            c._refuse_heights(tmp_path, offset, 5)
        assert f"the lower ones: here those of the {lower}" in told.value.cure
        assert f"they are the higher ones: here those of the {higher}" in told.value.cure
