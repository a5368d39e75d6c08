"""Depths of the bed: the echo sounder's log, and a survey on foot."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS
from scipy.spatial import cKDTree

from thalweg.core import ArrayF, CoverageError, LocalFrame
from thalweg.settings.twin import TwinConfig
from thalweg_lab import writers
from thalweg_lab.instruments.effects import damage_file
from thalweg_lab.random_numbers import gauss_markov, generator
from thalweg_lab.reach import River
from thalweg_lab.river import Material, Scene
from thalweg_lab.voyage import Motion, epochs, motion_of, write_effects
from thalweg_lab.writers import unix_us

_UNDULATION_M: Final = 45.0
"""Geoid above ellipsoid, as the receiver's coarse model states it."""

STRIP_M: Final = 0.8
"""From strip to strip along the river."""
STEP_M: Final = 0.5
"""From point to point across it."""
DEPTHS_M: Final = (0.1, 1.5)
"""Water in which a surveyor wades and a boat floats nearby."""
REACH_M: Final = 2.0
"""How far from the boat's track points are of use."""
_TRACK_HZ: Final = 5.0
_CARELESS_M: Final = 0.05
"""How far from its place in the strip a pole is put down."""


# ---------------------------------------------------------------- echo sounder


def true_depth_m(motion: Motion, scene: Scene, t_gps_s: ArrayF, lever_ics_echo_m: ArrayLike) -> ArrayF:
    """Distance (n,) from the transducer to the bed along the boat's own down axis; NaN where none."""
    bed = scene.only(Material.BED).caster()
    origin = motion.sensor_wcs_m(t_gps_s, np.asarray(lever_ics_echo_m, dtype=np.float64))
    hits = bed.cast(origin, motion.R_wcs_ics(t_gps_s)[:, :, 2])
    return np.where(np.isfinite(hits.t_hit_m), hits.t_hit_m, np.nan)


def simulate_echo(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    out_nmea: Path,
    *,
    lever_ics_echo_m: ArrayLike,
    out_effects: Path | None = None,
) -> dict[str, Any]:
    """Record the depth and write an NMEA log: RMC, DPT and DBT at each ping, GGA and ZDA each second.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    frame : the world frame.
    scene : file of `simulate_scene`.
    out_nmea : target.
    lever_ics_echo_m : (3,) true place of the transducer's face in the body frame.
    out_effects : where to write what was done to the log (JSON), beside the truth.

    Returns
    -------
    facts : number of pings, and the defects of the log.

    Raises
    ------
    ConfigError : a leap second falls into the recording.
    """
    echo = config.echo
    motion = motion_of(config, seed)
    t = epochs(config, echo.rate_hz)
    rng = generator(seed, "echo")
    depth = true_depth_m(motion, Scene.read(scene), t, lever_ics_echo_m) + rng.normal(0, echo.sigma_m, len(t))
    own = np.stack(
        [
            gauss_markov(rng, len(t), 1.0 / echo.rate_hz, s, config.ins.position_time_s)
            for s in config.ins.sigma_position_m
        ],
        axis=1,
    )
    lat, lon, height = (a.tolist() for a in frame.to_geodetic(motion.position_wcs_m(t) + own))
    v = motion.velocity_wcs_mps(t)
    course = np.rad2deg(np.arctan2(v[:, 0], v[:, 1])).tolist()
    speed = np.hypot(v[:, 0], v[:, 1]).tolist()
    second = -1
    out_nmea.parent.mkdir(parents=True, exist_ok=True)
    with out_nmea.open("w", encoding="ascii", newline="") as file:
        for i, stamp in enumerate(unix_us(config, t).tolist()):
            lines = [writers.rmc(stamp, lat[i], lon[i], speed[i], course[i])]
            if stamp // 1_000_000 != second:
                second = stamp // 1_000_000
                lines.append(writers.gga(stamp, lat[i], lon[i], height[i] - _UNDULATION_M, _UNDULATION_M))
                lines.append(writers.zda(stamp))
            if np.isfinite(depth[i]) and 0.0 < depth[i] <= echo.max_depth_m:
                lines.append(writers.dpt(float(depth[i]), echo.offset_m, echo.max_depth_m))
                lines.append(writers.dbt(float(depth[i])))
            file.write("".join(line + "\r\n" for line in lines))
    facts = {
        "pings": len(t),
        "without_bottom": int(np.sum(~np.isfinite(depth))),
        **damage_file(out_nmea, "echo", config.effects, generator(seed, "echo effects")),
    }
    write_effects(out_effects, "echo", facts)
    return facts


