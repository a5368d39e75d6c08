"""Where the error of a measured point comes from (P4 6, Fig. 13), and what correlations change of it (P4
6.6).

The covariance of a point is ``J C J^T`` with the derivatives of `derivatives` and the covariance C of the
sensor, and the line's error in the picture on top. A *cause* is a part of C: its own block gives its share.
The sum of the shares leaves out what is correlated between causes, as P4 does; the whole C does not.

P4 adds the squares of all causes as if the laser's five parameters had been found apart from each other. They
come from one adjustment on two levels and are strongly correlated; and errors of everything that this
adjustment held fixed (levels, camera, principal distance, indices, glass) are correlated with the laser's
errors that they caused.

A *design* is the set of observations of such a calibration: points of the line on each level, and pairs of
points on one sub-beam (the gaps of the upper level and the pieces on the lower one). The laser's rotation in
its own plane moves no point of the sheet, so five of its parameters are estimated: all but phi, whose axis is
nearest to the normal of the fan.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import ArrayF, GeometryError, propagated
from thalweg.lightsheet.optics import PARAMETERS, Sensor, SheetPoints, depth_lines, point_derivatives

DEPTHS_MM: Final = (50.0, 125.0, 200.0)
"""Reference depths of P4 Fig. 13."""

SIGMA_LINE_PX: Final = (0.15, 0.0)
"""P4 6.1: the line is measured along the rows."""

TOTAL: Final = "total"
TOTAL_CORRELATED: Final = "total with correlations"


@dataclass(frozen=True, slots=True)
class Cause:
    """A part of the covariance: its name, its panel in P4 Fig. 13 ("" for none there), its parameters."""

    name: str
    panel: str
    parameters: tuple[str, ...]


CAUSES: Final = (
    Cause("image", "a", ()),
    Cause("focal length", "b", ("fx", "fy")),
    Cause("camera z", "c", ("camera_z_mm",)),
    Cause("camera omega", "c", ("camera_omega_rad",)),
    Cause("camera phi", "c", ("camera_phi_rad",)),
    Cause("camera kappa", "c", ("camera_kappa_rad",)),
    Cause("laser x", "d", ("laser_x_mm",)),
    Cause("laser y", "d", ("laser_y_mm",)),
    Cause("laser z", "d", ("laser_z_mm",)),
    Cause("laser omega", "e", ("laser_omega_rad",)),
    Cause("laser phi", "e", ("laser_phi_rad",)),
    Cause("laser kappa", "e", ("laser_kappa_rad",)),
    Cause("water index", "f", ("n_water",)),
    Cause("camera x, y", "", ("camera_x_mm", "camera_y_mm")),
    Cause("principal point", "", ("cx", "cy")),
    Cause("distortion", "", ("k1", "k2", "p1", "p2", "k3")),
    Cause("glass", "", ("glass_mm", "n_glass")),
    Cause("window tilt", "", ("tilt_x_rad", "tilt_y_rad")),
)
"""Every parameter of a sensor belongs to one cause; those without a panel are no part of P4's budget."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PointBudget:
    """Standard deviations of points by cause.

    ``names`` the causes, then `TOTAL` (their squares added) and `TOTAL_CORRELATED`; ``sigma_lcs_mm`` (n,
    names, 3) along the axes of lcs; ``sigma_depth_mm`` (n, names) along the normal of the window; NaN where
    there is no point.
    """

    points: SheetPoints
    names: tuple[str, ...]
    sigma_lcs_mm: ArrayF
    sigma_depth_mm: ArrayF

    def of(self, name: str) -> ArrayF:
        """(n,) standard deviations of the depth by a cause or a total."""
        return self.sigma_depth_mm[:, self.names.index(name)]


