"""The commands ``thalweg catalogue`` and ``costs``: all campaigns of a folder of results."""

import argparse
import re
from pathlib import Path


def add_result_commands(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add ``catalogue`` and ``costs``."""
    catalogue = commands.add_parser(
        "catalogue",
        help="all campaigns of a folder of results: page, table, STAC items, calibration over the season; "
        "or those of a place and a time",
    )
    catalogue.add_argument(
        "results", type=Path, nargs="?", default=Path("results"), help="folder (default: %(default)s)"
    )
    catalogue.add_argument(
        "--box",
        type=float,
        nargs=4,
        metavar=("WEST", "SOUTH", "EAST", "NORTH"),
        help="list campaigns whose track touches this box, degrees",
    )
    catalogue.add_argument("--since", type=_date, metavar="DATE", help="list those that end later")
    catalogue.add_argument("--until", type=_date, metavar="DATE", help="list those that begin earlier")
    catalogue.set_defaults(command=_catalogue)
    costs = commands.add_parser(
        "costs", help="what the jobs of a folder of results took and had asked for; requests for the next run"
    )
    costs.add_argument(
        "results", type=Path, nargs="?", default=Path("results"), help="folder (default: %(default)s)"
    )
    costs.add_argument(
        "--write",
        type=Path,
        nargs="?",
        const=Path("config") / "resources.yaml",
        metavar="FILE",
        help="write requests that follow from it (default: %(const)s)",
    )
    costs.set_defaults(command=_costs)


def _date(text: str) -> str:
    if not re.fullmatch(r"\d{4}-\d\d-\d\d(T\d\d:\d\d(:\d\d)?Z?)?", text):
        raise argparse.ArgumentTypeError(f"'{text}' is no date such as 2026-05-11 or 2026-05-11T12:00:00")
    return text


def _catalogue(options: argparse.Namespace) -> int:
    from thalweg.core import InputError
    from thalweg.figures import chosen, read_entries, write_catalogue

    if not options.results.is_dir():
        raise InputError("no such folder", expected="a folder of results", where=options.results)
    entries = read_entries(options.results)
    if not entries:
        raise InputError(
            "no campaign in it",
            expected="folders of campaigns with index.html or orientation/trajectory.parquet",
            where=options.results,
            cure="Run `snakemake --config campaign=<id>` first",
        )
    if options.box or options.since or options.until:
        found = chosen(
            entries, box_deg=options.box, start_utc=options.since or "", end_utc=options.until or ""
        )
        for row in (entry.row for entry in found):
            print(f"{row['campaign']:20} {row['start_utc']:20} {row['chains']:18} {row['title']}")
        print(f"{len(found)} of {len(entries)} campaigns")
        return 0
    control = write_catalogue(entries, options.results / "catalogue")
    print(
        f"{len(entries)} campaigns, {int(control['outside'].sum())} calibrated values outside their limits: "
        f"{options.results / 'catalogue' / 'index.html'}"
    )
    return 0


def _costs(options: argparse.Namespace) -> int:
    import yaml

    from thalweg.core import InputError
    from thalweg.figures import costs_page
    from thalweg.workflow import fitted, per_rule, read_costs

    if not options.results.is_dir():
        raise InputError("no such folder", expected="a folder of results", where=options.results)
    jobs = read_costs(options.results)
    rules = per_rule(jobs)
    out = options.results / "costs"
    out.mkdir(exist_ok=True)
    rules.to_csv(out / "costs.csv", index=False, float_format="%.6g")
    jobs.to_csv(out / "jobs.csv", index=False, float_format="%.6g")
    costs_page(jobs, rules).write(out / "index.html")
    for row in rules[rules["remark"] != ""].to_dict("records"):
        print(f"{row['rule']}: {row['memory_mb']:.0f} of {row['asked_mb']:.0f} MB: {row['remark']}")
    print(
        f"{len(jobs)} jobs of {len(rules)} rules, {jobs['cpu_s'].sum() / 60:.1f} min of the processor,"
        f" largest {jobs['memory_mb'].max():.0f} MB: {out / 'index.html'}"
    )
    if options.write:
        lines = ["# Written by `thalweg costs --write`: what jobs took, with head room, over MB of inputs.\n"]
        lines += [
            yaml.safe_dump({name: each}, default_flow_style=None) for name, each in fitted(jobs).items()
        ]
        options.write.write_text("".join(lines), encoding="utf-8")
        print(f"requests of {len(rules)} rules: {options.write}")
    return int((rules["remark"].str.startswith("more")).any())
