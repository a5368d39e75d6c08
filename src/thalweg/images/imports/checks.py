"""Whether imported poses can be those of the campaign, and if not, what would make them so.

Poses are compared with those that clock, INS and mount predict. Where they are far away, the usual mistakes
are tried one after the other on the numbers of the file: another CRS, columns in another order, heights
above the geoid, another order of angles, another unit, other axes. The one that fits is named.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from pyproj import CRS

from thalweg.core.errors import GeometryError, InputError, ThalwegError
from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayF
from thalweg.images.imports.angles import ccs_rotations, changes, conventions
from thalweg.images.imports.frames import world_axes, world_positions
from thalweg.images.imports.source import Finished, Place
from thalweg.images.model.align import LEAST_IMAGES, angles_between, mean_rotation

_SIGMAS: Final = 4.0
_BETTER: Final = 0.25
"""A reading of the angles that leaves less than this share of the angle is the right one."""
_SUSPECT_RAD: Final = np.deg2rad(3.0)
"""Median angle below which no other reading is looked for."""
_GEOID_M: Final = (15.0, 110.0)
"""Heights of geoids above the ellipsoid are within +-107 m; below 15 m other causes are likelier."""
_LEVEL_M: Final = 3.0
_ALIKE_M: Final = 1.0
_NORTH: Final = ("grid", "true")
_UTM: Final = ((32601, 32660), (32701, 32760), (25828, 25838))
"""EPSG codes of zones of UTM that lie beside each other."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Predicted:
    """Predictions of some images, (n, 3) and (n, 3, 3) in wcs, their sigmas, and the limits of belief."""

    frame: LocalFrame
    centre_wcs_m: ArrayF
    R_wcs_ccs: ArrayF
    sigma_m: float
    sigma_rad: float
    most_m: float
    most_rad: float

    @property
    def limit_m(self) -> float:
        """Median distance that is believed: no less than the predictions' own sigma allows."""
        return max(self.most_m, _SIGMAS * self.sigma_m)

    @property
    def limit_rad(self) -> float:
        """Median angle that is believed."""
        return max(self.most_rad, _SIGMAS * self.sigma_rad)


@dataclass(slots=True, kw_only=True)
class Check:
    """Notes for people and facts of a comparison."""

    notes: list[str] = field(default_factory=list)
    facts: dict[str, Any] = field(default_factory=dict)


def check_poses(source: Finished, centre: ArrayF, R: ArrayF, predicted: Predicted) -> Check:
    """Compare poses in wcs with predicted ones.

    Parameters
    ----------
    source : the same poses as the file has them, for other readings of its numbers.
    centre, R : (n, 3), (n, 3, 3) in wcs.

    Raises
    ------
    InputError : positions or attitudes are not those of the campaign; it says what would fit.
    """
    out = Check()
    if len(centre) < LEAST_IMAGES:
        out.notes.append(f"{len(centre)} images with a prediction: the poses could not be checked against it")
        return out
    off = centre - predicted.centre_wcs_m
    away, turn = np.linalg.norm(off, axis=1), angles_between(R, predicted.R_wcs_ccs)
    out.facts = {
        "images_compared": len(centre),
        "median_distance_m": float(np.median(away)),
        "median_height_difference_m": float(np.median(off[:, 2])),
        "median_angle_deg": float(np.rad2deg(np.median(turn))),
    }
    check_heights(source, off, predicted, out)
    if np.median(away) > predicted.limit_m:
        raise _misplaced(source, predicted, np.median(away))
    _check_attitudes(source, R, turn, predicted)
    out.notes += _north_note(source, R, turn, predicted)
    for what, values, limit, unit in (
        ("m", away, predicted.limit_m, 1.0), ("degrees", turn, predicted.limit_rad, np.rad2deg(1.0)),
    ):  # fmt: skip
        far = np.flatnonzero(values > limit)
        if len(far):
            worst = int(np.argmax(values))
            out.notes.append(
                f"{len(far)} of {len(values)} images are more than {limit * unit:.0f} {what} away from their "
                f"prediction, most of all {source.names[worst]} with {values[worst] * unit:.1f} {what}"
            )
    return out


