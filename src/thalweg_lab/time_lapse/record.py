"""The recording: images, control points' survey, and the truth apart."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayF32, ArrayU8
from thalweg.settings.twin.sections import TwinConfig
from thalweg.settings.twin.time_lapse import TwinTimeLapse
from thalweg_lab.base.random import generator
from thalweg_lab.base.river import River
from thalweg_lab.river.materials import Material
from thalweg_lab.river.scene import Scene
from thalweg_lab.river.shading import metered
from thalweg_lab.river.waves import Waves
from thalweg_lab.river_images.daylight import Sun
from thalweg_lab.time_lapse.own_boat import OwnBoat
from thalweg_lab.time_lapse.plan import Plan, Shot, plan_images
from thalweg_lab.time_lapse.renderer import Renderer
from thalweg_lab.time_lapse.survey import surveyed, write_poses, write_survey, write_truth
from thalweg_lab.time_lapse.targets import Targets, place_targets
from thalweg_lab.time_lapse.world import World
from thalweg_lab.voyage.motion import start_unix
from thalweg_lab.voyage.voyage import Voyage
from thalweg_lab.writers.jpeg import PhotoFacts, write_jpeg
from thalweg_lab.yard_images.exposure import exposed
from thalweg_lab.yard_images.images import BOAT_SENSOR_MM, FULL_FRAME_MM, mount_of
from thalweg_lab.yard_images.lens_rays import LensRays
from thalweg_lab.yard_records.image_times import clock_minus_utc_s

_FALLBACK_SUN: Final = Sun(azimuth_rad=float(np.deg2rad(150.0)), elevation_rad=float(np.deg2rad(42.0)))
"""For campaigns at night."""

_LOW_SUN_RAD: Final = float(np.deg2rad(8.0))
_METERED: Final = 2.3 * 0.85
"""The exposure of `metered` is for light that becomes white at 1; here that is 2.3, in another tone curve."""

_EXPOSURES: Final = (0.4, 2.5)


@dataclass(frozen=True, slots=True)
class TimeLapse:
    """Everything that the images of a campaign are made from.

    Parameters
    ----------
    config, settings : sections ``twin`` and ``twin.time_lapse``.
    seed : seed of the campaign.
    plan : exposures and lens.
    targets : boards on the bank.
    renderer : sees.
    voyage : true motion.
    """

    config: TwinConfig
    settings: TwinTimeLapse
    seed: int
    plan: Plan
    targets: Targets
    renderer: Renderer
    voyage: Voyage

    @classmethod
    def of(
        cls,
        config: TwinConfig,
        settings: TwinTimeLapse,
        seed: int,
        frame: LocalFrame,
        scene: Scene,
        mounts: Mapping[str, Any],
    ) -> "TimeLapse":
        """Plan the images and place the boards.

        Parameters
        ----------
        config, settings : sections ``twin`` and ``twin.time_lapse``.
        seed : seed of the campaign.
        frame : local frame; says where the sun stands.
        scene : the twin's world.
        mounts : true mounts, with ``camera``.

        Raises
        ------
        ConfigError : no mount of the camera, no image, or no places for the control points.
        """
        plan = plan_images(config, settings, seed, mounts)
        sun = _sun(config, frame)
        bare = scene.without(Material.WATER).caster()
        targets = place_targets(River(config.scene, seed), bare, plan.camera, plan.poses, settings, seed)
        world = World(scene, targets, sun)
        lens = LensRays(plan.camera, field_of_view_deg=plan.lens.field_of_view_deg)
        effects, boat = settings.effects, None
        if effects.hull:
            boat = OwnBoat.seen(lens, mounts, mount_of(mounts["camera"]), waterline_m=config.boat.height_m)
        renderer = Renderer(
            world,
            lens,
            waves=Waves.draw(seed, rms_slope=config.lidar.wave_slope) if effects.waves else None,
            boat=boat,
            clouds=effects.clouds,
            glare=effects.glare,
            supersampling=settings.supersampling,
        )
        return cls(config, settings, seed, plan, targets, renderer, Voyage(config, seed))

    def light(self, k: int) -> ArrayF32:
        """Linear light (h, w, 3) of image k before lens and sensor."""
        shot = self.plan.shots[k]
        R = self.voyage.R_wcs_ics(np.array([shot.t_gps_s]))[0]
        return self.renderer.see(shot.T_wcs_ccs, R, t_s=shot.since_s, grain=k + 1)

    def render_image(self, k: int) -> ArrayU8:
        """Image k (h, w, 3), sRGB; it depends on no other image.

        Raises
        ------
        GeometryError : there is no such image.
        """
        if not 0 <= k < len(self.plan.shots):
            raise GeometryError(f"image {k}", expected=f"0 to {len(self.plan.shots) - 1}")
        shot, lens, effects = self.plan.shots[k], self.plan.lens, self.settings.effects
        light = self.light(k)
        exposure = float(np.clip(_METERED * metered(light[::4, ::4].astype(np.float64)), *_EXPOSURES))
        sharpness = lens.sharpness_px if effects.blur else 0.0
        if not shot.sharp:
            sharpness = float(np.hypot(sharpness, self.settings.defocus_px))
        # No check of bounds: defocus may be more than a lens in the campaign file is allowed.
        changes = {"sharpness_px": sharpness, "noise": lens.noise if effects.noise else 0.0}
        return exposed(
            light,
            lens.model_copy(update=changes),
            generator(self.seed, f"time lapse sensor {k}"),
            smear_px=shot.smear_px if effects.blur else (0.0, 0.0),
            exposure=exposure,
        )

    def write_image(self, k: int, folder: Path) -> list[str]:
        """Render and write image k, and its copy if it has one; gives the names of the files."""
        shot = self.plan.shots[k]
        image, facts = self.render_image(k), self._facts(shot)
        names = [name for name in (shot.name, shot.copy_name) if name]
        for name in names:
            write_jpeg(folder / name, image, facts, quality=self.settings.jpeg_quality)
        return names

    def _facts(self, shot: Shot) -> PhotoFacts:
        lens = self.plan.lens
        wide = lens.focal_px / lens.size_px[0]
        return PhotoFacts(
            model="boat camera",
            clock_us=shot.stamp_us if shot.stamped else None,
            sub_seconds=3 if shot.stamped else 0,
            zone="+00:00" if shot.stamped else None,
            focal_mm=round(wide * BOAT_SENSOR_MM, 1),
            focal_35mm=round(wide * FULL_FRAME_MM),
            exposure_s=self.config.camera.exposure_s,
        )


def simulate_time_lapse(
    config: TwinConfig,
    settings: TwinTimeLapse,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    mounts: Mapping[str, Any],
    out_images: Path,
    out_control_points: Path,
    *,
    out_poses: Path,
    out_truth: Path,
    only: Sequence[int] | None = None,
) -> int:
    """Take and write the images of a voyage, the survey of the control points, and the truth.

    Parameters
    ----------
    config, settings : sections ``twin`` and ``twin.time_lapse``.
    seed : seed of the campaign.
    frame : local frame of the campaign.
    scene : written by `simulate_scene`.
    mounts : true mounts, with ``camera``.
    out_images : folder for the images.
    out_control_points : CSV, see `survey.surveyed`.
    out_poses : true poses of the images, table kind ``image_poses``.
    out_truth : true camera, control points and defects, JSON.
    only : numbers of the images to render, for jobs that share the work; None: all.

    Returns
    -------
    n : number of written images.

    Raises
    ------
    ConfigError : no mount of the camera, no image, or no places for the control points.
    """
    recording = TimeLapse.of(config, settings, seed, frame, Scene.read(scene), mounts)
    plan = recording.plan
    table, swapped = surveyed(recording.targets, settings, seed)
    out_images.mkdir(parents=True, exist_ok=True)
    files = 0
    for k in range(len(plan.shots)) if only is None else only:
        files += len(recording.write_image(k, out_images))
    write_survey(out_control_points, table)
    write_poses(out_poses, plan, frame)
    since = np.array([shot.since_s for shot in plan.shots])
    write_truth(out_truth, plan, recording.targets, swapped, clock_minus_utc_s(config.camera, since))
    return files


def _sun(config: TwinConfig, frame: LocalFrame) -> Sun:
    """The sun at the begin of the campaign, or, if that is at night, one of a late morning."""
    whole, _ = start_unix(config)
    try:
        sun = Sun.at(float(whole), frame.lat_deg, frame.lon_deg)
    except GeometryError:
        return _FALLBACK_SUN
    return sun if sun.elevation_rad > _LOW_SUN_RAD else _FALLBACK_SUN
