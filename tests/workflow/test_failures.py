"""A run that fails ends with cause and cure, whatever Snakemake says before; end results are verified."""

import json
import logging
import os
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from thalweg.cli import main
from thalweg.workflow import verify
from thalweg.workflow.failures import Failures, cause_in
from thalweg.workflow.provenance import TEMPORARY

CAMPAIGN = """
campaign: {id: two, title: Two planes, crs: local}
logs: {cloud: [a.xyz], reference: [b.xyz]}
reference: {sigma_m: 0.002, cell_m: 0.5, longest_edge_m: 5.0, isolated_radius_m: 5.0}
"""


@pytest.fixture(scope="module")
def house(repository, tmp_path_factory, house_builder):
    """Where a campaign of two small clouds is run."""
    return house_builder(repository, tmp_path_factory.mktemp("two"))


@pytest.mark.workflow
def test_cause_and_cure_are_the_last_lines_in_every_mode(house):
    """Of a campaign whose reference is one point, a thousand times; between these two lies the usual mode."""
    folder = house.root / "config/campaigns"
    (folder / "two.yaml").write_text(CAMPAIGN)
    np.savetxt(folder / "a.xyz", np.random.default_rng(1).uniform(0, 5, (1000, 3)))
    np.savetxt(folder / "b.xyz", np.ones((1000, 3)))
    for mode in (("--quiet", "all"), ("--cores", "1", "--keep-going", "--verbose")):
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


@pytest.mark.workflow
def test_end_results_that_were_cut_are_found_and_made_again(house, monkeypatch, capsys):
    """Their time is the old one: Snakemake has nothing to do, and no job reads a page."""
    monkeypatch.chdir(house.root)
    folder = house.root / "config/campaigns"
    (folder / "two.yaml").write_text(CAMPAIGN)
    places = np.mgrid[0:8:0.2, 0:8:0.2].reshape(2, -1)
    for name, height in (("a", 1.0), ("b", 0.0)):
        np.savetxt(folder / f"{name}.xyz", np.vstack([places, height + 0.001 * np.sin(places.sum(0))]).T)
    house.snakemake("--quiet", "all", "--config", "campaign=two")
    assert main(["verify"]) == 0
    assert ", 0 are not" in capsys.readouterr().out
    cut = ["results/two/accuracy/cloud_to_surface.laz", "results/two/index.html"]
    for path in map(Path, cut):
        before = path.stat()
        path.write_bytes(path.read_bytes()[: before.st_size // 2])
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    again = house.snakemake("--config", "campaign=two")
    assert "Nothing to be done" in again.stderr
    assert main(["verify", "results"]) == 1
    *wrong, counts, _, command = capsys.readouterr().out.splitlines()
    for line, name, rule in zip(wrong, cut, ("compare_cloud", "front_page"), strict=True):
        assert line.startswith(f"{name} is not what {rule} wrote on 20")
    assert counts.endswith(", 2 are not")
    words = shlex.split(command)
    assert words == ["snakemake", "--cores", "all", "--config", "campaign=two", "--force", *cut]
    house.snakemake(*words[3:])
    assert main(["verify"]) == 0


def test_what_is_missing_damaged_or_without_a_record_is_told(repository, tmp_path):
    text = "\n".join(path.read_text() for path in (repository / "workflow/rules").glob("*.smk"))
    with_temp = [rule for rule in re.split(r"(?m)^(?:use )?rule ", text)[1:] if re.search(r"\btemp\(", rule)]
    assert {re.match(r"(?:\w+ as )?(\w+)", rule)[1] for rule in with_temp} == TEMPORARY
    for name, rule in (("a b.csv", "map_images"), ("features.npz", "extract_features"), ("c.csv", None)):
        record = {"output": f"results/study/{name}", "rule": rule, "sha256": "0", "written_utc": "2026"}
        (tmp_path / f"{name}.meta.json").write_text(json.dumps(record) if rule else "{")
    for name in ("c.csv", "notes.txt", ".hidden"):
        (tmp_path / name).write_text("1")
    found = verify(tmp_path)
    assert found.wrong == {
        "results/study/a b.csv": "is missing; map_images wrote it on 2026",
        str(tmp_path / "c.csv"): "has a record that is damaged (c.csv.meta.json)",
    }
    assert found.unrecorded == [tmp_path / "notes.txt"]
    assert found.commands()[0] == "snakemake --cores all --force 'results/study/a b.csv'"


def heard(**of: object) -> logging.LogRecord:
    record = logging.LogRecord("snakemake", logging.ERROR, "", 0, "", None, None)
    record.__dict__.update(of)
    return record


def failed(job: int, log: Path) -> logging.LogRecord:
    return heard(event="job_error", jobid=job, rule_name=f"rule_{job}", output=[f"{job}.csv"], log=[str(log)])


def test_jobs_that_do_better_in_another_attempt_are_not_told(tmp_path):
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


def test_the_cause_is_the_last_error_of_a_log_without_what_is_not_for_people():
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
