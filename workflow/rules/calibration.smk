"""Where the sensors sit on the boat, and how well that is known."""


rule collect_mounts:
    """The mounts of a campaign: from its file, or from the calibration that it names."""
    input:
        calibration=of(CampaignFiles.calibration_file),
    output:
        mounts="results/{campaign}/calibration/mounts.json",
    priority: URGENT
    resources:
        mem_mb=memory(1000),
        runtime=minutes(10),
    params:
        section=section("mounts"),
        rig=of(CampaignFiles.rig_mount),
    script:
        "../scripts/collect_mounts.py"


rule detect_markers:
    """Printed markers in images: of the reference and of the boat in the field, of the light-sheet sensor in its own."""
    input:
        folders=of_wildcard("marked", CampaignFiles.marked_images),
        field=of_wildcard("marked", CampaignFiles.marked_field),
    output:
        marks="results/{campaign}/{room}/{marked}_marks.parquet",
        report="results/{campaign}/{room}/{marked}_marks.json",
        rejected="results/{campaign}/{room}/{marked}_marks_rejected.csv",
    log:
        "logs/{campaign}/{room}/detect_{marked}_marks.log",
    wildcard_constraints:
        room="calibration|triangulation",
        marked="reference|boat|camera_field",
    priority: URGENT
    resources:
        mem_mb=memory(2000),
        runtime=minutes(60),
    params:
        camera=lambda wildcards: wildcards.marked.replace(
            "camera_field", "sheet_camera"
        ),
    script:
        "../scripts/detect_markers.py"


rule adjust_field:
    """Reference points of the calibration field, and its place in the world."""
    input:
        marks="results/{campaign}/calibration/reference_marks.parquet",
        field=raw("field"),
    output:
        points="results/{campaign}/calibration/field_points.csv",
        covariance="results/{campaign}/calibration/field_points.npz",
        facts="results/{campaign}/calibration/field.json",
        residuals="results/{campaign}/calibration/field_residuals.csv",
        camera="results/{campaign}/calibration/reference_camera.yaml",
    priority: URGENT
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        run=RUN,
        frame=FRAME,
        model=section("calibration", "reference_camera", "model"),
        focal_px=section("calibration", "reference_camera", "focal_px"),
    script:
        "../scripts/adjust_field.py"


rule orient_camera:
    """Interior orientation of the boat's camera, and the pose of each of its images."""
    input:
        marks="results/{campaign}/calibration/boat_marks.parquet",
        points="results/{campaign}/calibration/field_points.csv",
        covariance="results/{campaign}/calibration/field_points.npz",
        field=raw("field"),
        interior=of(CampaignFiles.boat_interior),
        position_images=raw("position_images"),
    output:
        poses="results/{campaign}/calibration/camera_poses.parquet",
        statics="results/{campaign}/calibration/static_positions.npz",
        camera="results/{campaign}/calibration/camera.yaml",
        residuals="results/{campaign}/calibration/camera_residuals.csv",
        report="results/{campaign}/calibration/camera.json",
    priority: URGENT
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        run=RUN,
        model=section("calibration", "boat_camera", "model"),
        focal_px=section("calibration", "boat_camera", "focal_px"),
    script:
        "../scripts/orient_camera.py"


rule calibrate_camera_lidar:
    """Relative orientation of camera and lidar from the cones, at the static positions."""
    input:
        scans=raw("position_scans"),
        images=raw("position_images"),
        statics="results/{campaign}/calibration/static_positions.npz",
        field=raw("field"),
    output:
        camera_lidar="results/{campaign}/calibration/camera_lidar.yaml",
        report="results/{campaign}/calibration/camera_lidar.json",
        cones="results/{campaign}/calibration/cones.csv",
        detection="results/{campaign}/calibration/cone_detection.csv",
        residuals="results/{campaign}/calibration/cone_residuals.csv",
        references="results/{campaign}/calibration/cone_references.csv",
        displacements="results/{campaign}/calibration/cone_displacements.csv",
        correlations="results/{campaign}/calibration/camera_lidar_correlations.csv",
        poses="results/{campaign}/calibration/poses.csv",
        cone_points="results/{campaign}/calibration/cone_points.parquet",
        study="results/{campaign}/calibration/design_study.csv",
    priority: URGENT
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        run=RUN,
        mounts=of(CampaignFiles.mounts, "lidar", "camera"),
        lidar_options=of(CampaignFiles.lidar_options),
        lidar_accuracy=section("lidar_accuracy"),
        settings=section("calibration", "camera_lidar"),
        twin=TWIN,
    script:
        "../scripts/calibrate_camera_lidar.py"


