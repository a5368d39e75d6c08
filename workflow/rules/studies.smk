"""Studies of the twin over many seeds: some seeds a job, and a job that gathers them; see config/studies."""


rule rows_of_study:
    """Some seeds of a study: rows of what was found."""
    output:
        rows=directory("results/reproduction/{study}/{batch}"),
    log:
        "logs/reproduction/{study}/{batch}.log",
    resources:
        mem_mb=of_study("memory_mb"),
        runtime=of_study("minutes"),
    params:
        code=study_version("rows_of_study"),
        study=lambda wildcards: STUDIES[wildcards.study]["study"],
        sizes=lambda wildcards: STUDIES[wildcards.study]["parameters"],
        kind=lambda wildcards: BATCHES[wildcards.study][wildcards.batch].kind,
        seeds=lambda wildcards: list(BATCHES[wildcards.study][wildcards.batch].seeds),
    script:
        "../scripts/rows_of_study.py"


for name, entry in STUDIES.items():

    rule:
        name:
            name
        input:
            rows=expand(
                "results/reproduction/{study}/{batch}", study=name, batch=BATCHES[name]
            ),
            files=[ROOT / file for file in entry.get("inputs", [])],
        output:
            results=[
                f"results/reproduction/{file}" for file in entry["outputs"].values()
            ],
        log:
            f"logs/reproduction/{name}.log",
        resources:
            mem_mb=memory(entry["jobs"].get("gathering_mb", 2000)),
            runtime=minutes(10),
        params:
            **entry["parameters"],
            code=study_version("results_of_study", name),
            study=entry["study"],
            names=list(entry["outputs"]),
        script:
            "../scripts/results_of_study.py"
