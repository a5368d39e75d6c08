"""The mobile lidar: a VLP-16 whose every shot leaves at its own time and pose, and its capture file."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, ArrayU8, LocalFrame, njit, rotation_enu_body
from thalweg_lab.instruments.effects import damage_file, packet_order
from thalweg_lab.instruments.footprint import (
    DETECTION_WIDTH,
    PULSE_M,
    WEAKEST,
    Beam,
    Echoes,
    EchoKind,
    ShotRandom,
    ShotWriter,
    Surfaces,
    choose,
    drawn_packets,
    echoes_of,
    part_of,
    quantise,
    range_sigma_m,
    seen,
)
from thalweg_lab.instruments.misstated import as_it_errs
from thalweg_lab.random_numbers import generator
from thalweg_lab.river import (
    HULL_MATERIAL,
    HULL_REFLECTANCE,
    REFLECTANCE,
    Hull,
    Material,
    Scene,
    Waves,
    fresnel,
)
from thalweg_lab.settings import TwinConfig, TwinLidar
from thalweg_lab.voyage import Motion, motion_of, write_effects
from thalweg_lab.writers import (
    CaptureWriter,
    check_leap_seconds,
    data_payloads,
    position_payload,
    rmc,
    start_us,
)

_CHUNK: Final = 256
"""Packets simulated at a time: 98,000 shots, about 60 MB."""
HOUR_US: Final = 3_600_000_000
ROTATION_HZ: Final = 10.0
_POSITION_RATE_HZ: Final = 50.0
_HOST_CLOCK_OFFSET_S: Final = 0.4
"""Recording computer's clock minus UTC."""
_RMC_DELAY_S: Final = 0.15
"""From a full second to the arrival of its sentence: so RMC lags TOH by 0.15 to 1.15 s."""
_FREE_START_US: Final = 140_550_000
_FREE_DRIFT: Final = 20e-6
"""Before the PPS the counter runs from power-up, 20 ppm fast."""

COUNTS: Final = (
    "mixed",
    "ghosts",
    "hull",
    "hull_blocked",
    "dropouts_chance",
    "dropouts_weak",
    "dropouts_water",
)
"""Counted in every piece: returns that are mixed, ghosts, or of the own boat; shots that the boat blocks;
shots with echoes that were lost by chance; echoes too weak; shots on water that met nothing by its mirror."""
_WATER_POWER: Final = 8
"""Returns of water fall with this power of the cosine of incidence."""
REFRACTIVE_INDEX: Final = 1.33
"""Water at 905 nm."""

FIRING_S: Final = 55.296e-6
"""All 16 lasers and the recharge."""
LASER_S: Final = 2.304e-6
"""From one laser to the next."""
ELEVATION_RAD: Final[ArrayF] = np.deg2rad(
    np.array([-15.0, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15])
)
HEIGHT_M: Final[ArrayF] = 1e-3 * np.array(
    [11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2]
)
"""Heights at which the lasers cross the spin axis, table 9-1."""
_WOBBLE: Final = 5e-4
"""Relative change of the motor's speed; it swings with 0.7 Hz."""
_WOBBLE_HZ: Final = 0.7


