"""Packets -> points in the world."""


rule estimate_pose_errors:
    """How large the errors of the poses are, from surfaces that the lidar saw again; sigmas of the poses."""
    input:
        lidar=raw("lidar"),
        clock=where(CampaignFiles.has_lidar, "ingest/lidar.clock.json"),
        stated="results/{campaign}/orientation/trajectory_stated.parquet",
        positions="results/{campaign}/ingest/positions.parquet",
        mounts="results/{campaign}/calibration/mounts.json",
    output:
        trajectory="results/{campaign}/orientation/trajectory.parquet",
        error_model="results/{campaign}/orientation/error_model.json",
    priority: URGENT
    resources:
        mem_mb=memory(2500),
        runtime=minutes(10, 20),
    params:
        lidar_options=of(CampaignFiles.lidar_options),
        lidar_accuracy=section("lidar_accuracy"),
        georeferencing=of(CampaignFiles.georeferencing),
        filters=section("filters"),
        orientation=section("orientation"),
    script:
        "../scripts/estimate_pose_errors.py"


rule adjust_strips:
    """Surfaces that the lidar saw again -> the best trajectory and the lidar's mount, corrected by them."""
    input:
        lidar=raw("lidar"),
        clock="results/{campaign}/ingest/lidar.clock.json",
        trajectory=of(CampaignFiles.trajectory_of_sensors),
        errors=of(CampaignFiles.errors_of_sensors),
        stable=raw("stable"),
        mounts="results/{campaign}/calibration/mounts.json",
        positions="results/{campaign}/ingest/positions.parquet",
        error_model="results/{campaign}/orientation/error_model.json",
    output:
        of_boat="results/{campaign}/orientation/trajectory_strips.parquet",
        of_lidar="results/{campaign}/orientation/trajectory_strips_lidar.parquet",
        chains="results/{campaign}/orientation/errors_strips.npz",
        chains_of_lidar="results/{campaign}/orientation/errors_strips_lidar.npz",
        mounts_strips="results/{campaign}/orientation/mounts_strips.json",
        knots="results/{campaign}/orientation/strips_knots.csv",
        border="results/{campaign}/orientation/strips_border.csv",
        observations="results/{campaign}/orientation/strips_observations.csv",
        facts="results/{campaign}/orientation/strips.json",
        page="results/{campaign}/orientation/strips.html",
    resources:
        mem_mb=memory(3000),
        runtime=minutes(20, 30),
    params:
        lidar_options=of(CampaignFiles.lidar_options),
        lidar_accuracy=section("lidar_accuracy"),
        georeferencing=of(CampaignFiles.georeferencing),
        filters=section("filters"),
        orientation=section("orientation"),
        strips=section("strips"),
        crs=CRS,
        title=TITLE,
        twin=TWIN,
    script:
        "../scripts/adjust_strips.py"


rule georeference_lidar:
    """Every lidar point into the world with its own pose: by the INS, or ``by_camera/``, ``by_fused/``, ``by_strips/``."""
    input:
        lidar=raw("lidar"),
        clock="results/{campaign}/ingest/lidar.clock.json",
        trajectory=of_wildcard("by", CampaignFiles.trajectory_of_lidar),
        mounts=of_wildcard("by", CampaignFiles.mounts_of_chain),
        error_model="results/{campaign}/orientation/error_model.json",
        window_points=of_wildcard("by", CampaignFiles.windows, "points", ".las"),
        window_rests=of_wildcard("by", CampaignFiles.windows, "rest", ".npz"),
    output:
        points="results/{campaign}/lidar/{by}points.laz",
        removed="results/{campaign}/lidar/{by}removed.parquet",
        counts="results/{campaign}/lidar/{by}counts.csv",
    log:
        "logs/{campaign}/lidar/{by}georeference_lidar.log",
    resources:
        mem_mb=memory(3000),
        runtime=minutes(10, 20),
    params:
        lidar_options=of(CampaignFiles.lidar_options),
        lidar_accuracy=section("lidar_accuracy"),
        georeferencing=of(CampaignFiles.georeferencing),
        filters=section("filters"),
    script:
        "../scripts/georeference_lidar.py"


rule export_map:
    """The cloud by the best trajectory in the national grid, for other programs."""
    input:
        points=of(CampaignFiles.best_cloud),
    output:
        out="results/{campaign}/lidar/points_map.laz",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10, 60),
    params:
        **calls("thalweg.lidar.cloud:export_map"),
        crs=CRS,
    script:
        "../scripts/call.py"


rule export_copc:
    """The cloud in map coordinates, sorted for programs that read what they show (COPC)."""
    input:
        points="results/{campaign}/lidar/points_map.laz",
    output:
        out="results/{campaign}/lidar/points_map.copc.laz",
    resources:
        mem_mb=memory(1000),
        runtime=minutes(10, 60),
    params:
        **calls("thalweg.lidar.copc:export_copc"),
    script:
        "../scripts/call.py"