def check_heights(source: Finished, off: ArrayF, predicted: Predicted, out: Check) -> None:
    """Name a constant difference of heights with positions that fit.

    Parameters
    ----------
    off : (n, 3) imported minus predicted positions in wcs.

    Raises
    ------
    InputError : the difference is that between geoid and ellipsoid.
    """
    height = float(np.median(off[:, 2]))
    scatter = 1.4826 * float(np.median(np.abs(off[:, 2] - height)))
    level = max(_LEVEL_M, 3.0 * predicted.sigma_m)
    flat = float(np.median(np.linalg.norm(off[:, :2], axis=1)))
    if scatter > level or flat > predicted.limit_m or abs(height) <= level:
        return
    words = (
        f"heights {abs(height):.1f} m {'below' if height < 0 else 'above'} the predicted ones, all "
        f"alike (NMAD {scatter:.2f} m), with positions that fit to {flat:.1f} m"
    )
    if _GEOID_M[0] <= abs(height) <= _GEOID_M[1]:
        raise InputError(
            words, expected="heights above the ellipsoid", where=source.where,
            cure="Heights above the geoid differ so: raise images.finished.height_offset_m by the height of "
            f"the geoid there, about {-height:.0f} m, from the geoid model of the land survey",
        )  # fmt: skip
    out.notes.append(words + ": check whether they are above the ellipsoid")


def placed(source: Finished, predicted: Predicted, error: GeometryError) -> ThalwegError:
    """The error to raise where coordinates do not fit into their CRS, with what would fit."""
    for words, cure, median in _other_places(source, predicted):
        if median <= predicted.limit_m:
            return _wrong_place(source, f"{error.found}", words, cure)
    return InputError(error.found, expected=error.expected, where=source.where, cure=error.cure)


def _misplaced(source: Finished, predicted: Predicted, median_m: float) -> InputError:
    found = f"positions a median of {_distance(median_m)} away from the predicted ones"
    tried = [t for t in _other_places(source, predicted) if t[2] <= predicted.limit_m]
    if tried:
        # WGS 84 and ETRS89 fit alike: the first of them is nearest to what was stated
        least = min(t[2] for t in tried)
        words, cure, _ = next(t for t in tried if t[2] <= least + _ALIKE_M)
        return _wrong_place(source, found, words, cure)
    return InputError(
        found, expected=f"at most {predicted.limit_m:.0f} m", where=source.where,
        cure="Check images.finished.crs, that the file belongs to this survey, and the camera's "
        "clock, by which "
        "the prediction goes; images.finished.most_position_m is the limit",
    )  # fmt: skip


def _wrong_place(source: Finished, found: str, words: str, cure: str) -> InputError:
    return InputError(
        f"{found}; {words} would fit", expected=f"coordinates in {source.place.text}", where=source.where,
        cure=cure,
    )  # fmt: skip


def _other_places(source: Finished, predicted: Predicted) -> Iterator[tuple[str, str, float]]:
    """Other readings of the coordinates: words, cure, and the median distance that is left."""
    x = source.coordinates
    swapped = x[:, [1, 0, 2]]
    inside = -np.einsum("nij,nj->ni", source.R_place_ccs, x)
    world, degrees = Place(kind="world"), Place(kind="geographic", crs=CRS.from_epsg(4326))
    own = source.place
    swap, metres, centres = "Swap these columns of the file", "Export in metres", "Export projection centres"
    readings: list[tuple[str, str, ArrayF, Place]] = [
        ("east and north (or longitude and latitude) swapped", swap, swapped, own),
        ("world coordinates of the campaign", "Set images.finished.crs: world", x, world),
        ("the translations of world-to-camera transforms", centres, inside, own),
        ("feet", metres, x * 0.3048, own),
        ("millimetres", metres, x * 1e-3, own),
        ("longitude and latitude", "Set images.finished.crs: EPSG:4326", x, degrees),
        ("latitude and longitude", f"{swap}, and set images.finished.crs: EPSG:4326", swapped, degrees),
    ]
    readings += [
        (crs.name, f"Set images.finished.crs: EPSG:{crs.to_epsg()}", x, Place(kind="map", crs=crs))
        for crs in _grids(own, predicted.frame)
    ]
    for words, cure, values, place in readings:
        median = _median_distance(values, place, predicted)
        if np.isfinite(median):
            yield words, cure, median


