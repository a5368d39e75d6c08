"""Terrestrial laser scans of the right bank from stations on the left bank: the reference cloud."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from pyproj import CRS

from thalweg.config.twin import TwinConfig
from thalweg.core.frames import LocalFrame
from thalweg.core.raycast import RayCaster
from thalweg.core.types import ArrayF
from thalweg.simulation.materials import REFLECTANCE, Material
from thalweg.simulation.random import generator
from thalweg.simulation.river import River
from thalweg.simulation.scene import Scene
from thalweg.simulation.truth import write_effects
from thalweg.simulation.writers.laz import write_scan

_AZIMUTH_RAD: Final = np.deg2rad(60.0)
_LOWEST_RAD: Final = np.deg2rad(-20.0)
_HIGHEST_RAD: Final = np.deg2rad(15.0)
_TRIPOD_M: Final = 1.8
_BEHIND_SHORE_M: Final = 3.0
_SPREAD: Final = 0.3
"""Stations stand on the middle part of the reach: outermost ones at this share of its half length."""
_CHUNK: Final = 500_000


def station_positions(config: TwinConfig, river: River, count: int) -> ArrayF:
    """Scanner centres (count, 3) in wcs, along the left bank."""
    s = np.linspace(-1.0, 1.0, count) if count > 1 else np.zeros(1)
    s = s * _SPREAD * config.scene.length_m
    n = river.half_width(s) + _BEHIND_SHORE_M
    up = river.height(s, n) + _TRIPOD_M
    return np.concatenate([river.to_wcs(s, n), up[:, None]], axis=1)


def _directions(azimuth_rad: ArrayF, elevation_rad: ArrayF) -> ArrayF:
    a, e = np.meshgrid(azimuth_rad, elevation_rad, indexing="ij")
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1).reshape(-1, 3)


def scan(
    config: TwinConfig,
    caster: RayCaster,
    scene: Scene,
    river: River,
    centre_wcs_m: ArrayF,
    rng: np.random.Generator,
) -> tuple[ArrayF, ArrayF]:
    """One scan: points (n, 3) in wcs with their noise, and reflectance (n,). Water gives no points.

    The angular step is such that points on the right shore opposite the station have the spacing of the
    settings. The 3D error at 50 m is split evenly over the components and grows with distance.
    """
    step = config.tls.spacing_m / (config.scene.width_m + _BEHIND_SHORE_M)
    s, _ = river.to_flow(centre_wcs_m[0], centre_wcs_m[1])
    towards = float(river.angle(s)) - np.pi / 2
    azimuth = towards + np.arange(-_AZIMUTH_RAD, _AZIMUTH_RAD, step)
    elevation = np.arange(_LOWEST_RAD, _HIGHEST_RAD, step)
    columns = max(1, _CHUNK // len(elevation))
    points, reflectance = [], []
    for first in range(0, len(azimuth), columns):
        direction = _directions(azimuth[first : first + columns], elevation)
        hits = caster.cast(centre_wcs_m, direction)
        kind = scene.material[np.maximum(hits.primitive, 0)]
        ok = np.isfinite(hits.t_hit_m) & (kind != Material.WATER) & (hits.t_hit_m < 300.0)
        range_m = hits.t_hit_m[ok]
        sigma = config.tls.sigma_50m_m / np.sqrt(3.0) * range_m / 50.0
        exact = centre_wcs_m + range_m[:, None] * direction[ok]
        points.append(exact + rng.standard_normal(exact.shape) * sigma[:, None])
        reflectance.append(REFLECTANCE[kind[ok]])
    return np.concatenate(points), np.concatenate(reflectance)


def simulate_tls(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    out_scans: Sequence[Path],
    *,
    crs: str,
    out_effects: Path | None = None,
) -> dict[str, Any]:
    """Scan the right bank from each station and write one LAZ file a station.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    frame : the world frame.
    scene : file of `simulate_scene`.
    out_scans : one target a station; the stations share the reach evenly.
    crs : projected CRS of the campaign; heights in the files are ellipsoidal.
    out_effects : where to write station positions and errors (JSON), beside the truth.

    Returns
    -------
    facts : number of points and position of each station.
    """
    world, river = Scene.read(scene), River(config.scene, seed)
    caster = world.caster()
    system = CRS.from_user_input(crs) if config.tls.coordinates == "map" else None
    facts: dict[str, Any] = {"stations": []}
    for number, (path, centre) in enumerate(
        zip(out_scans, station_positions(config, river, len(out_scans)), strict=True), start=1
    ):
        rng = generator(seed, f"tls {number}")
        shift = rng.normal(0.0, config.tls.sigma_station_m, 3)
        points, reflectance = scan(config, caster, world, river, centre, rng)
        points = points + shift
        if system is not None:
            points = frame.to_map(points, system)
        write_scan(path, points, reflectance, system, number)
        facts["stations"].append(
            {"centre_wcs_m": centre.tolist(), "shift_m": shift.tolist(), "points": len(points)}
        )
    write_effects(out_effects, "tls", facts)
    return facts
