"""A run that fails ends with cause and cure, whatever Snakemake says before."""

import logging
import re
from pathlib import Path

import numpy as np
import pytest

from thalweg.workflow.failures import Failures, cause_in

CAMPAIGN = """
campaign: {id: two, title: Two planes, crs: local}
logs: {cloud: [a.xyz], reference: [b.xyz]}
reference: {sigma_m: 0.002, cell_m: 0.5, longest_edge_m: 5.0, isolated_radius_m: 5.0}
"""


@pytest.mark.workflow
def test_cause_and_cure_are_the_last_lines_in_every_mode(repository, tmp_path, house_builder) -> None:
    """Of a campaign whose reference is one point, a thousand times."""
    house = house_builder(repository, tmp_path)
    folder = house.root / "config/campaigns"
    (folder / "two.yaml").write_text(CAMPAIGN)
    np.savetxt(folder / "a.xyz", np.random.default_rng(1).uniform(0, 5, (1000, 3)))
    np.savetxt(folder / "b.xyz", np.ones((1000, 3)))
    for mode in ((), ("--quiet", "all"), ("--cores", "1", "--keep-going", "--verbose")):
        run = house.snakemake(
            "results/two/accuracy/cloud.json", "--config", "campaign=two", *mode, check=False
        )
        assert run.returncode == 1
        last = run.stderr.strip().split("\n")[-3:]
        assert last[0] == "1 job failed:"
        log = "logs/two/accuracy/compare_cloud.log"
        output = "results/two/accuracy/cloud_to_surface.parquet"
        assert last[1] == f"compare_cloud for {output} (traceback: {log})"
        assert re.fullmatch(
            r"  InputError: a reference of 1 usable points: .*; expected at least 3 points .*\. Look at .*\.",
            last[2],
        )
        assert "Traceback" in (house.root / log).read_text()


def heard(**of: object) -> logging.LogRecord:
    record = logging.LogRecord("snakemake", logging.ERROR, "", 0, "", None, None)
    record.__dict__.update(of)
    return record


def failed(job: int, log: Path) -> logging.LogRecord:
    return heard(event="job_error", jobid=job, rule_name=f"rule_{job}", output=[f"{job}.csv"], log=[str(log)])


def test_jobs_that_do_better_in_another_attempt_are_not_told(tmp_path: Path) -> None:
    failures, log = Failures(), tmp_path / "a.log"
    log.write_text("Traceback (most recent call last):\n  File x\n    y\nValueError: 17\nand more\n")
    for job in range(8):
        assert failures.hear(failed(job, log if job else tmp_path / "absent.log"))
    failures.hear(heard(event="job_finished", job_id=1))
    failures.cures.append("Ask the operators.")
    lines = list(failures.lines())
    assert lines[0] == "7 jobs failed:"
    assert lines[1:3] == ["rule_0 for 0.csv", "  Its own words stand above."]
    assert lines[3:5] == [f"rule_2 for 2.csv (traceback: {log})", "  ValueError: 17\nand more"]
    assert lines[-2:] == ["and 2 more; their words stand above", "Ask the operators."]
    assert list(Failures().lines()) == []


def test_the_cause_is_the_last_error_of_a_log_without_what_is_not_for_people() -> None:
    log = (
        "INFO thalweg: begins\nTraceback (most recent call last):\n  File a\n    b\n    ^\nKeyError: 'x'\n\n"
        "During handling of the above exception, another exception occurred:\n\n"
        "Traceback (most recent call last):\n  File c\n"
        "thalweg.core.errors.ConfigError: out/.part-0a1b/x.csv: 2 mistakes\n  line 3\n  line 4.\n"
    )
    assert cause_in(log) == "ConfigError: out/x.csv: 2 mistakes\n  line 3\n  line 4."
    ended = "The job of rule scan was ended by SIGKILL of the system; expected its own end."
    assert cause_in(f"INFO begins\n{ended}\n") == ended
    assert cause_in("INFO begins\n") == ""