def point_budget(
    sensor: Sensor, xy_px: ArrayF, *, sigma_px: tuple[float, float] = SIGMA_LINE_PX
) -> PointBudget:
    """The budget of pixels.

    Parameters
    ----------
    sensor : its covariance is the input; one without any gives the share of the picture alone.
    xy_px : (n, 2).
    sigma_px : of the line's place along x and y of the picture.
    """
    points, by_parameters, by_pixel = point_derivatives(sensor, xy_px)
    normal = sensor.window.normal_lcs
    image = np.diag(np.square(np.asarray(sigma_px, dtype=np.float64)))
    shares = []
    for cause in CAUSES:
        at = [PARAMETERS.index(name) for name in cause.parameters]
        J, C = (by_parameters[:, :, at], sensor.cov[np.ix_(at, at)]) if at else (by_pixel, image)
        shares.append(propagated(J, C))
    whole = propagated(by_parameters, sensor.cov) + shares[0]
    covariances = np.stack([*shares, np.sum(shares, axis=0), whole], axis=1)
    variances = np.einsum("nkii->nki", covariances)
    along = np.einsum("i,nkij,j->nk", normal, covariances, normal)
    # a difference of equal numbers may fall below zero by rounding
    return PointBudget(
        points=points,
        names=(*(cause.name for cause in CAUSES), TOTAL, TOTAL_CORRELATED),
        sigma_lcs_mm=np.sqrt(np.maximum(variances, 0.0)),
        sigma_depth_mm=np.sqrt(np.maximum(along, 0.0)),
    )


def budget_on_lines(
    sensor: Sensor,
    depths_mm: Sequence[float] = DEPTHS_MM,
    n: int = 101,
    *,
    sigma_px: tuple[float, float] = SIGMA_LINE_PX,
) -> pd.DataFrame:
    """The budget along lines of equal depth (P4 Fig. 13 a to g).

    Returns
    -------
    A row for each place and cause: ``depth_mm, x_px, y_px, fan_angle_deg, panel, cause, sigma_x_mm,
    sigma_y_mm, sigma_z_mm, sigma_depth_mm``.

    Raises
    ------
    GeometryError : a line is not in the picture.
    """
    panels = {cause.name: cause.panel for cause in CAUSES} | {TOTAL: "g", TOTAL_CORRELATED: "g"}
    parts = []
    for line in depth_lines(sensor, depths_mm, n):
        if not len(line.xy_px):
            raise GeometryError(
                f"the line of {line.depth_mm:g} mm is not in the picture",
                expected="depths that the sensor sees",
                where=f"sensor {sensor.name!r}",
            )
        found = point_budget(sensor, line.xy_px, sigma_px=sigma_px)
        for k, name in enumerate(found.names):
            x, y, z = found.sigma_lcs_mm[:, k].T
            parts.append(
                pd.DataFrame(
                    {
                        "depth_mm": line.depth_mm,
                        "x_px": line.xy_px[:, 0],
                        "y_px": line.xy_px[:, 1],
                        "fan_angle_deg": np.rad2deg(line.fan_angle_rad),
                        "panel": panels[name],
                        "cause": name,
                        "sigma_x_mm": x,
                        "sigma_y_mm": y,
                        "sigma_z_mm": z,
                        "sigma_depth_mm": found.sigma_depth_mm[:, k],
                    }
                )
            )
    return pd.concat(parts, ignore_index=True)


def budget_table(lines: pd.DataFrame) -> pd.DataFrame:
    """Least and largest sigma of the depth of each cause in each depth, from `budget_on_lines`.

    Returns
    -------
    ``panel, cause, depth_mm, least_mm, most_mm`` in the order of the causes; those without a share are left
    out.
    """
    # a cause without a panel in P4 has none in a file, either: pandas would leave it out
    keys = ["cause", "panel", "depth_mm"]
    grouped = lines.fillna({"panel": ""}).groupby(keys, sort=False)["sigma_depth_mm"]
    table = grouped.agg(least_mm="min", most_mm="max").reset_index()
    shares = table.groupby("cause")["most_mm"].transform("max") > 0.0
    return table.loc[shares, ["panel", "cause", "depth_mm", "least_mm", "most_mm"]].reset_index(drop=True)
