"""What all rules share: the validated campaigns, and functions that find a campaign's files."""

import os

import yaml
from snakemake.exceptions import WorkflowError

from thalweg.settings.files.load import load_campaigns, with_calibrations
from thalweg.workflow.codehash import code_version

ROOT = Path(workflow.basedir)
CAMPAIGNS = with_calibrations(
    load_campaigns(config["campaign"], ROOT / "config" / "campaigns"),
    ROOT / "config" / "campaigns",
)

with open(ROOT / "resources" / "real_recordings.yaml") as stream:
    RECORDINGS = {entry["id"]: entry for entry in yaml.safe_load(stream)}


wildcard_constraints:
    campaign="|".join(CAMPAIGNS),
    chain="camera|fused",
    part="[0-9]+",
    recording="|".join(RECORDINGS),


def section(name):
    """Input function for params: one section of the campaign's settings, as plain values."""
    return lambda wildcards: CAMPAIGNS[wildcards.campaign].plain()[name]


def identity(*keys):
    """Input function for params: only those keys of the section `campaign`, so that a new title reruns pictures."""
    return lambda wildcards: {
        key: CAMPAIGNS[wildcards.campaign].plain()["campaign"][key] for key in keys
    }


def mounts_of(*sensors):
    """Input function for params: only the mounts of those sensors."""
    return lambda wildcards: {
        sensor: CAMPAIGNS[wildcards.campaign].plain()["mounts"][sensor]
        for sensor in sensors
    }


def georeferencing(wildcards):
    """Params function: the section `georeferencing` without the wish for a map.

    Comparisons with a reference or with a twin's truth need the full covariance of each point.
    """
    options = CAMPAIGNS[wildcards.campaign].plain()["georeferencing"]
    options["correlations"] |= has_reference(wildcards.campaign)
    options["correlations"] |= is_twin(wildcards.campaign)
    return {key: value for key, value in options.items() if key != "export_map"}


def twin_parts(*parts):
    """Input function for params: those sections of the twin, and its size, start and length.

    A job that names the parts it needs does not run again for a change in another.
    """

    def values(wildcards):
        twin = CAMPAIGNS[wildcards.campaign].plain()["twin"]
        given = ("size", "start_utc", "duration_s", "field", *parts)
        return {key: twin[key] for key in given}

    return values


def is_twin(name):
    """True if the digital twin writes the logs of a campaign."""
    return CAMPAIGNS[name].twin is not None


TWIN_LOGS = {
    "lidar": ["lidar.pcap"],
    "ins": ["ins.anpp"],
    "sbp": ["rover.sbp"],
    "pos": ["ppk.pos"],
    "depth": ["echo.nmea"],
    "reference": ["tls_1.laz", "tls_2.laz", "tls_3.laz"],
}
TWIN_FIELD_LOGS = {
    "lidar": ["lidar.pcap"],
    "ins": ["ins.anpp"],
    "sbp": ["rover.sbp"],
    "pos": ["ppk.pos"],
    "field": ["field.yaml"],
    "reference_images": ["reference_images"],
    "position_images": ["position_images"],
    "position_scans": ["position_scans"],
    "run_images": ["run_images"],
    "display": ["display"],
}
TWIN_BASIN_LOGS = {
    "sheet_sensor": ["light_sheet/sensor.yaml"],
    "camera_marks": ["light_sheet/camera_marks.csv"],
    "mark_points": ["light_sheet/mark_points.csv"],
    "grid_images": ["light_sheet/calibration/images"],
    "grid": ["light_sheet/calibration/grid_1.yaml"],
    "panel_images": ["light_sheet/panels/images"],
    "panels": ["light_sheet/panels/images.csv"],
}
TWIN_CAMERA_FIELD_LOGS = {
    "camera_field": ["light_sheet/camera_field.yaml"],
    "camera_field_marks": ["light_sheet/camera_field_marks.csv"],
}
TWIN_SCANS = ("stepped", "wreck")
TWIN_SCAN_LOGS = {
    "": "images",
    ".pulses": "trigger_pulses.csv",
    ".panel": "six_dof/panel.csv",
    ".marks": "six_dof/marks.csv",
    ".camera": "six_dof/camera.json",
    ".reference": "reference.ply",
    ".pairs": "pairs.csv",
}
TWIN_STRIP_LOGS = {
    "strip_images": ["light_sheet/strip/images"],
    "strip_pulses": ["light_sheet/strip/trigger_pulses.csv"],
}
TWIN_TIME_LAPSE_LOGS = {
    "time_lapse": ["time_lapse"],
    "control_points": ["control_points.csv"],
}
"""Names of the twin's logs below results/{campaign}/simulation/logs; those without a suffix are folders."""


