"""Terrestrial laser scans of the right bank from stations on the left bank: the reference cloud."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from pyproj import CRS

from thalweg.core import AnyArray, ArrayF, ArrayI, LocalFrame
from thalweg.core.geometry import RayCaster
from thalweg_lab.instruments.footprint import (
    DETECTION_WIDTH,
    Beam,
    EchoKind,
    ShotRandom,
    Surfaces,
    echoes_of,
    part_of,
    seen,
)
from thalweg_lab.random_numbers import generator
from thalweg_lab.reach import River
from thalweg_lab.river import REFLECTANCE, REFLECTANCE_1550, Material, Scene, outlook
from thalweg_lab.settings import TwinConfig, TwinTls
from thalweg_lab.voyage import write_effects
from thalweg_lab.writers import write_scan

_AZIMUTH_RAD: Final = np.deg2rad(60.0)
_LOWEST_RAD: Final = np.deg2rad(-20.0)
_HIGHEST_RAD: Final = np.deg2rad(40.0)
_TRIPOD_M: Final = 1.8
_BEHIND_SHORE_M: Final = 3.0
_SPREAD: Final = 0.3
"""Stations stand on the middle part of the reach: outermost ones at this share of its half length."""
_AIMS_M: Final = (0.3, 1.5, 3.0)
"""Heights above the water of the points that a station should see."""
_CHUNK: Final = 250_000

PULSE_M: Final = 0.8
"""Surfaces nearer to each other than this give one echo (VZ-400i data sheet, multi-target resolution)."""
WEAKEST: Final = 0.032
"""Strength that is just seen at 100 m: the data sheet's 250 m for a reflectance of 20 %."""


def station_positions(
    config: TwinConfig, river: River, count: int, caster: RayCaster | None = None
) -> ArrayF:
    """Scanner centres (count, 3) in wcs, along the left bank.

    Parameters
    ----------
    config : section ``twin``.
    river : its geometry.
    count : number of stations.
    caster : the scene. With it each station goes to the place within a step or two from which most of the
        right bank is in view, as a surveyor's would.
    """
    s = np.linspace(-1.0, 1.0, count) if count > 1 else np.zeros(1)
    s = s * _SPREAD * config.scene.length_m
    if caster is None:
        return _tripod(river, s, np.full(count, _BEHIND_SHORE_M))
    return np.stack([_clearest(river, caster, float(place)) for place in s])


def _tripod(river: River, s_m: ArrayF, behind_m: ArrayF) -> ArrayF:
    n = river.shores(s_m)[1] + behind_m
    up = river.height(s_m, n) + _TRIPOD_M
    return np.concatenate([river.to_wcs(s_m, n), up[:, None]], axis=1)


def _clearest(river: River, caster: RayCaster, s_m: float) -> ArrayF:
    """The place (3,) near ``s_m`` from which most points of the right bank are not hidden from nearby."""
    along, behind = (a.ravel() for a in np.meshgrid(np.arange(-1.5, 1.6, 0.5), np.arange(1.0, 5.1, 0.5)))
    # The nominal place first: it is taken if no other one is better.
    order = np.argsort(np.hypot(along, behind - _BEHIND_SHORE_M), kind="stable")
    places = _tripod(river, s_m + along[order], behind[order])
    far = s_m + np.linspace(-30.0, 30.0, 61)
    aims = river.to_wcs(far, -river.shores(far)[0])
    targets = np.concatenate([np.column_stack([aims, np.full(len(aims), up)]) for up in _AIMS_M])
    targets[:, 2] += river.config.water_level_m
    way = (targets - places[:, None]).reshape(-1, 3)
    # Half of the way: what hides a point from farther off belongs to the right bank.
    hits = caster.cast(np.repeat(places, len(targets), axis=0), way)
    free = (hits.t_hit_m > 0.5).reshape(len(places), -1).mean(axis=1)
    return np.asarray(places[np.argmax(free)])


