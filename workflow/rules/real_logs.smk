"""A first look at recordings of other people: the readers on bytes that no twin wrote."""


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
