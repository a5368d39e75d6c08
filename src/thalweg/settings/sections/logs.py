"""Section ``logs``: the files that the instruments wrote."""

import re
from pathlib import Path
from typing import Annotated, Final, Literal, Self

from pydantic import Field

from thalweg.settings.sections.base import Finite, Section, Vector3
from thalweg.settings.sections.light_sheet import SCAN_PARTS, ScanName, SheetScan, scan_stream

Files = tuple[Annotated[str, Field(min_length=1)], ...]
"""Paths or glob patterns, as in the file; absolute paths once the campaign is loaded."""

STREAM_KEYS = {
    "lidar": ("lidar",),
    "ins": ("ins",),
    "rover": ("gnss", "rover"),
    "base": ("gnss", "base"),
    "nav": ("gnss", "nav"),
    "pos": ("positions",),
    "sbet": ("sbet",),
    "smrmsg": ("smrmsg",),
    "depth": ("depth",),
    "reference": ("reference",),
    "cloud": ("cloud",),
    "bed": ("bed",),
    "decisions": ("decisions",),
    "centre_line": ("centre_line",),
    "bank_lines": ("bank_lines",),
    "uav": ("uav",),
    "geoid": ("geoid",),
    "soundings": ("soundings",),
    "reference_bed": ("reference_bed",),
    "field": ("calibration", "field"),
    "reference_images": ("calibration", "reference_images"),
    "position_images": ("calibration", "position_images"),
    "position_scans": ("calibration", "position_scans"),
    "run_images": ("calibration", "run_images"),
    "image_times": ("calibration", "image_times"),
    "board_images": ("calibration", "board_images"),
    "board_scans": ("calibration", "board_scans"),
    "board_camera": ("calibration", "board_camera"),
    "clock_ties": ("calibration", "clock_ties"),
    "trigger_pulses": ("calibration", "trigger_pulses"),
    "display": ("calibration", "display"),
    "display_labels": ("calibration", "display_labels"),
    "time_lapse": ("time_lapse", "images"),
    "time_lapse_times": ("time_lapse", "times"),
    "control_points": ("time_lapse", "control_points"),
    "image_marks": ("time_lapse", "marks"),
    "masks": ("time_lapse", "masks"),
    "finished_orientations": ("time_lapse", "orientations"),
    "interior": ("time_lapse", "interior"),
    "rig_images": ("rig", "images"),
    "rig_times": ("rig", "times"),
    "rig_calibration": ("rig", "calibration"),
    "rig_field": ("rig", "field"),
    "rig_field_images": ("rig", "field_images"),
    "rig_field_points": ("rig", "field_points"),
    "camera_positions": ("time_lapse", "positions"),
    "fixed_marks": ("fixed_camera", "marks"),
    "fixed_points": ("fixed_camera", "control_points"),
    "fixed_interior": ("fixed_camera", "interior"),
    "sheet_sensor": ("light_sheet", "sensor"),
    "camera_field": ("light_sheet", "camera_field"),
    "camera_field_images": ("light_sheet", "camera_field_images"),
    "camera_field_marks": ("light_sheet", "camera_field_marks"),
    "camera_marks": ("light_sheet", "camera_marks"),
    "mark_points": ("light_sheet", "mark_points"),
    "grid_images": ("light_sheet", "grid_images"),
    "grid": ("light_sheet", "grid"),
    "panel_images": ("light_sheet", "panel_images"),
    "panels": ("light_sheet", "panels"),
    "strip_images": ("light_sheet", "strip_images"),
    "strip_pulses": ("light_sheet", "strip_pulses"),
}
"""Stream name -> keys below ``logs``."""


FolderName = Annotated[str, Field(min_length=1, pattern=r"^[^/\\]+(/[^/\\]+)*$")]
"""A folder below the one that holds all images."""


def interior_stream(folder: str) -> str:
    """Stream of the interior orientation of a folder's camera."""
    return f"interior.{folder}"


