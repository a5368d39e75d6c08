"""Figures of a calibration."""


rule plot_field_setup:
    """The field and the static positions (P2 Fig. 2 and 8)."""
    input:
        cones="results/{campaign}/calibration/cones.csv",
        field=raw("field"),
        place="results/{campaign}/calibration/field.json",
        poses="results/{campaign}/calibration/poses.csv",
    output:
        field_setup_png=report(
            "results/{campaign}/figures/field_setup.png",
            caption="../report/field_setup.rst",
            category="{campaign}",
            subcategory="Calibration",
        ),
        field_positions_png=report(
            "results/{campaign}/figures/field_positions.png",
            caption="../report/field_positions.rst",
            category="{campaign}",
            subcategory="Calibration",
        ),
    log:
        "logs/{campaign}/figures/plot_field_setup.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_field_setup.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_field_setup"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: calibration field"
    script:
        "../scripts/plot_field_setup.py"


rule plot_field_reference:
    """Reference points, markers in an image, lidar on the cones (P1 Fig. 2)."""
    input:
        field_points="results/{campaign}/calibration/field_points.csv",
        cones="results/{campaign}/calibration/cones.csv",
        field=raw("field"),
        place="results/{campaign}/calibration/field.json",
        images=raw("position_images"),
        marks="results/{campaign}/calibration/camera_residuals.csv",
        measured="results/{campaign}/calibration/boat_marks.parquet",
        cone_points="results/{campaign}/calibration/cone_points.parquet",
    output:
        field_reference_png=report(
            "results/{campaign}/figures/field_reference.png",
            caption="../report/field_reference.rst",
            category="{campaign}",
            subcategory="Calibration",
        ),
    log:
        "logs/{campaign}/figures/plot_field_reference.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_field_reference.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_field_reference"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: reference, markers and cones"
    script:
        "../scripts/plot_field_reference.py"


rule plot_cone_frame:
    """The cone coordinate system (P2 Fig. 3)."""
    output:
        cone_frame_png=report(
            "results/{campaign}/figures/cone_frame.png",
            caption="../report/cone_frame.rst",
            category="{campaign}",
            subcategory="Calibration",
        ),
    log:
        "logs/{campaign}/figures/plot_cone_frame.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_cone_frame.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_cone_frame"),
        figures=section("figures"),
    message:
        "{wildcards.campaign}: cone coordinate system"
    script:
        "../scripts/plot_cone_frame.py"


rule plot_synthetic_view:
    """Synthetic image and lidar frame of the field (P2 Fig. 4)."""
    input:
        view="results/{campaign}/simulation/pictures/synthetic_view.npz",
        lidar_frame="results/{campaign}/simulation/pictures/lidar_frame.parquet",
    output:
        synthetic_view_png=report(
            "results/{campaign}/figures/synthetic_view.png",
            caption="../report/synthetic_view.rst",
            category="{campaign}",
            subcategory="Calibration",
        ),
    log:
        "logs/{campaign}/figures/plot_synthetic_view.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_synthetic_view.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_synthetic_view"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: synthetic view"
    script:
        "../scripts/plot_synthetic_view.py"


rule plot_clock_offset:
    """Antenna from images and from GNSS (P2 Fig. 9)."""
    input:
        fixes="results/{campaign}/timing/image_fixes.parquet",
        track="results/{campaign}/timing/antenna_track.parquet",
        facts="results/{campaign}/timing/camera_clock.json",
    output:
        clock_offset_png=report(
            "results/{campaign}/figures/clock_offset.png",
            caption="../report/clock_offset.rst",
            category="{campaign}",
            subcategory="Calibration",
        ),
    log:
        "logs/{campaign}/figures/plot_clock_offset.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_clock_offset.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_clock_offset"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: offset of the camera's clock"
    script:
        "../scripts/plot_clock_offset.py"


