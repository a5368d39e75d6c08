"""A whole survey in one call: the twin's raw logs, and what the processing makes of them.

`record` lets the instruments of the twin write their logs into a folder; `process` reads these logs as those
of a real survey are read and makes a trajectory and a cloud; `reference_mesh` makes a surface of the
terrestrial scans. The workflow does the same rule by rule; this is for studies over many seeds, where a rule
for each step would be a burden::

    settings = survey_settings({"size": "tiny", "duration_s": 4.0}, seed=7)
    logs = record(settings, folder)
    survey = process(logs)
    errors = survey.errors_3d()

One recording may be processed several times, on purpose with settings that are not those of the instruments:
a wrong mount, a late trajectory. What only the twin knows is in `Logs`; nothing of it enters `process` but
the names of the log files.
"""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import ArrayF, LocalFrame, Rigid, Trajectory, iter_laz, read_table
from thalweg.core.geometry import TriangleMesh
from thalweg.ingest import LidarOptions
from thalweg.ingest.anpp import read_anpp
from thalweg.ingest.clouds import gather_reference
from thalweg.ingest.registry import lidar_reader
from thalweg.ingest.tracks import read_pos
from thalweg.ingest.velodyne import VLP16
from thalweg.lidar import LogSettings, cloud_covariance, error_model_of_log, georeference_log
from thalweg.navigation.ins_gnss import ErrorModel, build_trajectory
from thalweg.settings import Campaign
from thalweg.settings.sections import Filters, LidarAccuracy, ReferenceSettings
from thalweg.surface import mesh_reference
from thalweg_lab.instruments import (
    LIDAR_SHOTS,
    EchoKind,
    simulate_echo,
    simulate_gnss,
    simulate_ins,
    simulate_lidar,
    simulate_tls,
)
from thalweg_lab.river import BARE_GROUND, Scene, simulate_scene
from thalweg_lab.settings import TwinConfig
from thalweg_lab.truth import (
    PointErrors,
    PointErrors3d,
    TrueReturns,
    Truth,
    point_errors,
    point_errors_3d,
    sample_of_known_points,
)
from thalweg_lab.voyage import Voyage, true_mounts, true_trajectory

PLACE: Final[dict[str, Any]] = {
    "crs": "EPSG:25833",
    "origin": {"lat_deg": 51.05, "lon_deg": 13.25, "h_ell_m": 300.0},
}
"""Where a survey takes place if nothing is said: the map and the world frame of the delivered campaigns."""

MOUNTS: Final[dict[str, Any]] = {
    "lidar": {"phi_deg": -90.0, "lever_ics_m": (-0.35, 0.0, -0.25)},
    "antenna": {"lever_ics_m": (0.1, 0.0, -0.45), "sigma_lever_m": (0.002, 0.002, 0.002)},
}
"""How its sensors sit if nothing is said; sigmas of the lidar's mount are those of T Table 3.1."""

BARE: Final[dict[str, Any]] = {
    "stones_per_m": 0, "cobbles_per_m": 0, "bushes_per_100m": 0, "trees_per_100m": 0, "grass_per_m": 0,
    "reeds_per_m": 0, "posts_per_100m": 0, "buildings": 0, "railway": False,
}  # fmt: skip
"""Scene settings of bare banks: terrain and water only."""


def survey_settings(
    twin: Mapping[str, Any], *, seed: int = 1, mounts: Mapping[str, Any] | None = None, **sections: Any
) -> dict[str, Any]:
    """All settings of a campaign of the twin as plain values: defaults wherever nothing is said.

    Parameters
    ----------
    twin : section ``twin``.
    seed : seed of the campaign.
    mounts : section ``mounts``; by default `MOUNTS`.
    sections : other sections of a campaign file, for instance ``reference={"cell_m": 0.1}``.

    Raises
    ------
    ValidationError : a value that a campaign file may not have.
    """
    plain = Campaign.model_validate(
        {
            "campaign": {"id": "survey", "title": "Survey of the twin", "seed": seed, **PLACE},
            "twin": twin,
            "mounts": MOUNTS if mounts is None else mounts,
            **sections,
        }
    ).plain()
    del plain["lidar"]["clock"]  # the lidar of the twin knows GPS time
    return plain


