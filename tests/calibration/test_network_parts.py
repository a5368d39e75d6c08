"""Parts of the adjustment of a field by hand: its frame, its scale bars, its tables and covariances."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest

from tests.calibration import field_blocks as blocks
from thalweg.calibration.field import Layout, Problem, State, measure_field, network_of
from thalweg.calibration.field.bundle import Bar
from thalweg.calibration.field.description import ScaleBar
from thalweg.calibration.field.network import _frame, _scaled
from thalweg.core import ArrayF, Camera, GeometryError, GlobalTest, Rigid, rotation_opk

# ---------------------------------------------------------------- the frame

CENTRES = {
    3: np.array([4.0, 0.0, 1.0]),
    5: np.array([-3.0, 2.0, 0.5]),
    8: np.array([0.0, -4.0, 2.0]),
    9: np.array([1.0, 5.0, 0.0]),
}
PLACE = Rigid(R=rotation_opk(0.3, -0.5, 2.0), shift_m=np.array([10.0, -20.0, 3.0]))
FACTOR = 0.9
CORNERS = 0.1 * np.array([[1.0, 1.0, 0.0], [-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0]])


def state(X: ArrayF, R: ArrayF | None = None) -> State:
    R = np.eye(3)[None] if R is None else R
    return State((), R, np.zeros((len(R), 3)), X)


def field_points() -> tuple[Any, ArrayF]:
    """Markers with four points around their centres, in a frame that ``PLACE (FACTOR x)`` makes known."""
    points = tuple((marker, corner) for marker in CENTRES for corner in range(4))
    there = np.concatenate([centre + CORNERS for centre in CENTRES.values()])
    return SimpleNamespace(points=points), PLACE.inverse().apply(there) / FACTOR


ONE = np.array([True])


def test_the_frame_is_that_of_the_approximate_centres():
    block, X = field_points()
    factor, T = _frame(block, state(X), ONE, CENTRES)
    assert factor == pytest.approx(FACTOR)
    np.testing.assert_allclose(T.R, PLACE.R, atol=1e-12)
    np.testing.assert_allclose(T.shift_m, PLACE.shift_m, atol=1e-12)
    factor, T = _frame(block, state(X * FACTOR), ONE, CENTRES, scaled=False)
    assert factor == 1.0
    np.testing.assert_allclose(T.apply(X * FACTOR), PLACE.apply(X * FACTOR), atol=1e-12)
    # centres of another scale do not stretch the field
    far = {marker: 1.3 * centre for marker, centre in CENTRES.items()}
    assert _frame(block, state(X * FACTOR), ONE, far, scaled=False)[0] == 1.0
    assert _frame(block, state(X * FACTOR), ONE, far)[0] == pytest.approx(1.3)


@pytest.mark.parametrize(
    "spoilt", ["one point unsolved", "three points", "stated elsewhere", "not in the field"]
)
def test_a_marker_that_is_not_whole_or_not_there_has_no_part_in_the_frame(spoilt):
    """The other three give the frame; of the fourth, counted with them, the mean would be elsewhere."""
    block, X = field_points()
    centres = dict(CENTRES)
    X[12:] += [0.5, -0.3, 0.4]
    if spoilt == "one point unsolved":
        X[13] = np.nan
    elif spoilt == "three points":
        block, X = SimpleNamespace(points=block.points[:-1]), X[:-1]
    elif spoilt == "stated elsewhere":
        centres[9] = np.array([500.0, 0.0, 0.0])
    else:
        del centres[9]
        centres[77] = np.zeros(3)
    factor, T = _frame(block, state(X), ONE, centres)
    assert factor == pytest.approx(FACTOR)
    np.testing.assert_allclose(T.apply(FACTOR * X[:12]), PLACE.apply(FACTOR * X[:12]), atol=1e-9)


@pytest.mark.parametrize("centres", [None, {k: CENTRES[k] for k in (3, 5)}, {1: np.zeros(3), 2: np.ones(3)}])
def test_without_three_centres_the_field_is_upright_as_the_pictures_are(centres):
    """Two cameras, tilted to either side; a third that takes no part lies on its side.

    x goes along the field, 10 m long and 2 m wide; the median of the coordinates is the origin.
    """
    level = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])  # y of the picture is down
    tilt = [rotation_opk(0.2 * sign, 0.0, 0.0) @ level for sign in (1, -1)]
    lying = np.array([[0.0, -1.0, 0], [0, 0, 1.0], [-1.0, 0, 0]])
    own = np.array([[-5.0, 0, 0.3], [0, 1.0, 2.0], [0, 0, 1.0], [5.0, 0.2, 0.1], [0.4, -1.0, 4.0]])
    X = own @ rotation_opk(0.0, 0.0, 0.7).T + 7.0
    block = SimpleNamespace(points=tuple((k, 0) for k in range(6)))
    turned = rotation_opk(0.4, 0.6, -1.0)  # the frame that the network began in
    x = state(np.vstack([X @ turned.T, [np.nan] * 3]), turned @ np.stack([*tilt, lying]))
    factor, T = _frame(cast(Any, block), x, np.array([True, True, False]), centres)
    assert factor == 1.0
    found = T.apply(X @ turned.T)
    np.testing.assert_allclose(found[:, 2] - found[0, 2], own[:, 2] - own[0, 2], atol=1e-12)
    np.testing.assert_allclose(T.apply(np.median(X @ turned.T, axis=0)[None]), 0.0, atol=1e-12)
    assert np.linalg.det(T.R) == pytest.approx(1.0)
    # the longest horizontal extent: least squares of these points lie within 3 degrees of their own x
    assert abs((found[3] - found[0])[0]) > 9.98
    flat = found[:, :2] - found[:, :2].mean(axis=0)
    assert (flat[:, 0] * flat[:, 1]).sum() == pytest.approx(0.0, abs=1e-9)


# ---------------------------------------------------------------- scale bars


def bars(*rows: tuple[str, str, str, float]) -> Any:
    return SimpleNamespace(
        scale_bars=tuple(
            ScaleBar(name=n, start=a, end=b, length_m=length, sigma_m=1e-3) for n, a, b, length in rows
        )
    )


def scaled(
    field: Any, *, cov: ArrayF | None = None
) -> tuple[tuple[Bar, ...], Any, list[tuple[str, str, str]]]:
    """Points 1/0 .. 1/3 and 2/0 in a network that is half as large as the field."""
    points = ((1, 0), (1, 1), (1, 2), (1, 3), (2, 0))
    X = np.array([[0.0, 0, 0], [1.0, 0, 0], [0, 2.0, 0], [0, 0, 3.0], [3.0, 4.0, 0]])
    layout = SimpleNamespace(point=lambda p: slice(2 + 3 * p, 5 + 3 * p), names="." * 17)
    adjusted = SimpleNamespace(
        x=SimpleNamespace(X=X), cov=np.zeros((17, 17)) if cov is None else cov, names="." * 17
    )
    rejected: list[tuple[str, str, str]] = []
    problem = SimpleNamespace(block=SimpleNamespace(points=points))
    used, scale = _scaled(field, *cast(Any, (problem, adjusted, layout, rejected)))
    return used, scale, rejected


def test_bars_between_measured_points_give_the_scale():
    used, scale, rejected = scaled(
        bars(("A", "1/0", "1/1", 2.0), ("B", "1/2", "1/0", 4.0), ("C", "1/1", "1/3", 6.3))
    )
    assert used[:2] == (Bar("A", 0, 1, 2.0, 1e-3), Bar("B", 2, 0, 4.0, 1e-3))
    # sqrt 10 long in the network: 6.3246 m by the others, and the bar is stated 24.6 mm shorter
    assert len(used) == 2
    assert scale.factor == pytest.approx(2.0)
    assert rejected == [
        ("scale bar", "C", "its length is -24.56 mm off what the other bars say: measure it again")
    ]
    used, scale, rejected = scaled(bars(("A", "1/0", "1/1", 2.0)))
    assert (len(used), rejected) == (1, [])
    assert scale.sigma == pytest.approx(1e-3)


def test_errors_of_the_ends_are_part_of_the_scale():
    """From (1, 0, 0) to (0, 2, 0): only what lies along (-1, 2, 0) / sqrt 5 counts, of both ends together."""
    cov = np.zeros((17, 17))
    cov[5:8, 5:8] = np.diag([4e-6, 1e-6, 9e-6])  # of point 1/1, the second
    cov[8:11, 8:11] = np.diag([1e-6, 2e-6, 7e-6])
    cov[5, 8] = cov[8, 5] = 1e-6
    length, stated = np.sqrt(5.0), 2 * np.sqrt(5.0)
    _, scale, _ = scaled(bars(("A", "1/1", "1/2", stated)), cov=cov)
    variance = (4e-6 + 1e-6 - 2 * 1e-6) / 5 + 4 * (1e-6 + 2e-6) / 5
    assert scale.factor == pytest.approx(2.0)
    assert scale.sigma == pytest.approx(np.sqrt(1e-6 + 4 * variance) / length, rel=1e-9)


def test_a_bar_without_one_of_its_ends_is_named_and_left_out():
    lost = ("A", "1/0", "9/0", 2.0), ("B", "8/1", "1/1", 2.0), ("C", "8/1", "9/0", 2.0)
    used, scale, rejected = scaled(bars(*lost, ("D", "1/0", "2/0", 10.0)))
    assert used == (Bar("D", 0, 4, 10.0, 1e-3),)
    assert scale.factor == pytest.approx(2.0)
    assert rejected == [
        ("scale bar", name, f"its mark {marks} was not measured in 3 good pictures")
        for name, marks in (("A", "9/0"), ("B", "8/1"), ("C", "8/1 and 9/0"))
    ]


def test_a_field_whose_bars_were_not_measured_is_refused_with_the_reasons():
    with pytest.raises(GeometryError, match=r"no scale bar can be used \(A: its mark 9/0 was not measured"):
        scaled(bars(("A", "1/0", "9/0", 2.0)))
    with pytest.raises(GeometryError, match=r"^no scale bar: expected at least two|^no scale bar[^ ]"):
        scaled(bars())


# ---------------------------------------------------------------- tables


def test_tables_of_a_network_by_hand():
    """One camera with two free parameters, two pictures, two points, four marks of which one is not used."""
    camera = Camera(
        model="perspective",
        size_px=(400, 300),
        parameters=np.array([100.0, 120, 200, 150, 0, 0, 0, 0, 0]),
        name="c",
    )
    u = 2 + 2 * 6 + 2 * 3
    root = np.random.default_rng(3).standard_normal((u, u))
    cov = 1e-6 * root @ root.T
    cov[14, 15] += 1e-12  # not quite symmetric, as sums are
    x = State(
        (camera,),
        np.stack([np.eye(3)] * 2),
        np.array([[0.0, 0, 0], [1.0, 0, 0]]),
        np.array([[0.0, 0, 2], [1.0, 1, 4]]),
    )
    pictures = np.array([[200.0, 150], [225.0, 180], [150.0, 150], [200.0, 180]])  # by hand: f x / z + c
    v = np.array([[0.3, -0.4], [0.0, 0.5], [0.6, 0.0], [30.0, 40.0]])
    block = SimpleNamespace(
        images=("p.jpg", "q.jpg"),
        points=((7, 1), (9, 3)),
        image=np.array([0, 0, 1, 1]),
        point=np.array([0, 1, 0, 1]),
        xy_px=pictures + v,
        sigma_px=np.array([0.5, 0.25, 0.3, 1.0]),
    )
    problem = Problem(
        cast(Any, block), np.array([0, 0]), np.array([True, True, True, False]), (("fy", "k1"),)
    )
    layout = Layout(problem, (camera,))
    adjusted = SimpleNamespace(
        x=x,
        cov=cov,
        names=layout.names,
        redundancy=5.0,
        sigma0_squared=1.44,
        group_sigma0={"scale bars": 0.7},
        global_test=lambda: GlobalTest(sigma0=1.2, low=0.5, high=1.5),
    )
    rejected = [("image", "z.jpg", "r"), ("mark", "m", "s"), ("mark", "n", "t")]
    scale = SimpleNamespace(sigma=3e-5, used=np.array([True, False, True]))
    found = network_of(*cast(Any, (problem, adjusted, layout, rejected, scale)))

    own = np.zeros((9, 9))
    own[np.ix_([1, 4], [1, 4])] = cov[:2, :2]
    np.testing.assert_allclose(found.cameras["c"].cov, own)
    for i, image in enumerate(block.images):
        np.testing.assert_array_equal(found.poses[image].shift_m, x.C[i])
        np.testing.assert_allclose(found.poses[image].cov, cov[2 + 6 * i : 8 + 6 * i, 2 + 6 * i : 8 + 6 * i])
    np.testing.assert_array_equal(found.points_pcs, x.X)
    assert found.points == block.points
    half = (cov[14:, 14:] + cov[14:, 14:].T) / 2
    np.testing.assert_allclose(found.cov_points, half, rtol=1e-15)
    table = found.residuals
    rows = [["p.jpg", 7, 1], ["p.jpg", 9, 3], ["q.jpg", 7, 1], ["q.jpg", 9, 3]]
    assert table[["image", "marker", "corner"]].to_numpy().tolist() == rows
    # observed minus computed
    np.testing.assert_allclose(table[["vx_px", "vy_px"]].to_numpy(), v, atol=1e-12)
    np.testing.assert_allclose(table["standardised"], [1.0, 2.0, 2.0, 50.0])
    assert table["sigma_px"].tolist() == block.sigma_px.tolist()
    assert table["used"].tolist() == [True, True, True, False]
    assert found.rejected.to_numpy().tolist() == [list(row) for row in rejected]
    variances = np.diag(half)
    assert found.report == {
        "images": 2,
        "points": 2,
        "markers": 2,
        "marks": 4,
        "marks_rejected": 1,
        "unknowns": u,
        "redundancy": 5.0,
        "sigma0": pytest.approx(1.2),
        "sigma0_band": [0.5, 1.5],
        # of the six coordinates and three sigmas that were used
        "mark_rms_px": pytest.approx(np.sqrt((0.25 + 0.25 + 0.36) / 6)),
        "mark_sigma_px": pytest.approx(np.sqrt((0.25 + 0.0625 + 0.09) / 3)),
        "object_sigma_mean_mm": pytest.approx(1000 * np.sqrt(variances.mean())),
        "object_sigma_max_mm": pytest.approx(1000 * np.sqrt(variances.max())),
        "rejected": {"image": 1, "mark": 2},
        "scale_sigma": 3e-5,
        "scale_bars_used": 2,
        "scale_bar_sigma0": 0.7,
    }
    assert "scale_sigma" not in network_of(*cast(Any, (problem, adjusted, layout, rejected, None))).report


# ---------------------------------------------------------------- all together


def test_a_field_in_the_frame_of_centres():
    """One picture of a lone marker is left out; the third bar is stated 5 mm too long and named."""
    sheets, field = blocks.yard(3, cones=3, per_cone=5, flat=8)
    marks = blocks.observe(sheets, blocks.stations(3, 14, 7.0), blocks.SLR, 3)
    lone = marks[marks["image"] == marks["image"].iloc[0]].head(4).assign(image="X.jpg")
    stated = field.scale_bars
    field = replace(field, scale_bars=(*stated[:2], replace(stated[2], length_m=stated[2].length_m + 0.005)))
    start = blocks.SLR.with_parameters(blocks.SLR.parameters * np.r_[1.01, 1.01, np.ones(7)])
    found = measure_field(
        pd.concat([marks, lone], ignore_index=True),
        {"slr": start},
        field,
        approximate=blocks.rtk_targets(sheets, [0, 4, 7, 11, 82]),
    )
    truth = blocks.truth_of(sheets, found.points)
    # the datum is that of the centres to their own errors, which are those of a first network
    np.testing.assert_allclose(found.points_pcs, truth, atol=0.05)
    factor, _, _ = blocks.similarity(truth, found.points_pcs)
    assert factor == pytest.approx(1.0, abs=4 * found.scale.sigma)
    assert found.scale.used.tolist() == [True, True, False]
    ((_, name, reason),) = [row for row in found.rejected.to_numpy() if row[0] == "scale bar"]
    assert (name, reason[:17]) == ("S3", "its length is +5.") or (name, reason[:17]) == (
        "S3",
        "its length is +4.",
    )
    assert "X.jpg" in found.rejected.loc[found.rejected["what"] == "image", "name"].tolist()
    assert found.report["scale_bars_used"] == 2
    assert found.report["redundancy"] > 0
    assert found.changes


def test_two_cameras_need_two_names():
    sheets, field = blocks.yard(3, cones=3, per_cone=5, flat=8)
    marks = blocks.observe(sheets, blocks.stations(3, 14, 7.0), blocks.SLR, 3)
    marks.loc[marks["image"] > "IMG_0006.jpg", "camera"] = "other"
    with pytest.raises(GeometryError, match="two cameras are called"):
        measure_field(marks, {"slr": blocks.SLR, "other": blocks.SLR}, field)
