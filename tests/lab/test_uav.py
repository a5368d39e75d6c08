"""The drone's cloud: where it has points, how they err, and its own shift."""

from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from pyproj import CRS
from tests.lab.conftest import FRAME, SEED, short

from thalweg.core import ConfigError
from thalweg_lab.instruments import simulate_uav
from thalweg_lab.river import Material, Scene

CRS_NAME = "EPSG:25833"


def test_the_cloud_is_shifted_rough_and_has_holes(twin: Any, scene: Scene, tmp_path: Path) -> None:
    config = short(uav={"spacing_m": 0.5, "crown_share": 0.0})
    path = tmp_path / "uav.laz"
    facts = simulate_uav(config, SEED, FRAME, twin.path("scene.npz"), path, crs=CRS_NAME)
    cloud = laspy.read(path)
    points = FRAME.from_map(np.asarray(cloud.xyz), CRS.from_user_input(CRS_NAME))
    assert len(points) == facts["points"]
    assert facts["lost_over_water"] > 0.1 * facts["places"]
    assert facts["lost_in_crowns"] > 0
    back = points - np.array(facts["shift_m"])
    above = back + np.array([0.0, 0.0, 60.0])
    down = np.tile([0.0, 0.0, -1.0], (len(back), 1))
    hits = scene.caster().cast(above, down)
    kind = scene.material[np.clip(hits.primitive, 0, None)]
    # nothing over water, and on bare ground the stated noise, made a little larger by slopes
    assert np.mean(kind == Material.WATER) < 0.01
    bare = np.isin(kind, [int(Material.SOIL), int(Material.GRASS), int(Material.GRAVEL)])
    error = (hits.t_hit_m - 60.0)[bare]
    assert bare.sum() > 1000
    spread = 1.4826 * np.median(np.abs(error - np.median(error)))
    assert 0.85 < spread / config.uav.sigma_m < 1.35
    assert abs(np.median(error)) < 0.01


def test_without_its_section_there_is_no_drone(twin: Any, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"twin\.uav is not given"):
        simulate_uav(short(), SEED, FRAME, twin.path("scene.npz"), tmp_path / "a.laz", crs=CRS_NAME)
