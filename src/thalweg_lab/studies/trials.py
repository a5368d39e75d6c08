"""Surveys of many seeds, processed rightly and wrongly: are the sigmas consistent, are mistakes noticed?

Each seed is a survey of its own: river, poses, mounts, every shot and the terrestrial scans err anew. Its
logs are processed once as they should be and once with each mistake of a list. Errors are taken where the
twin knows them, in three dimensions, and where a campaign sees them, as distances from the mesh of the scans.
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.accuracy import ComparisonSettings, compare_with_mesh
from thalweg.core import ArrayF, ArrayF32
from thalweg.settings.sections import Accuracy, ReferenceSettings
from thalweg.surface import Area, Surface
from thalweg_lab.studies.study import Result, Seed, Study, Tables
from thalweg_lab.studies.survey import BARE, Survey, process, record, reference_mesh, survey_settings
from thalweg_lab.truth import consistency_by_range, ratio_of_surveys

STATIONS: Final = 2
"""Terrestrial scans of each survey."""

MAX_POINTS: Final = 20_000
"""Points of each survey that are compared."""


BANKS: Final[dict[str, Any]] = {
    "size": "tiny",
    "duration_s": 4.0,
    "scene": BARE | {"length_m": 60.0, "grid_m": 0.25},
    "ins": {"attitude_time_s": 0.5},
    "gnss": {"correlation_time_s": 0.5},
    "lidar": {"mirror_ghosts": False},
    "tls": {"spacing_m": 0.1, "sigma_station_m": 0.005},
}
"""Section ``twin`` of the surveys: bare banks, and errors of poses that change every half second, so that a
survey of 4 s holds several. No mirror ghosts: those that the filters leave at the bank's toe are no points of
a surface, and no sigma speaks of them (`thalweg_lab.studies.offset_study` does)."""

REFERENCE: Final[dict[str, Any]] = {"cell_m": 0.1}
"""Section ``reference``: the terrain of `BANKS` has triangles of 25 cm."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantedMistake:
    """Something wrong in the processing.

    Parameters
    ----------
    name : in tables.
    boresight_deg : added to omega, phi, kappa of the lidar's mount.
    reversed_levers : sensors whose lever arm has the wrong sign, of ``lidar`` and ``antenna``.
    trajectory_late_s : the poses get stamps that are so much too late against the lidar's.
    estimate : no mistake: the errors of the poses are estimated from the survey, as the workflow does.
    """

    name: str
    boresight_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    reversed_levers: tuple[str, ...] = ()
    trajectory_late_s: float = 0.0
    estimate: bool = False

    def settings(self, true: Mapping[str, Any]) -> dict[str, Any]:
        """Settings of a campaign with this mistake in its mounts."""
        out = copy.deepcopy(dict(true))
        lidar = out["mounts"]["lidar"]
        for angle, wrong in zip(("omega_deg", "phi_deg", "kappa_deg"), self.boresight_deg, strict=True):
            lidar[angle] += wrong
        for sensor in self.reversed_levers:
            mount = out["mounts"][sensor]
            mount["lever_ics_m"] = [-x for x in mount["lever_ics_m"]]
        return out


RIVER: Final[dict[str, Any]] = {
    "size": "demo",
    "duration_s": 60.0,
    "gnss": {"shadow": True, "multipath_m": 0.01},
    "effects": {"lost_packets": 0.6},
    "tls": {"sigma_station_m": 0.005},
}
"""Section ``twin`` of surveys of the whole river: plants, houses, bridge, mirror images, shadow, multipath;
errors of attitude and positions last 20 s and 10 s. Six of ten packets are lost to save time."""

