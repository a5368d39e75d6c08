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
        streams="results/{campaign}/timing/streams.csv",
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
        mem_mb=memory(3000, 6),
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
        mem_mb=memory(3000, 6),
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


rule plot_trajectory:
    """The track with its sigmas and gaps."""
    input:
        trajectory="results/{campaign}/orientation/trajectory.parquet",
        summary="results/{campaign}/orientation/trajectory.json",
    output:
        trajectory_png=report(
            "results/{campaign}/figures/trajectory.png",
            caption="../report/trajectory.rst",
            category="Survey",
        ),
    log:
        "logs/{campaign}/figures/plot_trajectory.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_trajectory.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("plot_trajectory"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title", "crs"),
    message:
        "{wildcards.campaign}: trajectory with sigmas"
    script:
        "../scripts/plot_trajectory.py"


rule plot_cloud_by_sigma:
    """The cloud by predicted sigma, and sigma against range (T Table 3.1)."""
    input:
        points="results/{campaign}/lidar/points.laz",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
    output:
        cloud_by_sigma_png=report(
            "results/{campaign}/figures/cloud_by_sigma.png",
            caption="../report/cloud_by_sigma.rst",
            category="Point cloud",
        ),
    log:
        "logs/{campaign}/figures/plot_cloud_by_sigma.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_cloud_by_sigma.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000, 6),
        runtime=minutes(10, 30),
    params:
        code=code_version("plot_cloud_by_sigma"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title", "crs"),
    message:
        "{wildcards.campaign}: cloud by sigma"
    script:
        "../scripts/plot_cloud_by_sigma.py"


rule plot_cloud_by_range:
    """The cloud by measured range."""
    input:
        points="results/{campaign}/lidar/points.laz",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
    output:
        cloud_by_range_png=report(
            "results/{campaign}/figures/cloud_by_range.png",
            caption="../report/cloud_by_range.rst",
            category="Point cloud",
        ),
    log:
        "logs/{campaign}/figures/plot_cloud_by_range.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_cloud_by_range.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000, 6),
        runtime=minutes(10, 30),
    params:
        code=code_version("plot_cloud_by_range"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title", "crs"),
    message:
        "{wildcards.campaign}: cloud by range"
    script:
        "../scripts/plot_cloud_by_range.py"


rule plot_footprints:
    """One revolution of the lidar and its footprints (P2 Fig. 17)."""
    input:
        points="results/{campaign}/lidar/points.laz",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
        mounts="results/{campaign}/calibration/mounts.json",
    output:
        footprints_png=report(
            "results/{campaign}/figures/footprints.png",
            caption="../report/footprints.rst",
            category="Point cloud",
        ),
    log:
        "logs/{campaign}/figures/plot_footprints.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_footprints.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000, 6),
        runtime=minutes(10, 30),
    params:
        code=code_version("plot_footprints"),
        lidar_accuracy=section("lidar_accuracy"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title", "crs"),
    message:
        "{wildcards.campaign}: footprints"
    script:
        "../scripts/plot_footprints.py"


rule plot_reference_view:
    """The terrestrial scan as seen from the river (P2 Fig. 7)."""
    input:
        reference="results/{campaign}/ingest/reference.laz",
        integrity="results/{campaign}/ingest/reference.integrity.json",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
    output:
        reference_view_png=report(
            "results/{campaign}/figures/reference_view.png",
            caption="../report/reference_view.rst",
            category="Accuracy",
        ),
    log:
        "logs/{campaign}/figures/plot_reference_view.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_reference_view.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000, 6),
        runtime=minutes(10, 30),
    params:
        code=code_version("plot_reference_view"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title", "crs"),
    message:
        "{wildcards.campaign}: terrestrial scan"
    script:
        "../scripts/plot_reference_view.py"


rule plot_removed_points:
    """What each filter took from the cloud."""
    input:
        points="results/{campaign}/lidar/points.laz",
        removed="results/{campaign}/lidar/removed.parquet",
        counts="results/{campaign}/lidar/counts.csv",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
    output:
        removed_points_png=report(
            "results/{campaign}/figures/removed_points.png",
            caption="../report/removed_points.rst",
            category="Point cloud",
        ),
    log:
        "logs/{campaign}/figures/plot_removed_points.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_removed_points.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("plot_removed_points"),
        filters=section("filters"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title", "crs"),
    message:
        "{wildcards.campaign}: what the filters took"
    script:
        "../scripts/plot_removed_points.py"


rule plot_scene_view:
    """The bank of the twin as a camera on the boat would see it."""
    input:
        bank="results/{campaign}/simulation/pictures/view_bank.npz",
        detail="results/{campaign}/simulation/pictures/view_detail.npz",
    output:
        scene_view_png=report(
            "results/{campaign}/figures/scene_view.png",
            caption="../report/scene_view.rst",
            category="Survey",
        ),
    log:
        "logs/{campaign}/figures/plot_scene_view.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_scene_view.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("plot_scene_view"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title", "crs"),
    message:
        "{wildcards.campaign}: view from the boat"
    script:
        "../scripts/plot_scene_view.py"


rule plot_distance_map:
    """Distance of the cloud from the reference on the bank (P2 Fig. 14, T Fig. 3.2)."""
    input:
        comparison="results/{campaign}/accuracy/cloud_to_mesh.parquet",
        mesh="results/{campaign}/surface/reference_mesh.ply",
        mesh_facts="results/{campaign}/surface/reference_mesh.json",
    output:
        distance_map_png=report(
            "results/{campaign}/figures/distance_map.png",
            caption="../report/distance_map.rst",
            category="Accuracy",
        ),
    log:
        "logs/{campaign}/figures/plot_distance_map.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_distance_map.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000, 6),
        runtime=minutes(10, 30),
    params:
        code=code_version("plot_distance_map"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: distance map"
    script:
        "../scripts/plot_distance_map.py"


rule plot_cross_sections:
    """Cross sections through cloud and reference (P2 Fig. 15)."""
    input:
        comparison="results/{campaign}/accuracy/cloud_to_mesh.parquet",
        mesh="results/{campaign}/surface/reference_mesh.ply",
        mesh_facts="results/{campaign}/surface/reference_mesh.json",
        points="results/{campaign}/lidar/points.laz",
        reference="results/{campaign}/ingest/reference.laz",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
    output:
        cross_sections_png=report(
            "results/{campaign}/figures/cross_sections.png",
            caption="../report/cross_sections.rst",
            category="Accuracy",
        ),
    log:
        "logs/{campaign}/figures/plot_cross_sections.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_cross_sections.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000, 6),
        runtime=minutes(10, 30),
    params:
        code=code_version("plot_cross_sections"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
        sections=lambda wildcards: CAMPAIGNS[wildcards.campaign].plain()["accuracy"][
            "sections"
        ],
        water_line_ics_m=lambda wildcards: CAMPAIGNS[
            wildcards.campaign
        ].filters.water_line_ics_m,
    message:
        "{wildcards.campaign}: cross sections"
    script:
        "../scripts/plot_cross_sections.py"


rule plot_distance_histogram:
    """Histogram of the distances with a normal fit (P2 Fig. 16a)."""
    input:
        comparison="results/{campaign}/accuracy/cloud_to_mesh.parquet",
    output:
        distance_histogram_png=report(
            "results/{campaign}/figures/distance_histogram.png",
            caption="../report/distance_histogram.rst",
            category="Accuracy",
        ),
    log:
        "logs/{campaign}/figures/plot_distance_histogram.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_distance_histogram.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000, 10),
        runtime=minutes(10),
    params:
        code=code_version("plot_distance_histogram"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: histogram of distances"
    script:
        "../scripts/plot_distance_histogram.py"


rule plot_distance_by_range:
    """Observed and predicted RMSE of the distances by range (P2 Fig. 16b)."""
    input:
        by_range="results/{campaign}/accuracy/by_range.csv",
    output:
        distance_by_range_png=report(
            "results/{campaign}/figures/distance_by_range.png",
            caption="../report/distance_by_range.rst",
            category="Accuracy",
        ),
    log:
        "logs/{campaign}/figures/plot_distance_by_range.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_distance_by_range.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        code=code_version("plot_distance_by_range"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
        outlier_nmads=lambda wildcards: CAMPAIGNS[
            wildcards.campaign
        ].accuracy.outlier_nmads,
    message:
        "{wildcards.campaign}: distance by range"
    script:
        "../scripts/plot_distance_by_range.py"
