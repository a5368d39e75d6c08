"""The underwater light-sheet sensor: lines in images, calibration, points on the sheet (P3, P4)."""


rule calibrate_sheet_camera:
    """Interior orientation of the sensor's camera, from a marker field in air (P3 2.4, P4 6.2)."""
    input:
        design=raw("sheet_sensor"),
        marks=of(CampaignFiles.camera_field_marks),
        field=raw("camera_field"),
    output:
        camera="results/{campaign}/triangulation/camera_interior.yaml",
        report="results/{campaign}/triangulation/camera_interior.json",
        residuals="results/{campaign}/triangulation/camera_interior_residuals.csv",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        run=RUN,
        frame=FRAME,
        twin=TWIN,
    script:
        "../scripts/calibrate_sheet_camera.py"


rule orient_sheet_camera:
    """The sensor's camera over the window, from marks that it sees through air (P4 4.3)."""
    input:
        design=raw("sheet_sensor"),
        interior=of(CampaignFiles.sheet_interior),
        marks=raw("camera_marks"),
        points=raw("mark_points"),
    output:
        sensor="results/{campaign}/triangulation/camera.yaml",
        report="results/{campaign}/triangulation/camera.json",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        run=RUN,
        calibration=section("light_sheet", "calibration"),
        twin=TWIN,
    script:
        "../scripts/orient_sheet_camera.py"


rule detect_sheet_lines:
    """The laser line in each image of a series (P4 4.1)."""
    input:
        images=of_wildcard("series", CampaignFiles.sheet_images),
        sensor=of(CampaignFiles.sheet_design),
    output:
        line_points="results/{campaign}/triangulation/{series}/line_points.parquet",
        counts="results/{campaign}/triangulation/{series}/line_counts.csv",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        lines=of_wildcard("series", CampaignFiles.sheet_lines),
    script:
        "../scripts/detect_sheet_lines.py"


rule calibrate_light_sheet:
    """Where laser, window and water are, from the line on the grid object (P3 2.4, P4 4.3)."""
    input:
        camera="results/{campaign}/triangulation/camera.yaml",
        line_points="results/{campaign}/triangulation/calibration/line_points.parquet",
        grid=raw("grid"),
    output:
        sensor="results/{campaign}/triangulation/sensor.yaml",
        report="results/{campaign}/triangulation/calibration.json",
        parameters="results/{campaign}/triangulation/parameters.csv",
        residuals="results/{campaign}/triangulation/residuals.csv",
        pairs="results/{campaign}/triangulation/pairs.csv",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        run=RUN,
        calibration=section("light_sheet", "calibration"),
        water=section("light_sheet", "water"),
        twin=TWIN,
    script:
        "../scripts/calibrate_light_sheet.py"


rule measure_panels:
    """Depths of a panel, beside its true ones and the published errors (P3 3.1.2)."""
    input:
        sensor="results/{campaign}/triangulation/sensor.yaml",
        line_points="results/{campaign}/triangulation/panels/line_points.parquet",
        counts="results/{campaign}/triangulation/panels/line_counts.csv",
        panels=raw("panels"),
    output:
        points="results/{campaign}/triangulation/panels/points.parquet",
        table="results/{campaign}/triangulation/panels.csv",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    script:
        "../scripts/measure_panels.py"


rule light_sheet_budget:
    """What each parameter costs in depth, and the points of all pixels (P4 5, 6)."""
    input:
        sensor="results/{campaign}/triangulation/sensor.yaml",
    output:
        budget="results/{campaign}/triangulation/budget.csv",
        look_up="results/{campaign}/triangulation/look_up_table.npz",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    script:
        "../scripts/light_sheet_budget.py"
