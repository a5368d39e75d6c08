"""Published numbers recomputed. These rules depend on no campaign."""

BUDGETS = [
    "p2_table1",
    "t_table3_1",
    "p2_perfect_trigger",
    "p2_trigger_4ms",
    "p1_direct",
    "p1_direct_one_sigma",
    "sajo_2019",
    "sajo_2021",
]
BUDGET_FILE = str(ROOT / "resources" / "budgets" / "{name}.yaml")
PUBLISHED_FILE = str(ROOT / "resources" / "published" / "{name}.csv")


rule budget_tables:
    """Error budgets as tables with a verdict on each published cell."""
    input:
        budgets=expand(BUDGET_FILE, name=BUDGETS),
        published=expand(PUBLISHED_FILE, name=BUDGETS),
    output:
        budget_page="results/reproduction/error_budgets.md",
        verdicts_text="results/reproduction/error_budgets.txt",
        tables=expand("results/reproduction/budgets/{name}.csv", name=BUDGETS),
    resources:
        mem_mb=memory(1500),
        runtime=minutes(10),
    params:
        camera="p2_table1",
        ins="t_table3_1",
    script:
        "../scripts/budget_tables.py"


rule ledger:
    """Every published number, misprint and idea for future work with a verdict: which could have failed, and which did."""
    input:
        published=sorted((ROOT / laboratory.PUBLISHED).glob("*.yaml")),
        named=ROOT / laboratory.PUBLISHED / "headlines.csv",
        cells=expand(PUBLISHED_FILE, name=BUDGETS),
        pages=ROOT / "resources" / "thesis_pages.yaml",
        stored=[ROOT / name for name in laboratory.STORED],
        tables=rules.budget_tables.output.tables,
        records=laboratory.records(ROOT),
        campaigns=lambda wildcards: laboratory.whole_ledger_campaigns(ROOT),
    output:
        ledger="results/reproduction/ledger.csv",
        verdicts="results/reproduction/ledger_verdicts.csv",
        chosen="results/reproduction/ledger_headlines.csv",
        text="results/reproduction/ledger.txt",
        page=report(
            "results/reproduction/ledger.html",
            caption="../report/ledger.rst",
            category="Published numbers",
        ),
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        results=lambda wildcards: laboratory.whole_ledger_results(ROOT),
        rules=lambda wildcards: sorted(rule.name for rule in workflow.rules),
        figures=sorted(row.name for row in FIGURES.rows),
    script:
        "../scripts/ledger.py"


rule multi_line_scans:
    """Fifteen lines on grid, plane and wreck, measured and labelled (T 4.2.1)."""
    output:
        images="results/reproduction/multi_line_images.npz",
        image_points="results/reproduction/multi_line_points.csv",
    resources:
        mem_mb=memory(3000),
        runtime=minutes(20),
    params:
        seed=1,
    script:
        "../scripts/multi_line_scans.py"
