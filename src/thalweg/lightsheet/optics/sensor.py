"""The underwater light-sheet sensor: a camera and a laser fan above a plane window (P3, P4, T 3.2).

Sensor frame lcs, in **millimetres**: right-handed, Z up, away from the water. Without a tilt the inner face
of the window (air to glass) is the plane Z = 0 and the outer one (glass to water) the plane Z = -thickness; a
tilt turns both about the origin::

    x_lcs = R_lcs_window x_window,    R_lcs_window = R_x(tilt_x) R_y(tilt_y)

Depth D counts from the outer face along its normal, positive in the water: ``D = -z_window - thickness``.

The camera's angles are those of the papers, whose image frame looks along its own -z (x' to the right, y'
up); ours looks along +z (x to the right, y down), so that their ray (x', y', -c) is (x', -y', c) in ccs::

    R_lcs_ccs = R_x(omega) R_y(phi) R_z(kappa) diag(1, -1, -1)

The laser fan spreads along its local x axis and travels along local -z. Its sub-beam of the fan angle a is ::

    d_lcs = R_lcs_las (sin a, v, -sqrt(1 - sin^2 a - v^2)),    R_lcs_las = R_x(omega) R_y(phi) R_z(kappa)

with v = 0 for a light sheet. A diffractive element makes lines of constant direction cosine v: cones.

**Files** (`read_sensor`, `write_sensor`) are calibration files in metres and degrees. The places of camera
and laser are pose blocks, whose errors of angles are small rotations about the axes of lcs; a `Sensor` has
millimetres, radians, the papers' angles and errors of omega, phi, kappa themselves. The camera's angles of a
file are those of ``R_lcs_ccs`` itself, because ``R_x(w) R_y(p) R_z(k) diag(1, -1, -1) = R_x(w + 180) R_y(-p)
R_z(-k)``.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import ArrayLike

from thalweg.core import (
    PARAMETERS as INTERIOR,
    ROOT,
    ArrayF,
    Camera,
    GeometryError,
    InputError,
    ThalwegError,
    opk_axes,
    rotation_opk,
    rotation_x,
    rotation_y,
)
from thalweg.core.calibration import POSE, Block, Calibration, Source, read_calibration, write_calibration

PARAMETERS: Final = (
    "camera_x_mm",
    "camera_y_mm",
    "camera_z_mm",
    "camera_omega_rad",
    "camera_phi_rad",
    "camera_kappa_rad",
    *INTERIOR["perspective"],
    "laser_x_mm",
    "laser_y_mm",
    "laser_z_mm",
    "laser_omega_rad",
    "laser_phi_rad",
    "laser_kappa_rad",
    "glass_mm",
    "n_glass",
    "n_water",
    "tilt_x_rad",
    "tilt_y_rad",
)
"""Names of the 26 parameters of a sensor, in the order of `Sensor.vector` and of its covariance."""

CAMERA: Final = slice(0, 6)
LENS: Final = slice(6, 15)
LASER: Final = slice(15, 21)
WINDOW: Final = slice(21, 26)
"""Parts of the parameters."""

FLIP: Final = np.diag([1.0, -1.0, -1.0])
"""From ccs to the papers' image frame, and back."""

RESOURCES: Final = ROOT / "resources" / "light_sheet"

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Window:
    """A plane-parallel plate between air and water.

    Parameters
    ----------
    thickness_mm : of the glass; 0 for none.
    n_air, n_glass, n_water : refractive indices; see `thalweg.lightsheet.optics.refractive_index`.
    tilt_x_rad, tilt_y_rad : small rotations of the plate about the x and then the y axis of lcs.

    Raises
    ------
    GeometryError : a negative thickness, an index below that of the vacuum, a tilt of 45 degrees or more.
    """

    thickness_mm: float
    n_air: float = 1.0
    n_glass: float
    n_water: float
    tilt_x_rad: float = 0.0
    tilt_y_rad: float = 0.0

    def __post_init__(self) -> None:
        indices = np.array([self.n_air, self.n_glass, self.n_water], dtype=np.float64)
        # the vacuum has 1 exactly, every medium more; a derivative by differences may step a little below
        if not ((indices > 0.999) & (indices < 3.0)).all():
            raise GeometryError(
                f"refractive indices {indices.tolist()} of air, glass and water",
                expected="numbers such as 1.0, 1.52 and 1.335",
                where="window of the light-sheet sensor",
            )
        if not (np.isfinite(self.thickness_mm) and self.thickness_mm >= 0.0):
            raise GeometryError(f"a window {self.thickness_mm} mm thick", expected="zero or more millimetres")
        tilt = np.hypot(self.tilt_x_rad, self.tilt_y_rad)
        if not tilt < np.pi / 4:
            raise GeometryError(
                f"a window tilted by {np.rad2deg(tilt):g} degrees",
                expected="less than 45: the frame of the sensor has its Z axis near the window's normal",
                cure="State the tilt in radians",
            )

    @property
    def R_lcs_window(self) -> ArrayF:
        """(3, 3) rotation from the frame of the window, whose z axis is its normal, to lcs."""
        return rotation_x(self.tilt_x_rad) @ rotation_y(self.tilt_y_rad)

    @property
    def normal_lcs(self) -> ArrayF:
        """(3,) unit normal, away from the water."""
        return self.R_lcs_window[:, 2]

    def depth_mm(self, xyz_lcs_mm: ArrayLike) -> ArrayF:
        """Depths (n,) of points (n, 3) below the outer face; negative above it."""
        return np.asarray(-(np.asarray(xyz_lcs_mm, dtype=np.float64) @ self.normal_lcs) - self.thickness_mm)


