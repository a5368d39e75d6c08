"""Do the points know how good they are? Raw logs of 24 seeds through the whole chain, against the truth.

Each seed is a survey of its own: poses, mounts and every shot err anew. The reach is bare, so that the
question is about the sigmas and not about leaves; that of `tiny`, `demo` and `mulde` is not.
"""

import dataclasses
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from thalweg.accuracy.returns import TrueReturns, sample_of_known_points
from thalweg.accuracy.statistics import chi_square_band, independent_values
from thalweg.accuracy.truth import PointErrors, Truth, cloud_covariance, point_errors
from thalweg.config.campaign import Campaign
from thalweg.config.twin import TwinConfig
from thalweg.core.frames import LocalFrame
from thalweg.core.tables import read_table
from thalweg.ingest.anpp import read_anpp
from thalweg.ingest.rtklib_pos import read_pos
from thalweg.ingest.velodyne import LidarOptions, scan_lidar
from thalweg.ingest.velodyne_model import RING, VERTICAL_CORRECTION_M
from thalweg.lidar.cloud import LogSettings, georeference_log
from thalweg.lidar.covariance import BeamErrors
from thalweg.lidar.filters import FilterSettings
from thalweg.lidar.mount import Mount
from thalweg.orientation.ins_gnss import build_trajectory
from thalweg.simulation.gnss import simulate_gnss
from thalweg.simulation.ins import simulate_ins
from thalweg.simulation.lidar import simulate_lidar
from thalweg.simulation.materials import BARE_GROUND
from thalweg.simulation.scene import Scene, simulate_scene
from thalweg.simulation.shots import LIDAR_SHOTS, EchoKind
from thalweg.simulation.true_mounts import true_mounts
from thalweg.simulation.truth import true_trajectory
from thalweg.simulation.voyage import Voyage

SEEDS = 24
DURATION_S, CORRELATION_S = 4.0, 0.5
FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
BARE = {
    "stones_per_m": 0, "cobbles_per_m": 0, "bushes_per_100m": 0, "trees_per_100m": 0, "grass_per_m": 0,
    "reeds_per_m": 0, "posts_per_100m": 0, "buildings": 0, "railway": False, "length_m": 60.0, "grid_m": 0.25,
}  # fmt: skip
MOUNTS = {
    "lidar": {"phi_deg": -90.0, "lever_ics_m": (-0.35, 0.0, -0.25)},
    "antenna": {"lever_ics_m": (0.1, 0.0, -0.45), "sigma_lever_m": (0.002, 0.002, 0.002)},
}


def campaign(twin: dict[str, Any]) -> dict[str, Any]:
    """Settings of a campaign of the twin as plain values: defaults wherever nothing is said."""
    settings = {
        "size": "tiny",
        "duration_s": DURATION_S,
        "scene": BARE,
        "ins": {"attitude_time_s": CORRELATION_S},
        "gnss": {"correlation_time_s": CORRELATION_S},
    }
    for key, value in twin.items():
        settings[key] = settings.get(key, {}) | value
    identity = {"id": "x", "title": "x", "crs": "EPSG:25833", "seed": 1,
                "origin": {"lat_deg": 51.05, "lon_deg": 13.25, "h_ell_m": 300.0}}  # fmt: skip
    return Campaign.model_validate({"campaign": identity, "twin": settings, "mounts": MOUNTS}).plain()


def survey(seed: int, folder: Path, twin: dict[str, Any]) -> PointErrors:
    """A survey from raw logs to the errors of its points."""
    plain = campaign(twin)
    config = TwinConfig(**plain["twin"])
    names = ("scene.npz", "lidar.pcap", "ins.anpp", "rover.sbp", "ppk.pos", "points.laz", "shots.parquet")
    scene, pcap, anpp, sbp, pos, points, shots = (folder / f"{seed}_{name}" for name in names)
    true = true_mounts(plain["mounts"], seed, on=config.effects.mount_errors)
    mount, true_mount = (Mount.from_section(m["lidar"]) for m in (plain["mounts"], true))
    simulate_scene(config, seed, scene)
    simulate_lidar(
        config, seed, FRAME, scene, pcap,
        R_ics_scs=true_mount.R_ics_sensor, lever_ics_scs_m=true_mount.lever_ics_m, out_shots=shots,
    )  # fmt: skip
    simulate_ins(config, seed, FRAME, anpp)
    simulate_gnss(config, seed, FRAME, sbp, pos, lever_ics_antenna_m=true["antenna"]["lever_ics_m"])
    trajectory, _ = build_trajectory(
        read_pos([pos]).positions,
        read_anpp([anpp]).states,
        FRAME,
        lever_ics_antenna_m=plain["mounts"]["antenna"]["lever_ics_m"],
        sigma_lever_m=plain["mounts"]["antenna"]["sigma_lever_m"],
        accept_fixes=["fixed"],
        max_gap_s=1.0,
        max_attitude_gap_s=0.1,
        sigma_attitude_rad=np.deg2rad([0.1, 0.1, 0.2]),
    )
    options = LidarOptions()
    settings = LogSettings(
        mount=mount,
        beam=BeamErrors.from_section(plain["lidar_accuracy"]),
        filters=FilterSettings.from_section(plain["filters"]),
        min_range_m=0.5,
        max_range_m=100.0,
        correlations=True,
    )
    georeference_log([pcap], options, scan_lidar([pcap], options).clock, trajectory, settings, points)
    reach = Scene.read(scene)
    returns = TrueReturns.from_table(read_table(shots, LIDAR_SHOTS)[0], {int(k): k.name for k in EchoKind})
    cloud = sample_of_known_points(points, returns, 20_000)
    row = cloud["true_row"]
    bare = np.append(BARE_GROUND, np.zeros(256 - len(BARE_GROUND), dtype=np.bool_))
    return point_errors(
        cloud["xyz_m"],
        cloud["t_gps_s"],
        cloud_covariance(cloud, points),
        VERTICAL_CORRECTION_M[np.argsort(RING)][cloud["ring"]],
        estimated=trajectory,
        mount=mount,
        truth=Truth(
            trajectory=true_trajectory(Voyage(config, seed), FRAME),
            mount=true_mount,
            surface=reach.caster(),
            bare_ground=BARE_GROUND[reach.material],
            divergence_rad=config.lidar.divergence_mrad / 1000.0,
        ),
        from_ground=(returns.kind[row] == EchoKind.SURFACE) & bare[returns.material[row]],
    )


