"""What `make demo` prints while it runs."""

import importlib.util
import json
import logging
import os
import re
import subprocess
import sys
from types import SimpleNamespace

import pytest


@pytest.fixture(scope="module")
def progress(repository):
    path = repository / "workflow/progress/snakemake_logger_plugin_thalweg/__init__.py"
    spec = importlib.util.spec_from_file_location("progress_of_workflow", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def record(level: int, message: str, **more: object) -> logging.LogRecord:
    made = logging.LogRecord("snakemake", level, "", 0, message, None, None)
    made.__dict__.update(more)
    return made


def test_every_rule_has_words(progress, repository):
    words = progress.words_of_rules()
    text = "\n".join(path.read_text() for path in (repository / "workflow/rules").glob("*.smk"))
    assert len(words) > 80
    tables = text + (repository / "workflow/figures.yaml").read_text()
    rows = {name.removeprefix("plot_") for name in words if f"rule {name}:" not in text}
    assert {name for name in rows if not re.search(rf'(?m)^ +"?{name}"?:', tables)} == set()
    # they once were "plot rig field" and "accuracy page"
    assert words["plot_rig_field"] == "The field of a rig in both of its lenses (P1 Fig. 2b)"
    assert words["accuracy_page"].startswith("Everything that was found out about the accuracy")
    assert words["compare_with_truth"].startswith("Error of each point")
    assert all(5 < len(line) < 200 and "\n" not in line for line in words.values())


def test_a_line_says_time_count_campaign_and_work(progress, capsys, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    handler = progress.LogHandler(None, None)
    job = {"event": "job_info", "jobid": 4, "rule_name": "simulate_uav", "output": ["results/a/view.png"]}
    handler.emit(record(logging.INFO, "", event="run_info", stats={"total": 12, "simulate_uav": 1}))
    handler.emit(record(logging.INFO, "", **job, wildcards={"campaign": "tiny"}))
    now[0] += 65.0
    handler.emit(record(logging.INFO, "", event="progress", done=3, total=12))
    handler.emit(record(logging.INFO, "", event="job_finished", job_id=4))
    pdf = {"event": "job_info", "jobid": 5, "rule_name": "plot_survey_map_pdf"}
    handler.emit(record(logging.INFO, "", **pdf, wildcards={"campaign": "tiny"}))
    handler.emit(record(logging.INFO, "Select jobs to execute..."))
    handler.emit(record(logging.INFO, "Nothing to be done (all is there)."))
    handler.emit(record(logging.ERROR, "Error in rule x"))
    words = "tiny: Cloud of the surroundings by a drone"
    assert capsys.readouterr().err.splitlines() == [
        f"  0:00   0 of 12  {words}",
        f"  1:05   3 of 12  {words}: done in 65 s",
        "  1:05   3 of 12  the first picture: results/a/view.png",
        "  1:05   3 of 12  tiny: Plan view of the survey (P1 Fig. 3)",
        "Nothing to be done (all is there).",
        "Error in rule x",
    ]


def test_the_end_is_foretold_from_the_times_of_earlier_jobs(progress, tmp_path, monkeypatch, capsys):
    """Ten jobs of 1 s and one of 90 s: after the ten a tenth of the work is done, not ten elevenths."""
    monkeypatch.chdir(tmp_path)
    for rule, seconds in (("short", 1.0), ("long", 90.0)):
        (tmp_path / "benchmarks/a").mkdir(parents=True, exist_ok=True)
        (tmp_path / f"benchmarks/a/{rule}.jsonl").write_text(json.dumps({"s": seconds}) + "\n")
    now, lines = [100.0], tmp_path / "progress.jsonl"
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    settings = progress.LogHandlerSettings(json=lines)
    handler = progress.LogHandler(SimpleNamespace(quiet={"all"}), settings)
    handler.emit(record(logging.INFO, "", event="run_info", stats={"total": 11, "short": 10, "long": 1}))
    for job in range(10):
        job_info = {"event": "job_info", "jobid": job, "rule_name": "short"}
        handler.emit(record(logging.INFO, "", **job_info, wildcards={"campaign": "a"}))
        now[0] += 2.0
        handler.emit(record(logging.INFO, "", event="job_finished", job_id=job))
        handler.emit(record(logging.INFO, "", event="progress", done=job + 1, total=11))
    handler.emit(record(logging.ERROR, "Error in rule long"))
    told = [json.loads(line) for line in lines.read_text().splitlines()]
    assert [each["event"] for each in told[:4]] == ["begins", "job begins", "job ends", "progress"]
    assert told[1]["rule"] == "short"
    assert told[1]["wildcards"] == {"campaign": "a"}
    assert [each["left_s"] for each in told if each["event"] == "progress"][:5] == [
        *[None] * 4,
        190,
    ]  # 10 s for 5 of 100
    assert told[-1] == told[-1] | {"event": "message", "done": 10, "total": 11, "left_s": 180}
    written = capsys.readouterr().err
    assert "9 of 11, 4 min left  a: short" in written
    line, error = written.split("\n", 1)
    assert error == "Error in rule long\n"
    assert {len(part) for part in line.split("\r")[1:]} == {progress.WIDTH}


def test_snakemake_takes_it_with_its_options(repository, tmp_path):
    (tmp_path / "Snakefile").write_text('rule a:\n    output: "a.txt"\n    run: open("a.txt", "w").close()\n')
    command = [sys.executable, "-m", "snakemake", "--cores", "1", "--logger", "thalweg", "--quiet", "all"]
    run = subprocess.run(
        [*command, "--logger-thalweg-json", "lines.jsonl"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(repository / "workflow/progress")},
        capture_output=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    told = [json.loads(line) for line in (tmp_path / "lines.jsonl").read_text().splitlines()]
    assert [each["event"] for each in told] == ["begins", "job begins", "job ends", "progress"]
    assert (told[-1]["done"], told[-1]["total"]) == (1, 1)
    assert run.stderr.startswith(b"\r  0:00  0 of 1  a")
    assert run.stderr.count(b"\n") == 1