@dataclass(frozen=True, slots=True, kw_only=True)
class LightSheet:
    """A fan of sub-beams.

    Parameters
    ----------
    origin_lcs_mm : (3,) where the sub-beams begin.
    angles_rad : (3,) omega, phi, kappa of ``R_lcs_las``.
    half_angle_rad : of the fan, on either side.
    v : direction cosine of a diffracted line, 0 for a plane fan.
    name : for tables and messages.

    Raises
    ------
    GeometryError : no three numbers, or a fan of no angle or of 90 degrees and more on a side.
    """

    origin_lcs_mm: ArrayF
    angles_rad: ArrayF
    half_angle_rad: float
    v: float = 0.0
    name: str = "laser"

    def __post_init__(self) -> None:
        _three(self, "origin_lcs_mm")
        _three(self, "angles_rad")
        if not (abs(self.v) < 1.0 and 0.0 < self.half_angle_rad < np.arccos(abs(self.v))):
            raise GeometryError(
                f"a fan of {np.rad2deg(self.half_angle_rad):g} degrees on either side with v = {self.v:g}",
                expected="between 0 and 90 degrees; less with a v: sin^2 a + v^2 < 1",
                where=f"laser {self.name!r}",
            )

    @property
    def R_lcs_las(self) -> ArrayF:
        """(3, 3) rotation from the frame of the laser to lcs."""
        return rotation_opk(*(float(angle) for angle in self.angles_rad))

    def beams(self, a_rad: ArrayLike) -> ArrayF:
        """Unit directions (n, 3) in air, lcs, of the sub-beams of the fan angles (n,)."""
        s = np.sin(np.atleast_1d(np.asarray(a_rad, dtype=np.float64)))
        with np.errstate(invalid="ignore"):
            local = np.stack([s, np.full_like(s, self.v), -np.sqrt(1.0 - s * s - self.v * self.v)], axis=1)
        return np.asarray(local @ self.R_lcs_las.T)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """Camera, laser and window in the frame of the sensor.

    Parameters
    ----------
    camera : interior orientation, perspective.
    camera_origin_lcs_mm : (3,) projection centre.
    camera_angles_rad : (3,) omega, phi, kappa of the papers; see the module.
    sheet : the laser.
    window : the glass and the media on its sides.
    name : for tables and messages.
    cov : (26, 26) covariance of `PARAMETERS`, errors of the angles being those of omega, phi, kappa
        themselves; empty for zeros.

    Raises
    ------
    GeometryError : a fisheye camera, a covariance of another shape, a camera or laser on the wet side.
    """

    camera: Camera
    camera_origin_lcs_mm: ArrayF
    camera_angles_rad: ArrayF
    sheet: LightSheet
    window: Window
    name: str = "light sheet"
    cov: ArrayF = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        _three(self, "camera_origin_lcs_mm")
        _three(self, "camera_angles_rad")
        if self.camera.model != "perspective":
            raise GeometryError(
                f"a {self.camera.model} camera", expected="a perspective one", where=f"sensor {self.name!r}"
            )
        n = len(PARAMETERS)
        C = np.asarray(self.cov, dtype=np.float64)
        C = np.zeros((n, n)) if C.size == 0 else C
        if C.shape != (n, n) or not np.allclose(C, C.T, atol=1e-30):
            raise GeometryError(
                f"a covariance of the shape {C.shape}",
                expected=f"a symmetric {n}x{n} matrix in the order of PARAMETERS",
                where=f"sensor {self.name!r}",
            )
        object.__setattr__(self, "cov", C)
        places = {"camera": self.camera_origin_lcs_mm, "laser": self.sheet.origin_lcs_mm}
        for what, place in places.items():
            height_mm = float(place @ self.window.normal_lcs)
            if not height_mm > 0.0:
                raise GeometryError(
                    f"the {what} stands {height_mm:g} mm above the inner face of the window",
                    expected="a positive height: Z points up, away from the water",
                    where=f"sensor {self.name!r}",
                    cure="Check the direction of the Z axis; P3 prints a frame with Z downwards",
                )

    @property
    def R_lcs_ccs(self) -> ArrayF:
        """(3, 3) rotation from the camera's frame to lcs."""
        return rotation_opk(*(float(angle) for angle in self.camera_angles_rad)) @ FLIP

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return PARAMETERS

    def vector(self) -> ArrayF:
        """(26,) values of `PARAMETERS`."""
        window = self.window
        return np.concatenate(
            [
                self.camera_origin_lcs_mm,
                self.camera_angles_rad,
                self.camera.parameters,
                self.sheet.origin_lcs_mm,
                self.sheet.angles_rad,
                [window.thickness_mm, window.n_glass, window.n_water, window.tilt_x_rad, window.tilt_y_rad],
            ]
        )

    def with_vector(self, x: ArrayLike, cov: ArrayF | None = None) -> Self:
        """The same sensor with other parameters (26,) and, if given, their covariance (26, 26).

        Raises
        ------
        GeometryError : another number of values, or values that no sensor can have.
        """
        p = np.asarray(x, dtype=np.float64)
        if p.shape != (len(PARAMETERS),):
            raise GeometryError(f"{p.shape} parameters", expected=f"({len(PARAMETERS)},) as PARAMETERS")
        thickness, n_glass, n_water, tilt_x, tilt_y = (float(value) for value in p[WINDOW])
        laser = p[LASER]
        return replace(
            self,
            camera=self.camera.with_parameters(p[LENS].copy()),
            camera_origin_lcs_mm=p[CAMERA][:3].copy(),
            camera_angles_rad=p[CAMERA][3:].copy(),
            sheet=replace(self.sheet, origin_lcs_mm=laser[:3].copy(), angles_rad=laser[3:].copy()),
            window=replace(
                self.window,
                thickness_mm=thickness,
                n_glass=n_glass,
                n_water=n_water,
                tilt_x_rad=tilt_x,
                tilt_y_rad=tilt_y,
            ),
            cov=self.cov if cov is None else cov,
        )

    def with_sheet(self, sheet: LightSheet) -> Self:
        """The same sensor with another line; its covariance is kept."""
        return replace(self, sheet=sheet)

    def with_camera(self, camera: Camera) -> Self:
        """The same sensor with another interior orientation; its covariance is kept."""
        return replace(self, camera=camera)

    def with_water(self, n_water: float) -> Self:
        """The same sensor in other water."""
        return replace(self, window=replace(self.window, n_water=n_water))


