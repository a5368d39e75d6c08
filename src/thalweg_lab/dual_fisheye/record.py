"""The recording: files of the survey and of the room, the survey of the room, and the truth apart."""

from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core import ArrayF, ArrayI, LocalFrame, Rigid, steps, write_marked
from thalweg.settings.sections import Rig as RigSettings
from thalweg_lab.dual_fisheye.device import LENSES, TrueRig, true_rig
from thalweg_lab.dual_fisheye.room import LAYOUT, room_photographer, room_points, room_poses
from thalweg_lab.random_numbers import generator
from thalweg_lab.river import Scene, Waves
from thalweg_lab.settings import TwinConfig, TwinDualFisheye
from thalweg_lab.time_lapse import OwnBoat, Renderer, World, metered_exposure, sun_of
from thalweg_lab.voyage import Voyage, read_true_mounts, true_mounts
from thalweg_lab.writers import PhotoFacts, start_us, true_poses, write_jpeg
from thalweg_lab.yard_images import LensRays, mount_of, run_name

KIND: Final = "thalweg twin dual fisheye"
_SENSOR_MM: Final = 6.2
_FULL_FRAME_MM: Final = 36.0
_FIELD_DAY_S: Final = 86_400
"""The room was photographed the day before."""


def offset_of(zone: str) -> float:
    """Seconds of a zone such as ``+02:00``."""
    hours, minutes = zone[1:].split(":")
    return (1 if zone[0] == "+" else -1) * (3600.0 * int(hours) + 60.0 * int(minutes))