@dataclass(frozen=True, slots=True, kw_only=True)
class Logs:
    """What the instruments of the twin wrote, and what only the twin knows.

    Parameters
    ----------
    folder : where all of it lies.
    settings : all sections of the campaign, see `survey_settings`.
    scene, shots : truth: the river reach and where each return came from.
    true_mounts : truth: section ``mounts`` with the mounts that the sensors really have.
    pcap, anpp, pos : logs of lidar, INS and receiver (post-processed track).
    scans : terrestrial scans; may be none.
    nmea : log of the echo sounder; None: the boat had none.
    """

    folder: Path
    settings: Mapping[str, Any]
    scene: Path
    shots: Path
    true_mounts: Mapping[str, Any]
    pcap: Path
    anpp: Path
    pos: Path
    scans: tuple[Path, ...]
    nmea: Path | None = None

    @property
    def twin(self) -> TwinConfig:
        """Section ``twin``."""
        return TwinConfig(**self.settings["twin"])

    @property
    def seed(self) -> int:
        """Seed of the campaign."""
        return int(self.settings["campaign"]["seed"])

    @property
    def frame(self) -> LocalFrame:
        """The world frame."""
        return LocalFrame(**self.settings["campaign"]["origin"])

    def truth(self) -> Truth:
        """What `thalweg_lab.truth.points` compares with."""
        reach, twin = Scene.read(self.scene), self.twin
        return Truth(
            trajectory=true_trajectory(Voyage(twin, self.seed), self.frame),
            mount=Rigid.from_mount(self.true_mounts["lidar"]),
            surface=reach.caster(),
            bare_ground=BARE_GROUND[reach.material],
            divergence_rad=twin.lidar.divergence_mrad / 1000.0,
        )

    def returns(self) -> TrueReturns:
        """Where the returns of the lidar came from."""
        return TrueReturns.from_table(
            read_table(self.shots, LIDAR_SHOTS)[0], {int(k): k.name for k in EchoKind}
        )

    def remove(self) -> None:
        """Delete the folder: studies over many seeds keep numbers, not logs."""
        shutil.rmtree(self.folder)


@dataclass(frozen=True, slots=True, kw_only=True)
class Survey:
    """What the processing made of logs.

    Parameters
    ----------
    logs : its raw logs, with the truth.
    settings : the settings it was processed with.
    trajectory, mount : poses of the boat and mount of the scanner that the cloud was made with.
    points : cloud in the world frame, LAZ with full covariance of each point.
    counts : what became of the shots, columns ``reason, n``.
    """

    logs: Logs
    settings: Mapping[str, Any]
    trajectory: Trajectory
    mount: Rigid
    points: Path
    counts: pd.DataFrame

    def errors(self, max_points: int = 20_000) -> PointErrors:
        """Errors along the normal of the true surface, of points that come from bare ground alone."""
        cloud, row, returns = self._known(max_points)
        bare = np.append(BARE_GROUND, np.zeros(256 - len(BARE_GROUND), dtype=np.bool_))
        corrections = VLP16.vertical_by_ring_m * self.settings["lidar"]["vertical_corrections"]
        return point_errors(
            cloud["xyz_m"],
            cloud["t_gps_s"],
            cloud_covariance(cloud, self.points),
            corrections[cloud["ring"]],
            estimated=self.trajectory,
            mount=self.mount,
            truth=self.logs.truth(),
            from_ground=(returns.kind[row] == EchoKind.SURFACE) & bare[returns.material[row]],
        )

    def errors_3d(self, max_points: int = 20_000) -> PointErrors3d:
        """Errors in three dimensions, of points whose echo came from a single surface."""
        cloud, row, returns = self._known(max_points)
        single = returns.kind[row] == EchoKind.SURFACE
        return point_errors_3d(
            {name: values[single] for name, values in cloud.items()},
            returns.point_wcs_m[row[single]],
            where=self.points,
        )

    def _known(self, max_points: int) -> tuple[dict[str, Any], Any, TrueReturns]:
        """A sample of the cloud, the true returns and the row of each point in them."""
        returns = self.logs.returns()
        cloud = sample_of_known_points(self.points, returns, max_points)
        return cloud, cloud["true_row"], returns


