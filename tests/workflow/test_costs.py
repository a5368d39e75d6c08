"""What jobs took is told, and what they will ask for follows from it."""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from numpy.random import default_rng

from thalweg.cli import main
from thalweg.core import InputError
from thalweg.workflow import Measured, fitted, per_rule, predicted, read_costs
from thalweg.workflow.costs import BESIDE_MB, FLOOR_MB


def result(
    folder: Path,
    rule: str,
    number: int,
    *,
    memory_mb: float,
    asked_mb: float,
    input_mb: float = 10.0,
    wall_s: float = 6.0,
) -> None:
    """Provenance of a job with two outputs."""
    meta = {
        "rule": rule,
        "inputs": {f"in_{number}": "hash"},
        "threads": 1,
        "wall_s": wall_s,
        "cpu_s": 2 * wall_s,
        "written_utc": f"2026-11-25T19:00:{number:02}Z",
        "costs": {
            "memory_mb": memory_mb,
            "memory_with_libraries_mb": memory_mb + 200,
            "input_mb": input_mb,
            "output_mb": 1.0,
            "asked_mb": asked_mb,
            "asked_min": 10,
        },
    }
    (folder / rule).mkdir(parents=True, exist_ok=True)
    for name in ("a.csv", "b.csv"):
        (folder / rule / f"{number}_{name}.meta.json").write_text(json.dumps(meta))


def test_each_job_counts_once_and_each_rule_is_judged(tmp_path):
    for k in range(3):
        result(tmp_path / "tiny", "fits", k, memory_mb=900, asked_mb=2000)
        result(tmp_path / "tiny", "wastes", k, memory_mb=100, asked_mb=4000)
        result(tmp_path / "tiny", "small", k, memory_mb=0, asked_mb=FLOOR_MB)
        result(tmp_path / "other", "takes_long", k, memory_mb=900, asked_mb=2000, wall_s=700)
    rules = per_rule(read_costs(tmp_path)).set_index("rule")
    assert rules["jobs"].to_dict() == dict.fromkeys(("takes_long", "fits", "wastes", "small"), 3)
    assert rules.loc["fits", "cpu_s"] == 36.0
    assert rules.loc["fits", "memory_mb"] == 900 + 200 + BESIDE_MB
    assert rules["remark"].to_dict() == {
        "takes_long": "more time than asked for",
        "fits": "",
        "wastes": "less than a quarter of the memory asked for",
        "small": "",
    }


def test_a_job_whose_memory_doubled_is_told(tmp_path, capsys):
    result(tmp_path / "tiny", "georeference", 1, memory_mb=900, asked_mb=2000)
    assert main(["costs", str(tmp_path)]) == 0
    assert "georeference" not in capsys.readouterr().out
    result(tmp_path / "tiny", "georeference", 1, memory_mb=1800, asked_mb=2000)
    assert main(["costs", str(tmp_path)]) == 1
    assert "georeference: 2400 of 2000 MB: more memory than asked for" in capsys.readouterr().out
    table = pd.read_csv(tmp_path / "costs/costs.csv")
    assert table.loc[0, "used_memory"] == pytest.approx(1.2)


def test_what_is_written_is_what_rules_ask_for(tmp_path):
    for k, size in enumerate((10.0, 20.0, 40.0, 80.0)):
        result(
            tmp_path / "tiny", "grows", k, memory_mb=600 + 5 * size, asked_mb=9000, input_mb=size, wall_s=size
        )
    file = tmp_path / "resources.yaml"
    assert main(["costs", str(tmp_path), "--write", str(file)]) == 0
    measured = Measured.read(file)

    def of(megabytes):
        """Inputs of a size, in a file and in a folder, and one that is not made yet."""
        folder = tmp_path / "inputs" / str(megabytes)
        (folder / "images").mkdir(parents=True, exist_ok=True)
        for name in ("a", "images/b"):
            with (folder / name).open("wb") as stream:
                stream.truncate(int(megabytes * 5e5))
        return [str(folder / name) for name in ("a", "images", "not yet")]

    # 1200 MB and 5 MB for each of input, without scatter; twice as much on each attempt
    assert [measured.memory_mb("grows", of(size), 1, 1, 1) for size in (0, 10, 80)] == [1200, 1250, 1600]
    assert measured.memory_mb("grows", of(10), 3, 1, 1) == 4 * 1250
    # three times as long on a slow node, but never below the floor
    assert [measured.minutes("grows", of(size), 1, 1, 1) for size in (10, 150)] == [5, 8]
    # far beyond what was measured, and for other rules, what the rule states
    assert measured.memory_mb("grows", of(161), 1, 100, 2) == 422
    assert measured.memory_mb("other", of(10), 2, 1000, 2) == 2040
    assert measured.minutes("other", of(2000), 1, 10, 20) == 50
    # as a rule asks, by keywords
    job = {"wildcards": None, "input": of(10), "attempt": 2, "rulename": "other"}
    assert measured.memory_of_job(1000, 2)(**job) == 2040
    assert measured.minutes_of_job(10)(**job) == 20


def test_one_more_job_stays_below_its_request_as_often_as_promised():
    """Of 600 rules with 12 jobs each, the 13th: 95 % and a bit, as the largest job counts as well."""
    rng = default_rng(5)
    below, excess = [], []
    for _ in range(600):
        x = rng.uniform(10, 200, 13)
        y = 800 + 4 * x + 40 * rng.standard_normal(13)
        jobs = pd.DataFrame({"rule": "r", "input_mb": x, "memory_mb": y, "wall_s": 1.0})
        base, slope = fitted(jobs[:12])["r"]["memory_mb"]
        asked = base + slope * x[12]
        below.append(asked >= y[12])
        excess.append(asked / (800 + 4 * x[12]))
    share = float(np.mean(below))
    # four standard deviations of a share of 600 about 95 %, and the largest job adds up to 3 %
    assert 0.915 < share < 0.995
    assert np.median(excess) < 1.2


