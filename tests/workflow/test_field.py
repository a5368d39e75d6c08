"""A calibration from photographs and raw logs to the boat's file: the twin's, and as users have it."""

import json
import re

import numpy as np
import pandas as pd
import pytest
import yaml
from PIL import Image

from tests.golden.kept_numbers import moved_since_kept
from thalweg.core.calibration import read_calibration

pytestmark = pytest.mark.workflow

LOGS = "results/field_tiny/simulation/logs"


@pytest.fixture(scope="module")
def yard(repository, tmp_path_factory, house_builder):
    """A copy in which the small calibration campaign of the twin ran."""
    house = house_builder(repository, tmp_path_factory.mktemp("yard"))
    house.snakemake("--config", "campaign=field_tiny")
    return house


@pytest.fixture(scope="module")
def as_users_have_it(yard):
    """A campaign ``yard``: the same recordings named as files of a real one, by globs, no twin, no truth."""
    twin = yaml.safe_load((yard.root / "config/campaigns/field_tiny.yaml").read_text())
    logs = yard.root / LOGS
    campaign = {
        "campaign": {**twin["campaign"], "id": "yard", "title": "A yard"},
        "logs": {
            "lidar": [f"{logs}/lidar.pcap"],
            "ins": [f"{logs}/ins.anpp"],
            "positions": [f"{logs}/ppk.pos"],
            "calibration": {
                "field": [f"{logs}/field.yaml"],
                "reference_images": [f"{logs}/reference_images/*.jpg"],
                "position_images": [f"{logs}/position_images/*.jpg"],
                "position_scans": [f"{logs}/position_scans/*.pcap"],
                "run_images": [f"{logs}/run_images/*.jpg"],
                "display": [f"{logs}/display/*.[jJ][pP][gG]"],
            },
        },
        **{key: twin[key] for key in ("mounts", "orientation", "calibration")},
    }
    (yard.root / "config/campaigns/yard.yaml").write_text(yaml.safe_dump(campaign))
    return yard


def test_errors_against_the_truth_are_what_the_sigmas_say(yard):
    table = pd.read_csv(yard.root / "results/field_tiny/accuracy/calibration_truth.csv")
    assert set(table["block"]) == {"camera_lidar", "lidar", "camera", "camera interior", "camera clock"}
    together = table[table["quantity"] == "together"].set_index("block")["normalised"]
    # chi-squared with 6 over 6: 99.9 % lie below 3.74; above 0.05 lie 99.9 %
    assert together.between(0.05, 3.74).all(), together
    single = table[table["quantity"] != "together"].dropna(subset="normalised")
    # Gaussian: one of some 25 values lies beyond 4 once in 600 seeds.
    assert single["normalised"].abs().max() < 4.0, single
    lever = table[(table["block"] == "camera_lidar") & table["quantity"].isin(["x_m", "y_m", "z_m"])]
    assert lever["sigma"].max() < 0.001  # P2: below a millimetre


def test_no_number_has_moved_unseen(yard):
    assert moved_since_kept(yard.root / "results/field_tiny") == []


def test_the_page_shows_every_picture(yard):
    page = (yard.root / "results/field_tiny/calibration/index.html").read_text()
    pictures = sorted((yard.root / "results/field_tiny/figures").glob("*.png"))
    assert len(pictures) == 9
    assert page.count("data:image/png;base64") >= len(pictures)
    assert "digital twin" in page
    for path in pictures:
        pixels = np.asarray(Image.open(path).convert("L"), dtype=float)
        assert pixels.std() > 5, f"{path.name} is blank"


def test_a_second_call_has_nothing_to_do(yard):
    run = yard.snakemake("--dry-run", "--config", "campaign=field_tiny")
    assert "Nothing to be done" in run.stdout + run.stderr


