"""Which files and settings the rules of a campaign take: its logs, what depends on them, what `all` builds.

Rules ask by `CampaignFiles`, one for each chosen campaign. Methods give paths relative to the folder of the
run, as Snakemake wants them; a list is empty where a campaign does not have what a rule could take.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal

from thalweg.settings import Campaign, photographs_in
from thalweg.settings.sections import IMAGES_OF_JOB, LARGE_BLOCK, MOST_JOBS, Epoch, scan_stream

TwinLogs = Callable[[Campaign], Mapping[str, Sequence[str]]]
"""Logs that a digital twin writes: stream -> names below ``results/<campaign>/simulation/logs``."""

LogLength = Callable[[Sequence[str], Mapping[str, Any]], float]
"""Files of a lidar's log and options of its decoding -> about its length, seconds."""

ImageCount = Callable[[Campaign], int]
"""How many images the boat's camera of a digital twin takes."""

_STREAMS: Final = {"lidar": "lidar", "ins": "ins", "sbet": "ins", "sbp": "gnss", "depth": "depth"}
"""Logs, and how the rules that read them name their results."""
_POSITION_LOGS: Final = {"pos": "pos", "nmea": "pos", "gpx": "pos", "sbp": "sbp", "ppk": "rover"}
"""Sources of positions with files of their own."""
_CHAINS: Final = {"": "ins", "by_camera/": "camera", "by_fused/": "fused"}
"""Folder below those of clouds and of comparisons -> what the trajectory rests on."""
_OF_FOLDER: Final = {**_CHAINS, "by_strips/": "strips"}
"""The same with the cloud whose trajectory the bank has corrected."""
_WORDS_OF_CHAIN: Final = {
    "ins": "by INS",
    "camera": "by camera",
    "fused": "by all sensors",
    "strips": "by overlapping strips",
}
AUTO_WINDOW_S: Final = 1800.0
"""Windows of a log on a cluster: an hour of a VLP-16 is a few minutes' work, and each job takes seconds to
start."""
_FOR_GIS: Final = ("survey.gpkg", "survey.qgz")
_DELIVERED: Final = {
    "survey.qgz": "project for QGIS",
    "survey.gpkg": "track, soundings, river, or patches of change: layers for a GIS",
    "lidar/points_map.copc.laz": "point cloud in the map grid, COPC",
    "lidar/points_map.laz": "point cloud in the map grid, LAZ",
    "lidar/points.laz": "point cloud in the local frame, with standard deviations",
    "lidar/coloured.laz": "point cloud in the colours of photographs, local frame",
    "bathymetry/soundings.csv": "soundings in the map grid with uncertainties and order of IHO S-44",
    "bathymetry/bed.tif": "grid of the riverbed: height and standard deviation",
    "fusion/dtm.tif": "terrain model of bed and banks: height, standard deviation, source",
    "triangulation/strip/bed.laz": "strip of the bed by the light sheet",
    "orientation/trajectory.parquet": "trajectory with covariances, local frame",
    "orientation/trajectory_fused.parquet": "trajectory by all sensors with covariances, local frame",
    "orientation/track.geojson": "track by GNSS",
    "summary.csv": "key numbers",
}
"""Files to hand over with the report, and what they are."""
_SERIES: Final = {"calibration": "grid_images", "panels": "panel_images", "strip": "strip_images"}
"""Streams of the series of images of the light-sheet sensor that are no scans."""


def _no_length(files: Sequence[str], options: Mapping[str, Any]) -> float:
    """Length of logs where no reader is at hand."""
    return math.nan


def _with_parts(files: Iterable[str]) -> list[str]:
    """The files, then what belongs to a Shapefile of them: a new .dbf or .prj changes what it says."""
    found = list(files)
    for path in [Path(file) for file in found if file.lower().endswith(".shp")]:
        parts = [path.with_suffix(end) for end in (".shx", ".dbf", ".prj", ".cpg")]
        found += [str(part) for part in parts if part.exists()]
    return found


def _no_images(campaign: Campaign) -> int:
    """Images of a twin where no laboratory is at hand."""
    return 0


def _no_twin(campaign: Campaign) -> Mapping[str, Sequence[str]]:
    """Logs of a twin where no laboratory is at hand."""
    return {}


ERRORS_OF_CHAIN: Final = {
    "ins": "error_model.json",
    "camera": "errors_camera.npz",
    "fused": "errors_fused.npz",
    "strips": "errors_strips.npz",
}
"""What a survey shows of the errors of its trajectory, by the chain of sensors."""


@dataclass(frozen=True, slots=True)
class Product:
    """A product of a survey: its name and file, whether the logs make it, and which logs it needs."""

    name: str
    file: str
    made: bool
    needs: str


