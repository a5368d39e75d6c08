"""Where the boat is and how it lies."""


rule build_trajectory:
    """Antenna positions and INS attitudes -> poses of the boat with sigmas as stated."""
    input:
        states=of(CampaignFiles.ins_states),
        positions="results/{campaign}/ingest/positions.parquet",
        streams=of(CampaignFiles.streams_before_poses),
        mounts="results/{campaign}/calibration/mounts.json",
    output:
        trajectory="results/{campaign}/orientation/trajectory_stated.parquet",
        summary="results/{campaign}/orientation/trajectory.json",
    priority: URGENT
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        frame=FRAME,
        orientation=section("orientation"),
        stated=of(CampaignFiles.stated_positions),
        ins=section("ins"),
    script:
        "../scripts/build_trajectory.py"


rule predict_images:
    """Roughly where the camera was at each image: its clock, the trajectory, its mount."""
    input:
        stamps="results/{campaign}/ingest/image_stamps.parquet",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
        mounts="results/{campaign}/calibration/mounts.json",
        clock=of(CampaignFiles.camera_clock),
    output:
        predictions="results/{campaign}/orientation/image_predictions.parquet",
    priority: URGENT
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        stated=of(CampaignFiles.stated_clock),
        off_boat=section("images", "off_boat"),
    script:
        "../scripts/predict_images.py"


rule start_camera:
    """The calibrated interior orientation of the camera, for the size of the survey's images."""
    input:
        calibrated=of(CampaignFiles.calibrated_interior),
        stamps="results/{campaign}/ingest/image_stamps.parquet",
    output:
        camera="results/{campaign}/orientation/camera_start.yaml",
    priority: URGENT
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        run=RUN,
        folders=of(CampaignFiles.interior_folders),
    script:
        "../scripts/start_camera.py"


rule mask_images:
    """Water, sky and the boat itself in the images, where nothing is to be matched (P2 6.1.1)."""
    input:
        images=raw("time_lapse"),
        predictions="results/{campaign}/orientation/image_predictions.parquet",
        camera=of(CampaignFiles.known_interior),
        interiors=of(CampaignFiles.folder_interiors),
        supplied=raw("masks"),
    output:
        masks=directory("results/{campaign}/orientation/masks"),
        table="results/{campaign}/orientation/masks.csv",
    priority: URGENT
    resources:
        mem_mb=memory(3000),
        runtime=minutes(60),
    params:
        seed=SEED,
        options=section("images", "masks"),
        folders=of(CampaignFiles.interior_folders),
        cameras=section("images", "mapping", "cameras"),
    script:
        "../scripts/mask_images.py"


rule extract_features:
    """Features of one part of the images; the parts are jobs of their own."""
    input:
        images=raw("time_lapse"),
        masks="results/{campaign}/orientation/masks",
    output:
        features=temp("results/{campaign}/orientation/sfm/features_{part}.npz"),
    priority: URGENT
    resources:
        mem_mb=memory(3200),
        runtime=minutes(60),
    params:
        part=lambda wildcards: int(wildcards.part),
        parts=of(CampaignFiles.n_parts, "features"),
        options=section("images", "features"),
        device=section("images", "device"),
    script:
        "../scripts/extract_features.py"


rule match_features:
    """What the pairs of images of one part have in common; the parts are jobs of their own."""
    input:
        features=of(CampaignFiles.feature_parts),
        images=raw("time_lapse"),
        camera=of(CampaignFiles.known_interior),
        interiors=of(CampaignFiles.folder_interiors),
        times="results/{campaign}/orientation/image_predictions.parquet",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
    output:
        pairs=temp("results/{campaign}/orientation/sfm/pairs_{part}.npz"),
    priority: URGENT
    resources:
        mem_mb=memory(2800, 20),
        runtime=minutes(60),
    params:
        part=lambda wildcards: int(wildcards.part),
        parts=of(CampaignFiles.n_parts, "mapping"),
        options=section("images", "mapping"),
        device=section("images", "device"),
        folders=of(CampaignFiles.interior_folders),
    script:
        "../scripts/match_features.py"


