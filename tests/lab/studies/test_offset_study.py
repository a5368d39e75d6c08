"""The study of offsets: a small one says what it must, and words follow from numbers."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from thalweg_lab.studies.offset_study import EFFECTS, offset_table, rows_of_seed
from thalweg_lab.studies.survey import survey_settings

SMALL = {
    "duration_s": 1.0,
    "scene": {"length_m": 40.0, "grid_m": 0.25, "leaves_per_bush": 60},
    "tls": {"spacing_m": 0.2},
}


def small(effect):
    twin = {
        key: value | SMALL.get(key, {}) if isinstance(value, dict) else value
        for key, value in effect.twin.items()
    }
    twin["duration_s"] = SMALL["duration_s"]
    twin["effects"] = {**twin.get("effects", {}), "lost_packets": 0.5}
    return replace(effect, twin=twin, reference={"cell_m": 0.2, **effect.reference})


@pytest.fixture(scope="module")
def surveys(tmp_path_factory):
    """Rows of two seeds, and their effects."""
    names = (
        "bare bank of 60 degrees",
        "slope of 33 degrees",
        "footprint of 3 mrad",
        "mixed pixels",
        "bushes",
    )
    effects = [small(effect) for effect in EFFECTS if effect.name in names]
    folder = tmp_path_factory.mktemp("offset")
    rows = pd.concat([rows_of_seed(seed, folder, effects) for seed in range(2)], ignore_index=True)
    return rows, effects


@pytest.fixture(scope="module")
def found(surveys):
    return offset_table(*surveys)


def test_every_row_is_a_campaign_and_has_its_counterpart():
    names = [effect.name for effect in EFFECTS]
    assert len(set(names)) == len(names)
    for effect in EFFECTS:
        assert survey_settings(effect.twin, reference=effect.reference)["twin"]["lidar"]["sigma_range_m"] > 0
        assert effect.against in ("", *names)
    changed = {effect.name: effect.twin for effect in EFFECTS}
    # one at a time: the same settings but for the one that the name says
    wide, narrow = changed["footprint of 3 mrad"], changed["slope of 33 degrees"]
    assert wide["lidar"].pop("divergence_mrad") == 3.0
    assert narrow["lidar"].pop("divergence_mrad") == 0.0
    try:
        assert wide == narrow
    finally:
        wide["lidar"]["divergence_mrad"], narrow["lidar"]["divergence_mrad"] = 3.0, 0.0


def test_a_bare_bank_has_no_offset_and_plants_stand_before_it(found):
    rows = found.set_index("effect")
    assert (found["n"] > 2000).all()
    assert (found["seeds"] == 2).all()
    bare = rows.loc["bare bank of 60 degrees"]
    # millimetres: 17 mm of noise over thousands of points, and the coarse mesh of a scan at 20 cm
    assert abs(bare["mean_m"]) < 0.004
    assert bare["rmse_m"] == pytest.approx(0.0173, rel=0.15)
    assert np.isnan(bare["explains_m"])
    # a wide beam on a slope is noise, not an offset
    assert rows.loc["footprint of 3 mrad", "rmse_m"] > 1.3 * rows.loc["slope of 33 degrees", "rmse_m"]
    assert abs(rows.loc["footprint of 3 mrad", "explains_m"]) < 0.004
    # the mean of three speckle cells scatters less than the brightest
    assert rows.loc["mixed pixels", "rmse_m"] < rows.loc["footprint of 3 mrad", "rmse_m"]
    assert rows.loc["bushes", "explains_m"] > 0.002
    change = rows.loc["bushes", "mean_m"] - rows.loc["mixed pixels", "mean_m"]
    assert rows.loc["bushes", "explains_m"] == pytest.approx(change)
