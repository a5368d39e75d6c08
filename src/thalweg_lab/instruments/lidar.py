"""The mobile lidar: a VLP-16 whose every shot leaves at its own time and pose, and its capture file."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayF, ArrayI, ArrayU8
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import generator
from thalweg_lab.instruments.beams import FIRING_S
from thalweg_lab.instruments.effects import damage_file, packet_order
from thalweg_lab.instruments.scanner import COUNTS, LidarSensor, Shots
from thalweg_lab.instruments.shots import ShotWriter, drawn_packets
from thalweg_lab.instruments.stamps import check_leap_seconds, start_us
from thalweg_lab.river.scene import Scene
from thalweg_lab.voyage.motion import Motion
from thalweg_lab.voyage.motions import motion_of
from thalweg_lab.voyage.truth import write_effects
from thalweg_lab.writers.nmea import rmc
from thalweg_lab.writers.velodyne_pcap import CaptureWriter, data_payloads, position_payload

# ---------------------------------------------------------------- the clocks of a lidar recording: time past
# the hour, PPS state, RMC sentences, recording computer


HOUR_US: Final = 3_600_000_000

_RMC_DELAY_S: Final = 0.15
"""From a full second to the arrival of its sentence: so RMC lags TOH by 0.15 to 1.15 s."""
_FREE_START_US: Final = 140_550_000
_FREE_DRIFT: Final = 20e-6
"""Before the PPS the counter runs from power-up, 20 ppm fast."""


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
        return self._start_us * 1000 + round((self._host_s + lidar.host_clock_offset_s) * 1e9)

    def positions_until(self, t_s: float) -> Iterator[float]:
        """Times of the position packets that are due and not yet sent."""
        while (due := self._next_position / self._config.lidar.position_rate_hz) <= t_s:
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


# ---------------------------------------------------------------- lidar


_CHUNK: Final = 256
"""Packets simulated at a time: 98,000 shots, about 60 MB."""


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
        recordings that of whole packets drawn at random, see `thalweg_lab.instruments.shots`. The table's
        facts are ``share`` (chance of a packet), ``packets_fired`` and ``packets_drawn``.
    out_effects : where to write what was done to the log (JSON), beside the truth.

    Returns
    -------
    facts : numbers of packets and shots, of returns by their kind, of lost ones by cause (see
        `thalweg_lab.instruments.scanner.COUNTS`), and the defects of the log.
    """
    motion = motion_of(config, seed) if motion is None else motion
    sensor = LidarSensor.on_board(
        config,
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
            shots = sensor.shoot(first, min(_CHUNK, sensor.n_packets - first))
            shots.write_truth(truth, motion.start_gps_s, drawn[first : first + _CHUNK])
            azimuth, distance, brightness = packets(sensor, shots)
            returns += int(np.count_nonzero(distance))
            counts = {name: n + shots.counts[name] for name, n in counts.items()}
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
        **counts,
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