# ---------------------------------------------------------------- survey on foot


def bed_points(config: TwinConfig, seed: int, scene: Scene) -> ArrayF:
    """True places (n, 3) in wcs of the pole's tip on the bed.

    Raises
    ------
    CoverageError : the boat crossed no water that is shallow enough.
    """
    track = motion_of(config, seed).position_wcs_m(epochs(config, _TRACK_HZ))[:, :2]
    river = River(config.scene, seed)
    along, across = river.to_flow(track[:, 0], track[:, 1])
    s = np.arange(along.min() - REACH_M, along.max() + REACH_M, STRIP_M)
    n = np.arange(across.min() - REACH_M, across.max() + REACH_M, STEP_M)
    grid = np.stack(np.meshgrid(s, n, indexing="ij"), axis=-1).reshape(-1, 2)
    places = river.to_wcs(grid[:, 0], grid[:, 1])
    places = places + _CARELESS_M * generator(seed, "bed survey places").standard_normal(places.shape)
    places = places[cKDTree(track).query(places, distance_upper_bound=REACH_M)[0] <= REACH_M]
    level = scene.water_level_m
    above = np.column_stack([places, np.full(len(places), level)])
    depth = scene.only(Material.BED).caster().cast(above, np.tile([0.0, 0.0, -1.0], (len(above), 1))).t_hit_m
    low, high = DEPTHS_M
    wet = (depth >= low) & (depth <= high)
    if wet.sum() < 3:
        raise CoverageError(
            f"{int(wet.sum())} places in water of {low:g} to {high:g} m near the boat's track",
            expected="a bed that can be surveyed on foot",
            cure="Switch twin.echo.bed_survey off, or let the boat go nearer to the banks "
            "(twin.boat.bank_distance_m)",
        )
    return np.column_stack([places[wet], level - depth[wet]])


def simulate_bed_survey(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    out_bed: Path,
    *,
    crs: str,
    out_effects: Path | None = None,
) -> dict[str, Any]:
    """Survey the bed and write its points as CSV: east_m, north_m, h_ell_m, sigma_m.

    Parameters
    ----------
    config, seed, frame, scene : as in `thalweg_lab.instruments.bed.simulate_echo`.
    out_bed : target.
    crs : projected CRS of the campaign; heights are ellipsoidal.
    out_effects : where to write what was done to the points (JSON), beside the truth.

    Returns
    -------
    facts : number of points, and the common error of their heights.

    Raises
    ------
    CoverageError : see `bed_points`.
    """
    echo = config.echo
    points = bed_points(config, seed, Scene.read(scene))
    datum_m = echo.sigma_bed_datum_m * float(generator(seed, "bed survey datum").standard_normal())
    points = points + echo.sigma_bed_m * generator(seed, "bed survey").standard_normal(points.shape)
    points[:, 2] += datum_m
    rows = frame.to_map(points, CRS.from_user_input(crs)).tolist()
    lines = ["east_m,north_m,h_ell_m,sigma_m"]
    lines += [f"{east:.3f},{north:.3f},{height:.3f},{echo.sigma_bed_m:.3f}" for east, north, height in rows]
    out_bed.parent.mkdir(parents=True, exist_ok=True)
    out_bed.write_text("\n".join(lines) + "\n", encoding="ascii")
    facts = {"points": len(points), "datum_m": datum_m}
    write_effects(out_effects, "bed_survey", facts)
    return facts