def record(
    settings: Mapping[str, Any],
    folder: Path,
    *,
    scene: Path | None = None,
    stations: int = 0,
    echo: bool = False,
) -> Logs:
    """Let the twin's instruments record a survey.

    Parameters
    ----------
    settings : all sections of a campaign, see `survey_settings`.
    folder : where to write; it is made.
    scene : a scene of `simulate_scene` for the same settings, if there is one already: several seeds may
    share
        the river (``twin.scene.seed``). By default it is made.
    stations : number of terrestrial scans of the right bank.
    echo : the echo sounder records too.
    """
    twin, seed = TwinConfig(**settings["twin"]), int(settings["campaign"]["seed"])
    frame = LocalFrame(**settings["campaign"]["origin"])
    folder.mkdir(parents=True, exist_ok=True)
    if scene is None:
        scene = folder / "scene.npz"
        simulate_scene(twin, seed, scene)
    true = true_mounts(settings["mounts"], seed, on=twin.effects.mount_errors)
    scanner = Rigid.from_mount(true["lidar"])
    logs = Logs(
        folder=folder,
        settings=settings,
        scene=scene,
        shots=folder / "shots.parquet",
        true_mounts=true,
        pcap=folder / "lidar.pcap",
        anpp=folder / "ins.anpp",
        pos=folder / "track.pos",
        scans=tuple(folder / f"scan_{number}.laz" for number in range(1, stations + 1)),
        nmea=folder / "echo.nmea" if echo else None,
    )
    simulate_lidar(
        twin,
        seed,
        frame,
        scene,
        logs.pcap,
        R_ics_scs=scanner.R,
        lever_ics_scs_m=scanner.shift_m,
        out_shots=logs.shots,
    )
    simulate_ins(twin, seed, frame, logs.anpp)
    antenna = true["antenna"]["lever_ics_m"]
    simulate_gnss(twin, seed, frame, None, logs.pos, lever_ics_antenna_m=antenna, scene=scene)
    if logs.nmea is not None:
        face = true["echo_sounder"]["lever_ics_m"]
        simulate_echo(twin, seed, frame, scene, logs.nmea, lever_ics_echo_m=face)
    if stations:
        simulate_tls(twin, seed, frame, scene, list(logs.scans), crs=settings["campaign"]["crs"])
    return logs


def process(
    logs: Logs,
    settings: Mapping[str, Any] | None = None,
    *,
    trajectory_late_s: float = 0.0,
    name: str = "points",
    estimate: bool = False,
) -> Survey:
    """Make a trajectory and a cloud of raw logs.

    Parameters
    ----------
    logs : from `record`; only its files are read, and where the world frame is.
    settings : by default those that the logs were recorded with. Others may be wrong on purpose: a mount that
        the sensors do not have, a sigma that is too small.
    trajectory_late_s : the poses get stamps that are so much too late against the lidar's.
    name : of the cloud in the folder of the logs, without suffix.
    estimate : estimate the errors of the poses from the survey, as the workflow does; by default the stated
        sigmas are taken as certain, which tests their propagation alone.
    """
    trajectory, beam = ins_trajectory(logs, settings), None
    if estimate:
        model = pose_errors(logs, trajectory, settings)
        trajectory, beam = model.apply(trajectory, _antenna_lever_m(logs, settings)), model.beam
    if trajectory_late_s:
        trajectory = replace(trajectory, t_gps_s=trajectory.t_gps_s + trajectory_late_s)
    return orient(logs, trajectory, settings, name=name, beam=beam)


