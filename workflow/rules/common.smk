"""What all rules share: the validated campaigns, and functions that find a campaign's files."""

import os

import yaml
from snakemake.exceptions import WorkflowError

from thalweg.config.load import load_campaigns, with_calibrations
from thalweg.jobs.codehash import code_version

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


def calibration_file(wildcards):
    """Input function: the calibration of the boat that a campaign names, if any."""
    chosen = CAMPAIGNS[wildcards.campaign].mounts.calibration
    if chosen is None:
        return []
    return [
        f"results/{chosen}/calibration/boat.yaml" if chosen in CAMPAIGNS else chosen
    ]


def calibration_campaign(name):
    """Id of the calibration campaign that a campaign names; None if it names a file or none."""
    chosen = CAMPAIGNS[name].mounts.calibration
    return chosen if chosen in CAMPAIGNS else None


def calibrated_boat(wildcards):
    """Input function: true mounts of the twin's calibration that a campaign names; its boat is the same."""
    chosen = calibration_campaign(wildcards.campaign)
    return (
        [f"results/{chosen}/simulation/truth/mounts.json"]
        if chosen and is_twin(chosen)
        else []
    )


def calibration(*keys):
    """Input function for params: a value or a part of the section `calibration`."""

    def value(wildcards):
        found = CAMPAIGNS[wildcards.campaign].plain()["calibration"]
        for key in keys:
            found = found[key]
        return found

    return value


def boat_images(wildcards):
    """Input function: images of the boat's camera in the calibration field."""
    return [
        *logs_of(wildcards.campaign, "position_images"),
        *logs_of(wildcards.campaign, "run_images"),
    ]


def boat_interior(wildcards):
    """Input function: the interior orientation of the boat's camera that a campaign names, if any."""
    chosen = CAMPAIGNS[wildcards.campaign].calibration.boat_camera.interior
    return [] if chosen is None else [chosen]


def run_settings(wildcards):
    """Params function: how the run about the cones is evaluated."""
    plain = CAMPAIGNS[wildcards.campaign].plain()
    options = plain["calibration"]["ins_lidar"]
    sigma_m = plain["lidar_accuracy"]["sigma_component_m"]
    return {
        "errors": plain["calibration"]["run_errors"],
        "noise": {"along_m": sigma_m, "across_m": sigma_m},
        "search": {
            "lever_m": options["search_lever_m"],
            "angle_deg": options["search_angle_deg"],
        },
        "gates": {key: options[key] for key in ("min_cones", "min_headings_deg")},
        "form_sigma_m": plain["calibration"]["camera_lidar"]["form_sigma_m"],
        "estimate_errors": options["estimate_errors"],
    }


def clock_options(wildcards):
    """Params function: how the camera's clock is found."""
    found = CAMPAIGNS[wildcards.campaign].plain()["calibration"]
    errors = {
        key: found["run_errors"][key]
        for key in ("position_time_s", "attitude_time_s", "white_share")
    }
    return found["clock"] | errors


def echo_settings(wildcards):
    """Params function: how soundings over a surveyed bed are evaluated."""
    found = CAMPAIGNS[wildcards.campaign].plain()["calibration"]
    return found["echo_sounder"] | {"errors": found["run_errors"]}


def echo_outputs(name):
    """The place of the echo sounder, where the bed was surveyed."""
    surveyed = logs_of(name, "bed")
    return [f"results/{name}/calibration/echo_sounder.yaml"] if surveyed else []


def echo_place(wildcards):
    """Params function: where the echo sounder sits by the ruler."""
    mounts = CAMPAIGNS[wildcards.campaign].plain()["mounts"]
    place = mounts["echo_sounder"]
    return {
        "lever_ics_m": place["lever_ics_m"],
        "sigma_lever_m": place["sigma_lever_m"],
        "sigma_antenna_m": mounts["antenna"]["sigma_lever_m"],
    }


