"""``thalweg orient``: photographs and surveyed points alone, on a real aerial block, and its refusals."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pyproj import CRS, Transformer

from thalweg.cli import main
from thalweg.core import GeometryError, InputError
from thalweg.images import orient_photographs, read_control_points
from thalweg.images.control import frame_about
from thalweg.settings.sections import LOCAL, FeatureSettings

NAMES = ("8811.jpg", "8936.jpg", "8937.jpg", "8938.jpg", "9111.jpg")


def tables_of_strasbourg(project: Path, folder: Path) -> tuple[Path, Path]:
    """Control points and marks of the aerial block as tables with names; its pixels count from 1."""
    points = pd.read_csv(
        project / "reference/sxb-control.txt",
        comment="#",
        header=None,
        names=["id", "name", "x", "y", "z", "sigma_x_m", "sigma_y_m", "sigma_z_m"],
        skipinitialspace=True,
    )
    points["role"] = np.where(points["id"].isin([351, 410]), "check", "control")
    marks = pd.read_csv(
        project / "measurements/markpts.txt",
        comment="#",
        header=None,
        names=["id", "image", "x_px", "y_px"],
        skipinitialspace=True,
    )
    marks["point"] = marks["id"].map(dict(zip(points["id"], points["name"], strict=True)))
    marks["image"] = [NAMES[k - 1] for k in marks["image"]]
    marks[["x_px", "y_px"]] -= 0.5
    points.drop(columns="id").rename(columns={"name": "id"}).to_csv(folder / "points.csv", index=False)
    marks.drop(columns="id").to_csv(folder / "marks.csv", index=False)
    return folder / "points.csv", folder / "marks.csv"


def published(report: Path, axis: str) -> np.ndarray:
    """Value and standard deviation (5, 2) of a coordinate of the projection centres."""
    found = re.findall(rf"{axis}:\s+Value:\s+(\S+) ou\s+Deviation:\s+(\S+) ou", report.read_text())
    assert len(found) == 5
    return np.array(found, float)


@pytest.mark.real
@pytest.mark.slow
def test_a_real_aerial_block_from_photographs_and_points(data_dir, tmp_path, capsys, record_property):
    """Its photographs are those of two campaigns of `test_examples`, which stay in the suite."""
    project = data_dir / "dbat_sxb/script/sxb"
    points, marks = tables_of_strasbourg(project, tmp_path)
    f, cx, cy = 123.9392 / 0.006, 26.577 / 0.006 - 0.5, 38.811 / 0.006 - 0.5
    (tmp_path / "cameras.txt").write_text(f"1 PINHOLE 8858 12996 {f} {f} {cx} {cy}\n")
    files = [
        "--points",
        points,
        "--marks",
        marks,
        "--camera",
        tmp_path / "cameras.txt",
        "--out",
        tmp_path / "o",
    ]
    how = ["--crs", "local", "--interior", "fixed", "--max-size", 1000]
    pictures = data_dir / "dbat_sxb/prague2016/sxb/images"
    assert main(["orient", str(pictures), *map(str, [*files, *how])]) == 0
    told = capsys.readouterr().out
    assert "5 images" in told
    assert "2 check points" in told
    poses = pd.read_csv(tmp_path / "o/image_poses.csv").set_index("image").loc[list(NAMES)]
    squares = []
    for axis in "xyz":
        value, sigma = published(project / "result/report.txt", f"{axis.upper()}c").T
        own = poses[f"sigma_{axis}_m"].to_numpy()
        squares.append(np.square(poses[f"{axis}_m"] - value) / (own**2 + sigma**2))
        # other tie points, the same control: the published sigmas come out, to a third
        np.testing.assert_allclose(own, sigma, rtol=0.35)
    # measured 1.8 for 15 coordinates; 999 of 1000 independent sets lie below 2.5. The published sigmas take
    # all marks as independent
    record_property("nees", np.mean(squares))
    assert np.mean(squares) < 2.5
    # two check points of six coordinates: published root mean squares 0.136, 0.209, 0.339 m
    control = pd.read_csv(tmp_path / "o/control_points.csv").set_index("point")
    check = control[control["role"] == "check"]
    assert len(check) == 2
    assert np.sqrt(np.square(check[[f"without_{a}_mm" for a in ("east", "north", "up")]]).mean()).max() < 700
    tie = pd.read_csv(tmp_path / "o/points.csv")
    # the ground of the city, 135 to 145 m high, but for roofs
    assert tie["z_m"].quantile([0.25, 0.75]).between(125, 175).all()
    page = (tmp_path / "o/index.html").read_text()
    assert "photographs with a pose</td><td>5 of 5" in page


def test_coordinates_of_a_local_frame_stay(tmp_path):
    table = tmp_path / "points.csv"
    table.write_text("id,x,y,z\na,1000.5,2000.25,30\nb,1010,2000,31\n")
    frame = frame_about([table], crs=LOCAL)
    found = read_control_points(table, frame, crs=LOCAL, sigma_m=(0.01, 0.01, 0.02))
    np.testing.assert_array_equal(found.points_wcs_m[0], [1000.5, 2000.25, 30.0])


def test_the_frame_lies_amid_points_of_a_map_grid(tmp_path):
    east, north = 412_000.0, 5_650_970.0
    table = tmp_path / "points.csv"
    table.write_text(
        f"id,x,y,z\na,{east},{north},150\nb,{east + 40},{north},150\nc,{east + 20},{north},150\n"
    )
    frame = frame_about([table], crs="EPSG:25833")
    lon, lat = Transformer.from_crs(CRS(25833), CRS(4258), always_xy=True).transform(east + 20, north)
    assert frame.lat_deg == pytest.approx(lat, abs=1e-7)
    assert frame.lon_deg == pytest.approx(lon, abs=1e-7)
    assert frame.h_ell_m == pytest.approx(150.0, abs=0.01)


def test_points_without_a_place_are_refused(tmp_path):
    table = tmp_path / "points.csv"
    table.write_text("id,east_m,north_m,up_m\na,1,2,3\n")
    with pytest.raises(
        (InputError, GeometryError), match=r"without a place on the earth|outside the area of use"
    ):
        frame_about([table], crs="EPSG:25833")


def test_a_geographic_crs_is_no_map_grid(tmp_path):
    table = tmp_path / "points.csv"
    table.write_text("id,lat_deg,lon_deg,h_ell_m\na,51,13,200\n")
    with pytest.raises(InputError, match="projected"):
        orient_photographs({}, control_points=[table], marks=table, crs="EPSG:4326")


@pytest.mark.real
def test_two_control_points_do_not_place_a_block(data_dir, tmp_path):
    points, marks = tmp_path / "points.csv", tmp_path / "marks.csv"
    points.write_text("id,x,y,z\na,0,0,0\nb,10,0,0\n")
    pictures = sorted((data_dir / "dbat_roma/dbat/images/roma").glob("*.JPG"))[:3]
    rows = [f"{path.name},{name},{1000 + 50 * k},1500" for path in pictures for k, name in enumerate("ab")]
    marks.write_text("\n".join(["image,point,x_px,y_px", *rows]) + "\n")
    with pytest.raises(GeometryError, match="2 control points measured in two images") as raised:
        orient_photographs(
            pictures,
            control_points=[points],
            marks=marks,
            crs=LOCAL,
            features=FeatureSettings(max_size_px=600, max_features=1200),
        )
    assert "three control points" in raised.value.cure
