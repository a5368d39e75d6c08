"""The shape of the workflow: what depends on what, and what must not."""

import os
import re
import resource
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce

import pytest

from thalweg.workflow import start_driver
from thalweg.workflow.truth import may_read_truth

pytestmark = pytest.mark.workflow

OF_A_SURVEY = {
    "compare_with_truth",
    "compare_chains_with_truth",
    "compare_riverbed_with_truth",
    "compare_dtm_with_truth",
}
MAY_READ_TRUTH = {
    "tiny": OF_A_SURVEY | {"compare_rig_with_truth"},
    "full": OF_A_SURVEY
    | {"compare_bed_with_truth", "compare_light_sheet_with_truth", "compare_calibration_with_truth"},
    "mulde": OF_A_SURVEY,
    "field_tiny": {"compare_calibration_with_truth"},
    "basin_tiny": {"compare_light_sheet_with_truth"},
    "tiny_change": {"compare_change_with_truth"},
}
"""What judges results of the twin."""
CALIBRATED = dict.fromkeys(("full", "without_images"), ("field", "basin"))
"""Campaigns that bring the calibrations of their boat and light-sheet sensor along."""


@dataclass(frozen=True)
class Job:
    rule: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    log: tuple[str, ...] = ()
    benchmark: tuple[str, ...] = ()


def jobs(house, campaign: str, *targets: str) -> list[Job]:
    """All jobs of a campaign (or of several, ``[a,b]``) with their files, as a dry run shows them."""
    options = ("--dry-run", "--quiet", "host", "--forceall", "--config", f"campaign={campaign}", "--")
    run = house.snakemake(*options, *targets)
    found = []
    for block in re.split(r"(?m)^(?:local)?rule ", run.stdout + run.stderr)[1:]:
        files = {
            key: tuple(re.split(r",\s+", match.group(1)))
            if (match := re.search(rf"(?m)^    {key}: (.*)$", block))
            else ()
            for key in ("input", "output", "log", "benchmark")
        }
        found.append(Job(block.split(":", 1)[0], *files.values()))
    return found


EDITED = {
    "parted": ("tiny", r"(?m)^images:.*$", "images:\n  mapping: {parts: 3}"),
    "rigged": ("tiny", r"(?m)^images:.*$", "images:\n  source: rig"),
    "without_images": ("full", r"(?m)^  time_lapse: .*\n", ""),
}
"""Campaigns that are others with one change: name of the other, what is replaced, and by what."""


@pytest.fixture(scope="module")
def of_campaigns(empty_house):
    """Jobs of each campaign, from one dry run of all."""
    folder = empty_house.root / "config/campaigns"
    for name, (other, pattern, by) in EDITED.items():
        text, n = re.subn(pattern, by, (folder / f"{other}.yaml").read_text())
        assert n == 1
        (folder / f"{name}.yaml").write_text(text.replace(f"id: {other}", f"id: {name}"))
    names = (*MAY_READ_TRUTH, *EDITED)
    found = jobs(empty_house, f"[{','.join(names)}]")
    for name in EDITED:
        (folder / f"{name}.yaml").unlink()
    folders = {n: tuple(f"results/{each}/" for each in (n, *CALIBRATED.get(n, ()))) for n in names}
    return {
        name: behind(found, lambda job, own=own: any(file.startswith(own) for file in job.outputs))
        for name, own in folders.items()
    }


@pytest.mark.parametrize("campaign", MAY_READ_TRUTH)
def test_no_processing_rule_reads_the_truth(of_campaigns, campaign):
    found = of_campaigns[campaign]
    assert len(found) > 20
    readers = {job.rule for job in found if any("/truth/" in name for name in job.inputs)}
    simulating = {rule for rule in readers if rule.startswith("simulate_")}
    # images of the light-sheet sensor are made from the campaign alone
    assert bool(simulating) == (campaign != "basin_tiny")
    assert readers - simulating == MAY_READ_TRUTH[campaign]
    # what is declared here is what a job may open when it runs
    assert {job.rule for job in found if may_read_truth(job.rule)} >= readers
    # and what the comparison yields feeds tables and pictures only
    consumers = {job.rule for job in found if any("/accuracy/truth" in name for name in job.inputs)} - {"all"}
    for table in ("/calibration_truth", "/light_sheet_truth", "/deformation/truth"):
        consumers |= {j.rule for j in found if any(table in name for name in j.inputs)} - {"all"}
    assert consumers
    shown = {"summarise", "accuracy_page", "calibration_page", "light_sheet_page"}
    shown |= {"deformation_page", "bathymetry_page", "survey_report", "front_page"}
    assert all(rule in shown or rule.startswith("plot_") for rule in consumers)
    # the truth is written by the simulation alone, into its own folder
    for job in found:
        if any("/simulation/" in name for name in job.outputs):
            assert job.rule.startswith("simulate_")