rule plot_clock_stability:
    """A photograph of the clock, and the intervals (P2 Fig. 13)."""
    input:
        display="results/{campaign}/timing/display.csv",
        photos=raw("display"),
    output:
        clock_stability_png=report(
            "results/{campaign}/figures/clock_stability.png",
            caption="../report/clock_stability.rst",
            category="{campaign}",
            subcategory="Calibration",
        ),
    log:
        "logs/{campaign}/figures/plot_clock_stability.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_clock_stability.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_clock_stability"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
        nominal_s=calibration("display", "nominal_s"),
        step_s=calibration("display", "step_s"),
    message:
        "{wildcards.campaign}: stability of the camera's clock"
    script:
        "../scripts/plot_clock_stability.py"


rule plot_cone_before_after:
    """Cones as the moving boat sees them, before and after (T Fig. 3.1)."""
    input:
        before="results/{campaign}/calibration/cones_before.parquet",
        after="results/{campaign}/calibration/cones_after.parquet",
        cones="results/{campaign}/calibration/cones.csv",
        field=raw("field"),
    output:
        cone_before_after_png=report(
            "results/{campaign}/figures/cone_before_after.png",
            caption="../report/cone_before_after.rst",
            category="{campaign}",
            subcategory="Calibration",
        ),
    log:
        "logs/{campaign}/figures/plot_cone_before_after.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_cone_before_after.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_cone_before_after"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: cones before and after"
    script:
        "../scripts/plot_cone_before_after.py"


rule plot_cone_residuals:
    """What remains between points and cones."""
    input:
        cone_points="results/{campaign}/calibration/cone_points.parquet",
        cones="results/{campaign}/calibration/cones.csv",
        field=raw("field"),
    output:
        cone_residuals_png=report(
            "results/{campaign}/figures/cone_residuals.png",
            caption="../report/cone_residuals.rst",
            category="{campaign}",
            subcategory="Calibration",
        ),
    log:
        "logs/{campaign}/figures/plot_cone_residuals.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_cone_residuals.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_cone_residuals"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: residuals on the cones"
    script:
        "../scripts/plot_cone_residuals.py"


rule plot_correlations:
    """Correlations of the calibrated quantities."""
    input:
        calibration="results/{campaign}/calibration/boat.yaml",
    output:
        correlations_png=report(
            "results/{campaign}/figures/correlations.png",
            caption="../report/correlations.rst",
            category="{campaign}",
            subcategory="Calibration",
        ),
    log:
        "logs/{campaign}/figures/plot_correlations.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_correlations.jsonl"
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
        "{wildcards.campaign}: correlations"
    script:
        "../scripts/plot_correlations.py"


rule plot_calibration_design:
    """Sigmas against the number of cones and positions."""
    input:
        study="results/{campaign}/calibration/design_study.csv",
    output:
        calibration_design_png=report(
            "results/{campaign}/figures/calibration_design.png",
            caption="../report/calibration_design.rst",
            category="{campaign}",
            subcategory="Calibration",
        ),
    log:
        "logs/{campaign}/figures/plot_calibration_design.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_calibration_design.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_calibration_design"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
    message:
        "{wildcards.campaign}: design of the field"
    script:
        "../scripts/plot_calibration_design.py"


rule calibration_page:
    """Everything that a calibration found out, on one page."""
    input:
        calibrations=found_calibrations,
        tables=calibration_tables,
        facts=calibration_facts,
        pictures=calibration_page_pictures,
        captions=lambda wildcards: [
            ROOT / "workflow" / "report" / f"{Path(picture).stem}.rst"
            for picture in calibration_page_pictures(wildcards)
        ],
        truth=calibration_truth,
    output:
        page="results/{campaign}/calibration/index.html",
    log:
        "logs/{campaign}/figures/calibration_page.log",
    benchmark:
        "benchmarks/{campaign}/figures/calibration_page.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("calibration_page"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: calibration page"
    script:
        "../scripts/calibration_page.py"
