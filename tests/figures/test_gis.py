"""The project for QGIS: its XML, and QGIS itself where it is installed."""

import os
import subprocess
from itertools import pairwise
from xml.etree import ElementTree
from zipfile import ZipFile

import geopandas
import laspy
import numpy as np
import pytest
from pyproj import CRS
from shapely import LineString, Point

from thalweg.core import Grid, write_raster
from thalweg.figures.gis import write_gis_project
from thalweg.fusion import write_layers

UTM = CRS.from_epsg(25833)
TITLE = 'Mulde & <low> "water"'

OPENS = """
import sys
from qgis.core import QgsApplication, QgsProject, QgsVectorLayer
app = QgsApplication([], False)
app.initQgis()
project = QgsProject.instance()
assert project.read(sys.argv[1])
print("title|" + project.title() + "|" + project.crs().authid())
for node in project.layerTreeRoot().findLayers():
    layer = node.layer()
    kind = layer.renderer().type() if isinstance(layer, QgsVectorLayer) else layer.type()
    print(f"{layer.name()}|{layer.isValid()}|{layer.crs().authid()}|{kind}")
app.exitQgis()
"""
"""Run by the Python of QGIS, which is not that of the tests."""


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """A folder of results of a survey, and its project."""
    folder = tmp_path_factory.mktemp("results") / "mulde"
    for name in ("bathymetry", "fusion", "lidar"):
        (folder / name).mkdir(parents=True)
    east, north = 377300.0, 5656800.0
    at = [Point(east + i, north + i, 298.0 + i / 10) for i in range(9)]
    line = LineString(at)
    tables = {
        "track": geopandas.GeoDataFrame(geometry=[line], crs=UTM),
        "soundings": geopandas.GeoDataFrame({"depth": range(9)}, geometry=at, crs=UTM),
        "soundings_left_out": geopandas.GeoDataFrame(
            {"reason": ["weeds", "a < b"]}, geometry=at[:2], crs=UTM
        ),
        "contours": geopandas.GeoDataFrame({"height_m": [298.5]}, geometry=[line], crs=UTM),
    }
    write_layers(folder / "survey.gpkg", tables)
    grid = Grid(west_m=east, north_m=north + 9, cell_m=1.0, rows=9, columns=9, crs=UTM)
    height = np.linspace(298, 299, 81).reshape(9, 9)
    write_raster(folder / "bathymetry/bed.tif", grid, {"height_m": height, "sigma_m": height - 297.9})
    write_raster(folder / "fusion/dtm.tif", grid, {"height": height, "sigma": height - 297.9})
    cloud = laspy.create(point_format=6, file_version="1.4")
    cloud.x, cloud.y, cloud.z = (np.arange(5.0) + first for first in (east, north, 298.0))
    cloud.write(folder / "lidar/points_map.copc.laz")
    rasters = [folder / "bathymetry/bed.tif", folder / "fusion/dtm.tif"]
    for name in ("survey.qgz", "again.qgz"):
        write_gis_project(
            folder / "survey.gpkg",
            rasters,
            [folder / "lidar/points_map.copc.laz"],
            folder / name,
            TITLE,
            "EPSG:25833",
        )
    return folder


