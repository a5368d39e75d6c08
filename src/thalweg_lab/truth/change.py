"""What truly changed between two epochs of the river: distances along normals, classes, volumes.

The surfaces are the meshes of both scenes. A comparison of clouds averages over a cylinder about the normal
of each core point; the true distance averages over parallel rays that fill the same cylinder. Volumes are
those of the ground between both surfaces, column by column, so that a hollow below an overhang counts too.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.spatial import cKDTree

from thalweg.core import (
    AnyArray,
    ArrayB,
    ArrayF,
    ArrayI,
    ConfigError,
    GeometryError,
    LocalFrame,
    column,
    frame_of,
    table_kind,
    write_table,
)
from thalweg.core.geometry import RayCaster, polygon_area_m2
from thalweg.deformation.foreign import SurfaceDifference
from thalweg.settings.sections import Deformation
from thalweg.surface import Area
from thalweg_lab.changes import (
    EDGE_M,
    NICHE_REACH_M,
    PATCH_M,
    Stretch,
    patches,
    retreat_reach_m,
    slope_width,
    stretch,
)
from thalweg_lab.reach import BAR_PLACE, River
from thalweg_lab.river import BARE_GROUND, VEGETATION, Material, Scene
from thalweg_lab.settings import Change, TwinScene

_AXES: Final = ("east", "north", "up")
CLASSES: Final = ("unchanged", "erosion", "deposition", "object", "vegetation", "water", "outside")
"""What a place may be; ``outside``: one of the scenes has no surface there."""

_STEP_M: Final = 1e-3
"""Behind a hit the search for the next one goes on after so much; the resolution of float32 is far below."""
_LEAST_M: Final = 0.01
"""Smaller distances are no change."""
_PLANTS_M: Final = 1.0
"""How near plants must be to spoil a place."""
_MOST_HITS: Final = 16
_GOLDEN_RAD: Final = np.pi * (3.0 - 5.0**0.5)
_INSIDE_M: Final = 1.0
"""So much of the water before a retreating bank belongs to its outline, metres."""


# ---------------------------------------------------------------- distances along normals


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueChanges:
    """The truth at core points.

    Parameters
    ----------
    distance_m : (n,) from the first to the second surface along the normal, mean over the cylinder; not a
        number where either is missing. On stones and things the surface is theirs, below plants it is the
        ground.
    kind : (n,) one of `CLASSES`.
    off_m : (n,) from the core point to the first surface along the normal: the error of the core itself.
    """

    distance_m: ArrayF
    kind: AnyArray
    off_m: ArrayF


def true_changes(
    before: Scene,
    after: Scene,
    core_wcs_m: ArrayF,
    normal_wcs: ArrayF,
    *,
    radius_m: float = 0.5,
    reach_m: float = 10.0,
    rays: int = 19,
) -> TrueChanges:
    """Distances and classes at core points.

    Along each ray those surfaces are searched that face the normal and lie in no other body: of the first
    epoch the one nearest to the core point, of the second the one nearest to that. The class is the first
    that holds: ``water`` where the mean of either surface lies below the water of its epoch; ``vegetation``
    where plants stand within ``plants_m`` of the core on a quarter of the rays, in either epoch; ``object``
    where half of the rays meet something else than ground in either epoch, and the distance is not small;
    ``erosion`` and ``deposition`` by sign; ``unchanged`` where the distance is small.

    Parameters
    ----------
    before, after : scenes of both epochs, in one frame.
    core_wcs_m : (n, 3).
    normal_wcs : (n, 3) of unit length, out of the ground.
    radius_m : of the cylinder; 0: one ray along the normal.
    reach_m : both surfaces are searched within this distance of the core point.
    rays : rays in the cylinder, spread evenly over its area.

    Raises
    ------
    GeometryError : normals that are not of unit length, or not as many as core points.
    """
    core, normal = (np.asarray(a, dtype=np.float64) for a in (core_wcs_m, normal_wcs))
    if core.shape != normal.shape or core.ndim != 2 or core.shape[1] != 3:
        raise GeometryError(
            f"core points of shape {core.shape}, normals of shape {normal.shape}",
            expected="both of shape (n, 3)",
        )
    if not np.allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-3):
        raise GeometryError("normals of other lengths than one", expected="unit normals")
    start = _bundle(core, normal, radius_m, rays if radius_m > 0 else 1)
    n, k = start.shape[:2]
    origin, way = start.reshape(-1, 3), np.repeat(normal, k, axis=0)
    first, first_kind = _faced(before, origin, way, np.zeros(n * k), reach_m)
    second, second_kind = _faced(after, origin, way, np.nan_to_num(first), reach_m)
    both = (np.isfinite(first) & np.isfinite(second)).reshape(n, k)
    t1, t2 = first.reshape(n, k), second.reshape(n, k)
    distance, off = _mean(t2 - t1, both), _mean(t1, both)
    kind = np.where(distance < 0, "erosion", "deposition").astype("<U10")
    kind[np.abs(distance) < _LEAST_M] = "unchanged"
    thing = [(~BARE_GROUND[each]).reshape(n, k) & both for each in (first_kind, second_kind)]
    things = np.maximum(*(np.sum(each, axis=1) for each in thing))
    kind[(2 * things >= np.sum(both, axis=1)) & (np.abs(distance) >= _LEAST_M)] = "object"
    spoilt = np.zeros(n, dtype=np.bool_)
    for scene in (before, after):
        spoilt |= 4 * np.sum(_plants_near(scene, origin, way, _PLANTS_M).reshape(n, k), axis=1) >= k
    kind[spoilt] = "vegetation"
    for scene, t in ((before, t1), (after, t2)):
        height = _mean(start[..., 2] + t * normal[:, None, 2], both)
        kind[height < scene.water_level_m] = "water"
    kind[~both.any(axis=1)] = "outside"
    return TrueChanges(distance_m=distance, kind=kind, off_m=off)


def _bundle(core: ArrayF, normal: ArrayF, radius_m: float, rays: int) -> ArrayF:
    """Starting points (n, rays, 3) in discs about the core points, each standing for the same area."""
    i = np.arange(rays)
    r, turn = radius_m * np.sqrt((i + 0.5) / rays), i * _GOLDEN_RAD
    if rays == 1:
        r = np.zeros(1)
    aside = np.where(np.abs(normal[:, 2:]) > 0.9, [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    u = np.cross(aside, normal)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    v = np.cross(normal, u)
    disc = (r * np.cos(turn))[None, :, None] * u[:, None] + (r * np.sin(turn))[None, :, None] * v[:, None]
    return np.asarray(core[:, None] + disc)


def _mean(values: ArrayF, use: ArrayB) -> ArrayF:
    count = np.sum(use, axis=1)
    total = np.sum(np.where(use, values, 0.0), axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _faced(
    scene: Scene, origin: ArrayF, way: ArrayF, near_m: ArrayF, reach_m: float
) -> tuple[ArrayF, ArrayI]:
    """Places (m,) along lines where solid surfaces face their direction, nearest to ``near_m``; materials."""
    solid = scene.without(Material.WATER, *_PLANTS)
    found, depth = np.full(len(origin), np.nan), np.zeros(len(origin), dtype=np.int64)
    kind = np.zeros(len(origin), dtype=np.int64)
    # From outside inwards; how many bodies a ray is in tells whether a surface is open or buried in another.
    for row, t, triangle, enters in _crossings(solid.caster(), origin + reach_m * way, -way, 2.0 * reach_m):
        place = reach_m - t
        better = enters & (depth[row] == 0)
        better &= ~(np.abs(found[row] - near_m[row]) <= np.abs(place - near_m[row]))
        found[row[better]], kind[row[better]] = place[better], solid.material[triangle[better]]
        depth[row] = np.maximum(depth[row] + np.where(enters, 1, -1), 0)
    return found, kind


def _crossings(
    caster: RayCaster, origin: ArrayF, way: ArrayF, most_m: float
) -> Iterator[tuple[ArrayI, ArrayF, ArrayI, ArrayB]]:
    """All hits of rays one after the other: rows, ways from the origin, triangles, whether they enter."""
    row, gone = np.arange(len(origin)), np.zeros(len(origin))
    for _ in range(_MOST_HITS):
        hits = caster.cast(origin[row] + gone[row, None] * way[row], way[row])
        t = gone[row] + hits.t_hit_m
        some = t <= most_m
        row, t = row[some], t[some]
        if not len(row):
            return
        enters = np.einsum("ij,ij->i", hits.normal[some], way[row]) < 0
        yield row, t, hits.primitive[some], enters
        gone[row] = t + _STEP_M


_PLANTS: Final = tuple(m for m in Material if VEGETATION[m])


def _plants_near(scene: Scene, origin: ArrayF, way: ArrayF, within_m: float) -> ArrayB:
    plants = scene.only(*_PLANTS)
    if not len(plants.triangles):
        return np.zeros(len(origin), dtype=np.bool_)
    return np.asarray(plants.caster().cast(origin - within_m * way, way).t_hit_m <= 2.0 * within_m)


# ---------------------------------------------------------------- measured against true

_CHANGED_M: Final = 0.05
"""A measured place that truly moved less than this, and is called eroded although unseen, is a mistake."""


def judge_changes(
    changes: pd.DataFrame,
    core_points: pd.DataFrame,
    volumes: pd.DataFrame,
    before: Scene,
    after: Scene,
    *,
    radius_m: float,
    reach_m: float,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """How well measured changes and their sigmas agree with the truth.

    Parameters
    ----------
    changes, core_points, volumes : results of the comparison of two epochs.
    before, after : scenes of both epochs.
    radius_m, reach_m : of the cylinders of the comparison.

    Returns
    -------
    measures : ``measure, value, n``. Bare ground counts (no plants, things or water), measured places only.
    cores : ``core, true_distance_m, true_class``.
    """
    axes = ("east", "north", "up")
    true = true_changes(
        before,
        after,
        changes[[f"{a}_m" for a in axes]].to_numpy(),
        changes[[f"normal_{a}" for a in axes]].to_numpy(),
        radius_m=radius_m,
        reach_m=reach_m,
    )
    kind, state = true.kind, changes["state"].to_numpy()
    distance, sigma = changes["distance_m"].to_numpy(), changes["sigma_m"].to_numpy()
    moved = true.distance_m
    same, changed = kind == "unchanged", np.isin(kind, ("erosion", "deposition"))
    counted = np.isfinite(distance) & np.isfinite(moved) & ~np.isin(state, ("vegetation", "object"))
    z = (distance - moved) / sigma
    called = np.isin(state, ("erosion", "deposition"))
    large = counted & changed & (np.abs(moved) >= 0.1)
    area = core_points["area_m2"].to_numpy()
    in_net = np.isfinite(distance) & np.isin(state, ("erosion", "deposition", "no significant change"))
    known = in_net & np.isfinite(moved)
    volume_error = float(np.sum(area[known] * (distance - moved)[known]))
    sigma_net = float(volumes.loc[volumes["what"] == "net", "sigma_m3"].iloc[0])
    farthest = (
        int(np.nanargmin(np.where(counted & changed, moved, np.nan))) if (counted & changed).any() else 0
    )
    unseen = called & ~np.isfinite(distance)
    rows = [
        ("normalised_square_unchanged", _mean_of(z**2, counted & same), counted & same),
        ("false_alarm_95", _mean_of(np.abs(distance / sigma) > 1.96, counted & same), counted & same),
        ("normalised_square_changed", _mean_of(z**2, counted & changed), counted & changed),
        ("sensitivity_0.1_m", _mean_of(called, large), large),
        ("specificity", _mean_of(~called, counted & same), counted & same),
        ("false_discovery", _mean_of(same, called & counted), called & counted),
        ("net_volume_error_m3", volume_error, known),
        ("net_volume_error_over_sigma", volume_error / sigma_net, known),
        ("largest_retreat_true_m", float(-moved[farthest]), counted & changed),
        ("largest_retreat_measured_m", float(-distance[farthest]), counted & changed),
        ("unseen_called_change", float(unseen.sum()), unseen),
        ("unseen_called_change_wrongly", float(np.sum(unseen & (np.abs(moved) < _CHANGED_M))), unseen),
        ("plants_called_change", _mean_of(called, kind == "vegetation"), kind == "vegetation"),
        ("things_called_change", _mean_of(called, kind == "object"), kind == "object"),
    ]
    table = pd.DataFrame([{"measure": m, "value": v, "n": int(use.sum())} for m, v, use in rows])
    cores = pd.DataFrame({"core": changes["core"], "true_distance_m": moved, "true_class": kind})
    return table, cores


def _mean_of(values: AnyArray, use: ArrayB) -> float:
    return float(values[use].mean()) if use.any() else np.nan


# ---------------------------------------------------------------- volumes


def true_volumes(
    before: Scene,
    after: Scene,
    outlines: Mapping[str, ArrayF],
    *,
    step_m: float = 0.1,
    above_m: float = -np.inf,
) -> pd.DataFrame:
    """Volumes of ground that went and came within outlines.

    Parameters
    ----------
    before, after : scenes of both epochs; their ground counts, stones, plants and buildings do not.
    outlines : name -> (k, 2) corners, east and north.
    step_m : distance of the columns that are summed.
    above_m : ground below this height does not count, as where water hides it.

    Returns
    -------
    volumes : a row for each outline: ``name``, ``area_m2`` where both scenes have ground, ``erosion_m3``
        and ``deposition_m3``, both positive, and ``net_m3``, second minus first ground.

    Raises
    ------
    InputError : an outline that is no polygon.
    GeometryError : an outline that is narrower than the columns.
    """
    casters = [scene.only(*_GROUND).caster() for scene in (before, after)]
    top = max(float(s.vertices_wcs_m[:, 2].max()) for s in (before, after)) + 1.0
    depth = top - min(float(s.vertices_wcs_m[:, 2].min()) for s in (before, after)) + 1.0
    rows = []
    for name, outline in outlines.items():
        columns = _columns(name, np.asarray(outline, dtype=np.float64), step_m)
        high = np.column_stack([columns, np.full(len(columns), top)])
        solid = [_profile(caster, high, depth) for caster in casters]
        there = np.isfinite(solid[0][0][:, 0]) & np.isfinite(solid[1][0][:, 0])
        went, came = _gone_and_new(solid[0], solid[1], there, above_m)
        # The columns stand for the outline's area, not for the number of cells that happen to lie in it.
        cell = abs(polygon_area_m2(outline)) / len(columns)
        erosion, deposition = float(went.sum() * cell), float(came.sum() * cell)
        rows.append(
            {
                "name": name,
                "area_m2": float(there.sum() * cell),
                "erosion_m3": erosion,
                "deposition_m3": deposition,
                "net_m3": deposition - erosion,
            }
        )
    return pd.DataFrame(rows, columns=["name", "area_m2", "erosion_m3", "deposition_m3", "net_m3"])


_GROUND: Final = tuple(m for m in Material if BARE_GROUND[m])


def _columns(name: str, outline: ArrayF, step_m: float) -> ArrayF:
    area = Area(polygon_en_m=outline)
    low, high = outline.min(axis=0), outline.max(axis=0)
    axes = [np.arange(a + step_m / 2, b, step_m) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    inside = grid[area.contains(np.column_stack([grid, np.zeros(len(grid))]))]
    if not len(inside):
        raise GeometryError(
            f"outline {name} is narrower than the columns",
            expected=f"more than {step_m} m",
            cure="Lower step_m",
        )
    return np.asarray(inside)


def _profile(caster: RayCaster, high: ArrayF, depth_m: float) -> tuple[ArrayF, ArrayF]:
    """Heights (n, k) at which the ground of columns begins or ends, from above, and +1 or -1; padded by -inf.

    The ground has no lower side: below its last surface all is solid.
    """
    n = len(high)
    down = np.tile([0.0, 0.0, -1.0], (n, 1))
    heights, signs = [], []
    for row, t, _, enters in _crossings(caster, high, down, depth_m):
        z, each = np.full(n, -np.inf), np.zeros(n)
        z[row], each[row] = high[row, 2] - t, np.where(enters, 1.0, -1.0)
        heights.append(z)
        signs.append(each)
    if not heights:
        return np.full((n, 1), -np.inf), np.zeros((n, 1))
    return np.stack(heights, axis=1), np.stack(signs, axis=1)


def _gone_and_new(
    first: tuple[ArrayF, ArrayF], second: tuple[ArrayF, ArrayF], there: ArrayB, above_m: float
) -> tuple[ArrayF, ArrayF]:
    """Heights of ground (n,) that only the first, and that only the second epoch has."""
    z = np.concatenate([first[0], second[0]], axis=1)[there]
    one = np.concatenate([first[1], np.zeros_like(second[1])], axis=1)[there]
    two = np.concatenate([np.zeros_like(first[1]), second[1]], axis=1)[there]
    order = np.argsort(-z, axis=1, kind="stable")
    z, one, two = (np.take_along_axis(a, order, axis=1) for a in (z, one, two))
    solid_one, solid_two = np.cumsum(one, axis=1) > 0, np.cumsum(two, axis=1) > 0
    lowest = np.where(np.isfinite(z), z, np.inf).min(axis=1, keepdims=True)
    z = np.maximum(np.maximum(z, lowest), above_m)
    # Below the lowest surface of all both are solid.
    length = z - np.concatenate([z[:, 1:], z[:, -1:]], axis=1)
    went = np.sum(length * (solid_one & ~solid_two), axis=1)
    came = np.sum(length * (solid_two & ~solid_one), axis=1)
    return went, came


# ---------------------------------------------------------------- the truth as files

POINTS: Final = table_kind(
    "true_change_points",
    1,
    [
        *(column(f"{axis}_m", "m", f"place on the first ground, {axis} in wcs") for axis in _AXES),
        *(column(f"normal_{axis}", "1", f"normal of the ground, {axis}") for axis in _AXES),
        column("distance_m", "m", "true change along the normal, mean over the cylinder"),
        column("kind", "1", "class of the change", pa.string()),
        column("polygon", "1", "change that the place belongs to; empty: none", pa.string()),
    ],
)
"""One row a place on the ground of the first epoch."""
_PER_M2: Final = 4.0
"""Places on a square metre."""
_THINGS: Final = ("moved_boulders", "new_boulders", "fallen_tree")
"""Changes of things, which no volume of ground holds."""


def simulate_change(
    *,
    scenes: list[Path],
    points: Path,
    polygons: Path,
    settings: list[dict[str, Any]],
    seeds: list[int],
    campaign: dict[str, Any],
    deformation: Deformation,
) -> None:
    """What truly changed: at places on the first ground in the area, and by polygon with volumes and classes.

    Parameters
    ----------
    scenes : of both epochs.
    points : table `POINTS`; polygons : CSV, see `true_polygons`.
    settings : sections ``twin.scene`` of both epochs; seeds : of both campaigns.
    campaign : origin and map grid; deformation : area, cylinders.
    """
    before, after = (Scene.read(path) for path in scenes)
    first, second = (TwinScene(**each) for each in settings)
    outlines = change_outlines(first, second, seeds[0] if first.seed is None else first.seed)
    area = Area.from_section(deformation.area, LocalFrame(**campaign["origin"]), campaign["crs"])
    true_polygons(before, after, outlines).to_csv(polygons, index=False)
    write_table(
        points,
        true_points(
            before,
            after,
            outlines,
            area,
            radius_m=deformation.cylinder_radius_m,
            reach_m=deformation.reach_m,
            seed=seeds[0],
        ),
        POINTS,
    )


def true_polygons(before: Scene, after: Scene, outlines: Mapping[str, ArrayF]) -> pd.DataFrame:
    """Volumes of ground by outline, above the water of both epochs.

    Returns
    -------
    A row a polygon: ``name, kind`` ("object" where things came or went, else what most of the volume is),
    ``area_m2, erosion_m3, deposition_m3, net_m3`` (see `true_volumes`) and ``outline``, its corners as text.
    """
    level = max(before.water_level_m, after.water_level_m)
    table = true_volumes(before, after, outlines, above_m=level)
    ground = np.where(
        table["net_m3"] < 0, "erosion", np.where(table["net_m3"] > 0, "deposition", "unchanged")
    )
    table.insert(1, "kind", np.where(table["name"].isin(_THINGS), "object", ground))
    table["outline"] = [
        "; ".join(f"{east:.3f} {north:.3f}" for east, north in outlines[name]) for name in table["name"]
    ]
    return table


def outlines_of(polygons: pd.DataFrame) -> dict[str, ArrayF]:
    """Corners (k, 2) of the polygons of `true_polygons`, by name."""
    return {
        str(row["name"]): np.array([corner.split() for corner in str(row["outline"]).split(";")], np.float64)
        for row in polygons.to_dict("records")
    }


def true_points(
    before: Scene,
    after: Scene,
    outlines: Mapping[str, ArrayF],
    area: Area,
    *,
    radius_m: float,
    reach_m: float,
    seed: int,
) -> pd.DataFrame:
    """Table `POINTS`: true changes at random places on the ground of the first epoch, four a square metre.

    Raises
    ------
    GeometryError : no ground of the first epoch lies in the area.
    """
    ground = before.only(*_GROUND)
    corners = ground.vertices_wcs_m[ground.triangles]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inside = area.contains(corners.mean(axis=1))
    if not inside.any():
        raise GeometryError(
            "no ground of the first epoch lies in deformation.area",
            expected="an area on the bank of the twin",
        )
    corners, across = corners[inside], across[inside]
    size = 0.5 * np.linalg.norm(across, axis=1)
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(size), int(np.ceil(_PER_M2 * size.sum())), p=size / size.sum())
    u, v = rng.random((2, len(chosen)))
    fold = u + v > 1.0
    u, v = np.where(fold, 1.0 - u, u), np.where(fold, 1.0 - v, v)
    a, b, c = (corners[chosen, i] for i in range(3))
    place = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    # the mean normal of the ground about a place: single triangles are as rough as the soil
    near = cKDTree(corners.mean(axis=1)).query_ball_point(place, radius_m)
    normal = np.array(
        [across[rows].sum(axis=0) if rows else across[k] for k, rows in zip(chosen, near, strict=True)]
    )
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    found = true_changes(before, after, place, normal, radius_m=radius_m, reach_m=reach_m)
    polygon = np.full(len(place), "", dtype=object)
    for name, outline in outlines.items():
        polygon[Area(polygon_en_m=outline).contains(place)] = name
    return frame_of(
        POINTS,
        {
            **{f"{axis}_m": place[:, i] for i, axis in enumerate(_AXES)},
            **{f"normal_{axis}": normal[:, i] for i, axis in enumerate(_AXES)},
            "distance_m": found.distance_m,
            "kind": found.kind,
            "polygon": polygon,
        },
    )


_NEAR: Final = 1.5
"""A core point within so many spacings tells of a place."""


def judge_places(
    changes: pd.DataFrame, truth: pd.DataFrame, spacing_m: float
) -> list[tuple[str, float, int]]:
    """What became of the true changes of 10 cm and more on bare ground, wherever core points lie.

    Parameters
    ----------
    changes : measured; truth : table `POINTS`; spacing_m : of the core points.

    Returns
    -------
    measure, value, number of places: share that a core point with a distance stands for, and share of these
    that was called erosion or deposition with the right sign.
    """
    large = truth[truth["kind"].isin(("erosion", "deposition")) & (truth["distance_m"].abs() >= 0.1)]
    if not len(large):
        return []
    measured = changes[changes["distance_m"].notna()]
    tree = cKDTree(measured[[f"{axis}_m" for axis in _AXES]].to_numpy())
    off, nearest = tree.query(large[[f"{axis}_m" for axis in _AXES]].to_numpy())
    seen = np.asarray(off <= _NEAR * spacing_m)
    state = measured["state"].to_numpy()[nearest]
    called = seen & (state == large["kind"].to_numpy())
    return [
        ("true_changes_seen", float(seen.mean()), len(large)),
        ("true_changes_called", float(called[seen].mean()) if seen.any() else np.nan, int(seen.sum())),
    ]


def judge_polygons(
    changes: pd.DataFrame,
    core_points: pd.DataFrame,
    draws: pd.DataFrame,
    true_distance_m: ArrayF,
    polygons: pd.DataFrame,
) -> pd.DataFrame:
    """Measured and true net volume of each polygon of true change.

    Parameters
    ----------
    changes, core_points, draws : results of the comparison of two epochs.
    true_distance_m : (k,) of the core points.
    polygons : see `true_polygons`.

    Returns
    -------
    A row a polygon: ``name, kind, area_m2``, ``true_m3`` of all ground in it, and of the core points that
    were measured ``cores, measured_m2, measured_m3``, ``expected_m3`` by their true distances,
    and ``sigma_m3`` from the draws of all errors.
    """
    area = core_points["area_m2"].to_numpy()
    distance = changes["distance_m"].to_numpy()
    use = changes["state"].isin(("erosion", "deposition", "no significant change"))
    use &= np.isfinite(distance) & np.isfinite(true_distance_m)
    errors = np.nan_to_num(draws.drop(columns="core").to_numpy())
    places = changes[[f"{axis}_m" for axis in _AXES]].to_numpy()
    rows = []
    outlines = outlines_of(polygons)
    for row in polygons.to_dict("records"):
        inside = use.to_numpy() & Area(polygon_en_m=outlines[row["name"]]).contains(places)
        weight = np.where(inside, area, 0.0)
        rows.append(
            {
                **{key: row[key] for key in ("name", "kind", "area_m2")},
                "true_m3": row["net_m3"],
                "cores": int(inside.sum()),
                "measured_m2": float(weight.sum()),
                "measured_m3": float(weight @ np.nan_to_num(distance)),
                "expected_m3": float(weight @ np.nan_to_num(true_distance_m)),
                "sigma_m3": float(np.sqrt(np.mean((weight @ errors) ** 2))),
            }
        )
    return pd.DataFrame(rows)


def judge_differences(
    found: SurfaceDifference, before: Scene, after: Scene, frame: LocalFrame, *, reach_m: float
) -> list[tuple[str, float, int]]:
    """How well differences of heights and their sigmas agree with the truth, in cells of bare ground.

    Parameters
    ----------
    found : difference in cells of a map.
    before, after : scenes of both epochs, in ``frame``.
    reach_m : of the comparison.

    Returns
    -------
    measure, value, number of cells: mean of squared error over variance where the ground did not change, and
    where it did.
    """
    raster = found.raster
    known = np.isfinite(raster.height_m)
    if not known.any() or raster.frame is None:
        return []
    plan = raster.centres_m()[known.ravel()]
    middle = frame.to_map(np.zeros(3), raster.frame)
    high = frame.from_map(np.column_stack([plan, np.full(len(plan), middle[2])]), raster.frame)
    high[:, 2] = before.vertices_wcs_m[:, 2].max() + 1.0
    down = np.tile([0.0, 0.0, -1.0], (len(high), 1))
    on_ground = before.only(*_GROUND).caster().cast(high, down).t_hit_m
    place = high - np.column_stack(
        [np.zeros((len(high), 2)), np.where(np.isfinite(on_ground), on_ground, 0.0)]
    )
    radius = float(np.sqrt(raster.cell_area_m2 / np.pi))
    true = true_changes(before, after, place, -down, radius_m=radius, reach_m=reach_m)
    error = raster.height_m[known] - true.distance_m
    z2 = (error / found.sigma_m[known]) ** 2
    there = np.isfinite(on_ground) & np.isfinite(z2)
    rows = []
    for name, kinds in (("unchanged", ("unchanged",)), ("changed", ("erosion", "deposition"))):
        use = there & np.isin(true.kind, kinds)
        rows.append((f"height_normalised_square_{name}", _mean_of(z2, use), int(use.sum())))
    return rows


# ---------------------------------------------------------------- where the changes are


def change_outlines(before: TwinScene, after: TwinScene, seed: int) -> dict[str, ArrayF]:
    """Outlines (k, 2), east and north, of the changes that either epoch has, but grown vegetation.

    Patches have an outline each, a niche and its collapse one together. Those of retreating banks hold the
    bank and a metre of the water before it.

    Parameters
    ----------
    before, after : sections ``twin.scene`` of both epochs.
    seed : seed of the ground: ``twin.scene.seed``, or the first campaign's.

    Raises
    ------
    ConfigError : the epochs are not of one river.
    """
    own = {"changes": (), "stage_m": 0.0, "retreat_m": 0.0, "seed": None}
    if before.model_copy(update=own) != after.model_copy(update=own):
        raise ConfigError(
            "two scenes of different rivers",
            expected="settings that differ in changes, retreat_m and stage_m alone",
            where="twin.scene",
        )
    for scene in (before, after):
        if scene.seed not in (None, seed):
            raise ConfigError(
                f"a river of seed {scene.seed}", expected=f"seed {seed}", where="twin.scene.seed"
            )
    river = River(before.model_copy(update=own), seed)
    found: dict[str, ArrayF] = {}
    for epoch in (before, after):
        for change in epoch.changes:
            if change == "change_patches":
                for patch in patches(epoch):
                    half = (PATCH_M[0] + EDGE_M) / 2 / river.bank_scale(patch.middle_s_m, patch.right_m)
                    up = (PATCH_M[1] + EDGE_M) / 2 * np.cos(patch.slope_rad)
                    behind = (patch.right_m - up, patch.right_m + up)
                    found[patch.name] = _strip(river, Stretch(patch.middle_s_m, half), "right", behind)
            elif change != "grown_vegetation":
                side, behind = _behind(epoch, change)
                name = "niche" if change == "collapsed_niche" else change
                found[name] = _strip(river, stretch(epoch, change), side, behind)
    return found


def _behind(scene: TwinScene, change: Change) -> tuple[str, tuple[float, float]]:
    """Side of a change, and from where to where it reaches behind the shore of the first epoch, metres."""
    width = scene.width_m
    if change in ("niche", "collapsed_niche"):
        return "right", (0.0, NICHE_REACH_M)
    if change == "bank_retreat":
        return "right", (-_INSIDE_M, retreat_reach_m(scene) + 1.0)
    if change in ("moved_boulders", "new_boulders"):
        return "right", (-1.9, slope_width(scene))
    if change == "undercut_bank":
        return "left", (-_INSIDE_M, scene.retreat_m + 3.0)
    if change == "gravel_bar":
        return "left", (-(BAR_PLACE + 0.055) * width, -(BAR_PLACE - 0.055) * width)
    if change == "fallen_tree":
        return "left", (-0.1 * width - 1.5, 3.0)
    return "thalweg", (-0.1 * width, 0.1 * width)


def _strip(river: River, where: Stretch, side: str, behind_m: tuple[float, float]) -> ArrayF:
    s = np.linspace(where.middle_m - where.half_m, where.middle_m + where.half_m, 33)
    if side == "right":
        edges = [-river.half_width(s) - each for each in behind_m]
    else:
        middle = river.half_width(s) if side == "left" else river.thalweg_n(s)
        edges = [middle + each for each in behind_m]
    return np.concatenate([river.to_wcs(s, edges[0]), river.to_wcs(s, edges[1])[::-1]])
