"""Soundings, trajectory and a surveyed bed as files -> calibration and report; what is refused."""

import importlib.util
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pyproj import CRS
from scipy.spatial.transform import Rotation

from tests.calibration.echo_runs import SIGMA_RULER_M, TRUE_LEVER_M, EchoRun, EchoSpec, make_echo_run
from thalweg.bathymetry import Transducer, speed_of_sound_mps
from thalweg.calibration import echo_sounder as files, resolve_mounts, write_mounts
from thalweg.core import GeometryError, InputError, rotation_enu_body, write_table
from thalweg.core.calibration import read_calibration
from thalweg.ingest import DEPTH
from thalweg.settings.sections import Calibration, EchoSounder
from thalweg_lab.studies.cone_runs import LEVER_ANTENNA_M

PLAIN = Calibration().model_dump(mode="json")
SETTINGS = PLAIN["echo_sounder"] | {"errors": PLAIN["run_errors"]}


def depth_table(t_gps_s: np.ndarray, depth_m: np.ndarray, sentence: str = "DPT") -> pd.DataFrame:
    table = pd.DataFrame({"t_gps_s": t_gps_s, "depth_m": depth_m})
    for name in ("t_host_s", "t_day_s", "offset_m"):
        table[name] = np.nan
    table["sentence"], table["line"] = sentence, np.arange(1, len(table) + 1)
    return table[list(DEPTH.names)]


def calibrated(
    folder: Path,
    repository: Path,
    run: EchoRun,
    *,
    up_m: float = 0.0,
    stated: EchoSounder | None = None,
    logged_c: float | None = None,
) -> dict[str, Any]:
    """Write a run as the pipeline's files, call the entry script, and give its report."""
    name = "calibrate_echo_sounder"
    spec = importlib.util.spec_from_file_location(name, repository / f"workflow/scripts/{name}.py")
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    frame = run.trajectory.frame
    rows = frame.to_map(run.bed.points_wcs_m + np.array([0.0, 0.0, up_m]), CRS(25833)).tolist()
    text = "\n".join(f"{e:.3f},{n:.3f},{h:.3f},0.01" for e, n, h in rows)
    (folder / "bed.csv").write_text(f"east_m,north_m,h_ell_m,sigma_m\n{text}\n")
    both = [depth_table(run.t_gps_s, run.depth_m, s) for s in ("DPT", "DBT")]
    write_table(folder / "depths.parquet", pd.concat(both).sort_values("t_gps_s", kind="stable"), DEPTH)
    details = {} if logged_c is None else {"water_temperature_c": logged_c}
    (folder / "depth.integrity.json").write_text(json.dumps({"details": details}))
    run.trajectory.write(folder / "trajectory.parquet")
    ruler = {"lever_ics_m": run.ruler_m.tolist(), "sigma_lever_m": SIGMA_RULER_M.tolist()}
    antenna = {"lever_ics_m": LEVER_ANTENNA_M.tolist(), "sigma_lever_m": [0.0, 0.0, 0.0]}
    write_mounts(folder / "mounts.json", resolve_mounts({"echo_sounder": ruler, "antenna": antenna}, None))
    script.main(
        depths=folder / "depths.parquet",
        integrity=folder / "depth.integrity.json",
        trajectory=folder / "trajectory.parquet",
        mounts=folder / "mounts.json",
        bed=[folder / "bed.csv"],
        echo_sounder=folder / "echo_sounder.yaml",
        report=folder / "echo_sounder.json",
        run="river",
        frame=frame,
        crs="EPSG:25833",
        settings=SETTINGS,
        stated=stated or EchoSounder(),
        twin=True,
    )
    return json.loads((folder / "echo_sounder.json").read_text())


