"""Raw logs -> documented tables and integrity reports."""


rule scan_lidar:
    """Clock, counts and losses of the lidar log; the points are streamed later."""
    input:
        lidar=raw("lidar"),
        trajectory=where(
            CampaignFiles.motion_tells_time, "orientation/trajectory_stated.parquet"
        ),
        mounts=where(CampaignFiles.motion_tells_time, "calibration/mounts.json"),
    output:
        clock="results/{campaign}/ingest/lidar.clock.json",
        integrity="results/{campaign}/ingest/lidar.integrity.json",
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10, 20),
    params:
        stated=section("lidar", "clock"),
        lidar_options=of(CampaignFiles.lidar_options),
        filters=section("filters"),
    script:
        "../scripts/scan_lidar.py"


rule read_ins:
    """States of the INS."""
    input:
        ins=of(CampaignFiles.ins_logs),
        smrmsg=of(CampaignFiles.smrmsg_logs),
    output:
        states="results/{campaign}/ingest/ins_states.parquet",
        depths="results/{campaign}/ingest/ins_depths.parquet",
        integrity="results/{campaign}/ingest/ins.integrity.json",
    resources:
        mem_mb=memory(1500, 20),
        runtime=minutes(10),
    params:
        source=of(CampaignFiles.position_source),
        frame=FRAME,
        options=of(CampaignFiles.track_options),
    script:
        "../scripts/read_ins.py"


rule read_gnss:
    """On-board solution of the GNSS receiver."""
    input:
        sbp=raw("sbp"),
    output:
        positions="results/{campaign}/ingest/gnss_positions.parquet",
        integrity="results/{campaign}/ingest/gnss.integrity.json",
    resources:
        mem_mb=memory(1500, 20),
        runtime=minutes(10),
    script:
        "../scripts/read_gnss.py"


rule read_positions:
    """Positions of the antenna from the source that the campaign chooses (PPK included)."""
    input:
        logs=of(CampaignFiles.position_logs),
        base=of(CampaignFiles.ppk_logs, "base"),
        nav=of(CampaignFiles.ppk_logs, "nav"),
        states=of(CampaignFiles.ins_states),
    output:
        positions="results/{campaign}/ingest/positions.parquet",
        integrity="results/{campaign}/ingest/positions.integrity.json",
    resources:
        mem_mb=memory(2000, 20),
        runtime=minutes(20, 60),
    params:
        source=of(CampaignFiles.position_source),
        date=of(CampaignFiles.log_option, "depth_date"),
        topics=of(CampaignFiles.topics, "pos"),
        ppk=section("ppk"),
        base_position=of(CampaignFiles.base_position),
    script:
        "../scripts/read_positions.py"


rule export_track:
    """The track of raw GNSS for maps and globes."""
    input:
        positions="results/{campaign}/ingest/positions.parquet",
    output:
        out_geojson="results/{campaign}/orientation/track.geojson",
        out_kml="results/{campaign}/orientation/track.kml",
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        **calls("thalweg.ingest.ppk.exports:write_track"),
        name=TITLE,
    script:
        "../scripts/call.py"


rule read_depth:
    """Soundings of the echo sounder."""
    input:
        depth=raw("depth"),
    output:
        depths="results/{campaign}/ingest/depths.parquet",
        integrity="results/{campaign}/ingest/depth.integrity.json",
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        date=of(CampaignFiles.log_option, "depth_date"),
        topics=of(CampaignFiles.topics, "depth"),
    script:
        "../scripts/read_depth.py"


rule read_reference:
    """Reference clouds -> one cloud in the world frame, a station a source id."""
    input:
        reference=raw("reference"),
    output:
        cloud="results/{campaign}/ingest/reference.laz",
        integrity="results/{campaign}/ingest/reference.integrity.json",
    resources:
        mem_mb=memory(2000, 30),
        runtime=minutes(10, 60),
    params:
        frame=FRAME,
        crs=CRS,
    script:
        "../scripts/read_reference.py"


rule read_image_stamps:
    """When the images were taken, by the camera's clock."""
    input:
        images=of(CampaignFiles.stamped_images),
        times=of(CampaignFiles.stamp_tables),
    output:
        stamps="results/{campaign}/ingest/image_stamps.parquet",
        integrity="results/{campaign}/ingest/camera.integrity.json",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        folders=of(CampaignFiles.has_time_lapse),
        source=of(CampaignFiles.stamp_option, "source"),
        pattern=of(CampaignFiles.stamp_option, "pattern"),
        utc_offset=of(CampaignFiles.stamp_option, "utc_offset"),
    script:
        "../scripts/read_image_stamps.py"
