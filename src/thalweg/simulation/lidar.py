"""The mobile lidar: a VLP-16 whose every shot leaves at its own time and pose, and its capture file."""

from collections.abc import Iterator
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
from thalweg.simulation.materials import Material
from thalweg.simulation.random import generator
from thalweg.simulation.returns import Echoes, combine, echoes, quantise
from thalweg.simulation.scene import Scene
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

    def shot_azimuth_rad(self, t_s: ArrayF, start_deg: float) -> ArrayF:
        """True azimuth (n, 16) of the shots of firings."""
        shots = t_s[:, None] + LASER_S * np.arange(16)
        return np.deg2rad(azimuth_deg(shots, self.config.lidar.rotation_hz, start_deg))

    def packets(self, first: int, count: int, start_deg: float, rng: np.random.Generator) -> ArrayU8:
        """Blocks of data packets without time: azimuth (count, 12), distance and intensity (count, 12, 32)."""
        lidar = self.config.lidar
        t = (np.arange(first * self.firings_per_packet, (first + count) * self.firings_per_packet)) * FIRING_S
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
            strongest, last = combine(
                strongest, second, lidar.returns, self.config.effects.mixed_pixels
            )
        noise = rng.normal(0.0, lidar.sigma_range_m, len(origin))
        return self._blocks(t, strongest, last, noise, start_deg)

    def _blocks(
        self, t_s: ArrayF, strongest: Echoes, last: Echoes, noise_m: ArrayF, start_deg: float
    ) -> Any:
        lidar = self.config.lidar
        count = len(t_s) // self.firings_per_packet
        block = np.rint(100 * azimuth_deg(t_s[::2], lidar.rotation_hz, start_deg)).astype(np.int64) % 36000
        if lidar.returns != "dual":
            echo = last if lidar.returns == "last" else strongest
            distance, brightness = quantise(echo, noise_m, lidar.max_range_m)
            shape = (count, 12, 32)
            return block.reshape(count, 12), distance.reshape(shape), brightness.reshape(shape)
        # Even blocks hold the last return, odd ones the strongest; equal where there is one return only.
        pairs = [quantise(echo, noise_m, lidar.max_range_m) for echo in (last, strongest)]
        distance, brightness = (
            np.stack([pair[k].reshape(count, 6, 32) for pair in pairs], axis=2).reshape(count, 12, 32)
            for k in (0, 1)
        )
        return np.repeat(block.reshape(count, 6), 2, axis=1), distance, brightness


def simulate_lidar(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    out_pcap: Path,
    *,
    R_ics_scs: ArrayF,
    lever_ics_scs_m: ArrayF,
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
    returns = 0
    with CaptureWriter(out_pcap, nanoseconds=config.lidar.nanoseconds) as capture:
        for payloads, first, hits in _stream(sensor, clock, start_deg, rng):
            returns += hits
            _capture(capture, payloads, first, order, sensor, clock)
    facts = {
        "packets_fired": sensor.n_packets,
        "packets_written": len(order),
        "packets_lost": sensor.n_packets - len(np.unique(order)),
        "packets_twice": len(order) - len(np.unique(order)),
        "packets_swapped": int(np.sum(np.diff(order) < 0)),
        "shots": sensor.n_packets * sensor.firings_per_packet * 16,
        "returns": returns,
        "pps_locked_after_s": config.effects.pps_late_s,
        "hour_rollovers": clock.hour_rollovers,
        **damage_file(out_pcap, "lidar", config.effects, defects),
    }
    write_effects(out_effects, "lidar", facts)
    return facts


def _stream(
    sensor: LidarSensor, clock: LidarClock, start_deg: float, rng: np.random.Generator
) -> Iterator[tuple[ArrayU8, int, int]]:
    """Payloads of packets in pieces, with the number of the first packet and of the returns in them."""
    for first in range(0, sensor.n_packets, _CHUNK):
        count = min(_CHUNK, sensor.n_packets - first)
        azimuth, distance, brightness = sensor.packets(first, count, start_deg, rng)
        t = (first + np.arange(count)) * sensor.firings_per_packet * FIRING_S
        toh = clock.toh_us(t)
        payloads = data_payloads(azimuth, distance, brightness, toh, sensor.config.lidar.returns)
        yield payloads, first, int(np.count_nonzero(distance))


def _capture(
    capture: CaptureWriter,
    payloads: ArrayU8,
    first: int,
    order: ArrayI,
    sensor: LidarSensor,
    clock: LidarClock,
) -> None:
    """Write one piece in the order of capture, with the position packets that fall into it."""
    # Swapped neighbours never leave their piece far behind: the order is taken by the piece's numbers.
    mine = order[(order >= first) & (order < first + len(payloads))]
    packet_s = sensor.firings_per_packet * FIRING_S
    sent = np.maximum.accumulate((mine + 1) * packet_s) if len(mine) else np.zeros(0)
    for number, t in zip(mine, sent, strict=True):
        for due in clock.positions_until(float(t)):
            toh, pps, sentence = clock.position_state(due)
            capture.position(clock.host_ns(due), position_payload(toh, pps, sentence))
        capture.data(clock.host_ns(float(t)), payloads[number - first].tobytes())


__all__ = ["LidarSensor", "Material", "simulate_lidar"]
