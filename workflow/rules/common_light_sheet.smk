"""What the rules of the underwater light-sheet sensor share."""


def light_sheet(part):
    """Params function: a part of the section `light_sheet`."""
    return lambda wildcards: CAMPAIGNS[wildcards.campaign].plain()["light_sheet"][part]


def sheet_interior(wildcards):
    """Input function: the calibrated interior orientation, where there are pictures of a marker field."""
    name = wildcards.campaign
    given = logs_of(name, "camera_field")
    return [f"results/{name}/triangulation/camera_interior.yaml"] if given else []


def sheet_lens_report(wildcards):
    """Input function: the report on that lens."""
    return [path.replace(".yaml", ".json") for path in sheet_interior(wildcards)]


def camera_field_marks(wildcards):
    """Input function: marks in the pictures of the marker field, detected unless they are given."""
    name = wildcards.campaign
    given = logs_of(name, "camera_field_marks")
    return given or f"results/{name}/triangulation/camera_field_marks.parquet"


def sheet_lines(wildcards):
    """Params function: how lines are measured; on a grid object they come in short pieces, level beside level."""
    found = CAMPAIGNS[wildcards.campaign].plain()["light_sheet"]
    if wildcards.series != "calibration":
        return found["lines"]
    levels = found["calibration"]["levels"]
    short = {"link_gap_rows": 0, "least_rows": 5, "largest_rows": 7}
    return found["lines"] | {"lines": levels, **short}


def sheet_images(wildcards):
    """Input function: images of a series of the light-sheet sensor."""
    stream = {
        "calibration": "grid_images",
        "panels": "panel_images",
        "strip": "strip_images",
    }.get(wildcards.series, wildcards.series)
    return logs_of(wildcards.campaign, stream)


def basin_outputs(name):
    """The tables and pictures that `all` builds for a campaign of the light-sheet sensor."""
    base = f"results/{name}/triangulation"
    outputs = [f"{base}/sensor.yaml", f"{base}/budget.csv", f"{base}/index.html"]
    if logs_of(name, "panels"):
        outputs.append(f"{base}/panels.csv")
    if is_twin(name):
        outputs.append(f"results/{name}/accuracy/light_sheet_truth.csv")
    return outputs + scan_outputs(name) + ledger_outputs(name)


def sheet_series(name):
    """Series of images of the light-sheet sensor that a campaign has, in the order of the page."""
    streams = {"calibration": "grid_images", "panels": "panel_images"}
    return [
        series
        for series in ("calibration", "panels", *scan_names(name))
        if logs_of(name, streams.get(series, series))
    ]


def of_sheet_series(table):
    """Input function: that table of every series of a campaign."""
    return lambda wildcards: [
        f"results/{wildcards.campaign}/triangulation/{series}/{table}"
        for series in sheet_series(wildcards.campaign)
    ]


def sheet_panels(wildcards):
    """Input function: the comparison with panels, where there are any."""
    name = wildcards.campaign
    return (
        [f"results/{name}/triangulation/panels.csv"]
        if "panels" in sheet_series(name)
        else []
    )


def sheet_truth(wildcards):
    """Input function: the comparison with the true sensor of a twin."""
    name = wildcards.campaign
    return [f"results/{name}/accuracy/light_sheet_truth.csv"] if is_twin(name) else []


def sheet_pictures(wildcards):
    """Input function: pictures of the page on the light-sheet sensor, in their order."""
    series = sheet_series(wildcards.campaign)
    names = (
        ["sheet_deformation", "sensor_setup"]
        + ["line_measurement", "line_patch"] * ("panels" in series)
        + ["line_on_markers"] * ("stepped" in series)
        + ["grid_calibration", "sheet_correlations", "measurement_volume"]
        + ["panel_distances"] * ("panels" in series)
        + ["depth_budget", "published_depth_budget", "sheet_models"]
    )
    return [f"results/{wildcards.campaign}/figures/{name}.png" for name in names]


def sheet_captions(wildcards):
    """Input function: captions of all pictures of the page on the light-sheet sensor."""
    names = [Path(picture).stem for picture in sheet_pictures(wildcards)]
    if scan_names(wildcards.campaign):
        names += ["scan_setup", "sheet_image", "scan_reference", "scan_profile"]
        names += ["scan_distances", "orthophoto"]
    return [ROOT / "workflow" / "report" / f"{name}.rst" for name in names]
