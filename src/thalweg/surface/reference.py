"""Reference cloud -> surface mesh of natural terrain, with the facts that a reader must know about it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import shapely
from scipy.spatial import cKDTree

from thalweg.core import (
    ArrayB,
    ArrayF,
    ArrayI,
    CoverageError,
    GeometryError,
    InputError,
    LocalFrame,
    frame_in_words,
    iter_laz,
    laz_header,
    njit,
    robust_sigma,
)
from thalweg.core.geometry import TriangleMesh
from thalweg.lidar import MOST_COUNTED, Occupancy
from thalweg.settings.sections import ReferenceSettings
from thalweg.surface.area import Area
from thalweg.surface.meshing import (
    STEEP_DEG,
    BankFit,
    BankFrame,
    depth_for,
    fit_bank,
    front_direction,
    reconstruct,
    thin_track,
    triangulate,
)
from thalweg.surface.thinning import heights_above_envelope, spikes, thin

__all__ = ["mesh_reference"]
_LEAST_FRAGMENT: Final = 0.01
"""Pieces smaller than this share of the largest one are no surface, whatever the longest edge."""
_LEAST_USED: Final = 0.02
"""A smaller share of vertices in faces is no mesh of the points, but chance neighbours."""
_MUCH_REMOVED: Final = 0.9
_MUCH_IN_FRONT: Final = 0.3
"""Plants on a bank that a scanner can see are a few per cent; a second surface is half of the points."""
_MUCH_UNUSED: Final = 0.5
_MUCH_STEEP: Final = 0.02
_MANY_LAYERS: Final = 1.5
_FAR_M: Final = 300.0
"""No scanner of a boat reaches so far."""

LEAST_POINTS: Final = 3
Method = Literal["delaunay", "poisson"]

_LEAST_MARGIN_M: Final = 2.0
_EDGES_OF_MARGIN: Final = 4.0
GEOID_M: Final = 10.0
"""A larger difference of heights is one of height systems, not of the terrain."""
_ANOTHER_GRID_M: Final = 2000.0
_GEOID: Final = (
    "As large as a difference between ellipsoid and geoid: bring the reference, accuracy.area and "
    "campaign.origin.h_ell_m to heights above the ellipsoid"
)
_HEIGHTS: Final = "Compare min_height_m and max_height_m of accuracy.area with the heights of the reference"
_GRID: Final = (
    "Another CRS or zone than that of the campaign? ingest/reference.integrity.json tells which one was "
    "stated or assumed"
)
_PLACES: Final = (
    "Compare the corners of accuracy.area with the reference: are both in the same coordinates "
    "(accuracy.area.frame), in the order east, north, and in the CRS of the campaign?"
)

APART_M: Final = 0.05
"""Stations of one survey agree within centimetres; grass that only one of them sees stays below that."""
_CELL_M: Final = 0.5
_LEAST_POINTS: Final = 5
_LEAST_CELLS: Final = 20


@dataclass(frozen=True, slots=True, kw_only=True)
class CleanCloud:
    """Points of the ground.

    Parameters
    ----------
    points_m : (n, 3) wcs.
    normals : (n, 3) unit normals in wcs, on the side of `out` of the bank.
    sigma_m : (n,) standard deviation of each point along its normal.
    n_merged : (n,) points that it is the mean of.
    counts : what was given, and what became of it.
    front_m : median height above the lower envelope of the points in front of it; 0 without any.
    """

    points_m: ArrayF
    normals: ArrayF
    sigma_m: ArrayF
    n_merged: ArrayI
    counts: dict[str, int]
    front_m: float = 0.0


# ---------------------------------------------------------------- mesh


def mesh_reference(
    points_m: ArrayF, *, track_m: ArrayF, settings: ReferenceSettings
) -> tuple[TriangleMesh, dict[str, Any]]:
    """Mesh of the ground under a reference cloud; all faces look toward the river.

    Parameters
    ----------
    points_m : (n, 3) wcs, of one or several scans.
    track_m : (k, 3) wcs, the boat's track.
    settings : how to clean and to mesh.

    Returns
    -------
    mesh : every vertex belongs to a face.
    facts : JSON-able: counts of every loss, bank frame, sizes, median sigma, and `notes` for people.

    Raises
    ------
    InputError : too few points, or none left by the cleaning.
    GeometryError : no surface: all points on a line, or no triangle with edges short enough.
    """
    points, counts = finite_and_single(points_m)
    track = thin_track(track_m)
    fit = fit_bank(points, track)
    cloud = clean_reference(points, fit.frame, settings)
    counts |= {name: n for name, n in cloud.counts.items() if name not in counts}
    mesh, made, facts = _meshed(cloud, fit, track, settings)
    whole = len(mesh.faces)
    mesh = mesh.part(~_fragments(mesh, settings.longest_edge_m**2)) if whole else mesh
    counts |= made | {"fragment_faces": whole - len(mesh.faces)}
    counts["unused_vertices"] = len(cloud.points_m) - len(mesh.vertices_m) if not facts else 0
    if not whole or counts["unused_vertices"] > (1 - _LEAST_USED) * len(cloud.points_m):
        raise GeometryError(
            f"{counts.get('long_faces', 0):,} of {counts.get('long_faces', 0) + whole:,} triangles of the "
            f"{len(cloud.points_m):,} cleaned points have edges above {settings.longest_edge_m:g} m",
            expected="a cloud denser than reference.longest_edge_m",
            cure="Raise reference.longest_edge_m above the spacing of the points",
        )
    facts |= _facts(mesh, cloud, fit, settings)
    facts["counts"] = counts
    some = mesh.vertices_m[:: 1 + len(mesh.vertices_m) // 10_000]
    facts["track_m"] = float(np.min(cKDTree(track).query(some)[0]))
    facts["notes"] = mesh_notes(facts, vertical=fit.vertical)
    return mesh, facts


def _meshed(
    cloud: CleanCloud, fit: BankFit, track: ArrayF, settings: ReferenceSettings
) -> tuple[TriangleMesh, dict[str, int], dict[str, Any]]:
    if settings.method == "delaunay":
        made = triangulate(cloud.points_m, fit.frame, longest_edge_m=settings.longest_edge_m)
        mesh = TriangleMesh(vertices_m=cloud.points_m, faces=made.faces, sigma_m=cloud.sigma_m)
        return mesh, made.counts, {}
    front = front_direction(cloud.points_m, track)
    away = np.sum(cloud.normals * front, axis=1) < 0
    surface = reconstruct(
        cloud.points_m,
        np.where(away[:, None], -cloud.normals, cloud.normals),
        cloud.sigma_m,
        depth=settings.poisson_depth or depth_for(cloud.points_m, settings.cell_m),
        longest_edge_m=settings.longest_edge_m,
    )
    mesh = TriangleMesh(vertices_m=surface.vertices_m, faces=surface.faces, sigma_m=surface.sigma_m)
    return (
        mesh,
        surface.counts,
        {"poisson_depth": surface.depth, "poisson_resolution_m": surface.resolution_m},
    )


def _fragments(mesh: TriangleMesh, least_m2: float) -> ArrayB:
    """Faces (m,) of connected pieces smaller than ``least_m2``: remains of plants, and all border.

    A long edge must not make a small mesh a fragment: what counts is then the size of the largest piece.
    """
    piece = mesh.pieces()
    size = np.bincount(piece, mesh.areas_m2(), minlength=1)
    return np.asarray(size[piece] < min(least_m2, _LEAST_FRAGMENT * float(size.max())))


def _facts(
    mesh: TriangleMesh, cloud: CleanCloud, fit: BankFit, settings: ReferenceSettings
) -> dict[str, Any]:
    areas, out = mesh.areas_m2(), fit.frame.out
    normal = mesh.face_normals()
    edges = mesh.vertices_m[mesh.faces] - mesh.vertices_m[np.roll(mesh.faces, -1, axis=1)]
    steep = normal @ out < np.cos(np.deg2rad(STEEP_DEG))
    return {
        "method": settings.method,
        "settings": settings.model_dump(mode="json", exclude={"sigma_m"}),
        "bank_frame": {
            "origin_m": fit.frame.origin_m.tolist(),
            "R_bank_wcs": fit.frame.R_bank_wcs.tolist(),
            "inclination_deg": float(np.rad2deg(np.arccos(np.clip(out[2], -1, 1)))),
            "vertical": fit.vertical,
            "patches": fit.n_patches,
            "steep_patch_share": fit.steep_share,
        },
        "vertices": len(mesh.vertices_m),
        "faces": len(mesh.faces),
        "border_faces": int(mesh.border_faces().sum()),
        "area_m2": float(areas.sum()),
        "covered_area_m2": float(np.sum(areas * np.maximum(normal @ out, 0.0))),
        "median_edge_m": float(np.median(np.sqrt(np.einsum("fkx,fkx->fk", edges, edges)))),
        "median_sigma_m": float(np.median(mesh.sigma_m)),
        "points_a_vertex": float(np.mean(cloud.n_merged)),
        "steep_deg": STEEP_DEG,
        "steep_area_share": float(areas[steep].sum() / areas.sum()),
        "pieces": int(mesh.pieces().max()) + 1,
        "layers": _layers(mesh, fit, settings.longest_edge_m),
        "front_m": cloud.front_m,
    }


def _layers(mesh: TriangleMesh, fit: BankFit, cell_m: float) -> float:
    """How many times the mesh covers the plane of the bank, on average over the cells that it touches."""
    middle = mesh.vertices_m[mesh.faces].mean(axis=1)
    cell = np.floor(fit.frame.to_bank(middle)[:, :2] / cell_m).astype(np.int64)
    cell -= cell.min(axis=0)
    touched = np.unique(cell[:, 0] * (cell[:, 1].max() + 1) + cell[:, 1])
    area = np.sum(mesh.areas_m2() * np.abs(mesh.face_normals() @ fit.frame.out))
    return float(area / (len(touched) * cell_m**2))


# ---------------------------------------------------------------- what a reader must be told about a
# reference mesh, in sentences


def mesh_notes(facts: Mapping[str, Any], *, vertical: bool) -> list[str]:
    """Sentences about a mesh that may not be what it should.

    Parameters
    ----------
    facts : of the mesh, with ``counts``, ``layers``, ``front_m`` and ``track_m``.
    vertical : it was triangulated as seen from above, because no inclined direction served.
    """
    notes = [*_of_cleaning(facts), *_of_second_surfaces(facts)]
    if vertical:
        notes.append(
            "The bank turns so far that no inclined direction serves: it is meshed as seen from above."
        )
    if facts["method"] == "delaunay" and facts["steep_area_share"] > _MUCH_STEEP:
        notes.append(
            f"{100 * facts['steep_area_share']:.1f} % of the mesh's area is seen on edge (more than "
            f"{facts['steep_deg']:g} degrees from the direction of view): overhangs or a bend. A "
            "triangulation in one plane is doubtful there; take a smaller accuracy.area or reference.method "
            "poisson."
        )
    cell = facts["settings"]["cell_m"]
    if facts.get("poisson_resolution_m", 0.0) > 2 * cell:
        notes.append(
            f"The octree's cells are {facts['poisson_resolution_m']:.3f} m wide, those of the cloud "
            f"{cell:g} m: stones are smoothed away. Take a smaller accuracy.area, a larger "
            "reference.poisson_depth, or reference.method delaunay."
        )
    if facts["track_m"] > _FAR_M:
        notes.append(
            f"The boat stays {facts['track_m'] / 1000:,.1f} km or more away from the reference: they are "
            "not of one place, and which side of the mesh is its front is a guess."
        )
    return notes


def _of_cleaning(facts: Mapping[str, Any]) -> list[str]:
    counts, notes = facts["counts"], []
    removed = sum(counts.get(name, 0) for name in ("not_finite", "isolated", "in_front", "behind"))
    if removed > _MUCH_REMOVED * counts["given"]:
        notes.append(
            f"Cleaning took {removed:,} of {counts['given']:,} reference points (isolated "
            f"{counts.get('isolated', 0):,}, in front {counts.get('in_front', 0):,}, behind "
            f"{counts.get('behind', 0):,}): look at {_of_steps(counts)}."
        )
    unused, kept = counts.get("unused_vertices", 0), counts["kept"]
    if unused > _MUCH_UNUSED * kept:
        notes.append(
            f"{unused:,} of {kept:,} cleaned points are in no triangle: raise reference.longest_edge_m "
            f"({facts['settings']['longest_edge_m']:g} m) above their spacing."
        )
    return notes


def _of_steps(counts: Mapping[str, int]) -> str:
    """Settings of the steps that took points."""
    lonely = "reference.isolated_radius_m, which must fit the spacing of the points"
    steps = [lonely] if counts.get("isolated") else []
    if counts.get("in_front", 0) + counts.get("behind", 0):
        steps.append("reference.clearance_m")
    return ", and at ".join(steps) or "the file"


def _of_second_surfaces(facts: Mapping[str, Any]) -> list[str]:
    counts, notes = facts["counts"], []
    in_front = counts.get("in_front", 0)
    if in_front > _MUCH_IN_FRONT * counts["given"]:
        notes.append(
            f"{in_front:,} of {counts['given']:,} reference points "
            f"({100 * in_front / counts['given']:.0f} %) were left out in front of the ground, at a median "
            f"height of {facts['front_m']:.1f} m: dense plants, or a second surface (two epochs)?"
        )
    if facts["layers"] > _MANY_LAYERS:
        notes.append(
            f"The mesh covers its ground {facts['layers']:.1f} times: there is a second surface (two epochs, "
            "two registrations, crowns). Set reference.clearance_m, or give one scan only."
        )
    return notes


# ---------------------------------------------------------------- points of the ground


def clean_reference(points_m: ArrayF, frame: BankFrame, settings: ReferenceSettings) -> CleanCloud:
    """Leave out what is no ground, and thin the rest to one point a cell.

    In this order: coordinates that are not finite, repeated points, isolated points, points in front of the
    lower envelope (plants, loose objects) and behind it (multipath), in each cell the points that do not
    belong to its surface, and cells that stand alone in front of those about them.

    Parameters
    ----------
    points_m : (n, 3) wcs.
    frame : of the bank; "lower" is against its `out`.
    settings : radius, neighbours, clearance, width of the cells.

    Raises
    ------
    InputError : fewer than three points are given or left; the message says which step took them.
    """
    points, counts = finite_and_single(points_m)
    front_m = 0.0
    if settings.isolated_neighbours:
        points = _step(points, _has_company(points, settings), "isolated", counts)
    if settings.clearance_m is not None and len(points):
        height = heights_above_envelope(frame.to_bank(points), clearance_m=settings.clearance_m)
        front, behind = height > settings.clearance_m, height < -2 * settings.clearance_m
        counts["in_front"], counts["behind"] = int(front.sum()), int(behind.sum())
        front_m = float(np.median(height[front])) if front.any() else 0.0
        points = points[~(front | behind)]
    if len(points) < LEAST_POINTS:
        raise InputError(
            f"cleaning leaves {len(points)} points of the reference: {_counts_in_words(counts)}",
            expected=f"at least {LEAST_POINTS} points of a surface",
            cure=f"Look at {_of_steps(counts)}",
        )
    thinned = thin(frame.to_bank(points), settings.cell_m, cubes=settings.method == "poisson")
    counts["off_surface"] = thinned.n_trimmed
    counts["merged"] = int(thinned.n_merged.sum()) - len(thinned.points)
    # cubes stand one above the other on a wall: there a column has more than one point
    single = (
        ~spikes(thinned.points) if settings.method == "delaunay" and settings.clearance_m else slice(None)
    )
    points = thinned.points[single]
    counts["spikes"], counts["kept"] = len(thinned.points) - len(points), len(points)
    return CleanCloud(
        points_m=frame.to_wcs(points),
        normals=thinned.normals[single] @ frame.R_bank_wcs,
        sigma_m=thinned.sigma_m[single],
        n_merged=thinned.n_merged[single],
        counts=counts,
        front_m=front_m,
    )


def finite_and_single(points_m: ArrayF) -> tuple[ArrayF, dict[str, int]]:
    """Points (m, 3) with finite coordinates, each place once, and the counts of the others.

    Raises
    ------
    InputError : the array is no list of points, or fewer than three are left.
    """
    points = np.asarray(points_m, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"reference points of shape {points.shape}", expected="(n, 3)")
    counts = {"given": len(points)}
    points = _step(points, np.asarray(np.isfinite(points).all(axis=1)), "not_finite", counts)
    # Points that two exports share would count as each other's company, and make a mean look better.
    points = _step(points, first_of_equals(points), "duplicates", counts)
    if len(points) < LEAST_POINTS:
        raise InputError(
            f"a reference of {len(points)} usable points: {_counts_in_words(counts)}",
            expected=f"at least {LEAST_POINTS} points of a surface",
            cure="Look at the reference file and its CRS, and take a larger accuracy.area",
        )
    return points, counts


def first_of_equals(points_m: ArrayF) -> ArrayB:
    """True (n,) for the first of points with the same coordinates, to the last bit."""
    code = _stirred(np.ascontiguousarray(points_m + 0.0).view(np.uint64))  # + 0.0: -0.0 is 0.0
    order = np.argsort(code, kind="stable")
    same = np.diff(code[order]) == 0
    same[same] = (points_m[order[1:][same]] == points_m[order[:-1][same]]).all(axis=1)
    first = np.ones(len(points_m), dtype=np.bool_)
    first[order[1:][same]] = False
    return first


@njit(cache=True, nogil=True)
def _stirred(bits: Any) -> Any:
    """One number (n,) for three each, by the finaliser of MurmurHash3 (Appleby)."""
    out = np.empty(len(bits), dtype=np.int64)
    for i in range(len(bits)):
        h = np.uint64(0)
        for axis in range(3):
            h = h * np.uint64(0x9E3779B97F4A7C15) + bits[i, axis]
            h ^= h >> np.uint64(33)
            h *= np.uint64(0xFF51AFD7ED558CCD)
            h ^= h >> np.uint64(33)
            h *= np.uint64(0xC4CEB9FE1A85EC53)
            h ^= h >> np.uint64(33)
        out[i] = np.int64(h)
    return out


def _has_company(points: ArrayF, settings: ReferenceSettings) -> ArrayB:
    # the grid counts from the origin of wcs: a middle near the cloud keeps its block numbers small
    local = points - np.round(points.mean(axis=0))
    grid = Occupancy(settings.isolated_radius_m)
    grid.add(local)
    grid.freeze()
    enough = min(settings.isolated_neighbours, MOST_COUNTED - 1)
    return np.asarray(grid.neighbours(local, enough=enough) >= enough)


def _step(points: ArrayF, keep: ArrayB, name: str, counts: dict[str, int]) -> ArrayF:
    counts[name] = int(len(keep) - np.count_nonzero(keep))
    return points if keep.all() else points[keep]


def _counts_in_words(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{n:,} {name.replace('_', ' ')}" for name, n in counts.items())


# ---------------------------------------------------------------- the part that is meshed
#
# Were the mesh to end where the area ends, the nearest place of points at its rim would be the mesh's border,
# and their distances would say where the reference was cut.


def area_margin_m(settings: ReferenceSettings) -> float:
    """How far around the area of interest the reference is meshed, so that the mesh's border lies outside."""
    return max(_LEAST_MARGIN_M, _EDGES_OF_MARGIN * settings.longest_edge_m)


