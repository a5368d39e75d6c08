"""The commands ``summary``, ``catalogue``, ``costs``, ``verify`` for results; ``cluster`` for SLURM."""

import argparse
import re
import sys
from pathlib import Path
from typing import Final

from thalweg.commands.options import positive
from thalweg.commands.parser import Commands, add_options
from thalweg.core import InputError

# ---------------------------------------------------------------- jobs on SLURM


def add_cluster_commands(commands: Commands) -> None:
    """Add ``cluster status``, ``clean`` and ``check``."""
    cluster = commands.add_parser("cluster", help="jobs of a run on SLURM: status, clean, check")
    what = cluster.add_subparsers(required=True, metavar="WHAT")
    folder = ("--folder", Path, None, "where Snakemake runs (default: here)", Path())
    partition = ("--partition", str, None, "default: that of the cluster")
    for name, run, words, *rows in (
        ("status", _status, "driver and jobs of the run of a folder", folder),
        ("clean", _clean, "cancel jobs whose driver is dead, and remove what they left half-done", folder),
        (
            "check",
            _check,
            "before a first run: partition, shared folder, clocks and code of the nodes",
            folder,
            partition,
        ),
    ):
        parser = what.add_parser(name, help=words)
        add_options(parser, rows)
        parser.set_defaults(command=run)


def _status(options: argparse.Namespace) -> int:
    from thalweg.workflow import jobs_of, living_driver, unfinished

    driver, jobs = living_driver(options.folder), jobs_of(options.folder)
    print(f"driver: {driver or 'none'}")
    for job in jobs:
        print(f"{job.number:>8}  {job.state:10} {job.elapsed:>10}  {job.node or job.reason:16} {job.rule}")
    parts = sum(1 for _ in unfinished(options.folder))
    print(f"{len(jobs)} jobs wait or run; {parts} sets of outputs are being written")
    if driver is None and (jobs or parts):
        print("They have no driver. `thalweg cluster clean` cancels them, and then Snakemake resumes.")
    return 0


def _clean(options: argparse.Namespace) -> int:
    from thalweg.workflow import cancel_jobs

    jobs = cancel_jobs(options.folder)
    for job in jobs:
        print(f"cancelled {job.number}: {job.rule}")
    print(f"{len(jobs)} jobs cancelled. Now `snakemake --unlock`, and the same command as before.")
    return 0


def _check(options: argparse.Namespace) -> int:
    from thalweg.workflow import check_cluster, check_nodes

    check_cluster(options.partition)
    found = check_nodes(options.folder, options.partition, sys.executable)
    print("\n".join(found) if found else "no node is free to be asked")
    return 0 if all(" sees the folder" in line for line in found) else 2


# ---------------------------------------------------------------- folders of results


_RESULTS: Final = ("results", Path, None, "folder (default: %(default)s)", Path("results"), {"nargs": "?"})


def add_result_commands(commands: Commands) -> None:
    """Add ``catalogue``, ``costs`` and ``verify``."""
    commands.add(
        "catalogue",
        "catalogue of a results folder: page, table, STAC items, calibration over the season; or the "
        "campaigns of a place and a time",
        _catalogue,
        _RESULTS,
        (
            "--box",
            [float],
            ("WEST", "SOUTH", "EAST", "NORTH"),
            "list campaigns whose track touches this box, degrees",
        ),
        ("--since", _date, "DATE", "list those that end later"),
        ("--until", _date, "DATE", "list those that begin earlier"),
    )
    commands.add(
        "costs",
        "time and memory that the jobs of a results folder used and requested; requests for the next run",
        _costs,
        _RESULTS,
        (
            "--write",
            Path,
            "FILE",
            "write requests that follow from it (default: %(const)s)",
            None,
            {"nargs": "?", "const": Path("config") / "resources.yaml"},
        ),
        (
            "--predict",
            positive,
            "TIMES",
            "what a survey would take whose logs are so many times those of a measured one",
        ),
        ("--of", None, "CAMPAIGN", "that one (default: the campaign with the largest inputs)"),
    )
    commands.add(
        "verify",
        "check the files of a results folder against their recorded hashes; list what differs, and how to "
        "make it again",
        _verify,
        _RESULTS,
    )


