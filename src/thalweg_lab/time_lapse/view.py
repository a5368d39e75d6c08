"""Two pictures of the reach from the boat's true place: the right bank from mid-river, and its water line.

They are for people, and show what the scene holds: no boards, no own boat, a lens without distortion.
"""

import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.core import ArrayF, LocalFrame, Rigid, utc_text_from_gps
from thalweg_lab.random_numbers import generator
from thalweg_lab.river import Scene, Waves
from thalweg_lab.settings import TwinConfig, TwinLens
from thalweg_lab.time_lapse.record import metered_exposure, sun_of
from thalweg_lab.time_lapse.renderer import Renderer, World
from thalweg_lab.voyage import Voyage
from thalweg_lab.yard import looking
from thalweg_lab.yard_images import LensRays, exposed, true_camera

FORMAT: Final = 2
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


def simulate_view(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    out_bank: Path,
    out_detail: Path,
    *,
    shrink: int = 1,
) -> None:
    """Write both pictures as ``.npz``: image (h, w, 3), sRGB, and a JSON text with the facts.

    Parameters
    ----------
    config : section ``twin``.
    seed : seed of the campaign.
    frame : local frame; says where the sun stands.
    scene : written by `simulate_scene`.
    out_bank : the right bank, from the place in mid-river that the boat passes nearest to half time.
    out_detail : the water line of the right bank, from the boat's place nearest to it from which most of what
        it shows is in the sun; if none of the places near the bank is such, from the nearest.
    shrink : pictures with this many times fewer and larger pixels along each side, for a quick look.
    """
    voyage, sun = Voyage(config, seed), sun_of(config, frame)
    world = World(Scene.read(scene), None, sun)
    t, n = _track(voyage)
    bank = int(np.argmin(np.abs(n) / np.ptp(n) + 0.3 * np.abs(t / config.duration_s - 0.5)))
    views = {
        "bank": (out_bank, bank, _bank(voyage, config, t[bank], shrink)),
        "detail": (out_detail, *_near(voyage, config, world, t, n, shrink)),
    }
    for name, (out, at, (lens, T_wcs_ccs)) in views.items():
        rays = LensRays(true_camera(lens, name))
        renderer = Renderer(world, rays, waves=Waves.draw(seed, rms_slope=config.lidar.wave_slope), boat=None)
        light = renderer.see(T_wcs_ccs, np.eye(3), t_s=float(t[at]), grain=1)
        image = exposed(light, lens, generator(seed, f"view {name}"), exposure=metered_exposure(light))
        distance_m = _distance_m(world, rays, T_wcs_ccs)
        facts: dict[str, Any] = {
            "format": "thalweg twin view",
            "version": FORMAT,
            "view": name,
            "utc": utc_text_from_gps(voyage.start_gps_s + float(t[at]), 0),
            "position_wcs_m": T_wcs_ccs.shift_m.round(3).tolist(),
            "height_above_water_m": round(float(T_wcs_ccs.shift_m[2]) - world.level_m, 3),
            "focal_px": lens.focal_px,
            "distance_m": distance_m,
            "pixel_mm": round(1000.0 * distance_m / lens.focal_px, 2),
            "sun_azimuth_deg": round(float(np.rad2deg(sun.azimuth_rad)), 1),
            "sun_elevation_deg": round(float(np.rad2deg(sun.elevation_rad)), 1),
        }
        out.parent.mkdir(parents=True, exist_ok=True)
        with out.open("wb") as file:
            np.savez_compressed(file, image=image, facts=np.array(json.dumps(facts)))


def _track(voyage: Voyage) -> tuple[ArrayF, ArrayF]:
    """Seconds since the start, about each 0.1 s, and the place across the river, positive to the left."""
    steps = max(int(voyage.config.duration_s / 0.1), 2)
    t = np.linspace(0.0, voyage.config.duration_s, steps)
    position = voyage.position_at(t)
    return t, voyage.river.to_flow(position[:, 0], position[:, 1])[1]


