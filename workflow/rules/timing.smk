"""One GPS time axis for all streams."""


rule align_streams:
    """Do all streams carry GPS time, and do they overlap?"""
    input:
        reports=reports,
        states="results/{campaign}/ingest/ins_states.parquet",
        positions="results/{campaign}/ingest/positions.parquet",
        mounts="results/{campaign}/calibration/mounts.json",
    output:
        streams="results/{campaign}/timing/streams.csv",
    log:
        "logs/{campaign}/timing/align_streams.log",
    benchmark:
        "benchmarks/{campaign}/timing/align_streams.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("align_streams"),
        campaign=identity("origin"),
        source=position_source,
    message:
        "{wildcards.campaign}: time axis of all streams"
    script:
        "../scripts/align_streams.py"
