"""The cloud of the surroundings that pictures from a drone give (structure from motion)."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from pyproj import CRS

from thalweg.core import ConfigError, LocalFrame
from thalweg_lab.random_numbers import generator
from thalweg_lab.reach import REACH_M, River
from thalweg_lab.river import REFLECTANCE, Material, Scene
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import write_effects
from thalweg_lab.writers import write_scan

_CROWN: Final = (Material.LEAF, Material.WOOD, Material.BARK, Material.REED)
"""What moves in the wind and hides what is below."""
_ABOVE_M: Final = 100.0


def simulate_uav(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    out_cloud: Path,
    *,
    crs: str,
    out_effects: Path | None = None,
) -> dict[str, Any]:
    """Look at the reach from above and write the cloud as LAZ in map coordinates.

    Each point is the uppermost surface at its place. Water gives no points, crowns few and rough ones, the
    ground below crowns none. The whole cloud is shifted, as its control points err together.

    Parameters
    ----------
    config, seed, frame, scene : as in `thalweg_lab.instruments.bed.simulate_echo`.
    out_cloud : target, ``.laz``.
    crs : projected CRS of the campaign; heights in the file are ellipsoidal.
    out_effects : where to write the shift and the counts (JSON), beside the truth.

    Returns
    -------
    facts : shift_m (3,), places looked at, points, those lost over water and in crowns.

    Raises
    ------
    ConfigError : the section ``twin.uav`` is missing.
    """
    uav = config.uav
    if uav is None:
        raise ConfigError(
            "twin.uav is not given",
            expected="the section of the drone's cloud",
            cure="Add `uav: {}` below twin",
        )
    world, river = Scene.read(scene), River(config.scene, seed)
    half = config.scene.length_m / 2
    s = np.arange(-half, half, uav.spacing_m)
    reach = config.scene.width_m / 2 + min(uav.reach_m, REACH_M - 5.0)
    n = np.arange(-reach, reach, uav.spacing_m)
    rng = generator(seed, "uav")
    grid = np.stack(np.meshgrid(s, n, indexing="ij"), axis=-1).reshape(-1, 2)
    grid += uav.spacing_m * (rng.uniform(size=grid.shape) - 0.5)
    top = np.full((len(grid), 1), float(world.vertices_wcs_m[:, 2].max()) + _ABOVE_M)
    eye = np.concatenate([river.to_wcs(grid[:, 0], grid[:, 1]), top], axis=1)
    hits = world.caster().cast(eye, np.tile([0.0, 0.0, -1.0], (len(eye), 1)))
    met = np.isfinite(hits.t_hit_m)
    kind = np.where(met, world.material[np.clip(hits.primitive, 0, None)], int(Material.WATER))
    crown = np.isin(kind, [int(m) for m in _CROWN])
    chance, noise = rng.uniform(size=len(eye)), rng.standard_normal((len(eye), 3))
    wet = met & (kind == Material.WATER)
    lost = crown & (chance >= uav.crown_share)
    keep = met & ~wet & ~lost
    points = eye[keep].copy()
    points[:, 2] -= hits.t_hit_m[keep]
    rough = np.where(crown[keep], uav.sigma_crown_m, uav.sigma_m)
    points += rough[:, None] * noise[keep] * np.array([0.5, 0.5, 1.0])
    shift = np.asarray(uav.sigma_shift_m) * generator(seed, "uav shift").standard_normal(3)
    system = CRS.from_user_input(crs)
    write_scan(out_cloud, frame.to_map(points + shift, system), REFLECTANCE[kind[keep]], system, 1)
    facts = {
        "shift_m": shift.tolist(),
        "places": len(eye),
        "points": int(keep.sum()),
        "lost_over_water": int(wet.sum()),
        "lost_in_crowns": int(lost.sum()),
    }
    write_effects(out_effects, "uav", facts)
    return facts