def sigma_3d_m(config: TwinTls, range_m: ArrayF) -> ArrayF:
    """3D error of points, of the shape of their ranges: a floor and a part that grows with distance.

    ``sigma^2 = floor^2 + (sigma_50m^2 - floor^2) (range / 50 m)^2``: at 50 m it is the published 3 mm (P2
    5.1), and near the scanner it does not vanish.
    """
    floor = config.sigma_floor_m**2
    return np.asarray(np.sqrt(floor + (config.sigma_50m_m**2 - floor) * (range_m / 50.0) ** 2))


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """Points of one station, ray after ray and the nearest echo of a ray first.

    Parameters
    ----------
    points_wcs_m : (n, 3) with their noise.
    reflectance : (n,) reflectance times cosine of incidence, averaged over the footprint.
    return_number, number_of_returns : (n,).
    counts : rays shot, rays spared, points, further returns, mixed points and lost echoes by cause.
    """

    points_wcs_m: ArrayF
    reflectance: ArrayF
    return_number: AnyArray
    number_of_returns: AnyArray
    counts: dict[str, int]


@dataclass(frozen=True, slots=True, kw_only=True)
class Station:
    """A scanner at its place.

    Parameters
    ----------
    config : section ``twin.tls``.
    centre_wcs_m : (3,) where it stands.
    surfaces : the scene at its wavelength.
    beam : footprint.
    noise, chance, detection : random numbers of one cause each.
    """

    config: TwinTls
    centre_wcs_m: ArrayF
    surfaces: Surfaces
    beam: Beam
    noise: ShotRandom
    chance: ShotRandom
    detection: ShotRandom

    @classmethod
    def standing(
        cls, config: TwinTls, seed: int, number: int, centre_wcs_m: ArrayF, scene: Scene, caster: RayCaster
    ) -> Self:
        """Station ``number`` of a campaign; its random numbers are its own."""
        cause = f"tls {number}"
        return cls(
            config=config,
            centre_wcs_m=centre_wcs_m,
            surfaces=Surfaces(
                caster=caster,
                material=scene.material,
                reflectance=REFLECTANCE_1550 if config.wavelength_nm == 1550 else REFLECTANCE,
                water_level_m=scene.water_level_m,
                wet_band_m=config.wet_band_m,
                wet_reflectance=config.wet_reflectance,
            ),
            beam=Beam.of(config, seed, cause, pulse_m=PULSE_M),
            noise=ShotRandom.of(seed, f"{cause} noise"),
            chance=ShotRandom.of(seed, f"{cause} dropouts"),
            detection=ShotRandom.of(seed, f"{cause} detection"),
        )

    def shoot(self, ray: ArrayI, direction: ArrayF) -> Scan:
        """Points of rays with the given numbers and (n, 3) directions. Water gives no points."""
        c = self.config
        cell = self.beam.first_cell(direction, ray)
        hits = self.surfaces.caster.cast(self.centre_wcs_m, cell)
        there = hits.t_hit_m < c.max_range_m + PULSE_M
        water = there & (self.surfaces.kinds(hits) == Material.WATER)
        met = np.flatnonzero(there & ~water)
        number, direction = ray[met], direction[met]
        origin = np.broadcast_to(self.centre_wcs_m, direction.shape)
        echoes = echoes_of(self.surfaces, self.beam, origin, direction, number, cell[met], part_of(hits, met))
        lucky = self.chance.uniform(number) >= c.dropouts
        strong = seen(
            echoes.strength,
            echoes.range_m,
            self.detection.uniform(number, echoes.range_m.shape[1]),
            weakest=WEAKEST,
            width=DETECTION_WIDTH,
            dark_dropouts=c.dark_dropouts,
        )
        counts = {
            "rays": len(ray),
            "dropouts_water": int(water.sum()),
            "dropouts_chance": int(np.sum(~lucky)),
            "dropouts_weak": int(np.sum(echoes.there & ~strong)),
        }
        keep = lucky & strong & (echoes.range_m <= c.max_range_m)
        row, column = np.nonzero(keep)
        range_m = echoes.range_m[row, column][:, None]
        # An error for each echo and axis; those of one shot are three after the other.
        noise = self.noise.normal(number, 3 * keep.shape[1]).reshape(*keep.shape, 3)[row, column]
        sigma = sigma_3d_m(c, range_m) / np.sqrt(3.0)
        counts["points"], counts["later_returns"] = len(row), len(row) - int(keep.any(axis=1).sum())
        counts["mixed"] = int(np.sum(echoes.kind[row, column] == EchoKind.MIXED))
        return Scan(
            points_wcs_m=self.centre_wcs_m + range_m * direction[row] + sigma * noise,
            reflectance=echoes.strength[row, column],
            return_number=keep.cumsum(axis=1)[row, column],
            number_of_returns=keep.sum(axis=1)[row],
            counts=counts,
        )


