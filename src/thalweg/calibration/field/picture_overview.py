"""How many pictures show how many markers, in words: what a field that cannot be measured lacks."""

from collections.abc import Iterable
from typing import Final

import pandas as pd

from thalweg.core.errors import GeometryError, ThalwegError

_GOOD_PICTURES: Final = 3
_TIES: Final = 3
"""Markers that two pictures share if one is to be oriented by the other."""
_FEW_MARKERS: Final = 4


def overview_words(marks: pd.DataFrame) -> str:
    """Counts of pictures and markers of a table of marks, in words."""
    pairs = marks.drop_duplicates(["image", "marker"])
    seen = pairs.groupby("marker")["image"].nunique()
    shown = pairs.groupby("image")["marker"].nunique()
    often, twice, once = (int(n.sum()) for n in (seen >= _GOOD_PICTURES, seen == 2, seen == 1))
    words = (
        f"{len(shown)} pictures show {len(seen)} markers: {often} stand in {_GOOD_PICTURES} pictures or "
        f"more, {twice} in two, {once} in one"
    )
    poor = shown[shown < _FEW_MARKERS]
    if len(poor):
        words += f"; {len(poor)} pictures show fewer than {_FEW_MARKERS} markers ({_some(poor.index)})"
    groups = _groups(pairs)
    if len(groups) > 1:
        told = "; ".join(f"{len(g)} with {_some(g)}" for g in groups[:3])
        words += f"; they fall into {len(groups)} groups that share fewer than {_TIES} markers: {told}"
    return words


def advice_words(marks: pd.DataFrame) -> str:
    """What to photograph, by the same counts."""
    pairs = marks.drop_duplicates(["image", "marker"])
    seen = pairs.groupby("marker")["image"].nunique()
    shown = pairs.groupby("image")["marker"].nunique()
    advice = []
    groups = _groups(pairs)
    if len(groups) > 1:
        sides = [_some(_most_seen(pairs[pairs["image"].isin(group)])) for group in groups[:2]]
        advice.append(f"take pictures that show markers of both groups, so {sides[0]} and {sides[1]}")
    rare = seen[seen < _GOOD_PICTURES].index.astype(int).tolist()
    if rare:
        advice.append(f"take the markers {_some(rare, 12)} from two more sides")
    if len(shown) < 20:
        advice.append(f"take {20 - len(shown)} pictures more, from all sides and two heights")
    return "; ".join(advice)


def with_overview(error: GeometryError, marks: pd.DataFrame) -> GeometryError:
    """The same error, which also tells what the pictures show and what to photograph."""
    if len(marks) == 0:
        return error
    cure = "; ".join(words.rstrip(".") for words in (error.cure, advice_words(marks)) if words)
    found = f"{error.found}; {overview_words(marks)}"
    ThalwegError.__init__(error, found, expected=error.expected, where=error.where, cure=cure)
    return error


def _groups(pairs: pd.DataFrame) -> list[list[str]]:
    """Names of pictures that hang together by common markers, the largest group first."""
    markers = {str(image): set(part["marker"]) for image, part in pairs.groupby("image")}
    left, groups = sorted(markers), []
    while left:
        group, waiting = [], [left.pop(0)]
        while waiting:
            here = waiting.pop()
            group.append(here)
            near = [name for name in left if len(markers[name] & markers[here]) >= _TIES]
            left = [name for name in left if name not in near]
            waiting += near
        groups.append(sorted(group))
    return sorted(groups, key=lambda g: (-len(g), g[0]))


def _most_seen(pairs: pd.DataFrame) -> list[int]:
    """Markers, those in the most pictures first."""
    count = pairs.groupby("marker").size()
    return [int(m) for m in sorted(count.index, key=lambda m: (-count[m], m))]


def _some(names: Iterable[object], most: int = 4) -> str:
    every = [str(name) for name in names]
    return ", ".join(every[:most]) + (" ..." if len(every) > most else "")
