"""Where the sensor stands at each image: on a rail, under a boat, and as a panel with markers shows it (P4
4.2.1).

A pose is ``x_obj = R_obj_lcs x_lcs + shift_obj_mm``; the frame of the object does not move.

**Panel and tripod** (Luhmann 2009). The panel is fixed to the sensor, so its marks have coordinates in lcs.
The world of such a scan is the frame of the standing camera (ccs: x right, y down, z along the view), in
millimetres.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from thalweg.core import ArrayF, ArrayI, Camera, rotation_opk
from thalweg_lab.random_numbers import gauss_markov, generator
from thalweg_lab.tank.surfaces import Posed, Surface

DISTANCE_MM: Final = 1500.0
"""From the standing camera to the panel (P4 7.3)."""

SIGMA_PX: Final = 0.12
"""Of a mark's image coordinate: gives the published 0.01 degrees and 0.05 mm for this panel and camera."""

SIGMA_MARK_MM: Final = 0.01
"""Of the panel's own coordinates."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorPath:
    """True poses: ``R_obj_lcs`` (n, 3, 3), ``shift_obj_mm`` (n, 3), ``t_s`` (n,) from the first image."""

    R_obj_lcs: ArrayF
    shift_obj_mm: ArrayF
    t_s: ArrayF

    def __len__(self) -> int:
        return len(self.t_s)

    def posed(self, k: int, surface: Surface) -> Posed:
        """The surface as it lies under the sensor at image k."""
        R = self.R_obj_lcs[k].T
        return Posed(surface=surface, R_lcs_obj=R, shift_lcs_mm=-R @ self.shift_obj_mm[k])

    def quaternions(self) -> ArrayF:
        """(n, 4) of R_obj_lcs, scalar last."""
        return np.asarray(Rotation.from_matrix(self.R_obj_lcs).as_quat())


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


def rail(
    seed: int,
    *,
    lines: int,
    step_mm: float,
    middle_lcs_mm: ArrayF,
    middle_obj_mm: ArrayF,
    name: str,
    kappa_rad: float = 0.0,
) -> SensorPath:
    """A hand-driven rail across the line, as in P4 7.3: steps of 2 to 5 mm, the sensor stands at each image.

    Parameters
    ----------
    seed : of the campaign; the streams are ``light sheet <name> ...``.
    lines, step_mm : number of images and mean step along y of the object.
    middle_lcs_mm, middle_obj_mm : (3,) point of the sensor's frame that meets this point of the object in the
        middle of the way.
    name : of the run, for its random streams.
    kappa_rad : direction of the laser line in lcs, from its x axis: x of the object lies along it.
    """
    steps = 1.0 + 0.1 * generator(seed, f"light sheet {name} steps").standard_normal(lines)
    wobble = generator(seed, f"light sheet {name} wobble").standard_normal((lines, 6))
    way = np.cumsum(steps) * step_mm
    way -= way.mean()
    turn = Rotation.from_rotvec(np.deg2rad(0.15) * wobble[:, 3:]).as_matrix()
    R = turn @ rotation_opk(0.0, 0.0, -kappa_rad)
    at = middle_obj_mm + np.stack([np.zeros(lines), way, np.zeros(lines)], axis=1) + 0.3 * wobble[:, :3]
    return SensorPath(
        R_obj_lcs=R,
        shift_obj_mm=at - np.einsum("nij,j->ni", R, middle_lcs_mm),
        t_s=np.asarray(2.0 * np.arange(lines, dtype=np.float64)),
    )


def drift(
    seed: int,
    *,
    lines: int,
    rate_hz: float,
    speed_mmps: float,
    middle_lcs_mm: ArrayF,
    start_obj_mm: ArrayF,
    name: str,
    kappa_rad: float = 0.0,
) -> SensorPath:
    """A slow boat along y of the object, rolling, pitching and heaving.

    Parameters are those of `rail`; ``roll_deg``, ``pitch_deg``, ``heave_mm`` are amplitudes of a swell of
    ``period_s``; heading and course wander by a Gauss-Markov process of 0.5 degrees and 2 mm.
    """
    t = np.arange(lines) / rate_hz
    swell = generator(seed, f"light sheet {name} swell")
    phases = swell.uniform(0, 2 * np.pi, 3)
    periods_s = 1.8 * np.array([1.0, 1.37, 0.81])
    wave = np.sin(2 * np.pi * t / periods_s[:, None] + phases[:, None])
    course = generator(seed, f"light sheet {name} course")
    heading = gauss_markov(course, lines, 1 / rate_hz, float(np.deg2rad(0.5)), 4.0)
    aside = gauss_markov(course, lines, 1 / rate_hz, 2.0, 6.0)
    pitch, roll = np.deg2rad(0.4) * wave[0], np.deg2rad(0.6) * wave[1]
    turns = [rotation_opk(float(p), float(r), float(h)) for p, r, h in zip(pitch, roll, heading, strict=True)]
    R = np.stack(turns) @ rotation_opk(0.0, 0.0, -kappa_rad)
    at = start_obj_mm + np.stack([aside, speed_mmps * t, 4.0 * wave[2]], axis=1)
    return SensorPath(R_obj_lcs=R, shift_obj_mm=at - np.einsum("nij,j->ni", R, middle_lcs_mm), t_s=t)


def build_panel(seed: int) -> Panel:
    """A panel of 5 x 6 marks that faces +y of lcs, every second column 60 mm in front of the others."""
    columns, rows = np.meshgrid(np.arange(6), np.arange(5))
    x, z = 60.0 * (columns.ravel() - 2.5), 50.0 * (rows.ravel() - 2.0)
    y = np.where(columns.ravel() % 2 == 0, 0.0, 60.0)
    true = np.stack([x, y, z], axis=1) + np.array([0.0, -80.0, 260.0])
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
