"""INS, camera and fused trajectory through the same rules to the same bank, over seeds (T 3.1.4).

Each seed is a survey of the digital twin with logs of its own: INS and receiver err as their published sigmas
say, and by what no sigma says: fields of the motors and of the hull at the magnetometer, a drifting heading,
leaves that dim satellites and reflections from the water. Poses of images are drawn with the published
sigmas of poses and times, not rendered. From there on all is the
code of a campaign: three trajectories, three clouds with the same filters, one reference of terrestrial
scans, one outlier rule.

Two things of this study are put in and must not be read as findings. What a boat does to its INS is not
published: nine components of magnetic fields (two motors and the hull, three axes each), a drift of the
heading, the size of multipath and the turn rate are free, `DISTURBANCES` and `TURN_RATE_DEGPS`. They were
chosen so that the cloud by the INS comes near the published RMSE, which is met by an input chosen for it;
camera and fused trajectory follow. And the poses of the camera are not measured: they are drawn with the
sigmas that P2 Table 1 publishes and a jitter of 23 ms, so that the camera's RMSE is the propagation of these
assumed inputs, and the processing knows them.
"""

import logging
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.accuracy.cloud_to_mesh.comparison import ComparisonSettings, compare_with_mesh
from thalweg.accuracy.solutions.comparison import CHAINS
from thalweg.core.frames import LocalFrame, opk_axes
from thalweg.core.geometry.mesh import TriangleMesh
from thalweg.core.rigid import Rigid, exp_rotation
from thalweg.core.trajectory import Trajectory
from thalweg.core.types import ArrayF
from thalweg.images.model.poses import ImagePoses
from thalweg.ingest.anpp.reader import read_anpp
from thalweg.ingest.tracks.rtklib_pos import read_pos
from thalweg.lidar.mount import Mount
from thalweg.navigation.camera.mounts import lidar_mount_by_camera
from thalweg.navigation.camera.settings import CloudSettings
from thalweg.navigation.camera.trajectory import camera_trajectory
from thalweg.navigation.fusion.inputs import with_own_jitter
from thalweg.navigation.fusion.settings import FusionSettings
from thalweg.navigation.fusion.trajectory import fuse_trajectory
from thalweg.settings.twin.sections import TwinConfig
from thalweg.surface.area import Area
from thalweg.surface.cloud_to_mesh import Surface
from thalweg_lab.base.random import generator
from thalweg_lab.base.river import River
from thalweg_lab.studies.survey import (
    Logs,
    ins_trajectory,
    orient,
    record,
    reference_mesh,
    survey_settings,
)
from thalweg_lab.truth.solutions import (
    carried_by_camera,
    chains_truth_table,
)
from thalweg_lab.voyage.motion import Motion
from thalweg_lab.voyage.truth import true_trajectory
from thalweg_lab.voyage.voyage import Voyage

# ---------------------------------------------------------------- poses of images drawn about the true motion
# with errors of stated sigmas, as a block of images gives them
#
# Rendering and orienting images costs seconds an image. What the trajectories take from them is a pose, its
# covariance and a time; here these are drawn, with the published sigmas if nothing is said (P2 Table 1).


