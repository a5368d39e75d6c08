"""How accurate the results are; comparisons with the truth of the digital twin stand in accuracy_truth.smk."""


rule compare_with_reference:
    """Signed distance of each point from the reference mesh, and what its sigma predicts (P2 6.2)."""
    input:
        points="results/{campaign}/lidar/{by}points.laz",
        mesh="results/{campaign}/surface/reference_mesh.ply",
        error_model="results/{campaign}/orientation/error_model.json",
    output:
        cloud_to_mesh="results/{campaign}/accuracy/{by}cloud_to_mesh.parquet",
        statistics="results/{campaign}/accuracy/{by}statistics.csv",
        by_range="results/{campaign}/accuracy/{by}by_range.csv",
        spatial="results/{campaign}/accuracy/{by}spatial.csv",
        registration="results/{campaign}/accuracy/{by}registration.json",
    log:
        "logs/{campaign}/accuracy/{by}compare_with_reference.log",
    resources:
        mem_mb=memory(2500, 20),
        runtime=minutes(15, 30),
    params:
        crs=CRS,
        seed=SEED,
        accuracy=of(CampaignFiles.comparison),
        reference=lambda wildcards: {
            "sigma_m": CAMPAIGNS[wildcards.campaign].reference.sigma_m
        },
    script:
        "../scripts/compare_with_reference.py"


rule summarise:
    """Key numbers of a campaign in one table."""
    input:
        streams="results/{campaign}/timing/streams.csv",
        trajectory="results/{campaign}/orientation/trajectory.json",
        positions="results/{campaign}/ingest/positions.integrity.json",
        counts=of(CampaignFiles.counts_of_points),
        images=of(CampaignFiles.adjustment_facts),
        soundings=of(CampaignFiles.sounding_facts),
        bed=of(CampaignFiles.bed_validation),
        reference=of(CampaignFiles.reference_statistics),
        truth=of(CampaignFiles.truth_statistics),
    output:
        summary="results/{campaign}/summary.csv",
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    script:
        "../scripts/summarise.py"


rule compare_chains:
    """Clouds and trajectories by INS, camera and all sensors side by side (T 3.1.4)."""
    input:
        trajectories=of(CampaignFiles.trajectories),
        counts=of(CampaignFiles.of_chains, "lidar", "counts.csv"),
        statistics=of(CampaignFiles.of_compared_chains, "statistics.csv"),
        by_range=of(CampaignFiles.of_compared_chains, "by_range.csv"),
        distances=of(CampaignFiles.of_compared_chains, "cloud_to_mesh.parquet"),
        budgets=[
            ROOT / "resources" / "budgets" / f"{name}.yaml"
            for name in ("t_table3_1", "p2_table1")
        ],
    output:
        chains="results/{campaign}/accuracy/chains.csv",
        chains_by_range_csv="results/{campaign}/accuracy/chains_by_range.csv",
        facts="results/{campaign}/accuracy/chains.json",
    resources:
        mem_mb=memory(2000, 15),
        runtime=minutes(10),
    script:
        "../scripts/compare_chains.py"


rule compare_riverbed_with_truth:
    """Errors of the twin's soundings ping by ping, of its riverbed by distance to data; reasons of those left out."""
    input:
        soundings="results/{campaign}/bathymetry/soundings.parquet",
        depths="results/{campaign}/ingest/depths.parquet",
        pings="results/{campaign}/simulation/truth/soundings.parquet",
        bed="results/{campaign}/bathymetry/bed.tif",
        banks="results/{campaign}/bathymetry/banks.csv",
        line="results/{campaign}/bathymetry/centre_line.csv",
        level="results/{campaign}/bathymetry/water_level.json",
        scene="results/{campaign}/simulation/truth/scene.npz",
    output:
        riverbed="results/{campaign}/accuracy/truth_riverbed.csv",
        errors="results/{campaign}/accuracy/truth_soundings.csv",
        reasons="results/{campaign}/accuracy/truth_sounding_reasons.csv",
    resources:
        mem_mb=memory(2500, 10),
        runtime=minutes(10, 30),
    params:
        frame=FRAME,
    script:
        "../scripts/compare_riverbed_with_truth.py"
