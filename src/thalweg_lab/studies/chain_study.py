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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.accuracy import (
    ALL,
    WITHOUT_OUTLIERS,
    ComparisonSettings,
    compare_with_mesh,
    point_sets,
    predicted_sigma_m,
)
from thalweg.core import (
    ArrayF,
    ErrorChain,
    LocalFrame,
    Rigid,
    Trajectory,
    exp_rotation,
    opk_axes,
    root_mean_square,
)
from thalweg.core.geometry import TriangleMesh
from thalweg.images.model import ImagePoses
from thalweg.ingest.anpp import read_anpp
from thalweg.ingest.tracks import read_pos
from thalweg.navigation.camera import CloudSettings, camera_trajectory, lidar_mount_by_camera
from thalweg.navigation.fusion import FusionSettings, fuse_trajectory, with_own_jitter
from thalweg.settings.sections import Accuracy, CameraCloud, Fused, ReferenceSettings
from thalweg.surface import Area, Surface
from thalweg_lab.random_numbers import generator, lasting
from thalweg_lab.reach import River
from thalweg_lab.settings import TwinConfig
from thalweg_lab.studies.outage import drawn_poses
from thalweg_lab.studies.study import Result, Seed, Study, Tables, joined
from thalweg_lab.studies.survey import Logs, ins_trajectory, orient, record, reference_mesh, survey_settings
from thalweg_lab.truth import OWN_TIMES, carried_by_camera, chains_truth_table
from thalweg_lab.voyage import Motion, Voyage, true_trajectory

CHAINS: Final = ("ins", "camera", "fused")
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
        "phi_deg": -90.0,
        "lever_ics_m": (-0.35, 0.0, -0.25),
        "sigma_axes": "ics",
        "sigma_omega_deg": 0.018,
        "sigma_phi_deg": 0.009,
        "sigma_kappa_deg": 0.004,
        "sigma_lever_m": (0.0005, 0.0002, 0.0001),
    },
    "camera": {
        "omega_deg": -90.0,
        "kappa_deg": 180.0,
        "lever_ics_m": (-0.25, 0.10, -0.18),
        "sigma_axes": "ics",
        "sigma_omega_deg": 0.067,
        "sigma_phi_deg": 0.035,
        "sigma_kappa_deg": 0.015,
        "sigma_lever_m": (0.001, 0.0004, 0.0002),
    },
    "antenna": {"lever_ics_m": (0.1, 0.0, -0.45), "sigma_lever_m": (0.002, 0.002, 0.002)},
}
"""Sigmas of the mounts: T Table 3.1 for the lidar, those of P2 Table 1 for the camera."""
DISTURBANCES: Final[dict[str, Any]] = {
    "ins": {
        "motor_field_mg": ((2.2, 5.4, 0.8), (-2.2, 5.4, 0.8)),
        "hard_iron_mg": (2.7, 1.6, 0.0),
        "heading_drift_degpmin": 0.1,
    },
    "gnss": {"shadow": True, "multipath_m": 0.05},
}
"""What no sigma states: fields at the magnetometer, drift of the heading, shadows and reflections."""
TURN_RATE_DEGPS: Final = 20.0
"""Greatest turn rate, with which the root mean square about the vertical is 7 degrees/s: the angular speed
that P2 6.1.2 and T 3.1.2 assume for every moment."""
CLEAN: Final[dict[str, Any]] = {"gnss": {"shadow": False}}

DISTURBED: Final = "disturbed"
UNDISTURBED: Final = "undisturbed"
"""Names of the settings with and without `thalweg_lab.studies.chain_study.DISTURBANCES`."""
_NO_POSE: Final = ("no_gps_time", "no_pose")
_TRUTH: Final = (
    ("rms_position", "rms_place_m"),
    ("rms_roll", "rms_roll_deg"),
    ("rms_pitch", "rms_pitch_deg"),
    ("rms_heading", "rms_heading_deg"),
    ("sigma_heading", "sigma_heading_deg"),
    ("normalised_pose", "normalised_pose"),
)


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


