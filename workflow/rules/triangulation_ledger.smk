"""Published numbers of the light-sheet sensor beside those of the digital twin (P3, P4, T 4.2)."""


rule compare_line_methods:
    """Scatter of each method of line measurement on one image of a panel (P3 2.2, P4 4.1)."""
    input:
        images=raw("panel_images"),
        line_points="results/{campaign}/triangulation/panels/line_points.parquet",
    output:
        line_methods="results/{campaign}/triangulation/line_methods.csv",
    log:
        "logs/{campaign}/triangulation/compare_line_methods.log",
    benchmark:
        "benchmarks/{campaign}/triangulation/compare_line_methods.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("compare_line_methods"),
    message:
        "{wildcards.campaign}: methods of line measurement"
    script:
        "../scripts/compare_line_methods.py"


rule light_sheet_ledger:
    """Each published number with a verdict: found, put in, within a bound, missed and by how much, not checkable."""
    input:
        published=LEDGER,
        stored=STORED,
        results=ledger_results,
    output:
        ledger="results/{campaign}/triangulation/ledger.csv",
        text="results/{campaign}/triangulation/ledger.md",
        numbers="results/{campaign}/triangulation/ledger_counts.csv",
    log:
        "logs/{campaign}/triangulation/light_sheet_ledger.log",
    benchmark:
        "benchmarks/{campaign}/triangulation/light_sheet_ledger.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("light_sheet_ledger"),
        folder=lambda wildcards: f"results/{wildcards.campaign}",
        studies=ledger_studies,
        light_sheet=lambda wildcards: twin_parts("light_sheet")(wildcards)[
            "light_sheet"
        ],
        campaign=identity("title"),
        twin=lambda wildcards: is_twin(wildcards.campaign),
    message:
        "{wildcards.campaign}: published numbers beside those of the digital twin"
    script:
        "../scripts/light_sheet_ledger.py"
