"""What is recorded in the calibration field: notes of its owner, captures, points, times of images."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import yaml
from scipy.spatial.transform import Rotation

from thalweg.core import (
    ArrayB,
    ArrayF,
    ArrayI,
    ArrayU8,
    ConfigError,
    LocalFrame,
    column,
    frame_of,
    njit,
    table_kind,
    write_table,
)
from thalweg_lab.instruments import (
    FIRING_S,
    LASER_S,
    ROTATION_HZ,
    VLP_16,
    Beams,
    Lasers,
    LidarSensor,
    Shots,
    as_it_errs,
    simulate_lidar,
)
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import TwinCamera, TwinConfig, TwinField
from thalweg_lab.voyage import standing, start_gps_s, static_seed, write_effects
from thalweg_lab.writers import start_us
from thalweg_lab.yard import (
    ANTENNA,
    ANTENNA_OFFSET_M,
    CONE_M,
    FLAT,
    FLAT_MODULE_M,
    Field,
    build_field,
    field_of,
    recorded,
)

KIND: Final = "thalweg twin field"
FIELD_POSES: Final = table_kind(
    "twin_field_poses",
    1,
    [
        column("name", "1", "position_1, position_2 ...", pa.string()),
        column("begin_t_gps_s", "s", "begin of the lidar recording, adjusted standard GPS time"),
        column("end_t_gps_s", "s", "end of the lidar recording"),
        *(column(f"{a}_m", "m", f"{a} of the ics origin, wcs") for a in ("east", "north", "up")),
        *(column(f"q_{a}", "1", f"quaternion of R_wcs_ics, {a}, scalar last") for a in "xyzw"),
    ],
)

_SIGMA_BAR_M: Final = 0.00003
"""Error of the certificates of the scale bars."""
_SIGMA_ANTENNA_OFFSET_M: Final = 0.001
"""Error of the stated offset of the antenna."""
_INTERVAL_JITTER_S: Final = 0.004
"""Scatter of the time between two exposures of a run."""
_CHUNK: Final = 6144
"""Firings at a time, as in `thalweg_lab.instruments.lidar`."""
_UNIT_M: Final = 0.002
"""Step of the ranges that a VLP-16 reports."""

_STATIC_S: Final = 1.2
"""A static image is taken this long after the lidar starts."""


# ---------------------------------------------------------------- what the owner writes down, and what is
# true


def simulate_field_scene(config: TwinConfig, seed: int, out_scene: Path) -> None:
    """Write the field with the boat's recording time and people as the scene of the dynamic run."""
    recorded(config, seed, "run")[1].scene.write(out_scene)


def simulate_field(
    config: TwinConfig, seed: int, frame: LocalFrame, *, out_field: Path, out_truth: Path, out_poses: Path
) -> None:
    """Write the description of the field as its owner knows it, and the truth.

    Parameters
    ----------
    config : section ``twin`` with ``field``.
    seed : seed of the campaign.
    frame : the world frame.
    out_field : ``field.yaml``: nominal cones, certificates of the scale bars, RTK positions of the targets.
    out_truth : JSON: true cones, saddles, bars and targets.
    out_poses : true poses of the static positions, table kind ``twin_field_poses``.

    Raises
    ------
    ConfigError : the section ``twin.field`` is missing.
    """
    field = build_field(config, seed)
    _write_text(out_field, description(field, seed, frame))
    truth = {
        "kind": KIND,
        "version": 1,
        "frame": "wcs, metres; axes from the apex into the cone",
        **_facts(field),
        "effects": field.config.effects.model_dump(mode="json"),
    }
    _write_text(out_truth, json.dumps(truth, indent=1) + "\n")
    write_table(out_poses, frame_of(FIELD_POSES, _poses(config)), FIELD_POSES)