def camera_clock(wildcards):
    """Input function: the clock of the boat's camera, where a calibration has found it."""
    name = calibration_campaign(wildcards.campaign) or wildcards.campaign
    if not CAMPAIGNS[name].is_calibration or not logs_of(name, "run_images"):
        return []
    ties = logs_of(name, "clock_ties") + logs_of(name, "trigger_pulses")
    return [f"results/{name}/timing/camera_clock{'_ties' if ties else ''}.yaml"]


def clock_stability(wildcards):
    """Input function: the test of the camera's clock, where there is one."""
    name = calibration_campaign(wildcards.campaign) or wildcards.campaign
    found = CAMPAIGNS[name].is_calibration and logs_of(name, "display")
    return [f"results/{name}/timing/clock_stability.json"] if found else []


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
TWIN_TIME_LAPSE_LOGS = {
    "time_lapse": ["time_lapse"],
    "control_points": ["control_points.csv"],
}
"""Names of the twin's logs below results/{campaign}/simulation/logs; those without a suffix are folders."""


def logs_of(name, stream):
    """Files of a stream of a campaign: the twin's, or those that the campaign file names."""
    if is_twin(name):
        known = TWIN_FIELD_LOGS if CAMPAIGNS[name].is_calibration else TWIN_LOGS
        if CAMPAIGNS[name].twin.echo.bed_survey:
            known = known | {"bed": ["bed.csv"]}
        if CAMPAIGNS[name].twin.time_lapse is not None:
            known = known | TWIN_TIME_LAPSE_LOGS
        return [
            f"results/{name}/simulation/logs/{log}" for log in known.get(stream, [])
        ]
    return [str(p) for p in CAMPAIGNS[name].log_files(stream)]


def images(*keys):
    """Input function for params: a value or a part of the section `images`."""

    def value(wildcards):
        found = CAMPAIGNS[wildcards.campaign].plain()["images"]
        for key in keys:
            found = found[key]
        return found

    return value


def has_time_lapse(name):
    """True if a survey has images of the bank."""
    return bool(logs_of(name, "time_lapse")) and not CAMPAIGNS[name].is_calibration


def stamped_images(wildcards):
    """Input function: the images of the boat's camera in motion, on the river or about the cones."""
    name = wildcards.campaign
    return logs_of(name, "time_lapse") or logs_of(name, "run_images")


def stamp_tables(wildcards):
    """Input function: tables of the times of those images."""
    name = wildcards.campaign
    return logs_of(name, "time_lapse_times") or logs_of(name, "image_times")


def stamp_options(key):
    """Params function: how the times of those images are written."""

    def value(wildcards):
        plain = CAMPAIGNS[wildcards.campaign].plain()
        river = has_time_lapse(wildcards.campaign)
        return (
            plain["images"]["times"] if river else plain["calibration"]["image_times"]
        )[key]

    return value


def calibrated_interior(wildcards):
    """Input function: the camera's interior orientation from a file or from the calibration, if any."""
    given = logs_of(wildcards.campaign, "interior")
    chosen = calibration_campaign(wildcards.campaign)
    if not given and chosen and has_boat_camera(chosen):
        return [f"results/{chosen}/calibration/camera.yaml"]
    return given[:1]


def known_interior(wildcards):
    """Input function: the same for the size of the survey's images."""
    found = calibrated_interior(wildcards)
    return (
        [f"results/{wildcards.campaign}/orientation/camera_start.yaml"] if found else []
    )


def feature_parts(wildcards):
    """Input function: the features of all parts of the images."""
    parts = CAMPAIGNS[wildcards.campaign].images.features.parts
    folder = f"results/{wildcards.campaign}/orientation/sfm"
    return [f"{folder}/features_{part}.npz" for part in range(parts)]


def has_finished_orientations(name):
    """True if another program has oriented the images of a survey."""
    return bool(logs_of(name, "finished_orientations"))


def oriented_images(wildcards):
    """Input function: poses of the images, adjusted here or by another program."""
    finished = has_finished_orientations(wildcards.campaign)
    name = "image_poses_finished" if finished else "image_poses"
    return f"results/{wildcards.campaign}/orientation/{name}.parquet"


