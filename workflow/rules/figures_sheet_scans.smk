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


rule plot_scan_profile:
    """The middle line of a scan: points, distances with predicted sigma, histogram (P4 Fig. 19)."""
    input:
        distances="results/{campaign}/triangulation/{scan}/distances.parquet",
        facts="results/{campaign}/triangulation/{scan}/facts.json",
        profile="results/{campaign}/triangulation/{scan}/profile.json",
    output:
        scan_profile_png=report(
            "results/{campaign}/figures/profile_of_{scan}.png",
            caption="../report/scan_profile.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_scan_profile_{scan}.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_scan_profile_{scan}.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_scan_profile"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
        scanned=lambda wildcards: wildcards.scan,
    message:
        "{wildcards.campaign}: picture of the middle line on {wildcards.scan}"
    script:
        "../scripts/plot_scan_profile.py"


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


rule plot_scan_setup:
    """Standing camera, panel, sensor and object of a scan, and three of its poses (P4 Fig. 8 and 17)."""
    input:
        sensor="results/{campaign}/triangulation/sensor.yaml",
        poses="results/{campaign}/triangulation/{scan}/poses.npz",
        panel=of_scan("panel"),
        camera=of_scan("camera"),
        points="results/{campaign}/triangulation/{scan}/points.parquet",
    output:
        scan_setup_png=report(
            "results/{campaign}/figures/setup_of_{scan}.png",
            caption="../report/scan_setup.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_scan_setup_{scan}.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_scan_setup_{scan}.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_scan_setup"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
        scanned=lambda wildcards: wildcards.scan,
    message:
        "{wildcards.campaign}: picture of the set-up over {wildcards.scan}"
    script:
        "../scripts/plot_scan_setup.py"


rule plot_scan_reference:
    """The scanned object: orthophoto, reference, the scan on it, its levels (P4 Fig. 14, 15 and 20)."""
    input:
        picture="results/{campaign}/triangulation/{scan}/orthophoto.png",
        world="results/{campaign}/triangulation/{scan}/orthophoto.pgw",
        reference=of_scan("reference"),
        distances="results/{campaign}/triangulation/{scan}/distances.parquet",
        facts="results/{campaign}/triangulation/{scan}/facts.json",
    output:
        scan_reference_png=report(
            "results/{campaign}/figures/reference_of_{scan}.png",
            caption="../report/scan_reference.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_scan_reference_{scan}.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_scan_reference_{scan}.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000),
        runtime=minutes(10),
    params:
        code=code_version("plot_scan_reference"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
        scanned=lambda wildcards: wildcards.scan,
    message:
        "{wildcards.campaign}: picture of the object {wildcards.scan}"
    script:
        "../scripts/plot_scan_reference.py"


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


rule plot_bed_strip:
    """A strip of the bed under the boat, for a twin beside the true one (T 3.2)."""
    input:
        points="results/{campaign}/triangulation/strip/points.parquet",
        truth=strip_truth("truth_bed_strip.csv"),
        truth_lines=strip_truth("truth_bed_strip_lines.csv"),
    output:
        bed_strip_png=report(
            "results/{campaign}/figures/bed_strip.png",
            caption="../report/bed_strip.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_bed_strip.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_bed_strip.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_bed_strip"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: picture of a strip of the bed"
    script:
        "../scripts/plot_bed_strip.py"


rule bed_strip_page:
    """A strip of the bed under the boat on one page (T 3.2)."""
    input:
        counts="results/{campaign}/triangulation/strip/counts.json",
        picture="results/{campaign}/figures/bed_strip.png",
        caption=ROOT / "workflow" / "report" / "bed_strip.rst",
    output:
        page="results/{campaign}/triangulation/strip/index.html",
    log:
        "logs/{campaign}/triangulation/bed_strip_page.log",
    benchmark:
        "benchmarks/{campaign}/triangulation/bed_strip_page.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("bed_strip_page"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: page on a strip of the bed"
    script:
        "../scripts/bed_strip_page.py"
