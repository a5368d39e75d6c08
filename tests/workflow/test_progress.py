"""What `make demo` prints while it runs."""

import importlib.util
import logging
from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="module")
def progress(repository: Path) -> ModuleType:
    path = repository / "workflow/progress/snakemake_logger_plugin_thalweg/__init__.py"
    spec = importlib.util.spec_from_file_location("progress_of_workflow", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def record(level: int, message: str, **more: object) -> logging.LogRecord:
    made = logging.LogRecord("snakemake", level, "", 0, message, None, None)
    made.__dict__.update(more)
    return made


def test_every_rule_has_words(progress: ModuleType, repository: Path) -> None:
    words = progress.words_of_rules()
    text = "\n".join(path.read_text() for path in (repository / "workflow/rules").glob("*.smk"))
    assert len(words) > 80
    assert {name for name in words if f"rule {name}:" not in text} == set()
    assert all(5 < len(line) < 200 and "\n" not in line for line in words.values())


def test_a_line_says_time_count_campaign_and_work(progress: ModuleType, capsys, monkeypatch) -> None:
    now = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    handler = progress.LogHandler(None, None)
    job = {"event": "job_info", "jobid": 4, "rule_name": "simulate_view", "output": ["results/a/view.png"]}
    handler.emit(record(logging.INFO, "", event="run_info", stats={"total": 12, "simulate_view": 1}))
    handler.emit(record(logging.INFO, "", **job, wildcards={"campaign": "tiny"}))
    now[0] += 65.0
    handler.emit(record(logging.INFO, "", event="progress", done=3, total=12))
    handler.emit(record(logging.INFO, "", event="job_finished", job_id=4))
    handler.emit(record(logging.INFO, "Select jobs to execute..."))
    handler.emit(record(logging.INFO, "Nothing to be done (all is there)."))
    handler.emit(record(logging.ERROR, "Error in rule x"))
    words = "tiny: Two pictures of the bank as a camera on the boat would see it"
    assert capsys.readouterr().err.splitlines() == [
        f"  0:00   0 of 12  {words}",
        f"  1:05   3 of 12  {words}: done in 65 s",
        "  1:05   3 of 12  the first picture: results/a/view.png",
        "Nothing to be done (all is there).",
        "Error in rule x",
    ]
