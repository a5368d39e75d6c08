"""Which images are compared with which: neighbours in time, neighbours in space, or all with all."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any, Final, Self

import numpy as np
from scipy.spatial import cKDTree

from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayF, ArrayI
from thalweg.ingest.photos.stamps import natural_key

KINDS: Final = ("auto", "sequential", "spatial", "exhaustive")


@dataclass(frozen=True, slots=True, kw_only=True)
class PairSettings:
    """Settings of the pairs; names, units and defaults as in section ``images.mapping``."""

    pairs: str = "auto"
    exhaustive_up_to: int = 30
    overlap: int = 10
    quadratic: bool = True
    max_distance_m: float = 15.0
    max_neighbours: int = 20

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """From the section ``images.mapping`` of a campaign file."""
        return cls(**{name: section[name] for name in cls.__dataclass_fields__})


def order_in_time(names: Sequence[str], t_s: ArrayF | None = None) -> tuple[ArrayI, list[str]]:
    """Order of the images, and what is to be said about it.

    Images without time stand behind the one whose name precedes theirs; without any time the order is the
    natural one of the names.

    Parameters
    ----------
    names : n file names.
    t_s : (n,) times, NaN where unknown.

    Returns
    -------
    order : (n,) indices.
    notes : for the report.
    """
    by_name = np.array(sorted(range(len(names)), key=lambda k: natural_key(names[k])), np.int64)
    if t_s is None or not np.isfinite(t_s).any():
        return by_name, []
    t = np.asarray(t_s, np.float64)[by_name]
    notes = []
    unknown = ~np.isfinite(t)
    if unknown.any():
        first = names[by_name[np.flatnonzero(unknown)[0]]]
        notes.append(f"{unknown.sum()} images without time, such as {first}, are placed by their names")
        known = np.where(unknown, -1, np.arange(len(t)))
        before = np.maximum.accumulate(known)
        t = np.where(before >= 0, t[before], -np.inf)
    folder = np.array([str(PurePosixPath(names[k]).parent) for k in by_name], dtype=object)[~unknown]
    back = int(((np.diff(t[~unknown]) < 0) & (folder[1:] == folder[:-1])).sum())
    if back:
        notes.append(f"names do not follow time at {back} places: the order in time counts")
    return by_name[np.argsort(t, kind="stable")], notes


def image_pairs(
    order: ArrayI, settings: PairSettings, position_m: ArrayF | None = None
) -> tuple[ArrayI, str]:
    """Pairs of images to compare.

    Parameters
    ----------
    order : (n,) images in time; images that are not listed are in no pair.
    settings : see `PairSettings`.
    position_m : (all, 3) approximate positions of all images in any metric frame, NaN where unknown.

    Returns
    -------
    pairs : (m, 2) images, the smaller index first, sorted, each pair once.
    kind : exhaustive, sequential or spatial.

    Raises
    ------
    GeometryError : spatial pairs are wanted, but no position is known.
    """
    n = len(order)
    placed = position_m is not None and np.isfinite(position_m[order]).all(axis=1).any()
    kind = settings.pairs
    if kind not in KINDS:
        raise GeometryError(f"pairs: {kind}", expected=f"one of {', '.join(KINDS)}")
    if kind == "spatial" and not placed:
        raise GeometryError(
            "pairs by position, but no image has an approximate position",
            expected="positions of the images",
            where="images.mapping.pairs",
            cure="Choose sequential or exhaustive, or give the times of the images",
        )
    if kind == "auto":
        kind = "exhaustive" if n <= settings.exhaustive_up_to else "spatial" if placed else "sequential"
    if kind == "exhaustive":
        return _sorted(order, np.column_stack(np.triu_indices(n, 1))), kind
    steps = list(range(1, settings.overlap + 1))
    if settings.quadratic:
        steps += [2**k for k in range(settings.overlap) if 2**k < n]
    found = [np.column_stack([np.arange(n - s), np.arange(s, n)]) for s in sorted(set(steps)) if s < n]
    if kind == "spatial" and position_m is not None:
        found.append(_near(position_m[order], settings))
    return _sorted(order, np.concatenate([np.zeros((0, 2), np.int64), *found])), kind


def _near(position_m: ArrayF, settings: PairSettings) -> ArrayI:
    """Nearest images that are not neighbours in time anyhow."""
    known = np.flatnonzero(np.isfinite(position_m).all(axis=1))
    if len(known) < 2:
        return np.zeros((0, 2), np.int64)
    most = min(settings.max_neighbours + 2 * settings.overlap + 1, len(known))
    far, near = cKDTree(position_m[known]).query(
        position_m[known], k=most, distance_upper_bound=settings.max_distance_m
    )
    # a place without neighbour is marked by the number of all places
    a = np.broadcast_to(known[:, None], near.shape)
    b = np.append(known, -1)[near]
    good = np.isfinite(far) & (b >= 0) & (np.abs(a - b) > settings.overlap)
    good &= np.cumsum(good, axis=1) <= settings.max_neighbours
    return np.column_stack([a[good], b[good]])


def _sorted(order: ArrayI, places: ArrayI) -> ArrayI:
    if not len(places):
        return np.zeros((0, 2), np.int64)
    return np.asarray(np.unique(np.sort(order[places], axis=1), axis=0), np.int64)