def scan(station: Station, scene: Scene, towards_rad: float, step_rad: float) -> Scan:
    """All rays of a station that may meet anything but water or sky.

    Parameters
    ----------
    station, scene : scanner and river reach.
    towards_rad : middle of the field of view, 120 degrees wide, from east, counter-clockwise.
    step_rad : between rays, in azimuth and in elevation.

    Notes
    -----
    The 3D error (`sigma_3d_m`) is split evenly over the components.
    """
    azimuth = towards_rad + np.arange(-_AZIMUTH_RAD, _AZIMUTH_RAD, step_rad)
    elevation = np.arange(_LOWEST_RAD, _HIGHEST_RAD, step_rad)
    wanted = np.flatnonzero(outlook(scene, station.centre_wcs_m, azimuth, elevation).ravel())
    parts = []
    for first in range(0, max(len(wanted), 1), _CHUNK):
        ray = wanted[first : first + _CHUNK]
        a, e = azimuth[ray // len(elevation)], elevation[ray % len(elevation)]
        direction = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1)
        parts.append(station.shoot(ray, direction))
    counts = {name: sum(p.counts[name] for p in parts) for name in parts[0].counts}
    return Scan(
        points_wcs_m=np.concatenate([p.points_wcs_m for p in parts]),
        reflectance=np.concatenate([p.reflectance for p in parts]),
        return_number=np.concatenate([p.return_number for p in parts]),
        number_of_returns=np.concatenate([p.number_of_returns for p in parts]),
        counts={**counts, "rays_spared": len(azimuth) * len(elevation) - len(wanted)},
    )


def simulate_tls(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    out_scans: list[Path],
    *,
    crs: str,
    out_effects: Path | None = None,
) -> dict[str, Any]:
    """Scan the right bank from each station and write one LAZ file a station.

    Parameters
    ----------
    config, seed, frame, scene : as in `thalweg_lab.instruments.bed.simulate_echo`.
    out_scans : one target a station; the stations share the reach evenly.
    crs : projected CRS of the campaign; heights in the files are ellipsoidal.
    out_effects : where to write station positions and errors (JSON), beside the truth.

    Returns
    -------
    facts : position of each station, and its numbers of rays, points and lost echoes.

    Notes
    -----
    The angular step is such that points on the right shore opposite a station have the configured spacing.
    """
    world, river = Scene.read(scene), River(config.scene, seed)
    caster = world.caster()
    system = CRS.from_user_input(crs) if config.tls.coordinates == "map" else None
    tls = config.tls
    step = tls.spacing_m / (config.scene.width_m + _BEHIND_SHORE_M)
    facts: dict[str, Any] = {"stations": []}
    for number, (path, centre) in enumerate(
        zip(out_scans, station_positions(config, river, len(out_scans), caster), strict=True), start=1
    ):
        station = Station.standing(tls, seed, number, centre, world, caster)
        along, _ = river.to_flow(centre[0], centre[1])
        found = scan(station, world, float(river.angle(along)) - np.pi / 2, step)
        shift = generator(seed, f"tls {number} station").normal(0.0, tls.sigma_station_m, 3)
        points = found.points_wcs_m + shift
        if system is not None:
            points = frame.to_map(points, system)
        write_scan(
            path,
            points,
            found.reflectance,
            frame if system is None else system,
            number,
            return_number=found.return_number,
            number_of_returns=found.number_of_returns,
        )
        facts["stations"].append({"centre_wcs_m": centre.tolist(), "shift_m": shift.tolist(), **found.counts})
    write_effects(out_effects, "tls", facts)
    return facts