def trajectory_of_chain(wildcards):
    """Input function: the boat's trajectory by camera or by all sensors together."""
    return (
        f"results/{wildcards.campaign}/orientation/trajectory_{wildcards.chain}.parquet"
    )


def mounts_of_chain(wildcards):
    """Input function: places of the sensors; by the camera the lidar sits where their relative orientation says."""
    camera = wildcards.chain == "camera"
    return (
        f"results/{wildcards.campaign}/orientation/mounts_camera.json"
        if camera
        else f"results/{wildcards.campaign}/calibration/mounts.json"
    )


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


def board_settings(wildcards):
    """Params function: how poses of a board are evaluated."""
    found = CAMPAIGNS[wildcards.campaign].plain()["calibration"]["board"]
    return {"flatness_m": found["flatness_m"]}


def has_run(name):
    """True if a calibration campaign has a dynamic run: lidar and INS of the moving boat."""
    return bool(logs_of(name, "lidar") and logs_of(name, "ins"))


def has_static_camera(name):
    """True if a campaign has camera and lidar at static positions: they relate both, and show the antenna to the lidar."""
    return bool(logs_of(name, "position_images") and logs_of(name, "position_scans"))


def has_boat_camera(name):
    """True if a calibration campaign has images of the boat's camera."""
    return bool(logs_of(name, "position_images") or logs_of(name, "run_images"))


def has_kinematic_clock(name):
    """True if the clock of the camera comes from its images of the run."""
    ties = logs_of(name, "clock_ties") + logs_of(name, "trigger_pulses")
    return has_run(name) and bool(logs_of(name, "run_images")) and not ties


def calibration_pictures(name):
    """Pictures of a calibration campaign, by name."""
    static = [
        "field_setup",
        "field_positions",
        "field_reference",
        "cone_frame",
        "cone_residuals",
        "calibration_design",
    ]
    return [
        *(static if has_static_camera(name) else []),
        *(["cone_before_after"] if has_run(name) and has_static_camera(name) else []),
        *(["correlations"] if has_run(name) else []),
        *(["clock_offset"] if has_kinematic_clock(name) else []),
        *(["clock_stability"] if logs_of(name, "display") else []),
        *(["synthetic_view"] if is_twin(name) else []),
    ]


def calibration_page_pictures(wildcards):
    """Input function: pictures of a calibration campaign."""
    return [
        f"results/{wildcards.campaign}/figures/{picture}.png"
        for picture in calibration_pictures(wildcards.campaign)
    ]


def calibration_facts(wildcards):
    """Input function: reports of the jobs of a calibration that its page quotes."""
    return [
        f"results/{wildcards.campaign}/calibration/field.json",
        *(
            [f"results/{wildcards.campaign}/calibration/camera.json"]
            if has_boat_camera(wildcards.campaign)
            else []
        ),
        *(
            [f"results/{wildcards.campaign}/timing/camera_clock.json"]
            if has_kinematic_clock(wildcards.campaign)
            else []
        ),
        *clock_stability(wildcards),
    ]


def found_calibrations(wildcards):
    """Input function: calibration files of a calibration campaign."""
    moving = ["boat", "ins_lidar"] if has_run(wildcards.campaign) else []
    static = ["camera_lidar"] if has_static_camera(wildcards.campaign) else []
    camera = ["camera"] if has_boat_camera(wildcards.campaign) else []
    names = [*moving, *static, *camera, "reference_camera"]
    return [f"results/{wildcards.campaign}/calibration/{name}.yaml" for name in names]


def calibration_tables(wildcards):
    """Input function: tables that the page of a calibration shows."""
    static = ["cones", "cone_detection", "cone_residuals", "cone_displacements"]
    names = [
        *(static if has_static_camera(wildcards.campaign) else []),
        *(["passes"] if has_run(wildcards.campaign) else []),
        "reference_marks_rejected",
        *(["boat_marks_rejected"] if has_boat_camera(wildcards.campaign) else []),
    ]
    return [f"results/{wildcards.campaign}/calibration/{name}.csv" for name in names]


