"""Published numbers recomputed. These rules depend on no campaign."""

BUDGETS = [
    "p2_table1",
    "t_table3_1",
    "p2_perfect_trigger",
    "p2_trigger_4ms",
    "p1_direct",
    "p1_direct_one_sigma",
    "sajo_2019",
    "sajo_2021",
]
TABLES = {"p2_table1": 0.16, "t_table3_1": 0.0}
"""Budgets with a whole published table, and the length of the inner lever arm in metres (P2 5.2; T: unknown)."""


BUDGET_FILE = str(ROOT / "resources" / "budgets" / "{name}.yaml")
PUBLISHED_FILE = str(ROOT / "resources" / "published" / "{name}.csv")


rule budget_geometry:
    """The geometry that the published error tables imply, and what each assumption is needed for."""
    input:
        budgets=expand(BUDGET_FILE, name=TABLES),
        published=expand(PUBLISHED_FILE, name=TABLES),
    output:
        assumptions="results/reproduction/assumptions.csv",
        solutions="results/reproduction/geometry.csv",
    log:
        "logs/reproduction/budget_geometry.log",
    benchmark:
        "benchmarks/reproduction/budget_geometry.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("budget_geometry"),
        lever_lengths_m=TABLES,
    message:
        "geometry of the published error tables"
    script:
        "../scripts/budget_geometry.py"


rule budget_tables:
    """Error budgets as tables, with a verdict on each published cell."""
    input:
        budgets=expand(BUDGET_FILE, name=BUDGETS),
        published=expand(PUBLISHED_FILE, name=BUDGETS),
        assumptions="results/reproduction/assumptions.csv",
        solutions="results/reproduction/geometry.csv",
    output:
        budget_page="results/reproduction/error_budgets.md",
        verdicts_text="results/reproduction/error_budgets.txt",
        tables=expand("results/reproduction/budgets/{name}.csv", name=BUDGETS),
        latex_tables=expand("results/reproduction/budgets/{name}.tex", name=BUDGETS),
    log:
        "logs/reproduction/budget_tables.log",
    benchmark:
        "benchmarks/reproduction/budget_tables.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("budget_tables"),
        camera="p2_table1",
        ins="t_table3_1",
    message:
        "error budgets and their verdicts"
    script:
        "../scripts/budget_tables.py"


rule plot_error_budget:
    """Where the error of a point comes from, over its distance, for both ways of orientation."""
    input:
        budgets=expand(BUDGET_FILE, name=TABLES),
        published=expand(PUBLISHED_FILE, name=TABLES),
    output:
        error_budget_png=report(
            "results/reproduction/figures/error_budget.png",
            caption="../report/error_budget.rst",
            category="Error budgets",
        ),
    log:
        "logs/reproduction/plot_error_budget.log",
    benchmark:
        "benchmarks/reproduction/plot_error_budget.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(5),
    params:
        code=code_version("plot_error_budget"),
        dpi=200,
    message:
        "error budgets over distance"
    script:
        "../scripts/plot_error_budget.py"


rule honesty_study:
    """Predicted against observed errors over many surveys of the digital twin, and with mistakes put in."""
    output:
        verdicts="results/reproduction/honesty.csv",
        by_range="results/reproduction/honesty_by_range.csv",
    log:
        "logs/reproduction/honesty_study.log",
    benchmark:
        "benchmarks/reproduction/honesty_study.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 2
    resources:
        mem_mb=memory(6000),
        runtime=minutes(60),
    params:
        **study("honesty_study"),
        code=code_version("honesty_study"),
    message:
        "honesty of the sigmas over {params.seeds} surveys of the digital twin"
    script:
        "../scripts/honesty_study.py"


rule honesty_river_survey:
    """One survey of the whole river: errors of its points beside what stated and estimated sigmas predict."""
    output:
        points="results/reproduction/honesty_river/{seed}.parquet",
    log:
        "logs/reproduction/honesty_river_{seed}.log",
    benchmark:
        "benchmarks/reproduction/honesty_river_{seed}.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(4000),
        runtime=minutes(30),
    params:
        code=code_version("honesty_river_survey"),
        seed=lambda wildcards: int(wildcards.seed),
    message:
        "survey {wildcards.seed} of the whole river"
    script:
        "../scripts/honesty_river_survey.py"


rule honesty_river_study:
    """Predicted against observed errors on the whole river, with errors as long as those of an INS."""
    input:
        surveys=seeds_of("honesty_river_study", "honesty_river/{seed}.parquet"),
    output:
        verdicts="results/reproduction/honesty_river.csv",
        by_range="results/reproduction/honesty_river_by_range.csv",
    log:
        "logs/reproduction/honesty_river_study.log",
    benchmark:
        "benchmarks/reproduction/honesty_river_study.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(4000),
        runtime=minutes(10),
    params:
        **study("honesty_river_study"),
        code=code_version("honesty_river_study"),
    message:
        "sigmas and errors over surveys of the whole river"
    script:
        "../scripts/honesty_river_study.py"


