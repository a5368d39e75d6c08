"""What people should know of a measured field: what is missing, what checks nothing, what looks wrong."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from thalweg.calibration.field.datum import FieldDatum
from thalweg.calibration.field.description import FieldDescription
from thalweg.calibration.field.network import FieldNetwork
from thalweg.core.errors import GeometryError

_NAMED: Final = 8
"""Points named of those with one reason."""
_CONE_MARKERS: Final = 3
_LARGEST_SIGMA_MM: Final = 1.0
"""P2 section 5.2."""
_PRINT_SHARE: Final = 0.03
"""Printers that fit a page into their margins shrink a sheet by 3 to 5 %."""
_ANOTHER_UNIT: Final = 1.5
_SURE_SIGMAS: Final = 3.0


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