def _date(text: str) -> str:
    if not re.fullmatch(r"\d{4}-\d\d-\d\d(T\d\d:\d\d(:\d\d)?Z?)?", text):
        raise argparse.ArgumentTypeError(f"'{text}' is no date such as 2026-05-11 or 2026-05-11T12:00:00")
    return text


def _refuse_no_folder(results: Path) -> None:
    if not results.is_dir():
        raise InputError("no such folder", expected="a folder of results", where=results)


def _catalogue(options: argparse.Namespace) -> int:
    from thalweg.figures import chosen, read_entries, write_catalogue

    _refuse_no_folder(options.results)
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

    from thalweg.workflow import fitted, per_rule, predicted, read_costs

    _refuse_no_folder(options.results)
    jobs = read_costs(options.results)
    rules = per_rule(jobs)
    out = options.results / "costs"
    out.mkdir(exist_ok=True)
    rules.to_csv(out / "costs.csv", index=False, float_format="%.6g")
    jobs.to_csv(out / "jobs.csv", index=False, float_format="%.6g")
    for row in rules[rules["remark"] != ""].to_dict("records"):
        print(f"{row['rule']}: {row['memory_mb']:.0f} of {row['asked_mb']:.0f} MB: {row['remark']}")
    print(
        f"{len(jobs)} jobs of {len(rules)} rules, {jobs['cpu_s'].sum() / 60:.1f} min of the processor,"
        f" largest {jobs['memory_mb'].max():.0f} MB: {out / 'costs.csv'}"
    )
    if options.write:
        lines = ["# Written by `thalweg costs --write`: what jobs took, with head room, over MB of inputs.\n"]
        lines += [
            yaml.safe_dump({name: each}, default_flow_style=None) for name, each in fitted(jobs).items()
        ]
        options.write.write_text("".join(lines), encoding="utf-8")
        print(f"requests of {len(rules)} rules: {options.write}")
    if options.predict:
        of = options.of or str(jobs.groupby("campaign")["input_mb"].sum().idxmax())
        table = predicted(jobs, of, options.predict)
        table.to_csv(out / "predicted.csv", index=False, float_format="%.6g")
        longest = table.sort_values("longest_s").iloc[-1]
        unknown = int((~table["measured_growth"]).sum())
        print(
            f"{options.predict:g} times the logs of {of}: {table['least_cpu_s'].sum() / 3600:.2f} to"
            f" {table['cpu_s'].sum() / 3600:.2f} h of one processor, memory of a job up to"
            f" {table['least_memory_mb'].max() / 1000:.1f} to {table['memory_mb'].max() / 1000:.1f} GB,"
            f" longest job {longest['rule']} {longest['longest_s'] / 3600:.2f} h,"
            f" {table['output_mb'].sum() / 1000:.1f} GB of results: {out / 'predicted.csv'}"
        )
        if unknown:
            print(
                f"{unknown} of {len(table)} rules were measured at one size: the first number is as if they"
                " did not grow, the second as if in proportion; run a third of the logs as well"
            )
    return int((rules["remark"].str.startswith("more")).any())


_NAMED = 5
"""Files without a record; more are counted."""


def _verify(options: argparse.Namespace) -> int:
    from thalweg.workflow import verify

    _refuse_no_folder(options.results)
    found = verify(options.results)
    for name, words in found.wrong.items():
        print(f"{name} {words}")
    print(f"{found.as_written} outputs are as they were written, {len(found.wrong)} are not")
    if n := len(found.unrecorded):
        named = ", ".join(str(each) for each in found.unrecorded[:_NAMED])
        print(f"{n} files without a record: {named}{f' and {n - _NAMED} more' if n > _NAMED else ''}")
    if found.wrong:
        print("Made again, in the folder of the run, by:")
        print("\n".join(f"  {command}" for command in found.commands()))
    return int(bool(found.wrong))


