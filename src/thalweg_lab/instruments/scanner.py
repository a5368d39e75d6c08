"""A VLP-16 on the boat: from its firings to what it reports of them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI, ArrayU8
from thalweg.settings.twin.lidar import TwinLidar
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import generator
from thalweg_lab.instruments.beams import FIRING_S, LASER_S, VLP_16, Beams, Lasers, azimuth_deg, beams
from thalweg_lab.instruments.footprint import Beam, Echoes, Surfaces, echoes_of, part_of
from thalweg_lab.instruments.returns import (
    PULSE_M,
    WEAKEST,
    choose,
    quantise,
    range_sigma_m,
    seen,
)
from thalweg_lab.instruments.shot_random import ShotRandom
from thalweg_lab.instruments.shots import EchoKind, ShotWriter
from thalweg_lab.river.hull import HULL_MATERIAL, Hull
from thalweg_lab.river.hull import REFLECTANCE as HULL_REFLECTANCE
from thalweg_lab.river.materials import REFLECTANCE, Material
from thalweg_lab.river.scene import Scene
from thalweg_lab.river.waves import Waves
from thalweg_lab.voyage.motion import Motion

# ---------------------------------------------------------------- mirror ghosts: beams that water reflects
# onto something else come back along the same way
#
# The echo carries the length of the whole way and the direction in which the beam left: a point of the bank
# appears below the water, where its mirror image is.


REFRACTIVE_INDEX: Final = 1.33
"""Water at 905 nm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ghosts:
    """Echoes by way of the water, each array over n beams.

    ``range_m`` (n,) the whole way, infinite where nothing is met; ``strength`` (n,); ``point_wcs_m`` (n, 3)
    the surface point that the beam came back from, above the water; ``material`` (n,) of it.
    """

    range_m: ArrayF
    strength: ArrayF
    point_wcs_m: ArrayF
    material: ArrayU8


def fresnel(cosine: ArrayF) -> ArrayF:
    """Share (n,) of unpolarised light that water reflects, by cosine of incidence (Born and Wolf, 1.5.2)."""
    c = np.clip(cosine, 0.0, 1.0)
    inside = np.sqrt(1.0 - (1.0 - c * c) / REFRACTIVE_INDEX**2)
    across = (c - REFRACTIVE_INDEX * inside) / (c + REFRACTIVE_INDEX * inside)
    along = (inside - REFRACTIVE_INDEX * c) / (inside + REFRACTIVE_INDEX * c)
    return np.asarray((across**2 + along**2) / 2)


def overlap(
    divergence_rad: float, hidden_slope_variance: ArrayF, cosine: ArrayF, beyond: ArrayF | float = 1.0
) -> ArrayF:
    """Share (n,) of the mirrored light that the receiver looks at, as waves within the footprint scatter it.

    Parameters
    ----------
    divergence_rad : full divergence of the beam and of the receiver's view.
    hidden_slope_variance : (n,) mean square length of the slopes of waves that the footprint hides.
    cosine : (n,) of incidence on the water.
    beyond : (n,) or one share of the way that lies behind the water.

    Notes
    -----
    Waves longer than the footprint turn the beam as a whole and its way back with it. Shorter ones scatter
    it: a facet of slope s turns the light by ``2 s`` in the plane of incidence and ``2 s cos(i)`` across it
    (Cox and Munk 1954). At the surface behind the water, a way R1 + R2 from the scanner, light that left at
    an angle a and was turned by b lies ``(R1 + R2) a + R2 b`` off the middle. Seen from the scanner, the spot
    of light has in each direction the variance ``v + d^2``: ``v = divergence^2 / 16`` of the beam, and d^2
    the variance of ``b R2 / (R1 + R2)``. What the receiver sees is found by following its rays backwards, so
    it is a spot of the same variance, whose facets are others. The echo is the integral of the product of
    both densities, ``N(0; 2 (v + d^2))`` for normal ones. Over that without waves, ``N(0; 2 v)``, it is
    ``sqrt(v / (v + d^2))`` in each of the two directions.
    """
    if divergence_rad == 0:
        return np.ones_like(cosine)
    own = divergence_rad**2 / 16
    # Half of the mean square slope belongs to each direction.
    in_plane = 4 * hidden_slope_variance / 2 * np.square(beyond)
    share = own / np.sqrt((own + in_plane) * (own + in_plane * cosine**2))
    return np.asarray(share)


