"""The field from its table of marks: nominal camera, adjustment, place in the world, notes for people."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.calibration import block_of, starting_camera_by
from thalweg.calibration.field.datum import FieldDatum, field_datum, targets_wcs
from thalweg.calibration.field.description import FieldDescription
from thalweg.calibration.field.network import (
    FieldNetwork,
    Start,
    measure_field,
    misfit_px,
    require_steady,
    start_network,
)
from thalweg.calibration.field.points import FieldPoints
from thalweg.core import Camera, GeometryError, LocalFrame, Model, Rigid, ThalwegError, read_marked

_NAMED: Final = 8
"""Points named of those with one reason."""
_CONE_MARKERS: Final = 3
_LARGEST_SIGMA_MM: Final = 1.0
"""P2 section 5.2."""
_PRINT_SHARE: Final = 0.03
"""Printers that fit a page into their margins shrink a sheet by 3 to 5 %."""
_ANOTHER_UNIT: Final = 1.5
_SURE_SIGMAS: Final = 3.0

_GOOD_PICTURES: Final = 3
_FEW_MARKERS: Final = 4

KIND: Final = "thalweg field"
VERSION: Final = 1


# ---------------------------------------------------------------- job


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
    start: Start | None = None,
) -> MeasuredField:
    """Adjust a field and place it in the world.

    Parameters
    ----------
    marks : table of kind ``marks``.
    cameras : nominal interior orientations by name.
    field : its description.
    frame : of wcs.
    start : of `start_network` for these marks and cameras, if it is known already.

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
        network = measure_field(marks, cameras, field, approximate=approximate, start=start)
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


# ---------------------------------------------------------------- what people should know of a measured
# field: what is missing, what checks nothing, what looks wrong


def sheet_sizes(network: FieldNetwork, field: FieldDescription) -> dict[float, float]:
    """Measured over stated size of the sheets, by the stated side of their modules [m]; medians."""
    at = dict(zip(network.points, network.points_pcs, strict=True))
    found: dict[float, list[float]] = {}
    for marker in dict.fromkeys(marker for marker, _ in network.points):
        for corner in range(4):
            ends = (marker, corner), (marker, (corner + 1) % 4)
            if all(end in at for end in ends):
                stated = field.layout.saddles_m(marker)
                side = np.linalg.norm(stated[corner] - stated[(corner + 1) % 4])
                ratio = np.linalg.norm(at[ends[0]] - at[ends[1]]) / side
                found.setdefault(field.layout.module_of(marker), []).append(float(ratio))
    return {module: float(np.median(ratios)) for module, ratios in sorted(found.items())}


def require_size(sheets: Mapping[float, float]) -> None:
    """Refuse a field without targets whose scale bars and printed sheets are of different sizes.

    Raises
    ------
    GeometryError : tells the factor.
    """
    off = [max(ratio, 1 / ratio) for ratio in sheets.values()]
    if off and min(off) > _ANOTHER_UNIT:
        raise GeometryError(
            f"by the scale bars the printed markers are {_times(sheets)} the size in the field description",
            expected="lengths of scale bars and module_m both in metres",
            cure="Measure a printed module and a scale bar, and correct the field description",
        )


def field_notes(
    network: FieldNetwork, datum: FieldDatum | None, field: FieldDescription, sheets: Mapping[float, float]
) -> list[str]:
    """Lines for people.

    Parameters
    ----------
    network, datum : the measured field and its place, None without targets.
    field : its description.
    sheets : from `sheet_sizes`.
    """
    lines = [change.words for change in network.changes if change.clear]
    lines += _rejected(network)
    have = {marker for marker, _ in network.points}
    for cone in field.cones:
        n = len(have & set(cone.markers))
        if n < _CONE_MARKERS:
            lines.append(
                f"cone {cone.name}: {n} of {len(cone.markers)} markers were measured; "
                "take more pictures of it"
            )
    if datum is not None:
        lines += [f"target {name}: {reason}" for name, reason in datum.rejected]
    lines += _scale(network, datum)
    if any(abs(ratio - 1) > _PRINT_SHARE for ratio in sheets.values()):
        lines.append(
            f"the printed markers are {_times(sheets)} the size in the field description: measure a module "
            "and correct module_m, or check the scale bars"
        )
    if float(network.report["object_sigma_mean_mm"]) > _LARGEST_SIGMA_MM:
        sigma = network.report["object_sigma_mean_mm"]
        lines.append(f"object points have a sigma of {sigma:.2f} mm on average; below 1 mm is expected")
    return lines


def _rejected(network: FieldNetwork) -> list[str]:
    lines: list[str] = []
    told: dict[str, Any] = {}
    for row in network.rejected.itertuples():
        if row.what == "point":
            told.setdefault(str(row.reason), []).append(str(row.name))
        else:
            lines.append(f"{row.what} {row.name}: {row.reason}")
    for reason, names in told.items():
        more = " ..." if len(names) > _NAMED else ""
        lines.append(f"{len(names)} points have {reason}: {', '.join(names[:_NAMED])}{more}")
    return lines