def add_summary_command(commands: Commands) -> None:
    """Add ``summary``."""
    commands.add(
        "summary",
        "print the summary of a processed campaign",
        _summary,
        ("folder", Path, "FOLDER", "results/<campaign>"),
    )


WORTH_OPENING = (
    "index.html",
    "accuracy/index.html",
    "figures/cloud_overview.png",
    "bathymetry/index.html",
    "calibration/index.html",
    "triangulation/index.html",
    "lidar/by_fused/points.laz",
    "lidar/points.laz",
    "figures/survey_map.png",
    "summary.csv",
)
"""Files of a campaign below its folder, the best first; a run ends with the first five that exist."""


def _summary(options: argparse.Namespace) -> int:
    path = options.folder / "summary.csv"
    if not path.is_file() and any((options.folder / "deformation").glob("volumes_*.csv")):
        return _summarise_changes(options.folder)
    if not path.is_file():
        raise InputError(
            "no such file",
            where=path,
            expected="results of a processed campaign",
            cure=f"Run: snakemake --cores all --config campaign={options.folder.name}",
        )
    import pandas as pd

    from thalweg.accuracy import summary_lines

    print(f"\nSummary of campaign {options.folder.name}")
    print("\n".join(summary_lines(pd.read_csv(path))))
    files = [p for p in options.folder.rglob("*") if p.is_file() and "simulation" not in p.parts]
    kinds = {"pictures": {".png", ".pdf"}, "clouds": {".laz"}, "tables": {".csv", ".parquet"}}
    counts = (f"{sum(p.suffix in ends for p in files)} {kind}" for kind, ends in kinds.items())
    print(f"\n{', '.join(counts)} in {options.folder}. Worth opening first:")
    worth = [options.folder / name for name in WORTH_OPENING]
    print("\n".join(f"  {p}" for p in [p for p in worth if p.is_file()][:5]))
    return 0


def _summarise_changes(folder: Path) -> int:
    """Print what changed between the epochs of a campaign, and where its files are."""
    import pandas as pd

    from thalweg.core import read_json, read_parquet

    found = folder / "deformation"
    print(f"\nSummary of campaign {folder.name}")
    for path in sorted(found.glob("volumes_[0-9]*.csv")):
        pair = path.stem.removeprefix("volumes_")
        facts = read_json(found / f"registration_{pair}.json")
        print(f"\nEpochs {pair}")
        for row in pd.read_csv(path).itertuples():
            volume = f"{row.volume_m3:+9.2f} m3, sigma {row.sigma_m3:.2f} m3"
            print(f"  {row.what:<11}{volume}, on {row.area_m2:,.0f} m2")
        states = read_parquet(found / f"changes_{pair}.parquet")["state"].value_counts()
        print("  core points: " + ", ".join(f"{n:,} {state}" for state, n in states.items()))
        for note in read_json(found / f"changes_{pair}.json").get("notes", ()):
            print(f"  note: {note}")
        heights = pd.read_csv(found / f"dod_{pair}.csv").set_index("part").loc["net"]
        print(f"  net by heights {heights.volume_m3:+9.2f} m3, sigma {heights.sigma_m3:.2f} m3")
        if facts["model"] != "none":
            moved = ", ".join(f"{facts['parameters'][f'{a}_m']:+.3f}" for a in ("east", "north", "up"))
            print(
                f"  registration east, north, up: {moved} m, {'' if facts['needed'] else 'not '}significant"
            )
    for title, pattern in (("Pictures", "figures/*.png"), ("Tables and clouds", "deformation/*.[cpl]*")):
        print(f"\n{title}:")
        paths = [p for p in sorted(folder.glob(pattern)) if not p.name.endswith(".meta.json")]
        print("\n".join(f"  {p}" for p in paths) or "  none")
    print(f"\nPage:\n  {found / 'index.html'}")
    return 0