NONE: Final = PlantedMistake(name="none")
ESTIMATED: Final = PlantedMistake(name="estimated", estimate=True)
MISTAKES: Final = (
    PlantedMistake(name="boresight 0.1 deg", boresight_deg=(0.1, 0.0, 0.0)),
    PlantedMistake(name="lever arm reversed", reversed_levers=("lidar",)),
    PlantedMistake(name="trajectory 50 ms late", trajectory_late_s=0.05),
)
"""Mistakes that a check of predicted against observed errors must notice."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """Squared errors of the points of a survey beside their predictions.

    ``range_m``, ``squared_m2``, ``predicted_m2``, ``normalised`` (n,): the last is the squared error over the
    predicted variance, in three dimensions ``e^T C^-1 e / 3``.
    """

    range_m: ArrayF32
    squared_m2: ArrayF32
    predicted_m2: ArrayF32
    normalised: ArrayF32

    @classmethod
    def of(cls, range_m: ArrayF, squared_m2: ArrayF, predicted_m2: ArrayF, normalised: ArrayF) -> "Sample":
        """In single precision: many seeds are kept."""
        values = (range_m, squared_m2, predicted_m2, normalised)
        return cls(**{k: np.asarray(v, dtype=np.float32) for k, v in zip(cls.__slots__, values, strict=True)})


@dataclass(frozen=True, slots=True, kw_only=True)
class Trial:
    """Errors of one survey by the name of the mistake: in three dimensions, and from the mesh of scans."""

    in_3d: Mapping[str, Sample]
    to_mesh: Mapping[str, Sample]


def trial(
    seed: int,
    folder: Path,
    *,
    twin: Mapping[str, Any] = BANKS,
    reference: Mapping[str, Any] = REFERENCE,
    mistakes: Sequence[PlantedMistake] = (NONE,),
    mesh: bool = True,
    also: Callable[[Survey], None] = lambda survey: None,
) -> Trial:
    """One survey, processed with each of the mistakes.

    Parameters
    ----------
    seed : of the campaign.
    folder : for its files, which are deleted again.
    twin, reference : sections of the campaign file.
    mistakes : what is done wrong; `NONE` is nothing.
    mesh : also compare with a mesh of terrestrial scans.
    also : called with the survey of the first mistake before its files are deleted.
    """
    # A reversed lever arm puts the boat below the water, which the cloud's log would tell once a seed.
    settings = survey_settings(twin, seed=seed, reference=reference)
    logs = record(settings, folder / f"seed_{seed}", stations=STATIONS if mesh else 0)
    surveys = {
        mistake.name: process(
            logs,
            mistake.settings(settings),
            trajectory_late_s=mistake.trajectory_late_s,
            name=f"points_{number}",
            estimate=mistake.estimate,
        )
        for number, mistake in enumerate(mistakes)
    }
    in_3d, to_mesh = {}, {}
    for name, survey in surveys.items():
        e = survey.errors_3d(MAX_POINTS)
        in_3d[name] = Sample.of(e.range_m, e.squared_m2, e.predicted_m2, e.normalised)
    if mesh:
        # All of the tracks say alike on which side of the bank the river is.
        track = surveys[mistakes[0].name].trajectory.position_wcs_m
        surface = Surface(reference_mesh(logs, track)[0])
        to_mesh = {name: _from_mesh(survey, surface) for name, survey in surveys.items()}
    also(surveys[mistakes[0].name])
    logs.remove()
    return Trial(in_3d=in_3d, to_mesh=to_mesh)


def _from_mesh(survey: Survey, surface: Surface) -> Sample:
    """Distances from the mesh, as the rule of a campaign takes them."""
    s = survey.settings
    accuracy = Accuracy(**{**s["accuracy"], "max_points": MAX_POINTS})
    table, _ = compare_with_mesh(
        survey.points,
        surface.mesh,
        area=Area(),
        settings=ComparisonSettings.of(accuracy, ReferenceSettings(**s["reference"])),
        surface=surface,
    )
    table = table[table["used"]]
    squared = table["distance_m"].to_numpy() ** 2
    predicted = table["sigma_normal_m"].to_numpy() ** 2 + table["sigma_reference_m"].to_numpy() ** 2
    return Sample.of(table["range_m"].to_numpy(), squared, predicted, squared / predicted)


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Predicted against observed over all surveys.

    Parameters
    ----------
    ratio, ratio_low, ratio_high : predicted over observed RMSE, and where consistent sigmas leave it.
    normalised, normalised_low, normalised_high : mean normalised squared error, expectation 1, and its band.
    by_range : see `thalweg_lab.truth.consistency.consistency_by_range`.
    """

    ratio: float
    ratio_low: float
    ratio_high: float
    normalised: float
    normalised_low: float
    normalised_high: float
    by_range: pd.DataFrame

    @property
    def consistent(self) -> bool:
        """The ratio is within 0.9 to 1.1; neither it nor the normalised error nor a class leaves its band."""
        return (
            0.9 <= self.ratio <= 1.1
            and self.ratio_low < self.ratio < self.ratio_high
            and self.normalised_low < self.normalised < self.normalised_high
            and bool(self.by_range["inside"].all())
        )


