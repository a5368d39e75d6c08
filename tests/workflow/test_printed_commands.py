"""Every command of the page of single commands, as printed, in a folder with files of the printed names.

The five commands of a survey, and those of the tutorial: `test_subsets`.
"""

import json
import re
import runpy
import shutil
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pandas as pd
import pytest
from pyproj import CRS

from tests.test_readme import as_a_shell_splits, commands
from thalweg.cli import main
from thalweg.core import LocalFrame
from thalweg_lab.instruments import simulate_raw_gnss
from thalweg_lab.settings import TwinConfig

pytestmark = [pytest.mark.workflow, pytest.mark.real]

REPOSITORY = Path(__file__).parents[2]
TABLE = (REPOSITORY / "docs/commands.md").read_text()
PRINTED = {line.split()[1]: line for line in commands(TABLE)}
ORIGIN = {"lat_deg": 51.05, "lon_deg": 13.25, "h_ell_m": 300.0}
"""Of the tiny campaign."""
MAP_M = np.array([412_000.0, 5_650_970.0, 150.0])


def recordings(folder: Path, tiny: Path, data: Path) -> None:
    logs = tiny / "simulation/logs"
    for name, copy in (("lidar.pcap", "my.pcap"), ("rover.sbp", "rover.sbp"), ("ins.anpp", "ins.anpp")):
        shutil.copy(logs / name, folder / copy)


def raw_gnss(folder: Path, tiny: Path, data: Path) -> None:
    """Observations of the digital twin and of a base at the printed place."""
    simulate_raw_gnss(
        TwinConfig(size="tiny", gnss={"base_km": 0.05}),
        11,
        LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=243.0),
        scene=tiny / "simulation/truth/scene.npz",
        true_mounts=tiny / "simulation/truth/mounts.json",
        out_rover=folder / "rover.sbp",
        out_base=folder / "base.obs",
        out_nav=folder / "base.nav",
    )


def lidar_and_states(folder: Path, tiny: Path, data: Path) -> None:
    shutil.copy(tiny / "simulation/logs/lidar.pcap", folder)
    prepare = runpy.run_path(str(REPOSITORY / "config/campaigns/examples/prepare.py"))
    week = prepare["write_sbet"](tiny / "ingest/ins_states.parquet", folder / "sbet.out")
    assert f"--gps-week {week} " in PRINTED["georeference"]


def clouds(folder: Path, tiny: Path, data: Path) -> None:
    """Two clouds of one ground, on the map."""
    rng = np.random.default_rng(5)
    for name, up_m in (("boat", 0.04), ("tls", 0.0), ("2019", 0.0), ("2021", 0.2)):
        xy = rng.uniform(0.0, 20.0, (4_000, 2))
        xyz = MAP_M + np.column_stack([xy, up_m + 0.1 * np.sin(xy[:, 0]) + rng.normal(0, 0.005, 4_000)])
        write_cloud(folder / f"{name}.laz", xyz)


def write_cloud(path: Path, xyz_m: np.ndarray) -> None:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = MAP_M, np.full(3, 0.001)
    header.add_crs(CRS.from_epsg(25833))
    cloud = laspy.LasData(header)
    cloud.xyz = xyz_m
    cloud.write(path)


EAST_M, NORTH_M = 500_000.0, 5_400_000.0


def river(folder: Path, tiny: Path, data: Path) -> None:
    """Soundings in a zigzag between two banks, points beside its centre line."""
    s = np.arange(0.0, 120.0, 1.0)
    n = 16.0 * (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * s / 40))
    noise = np.random.default_rng(7).normal(0, 0.03, len(s))
    table = pd.DataFrame({"east": EAST_M + s, "north": NORTH_M + n, "z": 98.0 + 0.005 * n**2 + noise})
    table.to_csv(folder / "soundings.csv", index=False)
    banks = [[[EAST_M + x, NORTH_M + side] for x in (-5.0, 60.0, 125.0)] for side in (20.0, -20.0)]
    lines = [
        {"type": "Feature", "properties": {}, "geometry": {"type": "LineString", "coordinates": bank}}
        for bank in banks
    ]
    (folder / "banks.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": lines}))
    table[["east", "north"]].to_csv(folder / "points.csv", index=False)
    pd.DataFrame({"x": EAST_M + s, "y": NORTH_M}).to_csv(folder / "line.csv", index=False)


def video(folder: Path, tiny: Path, data: Path) -> None:
    from tests.ingest.test_video import video

    video(folder / "video.mp4")


def bed_through_water(folder: Path, tiny: Path, data: Path) -> None:
    """Points half a metre below the printed level, seen by four cameras."""
    rng = np.random.default_rng(6)
    places = rng.uniform(0.0, 10.0, (50, 2))
    table = pd.DataFrame({"x": places[:, 0], "y": places[:, 1], "z": 174.3})
    table.to_csv(folder / "points.csv", index=False)
    cameras = {"x": [0.0, 10.0, 0.0, 10.0], "y": [0.0, 0.0, 10.0, 10.0], "z": 205.0}
    pd.DataFrame(cameras).to_csv(folder / "cameras.csv", index=False)


