"""Public recordings as the files that the examples beside this script name.

    python config/campaigns/examples/prepare.py FOLDER_OF_RECORDINGS [results/tiny]

writes `data/` beside this script: links to the recordings, and tables of others in a form that Thalweg reads.
What no recording holds is made up and says so: the track of a lidar that stood still. An SBET beside
photographs is the digital twin's, from the results of campaign tiny.
"""

import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from thalweg.core import gps_from_unix, read_table
from thalweg.core.timescales import week_from_gps
from thalweg.ingest import INS_STATE

HERE = Path(__file__).parent / "data"
STRASBOURG = ("8811.jpg", "8936.jpg", "8937.jpg", "8938.jpg", "9111.jpg")


def copied(files: Sequence[Path], folder: Path) -> None:
    """Files, copied into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for file in files:
        shutil.copyfile(file, folder / file.name)


def photographs(source: Path, folder: Path) -> None:
    """The aerial block of Strasbourg (DBAT): pixels count from 1, 124 mm, 6 micrometres a pixel."""
    project = source / "dbat_sxb/script/sxb"
    copied(sorted((source / "dbat_sxb/prague2016/sxb/images").glob("*.jpg")), folder / "images")
    read = {"comment": "#", "header": None, "skipinitialspace": True}
    columns = ["id", "name", "x", "y", "z", "sigma_x_m", "sigma_y_m", "sigma_z_m"]
    points = pd.read_csv(project / "reference/sxb-control.txt", names=columns, **read)
    points["role"] = np.where(points["id"].isin([351, 410]), "check", "control")
    marks = pd.read_csv(project / "measurements/markpts.txt", names=["id", "image", "x_px", "y_px"], **read)
    marks["point"] = marks["id"].map(dict(zip(points["id"], points["name"], strict=True)))
    marks["image"] = [STRASBOURG[k - 1] for k in marks["image"]]
    marks[["x_px", "y_px"]] -= 0.5
    points.drop(columns="id").rename(columns={"name": "id"}).to_csv(folder / "points.csv", index=False)
    marks.drop(columns="id").to_csv(folder / "marks.csv", index=False)
    f, cx, cy = 123.9392 / 0.006, 26.577 / 0.006 - 0.5, 38.811 / 0.006 - 0.5
    (folder / "cameras.txt").write_text(f"1 PINHOLE 8858 12996 {f} {f} {cx} {cy}\n")
    report = (project / "result/report.txt").read_text().split()
    names = {"Omega": "omega", "Phi": "phi", "Kappa": "kappa", "Xc": "x", "Yc": "y", "Zc": "z"}
    table = {"image": list(STRASBOURG)}
    for word, name in names.items():
        at = [k for k, text in enumerate(report) if text == f"{word}:" and report[k + 1] == "Value:"]
        table[name] = [float(report[k + 2]) for k in at]
        table[f"sigma_{name}"] = [float(report[k + 5]) for k in at]
    found = pd.DataFrame(table)
    found.to_csv(folder / "orientations.csv", index=False)
    positions = found[["image", "x", "y", "z"]].assign(**{f"sigma_{a}_m": found[f"sigma_{a}"] for a in "xyz"})
    positions.to_csv(folder / "positions.csv", index=False)


def fixed_camera(source: Path, folder: Path) -> None:
    """The first camera before the Belvedere glacier (ICEpy4D)."""
    assets = source / "icepy4d_belvedere/assets"
    copied(sorted((assets / "targets").glob("IMG_26*.csv")), folder)
    copied([assets / "targets/target_world.csv"], folder)
    shutil.copyfile(assets / "calib/cam1.txt", folder / "camera.txt")


def standing_track(path: Path, *, begin_unix_s: float, lat_deg: float, lon_deg: float) -> None:
    """Ten seconds of an SBET of a boat that stands still: made up, no recording."""
    _, tow_s = week_from_gps(gps_from_unix(begin_unix_s) + np.arange(-4.0, 6.0, 0.01))
    records = np.zeros((len(tow_s), 17))
    records[:, 0] = tow_s
    records[:, 1:4] = np.deg2rad(lat_deg), np.deg2rad(lon_deg), 60.0
    records.astype("<f8").tofile(path)


def write_sbet(states: Path, target: Path) -> int:
    """States of the INS as an SBET (wander angle 0); returns the GPS week."""
    table, _ = read_table(states, INS_STATE)
    week, tow_s = week_from_gps(table["t_gps_s"])
    records = np.zeros((len(table), 17))
    records[:, 0] = tow_s
    records[:, 1:3] = np.deg2rad(table[["lat_deg", "lon_deg"]])
    records[:, 3] = table["h_ell_m"]
    records[:, 4:7] = table[["v_north_mps", "v_east_mps", "v_down_mps"]]
    records[:, 7:10] = table[["roll_rad", "pitch_rad", "heading_rad"]]
    records.astype("<f8").tofile(target)
    return int(week[0])


def sbet_photographs(tiny: Path, folder: Path) -> None:
    """Photographs and states of the digital twin, oriented by its own adjustment."""
    copied(sorted((tiny / "simulation/logs/time_lapse").glob("*.jpg")), folder / "images")
    copied([tiny / "orientation/image_poses.parquet"], folder)
    write_sbet(tiny / "ingest/ins_states.parquet", folder / "boat.sbet")


def main(source: Path, tiny: Path | None = None) -> None:
    """All folders of `data/`; that of the twin where campaign tiny has run."""
    if tiny is not None:
        sbet_photographs(tiny, HERE / "sbet_photographs")
    photographs(source, HERE / "strasbourg")
    fixed_camera(source, HERE / "belvedere")
    copied([source / "nmea_gpsd_depth/bundg_zeus_9.log"], HERE / "yacht")
    copied(sorted((source / "sbp_piksi_rtk_2017").glob("*.sbp")), HERE / "piksi")
    copied(sorted((source / "py4dgeo_planes").glob("*.xyz")), HERE / "planes")
    copied(sorted((source / "vlp16_mrpt_gps").glob("*.pcap")), HERE / "lidar")
    standing_track(HERE / "lidar/standing.sbet", begin_unix_s=1_453_364_282.0, lat_deg=36.829, lon_deg=-2.408)
    copied(sorted((source / "vlp16_veloview").glob("*.pcap")), HERE / "lidar_without_pps")
    track = HERE / "lidar_without_pps/standing.sbet"
    standing_track(track, begin_unix_s=1_778_587_200.0, lat_deg=51.0, lon_deg=13.7)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
