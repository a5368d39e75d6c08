"""The recordings of a basin and of the boat: camera station, grid, panels, scans, a strip of the river bed.

The sensor of the campaign is that of P4, built with the tolerances of its making (`forward.true_sensor`). Its
design, with the camera's interior orientation as a calibration in air gives it, is what the processing starts
from.

**Strip.** The boat is that of the survey, the sensor that of the basin in which it was calibrated; it sits on
the boat at its true mount. A river is deeper than the sensor sees where the twin's boat sails, so a shallow
bed of its own is laid under a piece of its way, as level as the way is.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from thalweg.calibration.field import FieldPoints, write_points
from thalweg.core import AnyArray, ArrayF, ArrayI, ConfigError, GeometryError, LocalFrame, Rigid, rotation_opk
from thalweg.core.calibration import Source
from thalweg.core.geometry import TriangleMesh, write_mesh
from thalweg.lightsheet.optics import CAMERA, LASER, LENS, WINDOW, Sensor, paper_4, write_sensor
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import SheetImage, TwinConfig, TwinLightSheet, TwinSheetStrip
from thalweg_lab.tank.forward import in_water_of, sized, true_sensor
from thalweg_lab.tank.glow import on_sheet
from thalweg_lab.tank.motion import Tripod, build_panel, set_up
from thalweg_lab.tank.objects import (
    SIGMA_MARK_MM,
    SIGMA_PX,
    build_board,
    dry,
    observe_board,
    stepped_object,
    wreck,
)
from thalweg_lab.tank.plan import Plan, boat_path, calibration_plan, panel_plan, scan_plan, strip_plan
from thalweg_lab.tank.record import image_name, record, trigger, write_image, write_poses, write_pulses
from thalweg_lab.tank.render import Darkroom, render_sheet_image
from thalweg_lab.tank.surfaces import Surface, Texture
from thalweg_lab.voyage import Motion, Voyage, start_gps_s, true_mounts

OBJECTS: Final = ("stepped", "wreck")
"""What is scanned."""

SIGMA_FOCAL_MM: Final = 0.004
"""Of the interior orientation by a bundle in air (P4 6.2); the principal point as well as that."""

_LASER_SIGMAS: Final = (3.0, 3.0, 3.0, 0.8, 0.8, 0.8)
_WINDOW_SIGMAS: Final = (0.05, 0.005, 0.001, 0.0, 0.0)
"""How well laser, glass and water are known beforehand: mm and degrees; mm, 1, 1."""

WINDOW_MARKERS: Final = (201, 202, 203, 204)
"""Markers on the outer face of the window."""

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


GROUND: Final = {"stepped": 1, "wreck": 0}
"""Material of the ground, which was not there when the object was scanned for its reference."""

TURN_RADIUS_M: Final = 0.5
"""A turn of one radian a second counts as much as so many metres a second when a quiet piece is chosen."""

AHEAD_MM: Final = 100.0
"""Of bed before the first line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Basin:
    """A true sensor in its water, the light of its images, and the design that a user has of it."""

    true: Sensor
    design: Sensor
    image: SheetImage
    seed: int
    settings: TwinLightSheet

    @classmethod
    def of(cls, twin: TwinConfig, seed: int) -> "Basin":
        """The basin of a campaign."""
        settings = twin.light_sheet or TwinLightSheet()
        nominal, image = sized(paper_4(), settings.image, settings.size)
        true = in_water_of(true_sensor(nominal, seed), settings.temperature_c, image.laser.wavelength_nm)
        design = _design(nominal, true, seed)
        return cls(true=true, design=design, image=image, seed=seed, settings=settings)


def record_camera_station(
    twin: TwinConfig, seed: int, *, out_sensor: Path, out_marks: Path, out_points: Path
) -> None:
    """The design, and marks on object and window as the sensor's own camera sees them through air (P4 4.3).

    The places of the marks come from a bundle with scale bars, in a frame of its own.

    Parameters
    ----------
    twin, seed : of the campaign.
    out_sensor, out_marks, out_points : design (YAML), marks in the image and points (CSV).
    """
    basin = Basin.of(twin, seed)
    source = Source(run="digital twin", method="drawing, and lens calibrated in air", twin=True)
    out_sensor.parent.mkdir(parents=True, exist_ok=True)
    write_sensor(out_sensor, basin.design, source=source, title="Light-sheet sensor as designed")
    board = build_board(basin.true, basin.seed)
    marker, xy = observe_board(dry(basin.true), board, basin.seed, name="camera station")
    table = pd.DataFrame(
        {
            "file": "camera_station.png",
            "marker": marker,
            "corner": 0,
            "x_px": xy[:, 0],
            "y_px": xy[:, 1],
            "sigma_px": SIGMA_PX,
        }
    )
    table.to_csv(out_marks, index=False, float_format="%.5f")
    rng = generator(basin.seed, "light sheet camera station frame")
    R = rotation_opk(*(float(a) for a in rng.uniform(-3.0, 3.0, 3)))
    window = _window_marks(basin, SIGMA_MARK_MM * rng.standard_normal((len(WINDOW_MARKERS) * 4, 3)))
    places = np.concatenate([board.measured_lcs_mm, window])
    names = [(int(m), 0) for m in board.marker]
    names += [(m, corner) for m in WINDOW_MARKERS for corner in range(4)]
    points = FieldPoints(
        points=tuple(names),
        points_pcs=1e-3 * places @ R.T + rng.uniform(-1.0, 1.0, 3),
        cov=np.eye(3 * len(names)) * (1e-3 * SIGMA_MARK_MM) ** 2,
    )
    write_points(out_points, points)


