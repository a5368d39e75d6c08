"""Cloud of a twin campaign -> its errors against the twin's truth, and what the filters took."""

from pathlib import Path
from typing import Any

from thalweg.calibration import read_mounts
from thalweg.core import Rigid, Trajectory, read_table
from thalweg.workflow import run_job
from thalweg_lab.instruments import LIDAR_SHOTS, EchoKind
from thalweg_lab.river import BARE_GROUND, Scene
from thalweg_lab.truth import TrueReturns, Truth, compare_cloud, filter_scores
from thalweg_lab.voyage import longest_correlation_s, read_true_mounts


def main(
    *,
    points: Path,
    trajectory: Path,
    scene: Path,
    voyage: Path,
    shots: Path,
    true_mounts: Path,
    mounts: Path,
    statistics: Path,
    by_range: Path,
    scores: Path,
    twin: dict[str, Any],
    lidar_options: dict[str, Any],
    orientation: dict[str, Any],
) -> None:
    reach, estimated = Scene.read(scene), Trajectory.read(trajectory)
    returns = TrueReturns.from_table(read_table(shots, LIDAR_SHOTS)[0], {int(k): k.name for k in EchoKind})
    numbers, classes = compare_cloud(
        points,
        estimated=estimated,
        mount=Rigid.from_mount(read_mounts(mounts)["lidar"]),
        truth=Truth(
            trajectory=Trajectory.read(voyage),
            mount=Rigid.from_mount(read_true_mounts(true_mounts)["lidar"]),
            surface=reach.caster(),
            bare_ground=BARE_GROUND[reach.material],
            divergence_rad=twin["lidar"]["divergence_mrad"] / 1000.0,
        ),
        returns=returns,
        bare_materials=BARE_GROUND,
        vertical_corrections=lidar_options["vertical_corrections"],
        correlation_s=longest_correlation_s(twin, orientation["position_source"]),
    )
    filter_scores(points, returns, estimated.at(returns.t_gps_s)[2]).to_csv(scores, index=False)
    numbers.to_csv(statistics, index=False)
    classes.to_csv(by_range, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
