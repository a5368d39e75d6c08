"""The recordings of a basin: camera station, grid, panels and scans of one true sensor.

The sensor of the campaign is that of P4, built with the tolerances of its making (`truth_sensor`). Its
design, with the camera's interior orientation as a calibration in air gives it, is what the processing starts
from.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.calibration.field.points import FieldPoints, write_points
from thalweg.core.calibration.model import Source
from thalweg.core.errors import ConfigError
from thalweg.core.frames import LocalFrame, rotation_opk
from thalweg.core.types import ArrayF
from thalweg.lightsheet.optics.sensor import CAMERA, LASER, LENS, WINDOW, Sensor, paper_4
from thalweg.lightsheet.optics.sensor_files import write_sensor
from thalweg.settings.twin.light_sheet import SheetImage, TwinLightSheet
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import generator
from thalweg_lab.tank.board import SIGMA_MARK_MM, SIGMA_PX, build_board, dry, observe_board
from thalweg_lab.tank.objects import stepped_object
from thalweg_lab.tank.plan import Plan, calibration_plan, panel_plan, scan_plan
from thalweg_lab.tank.record import record
from thalweg_lab.tank.surfaces import Surface
from thalweg_lab.tank.truth_sensor import in_water_of, sized, true_sensor
from thalweg_lab.tank.wreck import wreck
from thalweg_lab.voyage.motion import start_gps_s

OBJECTS: Final = ("stepped", "wreck")
"""What is scanned."""

SIGMA_FOCAL_MM: Final = 0.004
"""Of the interior orientation by a bundle in air (P4 6.2); the principal point as well as that."""

_LASER_SIGMAS: Final = (3.0, 3.0, 3.0, 0.8, 0.8, 0.8)
_WINDOW_SIGMAS: Final = (0.05, 0.005, 0.001, 0.0, 0.0)
"""How well laser, glass and water are known beforehand: mm and degrees; mm, 1, 1."""

WINDOW_MARKERS: Final = (201, 202, 203, 204)
"""Markers on the outer face of the window."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Basin:
    """A true sensor in its water, the light of its images, and the design that a user has of it."""

    true: Sensor
    design: Sensor
    image: SheetImage
    seed: int
    settings: TwinLightSheet

    @classmethod
    def of(cls, twin: TwinConfig, seed: int) -> "Basin":
        """The basin of a campaign."""
        settings = twin.light_sheet or TwinLightSheet()
        nominal, image = sized(paper_4(), settings.image, settings.size)
        true = in_water_of(true_sensor(nominal, seed), settings.temperature_c, image.laser.wavelength_nm)
        design = _design(nominal, true, seed)
        return cls(true=true, design=design, image=image, seed=seed, settings=settings)


def _design(nominal: Sensor, true: Sensor, seed: int) -> Sensor:
    """Drawing of the sensor with the lens of a calibration in air, and the sigmas of both.

    The indices of water and glass are those of a table, which differ from the true ones within their sigmas.
    """
    focal_px = SIGMA_FOCAL_MM / 0.0055 * true.camera.size_px[0] / 2048
    error = generator(seed, "light sheet lens calibration").standard_normal(3)
    sigma = np.zeros(26)
    sigma[LENS][:4] = focal_px
    sigma[LASER], sigma[WINDOW] = _LASER_SIGMAS, _WINDOW_SIGMAS
    sigma[CAMERA] = (0.0, 0.0, 0.5, 0.3, 0.3, 0.3)
    for part in (CAMERA, LASER):
        sigma[part][3:] = np.deg2rad(sigma[part][3:])
    cov = np.diag(np.square(sigma))
    at = LENS.start
    # one principal distance; square pixels are known to a hundredth of its sigma
    cov[at, at + 1] = cov[at + 1, at] = 0.9999 * focal_px**2
    x = nominal.vector()
    lens = true.camera.parameters.copy()
    lens[:2] += focal_px * error[0]
    lens[2:4] += focal_px * error[1:]
    x[LENS] = lens
    indices = slice(WINDOW.start + 1, WINDOW.start + 3)
    media = generator(seed, "light sheet media").standard_normal(2)
    x[indices] = true.vector()[indices] + sigma[indices] * media
    return nominal.with_vector(x, cov=cov)