def near_area(points_m: ArrayF, area: Area, margin_m: float) -> ArrayB:
    """Points (n,) inside an area or no farther than ``margin_m`` from it, in plan and in height."""
    lowest, highest = area.lowest_m - margin_m, area.highest_m + margin_m
    inside = replace(area, lowest_m=lowest, highest_m=highest).contains(points_m)
    if area.polygon_en_m is None:
        return inside
    low, high = area.polygon_en_m.min(axis=0) - margin_m, area.polygon_en_m.max(axis=0) + margin_m
    at_height = replace(area, polygon_en_m=None, lowest_m=lowest, highest_m=highest).contains(points_m)
    plan = points_m[:, :2]
    about = np.flatnonzero(~inside & at_height & ((plan >= low) & (plan <= high)).all(axis=1))
    outline = shapely.linearrings(area.polygon_en_m)
    shapely.prepare(outline)
    inside[about] = shapely.dwithin(outline, shapely.points(plan[about]), margin_m)
    return inside


@dataclass(slots=True, kw_only=True)
class ReferencePoints:
    """What was read of a reference cloud.

    Parameters
    ----------
    points_m : (n, 3) wcs, in the area and its margin.
    source : (n,) number of the file that each point comes from, from 1.
    counts : points read, and outside the area.
    files : of each file its name, its points, and how many of them lie in the area and its margin.
    notes : sentences for people.
    """

    points_m: ArrayF
    source: ArrayI
    counts: dict[str, int]
    files: dict[int, dict[str, Any]]
    notes: list[str]