def _scale(network: FieldNetwork, datum: FieldDatum | None) -> list[str]:
    """A single scale bar can be wrong and nothing shows it, but for targets that know the size as well."""
    if network.scale is None or network.scale.used.sum() > 1:
        return []
    words = "only one scale bar could be used: "
    if datum is None:
        words += "if its length is wrong, nothing shows it, and the whole field is as wrong"
    else:
        share = _SURE_SIGMAS * datum.sigma_scale
        words += (
            f"the targets show an error of its length of {share:.1%} or more, nothing shows a smaller one"
        )
    return [f"{words}. Put a second bar into the field"]


def _times(sheets: Mapping[float, float]) -> str:
    told = (f"{ratio:.3g} times (modules of {module * 1000:g} mm)" for module, ratio in sheets.items())
    return " and ".join(told)


# ---------------------------------------------------------------- how many images show how many markers


def overview(marks: pd.DataFrame) -> tuple[str, str]:
    """Counts of pictures and markers of a table of marks, and what to photograph by them, in words."""
    pairs = marks.drop_duplicates(["image", "marker"])
    sees = pd.crosstab(pairs["image"], pairs["marker"])
    seen, shown = sees.sum(), sees.sum(axis=1)
    often, twice, once = (int(n.sum()) for n in (seen >= _GOOD_PICTURES, seen == 2, seen == 1))
    words = (
        f"{len(shown)} pictures show {len(seen)} markers: {often} stand in {_GOOD_PICTURES} pictures or "
        f"more, {twice} in two, {once} in one"
    )
    poor = shown[shown < _FEW_MARKERS]
    if len(poor):
        words += f"; {len(poor)} pictures show fewer than {_FEW_MARKERS} markers ({_some(poor.index)})"
    advice = []
    rare = seen[seen < _GOOD_PICTURES].index
    if len(rare):
        advice.append(f"take the markers {_some(rare, 12)} from two more sides")
    if len(shown) < 20:
        advice.append(f"take {20 - len(shown)} pictures more, from all sides and two heights")
    return words, "; ".join(advice)


def with_overview(error: GeometryError, marks: pd.DataFrame) -> GeometryError:
    """The same error, which also tells what the pictures show and what to photograph."""
    if len(marks) == 0:
        return error
    words, advice = overview(marks)
    cure = "; ".join(part.rstrip(".") for part in (error.cure, advice) if part)
    ThalwegError.__init__(
        error, f"{error.found}; {words}", expected=error.expected, where=error.where, cure=cure
    )
    return error


def _some(names: Iterable[object], most: int = 4) -> str:
    every = [str(name) for name in names]
    return ", ".join(every[:most]) + (" ..." if len(every) > most else "")


# ---------------------------------------------------------------- facts of a field beside its points


def write_facts(path: Path, network: FieldNetwork, datum: FieldDatum | None, notes: list[str]) -> None:
    """Write the facts of an adjusted field as JSON."""
    facts: dict[str, Any] = {"kind": KIND, "version": VERSION, "adjustment": network.report, "notes": notes}
    facts["rejected"] = network.rejected.to_dict("records")
    facts["camera_changes"] = [asdict(change) for change in network.changes]
    if network.scale is not None:
        facts["scale_bars"] = {
            "used": network.scale.used.tolist(),
            "off_mm": [_or_none(v * 1000.0) for v in network.scale.off_m],
            "sigma_off_mm": [_or_none(v * 1000.0) for v in network.scale.sigma_off_m],
        }
    facts["T_wcs_pcs"] = None
    if datum is not None:
        facts["T_wcs_pcs"] = {
            "equation": "x_wcs = T_wcs_pcs @ x_pcs",
            "matrix": datum.T_wcs_pcs.matrix.tolist(),
            "cov": datum.T_wcs_pcs.cov.tolist(),
            "cov_of": "shift in m, small rotation vector in rad, both in wcs",
        }
        facts["targets"] = {
            "table": datum.table.to_dict("records"),
            "rejected": [{"name": name, "reason": reason} for name, reason in datum.rejected],
            "sigma0": datum.sigma0,
            "redundancy": datum.redundancy,
            "sigma_scale": datum.sigma_scale,
        }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(facts, indent=2, allow_nan=False) + "\n")


def read_facts(path: Path) -> dict[str, Any]:
    """Read what `write_facts` wrote.

    Raises
    ------
    InputError : the file is missing or something else.
    """
    return read_marked(
        path, kind=KIND, version=VERSION, what="facts of a calibration field", cure="Adjust the field again"
    )


def read_place(path: Path) -> Rigid:
    """``T_wcs_pcs`` of a field with its covariance.

    Raises
    ------
    InputError : the file is missing or something else.
    GeometryError : the field has no targets, so that its place in the world is unknown.
    """
    place = read_facts(path)["T_wcs_pcs"]
    if place is None:
        raise GeometryError(
            "the field has no place in the world: its description names no RTK targets",
            expected="at least three targets",
            where=path,
            cure="Measure three markers or more by RTK and add them to the field description",
        )
    return Rigid.from_matrix(np.array(place["matrix"]), np.array(place["cov"]))


def _or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