def record_camera_station(
    twin: TwinConfig, seed: int, *, out_sensor: Path, out_marks: Path, out_points: Path
) -> None:
    """The design, and marks on object and window as the sensor's own camera sees them through air (P4 4.3).

    The places of the marks come from a bundle with scale bars, in a frame of its own.

    Parameters
    ----------
    twin, seed : of the campaign.
    out_sensor, out_marks, out_points : design (YAML), marks in the image and points (CSV).
    """
    basin = Basin.of(twin, seed)
    source = Source(run="digital twin", method="drawing, and lens calibrated in air", twin=True)
    out_sensor.parent.mkdir(parents=True, exist_ok=True)
    write_sensor(out_sensor, basin.design, source=source, title="Light-sheet sensor as designed")
    board = build_board(basin.true, basin.seed)
    marker, xy = observe_board(dry(basin.true), board, basin.seed, name="camera station")
    table = pd.DataFrame({
        "file": "camera_station.png", "marker": marker, "corner": 0, "x_px": xy[:, 0], "y_px": xy[:, 1],
        "sigma_px": SIGMA_PX,
    })  # fmt: skip
    table.to_csv(out_marks, index=False, float_format="%.5f")
    rng = generator(basin.seed, "light sheet camera station frame")
    R = rotation_opk(*(float(a) for a in rng.uniform(-3.0, 3.0, 3)))
    window = _window_marks(basin, SIGMA_MARK_MM * rng.standard_normal((len(WINDOW_MARKERS) * 4, 3)))
    places = np.concatenate([board.measured_lcs_mm, window])
    names = [(int(m), 0) for m in board.marker]
    names += [(m, corner) for m in WINDOW_MARKERS for corner in range(4)]
    points = FieldPoints(
        points=tuple(names),
        points_pcs=1e-3 * places @ R.T + rng.uniform(-1.0, 1.0, 3),
        cov=np.eye(3 * len(names)) * (1e-3 * SIGMA_MARK_MM) ** 2,
    )
    write_points(out_points, points)


def _window_marks(basin: Basin, error_mm: ArrayF) -> ArrayF:
    """Corners (16, 3) of four markers on the window's outer face, lcs."""
    centres = np.array([[-60.0, -120.0], [60.0, -120.0], [60.0, 20.0], [-60.0, 20.0]])
    corners = 5.0 * np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
    xy = (centres[:, None] + corners).reshape(-1, 2)
    flat = np.column_stack([xy, np.full(len(xy), -basin.true.window.thickness_mm)])
    return flat @ basin.true.window.R_lcs_window.T + error_mm


def record_series(
    twin: TwinConfig, seed: int, series: str, frame: LocalFrame, folder: Path, truth: Path
) -> None:
    """Render and write one series.

    Parameters
    ----------
    twin, seed, frame : of the campaign.
    series : ``calibration``, ``panels``, or one of `OBJECTS`.
    folder, truth : see `thalweg_lab.tank.record`.

    Raises
    ------
    ConfigError : another series.
    """
    basin = Basin.of(twin, seed)
    record(
        _plan(basin, series), basin.true, _exposed(basin, series), seed, folder, truth, frame,
        start_gps_s=start_gps_s(twin), six_dof=series in OBJECTS, lost_pulses=basin.settings.lost_pulses,
    )  # fmt: skip


def _exposed(basin: Basin, series: str) -> SheetImage:
    """Light of the images of a series; the black object is exposed longer, in the dark."""
    if series != "stepped":
        return basin.image
    chip, times = basin.image.chip, basin.settings.black_exposure
    longer = {"peak_dn": times * chip.peak_dn, "ambient_dn": 0.0}
    return basin.image.model_copy(update={"chip": chip.model_copy(update=longer)})


def _plan(basin: Basin, series: str) -> Plan:
    settings = basin.settings
    if series == "calibration":
        return calibration_plan(basin.true, basin.seed, positions=1, depths_mm=settings.levels_mm)
    if series == "panels":
        return panel_plan(basin.true, depths_mm=settings.panels_mm)
    if series not in OBJECTS:
        raise ConfigError(f"series '{series}'", expected=f"calibration, panels, {', '.join(OBJECTS)}")
    return scan_plan(
        basin.true, basin.seed, scanned_object(series, basin.seed), lines=settings.scan_lines,
        step_mm=settings.scan_step_mm,
    )  # fmt: skip


def scanned_object(name: str, seed: int) -> Surface:
    """The object of a scan, one of `OBJECTS`, in its own frame."""
    return stepped_object() if name == "stepped" else replace(wreck(seed), name="wreck")
