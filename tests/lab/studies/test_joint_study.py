"""Echo sounder and light sheet on T's river: the river, points of the sheet, the picture."""

import numpy as np
import pytest

from thalweg_lab.reach import River
from thalweg_lab.settings import TwinConfig
from thalweg_lab.studies import joint_study
from thalweg_lab.studies.joint_study import SURVEYS, campaign_of, surveyed


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """One survey of 40 s on half of the river."""
    scene = joint_study.TWIN["scene"] | {"length_m": 24.0, "grid_m": 0.3}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(joint_study, "TWIN", joint_study.TWIN | {"duration_s": 40.0, "scene": scene})
        patch.setattr(
            "thalweg.bathymetry.variogram._STEPS", 20
        )  # how well ranges are found is judged in tests/bathymetry
        patch.setattr(joint_study, "BATHYMETRY", {"cell_m": 0.4, "bank_station_m": 1.0})
        return surveyed(1, tmp_path_factory.mktemp("joint"))


def test_the_river_is_that_of_the_thesis():
    twin = TwinConfig(**campaign_of(1)["twin"])
    river = River(twin.scene, 1)
    s = np.linspace(-21, 21, 200)
    u = np.linspace(0, 1, 101)
    right, left = river.shores(s)
    depth = river.depth(s[:, None], -right[:, None] + u * (right + left)[:, None])
    assert np.mean(right + left) == pytest.approx(10.0, rel=0.06)
    assert depth.max() == pytest.approx(2.5, abs=0.01)
    assert depth.min() == 0.0
    # the given sections where they stand: 0.31 of 2.5 m at the fourth of thirteen places of the third
    third = float(river.depth(7.0, -river.shores(7.0)[0] + 0.25 * sum(river.shores(7.0))))
    assert third == pytest.approx(0.31 * 2.5, abs=1e-6)
    shallow = (depth > 0.05) & (depth < 0.2)
    assert 0.04 < shallow.mean() < 0.2


def test_each_instrument_measures_its_depths(found):
    squares, places = found
    low = squares[(squares["quantity"] == SURVEYS[1]) & (squares["to_m"] <= 0.05)]
    assert low[["soundings", "sheet"]].sum().sum() <= 2  # errors of 3 cm move some below the limit
    sheet = places[places["what"] == "light sheet"]
    assert len(sheet) > 20
    # in 5 to 20 cm of water, to within the error of the pose
    assert sheet["up_m"].between(-0.35, 0.1).all()
    soundings = places[places["what"] == "sounding"]
    assert soundings["up_m"].max() < -0.05


def test_the_sheet_helps_where_it_measures(found):
    squares, _ = found
    of = squares[squares["from_m"] == 0.05].set_index("quantity")
    assert of.loc[SURVEYS[1], "measured"] > of.loc[SURVEYS[0], "measured"]
    assert of.loc[SURVEYS[1], "predicted_m2"] < of.loc[SURVEYS[0], "predicted_m2"]
    assert (of["n"] > 20).all()