class LidarClock:
    """Stamps of one recording.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    motion : true motion, for the position in RMC.
    frame : the world frame.

    Raises
    ------
    ConfigError : a leap second falls into the recording.
    """

    def __init__(self, config: TwinConfig, seed: int, motion: Motion, frame: LocalFrame) -> None:
        self._config = config
        self._motion = motion
        self._frame = frame
        check_leap_seconds(config)
        self._start_us = start_us(config)
        self._late_s = config.effects.pps_late_s
        self._next_position = 0
        self._host_rng = generator(seed, "lidar host delay")
        self._host_s = -np.inf
        self._sentences: dict[int, str] = {}

    @property
    def hour_rollovers(self) -> int:
        """How often the time past the hour starts again inside the recording."""
        end = self._start_us + int(self._config.duration_s * 1e6)
        return end // HOUR_US - self._start_us // HOUR_US

    def toh_us(self, t_s: ArrayF) -> ArrayI:
        """Stamps of events at seconds since the start; they jump when the PPS is acquired."""
        t = np.asarray(t_s, dtype=np.float64)
        # UTC of the hour: leap seconds never change the minute and second that GPS time gives here, because
        # the start is given in UTC and recordings with a leap second inside are refused.
        locked = (self._start_us % HOUR_US + np.rint(t * 1e6).astype(np.int64)) % HOUR_US
        free = _FREE_START_US + np.rint(t * (1.0 + _FREE_DRIFT) * 1e6).astype(np.int64)
        return np.where(t >= self._late_s, locked, free % HOUR_US)

    def host_ns(self, t_s: float) -> int:
        """Unix time at which the recording computer, which nobody set right, captures the next packet.

        Packets are taken one after the other: each waits for an exponential time of its own, and none is
        stamped before the one that came earlier.
        """
        lidar = self._config.lidar
        self._host_s = max(self._host_s, t_s + lidar.host_delay_s * self._host_rng.standard_exponential())
        return self._start_us * 1000 + round((self._host_s + _HOST_CLOCK_OFFSET_S) * 1e9)

    def positions_until(self, t_s: float) -> Iterator[float]:
        """Times of the position packets that are due and not yet sent."""
        while (due := self._next_position / _POSITION_RATE_HZ) <= t_s:
            self._next_position += 1
            yield due

    def position_state(self, t_s: float) -> tuple[int, int, str]:
        """Time past the hour, PPS state and RMC sentence at a time."""
        toh = int(self.toh_us(np.array([t_s]))[0])
        if t_s < self._late_s / 2:
            return toh, 0, ""
        state = 2 if t_s >= self._late_s else 1
        return toh, state, self._sentence(t_s)

    def _sentence(self, t_s: float) -> str:
        second = (self._start_us + round((t_s - _RMC_DELAY_S) * 1e6)) // 1_000_000
        if second not in self._sentences:
            at_s = second - self._start_us / 1e6
            t_gps = np.array([self._motion.start_gps_s + at_s])
            lat, lon, _ = self._frame.to_geodetic(self._motion.position_wcs_m(t_gps))
            v = self._motion.velocity_wcs_mps(t_gps)[0]
            course = float(np.rad2deg(np.arctan2(v[0], v[1])))
            speed = float(np.hypot(v[0], v[1]))
            self._sentences = {second: rmc(second * 1_000_000, float(lat[0]), float(lon[0]), speed, course)}
        return self._sentences[second]


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
class Lasers:
    """The lasers of a scanner in the order in which they fire.

    Parameters
    ----------
    elevation_rad : (k,).
    height_m : (k,) at which they cross the spin axis.
    """

    elevation_rad: ArrayF
    height_m: ArrayF

    @classmethod
    def even(cls, count: int, step_deg: float) -> "Lasers":
        """Lasers in even steps about the horizontal through one centre; P2 Fig. 4: 8, 4 degrees apart."""
        steps = np.arange(count) - (count - 1) / 2
        return cls(elevation_rad=np.deg2rad(steps * step_deg), height_m=np.zeros(count))

    @property
    def ring(self) -> ArrayI:
        """(k,) number of each laser, 0 the lowest."""
        return np.argsort(np.argsort(self.elevation_rad))

    def table(self) -> ArrayF:
        """(4, k) sine and cosine of the elevation, height and delay: argument of the kernel."""
        e = self.elevation_rad
        return np.stack([np.sin(e), np.cos(e), self.height_m, np.arange(len(e)) * LASER_S])


VLP_16: Final = Lasers(elevation_rad=ELEVATION_RAD, height_m=HEIGHT_M)


