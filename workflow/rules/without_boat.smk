"""Photographs, a camera that stays, or a finished cloud: what no boat recorded."""


rule orient_photographs:
    """Photographs and control points or positions -> poses, lens, tie points, with covariances."""
    input:
        images=raw("time_lapse"),
        control_points=raw("control_points"),
        marks=raw("image_marks"),
        positions=raw("camera_positions"),
        interior=raw("interior"),
        masks=raw("masks"),
    output:
        poses="results/{campaign}/photographs/image_poses.parquet",
        image_poses="results/{campaign}/photographs/image_poses.csv",
        points="results/{campaign}/photographs/points.csv",
        cloud="results/{campaign}/photographs/points.laz",
        camera="results/{campaign}/photographs/camera.yaml",
        cameras="results/{campaign}/photographs/cameras.csv",
        control_report="results/{campaign}/photographs/control_points.csv",
        images_report="results/{campaign}/photographs/images.csv",
        facts="results/{campaign}/photographs/orientation.json",
    log:
        "logs/{campaign}/orientation/orient_photographs.log",
    priority: URGENT
    threads: 2
    resources:
        mem_mb=memory(4000, 5),
        runtime=minutes(60, 60),
    params:
        **calls("thalweg.images.photographs:orient_files"),
        folder=f"{RESULTS}/photographs",
        campaign=identity("id", "crs"),
        device=section("images", "device"),
        features=section("images", "features"),
        mapping=section("images", "mapping"),
        adjustment=section("images", "adjustment"),
        control=section("images", "control"),
    script:
        "../scripts/call.py"


rule place_photographs:
    """Photographs that another program has oriented, without a boat -> poses, lens, judged points."""
    input:
        images=raw("time_lapse"),
        control_points=raw("control_points"),
        marks=raw("image_marks"),
        interior=raw("interior"),
        orientations=raw("finished_orientations"),
    output:
        poses="results/{campaign}/photographs/finished.parquet",
        image_poses="results/{campaign}/photographs/finished.csv",
        camera="results/{campaign}/photographs/finished_camera.yaml",
        points="results/{campaign}/photographs/finished_points.csv",
        facts="results/{campaign}/photographs/finished.json",
    log:
        "logs/{campaign}/orientation/place_photographs.log",
    priority: URGENT
    resources:
        mem_mb=memory(1500),
        runtime=minutes(20),
    params:
        **calls("thalweg.images.finished:place_files"),
        folder=f"{RESULTS}/photographs",
        campaign=identity("id", "crs", "origin"),
        finished=section("images", "finished"),
        control=section("images", "control"),
    script:
        "../scripts/call.py"


rule resect_pictures:
    """Marks of control points in pictures of a camera that stays -> its pose in each."""
    input:
        marks=raw("fixed_marks"),
        control_points=raw("fixed_points"),
        interior=raw("fixed_interior"),
    output:
        poses="results/{campaign}/orientation/fixed_camera.csv",
        residuals="results/{campaign}/orientation/fixed_camera_residuals.csv",
        facts="results/{campaign}/orientation/fixed_camera.json",
    log:
        "logs/{campaign}/orientation/resect_pictures.log",
    priority: URGENT
    resources:
        mem_mb=memory(1500),
        runtime=minutes(20),
    params:
        **calls("thalweg.images.fixed_camera:resect_files"),
        campaign=identity("crs"),
        control=section("images", "control"),
        settings=section("images", "fixed_camera"),
    script:
        "../scripts/call.py"


rule compare_cloud:
    """A finished cloud and its reference -> signed distances, statistics, registration."""
    input:
        cloud=raw("cloud"),
        reference=raw("reference"),
    output:
        distances="results/{campaign}/accuracy/cloud_to_surface.parquet",
        points="results/{campaign}/accuracy/cloud_to_surface.laz",
        facts="results/{campaign}/accuracy/cloud.json",
    log:
        "logs/{campaign}/accuracy/compare_cloud.log",
    priority: URGENT
    threads: 2
    resources:
        mem_mb=memory(3000, 60),
        runtime=minutes(15, 60),
    params:
        **calls("thalweg.deformation.foreign.clouds:compare_files"),
        settings=section("reference"),
        accuracy=of(CampaignFiles.comparison),
    script:
        "../scripts/call.py"
