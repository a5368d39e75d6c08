"""The mobile lidar: a VLP-16 whose every shot leaves at its own time and pose, and its capture file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.config.twin import TwinConfig
from thalweg.core.frames import LocalFrame
from thalweg.core.raycast import RayCaster
from thalweg.core.types import ArrayF, ArrayI, ArrayU8
from thalweg.simulation.beams import FIRING_S, LASER_S, azimuth_deg, beams
from thalweg.simulation.effects import damage_file, packet_order
from thalweg.simulation.lidar_clock import LidarClock
from thalweg.simulation.random import generator
from thalweg.simulation.returns import Echoes, combine, echoes, quantise
from thalweg.simulation.scene import Scene
from thalweg.simulation.shots import ShotWriter
from thalweg.simulation.truth import write_effects
from thalweg.simulation.voyage import Voyage
from thalweg.simulation.writers.velodyne_pcap import CaptureWriter, data_payloads, position_payload

_CHUNK: Final = 256
"""Packets simulated at a time: 98,000 shots, about 60 MB."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarSensor:
    """A VLP-16 on the boat.

    Parameters
    ----------
    config : section ``twin``.
    voyage : true motion.
    R_ics_scs, lever_ics_scs_m : true mount of the scanner.
    caster, material : the scene's mesh and the material of each of its triangles.
    """

    config: TwinConfig
    voyage: Voyage
    R_ics_scs: ArrayF
    lever_ics_scs_m: ArrayF
    caster: RayCaster
    material: ArrayU8

    @property
    def firings_per_packet(self) -> int:
        """24, or 12 in dual mode."""
        return 12 if self.config.lidar.returns == "dual" else 24

    @property
    def n_packets(self) -> int:
        """Whole packets in the recording."""
        return int(self.config.duration_s / (self.firings_per_packet * FIRING_S))

    def firing_times_s(self, first: int, count: int) -> ArrayF:
        """Times of the firings of packets, seconds since the start."""
        per = self.firings_per_packet
        return np.arange(first * per, (first + count) * per, dtype=np.float64) * FIRING_S

    def shot_azimuth_rad(self, t_s: ArrayF, start_deg: float) -> ArrayF:
        """True azimuth (n, 16) of the shots of firings."""
        shots = t_s[:, None] + LASER_S * np.arange(16, dtype=np.float64)
        return np.deg2rad(azimuth_deg(shots, self.config.lidar.rotation_hz, start_deg))

    def shoot(self, first: int, count: int, start_deg: float, rng: np.random.Generator) -> "Shots":
        """All shots of packets ``first`` to ``first + count``."""
        lidar = self.config.lidar
        t = self.firing_times_s(first, count)
        shape = (len(t), 16)
        lateral = rng.normal(0.0, lidar.sigma_lateral_m, (2, *shape)) if lidar.sigma_lateral_m > 0 else None
        two_rays = lidar.returns != "strongest" or self.config.effects.mixed_pixels
        rays = beams(
            self.voyage,
            t,
            self.shot_azimuth_rad(t, start_deg),
            self.R_ics_scs,
            self.lever_ics_scs_m,
            vertical_offsets=lidar.vertical_offsets,
            lateral_m=lateral,
            with_across=two_rays,
        )
        origin, direction = rays.origin_wcs_m.reshape(-1, 3), rays.direction_wcs.reshape(-1, 3)
        strongest = last = echoes(self.caster, self.material, origin, direction, lidar, rng)
        if rays.across_wcs is not None:
            radius = lidar.divergence_mrad / 2000 * np.sqrt(rng.uniform(size=shape))
            turn = rng.uniform(0, 2 * np.pi, shape)
            aside = np.stack([np.cos(turn) * radius, np.sin(turn) * radius])[..., None] * rays.across_wcs
            second_direction = (rays.direction_wcs + aside.sum(axis=0)).reshape(-1, 3)
            second = echoes(self.caster, self.material, origin, second_direction, lidar, rng)
            strongest, last = combine(strongest, second, mixed=self.config.effects.mixed_pixels)
        noise = rng.normal(0.0, lidar.sigma_range_m, len(origin))
        return Shots(t_s=t, strongest=strongest, last=last, noise_m=noise)

    def packets(self, shots: "Shots", start_deg: float) -> tuple[ArrayI, ArrayF, ArrayF]:
        """Content of data packets: azimuth (count, 12), distance and intensity (count, 12, 32)."""
        lidar = self.config.lidar
        count = len(shots.t_s) // self.firings_per_packet
        turned = azimuth_deg(shots.t_s[::2], lidar.rotation_hz, start_deg)
        block = np.rint(100 * turned).astype(np.int64) % 36000
        if lidar.returns != "dual":
            distance, brightness = quantise(shots.one(lidar.returns), shots.noise_m, lidar.max_range_m)
            shape = (count, 12, 32)
            return block.reshape(count, 12), distance.reshape(shape), brightness.reshape(shape)
        # Even blocks hold the last return, odd ones the strongest; equal where there is one return only.
        pairs = [quantise(e, shots.noise_m, lidar.max_range_m) for e in (shots.last, shots.strongest)]
        distance, brightness = (
            np.stack([pair[k].reshape(count, 6, 32) for pair in pairs], axis=2).reshape(count, 12, 32)
            for k in (0, 1)
        )
        return np.repeat(block.reshape(count, 6), 2, axis=1), distance, brightness


