"""Pictures for people, all from result tables: a rule for each row of workflow/figures.yaml."""

for row in FIGURES.drawn():

    rule:
        name:
            row.rule
        input:
            **row.input_files(FILES),
        output:
            figure_png=report(
                row.path, caption="../report/figure.rst", category=row.category
            ),
        log:
            row.protocol("logs", "log"),
        benchmark:
            row.protocol("benchmarks", "jsonl")
        conda:
            "../../envs/thalweg.yaml"
        threads: 1
        resources:
            mem_mb=memory(*row.memory_mb),
            runtime=minutes(10, 30),
        params:
            **row.params(FILES),
            code=code_version("plot", row.draw),
            draw=row.draw,
            shows=row.shows,
        script:
            "../scripts/plot.py"
