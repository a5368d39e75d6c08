"""Times of images by ties and by a trigger, and the script that writes them."""

import importlib.util
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from thalweg.clocks import ClockModel, read_run_image_times, triggered_images
from thalweg.clocks.ties import (
    RUN_IMAGE_TIMES,
    image_times_words,
    read_number_columns,
    read_text_columns,
    tied_images,
)
from thalweg.core import ClockError, InputError, frame_of, read_table, write_table
from thalweg.ingest.photos import IMAGE_STAMPS

ROOT = Path(__file__).parents[2]
T0 = 3.0e8
OFFSET_S = 712.25


def stamps_of(t_device_s):
    n = len(t_device_s)
    same = {"source": "name", "resolution_s": 1e-3, "width": 10, "height": 10, "make": "", "model": ""}
    rows = {name: [value] * n for name, value in (same | {"focal_mm": np.nan}).items()}
    files = [f"R{i:02d}.jpg" for i in range(n)]
    return frame_of(IMAGE_STAMPS, rows | {"file": files, "t_device_s": t_device_s})


def pulses():
    step = np.ones(40)
    step[[11, 26]] = (3.4, 2.7)
    return T0 + np.cumsum(step)


def run():
    """40 images, stamps with 20 ms jitter: pulse 5 made none, image 20 is by hand, the last has no stamp."""
    pulse, jitter = np.delete(pulses(), 5), 0.02 * np.random.default_rng(4).standard_normal(39)
    t = np.insert(pulse - OFFSET_S + jitter, 20, pulse[19] + 0.5 - OFFSET_S)
    t[-1] = np.nan
    return stamps_of(t), np.insert(pulse, 20, np.nan)


def test_an_image_takes_the_time_of_its_pulse():
    stamps, truth = run()
    clock, table, facts = triggered_images(stamps, pulses(), delay_s=0.003, jitter_s=2e-4)
    matched = table["matched"].to_numpy()
    assert np.flatnonzero(~matched).tolist() == [20, 39]
    # exactly, not to the 20 ms of the stamps
    assert np.array_equal(table["t_gps_s"][matched], truth[matched] + 0.003)
    assert (table["sigma_s"][matched] == 2e-4).all()
    # the one by hand: by the camera's own clock, with its jitter
    assert table["t_gps_s"][20] == pytest.approx(truth[19] + 0.503, abs=0.02)
    assert table["sigma_s"][20] == pytest.approx(0.02, rel=0.5)
    assert "no pulse" in table["reason"][20]
    assert table["reason"][39] == "no stamp"
    assert np.isnan(table["t_gps_s"][39])
    assert facts["images_without_pulse"] == ["R20.jpg", "R39.jpg"]
    assert facts["pulses_without_image_s"] == [pulses()[5], pulses()[-1]]
    assert (clock.offset_s, clock.jitter_s) == (0.003, 2e-4)
    assert (clock.t_first_s, clock.t_last_s) == (pulses()[0], pulses()[-1])
    assert any("R20.jpg, R39.jpg" in note for note in clock.notes)


def test_a_trigger_without_stated_jitter_has_none_and_says_so():
    stamps, _ = run()
    clock, table, _ = triggered_images(stamps, pulses())
    assert clock.jitter_s == 0.0
    assert (table["sigma_s"][table["matched"]] == 0.0).all()
    assert any("not stated" in note for note in clock.notes)


def test_images_that_share_a_stamp_find_no_pulse():
    stamps, _ = run()
    stamps.loc[8, "t_device_s"] = stamps.loc[7, "t_device_s"]
    table = triggered_images(stamps, pulses())[1]
    assert not table["matched"][[7, 8]].any()
    assert (table["reason"][[7, 8]] == "another image has the same stamp").all()


def test_the_report_of_times_says_how_many_images_have_them_and_how_good_they_are(tmp_path):
    stamps, _ = run()
    _, table, _ = triggered_images(stamps, pulses(), jitter_s=2e-4)
    write_table(tmp_path / "times.parquet", table, RUN_IMAGE_TIMES)
    words = image_times_words(read_run_image_times(tmp_path / "times.parquet"))
    assert words.startswith(
        "Times of 40 images: 38 by their pulse (sigma up to 0.20 ms), 1 by the camera's own"
    )
    assert words.endswith("1 without a time.")
    clock = ClockModel(offset_s=OFFSET_S, reference_s=T0, cov=np.zeros((2, 2)), jitter_s=0.0163)
    assert "39 by the camera's own clock (sigma up to 16.30 ms)" in image_times_words(
        tied_images(stamps, clock)
    )
    with pytest.raises(InputError):
        read_run_image_times(tmp_path / "nothing.parquet")


