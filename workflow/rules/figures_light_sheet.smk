"""Figures and the page of the underwater light-sheet sensor (P3, P4)."""


rule plot_sheet_deformation:
    """How refraction bends a light sheet (P3 Fig. 1, P4 Fig. 1 and 2)."""
    output:
        sheet_deformation_png=report(
            "results/{campaign}/figures/sheet_deformation.png",
            caption="../report/sheet_deformation.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_sheet_deformation.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_sheet_deformation.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_sheet_deformation"),
        figures=section("figures"),
    message:
        "{wildcards.campaign}: picture of a bent light sheet"
    script:
        "../scripts/plot_sheet_deformation.py"


rule plot_sensor_setup:
    """Laser, camera and window, and how one point is measured (P3 Fig. 3, P4 Fig. 3 and 7)."""
    input:
        sensor="results/{campaign}/triangulation/sensor.yaml",
    output:
        sensor_setup_png=report(
            "results/{campaign}/figures/sensor_setup.png",
            caption="../report/sensor_setup.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_sensor_setup.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_sensor_setup.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_sensor_setup"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: picture of the light-sheet sensor"
    script:
        "../scripts/plot_sensor_setup.py"


rule plot_line_measurement:
    """What each method of line measurement reaches (P3 Fig. 2, P4 Fig. 4 to 6)."""
    input:
        images=raw("panel_images"),
        line_points="results/{campaign}/triangulation/panels/line_points.parquet",
    output:
        line_measurement_png=report(
            "results/{campaign}/figures/line_measurement.png",
            caption="../report/line_measurement.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_line_measurement.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_line_measurement.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_line_measurement"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: measurement of the laser line"
    script:
        "../scripts/plot_line_measurement.py"


rule plot_line_patch:
    """Least-squares matching of one place of the line (P3 Fig. 2, P4 Fig. 6)."""
    input:
        images=raw("panel_images"),
        line_points="results/{campaign}/triangulation/panels/line_points.parquet",
    output:
        line_patch_png=report(
            "results/{campaign}/figures/line_patch.png",
            caption="../report/line_patch.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_line_patch.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_line_patch.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_line_patch"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: matching of one place of the laser line"
    script:
        "../scripts/plot_line_patch.py"


rule plot_line_on_markers:
    """The line over white markers and its flags (P4 Fig. 16)."""
    input:
        images=raw("stepped"),
        line_points="results/{campaign}/triangulation/stepped/line_points.parquet",
    output:
        line_on_markers_png=report(
            "results/{campaign}/figures/line_on_markers.png",
            caption="../report/line_on_markers.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_line_on_markers.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_line_on_markers.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_line_on_markers"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: laser line on bright markers"
    script:
        "../scripts/plot_line_on_markers.py"


rule plot_grid_calibration:
    """Observations, rays and residuals of the calibration (P3 Fig. 4 and 7, P4 Fig. 9 and 10)."""
    input:
        sensor="results/{campaign}/triangulation/sensor.yaml",
        images=raw("grid_images"),
        line_points="results/{campaign}/triangulation/calibration/line_points.parquet",
        residuals="results/{campaign}/triangulation/residuals.csv",
        pairs="results/{campaign}/triangulation/pairs.csv",
    output:
        grid_calibration_png=report(
            "results/{campaign}/figures/grid_calibration.png",
            caption="../report/grid_calibration.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_grid_calibration.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_grid_calibration.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_grid_calibration"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: calibration of the light sheet"
    script:
        "../scripts/plot_grid_calibration.py"


rule plot_measurement_volume:
    """What the sensor can measure (P3 Fig. 5, P4 Fig. 11 and 12)."""
    input:
        sensor="results/{campaign}/triangulation/sensor.yaml",
    output:
        measurement_volume_png=report(
            "results/{campaign}/figures/measurement_volume.png",
            caption="../report/measurement_volume.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_measurement_volume.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_measurement_volume.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_measurement_volume"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: measurement volume"
    script:
        "../scripts/plot_measurement_volume.py"


rule plot_depth_budget:
    """What each parameter of the sensor costs in depth (P4 Fig. 13)."""
    input:
        budget="results/{campaign}/triangulation/budget.csv",
    output:
        depth_budget_png=report(
            "results/{campaign}/figures/depth_budget.png",
            caption="../report/depth_budget.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_depth_budget.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_depth_budget.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_depth_budget"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: budget of the depth"
    script:
        "../scripts/plot_depth_budget.py"


rule plot_published_depth_budget:
    """The budget of P4 by the geometry that fits it best, with verdicts (P4 Fig. 13)."""
    input:
        published="results/{campaign}/triangulation/budget_published.csv",
    output:
        published_depth_budget_png=report(
            "results/{campaign}/figures/published_depth_budget.png",
            caption="../report/published_depth_budget.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_published_depth_budget.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_published_depth_budget.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_published_depth_budget"),
        figures=section("figures"),
    message:
        "{wildcards.campaign}: published budget of the depth"
    script:
        "../scripts/plot_published_depth_budget.py"


rule plot_panel_distances:
    """A panel in known depths, beside published errors (P3 Fig. 9 and 10)."""
    input:
        sensor="results/{campaign}/triangulation/sensor.yaml",
        images=raw("panel_images"),
        points="results/{campaign}/triangulation/panels/points.parquet",
        panels="results/{campaign}/triangulation/panels.csv",
    output:
        panel_distances_png=report(
            "results/{campaign}/figures/panel_distances.png",
            caption="../report/panel_distances.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_panel_distances.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_panel_distances.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_panel_distances"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: distances on the panel"
    script:
        "../scripts/plot_panel_distances.py"


rule plot_sheet_models:
    """Errors that simpler models of the sheet leave."""
    input:
        models="results/{campaign}/triangulation/models.csv",
    output:
        sheet_models_png=report(
            "results/{campaign}/figures/sheet_models.png",
            caption="../report/sheet_models.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_sheet_models.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_sheet_models.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_sheet_models"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: simpler models of the sheet"
    script:
        "../scripts/plot_sheet_models.py"


rule plot_sheet_correlations:
    """Correlations of all parameters of the sensor."""
    input:
        calibration="results/{campaign}/triangulation/sensor.yaml",
    output:
        correlations_png=report(
            "results/{campaign}/figures/sheet_correlations.png",
            caption="../report/sheet_correlations.rst",
            category="Light sheet",
        ),
    log:
        "logs/{campaign}/figures/plot_sheet_correlations.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_sheet_correlations.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_correlations"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
    message:
        "{wildcards.campaign}: correlations of the sensor"
    script:
        "../scripts/plot_correlations.py"


rule light_sheet_page:
    """Calibration, panels, budget, models and all that was rejected, on one page (P3, P4)."""
    input:
        calibration="results/{campaign}/triangulation/calibration.json",
        camera="results/{campaign}/triangulation/camera.json",
        lens=sheet_lens_report,
        budget="results/{campaign}/triangulation/budget.csv",
        published="results/{campaign}/triangulation/budget_published.csv",
        contradictions="results/{campaign}/triangulation/budget_contradictions.csv",
        correlations="results/{campaign}/triangulation/budget_correlations.csv",
        models="results/{campaign}/triangulation/models.csv",
        panels=sheet_panels,
        truth=sheet_truth,
        counts=of_sheet_series("line_counts.csv"),
        line_points=of_sheet_series("line_points.parquet"),
        scan_files=sheet_scan_files,
        scan_pictures=sheet_scan_pictures,
        pictures=sheet_pictures,
        captions=sheet_captions,
        ledger=sheet_ledger,
    output:
        page="results/{campaign}/triangulation/index.html",
    log:
        "logs/{campaign}/triangulation/light_sheet_page.log",
    benchmark:
        "benchmarks/{campaign}/triangulation/light_sheet_page.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("light_sheet_page"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
        scans=lambda wildcards: scan_names(wildcards.campaign),
    message:
        "{wildcards.campaign}: page on the light-sheet sensor"
    script:
        "../scripts/light_sheet_page.py"
