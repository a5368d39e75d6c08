"""Reference cloud -> surface mesh of natural terrain, with the facts that a reader must know about it."""

from typing import Any, Final

import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.mesh import TriangleMesh
from thalweg.core.types import ArrayB, ArrayF
from thalweg.surface.bank_frame import STEEP_DEG, BankFit, fit_bank, front_direction, thin_track
from thalweg.surface.delaunay import triangulate
from thalweg.surface.poisson import depth_for, reconstruct
from thalweg.surface.reference_cloud import (
    CleanCloud,
    ReferenceSettings,
    clean_reference,
    finite_and_single,
)

__all__ = ["ReferenceSettings", "mesh_reference"]

_MUCH_REMOVED: Final = 0.9
_MUCH_STEEP: Final = 0.02


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
    small = _fragments(mesh, settings.longest_edge_m**2)
    counts |= made | {"fragment_faces": int(small.sum())}
    mesh = mesh.part(~small)
    counts["unused_vertices"] = len(cloud.points_m) - len(mesh.vertices_m) if not facts else 0
    if not len(mesh.faces):
        raise GeometryError(
            f"no triangle of the {len(cloud.points_m):,} cleaned points has edges below "
            f"{settings.longest_edge_m:g} m, or all lie in pieces smaller than "
            f"{settings.longest_edge_m**2:.3g} m2",
            expected="a cloud denser than reference.longest_edge_m",
            cure="Raise reference.longest_edge_m above the spacing of the points",
        )
    facts |= _facts(mesh, cloud, fit, settings)
    facts["counts"] = counts
    facts["notes"] = _notes(facts, fit)
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
    """Faces (m,) of connected pieces smaller than ``least_m2``: remains of plants, and all border."""
    piece = mesh.pieces()
    size = np.bincount(piece, mesh.areas_m2(), minlength=1)
    return np.asarray(size[piece] < least_m2)


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
    }


def _notes(facts: dict[str, Any], fit: BankFit) -> list[str]:
    counts, notes = facts["counts"], []
    removed = sum(counts.get(name, 0) for name in ("not_finite", "isolated", "in_front", "behind"))
    if removed > _MUCH_REMOVED * counts["given"]:
        notes.append(
            f"Cleaning took {removed:,} of {counts['given']:,} reference points (isolated "
            f"{counts.get('isolated', 0):,}, in front {counts.get('in_front', 0):,}, behind "
            f"{counts.get('behind', 0):,}): look at reference.isolated_radius_m and reference.clearance_m."
        )
    if fit.vertical:
        notes.append(
            "The bank turns so far that no inclined direction serves: it is meshed as seen from above."
        )
    if facts["method"] == "delaunay" and facts["steep_area_share"] > _MUCH_STEEP:
        notes.append(
            f"{100 * facts['steep_area_share']:.1f} % of the mesh's area is seen on edge (more than "
            f"{STEEP_DEG:g} degrees from the direction of view): overhangs or a bend. A triangulation in one "
            "plane is doubtful there; take a smaller accuracy.area or reference.method poisson."
        )
    cell = facts["settings"]["cell_m"]
    if facts.get("poisson_resolution_m", 0.0) > 2 * cell:
        notes.append(
            f"The octree's cells are {facts['poisson_resolution_m']:.3f} m wide, those of the cloud "
            f"{cell:g} m: stones are smoothed away. Take a smaller accuracy.area, a larger "
            "reference.poisson_depth, or reference.method delaunay."
        )
    return notes
