"""The digital twin writes the raw logs of a campaign, and its truth apart from them."""


rule simulate_scene:
    """Mesh of the river reach."""
    output:
        scene="results/{campaign}/simulation/truth/scene.npz",
    priority: URGENT
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        seed=SEED,
        twin=of(CampaignFiles.twin_parts, "scene"),
    script:
        "../scripts/simulate_scene.py"


rule simulate_voyage:
    """True motion of the boat."""
    output:
        out_trajectory="results/{campaign}/simulation/truth/trajectory.parquet",
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        **calls("thalweg_lab.voyage.truth:simulate_voyage"),
        config=of(CampaignFiles.twin_parts, "scene", "boat"),
        seed=SEED,
        frame=FRAME,
    script:
        "../scripts/call.py"


rule simulate_mounts:
    """Where the sensors truly sit on the boat."""
    input:
        same_boat=of(laboratory.calibrated_boat),
    output:
        true_mounts_file="results/{campaign}/simulation/truth/mounts.json",
    priority: URGENT
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        seed=SEED,
        twin=of(CampaignFiles.twin_parts, "effects"),
        mounts=of(CampaignFiles.mounts, "lidar", "camera", "antenna", "echo_sounder"),
    script:
        "../scripts/simulate_mounts.py"


rule simulate_time_lapse_part:
    """One part of many images of the bank; the parts are jobs of their own."""
    input:
        true_mounts="results/{campaign}/simulation/truth/mounts.json",
        scene="results/{campaign}/simulation/truth/scene.npz",
    output:
        out_images=temp(directory("results/{campaign}/simulation/time_lapse_{part}")),
    priority: URGENT
    resources:
        mem_mb=memory(3000),
        runtime=minutes(600),
    params:
        **calls("thalweg_lab.time_lapse.record:draw_images"),
        config=of(CampaignFiles.twin_parts, "scene", "boat", "camera", "lidar"),
        settings=section("twin", "time_lapse"),
        seed=SEED,
        frame=FRAME,
        part=lambda wildcards: int(wildcards.part),
        parts=of(laboratory.n_image_parts),
    script:
        "../scripts/call.py"


rule simulate_time_lapse:
    """Images of the bank along the voyage, and the survey of the control points."""
    input:
        true_mounts="results/{campaign}/simulation/truth/mounts.json",
        scene="results/{campaign}/simulation/truth/scene.npz",
        drawn=of(laboratory.image_parts),
    output:
        images=directory("results/{campaign}/simulation/logs/time_lapse"),
        control_points="results/{campaign}/simulation/logs/control_points.csv",
        image_poses="results/{campaign}/simulation/truth/image_poses.parquet",
        truth="results/{campaign}/simulation/truth/time_lapse.json",
    priority: URGENT
    resources:
        mem_mb=memory(3000),
        runtime=minutes(600),
    params:
        frame=FRAME,
        seed=SEED,
        twin=of(CampaignFiles.twin_parts, "scene", "boat", "camera", "lidar"),
        time_lapse=section("twin", "time_lapse"),
    script:
        "../scripts/simulate_time_lapse.py"


rule simulate_rig_field:
    """Files of a camera with two fisheye lenses in a room of markers, and the survey of the markers."""
    output:
        images=directory("results/{campaign}/simulation/logs/rig_field"),
        field="results/{campaign}/simulation/logs/rig_field.yaml",
        field_points="results/{campaign}/simulation/logs/rig_field_points.csv",
    resources:
        mem_mb=memory(1500),
        runtime=minutes(20),
    params:
        **calls("thalweg_lab.dual_fisheye.record:simulate_rig_field"),
        config=of(CampaignFiles.twin_parts),
        settings=section("twin", "dual_fisheye"),
        seed=SEED,
    script:
        "../scripts/call.py"


rule simulate_dual_fisheye:
    """Files of a camera with two fisheye lenses along the voyage."""
    input:
        mounts="results/{campaign}/simulation/truth/mounts.json",
        scene="results/{campaign}/simulation/truth/scene.npz",
    output:
        images=directory("results/{campaign}/simulation/logs/rig"),
        poses="results/{campaign}/simulation/truth/rig_poses.parquet",
        panorama="results/{campaign}/simulation/truth/panorama.npz",
        truth="results/{campaign}/simulation/truth/rig.json",
    resources:
        mem_mb=memory(3000),
        runtime=minutes(60),
    params:
        **calls("thalweg_lab.dual_fisheye.record:simulate_dual_fisheye"),
        config=of(CampaignFiles.twin_parts, "scene", "boat", "lidar", "effects"),
        settings=section("twin", "dual_fisheye"),
        seed=SEED,
        frame=FRAME,
        rig=section("rig"),
        device=of(laboratory.rig_device),
    script:
        "../scripts/call.py"


