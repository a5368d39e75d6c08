"""Measure how long campaigns take and what they need: rows of docs/validation/timings.csv.

.venv/bin/python docs/make_timings.py tiny demo --cores 2

Each campaign runs in an empty folder, from simulated logs to the last picture, as a new user's first run does
with `.venv` ready. Memory is the largest that a job's benchmark file states; time of the processor that of
all jobs.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import pandas as pd

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "src"))

from thalweg.workflow.provenance import git_commit  # noqa: E402


def measured(campaign: str, cores: int, folder: Path) -> dict[str, Any]:
    """Run a campaign in a folder and say what it took.

    Raises
    ------
    subprocess.CalledProcessError : a job failed.
    """
    load = os.getloadavg()[0]
    start = time.perf_counter()
    command = [str(ROOT / ".venv/bin/snakemake"), "--cores", str(cores), "--config", f"campaign={campaign}"]
    subprocess.run([*command, "--directory", str(folder), "--snakefile", str(ROOT / "Snakefile")],
                   cwd=ROOT, check=True)  # fmt: skip
    wall_s = time.perf_counter() - start
    return {
        "campaign": campaign, "date": time.strftime("%Y-%m-%d", time.gmtime()),
        "commit": (git_commit(ROOT) or "unknown")[:7], "machine": machine(), "cores": cores,
        "load": round(load, 1), "wall_min": round(wall_s / 60, 2), **facts(campaign, folder),
    }  # fmt: skip


def facts(campaign: str, folder: Path) -> dict[str, Any]:
    """Shots, points, jobs, time of the processor, memory and size of the results of a run in a folder."""
    records = [json.loads(p.read_text(encoding="utf-8")) for p in folder.glob("results/**/*.meta.json")]
    jobs = {(r["rule"], r["written_utc"], r["wall_s"]): r["cpu_s"] for r in records}
    memory = [row["max_rss"] for p in folder.glob("benchmarks/**/*.jsonl")
              for row in map(json.loads, p.read_text(encoding="utf-8").splitlines())]  # fmt: skip
    used = [float(value) for value in memory if value not in ("NA", None, "-")]
    counts = folder / f"results/{campaign}/lidar/counts.csv"
    shots = pd.read_csv(counts).set_index("reason")["n"] if counts.exists() else pd.Series(dtype="int64")
    size = sum(p.stat().st_size for p in folder.glob("results/**/*") if p.is_file())
    return {
        "jobs": len(jobs), "cpu_min": round(sum(jobs.values()) / 60, 2),
        "most_memory_gb": round(max(used, default=0.0) / 1e3, 2), "results_gb": round(size / 1e9, 2),
        "shots": int(shots.sum()), "points": int(shots.get("kept", 0)),
    }  # fmt: skip


def machine() -> str:
    """Model and number of the processors, and the Python; no name of a host."""
    text = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    models = [line.split(":", 1)[1].strip() for line in text.splitlines() if line.startswith("model name")]
    name = models[0] if models else platform.processor() or platform.machine()
    return f"{os.cpu_count()} x {name}, Python {platform.python_version()}"


def with_row(table: Path, row: dict[str, Any]) -> pd.DataFrame:
    """The table with the campaign's row renewed or added."""
    old = pd.read_csv(table) if table.exists() else pd.DataFrame(columns=list(row))
    return pd.concat([old[old["campaign"] != row["campaign"]], pd.DataFrame([row])], ignore_index=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("campaigns", nargs="+", metavar="CAMPAIGN")
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    asked = parser.parse_args()
    table = ROOT / "docs/validation/timings.csv"
    for campaign in asked.campaigns:
        with tempfile.TemporaryDirectory(prefix="thalweg_timings_") as name:
            found = measured(campaign, asked.cores, Path(name))
        with_row(table, found).to_csv(table, index=False, lineterminator="\n")
        sys.stdout.write(json.dumps(found, indent=2) + "\n")