def record_series(
    twin: TwinConfig, seed: int, series: str, frame: LocalFrame, folder: Path, truth: Path
) -> None:
    """Render and write one series.

    Parameters
    ----------
    twin, seed, frame : of the campaign.
    series : ``calibration``, ``panels``, or one of `OBJECTS`.
    folder, truth : see `thalweg_lab.tank.record`.

    Raises
    ------
    ConfigError : another series.
    """
    basin = Basin.of(twin, seed)
    record(
        _plan(basin, series),
        basin.true,
        _exposed(basin, series),
        seed,
        folder,
        truth,
        frame,
        start_gps_s=start_gps_s(twin),
        six_dof=series in OBJECTS,
    )


def scanned_object(name: str, seed: int) -> Surface:
    """The object of a scan, one of `OBJECTS`, in its own frame."""
    return stepped_object() if name == "stepped" else replace(wreck(seed), name="wreck")


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


def picked_pairs(mesh: TriangleMesh, tripod: Tripod, seed: int, name: str, *, n: int = 5) -> pd.DataFrame:
    """Places that an operator picked in the scan (frame of the standing camera) and in the mesh, metres.

    Parameters
    ----------
    mesh : the reference, in the frame of the object.
    tripod : the standing camera, whose frame is that of the scan.
    seed, name : of the campaign and of the scan; the stream is ``light sheet <name> picks``.
    n : number of pairs.
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
    in_scan = in_scan + PICK_SIGMA_MM * 1e-3 * rng.standard_normal(in_scan.shape)
    return pd.DataFrame(
        {
            f"{where}_{a}_m": xyz[:, i]
            for where, xyz in (("scan", in_scan), ("mesh", on_mesh))
            for i, a in enumerate("xyz")
        }
    )


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


def record_strip(
    twin: TwinConfig,
    settings: TwinSheetStrip,
    seed: int,
    frame: LocalFrame,
    *,
    basin: Basin,
    mount: Mapping[str, Any],
    folder: Path,
    truth: Path,
) -> None:
    """Render and write the strip ::

        <folder>/images/sheet_*.png   images, named by the camera's own clock
        <folder>/trigger_pulses.csv   GPS times of the pulses
        <truth>/                      poses in the frame of the strip, sensor, mount, bed.ply in wcs

    Parameters
    ----------
    twin, settings, seed, frame : of the survey campaign.
    basin : of the campaign that calibrated the sensor.
    mount : section ``light_sheet.mount`` of the survey; the true one is drawn around it.
    folder, truth : of logs and truth.
    """
    true = true_mounts({"light_sheet": mount}, seed, on=twin.effects.mount_errors)["light_sheet"]
    motion, place = Voyage(twin, seed), Rigid.from_mount(true)
    planned = np.arange(settings.lines) / settings.rate_hz
    begin = quiet_begin_s(motion, twin, float(planned[-1]))
    shots = trigger(
        seed, planned, start_gps_s(twin) + begin, name="strip", rate_hz=settings.rate_hz, jitter_s=0.001
    )
    plan, R_strip, origin = _strip_plan(motion, place, basin, settings, seed, shots.t_gps_s)
    names = [image_name(int(us)) for us in shots.stamp_us]
    room = Darkroom.of(basin.true, basin.image, generator(seed, "light sheet strip speckle tile"))
    for k, name in enumerate(names):
        rng = generator(seed, f"light sheet strip image {k}")
        image = render_sheet_image(basin.true, plan.scene(k), basin.image, rng, darkroom=room)
        write_image(folder / "images" / name, image)
    write_pulses(folder / "trigger_pulses.csv", shots.pulse_gps_s)
    truth.mkdir(parents=True, exist_ok=True)
    write_poses(truth / "poses.parquet", names, plan.seen, shots.t_gps_s, plan.path)
    source = Source(run="digital twin", method="truth", twin=True)
    write_sensor(truth / "sensor.yaml", basin.true, source=source)
    bed = next(iter(plan.surfaces.values()))
    vertices = 1e-3 * bed.vertices_mm @ R_strip.T + origin
    mesh = TriangleMesh(vertices_m=vertices, faces=bed.faces, sigma_m=np.zeros(len(vertices)))
    write_mesh(truth / "bed.ply", mesh, frame, {"object": "true bed of the strip", "note": "frame wcs"})
    speed = np.linalg.norm(motion.velocity_wcs_mps(shots.t_gps_s), axis=1)
    facts = {
        "begin_s": begin,
        "speed_mps": float(speed.mean()),
        "mount": true,
        "step_mm": float(1e3 * speed.mean() / settings.rate_hz),
    }
    (truth / "strip.json").write_text(json.dumps(facts, indent=2) + "\n")


def quiet_begin_s(motion: Motion, twin: TwinConfig, length_s: float) -> float:
    """Seconds after the start at which the boat is slowest and turns least for some time."""
    t = np.arange(2.0, max(twin.duration_s - length_s - 3.0, 2.1), 0.1)
    at = start_gps_s(twin) + t + length_s / 2
    speed = np.linalg.norm(motion.velocity_wcs_mps(at), axis=1)
    turn = np.linalg.norm(motion.rates_ics_radps(at), axis=1)
    return float(t[int(np.argmin(speed + TURN_RADIUS_M * turn))])


def _design(nominal: Sensor, true: Sensor, seed: int) -> Sensor:
    """Drawing of the sensor with the lens of a calibration in air, and the sigmas of both.

    The indices of water and glass are those of a table, which differ from the true ones within their sigmas.
    """
    focal_px = SIGMA_FOCAL_MM / 0.0055 * true.camera.size_px[0] / 2048
    error = generator(seed, "light sheet lens calibration").standard_normal(3)
    sigma = np.zeros(26)
    sigma[LENS][:4] = focal_px
    sigma[LASER], sigma[WINDOW] = _LASER_SIGMAS, _WINDOW_SIGMAS
    sigma[CAMERA] = (0.0, 0.0, 0.5, 0.3, 0.3, 0.3)
    for part in (CAMERA, LASER):
        sigma[part][3:] = np.deg2rad(sigma[part][3:])
    cov = np.diag(np.square(sigma))
    at = LENS.start
    # one principal distance; square pixels are known to a hundredth of its sigma
    cov[at, at + 1] = cov[at + 1, at] = 0.9999 * focal_px**2
    x = nominal.vector()
    lens = true.camera.parameters.copy()
    lens[:2] += focal_px * error[0]
    lens[2:4] += focal_px * error[1:]
    x[LENS] = lens
    indices = slice(WINDOW.start + 1, WINDOW.start + 3)
    media = generator(seed, "light sheet media").standard_normal(2)
    x[indices] = true.vector()[indices] + sigma[indices] * media
    return nominal.with_vector(x, cov=cov)


def _window_marks(basin: Basin, error_mm: ArrayF) -> ArrayF:
    """Corners (16, 3) of four markers on the window's outer face, lcs."""
    centres = np.array([[-60.0, -120.0], [60.0, -120.0], [60.0, 20.0], [-60.0, 20.0]])
    corners = 5.0 * np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
    xy = (centres[:, None] + corners).reshape(-1, 2)
    flat = np.column_stack([xy, np.full(len(xy), -basin.true.window.thickness_mm)])
    return flat @ basin.true.window.R_lcs_window.T + error_mm