def ghosts(
    surfaces: Surfaces,
    waves: Waves,
    origin_wcs_m: ArrayF,
    direction_wcs: ArrayF,
    range_m: ArrayF,
    t_s: ArrayF,
    divergence_rad: float,
) -> Ghosts:
    """Echoes of beams that have met water.

    Parameters
    ----------
    surfaces : scene.
    waves : the water's surface.
    origin_wcs_m, direction_wcs : (n, 3) rays.
    range_m : (n,) way to the water.
    t_s : (n,) time of the shots, seconds since the start.
    divergence_rad : full divergence of the beams.
    """
    place = origin_wcs_m + range_m[:, None] * direction_wcs
    flat = np.maximum(np.abs(direction_wcs[:, 2]), 1e-3)
    # The footprint is an ellipse, long where the beam grazes; a circle of its area stands for it.
    footprint = divergence_rad * range_m / np.sqrt(flat)
    normal = waves.normal(place[:, 0], place[:, 1], t_s, footprint_m=footprint)
    towards = np.einsum("ni,ni->n", normal, direction_wcs)
    mirrored = direction_wcs - 2.0 * towards[:, None] * normal
    # A ray that meets the back of a wave, or is mirrored into the water, is lost.
    fine = (towards < 0) & (mirrored[:, 2] > 0)
    hits = surfaces.caster.cast(place + 1e-3 * mirrored, mirrored)
    kind = surfaces.kinds(hits)
    met = fine & np.isfinite(hits.t_hit_m) & (kind != Material.WATER)
    way = np.where(met, hits.t_hit_m + 1e-3, 0.0)
    point = place + way[:, None] * mirrored
    cosine = np.clip(-towards, 0.0, 1.0)
    strength = (
        fresnel(cosine) ** 2
        * overlap(divergence_rad, waves.hidden_slope_variance(footprint), cosine, way / (range_m + way))
        * surfaces.strength(kind, hits.normal, mirrored, point[:, 2])
    )
    return Ghosts(
        range_m=np.where(met, range_m + way, np.inf),
        strength=np.where(met, strength, 0.0),
        point_wcs_m=point,
        material=kind,
    )


# ---------------------------------------------------------------- scanner


COUNTS: Final = (
    "mixed", "ghosts", "hull", "hull_blocked", "dropouts_chance", "dropouts_weak", "dropouts_water",
)  # fmt: skip
"""Counted in every piece: returns that are mixed, ghosts, or of the own boat; shots that the boat blocks;
shots with echoes that were lost by chance; echoes too weak; shots on water that met nothing by its mirror."""

