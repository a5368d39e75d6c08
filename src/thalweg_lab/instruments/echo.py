"""The echo sounder: depth below the transducer, and its NMEA log with time and position sentences."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayF
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import gauss_markov, generator
from thalweg_lab.instruments.effects import damage_file
from thalweg_lab.instruments.stamps import unix_us
from thalweg_lab.river.materials import Material
from thalweg_lab.river.scene import Scene
from thalweg_lab.voyage.motion import Motion, epochs
from thalweg_lab.voyage.motions import motion_of
from thalweg_lab.voyage.truth import write_effects
from thalweg_lab.writers import nmea

_UNDULATION_M: Final = 45.0
"""Geoid above ellipsoid, as the receiver's coarse model states it."""


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
            lines = [nmea.rmc(stamp, lat[i], lon[i], speed[i], course[i])]
            if stamp // 1_000_000 != second:
                second = stamp // 1_000_000
                lines.append(nmea.gga(stamp, lat[i], lon[i], height[i] - _UNDULATION_M, _UNDULATION_M))
                lines.append(nmea.zda(stamp))
            if np.isfinite(depth[i]) and 0.0 < depth[i] <= echo.max_depth_m:
                lines.append(nmea.dpt(float(depth[i]), echo.offset_m, echo.max_depth_m))
                lines.append(nmea.dbt(float(depth[i])))
            file.write("".join(line + "\r\n" for line in lines))
    facts = {
        "pings": len(t),
        "without_bottom": int(np.sum(~np.isfinite(depth))),
        **damage_file(out_nmea, "echo", config.effects, generator(seed, "echo effects")),
    }
    write_effects(out_effects, "echo", facts)
    return facts
