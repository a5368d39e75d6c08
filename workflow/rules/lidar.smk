"""Packets -> points in the world."""


rule georeference_lidar:
    """Every lidar point into the world with its own pose."""
    input:
        lidar=raw("lidar"),
        clock="results/{campaign}/ingest/lidar.clock.json",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
        mounts="results/{campaign}/calibration/mounts.json",
    output:
        points="results/{campaign}/lidar/points.laz",
        removed="results/{campaign}/lidar/removed.parquet",
        counts="results/{campaign}/lidar/counts.csv",
    log:
        "logs/{campaign}/lidar/georeference_lidar.log",
    benchmark:
        "benchmarks/{campaign}/lidar/georeference_lidar.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 2
    resources:
        mem_mb=memory(3000),
        runtime=minutes(10, 20),
    params:
        code=code_version("georeference_lidar"),
        lidar_options=section("lidar"),
        lidar_accuracy=section("lidar_accuracy"),
        georeferencing=georeferencing,
        filters=section("filters"),
    message:
        "{wildcards.campaign}: lidar points into the world"
    script:
        "../scripts/georeference_lidar.py"


rule export_map:
    """The cloud in the national grid, for other programs."""
    input:
        points="results/{campaign}/lidar/points.laz",
    output:
        points_map="results/{campaign}/lidar/points_map.laz",
    log:
        "logs/{campaign}/lidar/export_map.log",
    benchmark:
        "benchmarks/{campaign}/lidar/export_map.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10, 60),
    params:
        code=code_version("export_map"),
        campaign=identity("crs"),
    message:
        "{wildcards.campaign}: cloud in the map grid"
    script:
        "../scripts/export_map.py"


# The same points by the trajectory of the camera, or of all sensors.
use rule georeference_lidar as georeference_by_trajectory with:
    input:
        lidar=raw("lidar"),
        clock="results/{campaign}/ingest/lidar.clock.json",
        trajectory=trajectory_of_chain,
        mounts=mounts_of_chain,
    output:
        points="results/{campaign}/lidar/by_{chain}/points.laz",
        removed="results/{campaign}/lidar/by_{chain}/removed.parquet",
        counts="results/{campaign}/lidar/by_{chain}/counts.csv",
    log:
        "logs/{campaign}/lidar/georeference_by_{chain}.log",
    benchmark:
        "benchmarks/{campaign}/lidar/georeference_by_{chain}.jsonl"
    message:
        "{wildcards.campaign}: lidar points into the world by the trajectory of {wildcards.chain}"