def simulate_dual_fisheye(
    config: TwinConfig,
    settings: TwinDualFisheye,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    mounts: Path,
    rig: RigSettings,
    device: dict[str, Any],
    *,
    images: Path,
    poses: Path,
    panorama: Path,
    truth: Path,
) -> None:
    """Write the files of the survey, and the truth.

    Parameters
    ----------
    config, settings : sections ``twin`` and ``twin.dual_fisheye``.
    seed : seed of the campaign.
    frame : local frame; says where the sun stands.
    scene : written by `simulate_scene`.
    mounts : true mounts of the boat's other sensors.
    rig : section ``rig``: the mount that the true one is drawn about.
    device : ``seed`` and ``settings`` of the campaign in whose room the rig was calibrated.
    images : folder of files by the local time in ms.
    poses : true poses of the front lens, table kind ``image_poses``.
    panorama : ``.npz``: what is seen from the centre of the rig at the middle exposure: ``light`` (h, w, 3),
        ``range_m`` (h, w), ``sunlit`` (h, w), and its pose; level, as `thalweg.panorama` has it.
    truth : true interiors, relative orientation, mount and times, JSON.
    """
    true = true_rig(TwinDualFisheye(**device["settings"]), device["seed"])
    on_boat = read_true_mounts(mounts)
    mount = true_mounts({"rig": rig.mount.model_dump()}, seed, on=config.effects.mount_errors)["rig"]
    T_ics_front = mount_of(mount)
    voyage = Voyage(config, seed)
    released, exposed_s, ahead, stamp_us = _times(config, settings, seed)
    at = voyage.start_gps_s + exposed_s
    place, R = voyage.position_wcs_m(at), voyage.R_wcs_ics(at)
    fronts = [Rigid(R=R[k], shift_m=place[k]) @ T_ics_front for k in range(len(at))]

    world = World(Scene.read(scene), None, sun_of(config, frame))
    waves = Waves.draw(seed, rms_slope=config.lidar.wave_slope)
    lenses = {name: T_ics_front @ place for name, place in true.T_front_lens.items()}
    see = {
        name: Renderer(
            world,
            rays,
            waves=waves,
            boat=OwnBoat.seen(rays, on_boat, lenses[name], waterline_m=config.boat.height_m)
            if settings.hull
            else None,
            glare=settings.glare,
            supersampling=settings.supersampling,
        ).see
        for name, rays in true.rays().items()
    }
    zone_us = int(1e6 * offset_of(settings.zone))
    names = [run_name(stamp + zone_us) for stamp in stamp_us.tolist()]
    for k in steps(range(len(at)), "exposure"):
        boat, since_s = Rigid(R=R[k], shift_m=place[k]), float(exposed_s[k])
        light = {name: see[name](boat @ lenses[name], boat.R, t_s=since_s, grain=k + 1) for name in LENSES}
        picture = true.file_of(
            light, generator(seed, f"dual fisheye {k}"), metered_exposure(light["front"][160:-160, 160:-160])
        )
        write_jpeg(images / names[k], picture, _facts(settings, int(stamp_us[k]) + zone_us), quality=93)
    source = "digital twin, true poses of the front lens"
    true_poses(names, at, fronts, frame, source).write(poses)
    _write_panorama(panorama, world, waves, fronts[len(at) // 2], true, exposed_s[len(at) // 2])
    write_marked(
        truth,
        kind=KIND,
        version=1,
        content={
            "rig": true.facts(),
            "mount": mount,
            "images": [
                {"file": name, "t_gps_s": float(t), "clock_minus_utc_s": float(c), "stamp_error_s": float(e)}
                for name, t, c, e in zip(names, at, ahead, exposed_s - released, strict=True)
            ],
        },
    )


def _times(config: TwinConfig, settings: TwinDualFisheye, seed: int) -> tuple[ArrayF, ArrayF, ArrayF, ArrayI]:
    """Release and exposure since the begin of the survey, what the clock is ahead, its stamps in us."""
    rng = generator(seed, "dual fisheye shutter")
    n = settings.images
    released = np.asarray(config.duration_s / 2 + (np.arange(n) - (n - 1) / 2) / settings.rate_hz)
    exposed_s: ArrayF = released + settings.jitter_s * rng.standard_normal(n)
    ahead: ArrayF = settings.clock_offset_s + 1e-6 * settings.clock_drift_ppm * released
    stamp_us = 1000 * np.rint((released + ahead) * 1e3 + start_us(config) * 1e-3).astype(np.int64)
    return released, exposed_s, ahead, stamp_us


def _facts(settings: TwinDualFisheye, clock_us: int) -> PhotoFacts:
    wide = settings.focal_px / settings.circle_px
    return PhotoFacts(
        model="dual fisheye",
        clock_us=clock_us,
        sub_seconds=0,
        zone=None,
        focal_mm=round(wide * _SENSOR_MM, 1),
        focal_35mm=round(wide * _FULL_FRAME_MM),
    )


def simulate_rig_field(
    config: TwinConfig, settings: TwinDualFisheye, seed: int, *, images: Path, field: Path, field_points: Path
) -> None:
    """Write files of the rig amid a room of marker sheets, the day before the survey.

    Parameters
    ----------
    config, settings, seed : as of `simulate_dual_fisheye`.
    images : folder of files by the local time in ms.
    field, field_points : description of the room's markers, and their survey.
    """
    device = true_rig(settings, seed)
    points, _ = room_points(seed, settings.sigma_field_m)
    field.parent.mkdir(parents=True, exist_ok=True)
    points.table().to_csv(field_points, index=False, float_format="%.6f", lineterminator="\n")
    field.write_text(
        "# A room of marker sheets around the rig.\nthalweg_field: 1\n"
        f"markers: {{dictionary: {LAYOUT.dictionary}, module_m: {LAYOUT.module_m}}}\n"
    )
    photographer, rays = room_photographer(), device.rays()
    begin = start_us(config) - 1_000_000 * _FIELD_DAY_S + int(1e6 * offset_of(settings.zone))
    for k, pose in enumerate(room_poses(seed, settings.field_images)):
        light = {
            name: photographer.see(rays[name], pose @ device.T_front_lens[name]).light for name in LENSES
        }
        picture = device.file_of(light, generator(seed, f"dual fisheye room {k}"), 1.3)
        stamp = begin + 5_000_000 * k
        write_jpeg(images / run_name(stamp), picture, _facts(settings, stamp), quality=93)


class _Sphere(LensRays):
    """Rays of an equirectangular picture, see `thalweg.panorama`."""

    def __init__(self, width_px: int) -> None:
        from thalweg.panorama import sphere_rays

        self.rays_ccs = sphere_rays(width_px).astype(np.float32)


def _write_panorama(
    path: Path, world: World, waves: Waves, front: Rigid, device: TrueRig, since_s: float
) -> None:
    """What is seen from the middle of the rig, by ray casting."""
    from thalweg.panorama import default_width_px, level_attitude

    pose = Rigid(R=level_attitude(front.R), shift_m=front.apply(device.centre_front_m[None])[0])
    rays = _Sphere(default_width_px(device.cameras["front"]))
    renderer = Renderer(world, rays, waves=waves, boat=None, glare=False)
    light = renderer.see(pose, np.eye(3), t_s=float(since_s), grain=1)
    way = rays.rays_ccs.reshape(-1, 3) @ pose.R.T.astype(np.float32)
    hits = world.caster.cast(pose.shift_m, way)
    met = np.flatnonzero(np.isfinite(hits.t_hit_m))
    normal = hits.normal[met].astype(np.float64)
    # of both sides of a surface the seen one
    normal *= np.where(np.sum(normal * way[met], axis=1) > 0, -1.0, 1.0)[:, None]
    lit = np.zeros(len(way), dtype=np.bool_)
    place = pose.shift_m + hits.t_hit_m[met, None] * way[met]
    lit[met] = (normal @ world.sun.direction_wcs > 0) & (world.sunlit(place, normal) > 0)
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        path,
        light=light.astype(np.float16),
        range_m=hits.t_hit_m.reshape(light.shape[:2]).astype(np.float32),
        sunlit=lit.reshape(light.shape[:2]),
        T_wcs_pano=pose.matrix,
    )
