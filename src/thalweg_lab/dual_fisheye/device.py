"""The device: true lenses, their places, and how both image circles lie in a file."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from thalweg.core import PARAMETERS, ArrayF, ArrayF32, ArrayU8, Camera, Rigid, exp_rotation
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import TwinDualFisheye, TwinLens
from thalweg_lab.yard_images import LensRays, exposed

LENSES: Final = ("front", "back")
_FOCAL_DIFFERENCE_PX: Final = -0.8
"""Camera constant of the back lens minus that of the front lens."""
_BACK_EXPOSURE: Final = 1.12
"""Light of the back lens over that of the front lens."""
_SCATTER: Final = np.array([1e-3, 1e-3, 5e-4, 1e-4])
"""Scatter of the distortion of single lenses of one kind."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueRig:
    """The rig as it really is.

    Parameters
    ----------
    settings : section ``twin.dual_fisheye``.
    cameras : interior orientation by lens.
    T_back_front : relative orientation.
    """

    settings: TwinDualFisheye
    cameras: dict[str, Camera]
    T_back_front: Rigid

    @property
    def T_front_lens(self) -> dict[str, Rigid]:
        """Place of each lens in the frame of the front lens."""
        return {"front": Rigid(), "back": self.T_back_front.inverse()}

    @property
    def centre_front_m(self) -> ArrayF:
        """(3,) middle of both projection centres in the frame of the front lens."""
        return np.asarray(self.T_front_lens["back"].shift_m / 2)

    def rays(self) -> dict[str, LensRays]:
        """Ray of each pixel of both upright views."""
        return {
            name: LensRays(camera, field_of_view_deg=self.settings.field_of_view_deg)
            for name, camera in self.cameras.items()
        }

    def facts(self) -> dict[str, Any]:
        """Plain values for the truth."""
        return {
            "base_m": float(np.linalg.norm(self.T_back_front.shift_m)),
            "axes_deg": float(np.rad2deg(np.arccos(self.T_back_front.R[2, 2]))),
            "T_back_front": self.T_back_front.matrix.tolist(),
            "lenses": {
                name: dict(zip(camera.parameter_names, camera.parameters.tolist(), strict=True))
                for name, camera in self.cameras.items()
            },
        }

    def file_of(self, light: dict[str, ArrayF32], rng: np.random.Generator, exposure: float) -> ArrayU8:
        """Both image circles (h, 2 h, 3) as the device stores them, from light (h, h, 3) by lens."""
        s = self.settings
        lens = TwinLens(sharpness_px=s.sharpness_px, noise=s.noise)
        views = {}
        for name in LENSES:
            rim = self._rim(name)
            gain = exposure * (_BACK_EXPOSURE if name == "back" else 1.0)
            views[name] = exposed(light[name] * rim[..., None], lens, rng, exposure=gain)
            # what no ray reaches stays dark but for the sensor's noise
        turned = np.rot90(views["back"], 2)
        return np.ascontiguousarray(np.concatenate([views["front"], turned], axis=1))

    def _rim(self, name: str) -> ArrayF32:
        """Share of the light (h, h) that the lens lets through at each pixel."""
        n, camera = self.settings.circle_px, self.cameras[name]
        y, x = np.mgrid[0:n, 0:n] + 0.5
        off = np.hypot(x - camera.parameters[2], y - camera.parameters[3]) / (n / 2)
        return np.asarray(1.0 - self.settings.vignetting * np.minimum(off, 1.0) ** 2, dtype=np.float32)


def true_rig(settings: TwinDualFisheye, seed: int) -> TrueRig:
    """The rig of a seed: both lenses, the base along the view of the front lens, the tilt of the axes."""
    rng = generator(seed, "dual fisheye")
    n = settings.circle_px
    offset = np.asarray(settings.principal_offset_px)
    cameras, count = {}, len(PARAMETERS[settings.lens])
    for name, sign, more in (("front", 1.0, 0.0), ("back", -1.0, _FOCAL_DIFFERENCE_PX)):
        f = settings.focal_px + more
        shape = np.asarray(settings.distortion) + _SCATTER * rng.standard_normal(4) * 0.2
        cameras[name] = Camera(
            model=settings.lens,
            size_px=(n, n),
            parameters=np.array(
                [f, f, n / 2 + sign * offset[0], n / 2 + sign * offset[1], *shape, 0.0][:count]
            ),
            name=name,
        )
    # the axes miss 180 degrees about an axis across the view that chance gives; the views are upright alike
    azimuth = rng.uniform(0, 2 * np.pi)
    tilt = np.deg2rad(180.0 - settings.axes_deg) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    roll = np.array([0.0, 0.0, np.deg2rad(0.15) * rng.standard_normal()])
    R_back_front = exp_rotation(tilt) @ exp_rotation(roll) @ np.diag([-1.0, 1.0, -1.0])
    # the back lens sits behind the front lens, a little beside its axis
    beside = 0.0003 * rng.standard_normal(2)
    back_in_front = np.array([*beside, 0.0])
    back_in_front[2] = -np.sqrt(settings.base_m**2 - float(beside @ beside))
    return TrueRig(
        settings=settings,
        cameras=cameras,
        T_back_front=Rigid(R=R_back_front, shift_m=-R_back_front @ back_in_front),
    )