class BasePosition(Section):
    """Geodetic position of the base antenna."""

    lat_deg: float = Field(
        ge=-90, le=90, allow_inf_nan=False, description="Latitude of the base antenna, degrees"
    )
    lon_deg: float = Field(
        ge=-180, le=180, allow_inf_nan=False, description="Longitude of the base antenna, degrees"
    )
    h_ell_m: Finite = Field(ge=-500, le=9000, description="Ellipsoidal height of the base antenna, metres")


class GnssLogs(Section):
    """Raw GNSS of the boat and of the base; paths as in `Logs`."""

    rover: Files = Field(default=(), description="Boat's receiver: SBP, or RINEX observations (ppk only)")
    base: Files = Field(
        default=(),
        description="Base: SBP or RINEX observations; empty if corrections are inside the rover's SBP",
    )
    nav: Files = Field(default=(), description="RINEX navigation; empty if the SBP carries ephemerides")
    base_ecef_m: Vector3 | None = Field(
        default=None, description="Base antenna, earth-centred x, y, z, metres"
    )
    base_llh: BasePosition | None = Field(default=None, description="Base antenna, geodetic")
    base_from: Literal["sbp", "rinex_header"] | None = Field(
        default=None, description="Take the base antenna from the log: `sbp` messages or the `rinex_header`"
    )
    base_antenna_delta_enu_m: Vector3 = Field(
        default=(0.0, 0.0, 0.0),
        description="From the given base position to its antenna reference point: east, north, up, metres",
    )


class CalibrationLogs(Section):
    """Recordings of a calibration field; paths as in `Logs`. The run's other logs stand there."""

    field: Files = Field(
        default=(), description="Description of the field: cones, markers, scale bars, targets (YAML)"
    )
    reference_images: Files = Field(default=(), description="Images of the field by a hand-held camera")
    position_images: Files = Field(
        default=(), description="Image of the boat's camera at each static position, one a position"
    )
    position_scans: Files = Field(
        default=(), description="Lidar capture of each static position, in the order of position_images"
    )
    run_images: Files = Field(default=(), description="Images of the boat's camera during the dynamic run")
    image_times: Files = Field(
        default=(),
        description="Table of image times, if neither names nor EXIF have them (CSV: file, and one of "
        "time_utc in ISO 8601, unix_s, t_gps_s)",
    )
    board_images: Files = Field(
        default=(), description="Images of a checkerboard that camera and lidar see, one a pose"
    )
    board_scans: Files = Field(
        default=(), description="Lidar recording of each pose: capture or PCD, in the order of board_images"
    )
    board_camera: Files = Field(
        default=(), description="Interior orientation for board_images: calibration, OpenCV or COLMAP file"
    )
    clock_ties: Files = Field(
        default=(),
        description="Comparisons of the camera's clock with GPS time before and after the run (CSV)",
    )
    trigger_pulses: Files = Field(
        default=(), description="GPS times of the pulses that triggered the camera (CSV: t_gps_s)"
    )
    display: Files = Field(default=(), description="Photographs of a running clock")
    display_labels: Files = Field(
        default=(), description="What a few of these photographs show (CSV: file, text)"
    )


class TimeLapseLogs(Section):
    """Images of the bank along the survey; paths as in `Logs`."""

    images: Files = Field(default=(), description="Photographs of the boat's camera: a folder, or files")
    times: Files = Field(
        default=(),
        description="Table of image times, if neither names nor EXIF have them (CSV: file, and one of "
        "time_utc in ISO 8601, unix_s, t_gps_s), or the log of an autopilot that triggered each of them",
    )
    control_points: Files = Field(
        default=(),
        description="Surveyed points on the bank (CSV: id; east_m, north_m, up_m in the world frame, or "
        "lat_deg, lon_deg, h_ell_m, or x, y, z in campaign.crs; sigmas; role control or check)",
    )
    marks: Files = Field(
        default=(),
        description="Where control points were measured in images (CSV: image, point, x_px, y_px; or as "
        "Metashape and OpenDroneMap write them), instead of finding them automatically",
    )
    masks: Files = Field(
        default=(),
        description="Folder of masks made elsewhere, PNG with 0 where an image is not to be used; they win "
        "over automatic ones",
    )
    interior: Files = Field(
        default=(),
        description="Interior orientation of the camera: calibration, OpenCV or COLMAP file; without one, "
        "that of `mounts.calibration`, else it is estimated from the images",
    )
    interiors: dict[FolderName, Files] = Field(
        default={},
        description="The same for cameras whose images have a folder of their own: folder, as the images' "
        "names begin, and its file, such as `left: [left.yaml]`",
    )
    positions: Files = Field(
        default=(),
        description="Where the camera was at each photograph, of photographs without a boat (CSV: image; "
        "lat_deg, lon_deg, h_ell_m, or x, y, z in campaign.crs; sigmas), beside control points or in place "
        "of them",
    )
    orientations: Files = Field(
        default=(),
        description="Finished exterior orientations of the images instead of our own: COLMAP model, "
        "Metashape cameras (XML), or a table with omega, phi, kappa",
    )


