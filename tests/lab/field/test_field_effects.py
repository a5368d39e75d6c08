"""Faults of a calibration: each changes what it names, when it should, and nothing else."""

import numpy as np

from tests.lab.field.conftest import small
from thalweg_lab.yard import build_field, people, recorded

SEED = 4


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
        assert "person" in recorded(config, SEED, recording)[1].names
    assert not np.allclose(places["run"], places["position 1"])
    assert "person" not in recorded(small(), SEED, "run")[1].names
