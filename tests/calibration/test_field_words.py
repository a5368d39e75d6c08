"""What people are told of a measured field: sizes of sheets, notes, counts of pictures, facts as a file."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from thalweg.calibration import MarkerLayout
from thalweg.calibration.field.datum import FieldDatum
from thalweg.calibration.field.description import FieldCone, FieldDescription
from thalweg.calibration.field.job import (
    MeasuredField,
    field_notes,
    overview,
    point_table,
    read_facts,
    read_place,
    require_size,
    sheet_sizes,
    with_overview,
    write_facts,
)
from thalweg.calibration.field.points import FieldPoints
from thalweg.core import GeometryError, Rigid, exp_rotation

LAYOUT = MarkerLayout(module_m=0.01, sizes=((10, 19, 0.02),))
FIELD = FieldDescription(
    layout=LAYOUT,
    cones=(
        FieldCone(name="A", markers=(0, 1, 2), half_angle_rad=0.4, length_m=0.7),
        FieldCone(name="B", markers=(3, 4), half_angle_rad=0.4, length_m=0.7),
    ),
)


def network(size: dict[int, float], *, sigma_mm: float = 0.3, bars: tuple[bool, ...] | None = (True, True)):
    """Sheets of these sizes against the stated ones; of marker 2 a saddle is missing."""
    points = tuple((m, c) for m in size for c in range(4) if (m, c) != (2, 3))
    pcs = np.array([size[m] * LAYOUT.saddles_m(m)[c] + [m, 0, 0] for m, c in points])
    scale = None
    if bars is not None:
        scale = SimpleNamespace(
            used=np.array(bars), off_m=np.array([0.001, np.nan]), sigma_off_m=np.array([0.002, np.inf])
        )
    rejected = pd.DataFrame(
        [("scale bar", "b1", "too long")]
        + [("point", f"{k}/0", "few pictures") for k in range(9)]
        + [("point", "9/1", "gross errors")],
        columns=["what", "name", "reason"],
    )
    return SimpleNamespace(
        points=points, points_pcs=pcs, changes=(), rejected=rejected, scale=scale,
        report={"object_sigma_mean_mm": sigma_mm},
    )  # fmt: skip


def test_sizes_of_sheets_are_medians_by_their_modules():
    found = sheet_sizes(network({0: 1.02, 1: 1.02, 2: 1.5, 12: 0.9}), FIELD)
    # eight sides of 1.02 and two of 1.5
    assert found == {0.01: pytest.approx(1.02), 0.02: pytest.approx(0.9)}
    for sizes, refused in (
        ({0.01: 1.49}, False),
        ({0.01: 1.51}, True),
        ({0.01: 1 / 1.51}, True),
        ({0.01: 1 / 1.49}, False),
        ({0.01: 1000.0, 0.02: 1.1}, False),
        ({}, False),
    ):
        if not refused:
            require_size(sizes)
            continue
        with pytest.raises(GeometryError, match=r"are (1\.51|0\.662) times \(modules of 10 mm\) the size"):
            require_size(sizes)


def test_notes_of_a_field():
    sizes = {0: 1.0, 1: 1.0, 2: 1.0, 3: 1.0}
    place = SimpleNamespace(rejected=(("T1", "10 mm off"),), sigma_scale=0.002)
    of = network(sizes)
    of.changes = tuple(SimpleNamespace(words=f"change {k}", clear=bool(k)) for k in (0, 1))
    notes = field_notes(of, place, FIELD, {0.01: 1.02})
    assert notes == [
        "change 1",
        "scale bar b1: too long",
        "9 points have few pictures: 0/0, 1/0, 2/0, 3/0, 4/0, 5/0, 6/0, 7/0 ...",
        "1 points have gross errors: 9/1",
        "cone B: 1 of 2 markers were measured; take more pictures of it",
        "target T1: 10 mm off",
    ]
    less = replace(FIELD, cones=FIELD.cones[:1])
    for ratio, told in ((1.029, False), (1.031, True), (0.971, False), (0.969, True)):
        words = field_notes(of, None, less, {0.01: 1.0, 0.02: ratio})
        assert any("the printed markers are" in note for note in words) is told
    assert "1 times (modules of 10 mm) and 0.969 times (modules of 20 mm) the size" in words[-1]
    for sigma, told in ((0.99, False), (1.01, True)):
        words = field_notes(network(sizes, sigma_mm=sigma), None, less, {})
        assert (f"object points have a sigma of {sigma:.2f} mm on average" in words[-1]) is told
    # one bar of two: three sigmas of the targets' scale, or nothing shows its error
    one = network(sizes, bars=(True, False))
    assert "the targets show an error of its length of 0.6% or more" in field_notes(one, place, less, {})[-1]
    assert "nothing shows it, and the whole field is as wrong" in field_notes(one, None, less, {})[-1]
    for bars in (None, (True, True)):
        assert not any(
            "scale bar could" in n for n in field_notes(network(sizes, bars=bars), place, less, {})
        )


def marks_of(seen: dict[str, list[int]]) -> pd.DataFrame:
    rows = [(image, m, c) for image, markers in seen.items() for m in markers for c in range(4)]
    return pd.DataFrame(rows, columns=["image", "marker", "corner"])


def test_pictures_and_markers_are_counted():
    seen = {"a": [0, 1, 2, 3], "b": [0, 1, 2, 3], "c": [0, 1, 4], "d": [0, 5]}
    words, advice = overview(marks_of(seen))
    assert words == (
        "4 pictures show 6 markers: 2 stand in 3 pictures or more, 2 in two, 2 in one; "
        "2 pictures show fewer than 4 markers (c, d)"
    )
    assert advice == (
        "take the markers 2, 3, 4, 5 from two more sides; "
        "take 16 pictures more, from all sides and two heights"
    )
    enough = {f"{k:02d}": [0, 1, 2, 3] for k in range(20)}
    assert overview(marks_of(enough)) == (
        "20 pictures show 4 markers: 4 stand in 3 pictures or more, 0 in two, 0 in one",
        "",
    )
    poor = {f"{k:02d}": [k] for k in range(19)}
    words, advice = overview(marks_of(poor))
    assert "19 pictures show fewer than 4 markers (00, 01, 02, 03 ...)" in words
    assert (
        "take the markers 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11 ... from two more sides; take 1 pictures"
        in advice
    )
    error = with_overview(GeometryError("bent", expected="flat", where="here", cure="Look."), marks_of(seen))
    assert (error.found[:6], error.expected, error.where) == ("bent; ", "flat", "here")
    assert error.cure.startswith("Look; take the markers 2, 3, 4, 5")
    bare = GeometryError("bent", expected="flat")
    assert with_overview(bare, marks_of({})) is bare
    assert bare.found == "bent"


def test_points_with_their_cones_and_pictures():
    points = FieldPoints(points=((1, 0), (1, 1), (4, 2), (7, 0)), points_pcs=np.eye(4)[:, :3], cov=np.eye(12))
    residuals = pd.DataFrame(
        {
            "marker": [1, 1, 1, 4, 4, 1],
            "corner": [0, 0, 1, 2, 2, 0],
            "used": [True, True, True, True, False, False],
        }
    )
    of = MeasuredField(network=SimpleNamespace(residuals=residuals), points=points, datum=None, notes=[])
    table = point_table(FIELD, of)
    assert table["mark"].tolist() == ["1/0", "1/1", "4/2", "7/0"]
    assert table["cone"].tolist() == ["A", "A", "B", ""]
    assert table["images"].tolist() == [2, 1, 1, 0]


def test_facts_of_a_field_as_a_file(tmp_path):
    root = np.random.default_rng(1).standard_normal((6, 6))
    place = Rigid(R=exp_rotation([0.1, 0.2, 0.3]), shift_m=np.array([1.0, 2.0, 3.0]), cov=root @ root.T)
    table = pd.DataFrame({"target": ["T1"], "east_m": [1.5], "used": [True]})
    datum = FieldDatum(
        T_wcs_pcs=place, table=table, rejected=(("T2", "far"),), sigma0=1.2, redundancy=9.0, sigma_scale=0.003
    )
    path = tmp_path / "deep" / "facts.json"
    write_facts(path, network({0: 1.0}), datum, ["a note"])
    told = read_facts(path)
    assert told["notes"] == ["a note"]
    assert told["adjustment"] == {"object_sigma_mean_mm": 0.3}
    assert told["scale_bars"] == {"used": [True, True], "off_mm": [1.0, None], "sigma_off_mm": [2.0, None]}
    assert len(told["rejected"]) == 11
    assert told["targets"] == {
        "table": [{"target": "T1", "east_m": 1.5, "used": True}],
        "rejected": [{"name": "T2", "reason": "far"}],
        "sigma0": 1.2,
        "redundancy": 9.0,
        "sigma_scale": 0.003,
    }
    found = read_place(path)
    np.testing.assert_allclose(found.matrix, place.matrix)
    np.testing.assert_allclose(found.cov, place.cov)
    write_facts(path, network({0: 1.0}, bars=None), None, [])
    told = json.loads(path.read_text())
    assert told["T_wcs_pcs"] is None
    assert not {"scale_bars", "targets"} & told.keys()
