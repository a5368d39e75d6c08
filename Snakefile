"""Thalweg: raw logs of a survey boat -> georeferenced riverbank and riverbed.

snakemake                              the campaign of config/config.yaml
snakemake --config campaign=tiny       another one; a list or a path works as well
snakemake lidar                        a part of it: ingest, lidar, images, accuracy, deformation, figures
snakemake -n --quiet host              what would run, with all files
snakemake reproduce                    every published number with a verdict: results/reproduction/ledger.html
"""

from snakemake.utils import min_version

min_version("9.20")

import gc
import sys
from pathlib import Path

# Snakemake and the libraries stay: the search for garbage leaves them out, which is a quarter of a start.
gc.freeze()
gc.set_threshold(10_000, 10, 10)
# Of this file, also where another Snakefile takes it as a module.
HERE = Path(workflow.current_basedir.get_path_or_uri(secret_free=False))
# Makes the library importable here, in `script:` jobs and in every cluster job, installed or not.
sys.path.insert(0, str(HERE / "src"))
# A folder of one's own has its own.
SETTINGS = Path("config") / "config.yaml"


configfile: SETTINGS if SETTINGS.is_file() else HERE / SETTINGS


report: "workflow/report/workflow.rst"


include: "workflow/rules/common.smk"
include: "workflow/rules/common_studies.smk"
include: "workflow/rules/simulation.smk"
include: "workflow/rules/simulation_field.smk"
include: "workflow/rules/simulation_light_sheet.smk"
include: "workflow/rules/simulation_sheet_scans.smk"
include: "workflow/rules/ingest.smk"
include: "workflow/rules/timing.smk"
include: "workflow/rules/calibration.smk"
include: "workflow/rules/orientation.smk"
include: "workflow/rules/without_boat.smk"
include: "workflow/rules/lidar.smk"
include: "workflow/rules/panorama.smk"
include: "workflow/rules/triangulation.smk"
include: "workflow/rules/triangulation_scans.smk"
include: "workflow/rules/triangulation_ledger.smk"
include: "workflow/rules/bathymetry.smk"
include: "workflow/rules/fusion.smk"
include: "workflow/rules/surface.smk"
include: "workflow/rules/accuracy.smk"
include: "workflow/rules/accuracy_truth.smk"
include: "workflow/rules/deformation.smk"
include: "workflow/rules/figures.smk"
include: "workflow/rules/figures_pages.smk"
include: "workflow/rules/reproduction.smk"
include: "workflow/rules/studies.smk"


for each in workflow.rules:
    if each.script and Path(each.snakefile).parent == HERE / "workflow" / "rules":
        complete(each)

# On a cluster the short jobs of a campaign that these files make of each other go to it as one.
GROUPS = {
    "simulation": "simulation",
    "ingest": "ingest",
    "bathymetry": "bathymetry",
    "fusion": "bathymetry",
    "accuracy": "accuracy",
    "accuracy_truth": "accuracy",
    "figures": "figures",
    "figures_pages": "figures",
}
if workflow.global_resources["_nodes"].value is not None:
    for each in workflow.rules:
        if each.name not in workflow.group_settings.overwrite_groups:  # --groups
            each.group = GROUPS.get(Path(each.snakefile).stem)


localrules:
    all,
    ingest,
    lidar,
    images,
    accuracy,
    deformation,
    figures,
    reproduce,


rule all:
    """Every table and picture of the chosen campaigns."""
    default_target: True
    input:
        [files.final_outputs() for files in BUILT],
        [FIGURES.files_to_keep(files) for files in BUILT],
        [laboratory.ledger_outputs(files) for files in BUILT],


rule ingest:
    """Logs of the chosen campaigns as tables, with a report of what is missing or broken."""
    input:
        part_of_campaigns("ingest"),


rule lidar:
    """Clouds of the chosen campaigns."""
    input:
        part_of_campaigns("lidar"),


rule images:
    """Oriented photographs of the bank, and the trajectories that rest on them."""
    input:
        part_of_campaigns("images"),


rule accuracy:
    """Comparisons with references and truth, with their pages."""
    input:
        part_of_campaigns("accuracy"),


rule deformation:
    """What changed between the epochs of the chosen campaigns."""
    input:
        part_of_campaigns("deformation"),


rule figures:
    """Every picture of the chosen campaigns."""
    input:
        [FIGURES.files_to_keep(files) for files in BUILT],


rule reproduce:
    """Published numbers recomputed; the verdicts appear on the terminal each time they are asked for."""
    input:
        text="results/reproduction/error_budgets.txt",
        ledger="results/reproduction/ledger.txt",
    log:
        "logs/reproduction/reproduce.log",
    conda:
        "envs/thalweg.yaml"
    shell:
        "cat {input.text} {input.ledger} | tee {log}"


DRIVERS = []  # of this folder: one, as long as it works


onstart:
    if workflow.is_main_process:
        if workflow.non_local_exec:
            refuse_shell(
                str(name)
                for job in workflow.dag.needrun_jobs()
                for name in job.input
            )
        DRIVERS.append(start_driver(Path.cwd()))
        for files in BUILT:
            for version, n in other_versions(
                map(Path, files.final_outputs())
            ).items():
                print(
                    f"{files.name}: {n} results are of Thalweg {version}. Those whose code has changed are made"
                    " again; in a copied folder, without its .snakemake, only by --forceall."
                )


onsuccess:
    for driver in DRIVERS:
        driver.close()


onerror:
    for driver in DRIVERS:
        driver.close()
    # of what was asked for, not of all that a campaign could have
    undone = [job.wildcards.get("campaign") for job in workflow.dag.needrun_jobs()]
    for name in CHOSEN if len(CHOSEN) > 1 else []:
        print(
            f"{name}: {f'{n} jobs not done' if (n := undone.count(name)) else 'done'}"
        )
    logs = [Path(each) for each in ([log] if isinstance(log, str) else log)]
    FAILURES.cures += cures_in(
        "\n".join(each.read_text(errors="replace") for each in logs)
    )
