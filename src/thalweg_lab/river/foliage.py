"""Leaves, branches and trunks: how bushes and trees are built from lobes.

A crown is a group of lobes, balls of foliage at the ends of branches. Leaves lie near the surface of a lobe,
turned outwards and upwards; each is a rhombus folded along its midrib. The number of leaves is given; their
size follows from the area that they have to cover, so that fewer leaves are larger ones.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI
from thalweg_lab.river.materials import Material
from thalweg_lab.river.mesh import MeshParts, tube_faces, tubes

_COVER: Final = 0.5
"""Area of the leaves over the area of the lobes' surfaces."""

_LEAF_LENGTH_M: Final = (0.045, 0.9)
_SIDES: Final = 5


@dataclass(frozen=True, slots=True)
class Plants:
    """Bushes or trees.

    Parameters
    ----------
    foot : (p, 3) where the trunk leaves the ground, wcs, metres.
    height : (p,) metres.
    spread : (p,) half width of the crown, metres.
    variation : (p,) 0 to 1.
    stays : (p,) false where a later epoch has lost the plant. Its numbers are drawn all the same, so that
        the others keep theirs.
    """

    foot: ArrayF
    height: ArrayF
    spread: ArrayF
    variation: ArrayF
    stays: ArrayB


def crown_lobes(rng: np.random.Generator, plants: Plants, lobes: int, *, low: float) -> tuple[ArrayF, ArrayF]:
    """Centres (p, lobes, 3) and radii (p, lobes) of the lobes, in wcs.

    Parameters
    ----------
    rng : randomness.
    plants : what they belong to.
    lobes : how many each has.
    low : where the crown begins, as a share of the height.
    """
    p = len(plants.height)
    way = rng.standard_normal((p, lobes, 3))
    way /= np.linalg.norm(way, axis=2, keepdims=True)
    way *= rng.uniform(0.35, 1.0, (p, lobes, 1)) ** 0.5
    share = rng.uniform(0.22, 0.55, (p, lobes))
    radius = share * plants.spread[:, None]
    middle = (1.0 + low) / 2
    tall = (1.0 - low) / 2 * plants.height
    room = np.stack([plants.spread, plants.spread, tall], axis=1)[:, None, :] - 0.75 * radius[:, :, None]
    centre = way * np.maximum(room, 0.15 * plants.spread[:, None, None])
    centre[..., 2] += (middle * plants.height)[:, None]
    # Crowns are broadest below their middle.
    upper = np.clip((centre[..., 2] / plants.height[:, None] - middle) / (1.0 - middle), 0.0, 1.0)
    centre[..., :2] *= (1.0 - 0.45 * upper)[..., None]
    return centre + plants.foot[:, None, :], radius


def add_leaves(
    parts: MeshParts,
    rng: np.random.Generator,
    plants: Plants,
    centre: ArrayF,
    radius: ArrayF,
    leaves: float,
) -> None:
    """Leaves on the lobes of plants; ``leaves`` on a plant of mean lobe surface."""
    p, lobes = radius.shape
    if p == 0:
        return
    area = np.sum(4 * np.pi * radius**2, axis=1)
    count = np.maximum((leaves * area / np.mean(area)).astype(np.int64), 8)
    owner = np.repeat(np.arange(p), count)
    m = len(owner)
    # Lobes get leaves in proportion to their surface.
    share = np.cumsum(radius**2, axis=1)
    share /= share[:, -1:]
    lobe = np.minimum(np.sum(rng.uniform(size=m)[:, None] > share[owner], axis=1), lobes - 1)
    length = np.sqrt(_COVER * area / count / 0.25).clip(*_LEAF_LENGTH_M)[owner]
    length *= rng.uniform(0.7, 1.25, m)
    out = rng.standard_normal((m, 3), dtype=np.float32).astype(np.float64)
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    # Mostly near the surface, some inside.
    ragged = 1.0 + 0.16 * rng.standard_normal(m).clip(-2.0, 2.0)
    inside = (0.35 + 0.65 * rng.uniform(size=m) ** 0.5) * ragged
    place = centre[owner, lobe] + out * (radius[owner, lobe] * inside)[:, None]
    up = np.array([0.0, 0.0, 1.0])
    normal = 0.5 * out + 0.55 * up + 0.75 * _normals(rng, m)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along = 0.8 * out - 0.25 * up + 0.8 * _normals(rng, m)
    along -= np.sum(along * normal, axis=1, keepdims=True) * normal
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    variation = 0.55 * plants.variation[owner] + 0.45 * rng.uniform(size=m)
    stays = plants.stays[owner]
    corners = leaf_corners(place[stays], along[stays], normal[stays], length[stays])
    parts.add_copies(np.array([[0, 1, 2], [0, 2, 3]]), corners, Material.LEAF, variation[stays])


