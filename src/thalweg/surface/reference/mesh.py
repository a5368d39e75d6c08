"""Reference cloud -> surface mesh of natural terrain, with the facts that a reader must know about it."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree

from thalweg.core.errors import GeometryError
from thalweg.core.geometry.mesh import TriangleMesh
from thalweg.core.types import ArrayB, ArrayF
from thalweg.surface.bank_frame import STEEP_DEG, BankFit, fit_bank, front_direction, thin_track
from thalweg.surface.delaunay import triangulate
from thalweg.surface.poisson import depth_for, reconstruct
from thalweg.surface.reference.cloud import (
    CleanCloud,
    ReferenceSettings,
    clean_reference,
    finite_and_single,
)

# ---------------------------------------------------------------- what a reader must be told about a
# reference mesh, in sentences


_MUCH_REMOVED: Final = 0.9
_MUCH_IN_FRONT: Final = 0.3
"""Plants on a bank that a scanner can see are a few per cent; a second surface is half of the points."""
_MUCH_UNUSED: Final = 0.5
_MUCH_STEEP: Final = 0.02
_MANY_LAYERS: Final = 1.5
_FAR_M: Final = 300.0
"""No scanner of a boat reaches so far."""


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
            f"{counts.get('behind', 0):,}): look at reference.isolated_radius_m and reference.clearance_m."
        )
    unused, kept = counts.get("unused_vertices", 0), counts["kept"]
    if unused > _MUCH_UNUSED * kept:
        notes.append(
            f"{unused:,} of {kept:,} cleaned points are in no triangle: raise reference.longest_edge_m "
            f"({facts['settings']['longest_edge_m']:g} m) above their spacing."
        )
    return notes


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


# ---------------------------------------------------------------- mesh


__all__ = ["ReferenceSettings", "mesh_reference"]

_LEAST_FRAGMENT: Final = 0.01
"""Pieces smaller than this share of the largest one are no surface, whatever the longest edge."""
_LEAST_USED: Final = 0.02
"""A smaller share of vertices in faces is no mesh of the points, but chance neighbours."""


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
    return mesh, surface.counts, {
        "poisson_depth": surface.depth, "poisson_resolution_m": surface.resolution_m,
    }  # fmt: skip


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
        "settings": {name: getattr(settings, name) for name in settings.__slots__},
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