def description(field: Field, seed: int, frame: LocalFrame) -> str:
    """Text of ``field.yaml``.

    Certificates of bars and positions of targets carry errors of the stated sigmas; the cones are as planned.
    """
    f = field.config
    rng = generator(seed, "field certificates")
    bars, targets = [], []
    for bar in field.bars:
        certified = bar.length_m + _SIGMA_BAR_M * rng.standard_normal()
        ends = {"from": f"{bar.markers[0]}/0", "to": f"{bar.markers[1]}/0"}
        length = {"length_m": round(float(certified), 7), "sigma_m": _SIGMA_BAR_M}
        bars.append({"name": bar.name, **ends, **length})
    rng = generator(seed, "field targets")
    for target, place in zip(field.targets, _target_places(field), strict=True):
        measured = place + np.asarray(f.sigma_target_m) * rng.standard_normal(3)
        lat, lon, height = (float(a) for a in frame.to_geodetic(measured))
        targets.append(
            {
                "name": target.name,
                "marker": target.marker,
                "lat_deg": round(lat, 10),
                "lon_deg": round(lon, 10),
                "h_ell_m": round(height, 4),
                "sigma_m": list(f.sigma_target_m),
            }
        )
    error = _SIGMA_ANTENNA_OFFSET_M * float(generator(seed, "field antenna offset").standard_normal())
    facts = {
        "thalweg_field": 1,
        "markers": {
            "dictionary": "DICT_4X4_250",
            "module_m": f.module_m,
            "sizes": [{"ids": list(FLAT), "module_m": FLAT_MODULE_M}],
        },
        "cones": [
            {
                "name": cone.name,
                "markers": [cone.markers[0], cone.markers[-1]],
                "half_angle_deg": f.half_angle_deg,
                "length_m": CONE_M[1],
            }
            for cone in field.cones
        ],
        "scale_bars": bars,
        "targets": targets,
        "antenna": {
            "marker": ANTENNA,
            "offset_m": round(ANTENNA_OFFSET_M + error, 5),
            "sigma_m": _SIGMA_ANTENNA_OFFSET_M,
        },
    }
    return _yaml(facts)


def _yaml(facts: dict[str, Any]) -> str:
    """Sections one after the other, each entry of a list on a line of its own."""
    lines = []
    for key, value in facts.items():
        if isinstance(value, list):
            lines.append(f"{key}:")
            lines += [f"  - {_flow(item)}" for item in value]
        else:
            lines.append(f"{key}: {_flow(value)}")
    return "\n".join(lines) + "\n"


def _flow(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000)
    return str(text).removesuffix("\n").removesuffix("\n...")


def _target_places(field: Field) -> list[ArrayF]:
    """True centres (3,): RTK measures what hangs there, whatever id is printed on it."""
    centres = {s.thing: s.centre_wcs_m() for s in field.sheets}
    return [centres[f"board {target.marker}"] for target in field.targets]


def _facts(field: Field) -> dict[str, Any]:
    return {
        "cones": [
            {
                "name": c.name,
                "apex_wcs_m": c.apex_wcs_m.tolist(),
                "axis_wcs": c.axis_wcs.tolist(),
                "half_angle_rad": c.half_angle_rad,
                "start_m": c.start_m,
                "length_m": c.length_m,
                "markers": list(c.markers),
            }
            for c in field.cones
        ],
        "saddles_wcs_m": {f"{m}/{k}": p.tolist() for (m, k), p in field.saddles_wcs_m().items()},
        "markers_on_cones": {str(s.marker): s.cone for s in field.sheets if s.cone is not None},
        "bars": [{"name": b.name, "markers": list(b.markers), "length_m": b.length_m} for b in field.bars],
        "targets": [
            {"name": t.name, "marker": t.marker, "centre_wcs_m": p.tolist()}
            for t, p in zip(field.targets, _target_places(field), strict=True)
        ],
        "antenna_offset_m": ANTENNA_OFFSET_M,
    }


def _poses(config: TwinConfig) -> dict[str, Any]:
    field: TwinField = field_of(config)
    boats = [standing(config, i + 1) for i in range(len(field.positions))]
    poses = [boat.T_wcs_ics for boat in boats]
    place = np.stack([p.shift_m for p in poses])
    q = Rotation.from_matrix(np.stack([p.R for p in poses])).as_quat()
    begin = np.array([boat.start_gps_s for boat in boats])
    return {
        "name": [f"position_{i + 1}" for i in range(len(boats))],
        "begin_t_gps_s": begin,
        "end_t_gps_s": begin + field.position_s,
        **{f"{a}_m": place[:, i] for i, a in enumerate(("east", "north", "up"))},
        **{f"q_{a}": q[:, i] for i, a in enumerate("xyzw")},
    }


def _write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


# ---------------------------------------------------------------- capture files of the static positions


def simulate_positions(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    out_pcaps: Sequence[Path],
    *,
    R_ics_scs: ArrayF,
    lever_ics_scs_m: ArrayF,
    out_effects: Path | None = None,
) -> list[dict[str, Any]]:
    """Record each static position with the lidar and write its capture file.

    Parameters
    ----------
    config : section ``twin`` with ``field``.
    seed : seed of the campaign; each position has noise of its own.
    frame : the world frame.
    out_pcaps : one target a position, in their order.
    R_ics_scs, lever_ics_scs_m : true mount of the scanner.
    out_effects : where to write what was done to the logs (JSON), beside the truth.

    Returns
    -------
    facts : of each position, see `simulate_lidar`.

    Raises
    ------
    ConfigError : not as many targets as positions.
    """
    wanted = len(field_of(config).positions)
    if len(out_pcaps) != wanted:
        raise ConfigError(
            f"{len(out_pcaps)} capture files for {wanted} positions",
            expected="one file for each of twin.field.positions",
            where="twin.field.positions",
        )
    facts = []
    for number, path in enumerate(out_pcaps, start=1):
        motion = standing(config, number)
        facts.append(
            simulate_lidar(
                motion.config,
                static_seed(seed, number),
                frame,
                recorded(config, seed, f"position {number}")[1].scene,
                path,
                R_ics_scs=R_ics_scs,
                lever_ics_scs_m=lever_ics_scs_m,
                motion=motion,
            )
        )
    write_effects(out_effects, "static positions", {"positions": facts})
    return facts