def _normals(rng: np.random.Generator, m: int) -> ArrayF:
    return rng.standard_normal((m, 3), dtype=np.float32).astype(np.float64)


def leaf_corners(place: ArrayF, along: ArrayF, normal: ArrayF, length: ArrayF) -> ArrayF:
    """Corners (m, 4, 3) of folded rhombi: base, right, tip, left."""
    aside = np.cross(normal, along) * (0.25 * length)[:, None]
    reach = along * (0.5 * length)[:, None]
    lift = normal * (0.06 * length)[:, None]
    return np.stack([place - reach, place - aside + lift, place + reach, place + aside + lift], axis=1)


def add_wood(
    parts: MeshParts, rng: np.random.Generator, plants: Plants, centre: ArrayF, thick: float, rings: int
) -> None:
    """Trunk of each plant, and a branch to each of its lobes.

    Parameters
    ----------
    parts : target.
    rng : randomness.
    plants : the plants.
    centre : (p, lobes, 3) ends of the branches.
    thick : radius of the trunk over the height.
    rings : sections of a trunk; 0: no trunk, the branches leave the ground.
    """
    p, lobes = centre.shape[:2]
    if p == 0:
        return
    root = plants.foot - [0.0, 0.0, 0.25]
    top = np.mean(centre, axis=1)
    top[:, 2] = plants.foot[:, 2] + 0.86 * plants.height
    bend = rng.normal(0, 0.035, (p, max(rings, 2), 3)) * plants.height[:, None, None]
    u = np.linspace(0.0, 1.0, max(rings, 2))
    bend *= (u * (1 - u) * 4)[None, :, None]
    axis = root[:, None] + (top - root)[:, None] * u[None, :, None] + bend
    radius = (
        (thick * plants.height)[:, None] * (1.0 - 0.88 * u[None, :]) * (1.0 + 0.5 * np.exp(-9 * u))[None, :]
    )
    if rings:
        trunks = tubes(axis, radius, _SIDES + 2)[plants.stays]
        faces = tube_faces(_SIDES + 2, rings)
        parts.add_copies(faces, trunks, Material.BARK, plants.variation[plants.stays])
    # Branches leave the trunk below their lobe; those of bushes leave the ground.
    rise = (centre[..., 2] - root[:, None, 2]) / (top - root)[:, None, 2]
    start_u = np.clip(0.6 * rise - 0.05, 0.0, 0.9) if rings else np.zeros((p, lobes))
    start = _on_axis(axis, u, start_u)
    v = np.array([0.0, 0.5, 1.0])
    sag = rng.normal(0, 0.08, (p, lobes, 1, 3)) * (v * (1 - v) * 4)[None, None, :, None]
    sag = sag * np.linalg.norm(centre - start, axis=2)[:, :, None, None]
    path = start[:, :, None] + (centre - start)[:, :, None] * v[None, None, :, None] + sag
    first = 0.5 * thick * plants.height[:, None] * (1.0 - 0.8 * start_u)
    girth = first[:, :, None] * np.array([1.0, 0.65, 0.3])[None, None, :]
    bodies = tubes(path.reshape(p * lobes, 3, 3), girth.reshape(p * lobes, 3), _SIDES - 1)
    stays = np.repeat(plants.stays, lobes)
    variation = np.repeat(plants.variation, lobes)[stays]
    parts.add_copies(tube_faces(_SIDES - 1, 3), bodies[stays], Material.BARK, variation)


def _on_axis(axis: ArrayF, u: ArrayF, at: ArrayF) -> ArrayF:
    """Points (p, k, 3) of polylines at parameters (p, k)."""
    step = u[1] - u[0]
    i: ArrayI = np.minimum((at / step).astype(np.int64), len(u) - 2)
    rest = (at / step - i)[..., None]
    row: AnyArray = np.arange(len(axis))[:, None]
    return np.asarray(axis[row, i] * (1 - rest) + axis[row, i + 1] * rest)
