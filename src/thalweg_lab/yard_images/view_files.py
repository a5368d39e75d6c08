"""Synthetic image and synthetic lidar frame of the cone field, as P2 Fig. 4 shows them."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError
from thalweg.core.rigid import Rigid
from thalweg.core.types import ArrayF, ArrayF32, ArrayI, ArrayU8
from thalweg.settings.twin.camera import TwinLens
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.instruments.beams import Lasers
from thalweg_lab.river_images.daylight import Sun
from thalweg_lab.voyage.yard_motion import standing
from thalweg_lab.yard.layout import Field, build_field
from thalweg_lab.yard.scene import field_scene
from thalweg_lab.yard.yard import Yard
from thalweg_lab.yard_images.exposure import exposed
from thalweg_lab.yard_images.images import SUN, mount_of, true_camera
from thalweg_lab.yard_images.lens_rays import LensRays
from thalweg_lab.yard_images.render import Photographer
from thalweg_lab.yard_records.scan import static_scan

# ---------------------------------------------------------------- A picture of the cones in which their
# colour tells their height (P2 Fig. 4a), and of any other lens


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


# ---------------------------------------------------------------- view files


LASERS: Final = Lasers.even(8, 4.0)
"""P2 Fig. 4: eight scan lines, four degrees apart."""

_GREY: Final = np.array([0.299, 0.587, 0.114])
"""Weights of red, green and blue in brightness (ITU-R BT.601)."""


def simulate_synthetic_view(
    config: TwinConfig, seed: int, mounts: Mapping[str, Any], out_view: Path, out_frame: Path
) -> None:
    """Write what camera and lidar see at the first static position.

    Parameters
    ----------
    config : section ``twin`` with ``field``.
    seed : seed of the campaign.
    mounts : true mounts, with ``camera`` and ``lidar``.
    out_view : ``.npz`` with ``height_m`` (h, w), of the cone that a pixel shows above the ground, NaN
        elsewhere, and ``shade`` (h, w) uint8.
    out_frame : Parquet of one revolution: ``x_m, y_m, z_m`` in wcs, ``ring``, ``on_cone``.
    """
    T_wcs_ics = standing(config, 1).T_wcs_ics
    camera = true_camera(config.camera, "boat")
    view = synthetic_view(
        build_field(config, seed), camera, T_wcs_ics @ mount_of(mounts["camera"]), SUN, colours=None
    )
    height = np.append(view.height_m, np.nan)[view.cone]
    out_view.parent.mkdir(parents=True, exist_ok=True)
    shade = np.rint(view.image @ _GREY).astype(np.uint8)
    np.savez_compressed(out_view, height_m=height.astype(np.float32), shade=shade)
    lidar = mount_of(mounts["lidar"])
    scan = static_scan(
        config, seed, 1, R_ics_scs=lidar.R, lever_ics_scs_m=lidar.shift_m, lasers=LASERS,
        near_cones_m=None, revolutions=1,
    )  # fmt: skip
    points = (T_wcs_ics @ Rigid(R=lidar.R, shift_m=lidar.shift_m)).apply(scan.points_scs_m)
    table = pd.DataFrame(points, columns=["x_m", "y_m", "z_m"])
    table.assign(ring=scan.ring, on_cone=scan.cone >= 0).to_parquet(out_frame, index=False)
