"""Panoramas of a survey as files: places, projection tags, ranges of a cloud, files that have no place."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from thalweg.calibration import Rig
from thalweg.core import (
    Camera,
    CoverageError,
    InputError,
    LazWriter,
    LocalFrame,
    Rigid,
    Trajectory,
    gps_from_unix,
    read_table,
)
from thalweg.lidar import colour_cloud
from thalweg.lidar.cloud import EXTRA_DIMENSIONS
from thalweg.panorama import (
    PANORAMAS,
    cloud_ranges,
    fill_gaps,
    make_panoramas,
    pixels_of,
    place_rig_files,
    rig_photographs,
)
from thalweg.panorama.files import write_panorama
from thalweg.settings.sections import Colour, Panorama, Rig as RigSettings

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=200.0)
SIDE, FOCAL = 160, 47.7
START = pd.Timestamp("2021-05-12T08:31:00Z")
HALF_M = 3.0
"""A square room of this half width around the rig, without floor and ceiling; each wall has its colour."""
WALLS = {"east": (230, 120, 60), "north": (60, 200, 60), "west": (60, 60, 200), "south": (190, 190, 60)}
SETTINGS = RigSettings.model_validate(
    {
        "size_px": (2 * SIDE, SIDE),
        "front": {"box_px": (0, 0, SIDE, SIDE)},
        "back": {"box_px": (SIDE, 0, SIDE, SIDE), "turn_deg": 180},
        "mount": {"omega_deg": 90.0, "phi_deg": 0.0, "kappa_deg": 0.0},
        "times": {"utc_offset": "+02:00"},
        "clock": {"offset_s": 0.0, "sigma_offset_s": 0.01},
    }
)


def small_rig() -> Rig:
    R = np.diag([-1.0, 1.0, -1.0])
    cameras = {
        name: Camera(
            model="fisheye",
            size_px=(SIDE, SIDE),
            parameters=np.array([FOCAL, FOCAL, SIDE / 2, SIDE / 2, -0.03, 0.02, -0.009, 0.0006]),
            name=name,
        )
        for name in ("front", "back")
    }
    return Rig(cameras=cameras, T_back_front=Rigid(R=R, shift_m=[0.0, 0.0, -0.0194]), settings=SETTINGS)


def wall_colours(origin: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """Colours (n, 3) of the room from a place: walls on four sides, else sky or water."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ways = np.stack(
            [
                (sign * HALF_M - origin[axis]) / rays[:, axis]
                for axis, sign in ((0, 1), (1, 1), (0, -1), (1, -1))
            ]
        )
    ways[~(ways > 0)] = np.inf
    wall = ways.argmin(axis=0)
    way = np.where(np.isfinite(ways.min(axis=0)), ways.min(axis=0), 1e6)
    height = origin[2] + way * rays[:, 2]
    colour = np.array(list(WALLS.values()))[wall].astype(float)
    colour[height > 1.0], colour[height < -1.0] = (150, 180, 220), (60, 70, 60)
    return colour