_View = tuple[TwinLens, Rigid]
"""Lens and pose ``T_wcs_ccs`` of a picture."""


def _near(
    voyage: Voyage, config: TwinConfig, world: World, t: ArrayF, n: ArrayF, shrink: int
) -> tuple[int, _View]:
    """The place nearest to the right bank that has most of it in the sun before it, and its picture."""
    score = n + 1e-3 * np.abs(t - config.duration_s / 2)
    order = np.argsort(score, kind="stable")
    order = order[score[order] <= score[order[0]] + _NEAR_M]
    # A few dozen on a long voyage, the nearest one among them: they follow each other in steps of 4 cm.
    places = order[:: -(-len(order) // _MOST_PLACES)].tolist()
    for at in places:
        if _sunlit_share(*_detail(voyage, config, t[at], DETAIL_PX[0] // 30), world) > _MOSTLY:
            return at, _detail(voyage, config, t[at], shrink)
    return places[0], _detail(voyage, config, t[places[0]], shrink)


def _sunlit_share(lens: TwinLens, T_wcs_ccs: Rigid, world: World) -> float:
    """Share of the land in a picture that the sun shines on."""
    ray = LensRays(true_camera(lens, "detail")).rays_ccs.reshape(-1, 3) @ T_wcs_ccs.R.T
    hits = world.caster.cast(T_wcs_ccs.shift_m, ray)
    point = T_wcs_ccs.shift_m + np.where(np.isfinite(hits.t_hit_m), hits.t_hit_m, 0.0)[:, None] * ray
    land = np.isfinite(hits.t_hit_m) & (point[:, 2] > world.level_m)
    if not land.any():
        return 0.0
    ray, point, normal = ray[land], point[land], hits.normal[land].astype(np.float64)
    normal = np.where((np.sum(normal * ray, axis=1) > 0)[:, None], -normal, normal)
    return float(np.mean((world.sunlit(point, normal) > 0) & (normal @ world.sun.direction_wcs > 0)))


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


def _bank(voyage: Voyage, config: TwinConfig, t_s: float, shrink: int) -> _View:
    eye, s = _eye(voyage, t_s)
    return _lens(config, BANK_FOCAL_PX, BANK_PX, shrink), looking(eye, _shore(voyage, s, 2.0, 1.9))


def _detail(voyage: Voyage, config: TwinConfig, t_s: float, shrink: int) -> _View:
    eye, s = _eye(voyage, t_s)
    target = _shore(voyage, s, 0.2, 0.25)
    focal_px = float(np.linalg.norm(target - eye)) / DETAIL_PIXEL_M
    return _lens(config, focal_px, DETAIL_PX, shrink), looking(eye, target)


def _lens(config: TwinConfig, focal_px: float, size_px: tuple[int, int], shrink: int) -> TwinLens:
    """A lens without distortion, as sharp as that of the boat."""
    w, h = size_px
    changes = {"focal_px": focal_px / shrink, "size_px": (w // shrink, h // shrink)}
    plain = {"model": "perspective", "principal_offset_px": (0.0, 0.0), "distortion": (0.0,) * 5}
    return config.camera.model_copy(update={**changes, **plain})


def _distance_m(world: World, rays: LensRays, T_wcs_ccs: Rigid) -> float:
    """Median way to land or water in the middle of a picture, metres; NaN if there is only sky."""
    h, w, _ = rays.rays_ccs.shape
    middle = rays.rays_ccs[2 * h // 5 : 3 * h // 5, 2 * w // 5 : 3 * w // 5].reshape(-1, 3) @ T_wcs_ccs.R.T
    with np.errstate(divide="ignore"):
        water = (world.level_m - T_wcs_ccs.shift_m[2]) / middle[:, 2]
    way = np.fmin(world.caster.cast(T_wcs_ccs.shift_m, middle).t_hit_m, np.where(water > 0, water, np.inf))
    seen = way[np.isfinite(way)]
    return round(float(np.median(seen)), 2) if seen.size else float("nan")
