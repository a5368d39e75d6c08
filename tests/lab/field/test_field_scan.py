"""Lidar points of the field: consistent noise, the right cones, the same in memory as in the capture file."""

from typing import Any

import numpy as np
import pytest

from thalweg.core import ConfigError, LocalFrame, rotation_opk
from thalweg.ingest.velodyne.reader import iter_points
from thalweg_lab.instruments import EchoKind
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import FieldRun, standing
from thalweg_lab.yard import build_field
from thalweg_lab.yard_records import Scan, simulate_positions, static_scan

SEED = 4
FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
R, LEVER = rotation_opk(0.01, -np.pi / 2 + 0.02, -0.015), np.array([-0.35, 0.02, -0.25])
MOUNT: dict[str, Any] = {"R_ics_scs": R, "lever_ics_scs_m": LEVER}
QUIET = {"sigma_range_m": 0.0, "sigma_lateral_m": 0.0, "sigma_weak_m": 0.0, "divergence_mrad": 0.0}


def twin(lidar: dict[str, Any] | None = None, **field: Any) -> TwinConfig:
    return TwinConfig.of_size("field_tiny", field=field, lidar=lidar or {})


def off_cones(config: TwinConfig, scan: Scan, number: int) -> list[np.ndarray]:
    """Distance of the points of each cone from its true surface."""
    points = standing(config, number).T_wcs_ics.apply(scan.points_scs_m @ R.T + LEVER)
    cones = build_field(config, SEED).cones
    return [cone.distance_m(points[scan.cone == i]) for i, cone in enumerate(cones)]


def test_without_noise_points_lie_on_their_cones():
    config = twin(QUIET)
    scan = static_scan(config, SEED, 1, revolutions=3, **MOUNT)
    assert (scan.kind == EchoKind.SURFACE).all()
    for off in off_cones(config, scan, 1)[:6]:
        # Ranges step by 2 mm, chords lie 0.008 mm inside.
        assert np.abs(off).max() < 1.02e-3
    t = scan.t_gps_s - standing(config, 1).start_gps_s
    assert (np.diff(t) > 0).all()
    assert 0 <= t[0] < t[-1] < 0.3


def test_each_position_sees_six_cones_of_eight_with_the_noise_of_the_settings():
    config = twin()
    for number in (1, 2, 3):
        scan = static_scan(config, SEED, number, revolutions=20, **MOUNT)
        off = off_cones(config, scan, number)
        counts = [len(d) for d in off]
        assert min(counts[:6]) > 700, (number, counts)
        assert counts[6:] == [0, 0]
        every = np.concatenate(off)
        # sigma of 17.3 mm in each direction; 20,000 points with some common error of each beam: 2 %.
        assert every.std() == pytest.approx(0.0173, rel=0.05)
        # A beam's offset sigma leaves a curved surface of radius r by sigma^2 / 2r: 0.5 to 1 mm here.
        assert abs(every.mean()) < 1.6e-3


def test_capture_files_hold_the_same_points(tmp_path):
    config = twin(position_s=0.4, effects={"passers_by": 4})
    paths = [tmp_path / f"position_{n}.pcap" for n in (1, 2, 3)]
    facts = simulate_positions(config, SEED, FRAME, paths, out_effects=tmp_path / "e.json", **MOUNT)
    assert [f["ghosts"] for f in facts] == [0, 0, 0]
    for number, path in ((1, paths[0]), (3, paths[2])):
        blocks = list(iter_points([path]))
        xyz = np.concatenate([b.xyz_scs_m for b in blocks])
        t = np.concatenate([b.t_gps_s for b in blocks])
        ring = np.concatenate([b.ring for b in blocks])
        scan = static_scan(config, SEED, number, near_cones_m=None, **MOUNT)
        # The capture holds whole packets only.
        n = len(t)
        assert 0 <= len(scan.ring) - n < 384
        np.testing.assert_array_equal(scan.ring[:n], ring)
        # Stamps are whole microseconds; azimuths are rounded by 0.005 degrees, 1.3 mm at the fence 14.6 m
        # away, and shots between or beyond them have up to twice that.
        np.testing.assert_allclose(scan.t_gps_s[:n], t, atol=1.2e-6)
        assert np.abs(scan.points_scs_m[:n] - xyz).max() < 4e-3
    again = [tmp_path / f"again_{n}.pcap" for n in (1, 2, 3)]
    simulate_positions(config, SEED, FRAME, again, **MOUNT)
    assert [p.read_bytes() for p in again] == [p.read_bytes() for p in paths]
    with pytest.raises(ConfigError, match="positions"):
        simulate_positions(config, SEED, FRAME, paths[:2], **MOUNT)


def test_the_run_sees_every_cone_from_many_sides(run_scan):
    config = twin().model_copy(update={"duration_s": 16.0})
    scan = run_scan(config, SEED, **MOUNT)
    run = FieldRun(config, SEED)
    places = run.position_wcs_m(scan.t_gps_s)
    points = places + np.einsum("nij,nj->ni", run.R_wcs_ics(scan.t_gps_s), scan.points_scs_m @ R.T + LEVER)
    for i, cone in enumerate(build_field(config, SEED).cones):
        on = scan.cone == i
        assert on.sum() > 500, cone.name
        off = cone.distance_m(points[on])
        assert off.std() == pytest.approx(0.0173, rel=0.2)
        # Seen from places some metres apart.
        assert np.linalg.norm(np.ptp(places[on], axis=0)) > 1.5, cone.name


def test_people_stand_in_the_scan():
    plain = static_scan(twin(), SEED, 1, revolutions=2, near_cones_m=None, **MOUNT)
    crowd = static_scan(twin(effects={"passers_by": 12}), SEED, 1, revolutions=2, near_cones_m=None, **MOUNT)
    assert (plain.cone >= 0).sum() > (crowd.cone >= 0).sum()
