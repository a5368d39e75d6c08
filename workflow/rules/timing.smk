"""One GPS time axis for all streams."""


rule align_streams:
    """Do all streams carry GPS time, and do they overlap?"""
    input:
        reports=of(CampaignFiles.reports),
        states=of(CampaignFiles.ins_states),
        positions="results/{campaign}/ingest/positions.parquet",
        mounts="results/{campaign}/calibration/mounts.json",
    output:
        streams="results/{campaign}/timing/streams.csv",
    priority: URGENT
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        frame=FRAME,
        source=of(CampaignFiles.position_source),
    script:
        "../scripts/align_streams.py"


rule synchronise_camera:
    """Offset of the camera's clock from its run about the field."""
    input:
        poses="results/{campaign}/calibration/camera_poses.parquet",
        place="results/{campaign}/calibration/field.json",
        stamps="results/{campaign}/ingest/image_stamps.parquet",
        positions="results/{campaign}/ingest/positions.parquet",
        states="results/{campaign}/ingest/ins_states.parquet",
    output:
        clock="results/{campaign}/timing/camera_clock.yaml",
        images="results/{campaign}/timing/image_times.parquet",
        report="results/{campaign}/timing/camera_clock.json",
        fixes="results/{campaign}/timing/image_fixes.parquet",
        track="results/{campaign}/timing/antenna_track.parquet",
    priority: URGENT
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        frame=FRAME,
        options=of(CampaignFiles.clock_options),
    script:
        "../scripts/synchronise_camera.py"


rule clock_from_ties:
    """Clock of the camera from comparisons before and after a run, or from the pulses of its trigger."""
    input:
        ties=raw("clock_ties"),
        pulses=raw("trigger_pulses"),
        stamps="results/{campaign}/ingest/image_stamps.parquet",
        stability=of(CampaignFiles.clock_stability),
    output:
        clock="results/{campaign}/timing/camera_clock_ties.yaml",
        images="results/{campaign}/timing/image_times_ties.parquet",
    priority: URGENT
    resources:
        mem_mb=memory(1000),
        runtime=minutes(10),
    params:
        options=of(CampaignFiles.clock_options),
    script:
        "../scripts/clock_from_ties.py"


rule read_display:
    """Photographs of a running clock: how evenly the camera takes its images."""
    input:
        photos=raw("display"),
        labels=raw("display_labels"),
    output:
        display="results/{campaign}/timing/display.csv",
        stability="results/{campaign}/timing/clock_stability.json",
    priority: URGENT
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        options=section("calibration", "display"),
    script:
        "../scripts/read_display.py"


rule time_report:
    """Who stamps what, how well, and what it costs at the bank."""
    input:
        streams="results/{campaign}/timing/streams.csv",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
        clock=of(CampaignFiles.camera_clock),
        stability=of(CampaignFiles.clock_stability),
        images=of(CampaignFiles.tied_images),
    output:
        report="results/{campaign}/timing/time_report.csv",
        text="results/{campaign}/timing/time_report.txt",
    priority: URGENT
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        range_m=25.0,
    script:
        "../scripts/time_report.py"