def test_pairs_of_images_are_dealt_out_to_as_many_jobs_as_the_campaign_says(of_campaigns):
    found = of_campaigns["parted"]
    parts = sorted(name for job in found if job.rule == "match_features" for name in job.outputs)
    assert [name.rsplit("/", 1)[-1] for name in parts] == [f"pairs_{k}.npz" for k in range(3)]
    (join,) = (job for job in found if job.rule == "join_matches")
    assert set(parts) < set(join.inputs)
    (mapping,) = (job for job in found if job.rule == "map_images")
    assert set(mapping.inputs) == set(join.outputs)


def test_files_of_a_rig_may_be_the_images_that_orient_the_boat(of_campaigns):
    """Its block feeds the trajectories; its panoramas and the colours take the poses by all sensors."""
    found = of_campaigns["rigged"]
    by_rule = {job.rule: job for job in found}
    own = (
        "mask_images",
        "extract_features",
        "map_images",
        "adjust_images",
        "check_colours",
        "place_rig_images",
    )
    assert not by_rule.keys() & set(own)
    (block,) = (name for name in by_rule["orient_rig"].outputs if "image_poses" in name)
    assert block in by_rule["time_images"].inputs
    assert "results/rigged/simulation/logs/rig" in by_rule["orient_rig"].inputs
    assert "results/rigged/simulation/logs/rig" in by_rule["read_image_stamps"].inputs
    for poses, rules in (
        ("timed", ("camera_trajectory", "fuse_trajectory")),
        ("fused", ("make_panoramas", "colour_points", "compare_rig_with_truth")),
    ):
        for rule in rules:
            assert f"results/rigged/orientation/image_poses_{poses}.parquet" in by_rule[rule].inputs, rule
    readers = {job.rule for job in found if any("/truth/" in name for name in job.inputs)}
    assert {rule for rule in readers if not rule.startswith("simulate_")} == MAY_READ_TRUTH["tiny"]


@pytest.mark.parametrize("images", [True, False])
def test_the_strip_of_the_bed_takes_the_best_trajectory(of_campaigns, images):
    """INS alone leads the strip centimetres away from the bed; fused where the survey has images."""
    found = of_campaigns["full" if images else "without_images"]
    (job,) = (job for job in found if job.rule == "locate_bed_strip")
    used = [name.rsplit("/", 1)[-1] for name in job.inputs if "/orientation/" in name]
    assert used == ["trajectory_fused.parquet" if images else "trajectory.parquet"]


TARGETS = ("ingest", "lidar", "images", "accuracy", "figures")


@pytest.fixture(scope="module")
def of_targets(empty_house):
    """Jobs of all targets of the tiny campaign, and of the ledger."""
    return jobs(empty_house, "tiny", *TARGETS, "reproduce")


def behind(found: list[Job], wanted: Callable[[Job], bool]) -> list[Job]:
    """The wanted jobs and all whose outputs they need."""
    makers = {name: job for job in found for name in job.outputs}
    seen, queue = list[Job](), [job for job in found if wanted(job)]
    while queue:
        job = queue.pop()
        if job not in seen:
            seen.append(job)
            queue += [makers[name] for name in job.inputs if name in makers]
    return seen


@pytest.mark.parametrize(
    ("target", "last", "absent"),
    [
        ("ingest", "read_reference", "build_trajectory"),
        ("lidar", "georeference_lidar", "mesh_reference"),
        ("images", "fuse_trajectory", "georeference_lidar"),
        ("accuracy", "compare_chains", "summarise"),
        ("figures", "plot_cloud_overview", "summarise"),
    ],
)
def test_a_target_builds_what_its_name_says(of_targets, target, last, absent):
    found = behind(of_targets, lambda job: job.rule == target)
    rules = {job.rule for job in found}
    assert {target, last} <= rules
    assert absent not in rules
    assert not (set(TARGETS) - {target}) & rules
    asked = found[0]
    assert len(asked.inputs) >= 3


SHARED_SCRIPTS = {"call", "detect_markers", "simulate_field_images"}
CALLING = {"call", "page", "plot", "results_of_study", "rows_of_study"}
"""Scripts that call a function by its name: the version of their own code says nothing of it."""


def test_every_rule_has_its_script_and_requests(repository):
    scripts = {p.stem for p in (repository / "workflow/scripts").glob("*.py")}
    used: set[str] = set()
    for path in sorted((repository / "workflow/rules").glob("*.smk")):
        for text in re.split(r"(?m)^ *rule\b", path.read_text())[1:]:
            script = re.search(r'"\.\./scripts/(\w+)\.py"', text)[1]
            # a rule without a name is that of a table: of all pictures, pages or studies
            name = text.split(":", 1)[0].strip() or script
            # A rule has the name of its script; rules that share one say what of it they do.
            used.add(script)
            assert script == name or script in SHARED_SCRIPTS, name
            version = r"\*\*calls\(" if script in ("call", "page") else rf'code=.*\b\w*version\("{script}"'
            assert bool(re.search(version, text)) == (script in CALLING), name
            for field in ("mem_mb=", "runtime="):
                assert field in text, f"{name} has no {field}"
    assert used == scripts


