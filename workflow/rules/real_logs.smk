"""A first look at recordings of other people: the readers on bytes that no twin wrote."""

import os

import yaml
from snakemake.exceptions import WorkflowError

with open(ROOT / "resources" / "real_recordings.yaml") as stream:
    RECORDINGS = {entry["id"]: entry for entry in yaml.safe_load(stream)}
REAL_DATA = Path(os.environ.get("THALWEG_DATA", ROOT.parent / "shared" / "data"))


wildcard_constraints:
    recording="|".join(RECORDINGS),


def recording_files(key):
    """Input function: files of one real recording, with a word of help where the folder is absent."""

    def files(wildcards):
        names = RECORDINGS[wildcards.recording].get(key, [])
        if names and not REAL_DATA.is_dir():
            raise WorkflowError(
                f"The real recordings are not at {REAL_DATA}. Set THALWEG_DATA to their folder."
            )
        return [str(REAL_DATA / name) for name in names]

    return files


rule look_at_recording:
    """Integrity and first picture of one recording."""
    input:
        files=recording_files("files"),
        base=recording_files("base"),
        nav=recording_files("nav"),
    output:
        integrity="results/real_logs/{recording}.integrity.json",
        pictures=directory("results/real_logs/{recording}"),
    log:
        "logs/real_logs/look_at_recording_{recording}.log",
    benchmark:
        "benchmarks/real_logs/look_at_recording_{recording}.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(2000),
        runtime=minutes(10),
    params:
        code=code_version("look_at_recording"),
        reader=lambda wildcards: RECORDINGS[wildcards.recording].get("reader", "auto"),
        title=lambda wildcards: RECORDINGS[wildcards.recording]["title"],
        options=lambda wildcards: RECORDINGS[wildcards.recording].get("options", {}),
    script:
        "../scripts/look_at_recording.py"


rule real_logs_page:
    """All recordings on one self-contained page."""
    input:
        integrity=expand(
            "results/real_logs/{recording}.integrity.json", recording=RECORDINGS
        ),
        pictures=expand("results/real_logs/{recording}", recording=RECORDINGS),
    output:
        page="results/real_logs/index.html",
        table="results/real_logs/recordings.csv",
    log:
        "logs/real_logs/real_logs_page.log",
    benchmark:
        "benchmarks/real_logs/real_logs_page.jsonl"
    conda:
        "../../envs/thalweg.yaml"
    threads: 1
    resources:
        mem_mb=memory(1000),
        runtime=minutes(5),
    params:
        code=code_version("real_logs_page"),
        titles=[recording["title"] for recording in RECORDINGS.values()],
    script:
        "../scripts/real_logs_page.py"
