"""The budget of P4 line by line: what the geometry reproduces, and what no geometry can (P4 6, Table 1).

P4 does not print its geometry. Where a published figure differs from that of the geometry that fits best, the
difference may be the geometry's. Three groups of figures contradict each other, or optics, for *any*
geometry: each contradiction here is an inequality whose two sides are computed from published figures.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import InputError
from thalweg.lightsheet.optics import RESOURCES, Sensor

PUBLISHED: Final = RESOURCES / "paper_4_budget.csv"
COLUMNS: Final = ("panel", "cause", "sigma", "unit", "published_least_mm", "published_most_mm", "source")

MET: Final = 0.2
"""Share by which a figure may differ and count as reproduced: published ones have one or two digits."""

WAVELENGTH_NM: Final = 520.0
GSD_MM: Final = (0.02, 0.03)
GSD_DEPTH_MM: Final = 100.0
LINE_THICKNESS_MM: Final = 0.03
"""P4 Table 1."""

CAMERA_ANGLES: Final = ("camera omega", "camera phi", "camera kappa")

OR: Final = " or "
"""Between causes for which P4 states one figure."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Inequality:
    """``left_value`` must be at least ``right_value`` for published figures to agree.

    ``name``; ``left``, ``right`` say in words what is compared; ``unit``; ``causes`` the lines of the budget
    that it is about; ``condition`` under which it holds.
    """

    name: str
    left: str
    right: str
    left_value: float
    right_value: float
    unit: str
    causes: tuple[str, ...] = ()
    condition: str = ""

    @property
    def holds(self) -> bool:
        """Whether the published figures agree."""
        return self.left_value >= self.right_value

    @property
    def factor(self) -> float:
        """By how much the left side falls short of the right one; below 1 if it does not."""
        return self.right_value / self.left_value


def read_published(path: Path = PUBLISHED) -> pd.DataFrame:
    """The published budget.

    Raises
    ------
    InputError : the file is missing or has other columns.
    """
    if not path.is_file():
        raise InputError("file not found", expected="the published budget", where=path)
    table = pd.read_csv(path)
    if tuple(table.columns) != COLUMNS:
        raise InputError(f"the columns {', '.join(table.columns)}", expected=", ".join(COLUMNS), where=path)
    return table


def verdicts(
    table: pd.DataFrame, published: pd.DataFrame, contradictions: Sequence[Inequality] = ()
) -> pd.DataFrame:
    """The budget beside the published one.

    Parameters
    ----------
    table : of `thalweg.lightsheet.budget.budget.budget_table`.
    published : of `read_published`.
    contradictions : those that do not hold make the verdict of their causes.

    Returns
    -------
    A row for each published figure: ``panel, cause, sigma, unit, bound`` (most or least), ``published_mm,
    computed_mm, at_depth_mm, ratio, verdict``: ``met`` within `MET`, else ``smaller`` or ``larger`` than
    published, or ``contradicted``.
    """
    broken = {cause: c for c in contradictions if not c.holds for cause in c.causes}
    rows = []
    for row in published.to_dict("records"):
        mine = table[table["cause"].isin(str(row["cause"]).split(OR))]
        for bound in ("least", "most"):
            value = float(row[f"published_{bound}_mm"])
            if not np.isfinite(value):
                continue
            figures = mine[f"{bound}_mm"].to_numpy(dtype=np.float64)
            at = int(figures.argmax() if bound == "most" else figures.argmin())
            ratio = float(figures[at]) / value
            word = "met" if abs(ratio - 1.0) <= MET else "smaller" if ratio < 1.0 else "larger"
            if row["cause"] in broken and word != "met":
                word = "contradicted"
            depth = float(mine["depth_mm"].to_numpy(dtype=np.float64)[at])
            given = (row["panel"], row["cause"], row["sigma"], row["unit"], bound, value)
            rows.append((*given, float(figures[at]), depth, ratio, word))
    columns = [
        "panel",
        "cause",
        "sigma",
        "unit",
        "bound",
        "published_mm",
        "computed_mm",
        "at_depth_mm",
        "ratio",
        "verdict",
    ]
    return pd.DataFrame(rows, columns=columns)


def contradictions(sensor: Sensor, published: pd.DataFrame) -> list[Inequality]:
    """All inequalities of this module for the camera and media of a sensor; only published figures enter."""
    return [camera_angles(sensor, published), ground_sampling(sensor), line_thickness(sensor)]


def inequality_table(found: Sequence[Inequality]) -> pd.DataFrame:
    """A row for each: both sides in words and values, unit, whether it holds, factor, condition."""
    return pd.DataFrame(
        [
            {
                "name": c.name,
                "left": c.left,
                "left_value": c.left_value,
                "right": c.right,
                "right_value": c.right_value,
                "unit": c.unit,
                "holds": c.holds,
                "factor": c.factor,
                "condition": c.condition,
            }
            for c in found
        ]
    )