@dataclass(frozen=True, slots=True, kw_only=True)
class Beams:
    """Rays of whole firings, each array (n, k, 3): origins and unit directions in ics and in wcs."""

    origin_ics_m: ArrayF
    direction_ics: ArrayF
    origin_wcs_m: ArrayF
    direction_wcs: ArrayF


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
        """True azimuth of the rotor, not reduced to one turn; its speed swings by 0.05 %."""
        w = 2 * np.pi * _WOBBLE_HZ
        turned = t_s + _WOBBLE / w * (1.0 - np.cos(w * t_s))
        return np.asarray(self.start_deg + 360.0 * ROTATION_HZ * turned)

    def shoot(self, packet: ArrayI) -> Shots:
        """All shots of packets (n,), numbers that rise."""
        per = self.firings_per_packet
        return self.fire((packet[:, None] * per + np.arange(per)).ravel())

    def fire(self, firing: ArrayI, wanted: Callable[[Beams], ArrayB] | None = None) -> Shots:
        """All shots of firings (n,), numbers that rise.

        Parameters
        ----------
        firing : (n,) their numbers.
        wanted : tells which beams (n, k) are worth casting, the others return nothing; None: all.
        """
        c, k = self.config.lidar, len(self.lasers.elevation_rad)
        t = np.asarray(firing * FIRING_S, dtype=np.float64)
        number = (k * firing[:, None] + np.arange(k)).ravel()
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
            origin[water], cell[water], hits.t_hit_m[water], shot_t.ravel()[at[water]], number[at[water]]
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
            width=DETECTION_WIDTH,
            dark_dropouts=c.dark_dropouts,
        )
        counts["dropouts_chance"] = int(np.sum((there & ~water & ~lucky).any(axis=1)))
        counts["dropouts_weak"] = int(np.sum(there & ~water & ~strong))
        return np.asarray(there & (water | (lucky & strong)))


# ---------------------------------------------------------------- lidar


def packets(sensor: LidarSensor, shots: Shots) -> tuple[ArrayI, ArrayI, ArrayI]:
    """Content of data packets: azimuth (count, 12), distance and intensity (count, 12, 32)."""
    count = len(shots.t_s) // sensor.firings_per_packet
    block = np.rint(100 * sensor.azimuth_deg(shots.t_s[::2])).astype(np.int64) % 36000
    if sensor.config.lidar.returns != "dual":
        shape = (count, 12, 32)
        return block.reshape(count, 12), shots.distance[0].reshape(shape), shots.brightness[0].reshape(shape)
    # Even blocks hold the last return, odd ones the other; equal where there is one return only.
    distance, brightness = (
        np.stack([v.reshape(count, 6, 32) for v in values], axis=2).reshape(count, 12, 32)
        for values in (shots.distance, shots.brightness)
    )
    return np.repeat(block.reshape(count, 6), 2, axis=1), distance, brightness