def trajectory() -> Trajectory:
    """The boat stands in the middle of the room, its bow to the east."""
    t = gps_from_unix(START.timestamp() + np.arange(-5.0, 6.0), 0)
    n = len(t)
    return Trajectory(
        frame=FRAME,
        t_gps_s=np.asarray(t),
        position_wcs_m=np.zeros((n, 3)),
        quaternion_wcs_ics=np.tile([1.0, 0.0, 0.0, 0.0], (n, 1)),
        cov_pose_wcs=np.tile(1e-4 * np.eye(6), (n, 1, 1)),
        valid=np.ones(n, dtype=bool),
    )


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """Three files of the rig, one of them a copy, and the cloud of the walls."""
    folder = tmp_path_factory.mktemp("rig")
    rig = small_rig()
    front = Rigid.from_mount(SETTINGS.mount.model_dump())
    T = Rigid(R=np.diag([1.0, -1.0, -1.0]), shift_m=np.zeros(3)) @ front
    views = {}
    for name, place in rig.T_front_lens.items():
        pose = T @ place
        y, x = np.mgrid[0:SIDE, 0:SIDE] + 0.5
        rays = rig.cameras[name].rays(np.column_stack([x.ravel(), y.ravel()]))
        seen = rays[:, 2] > np.cos(np.deg2rad(101))
        colour = np.where(seen[:, None], wall_colours(pose.shift_m, np.nan_to_num(rays) @ pose.R.T), 0)
        views[name] = colour.reshape(SIDE, SIDE, 3).astype(np.uint8)
    picture = np.concatenate([views["front"], np.rot90(views["back"], 2)], axis=1)
    (folder / "rig").mkdir()
    for name in ("R20210512_103100000.jpg", "R20210512_103102500.jpg", "R20210512_103102500 (2).jpg"):
        Image.fromarray(picture).save(folder / "rig" / name, quality=95)
    along, up = (a.ravel() for a in np.meshgrid(np.arange(-3, 3, 0.03), np.arange(-1, 1, 0.03)))
    far = np.full(len(up), HALF_M)
    xyz = np.concatenate(
        [
            np.column_stack(each)
            for each in ((far, along, up), (along, far, up), (-far, along, up), (along, -far, up))
        ]
    )
    n = len(xyz)
    extra = {name: np.full(n, 0.01) for name in EXTRA_DIMENSIONS} | {"ring": np.arange(n) % 16}
    with LazWriter(folder / "points.laz", FRAME, extra_dimensions=EXTRA_DIMENSIONS) as writer:
        writer.append(
            xyz,
            t_gps_s=np.full(n, float(gps_from_unix(START.timestamp(), 0))),
            intensity=np.full(n, 100, np.uint16),
            return_number=np.ones(n, np.uint8),
            number_of_returns=np.ones(n, np.uint8),
            extra=extra,
        )
    return folder


def files_of(folder: Path) -> dict[str, Path]:
    return {path.name: path for path in (folder / "rig").iterdir()}


def test_panoramas_are_placed_levelled_and_tagged(survey, tmp_path):
    placed = place_rig_files([survey / "rig"], trajectory(), SETTINGS)
    table = make_panoramas(
        files_of(survey),
        placed.poses,
        small_rig(),
        survey / "points.laz",
        Panorama(width_px=480),
        tmp_path / "pictures",
        tmp_path / "panoramas.parquet",
    )
    assert len(table) == 2
    row = read_table(tmp_path / "panoramas.parquet", PANORAMAS)[0].iloc[0]
    # omega 90: the front lens looks to port, that is north of a bow to the east; local names are +02:00
    assert row["heading_deg"] == pytest.approx(0.0, abs=1e-6)
    assert row["t_gps_s"] == pytest.approx(float(gps_from_unix(START.timestamp(), 0)))
    assert [row["lat_deg"], row["lon_deg"]] == pytest.approx([51.05, 13.25], abs=1e-6)
    assert row["sigma_up_m"] == pytest.approx(np.hypot(0.01, 0.01), rel=0.05)
    assert 0.1 < row["ranged"] < 0.5
    with Image.open(tmp_path / "pictures" / "R20210512_103100000.jpg") as file:
        picture = np.asarray(file).astype(float)
        xmp = file.info["xmp"]
    assert b'GPano:ProjectionType="equirectangular"' in xmp
    assert b'GPano:FullPanoWidthPixels="480"' in xmp
    # each wall where it stands: north ahead, east to the right, south behind, west to the left
    for name, direction in {
        "north": (0, 0, 1),
        "east": (1, 0, 0),
        "west": (-1, 0, 0),
        "south": (0.05, 0, -1),
    }.items():
        x, y = pixels_of(np.array([direction], dtype=float), 480)[0].astype(int)
        assert picture[y, x] == pytest.approx(WALLS[name], abs=12), name


