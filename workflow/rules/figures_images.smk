"""Figures of the images and of the trajectories that they give."""


rule plot_image_positions:
    """Images, control points and their residuals (P2 Fig. 6 and 10)."""
    input:
        poses="results/{campaign}/orientation/image_poses.parquet",
        control_points=raw("control_points"),
        report="results/{campaign}/orientation/control_points.csv",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
    output:
        image_positions_png=report(
            "results/{campaign}/figures/image_positions.png",
            caption="../report/image_positions.rst",
            category="Images",
        ),
    log:
        "logs/{campaign}/figures/plot_image_positions.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_image_positions.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_image_positions"),
        sigma_m=images("control", "sigma_m"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title", "crs"),
    message:
        "{wildcards.campaign}: images and control points"
    script:
        "../scripts/plot_image_positions.py"


rule plot_frames_by_image:
    """The cloud by the image that orients it (P2 Fig. 11)."""
    input:
        points="results/{campaign}/lidar/by_camera/points.laz",
        poses="results/{campaign}/orientation/image_poses_timed.parquet",
    output:
        frames_by_image_png=report(
            "results/{campaign}/figures/frames_by_image.png",
            caption="../report/frames_by_image.rst",
            category="Images",
        ),
    log:
        "logs/{campaign}/figures/plot_frames_by_image.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_frames_by_image.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(3000, 6),
        runtime=minutes(10, 30),
    params:
        code=code_version("plot_frames_by_image"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: cloud by image"
    script:
        "../scripts/plot_frames_by_image.py"


rule plot_mask_view:
    """What of the images is usable, and what is water, sky or the boat itself (P2 Fig. 12)."""
    input:
        images=raw("time_lapse"),
        masks="results/{campaign}/orientation/masks",
        table="results/{campaign}/orientation/masks.csv",
    output:
        mask_view_png=report(
            "results/{campaign}/figures/mask_view.png",
            caption="../report/mask_view.rst",
            category="Images",
        ),
    log:
        "logs/{campaign}/figures/plot_mask_view.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_mask_view.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_mask_view"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: masks of the images"
    script:
        "../scripts/plot_mask_view.py"


rule plot_pose_sigmas:
    """Sigmas of the poses by INS, camera and all sensors over time."""
    input:
        trajectories=chain_trajectories,
    output:
        pose_sigmas_png=report(
            "results/{campaign}/figures/pose_sigmas.png",
            caption="../report/pose_sigmas.rst",
            category="Trajectories",
        ),
    log:
        "logs/{campaign}/figures/plot_pose_sigmas.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_pose_sigmas.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_pose_sigmas"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: sigmas of the trajectories"
    script:
        "../scripts/plot_pose_sigmas.py"


rule plot_chains_by_range:
    """Distances by range for all trajectories, achieved and predicted (T Fig. 3.3b)."""
    input:
        by_range="results/{campaign}/accuracy/chains_by_range.csv",
    output:
        chains_by_range_png=report(
            "results/{campaign}/figures/chains_by_range.png",
            caption="../report/chains_by_range.rst",
            category="Trajectories",
        ),
    log:
        "logs/{campaign}/figures/plot_chains_by_range.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_chains_by_range.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("plot_chains_by_range"),
        outlier_nmads=lambda wildcards: CAMPAIGNS[
            wildcards.campaign
        ].accuracy.outlier_nmads,
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: distances by range and trajectory"
    script:
        "../scripts/plot_chains_by_range.py"


rule plot_chain_histograms:
    """Histograms of the distances for all trajectories (T Fig. 3.3a)."""
    input:
        distances=of_compared_chains("cloud_to_mesh.parquet"),
    output:
        chain_histograms_png=report(
            "results/{campaign}/figures/chain_histograms.png",
            caption="../report/chain_histograms.rst",
            category="Trajectories",
        ),
    log:
        "logs/{campaign}/figures/plot_chain_histograms.log",
    benchmark:
        "benchmarks/{campaign}/figures/plot_chain_histograms.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000, 15),
        runtime=minutes(10),
    params:
        code=code_version("plot_chain_histograms"),
        figures=section("figures"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: distances by trajectory"
    script:
        "../scripts/plot_chain_histograms.py"


rule trajectory_comparison_page:
    """INS, camera and fused trajectory side by side, on one page (T 3.1.4)."""
    input:
        chains="results/{campaign}/accuracy/chains.csv",
        by_range="results/{campaign}/accuracy/chains_by_range.csv",
        facts="results/{campaign}/accuracy/chains.json",
        camera_facts="results/{campaign}/orientation/camera_trajectory.json",
        control=control_reports,
        truth=chains_truth,
        fused_facts="results/{campaign}/orientation/fused.json",
        trajectories=chain_trajectories,
        steps_ins=chain_steps("ins"),
        steps_camera=chain_steps("camera"),
        steps_fused=chain_steps("fused"),
        pictures=chain_pictures,
        captions=lambda wildcards: [
            ROOT / "workflow" / "report" / f"{Path(picture).stem}.rst"
            for picture in chain_pictures(wildcards)
        ],
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
        twin=lambda wildcards: is_twin(wildcards.campaign),
        campaign=identity("title"),
    message:
        "{wildcards.campaign}: page on INS, camera and fused trajectory"
    script:
        "../scripts/trajectory_comparison_page.py"
