"""The drone's cloud: where it has points, how they err, and its own shift."""

from dataclasses import replace

import laspy
import numpy as np
import pytest
from pyproj import CRS

from tests.lab.conftest import FRAME, SEED, short
from thalweg.core import GeometryError
from thalweg.fusion import Cloud, fit_cloud, read_cloud
from thalweg.settings.sections import CloudFit
from thalweg_lab.instruments import simulate_uav
from thalweg_lab.reach import River
from thalweg_lab.river import Material

CRS_NAME = "EPSG:25833"


def test_the_cloud_is_shifted_rough_and_has_holes(twin, scene, tmp_path):
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


def test_its_shift_is_found_on_the_ground_of_the_banks(twin, scene, tmp_path):
    """The drone's cloud, laid on ground as the boat's lidar gives it; a metre too high it is refused."""
    config = short(uav={"spacing_m": 0.5, "sigma_shift_m": (0.03, 0.03, 0.15)})
    path = tmp_path / "uav.laz"
    facts = simulate_uav(config, SEED, FRAME, twin.path("scene.npz"), path, crs=CRS_NAME)
    rng = np.random.default_rng(5)
    river = River(config.scene, SEED)
    half = config.scene.width_m / 2
    s = rng.uniform(-0.45, 0.45, 40_000) * config.scene.length_m
    behind = half + rng.uniform(0.5, 9.0, len(s))
    eye = np.column_stack([river.to_wcs(s, behind * rng.choice([-1.0, 1.0], len(s))), np.full(len(s), 60.0)])
    ground = scene.only(Material.SOIL, Material.GRASS, Material.GRAVEL).caster()
    t_m = ground.cast(eye, np.tile([0.0, 0.0, -1.0], (len(eye), 1))).t_hit_m
    met = np.isfinite(t_m)
    xyz = eye[met] - np.column_stack([np.zeros((met.sum(), 2)), t_m[met]])
    xyz[:, 2] += 0.03 * rng.standard_normal(len(xyz))
    banks = Cloud(xyz_m=xyz, sigma_horizontal_m=np.full(len(xyz), 0.03), sigma_up_m=np.full(len(xyz), 0.03))
    foreign = read_cloud([path], FRAME, CRS.from_user_input(CRS_NAME), sigma_m=0.05)
    settings = CloudFit(motion="shift")
    fit = fit_cloud(foreign, banks, settings, sigma_shared_m=0.01)
    error = fit.motion.shift_m + np.array(facts["shift_m"])
    assert np.abs(error[2]) < 3 * np.sqrt(fit.cov[2, 2]) + 0.02  # 2 cm: grass, on which the drone looks
    assert np.abs(facts["shift_m"][2]) > 0.03
    high = replace(foreign, xyz_m=foreign.xyz_m + np.array([0.0, 0.0, 1.2]))
    with pytest.raises(GeometryError, match="off the ground of the banks"):
        fit_cloud(high, banks, settings, sigma_shared_m=0.01)
