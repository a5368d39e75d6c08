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
    """Input function: a part of the recordings of a scan, see `thalweg.settings.light_sheet.scans`."""
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
        outputs.append(f"{base}/triangulation/{scan}/points.parquet")
        outputs += pictures_of_scan(name, scan)
    for scan in compared_scans(name):
        outputs.append(f"{base}/triangulation/{scan}/profile.csv")
    return outputs


def sheet_scan_files(wildcards):
    """Input function: tables and reports of all scans for the page on the light-sheet sensor."""
    name = wildcards.campaign
    files = ["statistics.csv", "lines.csv", "facts.json", "profile.csv", "profile.json"]
    return [
        f"results/{name}/triangulation/{scan}/{file}"
        for scan in scan_names(name)
        for file in ["counts.json"] + files * (scan in compared_scans(name))
    ]


def sheet_scan_pictures(wildcards):
    """Input function: pictures of all scans for the page on the light-sheet sensor, in their order."""
    return [
        picture
        for scan in scan_names(wildcards.campaign)
        for picture in pictures_of_scan(wildcards.campaign, scan)
    ]


def pictures_of_scan(name, scan):
    """Pictures of a scan, in the order of the page."""
    kinds = ["setup_of", "sheet_image"]
    if scan in compared_scans(name):
        kinds += ["reference_of", "profile_of", "scan"]
    pictures = [f"results/{name}/figures/{kind}_{scan}.png" for kind in kinds]
    if scan in compared_scans(name):
        pictures.append(f"results/{name}/triangulation/{scan}/orthophoto.png")
    return pictures


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
    base = f"results/{name}/triangulation/strip"
    outputs = [f"{base}/bed.laz", f"{base}/index.html"]
    if is_twin(name):
        outputs.append(f"results/{name}/accuracy/truth_bed_strip.csv")
    return outputs


def strip_truth(table):
    """Input function: that table of errors of the strip of the bed, of a twin."""
    return lambda wildcards: (
        [f"results/{wildcards.campaign}/accuracy/{table}"]
        if is_twin(wildcards.campaign)
        else []
    )