rule prior_survey:
    """One survey whose instruments err otherwise than stated, by the chains of one kind."""
    output:
        table="results/reproduction/prior_study/{kind}_{seed}.csv",
    log:
        "logs/reproduction/prior_{kind}_{seed}.log",
    benchmark:
        "benchmarks/reproduction/prior_{kind}_{seed}.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000),
        runtime=minutes(30),
    params:
        code=code_version("prior_survey"),
        kind="{kind}",
        seed=lambda wildcards: int(wildcards.seed),
    message:
        "survey {wildcards.seed} with wrong presumptions: {wildcards.kind}"
    script:
        "../scripts/prior_survey.py"


rule prior_study:
    """What wrong presumptions of the errors do to sigmas, and what estimates mend of that."""
    input:
        surveys=prior_surveys,
    output:
        table="results/reproduction/prior_study.csv",
    log:
        "logs/reproduction/prior_study.log",
    benchmark:
        "benchmarks/reproduction/prior_study.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        **study("prior_study"),
        code=code_version("prior_study"),
    message:
        "sigmas under wrong presumptions"
    script:
        "../scripts/prior_study.py"


rule offset_study:
    """What each effect of footprint, slope and plants adds to the mean distance from a reference (P2 7)."""
    output:
        table="results/reproduction/offset_study.csv",
        page="results/reproduction/offset_study.md",
    log:
        "logs/reproduction/offset_study.log",
    benchmark:
        "benchmarks/reproduction/offset_study.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 2
    resources:
        mem_mb=memory(6000),
        runtime=minutes(60),
    params:
        **study("offset_study"),
        code=code_version("offset_study"),
    message:
        "causes of an offset, on the digital twin"
    script:
        "../scripts/offset_study.py"


rule camera_lidar_study:
    """Camera and lidar calibrated by cones over many seeds of the digital twin: small errors, honest sigmas?"""
    output:
        table="results/reproduction/camera_lidar_study.csv",
        cases="results/reproduction/camera_lidar_cases.csv",
        page="results/reproduction/camera_lidar_study.md",
    log:
        "logs/reproduction/camera_lidar_study.log",
    benchmark:
        "benchmarks/reproduction/camera_lidar_study.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 2
    resources:
        mem_mb=memory(6000),
        runtime=minutes(120),
    params:
        **study("camera_lidar_study"),
        code=code_version("camera_lidar_study"),
    message:
        "camera-lidar calibrations of {params.seeds} seeds of the digital twin"
    script:
        "../scripts/camera_lidar_study.py"


rule ins_lidar_study:
    """Lidar on the moving boat calibrated by cones over many seeds: are the sigmas honest?"""
    output:
        table="results/reproduction/ins_lidar_study.csv",
        page="results/reproduction/ins_lidar_study.md",
    log:
        "logs/reproduction/ins_lidar_study.log",
    benchmark:
        "benchmarks/reproduction/ins_lidar_study.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000),
        runtime=minutes(60),
    params:
        **study("ins_lidar_study"),
        code=code_version("ins_lidar_study"),
    message:
        "mounts of the lidar from {params.seeds} seeds of the digital twin"
    script:
        "../scripts/ins_lidar_study.py"


rule echo_sounder_study:
    """Place of the echo sounder over a surveyed bed, over many seeds: are the sigmas honest?"""
    output:
        table="results/reproduction/echo_sounder_study.csv",
        page="results/reproduction/echo_sounder_study.md",
    log:
        "logs/reproduction/echo_sounder_study.log",
    benchmark:
        "benchmarks/reproduction/echo_sounder_study.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000),
        runtime=minutes(60),
    params:
        **study("echo_sounder_study"),
        code=code_version("echo_sounder_study"),
    message:
        "places of the echo sounder from {params.seeds} seeds of the digital twin"
    script:
        "../scripts/echo_sounder_study.py"


rule image_block:
    """One block of rendered pictures of the digital twin: errors of its poses beside their covariances."""
    output:
        table="results/reproduction/image_blocks/{seed}.csv",
    log:
        "logs/reproduction/image_block_{seed}.log",
    benchmark:
        "benchmarks/reproduction/image_block_{seed}.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000),
        runtime=minutes(30),
    params:
        code=code_version("image_block"),
        seed=lambda wildcards: int(wildcards.seed),
    message:
        "image block {wildcards.seed}"
    script:
        "../scripts/image_block.py"


