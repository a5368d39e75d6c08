"""Where the sensors sit on the boat, and how well that is known."""


rule collect_mounts:
    """The mounts of a campaign: from its file, or from the calibration that it names."""
    input:
        calibration=calibration_file,
    output:
        mounts="results/{campaign}/calibration/mounts.json",
    log:
        "logs/{campaign}/calibration/collect_mounts.log",
    benchmark:
        "benchmarks/{campaign}/calibration/collect_mounts.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1000),
        runtime=minutes(10),
    params:
        code=code_version("collect_mounts"),
        section=section("mounts"),
    message:
        "{wildcards.campaign}: mounts of the sensors"
    script:
        "../scripts/collect_mounts.py"