# ---------------------------------------------------------------- surveys


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


def survey_chains(seed: int, study: ChainStudy, world: World, folder: Path) -> Tables:
    """Survey the river once and compare the clouds of all chains; the files are deleted again.

    Returns
    -------
    tables : ``distances`` (kind ``cloud_to_mesh``) and ``counts`` (what became of the shots) with ``chain``;
        ``truth``, errors of the poses (`chains_truth_table`); all with ``setting`` and ``seed``.
    """
    settings = study.settings(seed)
    logs = record(settings, folder, scene=world.scene)
    trajectories, mounts, used, _ = trajectories_of(logs, study.images)
    surface = Surface(world.mesh)
    how = comparison_settings(settings, seed)
    distances, counts = [], []
    for name in CHAINS:
        survey = orient(logs, trajectories[name], name=name, mount=mounts[name])
        found, _ = compare_with_mesh(
            survey.points, world.mesh, area=world.area, settings=how, surface=surface
        )
        distances.append(found.assign(chain=name))
        counts.append(survey.counts.assign(chain=name))
        survey.points.unlink()
    camera = Rigid.from_mount(logs.true_mounts["camera"])
    truth = chains_truth_table(
        trajectories,
        true_trajectory(Voyage(logs.twin, seed), logs.frame),
        correlation_s=how.correlation_s,
        carried={"camera": carried_by_camera(camera, used)},
    )
    logs.remove()
    tables = {"distances": pd.concat(distances), "counts": pd.concat(counts), "truth": truth}
    return {name: table.assign(setting=study.name, seed=seed) for name, table in tables.items()}


def trajectories_of(
    logs: Logs, errors: ImageErrors
) -> tuple[dict[str, Trajectory], dict[str, Rigid], Rigid, dict[str, Callable[[], list[ErrorChain]]]]:
    """Trajectories of all chains, and the lidar's mount that belongs to each.

    The settings are those of a campaign that says nothing of its errors: defaults. Behind both stand
    ``T_ics_ccs`` of the camera's, and what tells the chains of errors of camera and fused trajectory.
    """
    s = logs.settings
    places = s["mounts"]
    images = draw_images(
        logs.seed,
        Voyage(logs.twin, logs.seed),
        logs.frame,
        Rigid.from_mount(logs.true_mounts["camera"]),
        errors,
    )
    through, T_ics_ccs, _ = lidar_mount_by_camera(places, None)
    states = read_anpp([logs.anpp]).states
    ins: dict[str, Any] = {
        "sigma_attitude_rad": np.deg2rad([s["ins"][f"sigma_{a}_deg"] for a in ("roll", "pitch", "heading")]),
        "max_attitude_gap_s": s["orientation"]["max_attitude_gap_s"],
    }
    by_camera = camera_trajectory(
        images, T_ics_ccs, CloudSettings.of(CameraCloud(**s["images"]["cloud"])), states=states, **ins
    )
    by_all = fuse_trajectory(
        states,
        logs.frame,
        FusionSettings.of(Fused(**s["fused"])),
        positions=read_pos([logs.pos]).positions,
        lever_ics_antenna_m=places["antenna"]["lever_ics_m"],
        sigma_lever_m=places["antenna"]["sigma_lever_m"],
        images=with_own_jitter(images),
        T_ccs_ics=Rigid.from_mount(places["camera"]).inverse(),
        **ins,
    )
    own = Rigid.from_mount(places["lidar"])
    trajectories = {"ins": ins_trajectory(logs), "camera": by_camera.trajectory, "fused": by_all.trajectory}
    mounts = {"ins": own, "camera": Rigid.from_mount(through["lidar"]), "fused": own}
    chains = {"camera": by_camera.error_chains, "fused": by_all.error_chains}
    return trajectories, mounts, T_ics_ccs, chains