def bank(folder: Path, tiny: Path, data: Path) -> None:
    """Eight photographs of the digital twin with the control points that its campaign measured in them."""
    marks = pd.read_csv(tiny / "orientation/control_marks.csv")
    names = sorted(marks["image"].unique())[:8]
    marks = marks[marks["used"] & marks["image"].isin(names)]
    marks[["image", "point", "x_px", "y_px"]].to_csv(folder / "marks.csv", index=False)
    points = pd.read_csv(tiny / "simulation/logs/control_points.csv")
    local = points[["east_m", "north_m", "up_m"]].to_numpy()
    points[["x", "y", "z"]] = LocalFrame(**ORIGIN).to_map(local, CRS.from_epsg(25833))
    points[["id", "x", "y", "z", "role"]].to_csv(folder / "points.csv", index=False)
    (folder / "photos").mkdir()
    for name in names:
        shutil.copy(tiny / "simulation/logs/time_lapse" / name, folder / "photos")


def boards(folder: Path, tiny: Path, data: Path) -> None:
    """Ten photographs of a checkerboard by a fisheye (ACFR)."""
    shutil.copytree(data / "acfr_vlp16_camera/data/vlp/images", folder / "photos")


def fixed_camera(folder: Path, tiny: Path, data: Path) -> None:
    """Control points in pictures of a glacier (ICEpy4D), and its lens as a file of Thalweg."""
    assets = data / "icepy4d_belvedere/assets"
    world = pd.read_csv(assets / "targets/target_world.csv")
    world.set_axis(["point", "x", "y", "z"], axis=1).to_csv(folder / "points.csv", index=False)
    tables = (pd.read_csv(p).assign(image=p.stem) for p in (assets / "targets").glob("IMG_26*.csv"))
    marks = pd.concat(tables).rename(columns={"label": "point", "x": "x_px", "y": "y_px"})
    marks.to_csv(folder / "marks.csv", index=False)
    sigmas = ["--sigma", "focal_px=0.5", "--sigma", "centre_px=0.5", "--sigma", "distortion=1e-4"]
    assert main(["import-camera", str(assets / "calib/cam1.txt"), str(folder / "lens.yaml"), *sigmas]) == 0


def lens_of_colmap(folder: Path, tiny: Path, data: Path) -> None:
    (folder / "cameras.txt").write_text("1 OPENCV 1600 1200 1295 1294 804 597 -0.06 0.08 4e-4 -3e-4\n")


def budget(folder: Path, tiny: Path, data: Path) -> None:
    (folder / "resources").symlink_to(REPOSITORY / "resources")


def nothing(folder: Path, tiny: Path, data: Path) -> None:
    """The command needs no file."""


ELSEWHERE = {"run", "align-strips"}
"""Commands that tests/test_wheel.py and tests/lidar/test_strips.py try."""

MADE_FOR: dict[str, tuple[Callable[[Path, Path, Path], None], tuple[str, ...]]] = {
    "init": (nothing, ("surveys/config/campaigns/tiny.yaml",)),
    "describe": (recordings, ()),
    "fetch": (nothing, ("river_bottom_interpolator/LICENSE.md",)),
    "ppk": (raw_gnss, ("track/positions.csv", "track/index.html")),
    "georeference": (lidar_and_states, ("cloud.laz", "cloud_map.laz", "cloud.json")),
    "compare": (clouds, ("distances.laz",)),
    "view": (clouds, ("page/index.html",)),
    "compare-clouds": (clouds, ("changes.laz",)),
    "bed": (river, ("bed/bed.tif", "bed/bed.png")),
    "flow": (river, ("flow.csv",)),
    "frames": (video, ("frames/times.csv",)),
    "plan-survey": (river, ("plan/plan.json",)),
    "refract": (bed_through_water, ("bed.csv",)),
    "orient": (bank, ("block/image_poses.csv", "block/index.html")),
    "masks": (bank, ("masks/masks.csv", "masks/overview.png")),
    "calibrate-lens": (boards, ("lens.yaml",)),
    "resect": (fixed_camera, ("poses.csv",)),
    "import-camera": (lens_of_colmap, ("camera.yaml",)),
    "print-markers": (nothing, ("markers.pdf",)),
    "budget": (budget, ()),
}
"""Who makes the files that a command names, and what the command makes."""


@pytest.mark.parametrize("command", [name for name in PRINTED if name not in ELSEWHERE])
def test_a_command_does_what_is_printed(command, tiny_house, data_dir, tmp_path, monkeypatch, capsys):
    make, files = MADE_FOR[command]
    make(tmp_path, tiny_house.root / "results/tiny", data_dir)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("THALWEG_DATA", str(data_dir))
    assert main(as_a_shell_splits(PRINTED[command], tmp_path)[1:]) == 0, capsys.readouterr().err
    assert capsys.readouterr().out.strip()
    assert [name for name in files if not (tmp_path / name).stat().st_size] == []


def test_the_tutorial_on_real_recordings_is_walked(data_dir, tmp_path, monkeypatch, capsys):
    """Its commands in an empty folder give the figures of the page; the longer river: by hand."""
    page = (REPOSITORY / "docs/tutorial_real.md").read_text()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("THALWEG_DATA", str(data_dir))
    walked = [line for line in commands(page) if "/CDD/" not in line]
    for line in walked:
        assert main(line.split()[1:]) == 0, line
    assert [line.split()[1] for line in walked] == ["fetch", "describe", "bed", "compare-clouds"]
    said = capsys.readouterr().out
    for block in re.findall(r"```text\n(.*?)```", page, re.S):
        for line in block.splitlines():
            assert line in said
