"""A scan of an object with what comes with it: images, panel, standing camera, reference, picked pairs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from thalweg.core.errors import GeometryError
from thalweg.core.frames import LocalFrame
from thalweg.core.geometry.mesh import TriangleMesh
from thalweg.core.geometry.mesh_ply import write_mesh
from thalweg.core.types import AnyArray, ArrayF, ArrayI
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import generator
from thalweg_lab.tank.plan import scan_plan
from thalweg_lab.tank.series import Basin, record_series, scanned_object
from thalweg_lab.tank.six_dof import Tripod, build_panel, set_up
from thalweg_lab.tank.surfaces import Surface, Texture

# ---------------------------------------------------------------- the reference scan of an object, as a
# structured-light scanner gives it: fine, noisy, with holes (P4 7.1)
#
# A comparison with the exact mesh would flatter a scan: nothing would ever lie on a border, and the reference
# would have no error. Here the faces of the object are divided until they are as fine as the scanner's mesh
# (0.1 mm), each corner is moved along the surface normal (0.02 mm), and the places of the scanner's own
# markers stay open.


RESOLUTION_MM: Final = 0.1
SIGMA_MM: Final = 0.02
"""Of the reference scan (P4 7.1)."""

PICK_SIGMA_MM: Final = 1.5
"""How well an operator finds the same place in a scan and in the mesh."""

_MOST_FACES: Final = 20_000_000
_ROUNDS: Final = 16


def reference_mesh(
    surface: Surface,
    seed: int,
    *,
    resolution_mm: float = RESOLUTION_MM,
    sigma_mm: float = SIGMA_MM,
    holes: int = 12,
    hole_radius_mm: float = 2.5,
    without: Sequence[int] = (),
) -> TriangleMesh:
    """The mesh of an object as a scanner measures it, in the frame of the object, metres.

    Parameters
    ----------
    surface : the true object.
    seed : of the campaign; the streams are ``light sheet reference <surface> ...``.
    resolution_mm : longest edge.
    sigma_mm : standard deviation of a corner along the normal: half of its variance is white, half is waves
        of 5 to 30 mm, as the matching of single views leaves them.
    holes, hole_radius_mm : open places where the scanner's markers were.
    without : materials that were not there when the object was scanned, such as the ground.

    Raises
    ------
    GeometryError : no face is left, or more than 20 million faces.
    """
    faces = surface.faces[~np.isin(surface.material, np.asarray(without, dtype=np.int64))]
    if not len(faces):
        raise GeometryError("no face without these materials", expected="an object", where=surface.name)
    vertices, faces = divided(surface.vertices_mm, faces, resolution_mm)
    noise = generator(seed, f"light sheet reference {surface.name} noise")
    at = generator(seed, f"light sheet reference {surface.name} holes")
    white = noise.standard_normal(len(vertices))
    wave = Texture.draw(noise, strength=1.0, lengths_mm=(5.0, 30.0))
    smooth = np.cos(vertices @ wave.waves.T + wave.phases).sum(axis=1) / np.sqrt(len(wave.phases) / 2)
    moved = vertices + (sigma_mm * np.sqrt(0.5) * (white + smooth))[:, None] * _normals(vertices, faces)
    if holes:
        middle = vertices[faces].mean(axis=1)
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        centres = middle[at.choice(len(faces), holes, replace=False, p=area / area.sum())]
        faces = faces[cKDTree(centres).query(middle)[0] > hole_radius_mm]
    mesh = TriangleMesh(vertices_m=moved * 1e-3, faces=faces, sigma_m=np.full(len(moved), sigma_mm * 1e-3))
    return mesh.part(np.ones(len(faces), dtype=np.bool_))


def write_reference(path: Path, mesh: TriangleMesh, surface: Surface, frame: LocalFrame) -> None:
    """Write the reference of an object, PLY in its own frame, metres."""
    write_mesh(path, mesh, frame, {"object": surface.name, "note": "frame of the object; reference scan"})


def divided(vertices_mm: ArrayF, faces: ArrayI, longest_mm: float) -> tuple[ArrayF, ArrayI]:
    """The same surface with no edge longer than ``longest_mm``; neighbours stay joined.

    Long edges are halved, in all faces that have them; a face with one, two or three halved edges becomes
    two, three or four.

    Raises
    ------
    GeometryError : more than 20 million faces would be needed.
    """
    v, f = np.asarray(vertices_mm, dtype=np.float64), np.asarray(faces, dtype=np.int64)
    a, b, c = (v[f[:, k]] for k in range(3))
    area_mm2 = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
    # no triangle with such edges is larger than an equilateral one
    least = area_mm2 / (0.25 * np.sqrt(3.0) * longest_mm**2)
    if least > _MOST_FACES:
        raise GeometryError(
            f"{least / 1e6:.0f} million faces and more with edges of {longest_mm:g} mm",
            expected=f"at most {_MOST_FACES / 1e6:.0f} million: a coarser reference or a smaller object",
            where="reference mesh",
        )
    done: list[ArrayI] = []
    for _ in range(_ROUNDS):
        ends = np.sort(f[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        long = np.linalg.norm(v[ends[:, 0]] - v[ends[:, 1]], axis=1) > longest_mm
        # short edges stay as they are: faces that have no other need not be looked at again
        open_ = long.reshape(-1, 3).any(axis=1)
        done.append(f[~open_])
        if not open_.any():
            break
        f, ends, long = f[open_], ends[np.repeat(open_, 3)], long[np.repeat(open_, 3)]
        halves, back = np.unique(ends[long, 0] * len(v) + ends[long, 1], return_inverse=True)
        number = np.full(len(ends), -1, dtype=np.int64)
        number[long] = len(v) + back
        v, f = (
            np.concatenate([v, (v[halves // len(v)] + v[halves % len(v)]) / 2]),
            _split(f, number.reshape(-1, 3)),
        )
    return v, np.concatenate(done)


def _split(f: ArrayI, middle: ArrayI) -> ArrayI:
    """Faces after their edges were halved; ``middle`` (m, 3) new corner of each edge or -1."""
    out: list[AnyArray] = [f[(middle < 0).all(axis=1)]]
    count = (middle >= 0).sum(axis=1)
    for n in (1, 2, 3):
        own = count == n
        a, m = f[own], middle[own]
        if n < 3 and len(a):
            # turned so that the first edge is halved and, with two, the last one is not
            odd = np.argmax(m >= 0, axis=1) if n == 1 else (np.argmax(m < 0, axis=1) + 1) % 3
            turn = (odd[:, None] + np.arange(3)) % 3
            a, m = np.take_along_axis(a, turn, axis=1), np.take_along_axis(m, turn, axis=1)
        i, j, k = a.T
        p, q, r = m.T
        triples = {
            1: [(i, p, k), (p, j, k)],
            2: [(p, j, q), (i, p, q), (i, q, k)],
            3: [(i, p, r), (p, j, q), (r, q, k), (p, q, r)],
        }[n]
        out += [np.stack(t, axis=1) for t in triples]
    return np.concatenate(out).astype(np.int64)


def _normals(vertices: ArrayF, faces: ArrayI) -> ArrayF:
    """Unit normals (n, 3) of corners: the sum of the normals of their faces by area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    out = np.stack(
        [np.bincount(faces.ravel(), np.repeat(normal[:, i], 3), len(vertices)) for i in range(3)], axis=1
    )
    return np.asarray(out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-30))