@dataclass(frozen=True, kw_only=True)
class CampaignFiles:
    """Files and settings of one campaign.

    Parameters
    ----------
    name : id of the campaign.
    campaigns : all chosen ones and those that they name, by id.
    twin_logs : names of the logs that a twin writes.
    twin_images : how many images the twin's boat takes.
    log_length_s : about how long a log of the lidar is, by its files and `lidar_options`; NaN: not known.
    on_cluster : jobs run on other machines, beside each other.
    """

    name: str
    campaigns: Mapping[str, Campaign]
    twin_logs: TwinLogs = _no_twin
    twin_images: ImageCount = _no_images
    log_length_s: LogLength = _no_length
    on_cluster: bool = False

    @cached_property
    def campaign(self) -> Campaign:
        """The settings of the campaign."""
        return self.campaigns[self.name]

    @cached_property
    def plain(self) -> dict[str, Any]:
        """All settings as plain values, as Snakemake compares them; not to be changed."""
        return self.campaign.plain()

    def of(self, name: str) -> "CampaignFiles":
        """The files of another campaign."""
        return replace(self, name=name)

    def _result(self, name: str) -> str:
        return f"results/{self.name}/{name}"

    def where(self, condition: Callable[["CampaignFiles"], object], *names: str) -> list[str]:
        """Those results of the campaign where one of its methods says yes, else none."""
        return self._where(condition(self), *names)

    def _where(self, condition: object, *names: str) -> list[str]:
        """Those results of the campaign where the condition holds, else none."""
        return [self._result(name) for name in names] if condition else []

    # ------------------------------------------------------------ settings

    def section(self, *keys: str) -> Any:
        """A section of the settings, or a part of one, as plain values."""
        found: Any = self.plain
        for key in keys:
            found = found[key]
        return found

    def without(self, section: str, *keys: str) -> dict[str, Any]:
        """A section without keys that a job does not depend on: a change of them runs nothing again."""
        return {key: value for key, value in self.plain[section].items() if key not in keys}

    def comparison(self) -> dict[str, Any]:
        """The section `accuracy` without the cross sections, which are a picture's."""
        return self.without("accuracy", "sections")

    @cached_property
    def _n_images(self) -> int:
        """Images of the boat's camera, or photographs without a boat."""
        if self.campaign.twin is not None:
            return self.twin_images(self.campaign)
        return sum(1 for _ in photographs_in(self.logs("time_lapse")))

    def n_parts(self, of: Literal["features", "mapping"]) -> int:
        """Jobs among which the images, or their pairs, are dealt out."""
        stated = getattr(self.campaign.images, of).parts
        if stated != "auto":
            return int(stated)
        return min(max(math.ceil(self._n_images / IMAGES_OF_JOB), 1), MOST_JOBS)

    def mapper_threads(self) -> int:
        """Of structure from motion: large blocks have parts of their own, mapped at the same time."""
        parts = min(self.n_parts("mapping"), 8) if self._n_images > LARGE_BLOCK else 1
        return max(parts, 1 if self.campaign.images.mapping.repeatable else 2)

    def identity(self, *keys: str) -> dict[str, Any]:
        """Only those keys of the section `campaign`, so that a new title reruns pictures alone."""
        return {key: self.plain["campaign"][key] for key in keys}

    def mounts(self, *sensors: str) -> dict[str, Any]:
        """Only the mounts of those sensors."""
        return {sensor: self.plain["mounts"][sensor] for sensor in sensors}

    def lidar_options(self) -> dict[str, Any]:
        """How the lidar is decoded; its stated time is known to the job that makes its clock."""
        return self.without("lidar", "clock") | {"topics": self.topics("lidar")}

    def topics(self, stream: str) -> list[str]:
        """Topics of bags that the campaign names for a stream."""
        return self.campaign.topics(stream)

    def georeferencing(self) -> dict[str, Any]:
        """The section `georeferencing` without the wish for a map.

        Comparisons with a reference or with a twin's truth need the full covariance of each point.
        """
        options = self.without("georeferencing", "export_map")
        options["correlations"] |= self.has_reference() or self.is_twin() or self.is_epoch()
        return options

    def twin_parts(self, *parts: str) -> dict[str, Any]:
        """Those sections of the twin, and its size, start and length.

        A job that names the parts it needs does not run again for a change in another.
        """
        twin = self.plain["twin"]
        return {key: twin[key] for key in ("size", "start_utc", "duration_s", "field", *parts)}

    def log_option(self, key: str) -> Any:
        """A plain value of the section `logs`; None for a twin."""
        logs = self.plain["logs"]
        return logs[key] if logs else None

    def track_options(self) -> dict[str, Any]:
        """What files of poses do not state."""
        stated = {key: self.plain["ins"][key] for key in ("body_axes", "time_scale", "upside_down")}
        return {"gps_week": self.log_option("gps_week"), "topics": self.topics("ins"), **stated}

    def base_position(self) -> dict[str, Any]:
        """How the campaign file states the position of the base; a twin's base does in its own file."""
        logs = self.plain["logs"]
        if not logs:
            return {"base_from": "rinex_header"} if self.position_source() == "ppk" else {}
        return {k: v for k, v in logs["gnss"].items() if k.startswith("base_")}

    # ------------------------------------------------------------ windows of a long log

    @cached_property
    def _window_s(self) -> float:
        """Length of the windows of the lidar's log, seconds; infinite where it stays whole."""
        asked = self.campaign.scatter.seconds
        if asked == "auto":
            return AUTO_WINDOW_S if self.on_cluster else math.inf
        return asked

    @cached_property
    def _n_windows(self) -> int:
        """Windows into which the lidar's log is cut."""
        if math.isinf(self._window_s) or not self.has_lidar():
            return 1
        if self.campaign.twin is not None:
            length_s = self.campaign.twin.duration_s
        else:
            length_s = self.log_length_s(self.logs("lidar"), self.lidar_options())
        return 1 if math.isnan(length_s) else max(1, math.ceil(length_s / self._window_s))

    def windows(self, chain: str, name: str, ending: str) -> list[str]:
        """That file of each window of the lidar's log; none where it stays whole."""
        chain = _OF_FOLDER.get(chain, chain)
        numbers = range(self._n_windows if self._n_windows > 1 else 0)
        return [self._result(f"lidar/windows/{chain}_{name}_{part}{ending}") for part in numbers]

    def window(self, part: str) -> dict[str, Any]:
        """A window of the lidar's log, as `thalweg.ingest.LogWindow` takes it."""
        return {"index": int(part), "count": self._n_windows, "seconds": self._window_s}

    # ------------------------------------------------------------ logs

    def is_twin(self) -> bool:
        """True if the digital twin writes the logs; of epochs: of one of them."""
        epochs = (self.of(name).is_twin() for name in self._surveys())
        return self.campaign.twin is not None or any(epochs)

    def logs(self, stream: str) -> list[str]:
        """Files of a stream: the twin's, or those that the campaign file names."""
        if self.campaign.twin is not None:
            known = self.twin_logs(self.campaign)
            return [self._result(f"simulation/logs/{log}") for log in known.get(stream, ())]
        return [str(path) for path in self.campaign.log_files(stream)]

    def drawn(self, stream: str) -> list[str]:
        """Files of lines of a stream, those first that are read."""
        return _with_parts(self.logs(stream))

    def boat_trajectory(self) -> list[str]:
        """The trajectory of the boat, where there is one."""
        return self._where(self._is_survey(), "orientation/trajectory.parquet")

    def has_reference(self) -> bool:
        """True if there are reference clouds, and a cloud to compare with them."""
        return bool(self.logs("reference")) and self.has_lidar()

    def has_lidar(self) -> bool:
        """True if a lidar was recorded."""
        return bool(self.logs("lidar"))

    def motion_tells_time(self) -> bool:
        """True if the motion of the boat tells the time of the lidar."""
        return self.has_lidar() and self.campaign.lidar.clock.source == "motion"

    def streams_before_poses(self) -> list[str]:
        """The common time axis, where it can be known before the poses."""
        return self._where(not self.motion_tells_time(), "timing/streams.csv")

    def ins_points(self) -> list[str]:
        """The cloud by INS and GNSS, where there is a lidar."""
        return self._where(self.has_lidar(), "lidar/points.laz")

    def counts_of_points(self) -> list[str]:
        """What became of the points of the lidar, where there is one."""
        return self._where(self.has_lidar(), "lidar/counts.csv")

    def has_divergence(self) -> bool:
        """True if it is known how wide the beam of the lidar grows."""
        return self.has_lidar() and self.campaign.lidar_accuracy.divergence_mrad > 0

    def position_source(self) -> str:
        """Where the positions come from."""
        return self.campaign.orientation.position_source

    def stated_positions(self) -> dict[str, Any]:
        """What is stated of positions whose log states none; section `ins` has the sigmas of its own."""
        found = {key: self.plain["orientation"][key] for key in ("sigma_position_m", "antenna_h_ell_m")}
        if self.position_source() in ("ins", "sbet"):
            found["sigma_position_m"] = self.plain["ins"]["sigma_position_m"]
        return found

    def ins_logs(self) -> list[str]:
        """The files that hold attitudes, ANPP or SBET."""
        return self.logs("sbet" if self.position_source() == "sbet" else "ins")

    def smrmsg_logs(self) -> list[str]:
        """The standard deviations of an SBET, where there are any."""
        return self.logs("smrmsg") if self.position_source() == "sbet" else []

    def position_logs(self) -> list[str]:
        """The files of the position source itself; none if the INS states hold them."""
        source = self.position_source()
        stream = _POSITION_LOGS.get(source)
        found = self.logs(stream) if stream else []
        return found or (self.logs("depth") if source == "nmea" else [])

    def ins_states(self) -> list[str]:
        """The states of the INS, where there is one."""
        return self._where(self.ins_logs(), "ingest/ins_states.parquet")

    def ppk_logs(self, stream: Literal["base", "nav"]) -> list[str]:
        """Raw GNSS of the base, or navigation files, where PPK needs them."""
        return self.logs(stream) if self.position_source() == "ppk" else []

    def reports(self) -> list[str]:
        """The integrity reports of all streams."""
        found = dict.fromkeys(result for stream, result in _STREAMS.items() if self.logs(stream))
        return [self._result(f"ingest/{stream}.integrity.json") for stream in [*found, "positions"]]

    # ------------------------------------------------------------ calibration of the boat

    def calibration_file(self) -> list[str]:
        """The calibration of the boat that the campaign names, if any."""
        chosen = self.campaign.mounts.calibration
        if chosen is None:
            return []
        return [f"results/{chosen}/calibration/boat.yaml" if chosen in self.campaigns else chosen]

    def calibration_campaign(self) -> str | None:
        """Id of the calibration campaign that the campaign names; None if it names a file or none."""
        chosen = self.campaign.mounts.calibration
        return chosen if chosen in self.campaigns else None

    def boat_images(self) -> list[str]:
        """Images of the boat's camera in the calibration field."""
        return self.logs("position_images") + self.logs("run_images")

    def marked_images(self, marked: Literal["reference", "boat", "camera_field"]) -> list[str]:
        """Images with printed markers: of the reference, of the boat, of the light-sheet sensor."""
        if marked == "boat":
            return self.boat_images()
        return self.logs("reference_images" if marked == "reference" else "camera_field_images")

    def marked_field(self, marked: Literal["reference", "boat", "camera_field"]) -> list[str]:
        """The description of the markers in them."""
        return self.logs("camera_field" if marked == "camera_field" else "field")

    def boat_interior(self) -> list[str]:
        """The interior orientation of the boat's camera that the campaign names, if any."""
        chosen = self.campaign.calibration.boat_camera.interior
        return [] if chosen is None else [chosen]

    def run_settings(self) -> dict[str, Any]:
        """How the run about the cones is evaluated."""
        found = self.plain["calibration"]
        options = found["ins_lidar"]
        sigma_m = self.plain["lidar_accuracy"]["sigma_component_m"]
        return {
            "errors": found["run_errors"],
            "noise": {"along_m": sigma_m, "across_m": sigma_m},
            "search": {"lever_m": options["search_lever_m"], "angle_deg": options["search_angle_deg"]},
            "gates": {key: options[key] for key in ("min_cones", "min_headings_deg")},
            "form_sigma_m": found["camera_lidar"]["form_sigma_m"],
            "estimate_errors": options["estimate_errors"],
        }

    def ins_lidar_settings(self) -> dict[str, Any]:
        """How the run about the cones is evaluated, the lidar's stamps included."""
        return self.run_settings() | {"sigma_time_s": self.plain["calibration"]["ins_lidar"]["sigma_time_s"]}

    def clock_options(self) -> dict[str, Any]:
        """How the camera's clock is found."""
        found = self.plain["calibration"]
        errors = ("position_time_s", "attitude_time_s", "white_share")
        return found["clock"] | {key: found["run_errors"][key] for key in errors}

    def echo_settings(self) -> dict[str, Any]:
        """How soundings over a surveyed bed are evaluated."""
        found = self.plain["calibration"]
        return found["echo_sounder"] | {"errors": found["run_errors"]}

    def echo_place(self) -> dict[str, Any]:
        """Where the echo sounder sits by the ruler."""
        mounts = self.plain["mounts"]
        place = mounts["echo_sounder"]
        return {
            "lever_ics_m": place["lever_ics_m"],
            "sigma_lever_m": place["sigma_lever_m"],
            "sigma_antenna_m": mounts["antenna"]["sigma_lever_m"],
        }

    def echo_outputs(self) -> list[str]:
        """The place of the echo sounder, where the bed was surveyed."""
        return self._where(self.logs("bed"), "calibration/echo_sounder.yaml")

    def board_settings(self) -> dict[str, Any]:
        """How poses of a board are evaluated."""
        return {"flatness_m": self.plain["calibration"]["board"]["flatness_m"]}

    def clock_ties(self) -> list[str]:
        """Comparisons of the camera's clock, and pulses of its trigger."""
        return self.logs("clock_ties") + self.logs("trigger_pulses")

    def _calibrating(self) -> "CampaignFiles":
        """The calibration that the campaign names, or the campaign itself."""
        return self.of(self.calibration_campaign() or self.name)

    def camera_clock(self) -> list[str]:
        """The clock of the boat's camera, where a calibration has found it."""
        it = self._calibrating()
        found = it.campaign.is_calibration and it.logs("run_images") and not self.is_by_rig()
        return it._where(found, f"timing/camera_clock{'_ties' if found and it.clock_ties() else ''}.yaml")

    def clock_stability(self) -> list[str]:
        """The test of the camera's clock, where there is one."""
        it = self._calibrating()
        return it._where(it.campaign.is_calibration and it.logs("display"), "timing/clock_stability.json")

    def tied_images(self) -> list[str]:
        """The times of a calibration's own images by ties or pulses, where it has them."""
        found = self.campaign.is_calibration and self.logs("run_images") and self.clock_ties()
        return self._where(found, "timing/image_times_ties.parquet")

    def calibrated_interior(self) -> list[str]:
        """The camera's interior orientation from a file or from the calibration, if any."""
        if self.is_by_rig():
            return []
        given = self.logs("interior")
        chosen = self.calibration_campaign()
        if not given and chosen and self.of(chosen).has_boat_camera():
            return [f"results/{chosen}/calibration/camera.yaml"]
        return given[:1]

    def has_run(self) -> bool:
        """True if a calibration has a dynamic run: lidar and INS of the moving boat."""
        return bool(self.logs("lidar") and self.logs("ins"))

    def has_static_camera(self) -> bool:
        """True with camera and lidar at static positions: they relate both, and the antenna to the lidar."""
        return bool(self.logs("position_images") and self.logs("position_scans"))

    def has_boat_camera(self) -> bool:
        """True if a calibration has images of the boat's camera."""
        return bool(self.boat_images())

    def has_kinematic_clock(self) -> bool:
        """True if the clock of the camera comes from its images of the run."""
        return self.has_run() and bool(self.logs("run_images")) and not self.clock_ties()

    def of_static_camera(self, file: str) -> list[str]:
        """A result of the static positions, where the campaign has them."""
        return self._where(self.has_static_camera(), f"calibration/{file}")

    def calibration_truth(self) -> list[str]:
        """Errors of a twin's calibration against its true places."""
        return self._where(self.is_twin(), "accuracy/calibration_truth.csv")

    def calibration_facts(self) -> list[str]:
        """Reports of the jobs of a calibration that its page quotes."""
        return [
            self._result("calibration/field.json"),
            *self._where(self.has_boat_camera(), "calibration/camera.json"),
            *self._where(self.has_kinematic_clock(), "timing/camera_clock.json"),
            *self.clock_stability(),
            *self._where(self.has_run(), "calibration/ins_lidar.json"),
        ]

    def found_calibrations(self) -> list[str]:
        """Files of calibrated sensors that a calibration makes."""
        return [
            *self._where(self.has_run(), "calibration/boat.yaml", "calibration/ins_lidar.yaml"),
            *self._where(self.has_static_camera(), "calibration/camera_lidar.yaml"),
            *self._where(self.has_boat_camera(), "calibration/camera.yaml"),
            self._result("calibration/reference_camera.yaml"),
        ]

    def calibration_tables(self) -> list[str]:
        """Tables that the page of a calibration shows."""
        static = ("cones", "cone_detection", "cone_residuals", "cone_displacements")
        names = [
            *(static if self.has_static_camera() else ()),
            *(("passes",) if self.has_run() else ()),
            "reference_marks_rejected",
            *(("boat_marks_rejected",) if self.has_boat_camera() else ()),
        ]
        return [self._result(f"calibration/{name}.csv") for name in names]

    def _calibration_outputs(self) -> list[str]:
        outputs = self._where(self.logs("board_images"), "calibration/board_camera_lidar.yaml")
        outputs += self._where(self.has_rig_field(), "calibration/rig.yaml")
        if not self.logs("field"):
            return outputs
        outputs += self._where(self.has_static_camera(), "calibration/camera_lidar.yaml")
        outputs.append(self._result("calibration/index.html"))
        if self.has_run():
            outputs += self._where(True, "calibration/boat.yaml", "timing/time_report.csv")
            outputs += self.echo_outputs()
        return outputs + self.calibration_truth()

    # ------------------------------------------------------------ images of the bank

    def has_time_lapse(self) -> bool:
        """True if a survey by boat has images of the bank, whose cameras may have folders of their own."""
        return self.is_by_rig() or (bool(self.logs("time_lapse")) and self._is_survey())

    def is_by_rig(self) -> bool:
        """True if the files of a rig are the images that orient the boat, its front lens the camera."""
        return self.campaign.images.source == "rig" and self.has_panoramas()

    def stated_clock(self) -> dict[str, Any]:
        """What the campaign file states of the clock of the images."""
        found: dict[str, Any] = self.section(*(("rig",) if self.is_by_rig() else ("images",)), "clock")
        return found

    def rig_mount(self) -> dict[str, Any]:
        """Where the front lens sits, if it is the camera of the chain."""
        return self.plain["rig"]["mount"] if self.is_by_rig() else {}

    def camera_calibration(self) -> list[str]:
        """The calibration of the boat, if the camera of the chain is the one in it."""
        return [] if self.is_by_rig() else self.calibration_file()

    def stamped_images(self) -> list[str]:
        """The images of the boat's camera in motion, on the river or about the cones."""
        return self.rig_images() if self.is_by_rig() else self.logs("time_lapse") or self.logs("run_images")

    def stamp_tables(self) -> list[str]:
        """Tables of the times of those images."""
        if self.is_by_rig():
            return self.logs("rig_times")
        return self.logs("time_lapse_times") or self.logs("image_times")

    def stamp_option(self, key: str) -> Any:
        """How the times of those images are written."""
        if self.is_by_rig():
            return self.section("rig", "times", key)
        river = self.has_time_lapse()
        return self.section(*(("images", "times") if river else ("calibration", "image_times")), key)

    def known_interior(self) -> list[str]:
        """`calibrated_interior` for the size of the survey's images."""
        return self._where(self.calibrated_interior(), "orientation/camera_start.yaml")

    def interior_folders(self) -> list[str]:
        """Folders whose camera has an interior orientation of its own."""
        logs = self.campaign.logs
        return list(logs.time_lapse.interiors) if logs and not self.is_by_rig() else []

    def folder_interiors(self) -> list[str]:
        """Interior orientations of the cameras of single folders, in the order of these."""
        return [file for folder in self.interior_folders() for file in self.logs(f"interior.{folder}")]

    def feature_parts(self) -> list[str]:
        """The features of all parts of the images."""
        parts = range(self.n_parts("features"))
        return [self._result(f"orientation/sfm/features_{part}.npz") for part in parts]

    def pair_parts(self) -> list[str]:
        """The compared pairs of images of all parts."""
        parts = range(self.n_parts("mapping"))
        return [self._result(f"orientation/sfm/pairs_{part}.npz") for part in parts]

    def has_finished_orientations(self) -> bool:
        """True if another program has oriented the images of a survey."""
        return bool(self.logs("finished_orientations")) and not self.is_by_rig()

    def orients_alone(self) -> bool:
        """True if photographs without a boat are oriented here."""
        return self.campaign.kind == "photographs" and not self.has_finished_orientations()

    def orients_images(self) -> bool:
        """True if the images of the camera of a survey are oriented here."""
        return self.has_time_lapse() and not self._orienting()

    def _orienting(self) -> str:
        """Ending of poses that are no block of the boat's camera: of a rig, or by another program."""
        return "_rig" if self.is_by_rig() else "_finished" if self.has_finished_orientations() else ""

    def images_hold_positions(self) -> bool:
        """Whether the antenna's positions were observations of the image block."""
        return self.campaign.images.adjustment.antenna.use and not self.has_finished_orientations()

    def oriented_images(self) -> str:
        """Poses of the images, adjusted here or by another program."""
        return self._result(f"orientation/image_poses{self._orienting()}.parquet")

    def control_reports(self) -> list[str]:
        """The adjustment's report on control and check points, where there are control points."""
        given = self.logs("control_points") and not self._orienting()
        return self._where(given, "orientation/control_points.csv")

    # ------------------------------------------------------------ trajectories and what is made by each

    def best_chain(self) -> str:
        """What the best trajectory rests on: the bank where it is to, else what strips begin from."""
        return "strips" if self.adjusts_strips() and self.campaign.strips.use else self.chain_of_sensors()

    def chain_of_sensors(self) -> str:
        """All sensors where there are images of the bank, else the INS: strips begin from it.

        The camera alone is no third case: where it has a trajectory, all sensors together have one.
        """
        return "fused" if self.has_time_lapse() else "ins"

    def errors_of_sensors(self) -> str:
        """What the survey shows of the errors of that trajectory."""
        return self._result(f"orientation/{ERRORS_OF_CHAIN[self.chain_of_sensors()]}")

    def trajectory_of_sensors(self) -> str:
        """That trajectory."""
        return self.trajectory(self.chain_of_sensors())

    def best_trajectory(self) -> str:
        """The trajectory for everything that is placed by one and is no comparison of several."""
        return self.trajectory(self.best_chain())

    def trajectory(self, chain: str) -> str:
        """The boat's trajectory by ``ins``, ``camera`` or all sensors together (``fused``), or by folder."""
        chain = _CHAINS.get(chain, chain)
        return self._result(f"orientation/trajectory{'' if chain == 'ins' else f'_{chain}'}.parquet")

    def trajectory_of_lidar(self, chain: str) -> str:
        """The same for the lidar's points: of strips with the covariance of poses and mount together."""
        if _OF_FOLDER.get(chain, chain) == "strips":
            return self._result("orientation/trajectory_strips_lidar.parquet")
        return self.trajectory(chain)

    def mounts_of_chain(self, chain: str) -> str:
        """Places of the sensors; the camera and the bank tell those of the lidar themselves."""
        chain = _OF_FOLDER.get(chain, chain)
        own = chain in ("camera", "strips")
        return self._result(f"orientation/mounts_{chain}.json" if own else "calibration/mounts.json")

    def adjusts_strips(self) -> bool:
        """True if the bank is to correct the trajectory."""
        strips = self.campaign.strips
        return self.has_lidar() and self._is_survey() and (strips.adjust or strips.use)

    def aligned_strips(self) -> list[str]:
        """What that makes: the page, the cloud, and its comparison with a reference."""
        page = self._where(self.adjusts_strips(), "orientation/strips.html", "lidar/by_strips/points.laz")
        compared = self.adjusts_strips() and self.has_reference()
        return page + self._where(compared, "accuracy/by_strips/statistics.csv")

    def trajectories(self) -> list[str]:
        """Trajectories by INS, camera and all sensors, in this order, then by strips if adjusted."""
        return [self.trajectory(chain) for chain in self._compared().values()]

    def _compared(self) -> Mapping[str, str]:
        return _OF_FOLDER if self.adjusts_strips() else _CHAINS

    def of_chains(self, folder: str, name: str) -> list[str]:
        """A result of the clouds of these trajectories, in the same order."""
        return [self._result(f"{folder}/{part}{name}") for part in self._compared()]

    def of_compared_chains(self, name: str) -> list[str]:
        """The same of their comparison with a reference; nothing where there is none."""
        return self.of_chains("accuracy", name) if self.has_reference() else []

    def chain_steps(self) -> dict[str, list[str]]:
        """A result of each job that belongs to one chain alone; only the record beside it is read."""
        own = ("masks", "sfm/matches.npz", "sfm/block.npz", "control_marks.csv", "image_poses.parquet")
        other = self._orienting()
        oriented = (f"image_poses{other}.parquet",) if other else own
        names = {
            "ins": ("trajectory.parquet",),
            "camera": (*oriented, "image_poses_timed.parquet", "trajectory_camera.parquet"),
            "fused": ("trajectory_fused.parquet",),
        }
        if self.adjusts_strips():
            names["strips"] = ("trajectory_strips.parquet",)
        steps = {chain: [self._result(f"orientation/{name}") for name in own] for chain, own in names.items()}
        scattered = [] if other else [*self.feature_parts(), *self.pair_parts()]
        return steps | {"camera": [*scattered, *steps["camera"]]}

    # ------------------------------------------------------------ light-sheet sensor

    def sheet_interior(self) -> list[str]:
        """The calibrated interior orientation, where there are pictures of a marker field."""
        return self._where(self.logs("camera_field"), "triangulation/camera_interior.yaml")

    def sheet_lens_report(self) -> list[str]:
        """The report on that lens."""
        return self._where(self.logs("camera_field"), "triangulation/camera_interior.json")

    def camera_field_marks(self) -> list[str]:
        """Marks in the pictures of the marker field, detected unless they are given."""
        return self.logs("camera_field_marks") or [self._result("triangulation/camera_field_marks.parquet")]

    def sheet_lines(self, series: str) -> dict[str, Any]:
        """How lines are measured; on a grid object they come in short pieces, level beside level."""
        found = self.plain["light_sheet"]
        if series != "calibration":
            return dict(found["lines"])
        how = found["calibration"]
        return {**found["lines"], "lines": how["levels"], **how["pieces"]}

    def sheet_images(self, series: str) -> list[str]:
        """Images of a series of the sensor."""
        return self.logs(_SERIES.get(series, series))

    def sheet_series(self) -> list[str]:
        """Series of images of the sensor in a basin, in the order of the page."""
        return [s for s in ("calibration", "panels", *self.scan_names()) if self.sheet_images(s)]

    def has_series(self, series: str) -> bool:
        """True if there are images of that series."""
        return series in self.sheet_series()

    def of_sheet_series(self, table: str) -> list[str]:
        """That table of every series."""
        return [self._result(f"triangulation/{series}/{table}") for series in self.sheet_series()]

    def sheet_panels(self) -> list[str]:
        """The comparison with panels, where there are any."""
        return self._where("panels" in self.sheet_series(), "triangulation/panels.csv")

    def sheet_truth(self) -> list[str]:
        """The comparison with the true sensor of a twin."""
        return self._where(self.is_twin(), "accuracy/light_sheet_truth.csv")

    def scan_names(self) -> list[str]:
        """Names of the scanned objects."""
        logs = self.campaign.logs
        if logs is not None:
            return list(logs.light_sheet.scans)
        pairs = scan_stream("", "pairs")
        return [s.removesuffix(pairs) for s in self.twin_logs(self.campaign) if s.endswith(pairs)]

    def compared_scans(self) -> list[str]:
        """Names of the scans that have a reference."""
        return [scan for scan in self.scan_names() if self.scan_logs(scan, "reference")]

    def is_compared(self, scan: str) -> bool:
        """True if a scan has a reference."""
        return scan in self.compared_scans()

    def scan_logs(self, scan: str, part: str) -> list[str]:
        """A part of the recordings of a scan, see `thalweg.settings.sections.light_sheet`."""
        return self.logs(scan_stream(scan, part))

    def scan_levels(self, scan: str) -> list[float] | None:
        """Heights of the levels of a scanned object, mm; None if it is compared with a mesh."""
        levels: dict[str, list[float]] = self.plain["light_sheet"]["levels_mm"]
        return levels.get(scan)

    def sheet_scan_files(self) -> list[str]:
        """Tables and reports of all scans for the page on the sensor."""
        files = ("statistics.csv", "lines.csv", "facts.json", "profile.csv", "profile.json")
        return [
            self._result(f"triangulation/{scan}/{file}")
            for scan in self.scan_names()
            for file in ("counts.json", *(files if scan in self.compared_scans() else ()))
        ]

    def sheet_on_board(self) -> list[str]:
        """The calibrated light-sheet sensor that a boat carries."""
        chosen = self.campaign.light_sheet.sensor
        return [f"results/{chosen}/triangulation/sensor.yaml"] if chosen else []

    def sheet_design(self) -> list[str]:
        """A sensor whose camera took the images: the design, on a boat the calibrated one."""
        return self.logs("sheet_sensor") or self.sheet_on_board()

    def strip_truth(self, table: str) -> list[str]:
        """That table of errors of the strip of the bed, of a twin."""
        return self._where(self.is_twin(), f"accuracy/{table}")

    def has_strip(self) -> bool:
        """True if the boat carries a calibrated light-sheet sensor that recorded a strip of the bed."""
        return self.campaign.light_sheet.sensor is not None and bool(self.logs("strip_images"))

    def _strip_outputs(self) -> list[str]:
        """The strip of the bed by the light-sheet sensor, where the boat carries one."""
        if not self.has_strip():
            return []
        strip = self._where(True, "triangulation/strip/bed.laz", "triangulation/strip/index.html")
        return strip + self.strip_truth("truth_bed_strip.csv")

    def _basin_outputs(self) -> list[str]:
        outputs = self._where(
            True, "triangulation/sensor.yaml", "triangulation/budget.csv", "triangulation/index.html"
        )
        outputs += self._where(self.logs("panels"), "triangulation/panels.csv")
        outputs += self.sheet_truth()
        for scan in self.scan_names():
            outputs.append(self._result(f"triangulation/{scan}/points.parquet"))
        outputs += [self._result(f"triangulation/{scan}/profile.csv") for scan in self.compared_scans()]
        return outputs

    # ------------------------------------------------------------ riverbed

    def has_soundings(self) -> bool:
        """True if a survey of a river recorded depths."""
        return self._is_survey() and bool(self.logs("depth"))

    def has_bed(self) -> bool:
        """True if soundings make a riverbed: a lidar saw its banks, or they are given."""
        return self.has_soundings() and bool(self.has_lidar() or self.logs("bank_lines"))

    def _is_survey(self) -> bool:
        """True if a boat surveyed a river."""
        return self.campaign.kind == "survey"

    def has_colour_images(self) -> bool:
        """True if one camera of known interior orientation took photographs of the bank that a lidar scanned.

        Orientations from other programs may state none.
        """
        known = self.orients_images() or bool(self.calibrated_interior())
        return self.has_time_lapse() and self.has_lidar() and known and not self.interior_folders()

    def is_coloured(self) -> bool:
        """True if photographs of the boat's camera or of a rig give the cloud colours."""
        return self.has_colour_images() or (self.has_lidar() and self.has_panoramas())

    def colour_images(self) -> list[str]:
        """The photographs of the boat's camera, where they give colours."""
        return self.logs("time_lapse") if self.has_colour_images() else []

    def colour_camera(self) -> list[str]:
        """Their interior orientation."""
        return [self.adjusted_camera()] if self.has_colour_images() else []

    def colour_masks(self) -> list[str]:
        """Their masks."""
        return self.used_masks() if self.has_colour_images() else []

    def rig_images(self) -> list[str]:
        """The files of a calibrated rig."""
        return self.logs("rig_images") if self.has_panoramas() else []

    def rig_poses(self) -> list[str]:
        """Their poses: by all sensors together where the block is theirs, else by the boat's trajectory."""
        block = "orientation/image_poses_fused.parquet"
        return self._where(self.has_panoramas(), block if self.is_by_rig() else "panorama/poses.parquet")

    def rig_truth(self) -> list[str]:
        """The true rig of a twin, where it is the camera of the chain."""
        return self._where(self.is_by_rig() and self.is_twin(), "simulation/truth/rig.json")

    def used_rig(self) -> list[str]:
        """The calibration of the rig, where its files are used."""
        return self.rig_calibration() if self.has_panoramas() else []

    # ------------------------------------------------------------ a camera with two fisheye lenses

    def has_rig_field(self) -> bool:
        """True if the rig was recorded amid a field of marks."""
        return bool(
            self.logs("rig_field_images") and self.logs("rig_field") and self.logs("rig_field_points")
        )

    def rig_calibration(self) -> list[str]:
        """The calibration of the rig: the given one, of its own field, or by the calibration of the boat."""
        own = self._where(self.has_rig_field(), "calibration/rig.yaml")
        chosen = self.calibration_campaign()
        return (
            self.logs("rig_calibration")[:1] or own or (self.of(chosen).rig_calibration() if chosen else [])
        )

    def has_panoramas(self) -> bool:
        """True if a survey has files of a calibrated rig."""
        return self._is_survey() and bool(self.logs("rig_images") and self.rig_calibration())

    def rig_views(self) -> dict[str, Any]:
        """The section `rig` without mount and clock, which no picture depends on."""
        return self.without("rig", "mount", "times", "clock")

    def panorama_points(self) -> list[str]:
        """The cloud that says how far things are, where panoramas need it."""
        needed = self.campaign.panorama.mode == "depth" and self.has_lidar()
        return self.best_points() if needed else []

    def adjusted_camera(self) -> str:
        """The interior orientation that the poses of the images go with."""
        ending = "_finished" if self.has_finished_orientations() else ""
        return self._result(f"orientation/camera{ending}.yaml")

    def used_masks(self) -> list[str]:
        """The folder of the masks that orienting the images took, if they are oriented here."""
        return self._where(self.orients_images(), "orientation/masks")

    def adjustment_facts(self) -> list[str]:
        """Facts of the adjustment of photographs that are oriented here."""
        return self._where(self.orients_images(), "orientation/adjustment.json")

    def sounding_facts(self) -> list[str]:
        """What became of the soundings, where there are any."""
        return self._where(self.has_soundings(), "bathymetry/soundings.json")

    def bed_validation(self) -> list[str]:
        """How well the riverbed foretells what it did not see, where there is one."""
        return self._where(self.has_bed(), "bathymetry/validation.json")

    def best_errors(self) -> str:
        """What the survey shows of the errors of the best trajectory."""
        return self._result(f"orientation/{ERRORS_OF_CHAIN[self.best_chain()]}")

    def best_cloud(self) -> str:
        """The cloud by the best trajectory."""
        chain = self.best_chain()
        return self._result(f"lidar/{'' if chain == 'ins' else f'by_{chain}/'}points.laz")

    def best_points(self) -> list[str]:
        """The same, where there is a lidar."""
        return [self.best_cloud()] if self.has_lidar() else []

    def coloured(self) -> list[str]:
        """The cloud in colour, where photographs give any."""
        return self._where(self.is_coloured(), "lidar/coloured.laz")

    def colour_gains(self) -> list[str]:
        """Exposures of the photographs that give the cloud colours, and their numbers in it."""
        return self._where(self.is_coloured(), "lidar/coloured_gains.csv")

    def walk_points(self) -> list[str]:
        """The cloud over the panoramas of a walk, if there is a lidar."""
        return self.shown_points() if self.has_lidar() else []

    def shown_points(self) -> list[str]:
        """The cloud to look at: in colour, where photographs give any."""
        return self.coloured() or self.best_points()

    def page_clouds(self) -> list[str]:
        """The clouds of the page to look at them: by other trajectories, too; of a change its places."""
        if self.campaign.is_change:
            return self.of_pairs("changes_{}.laz")
        return [*self.shown_points(), *self._other_chains().values()]

    def page_names(self) -> list[str]:
        """What the page calls them."""
        if self.campaign.is_change:
            return [" to ".join(self._pair(pair)) for pair in self.epoch_pairs()]
        return [_WORDS_OF_CHAIN[chain] for chain in (self.best_chain(), *self._other_chains())]

    def page_path(self) -> list[str]:
        """The trajectory that they show, if a boat surveyed them."""
        return [self.best_trajectory()] if self._is_survey() else []

    def _other_chains(self) -> dict[str, str]:
        """Clouds by other trajectories than the best one."""
        if not self.has_lidar():
            return {}
        sensors = _CHAINS.values() if self.has_time_lapse() else ["ins"]
        made = [*sensors, *(["strips"] if self.adjusts_strips() else [])]
        folders = {chain: folder for folder, chain in _OF_FOLDER.items()}
        others = [chain for chain in made if chain != self.best_chain()]
        return {chain: self._result(f"lidar/{folders[chain]}points.laz") for chain in others}

    def bed_truth(self) -> list[str]:
        """Errors of the bed against the true one, of a twin."""
        return self._where(self.is_twin() and self.has_bed(), "accuracy/truth_riverbed.csv")

    def _bed_outputs(self) -> list[str]:
        outputs = ("bed.tif", "validation.json", "methods.csv", "index.html")
        made = self._where(self.has_soundings(), "bathymetry/soundings.parquet", "bathymetry/soundings.csv")
        made += self._where(self.has_bed(), *(f"bathymetry/{name}" for name in outputs))
        judged = ("accuracy/truth_dtm.csv", "accuracy/truth_soundings.csv")
        made += self._where(self.is_twin() and self.has_bed(), *judged)
        return [*made, *self.bed_truth(), *self._where(self.has_bed(), "fusion/dtm.tif", "fusion/river.json")]

    def mapped(self, name: str) -> list[str]:
        """What ``survey.gpkg`` draws beside the track: soundings, or what shows the river."""
        made = self.has_soundings() if name.startswith("bathymetry/soundings.") else self.has_bed()
        return self._where(made, name)

    def patches(self) -> list[str]:
        """Patches of change, of each pair of epochs."""
        return self.of_pairs("patches_{}.csv") if self.campaign.is_change else []

    def map_rasters(self) -> list[str]:
        """Grids of the project for QGIS, the uppermost first."""
        if self.campaign.is_change:
            return self.of_pairs("dod_{}.tif")
        return self._where(self.has_bed(), "bathymetry/bed.tif", "fusion/dtm.tif")

    def map_clouds(self) -> list[str]:
        """The cloud of the project for QGIS."""
        exported = self._is_survey() and self.has_lidar() and self.campaign.georeferencing.export_map
        return self._where(exported, "lidar/points_map.copc.laz")

    # ------------------------------------------------------------ change between epochs

    def is_epoch(self) -> bool:
        """True if another chosen campaign compares this one with other epochs."""
        return any(self.name in self.of(name)._surveys() for name in self.campaigns)

    def _surveys(self) -> list[str]:
        """Campaigns that surveyed the epochs, in the order of time; epochs of files have none."""
        return [epoch.campaign for epoch in self.campaign.epochs or [] if epoch.campaign is not None]

    def epoch_names(self) -> list[str]:
        """Names of the epochs, in the order of time."""
        return self.campaign.epoch_names

    def epochs_with_trajectory(self, wanted: bool) -> list[str]:
        """Names of the epochs with a boat's trajectory, or of those without."""
        epochs = zip(self.epoch_names(), self.campaign.epochs or [], strict=True)
        return [name for name, epoch in epochs if epoch.has_trajectory is wanted]

    def has_boat_epoch(self) -> bool:
        """True if an epoch has a boat's trajectory."""
        return bool(self.epochs_with_trajectory(True))

    def _epoch(self, name: str) -> Epoch:
        """What the campaign file says of an epoch."""
        return (self.campaign.epochs or [])[self.epoch_names().index(name)]

    def epoch_result(self, epoch: str, name: str) -> str:
        """A result of the campaign that surveyed an epoch."""
        return self.of(self._epoch(epoch).campaign or epoch)._result(name)

    def epoch_surface(self, epoch: str) -> list[str]:
        """Files of an epoch without a trajectory: a cloud, a surface model, or the bed of a campaign."""
        stated = self._epoch(epoch)
        if stated.campaign is not None:
            return [self.epoch_result(epoch, "bathymetry/bed.tif")]
        return [stated.dsm] if stated.dsm is not None else stated.clouds

    def epoch_masks(self, epoch: str) -> list[str]:
        """Files of polygons that are left out of an epoch."""
        return _with_parts(text.partition("?")[0] for text in self._epoch(epoch).leave_out)

    def stable_ground(self) -> list[str]:
        """Files of the ground that did not move."""
        drawn = self.campaign.deformation.stable
        return _with_parts([drawn.partition("?")[0]]) if isinstance(drawn, str) else []

    def epoch_positions(self, epoch: str) -> list[str]:
        """Positions of the boat that sounded the bed of an epoch, which say when."""
        bed = self._epoch(epoch).campaign is not None
        return [self.epoch_result(epoch, "ingest/positions.parquet")] if bed else []

    def epoch_statement(self, epoch: str) -> dict[str, Any]:
        """What is stated of an epoch without a trajectory; the bed of a campaign is a surface model too."""
        stated = self._epoch(epoch)
        if stated.campaign is not None:
            stated = Epoch(dsm=self.epoch_surface(epoch)[0], correlation_m=stated.correlation_m)
        return stated.model_dump(mode="json")

    def surface_statements(self, pair: str) -> list[dict[str, Any]]:
        """Statements of both epochs of a pair if both are surface models, else none."""
        names = self._pair(pair)
        if any(self._epoch(name).has_trajectory for name in names):
            return []
        statements = [self.epoch_statement(name) for name in names]
        return statements if all(each["dsm"] for each in statements) else []

    def surface_files(self, pair: str) -> list[str]:
        """Files of those statements."""
        names = self._pair(pair)
        both = self.surface_statements(pair)
        return [file for name in names for file in self.epoch_surface(name) + self.epoch_masks(name) if both]

    def epoch_points(self, epoch: str) -> str:
        """The cloud of an epoch, by the trajectory that the campaign of epochs chose."""
        chain = self.chain_of(epoch)
        return self.epoch_result(
            epoch, "lidar/points.laz" if chain == "ins" else f"lidar/by_{chain}/points.laz"
        )

    def epoch_trajectory(self, epoch: str) -> str:
        """The trajectory that the cloud of an epoch rests on."""
        return self.of(epoch).trajectory_of_lidar(self.chain_of(epoch))

    def epoch_mounts(self, epoch: str) -> str:
        """The places of the sensors on the boat of an epoch."""
        found: str = self.of(epoch).mounts_of_chain(self.chain_of(epoch))
        return found

    def epoch_errors(self, epoch: str) -> str:
        """What the survey of an epoch shows of the errors of its trajectory."""
        chain = self.chain_of(epoch)
        name = "errors_strips_lidar.npz" if chain == "strips" else ERRORS_OF_CHAIN[chain]
        return self.epoch_result(epoch, f"orientation/{name}")

    def chain_of(self, epoch: str) -> str:
        """The chain whose trajectory georeferenced the cloud of an epoch."""
        return self._epoch(epoch).chain

    def epoch_pairs(self) -> list[str]:
        """Pairs of epochs that are compared, such as ``1-2``: neighbours, and the first with the last."""
        n = len(self.epoch_names())
        pairs = [f"{i}-{i + 1}" for i in range(1, n)]
        return pairs + ([f"1-{n}"] if n > 2 else [])

    def epochs_of(self, pair: str, name: str) -> list[str]:
        """That file of the prepared epochs of a pair."""
        return [self._result(f"deformation/epochs/{epoch}/{name}") for epoch in self._pair(pair)]

    def surveys_of(self, pair: str, name: str) -> list[str]:
        """That result of the campaigns that surveyed the epochs of a pair."""
        return [self.epoch_result(epoch, name) for epoch in self._pair(pair)]

    def scenes_of(self, pair: str) -> list[dict[str, Any]]:
        """Scenes that the twins of a pair of epochs simulate."""
        return [self.of(name).section("twin", "scene") for name in self._pair(pair)]

    def seeds_of(self, pair: str) -> list[int]:
        """Seeds of the campaigns of a pair of epochs."""
        return [self.of(name).section("campaign", "seed") for name in self._pair(pair)]

    def _pair(self, pair: str) -> list[str]:
        names = self.epoch_names()
        return [names[int(i) - 1] for i in pair.split("-")]

    def change_places(self) -> dict[str, Any]:
        """The section `deformation` as far as the truth of a change depends on it."""
        keys = ("area", "cylinder_radius_m", "reach_m")
        return {key: self.plain["deformation"][key] for key in keys}

    def all_epochs(self, name: str) -> list[str]:
        """That file of every prepared epoch."""
        return [self._result(f"deformation/epochs/{epoch}/{name}") for epoch in self.epoch_names()]

    def of_pairs(self, name: str) -> list[str]:
        """That file of every pair; ``{}`` stands for the pair."""
        return [self._result(f"deformation/{name.format(pair)}") for pair in self.epoch_pairs()]

    def change_truth(self, name: str = "truth_{}.csv") -> list[str]:
        """The comparison with the true change, a file of it, where all epochs are a digital twin's."""
        surveyed = not self.epochs_with_trajectory(wanted=False)
        twins = surveyed and all(self.of(name).is_twin() for name in self._surveys())
        return self.of_pairs(name) if self.campaign.is_change and twins else []

    def has_many_epochs(self) -> bool:
        """True if more than two epochs are compared."""
        return len(self.epoch_names()) > 2

    def change_series(self) -> list[str]:
        """Epochs that jump, and rates of retreat, where there are more than two epochs."""
        names = ("deformation/jumps.json", "deformation/retreat_rates.csv")
        return [file for name in names for file in self._where(self.has_many_epochs(), name)]

    def _change_outputs(self) -> list[str]:
        return [
            *self.of_pairs("changes_{}.parquet"),
            *self.of_pairs("changes_{}.laz"),
            *self.of_pairs("volumes_{}.csv"),
            *self.of_pairs("volumes_along_{}.csv"),
            *self.of_pairs("retreat_{}.csv"),
            *self.of_pairs("dod_{}.tif"),
            *self._where(True, *_FOR_GIS),
            *self._where(self.has_many_epochs(), "deformation/series.parquet"),
            *self.change_truth(),
            self._result("deformation/index.html"),
            self._result("viewer/index.html"),
        ]

    # ------------------------------------------------------------ accuracy, and all

    def truth_statistics(self) -> list[str]:
        """The comparison with the truth, where there is one."""
        return self._where(self.is_twin(), "accuracy/truth_statistics.csv")

    def reference_statistics(self) -> list[str]:
        """The comparison with a reference, where there is one."""
        return self._where(self.has_reference(), "accuracy/statistics.csv")

    def _made(self) -> list[str]:
        """What `all` builds but pictures and the front page."""
        match self.campaign.kind:
            case "basin":
                return self._basin_outputs()
            case "change":
                return self._change_outputs()
            case "calibration":
                return self._calibration_outputs()
            case "photographs" if self.has_finished_orientations():
                return self._where(True, "photographs/finished.csv", "photographs/finished.html")
            case "photographs":
                return self._where(True, "photographs/image_poses.csv", "photographs/index.html")
            case "fixed_camera":
                return self._where(True, "orientation/fixed_camera.csv", "orientation/fixed_camera.html")
            case "cloud":
                return self._where(True, "accuracy/cloud_to_surface.laz", "accuracy/cloud.html")
        lidar = self.has_lidar()
        tables = ("orientation/trajectory.parquet", "timing/streams.csv", "timing/time_report.csv")
        outputs = [*self._where(True, *tables, "summary.csv", *_FOR_GIS), *self._map_of_track()]
        outputs += self.ins_points()
        outputs += [*self.echo_outputs(), *self._strip_outputs(), *self._bed_outputs()]
        outputs += self._where(self.map_clouds(), "lidar/points_map.laz", "lidar/points_map.copc.laz")
        if self.has_time_lapse():
            outputs.append(self.trajectory("fused"))
        if self.has_time_lapse() and lidar:
            outputs += self.of_chains("lidar", "points.laz")[1:3]
            outputs.append(self._result("accuracy/trajectories.html"))
        outputs += self.aligned_strips()
        outputs += self._where(self.is_coloured(), "lidar/coloured.laz")
        outputs += self._where(self.has_colour_images(), "lidar/colour_check.csv")
        outputs += self._where(self.has_panoramas(), "panorama/panoramas.parquet", "panorama/index.html")
        outputs += self._where(self.is_twin() and self.has_panoramas(), "accuracy/truth_rig.csv")
        outputs += self._where(lidar, "viewer/index.html")
        outputs += [*self.truth_statistics(), *self._where(self.is_twin(), "accuracy/filter_scores.csv")]
        compared = ("statistics.csv", "by_range.csv", "spatial.csv", "index.html")
        if self.has_reference():
            outputs += self._where(True, "ingest/reference.laz", "surface/reference_mesh.ply")
            outputs += [self._result(f"accuracy/{name}") for name in compared]
        return outputs

    def has_report(self) -> bool:
        """True if there is a report to hand in: of a survey, or of change."""
        return self._is_survey() or self.campaign.is_change

    def delivered(self) -> dict[str, str]:
        """Files to hand over with the report, and what they are, in the order of the report."""
        made = set(self._made())
        words = {self._result(name): what for name, what in _DELIVERED.items()}
        if self.campaign.is_change:
            words |= dict.fromkeys(
                self.of_pairs("dod_{}.tif"), "change of height and standard deviation, grid"
            )
            words |= dict.fromkeys(self.of_pairs("changes_{}.laz"), "change at each place, local frame")
        return {path: what for path, what in words.items() if path in made}

    def report_tables(self) -> list[str]:
        """Tables that the report of survey, or of change, takes its numbers from."""
        if self.campaign.is_change:
            tables = ("volumes_{}.csv", "patches_{}.csv", "registration_{}.json")
            return [file for name in tables for file in self.of_pairs(name)]
        bed = ("bathymetry/variogram.json", "bathymetry/water_level.json", "bathymetry/banks.csv")
        return [
            *self._where(True, "timing/streams.csv", "timing/time_report.csv", "orientation/trajectory.json"),
            self.mounts_of_chain(""),
            *self.reports(),
            *self.counts_of_points(),
            *self.sounding_facts(),
            *self._where(self.has_soundings(), "bathymetry/soundings.csv"),
            *self._where(self.echo_outputs(), "calibration/echo_sounder.json"),
            *self._where(self.has_bed(), *bed, "fusion/river.json", "fusion/dtm.json"),
            *self.bed_validation(),
            *self.adjustment_facts(),
            *self.reference_statistics(),
            *self.bed_truth(),
        ]

    def report_settings(self) -> dict[str, Any]:
        """What the report says of settings."""
        sections = ("campaign", "orientation", "echo_sounder", "filters")
        carried = {
            "lidar": self.has_lidar(),
            "camera": self.has_time_lapse() or self.has_panoramas(),
            "antenna": self.position_source() not in ("ins", "sbet"),
            "echo_sounder": self.has_soundings(),
        }
        found = {key: self.plain[key] for key in sections} | {"epochs": self.epoch_names()}
        return found | {"sensors": [name for name, there in carried.items() if there]}

    def products(self) -> list[Product]:
        """What a campaign gives from its logs, and what one more log would add."""
        alone = self._products_alone()
        if alone or not self._is_survey():
            return alone
        rows = (
            ("trajectory of the boat", self.trajectory("ins"), True, ""),
            ("report of survey, PDF", self._result("report.pdf"), True, ""),
            ("project for QGIS", self._result("survey.qgz"), True, ""),
            ("track, soundings, river for a GIS", self._result("survey.gpkg"), True, ""),
            (
                "georeferenced soundings",
                self._result("bathymetry/soundings.csv"),
                self.has_soundings(),
                "logs.depth",
            ),
            (
                "riverbed and terrain model",
                self._result("bathymetry/index.html"),
                self.has_bed(),
                "logs.depth, and logs.lidar or logs.bank_lines",
            ),
            (
                "point cloud of the banks",
                self._result("lidar/points.laz"),
                self.has_lidar(),
                "logs.lidar, and logs.ins or logs.sbet",
            ),
            (
                "cloud in the colours of photographs",
                self._result("lidar/coloured.laz"),
                self.is_coloured(),
                "logs.time_lapse with an interior orientation or logs.rig, and logs.lidar",
            ),
            (
                "panoramas along the river",
                self._result("panorama/index.html"),
                self.has_panoramas(),
                "logs.rig with images of a dual fisheye and its calibration",
            ),
            (
                "accuracy against a reference",
                self._result("accuracy/index.html"),
                self.has_reference(),
                "logs.reference and logs.lidar",
            ),
            (
                "camera trajectory; fused trajectory",
                # compared by what they make of the cloud, where there is one
                self._result("accuracy/trajectories.html") if self.has_lidar() else self.trajectory("fused"),
                self.has_time_lapse(),
                "logs.time_lapse",
            ),
            (
                "strip of the bed by the light sheet",
                self._result("triangulation/strip/index.html"),
                self.has_strip(),
                "logs.light_sheet.strip_images and light_sheet.sensor",
            ),
        )
        names = ("its track as GeoJSON", "its track as KML")
        track = [(*row, True, "") for row in zip(names, self._map_of_track(), strict=False)]
        return [Product(*row) for row in (rows[0], *track, *rows[1:])]

    def _map_of_track(self) -> list[str]:
        """The track of raw GNSS for maps and globes."""
        ppk = self._is_survey() and self.position_source() == "ppk"
        return self._where(ppk, "orientation/track.geojson", "orientation/track.kml")

    def _products_alone(self) -> list[Product]:
        """The same of photographs, of a camera that stays and of a finished cloud, recorded by no boat."""
        kind, own = self.campaign.kind, self.orients_alone()
        checked = bool(self.logs("control_points") and self.logs("image_marks"))
        boat = "the logs of a boat: logs.lidar with logs.ins, or logs.depth"
        rows: dict[str, tuple[tuple[str, str, bool, str], ...]] = {
            "photographs": (
                (
                    "poses of the photographs",
                    f"photographs/{'image_poses' if own else 'finished'}.csv",
                    True,
                    "",
                ),
                (
                    "sparse cloud of tie points",
                    "photographs/points.laz",
                    own,
                    "photographs without logs.time_lapse.orientations, which are oriented here",
                ),
                ("lens", f"photographs/{'camera' if own else 'finished_camera'}.yaml", True, ""),
                (
                    "control and check points",
                    f"photographs/{'control_points' if own else 'finished_points'}.csv",
                    checked,
                    "logs.time_lapse.control_points and logs.time_lapse.marks",
                ),
                ("point cloud of the banks, riverbed", "index.html", False, boat),
            ),
            "fixed_camera": (
                ("pose of the camera in each picture", "orientation/fixed_camera.csv", True, ""),
                ("residuals of the marks", "orientation/fixed_camera_residuals.csv", True, ""),
            ),
            "cloud": (
                ("distances from the reference, as cloud", "accuracy/cloud_to_surface.laz", True, ""),
                ("statistics and registration", "accuracy/cloud.json", True, ""),
                ("standard deviations of the points, and whether they hold", "index.html", False, boat),
            ),
        }
        return [
            Product(name, self._result(file), made, needs) for name, file, made, needs in rows.get(kind, ())
        ]

    def lacking(self) -> list[tuple[str, str]]:
        """What more logs would add, and which."""
        return [(product.name, product.needs) for product in self.products() if not product.made]

    def shown_in_front(self) -> list[str]:
        """What the front page links or quotes: all that `all` builds, and what tells how good it is."""
        reports = [path for path in self.target("ingest") if path.endswith(".integrity.json")]
        beside = self.has_panoramas() and not self.is_by_rig()
        reports += self._where(beside, "ingest/rig.integrity.json")
        fused = self.of_compared_chains("statistics.csv")[2:3] if self.has_time_lapse() else []
        facts = [*self.counts_of_points(), *self.sounding_facts()] if self._is_survey() else []
        facts += self.all_epochs("errors.json") if self.campaign.is_change else []
        others = [path for path in self.final_outputs() if path != self._result("index.html")]
        return list(dict.fromkeys([*others, *reports, *fused, *facts]))

    def final_outputs(self) -> list[str]:
        """The tables and pages that `all` builds; pictures stand in `thalweg.workflow.figures`."""
        return [*self._made(), *self._where(self.has_report(), "report.pdf"), self._result("index.html")]

    def target(self, name: str) -> list[str]:
        """What the target ``ingest``, ``lidar``, ``images`` or ``accuracy`` builds."""
        match name:
            case "ingest" if self.campaign.kind in ("photographs", "fixed_camera", "cloud"):
                return []
            case "ingest":
                moved = (self.position_logs() or self.ins_logs()) and not self.campaign.is_basin
                reports = self.reports() if moved else []
                reports += self._where(self.has_reference(), "ingest/reference.integrity.json")
                return reports + self._where(self.stamped_images(), "ingest/camera.integrity.json")
            case "images" if self.campaign.kind in ("photographs", "fixed_camera"):
                return self._made()
            case "images" if self.has_time_lapse():
                timed = self._where(True, "orientation/image_poses_timed.parquet")
                return [self.oriented_images(), *timed, self.trajectory("camera"), self.trajectory("fused")]
            case "images":
                return []
        return [path for path in self.final_outputs() if path.startswith(self._result(f"{name}/"))]


def pattern_of_epochs(files: Iterable[CampaignFiles], *, with_trajectory: bool) -> str:
    """Pattern of the names of epochs with a boat's trajectory, or of those without; ``none`` of none."""
    names = {name for each in files for name in each.epochs_with_trajectory(with_trajectory)}
    return "|".join(sorted(names)) or "none"
