"""The study of offsets: a small one says what it must, and words follow from numbers."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from thalweg_lab.studies.offset_study import (
    EFFECTS,
    PER_SURVEY,
    SINGLE,
    Effect,
    as_markdown,
    conclusion,
    distances,
    offset_table,
    rows_of_seed,
)
from thalweg_lab.studies.survey import survey_settings

SMALL: dict[str, Any] = {
    "duration_s": 1.0,
    "scene": {"length_m": 40.0, "grid_m": 0.25, "leaves_per_bush": 60},
    "tls": {"spacing_m": 0.2},
}


def small(effect: Effect) -> Effect:
    twin = {
        key: value | SMALL.get(key, {}) if isinstance(value, dict) else value
        for key, value in effect.twin.items()
    }
    twin["duration_s"] = SMALL["duration_s"]
    twin["effects"] = {**twin.get("effects", {}), "lost_packets": 0.5}
    return replace(effect, twin=twin, reference={"cell_m": 0.2, **effect.reference})


@pytest.fixture(scope="module")
def surveys(tmp_path_factory: pytest.TempPathFactory) -> tuple[pd.DataFrame, list[Effect]]:
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
def found(surveys: tuple[pd.DataFrame, list[Effect]]) -> pd.DataFrame:
    return offset_table(*surveys)


def test_every_row_is_a_campaign_and_has_its_counterpart() -> None:
    names = [effect.name for effect in EFFECTS]
    assert len(set(names)) == len(names)
    assert set(SINGLE) < set(names)
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


def test_a_bare_bank_has_no_offset_and_plants_stand_before_it(found: pd.DataFrame) -> None:
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


def test_the_same_seed_gives_the_same_numbers(
    tmp_path: Path, surveys: tuple[pd.DataFrame, list[Effect]]
) -> None:
    (first, *_), (effect, *_) = surveys[0].to_dict("records"), surveys[1]
    assert distances(first["seed"], tmp_path / "again", effect) == {name: first[name] for name in PER_SURVEY}
    assert list(tmp_path.iterdir()) == []


def test_the_page_reads_as_a_table(found: pd.DataFrame) -> None:
    page = as_markdown(found)
    table = [line for line in page.splitlines() if line.startswith("|")]
    assert len(table) == len(found) + 3  # head, rule, P2
    assert len({line.count("|") for line in table}) == 1
    assert "-60 to -50" in table[-1]
    assert "nan" not in page


def rows(**means: tuple[float, float, float]) -> pd.DataFrame:
    """A table with (mean, explained, its sigma) of some effects, in millimetres."""
    return pd.DataFrame(
        [
            {
                "effect": name.replace("_", " "),
                "mean_m": mean / 1e3,
                "explains_m": change / 1e3,
                "sigma_explains_m": sigma / 1e3,
                "sigma_mean_m": sigma / 1e3,
                "seeds": 4,
                "fitted": 4,
                "sigma_mean_registered_m": sigma / 4e3,
            }
            for name, (mean, change, sigma) in means.items()
        ]
    )


def test_the_conclusion_follows_the_numbers() -> None:
    words = conclusion(
        rows(
            stones=(3.0, 1.0, 1.0),
            bushes=(-20.0, -19.0, 2.0),
            trees=(9.0, 8.0, 3.0),
            all_but_poses_and_mounts=(-31.0, -31.0, 4.0),
            plants_left_in_the_reference=(5.0, 36.0, 2.0),
        )
    )
    assert "31 mm behind the reference" in words
    assert words.index("bushes -19.0 ± 2.0") < words.index("trees +8.0 ± 3.0")
    assert "Not told from zero: stones." in words
    assert "+5.0 ± 2.0 mm: what is taken for the reference's surface decides on the sign" in words
    scattered = conclusion(rows(errors_of_poses_and_mounts=(4.0, 4.0, 10.0)))
    assert "Not told from zero: errors of poses and mounts." in scattered
    # one survey of four: twice the standard error of the mean
    assert "scatters by 20 mm with them" in scattered
    assert "5 mm after a rigid fit" in scattered
    assert "4 mm in front of" in conclusion(rows(stones=(4.0, 4.0, 1.0)))
