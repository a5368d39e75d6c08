"""The calibration field of the digital twin: images, scans and a running clock, and their truth apart."""


rule simulate_field:
    """Description of the calibration field as a user writes it, and the truth."""
    output:
        out_field="results/{campaign}/simulation/logs/field.yaml",
        out_truth="results/{campaign}/simulation/truth/field.json",
        out_poses="results/{campaign}/simulation/truth/field_poses.parquet",
    priority: URGENT
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        **calls("thalweg_lab.yard_records:simulate_field"),
        config=of(CampaignFiles.twin_parts),
        seed=SEED,
        frame=FRAME,
    script:
        "../scripts/call.py"


rule simulate_positions:
    """Lidar captures of the static positions."""
    input:
        true_mounts="results/{campaign}/simulation/truth/mounts.json",
    output:
        scans=directory("results/{campaign}/simulation/logs/position_scans"),
        effects="results/{campaign}/simulation/truth/positions_effects.json",
    priority: URGENT
    resources:
        mem_mb=memory(3000),
        runtime=minutes(20),
    params:
        frame=FRAME,
        seed=SEED,
        twin=of(CampaignFiles.twin_parts, "lidar", "effects"),
    script:
        "../scripts/simulate_positions.py"


rule simulate_field_images_part:
    """One part of the reflex camera's images of the field; the parts are jobs of their own."""
    input:
        true_mounts="results/{campaign}/simulation/truth/mounts.json",
    output:
        out_images=temp(
            directory("results/{campaign}/simulation/reference_images_{part}")
        ),
    priority: URGENT
    resources:
        mem_mb=memory(3000),
        runtime=minutes(60),
    params:
        **calls("thalweg_lab.yard_images.images:draw_field_images"),
        config=of(CampaignFiles.twin_parts, "camera", "effects"),
        kind="reference",
        seed=SEED,
        part=lambda wildcards: int(wildcards.part),
        parts=of(laboratory.n_reference_parts),
    script:
        "../scripts/call.py"


rule simulate_field_images:
    """Images of the field: by a reflex camera, by the boat's camera at each static position and in the run."""
    input:
        true_mounts="results/{campaign}/simulation/truth/mounts.json",
        drawn=of_wildcard("field_images", laboratory.drawn_field_images),
    output:
        images=directory("results/{campaign}/simulation/logs/{field_images}_images"),
        times="results/{campaign}/simulation/truth/{field_images}_images.parquet",
    log:
        "logs/{campaign}/simulation/simulate_{field_images}_images.log",
    wildcard_constraints:
        field_images="reference|position|run",
    priority: URGENT
    resources:
        mem_mb=memory(3000),
        runtime=minutes(60),
    params:
        kind=lambda wildcards: wildcards.field_images.replace("position", "positions"),
        seed=SEED,
        twin=of(CampaignFiles.twin_parts, "camera", "effects"),
    script:
        "../scripts/simulate_field_images.py"


rule simulate_display:
    """Photographs of a running clock."""
    output:
        out_folder=directory("results/{campaign}/simulation/logs/display"),
        out_truth="results/{campaign}/simulation/truth/display.parquet",
    priority: URGENT
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        **calls("thalweg_lab.instruments.display_photos:simulate_display"),
        config=of(CampaignFiles.twin_parts, "camera"),
        seed=SEED,
    script:
        "../scripts/call.py"


rule simulate_synthetic_view:
    """Synthetic image and lidar frame of the field: 8 scan lines in steps of 4 degrees (P2 Fig. 4)."""
    input:
        true_mounts="results/{campaign}/simulation/truth/mounts.json",
    output:
        view="results/{campaign}/simulation/pictures/synthetic_view.npz",
        lidar_frame="results/{campaign}/simulation/pictures/lidar_frame.parquet",
    resources:
        mem_mb=memory(3000),
        runtime=minutes(10),
    params:
        seed=SEED,
        twin=of(CampaignFiles.twin_parts, "camera", "lidar", "effects"),
    script:
        "../scripts/simulate_synthetic_view.py"
