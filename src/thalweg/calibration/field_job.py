"""The field from its table of marks: nominal camera, adjustment, place in the world, notes for people."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from thalweg.calibration.field_datum import FieldDatum, field_datum, targets_wcs
from thalweg.calibration.field_description import FieldDescription
from thalweg.calibration.field_network import FieldNetwork, measure_field
from thalweg.calibration.field_points import FieldPoints
from thalweg.calibration.network_start import block_of, misfit_px, start_network
from thalweg.calibration.nominal_camera import best_nominal, nominal_camera
from thalweg.core.camera import Camera, Model
from thalweg.core.frames import LocalFrame


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredField:
    """A field, its points, its place in the world if it has targets, and what people should know."""

    network: FieldNetwork
    points: FieldPoints
    datum: FieldDatum | None
    notes: list[str]


def starting_camera(
    marks: pd.DataFrame,
    field: FieldDescription,
    name: str,
    size_px: tuple[int, int],
    *,
    model: Model = "perspective",
    focal_px: float | None = None,
) -> Camera:
    """Nominal interior orientation of the field's camera; without a focal length several are tried."""
    if focal_px is not None:
        return nominal_camera(name, model, size_px, focal_px)
    mine = marks[marks["camera"] == name]

    def misfit(camera: Camera) -> float:
        block = block_of(mine, {name: camera})
        return misfit_px(block, start_network(block, field.layout), float(camera.parameters[0]))

    return best_nominal(name, model, size_px, misfit)


def measure(
    marks: pd.DataFrame,
    cameras: Mapping[str, Camera],
    field: FieldDescription,
    frame: LocalFrame,
    *,
    calibrate: Mapping[str, tuple[str, ...]] | None = None,
) -> MeasuredField:
    """Adjust a field and place it in the world.

    Parameters
    ----------
    marks : table of kind ``marks``.
    cameras : nominal interior orientations by name.
    field : its description.
    frame : of wcs.
    calibrate : parameters to estimate of each camera; all if None.
    """
    approximate = None
    if len(field.targets) >= 3:
        wcs = targets_wcs(field.targets, frame)
        # a frame with its origin amid the targets: coordinates stay small wherever wcs begins
        middle = np.round(wcs.mean(axis=0))
        approximate = {t.marker: place - middle for t, place in zip(field.targets, wcs, strict=True)}
    network = measure_field(marks, cameras, field, approximate=approximate, calibrate=calibrate)
    points = FieldPoints(points=network.points, points_pcs=network.points_pcs, cov=network.cov_points)
    datum = field_datum(points, field.targets, frame) if field.targets else None
    return MeasuredField(network=network, points=points, datum=datum, notes=_notes(network, datum, field))


def point_table(field: FieldDescription, measured: MeasuredField) -> pd.DataFrame:
    """Table for people: mark, coordinates, sigmas, cone that carries it, number of pictures."""
    table = measured.points.table()
    used = measured.network.residuals[measured.network.residuals["used"]]
    count = used.groupby(["marker", "corner"]).size().to_dict()
    table["cone"] = [field.cone_of(marker) for marker, _ in measured.points.points]
    table["images"] = [int(count.get(point, 0)) for point in measured.points.points]
    return table


def _notes(network: FieldNetwork, datum: FieldDatum | None, field: FieldDescription) -> list[str]:
    lines: list[str] = []
    told: dict[str, Any] = {}
    for row in network.rejected.itertuples():
        if row.what == "point":
            told.setdefault(str(row.reason), []).append(str(row.name))
        else:
            lines.append(f"{row.what} {row.name}: {row.reason}")
    for reason, names in told.items():
        more = " ..." if len(names) > 8 else ""
        lines.append(f"{len(names)} points have {reason}: {', '.join(names[:8])}{more}")
    have = {marker for marker, _ in network.points}
    for cone in field.cones:
        n = len(have & set(cone.markers))
        if n < 3:
            lines.append(
                f"cone {cone.name}: {n} of {len(cone.markers)} markers were measured; "
                "take more pictures of it"
            )
    if datum is not None:
        lines += [f"target {name}: {reason}" for name, reason in datum.rejected]
    if float(network.report["object_sigma_mean_mm"]) > 1.0:
        sigma = network.report["object_sigma_mean_mm"]
        lines.append(f"object points have a sigma of {sigma:.2f} mm on average; below 1 mm is expected")
    return lines