class RigLogs(Section):
    """Files of a camera with two fisheye lenses; paths as in `Logs`."""

    images: Files = Field(
        default=(), description="Files with both image circles, of the survey: a folder, or files"
    )
    times: Files = Field(
        default=(),
        description="Table of their times, if neither names nor EXIF have them, as `time_lapse.times`",
    )
    calibration: Files = Field(
        default=(),
        description="Calibration of the rig: `front_interior`, `back_interior`, `back_front` (YAML); without "
        "one it is calibrated from `field_images`",
    )
    field: Files = Field(
        default=(), description="Description of the markers of a field around the rig (YAML)"
    )
    field_images: Files = Field(default=(), description="Files of the rig amid the field: a folder, or files")
    field_points: Files = Field(
        default=(),
        description="Coordinates of the marks of the field (CSV: mark, x_m, y_m, z_m and sigmas), as the "
        "adjustment of a calibration field writes them",
    )


class FixedCameraLogs(Section):
    """Pictures of a camera that stays, such as before a glacier; paths as in `Logs`."""

    marks: Files = Field(
        default=(),
        description="Where control points are in the pictures: one table (CSV: image, point, x_px, y_px), or "
        "a table for each picture that is called like it (CSV: label, x, y)",
    )
    control_points: Files = Field(
        default=(), description="Surveyed points, as for `time_lapse.control_points`"
    )
    interior: Files = Field(
        default=(),
        description="Interior orientation of the camera: calibration, OpenCV or COLMAP file; none: the "
        "points tell it (`images.fixed_camera.free`)",
    )


class LightSheetLogs(Section):
    """Recordings of the underwater light-sheet sensor in a basin; paths as in `Logs`."""

    sensor: Files = Field(
        default=(),
        description="Design of the sensor: lens as calibrated, places of camera and laser, window (YAML)",
    )
    camera_field: Files = Field(
        default=(),
        description="Markers and scale bars of a field that the sensor's camera photographed in air, for its "
        "interior orientation (YAML, as for a calibration field); none: that of `sensor` counts",
    )
    camera_field_images: Files = Field(default=(), description="These pictures: files, or a folder")
    camera_field_marks: Files = Field(
        default=(),
        description="Marks in these pictures by another program, instead of them (CSV: file, marker, corner, "
        "x_px, y_px, sigma_px)",
    )
    camera_marks: Files = Field(
        default=(),
        description="Marks on object and window in an image of the sensor's camera through air (CSV: marker, "
        "corner, x_px, y_px, sigma_px)",
    )
    mark_points: Files = Field(
        default=(), description="Coordinates of these marks from a bundle with scale bars (CSV, metres)"
    )
    grid_images: Files = Field(
        default=(), description="The image of the laser on the grid object: a file, or the folder it is in"
    )
    grid: Files = Field(default=(), description="The grid object and the depths of its levels (YAML)")
    panel_images: Files = Field(
        default=(), description="Images of the laser on a plane panel: files, or a folder"
    )
    panels: Files = Field(
        default=(), description="Depths of the panel by image (CSV: file, depth_mm, sigma_mm)"
    )
    strip_images: Files = Field(
        default=(),
        description="Images of the bed by the sensor on the boat, of a survey: files in order, or a folder",
    )
    strip_pulses: Files = Field(
        default=(), description="GPS times of the pulses that triggered these images (CSV: t_gps_s)"
    )
    scans: dict[ScanName, SheetScan] = Field(
        default={}, description="Scanned objects by name, each with the keys below"
    )

    @property
    def given(self) -> tuple[str, ...]:
        """Keys that name files of a basin; the strip of the bed belongs to a survey."""
        return tuple(
            name for name in type(self).model_fields if getattr(self, name) and not name.startswith("strip_")
        )


