"""What the rules of scans with the underwater light-sheet sensor share."""


def scan_names(name):
    """Names of the scanned objects of a campaign."""
    if is_twin(name):
        return list(TWIN_SCANS) if twin_scan_logs(name) else []
    return list(CAMPAIGNS[name].logs.light_sheet.scans)


def compared_scans(name):
    """Names of the scans that have a reference."""
    return [scan for scan in scan_names(name) if logs_of(name, f"{scan}.reference")]


wildcard_constraints:
    scan="|".join(sorted({s for name in CAMPAIGNS for s in scan_names(name)})) or "none",


def of_scan(part):
    """Input function: a part of the recordings of a scan, see `thalweg.config.sheet_scans`."""
    return lambda wildcards: logs_of(
        wildcards.campaign,
        wildcards.scan if part == "images" else f"{wildcards.scan}.{part}",
    )


def scan_levels(wildcards):
    """Params function: heights of the levels of a scanned object; None if it is compared with a mesh."""
    return light_sheet("levels_mm")(wildcards).get(wildcards.scan)


def scan_outputs(name):
    """The tables and pictures that `all` builds for the scans of a campaign."""
    base = f"results/{name}"
    outputs = [f"{base}/figures/joint_survey.png"] if CAMPAIGNS[name].is_basin else []
    for scan in scan_names(name):
        outputs += [
            f"{base}/triangulation/{scan}/points.parquet",
            f"{base}/figures/sheet_image_{scan}.png",
        ]
    for scan in compared_scans(name):
        outputs += [
            f"{base}/triangulation/{scan}/profile.csv",
            f"{base}/triangulation/{scan}/orthophoto.png",
            f"{base}/figures/scan_{scan}.png",
        ]
    return outputs


def sheet_on_board(wildcards):
    """Input function: the calibrated light-sheet sensor that a boat carries."""
    chosen = CAMPAIGNS[wildcards.campaign].light_sheet.sensor
    return [f"results/{chosen}/triangulation/sensor.yaml"] if chosen else []


def sheet_design(wildcards):
    """Input function: a sensor whose camera took the images: the design, on a boat the calibrated one."""
    return logs_of(wildcards.campaign, "sheet_sensor") or sheet_on_board(wildcards)


def sheet_basin(wildcards):
    """Params function: the twin of the basin in which the sensor of a boat was calibrated."""
    basin = CAMPAIGNS[CAMPAIGNS[wildcards.campaign].light_sheet.sensor].plain()
    keys = ("size", "light_sheet")
    return {
        "seed": basin["campaign"]["seed"],
        "twin": {key: basin["twin"][key] for key in keys},
    }


def strip_outputs(name):
    """The strip of the bed by the light-sheet sensor, where the boat carries one."""
    if not logs_of(name, "strip_images") or CAMPAIGNS[name].light_sheet.sensor is None:
        return []
    outputs = [f"results/{name}/triangulation/strip/bed.laz"]
    if is_twin(name):
        outputs.append(f"results/{name}/accuracy/truth_bed_strip.csv")
    return outputs
