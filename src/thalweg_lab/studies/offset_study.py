"""Why does a boat's cloud lie behind the reference? Each cause switched on alone, and all of them together.

P2 found its points 5 to 6 cm behind the mesh of a terrestrial scanner, and names as possible causes: plants,
which both scanners see differently, and the bank's slope together with the boat's wide beam, which makes
mixed signals (P2 section 7). In the digital twin each of them can be switched on alone. A cause
explains the change of the mean distance that it makes, survey by survey: the same seed shoots the same shots
from the same places, so that most of the noise cancels. Errors of poses and mounts are off but in the rows
that name them; they have no mean over many surveys, and a few seeds would not show one of some millimetres
beside them.

Distances are positive in front of the reference, toward the boat, and negative behind it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.accuracy import ComparisonSettings, after_motion, compare_with_mesh, register
from thalweg.core import GeometryError, root_mean_square
from thalweg.settings.sections import Accuracy, ReferenceSettings
from thalweg.surface import Area, Surface
from thalweg_lab.studies.study import Study
from thalweg_lab.studies.survey import BARE, process, record, reference_mesh, survey_settings

STATIONS: Final = 3
MAX_POINTS: Final = 50_000

_STEEP: Final[dict[str, Any]] = {
    "size": "demo",
    "duration_s": 12.0,
    "scene": BARE
    | {
        "length_m": 70.0,
        "width_m": 30.0,
        "grid_m": 0.1,
        "embankment_slope_deg": 60.0,
        "roughness_m": 0.0,
        "leaves_per_bush": 300,
        "leaves_per_tree": 1500,
        "bridge": False,
        "weir": False,
    },
    "boat": {"speed_mps": 2.0, "turn_rate_degps": 20.0},
    "lidar": {"divergence_mrad": 0.0, "mixed_pixels": False, "mirror_ghosts": False},
    "ins": {"sigma_roll_deg": 0.001, "sigma_pitch_deg": 0.001, "sigma_heading_deg": 0.001},
    "gnss": {"sigma_m": (0.001, 0.001, 0.001), "shadow": False},
    "tls": {"spacing_m": 0.05},
    "effects": {"mount_errors": False},
}
"""Bare, smooth bank, as steep as the twin makes one: nearly across the beams. No beam width, true poses."""

_SLOPE: Final[dict[str, Any]] = {"scene": {"embankment_slope_deg": 33.0}}
_WIDE: Final[dict[str, Any]] = {"lidar": {"divergence_mrad": 3.0}}
_MIXED: Final[dict[str, Any]] = {"lidar": {"mixed_pixels": True}}
_RELIEF: Final[dict[str, Any]] = {"scene": {"roughness_m": 0.06}}
_STONES: Final[dict[str, Any]] = {"scene": {"stones_per_m": 20.0, "cobbles_per_m": 100.0}}
_GRASS: Final[dict[str, Any]] = {"scene": {"grass_per_m": 40.0, "reeds_per_m": 6.0}}
_BUSHES: Final[dict[str, Any]] = {"scene": {"bushes_per_100m": 100.0}}
_TREES: Final[dict[str, Any]] = {"scene": {"trees_per_100m": 14.0}}
_GHOSTS: Final[dict[str, Any]] = {"lidar": {"mirror_ghosts": True}}
_POSES: Final[dict[str, Any]] = {
    "ins": {"sigma_roll_deg": 0.1, "sigma_pitch_deg": 0.1, "sigma_heading_deg": 0.2, "attitude_time_s": 1.0},
    "gnss": {"sigma_m": (0.020, 0.020, 0.030), "correlation_time_s": 1.0},
    "effects": {"mount_errors": True},
}


def _joined(*changes: Mapping[str, Any]) -> dict[str, Any]:
    """Changes of section ``twin`` one over the other."""
    out: dict[str, Any] = {}
    for change in changes:
        for key, value in change.items():
            below = out.get(key)
            out[key] = {**below, **value} if isinstance(below, dict) and isinstance(value, Mapping) else value
    return out


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """One row of the study.

    Parameters
    ----------
    name : in the table.
    against : name of the row that it is compared with; empty: with none.
    twin, reference : sections of the campaign file.
    """

    name: str
    against: str
    twin: Mapping[str, Any]
    reference: Mapping[str, Any] = field(default_factory=dict)


_BASE: Final = "bare bank of 60 degrees"
_SLOPED: Final = "slope of 33 degrees"
_NARROW: Final = "footprint of 3 mrad"
_BEAM_NAME: Final = "mixed pixels"
_POSE_ROW: Final = "errors of poses and mounts"
_SCENERY: Final = "all but poses and mounts"
_ALL: Final = "all together"
_LEFT_IN: Final = "plants left in the reference"

_BEAM: Final = _joined(_STEEP, _SLOPE, _WIDE, _MIXED)
_WHOLE: Final = _joined(_BEAM, _RELIEF, _STONES, _GRASS, _BUSHES, _TREES, _GHOSTS)

EFFECTS: Final = (
    Effect(name=_BASE, against="", twin=_STEEP),
    Effect(name=_SLOPED, against=_BASE, twin=_joined(_STEEP, _SLOPE)),
    Effect(name=_NARROW, against=_SLOPED, twin=_joined(_STEEP, _SLOPE, _WIDE)),
    Effect(name=_BEAM_NAME, against=_NARROW, twin=_BEAM),
    Effect(name="relief of the bank", against=_BEAM_NAME, twin=_joined(_BEAM, _RELIEF)),
    Effect(name="stones", against=_BEAM_NAME, twin=_joined(_BEAM, _STONES)),
    Effect(name="grass and reeds", against=_BEAM_NAME, twin=_joined(_BEAM, _GRASS)),
    Effect(name="bushes", against=_BEAM_NAME, twin=_joined(_BEAM, _BUSHES)),
    Effect(name="trees", against=_BEAM_NAME, twin=_joined(_BEAM, _TREES)),
    Effect(name="mirror ghosts", against=_BEAM_NAME, twin=_joined(_BEAM, _GHOSTS)),
    Effect(name=_POSE_ROW, against=_BEAM_NAME, twin=_joined(_BEAM, _POSES)),
    Effect(name=_SCENERY, against=_BASE, twin=_WHOLE),
    Effect(name=_ALL, against=_BASE, twin=_joined(_WHOLE, _POSES)),
    Effect(name=_LEFT_IN, against=_SCENERY, twin=_WHOLE, reference={"clearance_m": None}),
)
"""Rows in the order of the table: the base, each cause alone, everything, and a reference with its plants."""


PER_SURVEY: Final = ("n", "mean_m", "median_m", "rmse_m", "behind", "mean_registered_m", "rmse_registered_m")
"""What is kept of each survey: points, their signed distances, the share of points behind the reference,
and the same after the cloud was fitted to the reference by a rigid motion (NaN where that failed)."""


def distances(seed: int, folder: Path, effect: Effect) -> dict[str, float]:
    """Statistics of the distances of one survey, see `PER_SURVEY`. Its files are deleted again."""
    settings = survey_settings(effect.twin, seed=seed, reference=effect.reference)
    logs = record(settings, folder, stations=STATIONS)
    survey = process(logs)
    surface = Surface(reference_mesh(logs, survey.trajectory.position_wcs_m)[0])
    how = ComparisonSettings.of(
        Accuracy(**{**settings["accuracy"], "max_points": MAX_POINTS}),
        ReferenceSettings(**settings["reference"]),
    )
    table, _ = compare_with_mesh(survey.points, surface.mesh, area=Area(), settings=how, surface=surface)
    logs.remove()
    d = table.loc[table["used"], "distance_m"].to_numpy()
    try:
        motion = register(table, surface, how).motion
    except GeometryError:
        fitted = np.full(1, np.nan)
    else:
        places = motion.apply(table[["east_m", "north_m", "up_m"]].to_numpy())
        moved = after_motion(table, places, surface, how)
        fitted = moved.loc[moved["used"], "distance_m"].to_numpy()
    values = (
        len(d),
        np.mean(d),
        np.median(d),
        root_mean_square(d),
        np.mean(d < 0),
        np.mean(fitted),
        root_mean_square(fitted),
    )
    return {name: float(value) for name, value in zip(PER_SURVEY, values, strict=True)}


def rows_of_seed(seed: int, folder: Path, effects: Sequence[Effect] = EFFECTS) -> pd.DataFrame:
    """Survey each effect with one seed.

    Parameters
    ----------
    seed : of all surveys.
    folder : for their files, which are deleted again.
    effects : rows.

    Returns
    -------
    ``effect``, ``seed`` and `PER_SURVEY`.
    """
    found = [
        {"effect": effect.name, "seed": seed, **distances(seed, folder / f"{number}", effect)}
        for number, effect in enumerate(effects)
    ]
    return pd.DataFrame(found)


def offset_table(rows: pd.DataFrame, effects: Sequence[Effect] = EFFECTS) -> pd.DataFrame:
    """What each effect adds to the mean distance.

    Parameters
    ----------
    rows : `rows_of_seed` of at least two seeds.
    effects : rows; the one that a row is compared with must be among them.

    Returns
    -------
    One row an effect: ``effect``, ``against``, ``seeds``; ``explains_m``, the change of the mean against the
    other row, with ``sigma_explains_m``; ``n`` points of all surveys; ``mean_m``, ``median_m``, ``rmse_m``
    and the share ``behind`` the reference, means over the surveys, with ``sigma_mean_m`` of the mean;
    ``mean_registered_m`` with its sigma and ``rmse_registered_m`` after a rigid fit of each cloud, which
    ``fitted`` of the surveys allowed. All sigmas come from the spread over the seeds.
    """
    of = {e.name: rows[rows["effect"] == e.name].reset_index(drop=True) for e in effects}
    return pd.DataFrame([_row(effect, of) for effect in effects])


def _row(effect: Effect, of: Mapping[str, pd.DataFrame]) -> dict[str, Any]:
    """Row of the table from the surveys (one row a seed) of each effect."""
    own, root = of[effect.name], np.sqrt(len(of[effect.name]))
    change = own["mean_m"] - of[effect.against]["mean_m"] if effect.against else own["mean_m"] * np.nan
    return {
        "effect": effect.name,
        "against": effect.against,
        "seeds": len(own),
        "explains_m": change.mean(),
        "sigma_explains_m": change.std(ddof=1) / root,
        "n": int(own["n"].sum()),
        "mean_m": own["mean_m"].mean(),
        "sigma_mean_m": own["mean_m"].std(ddof=1) / root,
        "median_m": own["median_m"].mean(),
        "rmse_m": root_mean_square(own["rmse_m"]),
        "behind": own["behind"].mean(),
        "fitted": int(own["mean_registered_m"].notna().sum()),
        "mean_registered_m": own["mean_registered_m"].mean(),
        "sigma_mean_registered_m": own["mean_registered_m"].sem(),
        "rmse_registered_m": root_mean_square(own["rmse_registered_m"]),
    }


STUDY: Final = Study(
    rows=lambda seed: {"surveys": rows_of_seed(seed.number, seed.folder)},
    results=lambda tables, files: {"table": offset_table(tables["surveys"])},
    float_format=None,
)