def _exposed(basin: Basin, series: str) -> SheetImage:
    """Light of the images of a series; the black object is exposed longer, in the dark."""
    if series != "stepped":
        return basin.image
    chip, times = basin.image.chip, basin.settings.black_exposure
    longer = {"peak_dn": times * chip.peak_dn, "ambient_dn": 0.0}
    return basin.image.model_copy(update={"chip": chip.model_copy(update=longer)})


def _plan(basin: Basin, series: str) -> Plan:
    settings = basin.settings
    if series == "calibration":
        return calibration_plan(basin.true, basin.seed, positions=1, depths_mm=settings.levels_mm)
    if series == "panels":
        return panel_plan(basin.true, depths_mm=settings.panels_mm)
    if series not in OBJECTS:
        raise ConfigError(f"series '{series}'", expected=f"calibration, panels, {', '.join(OBJECTS)}")
    return scan_plan(
        basin.true,
        basin.seed,
        scanned_object(series, basin.seed),
        lines=settings.scan_lines,
        step_mm=settings.scan_step_mm,
    )


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


def _strip_plan(
    motion: Motion, place: Rigid, basin: Basin, settings: TwinSheetStrip, seed: int, t_gps_s: ArrayF
) -> tuple[Plan, ArrayF, ArrayF]:
    """The plan, and rotation (3, 3) and origin (3,) of the strip's frame in wcs."""
    R = motion.R_wcs_ics(t_gps_s) @ place.R
    x = motion.sensor_wcs_m(t_gps_s, place.shift_m)
    line = 1e-3 * on_sheet(basin.true, basin.true.sheet, 1e3 * settings.depth_m)[0]
    first, last = (R[k] @ line + x[k] for k in (0, -1))
    way = last - first
    kappa = float(np.arctan2(-way[0], way[1]))
    R_strip = rotation_opk(0.0, 0.0, kappa)
    origin = (first + last) / 2 - R_strip @ [0.0, float(np.hypot(way[0], way[1])) / 2 + 1e-3 * AHEAD_MM, 0.0]
    path = boat_path(R, x, t_gps_s, origin, kappa)
    return strip_plan(basin.true, seed, path=path, step_mm=settings.step_mm), R_strip, origin