def test_the_calibration_holds_the_place_and_the_report_what_determined_it(tmp_path, repository):
    run = make_echo_run(1, EchoSpec(reach_m=12.0, duration_s=240.0))
    report = calibrated(tmp_path, repository, run)
    found = read_calibration(tmp_path / "echo_sounder.yaml")
    values, cov = found.block("echo_sounder")
    error = values - TRUE_LEVER_M
    # chi-square with three degrees of freedom, 99.9 %
    assert error @ np.linalg.solve(cov, error) < 16.3
    # the ruler has 3 cm
    assert np.sqrt(np.diag(cov)).max() < 0.02
    assert report["determined"] == ["x", "y", "z", "lag"]
    assert report["refused"] == []
    assert found.find("echo_sounder").facts["determined"] == ["x", "y", "z"]
    assert found.source.twin
    assert report["lever_ics"]["x"]["ruler_m"] == pytest.approx(run.ruler_m[0])
    counts = report["soundings"]
    assert counts["rows"] == 2 * len(run.t_gps_s)
    assert counts["of_other_sentences"] == len(run.t_gps_s)
    assert counts["used"] + counts["rejected"] + counts["outside_the_bed"] == counts["taken"]
    # the mounts of another campaign can be made of it
    others = {name: {"lever_ics_m": [0.1, 0.0, -0.4]} for name in ("lidar", "antenna")}
    mounts = resolve_mounts({"echo_sounder": {}, **others}, found)
    assert mounts["echo_sounder"]["source"] == "river"
    lever, again = files.ruler_of(mounts["echo_sounder"])
    assert lever == pytest.approx(values)
    assert again == pytest.approx(cov)


def test_speed_of_sound_and_latency_are_not_put_into_the_place(tmp_path, repository):
    """An instrument that takes 1500 m/s in water of 12 degrees and stamps 0.2 s late is calibrated to the
    same place as one without either; its lag is that against the stamps of the log."""
    run = make_echo_run(1, EchoSpec(reach_m=12.0, duration_s=240.0))
    calibrated(tmp_path, repository, run)
    plain = read_calibration(tmp_path / "echo_sounder.yaml")
    factor = float(speed_of_sound_mps(12.0)) / 1500.0
    late = replace(run, t_gps_s=run.t_gps_s + 0.2, depth_m=run.depth_m / factor)
    stated = EchoSounder(set_sound_speed_mps=1500.0, latency_s=0.2)
    calibrated(tmp_path, repository, late, stated=stated, logged_c=12.0)
    found = read_calibration(tmp_path / "echo_sounder.yaml")
    assert found.block("echo_sounder")[0] == pytest.approx(plain.block("echo_sounder")[0], abs=1e-3)
    lags = [each.find("echo_sounder").facts["lag_s"] for each in (plain, found)]
    assert lags[1] == pytest.approx(lags[0] - 0.2, abs=2e-3)


def test_a_lag_that_a_flat_bed_does_not_show_stays_the_stated_latency(tmp_path, repository):
    stated = EchoSounder(latency_s=0.2, sigma_latency_s=0.07)
    times = {}
    for name, spec in (
        ("flat", EchoSpec(reach_m=12.0, duration_s=120.0, relief_m=0.0, sway=0.1)),
        ("relief", EchoSpec(reach_m=12.0, duration_s=240.0)),
    ):
        (tmp_path / name).mkdir()
        run = make_echo_run(2, spec)
        late = replace(run, t_gps_s=run.t_gps_s + 0.2)
        report = calibrated(tmp_path / name, repository, late, stated=stated)
        placed = Transducer.of({}, tmp_path / name / "echo_sounder.yaml", stated)
        times[name] = (report["lag"]["determined"], placed.lag_s, placed.sigma_lag_s, report["lag"])
    assert times["flat"][:3] == (False, -0.2, 0.07)
    known, lag_s, sigma_s, lag = times["relief"]
    assert known
    assert lag_s == pytest.approx(lag["value_s"], abs=1e-6)
    assert sigma_s == pytest.approx(lag["sigma_s"], abs=1e-6)
    assert sigma_s < 0.02


def test_heights_of_another_kind_are_refused(tmp_path, repository):
    """45 m of geoid: nothing is written."""
    with pytest.raises(GeometryError, match=r"miss the surveyed bed by .*ellipsoidal"):
        calibrated(tmp_path, repository, make_echo_run(3, EchoSpec(reach_m=12.0, duration_s=30.0)), up_m=45.0)
    assert not (tmp_path / "echo_sounder.yaml").exists()


