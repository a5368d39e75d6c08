"""The images: geometry, what moves and what does not, effects, files."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.lab.conftest import FRAME
from tests.lab.time_lapse.conftest import CONFIG, MOUNTS, SEED, settings
from thalweg.ingest.photos import read_image_stamps
from thalweg_lab.time_lapse import draw_images, simulate_time_lapse
from thalweg_lab.voyage import read_true_mounts, start_gps_s, write_true_mounts

FIRST = 5
"""An image of the tests."""


@pytest.fixture(scope="module")
def images(reach):
    return [reach.recording.render_image(k) for k in (FIRST, FIRST + 1)]


SMALL = {"size_px": (240, 180), "n_targets": 0}


@pytest.fixture(scope="module")
def small(reach):
    """The same view in a quarter of the pixels, without boards."""
    return reach.other(**SMALL)


def land_of(recording, k):
    """(h, w) pixels whose middle meets land, without the own boat."""
    renderer, shot = recording.renderer, recording.plan.shots[k]
    rays = renderer.lens.rays_ccs.reshape(-1, 3) @ shot.T_wcs_ccs.R.T.astype(np.float32)
    eye = shot.T_wcs_ccs.shift_m
    hits = renderer.world.caster.cast(eye, rays)
    up = eye[2] + np.where(np.isfinite(hits.t_hit_m), hits.t_hit_m, 0.0) * rays[:, 2]
    land = (np.isfinite(hits.t_hit_m) & (up > renderer.world.level_m)).reshape(
        renderer.lens.rays_ccs.shape[:2]
    )
    return land & (renderer.boat.share == 0) if renderer.boat else land


def test_crossings_of_the_boards_are_where_lens_and_pose_say(reach):
    recording = reach.recording
    targets, camera = recording.targets, recording.plan.camera
    shown = []
    for shot in recording.plan.shots:
        way = targets.centre_wcs_m - shot.T_wcs_ccs.shift_m
        range_m = np.linalg.norm(way, axis=1)
        facing = -np.sum(way * targets.normal_wcs, axis=1) / range_m
        at = camera.project(shot.T_wcs_ccs.inverse().apply(targets.centre_wcs_m))
        large = camera.parameters[0] * targets.size_m * facing / range_m > 12.0
        shown.append(at[camera.inside(at, 15.0) & large & (facing > 0.5) & (at[:, 1] < 250)])
    off = []
    for k in np.argsort([-len(at) for at in shown])[:2].tolist():
        grey = cv2.cvtColor(recording.render_image(k), cv2.COLOR_RGB2GRAY)
        for place in shown[k]:
            start = np.array([[place - 0.5]], dtype=np.float32)
            criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
            found = cv2.cornerSubPix(grey, start.copy(), (3, 3), (-1, -1), criteria)[0, 0] + 0.5
            off.append(found - place)
    assert len(off) >= 5
    # Single boards may be hidden in an image, so the median; noise of 1.6 steps of 150 leaves 0.02 px.
    assert np.median(np.abs(off), axis=0).max() < 0.12
    assert np.abs(np.median(off, axis=0)).max() < 0.08


def test_water_moves_and_the_boat_covers_the_lower_edge(small):
    land, full, boat = land_of(small, FIRST), small.light(FIRST), small.renderer.boat
    h = land.shape[0]
    # The float covers part of the lower edge, and nothing above the middle.
    assert 0.3 < boat.full[-1].mean() < 1.0
    assert not boat.share[: h // 2].any()
    # The water of another moment is another one, the land is not.
    shot = small.plan.shots[FIRST]
    R = small.voyage.R_wcs_ics(np.array([shot.t_gps_s]))[0]
    later = small.renderer.see(shot.T_wcs_ccs, R, t_s=shot.since_s + 1.0, grain=FIRST + 1)
    inner = cv2.erode(land.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    assert np.mean(np.any(later[inner] != full[inner], axis=1)) < 0.01
    water = np.zeros_like(land)
    water[h // 2 + 20 : int(0.8 * h)] = True
    rest = ~land & (boat.share == 0)
    assert np.mean(np.abs(later - full).max(axis=2)[water & rest] > 0.01) > 0.3


def test_files_carry_their_stamps_as_the_reader_expects(reach, tmp_path):
    recording = reach.other(size_px=(160, 120), n_targets=0)
    names = [recording.write_image(k, tmp_path) for k in (0, 1)]
    for source in ("name", "exif"):
        table = read_image_stamps(tmp_path, source=source).table.set_index("file")  # type: ignore[arg-type]
        for name, shot in zip(names, recording.plan.shots, strict=False):
            row = table.loc[name]
            assert (row["width"], row["height"]) == (160, 120)
            # 28 mm on full frame: 14 mm on this sensor, as P2's camera.
            assert row["focal_mm"] == pytest.approx(14.0, abs=0.1)
            ahead = recording.config.camera.clock_offset_s
            error = row["t_device_s"] - start_gps_s(recording.config) - shot.since_s - ahead
            # Jitter of 23 ms, five sigma; drift of 12 ppm over 8 s and milliseconds are nothing beside it.
            assert abs(error) < 5 * recording.config.camera.jitter_s + 0.001


def test_images_in_parts_are_those_of_one_job(reach, tmp_path):
    """Three images in two jobs, byte by byte, with everything that is written beside them."""
    how = (CONFIG, settings(**SMALL, share=0.06), SEED, FRAME, reach.path)
    mounts = tmp_path / "mounts.json"
    write_true_mounts(mounts, MOUNTS, MOUNTS)
    drawn = [tmp_path / f"part_{k}" for k in range(2)]
    for k, folder in enumerate(drawn):
        draw_images(*how, mounts, folder, part=k, parts=2)
    assert [len(list(folder.iterdir())) for folder in drawn] == [2, 1]

    def written(name: str, parts: list[Path]) -> dict[str, bytes]:
        """All files of a recording, by the folder that it was told."""
        folder = tmp_path / name
        n = simulate_time_lapse(
            *how, read_true_mounts(mounts), folder / "images", folder / "points.csv",
            out_poses=folder / "poses.parquet", out_truth=folder / "truth.json", drawn=parts,
        )  # fmt: skip
        assert n == 3
        return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}

    whole = written("whole", [])
    assert len(whole) == 3 + 3
    assert written("joined", drawn) == whole
