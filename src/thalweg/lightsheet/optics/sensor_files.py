"""Light-sheet sensors as calibration files: values, sigmas, correlations, units and equations of frames.

The files follow the house: metres and degrees, the places of camera and laser as pose blocks, whose errors of
angles are small rotations about the axes of lcs. A `Sensor` has millimetres, radians, the papers' angles and
errors of omega, phi, kappa themselves. This module is the border between both. The camera's angles of a file
are those of ``R_lcs_ccs`` itself, because ``R_x(w) R_y(p) R_z(k) diag(1, -1, -1) = R_x(w + 180) R_y(-p)
R_z(-k)``.
"""

from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core.calibration.files import read_calibration, write_calibration
from thalweg.core.calibration.model import POSE, Block, Calibration, Source
from thalweg.core.camera.model import PARAMETERS as INTERIOR
from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError, InputError, ThalwegError
from thalweg.core.frames import opk_axes
from thalweg.core.types import ArrayF
from thalweg.lightsheet.optics.sensor import CAMERA, LASER, PARAMETERS, LightSheet, Sensor, Window

CAMERA_BLOCK: Final = "sheet_camera"
LENS_BLOCK: Final = "sheet_camera_interior"
LASER_BLOCK: Final = "sheet_laser"
WINDOW_BLOCK: Final = "sheet_window"
BLOCKS: Final = (CAMERA_BLOCK, LENS_BLOCK, LASER_BLOCK, WINDOW_BLOCK)
"""Blocks of a sensor; a file may hold others as well."""

WINDOW_QUANTITIES: Final = ("thickness_m", "n_glass", "n_water", "tilt_x_deg", "tilt_y_deg")

CAMERA_SIGNS: Final = np.array([1.0, -1.0, -1.0])
"""Of the papers' omega, phi, kappa in those of ``R_lcs_ccs``, behind half a turn of omega."""

MM: Final = 1000.0
DEG: Final = float(np.rad2deg(1.0))
_ROUNDING: Final = 1e-12
"""Share of its largest possible value below which a variance is that of nothing."""


def read_sensor(path: Path) -> Sensor:
    """Read a sensor.

    Raises
    ------
    ConfigError : the file is no calibration; every mistake with its line.
    InputError : a block, a quantity or a fact of the sensor is missing, or no sensor can be like this.
    """
    calibration = read_calibration(path)
    try:
        return sensor_of(calibration, name=path.stem)
    except ThalwegError as error:
        raise InputError(
            error.found,
            expected=error.expected,
            where=path,
            cure=error.cure or "docs/calibration.md says more",
        ) from error


def write_sensor(path: Path, sensor: Sensor, *, source: Source, title: str = "") -> None:
    """Write a sensor; the same sensor gives the same bytes.

    Parameters
    ----------
    path : a YAML file.
    sensor : with its covariance.
    source : where the values come from.
    title : for people; by default it names the sensor.
    """
    write_calibration(path, sensor_calibration(sensor, source=source, title=title))


def sensor_calibration(sensor: Sensor, *, source: Source, title: str = "") -> Calibration:
    """The calibration that holds a sensor."""
    camera, sheet, window = sensor.camera, sensor.sheet, sensor.window
    camera_deg = np.rad2deg(sensor.camera_angles_rad) * CAMERA_SIGNS + [180.0, 0.0, 0.0]
    camera_deg[0] = (camera_deg[0] + 180.0) % 360.0 - 180.0
    blocks = (
        Block(
            name=CAMERA_BLOCK,
            quantities=POSE,
            values=np.concatenate([camera_deg, sensor.camera_origin_lcs_mm / MM]),
            equation=_pose_equation("ccs"),
            convention="lcs: Z up, away from the water; the papers' angles are omega - 180, -phi, -kappa; "
            "errors of the angles are small rotations about the axes of lcs",
        ),
        Block(
            name=LENS_BLOCK,
            quantities=camera.parameter_names,
            values=camera.parameters,
            equation="pixels = perspective(x_ccs)",
            convention="pixels count from the upper left corner; ccs: x right, y down, z view",
            facts={"model": camera.model, "width_px": camera.size_px[0], "height_px": camera.size_px[1]},
        ),
        Block(
            name=LASER_BLOCK,
            quantities=POSE,
            values=np.concatenate([np.rad2deg(sheet.angles_rad), sheet.origin_lcs_mm / MM]),
            equation=_pose_equation("las"),
            convention="d_las = (sin a, v, -sqrt(1 - sin^2 a - v^2)) for the fan angle a",
            facts={"half_angle_deg": float(np.rad2deg(sheet.half_angle_rad)), "v": float(sheet.v)},
        ),
        Block(
            name=WINDOW_BLOCK,
            quantities=WINDOW_QUANTITIES,
            values=np.array([
                window.thickness_mm / MM, window.n_glass, window.n_water,
                np.rad2deg(window.tilt_x_rad), np.rad2deg(window.tilt_y_rad),
            ]),
            equation="n_1 sin(t_1) = n_2 sin(t_2) at z_window = 0 and -thickness, "
            "x_lcs = R_x(tilt_x) R_y(tilt_y) x_window",
            convention="plane-parallel glass between air and water",
            facts={"n_air": float(window.n_air)},
        ),
    )  # fmt: skip
    J = file_derivatives(sensor)
    cov = J @ sensor.cov @ J.T
    return Calibration(
        title=title or f"Light-sheet sensor {sensor.name}",
        blocks=blocks,
        cov=0.5 * (cov + cov.T),
        source=source,
    )


