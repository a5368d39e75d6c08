"""Raw logs -> documented tables and integrity reports."""


rule scan_lidar:
    """Clock, counts and losses of the lidar log; the points are streamed later."""
    input:
        lidar=raw("lidar"),
    output:
        clock="results/{campaign}/ingest/lidar.clock.json",
        integrity="results/{campaign}/ingest/lidar.integrity.json",
    log:
        "logs/{campaign}/ingest/scan_lidar.log",
    benchmark:
        "benchmarks/{campaign}/ingest/scan_lidar.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10, 20),
    params:
        code=code_version("scan_lidar"),
        lidar_options=section("lidar"),
    message:
        "{wildcards.campaign}: clock and integrity of the lidar log"
    script:
        "../scripts/scan_lidar.py"


rule read_ins:
    """States of the INS."""
    input:
        ins=ins_logs,
        smrmsg=smrmsg_logs,
    output:
        states="results/{campaign}/ingest/ins_states.parquet",
        depths="results/{campaign}/ingest/ins_depths.parquet",
        integrity="results/{campaign}/ingest/ins.integrity.json",
    log:
        "logs/{campaign}/ingest/read_ins.log",
    benchmark:
        "benchmarks/{campaign}/ingest/read_ins.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500, 20),
        runtime=minutes(10),
    params:
        code=code_version("read_ins"),
        source=position_source,
        gps_week=lambda wildcards: log_option(wildcards.campaign, "gps_week"),
    message:
        "{wildcards.campaign}: INS log"
    script:
        "../scripts/read_ins.py"


rule read_gnss:
    """On-board solution of the GNSS receiver."""
    input:
        sbp=raw("sbp"),
    output:
        positions="results/{campaign}/ingest/gnss_positions.parquet",
        integrity="results/{campaign}/ingest/gnss.integrity.json",
    log:
        "logs/{campaign}/ingest/read_gnss.log",
    benchmark:
        "benchmarks/{campaign}/ingest/read_gnss.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500, 20),
        runtime=minutes(10),
    params:
        code=code_version("read_gnss"),
    message:
        "{wildcards.campaign}: GNSS receiver log"
    script:
        "../scripts/read_gnss.py"


rule read_positions:
    """Positions of the antenna from the source that the campaign chooses (PPK included)."""
    input:
        logs=position_logs,
        base=base_logs,
        nav=nav_logs,
        states="results/{campaign}/ingest/ins_states.parquet",
    output:
        positions="results/{campaign}/ingest/positions.parquet",
        integrity="results/{campaign}/ingest/positions.integrity.json",
    log:
        "logs/{campaign}/ingest/read_positions.log",
    benchmark:
        "benchmarks/{campaign}/ingest/read_positions.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000, 20),
        runtime=minutes(20, 60),
    params:
        code=code_version("read_positions"),
        source=position_source,
        ppk=section("ppk"),
        base_position=base_position,
    message:
        "{wildcards.campaign}: positions"
    script:
        "../scripts/read_positions.py"


rule read_depth:
    """Soundings of the echo sounder."""
    input:
        depth=raw("depth"),
    output:
        depths="results/{campaign}/ingest/depths.parquet",
        integrity="results/{campaign}/ingest/depth.integrity.json",
    log:
        "logs/{campaign}/ingest/read_depth.log",
    benchmark:
        "benchmarks/{campaign}/ingest/read_depth.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("read_depth"),
        date=lambda wildcards: log_option(wildcards.campaign, "depth_date"),
    message:
        "{wildcards.campaign}: depth log"
    script:
        "../scripts/read_depth.py"


rule read_reference:
    """Reference clouds -> one cloud in the world frame, a station a source id."""
    input:
        reference=raw("reference"),
    output:
        cloud="results/{campaign}/ingest/reference.laz",
        integrity="results/{campaign}/ingest/reference.integrity.json",
    log:
        "logs/{campaign}/ingest/read_reference.log",
    benchmark:
        "benchmarks/{campaign}/ingest/read_reference.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000, 30),
        runtime=minutes(10, 60),
    params:
        code=code_version("read_reference"),
        campaign=identity("origin", "crs"),
    message:
        "{wildcards.campaign}: reference clouds"
    script:
        "../scripts/read_reference.py"


rule read_image_stamps:
    """When the images were taken, by the camera's clock."""
    input:
        images=stamped_images,
        times=stamp_tables,
    output:
        stamps="results/{campaign}/ingest/image_stamps.parquet",
        integrity="results/{campaign}/ingest/camera.integrity.json",
    log:
        "logs/{campaign}/ingest/read_image_stamps.log",
    benchmark:
        "benchmarks/{campaign}/ingest/read_image_stamps.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        code=code_version("read_image_stamps"),
        folders=names_hold_folders,
        source=stamp_options("source"),
        pattern=stamp_options("pattern"),
        utc_offset=stamp_options("utc_offset"),
    message:
        "{wildcards.campaign}: stamps of the images"
    script:
        "../scripts/read_image_stamps.py"
