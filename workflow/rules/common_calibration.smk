"""What the rules of a calibration share: which logs it has, what they ask of the configuration."""


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


def calibrated_interior(wildcards):
    """Input function: the camera's interior orientation from a file or from the calibration, if any."""
    given = logs_of(wildcards.campaign, "interior")
    chosen = calibration_campaign(wildcards.campaign)
    if not given and chosen and has_boat_camera(chosen):
        return [f"results/{chosen}/calibration/camera.yaml"]
    return given[:1]


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
        *(
            [f"results/{wildcards.campaign}/calibration/ins_lidar.json"]
            if has_run(wildcards.campaign)
            else []
        ),
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


def of_static_camera(file):
    """Input function: a result of the static positions, where the campaign has them."""
    return lambda wildcards: (
        [f"results/{wildcards.campaign}/calibration/{file}"]
        if has_static_camera(wildcards.campaign)
        else []
    )


def ins_lidar_settings(wildcards):
    """Params function: how the run about the cones is evaluated, the lidar's stamps included."""
    found = CAMPAIGNS[wildcards.campaign].plain()["calibration"]["ins_lidar"]
    return run_settings(wildcards) | {"sigma_time_s": found["sigma_time_s"]}


def tied_images(wildcards):
    """Input function: the times of a calibration's own images by ties or pulses, where it has them."""
    name = wildcards.campaign
    tied = logs_of(name, "clock_ties") or logs_of(name, "trigger_pulses")
    found = (
        CAMPAIGNS[name].is_calibration and logs_of(name, "run_images") and bool(tied)
    )
    return [f"results/{name}/timing/image_times_ties.parquet"] if found else []