def comparison_settings(settings: Mapping[str, Any], seed: int) -> ComparisonSettings:
    """How clouds are compared: as in a campaign, with fewer points."""
    accuracy = Accuracy(**{**settings["accuracy"], "max_points": MAX_POINTS})
    return ComparisonSettings.of(accuracy, ReferenceSettings(**settings["reference"]), seed)


# ---------------------------------------------------------------- poses of images drawn about the true motion
# with errors of stated sigmas, as a block of images gives them
#
# Rendering and orienting images costs seconds an image. What the trajectories take from them is a pose, its
# covariance and a time; here these are drawn, with the published sigmas if nothing is said (P2 Table 1).


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
    white = generator(seed, "drawn images poses").standard_normal((n, 6))
    unit = lasting(white, errors.interval_s, errors.time_s)
    # an error moves the estimate to the truth
    error = np.einsum("nij,nj->ni", root, unit)
    following = np.zeros((n, 6, 6))
    following[:-1] = keep * root[:-1] @ np.swapaxes(root[1:], 1, 2)
    poses = drawn_poses(
        frame,
        stamp,
        np.hypot(errors.jitter_s, errors.sigma_clock_s),
        motion.position_wcs_m(exposed) + R_wcs_ics @ true_T_ics_ccs.shift_m - error[:, :3],
        exp_rotation(-error[:, 3:]) @ R,
        root @ np.swapaxes(root, 1, 2),
        following,
    )
    facts = {"image_times": {"sigma_common_s": errors.sigma_clock_s, "independent_of_ins": True}}
    return replace(poses, facts=facts)


def _roots(R_wcs_ccs: ArrayF, errors: ImageErrors) -> ArrayF:
    """Roots (n, 6, 6) of the covariances in wcs; the sigmas of angles act about the axes of the angles."""
    phi = np.arcsin(np.clip(R_wcs_ccs[:, 0, 2], -1.0, 1.0))
    omega = np.arctan2(-R_wcs_ccs[:, 1, 2], R_wcs_ccs[:, 2, 2])
    root = np.zeros((len(R_wcs_ccs), 6, 6))
    root[:, :3, :3] = np.diag(errors.sigma_m)
    root[:, 3:, 3:] = opk_axes(omega, phi) * np.deg2rad(errors.sigma_opk_deg)
    return root


# ---------------------------------------------------------------- tables and goals


@dataclass(frozen=True, slots=True, kw_only=True)
class Goal:
    """What was asked for: a column of `study_table` between ``low_m`` and ``high_m``, for a chain."""

    words: str
    chain: str
    quantity: str
    low_m: float
    high_m: float


GOALS: Final = (
    Goal(words="INS near 23 cm RMSE (T 3.1.3)", chain="ins", quantity="rmse_m", low_m=0.18, high_m=0.28),
    Goal(words="camera near 14 cm RMSE (P2 6.2)", chain="camera", quantity="rmse_m", low_m=0.11, high_m=0.17),
    Goal(words="fused at most 8 cm RMSE", chain="fused", quantity="rmse_m", low_m=0.0, high_m=0.08),
    Goal(words="fused at most 2 cm mean", chain="fused", quantity="mean_m", low_m=-0.02, high_m=0.02),
)
"""Near: within a fifth."""


def both_settings() -> list[ChainStudy]:
    """The surveys with and without disturbances."""
    return [ChainStudy.of(DISTURBED, DISTURBANCES), ChainStudy.of(UNDISTURBED, CLEAN)]


