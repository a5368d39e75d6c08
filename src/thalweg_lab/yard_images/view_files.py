"""Synthetic image and synthetic lidar frame of the cone field, as P2 Fig. 4 shows them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core.rigid import Rigid
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.instruments.beams import Lasers
from thalweg_lab.voyage.yard_motion import standing
from thalweg_lab.yard.layout import build_field
from thalweg_lab.yard_images.images import SUN, mount_of, true_camera
from thalweg_lab.yard_images.synthetic_view import synthetic_view
from thalweg_lab.yard_records.scan import static_scan

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
