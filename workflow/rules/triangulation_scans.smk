"""Scans with the underwater light-sheet sensor: poses, cloud, comparison, orthophoto (P4 7); bed strips (T 3.2)."""


rule locate_sheet_sensor:
    """Where the sensor was at each image of a scan, by a standing camera (P4 4.2.1)."""
    input:
        images=of_wildcard("scan", CampaignFiles.scan_logs, "images"),
        panel=of_wildcard("scan", CampaignFiles.scan_logs, "panel"),
        marks=of_wildcard("scan", CampaignFiles.scan_logs, "marks"),
        camera=of_wildcard("scan", CampaignFiles.scan_logs, "camera"),
        pulses=of_wildcard("scan", CampaignFiles.scan_logs, "pulses"),
    output:
        poses="results/{campaign}/triangulation/{scan}/poses.npz",
        table="results/{campaign}/triangulation/{scan}/poses.csv",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    script:
        "../scripts/locate_sheet_sensor.py"


rule merge_scan:
    """All profiles of a scan as one cloud, with the covariance of each point (P4 7.3)."""
    input:
        sensor="results/{campaign}/triangulation/sensor.yaml",
        line_points="results/{campaign}/triangulation/{scan}/line_points.parquet",
        poses="results/{campaign}/triangulation/{scan}/poses.npz",
    output:
        points="results/{campaign}/triangulation/{scan}/points.parquet",
        counts="results/{campaign}/triangulation/{scan}/counts.json",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    script:
        "../scripts/merge_scan.py"


rule compare_scan:
    """Distances of a scan from a mesh or from known planes, and of its middle profile by itself (P4 7.2, 7.3)."""
    input:
        sensor="results/{campaign}/triangulation/sensor.yaml",
        line_points="results/{campaign}/triangulation/{scan}/line_points.parquet",
        poses="results/{campaign}/triangulation/{scan}/poses.npz",
        reference=of_wildcard("scan", CampaignFiles.scan_logs, "reference"),
        pairs=of_wildcard("scan", CampaignFiles.scan_logs, "pairs"),
    output:
        statistics="results/{campaign}/triangulation/{scan}/statistics.csv",
        lines="results/{campaign}/triangulation/{scan}/lines.csv",
        distances="results/{campaign}/triangulation/{scan}/distances.parquet",
        facts="results/{campaign}/triangulation/{scan}/facts.json",
        profile="results/{campaign}/triangulation/{scan}/profile.csv",
        profile_facts="results/{campaign}/triangulation/{scan}/profile.json",
    resources:
        mem_mb=memory(2500, 15),
        runtime=minutes(20),
    params:
        scanned=lambda wildcards: wildcards.scan,
        levels_mm=of_wildcard("scan", CampaignFiles.scan_levels),
    script:
        "../scripts/compare_scan.py"


rule rectify_scan:
    """Orthophoto of a scanned object from the images that hold its lines (P4 4.1)."""
    input:
        images=of_wildcard("scan", CampaignFiles.scan_logs, "images"),
        sensor="results/{campaign}/triangulation/sensor.yaml",
        line_points="results/{campaign}/triangulation/{scan}/line_points.parquet",
        poses="results/{campaign}/triangulation/{scan}/poses.npz",
        facts="results/{campaign}/triangulation/{scan}/facts.json",
    output:
        picture="results/{campaign}/triangulation/{scan}/orthophoto.png",
        world="results/{campaign}/triangulation/{scan}/orthophoto.pgw",
        report="results/{campaign}/triangulation/{scan}/orthophoto.json",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        lines=section("light_sheet", "lines"),
        cell_m=0.0005,
    script:
        "../scripts/rectify_scan.py"


rule locate_bed_strip:
    """Points of the bed under the boat in the world, with the covariance of each (T 3.2)."""
    input:
        images=raw("strip_images"),
        pulses=raw("strip_pulses"),
        line_points="results/{campaign}/triangulation/strip/line_points.parquet",
        sensor=of(CampaignFiles.sheet_on_board),
        trajectory=of(CampaignFiles.best_trajectory),
    output:
        bed="results/{campaign}/triangulation/strip/bed.laz",
        points="results/{campaign}/triangulation/strip/points.parquet",
        counts="results/{campaign}/triangulation/strip/counts.json",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        frame=FRAME,
        mount=section("light_sheet", "mount"),
        water=section("light_sheet", "water"),
        chain=of(CampaignFiles.best_chain),
    script:
        "../scripts/locate_bed_strip.py"
