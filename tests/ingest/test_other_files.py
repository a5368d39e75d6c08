"""Files beside the logs are known for what they are, by content alone, and told what they are good for."""

import struct

import numpy as np
import pytest
import rasterio

from thalweg.calibration import read_camera
from thalweg.cli import main
from thalweg.ingest.registry import describe, recognise

LENS = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<calibration>\n  <projection>frame</projection>\n'
    "  <width>6000</width>\n  <height>4000</height>\n  <f>6600</f>\n  <cx>10</cx>\n  <cy>-50</cy>\n"
    "  <k1>-0.09</k1>\n  <k2>0.08</k2>\n  <p1>0.0002</p1>\n  <p2>-0.0009</p2>\n{}</calibration>\n"
)
IMAGES_BIN = struct.pack("<QI4d3dI", 2, 1, 0.8, 0.6, 0.0, 0.0, 1.0, 2.0, 3.0, 1) + b"a.jpg\0" + bytes(8)
FILES = {
    "dbat_project": b'<document dbat_script_version="1.0">\n<input><cameras/></input></document>',
    "dbat_camera": b'<document dbat_camera_version="1.0">\n<cameras><camera><cc>24.3</cc></camera></cameras>',
    "dbat_report": b"Damped Bundle Adjustment Toolbox result file\n   Project Name: x\n",
    "metashape_lens": LENS.format("").encode(),
    "colmap_images": b"# Image list\n1 0.8 0.6 0 0 1 2 3 1 a.jpg\n10 20 -1\n",
    "colmap_images_bin": IMAGES_BIN,
    "camera_poses": b"#Label,X/Longitude,Y/Latitude,Z/Altitude,Yaw,Pitch,Roll\nIMG_1,13.2,51.0,250,10,0,1\n",
    "image_points": b"label,x,y\nF2,1501.2,870.5\nF10,20,30\n",
    "corners": b"image,column,row,x_px,y_px\na.png,0,0,10,20\n",
    "xyz": b"412000.1 5650970.2 140.33\n412001.1 5650971.2 140.31\n412002.1 5650972.2 140.29\n",
    "geojson": b'{"type": "FeatureCollection", "features": [{"geometry": {"coordinates": [1, 2]}}]}',
    "pcd": b"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\n",
    "sqlite": b"SQLite format 3\x00" + bytes(40),
    "video": bytes([0, 0, 0, 24]) + b"ftypmp42" + bytes(40),
    "heif": bytes([0, 0, 0, 24]) + b"ftypheic" + bytes(40),
    "kml": b'<?xml version="1.0"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"/>',
    "gml": b'<?xml version="1.0"?>\n<FeatureCollection xmlns:gml="http://www.opengis.net/gml"/>',
    "dxf": b"  0\r\nSECTION\r\n  2\r\nENTITIES\r\n",
    "flatgeobuf": b"fgb\x03fgb\x00" + bytes(40),
    "geopackage": b"SQLite format 3\x00" + bytes(52) + b"GPKG" + bytes(30),
    "shapefile": bytes.fromhex("0000270a") + bytes(96) + b"\0\0\0\1",
    "shapefile_part": b'PROJCS["ETRS_1989_UTM_Zone_33N"]',
}


@pytest.mark.parametrize("kind", FILES)
def test_a_file_beside_the_logs_is_known_by_its_content(tmp_path, kind):
    path = tmp_path / "whatever"
    path.write_bytes(FILES[kind])
    assert recognise(path) == kind
    lines = describe(path).lines()
    assert any(line.strip().startswith("use") for line in lines)


def test_a_surface_model_is_no_photograph(tmp_path):
    path = tmp_path / "dsm.tif"
    place = rasterio.Affine(0.5, 0.0, 412_000.0, 0.0, -0.5, 5_650_970.0)
    how = {"driver": "GTiff", "width": 4, "height": 3, "count": 1, "dtype": "float32", "transform": place}
    with rasterio.open(path, "w", crs="EPSG:25833", nodata=-9999.0, **how) as target:
        target.write(np.zeros((1, 3, 4), np.float32))
    assert recognise(path) == "geotiff"
    text = "\n".join(describe(path).lines())
    assert "4 x 3 cells of 0.5 x 0.5, 1 band" in text
    assert "EPSG:25833" in text
    assert "-9999" in text


def test_a_lens_of_metashape_becomes_a_calibration(tmp_path):
    path = tmp_path / "lens.xml"
    path.write_text(LENS.format(""))
    sigmas = ["--sigma", "focal_px=0.5", "--sigma", "centre_px=0.5", "--sigma", "distortion=1e-4"]
    assert main(["import-camera", str(path), str(tmp_path / "lens.yaml"), *sigmas]) == 0
    camera = read_camera(tmp_path / "lens.yaml")
    assert camera.parameters[2] == 3010.0
    assert np.sqrt(camera.cov[2, 2]) == pytest.approx(0.5)


def test_what_a_new_campaign_leaves_out_is_summed_up(tmp_path, monkeypatch, capsys):
    logs = tmp_path / "logs"
    logs.mkdir()
    for k in range(5):
        (logs / f"note_{k}.txt").write_text(f"hello {k}\n")
        (logs / f"cloud_{k}.pcd").write_bytes(FILES["pcd"])
    (logs / "points.csv").write_text("id,east_m,north_m,up_m\nA,1,2,3\n")
    monkeypatch.chdir(tmp_path)
    assert main(["new-campaign", "x", "--from-logs", str(logs), "--folder", str(tmp_path)]) == 0
    told = capsys.readouterr().err.splitlines()
    assert "left out, unrecognised: note_0.txt, note_1.txt, note_2.txt and 2 more" in told
    assert any(line.startswith("left out, PCD cloud") and line.endswith("and 2 more") for line in told)


@pytest.mark.real
def test_real_files_of_others_are_what_they_are(data_dir):
    found = {
        "dbat_sxb/script/sxb/sxb.xml": "dbat_project",
        "dbat_sxb/script/sxb/result/report.txt": "dbat_report",
        "dbat_roma/script/romabundledemo/cameras/EOS5DMarkII.xml": "dbat_camera",
        "sandpyper_dsm/dsm_1m/mar_20180601_dsm_resampled_1m.tif": "geotiff",
        "dbat_sxb/script/sxb/reference/sxb-control.txt": "control_points",
        "dbat_sxb/script/sxb/measurements/markpts.txt": "marks",
        "dbat_sxb/prague2016/sxb/ref/fake-camera-positions.txt": "camera_positions",
        "icepy4d_belvedere/assets/targets/IMG_1112.csv": "image_points",
        "icepy4d_belvedere/assets/calib/cam1.txt": "opencv",
        "icepy4d_belvedere/data/calib/24mm_280722_selfcal_all_metashape.xml": "metashape_lens",
        "acfr_vlp16_camera/data/vlp/pcd/pose1_full.pcd": "pcd",
        "ricoh_theta_s/corners.csv": "corners",
        "river_bottom_interpolator/CDD/cross_sections.geojson": "geojson",
        "dbat_roma/dbat/images/roma/IMG_0088.JPG": "photograph",
    }
    assert {name: recognise(data_dir / name) for name in found} == found
    text = "\n".join(describe(data_dir / "dbat_roma/dbat/images/roma/IMG_0088.JPG").lines())
    assert "24 mm by EXIF" in text
    assert "2012-01-23 13:58:15 by EXIF, zone not stated: read as UTC" in text