def simulate_lidar(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    scene: Path | Scene,
    out_pcap: Path,
    *,
    R_ics_scs: ArrayF,
    lever_ics_scs_m: ArrayF,
    motion: Motion | None = None,
    out_shots: Path | None = None,
    out_effects: Path | None = None,
) -> dict[str, Any]:
    """Record the motion with the lidar and write its capture file.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    frame : the world frame.
    scene : what surrounds the boat, or the file of `simulate_scene`.
    out_pcap : target.
    R_ics_scs : (3, 3) true rotation from scanner to body frame.
    lever_ics_scs_m : (3,) true scanner origin in the body frame.
    motion : of the boat; None: what the configuration asks for, see `motion_of`.
    out_shots : where to write the true point of each return (table kind ``twin_lidar_shots``), of long
        recordings that of whole packets drawn at random, see `thalweg_lab.instruments.footprint`. The table's
        facts are ``share`` (chance of a packet), ``packets_fired`` and ``packets_drawn``.
    out_effects : where to write what was done to the log (JSON), beside the truth.

    Returns
    -------
    facts : numbers of packets and shots, of returns by their kind, of lost ones by cause (see
        `thalweg_lab.instruments.lidar.COUNTS`), and the defects of the log. Returns, like their truth, are
        those of packets that are captured.
    """
    motion = motion_of(config, seed) if motion is None else motion
    sensor = LidarSensor.on_board(
        as_it_errs(config, seed),
        seed,
        motion,
        scene if isinstance(scene, Scene) else Scene.read(scene),
        R_ics_scs=R_ics_scs,
        lever_ics_scs_m=lever_ics_scs_m,
    )
    defects = generator(seed, "lidar effects")
    clock = LidarClock(config, seed, motion, frame)
    order = packet_order(config.effects, sensor.n_packets, defects)
    returns = swapped = 0
    counts = dict.fromkeys(COUNTS, 0)
    drawn, share = drawn_packets(seed, sensor.n_packets, 16 * sensor.firings_per_packet)
    table_facts = {
        "share": share,
        "packets_fired": sensor.n_packets,
        "packets_drawn": int(np.count_nonzero(drawn)),
    }
    with (
        CaptureWriter(out_pcap, nanoseconds=config.lidar.nanoseconds) as capture,
        ShotWriter(out_shots, table_facts) as truth,
    ):
        for first in range(0, sensor.n_packets, _CHUNK):
            # What nobody captures need not be cast: studies lose most packets to save time.
            mine = order[(order >= first) & (order < first + _CHUNK)]
            packet = np.unique(mine)
            if not len(packet):
                continue
            shots = sensor.shoot(packet)
            shots.write_truth(truth, motion.start_gps_s, drawn[packet])
            azimuth, distance, brightness = packets(sensor, shots)
            returns += int(np.count_nonzero(distance))
            counts = {name: n + shots.counts[name] for name, n in counts.items()}
            toh = clock.toh_us(shots.t_s[:: sensor.firings_per_packet])
            payloads = data_payloads(azimuth, distance, brightness, toh, config.lidar.returns)
            swapped += _capture(capture, payloads[np.searchsorted(packet, mine)], mine, sensor, clock)
    facts = {
        "packets_fired": sensor.n_packets,
        "packets_written": len(order),
        "packets_lost": sensor.n_packets - len(np.unique(order)),
        "packets_twice": len(order) - len(np.unique(order)),
        "packets_swapped": swapped,
        "shots": sensor.n_packets * sensor.firings_per_packet * 16,
        "returns": returns,
        **counts,
        "pps_locked_after_s": config.effects.pps_late_s,
        "hour_rollovers": clock.hour_rollovers,
        **damage_file(out_pcap, "lidar", config.effects, defects),
    }
    write_effects(out_effects, "lidar", facts)
    return facts


def _capture(
    capture: CaptureWriter, payloads: ArrayU8, mine: ArrayI, sensor: LidarSensor, clock: LidarClock
) -> int:
    """Write the packets ``mine`` (n,) of one piece, with position packets; returns the swapped pairs."""
    # A pair that was swapped across the edge of two pieces is captured in order after all.
    packet_s = sensor.firings_per_packet * FIRING_S
    sent = np.maximum.accumulate((mine + 1) * packet_s)
    for payload, t in zip(payloads, sent, strict=True):
        for due in clock.positions_until(float(t)):
            toh, pps, sentence = clock.position_state(due)
            capture.position(clock.host_ns(due), position_payload(toh, pps, sentence))
        capture.data(clock.host_ns(float(t)), payload.tobytes())
    return int(np.sum(np.diff(mine) < 0))


# ---------------------------------------------------------------- from firings to reports


# ---------------------------------------------------------------- mirror ghosts: beams that water reflects
# onto something else come back along the same way
#
# The echo carries the length of the whole way and the direction in which the beam left: a point of the bank
# appears below the water, where its mirror image is.


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
        fresnel(cosine, REFRACTIVE_INDEX) ** 2
        * overlap(divergence_rad, waves.hidden_slope_variance(footprint), cosine, way / (range_m + way))
        * surfaces.strength(kind, hits.normal, mirrored, point[:, 2])
    )
    return Ghosts(
        range_m=np.where(met, range_m + way, np.inf),
        strength=np.where(met, strength, 0.0),
        point_wcs_m=point,
        material=kind,
    )


# ---------------------------------------------------------------- beams of a VLP-16 (User Manual 63-9243 Rev.
# D, chapter 9)