def twin_scan_logs(name):
    """Scans of a twin's basin: stream -> names; without lines there are none."""
    settings = CAMPAIGNS[name].twin.light_sheet
    if settings is None or not settings.scan_lines:
        return {}
    return {
        f"{scan}{part}": [f"light_sheet/{scan}/{log}"]
        for scan in TWIN_SCANS
        for part, log in TWIN_SCAN_LOGS.items()
    }


def logs_of(name, stream):
    """Files of a stream of a campaign: the twin's, or those that the campaign file names."""
    if is_twin(name):
        if CAMPAIGNS[name].is_basin:
            known = TWIN_BASIN_LOGS | twin_scan_logs(name)
            settings = CAMPAIGNS[name].twin.light_sheet
            if settings is not None and settings.lens_pictures:
                known = known | TWIN_CAMERA_FIELD_LOGS
        else:
            known = TWIN_FIELD_LOGS if CAMPAIGNS[name].is_calibration else TWIN_LOGS
        if CAMPAIGNS[name].twin.echo.bed_survey:
            known = known | {"bed": ["bed.csv"]}
        if CAMPAIGNS[name].twin.time_lapse is not None:
            known = known | TWIN_TIME_LAPSE_LOGS
        if CAMPAIGNS[name].twin.light_sheet_strip is not None:
            known = known | TWIN_STRIP_LOGS
        return [
            f"results/{name}/simulation/logs/{log}" for log in known.get(stream, [])
        ]
    return [str(p) for p in CAMPAIGNS[name].log_files(stream)]


def raw(stream):
    """Input function: the raw files of one stream."""
    return lambda wildcards: logs_of(wildcards.campaign, stream)


def has_reference(name):
    """True if a campaign has reference clouds."""
    return bool(logs_of(name, "reference"))


def position_source(wildcards):
    """Params function: where the campaign's positions come from."""
    return CAMPAIGNS[wildcards.campaign].orientation.position_source


def ins_logs(wildcards):
    """Input function: the files that hold attitudes, ANPP or SBET."""
    return logs_of(
        wildcards.campaign, "sbet" if position_source(wildcards) == "sbet" else "ins"
    )


def smrmsg_logs(wildcards):
    """Input function: the standard deviations of an SBET, where there are any."""
    return (
        logs_of(wildcards.campaign, "smrmsg")
        if position_source(wildcards) == "sbet"
        else []
    )


def position_logs(wildcards):
    """Input function: the files of the position source itself; none if the INS states hold them."""
    stream = {"pos": "pos", "sbp": "sbp", "ppk": "rover"}.get(
        position_source(wildcards)
    )
    return logs_of(wildcards.campaign, stream) if stream else []


def base_logs(wildcards):
    """Input function: raw GNSS of the base, where PPK needs it."""
    return (
        logs_of(wildcards.campaign, "base")
        if position_source(wildcards) == "ppk"
        else []
    )


def nav_logs(wildcards):
    """Input function: navigation files, where PPK needs them."""
    return (
        logs_of(wildcards.campaign, "nav")
        if position_source(wildcards) == "ppk"
        else []
    )


def log_option(name, key):
    """A plain value of the section `logs`; None for a twin."""
    logs = CAMPAIGNS[name].plain()["logs"]
    return logs[key] if logs else None


def base_position(wildcards):
    """Params function: how the campaign file states the position of the base."""
    logs = CAMPAIGNS[wildcards.campaign].plain()["logs"]
    return (
        {key: value for key, value in logs["gnss"].items() if key.startswith("base_")}
        if logs
        else {}
    )


STREAM_NAMES = {
    "lidar": "lidar",
    "ins": "ins",
    "sbet": "ins",
    "sbp": "gnss",
    "depth": "depth",
}


def streams_of(name):
    """The streams of a campaign that have logs, as the ingest rules name their results."""
    found = [result for stream, result in STREAM_NAMES.items() if logs_of(name, stream)]
    return [*dict.fromkeys(found), "positions"]


def reports(wildcards):
    """Input function: the integrity reports of all streams of a campaign."""
    return [
        f"results/{wildcards.campaign}/ingest/{stream}.integrity.json"
        for stream in streams_of(wildcards.campaign)
    ]


REFERENCE_PICTURES = [
    "distance_map",
    "cross_sections",
    "distance_histogram",
    "distance_by_range",
]


def accuracy_pictures(wildcards):
    """Input function: the pictures of the accuracy page."""
    names = REFERENCE_PICTURES + ["error_versus_range"] * is_twin(wildcards.campaign)
    return [f"results/{wildcards.campaign}/figures/{name}.png" for name in names]


