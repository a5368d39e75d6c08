"""Page of what jobs took and asked for."""

import pandas as pd
from matplotlib.figure import Figure

from thalweg.figures.page import Page
from thalweg.figures.style import BLUE, GREY, VERMILION, new_figure, styled

SHOWN = 25
"""Rules in the picture; all of them are in the table."""


@styled
def costs_figure(rules: pd.DataFrame) -> Figure:
    """Time of the processor of the most expensive rules, and their memory beside what was asked for."""
    top = rules.head(SHOWN).iloc[::-1]
    title = f"What jobs took, n = {int(rules['jobs'].sum())} jobs of {len(rules)} rules"
    figure = new_figure(35 + 5 * len(top), title, twin=False)
    left, right = figure.subplots(1, 2, sharey=True)
    names = [f"{r['rule']} ({r['jobs']})" for r in top.to_dict("records")]
    left.barh(names, top["cpu_s"], color=BLUE, height=0.6)
    left.set_xlabel("time of the processor [s]")
    left.tick_params(axis="y", labelsize=7)
    over = top["memory_mb"] > top["asked_mb"]
    right.barh(names, top["asked_mb"], color=GREY, alpha=0.35, height=0.8, label="asked for")
    colours = [VERMILION if each else BLUE for each in over]
    right.barh(names, top["memory_mb"], color=colours, height=0.4, label="used, the largest job")
    right.set_xlabel("memory [MB]")
    right.legend(fontsize=7, loc="lower right")
    return figure


def costs_page(jobs: pd.DataFrame, rules: pd.DataFrame) -> Page:
    """The page of the command ``thalweg costs``."""
    lead = (
        f"{len(jobs)} jobs of {jobs['campaign'].nunique()} campaigns, "
        f"{jobs['cpu_s'].sum() / 60:.1f} minutes of the processor."
    )
    page = Page("What jobs took", lead)
    page.section("Requests")
    told = [f"{r['rule']}: {r['remark']}" for r in rules[rules["remark"] != ""].to_dict("records")]
    page.lines(told or ["No job took more than it had asked for, and none less than a quarter of it."])
    page.section("Rules")
    page.figure(
        costs_figure(rules), f"The {min(SHOWN, len(rules))} most expensive rules; in brackets the jobs."
    )
    units = {"wall_s": "s", "cpu_s": "s", "longest_s": "s", "memory_mb": "MB", "asked_mb": "MB"}
    page.table(
        rules,
        "Sums of each rule; memory of its largest job with libraries, and 400 MB for Snakemake beside it.",
        units | {"input_mb": "MB", "output_mb": "MB"},
        digits=4,
    )
    return page