rule join_matches:
    """Which images have which points in common, of all parts."""
    input:
        features=of(CampaignFiles.feature_parts),
        pairs=of(CampaignFiles.pair_parts),
        images=raw("time_lapse"),
        camera=of(CampaignFiles.known_interior),
        interiors=of(CampaignFiles.folder_interiors),
        times="results/{campaign}/orientation/image_predictions.parquet",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
    output:
        matches="results/{campaign}/orientation/sfm/matches.npz",
    priority: URGENT
    resources:
        mem_mb=memory(2000, 5),
        runtime=minutes(20),
    params:
        options=section("images", "mapping"),
        folders=of(CampaignFiles.interior_folders),
    script:
        "../scripts/join_matches.py"


rule map_images:
    """Structure from motion: a block of images in a frame of its own."""
    input:
        matches="results/{campaign}/orientation/sfm/matches.npz",
    output:
        block="results/{campaign}/orientation/sfm/block.npz",
        pieces=directory("results/{campaign}/orientation/sfm/pieces"),
        images="results/{campaign}/orientation/sfm/images.csv",
        facts="results/{campaign}/orientation/sfm/facts.json",
    priority: URGENT
    threads: of(CampaignFiles.mapper_threads)
    resources:
        mem_mb=memory(2700, 100),
        runtime=minutes(120),
    params:
        options=section("images", "mapping"),
        device=section("images", "device"),
    script:
        "../scripts/map_images.py"


rule fuse_trajectory:
    """INS, antenna positions and image poses -> one trajectory of the boat."""
    input:
        states="results/{campaign}/ingest/ins_states.parquet",
        positions="results/{campaign}/ingest/positions.parquet",
        images="results/{campaign}/orientation/image_poses_timed.parquet",
        mounts="results/{campaign}/calibration/mounts.json",
    output:
        trajectory="results/{campaign}/orientation/trajectory_fused.parquet",
        observations="results/{campaign}/orientation/fused_observations.csv",
        counts="results/{campaign}/orientation/fused_counts.csv",
        facts="results/{campaign}/orientation/fused.json",
        errors="results/{campaign}/orientation/errors_fused.npz",
        adjusted="results/{campaign}/orientation/image_poses_fused.parquet",
    priority: URGENT
    resources:
        mem_mb=memory(3000),
        runtime=minutes(30),
    params:
        images_hold_positions=of(CampaignFiles.images_hold_positions),
        frame=FRAME,
        fused=section("fused"),
        orientation=section("orientation"),
        ins=section("ins"),
    script:
        "../scripts/fuse_trajectory.py"


rule measure_control_points:
    """Where each control point is in each image: predicted and found, or as a table says."""
    input:
        block="results/{campaign}/orientation/sfm/block.npz",
        pieces="results/{campaign}/orientation/sfm/pieces",
        predictions="results/{campaign}/orientation/image_predictions.parquet",
        control_points=raw("control_points"),
        image_marks=raw("image_marks"),
        images=raw("time_lapse"),
        # a white board before the sky may look like sky: automatic masks do not count here
        masks=raw("masks"),
    output:
        marks="results/{campaign}/orientation/control_marks.csv",
    priority: URGENT
    resources:
        mem_mb=memory(2600),
        runtime=minutes(30),
    params:
        frame=FRAME,
        crs=CRS,
        options=section("images", "control"),
    script:
        "../scripts/measure_control_points.py"