rule simulate_lidar:
    """VLP-16 packets: every shot cast from its own pose."""
    input:
        true_mounts="results/{campaign}/simulation/truth/mounts.json",
        scene="results/{campaign}/simulation/truth/scene.npz",
    output:
        pcap="results/{campaign}/simulation/logs/lidar.pcap",
        shots="results/{campaign}/simulation/truth/lidar_shots.parquet",
        effects="results/{campaign}/simulation/truth/lidar_effects.json",
    priority: URGENT
    resources:
        mem_mb=memory(3000),
        runtime=minutes(60),
    params:
        frame=FRAME,
        seed=SEED,
        twin=of(CampaignFiles.twin_parts, "scene", "boat", "lidar", "effects"),
    script:
        "../scripts/simulate_lidar.py"


rule simulate_ins:
    """ANPP log of the INS."""
    output:
        anpp="results/{campaign}/simulation/logs/ins.anpp",
        effects="results/{campaign}/simulation/truth/ins_effects.json",
    priority: URGENT
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        frame=FRAME,
        seed=SEED,
        twin=of(CampaignFiles.twin_parts, "scene", "boat", "ins", "effects"),
    script:
        "../scripts/simulate_ins.py"


rule simulate_gnss:
    """SBP log of the rover and the PPK track."""
    input:
        scene="results/{campaign}/simulation/truth/scene.npz",
        true_mounts="results/{campaign}/simulation/truth/mounts.json",
    output:
        sbp="results/{campaign}/simulation/logs/rover.sbp",
        pos="results/{campaign}/simulation/logs/ppk.pos",
        effects="results/{campaign}/simulation/truth/gnss_effects.json",
    priority: URGENT
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        frame=FRAME,
        seed=SEED,
        twin=of(CampaignFiles.twin_parts, "scene", "boat", "gnss", "effects"),
    script:
        "../scripts/simulate_gnss.py"


rule simulate_raw_gnss:
    """Raw observations of the boat's receiver and of a base, where a campaign solves them itself."""
    input:
        scene="results/{campaign}/simulation/truth/scene.npz",
        true_mounts="results/{campaign}/simulation/truth/mounts.json",
    output:
        out_rover="results/{campaign}/simulation/logs/raw/rover.sbp",
        out_base="results/{campaign}/simulation/logs/raw/base.obs",
        out_nav="results/{campaign}/simulation/logs/raw/base.nav",
        out_effects="results/{campaign}/simulation/truth/raw_gnss_effects.json",
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        **calls("thalweg_lab.instruments.raw_gnss:simulate_raw_gnss"),
        config=of(CampaignFiles.twin_parts, "scene", "boat", "gnss"),
        seed=SEED,
        frame=FRAME,
    script:
        "../scripts/call.py"


rule simulate_echo:
    """NMEA log of the echo sounder."""
    input:
        true_mounts="results/{campaign}/simulation/truth/mounts.json",
        scene="results/{campaign}/simulation/truth/scene.npz",
    output:
        nmea="results/{campaign}/simulation/logs/echo.nmea",
        effects="results/{campaign}/simulation/truth/echo_effects.json",
        true_soundings="results/{campaign}/simulation/truth/soundings.parquet",
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        frame=FRAME,
        seed=SEED,
        twin=of(CampaignFiles.twin_parts, "scene", "boat", "echo", "effects"),
    script:
        "../scripts/simulate_echo.py"


rule simulate_bed_survey:
    """Points of the river bed, surveyed on foot."""
    input:
        scene="results/{campaign}/simulation/truth/scene.npz",
    output:
        out_bed="results/{campaign}/simulation/logs/bed.csv",
        out_effects="results/{campaign}/simulation/truth/bed_survey_effects.json",
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        **calls("thalweg_lab.instruments.bed:simulate_bed_survey"),
        config=of(CampaignFiles.twin_parts, "scene", "boat", "echo"),
        seed=SEED,
        frame=FRAME,
        crs=CRS,
    script:
        "../scripts/call.py"


rule simulate_tls:
    """Terrestrial scans from three stations."""
    input:
        scene="results/{campaign}/simulation/truth/scene.npz",
    output:
        out_scans=expand(
            "results/{campaign}/simulation/logs/tls_{station}.laz",
            station=[1, 2, 3],
            allow_missing=True,
        ),
        out_effects="results/{campaign}/simulation/truth/tls_effects.json",
    resources:
        mem_mb=memory(3000),
        runtime=minutes(10),
    params:
        **calls("thalweg_lab.instruments.tls:simulate_tls"),
        config=of(CampaignFiles.twin_parts, "scene", "tls"),
        seed=SEED,
        frame=FRAME,
        crs=CRS,
    script:
        "../scripts/call.py"


rule simulate_uav:
    """Cloud of the surroundings by a drone."""
    input:
        scene="results/{campaign}/simulation/truth/scene.npz",
    output:
        out_cloud="results/{campaign}/simulation/logs/uav.laz",
        out_effects="results/{campaign}/simulation/truth/uav_effects.json",
    resources:
        mem_mb=memory(3000),
        runtime=minutes(10),
    params:
        **calls("thalweg_lab.instruments.uav:simulate_uav"),
        config=of(CampaignFiles.twin_parts, "scene", "uav"),
        seed=SEED,
        frame=FRAME,
        crs=CRS,
    script:
        "../scripts/call.py"