@pytest.mark.parametrize(
    ("campaign", "output", "log"),
    [
        ("tiny", "ingest/depths.parquet", "ingest/read_depth"),
        ("tiny", "orientation/image_poses.parquet", "orientation/adjust_images"),
        ("tiny", "accuracy/by_camera/statistics.csv", "accuracy/by_camera/compare_with_reference"),
        ("tiny", "accuracy/truth_statistics.csv", "accuracy/compare_with_truth"),
        ("tiny", "figures/bed_map.png", "figures/plot_bed_map"),
        ("tiny", "index.html", "figures/front_page"),
        ("parted", "orientation/sfm/pairs_2.npz", "orientation/match_features_2"),
        ("tiny_change", "deformation/volumes_1-2.csv", "deformation/compare_epochs_1-2"),
        ("basin_tiny", "triangulation/panels/line_points.parquet", "triangulation/detect_sheet_lines_panels"),
    ],
)
def test_a_log_and_a_benchmark_have_the_name_of_their_job(of_campaigns, campaign, output, log):
    (job,) = (job for job in of_campaigns[campaign] if f"results/{campaign}/{output}" in job.outputs)
    assert job.log == (f"logs/{campaign}/{log}.log",)
    assert job.benchmark == (f"benchmarks/{campaign}/{log}.jsonl",)


def test_no_two_jobs_share_a_log(of_campaigns):
    made = {job for found in of_campaigns.values() for job in found if job.outputs}
    assert len(made) > 300
    assert len({job.log for job in made}) == len({job.benchmark for job in made}) == len(made)


def test_published_numbers_need_no_survey(of_targets):
    """What was made counts, and nothing is made for the ledger's sake but the tables of budgets."""
    found = {job.rule: job for job in behind(of_targets, lambda job: job.rule == "reproduce")}
    assert set(found) == {"budget_tables", "ledger", "reproduce"}
    read = " ".join(found["ledger"].inputs)
    for name in ("light_sheet", "boat_and_bank", "tables", "figures", "findings", "misprints", "future"):
        assert f"resources/published/{name}.yaml" in read
    # settings that entries point to
    assert "config/campaigns/full.yaml" in read
    assert "results/reproduction/budgets/p2_table1.csv" in read


def test_a_wrong_campaign_stops_before_the_first_job(empty_house):
    campaign = empty_house.root / "config/campaigns/wrong.yaml"
    campaign.write_text(
        "campaign: {id: wrong, title: x, crs: EPSG:4326, origin: {lat_deg: 51, lon_deg: 13, h_ell_m: 300}}\n"
        "twin: {size: tiny}\nlidr: {}\n"
    )
    run = empty_house.snakemake("--dry-run", "--config", "campaign=wrong", check=False)
    campaign.unlink()
    text = run.stdout + run.stderr
    assert run.returncode != 0
    assert "lidr" in text
    assert "campaign.crs" in text
    assert "Traceback" not in text


def test_a_calibration_that_two_campaigns_name_is_made_once(empty_house):
    folder = empty_house.root / "season"
    folder.mkdir()
    head = "crs: EPSG:25833, origin: {lat_deg: 51.05, lon_deg: 13.25, h_ell_m: 300.0}"
    for name in ("may", "june"):
        (folder / f"{name}.yaml").write_text(
            f"campaign: {{id: {name}, title: x, {head}}}\n"
            "twin: {size: tiny}\nmounts: {calibration: field_tiny}\n"
        )
    found = [job.rule for job in jobs(empty_house, "season/*", "lidar")]
    shutil.rmtree(folder)
    calibrating = {"calibrate_camera_lidar", "calibrate_ins_lidar", "assemble_boat", "adjust_field"}
    assert {rule: found.count(rule) for rule in calibrating} == dict.fromkeys(calibrating, 1)
    assert found.count("georeference_lidar") == 2


def test_a_season_of_ten_is_planned_in_seconds(empty_house):
    folder, own = empty_house.root / "season", empty_house.root / "config/campaigns/tiny.yaml"
    folder.mkdir()
    for k in range(10):
        (folder / f"tiny_{k}.yaml").write_text(own.read_text().replace("id: tiny", f"id: tiny_{k}"))
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    run = empty_house.snakemake("--dry-run", "--quiet", "host", "--config", "campaign=season/*")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    shutil.rmtree(folder)
    (total,) = set(re.findall(r"(?m)^total +(\d+)$", run.stdout + run.stderr))
    assert int(total) > 10 * 90
    # of the processor, whatever else runs; measured 5
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 12


