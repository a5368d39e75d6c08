"""What changed between epochs."""


wildcard_constraints:
    pair=r"\d+-\d+",


rule prepare_epoch:
    """Points of a survey with the errors that they share, in the frame of all epochs."""
    input:
        points=of_wildcard("epoch", CampaignFiles.epoch_points),
        trajectory=of_wildcard("epoch", CampaignFiles.epoch_trajectory),
        mounts=of_wildcard("epoch", CampaignFiles.epoch_mounts),
        positions="results/{epoch}/ingest/positions.parquet",
        facts=of_wildcard("epoch", CampaignFiles.epoch_errors),
    output:
        prepared="results/{campaign}/deformation/epochs/{epoch}/points.npz",
        errors="results/{campaign}/deformation/epochs/{epoch}/errors.json",
    wildcard_constraints:
        epoch=pattern_of_epochs(FILES.values(), with_trajectory=True),
    resources:
        mem_mb=memory(3000, 10),
        runtime=minutes(10, 60),
    params:
        frame=FRAME,
        crs=CRS,
        deformation=section("deformation"),
        name=lambda wildcards: wildcards.epoch,
        chain=of_wildcard("epoch", CampaignFiles.chain_of),
        water_line_ics_m=lambda wildcards: (
            CAMPAIGNS[wildcards.epoch].filters.water_line_ics_m
        ),
        sigma_time_s=lambda wildcards: (
            CAMPAIGNS[wildcards.epoch].lidar_accuracy.sigma_time_s
        ),
    script:
        "../scripts/prepare_epoch.py"


rule prepare_foreign_epoch:
    """Points of a cloud or surface model from elsewhere, or of a riverbed, with the errors stated of them."""
    input:
        surface=of_wildcard("epoch", CampaignFiles.epoch_surface),
        masks=of_wildcard("epoch", CampaignFiles.epoch_masks),
        positions=of_wildcard("epoch", CampaignFiles.epoch_positions),
    output:
        prepared="results/{campaign}/deformation/epochs/{epoch}/points.npz",
        errors="results/{campaign}/deformation/epochs/{epoch}/errors.json",
    wildcard_constraints:
        epoch=pattern_of_epochs(FILES.values(), with_trajectory=False),
    resources:
        mem_mb=memory(3000, 10),
        runtime=minutes(10, 60),
    params:
        frame=FRAME,
        crs=CRS,
        deformation=section("deformation"),
        name=lambda wildcards: wildcards.epoch,
        stated=of_wildcard("epoch", CampaignFiles.epoch_statement),
    script:
        "../scripts/prepare_foreign_epoch.py"


rule place_core_points:
    """Even core points over the surfaces of the first and of the last epoch."""
    input:
        epochs=of(CampaignFiles.all_epochs, "points.npz"),
    output:
        core_points="results/{campaign}/deformation/core_points.parquet",
    threads: 2
    resources:
        mem_mb=memory(2600, 10),
        runtime=minutes(10, 60),
    params:
        frame=FRAME,
        crs=CRS,
        deformation=section("deformation"),
    script:
        "../scripts/place_core_points.py"


rule coregister_epochs:
    """The motion between two epochs that stable ground shows, with its covariance."""
    input:
        epochs=of_wildcard("pair", CampaignFiles.epochs_of, "points.npz"),
        core_points="results/{campaign}/deformation/core_points.parquet",
        stable=of(CampaignFiles.stable_ground),
    output:
        registration="results/{campaign}/deformation/registration_{pair}.json",
        weights="results/{campaign}/deformation/registration_{pair}.npz",
    threads: 2
    resources:
        mem_mb=memory(3200, 10),
        runtime=minutes(10, 60),
    params:
        frame=FRAME,
        crs=CRS,
        deformation=section("deformation"),
    script:
        "../scripts/coregister_epochs.py"


rule compare_epochs:
    """Distances between two epochs with their significance, what each could see, classes and volumes."""
    input:
        epochs=of_wildcard("pair", CampaignFiles.epochs_of, "points.npz"),
        core_points="results/{campaign}/deformation/core_points.parquet",
        registration="results/{campaign}/deformation/registration_{pair}.json",
        weights="results/{campaign}/deformation/registration_{pair}.npz",
    output:
        visibility="results/{campaign}/deformation/visibility_{pair}.parquet",
        changes="results/{campaign}/deformation/changes_{pair}.parquet",
        draws="results/{campaign}/deformation/draws_{pair}.parquet",
        cloud="results/{campaign}/deformation/changes_{pair}.laz",
        patches="results/{campaign}/deformation/patches_{pair}.csv",
        volumes="results/{campaign}/deformation/volumes_{pair}.csv",
        along="results/{campaign}/deformation/volumes_along_{pair}.csv",
        retreat="results/{campaign}/deformation/retreat_{pair}.csv",
        facts="results/{campaign}/deformation/changes_{pair}.json",
    threads: 2
    resources:
        mem_mb=memory(3200, 10),
        runtime=minutes(20, 60),
    params:
        frame=FRAME,
        seed=SEED,
        deformation=section("deformation"),
    script:
        "../scripts/compare_epochs.py"