_WATER_POWER: Final = 8
"""Returns of water fall with this power of the cosine of incidence."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shots:
    """What the sensor reports of n firings.

    Parameters
    ----------
    t_s : (n,) times of the firings, seconds since the start.
    distance, brightness : each twice (16 n,): of the last and of the other return, see `returns.choose`;
        distances in units of 2 mm, 0 = none.
    shot : (m,) shots with returns, rising; number in this piece.
    last, other : (m,) column of ``echoes`` that is reported.
    echoes : of these shots.
    counts : see `COUNTS`.
    """

    t_s: ArrayF
    distance: tuple[ArrayI, ArrayI]
    brightness: tuple[ArrayI, ArrayI]
    shot: ArrayI
    last: ArrayI
    other: ArrayI
    echoes: Echoes
    counts: dict[str, int]

    def write_truth(self, out: ShotWriter, start_gps_s: float, drawn: ArrayB) -> None:
        """Write where the returns came from, in the order of time; in dual mode the nearer one first.

        Parameters
        ----------
        out : target.
        start_gps_s : start of the recording.
        drawn : (packets,) whether the truth of each packet of this piece is kept.
        """
        t = start_gps_s + self.t_s[self.shot // 16] + LASER_S * (self.shot % 16)
        kept = drawn[self.shot // (16 * len(self.t_s) // len(drawn))]
        two = kept & (self.last != self.other)
        # Columns stand in the order of range.
        row = np.concatenate([np.flatnonzero(kept), np.flatnonzero(two)])
        nearer, farther = np.minimum(self.last, self.other), np.maximum(self.last, self.other)
        column = np.concatenate([nearer[kept], farther[two]])
        number = np.repeat([1, 2], [int(kept.sum()), int(two.sum())])
        order = np.argsort(row, kind="stable")
        row, column = row[order], column[order]
        e = self.echoes
        out.add(
            t[row], e.point_wcs_m[row, column], e.material[row, column], number[order], e.kind[row, column]
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarSensor:
    """A VLP-16 on the boat.

    Parameters
    ----------
    config : section ``twin``.
    motion : true motion.
    R_ics_scs, lever_ics_scs_m : true mount of the scanner.
    surfaces : the scene at 905 nm.
    beam : footprint.
    hull, waves : None if the effect is off, waves also where there is no water.
    start_deg : azimuth at the start.
    lasers : k of them; only a VLP-16's 16 fill packets.
    lateral, noise, chance, detection, water : random numbers of one cause each.
    """

    config: TwinConfig
    motion: Motion
    R_ics_scs: ArrayF
    lever_ics_scs_m: ArrayF
    surfaces: Surfaces
    beam: Beam
    hull: Hull | None
    waves: Waves | None
    start_deg: float
    lasers: Lasers
    lateral: ShotRandom
    noise: ShotRandom
    chance: ShotRandom
    detection: ShotRandom
    water: ShotRandom

    @classmethod
    def on_board(
        cls,
        config: TwinConfig,
        seed: int,
        motion: Motion,
        scene: Scene,
        *,
        R_ics_scs: ArrayF,
        lever_ics_scs_m: ArrayF,
        lasers: Lasers = VLP_16,
    ) -> Self:
        """The sensor of a configuration."""
        c = config.lidar
        R, lever = np.asarray(R_ics_scs, dtype=np.float64), np.asarray(lever_ics_scs_m, dtype=np.float64)
        hull, wet = None, bool(np.any(scene.material == Material.WATER))
        if c.own_hull:
            # Six sigma of the beam's offset, the lasers' own heights, and the edge of the footprint.
            margin = 6 * c.sigma_lateral_m + 0.015 + c.divergence_mrad / 1000
            hull = Hull.seen_from(
                R, lever, lasers.elevation_rad, height_m=config.boat.height_m, margin_m=margin
            )
        return cls(
            config=config,
            motion=motion,
            R_ics_scs=R,
            lever_ics_scs_m=lever,
            surfaces=Surfaces(
                caster=scene.caster(),
                material=scene.material,
                reflectance=REFLECTANCE,
                water_level_m=scene.water_level_m,
                wet_band_m=c.wet_band_m,
                wet_reflectance=c.wet_reflectance,
            ),
            beam=Beam.of(c, seed, "lidar", pulse_m=PULSE_M),
            hull=hull,
            waves=Waves.draw(seed, rms_slope=c.wave_slope) if c.mirror_ghosts and wet else None,
            start_deg=float(generator(seed, "lidar").uniform(0, 360)),
            lasers=lasers,
            lateral=ShotRandom.of(seed, "lidar lateral"),
            noise=ShotRandom.of(seed, "lidar noise"),
            chance=ShotRandom.of(seed, "lidar dropouts"),
            detection=ShotRandom.of(seed, "lidar detection"),
            water=ShotRandom.of(seed, "lidar water"),
        )

    @property
    def firings_per_packet(self) -> int:
        """24, or 12 in dual mode."""
        return 12 if self.config.lidar.returns == "dual" else 24

    @property
    def n_packets(self) -> int:
        """Whole packets in the recording."""
        return int(self.config.duration_s / (self.firings_per_packet * FIRING_S))

    def azimuth_deg(self, t_s: ArrayF) -> ArrayF:
        """True azimuth of the rotor, not reduced to one turn."""
        return azimuth_deg(t_s, self.config.lidar.rotation_hz, self.start_deg)

    def shoot(self, first: int, count: int) -> Shots:
        """All shots of packets ``first`` to ``first + count``."""
        per = self.firings_per_packet
        return self.fire(np.arange(first * per, (first + count) * per))

    def fire(self, firing: ArrayI, wanted: Callable[[Beams], ArrayB] | None = None) -> Shots:
        """All shots of firings (n,), that follow each other.

        Parameters
        ----------
        firing : (n,) their numbers.
        wanted : tells which beams (n, k) are worth casting, the others return nothing; None: all.
        """
        c, k = self.config.lidar, len(self.lasers.elevation_rad)
        t = np.asarray(firing * FIRING_S, dtype=np.float64)
        number = k * firing[0] + np.arange(k * len(t))
        shot_t = t[:, None] + LASER_S * np.arange(k, dtype=np.float64)
        azimuth = self.azimuth_deg(shot_t)
        lateral = None
        if c.sigma_lateral_m > 0:
            lateral = (c.sigma_lateral_m * self.lateral.normal(number, 2)).reshape(len(t), k, 2)
        rays = beams(
            self.motion,
            t,
            np.deg2rad(azimuth),
            self.R_ics_scs,
            self.lever_ics_scs_m,
            vertical_offsets=c.vertical_offsets,
            lateral_m=lateral,
            lasers=self.lasers,
        )
        origin, direction = rays.origin_wcs_m.reshape(-1, 3), rays.direction_wcs.reshape(-1, 3)
        counts = dict.fromkeys(COUNTS, 0)
        parts: list[tuple[AnyArray, Echoes]] = []
        free = np.ones(len(number), dtype=np.bool_) if wanted is None else wanted(rays).ravel()
        if self.hull is not None:
            near = np.flatnonzero(self.hull.may_hit(azimuth) & free.reshape(azimuth.shape))
            way, cosine = self.hull.cast(
                rays.origin_ics_m.reshape(-1, 3)[near], rays.direction_ics.reshape(-1, 3)[near]
            )
            met = np.isfinite(way)
            near, way, cosine = near[met], way[met], cosine[met]
            free[near] = False
            counts["hull_blocked"] = len(near)
            boat = np.full(len(near), HULL_MATERIAL, dtype=np.uint8)
            point = origin[near] + way[:, None] * direction[near]
            parts.append((near, Echoes.single(way, HULL_REFLECTANCE * cosine, point, boat, EchoKind.HULL)))
        at = np.flatnonzero(free)
        origin, direction = origin[at], direction[at]
        cell = self.beam.first_cell(direction, number[at])
        hits = self.surfaces.caster.cast(origin, cell)
        there = hits.t_hit_m < c.max_range_m + PULSE_M
        wet = there & (self.surfaces.kinds(hits) == Material.WATER)
        solid = np.flatnonzero(there & ~wet)
        found = echoes_of(
            self.surfaces,
            self.beam,
            origin[solid],
            direction[solid],
            number[at[solid]],
            cell[solid],
            part_of(hits, solid),
        )
        parts.append((at[solid], found))
        water = np.flatnonzero(wet)
        mirrored = self._on_water(
            origin[water],
            cell[water],
            hits.t_hit_m[water],
            shot_t.ravel()[at[water]],
            number[at[water]],
        )
        counts["dropouts_water"] = len(water) - len(mirrored[0])
        parts.append((at[water[mirrored[0]]], mirrored[1]))
        return self._report(t, number, parts, counts)

    def _on_water(
        self, origin: ArrayF, direction: ArrayF, range_m: ArrayF, t_s: ArrayF, number: ArrayI
    ) -> tuple[ArrayI, Echoes]:
        """Rows of the beams on water that return anything, and their echoes: of the water, by its mirror."""
        c = self.config.lidar
        cosine = np.abs(direction[:, 2])
        # A mirror seen from straight above returns by itself; its diffuse part is never seen.
        own = self.water.uniform(number)[:, 0] < c.water_returns * cosine**_WATER_POWER
        cells = [
            Echoes.single(
                np.where(own, range_m, np.inf),
                REFLECTANCE[Material.WATER] * cosine,
                origin + range_m[:, None] * direction,
                np.full(len(number), Material.WATER, dtype=np.uint8),
                EchoKind.SURFACE,
            )
        ]
        if self.waves is not None:
            g = ghosts(self.surfaces, self.waves, origin, direction, range_m, t_s, self.beam.divergence_rad)
            cells.append(Echoes.single(g.range_m, g.strength, g.point_wcs_m, g.material, EchoKind.GHOST))
        keep = np.flatnonzero(np.any([e.there[:, 0] for e in cells], axis=0))
        return keep, Echoes.beside([e.taken(keep) for e in cells])

    def _report(
        self, t: ArrayF, number: ArrayI, parts: list[tuple[AnyArray, Echoes]], counts: dict[str, int]
    ) -> Shots:
        """Detect, measure and choose echoes."""
        c = self.config.lidar
        cells = max(e.range_m.shape[1] for _, e in parts)
        shot = np.concatenate([at for at, _ in parts])
        order = np.argsort(shot)
        shot, echoes = shot[order], Echoes.stacked([e for _, e in parts], cells).taken(order)
        detected = self._detected(echoes, number[shot], counts)
        echoes = echoes.only(detected)
        sigma = range_sigma_m(echoes.range_m, echoes.strength, c.sigma_range_m, c.sigma_weak_m)
        noise = sigma * self.noise.normal(number[shot], cells)
        distance, brightness = quantise(echoes, noise, c.max_range_m)
        rows = np.flatnonzero(distance.any(axis=1))
        shot, echoes, distance, brightness = shot[rows], echoes.taken(rows), distance[rows], brightness[rows]
        last, other = choose(distance, echoes.strength, c.returns)
        row = np.arange(len(rows))
        reported = np.concatenate([echoes.kind[row, last], echoes.kind[row, other][last != other]])
        for name, kind in (("mixed", EchoKind.MIXED), ("ghosts", EchoKind.GHOST), ("hull", EchoKind.HULL)):
            counts[name] = int(np.sum(reported == kind))

        def dense(values: ArrayI, column: ArrayI) -> ArrayI:
            """One value a shot out of those with echoes, 0 for the others."""
            out = np.zeros(len(number), dtype=np.int64)
            out[shot] = values[row, column]
            return out

        return Shots(
            t_s=t,
            distance=(dense(distance, last), dense(distance, other)),
            brightness=(dense(brightness, last), dense(brightness, other)),
            shot=shot,
            last=last,
            other=other,
            echoes=echoes,
            counts=counts,
        )

    def _detected(self, echoes: Echoes, number: ArrayI, counts: dict[str, int]) -> ArrayB:
        """Which echoes (n, K) the receiver sees."""
        c: TwinLidar = self.config.lidar
        there = echoes.there
        water = (echoes.material == Material.WATER) & (echoes.kind == EchoKind.SURFACE)
        lucky = self.chance.uniform(number) >= c.dropouts
        strong = seen(
            echoes.strength,
            echoes.range_m,
            self.detection.uniform(number, echoes.range_m.shape[1]),
            weakest=WEAKEST,
            width=c.detection_width,
            dark_dropouts=c.dark_dropouts,
        )
        counts["dropouts_chance"] = int(np.sum((there & ~water & ~lucky).any(axis=1)))
        counts["dropouts_weak"] = int(np.sum(there & ~water & ~strong))
        return np.asarray(there & (water | (lucky & strong)))
