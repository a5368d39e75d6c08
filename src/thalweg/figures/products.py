"""Files of a campaign that people take away: what each is, and what opens it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from thalweg.core import read_json

Product = tuple[str, str, str]
BEST: Final = "Point cloud by the best trajectory"
MAP_FILES: Final[Sequence[Product]] = (
    ("report.pdf", "Report of survey", "to print and hand in"),
    ("survey.qgz", "QGIS project", "QGIS: all on one map, beside these files"),
    ("survey.gpkg", "Its layers: track, soundings, river, changes", "QGIS, ArcGIS"),
    ("lidar/points_map.laz", BEST, "CloudCompare, QGIS, CAD"),
    ("lidar/points_map.copc.laz", "The same cloud, streamable (COPC)", "QGIS, PDAL, Potree"),
    ("fusion/dtm.tif", "Terrain model of bed and banks", "QGIS, ArcGIS, hydraulic models"),
    ("bathymetry/bed.tif", "Riverbed with standard deviations", "QGIS, ArcGIS"),
    ("bathymetry/soundings.csv", "Georeferenced soundings", "QGIS, spreadsheets"),
    ("orientation/track.geojson", "Track", "QGIS, web maps"),
    ("orientation/track.kml", "Track", "Google Earth"),
    ("fusion/exports", "Meshes and cross sections", "HEC-RAS, TELEMAC, SMS, EPA SWMM"),
    ("deformation/dod_*.tif", "Difference of heights", "QGIS, ArcGIS"),
)
OWN_FILES: Final[Sequence[Product]] = (
    ("summary.csv", "All numbers of the survey", "spreadsheets"),
    ("lidar/coloured.laz", "Coloured point cloud", "CloudCompare"),
    ("lidar/points.laz", "Point cloud, INS and GNSS", "CloudCompare"),
    ("lidar/by_camera/points.laz", "Point cloud, camera", "CloudCompare"),
    ("lidar/by_fused/points.laz", "Point cloud, all sensors", "CloudCompare"),
    ("lidar/by_strips/points.laz", "Point cloud, corrected by strips", "CloudCompare"),
    ("fusion/model.laz", "Bed, banks and surroundings as points", "CloudCompare"),
    ("surface/reference_mesh.ply", "Mesh of the reference", "CloudCompare, MeshLab"),
    ("orientation/trajectory.parquet", "Trajectory, INS and GNSS", "Python, R"),
    ("orientation/trajectory_camera.parquet", "Trajectory, camera", "Python, R"),
    ("orientation/trajectory_fused.parquet", "Trajectory, all sensors", "Python, R"),
    ("orientation/trajectory_strips.parquet", "Trajectory, corrected by strips", "Python, R"),
    ("panorama/panoramas.parquet", "Poses of the panoramas", "Python, R"),
    ("triangulation/strip/points.parquet", "Bed by the light sheet", "Python, R"),
    ("triangulation/sensor.yaml", "Calibrated light-sheet sensor", "surveys with this sensor"),
    ("triangulation/budget.csv", "Error budget of the light sheet", "spreadsheets"),
    ("triangulation/panels.csv", "Panels in known depths", "spreadsheets"),
    ("calibration/boat.yaml", "Calibration of the boat", "surveys with this boat"),
    ("calibration/camera_lidar.yaml", "Camera and lidar, calibrated", "Python, R"),
    ("calibration/board_camera_lidar.yaml", "Camera and lidar, by a board", "Python, R"),
    ("calibration/rig.yaml", "Calibration of the panorama camera", "surveys with this camera"),
    ("calibration/camera.yaml", "Interior orientation of the camera", "surveys with this camera"),
    ("calibration/echo_sounder.yaml", "Place of the echo sounder", "surveys with this boat"),
    ("photographs/image_poses.csv", "Poses of the photographs", "spreadsheets, Metashape"),
    ("photographs/finished.csv", "Poses of the photographs", "spreadsheets"),
    ("photographs/points.laz", "Tie points", "CloudCompare"),
    ("photographs/camera.yaml", "Interior orientation", "surveys with this camera"),
    ("photographs/control_points.csv", "Control and check points", "spreadsheets"),
    ("photographs/finished_points.csv", "Control and check points", "spreadsheets"),
    ("orientation/fixed_camera.csv", "Pose of the camera in each picture", "spreadsheets"),
    ("accuracy/cloud_to_surface.laz", "Distances from the reference as a cloud", "CloudCompare"),
    ("deformation/changes_*.laz", "Changes as a cloud", "CloudCompare"),
    ("deformation/volumes_*.csv", "Volumes of erosion and deposition", "spreadsheets"),
    ("deformation/retreat_*.csv", "Retreat of the bank", "spreadsheets"),
    ("deformation/series.parquet", "Changes over time", "Python, R"),
)
"""Files on the map of the campaign, and those in its local frame or without one: name or pattern below the
folder of results, what it is, what opens it."""


def products_of(folder: Path, known: Sequence[Product]) -> list[tuple[Path, str, str]]:
    """Those of the known files that are there: path, what it is and of several alike which, what opens it."""
    by = "INS and GNSS" if (folder / "ingest/ins.integrity.json").exists() else "GNSS"
    found = []
    for name, words, use in known:
        paths = sorted(folder.glob(name))
        for path in paths:
            which = f", {path.stem.rpartition('_')[2]}" if len(paths) > 1 else ""
            words = _of_best(path) or words if words == BEST else words
            found.append((path, words.replace("INS and GNSS", by) + which, use))
    return found


def _of_best(path: Path) -> str:
    """What the cloud is of which that by the best trajectory was made; "" where nothing tells."""
    made_of = path.with_name(f"{path.name}.meta.json")
    inputs = read_json(made_of)["inputs"] if made_of.exists() else ()
    return next((words for name, words, _ in OWN_FILES for each in inputs if each.endswith(name)), "")