@dataclass(slots=True)
class _Seen:
    """Where the points of one file lie."""

    n: int = 0
    kept: int = 0
    low: ArrayF = field(default_factory=lambda: np.full(3, np.inf))
    high: ArrayF = field(default_factory=lambda: np.full(3, -np.inf))
    in_plan: int = 0
    sum_of_heights_m: float = 0.0

    def add(self, points: ArrayF, keep: ArrayB, area: Area) -> None:
        """Count some points (n, 3) of the file, of which those of ``keep`` are near the area."""
        self.n, self.kept = self.n + len(points), self.kept + int(np.count_nonzero(keep))
        self.low = np.minimum(self.low, points.min(axis=0))
        self.high = np.maximum(self.high, points.max(axis=0))
        plan = replace(area, lowest_m=-np.inf, highest_m=np.inf).contains(points)
        self.in_plan += int(np.count_nonzero(plan))
        self.sum_of_heights_m += float(area.heights_m(points[plan]).sum())

    def above_m(self, area: Area) -> float:
        """How far the mean height in plan is above the heights of the area; NaN if they do not meet in plan.

        From the middle of its limits, or from the one limit that there is.
        """
        limits = [z for z in (area.lowest_m, area.highest_m) if np.isfinite(z)]
        if not self.in_plan or not limits:
            return float("nan")
        return self.sum_of_heights_m / self.in_plan - sum(limits) / len(limits)

    def away_m(self, area: Area) -> float:
        """Distance in plan between the boxes about the points and about the area."""
        if area.polygon_en_m is None:
            return 0.0
        low, high = area.polygon_en_m.min(axis=0), area.polygon_en_m.max(axis=0)
        return float(np.linalg.norm(np.maximum(0.0, np.maximum(low - self.high[:2], self.low[:2] - high))))

    def offset(self, area: Area) -> tuple[str, str]:
        """Where the points lie against the area, and what may be the cause."""
        above = self.above_m(area)
        if np.isfinite(above):
            side = "above" if above > 0 else "below"
            both = np.isfinite(area.lowest_m) and np.isfinite(area.highest_m)
            of = "the middle of its heights" if both else "its limit"
            words = f"in plan they meet it, but on average {abs(above):.1f} m {side} {of}"
            return words, _GEOID if abs(above) > GEOID_M else _HEIGHTS
        away = self.away_m(area)
        return f"in plan they end {away:,.0f} m from it", _GRID if away > _ANOTHER_GRID_M else _PLACES


