"""Two pictures of the reach from the boat's true place: the right bank from mid-river, and its water line.

They are for people, and show what the scene holds; the images of the camera have a lens of their own.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core import ArrayF, GeometryError, LocalFrame, utc_text_from_gps
from thalweg.settings.twin import TwinConfig
from thalweg_lab.river import Scene, Waves
from thalweg_lab.river_images.daylight import Sun
from thalweg_lab.river_images.picture import SKY, Painter, Picture
from thalweg_lab.river_images.pinhole import PictureCamera
from thalweg_lab.voyage import Voyage, start_unix

FORMAT = 1
"""Version of the file of a view."""

MAST_M: Final = 0.9
"""Height of the camera above the origin of the INS."""

BANK_PX: Final = (1600, 900)
BANK_FOCAL_PX: Final = 1386.0
"""60 degrees across."""

DETAIL_PX: Final = (1200, 800)
DETAIL_PIXEL_M: Final = 0.003
"""Size of a pixel of the second picture at the water line."""

_NEAR_M: Final = 3.0
"""The second picture is taken from the places of the boat that are at most this much farther from the bank
than the nearest one."""
_MOST_PLACES: Final = 100
_MOSTLY: Final = 0.5
"""Share of a patch of the bank that is in the sun if it is mostly sunlit."""
_LIFT_M: Final = 0.002

_FALLBACK_SUN: Final = Sun(azimuth_rad=float(np.deg2rad(150.0)), elevation_rad=float(np.deg2rad(42.0)))
_LOW_SUN_RAD: Final = float(np.deg2rad(8.0))


def simulate_view(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    out_bank: Path,
    out_detail: Path,
    *,
    samples: int = 2,
    shrink: int = 1,
) -> None:
    """Write both pictures as ``.npz``: image, range, material, and a JSON text with the facts.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    frame : local frame; says where the sun stands.
    scene : written by `simulate_scene`.
    out_bank : the right bank, from the place in mid-river that the boat passes nearest to half time.
    out_detail : the water line of the right bank, from the boat's place nearest to it from which most of what
        it shows is in the sun; if none of the places near the bank is such, from the nearest.
    samples : rays along each side of a pixel.
    shrink : pictures with this many times fewer and larger pixels along each side, for a quick look.
    """
    voyage = Voyage(config, seed)
    world = Scene.read(scene)
    sun, true_sun = _sun(config, frame)
    waves = Waves.draw(seed, rms_slope=config.lidar.wave_slope)
    painter = Painter(world, sun=sun, waves=waves)
    t, n = _track(voyage)
    bank = int(np.argmin(np.abs(n) / np.ptp(n) + 0.3 * np.abs(t / config.duration_s - 0.5)))
    near = _near_place(voyage, painter, world.water_level_m, t, n)
    for out, at, name in ((out_bank, bank, "bank"), (out_detail, near, "detail")):
        camera = _bank_camera(voyage, t[at]) if name == "bank" else _detail_camera(voyage, t[at])
        camera = _shrunk(camera, shrink)
        picture = painter.paint(camera, t_s=float(t[at]), samples=samples, exposure=None)
        distance_m = _distance_m(picture)
        facts: dict[str, object] = {
            "format": "thalweg twin view",
            "version": FORMAT,
            "view": name,
            "utc": utc_text_from_gps(voyage.start_gps_s + float(t[at]), 0),
            "position_wcs_m": [round(float(x), 3) for x in camera.position_wcs_m],
            "height_above_water_m": round(float(camera.position_wcs_m[2]) - world.water_level_m, 3),
            "focal_px": camera.focal_px,
            "distance_m": distance_m,
            "pixel_mm": round(1000.0 * distance_m / camera.focal_px, 2),
            "sun_azimuth_deg": round(float(np.rad2deg(sun.azimuth_rad)), 1),
            "sun_elevation_deg": round(float(np.rad2deg(sun.elevation_rad)), 1),
            "sun_of_the_time": true_sun,
        }
        _write(picture, facts, out)


def _track(voyage: Voyage) -> tuple[ArrayF, ArrayF]:
    """Seconds since the start, about each 0.1 s, and the place across the river, positive to the left."""
    steps = max(int(voyage.config.duration_s / 0.1), 2)
    t = np.linspace(0.0, voyage.config.duration_s, steps)
    position = voyage.position_at(t)
    return t, voyage.river.to_flow(position[:, 0], position[:, 1])[1]


def _near_place(voyage: Voyage, painter: Painter, water_m: float, t: ArrayF, n: ArrayF) -> int:
    """Which of the places (m,) is the nearest to the right bank that has most of it in the sun before it."""
    score = n + 1e-3 * np.abs(t - voyage.config.duration_s / 2)
    order = np.argsort(score, kind="stable")
    order = order[score[order] <= score[order[0]] + _NEAR_M]
    # A few dozen on a long voyage, the nearest one among them: they follow each other in steps of 4 cm.
    order = order[:: -(-len(order) // _MOST_PLACES)]
    for place in order.tolist():
        if _sunlit_share(_detail_camera(voyage, t[place]), painter, water_m) > _MOSTLY:
            return int(place)
    return int(order[0])


def _sunlit_share(camera: PictureCamera, painter: Painter, water_m: float) -> float:
    """Share of the land in a picture that the sun shines on, from 30 by 20 rays."""
    ray = _shrunk(camera, DETAIL_PX[0] // 30).rays((0.5, 0.5))
    hits = painter.caster.cast(camera.position_wcs_m, ray)
    point = camera.position_wcs_m + np.where(np.isfinite(hits.t_hit_m), hits.t_hit_m, 0.0)[:, None] * ray
    land = np.isfinite(hits.t_hit_m) & (point[:, 2] > water_m)
    if not land.any():
        return 0.0
    ray, point, normal = ray[land], point[land], hits.normal[land]
    normal = np.where((np.sum(normal * ray, axis=1) > 0)[:, None], -normal, normal)
    sun = painter.sun.direction_wcs
    way = np.tile(sun, (len(point), 1))
    free = painter.caster.free(point + _LIFT_M * normal, way)
    return float(np.mean(free & (normal @ sun > 0)))


def _sun(config: TwinConfig, frame: LocalFrame) -> tuple[Sun, bool]:
    """The sun at the begin of the campaign, or, if that is at night, one of a late morning."""
    whole, _ = start_unix(config)
    try:
        sun = Sun.at(float(whole), frame.lat_deg, frame.lon_deg)
    except GeometryError:
        return _FALLBACK_SUN, False
    return (sun, True) if sun.elevation_rad > _LOW_SUN_RAD else (_FALLBACK_SUN, False)


def _eye(voyage: Voyage, t_s: float) -> tuple[ArrayF, float]:
    """Position (3,) of the camera and its place along the river."""
    position = voyage.position_at(np.array([t_s]))[0]
    s, _ = voyage.river.to_flow(position[:1], position[1:2])
    return position + np.array([0.0, 0.0, MAST_M]), float(s[0])


def _shore(voyage: Voyage, s_m: float, behind_m: float, height_m: float) -> ArrayF:
    """A point (3,) behind the right shore."""
    s = np.array([s_m])
    right, _ = voyage.river.shores(s)
    xy = voyage.river.to_wcs(s, -right - behind_m)[0]
    return np.append(xy, voyage.config.scene.water_level_m + height_m)


def _bank_camera(voyage: Voyage, t_s: float) -> PictureCamera:
    eye, s = _eye(voyage, t_s)
    target = _shore(voyage, s, 2.0, 1.9)
    return PictureCamera.look(eye, target, focal_px=BANK_FOCAL_PX, size_px=BANK_PX)


def _detail_camera(voyage: Voyage, t_s: float) -> PictureCamera:
    eye, s = _eye(voyage, t_s)
    target = _shore(voyage, s, 0.2, 0.25)
    focal = float(np.linalg.norm(target - eye)) / DETAIL_PIXEL_M
    return PictureCamera.look(eye, target, focal_px=focal, size_px=DETAIL_PX)


def _shrunk(camera: PictureCamera, times: int) -> PictureCamera:
    width, height = camera.size_px
    return replace(camera, focal_px=camera.focal_px / times, size_px=(width // times, height // times))


def _distance_m(picture: Picture) -> float:
    """Median range of what is no sky in the middle of the picture, metres."""
    h, w = picture.range_m.shape
    middle = np.s_[2 * h // 5 : 3 * h // 5, 2 * w // 5 : 3 * w // 5]
    seen = picture.range_m[middle][picture.material[middle] != SKY]
    return round(float(np.median(seen)), 2) if seen.size else float("nan")


def _write(picture: Picture, facts: dict[str, object], out: Path) -> None:
    out.parent.mkdir(parents=True, exist_ok=True)
    with out.open("wb") as file:
        np.savez_compressed(
            file,
            image=picture.image,
            range_m=picture.range_m.astype(np.float32),
            material=picture.material,
            facts=np.array(json.dumps(facts)),
        )