def _grids(place: Place, frame: LocalFrame) -> list[CRS]:
    """Zones of UTM around the campaign and beside the stated one."""
    zone = int((frame.lon_deg + 180) // 6) + 1
    codes = [
        32600 + z if frame.lat_deg >= 0 else 32700 + z for z in (zone, zone - 1, zone + 1) if 1 <= z <= 60
    ]
    codes += [25800 + z for z in (zone, zone - 1, zone + 1) if 28 <= z <= 38]
    own = place.crs.to_epsg() if place.crs is not None else None
    if own is not None and any(low <= own <= high for low, high in _UTM):
        codes = [own - 1, own + 1, *codes]
    return [CRS.from_epsg(code) for code in dict.fromkeys(codes) if code != own]


def _median_distance(coordinates: ArrayF, place: Place, predicted: Predicted) -> float:
    try:
        centre = world_positions(coordinates, place, predicted.frame)
    except GeometryError:
        return float("inf")
    off = centre - predicted.centre_wcs_m
    # heights above the geoid are a mistake of their own
    return float(np.median(np.linalg.norm(off[:, :2], axis=1)))


def _check_attitudes(source: Finished, R: ArrayF, turn: ArrayF, predicted: Predicted) -> None:
    """Refuse attitudes far from the predicted ones, or much farther than another reading of the angles."""
    median = float(np.median(turn))
    far = median > predicted.limit_rad
    if not far and median <= max(_SUSPECT_RAD, _SIGMAS * predicted.sigma_rad):
        return
    found = f"attitudes a median of {np.rad2deg(median):.1f} degrees away from the predicted ones"
    limit = f"at most {np.rad2deg(predicted.limit_rad):.0f} degrees"
    expected = limit if far else "no other reading of the angles that fits much better"
    other = _other_angles(source, predicted)
    if other is not None and other[1] < _BETTER * median and other[1] <= predicted.limit_rad:
        raise InputError(
            f"{found}; with {' and '.join(other[0])} they would fit to {np.rad2deg(other[1]):.1f}",
            expected=expected, where=source.where,
            cure=f"Set {', '.join(f'images.finished.{change}' for change in other[0])}",
        )  # fmt: skip
    if not far:
        return
    raise InputError(
        f"{found}{_constant_turn(R, median, predicted)}", expected=expected, where=source.where,
        cure="Check what the rotations of the file mean, the mount of the camera and the camera's clock, by "
        "which the prediction goes; images.finished.most_angle_deg is the limit",
    )  # fmt: skip


def _north_note(source: Finished, R: ArrayF, turn: ArrayF, predicted: Predicted) -> list[str]:
    """Whether angles in a map grid fit much better with the other north."""
    if source.angles is None or source.place.kind != "map":
        return []
    frame, median = predicted.frame, float(np.median(turn))
    readings = {
        n: world_axes(source.coordinates, source.place, frame, n) @ source.R_place_ccs for n in _NORTH
    }
    other = max(_NORTH, key=lambda n: float(np.median(angles_between(readings[n], R))))
    left = float(np.median(angles_between(readings[other], predicted.R_wcs_ccs)))
    convergence = float(np.median(angles_between(readings["grid"], readings["true"])))
    if left > 0.5 * median or convergence < _SIGMAS * predicted.sigma_rad:
        return []
    return [
        f"attitudes fit to {np.rad2deg(median):.2f} degrees, and to {np.rad2deg(left):.2f} if they refer to "
        f"{other} north (convergence {np.rad2deg(convergence):.2f}): images.finished.north"
    ]


def _other_angles(source: Finished, predicted: Predicted) -> tuple[Sequence[str], float] | None:
    """The best other reading of a table's angles, and the median angle (rad) that it leaves."""
    if source.angles is None:
        return None
    axes = world_axes(source.coordinates, source.place, predicted.frame)
    best: tuple[Sequence[str], float] | None = None
    for other in conventions(source.angles):
        changed = changes(source.angles, other)
        if not changed:
            continue
        left = float(np.median(angles_between(axes @ ccs_rotations(other), predicted.R_wcs_ccs)))
        # of readings that fit alike the one that changes least, which comes first
        if best is None or left < best[1] - 1e-6:
            best = changed, left
    return best


def _constant_turn(R: ArrayF, median_rad: float, predicted: Predicted) -> str:
    """Whether one turn of the image axes or of the world's would make all attitudes fit."""
    at_image = np.swapaxes(R, 1, 2) @ predicted.R_wcs_ccs
    at_world = predicted.R_wcs_ccs @ np.swapaxes(R, 1, 2)
    inverse = predicted.R_wcs_ccs @ R
    for turns, words in ((at_image, "the axes of the images"), (at_world, "the axes of the world"),
                         (inverse, "the rotations inverted, and the axes of the world")):  # fmt: skip
        mean = mean_rotation(turns)
        left = float(np.median(angles_between(turns, np.broadcast_to(mean, turns.shape))))
        if left < _BETTER * median_rad:
            angle = float(np.arccos(np.clip((np.trace(mean) - 1) / 2, -1, 1)))
            return (
                f"; with {words} turned by {np.rad2deg(angle):.1f} degrees they would fit to "
                f"{np.rad2deg(left):.1f}"
            )
    return ""


def _distance(metres: float) -> str:
    return f"{metres:.0f} m" if metres < 10_000 else f"{metres / 1000:.0f} km"