def camera_angles(sensor: Sensor, published: pd.DataFrame) -> Inequality:
    """Errors of the camera's angles against those of the line in the picture.

    A small rotation vector e about the camera moves the picture. At the place where the image error is
    largest, let g be the derivative of the depth by a shift of the line; shifts of at least c |e| come from
    rotations in a plane that contains the direction of g. Three angles about perpendicular axes therefore
    give together ::

        s_omega^2 + s_phi^2 + s_kappa^2 >= (g c sigma)^2 = (s_image c sigma / sigma_px)^2

    whatever the geometry. The axes of omega, phi, kappa are perpendicular but for omega and kappa, which
    enclose 90 degrees - phi: the right side gets the factor sqrt(1 - |sin phi|). The left side takes
    published maxima, which need not even meet in one place.
    """
    sigmas = dict(zip(published["cause"], published["sigma"].astype(float), strict=True))
    mosts = dict(zip(published["cause"], published["published_most_mm"].astype(float), strict=True))
    sigma = np.deg2rad([sigmas[name] for name in CAMERA_ANGLES]).min()
    most = [mosts[name] for name in CAMERA_ANGLES]
    image_mm, image_px = mosts["image"], sigmas["image"]
    c_px = float(sensor.camera.parameters[0])
    left = float(np.linalg.norm(most))
    right = image_mm * c_px * float(sigma) / image_px
    least_phi = np.rad2deg(np.arcsin(max(0.0, 1.0 - (left / right) ** 2)))
    return Inequality(
        name="camera angles against image measurement",
        left="root of the squared sum of the published maxima of omega, phi, kappa",
        right=f"published image maximum times {c_px * sigma:.3f} px / {image_px:g} px",
        left_value=left,
        right_value=right,
        unit="mm",
        causes=CAMERA_ANGLES,
        condition=f"|phi| below {least_phi:.0f} degrees",
    )


def ground_sampling(sensor: Sensor) -> Inequality:
    """Size of a pixel on the object in the centre of the picture.

    Across the plane of incidence a bundle of the angle dt in air is D dt / (n cos t_w) wide at the depth D,
    for a camera that lies on the glass; a plate, a height above it and an oblique view make it wider. So the
    larger side of a pixel is at least D / (c n).
    """
    c_px, n = float(sensor.camera.parameters[0]), sensor.window.n_water
    return Inequality(
        name="ground sampling distance",
        left=f"larger side of a pixel at {GSD_DEPTH_MM:g} mm, as published",
        right="that of a camera on the glass that looks straight down, D / (c n)",
        left_value=max(GSD_MM),
        right_value=GSD_DEPTH_MM / (c_px * n),
        unit="mm",
    )


def line_thickness(sensor: Sensor, reach_mm: float = 100.0) -> Inequality:
    """Diameter (1/e^2) of a Gaussian beam over a range of depths.

    With a waist of the radius w0 the radius at the distance z is w0 sqrt(1 + (z / z_R)^2), z_R = pi w0^2 n /
    lambda. The least diameter that a beam keeps over +-z is 2 sqrt(2 lambda z / (pi n)), at z_R = z.
    """
    wave_mm = WAVELENGTH_NM * 1e-6
    return Inequality(
        name="line thickness",
        left="diameter at 100 mm, as published",
        right=f"least largest diameter of a Gaussian beam within +-{reach_mm:g} mm of its waist in water",
        left_value=LINE_THICKNESS_MM,
        right_value=float(2.0 * np.sqrt(2.0 * wave_mm * reach_mm / (np.pi * sensor.window.n_water))),
        unit="mm",
    )


def depth_trends(table: pd.DataFrame) -> pd.DataFrame:
    """Whether each cause grows with depth, as P4 6.6 says of all.

    Returns
    -------
    ``panel, cause``, a column for each depth with the largest sigma, ``grows``.
    """
    wide = table.pivot(index=["panel", "cause"], columns="depth_mm", values="most_mm")
    wide = wide.reindex(table[["panel", "cause"]].drop_duplicates().apply(tuple, axis=1).tolist())
    grows = [bool((np.diff(row) > 0.0).all()) for row in wide.to_numpy(dtype=np.float64)]
    wide.columns = [f"most_mm_at_{depth:g}" for depth in wide.columns]
    return wide.assign(grows=grows).reset_index()


def centre_trends(lines: pd.DataFrame, sensor: Sensor) -> pd.DataFrame:
    """Where along a line each cause is least, as P4 6.6 says: in the centre of the picture.

    Parameters
    ----------
    lines : of `thalweg.lightsheet.budget.budget.budget_on_lines`.
    sensor : whose picture it is.

    Returns
    -------
    ``cause, depth_mm, least_at`` and ``most_at``, the places along the line's own direction in the picture as
    shares of half its size, 0 in the centre and +-1 at the edges; ``swing`` largest over smallest sigma;
    ``falls`` whether the least is nearer to the centre than the largest.
    """
    width, height = sensor.camera.size_px
    rows = []
    for (cause, depth), part in lines.groupby(["cause", "depth_mm"], sort=False):
        part = part[np.isfinite(part["sigma_depth_mm"])]
        if not part["sigma_depth_mm"].max() > 0.0:
            continue
        along_y = np.ptp(part["y_px"]) >= np.ptp(part["x_px"])
        side, place = (height, part["y_px"]) if along_y else (width, part["x_px"])
        share = (place.to_numpy() - 0.5 * side) / (0.5 * side)
        sigma = part["sigma_depth_mm"].to_numpy()
        least, most = float(share[sigma.argmin()]), float(share[sigma.argmax()])
        swing = float(sigma.max() / max(sigma.min(), 1e-12))
        rows.append((cause, depth, least, most, swing, abs(least) < abs(most)))
    return pd.DataFrame(rows, columns=["cause", "depth_mm", "least_at", "most_at", "swing", "falls"])
