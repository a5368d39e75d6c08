"""How studies are run: jobs of some seeds, and one that gathers their rows."""

import json
import re

import pandas as pd
import pytest
import yaml

from thalweg.core import InputError
from thalweg_lab.studies import Batch, batches, load, run_seeds, write_results
from thalweg_lab.studies.study import Study

SIZES = {"first_seed": 5, "seeds": 5, "first_seed_of_fit": 1, "sizes": {"ins": 2}, "factor": 3.0}


def squares(seed):
    assert not list(seed.folder.iterdir())  # each seed has a folder of its own
    (seed.folder / "log").write_text("x")
    value = seed.sizes["factor"] * seed.number**2
    return {seed.kind: pd.DataFrame({"seed": [seed.number], "value": [value], "why": [""]})}


def summed(tables, files):
    rows = tables["survey"]
    words = f"{rows['value'].sum():.0f} {len(files)}"
    return {"table": rows, "page": words, "facts": lambda path: path.write_text(json.dumps(len(rows)))}


STUDY = Study(rows=squares, results=summed)


def test_seeds_are_dealt_out_to_jobs():
    one = batches({"parameters": SIZES, "jobs": {}})
    assert list(one) == ["survey_5", "survey_6", "survey_7", "survey_8", "survey_9"]
    two = batches({"parameters": SIZES, "jobs": {"seeds_a_job": 2}})
    assert {name: batch.seeds for name, batch in two.items()} == {
        "survey_5_to_6": (5, 6),
        "survey_7_to_8": (7, 8),
        "survey_9": (9,),
    }
    kinds = {"fit": ["first_seed_of_fit", "sizes.ins"], "marks": [3, 1]}
    several = batches({"parameters": SIZES, "jobs": {"kinds": kinds}})
    assert [(name, batch.kind) for name, batch in several.items()] == [
        ("fit_1", "fit"),
        ("fit_2", "fit"),
        ("marks_3", "marks"),
    ]


@pytest.mark.parametrize("at_once", [1, 2, 5])
def test_results_do_not_depend_on_how_seeds_are_dealt_out(tmp_path, at_once):
    jobs = batches({"parameters": SIZES, "jobs": {"seeds_a_job": at_once}})
    for name, batch in jobs.items():
        run_seeds(STUDY, batch, SIZES, tmp_path / name)
    outputs = {name: tmp_path / name for name in ("table", "page", "facts")}
    write_results(STUDY, [tmp_path / name for name in jobs], [tmp_path], outputs)
    assert pd.read_csv(outputs["table"])["value"].tolist() == [75.0, 108.0, 147.0, 192.0, 243.0]
    assert outputs["page"].read_text() == "765 1"
    assert outputs["facts"].read_text() == "5"


def test_a_result_that_nobody_asked_for_is_named(tmp_path):
    run_seeds(STUDY, Batch(kind="survey", seeds=(1,)), SIZES, tmp_path / "a")
    with pytest.raises(InputError, match="page"):
        write_results(STUDY, [tmp_path / "a"], [], {"table": tmp_path / "t.csv"})


@pytest.mark.parametrize("place", ["nothing:STUDY", "study:NO", "study:load"])
def test_what_is_no_study_is_named(place):
    name = f"thalweg_lab.studies.{place}"
    with pytest.raises(InputError, match=re.escape(name)):
        load(name)


def test_every_study_of_the_repository_can_be_run(repository):
    found = 0
    for path in sorted((repository / "config/studies").glob("*_study.yaml")):
        entry = yaml.safe_load(path.read_text())
        assert isinstance(load(entry["study"]), Study)
        assert all(re.fullmatch("[a-z_]+_[0-9]+(_to_[0-9]+)?", name) for name in batches(entry)), path.stem
        assert {"memory_mb", "minutes"} <= set(entry["jobs"])
        files = {f"results/reproduction/{file}" for file in entry["outputs"].values()}
        assert {table["file"] for table in entry["tables"].values()} <= files
        assert all((repository / file).is_file() for file in entry.get("inputs", []))
        found += 1
    assert found == 17