rule difference_of_surfaces:
    """Difference of the heights of two epochs on a grid of the map, with sigmas, and volumes."""
    input:
        epochs=of_wildcard("pair", CampaignFiles.epochs_of, "points.npz"),
        core_points="results/{campaign}/deformation/core_points.parquet",
        registration="results/{campaign}/deformation/registration_{pair}.json",
        weights="results/{campaign}/deformation/registration_{pair}.npz",
        surfaces=of_wildcard("pair", CampaignFiles.surface_files),
    output:
        difference="results/{campaign}/deformation/dod_{pair}.tif",
        volumes="results/{campaign}/deformation/dod_{pair}.csv",
    resources:
        mem_mb=memory(3200, 10),
        runtime=minutes(20, 60),
    params:
        frame=FRAME,
        crs=CRS,
        deformation=section("deformation"),
        models=of_wildcard("pair", CampaignFiles.surface_statements),
    script:
        "../scripts/difference_of_surfaces.py"


rule change_series:
    """Trend and step at each core point over more than two epochs, and epochs that jump and return."""
    input:
        epochs=of(CampaignFiles.all_epochs, "points.npz"),
        core_points="results/{campaign}/deformation/core_points.parquet",
        stable=of(CampaignFiles.stable_ground),
    output:
        series="results/{campaign}/deformation/series.parquet",
        heights="results/{campaign}/deformation/heights.parquet",
        jumps="results/{campaign}/deformation/jumps.json",
        retreat="results/{campaign}/deformation/retreat_rates.csv",
    threads: 2
    resources:
        mem_mb=memory(4000, 10),
        runtime=minutes(20, 60),
    params:
        frame=FRAME,
        crs=CRS,
        deformation=section("deformation"),
    script:
        "../scripts/change_series.py"


rule simulate_change:
    """What truly changed between two epochs of a twin, at places and by polygon; for the comparison alone."""
    input:
        scenes=of_wildcard(
            "pair", CampaignFiles.surveys_of, "simulation/truth/scene.npz"
        ),
    output:
        points="results/{campaign}/simulation/truth/change_{pair}.parquet",
        polygons="results/{campaign}/simulation/truth/change_{pair}.csv",
    log:
        "logs/{campaign}/simulation/simulate_change_{pair}.log",
    threads: 2
    resources:
        mem_mb=memory(3000),
        runtime=minutes(20),
    params:
        **calls("thalweg_lab.truth.change:simulate_change"),
        settings=of_wildcard("pair", CampaignFiles.scenes_of),
        seeds=of_wildcard("pair", CampaignFiles.seeds_of),
        campaign=identity("origin", "crs"),
        deformation=of(CampaignFiles.change_places),
    script:
        "../scripts/call.py"


rule compare_change_with_truth:
    """Measured changes of a twin against what truly changed."""
    input:
        changes="results/{campaign}/deformation/changes_{pair}.parquet",
        core_points="results/{campaign}/deformation/core_points.parquet",
        volumes="results/{campaign}/deformation/volumes_{pair}.csv",
        draws="results/{campaign}/deformation/draws_{pair}.parquet",
        difference="results/{campaign}/deformation/dod_{pair}.tif",
        places="results/{campaign}/simulation/truth/change_{pair}.parquet",
        polygons="results/{campaign}/simulation/truth/change_{pair}.csv",
        scenes=of_wildcard(
            "pair", CampaignFiles.surveys_of, "simulation/truth/scene.npz"
        ),
    output:
        measures="results/{campaign}/deformation/truth_{pair}.csv",
        cores="results/{campaign}/deformation/truth_{pair}.parquet",
        by_polygon="results/{campaign}/deformation/truth_polygons_{pair}.csv",
    resources:
        mem_mb=memory(3000),
        runtime=minutes(20),
    params:
        frame=FRAME,
        deformation=section("deformation"),
    script:
        "../scripts/compare_change_with_truth.py"