# ---------------------------------------------------------------- the script


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location(
        "clock_from_ties_script", ROOT / "workflow/scripts/clock_from_ties.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def job(tmp_path):
    """Keywords of the script, for a run with ties."""
    write_table(tmp_path / "stamps.parquet", run()[0], IMAGE_STAMPS)
    tie = T0 - OFFSET_S
    (tmp_path / "ties.csv").write_text(
        f"t_device_s,t_gps_s,sigma_s\n{tie},{T0},0.005\n{tie + 60},{T0 + 60},0.005\n"
    )
    pd.DataFrame({"t_gps_s": pulses()}).to_csv(tmp_path / "pulses.csv", index=False)
    (tmp_path / "stability.json").write_text('{"image_error_s": 0.0163}')
    return {
        "ties": [tmp_path / "ties.csv"],
        "pulses": [],
        "stability": None,
        "stamps": tmp_path / "stamps.parquet",
        "clock": tmp_path / "clock.yaml",
        "images": tmp_path / "images.parquet",
        "options": {"jitter_s": None, "delay_s": 0.0},
    }


def test_ties_do_not_tell_the_jitter(script, job):
    with pytest.raises(ClockError, match=r"jitter of the camera's stamps is not known.*") as caught:
        script.main(**job)
    assert "calibration.clock.jitter_s" in str(caught.value)
    assert not job["clock"].exists()


@pytest.mark.parametrize(("stated", "jitter_s", "words"), [(None, 0.0163, "display"), (0.03, 0.03, "stated")])
def test_ties_take_the_jitter_from_elsewhere(script, job, stated, jitter_s, words):
    job["stability"] = job["clock"].parent / "stability.json"
    job["options"]["jitter_s"] = stated
    script.main(**job)
    clock = ClockModel.read(job["clock"])
    assert clock.jitter_s == jitter_s
    assert any("Jitter" in note and words in note for note in clock.notes)
    table = read_table(job["images"], RUN_IMAGE_TIMES)[0]
    assert not table["matched"].any()
    assert (table["sigma_s"].dropna() > jitter_s).all()
    assert table["t_gps_s"].isna().sum() == 1


def test_pulses_make_the_times_of_images(script, job):
    job |= {"pulses": [job["clock"].parent / "pulses.csv"], "ties": []}
    script.main(**job)
    table, meta = read_table(job["images"], RUN_IMAGE_TIMES)[:2]
    assert table["matched"].sum() == 38
    assert set(table["t_gps_s"][table["matched"]]) <= set(pulses())
    assert meta["images_without_pulse"] == ["R20.jpg", "R39.jpg"]
    assert ClockModel.read(job["clock"]).source.startswith("hardware trigger")


def test_one_table_only(script, job):
    job["ties"] = job["ties"] * 2
    with pytest.raises(InputError, match="2 tables of ties and 0 of pulses"):
        script.main(**job)


def test_tables_of_people_are_read_as_they_write_them(tmp_path):
    """Blanks around cells and before quotes, names with commas, and what pandas takes for a missing value."""
    path = tmp_path / "ties.csv"
    path.write_text('file , t_s, more\n "R01, left.jpg",  1.5 ,x\nNA, -2,y\n')
    assert read_text_columns(path, ("t_s", "file")) == [["1.5", "-2"], ["R01, left.jpg", "NA"]]
    (t,) = read_number_columns(path, ("t_s",))
    assert t.tolist() == [1.5, -2.0]
    with pytest.raises(InputError, match=r"'R01, left\.jpg' in column file, row 1") as caught:
        read_number_columns(path, ("t_s", "file"))
    assert caught.value.expected == "a number"


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", "the file is empty"),
        ("file\na\n", "columns missing: t_s"),
        ("file,t_s\n", "no row"),
        ("file,t_s\na,nan\n", "'nan' in column t_s, row 1"),
        ("file,t_s\na,1\nb,inf\n", "'inf' in column t_s, row 2"),
    ],
)
def test_tables_that_lack_something_are_refused(tmp_path, text, found):
    path = tmp_path / "ties.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=found):
        read_number_columns(path, ("t_s",))
    with pytest.raises(InputError, match="file not found"):
        read_number_columns(path.with_name("other.csv"), ("t_s",))