def sensor_of(calibration: Calibration, *, name: str = "light sheet") -> Sensor:
    """The sensor of a calibration with its covariance.

    Raises
    ------
    InputError : a block, a quantity or a fact is missing.
    GeometryError : no sensor can be like this.
    """
    values = {block: _values(calibration, block) for block in BLOCKS}
    camera, lens, laser, window = (values[block] for block in BLOCKS)
    size = (
        round(_fact(calibration, LENS_BLOCK, "width_px")),
        round(_fact(calibration, LENS_BLOCK, "height_px")),
    )
    sensor = Sensor(
        camera=Camera(model="perspective", size_px=size, parameters=lens, name=name),
        camera_origin_lcs_mm=camera[3:] * MM,
        camera_angles_rad=np.deg2rad((camera[:3] - [180.0, 0.0, 0.0]) * CAMERA_SIGNS),
        sheet=LightSheet(
            origin_lcs_mm=laser[3:] * MM,
            angles_rad=np.deg2rad(laser[:3]),
            half_angle_rad=float(np.deg2rad(_fact(calibration, LASER_BLOCK, "half_angle_deg"))),
            v=_fact(calibration, LASER_BLOCK, "v"),
        ),
        window=Window(
            thickness_mm=float(window[0] * MM), n_air=_fact(calibration, WINDOW_BLOCK, "n_air"),
            n_glass=float(window[1]), n_water=float(window[2]),
            tilt_x_rad=float(np.deg2rad(window[3])), tilt_y_rad=float(np.deg2rad(window[4])),
        ),
        name=name,
    )  # fmt: skip
    _, cov = calibration.joint(BLOCKS)
    if not cov.any():
        return sensor
    back = np.linalg.inv(file_derivatives(sensor))
    inside = back @ cov @ back.T
    inside = 0.5 * (inside + inside.T)
    # what was held fixed comes back as the difference of equal numbers, of either sign
    largest = np.square(np.abs(back) @ np.sqrt(np.diag(cov)))
    held = np.diag(inside) < _ROUNDING * largest
    inside[held], inside[:, held] = 0.0, 0.0
    lens_cov = inside[6:15, 6:15]
    return sensor.with_vector(sensor.vector(), inside).with_camera(
        Camera(model="perspective", size_px=size, parameters=lens, cov=lens_cov, name=name)
    )


def file_derivatives(sensor: Sensor) -> ArrayF:
    """(26, 26) derivatives of a file's quantities, in its order and units, by `PARAMETERS`.

    Errors of omega, phi, kappa become rotations about the axes of lcs; the same matrix serves the camera,
    because the half turn of omega and the signs change its angles, not the axes that it turns about.

    Raises
    ------
    GeometryError : phi is 90 degrees, where omega and kappa turn about the same axis.
    """
    J = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    at = 0
    for part, angles in ((CAMERA, sensor.camera_angles_rad), (LASER, sensor.sheet.angles_rad)):
        if abs(np.cos(angles[1])) < 1e-6:
            raise GeometryError(
                f"phi = {np.rad2deg(angles[1]):g} degrees",
                expected="a phi away from 90 degrees, where errors of omega and kappa can be told apart",
                where=f"sensor {sensor.name!r}",
            )
        first = part.start
        J[at : at + 3, first + 3 : first + 6] = opk_axes(angles[0], angles[1]) * DEG
        J[at + 3 : at + 6, first : first + 3] = np.eye(3) / MM
        at += 6
        if part is CAMERA:
            J[at : at + 9, 6:15] = np.eye(9)
            at += 9
    J[at:, 21:] = np.diag([1.0 / MM, 1.0, 1.0, DEG, DEG])
    return J


def _pose_equation(source: str) -> str:
    return f"x_lcs = R_lcs_{source} @ x_{source} + (x, y, z), R_lcs_{source} = R_x(omega) R_y(phi) R_z(kappa)"


def _values(calibration: Calibration, name: str) -> ArrayF:
    expected = {CAMERA_BLOCK: POSE, LENS_BLOCK: INTERIOR["perspective"], LASER_BLOCK: POSE}
    wanted = expected.get(name, WINDOW_QUANTITIES)
    block = calibration.find(name)
    if block.quantities != wanted:
        raise InputError(f"block '{name}' with {', '.join(block.quantities)}", expected=", ".join(wanted))
    if block.is_pose and not block.equation.startswith("x_lcs ="):
        raise InputError(
            f"block '{name}' is {block.equation.split(',')[0]}",
            expected="a place in the frame of the sensor, x_lcs = R_lcs_... + (x, y, z)",
        )
    return calibration.block(name)[0]


def _fact(calibration: Calibration, block: str, key: str) -> float:
    found = calibration.find(block).facts.get(key)
    if isinstance(found, bool) or not isinstance(found, int | float) or not np.isfinite(found):
        raise InputError(f"the fact {key} of the block '{block}' is {found!r}", expected="a number")
    return float(found)