rule adjust_images:
    """Bundle adjustment with control points: poses of the images in the world, with covariances (P2 5.3)."""
    input:
        block="results/{campaign}/orientation/sfm/block.npz",
        pieces="results/{campaign}/orientation/sfm/pieces",
        sfm_images="results/{campaign}/orientation/sfm/images.csv",
        predictions="results/{campaign}/orientation/image_predictions.parquet",
        control_points=raw("control_points"),
        marks="results/{campaign}/orientation/control_marks.csv",
        interior=of(CampaignFiles.known_interior),
        interiors=of(CampaignFiles.folder_interiors),
        positions="results/{campaign}/ingest/positions.parquet",
        mounts="results/{campaign}/calibration/mounts.json",
    output:
        poses="results/{campaign}/orientation/image_poses.parquet",
        camera="results/{campaign}/orientation/camera.yaml",
        cameras="results/{campaign}/orientation/cameras.csv",
        control_report="results/{campaign}/orientation/control_points.csv",
        images_report="results/{campaign}/orientation/images.csv",
        facts="results/{campaign}/orientation/adjustment.json",
    priority: URGENT
    resources:
        mem_mb=memory(2900, 100),
        runtime=minutes(60),
    params:
        run=RUN,
        frame=FRAME,
        crs=CRS,
        adjustment=section("images", "adjustment"),
        control=section("images", "control"),
        folders=of(CampaignFiles.interior_folders),
    script:
        "../scripts/adjust_images.py"


rule import_orientations:
    """Poses of the images that another program has found."""
    input:
        files=raw("finished_orientations"),
        predictions="results/{campaign}/orientation/image_predictions.parquet",
        interior=of(CampaignFiles.known_interior),
    output:
        poses="results/{campaign}/orientation/image_poses_finished.parquet",
        camera="results/{campaign}/orientation/camera_finished.yaml",
        facts="results/{campaign}/orientation/finished.json",
    priority: URGENT
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        run=RUN,
        crs=CRS,
        finished=section("images", "finished"),
    script:
        "../scripts/import_orientations.py"


rule time_images:
    """When each image was taken: its stamp and the camera's clock, from the calibration and from the survey."""
    input:
        poses=of(CampaignFiles.oriented_images),
        stamps="results/{campaign}/ingest/image_stamps.parquet",
        positions="results/{campaign}/ingest/positions.parquet",
        states="results/{campaign}/ingest/ins_states.parquet",
        mounts="results/{campaign}/calibration/mounts.json",
        camera_clock=of(CampaignFiles.camera_clock),
        boat=of(CampaignFiles.camera_calibration),
    output:
        timed="results/{campaign}/orientation/image_poses_timed.parquet",
        times="results/{campaign}/orientation/image_times.parquet",
        clock="results/{campaign}/orientation/camera_clock.yaml",
        report="results/{campaign}/orientation/image_times.json",
    priority: URGENT
    resources:
        mem_mb=memory(2600),
        runtime=minutes(30),
    params:
        frame=FRAME,
        source=of(CampaignFiles.position_source),
        stated=of(CampaignFiles.stated_positions),
        options=of(CampaignFiles.clock_options),
        cloud=section("images", "cloud"),
        off_boat=section("images", "off_boat"),
    script:
        "../scripts/time_images.py"


rule camera_trajectory:
    """Poses of the boat by its camera, at the times of lidar points (P2 section 4)."""
    input:
        poses="results/{campaign}/orientation/image_poses_timed.parquet",
        states="results/{campaign}/ingest/ins_states.parquet",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
        mounts="results/{campaign}/calibration/mounts.json",
        boat=of(CampaignFiles.camera_calibration),
    output:
        trajectory_camera="results/{campaign}/orientation/trajectory_camera.parquet",
        mounts_camera="results/{campaign}/orientation/mounts_camera.json",
        images="results/{campaign}/orientation/camera_frames.csv",
        facts="results/{campaign}/orientation/camera_trajectory.json",
        errors="results/{campaign}/orientation/errors_camera.npz",
    priority: URGENT
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        cloud=section("images", "cloud"),
        orientation=section("orientation"),
        ins=section("ins"),
    script:
        "../scripts/camera_trajectory.py"