@dataclass(frozen=True, slots=True, kw_only=True)
class Shots:
    """Shots of n firings: times (n,) of the firings, echoes and range noise (16 n,)."""

    t_s: ArrayF
    strongest: Echoes
    last: Echoes
    noise_m: ArrayF

    def one(self, returns: str) -> Echoes:
        """The echoes of a single-return mode."""
        return self.last if returns == "last" else self.strongest

    def write_truth(self, out: ShotWriter, start_gps_s: float, returns: str) -> None:
        """Write where the returns came from; in dual mode the nearer one first."""
        t = (start_gps_s + self.t_s[:, None] + LASER_S * np.arange(16, dtype=np.float64)).ravel()
        if returns != "dual":
            echo = self.one(returns)
            keep = echo.there
            out.add(t[keep], echo.point_wcs_m[keep], echo.material[keep], np.ones(int(keep.sum())))
            return
        two = self.last.there & (self.last.range_m != self.strongest.range_m)
        near_is_last = two & (self.last.range_m < self.strongest.range_m)
        near = self.strongest.or_else(self.last, near_is_last)
        far = self.last.or_else(self.strongest, near_is_last)
        for number, echo, keep in ((1, near, near.there), (2, far, two)):
            out.add(t[keep], echo.point_wcs_m[keep], echo.material[keep], np.full(int(keep.sum()), number))


def simulate_lidar(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    out_pcap: Path,
    *,
    R_ics_scs: ArrayF,
    lever_ics_scs_m: ArrayF,
    out_shots: Path | None = None,
    out_effects: Path | None = None,
) -> dict[str, Any]:
    """Record the voyage with the lidar and write its capture file.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    frame : the world frame.
    scene : file of `simulate_scene`.
    out_pcap : target.
    R_ics_scs : (3, 3) true rotation from scanner to body frame.
    lever_ics_scs_m : (3,) true scanner origin in the body frame.
    out_shots : where to write the true point of each return (table kind ``twin_lidar_shots``).
    out_effects : where to write what was done to the log (JSON), beside the truth.

    Returns
    -------
    facts : numbers of packets and shots, and the defects of the log.
    """
    world = Scene.read(scene)
    voyage = Voyage(config, seed)
    sensor = LidarSensor(
        config=config,
        voyage=voyage,
        R_ics_scs=np.asarray(R_ics_scs, dtype=np.float64),
        lever_ics_scs_m=np.asarray(lever_ics_scs_m, dtype=np.float64),
        caster=world.caster(),
        material=world.material,
    )
    rng, defects = generator(seed, "lidar"), generator(seed, "lidar effects")
    clock = LidarClock(config, voyage, frame)
    start_deg = float(rng.uniform(0, 360))
    order = packet_order(config.effects, sensor.n_packets, defects)
    returns = swapped = 0
    with (
        CaptureWriter(out_pcap, nanoseconds=config.lidar.nanoseconds) as capture,
        ShotWriter(out_shots) as truth,
    ):
        for first in range(0, sensor.n_packets, _CHUNK):
            count = min(_CHUNK, sensor.n_packets - first)
            shots = sensor.shoot(first, count, start_deg, rng)
            shots.write_truth(truth, voyage.start_gps_s, config.lidar.returns)
            azimuth, distance, brightness = sensor.packets(shots, start_deg)
            returns += int(np.count_nonzero(distance))
            toh = clock.toh_us(shots.t_s[:: sensor.firings_per_packet])
            payloads = data_payloads(azimuth, distance, brightness, toh, config.lidar.returns)
            swapped += _capture(capture, payloads, first, order, sensor, clock)
    facts = {
        "packets_fired": sensor.n_packets,
        "packets_written": len(order),
        "packets_lost": sensor.n_packets - len(np.unique(order)),
        "packets_twice": len(order) - len(np.unique(order)),
        "packets_swapped": swapped,
        "shots": sensor.n_packets * sensor.firings_per_packet * 16,
        "returns": returns,
        "pps_locked_after_s": config.effects.pps_late_s,
        "hour_rollovers": clock.hour_rollovers,
        **damage_file(out_pcap, "lidar", config.effects, defects),
    }
    write_effects(out_effects, "lidar", facts)
    return facts


def _capture(
    capture: CaptureWriter,
    payloads: ArrayU8,
    first: int,
    order: ArrayI,
    sensor: LidarSensor,
    clock: LidarClock,
) -> int:
    """Write one piece in the order of capture, with its position packets; returns the swapped pairs."""
    # A pair that was swapped across the edge of two pieces is captured in order after all.
    mine = order[(order >= first) & (order < first + len(payloads))]
    packet_s = sensor.firings_per_packet * FIRING_S
    sent = np.maximum.accumulate((mine + 1) * packet_s) if len(mine) else np.zeros(0)
    for number, t in zip(mine, sent, strict=True):
        for due in clock.positions_until(float(t)):
            toh, pps, sentence = clock.position_state(due)
            capture.position(clock.host_ns(due), position_payload(toh, pps, sentence))
        capture.data(clock.host_ns(float(t)), payloads[number - first].tobytes())
    return int(np.sum(np.diff(mine) < 0))
