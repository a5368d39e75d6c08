"""The drone's cloud: where it has points, how they err, and its own shift."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
from pyproj import CRS

from tests.lab.conftest import FRAME, SEED, short
from thalweg.core import ArrayB, ArrayF, ArrayU8, GeometryError
from thalweg.fusion import Cloud, fit_cloud, read_cloud
from thalweg.settings.sections import CloudFit
from thalweg_lab.instruments import simulate_uav
from thalweg_lab.river import Material

CRS_NAME = "EPSG:25833"


@dataclass(frozen=True)
class Drone:
    """Its file, what it says of itself, its points shifted back, and the ground's height and kind there."""

    path: Path
    facts: dict[str, Any]
    back_m: ArrayF
    ground_m: ArrayF
    kind: ArrayU8

    @property
    def bare(self) -> ArrayB:
        ground = [int(Material.SOIL), int(Material.GRASS), int(Material.GRAVEL)]
        return np.isin(self.kind, ground) & np.isfinite(self.ground_m)


CONFIG = short(uav={"spacing_m": 0.5, "crown_share": 0.0, "sigma_shift_m": (0.03, 0.03, 0.15)})


@pytest.fixture(scope="module")
def drone(twin, scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("uav") / "uav.laz"
    facts = simulate_uav(CONFIG, SEED, FRAME, twin.path("scene.npz"), path, crs=CRS_NAME)
    points = FRAME.from_map(np.asarray(laspy.read(path).xyz), CRS.from_user_input(CRS_NAME))
    back = points - np.array(facts["shift_m"])
    above = back + np.array([0.0, 0.0, 60.0])
    hits = scene.caster().cast(above, np.tile([0.0, 0.0, -1.0], (len(back), 1)))
    kind = scene.material[np.clip(hits.primitive, 0, None)]
    return Drone(path, facts, back, above[:, 2] - hits.t_hit_m, kind)


def test_the_cloud_is_shifted_rough_and_has_holes(drone):
    facts = drone.facts
    assert len(drone.back_m) == facts["points"]
    assert facts["lost_over_water"] > 0.1 * facts["places"]
    assert facts["lost_in_crowns"] > 0
    # nothing over water, and on bare ground the stated noise, made a little larger by slopes
    assert np.mean(drone.kind == Material.WATER) < 0.01
    error = (drone.ground_m - drone.back_m[:, 2])[drone.bare]
    assert drone.bare.sum() > 1000
    spread = 1.4826 * np.median(np.abs(error - np.median(error)))
    assert 0.85 < spread / CONFIG.uav.sigma_m < 1.35
    assert abs(np.median(error)) < 0.01


def test_its_shift_is_found_on_the_ground_of_the_banks(drone):
    """The drone's cloud, laid on ground as the boat's lidar gives it; a metre too high it is refused."""
    rng = np.random.default_rng(5)
    xyz = np.column_stack([drone.back_m[:, :2], drone.ground_m])[drone.bare]
    sigma = np.full(len(xyz), 0.03)
    xyz[:, 2] += 0.03 * rng.standard_normal(len(xyz))
    banks = Cloud(xyz_m=xyz, sigma_horizontal_m=sigma, sigma_up_m=sigma)
    foreign = read_cloud([drone.path], FRAME, CRS.from_user_input(CRS_NAME), sigma_m=0.05)
    settings = CloudFit(motion="shift")
    fit = fit_cloud(foreign, banks, settings, sigma_shared_m=0.01)
    shift_m = np.array(drone.facts["shift_m"])
    # 2 cm: grass, on which the drone looks
    assert abs((fit.motion.shift_m + shift_m)[2]) < 3 * np.sqrt(fit.cov[2, 2]) + 0.02
    assert abs(shift_m[2]) > 0.03
    high = replace(foreign, xyz_m=foreign.xyz_m + np.array([0.0, 0.0, 1.2]))
    with pytest.raises(GeometryError, match="off the ground of the banks"):
        fit_cloud(high, banks, settings, sigma_shared_m=0.01)