rule georeference_window:
    """The points of a window of a long log, without those that no other point of the whole log lies near to."""
    input:
        lidar=raw("lidar"),
        clock="results/{campaign}/ingest/lidar.clock.json",
        trajectory=of_wildcard("chain", CampaignFiles.trajectory_of_lidar),
        mounts=of_wildcard("chain", CampaignFiles.mounts_of_chain),
        error_model="results/{campaign}/orientation/error_model.json",
        densities=of_wildcard("chain", CampaignFiles.windows, "density", ".npz"),
    output:
        out=[
            temp("results/{campaign}/lidar/windows/{chain}_points_{part}.las"),
            temp("results/{campaign}/lidar/windows/{chain}_rest_{part}.npz"),
        ],
    wildcard_constraints:
        chain="ins|camera|fused|strips",
    resources:
        mem_mb=memory(3000),
        runtime=minutes(10, 20),
    params:
        lidar_options=of(CampaignFiles.lidar_options),
        lidar_accuracy=section("lidar_accuracy"),
        georeferencing=of(CampaignFiles.georeferencing),
        filters=section("filters"),
        window=of_wildcard("part", CampaignFiles.window),
    script:
        "../scripts/georeference_window.py"


# Before that: where the points of a window lie, for the filters of all windows.
use rule georeference_window as count_neighbours with:
    input:
        lidar=raw("lidar"),
        clock="results/{campaign}/ingest/lidar.clock.json",
        trajectory=of_wildcard("chain", CampaignFiles.trajectory_of_lidar),
        mounts=of_wildcard("chain", CampaignFiles.mounts_of_chain),
        error_model="results/{campaign}/orientation/error_model.json",
        densities=[],
    output:
        out=temp("results/{campaign}/lidar/windows/{chain}_density_{part}.npz"),
    benchmark:
        "benchmarks/{campaign}/lidar/count_neighbours_{chain}_{part}.jsonl"


rule colour_points:
    """The cloud in the colours of the photographs that show it, without what hides behind something nearer."""
    input:
        points=of(CampaignFiles.best_points),
        poses=where(
            CampaignFiles.has_colour_images, "orientation/image_poses_fused.parquet"
        ),
        camera=of(CampaignFiles.colour_camera),
        images=of(CampaignFiles.colour_images),
        masks=of(CampaignFiles.colour_masks),
        rig_images=of(CampaignFiles.rig_images),
        rig_poses=of(CampaignFiles.rig_poses),
        rig_calibration=of(CampaignFiles.used_rig),
    output:
        coloured="results/{campaign}/lidar/coloured.laz",
        counts="results/{campaign}/lidar/coloured.csv",
        gains="results/{campaign}/lidar/coloured_gains.csv",
    resources:
        mem_mb=memory(3000),
        runtime=minutes(20, 120),
    params:
        colour=section("colour"),
        rig=of(CampaignFiles.rig_views),
    script:
        "../scripts/colour_points.py"


rule check_colours:
    """Clock and mount of the camera, tested by intensities of the cloud against the brightness of photographs."""
    input:
        points=of(CampaignFiles.best_points),
        poses="results/{campaign}/orientation/image_poses_timed.parquet",
        camera=of(CampaignFiles.adjusted_camera),
        images=raw("time_lapse"),
        masks=of(CampaignFiles.used_masks),
    output:
        table="results/{campaign}/lidar/colour_check.csv",
        curves="results/{campaign}/lidar/colour_check_curves.csv",
    resources:
        mem_mb=memory(3000),
        runtime=minutes(20, 120),
    params:
        colour=section("colour"),
    script:
        "../scripts/check_colours.py"


rule viewer_page:
    """The cloud in a page that opens from disk, to turn, to measure in, and to hand on."""
    input:
        points=of(CampaignFiles.page_clouds),
        trajectory=of(CampaignFiles.page_path),
        gains=of(CampaignFiles.colour_gains),
        images=of(CampaignFiles.colour_images),
        rig_images=of(CampaignFiles.rig_images),
        table=where(CampaignFiles.has_panoramas, "panorama/panoramas.parquet"),
    output:
        page="results/{campaign}/viewer/index.html",
        nodes=directory("results/{campaign}/viewer/nodes"),
    resources:
        mem_mb=memory(3000),
        runtime=minutes(10),
    params:
        **calls("thalweg.figures.viewer.page:write_survey_viewer"),
        title=TITLE,
        names=of(CampaignFiles.page_names),
        twin=TWIN,
        crs=CRS,
    script:
        "../scripts/call.py"