def study_table(tables: Tables) -> pd.DataFrame:
    """One row a setting, chain and set of points, from the tables of `survey_chains` of all surveys.

    Columns ``setting, chain, points, surveys, n``; ``mean_m`` with ``sigma_mean_m`` of the spread over the
    surveys; ``std_m, rmse_m`` of all points together, ``rmse_least_m, rmse_most_m`` of single surveys;
    ``predicted_rmse_m``; ``share_with_pose`` of the shots; ``mean_range_m``; errors of the poses against the
    truth: ``rms_place_m`` and so on, root mean square over the surveys.
    """
    rows = []
    for (setting, name), distances in tables["distances"].groupby(["setting", "chain"], sort=False):
        truth = tables["truth"].query("setting == @setting")
        counts = tables["counts"].query("setting == @setting and chain == @name")
        share = float(np.mean([_share(part) for _, part in counts.groupby("seed", sort=False)]))
        surveys = [part for _, part in distances.groupby("seed", sort=False)]
        for points in (ALL, WITHOUT_OUTLIERS):
            parts = [part[point_sets(part)[points]] for part in surveys]
            rows.append(
                dict[str, Any](setting=setting, chain=name, points=points, surveys=len(parts))
                | _distances(parts)
                | {"share_with_pose": share}
                | _truth(truth, str(name))
            )
    return pd.DataFrame(rows)


def goals_table(table: pd.DataFrame) -> pd.DataFrame:
    """What was asked for with the disturbances on, and what came out.

    Columns ``goal, chain, low_m, high_m, found_m`` (without outliers), ``found_all_m`` (all points), ``met``
    (of the first) and ``missed_by_m``, 0 if met.
    """
    rows = []
    for goal in GOALS:
        of = table[(table["setting"] == DISTURBED) & (table["chain"] == goal.chain)]
        value = dict(zip(of["points"], of[goal.quantity], strict=True))
        found = float(value[WITHOUT_OUTLIERS])
        missed = max(goal.low_m - found, found - goal.high_m, 0.0)
        rows.append(
            {
                "goal": goal.words,
                "chain": goal.chain,
                "low_m": goal.low_m,
                "high_m": goal.high_m,
                "found_m": found,
                "found_all_m": float(value[ALL]),
                "met": missed == 0.0,
                "missed_by_m": missed,
            }
        )
    return pd.DataFrame(rows)


def _distances(parts: Sequence[pd.DataFrame]) -> dict[str, float]:
    d = [part["distance_m"].to_numpy(np.float64) for part in parts if len(part)]
    whole = np.concatenate(d)
    sigma = np.concatenate([predicted_sigma_m(part) for part in parts])
    means, single = np.array([x.mean() for x in d]), [root_mean_square(x) for x in d]
    return {
        "n": len(whole),
        "mean_m": float(whole.mean()),
        "sigma_mean_m": float(means.std(ddof=1) / np.sqrt(len(d))) if len(d) > 1 else float("nan"),
        "std_m": float(whole.std()),
        "rmse_m": root_mean_square(whole),
        "rmse_least_m": min(single),
        "rmse_most_m": max(single),
        "predicted_rmse_m": root_mean_square(sigma),
        "mean_range_m": float(np.mean(np.concatenate([part["range_m"].to_numpy() for part in parts]))),
    }


def _truth(truth: pd.DataFrame, chain: str) -> dict[str, float]:
    """Errors of the poses of a chain at its own times, over all surveys."""
    own = truth[truth["times"] == OWN_TIMES].groupby("quantity")[chain]
    return {
        column: float(own.get_group(quantity).mean())
        if quantity.startswith("normalised")
        else root_mean_square(own.get_group(quantity))
        for quantity, column in _TRUTH
    }


def _share(counts: pd.DataFrame) -> float:
    n = dict(zip(counts["reason"], counts["n"], strict=True))
    return 1.0 - sum(n.get(reason, 0) for reason in _NO_POSE) / sum(n.values())


# ---------------------------------------------------------------- rows of one seed, and what comes of all


def _study_rows(seed: Seed) -> Tables:
    """Both settings are surveys of one scene."""
    settings = both_settings()
    world = make_world(settings[0], seed.folder / "world")
    return joined([survey_chains(seed.number, each, world, seed.folder / each.name) for each in settings])


def _study_results(tables: Tables, files: Sequence[Path]) -> Mapping[str, Result]:
    table = study_table(tables)
    return {"table": table, "goals": goals_table(table)}


STUDY: Final = Study(rows=_study_rows, results=_study_results)
