"""Published numbers of the light-sheet sensor beside those of the digital twin (P3, P4, T 4.2)."""


rule compare_line_methods:
    """Scatter of each method of line measurement on one image of a panel (P3 2.2, P4 4.1)."""
    input:
        images=raw("panel_images"),
        line_points="results/{campaign}/triangulation/panels/line_points.parquet",
    output:
        line_methods="results/{campaign}/triangulation/line_methods.csv",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    script:
        "../scripts/compare_line_methods.py"


rule light_sheet_ledger:
    """Each published number with a verdict: reproduced, below a bound, by definition, input, not matched and by how much."""
    input:
        published=ROOT / laboratory.LEDGER,
        stored=[ROOT / name for name in laboratory.STORED],
        results=of(laboratory.ledger_results, ROOT),
        # of studies that were not made here
        records=laboratory.records(ROOT),
    output:
        ledger="results/{campaign}/triangulation/ledger.csv",
        text="results/{campaign}/triangulation/ledger.md",
        numbers="results/{campaign}/triangulation/ledger_counts.csv",
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        folder=lambda wildcards: f"results/{wildcards.campaign}",
        studies=laboratory.ledger_studies(ROOT),
        light_sheet=section("twin", "light_sheet"),
        title=TITLE,
        twin=TWIN,
    script:
        "../scripts/light_sheet_ledger.py"
