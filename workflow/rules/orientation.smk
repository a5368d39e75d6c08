"""Where the boat is and how it lies."""


rule build_trajectory:
    """Antenna positions and INS attitudes -> poses of the boat with sigmas."""
    input:
        states="results/{campaign}/ingest/ins_states.parquet",
        positions="results/{campaign}/ingest/positions.parquet",
        streams="results/{campaign}/timing/streams.csv",
        mounts="results/{campaign}/calibration/mounts.json",
    output:
        trajectory="results/{campaign}/orientation/trajectory.parquet",
        summary="results/{campaign}/orientation/trajectory.json",
    log:
        "logs/{campaign}/orientation/build_trajectory.log",
    benchmark:
        "benchmarks/{campaign}/orientation/build_trajectory.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("build_trajectory"),
        campaign=identity("origin"),
        orientation=section("orientation"),
        ins=section("ins"),
    message:
        "{wildcards.campaign}: trajectory"
    script:
        "../scripts/build_trajectory.py"
