"""Pictures for people, all from result tables."""


rule plot_survey_map:
    """Plan view of the survey (P1 Fig. 3)."""
    input:
        trajectory="results/{campaign}/orientation/trajectory.parquet",
        positions="results/{campaign}/ingest/positions.parquet",
        points="results/{campaign}/lidar/points.laz",
    output:
        survey_map_png=report(
            "results/{campaign}/figures/survey_map.png",
            caption="../report/survey_map.rst",
            category="Survey",
        ),
    log:
        "logs/{campaign}/figures/plot_survey_map.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_survey_map.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("plot_survey_map"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title", "crs"),
    message:
        "{wildcards.campaign}: survey map"
    script:
        "../scripts/plot_survey_map.py"


rule plot_streams_in_time:
    """All streams on the GPS time axis."""
    input:
        reports=reports,
    output:
        streams_in_time_png=report(
            "results/{campaign}/figures/streams_in_time.png",
            caption="../report/streams_in_time.rst",
            category="Survey",
        ),
    log:
        "logs/{campaign}/figures/plot_streams_in_time.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_streams_in_time.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("plot_streams_in_time"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title", "crs"),
    message:
        "{wildcards.campaign}: streams in time"
    script:
        "../scripts/plot_streams_in_time.py"


rule plot_cloud_overview:
    """The cloud of the reach (P1 Fig. 4)."""
    input:
        points="results/{campaign}/lidar/points.laz",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
    output:
        cloud_overview_png=report(
            "results/{campaign}/figures/cloud_overview.png",
            caption="../report/cloud_overview.rst",
            category="Point cloud",
        ),
    log:
        "logs/{campaign}/figures/plot_cloud_overview.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_cloud_overview.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000),
        runtime=minutes(10, 30),
    params:
        code=code_version("plot_cloud_overview"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title", "crs"),
    message:
        "{wildcards.campaign}: cloud of the reach"
    script:
        "../scripts/plot_cloud_overview.py"


rule plot_cloud_detail:
    """A detail of the bank by intensity (P1 Fig. 5)."""
    input:
        points="results/{campaign}/lidar/points.laz",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
    output:
        cloud_detail_png=report(
            "results/{campaign}/figures/cloud_detail.png",
            caption="../report/cloud_detail.rst",
            category="Point cloud",
        ),
    log:
        "logs/{campaign}/figures/plot_cloud_detail.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_cloud_detail.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000),
        runtime=minutes(10, 30),
    params:
        code=code_version("plot_cloud_detail"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title", "crs"),
    message:
        "{wildcards.campaign}: detail of the bank"
    script:
        "../scripts/plot_cloud_detail.py"


rule plot_error_versus_range:
    """Observed and predicted error by range."""
    input:
        by_range="results/{campaign}/accuracy/truth_by_range.csv",
    output:
        error_versus_range_png=report(
            "results/{campaign}/figures/error_versus_range.png",
            caption="../report/error_versus_range.rst",
            category="Accuracy",
        ),
    log:
        "logs/{campaign}/figures/plot_error_versus_range.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_error_versus_range.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("plot_error_versus_range"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title", "crs"),
    message:
        "{wildcards.campaign}: error versus range"
    script:
        "../scripts/plot_error_versus_range.py"
