"""A camera with two fisheye lenses: its calibration, where its files were taken, and panoramas."""


rule calibrate_rig:
    """Interior orientations of both lenses and their relative orientation, from a field around the rig."""
    input:
        images=raw("rig_field_images"),
        field=raw("rig_field"),
        points=raw("rig_field_points"),
    output:
        calibration="results/{campaign}/calibration/rig.yaml",
        residuals="results/{campaign}/calibration/rig_residuals.csv",
        exposures="results/{campaign}/calibration/rig_exposures.csv",
        report="results/{campaign}/calibration/rig.json",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20, 60),
    params:
        run=RUN,
        rig=of(CampaignFiles.rig_views),
    script:
        "../scripts/calibrate_rig.py"


rule orient_rig:
    """A block of the files of the rig: one pose for each, both lenses as calibrated."""
    input:
        images=raw("rig_images"),
        calibration=of(CampaignFiles.rig_calibration),
        predictions="results/{campaign}/orientation/image_predictions.parquet",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
        control_points=raw("control_points"),
        image_marks=raw("image_marks"),
        positions="results/{campaign}/ingest/positions.parquet",
        mounts="results/{campaign}/calibration/mounts.json",
    output:
        poses="results/{campaign}/orientation/image_poses_rig.parquet",
        control_report="results/{campaign}/orientation/control_points_rig.csv",
        images_report="results/{campaign}/orientation/images_rig.csv",
        facts="results/{campaign}/orientation/adjustment_rig.json",
    priority: URGENT
    threads: 2
    resources:
        mem_mb=memory(4000, 5),
        runtime=minutes(60, 60),
    params:
        **calls("thalweg.images.photographs:orient_rig_files"),
        campaign=identity("origin", "crs"),
        rig=of(CampaignFiles.rig_views),
        device=section("images", "device"),
        features=section("images", "features"),
        mapping=section("images", "mapping"),
        adjustment=section("images", "adjustment"),
        control=section("images", "control"),
    script:
        "../scripts/call.py"


rule place_rig_images:
    """When and where the front lens of the rig took each of its files."""
    input:
        images=raw("rig_images"),
        times=raw("rig_times"),
        trajectory=of(CampaignFiles.best_trajectory),
    output:
        stamps="results/{campaign}/ingest/rig_stamps.parquet",
        integrity="results/{campaign}/ingest/rig.integrity.json",
        poses="results/{campaign}/panorama/poses.parquet",
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        rig=section("rig"),
    script:
        "../scripts/place_rig_images.py"


rule make_panoramas:
    """Equirectangular panoramas of the rig, stitched at the ranges of the cloud."""
    input:
        images=raw("rig_images"),
        poses=of(CampaignFiles.rig_poses),
        calibration=of(CampaignFiles.rig_calibration),
        points=of(CampaignFiles.panorama_points),
    output:
        pictures=directory("results/{campaign}/panorama/pictures"),
        table="results/{campaign}/panorama/panoramas.parquet",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(30, 120),
    params:
        rig=of(CampaignFiles.rig_views),
        panorama=section("panorama"),
    script:
        "../scripts/make_panoramas.py"


# The page of the cloud, seen from panorama to panorama.
use rule viewer_page as walk_page with:
    input:
        points=of(CampaignFiles.walk_points),
        trajectory=of(CampaignFiles.page_path),
        gains=of(CampaignFiles.colour_gains),
        images=of(CampaignFiles.colour_images),
        rig_images=of(CampaignFiles.rig_images),
        table="results/{campaign}/panorama/panoramas.parquet",
        pictures="results/{campaign}/panorama/pictures",
    output:
        page="results/{campaign}/panorama/index.html",
        nodes=directory("results/{campaign}/panorama/nodes"),
        views=directory("results/{campaign}/panorama/views"),