def read_reference(
    path: Path, frame: LocalFrame, area: Area, *, margin_m: float, files: Sequence[str] = ()
) -> ReferencePoints:
    """The part of a reference cloud that lies in an area and its margin, and where the rest is.

    Parameters
    ----------
    path : LAZ in the world frame; ``point_source_id`` counts the files that it was gathered from.
    frame : the world frame of the campaign.
    area : of interest.
    margin_m : how far around it points are taken.
    files : names of the files that the cloud was gathered from, for messages.

    Raises
    ------
    InputError : the cloud is empty, or not in the world frame of the campaign.
    CoverageError : fewer than three points lie inside, or all points of one file lie in the area in plan but
        more than 10 m above or below; the message says where they and the area are.
    """
    theirs = laz_header(path).frame
    if theirs != frame:
        raise InputError(
            f"the reference is in the frame {frame_in_words(theirs)}",
            expected=f"the campaign's world frame, {frame_in_words(frame)}",
            where=path,
            cure="Run the rule read_reference again",
        )
    parts, sources = [], []
    total, seen = _Seen(), {}  # type: _Seen, dict[int, _Seen]
    for chunk in iter_laz(path):
        points, source = chunk["xyz_m"], np.asarray(chunk["point_source_id"], dtype=np.int64)
        keep = near_area(points, area, margin_m)
        for number in np.flatnonzero(np.bincount(source)).tolist():
            mine = source == number
            seen.setdefault(number, _Seen()).add(points[mine], keep[mine], area)
        total.add(points, keep, area)
        parts.append(points[keep])
        sources.append(source[keep])
    if not total.n:
        raise InputError("the reference cloud has no points", expected="a terrestrial scan", where=path)
    named = {k: files[k - 1] if 0 < k <= len(files) else f"file {k} of {path.name}" for k in sorted(seen)}
    if total.kept < LEAST_POINTS:
        raise _none_near(total, area, margin_m, next(iter(named.values())) if len(seen) == 1 else str(path))
    notes = []
    for number, name in named.items():
        if seen[number].kept:
            continue
        if abs(seen[number].above_m(area)) > GEOID_M:
            raise _none_near(seen[number], area, margin_m, name)
        words, cause = seen[number].offset(area)
        notes.append(
            f"{name}: none of {seen[number].n:,} points lies in the area of interest: {words}. {cause}."
        )
    return ReferencePoints(
        points_m=np.concatenate(parts),
        source=np.concatenate(sources),
        counts={"read": total.n, "outside_area": total.n - total.kept},
        files={
            k: {"file": name, "points": seen[k].n, "near_area": seen[k].kept} for k, name in named.items()
        },
        notes=notes,
    )