rule image_block_study:
    """Image blocks on rendered pictures over seeds of the digital twin: are covariances of poses honest?"""
    input:
        fit=seeds_of("image_block_study", "image_blocks/{seed}.csv", "_of_fit"),
        judged=seeds_of("image_block_study", "image_blocks/{seed}.csv"),
    output:
        table="results/reproduction/image_block_study.csv",
        blocks="results/reproduction/image_blocks.csv",
        page="results/reproduction/image_block_study.md",
    log:
        "logs/reproduction/image_block_study.log",
    benchmark:
        "benchmarks/reproduction/image_block_study.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        **study("image_block_study"),
        code=code_version("image_block_study"),
    message:
        "image blocks of {params.seeds} seeds of the digital twin, and of {params.seeds_of_fit} others"
    script:
        "../scripts/image_block_study.py"


rule outage_study:
    """Position errors of INS, camera and fused trajectory by the length of an outage of GNSS."""
    output:
        table="results/reproduction/outage_study.csv",
        page="results/reproduction/outage_study.md",
    log:
        "logs/reproduction/outage_study.log",
    benchmark:
        "benchmarks/reproduction/outage_study.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(30),
    params:
        **study("outage_study"),
        code=code_version("outage_study"),
    message:
        "outages of GNSS, on the digital twin"
    script:
        "../scripts/outage_study.py"


rule plot_outage_study:
    """Error of the place by the length of an outage of GNSS."""
    input:
        table="results/reproduction/outage_study.csv",
    output:
        outage_study_png=report(
            "results/reproduction/figures/outage_study.png",
            caption="../report/outage_study.rst",
            category="Trajectories",
        ),
    log:
        "logs/reproduction/plot_outage_study.log",
    benchmark:
        "benchmarks/reproduction/plot_outage_study.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(5),
    params:
        code=code_version("plot_outage_study"),
        dpi=200,
    message:
        "outages of GNSS on the digital twin"
    script:
        "../scripts/plot_outage_study.py"


CHAIN_DISTANCES = expand(
    "results/reproduction/chain_study/{chain}.parquet", chain=["ins", "camera", "fused"]
)


rule chain_study:
    """INS, camera and fused trajectory, disturbed and not, through the same rules to one bank (T 3.1.4)."""
    input:
        budgets=expand(BUDGET_FILE, name=["t_table3_1", "p2_table1"]),
    output:
        table="results/reproduction/chain_study.csv",
        goals="results/reproduction/chain_study_goals.csv",
        by_range="results/reproduction/chain_study_by_range.csv",
        facts="results/reproduction/chain_study.json",
        distances=CHAIN_DISTANCES,
        page="results/reproduction/chain_study.md",
    log:
        "logs/reproduction/chain_study.log",
    benchmark:
        "benchmarks/reproduction/chain_study.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 2
    resources:
        mem_mb=memory(8000),
        runtime=minutes(120),
    params:
        **study("chain_study"),
        code=code_version("chain_study"),
    message:
        "INS, camera and fused trajectory of {params.seeds} surveys of the digital twin"
    script:
        "../scripts/chain_study.py"


rule plot_chain_study:
    """Distances to the bank by range and as histograms, of the surveys of the study (T Fig. 3.3)."""
    input:
        by_range="results/reproduction/chain_study_by_range.csv",
        distances=CHAIN_DISTANCES,
    output:
        chain_study_by_range_png=report(
            "results/reproduction/figures/chain_study_by_range.png",
            caption="../report/chain_study_by_range.rst",
            category="Trajectories",
        ),
        chain_study_histograms_png=report(
            "results/reproduction/figures/chain_study_histograms.png",
            caption="../report/chain_study_histograms.rst",
            category="Trajectories",
        ),
    log:
        "logs/reproduction/plot_chain_study.log",
    benchmark:
        "benchmarks/reproduction/plot_chain_study.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2500),
        runtime=minutes(5),
    params:
        code=code_version("plot_chain_study"),
        dpi=200,
        outlier_nmads=5.0,
    message:
        "INS, camera and fused trajectory on the digital twin"
    script:
        "../scripts/plot_chain_study.py"


rule multi_line_study:
    """Models of a fifteen-line laser: sigma, information, errors of planes, a joint centre (T 4.2.1)."""
    output:
        models="results/reproduction/multi_line_models.csv",
        summary="results/reproduction/multi_line_summary.csv",
        tests="results/reproduction/multi_line_tests.csv",
        lines="results/reproduction/multi_line_lines.csv",
    log:
        "logs/reproduction/multi_line_study.log",
    benchmark:
        "benchmarks/reproduction/multi_line_study.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000),
        runtime=minutes(30),
    params:
        **study("multi_line_study"),
        code=code_version("multi_line_study"),
    message:
        "models of a fifteen-line laser, on the digital twin"
    script:
        "../scripts/multi_line_study.py"


