"""Pages for people, from tables and pictures."""


rule front_page:
    """What a campaign gave, on the page that a person opens first: every page and picture, and what lacks."""
    input:
        pages=of(CampaignFiles.pages),
        pictures=lambda wildcards: FIGURES.files(FILES[wildcards.campaign]),
        summary=of(CampaignFiles.summary),
    output:
        page="results/{campaign}/index.html",
    log:
        "logs/{campaign}/figures/front_page.log",
    benchmark:
        "benchmarks/{campaign}/figures/front_page.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("front_page"),
        products=of(CampaignFiles.plain_products),
        captions={row.name: row.shows for row in FIGURES.rows},
        twin=of(CampaignFiles.is_twin),
        campaign=identity("title"),
    script:
        "../scripts/front_page.py"


rule calibration_page:
    """Everything that a calibration found out, on one page."""
    input:
        calibrations=of(CampaignFiles.found_calibrations),
        tables=of(CampaignFiles.calibration_tables),
        facts=of(CampaignFiles.calibration_facts),
        pictures=of_page("calibration"),
        truth=of(CampaignFiles.calibration_truth),
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
        captions=FIGURES.captions("calibration"),
        twin=of(CampaignFiles.is_twin),
        campaign=identity("title"),
    script:
        "../scripts/calibration_page.py"


rule trajectory_comparison_page:
    """INS, camera and fused trajectory side by side, on one page (T 3.1.4)."""
    input:
        chains="results/{campaign}/accuracy/chains.csv",
        by_range="results/{campaign}/accuracy/chains_by_range.csv",
        facts="results/{campaign}/accuracy/chains.json",
        camera_facts="results/{campaign}/orientation/camera_trajectory.json",
        control=of(CampaignFiles.control_reports),
        truth=of(CampaignFiles.chains_truth),
        fused_facts="results/{campaign}/orientation/fused.json",
        trajectories=of(CampaignFiles.trajectories),
        steps_ins=of(CampaignFiles.chain_steps, "ins"),
        steps_camera=of(CampaignFiles.chain_steps, "camera"),
        steps_fused=of(CampaignFiles.chain_steps, "fused"),
        pictures=of_page("trajectories"),
    output:
        page="results/{campaign}/accuracy/trajectories.html",
    log:
        "logs/{campaign}/accuracy/trajectory_comparison_page.log",
    benchmark:
        "benchmarks/{campaign}/accuracy/trajectory_comparison_page.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("trajectory_comparison_page"),
        captions=FIGURES.captions("trajectories"),
        twin=of(CampaignFiles.is_twin),
        campaign=identity("title"),
    script:
        "../scripts/trajectory_comparison_page.py"


rule light_sheet_page:
    """Calibration, panels, budget, models and all that was rejected, on one page (P3, P4)."""
    input:
        calibration="results/{campaign}/triangulation/calibration.json",
        camera="results/{campaign}/triangulation/camera.json",
        lens=of(CampaignFiles.sheet_lens_report),
        budget="results/{campaign}/triangulation/budget.csv",
        published="results/{campaign}/triangulation/budget_published.csv",
        contradictions="results/{campaign}/triangulation/budget_contradictions.csv",
        correlations="results/{campaign}/triangulation/budget_correlations.csv",
        models="results/{campaign}/triangulation/models.csv",
        panels=of(CampaignFiles.sheet_panels),
        truth=of(CampaignFiles.sheet_truth),
        counts=of(CampaignFiles.of_sheet_series, "line_counts.csv"),
        line_points=of(CampaignFiles.of_sheet_series, "line_points.parquet"),
        scan_files=of(CampaignFiles.sheet_scan_files),
        scan_pictures=of_page("scans"),
        pictures=of_page("light_sheet"),
        ledger=of(laboratory.ledger_table),
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
        captions=FIGURES.captions("light_sheet", "scans"),
        twin=of(CampaignFiles.is_twin),
        campaign=identity("title"),
        scans=of(CampaignFiles.scan_names),
    script:
        "../scripts/light_sheet_page.py"


rule bed_strip_page:
    """A strip of the bed under the boat on one page (T 3.2)."""
    input:
        counts="results/{campaign}/triangulation/strip/counts.json",
        picture="results/{campaign}/figures/bed_strip.png",
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
        caption=FIGURES.captions("strip")["bed_strip"],
        twin=of(CampaignFiles.is_twin),
        campaign=identity("title"),
    script:
        "../scripts/bed_strip_page.py"


rule deformation_page:
    """What changed between epochs, how sure that is and what nobody saw, on one page (T 4.1)."""
    input:
        errors=of(CampaignFiles.all_epochs, "errors.json"),
        changes=of(CampaignFiles.of_pairs, "changes_{}.parquet"),
        visibility=of(CampaignFiles.of_pairs, "visibility_{}.parquet"),
        control=of(CampaignFiles.of_pairs, "changes_{}.json"),
        registrations=of(CampaignFiles.of_pairs, "registration_{}.json"),
        volumes=of(CampaignFiles.of_pairs, "volumes_{}.csv"),
        patches=of(CampaignFiles.of_pairs, "patches_{}.csv"),
        core_points="results/{campaign}/deformation/core_points.parquet",
        truth=of(CampaignFiles.change_truth),
        pictures=of_page("deformation"),
    output:
        page="results/{campaign}/deformation/index.html",
    log:
        "logs/{campaign}/deformation/deformation_page.log",
    benchmark:
        "benchmarks/{campaign}/deformation/deformation_page.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("deformation_page"),
        captions=FIGURES.captions("deformation"),
        twin=of(CampaignFiles.is_twin),
        campaign=identity("title"),
    script:
        "../scripts/deformation_page.py"


rule bathymetry_page:
    """The riverbed: how deep, how sure, and what that rests on."""
    input:
        facts="results/{campaign}/bathymetry/soundings.json",
        variogram="results/{campaign}/bathymetry/variogram.json",
        level="results/{campaign}/bathymetry/water_level.json",
        banks="results/{campaign}/bathymetry/banks.csv",
        validation="results/{campaign}/bathymetry/validation.json",
        methods="results/{campaign}/bathymetry/methods.csv",
        river="results/{campaign}/fusion/river.json",
        truth=of(CampaignFiles.bed_truth),
        pictures=of_page("bathymetry"),
    output:
        page="results/{campaign}/bathymetry/index.html",
    log:
        "logs/{campaign}/bathymetry/bathymetry_page.log",
    benchmark:
        "benchmarks/{campaign}/bathymetry/bathymetry_page.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("bathymetry_page"),
        captions=FIGURES.captions("bathymetry"),
        twin=of(CampaignFiles.is_twin),
        campaign=identity("title"),
    script:
        "../scripts/bathymetry_page.py"