def paper_3() -> Sensor:
    """The prototype of P3, decoded from its Table 1 (``resources/light_sheet/paper_3.yaml``)."""
    return _resource("paper_3")


def paper_4() -> Sensor:
    """The prototype of P4: the unpublished geometry that fits its published figures best."""
    return _resource("paper_4")


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
            values=np.array(
                [
                    window.thickness_mm / MM,
                    window.n_glass,
                    window.n_water,
                    np.rad2deg(window.tilt_x_rad),
                    np.rad2deg(window.tilt_y_rad),
                ]
            ),
            equation="n_1 sin(t_1) = n_2 sin(t_2) at z_window = 0 and -thickness, "
            "x_lcs = R_x(tilt_x) R_y(tilt_y) x_window",
            convention="plane-parallel glass between air and water",
            facts={"n_air": float(window.n_air)},
        ),
    )
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
            thickness_mm=float(window[0] * MM),
            n_air=_fact(calibration, WINDOW_BLOCK, "n_air"),
            n_glass=float(window[1]),
            n_water=float(window[2]),
            tilt_x_rad=float(np.deg2rad(window[3])),
            tilt_y_rad=float(np.deg2rad(window[4])),
        ),
        name=name,
    )
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


def _resource(name: str) -> Sensor:

    return read_sensor(RESOURCES / f"{name}.yaml")


def _three(owner: object, name: str) -> None:
    """Make a field three finite float64 numbers."""
    value = np.asarray(getattr(owner, name), dtype=np.float64)
    if value.shape != (3,) or not np.isfinite(value).all():
        raise GeometryError(f"{name} = {value.tolist()}", expected="three finite numbers")
    object.__setattr__(owner, name, value)


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
