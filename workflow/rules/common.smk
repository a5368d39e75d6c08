"""What all rules share: the validated campaigns, and thin adapters from wildcards to `thalweg.workflow`."""

import logging
import re
from functools import cache
from itertools import product

from snakemake.exceptions import WorkflowError
from snakemake.io import strip_wildcard_constraints
from snakemake.logging import DefaultFilter, get_event, logger as snakemake_logger
from snakemake_interface_logger_plugins.common import LogEvent

from thalweg.core import ROOT, did_you_mean
from thalweg.settings import load_campaigns, with_calibrations
from thalweg.workflow import (
    CampaignFiles,
    Measured,
    check_cluster,
    code_version,
    cures_in,
    fork_scripts,
    other_versions,
    pattern_of_epochs,
    as_format,
    read_figures,
    refuse_shell,
    start_driver,
    start_snakemake_once,
    tell_failures_last,
    use_scratch,
)
from thalweg_lab import campaign_files as laboratory


def hear_errors():
    """Errors are said whatever `--quiet` says; those of jobs by these themselves, where they run here."""
    said, of_jobs = DefaultFilter.filter, (LogEvent.JOB_ERROR, LogEvent.GROUP_ERROR)

    def filter(self, record):
        by_job = get_event(record) in of_jobs and not workflow.non_local_exec
        return (record.levelno >= logging.ERROR and not by_job) or said(self, record)

    DefaultFilter.filter = filter


def refuse_unknown_config(names):
    """`--config campain=x` would otherwise build the campaign of config.yaml in silence."""
    known = (
        "campaign",
        "limit",
        "captions",
    )  # captions: set below, and handed to the jobs
    for name in names:
        if name not in known:
            raise WorkflowError(
                f"--config {name}=...: there is no such option; expected campaign=... or limit=runtime. "
                + did_you_mean(name, known[:2])
            )


hear_errors()
refuse_unknown_config(config)
# Snakemake's words on a failure would be the last ones.
FAILURES = tell_failures_last(snakemake_logger) if workflow.is_main_process else None

if workflow.storage_settings.default_storage_provider == "fs":
    use_scratch(workflow.storage_settings.local_storage_prefix / "fs")

if workflow.is_main_process or workflow.remote_exec:
    fork_scripts(
        after=0 if workflow.is_main_process else 1,
        limited=config.get("limit") == "runtime",
    )

if workflow.is_main_process and workflow.non_local_exec and not workflow.dryrun:
    start_snakemake_once()
    given = workflow.resource_settings._parsed_default_resources
    check_cluster(
        given["slurm_partition"].value if "slurm_partition" in given else None,
        cpus=workflow.global_resources["_cores"].value,
    )


def log_length_s(files, options):
    """About how long a log of the lidar is, seconds."""
    # Here: reading a log takes libraries that no other start of Snakemake needs.
    from thalweg.ingest import LidarOptions
    from thalweg.ingest.registry import lidar_reader

    reader = lidar_reader([Path(name) for name in files], LidarOptions(**options))
    return reader.length_s()


# A folder of one's own, apart from the checkout, has its own campaigns.
NAMED = Path("config/campaigns").resolve()
NAMED = NAMED if NAMED.is_dir() else ROOT / "config" / "campaigns"
CHOSEN = load_campaigns(config["campaign"], NAMED)
CAMPAIGNS = with_calibrations(CHOSEN, NAMED)
FILES = {
    name: CampaignFiles(
        name=name,
        campaigns=CAMPAIGNS,
        twin_logs=laboratory.twin_logs,
        twin_images=laboratory.n_images,
        log_length_s=log_length_s,
        on_cluster=workflow.non_local_exec or workflow.remote_exec,
    )
    for name in CAMPAIGNS
}
# Of the surveys that a campaign of epochs names only what the comparison needs is built.
BUILT = [f for n, f in FILES.items() if n in CHOSEN or not f.is_epoch()]

MEASURED = Measured.read(ROOT / "config" / "resources.yaml")
# What jobs ask for: as measured, or else from the size of their inputs; twice as much on each attempt.
memory, minutes = MEASURED.memory_of_job, MEASURED.minutes_of_job

