"""Reference clouds become surfaces."""


rule mesh_reference:
    """Reference cloud near the area of interest -> surface mesh."""
    input:
        cloud="results/{campaign}/ingest/reference.laz",
        integrity="results/{campaign}/ingest/reference.integrity.json",
        trajectory="results/{campaign}/orientation/trajectory.parquet",
    output:
        mesh="results/{campaign}/surface/reference_mesh.ply",
        facts="results/{campaign}/surface/reference_mesh.json",
    resources:
        mem_mb=memory(3000, 60),
        runtime=minutes(10, 60),
    params:
        origin=FRAME,
        crs=CRS,
        reference=without("reference", "sigma_m"),
        area=section("accuracy", "area"),
    script:
        "../scripts/mesh_reference.py"
