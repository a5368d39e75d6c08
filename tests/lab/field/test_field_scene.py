"""Rays meet the sheets where they are painted, and the boat sees cones and markers."""

from typing import Any

import numpy as np

from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import standing
from thalweg_lab.yard import Field, FieldScene
from thalweg_lab.yard.layout import covers


def small(**field: Any) -> TwinConfig:
    """The small field with changes in its section."""
    return TwinConfig.of_size("field_tiny", field=field)


def sheet_uv(field: Field, points_wcs_m: Any, things: Any, names: tuple[str, ...]) -> tuple[Any, Any]:
    """Printed id (n,) and modules (n, 2) of the sheets that rays have met; -1 and NaN where none."""
    marker = np.full(len(points_wcs_m), -1, dtype=np.int64)
    modules = np.full((len(points_wcs_m), 2), np.nan)
    order = np.argsort(things, kind="stable")
    first = np.searchsorted(np.asarray(things)[order], np.arange(len(names) + 1))
    number = {name: i for i, name in enumerate(names)}
    for sheet in field.sheets:
        i = number.get(sheet.thing)
        rows = order[first[i] : first[i + 1]] if i is not None else order[:0]
        if not len(rows):
            continue
        middle = sheet.to_wcs([[5.0, 5.0]])[0]
        near = np.abs(points_wcs_m[rows] - middle).max(axis=1) < 1.5 * sheet.half_side_m
        rows = rows[near]
        uv = sheet.to_modules(points_wcs_m[rows])
        # A sheet is on the front of its board only, and on a cone the other side unrolls elsewhere.
        back = np.linalg.norm(sheet.to_wcs(uv) - points_wcs_m[rows], axis=1) > 2e-3
        on = covers(uv) & ~back
        marker[rows[on]], modules[rows[on]] = sheet.marker, uv[on]
    return marker, modules


def looked_at(field: Field, yard: FieldScene, eye: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, ...]:
    """Markers and modules that rays from an eye to points meet, and how far before them they end."""
    way = points - eye
    distance = np.linalg.norm(way, axis=1)
    ray = way / distance[:, None]
    hits = yard.scene.caster().cast(np.broadcast_to(eye, points.shape), ray)
    met = eye + np.where(np.isfinite(hits.t_hit_m), hits.t_hit_m, 0.0)[:, None] * ray
    marker, modules = sheet_uv(
        field, met, np.where(hits.primitive >= 0, yard.things[hits.primitive], -1), yard.names
    )
    return marker, modules, distance - hits.t_hit_m


def test_rays_meet_each_sheet_at_its_modules(field, yard):
    modules = np.random.default_rng(1).uniform(-0.4, 10.4, (40, 2))
    seen = 0
    for sheet in field.sheets:
        points = sheet.to_wcs(modules)
        # From 0.4 m before it; under the lowest cones the ground is nearer than that.
        eye = sheet.centre_wcs_m() + 0.4 * sheet.normal_wcs()
        if eye[2] < 0.02:
            continue
        marker, found, short = looked_at(field, yard, eye, points)
        free = np.abs(short) < 1e-4
        assert (marker[free] == sheet.marker).all()
        # Chords lie up to 0.008 mm inside the cone, float32 of the ray caster steps by 0.0005 mm.
        np.testing.assert_allclose(found[free], modules[free], atol=5e-3)
        seen += int(free.all())
    assert seen > 0.9 * len(field.sheets)


def test_the_boat_sees_cones_and_enough_markers_to_port(field, yard):
    for number in (1, 2, 3):
        boat = standing(small(), number).T_wcs_ics
        camera = boat.apply(np.array([[-0.25, -0.1, -0.18]]))[0]
        port = boat.R @ np.array([0.0, -1.0, 0.0])
        seen = set()
        for sheet in field.sheets:
            points = sheet.saddles_wcs_m()
            short = looked_at(field, yard, camera, points)[2]
            way = points - camera
            ahead = way @ port / np.linalg.norm(way, axis=1)
            # The lens of P2 looks 31 degrees to each side; a print is read up to 70 degrees off its normal.
            slant = -(way @ sheet.normal_wcs()) / np.linalg.norm(way, axis=1)
            if (
                (ahead > np.cos(np.deg2rad(29))).all()
                and (slant > 0.34).all()
                and (np.abs(short) < 1e-3).all()
            ):
                seen.add(sheet.marker)
        side = {1: "C1 C2 C3", 2: "C4 C5 C6", 3: "C1 C2 C3"}[number].split()
        for name in side:
            assert len(seen & set(field.cone(name).markers)) >= 3, (number, name)
        assert len(seen) >= 14