def ins_trajectory(
    logs: Logs,
    settings: Mapping[str, Any] | None = None,
    *,
    positions: pd.DataFrame | None = None,
    states: pd.DataFrame | None = None,
) -> Trajectory:
    """Trajectory by INS and antenna of raw logs; ``settings`` as for `process`.

    Parameters
    ----------
    positions, states : tables in place of those in the logs.
    """
    s = logs.settings if settings is None else settings
    antenna, orientation = s["mounts"]["antenna"], s["orientation"]
    trajectory, _ = build_trajectory(
        read_pos([logs.pos]).positions if positions is None else positions,
        read_anpp([logs.anpp]).states if states is None else states,
        logs.frame,
        lever_ics_antenna_m=antenna["lever_ics_m"],
        sigma_lever_m=antenna["sigma_lever_m"],
        sigma_attitude_rad=np.deg2rad([s["ins"][f"sigma_{a}_deg"] for a in ("roll", "pitch", "heading")]),
        **{
            key: orientation[key]
            for key in ("accept_fixes", "max_gap_s", "max_attitude_gap_s", "interpolation")
        },
    )
    return trajectory


def _antenna_lever_m(logs: Logs, settings: Mapping[str, Any] | None) -> ArrayF:
    return np.asarray((settings or logs.settings)["mounts"]["antenna"]["lever_ics_m"], dtype=np.float64)


def pose_errors(logs: Logs, trajectory: Trajectory, settings: Mapping[str, Any] | None = None) -> ErrorModel:
    """Error model of the poses, from surfaces that the lidar saw again; ``settings`` as for `process`."""
    s = logs.settings if settings is None else settings
    log = lidar_reader([logs.pcap], LidarOptions(**s["lidar"]))
    return error_model_of_log(
        log,
        log.scan().clock,
        trajectory,
        log_settings(s, Rigid.from_mount(s["mounts"]["lidar"])),
        positions_t_gps_s=read_pos([logs.pos]).positions["t_gps_s"].to_numpy(),
        lever_ics_antenna_m=_antenna_lever_m(logs, s),
        settings=s["orientation"]["error_model"] | {"estimate": True},
    )


def log_settings(s: Mapping[str, Any], mount: Rigid) -> LogSettings:
    """How a log becomes points, with the full covariance of each."""
    wanted = {key: value for key, value in s["georeferencing"].items() if key != "export_map"}
    return LogSettings(
        mount=mount,
        beam=LidarAccuracy(**s["lidar_accuracy"]),
        filters=Filters(**s["filters"]),
        **(wanted | {"correlations": True}),
    )


def orient(
    logs: Logs,
    trajectory: Trajectory,
    settings: Mapping[str, Any] | None = None,
    *,
    name: str = "points",
    mount: Rigid | None = None,
    beam: Mapping[str, float] | None = None,
) -> Survey:
    """Make a cloud of the lidar log with any trajectory.

    Parameters
    ----------
    logs : from `record`.
    trajectory : poses of the boat.
    settings, name : as for `process`.
    mount : of the scanner; by default that of the settings.
    beam : factors on the stated sigmas of a single measurement.
    """
    s = logs.settings if settings is None else settings
    log = lidar_reader([logs.pcap], LidarOptions(**s["lidar"]))
    mount = Rigid.from_mount(s["mounts"]["lidar"]) if mount is None else mount
    how = log_settings(s, mount)
    points = logs.folder / f"{name}.laz"
    counts = georeference_log(
        log,
        log.scan().clock,
        trajectory,
        how if beam is None else replace(how, beam=how.beam.scaled(**beam)),
        points,
    )
    return Survey(logs=logs, settings=s, trajectory=trajectory, mount=mount, points=points, counts=counts)


def reference_mesh(
    logs: Logs, track_m: ArrayF, settings: Mapping[str, Any] | None = None
) -> tuple[TriangleMesh, dict[str, Any]]:
    """Make a mesh of the terrestrial scans.

    Parameters
    ----------
    logs : with scans.
    track_m : (n, 3) positions of the boat in wcs: the side that the mesh's front is on.
    settings : by default those that the logs were recorded with.

    Returns
    -------
    mesh, facts : see `thalweg.surface.reference.mesh_reference`.
    """
    s = logs.settings if settings is None else settings
    cloud = logs.folder / "reference.laz"
    gather_reference(list(logs.scans), cloud, logs.frame, s["campaign"]["crs"])
    points = np.concatenate([chunk["xyz_m"] for chunk in iter_laz(cloud, 5_000_000)])
    return mesh_reference(points, track_m=track_m, settings=ReferenceSettings(**s["reference"]))