def test_every_layer_is_there_from_the_uppermost_to_the_lowest(survey):
    with ZipFile(survey / "survey.qgz") as archive:
        assert archive.namelist() == ["survey.qgs"]
        root = ElementTree.fromstring(archive.read("survey.qgs"))
    assert root.findtext("title") == TITLE
    nodes = root.findall("layer-tree-group/layer-tree-layer")
    layers = {layer.findtext("id"): layer for layer in root.findall("projectlayers/maplayer")}
    assert [node.get("id") for node in nodes] == list(layers)
    order = (
        "soundings soundings_left_out track contours cloud "
        "bed_height_m bed_sigma_m dtm_height dtm_sigma hillshade"
    )
    assert [name.removeprefix("thalweg_") for name in layers] == order.split()
    hidden = {node.get("id") for node in nodes if node.get("checked") == "Qt::Unchecked"}
    assert hidden == {"thalweg_cloud", "thalweg_bed_sigma_m", "thalweg_dtm_sigma"}
    assert root.find("properties/Paths/Absolute").text == "false"
    for layer in layers.values():
        file = layer.findtext("datasource").partition("|")[0]
        assert file.startswith("./")
        assert (survey / file).is_file()
        assert layer.findtext("srs/spatialrefsys/authid") == "EPSG:25833"
    assert root.findtext("projectCrs/spatialrefsys/authid") == "EPSG:25833"
    corners = [float(root.findtext(f"mapcanvas/extent/{name}")) for name in ("xmin", "ymin", "xmax", "ymax")]
    # of soundings and track, with a twentieth around them: the rasters reach a metre farther
    assert corners == pytest.approx([377299.6, 5656799.6, 377308.4, 5656808.4], abs=1e-3)
    pipe = layers["thalweg_hillshade"].find("pipe")
    assert pipe.find("provider/resampling").get("zoomedInResamplingMethod") == "bilinear"


def test_classes_hold_all_soundings_and_all_reasons(survey):
    with ZipFile(survey / "survey.qgz") as archive:
        root = ElementTree.fromstring(archive.read("survey.qgs"))
    ranges = [(float(r.get("lower")), float(r.get("upper"))) for r in root.iter("range")]
    assert (ranges[0][0], ranges[-1][1]) == (298.0, 298.8)
    assert all(high == low for (_, high), (low, _) in pairwise(ranges))
    assert {c.get("value") for c in root.iter("category")} == {"weeds", "a < b"}


def test_the_same_results_give_the_same_bytes(survey):
    with ZipFile(survey / "survey.qgz") as one, ZipFile(survey / "again.qgz") as two:
        assert one.read("survey.qgs") == two.read("again.qgs")
        assert one.infolist()[0].date_time == (1980, 1, 1, 0, 0, 0)


def test_a_map_with_heights_is_drawn_in_its_plane(survey, tmp_path):
    out = tmp_path / "p.qgz"
    write_gis_project(survey / "survey.gpkg", [], [], out, TITLE, "EPSG:25833+7837")
    with ZipFile(out) as archive:
        root = ElementTree.fromstring(archive.read("p.qgs"))
    assert root.findtext("projectCrs/spatialrefsys/authid") == "EPSG:25833"
    assert len(root.findall("projectlayers/maplayer")) == 4


def test_qgis_opens_every_layer(survey):
    """By PyQGIS; COPC is valid from QGIS 3.26 on."""
    python = "/usr/bin/python3"
    # nothing of our own Python, nor of the PROJ and GDAL that came with it
    own = {
        "PATH": os.defpath,
        "QT_QPA_PLATFORM": "offscreen",
        "HOME": str(survey),
        "XDG_RUNTIME_DIR": str(survey),
    }
    has = [python, "-c", "from qgis.core import Qgis; print(Qgis.QGIS_VERSION_INT)"]
    found = subprocess.run(has, env=own, capture_output=True, text=True, check=False)
    if found.returncode:
        pytest.skip("QGIS is not installed (Debian: python3-qgis)")
    done = subprocess.run(
        [python, "-c", OPENS, survey / "survey.qgz"], env=own, capture_output=True, text=True, check=True
    )
    title, *layers = (line.split("|") for line in done.stdout.splitlines())
    assert title == ["title", TITLE, "EPSG:25833"]
    assert len(layers) == 10
    reads_copc = int(found.stdout) >= 32600
    assert {name for name, valid, *_ in layers if valid != "True"} <= (
        set() if reads_copc else {"Point cloud, height in m"}
    )
    assert {crs for *_, crs, _ in layers} == {"EPSG:25833"}
    kinds = {name.partition(",")[0]: kind for name, *_, kind in layers[:4]}
    assert list(kinds.values()) == ["graduatedSymbol", "categorizedSymbol", "singleSymbol", "singleSymbol"]