FIGURES = read_figures(ROOT / "workflow" / "figures.yaml")
# workflow/report/figure.rst finds the words for a picture here; as params they would draw it again when they change.
config["captions"] = {row.rule: row.caption for row in FIGURES.rows}

RESULTS = "results/{campaign}"

URGENT = 10
"""Priority of the longest chain of jobs: poses of images need the calibration, and all comparisons need them."""


wildcard_constraints:
    campaign="|".join(CAMPAIGNS),
    by="(by_(camera|fused|strips)/)?",
    part="[0-9]+",
    scan="|".join(sorted({s for f in FILES.values() for s in f.scan_names()})) or "none",


def of(method, *arguments):
    """Function for input and params: a method of `CampaignFiles`, asked of the campaign of the job."""
    return lambda wildcards: method(FILES[wildcards.campaign], *arguments)


def of_wildcard(name, method, *arguments):
    """The same for a method that takes another wildcard of the job first, such as `scan`."""
    return lambda wildcards: method(
        FILES[wildcards.campaign], wildcards[name], *arguments
    )


def section(*keys):
    """Function for params: a section of the campaign's settings, or a part of one, as plain values."""
    return of(CampaignFiles.section, *keys)


def without(name, *keys):
    """Function for params: a section without keys that the rule does not depend on."""
    return of(CampaignFiles.without, name, *keys)


def where(condition, *names):
    """Input function: results of the campaign where a method of `CampaignFiles` says yes."""
    return of(CampaignFiles.where, condition, *names)


def identity(*keys):
    """Function for params: only those keys of the section `campaign`, so that a new title reruns pictures alone."""
    return of(CampaignFiles.identity, *keys)


FRAME, CRS, SEED, RUN, TITLE = (
    section("campaign", key) for key in ("origin", "crs", "seed", "id", "title")
)
TWIN = of(CampaignFiles.is_twin)


# Of the jobs that are planned alone: all would be a seventh of a start of Snakemake.
VERSIONS = cache(code_version)


def version(script, called=None):
    """Function for params: version of the code that a job runs."""
    return lambda wildcards: VERSIONS(script, called)


def calls(function, script="call"):
    """Params where the script is call.py or page.py: ``module:function`` that does the work, and its version."""
    return {"code": version(script, function), "call": function}


def complete(each):
    """What all rules have alike, but where one says otherwise: environment, log, benchmark, version of its code."""
    first = strip_wildcard_constraints(each.output[0])
    owner = first.split("/")[1]
    # where a module of another workflow puts its results
    each.log_modifier = each.benchmark_modifier = each.output_modifier
    if not each.log:
        room = Path(each.snakefile).stem.split("_")[0]
        folder = f"{owner}/{room}" if owner == "{campaign}" else owner
        which = re.findall(r"{\w+}", first.removeprefix("results/{campaign}"))
        name = "_".join([each.name, *which])
        each.set_log(f"logs/{folder}/{name}.log")
    each.benchmark = (
        f"benchmarks{each.log[0].removeprefix('logs').removesuffix('log')}jsonl"
    )
    each.conda_env = "../../envs/thalweg.yaml"
    if "code" not in each.params.keys():
        each.set_params(code=version(Path(each.script).stem))


def raw(stream):
    """Input function: the raw files of one stream."""
    return of(CampaignFiles.logs, stream)


def part_of_campaigns(name):
    """Input function: what the target ``name`` builds, with a word of help where the logs give nothing of it."""

    def files(wildcards):
        names = [path for each in BUILT for path in each.target(name)]
        if not names:
            raise WorkflowError(
                f"The logs of {', '.join(CHOSEN)} give nothing of the part `{name}`. What they give, and what "
                "one more log would add, says: thalweg check-config."
            )
        return names

    return files


def reported(wildcards):
    """Input function: tables of the report, with a word of help where there is none to hand in."""
    files = FILES[wildcards.campaign]
    if not files.has_report():
        raise WorkflowError(
            f"{files.name}: no report.pdf of a campaign of the kind `{files.campaign.kind}`; there is one of a survey "
            f"by boat and of a change between epochs. Its page: results/{files.name}/index.html."
        )
    return files.report_tables()


def of_page(page):
    """Input function: the pictures of a page."""
    return lambda wildcards: FIGURES.files(FILES[wildcards.campaign], page)
