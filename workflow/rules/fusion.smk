"""One model of bed and banks."""


rule build_dtm:
    """Bed, ground of the banks and the cloud of the surroundings as one terrain model with sigmas."""
    input:
        bed="results/{campaign}/bathymetry/bed.tif",
        banks="results/{campaign}/bathymetry/banks.csv",
        line="results/{campaign}/bathymetry/centre_line.csv",
        points=of(CampaignFiles.best_points),
        trajectory=of(CampaignFiles.best_trajectory),
        errors=of(CampaignFiles.best_errors),
        surroundings=raw("uav"),
        geoid=raw("geoid"),
    output:
        dtm="results/{campaign}/fusion/dtm.tif",
        cloud="results/{campaign}/fusion/model.laz",
        facts="results/{campaign}/fusion/dtm.json",
        fit="results/{campaign}/fusion/fit.json",
    resources:
        mem_mb=memory(3000, 15),
        runtime=minutes(20, 60),
    params:
        frame=FRAME,
        crs=CRS,
        fusion=section("fusion"),
    script:
        "../scripts/build_dtm.py"


rule measure_river:
    """Sections, long profile, volumes of the water, and files for hydraulic programs."""
    input:
        dtm="results/{campaign}/fusion/dtm.tif",
        banks="results/{campaign}/bathymetry/banks.csv",
        line="results/{campaign}/bathymetry/centre_line.csv",
        variogram="results/{campaign}/bathymetry/variogram.json",
    output:
        profile="results/{campaign}/fusion/profile.csv",
        hydraulics="results/{campaign}/fusion/hydraulics.csv",
        volumes="results/{campaign}/fusion/hypsometry.csv",
        facts="results/{campaign}/fusion/river.json",
        exports=directory("results/{campaign}/fusion/exports"),
    resources:
        mem_mb=memory(2000, 20),
        runtime=minutes(10, 30),
    params:
        frame=FRAME,
        crs=CRS,
        fusion=section("fusion"),
    script:
        "../scripts/measure_river.py"


rule export_layers:
    """Track, soundings, banks, contours and sections, or patches of change, as layers of one GeoPackage."""
    input:
        trajectory=of(CampaignFiles.page_path),
        soundings=of(CampaignFiles.mapped, "bathymetry/soundings.csv"),
        pings=of(CampaignFiles.mapped, "bathymetry/soundings.parquet"),
        dtm=of(CampaignFiles.mapped, "fusion/dtm.tif"),
        banks=of(CampaignFiles.mapped, "bathymetry/banks.csv"),
        line=of(CampaignFiles.mapped, "bathymetry/centre_line.csv"),
        patches=of(CampaignFiles.patches),
    output:
        out="results/{campaign}/survey.gpkg",
    resources:
        mem_mb=memory(2000, 15),
        runtime=minutes(10, 30),
    params:
        **calls("thalweg.fusion.maps:map_of_campaign"),
        campaign=identity("origin", "crs"),
        fusion=section("fusion"),
    script:
        "../scripts/call.py"


rule gis_project:
    """Layers, models and cloud of a campaign as a project for QGIS, drawn as in the figures."""
    input:
        layers="results/{campaign}/survey.gpkg",
        rasters=of(CampaignFiles.map_rasters),
        clouds=of(CampaignFiles.map_clouds),
    output:
        out="results/{campaign}/survey.qgz",
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        **calls("thalweg.figures.gis:write_gis_project"),
        title=TITLE,
        crs=CRS,
    script:
        "../scripts/call.py"
