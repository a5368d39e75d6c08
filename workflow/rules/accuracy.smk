"""How accurate the results are. Only these rules may read the truth of the digital twin."""


rule compare_with_truth:
    """Error of each point of a twin campaign against the true surface."""
    input:
        points="results/{campaign}/lidar/points.laz",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
        scene="results/{campaign}/simulation/truth/scene.npz",
        voyage="results/{campaign}/simulation/truth/trajectory.parquet",
        true_mounts="results/{campaign}/simulation/truth/mounts.json",
        shots="results/{campaign}/simulation/truth/lidar_shots.parquet",
    output:
        statistics="results/{campaign}/accuracy/truth_statistics.csv",
        by_range="results/{campaign}/accuracy/truth_by_range.csv",
        scores="results/{campaign}/accuracy/filter_scores.csv",
    log:
        "logs/{campaign}/accuracy/compare_with_truth.log",
    benchmark:
        "benchmarks/{campaign}/accuracy/compare_with_truth.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 2
    resources:
        mem_mb=memory(4000),
        runtime=minutes(10),
    params:
        code=code_version("compare_with_truth"),
        twin=twin_parts("lidar", "ins", "gnss"),
        mounts=mounts_of("lidar"),
        lidar_options=section("lidar"),
        orientation=section("orientation"),
    message:
        "{wildcards.campaign}: cloud against the truth of the digital twin"
    script:
        "../scripts/compare_with_truth.py"


rule summarise:
    """The most important figures of a campaign in one table."""
    input:
        streams="results/{campaign}/timing/streams.csv",
        trajectory="results/{campaign}/orientation/trajectory.json",
        counts="results/{campaign}/lidar/counts.csv",
        truth=truth_statistics,
    output:
        summary="results/{campaign}/summary.csv",
    log:
        "logs/{campaign}/accuracy/summarise.log",
    benchmark:
        "benchmarks/{campaign}/accuracy/summarise.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("summarise"),
    message:
        "{wildcards.campaign}: summary"
    script:
        "../scripts/summarise.py"
