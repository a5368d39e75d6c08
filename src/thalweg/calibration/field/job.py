"""The field from its table of marks: nominal camera, adjustment, place in the world, notes for people."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from thalweg.calibration.field.datum import FieldDatum, field_datum, targets_wcs
from thalweg.calibration.field.description import FieldDescription
from thalweg.calibration.field.network import FieldNetwork, measure_field
from thalweg.calibration.field.network_start import misfit_px, start_network
from thalweg.calibration.field.notes import field_notes, require_size, sheet_sizes
from thalweg.calibration.field.picture_overview import with_overview
from thalweg.calibration.field.points import FieldPoints
from thalweg.calibration.field.steady_camera import require_steady
from thalweg.calibration.markers.mark_block import block_of
from thalweg.calibration.markers.nominal_camera import starting_camera_by
from thalweg.core.camera.model import Camera, Model
from thalweg.core.errors import GeometryError
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
    """Nominal interior orientation of the field's camera; without a focal length several are tried.

    Raises
    ------
    GeometryError : none gives a field; tells what the pictures show, and what to photograph.
    """
    mine = marks[marks["camera"] == name]

    def misfit(camera: Camera) -> float:
        """How badly a field by this camera fits, pixels."""
        block = block_of(mine, {name: camera})
        return misfit_px(block, start_network(block, field.layout), float(camera.parameters[0]))

    try:
        return starting_camera_by(misfit, name, model, size_px, focal_px)
    except GeometryError as error:
        raise with_overview(error, mine) from error


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

    Raises
    ------
    GeometryError : the pictures do not determine the field (with what they show, and what to photograph); the
        camera changed so much that the field is bent; scale bars, targets and sheets contradict each other.
    """
    approximate = None
    if len(field.targets) >= 3:
        wcs = targets_wcs(field.targets, frame)
        # a frame with its origin amid the targets: coordinates stay small wherever wcs begins
        middle = np.round(np.median(wcs, axis=0))
        approximate = {t.marker: place - middle for t, place in zip(field.targets, wcs, strict=True)}
    try:
        network = measure_field(marks, cameras, field, approximate=approximate, calibrate=calibrate)
    except GeometryError as error:
        raise with_overview(error, marks) from error
    require_steady(list(network.changes))
    points = FieldPoints(points=network.points, points_pcs=network.points_pcs, cov=network.cov_points)
    datum = field_datum(points, field.targets, frame) if field.targets else None
    sheets = sheet_sizes(network, field)
    if datum is None:
        require_size(sheets)
    notes = field_notes(network, datum, field, sheets)
    return MeasuredField(network=network, points=points, datum=datum, notes=notes)


def point_table(field: FieldDescription, measured: MeasuredField) -> pd.DataFrame:
    """Table for people: mark, coordinates, sigmas, cone that carries it, number of pictures."""
    table = measured.points.table()
    used = measured.network.residuals[measured.network.residuals["used"]]
    count = used.groupby(["marker", "corner"]).size().to_dict()
    table["cone"] = [field.cone_of(marker) for marker, _ in measured.points.points]
    table["images"] = [int(count.get(point, 0)) for point in measured.points.points]
    return table
