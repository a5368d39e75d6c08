"""A cloud against its reference: distances, statistics, range classes, local dependency, registration."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.accuracy.cloud_to_mesh.autocorrelation import dependency_in_words, local_dependency
from thalweg.accuracy.cloud_to_mesh.comparison import (
    ComparisonSettings,
    after_motion,
    compare_with_mesh,
    predicted_sigma_m,
)
from thalweg.accuracy.cloud_to_mesh.comparison_tables import (
    AS_MEASURED,
    REGISTERED,
    by_range_table,
    point_sets,
    statistics_table,
    verdicts,
)
from thalweg.accuracy.cloud_to_mesh.registration import register
from thalweg.accuracy.cloud_to_mesh.registration_facts import registration_facts
from thalweg.core.errors import GeometryError
from thalweg.core.geometry.mesh import TriangleMesh
from thalweg.surface.area import Area
from thalweg.surface.cloud_to_mesh import Surface

_LOG = logging.getLogger("thalweg")


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceComparison:
    """What a comparison with a reference brings.

    ``table`` is of kind ``cloud_to_mesh`` and ``facts`` its metadata, with the verdicts in words;
    ``statistics``, ``by_range`` and ``spatial`` are tables for people, each as measured and, if there is one,
    with registration; ``registration`` says what that did, or why there is none.
    """

    table: pd.DataFrame
    facts: dict[str, Any]
    statistics: pd.DataFrame
    by_range: pd.DataFrame
    spatial: pd.DataFrame
    registration: dict[str, Any]


def compare_with_reference(
    points: Path, mesh: TriangleMesh, *, area: Area, settings: ComparisonSettings, registration: bool
) -> ReferenceComparison:
    """Compare a cloud with a reference mesh in every respect.

    Parameters
    ----------
    points, mesh, area, settings : as for `compare_with_mesh`.
    registration : also fit the cloud to the mesh and give all tables for that too.

    Raises
    ------
    InputError, CoverageError : see `compare_with_mesh`. A registration that fails is no error: its reason is
        logged and stands in the result.
    """
    surface = Surface(mesh)
    table, facts = compare_with_mesh(points, mesh, area=area, settings=settings, surface=surface)
    if facts["warning"]:
        _LOG.warning("%s", facts["warning"])
    states = {AS_MEASURED: table}
    fit: dict[str, Any] = {"done": False, "words": "no registration was asked for"}
    if registration:
        try:
            found = register(table, surface, settings)
        except GeometryError as error:
            fit["words"] = f"no registration: {error}"
            _LOG.warning("%s", fit["words"])
        else:
            places = found.motion.apply(table[["east_m", "north_m", "up_m"]].to_numpy())
            states[REGISTERED] = after_motion(table, places, surface, settings)
            fit = registration_facts(found, table, states[REGISTERED])
    statistics = pd.concat([statistics_table(t, settings, s) for s, t in states.items()], ignore_index=True)
    by_range = pd.concat([by_range_table(t, settings, s) for s, t in states.items()], ignore_index=True)
    spatial, sentences = _spatial(states, settings)
    facts |= {
        "verdicts": verdicts(statistics, by_range),
        "local_dependency": sentences,
        "registration": fit["words"],
    }
    for entry in facts["verdicts"]:
        if entry["registration"] == AS_MEASURED:
            _LOG.info("%s, %s: %s", entry["registration"], entry["points"], entry["sigmas"])
    return ReferenceComparison(
        table=table,
        facts=facts,
        statistics=statistics,
        by_range=by_range,
        spatial=spatial,
        registration=fit,
    )


def _spatial(
    states: dict[str, pd.DataFrame], settings: ComparisonSettings
) -> tuple[pd.DataFrame, list[dict[str, str]]]:
    """Tables of `local_dependency` of all sets of points, and their verdicts."""
    tables, sentences = [], []
    for state, table in states.items():
        places = table[["east_m", "north_m", "up_m"]].to_numpy()
        distance, sigma = table["distance_m"].to_numpy(), predicted_sigma_m(table)
        t_gps_s = table["t_gps_s"].to_numpy()
        for name, use in point_sets(table).items():
            found = local_dependency(
                places[use],
                distance[use],
                seed=settings.seed,
                # as elsewhere, a fitted cloud is not held against the sigmas of one that was not
                sigma_m=sigma[use] if state == AS_MEASURED else None,
                t_gps_s=t_gps_s[use],
                correlation_s=settings.correlation_s,
            )
            sentences.append({"registration": state, "points": name, "words": dependency_in_words(found)})
            found.insert(0, "points", name)
            found.insert(0, "registration", state)
            tables.append(found)
    return pd.concat(tables, ignore_index=True), sentences