def picked_pairs(
    mesh: TriangleMesh, tripod: Tripod, seed: int, name: str, *, n: int = 5, sigma_mm: float = PICK_SIGMA_MM
) -> pd.DataFrame:
    """Places that an operator picked in the scan (frame of the standing camera) and in the mesh, metres.

    Parameters
    ----------
    mesh : the reference, in the frame of the object.
    tripod : the standing camera, whose frame is that of the scan.
    seed, name : of the campaign and of the scan; the stream is ``light sheet <name> picks``.
    n : number of pairs.
    sigma_mm : of a picked place, each axis.
    """
    rng = generator(seed, f"light sheet {name} picks")
    v = mesh.vertices_m
    chosen = [int(rng.integers(len(v)))]
    # each next one as far as possible from those before, among a few hundred
    some = v[rng.choice(len(v), min(400, len(v)), replace=False)]
    places = [v[chosen[0]]]
    for _ in range(n - 1):
        away = np.min([np.linalg.norm(some - p, axis=1) for p in places], axis=0)
        places.append(some[int(np.argmax(away))])
    on_mesh = np.array(places)
    in_scan = on_mesh @ tripod.R_ccs_obj.T + tripod.shift_ccs_mm * 1e-3
    in_scan = in_scan + sigma_mm * 1e-3 * rng.standard_normal(in_scan.shape)
    return pd.DataFrame(
        {f"{where}_{a}_m": xyz[:, i] for where, xyz in (("scan", in_scan), ("mesh", on_mesh))
         for i, a in enumerate("xyz")}
    )  # fmt: skip


# ---------------------------------------------------------------- scan series


GROUND: Final = {"stepped": 1, "wreck": 0}
"""Material of the ground, which was not there when the object was scanned for its reference."""


def record_scan(twin: TwinConfig, seed: int, name: str, frame: LocalFrame, folder: Path, truth: Path) -> None:
    """Render and write a scan, see `thalweg_lab.tank.record`, and beside it ::

        <folder>/reference.ply   mesh of the object as a structured-light scanner gives it
        <folder>/pairs.csv       places that an operator picked in scan and mesh

    Parameters
    ----------
    twin, seed, frame : of the campaign.
    name : one of `thalweg_lab.tank.series.OBJECTS`.
    folder, truth : of logs and truth.

    Raises
    ------
    ConfigError : another name.
    """
    record_series(twin, seed, name, frame, folder, truth)
    basin = Basin.of(twin, seed)
    surface = scanned_object(name, seed)
    settings = basin.settings
    mesh = reference_mesh(surface, seed, resolution_mm=settings.reference_mm, without=(GROUND[name],))
    write_reference(folder / "reference.ply", mesh, surface, frame)
    plan = scan_plan(basin.true, seed, surface, lines=settings.scan_lines, step_mm=settings.scan_step_mm)
    tripod = set_up(plan.path, build_panel(seed))
    pairs = picked_pairs(mesh, tripod, seed, plan.name, n=4)
    pairs.to_csv(folder / "pairs.csv", index=False, float_format="%.5f")