def test_a_survey_that_names_it_gets_its_values_and_its_boat(yard):
    text = (yard.root / "config/campaigns/tiny.yaml").read_text()
    start, end = text.index("mounts:"), text.index("orientation:")
    named = text[:start] + "mounts:\n  calibration: field_tiny\n\n" + text[end:]
    named = re.sub(r"\n  dual_fisheye: .*", "", named)  # which that calibration does not know
    (yard.root / "config/campaigns/after.yaml").write_text(named.replace("id: tiny", "id: after"))
    wanted = ("results/after/calibration/mounts.json", "results/after/simulation/truth/mounts.json")
    yard.snakemake("--config", "campaign=after", "--", *wanted)
    mounts = json.loads((yard.root / wanted[0]).read_text())["mounts"]
    boat = read_calibration(yard.root / "results/field_tiny/calibration/boat.yaml")
    assert {m["source"] for m in mounts.values()} == {"field_tiny"}
    np.testing.assert_allclose(mounts["lidar"]["lever_ics_m"], boat.block("lidar")[0][3:], rtol=1e-12)
    truth = (yard.root / "results/field_tiny/simulation/truth/mounts.json").read_text()
    assert (yard.root / wanted[1]).read_text() == truth


@pytest.mark.slow
def test_files_named_by_globs_give_the_same_calibration(as_users_have_it):
    """As of the light sheet in `test_basin`; what is planned of such files is looked at below."""
    as_users_have_it.snakemake("--config", "campaign=yard")
    root = as_users_have_it.root / "results"
    ours, theirs = (
        read_calibration(root / name / "calibration/boat.yaml") for name in ("field_tiny", "yard")
    )
    assert not theirs.source.twin
    # 0.05 sigma: the same numbers in the same order, on other threads.
    gap = np.abs(ours.values - theirs.values)[ours.sigmas > 0] / ours.sigmas[ours.sigmas > 0]
    assert gap.max() < 0.05
    assert "digital twin" not in (root / "yard/calibration/index.html").read_text()
    assert not (root / "yard/accuracy").exists()


@pytest.fixture(scope="module")
def in_part(as_users_have_it):
    """Rules that are planned: all recordings, without a run, and with a run but no camera."""
    root = as_users_have_it.root
    whole = yaml.safe_load((root / "config/campaigns/yard.yaml").read_text())
    calibration = whole["logs"]["calibration"]
    logs = {
        "still": {"calibration": {key: calibration[key] for key in STILL}},
        "blind": whole["logs"]
        | {"calibration": {key: calibration[key] for key in ("field", "reference_images")}},
    }
    for name, some in logs.items():
        campaign = whole | {"campaign": whole["campaign"] | {"id": name}, "logs": some}
        (root / f"config/campaigns/{name}.yaml").write_text(yaml.safe_dump(campaign))
    words = ("--dry-run", "--quiet", "host", "--config", "campaign=[yard,still,blind]")
    run = as_users_have_it.snakemake(*words)
    jobs = re.split(r"(?m)^(?:local)?rule ", run.stdout + run.stderr)[1:]
    return lambda name: {job.split(":", 1)[0] for job in jobs if f"results/{name}/" in job}


STILL = ("field", "reference_images", "position_images", "position_scans")
"""Recordings of a calibration without a dynamic run."""


def test_files_named_by_globs_are_calibrated_without_the_twin(in_part):
    planned = in_part("yard")
    assert {"adjust_field", "calibrate_camera_lidar", "calibrate_ins_lidar", "assemble_boat"} <= planned
    assert {"read_display", "synchronise_camera", "calibration_page"} <= planned
    assert not any(rule.startswith("simulate_") or rule.endswith("_with_truth") for rule in planned)


def test_a_calibration_without_a_run_ends_with_camera_and_lidar(in_part):
    planned = in_part("still")
    assert {"calibrate_camera_lidar", "calibration_page"} <= planned
    assert not planned & {"calibrate_ins_lidar", "assemble_boat", "synchronise_camera", "build_trajectory"}


def test_a_run_without_a_camera_ends_with_the_lidar_on_the_boat(in_part):
    planned = in_part("blind")
    assert {"calibrate_ins_lidar", "assemble_boat", "calibration_page"} <= planned
    assert not planned & {"orient_camera", "calibrate_camera_lidar", "synchronise_camera"}
