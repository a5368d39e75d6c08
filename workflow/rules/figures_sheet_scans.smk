"""Figures of scans with the underwater light-sheet sensor, and of its survey beside an echo sounder."""


rule plot_scan_distances:
    """A scan coloured by its distance from the reference, and their histogram (P4 Fig. 19 and 20)."""
    input:
        distances="results/{campaign}/triangulation/{scan}/distances.parquet",
        statistics="results/{campaign}/triangulation/{scan}/statistics.csv",
        facts="results/{campaign}/triangulation/{scan}/facts.json",
    output:
        scan_distances_png=report(
            "results/{campaign}/figures/scan_{scan}.png",
            caption="../report/scan_distances.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_scan_distances_{scan}.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_scan_distances_{scan}.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_scan_distances"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
        scanned=lambda wildcards: wildcards.scan,
    message:
        "{wildcards.campaign}: picture of the scan of {wildcards.scan}"
    script:
        "../scripts/plot_scan_distances.py"


rule plot_sheet_image:
    """An image of a scan with the line that was measured in it (P4 Fig. 18)."""
    input:
        images=of_scan("images"),
        line_points="results/{campaign}/triangulation/{scan}/line_points.parquet",
    output:
        sheet_image_png=report(
            "results/{campaign}/figures/sheet_image_{scan}.png",
            caption="../report/sheet_image.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_sheet_image_{scan}.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_sheet_image_{scan}.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_sheet_image"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
        scanned=lambda wildcards: wildcards.scan,
    message:
        "{wildcards.campaign}: picture of a line on {wildcards.scan}"
    script:
        "../scripts/plot_sheet_image.py"


rule plot_joint_survey:
    """Echo sounder and light sheet on a small river (T Fig. 3.5)."""
    input:
        table="results/{campaign}/triangulation/joint_survey.csv",
        facts="results/{campaign}/triangulation/joint_survey.json",
        places="results/{campaign}/triangulation/joint_survey.parquet",
    output:
        joint_survey_png=report(
            "results/{campaign}/figures/joint_survey.png",
            caption="../report/joint_survey.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_joint_survey.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_joint_survey.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_joint_survey"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: picture of a joint survey"
    script:
        "../scripts/plot_joint_survey.py"