rule sheet_scan_study:
    """What white markers and errors of poses do to scans with the light sheet (P4 7.2, 7.3)."""
    output:
        markers="results/reproduction/marker_bias.csv",
        poses="results/reproduction/pose_noise.csv",
        ratios="results/reproduction/pose_noise_ratios.csv",
    log:
        "logs/reproduction/sheet_scan_study.log",
    benchmark:
        "benchmarks/reproduction/sheet_scan_study.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000),
        runtime=minutes(30),
    params:
        **study("sheet_scan_study"),
        code=code_version("sheet_scan_study"),
    message:
        "markers and poses in scans with the light sheet, on the digital twin"
    script:
        "../scripts/sheet_scan_study.py"


rule line_label_study:
    """Which line is which on free-form objects: right labels and labels given, by spacing (T 4.2.1)."""
    output:
        scenes="results/reproduction/line_labels.csv",
        spacings="results/reproduction/line_label_spacings.csv",
    log:
        "logs/reproduction/line_label_study.log",
    benchmark:
        "benchmarks/reproduction/line_label_study.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000),
        runtime=minutes(300),
    params:
        **study("line_label_study"),
        code=code_version("line_label_study"),
    message:
        "labels of fifteen lines, on the digital twin"
    script:
        "../scripts/line_label_study.py"


rule plot_multi_line_geometry:
    """A fifteen-line laser under water: in space, in a section, and in the image (T Fig. 4.3)."""
    input:
        lines="results/reproduction/multi_line_lines.csv",
    output:
        multi_line_geometry_png=report(
            "results/reproduction/figures/multi_line_geometry.png",
            caption="../report/multi_line_geometry.rst",
            category="Light sheet",
        ),
    log:
        "logs/reproduction/plot_multi_line_geometry.log",
    benchmark:
        "benchmarks/reproduction/plot_multi_line_geometry.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(5),
    params:
        code=code_version("plot_multi_line_geometry"),
        dpi=200,
    message:
        "lines of a fifteen-line laser"
    script:
        "../scripts/plot_multi_line_geometry.py"


rule multi_line_images:
    """Images of a fifteen-line laser on grid, plane and wreck, measured and labelled (T 4.2.1)."""
    output:
        images="results/reproduction/multi_line_images.npz",
        points="results/reproduction/multi_line_points.csv",
    log:
        "logs/reproduction/multi_line_images.log",
    benchmark:
        "benchmarks/reproduction/multi_line_images.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000),
        runtime=minutes(20),
    params:
        code=code_version("multi_line_images"),
        seed=1,
    message:
        "images of a fifteen-line laser, on the digital twin"
    script:
        "../scripts/multi_line_images.py"


rule plot_multi_line_images:
    """Set-ups of a fifteen-line laser and its images with the measured lines (T Fig. 4.4)."""
    input:
        images="results/reproduction/multi_line_images.npz",
        points="results/reproduction/multi_line_points.csv",
    output:
        multi_line_images_png=report(
            "results/reproduction/figures/multi_line_images.png",
            caption="../report/multi_line_images.rst",
            category="Light sheet",
        ),
    log:
        "logs/reproduction/plot_multi_line_images.log",
    benchmark:
        "benchmarks/reproduction/plot_multi_line_images.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_multi_line_images"),
        dpi=200,
    message:
        "images of a fifteen-line laser"
    script:
        "../scripts/plot_multi_line_images.py"


rule line_label_scans:
    """Two scans of a wreck by fifteen lines, point by point, with labels and reasons (T 4.2.1)."""
    output:
        points="results/reproduction/line_label_points.parquet",
        shifts="results/reproduction/line_label_shifts.csv",
    log:
        "logs/reproduction/line_label_scans.log",
    benchmark:
        "benchmarks/reproduction/line_label_scans.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000),
        runtime=minutes(20),
    params:
        code=code_version("line_label_scans"),
        seed=1,
    message:
        "scans by fifteen lines, on the digital twin"
    script:
        "../scripts/line_label_scans.py"


rule plot_line_labels:
    """What a scan tells about the numbers of fifteen lines (T 4.2.1, Fig. 4.4 f)."""
    input:
        points="results/reproduction/line_label_points.parquet",
        shifts="results/reproduction/line_label_shifts.csv",
    output:
        line_labels_png=report(
            "results/reproduction/figures/line_labels.png",
            caption="../report/line_labels.rst",
            category="Light sheet",
        ),
    log:
        "logs/reproduction/plot_line_labels.log",
    benchmark:
        "benchmarks/reproduction/plot_line_labels.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(5),
    params:
        code=code_version("plot_line_labels"),
        dpi=200,
    message:
        "labels of fifteen lines"
    script:
        "../scripts/plot_line_labels.py"