_TOPIC: Final = re.compile(r"#((?:/\w+)+)$")
"""A topic behind a file: names of ROS have no dots, so that a folder called ``C#`` is none."""
_OF_CONTAINERS: Final = frozenset({"lidar", "ins", "pos", "depth"})
"""Streams that a topic of a container may give."""


class Logs(Section):
    """Files of each stream, in order of time. Relative to this file or absolute; ``~`` and globs work.

    Of a bag with several topics of one kind ``file.bag#/topic`` is the one that is meant.
    """

    lidar: Files = Field(default=(), description="Velodyne captures: pcap, pcapng or bare payloads")
    ins: Files = Field(
        default=(),
        description="Logs of the INS (ANPP), of an autopilot (ArduPilot), bags of ROS, tables of poses",
    )
    gnss: GnssLogs = Field(default=GnssLogs(), description="Raw GNSS of boat and base")
    positions: Files = Field(
        default=(), description="Positions of the boat's antenna: RTKLIB .pos files, or NMEA 0183"
    )
    sbet: Files = Field(default=(), description="Applanix SBET trajectories")
    smrmsg: Files = Field(default=(), description="Standard deviations that belong to the SBET files")
    gps_week: int | None = Field(
        default=None, ge=1024, le=4095, description="GPS week of the SBET's first record, not modulo 1024"
    )
    depth: Files = Field(default=(), description="Echo sounder, NMEA 0183")
    depth_date: str | None = Field(
        default=None,
        pattern=r"^\d{4}-\d{2}-\d{2}$",
        description="UTC date `YYYY-MM-DD` of the first sounding, for NMEA logs without date",
    )
    reference: Files = Field(default=(), description="Reference clouds: LAS, LAZ, PLY, E57")
    cloud: Files = Field(
        default=(),
        description="A finished cloud that is compared with `reference`, without other logs: LAS, LAZ, PLY, "
        "E57, PCD, text of x y z",
    )
    bed: Files = Field(
        default=(),
        description="Surveyed points of the river bed, for the place of the echo sounder: CSV with east_m, "
        "north_m, h_ell_m in campaign.crs and sigma_m",
    )
    decisions: Files = Field(
        default=(),
        description="Decisions by hand about soundings: CSV with t_from_s, t_to_s (GPS time), keep",
    )
    centre_line: Files = Field(
        default=(),
        description="Centre line of the river, downstream: CSV with east_m, north_m in campaign.crs, or one "
        "line of a GIS; else from banks and track",
    )
    bank_lines: Files = Field(
        default=(),
        description="Bank lines with `side: left` and `right` (GeoJSON, Shapefile, GeoPackage, KML, GML, "
        "DXF); else where the ground of the cloud meets the water",
    )
    uav: Files = Field(
        default=(),
        description="Clouds of the surroundings, such as photogrammetry from the air: LAS, LAZ in the local "
        "frame, campaign.crs or a CRS of their own, ellipsoidal heights",
    )
    geoid: Files = Field(
        default=(),
        description="Grid of a geoid for `fusion.vertical`, heights above the ellipsoid: GeoTIFF or .gtx, as "
        "geodetic services and PROJ hand them out",
    )
    soundings: Files = Field(
        default=(),
        description="Soundings of others, further data of the bed: CSV, text of x y z or points of a GIS in "
        "campaign.crs; section bathymetry.table says which column they are in",
    )
    reference_bed: Files = Field(
        default=(),
        description="Surfaces or points that the bed is compared with, such as a multibeam survey: GeoTIFF, "
        "LAS, LAZ, CSV, text of x y z, points of a GIS in campaign.crs, ellipsoidal heights",
    )
    time_lapse: TimeLapseLogs = Field(
        default=TimeLapseLogs(), description="Images of the bank, and control points"
    )
    fixed_camera: FixedCameraLogs = Field(
        default=FixedCameraLogs(), description="Pictures of a camera that stays, without other logs"
    )
    calibration: CalibrationLogs = Field(
        default=CalibrationLogs(), description="Recordings of a calibration field"
    )
    rig: RigLogs = Field(default=RigLogs(), description="Files of a camera with two fisheye lenses")
    light_sheet: LightSheetLogs = Field(
        default=LightSheetLogs(), description="Recordings of the underwater light-sheet sensor in a basin"
    )

    @property
    def kind(self) -> Literal["boat", "photographs", "fixed_camera", "cloud"]:
        """What was recorded: by a boat, or photographs, a camera that stays or a finished cloud alone."""
        if any(getattr(self.fixed_camera, name) for name in FixedCameraLogs.model_fields):
            return "fixed_camera"
        if self.cloud:
            return "cloud"
        moved = (self.lidar, self.ins, self.gnss.rover, self.positions, self.sbet, self.depth)
        apart = self.light_sheet.given or self.calibration != CalibrationLogs()
        return "photographs" if self.time_lapse.images and not any(moved) and not apart else "boat"

    def files(self, stream: str) -> tuple[str, ...]:
        """Paths of one stream, named as in `STREAM_KEYS`, with their topics."""
        value: object = self
        for key in self.streams()[stream]:
            value = value[key] if isinstance(value, dict) else getattr(value, key)
        return value if isinstance(value, tuple) else ()

    def named(self, stream: str) -> list[tuple[str, str]]:
        """Path and topic of each entry of a stream; the topic is empty where the whole file is meant.

        Examples
        --------
        >>> Logs(lidar=("day1.bag#/os/points", "C#/day2.bag")).named("lidar")
        [('day1.bag', '/os/points'), ('C#/day2.bag', '')]
        """
        topics = [_TOPIC.search(text) if stream in _OF_CONTAINERS else None for text in self.files(stream)]
        return [
            (text[: topic.start()], topic[1]) if topic else (text, "")
            for text, topic in zip(self.files(stream), topics, strict=True)
        ]

    def streams(self) -> dict[str, tuple[str, ...]]:
        """Stream name -> keys below ``logs``: `STREAM_KEYS`, folders' interiors, the parts of all scans."""
        interiors = {
            interior_stream(folder): ("time_lapse", "interiors", folder)
            for folder in self.time_lapse.interiors
        }
        scans = {
            scan_stream(name, part): ("light_sheet", "scans", name, part)
            for name in self.light_sheet.scans
            for part in SCAN_PARTS
        }
        return STREAM_KEYS | interiors | scans

    def with_files(self, files: dict[str, tuple[str, ...]]) -> Self:
        """A copy with other paths."""
        top = {keys[0]: files[s] for s, keys in STREAM_KEYS.items() if len(keys) == 1 and s in files}
        below: dict[str, Section] = {}
        for group in dict.fromkeys(keys[0] for keys in STREAM_KEYS.values() if len(keys) > 1):
            nested = {keys[1]: files[s] for s, keys in STREAM_KEYS.items() if keys[0] == group and s in files}
            below[group] = getattr(self, group).model_copy(update=nested)
        below["light_sheet"] = below["light_sheet"].model_copy(
            update={"scans": {name: self._scan_with(name, files) for name in self.light_sheet.scans}}
        )
        interiors = self.time_lapse.interiors
        below["time_lapse"] = below["time_lapse"].model_copy(
            update={"interiors": {f: files.get(interior_stream(f), own) for f, own in interiors.items()}}
        )
        return self.model_copy(update={**top, **below})

    def _scan_with(self, name: str, files: dict[str, tuple[str, ...]]) -> SheetScan:
        given = {part: files[s] for part in SCAN_PARTS if (s := scan_stream(name, part)) in files}
        return self.light_sheet.scans[name].model_copy(update=given)


def is_rinex_name(path: Path) -> bool:
    """True for the usual names of RINEX observation files: ``.obs``, ``.rnx``, ``.21o``."""
    suffix = path.suffix.lower()
    return suffix in {".obs", ".rnx"} or (len(suffix) == 4 and suffix[1:3].isdigit() and suffix[3] == "o")