def test_soundings_near_a_gap_and_without_time_are_left_out_and_counted():
    run = make_echo_run(4, EchoSpec(reach_m=12.0, duration_s=30.0))
    path = run.trajectory
    t0 = path.t_gps_s[0]
    hole = (path.t_gps_s > t0 + 10.0) & (path.t_gps_s < t0 + 11.0)
    path = replace(path, valid=~hole)
    table = depth_table(np.r_[run.t_gps_s, np.nan, t0 - 5.0], np.r_[run.depth_m, 1.0, 1.0])
    t, depth, counts = files.soundings(table, path)
    assert len(t) == len(depth) == counts["taken"]
    assert counts["without_time"] == 1
    assert counts["taken"] + counts["near_a_gap"] == len(run.t_gps_s) + 1
    # velocities hold what lies within a second and a half
    assert np.abs(t - (t0 + 10.5)).min() > 0.5 + 1.5
    assert counts["near_a_gap"] == pytest.approx(1 + 10 * (1.0 + 2 * 1.6), abs=3)
    with pytest.raises(InputError, match="no soundings"):
        files.soundings(table[:0], path)


def test_the_sentence_that_is_there_is_taken():
    run = make_echo_run(4, EchoSpec(reach_m=12.0, duration_s=10.0))
    # a log in which DPT stops early
    few = depth_table(run.t_gps_s[:10], run.depth_m[:10])
    all_of_them = depth_table(run.t_gps_s, run.depth_m, "DBS")
    _, _, counts = files.soundings(pd.concat([few, all_of_them]), run.trajectory)
    assert counts["of_other_sentences"] == 10


def test_sizes_of_pose_errors_follow_the_trajectory_where_it_states_greater_ones():
    run = make_echo_run(4, EchoSpec(reach_m=12.0, duration_s=10.0))
    cov = np.zeros((len(run.trajectory.t_gps_s), 6, 6))
    cov[:, 2, 2] = 0.06**2
    worse = replace(run.trajectory, cov_pose_wcs=cov)
    # numbers of the section, and 6 cm for the height
    found = files.settings_of(SETTINGS, worse, run.t_gps_s).errors.sigma_position_m
    assert found == pytest.approx([0.02, 0.02, 0.06])
    assert files.settings_of(SETTINGS, run.trajectory, run.t_gps_s).errors.sigma_position_m[2] == 0.03


def test_soundings_of_a_heeled_boat_meet_the_bed_beside_it():
    """Eastward, starboard 30 degrees down: forward is east; what is 0.5 m to starboard and 3.2 m down lies
    0.5 cos 30 - 3.2 sin 30 = -1.167 m to the south. The last sounding has no pose."""
    path = make_echo_run(4, EchoSpec(reach_m=12.0, duration_s=10.0)).trajectory
    n, turn = len(path.t_gps_s), Rotation.from_matrix(rotation_enu_body(np.pi / 6, 0.0, np.pi / 2)).as_quat()
    path = replace(
        path, position_wcs_m=np.tile([10.0, 20.0, 5.0], (n, 1)), quaternion_wcs_ics=np.tile(turn, (n, 1))
    )
    t = path.t_gps_s[[5, n - 1]] + [0.0, 9.0]
    places = files.places_of(path, t, np.array([3.0, 3.0]), np.array([1.0, 0.5, 0.2]))
    assert places == pytest.approx(np.array([[11.0, 20.0 + 1.6 - 0.25 * np.sqrt(3)]]))


def test_soundings_that_share_surveyed_points_share_their_errors():
    rng = np.random.default_rng(2)
    side = np.arange(0.0, 10.1, 0.5)
    grid = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    up = 0.1 * grid[:, 0] - 0.2 * grid[:, 1] + 0.02 * rng.standard_normal(len(grid))
    points, sigma = np.column_stack([grid, up]), np.full(len(grid), 0.02)
    line = np.column_stack([np.linspace(1.0, 9.0, 400), np.full(400, 5.2)])
    bed = files.bed_of(points, sigma, SETTINGS, line)
    # 16 cells of a strip, 17 points on either side
    assert bed.sigma_m == pytest.approx(0.02 * np.sqrt(400 / 34), rel=0.1)
    assert files.bed_of(points, sigma, SETTINGS, line[:3]).sigma_m == pytest.approx(0.02)
    # slopes of triangles of 0.5 m would err by 0.02 sqrt(2) / 0.5 = 0.057; planes over 1 m by a third of it
    _, slope, inside = bed.at(line)
    assert inside.all()
    assert (slope - [0.1, -0.2]).std() < 0.03
