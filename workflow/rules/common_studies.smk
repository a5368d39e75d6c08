"""Studies of the twin: sizes, jobs and outputs stand once, in config/studies, also for documents."""

from thalweg_lab.studies import batches, read_studies

STUDIES = read_studies(ROOT / "config" / "studies")
BATCHES = {name: batches(entry) for name, entry in STUDIES.items()}


wildcard_constraints:
    study="|".join(STUDIES),
    batch="[a-z_]+_[0-9]+(_to_[0-9]+)?",


def of_study(key):
    """Resource function: what a study's file says of its jobs, more on each attempt."""
    return lambda wildcards, attempt: STUDIES[wildcards.study]["jobs"][key] * attempt


def study_version(script, name=None):
    """Function for params: version of the code of a script and of the study which it loads by name."""
    return lambda wildcards: VERSIONS(script, STUDIES[name or wildcards.study]["study"])