# ---------------------------------------------------------------- lidar points without packets
#
# Noise, dropouts, footprint and mixed pixels are those of `thalweg_lab.instruments.lidar`. Studies over
# many seeds need the surroundings of the cones only; the other beams are then not cast at all.


@dataclass(frozen=True, slots=True, kw_only=True)
class Scan:
    """Returns of n shots, in the order of time.

    Parameters
    ----------
    points_scs_m : (n, 3) as the sensor's reader computes them, noise included.
    ring : (n,) laser, 0 the lowest.
    t_gps_s : (n,) adjusted standard GPS time of the shots, without error.
    reflectivity : (n,) 1 to 100.
    cone : (n,) truth: index of the cone that the echo arose on, -1 if on none or on several things.
    kind : (n,) truth: values of `EchoKind`.
    """

    points_scs_m: ArrayF
    ring: ArrayI
    t_gps_s: ArrayF
    reflectivity: ArrayI
    cone: ArrayI
    kind: ArrayU8


def static_scan(
    config: TwinConfig,
    seed: int,
    number: int,
    *,
    R_ics_scs: ArrayF,
    lever_ics_scs_m: ArrayF,
    revolutions: int | None = None,
    lasers: Lasers = VLP_16,
    near_cones_m: float | None = 0.3,
) -> Scan:
    """Lidar recording of a static position.

    Parameters
    ----------
    config : section ``twin`` with ``field``.
    seed : seed of the campaign.
    number : of the position, from 1.
    R_ics_scs, lever_ics_scs_m : true mount of the scanner.
    revolutions : number of turns; None: as long as ``twin.field.position_s``.
    lasers : of the scanner; P2 Fig. 4: ``Lasers.even(8, 4.0)``.
    near_cones_m : only beams that pass the sphere about a cone within this distance are cast; None: all.
    """
    motion = standing(config, number)
    field, scene = recorded(config, seed, f"position {number}")
    duration_s = motion.config.duration_s
    if revolutions is not None:
        duration_s = revolutions / ROTATION_HZ
    sensor = LidarSensor.on_board(
        motion.config,
        static_seed(seed, number),
        motion,
        scene.scene,
        R_ics_scs=R_ics_scs,
        lever_ics_scs_m=lever_ics_scs_m,
        lasers=lasers,
    )
    return scan(sensor, field, duration_s=duration_s, near_cones_m=near_cones_m)


def scan(sensor: LidarSensor, field: Field, *, duration_s: float, near_cones_m: float | None) -> Scan:
    """What a sensor records in a time from its start; one return a shot, as in the modes with one return.

    Parameters
    ----------
    sensor : on the boat in the field.
    field : for the truth, and for the beams that are worth casting.
    duration_s : whole firings within.
    near_cones_m : see `static_scan`.
    """
    wanted = None if near_cones_m is None else _near(field, near_cones_m)
    total = int(duration_s / FIRING_S)
    parts = [
        _points(sensor, sensor.fire(np.arange(first, min(first + _CHUNK, total)), wanted))
        for first in range(0, total, _CHUNK)
    ]
    points, ring, t_s, reflectivity, surface, kind = (np.concatenate(p) for p in zip(*parts, strict=True))
    return Scan(
        points_scs_m=points,
        ring=ring,
        t_gps_s=sensor.motion.start_gps_s + t_s,
        reflectivity=reflectivity,
        cone=field.cone_of(surface),
        kind=kind,
    )