def study(folder: Path, seeds: int = SEEDS, **twin: Any) -> list[PointErrors]:
    # Two processes for the two cores of a testing machine; spawned, as numba's threads do not survive a fork.
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(survey, seed, folder, twin) for seed in range(seeds)]
        return [job.result() for job in jobs]


def normalised(study_errors: list[PointErrors], near_m: float = 0.0, far_m: float = 200.0) -> np.ndarray:
    """Mean over the bare ground of squared error over predicted variance, one value a seed."""
    out = []
    for errors in study_errors:
        use = errors.bare_ground & (errors.range_m >= near_m) & (errors.range_m < far_m)
        out.append(np.mean((errors.error_m[use] / errors.sigma_m[use]) ** 2))
    return np.array(out)


def band(seeds: int) -> tuple[float, float]:
    """95 % band of the mean over the seeds if one error of that correlation time made all of it.

    Several independent errors add up in each point, so that honest sigmas stay inside more often than that.
    """
    return chi_square_band(seeds * independent_values(DURATION_S, CORRELATION_S))


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> list[PointErrors]:
    return study(tmp_path_factory.mktemp("honest"))


def test_normalised_errors_are_inside_their_band(honest: list[PointErrors]) -> None:
    low, high = band(SEEDS)
    assert high - low < 0.45  # sigmas that are 11 % too small or too large would be seen
    values = normalised(honest)
    assert low < values.mean() < high, values


@pytest.mark.parametrize(("near_m", "far_m"), [(0.0, 17.0), (17.0, 25.0), (25.0, 100.0)])
def test_near_and_far_alike(honest: list[PointErrors], near_m: float, far_m: float) -> None:
    """Too small a sigma far away must not be made up for by too large a one near by."""
    low, high = band(SEEDS)
    assert low < normalised(honest, near_m, far_m).mean() < high


def test_95_percent_of_the_points_are_within_1_96_sigma(honest: list[PointErrors]) -> None:
    shares = [np.mean(np.abs(e.error_m[e.bare_ground]) < 1.96 * e.sigma_m[e.bare_ground]) for e in honest]
    # shares of seeds scatter with their few independent errors: the mean is known to std / sqrt(24)
    assert abs(np.mean(shares) - 0.95) < 3 * np.std(shares, ddof=1) / np.sqrt(SEEDS)
    assert abs(np.mean(shares) - 0.95) < 0.02


def test_errors_of_seeds_have_no_common_sign(honest: list[PointErrors]) -> None:
    """A bias shared by all seeds would be an error of the chain, not of the sensors."""
    means = np.array([np.mean((e.error_m / e.sigma_m)[e.bare_ground]) for e in honest])
    assert abs(means.mean()) < 3 * means.std(ddof=1) / np.sqrt(SEEDS)


@pytest.mark.parametrize(
    "unknown",
    [
        # 40 mG across the boat turn a compass by 11 degrees where the earth has 200 mG; the INS follows late
        {"ins": {"motor_field_mg": ((0.0, 40.0, 0.0), (0.0, 40.0, 0.0)), "magnetic_time_s": 2.0}},
        {"ins": {"heading_drift_degpmin": 15.0}},
        {"lidar": {"sigma_range_m": 0.12}},
    ],
    ids=["motor fields", "heading drift", "range noise"],
)
def test_an_effect_that_the_model_does_not_know_is_seen(tmp_path: Path, unknown: dict[str, Any]) -> None:
    seeds = 6
    assert normalised(study(tmp_path, seeds, **unknown)).mean() > band(seeds)[1]


def test_sigmas_that_promise_too_little_are_seen(honest: list[PointErrors]) -> None:
    """Two-sided: claimed sigmas a quarter too large leave the band below."""
    modest = [dataclasses.replace(errors, sigma_m=1.25 * errors.sigma_m) for errors in honest]
    assert normalised(modest).mean() < band(SEEDS)[0]


@pytest.mark.slow
def test_on_the_whole_river_too(tmp_path: Path) -> None:
    """The reach of `tiny` with stones, cobbles, bushes, trees, grass, houses: the same band, a little wider.

    Spots that graze a bump or a stone are counted in, which no sigma of a beam foresees; on a bank with
    relief of centimetres they widen the mean square by some percent.
    """
    whole = dict.fromkeys(BARE) | TwinConfig.of_size("tiny").scene.model_dump(include=set(BARE))
    values = normalised(study(tmp_path, 20, scene=whole))
    low, high = band(20)
    assert low < values.mean() < 1.1 * high, values