MARKS: Final = 300.0
RESIDUAL_PX: Final = 0.5
"""What the table of poses says of the marks of an image; no trajectory uses it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageErrors:
    """How poses and times of images err.

    Parameters
    ----------
    sigma_m : (3,) of the projection centre, east, north, up.
    sigma_opk_deg : (3,) of omega, phi, kappa of ``R_wcs_ccs``.
    time_s : correlation time of both along the series; the papers do not state one.
    jitter_s : scatter of the single times.
    sigma_clock_s : of an offset that all times share (P2: 4 ms).
    interval_s : between images.
    """

    sigma_m: tuple[float, float, float] = (0.0051, 0.0054, 0.0051)
    sigma_opk_deg: tuple[float, float, float] = (0.078, 0.004, 0.078)
    time_s: float = 4.0
    jitter_s: float = 0.023
    sigma_clock_s: float = 0.004
    interval_s: float = 1.0


def draw_images(
    seed: int, motion: Motion, frame: LocalFrame, true_T_ics_ccs: Rigid, errors: ImageErrors
) -> ImagePoses:
    """Poses of images of a voyage with the errors of a block and of the camera's clock.

    Parameters
    ----------
    seed : of the survey; poses, jitter and offset have random numbers of their own.
    motion : the true one.
    frame : the world frame.
    true_T_ics_ccs : where the camera really sits.
    errors : their sizes.
    """
    stamp = motion.start_gps_s + np.arange(0.5, motion.config.duration_s - 0.5, errors.interval_s)
    n = len(stamp)
    clock_s = errors.sigma_clock_s * float(generator(seed, "drawn images clock").standard_normal())
    jitter = errors.jitter_s * generator(seed, "drawn images jitter").standard_normal(n)
    exposed = stamp + clock_s + jitter
    R_wcs_ics = motion.R_wcs_ics(exposed)
    R = R_wcs_ics @ true_T_ics_ccs.R
    root = _roots(R, errors)
    keep = float(np.exp(-errors.interval_s / errors.time_s))
    unit = generator(seed, "drawn images poses").standard_normal((n, 6))
    for k in range(1, n):
        unit[k] = keep * unit[k - 1] + np.sqrt(1 - keep**2) * unit[k]
    # an error moves the estimate to the truth
    error = np.einsum("nij,nj->ni", root, unit)
    following = np.zeros((n, 6, 6))
    following[:-1] = keep * root[:-1] @ np.swapaxes(root[1:], 1, 2)
    return ImagePoses(
        frame=frame,
        images=tuple(f"{k:05d}.jpg" for k in range(n)),
        t_gps_s=stamp,
        sigma_t_s=np.full(n, np.hypot(errors.jitter_s, errors.sigma_clock_s)),
        oriented=np.ones(n, dtype=np.bool_),
        reasons=("",) * n,
        centre_wcs_m=motion.position_wcs_m(exposed) + R_wcs_ics @ true_T_ics_ccs.shift_m - error[:, :3],
        R_wcs_ccs=exp_rotation(-error[:, 3:]) @ R,
        cov_pose_wcs=root @ np.swapaxes(root, 1, 2),
        cov_next=following,
        n_marks=np.full(n, MARKS),
        rms_px=np.full(n, RESIDUAL_PX),
        facts={"image_times": {"sigma_common_s": errors.sigma_clock_s, "independent_of_ins": True}},
    )


def _roots(R_wcs_ccs: ArrayF, errors: ImageErrors) -> ArrayF:
    """Roots (n, 6, 6) of the covariances in wcs; the sigmas of angles act about the axes of the angles."""
    phi = np.arcsin(np.clip(R_wcs_ccs[:, 0, 2], -1.0, 1.0))
    omega = np.arctan2(-R_wcs_ccs[:, 1, 2], R_wcs_ccs[:, 2, 2])
    root = np.zeros((len(R_wcs_ccs), 6, 6))
    root[:, :3, :3] = np.diag(errors.sigma_m)
    root[:, 3:, 3:] = opk_axes(omega, phi) * np.deg2rad(errors.sigma_opk_deg)
    return root


# ---------------------------------------------------------------- chain study


STATIONS: Final = 3
MAX_POINTS: Final = 60_000
"""Points of a cloud that are compared."""

RIVER_SEED: Final = 1
"""All seeds survey the same river: scene and terrestrial scans are made once."""

LOWEST_M: Final = 0.15
"""Nearer to the water waves and mirror images mix with the bank."""

APART_S: Final = 1e5
"""Surveys of different seeds are so far apart in time that none of their errors are taken for shared."""

MOUNTS: Final[dict[str, Any]] = {
    "lidar": {
        "phi_deg": -90.0, "lever_ics_m": (-0.35, 0.0, -0.25), "sigma_axes": "ics", "sigma_omega_deg": 0.018,
        "sigma_phi_deg": 0.009, "sigma_kappa_deg": 0.004, "sigma_lever_m": (0.0005, 0.0002, 0.0001),
    },
    "camera": {
        "omega_deg": -90.0, "kappa_deg": 180.0, "lever_ics_m": (-0.25, 0.10, -0.18), "sigma_axes": "ics",
        "sigma_omega_deg": 0.067, "sigma_phi_deg": 0.035, "sigma_kappa_deg": 0.015,
        "sigma_lever_m": (0.001, 0.0004, 0.0002),
    },
    "antenna": {"lever_ics_m": (0.1, 0.0, -0.45), "sigma_lever_m": (0.002, 0.002, 0.002)},
}  # fmt: skip
"""Sigmas of the mounts: T Table 3.1 for the lidar, those of P2 Table 1 for the camera."""

DISTURBANCES: Final[dict[str, Any]] = {
    "ins": {
        "motor_field_mg": ((2.2, 5.4, 0.8), (-2.2, 5.4, 0.8)), "hard_iron_mg": (2.7, 1.6, 0.0),
        "heading_drift_degpmin": 0.1,
    },
    "gnss": {"shadow": True, "multipath_m": 0.05},
}  # fmt: skip
"""What no sigma states: fields at the magnetometer, drift of the heading, shadows and reflections."""

TURN_RATE_DEGPS: Final = 20.0
"""Greatest turn rate, with which the root mean square about the vertical is 7 degrees/s: the angular speed
that P2 6.1.2 and T 3.1.2 assume for every moment."""

CLEAN: Final[dict[str, Any]] = {"gnss": {"shadow": False}}


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainStudy:
    """What is surveyed.

    Parameters
    ----------
    name : of the setting, in tables.
    twin : section ``twin`` of a campaign file.
    reference : section ``reference``.
    images : how poses and times of images err.
    """

    name: str
    twin: Mapping[str, Any]
    reference: Mapping[str, Any]
    images: ImageErrors = field(default_factory=ImageErrors)

    @classmethod
    def of(
        cls,
        name: str,
        disturbances: Mapping[str, Any],
        twin: Mapping[str, Any] | None = None,
        reference: Mapping[str, Any] | None = None,
        images: ImageErrors | None = None,
    ) -> "ChainStudy":
        """The voyage of the demo, turning as fast as the published error budgets assume."""
        base: dict[str, Any] = {"size": "demo", "duration_s": 120.0} | dict(twin or {})
        base["scene"] = {"seed": RIVER_SEED} | dict(base.get("scene", {}))
        base["boat"] = {"turn_rate_degps": TURN_RATE_DEGPS} | dict(base.get("boat", {}))
        return cls(
            name=name,
            twin=base | dict(disturbances),
            reference=dict(reference or {}),
            images=images or ImageErrors(),
        )

    def settings(self, seed: int) -> dict[str, Any]:
        """All settings of a campaign."""
        return survey_settings(self.twin, seed=seed, mounts=MOUNTS, reference=self.reference)


@dataclass(frozen=True, slots=True, kw_only=True)
class World:
    """What all seeds share.

    ``scene`` its file, ``mesh`` of the terrestrial scans, ``area`` the slope of the right bank.
    """

    scene: Path
    mesh: TriangleMesh
    area: Area


def make_world(study: ChainStudy, folder: Path) -> World:
    """Build the river and scan its right bank."""
    settings = study.settings(RIVER_SEED)
    twin = TwinConfig(**settings["twin"])
    voyage = Voyage(twin, RIVER_SEED)
    # the scans need no boat
    short = {**settings, "twin": {**settings["twin"], "duration_s": 1.0}}
    logs = record(short, folder, stations=STATIONS)
    every_s = np.arange(0.0, settings["twin"]["duration_s"], 1.0)
    mesh, _ = reference_mesh(logs, voyage.position_wcs_m(voyage.start_gps_s + every_s))
    return World(scene=logs.scene, mesh=mesh, area=bank_area(twin))


def bank_area(twin: TwinConfig) -> Area:
    """The slope of the right bank, from its toe to the crest: what P2 6.2 calls the railway embankment."""
    scene = twin.scene
    river = River(scene, RIVER_SEED)
    along = np.linspace(-scene.length_m / 2, scene.length_m / 2, 100)
    toe = -river.shores(along)[0]
    width_m = scene.embankment_height_m / np.tan(np.deg2rad(scene.embankment_slope_deg))
    edges = river.to_wcs(along, toe), river.to_wcs(along[::-1], toe[::-1] - width_m)
    return Area(
        polygon_en_m=np.concatenate(edges),
        lowest_m=scene.water_level_m + LOWEST_M,
        highest_m=scene.water_level_m + scene.embankment_height_m,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """What came of one survey: for each chain a table of kind ``cloud_to_mesh``, what became of its shots,
    the trajectory and the facts of the comparison; and the errors of the poses (`chains_truth_table`).
    """

    distances: dict[str, pd.DataFrame]
    counts: dict[str, pd.DataFrame]
    trajectories: dict[str, Trajectory]
    facts: dict[str, dict[str, Any]]
    truth: pd.DataFrame


def survey_chains(seed: int, study: ChainStudy, world: World, folder: Path) -> Found:
    """Survey the river once and compare the clouds of all chains; the files are deleted again."""
    logging.getLogger("thalweg").setLevel(logging.ERROR)
    settings = study.settings(seed)
    logs = record(settings, folder, scene=world.scene)
    trajectories, mounts, used = trajectories_of(logs, study.images)
    surface = Surface(world.mesh)
    how = comparison_settings(settings, seed)
    distances, counts, facts = {}, {}, {}
    for name in CHAINS:
        survey = orient(logs, trajectories[name], name=name, mount=mounts[name])
        distances[name], facts[name] = compare_with_mesh(
            survey.points, world.mesh, area=world.area, settings=how, surface=surface
        )
        counts[name] = survey.counts
        survey.points.unlink()
    camera = Mount.from_section(logs.true_mounts["camera"]).as_rigid()
    truth = chains_truth_table(
        trajectories,
        true_trajectory(Voyage(logs.twin, seed), logs.frame),
        correlation_s=how.correlation_s,
        carried={"camera": carried_by_camera(camera, used)},
    )
    logs.remove()
    return Found(distances=distances, counts=counts, trajectories=trajectories, facts=facts, truth=truth)


def trajectories_of(logs: Logs, errors: ImageErrors) -> tuple[dict[str, Trajectory], dict[str, Mount], Rigid]:
    """Trajectories of all chains, the lidar's mount that belongs to each, and ``T_ics_ccs`` of the camera's.

    The settings are those of a campaign that says nothing of its errors: defaults.
    """
    s = logs.settings
    places = s["mounts"]
    images = draw_images(
        logs.seed,
        Voyage(logs.twin, logs.seed),
        logs.frame,
        Mount.from_section(logs.true_mounts["camera"]).as_rigid(),
        errors,
    )
    through, T_ics_ccs, _ = lidar_mount_by_camera(places, None)
    states = read_anpp([logs.anpp]).states
    ins: dict[str, Any] = {
        "sigma_attitude_rad": np.deg2rad([s["ins"][f"sigma_{a}_deg"] for a in ("roll", "pitch", "heading")]),
        "max_attitude_gap_s": s["orientation"]["max_attitude_gap_s"],
    }
    by_camera = camera_trajectory(
        images, T_ics_ccs, CloudSettings.from_section(s["images"]["cloud"]), states=states, **ins
    )
    by_all = fuse_trajectory(
        states,
        logs.frame,
        FusionSettings.from_section(s["fused"]),
        positions=read_pos([logs.pos]).positions,
        lever_ics_antenna_m=places["antenna"]["lever_ics_m"],
        sigma_lever_m=places["antenna"]["sigma_lever_m"],
        images=with_own_jitter(images),
        T_ccs_ics=Mount.from_section(places["camera"]).as_rigid().inverse(),
        **ins,
    )
    own = Mount.from_section(places["lidar"])
    trajectories = {
        "ins": ins_trajectory(logs),
        "camera": by_camera.trajectory,
        "fused": by_all.trajectory,
    }
    return trajectories, {"ins": own, "camera": Mount.from_section(through["lidar"]), "fused": own}, T_ics_ccs


def comparison_settings(settings: Mapping[str, Any], seed: int) -> ComparisonSettings:
    """How clouds are compared: as in a campaign, with fewer points."""
    accuracy = {**settings["accuracy"], "max_points": MAX_POINTS}
    return ComparisonSettings.from_sections(accuracy, settings["reference"], seed)


def chain_study(
    folder: Path, studies: Sequence[ChainStudy], *, seeds: Sequence[int], processes: int = 2
) -> dict[str, list[Found]]:
    """Survey each setting with each seed; all of them must be of one scene.

    Parameters
    ----------
    folder : for files of the surveys, which are deleted again.
    studies : settings; the scene is that of the first.
    seeds : of the surveys.
    processes : surveys at a time.

    Returns
    -------
    Name of a setting -> what was found, in the order of the seeds.
    """
    world = make_world(studies[0], folder / "world")
    jobs = [(study, seed) for study in studies for seed in seeds]
    # Spawned: numba's threads do not survive a fork.
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        running = [
            pool.submit(survey_chains, seed, study, world, folder / f"{number}")
            for number, (study, seed) in enumerate(jobs)
        ]
        found = [job.result() for job in running]
    of: dict[str, list[Found]] = {study.name: [] for study in studies}
    for (study, _), each in zip(jobs, found, strict=True):
        of[study.name].append(each)
    return of
