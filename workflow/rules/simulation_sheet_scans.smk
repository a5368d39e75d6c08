"""Scans of the digital twin with the underwater light-sheet sensor, and their truth apart."""


rule simulate_sheet_scan:
    """Scan of an object with panel, standing camera, reference mesh and picked pairs (P4 7.3)."""
    output:
        images=directory("results/{campaign}/simulation/logs/light_sheet/{scan}/images"),
        notes="results/{campaign}/simulation/logs/light_sheet/{scan}/images.csv",
        pulses="results/{campaign}/simulation/logs/light_sheet/{scan}/trigger_pulses.csv",
        panel="results/{campaign}/simulation/logs/light_sheet/{scan}/six_dof/panel.csv",
        marks="results/{campaign}/simulation/logs/light_sheet/{scan}/six_dof/marks.csv",
        camera="results/{campaign}/simulation/logs/light_sheet/{scan}/six_dof/camera.json",
        reference="results/{campaign}/simulation/logs/light_sheet/{scan}/reference.ply",
        pairs="results/{campaign}/simulation/logs/light_sheet/{scan}/pairs.csv",
        truth=directory("results/{campaign}/simulation/truth/light_sheet/{scan}"),
    resources:
        mem_mb=memory(3000),
        runtime=minutes(20),
    params:
        **calls("thalweg_lab.tank.series:record_scan"),
        twin=of(CampaignFiles.twin_parts, "light_sheet"),
        seed=SEED,
        name=lambda wildcards: wildcards.scan,
        frame=FRAME,
        folder="results/{campaign}/simulation/logs/light_sheet/{scan}",
    script:
        "../scripts/call.py"


rule simulate_sheet_strip:
    """Images of the bed by the light-sheet sensor on the sailing boat (T 3.2)."""
    output:
        images=directory("results/{campaign}/simulation/logs/light_sheet/strip/images"),
        pulses="results/{campaign}/simulation/logs/light_sheet/strip/trigger_pulses.csv",
        truth=directory("results/{campaign}/simulation/truth/light_sheet/strip"),
    resources:
        mem_mb=memory(3000),
        runtime=minutes(20),
    params:
        frame=FRAME,
        seed=SEED,
        twin=of(CampaignFiles.twin_parts, "boat", "scene", "effects"),
        strip=section("twin", "light_sheet_strip"),
        mount=section("light_sheet", "mount"),
        basin=of(laboratory.sheet_basin),
    script:
        "../scripts/simulate_sheet_strip.py"
