"""Rays meet the sheets where they are painted, and the boat sees cones and markers."""

import numpy as np

from tests.lab.field.conftest import small
from thalweg_lab.voyage import standing
from thalweg_lab.yard.layout import covers


def looked_at(yard, eye, points):
    """Numbers of the things that rays from an eye to points meet, where, and how far before the points."""
    way = points - eye
    distance = np.linalg.norm(way, axis=1)
    ray = way / distance[:, None]
    hits = yard.scene.caster().cast(np.broadcast_to(eye, points.shape), ray)
    met = eye + np.where(np.isfinite(hits.t_hit_m), hits.t_hit_m, 0.0)[:, None] * ray
    return np.where(hits.primitive >= 0, yard.things[hits.primitive], -1), met, distance - hits.t_hit_m


def test_rays_meet_each_sheet_at_its_modules(field, yard):
    modules = np.random.default_rng(1).uniform(-0.4, 10.4, (40, 2))
    seen = 0
    for sheet in field.sheets:
        points = sheet.to_wcs(modules)
        # From 0.4 m before it; under the lowest cones the ground is nearer than that.
        eye = sheet.centre_wcs_m() + 0.4 * sheet.normal_wcs()
        if eye[2] < 0.02:
            continue
        things, met, short = looked_at(yard, eye, points)
        free = np.abs(short) < 1e-4
        assert {yard.names[k] for k in things[free]} <= {sheet.thing}
        found = sheet.to_modules(met[free])
        # Chords lie up to 0.008 mm inside the cone, float32 of the ray caster steps by 0.0005 mm.
        np.testing.assert_allclose(found, modules[free], atol=5e-3)
        assert covers(found).all()
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
            short = looked_at(yard, camera, points)[2]
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
