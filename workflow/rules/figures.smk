"""Pictures for people, all from result tables: a rule for each row of workflow/figures.yaml and format."""

VECTORS = {s for f in BUILT for s in f.section("figures", "formats")} - {"png"}

for row, suffix in product(FIGURES.drawn(), ["png", *sorted(VECTORS)]):

    rule:
        name:
            row.rule + f"_{suffix}" * (suffix != "png")
        input:
            **row.input_files(FILES),
        output:
            figure_file=(
                report(row.path, caption="../report/figure.rst", category=row.category)
                if suffix == "png"
                else as_format(row.path, suffix)
            ),
        log:
            row.log(suffix),
        resources:
            mem_mb=memory(*row.memory_mb),
            runtime=minutes(10, 30),
        params:
            **row.params(FILES),
            code=version("plot", row.draw),
            draw=row.draw,
            shows=row.shows,
        script:
            "../scripts/plot.py"
