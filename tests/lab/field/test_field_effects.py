"""Faults of a calibration: each changes what it names, when it should, and nothing else."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tests.lab.field.conftest import small
from thalweg.core import ConfigError
from thalweg_lab.yard import build_field, people, recorded_scene

SEED = 4


def fields(**effects):
    """The field at the time of the reference and of the boat."""
    config = small(effects=effects)
    return build_field(config, SEED), build_field(config, SEED, when="boat")


def moved(a, b):
    """Markers of which a saddle differs."""
    there, then = a.saddles_wcs_m(), b.saddles_wcs_m()
    return {marker for marker, k in there if not np.array_equal(there[marker, k], then[marker, k])}


def test_a_toppled_cone_leans_with_its_sheets_after_the_reference(field):
    before, after = fields(toppled_cone="C5", toppled_by_deg=8.0)
    assert moved(field, before) == set()
    assert moved(before, after) == set(range(32, 40))
    a, b = before.cone("C5"), after.cone("C5")
    # The axis lies across the line that it leans about only in part, where the builder has tilted it.
    assert np.rad2deg(np.arccos(a.axis_wcs @ b.axis_wcs)) == pytest.approx(8.0, abs=0.05)
    assert_allclose(b.distance_m(after.sheet(33).saddles_wcs_m()), 0.0, atol=1e-13)
    assert fields(toppled_cone="C7")[1].cone("C7").axis_wcs[2] > -0.999


def test_a_moved_marker_is_shifted_in_its_plane(field):
    before, after = fields(moved_marker=74, moved_by_m=0.02)
    assert moved(before, after) == {74}
    shift = after.sheet(74).saddles_wcs_m() - before.sheet(74).saddles_wcs_m()
    assert_allclose(np.linalg.norm(shift, axis=1), 0.02, atol=1e-12)
    assert_allclose(shift @ before.sheet(74).normal_wcs(), 0.0, atol=1e-10)
    on_cone = fields(moved_marker=9)
    assert moved(*on_cone) == {9}


@pytest.mark.parametrize(
    ("marker", "found"),
    [
        (40, "marker 40 on C6 looks away from the boat"),
        (98, "marker 98 is on no board"),
        (200, "marker 200 is"),
    ],
)
def test_a_marker_that_nobody_would_see_moved_is_refused(marker, found):
    with pytest.raises(ConfigError, match=found) as caught:
        fields(moved_marker=marker)
    assert "70 to 79" in caught.value.cure


def test_people_stand_near_cones_and_off_the_boats_way():
    config = small(effects={"passers_by": 5})
    places = {}
    for recording in ("run", "position 1", "position 2"):
        field = build_field(config, SEED)
        places[recording] = people(config, SEED, recording, field)
        assert places[recording].shape == (5, 2)
        middles = np.array([c.middle_wcs_m[:2] for c in field.cones[:6]])
        near = np.linalg.norm(places[recording][:, None] - middles, axis=2).min(axis=1)
        assert (near < 1.3).all()
        assert (np.linalg.norm(places[recording], axis=1) > 3.6).all()
        assert "person" in recorded_scene(config, SEED, recording).names
    assert not np.allclose(places["run"], places["position 1"])
    assert "person" not in recorded_scene(small(), SEED, "run").names