def area_of_interest(wildcards):
    """Params function: the part of the cloud that is compared with the reference."""
    return CAMPAIGNS[wildcards.campaign].plain()["accuracy"]["area"]


def reference_surface(wildcards):
    """Params function: the section `reference` without the sigma, which no mesh depends on."""
    options = CAMPAIGNS[wildcards.campaign].plain()["reference"]
    return {key: value for key, value in options.items() if key != "sigma_m"}


def comparison_settings(wildcards):
    """Params function: the section `accuracy` without the cross sections, which are a picture's."""
    options = CAMPAIGNS[wildcards.campaign].plain()["accuracy"]
    return {key: value for key, value in options.items() if key != "sections"}


def final_outputs(name):
    """The tables and pictures that `all` builds for a campaign."""
    if CAMPAIGNS[name].is_basin:
        return basin_outputs(name)
    if CAMPAIGNS[name].is_calibration:
        return calibration_outputs(name)
    base = f"results/{name}"
    pictures = [
        "survey_map",
        "streams_in_time",
        "trajectory",
        "cloud_overview",
        "cloud_detail",
        "cloud_by_sigma",
        "cloud_by_range",
        "removed_points",
    ]
    if CAMPAIGNS[name].lidar_accuracy.divergence_mrad > 0:
        pictures.append("footprints")
    outputs = [
        f"{base}/lidar/points.laz",
        f"{base}/timing/streams.csv",
        f"{base}/timing/time_report.csv",
        *(f"{base}/figures/{picture}.png" for picture in pictures),
        f"{base}/summary.csv",
        *echo_outputs(name),
        *strip_outputs(name),
    ]
    if CAMPAIGNS[name].georeferencing.export_map:
        outputs.append(f"{base}/lidar/points_map.laz")
    if has_time_lapse(name):
        outputs += [
            f"{base}/orientation/trajectory_fused.parquet",
            f"{base}/lidar/by_camera/points.laz",
            f"{base}/lidar/by_fused/points.laz",
            f"{base}/accuracy/trajectories.html",
            *(f"{base}/figures/{picture}.png" for picture in image_pictures(name)),
        ]
    if is_twin(name):
        outputs += [
            f"{base}/accuracy/truth_statistics.csv",
            f"{base}/accuracy/filter_scores.csv",
            f"{base}/figures/error_versus_range.png",
            f"{base}/figures/scene_view.png",
        ]
    if has_reference(name):
        outputs += [
            f"{base}/ingest/reference.laz",
            f"{base}/figures/reference_view.png",
            f"{base}/surface/reference_mesh.ply",
            f"{base}/accuracy/statistics.csv",
            f"{base}/accuracy/by_range.csv",
            f"{base}/accuracy/spatial.csv",
            f"{base}/accuracy/index.html",
            *(f"{base}/figures/{picture}.png" for picture in REFERENCE_PICTURES),
        ]
    return outputs


URGENT = 10
"""Priority of the longest chain of jobs: poses of images need the calibration, and all comparisons need them."""


def memory(base_mb, per_input_mb=0.0):
    """Resource function: memory from the size of the inputs, more on each attempt."""
    return lambda wildcards, input, attempt: int(
        (base_mb + per_input_mb * input.size_mb) * attempt
    )


def minutes(base, per_input_gb=0.0):
    """Resource function: wall time in minutes from the size of the inputs, more on each attempt."""
    return (
        lambda wildcards, input, attempt: int(
            (base + per_input_gb * input.size_mb / 1000) * attempt
        )
        + 1
    )


def truth_statistics(wildcards):
    """Input function: the comparison with the truth, where there is one."""
    name = wildcards.campaign
    return [f"results/{name}/accuracy/truth_statistics.csv"] if is_twin(name) else []


def reference_statistics(wildcards):
    """Input function: the comparison with a reference, where there is one."""
    name = wildcards.campaign
    return [f"results/{name}/accuracy/statistics.csv"] if has_reference(name) else []


REAL_DATA = Path(os.environ.get("THALWEG_DATA", ROOT.parent / "shared" / "data"))


def recording_files(key):
    """Input function: files of one real recording, with a word of help where the folder is absent."""

    def files(wildcards):
        names = RECORDINGS[wildcards.recording].get(key, [])
        if names and not REAL_DATA.is_dir():
            raise WorkflowError(
                f"The real recordings are not at {REAL_DATA}. Set THALWEG_DATA to their folder."
            )
        return [str(REAL_DATA / name) for name in names]

    return files
