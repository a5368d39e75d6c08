"""What the surveys of `thalweg_lab.studies.chain_study` say together: tables, goals and a page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.accuracy.cloud_to_mesh.comparison import ComparisonSettings, predicted_sigma_m
from thalweg.accuracy.cloud_to_mesh.comparison_tables import ALL, WITHOUT_OUTLIERS, by_range_table, point_sets
from thalweg.accuracy.solutions.comparison import CHAINS, Chain
from thalweg.accuracy.solutions.ranges import chains_by_range
from thalweg.core.types import ArrayF
from thalweg_lab.studies.chain_study import APART_S, CLEAN, DISTURBANCES, ChainStudy, Found
from thalweg_lab.truth.solutions import OWN_TIMES

DISTURBED: Final = "disturbed"
UNDISTURBED: Final = "undisturbed"
"""Names of the settings with and without `thalweg_lab.studies.chain_study.DISTURBANCES`."""

_NO_POSE: Final = ("no_gps_time", "no_pose")
_TRUTH: Final = (
    ("rms_position", "rms_place_m"), ("rms_roll", "rms_roll_deg"), ("rms_pitch", "rms_pitch_deg"),
    ("rms_heading", "rms_heading_deg"), ("sigma_heading", "sigma_heading_deg"),
    ("normalised_pose", "normalised_pose"),
)  # fmt: skip


LIMITS: Final = (
    "Not in the poses of the images is what a block of a real survey may have beyond its stated sigmas; "
    "plants are in all clouds, and rule the rows of all points. The twin turns at the banks, so that short "
    "ranges are measured while it turns and the jitter of the camera's clock counts most there; the "
    "published budgets take one angular speed for all ranges."
)


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


def pooled(found: Sequence[Found]) -> dict[str, pd.DataFrame]:
    """Distances of all surveys by chain, kind ``cloud_to_mesh``; each survey lies at times of its own."""
    out = {}
    for name in CHAINS:
        parts = [f.distances[name].assign(t_gps_s=f.distances[name]["t_gps_s"] + k * APART_S)
                 for k, f in enumerate(found)]  # fmt: skip
        out[name] = pd.concat(parts, ignore_index=True)
    return out


def ranges_of(
    found: Sequence[Found],
    settings: ComparisonSettings,
    published_mm: Mapping[str, ArrayF] | None = None,
    at_m: ArrayF | None = None,
) -> pd.DataFrame:
    """RMSE of all surveys in range classes, see `chains_by_range`."""
    chains = [
        Chain(
            name=name,
            counts=found[0].counts[name],
            trajectory=found[0].trajectories[name],
            by_range=by_range_table(table, settings),
        )
        for name, table in pooled(found).items()
    ]
    return chains_by_range(chains, published_mm, at_m)


def study_table(found: Mapping[str, Sequence[Found]]) -> pd.DataFrame:
    """One row a setting, chain and set of points.

    Columns ``setting, chain, points, surveys, n``; ``mean_m`` with ``sigma_mean_m`` of the spread over the
    surveys; ``std_m, rmse_m`` of all points together, ``rmse_least_m, rmse_most_m`` of single surveys;
    ``predicted_rmse_m``; ``share_with_pose`` of the shots; ``mean_range_m``; errors of the poses against the
    truth: ``rms_place_m`` and so on, root mean square over the surveys.
    """
    rows = []
    for setting, surveys in found.items():
        for name in CHAINS:
            truth = _truth(surveys, name)
            share = float(np.mean([_share(f.counts[name]) for f in surveys]))
            for points in (ALL, WITHOUT_OUTLIERS):
                parts = [f.distances[name][point_sets(f.distances[name])[points]] for f in surveys]
                rows.append(
                    dict[str, Any](setting=setting, chain=name, points=points, surveys=len(parts))
                    | _distances(parts)
                    | {"share_with_pose": share}
                    | truth
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
        rows.append({
            "goal": goal.words, "chain": goal.chain, "low_m": goal.low_m, "high_m": goal.high_m,
            "found_m": found, "found_all_m": float(value[ALL]), "met": missed == 0.0,
            "missed_by_m": missed,
        })  # fmt: skip
    return pd.DataFrame(rows)


def as_markdown(table: pd.DataFrame, facts: Mapping[str, Any]) -> str:
    """Page of the study; ``facts`` of `thalweg.accuracy.solutions.ranges.range_facts`."""
    n = int(table["n"].max())
    lines = [
        "# INS, camera and fused trajectory on the digital twin",
        "",
        "Distances of the clouds to a mesh of terrestrial scans on the slope of the right bank, in "
        f"centimetres; {int(table['surveys'].max())} surveys of each setting, up to n = {n:,} points a row. "
        "These are results of the digital twin. Disturbed: fields of the motors and of the hull turn the "
        "heading, it drifts, leaves and bridge take satellites away and the water reflects them. The size of "
        "the fields was chosen so that the INS comes near its published RMSE; camera and fused trajectory "
        "follow.",
        "",
        "| setting | trajectory | points | n | mean | RMSE | of single surveys | predicted | with pose | "
        "place | heading |",
        "|" + " --- |" * 3 + " ---: |" * 8,
    ]
    lines += [
        f"| {r['setting']} | {r['chain']} | {r['points']} | {r['n']:,} "
        f"| {100 * r['mean_m']:+.1f} ± {100 * r['sigma_mean_m']:.1f} | {100 * r['rmse_m']:.1f} "
        f"| {100 * r['rmse_least_m']:.1f} to {100 * r['rmse_most_m']:.1f} "
        f"| {100 * r['predicted_rmse_m']:.1f} | {100 * r['share_with_pose']:.0f} % "
        f"| {100 * r['rms_place_m']:.1f} | {r['rms_heading_deg']:.2f} deg |"
        for r in _records(table)
    ]
    lines += ["", "| asked for | without outliers, cm | all points, cm | |", "| --- | ---: | ---: | --- |"]
    for r in _records(goals_table(table)):
        verdict = "met" if r["met"] else f"missed by {100 * r['missed_by_m']:.1f} cm"
        lines.append(f"| {r['goal']} | {100 * r['found_m']:.1f} | {100 * r['found_all_m']:.1f} | {verdict} |")
    return "\n".join([*lines, "", crossing_words(facts), "", LIMITS]) + "\n"


def crossing_words(facts: Mapping[str, Any]) -> str:
    """Where the predicted curves of INS and camera cross."""
    for found in facts["crossings"]:
        if set(found["chains"]) == {"ins", "camera"} and found["curve"] == "rmse_predicted_3d":
            at = found.get("crossing_m")
            if at is not None:
                return (
                    f"The predicted 3D sigmas of INS and camera cross at {at:.1f} m: nearer the "
                    f"{_name(found['nearer'])} is better, farther the {_name(found['farther'])} (published "
                    "budgets: 11 to 13 m)."
                )
            return (
                f"The predicted 3D sigmas of INS and camera do not cross: the {_name(found['nearer'])} is "
                "better at every range (published budgets: 11 to 13 m)."
            )
    return "Too few points for predicted curves."


def _name(chain: str) -> str:
    return {"ins": "INS", "camera": "camera", "fused": "fused trajectory"}.get(chain, chain)


def _distances(parts: Sequence[pd.DataFrame]) -> dict[str, float]:
    d = [part["distance_m"].to_numpy(np.float64) for part in parts if len(part)]
    whole = np.concatenate(d)
    sigma = np.concatenate([predicted_sigma_m(part) for part in parts])
    means, single = np.array([x.mean() for x in d]), [float(np.sqrt(np.mean(x**2))) for x in d]
    return {
        "n": len(whole),
        "mean_m": float(whole.mean()),
        "sigma_mean_m": float(means.std(ddof=1) / np.sqrt(len(d))) if len(d) > 1 else float("nan"),
        "std_m": float(whole.std()),
        "rmse_m": float(np.sqrt(np.mean(whole**2))),
        "rmse_least_m": min(single),
        "rmse_most_m": max(single),
        "predicted_rmse_m": float(np.sqrt(np.mean(sigma**2))),
        "mean_range_m": float(np.mean(np.concatenate([part["range_m"].to_numpy() for part in parts]))),
    }


def _truth(surveys: Sequence[Found], chain: str) -> dict[str, float]:
    out = {}
    for quantity, column in _TRUTH:
        values = []
        for f in surveys:
            rows = f.truth[(f.truth["times"] == OWN_TIMES) & (f.truth["quantity"] == quantity)]
            values.append(float(rows[chain].iloc[0]))
        squares = (
            np.mean(values) if quantity.startswith("normalised") else np.sqrt(np.mean(np.square(values)))
        )
        out[column] = float(squares)
    return out


def _share(counts: pd.DataFrame) -> float:
    n = dict(zip(counts["reason"], counts["n"], strict=True))
    return 1.0 - sum(n.get(reason, 0) for reason in _NO_POSE) / sum(n.values())


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    return [{str(name): value for name, value in row.items()} for row in table.to_dict("records")]