def test_a_second_file_of_one_time_is_counted_and_has_no_panorama(survey):
    placed = place_rig_files([survey / "rig"], trajectory(), SETTINGS)
    assert placed.report.losses["files_of_one_time"] == 1
    assert placed.poses.reasons.count("of the same time as R20210512_103102500 (2).jpg") == 1
    assert placed.poses.oriented.sum() == 2


def test_stamps_in_whole_seconds_are_less_certain_and_this_is_told(survey, tmp_path, caplog):
    path = tmp_path / "R20210512_103100.jpg"
    path.write_bytes((survey / "rig" / "R20210512_103100000.jpg").read_bytes())
    with caplog.at_level("WARNING", logger="thalweg"):
        placed = place_rig_files([path], trajectory(), SETTINGS)
    assert "in steps of 1 s: each is uncertain by 0.29 s" in caplog.text
    clock = SETTINGS.clock
    expected = np.sqrt(1 / 12 + clock.sigma_offset_s**2 + clock.jitter_s**2)
    assert placed.poses.sigma_t_s[0] == pytest.approx(expected, rel=1e-6)


def test_files_outside_the_survey_and_depth_without_a_cloud_are_told(survey, tmp_path):
    late = RigSettings.model_validate(SETTINGS.model_dump() | {"times": {"utc_offset": "+01:00"}})
    with pytest.raises(CoverageError):
        place_rig_files([survey / "rig"], trajectory(), late)
    placed = place_rig_files([survey / "rig"], trajectory(), SETTINGS)
    given = (files_of(survey), placed.poses, small_rig())
    with pytest.raises(CoverageError, match="there is no lidar cloud") as refused:
        make_panoramas(*given, None, Panorama(), tmp_path / "p", tmp_path / "p.parquet")
    assert "sphere" in refused.value.cure
    turned = Rig(
        cameras=given[2].cameras,
        T_back_front=given[2].T_back_front,
        settings=RigSettings.model_validate(
            SETTINGS.model_dump() | {"back": {"box_px": (SIDE, 0, SIDE, SIDE), "turn_deg": 0}}
        ),
    )
    with pytest.raises(InputError, match="only if they are turned by half against"):
        make_panoramas(
            *given[:2], turned, None, Panorama(mode="sphere"), tmp_path / "p", tmp_path / "p.parquet"
        )


def test_an_unknown_clock_a_missing_mask_and_a_cloud_of_elsewhere_are_told(survey, tmp_path, caplog):
    plain = RigSettings.model_validate(SETTINGS.model_dump() | {"clock": {}})
    with caplog.at_level("WARNING", logger="thalweg"):
        placed = place_rig_files([survey / "rig"], trajectory(), plain)
    assert "The clock of the rig is known to 1 s only (rig.clock)" in caplog.text
    assert any("rig.clock" in note for note in placed.report.notes)
    assert placed.poses.sigma_t_s[0] > 1.0
    out = tmp_path / "p", tmp_path / "p.parquet"
    given = (files_of(survey), placed.poses, small_rig())
    with pytest.raises(InputError, match="no lens has a mask") as refused:
        make_panoramas(*given, survey / "points.laz", Panorama(boat="mask"), *out)
    assert "rig.front.mask" in refused.value.cure
    assert "0 where the boat is" in refused.value.expected
    away = replace(placed.poses, centre_wcs_m=placed.poses.centre_wcs_m + np.array([900.0, 0, 0]))
    caplog.clear()
    with caplog.at_level("WARNING", logger="thalweg"):
        make_panoramas(given[0], away, given[2], survey / "points.laz", Panorama(width_px=64), *out)
    assert caplog.text.count("no point of the cloud within 80 m: taken outside the time of the lidar?") == 2


