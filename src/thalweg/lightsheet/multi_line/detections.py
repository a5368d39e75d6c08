"""Detections of a multi-line image, and what each would be if it belonged to each line."""

from dataclasses import dataclass, replace

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayB, ArrayF, ArrayI
from thalweg.lightsheet.multi_line.label_kernels import link_rows
from thalweg.lightsheet.multi_line.sheet_curves import Lines
from thalweg.lightsheet.optics.intersection import intersect
from thalweg.lightsheet.optics.projection import project
from thalweg.lightsheet.optics.refracted_rays import refract_to_water
from thalweg.lightsheet.optics.sensor import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class Detections:
    """Places where lines cross the rows of an image; the lines run along its columns.

    Parameters
    ----------
    row : (n,) rows, ascending.
    x_px : (n,) places in them, ascending within a row, corner origin.
    row_step : distance of the rows that were searched.

    Raises
    ------
    GeometryError : columns of different lengths or out of order, or numbers that are not finite.
    """

    row: ArrayI
    x_px: ArrayF
    row_step: int = 1

    def __post_init__(self) -> None:
        lost = int(np.sum(~np.isfinite(self.x_px)))
        if len(self.row) != len(self.x_px) or lost:
            raise GeometryError(
                f"{len(self.row)} rows, {len(self.x_px)} places, {lost} not finite",
                expected="one finite place for each row",
            )
        later = (np.diff(self.row) > 0) | ((np.diff(self.row) == 0) & (np.diff(self.x_px) >= 0))
        if not later.all():
            raise GeometryError(
                f"{np.sum(~later)} detections out of order",
                expected="detections sorted by row and place",
                where="detections of a multi-line image",
            )

    @property
    def xy_px(self) -> ArrayF:
        """(n, 2) pixels, corner origin."""
        return np.stack([self.x_px, self.row + 0.5], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelSettings:
    """Rules of the assignment.

    Parameters
    ----------
    min_depth_mm, max_depth_mm : working range.
    link_px : how far a segment's next place may lie from where its slope leads.
    gap_rows : steps without a detection that end a segment.
    skip, missing : costs of a detection without line, and of a line without detection, in a row.
    smooth_per_mm, smooth_cap_mm : cost of a change of depth from line to line.
    rounds : of the exchange between rows and segments.
    min_points : least length of a segment that gets a label of its own.
    margin : least difference of the mean cost of a row to the second best label.
    support : least share of a segment's points that lie on the map.
    """

    min_depth_mm: float = 40.0
    max_depth_mm: float = 210.0
    link_px: float = 1.5
    gap_rows: int = 3
    skip: float = 2.0
    missing: float = 0.6
    smooth_per_mm: float = 0.12
    smooth_cap_mm: float = 12.0
    rounds: int = 6
    min_points: int = 8
    margin: float = 1.5
    support: float = 0.7


@dataclass(frozen=True, slots=True, kw_only=True)
class Hypotheses:
    """What each detection would be on each line.

    Parameters
    ----------
    detections : (n,).
    order : +1 if places in a row grow with the number of the line, else -1.
    xyd_mm : (n, L, 3) place and depth in the window's frame, NaN where the line is not met.
    slope : (n, 2) change of x and y of the camera ray for each millimetre of depth.
    laser_slope : (n, L, 2) the same of the sub-beams.
    possible : (n, L) whether the depth lies in the working range and the sub-beam in the fan.
    segment : (n,) number of the segment.
    """

    detections: Detections
    order: int
    xyd_mm: ArrayF
    slope: ArrayF
    laser_slope: ArrayF
    possible: ArrayB
    segment: ArrayI

    @property
    def n_segments(self) -> int:
        """Number of segments."""
        return int(self.segment.max(initial=-1)) + 1


def line_order(sensor: Sensor, lines: Lines, depth_mm: float) -> int:
    """Whether image places in a row grow (+1) or shrink (-1) with the number of the line.

    Raises
    ------
    GeometryError : the lines do not run side by side along the columns of the image.
    """
    middle = []
    for sheet in lines.sheets():
        water = refract_to_water(sheet.origin_lcs_mm, sheet.beams(0.0), sensor.window)
        middle.append(project(sensor, water.at_depth(depth_mm))[0, 0])
    steps = np.diff(middle)
    if not ((steps > 0).all() or (steps < 0).all()):
        raise GeometryError(
            f"lines at the places {np.round(middle).tolist()} px",
            expected="lines one beside the other along the columns of the image",
            cure="Turn the image, or check the calibration of the lines",
        )
    return 1 if steps[0] > 0 else -1


def hypotheses(
    sensor: Sensor, lines: Lines, detections: Detections, settings: LabelSettings, *, order: int | None = None
) -> Hypotheses:
    """Intersect every detection with every line, and link detections to segments."""
    xy = detections.xy_px
    n, L = len(xy), len(lines.labels)
    xyd, laser_slope = np.full((n, L, 3), np.nan), np.full((n, L, 2), np.nan)
    R = sensor.window.R_lcs_window
    for j, sheet in enumerate(lines.sheets()):
        # the ends of a fan are blurred by a few milliradians
        wide = replace(sheet, half_angle_rad=1.003 * sheet.half_angle_rad)
        met = intersect(sensor.with_sheet(wide), xy)
        xyd[:, j, :2] = (met.xyz_lcs_mm @ R)[:, :2]
        xyd[:, j, 2] = met.depth_mm
        laser_slope[:, j] = refract_to_water(
            sheet.origin_lcs_mm, sheet.beams(met.fan_angle_rad), sensor.window
        ).B
    rays = sensor.camera.rays(xy) @ sensor.R_lcs_ccs.T
    slope = refract_to_water(sensor.camera_origin_lcs_mm, rays, sensor.window).B
    with np.errstate(invalid="ignore"):
        possible = (xyd[:, :, 2] > settings.min_depth_mm) & (xyd[:, :, 2] < settings.max_depth_mm)
    middle = 0.5 * (settings.min_depth_mm + settings.max_depth_mm)
    return Hypotheses(
        detections=detections,
        order=line_order(sensor, lines, middle) if order is None else order,
        xyd_mm=xyd,
        slope=slope,
        laser_slope=laser_slope,
        possible=possible,
        segment=link_rows(
            detections.row, detections.x_px, detections.row_step, settings.link_px, settings.gap_rows
        ),
    )