def verdict(samples: Sequence[Sample], *, sigma_factor: float = 1.0, level: float = 0.95) -> Verdict:
    """Judge the sigmas of surveys.

    Parameters
    ----------
    samples : one a survey.
    sigma_factor : judge sigmas that are so many times as large.
    level : of the band of the ratio, of that of the normalised error, and of those of all classes together.
    """
    scale = sigma_factor**2
    n = np.array([float(len(s.range_m)) for s in samples])
    observed, predicted, normalised = (
        np.array([np.sum(getattr(s, name), dtype=np.float64) for s in samples])
        for name in ("squared_m2", "predicted_m2", "normalised")
    )
    ratio, low, high, _ = ratio_of_surveys(observed, scale * predicted, level=level)
    # As a ratio of sums: normalised errors over the number of points.
    inverse, inverse_low, inverse_high, _ = ratio_of_surveys(normalised / scale, n, level=level)
    survey = np.repeat(np.arange(len(samples)), n.astype(np.int64))
    ranges, squares, variances = (
        np.concatenate([getattr(s, name) for s in samples]).astype(np.float64)
        for name in ("range_m", "squared_m2", "predicted_m2")
    )
    return Verdict(
        ratio=ratio,
        ratio_low=low,
        ratio_high=high,
        normalised=inverse**-2,
        normalised_low=inverse_high**-2,
        normalised_high=inverse_low**-2,
        by_range=consistency_by_range(survey, ranges, squares, scale * variances, level=level),
    )


def as_table(found: Trial) -> pd.DataFrame:
    """Points of a survey as a table: ``quantity``, ``mistake`` and the fields of `Sample`."""
    parts = [
        pd.DataFrame({name: getattr(sample, name) for name in Sample.__slots__}).assign(
            quantity=quantity, mistake=mistake
        )
        for quantity in QUANTITIES
        for mistake, sample in getattr(found, quantity).items()
    ]
    return pd.concat(parts, ignore_index=True)


def from_table(table: pd.DataFrame) -> Trial:
    """What `as_table` made a table of."""
    fields = {
        quantity: {
            str(mistake): Sample(**{name: rows[name].to_numpy() for name in Sample.__slots__})
            for mistake, rows in table[table["quantity"] == quantity].groupby("mistake", sort=False)
        }
        for quantity in QUANTITIES
    }
    return Trial(**fields)


QUANTITIES: Final = {"in_3d": "error in three dimensions", "to_mesh": "distance from the reference mesh"}
"""What `consistency_tables` judges: fields of `Trial` and their names."""


def consistency_tables(found: Sequence[Trial]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Verdicts on surveys, for people.

    Parameters
    ----------
    found : surveys with the same mistakes.

    Returns
    -------
    verdicts : one row a quantity and mistake: ``surveys``, the fields of `Verdict`, ``classes``,
        ``classes_outside`` their bands, ``consistent``; ``beyond_3_sigma``, the share of points with a larger
        error (0.0027 of normal ones; plants and what the reference has not seen add to it), and
        ``normalised_within``, the mean of the normalised squares of the others (0.973 expected).
    by_range : the classes of all of them, see `thalweg_lab.truth.consistency.consistency_by_range`.
    """
    rows, classes = [], []
    for name, quantity in QUANTITIES.items():
        for mistake in getattr(found[0], name):
            samples = [getattr(trial, name)[mistake] for trial in found]
            v, normalised = verdict(samples), np.concatenate([each.normalised for each in samples])
            head = {"quantity": quantity, "mistake": mistake}
            rows.append(
                {
                    **head,
                    "surveys": len(found),
                    "ratio": v.ratio,
                    "ratio_low": v.ratio_low,
                    "ratio_high": v.ratio_high,
                    "normalised": v.normalised,
                    "normalised_low": v.normalised_low,
                    "normalised_high": v.normalised_high,
                    "classes": len(v.by_range),
                    "classes_outside": int((~v.by_range["inside"]).sum()),
                    "consistent": v.consistent,
                    "beyond_3_sigma": float((normalised > 9.0).mean()),
                    "normalised_within": float(normalised[normalised <= 9.0].mean()),
                }
            )
            classes.append(v.by_range.assign(**head))
    return pd.DataFrame(rows), pd.concat(classes, ignore_index=True)


def _study_of(how: Callable[..., Trial], float_format: str | None = "%.6g") -> Study:
    def rows(seed: Seed) -> Tables:
        """Errors of the points of one survey."""
        return {"points": as_table(how(seed.number, seed.folder)).assign(seed=seed.number)}

    def results(tables: Tables, files: Sequence[Path]) -> Mapping[str, Result]:
        """Verdicts on all surveys."""
        surveys = [from_table(rows) for _, rows in tables["points"].groupby("seed", sort=False)]
        verdicts, by_range = consistency_tables(surveys)
        return {"verdicts": verdicts, "by_range": by_range}

    return Study(rows=rows, results=results, float_format=float_format)


BANKS_STUDY: Final = _study_of(partial(trial, mistakes=(NONE, *MISTAKES)), None)
RIVER_STUDY: Final = _study_of(partial(trial, twin=RIVER, reference={}, mistakes=(NONE, ESTIMATED)))
