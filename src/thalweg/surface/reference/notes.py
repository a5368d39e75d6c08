"""What a reader must be told about a reference mesh, in sentences."""

from collections.abc import Mapping
from typing import Any, Final

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