def test_a_rig_colours_all_walls(survey, tmp_path):
    placed = place_rig_files([survey / "rig"], trajectory(), SETTINGS)
    sources = rig_photographs(files_of(survey), placed.poses, small_rig())
    found = colour_cloud(
        survey / "points.laz", tmp_path / "coloured.laz", sources, Colour(even_exposures=False)
    )
    counts = found.counts.set_index("reason")["n"]
    # a few in the corners of the room hide each other
    assert counts["coloured"] >= 0.99 * counts.sum()
    assert counts["not_shown"] == counts["masked"] == 0
    assert sorted(name.split("/")[0] for name in found.gains["image"]) == ["back"] * 2 + ["front"] * 2
    from thalweg.core.las import read_laz

    cloud = read_laz(tmp_path / "coloured.laz")[0]
    xyz, rgb = cloud["xyz_m"], cloud["rgb"] / 257.0
    lens = dict(zip(found.gains["number"], found.gains["image"].str.split("/").str[0], strict=True))
    for name, axis, sign in (("east", 0, 1), ("north", 1, 1), ("west", 0, -1), ("south", 1, -1)):
        on = (
            (sign * xyz[:, axis] > HALF_M - 0.01)
            & (np.abs(xyz[:, 1 - axis]) < 2.7)
            & (np.abs(xyz[:, 2]) < 0.8)
        )
        assert np.abs(np.median(rgb[on], axis=0) - WALLS[name]).max() < 8, name
        # the front lens looks to the north, and the numbers of photographs tell the lens
        if axis == 1:
            seen = cloud["image"][on & (np.abs(xyz[:, 0]) < 1.5) & (cloud["image"] >= 0)]
            assert {lens[number] for number in seen} == {"front" if sign > 0 else "back"}


def test_gaps_of_a_cloud_take_the_nearer_border_and_the_rest_is_far():
    rng = np.random.default_rng(2)
    # two walls, 4 m ahead and 9 m behind, with a slit of 3 degrees between points in the first
    ahead = np.column_stack([rng.uniform(-4, 4, (60_000, 2)), np.full(60_000, 4.0)])
    ahead = ahead[np.abs(np.rad2deg(np.arctan2(ahead[:, 0], 4.0))) > 1.5]
    behind = np.column_stack([rng.uniform(-9, 9, (60_000, 2)), np.full(60_000, -9.0)])
    ranges = cloud_ranges(np.concatenate([ahead, behind]), np.zeros(3), np.eye(3), cell_deg=1.0, reach_m=50.0)
    assert np.isinf(ranges[90, 180])
    filled = fill_gaps(ranges, gap_deg=6.0)
    assert filled[90, 180] == pytest.approx(4.0, abs=0.05)
    # the seam of the picture lies behind: no gap there
    assert filled[90, [0, -1]] == pytest.approx([9.0, 9.0], abs=0.1)
    # overhead there is nothing within reach of a gap
    assert np.isinf(filled[2]).all()
    assert (filled <= ranges).all()


def test_places_in_all_quarters_of_the_earth_and_below_its_ellipsoid(tmp_path):
    """EXIF 2.3: letters and three fractions of latitude and longitude, 1 for heights below zero."""
    picture = np.zeros((8, 16, 3), np.uint8)
    for llh, north, east, below in (
        ([51.5, 13.25, 200.1234], "N", "E", 0),
        ([-33.125, -70.75, -3.5], "S", "W", 1),
    ):
        time = float(gps_from_unix(START.timestamp()))
        write_panorama(
            tmp_path / "a.jpg", picture, heading_deg=-90.0, llh=np.array(llh), t_gps_s=time, quality=90
        )
        with Image.open(tmp_path / "a.jpg") as file:
            gps = file.getexif().get_ifd(0x8825)
        assert (gps[1], gps[3], int.from_bytes(gps[5])) == (north, east, below)
        for tag, value in ((2, llh[0]), (4, llh[1])):
            assert gps[tag][0] + gps[tag][1] / 60 + gps[tag][2] / 3600 == pytest.approx(abs(value))
        assert float(gps[6]) == pytest.approx(abs(llh[2]), abs=6e-4)
