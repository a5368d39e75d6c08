"""The pose of the moving sensor from a panel with markers and a camera on a tripod (P4 4.2.1, Luhmann 2009).

The panel is fixed to the sensor, so its marks have coordinates in lcs. The world of such a scan is the frame
of the standing camera (ccs: x right, y down, z along the view), in millimetres.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.camera.model import Camera
from thalweg.core.types import ArrayF, ArrayI
from thalweg_lab.base.random import generator
from thalweg_lab.tank.motion import SensorPath

DISTANCE_MM: Final = 1500.0
"""From the standing camera to the panel (P4 7.3)."""

SIGMA_PX: Final = 0.12
"""Of a mark's image coordinate: gives the published 0.01 degrees and 0.05 mm for this panel and camera."""

SIGMA_MARK_MM: Final = 0.01
"""Of the panel's own coordinates."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """Marks fixed to the sensor: ``marker`` (m,), true ``xyz_lcs_mm`` (m, 3), ``measured_lcs_mm`` (m, 3)."""

    marker: ArrayI
    xyz_lcs_mm: ArrayF
    measured_lcs_mm: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class Tripod:
    """The standing camera: ``x_ccs = R_ccs_obj x_obj + shift_ccs_mm``, and its interior orientation."""

    camera: Camera
    R_ccs_obj: ArrayF
    shift_ccs_mm: ArrayF

    def T_ccs_lcs(self, path: SensorPath, k: int) -> tuple[ArrayF, ArrayF]:
        """Rotation (3, 3) and shift (3,) mm of the sensor in the frame of the standing camera at image k."""
        shift = self.R_ccs_obj @ path.shift_obj_mm[k] + self.shift_ccs_mm
        return self.R_ccs_obj @ path.R_obj_lcs[k], shift


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """Marks in the images of the standing camera: ``image``, ``marker`` (n,), ``xy_px`` (n, 2)."""

    image: ArrayI
    marker: ArrayI
    xy_px: ArrayF


def build_panel(seed: int, *, centre_lcs_mm: tuple[float, float, float] = (0.0, -80.0, 260.0)) -> Panel:
    """A panel of 5 x 6 marks that faces +y of lcs, every second column 60 mm in front of the others."""
    columns, rows = np.meshgrid(np.arange(6), np.arange(5))
    x, z = 60.0 * (columns.ravel() - 2.5), 50.0 * (rows.ravel() - 2.0)
    y = np.where(columns.ravel() % 2 == 0, 0.0, 60.0)
    true = np.stack([x, y, z], axis=1) + np.asarray(centre_lcs_mm)
    error = generator(seed, "light sheet panel marks").standard_normal(true.shape)
    return Panel(
        marker=np.arange(1, len(true) + 1), xyz_lcs_mm=true, measured_lcs_mm=true + SIGMA_MARK_MM * error
    )


def set_up(path: SensorPath, panel: Panel) -> Tripod:
    """A camera 1.5 m in front of the panel in the middle of the way, looking at it a little from above."""
    k = len(path) // 2
    centre = path.R_obj_lcs[k] @ panel.xyz_lcs_mm.mean(axis=0) + path.shift_obj_mm[k]
    eye = centre + DISTANCE_MM * np.array([0.15, 0.95, 0.27]) / np.linalg.norm([0.15, 0.95, 0.27])
    view = (centre - eye) / np.linalg.norm(centre - eye)
    right = np.cross(view, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    R = np.stack([right, np.cross(view, right), view])
    parameters = np.array([6000.0, 6000.0, 2000.0, 1500.0, -0.08, 0.06, 0.0, 0.0, 0.0])
    camera = Camera(model="perspective", size_px=(4000, 3000), parameters=parameters, name="tripod")
    return Tripod(camera=camera, R_ccs_obj=R, shift_ccs_mm=-R @ eye)


def observe(
    seed: int, tripod: Tripod, panel: Panel, path: SensorPath, *, name: str, sigma_px: float = SIGMA_PX
) -> Observed:
    """Image coordinates with noise of all marks in the picture, for each image of a path."""
    rng = generator(seed, f"light sheet {name} marks")
    image, marker, xy = [], [], []
    for k in range(len(path)):
        R, shift = tripod.T_ccs_lcs(path, k)
        at = tripod.camera.project(panel.xyz_lcs_mm @ R.T + shift)
        at = at + sigma_px * rng.standard_normal(at.shape)
        inside = tripod.camera.inside(at)
        image.append(np.full(int(inside.sum()), k))
        marker.append(panel.marker[inside])
        xy.append(at[inside])
    return Observed(image=np.concatenate(image), marker=np.concatenate(marker), xy_px=np.concatenate(xy))