def beams(
    motion: Motion,
    t_s: ArrayF,
    azimuth_rad: ArrayF,
    R_ics_scs: ArrayF,
    lever_ics_scs_m: ArrayF,
    *,
    vertical_offsets: bool,
    lateral_m: ArrayF | None = None,
    lasers: Lasers = VLP_16,
) -> Beams:
    """Rays of firings, each laser at its own time and pose.

    Parameters
    ----------
    motion : true motion.
    t_s : (n,) time of the first laser of each firing, seconds since the start.
    azimuth_rad : (n, k) azimuth of each shot.
    R_ics_scs, lever_ics_scs_m : mount of the scanner.
    vertical_offsets : lasers cross the spin axis at the heights of the manual's table.
    lateral_m : (n, k, 2) offset of each beam across itself, to the right and upward.
    lasers : k of them.

    Notes
    -----
    The pose is exact at each firing; within a firing (35 us) position and attitude change linearly, which
    is right to 1e-9 rad and 1e-10 m at the greatest rates of the boat.
    """
    table = lasers.table()
    table[2] *= vertical_offsets
    out = [np.empty((*azimuth_rad.shape, 3)) for _ in range(4)]
    _aim(
        azimuth_rad,
        np.zeros((*azimuth_rad.shape, 2)) if lateral_m is None else lateral_m,
        table,
        np.ascontiguousarray(R_ics_scs, dtype=np.float64),
        np.asarray(lever_ics_scs_m, dtype=np.float64),
        rotation_enu_body(*motion.angles_at(t_s)),
        motion.rates_at(t_s),
        motion.position_at(t_s),
        motion.velocity_wcs_mps(motion.start_gps_s + t_s),
        *out,
    )
    return Beams(origin_ics_m=out[0], direction_ics=out[1], origin_wcs_m=out[2], direction_wcs=out[3])


@njit(cache=True, error_model="numpy")
def _aim(  # type: ignore[no-untyped-def]
    azimuth, lateral, lasers, mount, lever, attitude, rates, position, velocity, o_ics, d_ics, o_wcs, d_wcs
):
    for i in range(len(azimuth)):
        R, w = attitude[i], rates[i]
        for j in range(azimuth.shape[1]):
            sin_a, cos_a = np.sin(azimuth[i, j]), np.cos(azimuth[i, j])
            sin_e, cos_e, height, delay = lasers[0, j], lasers[1, j], lasers[2, j], lasers[3, j]
            right, up = lateral[i, j, 0], lateral[i, j, 1]
            dx, dy, dz = cos_e * sin_a, cos_e * cos_a, sin_e
            ox = right * cos_a - up * sin_e * sin_a
            oy = -right * sin_a - up * sin_e * cos_a
            oz = height + up * cos_e
            for k in range(3):
                d_ics[i, j, k] = mount[k, 0] * dx + mount[k, 1] * dy + mount[k, 2] * dz
                o_ics[i, j, k] = lever[k] + mount[k, 0] * ox + mount[k, 1] * oy + mount[k, 2] * oz
            # R(t + d) x = R(t) (x + d omega x x), to first order in d.
            b = d_ics[i, j]
            dx = b[0] + delay * (w[1] * b[2] - w[2] * b[1])
            dy = b[1] + delay * (w[2] * b[0] - w[0] * b[2])
            dz = b[2] + delay * (w[0] * b[1] - w[1] * b[0])
            b = o_ics[i, j]
            ox = b[0] + delay * (w[1] * b[2] - w[2] * b[1])
            oy = b[1] + delay * (w[2] * b[0] - w[0] * b[2])
            oz = b[2] + delay * (w[0] * b[1] - w[1] * b[0])
            for k in range(3):
                d_wcs[i, j, k] = R[k, 0] * dx + R[k, 1] * dy + R[k, 2] * dz
                moved = position[i, k] + delay * velocity[i, k]
                o_wcs[i, j, k] = moved + (R[k, 0] * ox + R[k, 1] * oy + R[k, 2] * oz)