def _none_near(seen: _Seen, area: Area, margin_m: float, where: str) -> CoverageError:
    axes = zip(("east", "north", "height"), seen.low, seen.high, strict=True)
    words, cause = seen.offset(area)
    many = (
        f"only {seen.kept} of {seen.n:,} reference points lie"
        if seen.kept
        else (f"none of {seen.n:,} reference points lies")
    )
    return CoverageError(
        f"{many} in the area of interest: they reach from "
        + ", ".join(f"{name} {a:.1f} to {b:.1f} m" for name, a, b in axes)
        + ("" if seen.kept else f"; {words}"),
        expected=f"points in {area.describe()}, or no more than {margin_m:g} m from it",
        where=where,
        cure=_PLACES if seen.kept else cause,
    )


# ---------------------------------------------------------------- do the files agree?
#
# Two scans that were registered apart, or at two epochs, give a mesh that follows the one farther behind, or
# runs to and fro between both, and nothing in it tells so.


def compare_files(read: ReferencePoints, frame: BankFrame) -> tuple[list[dict[str, Any]], list[str]]:
    """How far apart two files each lie along `out` of the bank, and sentences about those that differ.

    Parameters
    ----------
    read : points with the numbers of their files.
    frame : of the bank.

    Returns
    -------
    pairs : of files that share 20 cells or more: their names; `cells`; `apart_m`, the median over these cells
        of the difference of the median heights in them, positive if the second stands in front; `spread_m`,
        the NMAD of these differences.
    notes : sentences for people.
    """
    columns = _medians(read, frame)
    pairs, notes = [], []
    for one, other in combinations(columns, 2):
        shared = [key for key in columns[one] if key in columns[other]]
        if len(shared) < _LEAST_CELLS:
            continue
        differences = np.array([columns[other][key] - columns[one][key] for key in shared])
        apart = float(np.median(differences))
        spread = robust_sigma(differences, apart)
        names = [read.files[number]["file"] for number in (one, other)]
        pairs.append({"files": names, "cells": len(shared), "apart_m": round(apart, 5)})
        pairs[-1]["spread_m"] = round(spread, 5)
        # in crowns two stations see different leaves: those differences have no common value
        if abs(apart) > max(APART_M, spread):
            side = "in front of" if apart > 0 else "behind"
            notes.append(
                f"{names[1]} lies {abs(apart):.2f} m {side} {names[0]} where they meet: another epoch, "
                "registration or height system? Remove one of them from logs.reference."
            )
    return pairs, notes


def _medians(read: ReferencePoints, frame: BankFrame) -> Mapping[int, dict[int, float]]:
    """Median height in each cell of the plane of the bank that holds five points of a file or more."""
    if len(read.files) < 2:
        return {}
    good = np.isfinite(read.points_m).all(axis=1)
    bank, source = frame.to_bank(read.points_m[good]), read.source[good]
    cell = np.floor(bank[:, :2] / _CELL_M).astype(np.int64)
    cell -= cell.min(axis=0, initial=0)
    key = cell[:, 0] * (int(cell[:, 1].max(initial=0)) + 1) + cell[:, 1]
    return {number: _of_one(key[source == number], bank[source == number, 2]) for number in read.files}


def _of_one(key: ArrayI, height_m: ArrayF) -> dict[int, float]:
    order = np.lexsort((height_m, key))
    cells, start, n = np.unique(key[order], return_index=True, return_counts=True)
    many = n >= _LEAST_POINTS
    middle = height_m[order[(start + n // 2)[many]]]
    return dict(zip(cells[many].tolist(), middle.tolist(), strict=True))
