"""The underwater light-sheet sensor of the digital twin: images, observations, and their truth apart."""


rule simulate_sheet_station:
    """Design of the sensor, marks that its camera sees through air (P4 4.3), and those of a field in air (P3 2.4)."""
    output:
        out_sensor="results/{campaign}/simulation/logs/light_sheet/sensor.yaml",
        out_marks="results/{campaign}/simulation/logs/light_sheet/camera_marks.csv",
        out_points="results/{campaign}/simulation/logs/light_sheet/mark_points.csv",
        covariance="results/{campaign}/simulation/logs/light_sheet/mark_points.npz",
        out_field_marks="results/{campaign}/simulation/logs/light_sheet/camera_field_marks.csv",
        out_field="results/{campaign}/simulation/logs/light_sheet/camera_field.yaml",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        **calls("thalweg_lab.tank.camera_field:record_camera_marks"),
        twin=of(CampaignFiles.twin_parts, "light_sheet"),
        seed=SEED,
    script:
        "../scripts/call.py"


rule simulate_sheet_grid:
    """Image of the laser on the grid object (P3 Fig. 4, P4 Fig. 9)."""
    output:
        images=directory(
            "results/{campaign}/simulation/logs/light_sheet/calibration/images"
        ),
        notes="results/{campaign}/simulation/logs/light_sheet/calibration/images.csv",
        pulses="results/{campaign}/simulation/logs/light_sheet/calibration/trigger_pulses.csv",
        grid="results/{campaign}/simulation/logs/light_sheet/calibration/grid_1.yaml",
        truth=directory("results/{campaign}/simulation/truth/light_sheet/calibration"),
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        **calls("thalweg_lab.tank.series:record_series"),
        twin=of(CampaignFiles.twin_parts, "light_sheet"),
        seed=SEED,
        series="calibration",
        frame=FRAME,
        folder="results/{campaign}/simulation/logs/light_sheet/calibration",
    script:
        "../scripts/call.py"


rule simulate_sheet_panels:
    """Images of the laser on a plane panel at known depths (P3 3.1.2)."""
    output:
        images=directory("results/{campaign}/simulation/logs/light_sheet/panels/images"),
        panels="results/{campaign}/simulation/logs/light_sheet/panels/images.csv",
        pulses="results/{campaign}/simulation/logs/light_sheet/panels/trigger_pulses.csv",
        truth=directory("results/{campaign}/simulation/truth/light_sheet/panels"),
    resources:
        mem_mb=memory(2000),
        runtime=minutes(20),
    params:
        **calls("thalweg_lab.tank.series:record_series"),
        twin=of(CampaignFiles.twin_parts, "light_sheet"),
        seed=SEED,
        series="panels",
        frame=FRAME,
        folder="results/{campaign}/simulation/logs/light_sheet/panels",
    script:
        "../scripts/call.py"
