"""All pairs of the surface models of a campaign, with stable ground drawn and without: does the rule hold?

    python -m thalweg_lab.studies.by_hand.ground CAMPAIGN.yaml

The campaign names its stable ground (``deformation.stable``). Each pair is compared as a campaign of two is,
once with that ground and once without. What is taken off is held against the median of the differences of
the rasters on that ground, and the net volume with it against the interval of 95 % without it. Areas with at
least ten places are held back one after another: the motion by the others against that by the area alone.
"""

import sys
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import ArrayF, GeometryError, InputError, LocalFrame, robust_sigma
from thalweg.core.values import read_vectors
from thalweg.deformation import (
    IN_VOLUME,
    Epoch,
    Registration,
    classify_changes,
    compare_epochs,
    measure_pair,
    observe_visibility,
    place_core_points,
    register_pair,
)
from thalweg.deformation.foreign import difference_of_models, dsm_of, prepare_foreign_epoch, with_drawn_areas
from thalweg.settings import load_campaign
from thalweg.settings.sections import Deformation, Epoch as Statement
from thalweg.surface import Area

WIDE: Final = 1.96
_LEAST: Final = 10
"""Places of an area that is held back."""


def all_pairs(path: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """A row for each pair of epochs of a campaign file, and one for each area held back of each pair.

    Raises
    ------
    InputError : not all epochs are surface models, or no stable ground is named.
    """
    campaign = load_campaign(path)
    stated = campaign.epochs or []
    if not all(each.dsm for each in stated) or not isinstance(campaign.deformation.stable, str):
        raise InputError(
            "epochs that are no surface models, or no file of stable ground",
            expected="dsm of each epoch, and deformation.stable",
            where=path,
        )
    assert campaign.campaign.origin is not None
    frame, crs = LocalFrame(**campaign.campaign.origin.model_dump()), campaign.campaign.crs
    settings = with_drawn_areas(campaign.deformation, frame, crs)
    area = Area.from_section(settings.area, frame, crs)
    epochs = [
        prepare_foreign_epoch(name, each, frame=frame, crs=crs, area=area, margin_m=settings.reach_m + 1.0)
        for name, each in zip(campaign.epoch_names, stated, strict=True)
    ]
    ground = _ground(campaign.deformation.stable, stated)
    rows, held = [], []
    for a, b in combinations(range(len(epochs)), 2):
        before, after = epochs[a], epochs[b]
        cores = place_core_points([before, after], settings, area)
        pair = measure_pair(cores, before, after, settings)
        drawn, nothing = settings, settings.replace(stable=None)
        moved = register_pair(pair, drawn)
        guessed = register_pair(pair, nothing)
        step = ground[b] - ground[a]
        step = step[np.isfinite(step)]
        median = float(np.median(step))
        with_ground = _net(cores, before, after, moved, drawn)
        without = _net(cores, before, after, guessed, nothing)
        heights = difference_of_models(stated[a], stated[b], drawn, crs, moved).volumes.iloc[0]
        name = f"{a + 1}-{b + 1}"
        rows.append(
            {
                "pair": name,
                "agreed_m": guessed.facts["would_be"]["up_m"],
                "median_m": median,
                "nmad_m": robust_sigma(step, median),
                "n": len(step),
                "areas": moved.facts["n_areas"],
                "taken_off_m": moved.facts["parameters"]["up_m"],
                "sigma_m": moved.facts["sigmas"]["up_m"],
                "net_m3": with_ground[0],
                "sigma_net_m3": with_ground[1],
                "net_heights_m3": heights["volume_m3"],
                "sigma_heights_m3": heights["sigma_m3"],
                "net_without_m3": without[0],
                "sigma_without_m3": without[1],
            }
        )
        held += [{"pair": name} | row for row in _held_back(pair, moved, settings)]
    return pd.DataFrame(rows), pd.DataFrame(held)


def _ground(drawn: str, stated: Sequence[Statement]) -> list[ArrayF]:
    """Heights of each raster on the drawn ground: along lines, or in the cells within polygons."""
    first = dsm_of(stated[0])
    assert first.frame is not None
    vectors = read_vectors(drawn).on_map(first.frame)
    points = vectors.points_along(1.0)
    if vectors.polygons():
        points = first.centres_m()[vectors.contain(first.centres_m())]
    return [dsm_of(each).at(points) for each in stated]


def _net(
    cores: pd.DataFrame, before: Epoch, after: Epoch, moved: Registration, settings: Deformation
) -> tuple[float, float]:
    """Net volume along normals and its standard deviation."""
    table, compared, _ = compare_epochs(cores, before, after, moved, settings, 1)
    found = compared.pair.found
    seen = observe_visibility(found.cores_m, found.normals, found.n, (before, after), settings)
    state = classify_changes(table, compared, seen, settings)[0]["state"]
    use = state.isin(IN_VOLUME).to_numpy() & np.isfinite(compared.distance_m)
    product = np.where(use, cores["area_m2"].to_numpy(), 0.0)[None]
    variance = sum(float(part[0]) for part in compared.variances(product))
    return float(product[0] @ np.nan_to_num(compared.distance_m)), float(np.sqrt(variance))


def _held_back(pair: Any, moved: Registration, settings: Deformation) -> list[dict[str, float]]:
    """Motion by all areas but one, against that by this one alone.

    An area by itself counts as known as well as one of the others.
    """
    areas = settings.stable
    assert isinstance(areas, list)
    rows = []
    for i, own in enumerate(areas):
        try:
            alone = register_pair(pair, settings.replace(stable=[own]))
            others = register_pair(pair, settings.replace(stable=[*areas[:i], *areas[i + 1 :]]))
        except GeometryError:  # too few places, or none in an epoch
            continue
        sigma = others.facts["sigmas"]["up_m"]
        rows.append(
            {
                "area": i + 1,
                "off_m": float(alone.parameters[2] - others.parameters[2]),
                "sigma_m": float(np.hypot(sigma, sigma * np.sqrt(max(moved.facts["n_areas"] - 1, 1)))),
            }
        )
    return rows


def in_markdown(pairs: pd.DataFrame, held: pd.DataFrame) -> str:
    """Both tables as the documentation prints them, with what they come to."""
    z = (pairs["taken_off_m"] - pairs["median_m"]) / pairs["sigma_m"]
    half = WIDE * pairs["sigma_without_m3"]
    within = (pairs["net_m3"] - pairs["net_without_m3"]).abs() <= half
    gap = (pairs["net_m3"] - pairs["net_heights_m3"]).abs()
    agrees = gap <= WIDE * pairs["sigma_net_m3"]
    lines = [
        "| pair | most agrees on | stable ground, median ± NMAD (n) | taken off ± sigma | net, drawn ground "
        "| by heights | net ± 1.96 sigma, none drawn | within |",
        "| --- | ---: | ---: | ---: | ---: | ---: | ---: | --- |",
    ]
    for i, row in enumerate(pairs.itertuples()):
        cells = (
            str(row.pair),
            f"{row.agreed_m:+.3f} m",
            f"{row.median_m:+.3f} ± {row.nmad_m:.3f} m ({row.n})",
            f"{row.taken_off_m:+.3f} ± {row.sigma_m:.3f} m",
            f"{row.net_m3:+,.0f} ± {row.sigma_net_m3:,.0f} m³",
            f"{row.net_heights_m3:+,.0f} m³",
            f"{row.net_without_m3:+,.0f} ± {half[i]:,.0f} m³",
            "yes" if within[i] else "no",
        )
        lines.append(f"| {' | '.join(cells)} |")
    normalised = held["off_m"] / held["sigma_m"]
    lines += [
        "",
        f"Taken off within 3 sigma of the median of stable ground: {int((z.abs() <= 3).sum())} of {len(z)} "
        f"(largest {z.abs().max():.1f} sigma). Net volume within the interval without drawn ground: "
        f"{int(within.sum())} of {len(within)}. Volumes along normals and by heights within 1.96 sigma: "
        f"{int(agrees.sum())} of {len(agrees)}. Areas held back: {len(held)}, mean square over variance "
        f"{(normalised**2).mean():.2f}, beyond 1.96 sigma {100 * (normalised.abs() > WIDE).mean():.0f} %.",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    print(in_markdown(*all_pairs(Path(sys.argv[1]))))