def sentences(second: int) -> str:
    """NMEA of one second of a boat that goes north: position and depth."""
    bodies = [
        f"GPGGA,1200{second:02}.00,5104.{1000 + second},N,01315.0000,E,4,12,0.8,300.0,M,0.0,M,1,0",
        f"GPRMC,1200{second:02}.00,A,5104.{1000 + second},N,01315.0000,E,1.0,0.0,120526,,,D",
        f"SDDBT,,f,{2 + second / 100:.2f},M,,F",
    ]
    sums = [reduce(lambda a, b: a ^ b, body.encode()) for body in bodies]
    return "".join(f"${body}*{total:02X}\r\n" for body, total in zip(bodies, sums, strict=True))


def test_a_campaign_that_fails_does_not_stop_the_others(empty_house):
    folder = empty_house.root / "season"
    folder.mkdir()
    for name in ("may", "june", "july"):
        (folder / f"{name}.log").write_text("".join(map(sentences, range(40))))
        (folder / f"{name}.yaml").write_text(
            f"campaign: {{id: {name}, title: x, crs: EPSG:25833, "
            "origin: {lat_deg: 51.05, lon_deg: 13.25, h_ell_m: 300.0}}\n"
            f"logs: {{depth: [{name}.log]}}\n"
            "mounts: {antenna: {lever_ics_m: [0, 0, -1.5]}, echo_sounder: {lever_ics_m: [0, 0, 0.3]}}\n"
            "orientation: {position_source: nmea, sigma_position_m: [2.0, 2.0, 4.0]}\n"
        )
    (folder / "june.log").write_text("\n".join(60 * ["$GPGGA,no,numbers*00"]))
    quietly = "--quiet", "all", "--keep-going", "--config", "campaign=season/*", "--", "ingest"
    driver = start_driver(empty_house.root)
    try:
        refused = empty_house.snakemake(*quietly, check=False)
    finally:
        driver.close()
    assert re.search("another driver works in this folder: .*; expected one Snakemake", refused.stderr), (
        refused
    )
    run = empty_house.snakemake(*quietly, check=False)
    made = {
        name: sorted((empty_house.root / f"results/{name}").rglob("depths.parquet"))
        for name in ("may", "june", "july")
    }
    shutil.rmtree(folder)
    text = run.stdout + run.stderr
    assert run.returncode != 0
    assert re.search(r"june.log: no NMEA sentence .*; expected .*\n.*traceback is in logs/june", run.stderr)
    assert {name: len(each) for name, each in made.items()} == {"may": 1, "june": 0, "july": 1}, text
    assert re.findall(r"(?m)^(july|june|may): (.*)$", text) == [
        ("july", "done"),
        ("june", "2 jobs not done"),
        ("may", "done"),
    ]


def test_an_unknown_campaign_is_answered_with_the_known_ones(empty_house):
    run = empty_house.snakemake("--quiet", "all", "--config", "campaign=tinny", check=False)
    text = run.stderr
    assert run.returncode != 0
    assert "tinny" in text
    assert "tiny" in text
    assert "mulde" in text


@pytest.mark.parametrize("campaign", ["tiny", "[full,tiny_change]"])
def test_on_a_cluster_short_jobs_go_together(empty_house, campaign):
    """No group waits for a job that waits for it, which Snakemake checks; a third of the starts remains."""
    run = empty_house.snakemake(
        *("--dry-run", "--quiet", "host", "--profile", "profiles/slurm", "--forceall"),
        *("--config", f"campaign={campaign}"),
    )
    groups = len(re.findall(r"(?m)^(?:\[.*\] )?Group job ", run.stdout))
    lone = len(re.findall(r"(?m)^rule \w+:", run.stdout))
    every = len(re.findall(r"(?m)^ *rule \w+:", run.stdout))
    assert groups >= 2
    assert every > 40
    if campaign == "tiny":
        assert groups + lone <= 0.36 * every


CONDA = """#!/bin/sh
case "$*" in
  *info*) echo '{"conda_version": "25.1.0", "conda_prefix": "/c", "platform": "linux-64"}';;
  *config*) echo '{"get": {"channel_priority": "strict"}}';;
  *) echo "conda 25.1.0";;
esac
"""
"""Answers as conda does to what Snakemake asks before it makes an environment."""


def test_jobs_run_in_the_conda_environment(empty_house, tmp_path, monkeypatch):
    (tmp_path / "conda").write_text(CONDA)
    (tmp_path / "conda").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    words = ("--dry-run", "--quiet", "host", "--sdm", "conda", "--config", "campaign=tiny", "--")
    run = empty_house.snakemake(*words, "results/tiny/ingest/depths.parquet")
    assert "Conda environment envs/thalweg.yaml will be created." in run.stdout + run.stderr
