"""A picture of the cones in which their colour tells their height (P2 Fig. 4a), and of any other lens."""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF, ArrayF32, ArrayI, ArrayU8
from thalweg.settings.twin.camera import TwinLens
from thalweg_lab.river_images.daylight import Sun
from thalweg_lab.yard.layout import Field
from thalweg_lab.yard.scene import field_scene
from thalweg_lab.yard.yard import Yard
from thalweg_lab.yard_images.exposure import exposed
from thalweg_lab.yard_images.lens_rays import LensRays
from thalweg_lab.yard_images.render import Photographer

RAMP: Final = np.array([
    [0.02, 0.10, 0.42], [0.02, 0.32, 0.55], [0.10, 0.55, 0.42], [0.62, 0.62, 0.10], [0.80, 0.30, 0.04],
])  # fmt: skip
"""Colours from low to high, linear RGB."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SyntheticView:
    """A picture and what it shows.

    Parameters
    ----------
    image : (h, w, 3) uint8, sRGB; black outside the image circle of a fisheye.
    cone : (h, w) index of the cone that a pixel meets, -1 elsewhere.
    height_m : (cones,) height of the middle of each cone above the ground.
    range_m : (h, w) distance, infinite where nothing was met.
    """

    image: ArrayU8
    cone: ArrayI
    height_m: ArrayF
    range_m: ArrayF32


def synthetic_view(
    field: Field,
    camera: Camera,
    T_wcs_ccs: Rigid,
    sun: Sun,
    *,
    colours: ArrayF | None = RAMP,
    with_sheets: bool = False,
    field_of_view_deg: float = 190.0,
) -> SyntheticView:
    """A clean picture of the field, without noise.

    Parameters
    ----------
    field : the yard.
    camera : of any model.
    T_wcs_ccs : its pose.
    sun : the light.
    colours : (k, 3) linear RGB from 0 to 1, from the lowest cone to the highest; None: cones as they are.
    with_sheets : whether the printed markers are there.
    field_of_view_deg : full angle of the image circle of a fisheye.

    Raises
    ------
    GeometryError : colours of another shape.
    """
    scene = field_scene(field)
    yard = Yard.of(scene, field.sheets if with_sheets else ())
    heights = np.array([cone.middle_wcs_m[2] for cone in field.cones])
    if colours is not None:
        ramp = np.asarray(colours, dtype=np.float64)
        if ramp.ndim != 2 or ramp.shape[1] != 3 or len(ramp) < 2:
            raise GeometryError(f"colours of the shape {ramp.shape}", expected="(k, 3) with k of at least 2")
        share = (heights - heights.min()) / max(float(np.ptp(heights)), 1e-9)
        of_cones = np.stack([np.interp(share, np.linspace(0, 1, len(ramp)), c) for c in ramp.T], axis=1)
        given = np.full((len(yard.names), 3), np.nan)
        given[[yard.names.index(cone.name) for cone in field.cones]] = of_cones
        yard = replace(yard, colours=given)
    seen = Photographer(yard, sun).see(LensRays(camera, field_of_view_deg=field_of_view_deg), T_wcs_ccs)
    number = np.full(len(yard.names) + 1, -1, dtype=np.int64)
    number[[yard.names.index(cone.name) for cone in field.cones]] = np.arange(len(field.cones))
    lens = TwinLens(noise=0.0, sharpness_px=0.4)
    image = exposed(seen.light, lens, np.random.default_rng(0))
    return SyntheticView(image=image, cone=number[seen.thing], height_m=heights, range_m=seen.range_m)