def test_a_rule_with_one_job_gets_half_as_much_again():
    jobs = pd.DataFrame({"rule": ["r"], "input_mb": [10.0], "memory_mb": [1000.0], "wall_s": [60.0]})
    assert fitted(jobs) == {"r": {"memory_mb": [1500.0, 0.0], "minutes": [4.5, 0.0], "input_mb": 10.0}}


@pytest.mark.parametrize("text", ["r: 5", "r: {memory_mb: [1], minutes: [1, 2], input_mb: 3}", "r: [", "- 1",
                                  "r: {memory_mb: [1, -1], minutes: [1, 2], input_mb: 3}"])  # fmt: skip
def test_a_damaged_file_is_named_with_its_cure(tmp_path, text):
    file = tmp_path / "resources.yaml"
    file.write_text(text)
    with pytest.raises(InputError, match=r"resources\.yaml: no measured resources .*--write"):
        Measured.read(file)


def test_results_without_costs_are_named(tmp_path, capsys):
    (tmp_path / "old.csv.meta.json").write_text('{"rule": "r"}')
    assert main(["costs", str(tmp_path)]) == 2
    assert "no job left its costs" in capsys.readouterr().err


def test_rules_in_the_file_exist(repository):
    """Requests of rules that were renamed would be forgotten in silence."""
    file = repository / "config/resources.yaml"
    if not file.exists():
        pytest.skip("nothing measured is shipped")
    text = "".join(path.read_text() for path in (repository / "workflow").rglob("*.smk"))
    figures = yaml.safe_load((repository / "workflow/figures.yaml").read_text())
    rules = {
        *re.findall(r"(?m)^(?:rule|use rule \w+ as) (\w+)", text),
        *re.findall(r'(?m)^    "(\w+)": \{', text),
    }
    rules |= {f"plot_{name}" for group in figures.values() for name in group}
    assert set(Measured.read(file).rules) <= rules


def test_a_larger_survey_follows_the_lines_that_were_measured():
    """By hand: 30 times 8 MB; a rule whose inputs never differed is proportional beyond the libraries."""
    grows = [
        ("grows", c, size, 2 + 0.5 * size, 700 + 3 * size, 1 + 0.1 * size)
        for c, size in zip("aab", (1, 8, 32), strict=True)
    ]
    pairs = [("pairs", c, size, 0.1 * size**1.5, 800, 2) for c, size in zip("ab", (4, 16), strict=True)]
    alike = [("alike", "a", 8, 4, 1000, 3), ("alike", "a", 8, 6, 600, 3), ("alike", "b", 8, 4, 900, 3)]
    drawn = [("plot_map", "a", 8, 1, 700, 5)]
    twin = [("simulate_lidar", "a", 1, 99, 9999, 9), ("compare_with_truth", "a", 1, 99, 9999, 9)]
    jobs = pd.DataFrame(
        [*grows, *pairs, *alike, *drawn, *twin],
        columns=["rule", "campaign", "input_mb", "cpu_s", "memory_mb", "output_mb"],
    )
    table = predicted(jobs.assign(threads=2), "a", 30.0).set_index("rule")
    assert list(table.index) == [
        "alike",
        "grows",
        "pairs",
        "plot_map",
    ]  # the most expensive first, none of the twin
    assert table.loc["grows", ["jobs", "cpu_s", "longest_s"]].tolist() == pytest.approx([2, 17 + 122, 61])
    assert table.loc["grows", ["memory_mb", "output_mb"]].tolist() == pytest.approx([700 + 3 * 240, 4 + 25])
    assert table.loc["pairs", ["cpu_s", "memory_mb", "output_mb"]].tolist() == pytest.approx(
        [0.1 * 120**1.5, 800, 2]
    )
    assert table.loc["alike", ["jobs", "cpu_s", "longest_s"]].tolist() == [2, 30 * 10, 90]
    assert table.loc["alike", "memory_mb"] == FLOOR_MB + 30 * 300  # the smaller job stays below the floor
    assert table.loc["alike", ["output_mb", "least_cpu_s", "least_memory_mb"]].tolist() == [180, 10, 1000]
    assert table.loc["grows", "least_cpu_s"] == table.loc["grows", "cpu_s"]
    assert table.loc["plot_map", ["cpu_s", "output_mb"]].tolist() == [30, 5]
    assert table["measured_growth"].tolist() == [False, True, True, False]
    with pytest.raises(InputError, match="expected one of a, b"):
        predicted(jobs, "c", 2.0)


def test_what_a_larger_survey_takes_is_told(tmp_path, capsys):
    result(tmp_path / "small", "reads", 0, memory_mb=100, asked_mb=2000)
    result(tmp_path / "river", "reads", 1, memory_mb=100, asked_mb=2000, input_mb=15, wall_s=360)
    assert main(["costs", str(tmp_path), "--predict", "10"]) == 0
    told = capsys.readouterr().out
    assert "10 times the logs of river: 0.20 to 2.00 h of one processor" in told
    assert "memory of a job up to 0.7 to 0.7 GB, longest job reads 2.00 h, 0.0 GB of results" in told
    assert "1 of 1 rules were measured at one size" in told
    assert pd.read_csv(tmp_path / "costs/predicted.csv")["cpu_s"].tolist() == [7_200]
    assert main(["costs", str(tmp_path), "--predict", "2", "--of", "small"]) == 0
    assert "2 times the logs of small" in capsys.readouterr().out