rule calibrate_ins_lidar:
    """Mount of the lidar from the cones as the moving boat sees them."""
    input:
        lidar=raw("lidar"),
        clock="results/{campaign}/ingest/lidar.clock.json",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
        mounts="results/{campaign}/calibration/mounts.json",
        field=raw("field"),
        points="results/{campaign}/calibration/field_points.csv",
        covariance="results/{campaign}/calibration/field_points.npz",
        facts="results/{campaign}/calibration/field.json",
        poses=of(CampaignFiles.of_static_camera, "camera_poses.parquet"),
        camera_lidar=of(CampaignFiles.of_static_camera, "camera_lidar.yaml"),
    output:
        ins_lidar="results/{campaign}/calibration/ins_lidar.yaml",
        mount="results/{campaign}/calibration/ins_lidar.json",
        passes="results/{campaign}/calibration/passes.csv",
        before="results/{campaign}/calibration/cones_before.parquet",
        after="results/{campaign}/calibration/cones_after.parquet",
    priority: URGENT
    resources:
        mem_mb=memory(3000),
        runtime=minutes(20),
    params:
        run=RUN,
        lidar_options=of(CampaignFiles.lidar_options),
        settings=of(CampaignFiles.ins_lidar_settings),
        antenna_position=section("calibration", "ins_lidar", "antenna_position"),
    script:
        "../scripts/calibrate_ins_lidar.py"


rule calibrate_echo_sounder:
    """Place and lag of the echo sounder from soundings over a surveyed bed."""
    input:
        depths="results/{campaign}/ingest/depths.parquet",
        integrity="results/{campaign}/ingest/depth.integrity.json",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
        mounts="results/{campaign}/calibration/mounts.json",
        bed=raw("bed"),
    output:
        echo_sounder="results/{campaign}/calibration/echo_sounder.yaml",
        report="results/{campaign}/calibration/echo_sounder.json",
    priority: URGENT
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        run=RUN,
        frame=FRAME,
        crs=CRS,
        settings=of(CampaignFiles.echo_settings),
        stated=section("echo_sounder"),
        twin=TWIN,
    script:
        "../scripts/calibrate_echo_sounder.py"


rule assemble_boat:
    """All sensors of the boat in one calibration."""
    input:
        mount="results/{campaign}/calibration/ins_lidar.json",
        camera_lidar=of(CampaignFiles.of_static_camera, "camera_lidar.yaml"),
    output:
        boat="results/{campaign}/calibration/boat.yaml",
    priority: URGENT
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        run=RUN,
        echo_sounder=of(CampaignFiles.echo_place),
        twin=TWIN,
    script:
        "../scripts/assemble_boat.py"


rule calibrate_board:
    """Relative orientation of camera and lidar from poses of a checkerboard."""
    input:
        images=raw("board_images"),
        scans=raw("board_scans"),
        camera=raw("board_camera"),
    output:
        camera_lidar="results/{campaign}/calibration/board_camera_lidar.yaml",
        table="results/{campaign}/calibration/board_poses.csv",
    priority: URGENT
    threads: 2
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        run=RUN,
        mounts=of(CampaignFiles.mounts, "lidar", "camera"),
        lidar_options=of(CampaignFiles.lidar_options),
        lidar_accuracy=section("lidar_accuracy"),
        board=section("calibration", "board"),
        settings=of(CampaignFiles.board_settings),
    script:
        "../scripts/calibrate_board.py"