def calibration_truth(wildcards):
    """Input function: errors of a twin's calibration against its true places."""
    twin = is_twin(wildcards.campaign)
    return (
        [f"results/{wildcards.campaign}/accuracy/calibration_truth.csv"] if twin else []
    )


def calibration_outputs(name):
    """The tables and pictures that `all` builds for a calibration campaign."""
    base = f"results/{name}"
    outputs = []
    if logs_of(name, "board_images") or logs_of(name, "board_observations"):
        outputs.append(f"{base}/calibration/board_camera_lidar.yaml")
    if not logs_of(name, "field"):
        return outputs
    outputs += [
        *([f"{base}/calibration/camera_lidar.yaml"] if has_static_camera(name) else []),
        f"{base}/calibration/index.html",
        *(f"{base}/figures/{picture}.png" for picture in calibration_pictures(name)),
    ]
    if has_run(name):
        outputs += [f"{base}/calibration/boat.yaml", f"{base}/timing/time_report.csv"]
        outputs += echo_outputs(name)
    if is_twin(name):
        outputs.append(f"{base}/accuracy/calibration_truth.csv")
    return outputs


def chain_trajectories(wildcards):
    """Input function: trajectories by INS, camera and all sensors, in this order."""
    folder = f"results/{wildcards.campaign}/orientation"
    return [
        f"{folder}/trajectory{ending}.parquet" for ending in ("", "_camera", "_fused")
    ]


def of_chains(folder, name):
    """Input function: a result of the clouds by INS, camera and all sensors, in this order."""
    return lambda wildcards: [
        f"results/{wildcards.campaign}/{folder}/{part}{name}"
        for part in ("", "by_camera/", "by_fused/")
    ]


def of_compared_chains(name):
    """Input function: the same of their comparison with a reference; nothing where there is none."""
    return lambda wildcards: (
        of_chains("accuracy", name)(wildcards)
        if has_reference(wildcards.campaign)
        else []
    )


def chains_truth(wildcards):
    """Input function: errors of the trajectories of a twin against its truth."""
    twin = is_twin(wildcards.campaign)
    return [f"results/{wildcards.campaign}/accuracy/chains_truth.csv"] if twin else []


def chain_steps(chain):
    """Input function: a result of each job that belongs to one chain alone, for its computing time."""

    def steps(wildcards):
        folder = f"results/{wildcards.campaign}/orientation"
        own = [
            "masks",
            "sfm/matches.npz",
            "sfm/block.npz",
            "control_marks.csv",
            "image_poses.parquet",
        ]
        finished = has_finished_orientations(wildcards.campaign)
        names = {
            "ins": ["trajectory.parquet"],
            "camera": [
                *(["image_poses_finished.parquet"] if finished else own),
                "image_poses_timed.parquet",
                "trajectory_camera.parquet",
            ],
            "fused": ["trajectory_fused.parquet"],
        }[chain]
        own_camera = chain == "camera" and not finished
        features = feature_parts(wildcards) if own_camera else []
        return [*features, *(f"{folder}/{name}" for name in names)]

    return steps


OWN_IMAGE_PICTURES = ["mask_view", "image_positions"]
CHAIN_PICTURES = ["chain_histograms", "chains_by_range"]
"""Pictures of an adjustment of our own, and of a comparison of trajectories with a reference."""


def image_pictures(name):
    """Pictures of the image branch of a campaign, by name."""
    compared = CHAIN_PICTURES if has_reference(name) else []
    own = [] if has_finished_orientations(name) else OWN_IMAGE_PICTURES
    return [*compared, "pose_sigmas", *own, "frames_by_image"]


def chain_pictures(wildcards):
    """Input function: the pictures of the page on the trajectories."""
    name = wildcards.campaign
    return [f"results/{name}/figures/{picture}.png" for picture in image_pictures(name)]


def control_reports(wildcards):
    """Input function: the adjustment's report on control and check points, where there are control points."""
    name = wildcards.campaign
    given = logs_of(name, "control_points") and not has_finished_orientations(name)
    return [f"results/{name}/orientation/control_points.csv"] if given else []


def final_outputs(name):
    """The tables and pictures that `all` builds for a campaign."""
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
