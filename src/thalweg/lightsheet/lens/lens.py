"""Interior orientation of the sensor's camera from pictures of a field of markers in air (P3 2.4, P4 6.2).

The self-calibrating bundle is that of the calibration field (`thalweg.calibration.field.job.measure`). Before
it runs, its normal equations at the approximate values tell whether these pictures can give an interior
orientation at all: pictures from one direction leave the camera constant to the distance, and pictures that
are not rolled the principal point to the tilt. What cannot be had is refused, with the unknown that it is
taken for.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.calibration.field.description import FieldDescription
from thalweg.calibration.field.job import MeasuredField, measure
from thalweg.calibration.markers.nominal_camera import nominal_camera
from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError
from thalweg.core.frames import LocalFrame
from thalweg.lightsheet.lens.checks import (
    require_design,
    require_determined,
    require_fit,
    require_pictures,
    require_steady,
    with_misfit,
)
from thalweg.lightsheet.lens.design import lens_correlations, lens_cov, predicted, view_facts
from thalweg.lightsheet.optics.sensor import LENS, Sensor

NAME: Final = "sheet_camera"
"""Of the camera in tables; with the ending ``_interior`` of its block in files, as a sensor's file has it."""

GOOD_PICTURES: Final = 12
_REACHES: Final = 0.8
"""Share of the way from the middle to a corner of the picture that marks should reach."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LensCalibration:
    """A calibrated camera and what its calibration rests on.

    Parameters
    ----------
    camera : with the covariance (9, 9) of its parameters.
    measured : the bundle.
    images : image, marks, rejected, rms_px, largest (residual in sigmas).
    bars : name, stated_m, residual_mm (adjusted minus stated), off_mm and sigma_off_mm (stated minus what the
        other bars say), used.
    correlations : parameter, with, correlation; see `lens_correlations`.
    views : see `view_facts`.
    notes : for people.
    """

    camera: Camera
    measured: MeasuredField
    images: pd.DataFrame
    bars: pd.DataFrame
    correlations: pd.DataFrame
    views: dict[str, Any]
    notes: list[str]


def calibrate_lens(
    marks: pd.DataFrame, design: Camera, field: FieldDescription, frame: LocalFrame, *, where: str = ""
) -> LensCalibration:
    """Interior orientation with covariance by a self-calibrating bundle.

    Parameters
    ----------
    marks : image, camera (`NAME`), marker, corner, x_px, y_px, sigma_px of all pictures.
    design : of the camera; its size, and its camera constant as approximate value, count.
    field : sizes of the sheets and scale bars.
    frame : of wcs, if the field has targets there.
    where : name of the table of marks.

    Raises
    ------
    GeometryError : too few pictures; pictures that do not determine camera constant or principal point, with
        what these are correlated; a camera that changed in their course; another camera than the design's;
        all that the bundle refuses.
    """
    require_pictures(marks, where)
    start = nominal_camera(NAME, "perspective", design.size_px, float(design.parameters[:2].mean()))
    expected = predicted(marks, start, field)
    correlations = lens_correlations(expected.x, expected.layout, expected.cov, expected.images)
    lens = lens_cov(expected.layout, expected.cov)
    require_determined(start, lens, correlations, view_facts(expected.x), where=where)
    try:
        measured = measure(marks, {NAME: start}, field, frame)
    except GeometryError as error:
        raise with_misfit(error, expected.misfit_px) from error
    network = measured.network
    require_fit(float(network.report["mark_sigma_px"]), where)
    require_steady(measured, where)
    x, cov = network.adjusted.x, network.adjusted.cov
    views = view_facts(x)
    camera = network.cameras[NAME]
    correlations = lens_correlations(x, network.layout, cov, tuple(network.poses))
    require_determined(camera, camera.cov, correlations, views, where=where)
    require_design(camera, design, where)
    return LensCalibration(
        camera=camera, measured=measured, images=image_table(network.residuals),
        bars=bar_table(measured, field), correlations=correlations, views=views,
        notes=measured.notes + _notes(camera, network.residuals, marks, views),
    )  # fmt: skip


def with_lens(sensor: Sensor, camera: Camera) -> Sensor:
    """The sensor with a calibrated interior orientation, whose errors are independent of all others.

    Raises
    ------
    GeometryError : a camera of another picture size.
    """
    if camera.size_px != sensor.camera.size_px:
        raise GeometryError(
            f"an interior orientation for pictures of {camera.size_px[0]} x {camera.size_px[1]} pixels",
            expected=f"{sensor.camera.size_px[0]} x {sensor.camera.size_px[1]}, as the design says",
            cure="Calibrate the camera in the mode in which the sensor uses it",
        )
    cov = sensor.cov.copy()
    cov[LENS], cov[:, LENS] = 0.0, 0.0
    cov[LENS, LENS] = camera.cov
    own = Camera(
        model=camera.model, size_px=camera.size_px, parameters=camera.parameters, cov=camera.cov,
        name=sensor.camera.name,
    )  # fmt: skip
    return sensor.with_camera(own).with_vector(sensor.with_camera(own).vector(), cov=cov)


def image_table(residuals: pd.DataFrame) -> pd.DataFrame:
    """Marks, rejected ones and residuals of each picture; see `LensCalibration`."""
    rows = []
    for image, part in residuals.groupby("image", sort=True):
        used = part[part["used"]]
        rms = float(np.sqrt(np.square(used[["vx_px", "vy_px"]].to_numpy()).mean())) if len(used) else np.nan
        largest = float(used["standardised"].max()) if len(used) else np.nan
        rows.append((str(image), len(part), int((~part["used"]).sum()), rms, largest))
    return pd.DataFrame(rows, columns=["image", "marks", "rejected", "rms_px", "largest"])


def bar_table(measured: MeasuredField, field: FieldDescription) -> pd.DataFrame:
    """Scale bars whose ends were measured; see `LensCalibration`."""
    points, scale = measured.points, measured.network.scale
    columns = ["name", "stated_m", "residual_mm", "off_mm", "sigma_off_mm", "used"]
    at = {f"{m}/{c}": k for k, (m, c) in enumerate(points.points)}
    bars = [bar for bar in field.scale_bars if bar.start in at and bar.end in at]
    if scale is None or len(bars) != len(scale.used):
        return pd.DataFrame(columns=columns)
    rows = []
    for k, bar in enumerate(bars):
        length = float(np.linalg.norm(points.points_pcs[at[bar.end]] - points.points_pcs[at[bar.start]]))
        off, sigma = float(scale.off_m[k]), float(scale.sigma_off_m[k])
        residual = 1e3 * (length - bar.length_m)
        rows.append((bar.name, bar.length_m, residual, 1e3 * off, 1e3 * sigma, bool(scale.used[k])))
    return pd.DataFrame(rows, columns=columns)


def _notes(camera: Camera, residuals: pd.DataFrame, marks: pd.DataFrame, views: dict[str, Any]) -> list[str]:
    notes = []
    if views["pictures"] < GOOD_PICTURES:
        notes.append(f"{views['pictures']} pictures: {GOOD_PICTURES} or more check each other better")
    keys = ["image", "marker", "corner"]
    good = residuals.loc[residuals["used"], keys].merge(marks, on=keys)[["x_px", "y_px"]].to_numpy()
    half = np.array(camera.size_px) / 2
    reach = float(np.linalg.norm(good - half, axis=1).max() / np.linalg.norm(half))
    if reach < _REACHES:
        notes.append(
            f"the marks reach {reach:.0%} of the way to the corners of the picture: what lies beyond is "
            "extrapolated. Let the field fill the picture"
        )
    return notes