def _points(sensor: LidarSensor, shots: Shots) -> tuple[Any, ...]:
    """Points in scs, rings, times, reflectivities, true surface points and kinds of the returns."""
    lasers = sensor.lasers
    row, laser = np.divmod(shots.shot, len(lasers.elevation_rad))
    t_s = shots.t_s[row] + LASER_S * laser
    azimuth, elevation = np.deg2rad(sensor.azimuth_deg(t_s)), lasers.elevation_rad[laser]
    range_m = _UNIT_M * shots.distance[0][shots.shot]
    level = range_m * np.cos(elevation)
    height = range_m * np.sin(elevation)
    if sensor.config.lidar.vertical_offsets:
        height = height + lasers.height_m[laser]
    at = np.arange(len(row))
    return (
        np.stack([level * np.sin(azimuth), level * np.cos(azimuth), height], axis=1),
        lasers.ring[laser],
        t_s,
        shots.brightness[0][shots.shot],
        shots.echoes.point_wcs_m[at, shots.last],
        shots.echoes.kind[at, shots.last],
    )


def _near(field: Field, margin_m: float) -> Callable[[Beams], ArrayB]:
    """Tells which beams pass a cone within a margin."""
    spheres = [c.sphere for c in field.cones]
    centre = np.stack([c for c, _ in spheres])
    radius = np.array([r for _, r in spheres]) + margin_m

    def wanted(rays: Beams) -> ArrayB:
        """Beams (n, m) that pass a cone within the margin."""
        out = np.zeros(rays.origin_wcs_m.shape[:2], dtype=np.bool_)
        _passes(rays.origin_wcs_m, rays.direction_wcs, centre, radius, out)
        return out

    return wanted


@njit(cache=True, error_model="numpy")
def _passes(origin: ArrayF, direction: ArrayF, centre: ArrayF, radius: ArrayF, out: ArrayB) -> None:
    for i in range(origin.shape[0]):
        for j in range(origin.shape[1]):
            o, d = origin[i, j], direction[i, j]
            for k in range(len(radius)):
                x, y, z = centre[k, 0] - o[0], centre[k, 1] - o[1], centre[k, 2] - o[2]
                along = x * d[0] + y * d[1] + z * d[2]
                if along > 0.0 and x * x + y * y + z * z - along * along < radius[k] * radius[k]:
                    out[i, j] = True
                    break


# ---------------------------------------------------------------- true exposures, and what the clock wrote


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageTimes:
    """Images in time.

    Parameters
    ----------
    t_gps_s : (n,) true middle of the exposure, adjusted standard GPS time.
    stamp_us : (n,) reading of the camera's clock that it wrote, microseconds since 1970, whole milliseconds.
    clock_minus_utc_s : (n,) what the clock was ahead of UTC when it stamped.
    """

    t_gps_s: ArrayF
    stamp_us: ArrayI
    clock_minus_utc_s: ArrayF


def clock_minus_utc_s(camera: TwinCamera, since_s: ArrayF) -> ArrayF:
    """How far the camera's clock is ahead of UTC (n,), seconds after the begin of the run."""
    return np.asarray(camera.clock_offset_s + camera.clock_drift_ppm * 1e-6 * since_s)


def run_times(config: TwinConfig, seed: int) -> ImageTimes:
    """Times of the images of the dynamic run, from its begin to its end.

    The camera's timer releases at nearly even intervals, and its clock stamps the release. The exposure
    follows with a delay that differs from image to image: that is the error of the stamp.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    """
    camera = config.camera
    rng, shutter = generator(seed, "camera timer"), generator(seed, "camera shutter")
    phase = rng.uniform(0.2, 0.8) / camera.rate_hz
    n = max(int((config.duration_s - phase - 0.2 / camera.rate_hz) * camera.rate_hz) + 1, 1)
    released = phase + np.arange(n) / camera.rate_hz
    # Independent errors of std / sqrt 2 about an even grid give intervals of the stated std.
    released = released + rng.standard_normal(n) * _INTERVAL_JITTER_S / np.sqrt(2.0)
    exposed = released + as_it_errs(config, seed).camera.jitter_s * shutter.standard_normal(n)
    return _times(config, released, exposed)


def static_times(config: TwinConfig, seed: int, begin_gps_s: ArrayF) -> ImageTimes:
    """Times of one image in each static position.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    begin_gps_s : (n,) begin of the lidar's recordings.
    """
    shutter = generator(seed, "camera shutter, static").standard_normal(len(begin_gps_s))
    released = np.asarray(begin_gps_s) + _STATIC_S - start_gps_s(config)
    return _times(config, released, released + as_it_errs(config, seed).camera.jitter_s * shutter)


def _times(config: TwinConfig, released_s: ArrayF, exposed_s: ArrayF) -> ImageTimes:
    """From seconds since the begin of the run."""
    ahead = clock_minus_utc_s(config.camera, released_s)
    stamp_ms = np.rint((released_s + ahead) * 1e3 + start_us(config) * 1e-3).astype(np.int64)
    return ImageTimes(
        t_gps_s=start_gps_s(config) + exposed_s, stamp_us=1000 * stamp_ms, clock_minus_utc_s=ahead
    )
