"""The riverbed from soundings, banks and the light sheet."""


rule locate_soundings:
    """Soundings in the world with their errors; those that do not count with the reason."""
    input:
        depths="results/{campaign}/ingest/depths.parquet",
        integrity="results/{campaign}/ingest/depth.integrity.json",
        trajectory=of(CampaignFiles.best_trajectory),
        errors=of(CampaignFiles.best_errors),
        positions="results/{campaign}/ingest/positions.parquet",
        mounts="results/{campaign}/calibration/mounts.json",
        calibration=of(CampaignFiles.echo_outputs),
        decisions=raw("decisions"),
    output:
        soundings="results/{campaign}/bathymetry/soundings.parquet",
        text="results/{campaign}/bathymetry/soundings.csv",
        facts="results/{campaign}/bathymetry/soundings.json",
    resources:
        mem_mb=memory(2000, 20),
        runtime=minutes(10, 30),
    params:
        frame=FRAME,
        crs=CRS,
        echo_sounder=section("echo_sounder"),
        bathymetry=section("bathymetry"),
        water_line_ics_m=section("filters", "water_line_ics_m"),
    script:
        "../scripts/locate_soundings.py"


rule trace_river:
    """Water level, bank lines and centre line, solved jointly."""
    input:
        trajectory=of(CampaignFiles.best_trajectory),
        errors=of(CampaignFiles.best_errors),
        positions="results/{campaign}/ingest/positions.parquet",
        points=of(CampaignFiles.best_points),
        centre_line=of(CampaignFiles.drawn, "centre_line"),
        banks=of(CampaignFiles.drawn, "bank_lines"),
    output:
        traced="results/{campaign}/bathymetry/banks.csv",
        line="results/{campaign}/bathymetry/centre_line.csv",
        level="results/{campaign}/bathymetry/water_level.json",
    resources:
        mem_mb=memory(2500, 10),
        runtime=minutes(10, 30),
    params:
        frame=FRAME,
        crs=CRS,
        bathymetry=section("bathymetry"),
        water_line_ics_m=section("filters", "water_line_ics_m"),
    script:
        "../scripts/trace_river.py"


rule krige_bed:
    """The riverbed as a grid of heights with two sigmas, and the covariance that it rests on."""
    input:
        soundings="results/{campaign}/bathymetry/soundings.parquet",
        facts="results/{campaign}/bathymetry/soundings.json",
        banks="results/{campaign}/bathymetry/banks.csv",
        line="results/{campaign}/bathymetry/centre_line.csv",
        level="results/{campaign}/bathymetry/water_level.json",
        strip=where(CampaignFiles.has_strip, "triangulation/strip/points.parquet"),
        others=raw("soundings"),
    output:
        bed="results/{campaign}/bathymetry/bed.tif",
        variogram="results/{campaign}/bathymetry/variogram.json",
        used="results/{campaign}/bathymetry/observations.parquet",
    resources:
        mem_mb=memory(2000, 20),
        runtime=minutes(30, 60),
    params:
        run=RUN,
        frame=FRAME,
        crs=CRS,
        seed=SEED,
        echo_sounder=section("echo_sounder"),
        bathymetry=section("bathymetry"),
    script:
        "../scripts/krige_bed.py"


rule validate_bed:
    """Cross-validation of the bed by lines and stretches left out, beside other interpolators."""
    input:
        used="results/{campaign}/bathymetry/observations.parquet",
        soundings="results/{campaign}/bathymetry/soundings.json",
        variogram="results/{campaign}/bathymetry/variogram.json",
        line="results/{campaign}/bathymetry/centre_line.csv",
        banks="results/{campaign}/bathymetry/banks.csv",
        bed="results/{campaign}/bathymetry/bed.tif",
        reference=raw("reference_bed"),
        surveyed=raw("bed"),
    output:
        validation="results/{campaign}/bathymetry/validation.json",
        predicted="results/{campaign}/bathymetry/predicted.parquet",
        methods="results/{campaign}/bathymetry/methods.csv",
    resources:
        mem_mb=memory(2000, 20),
        runtime=minutes(30, 60),
    params:
        crs=CRS,
        bathymetry=section("bathymetry"),
    script:
        "../scripts/validate_bed.py"
