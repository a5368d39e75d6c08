"""Numbers that the ledger points to, out of results, studies and settings; what is absent is named."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import yaml

from thalweg.core.errors import InputError
from thalweg.core.geometry.mesh_ply import read_mesh
from thalweg.core.tables import read_parquet
from thalweg.core.types import ArrayF
from thalweg_lab.reproduction.files import Ours

MM_PER_M: Final = 1000.0
SPREADS: Final = ("binomial", "scatter", "unit")
"""Sigmas that are no column, see `thalweg_lab.reproduction.files.Ours`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Found:
    """Our number: ``value`` a number or word, None if there is none, and then ``absent`` says why; ``sigma``
    and ``n`` where the result has them.
    """

    value: float | str | None = None
    sigma: float = float("nan")
    n: float = float("nan")
    absent: str = ""


@dataclass(slots=True)
class Results:
    """Files that the ledger may read, each read once.

    Parameters
    ----------
    files : path below the campaign's results -> file.
    studies : path below ``results/reproduction`` -> file.
    settings : section ``twin.light_sheet`` of the campaign, as plain values; None for a campaign that is no
        twin.
    """

    files: Mapping[str, Path]
    studies: Mapping[str, Path]
    settings: Mapping[str, Any] | None
    _read: dict[Path, Any]

    @classmethod
    def of(
        cls, files: Mapping[str, Path], studies: Mapping[str, Path], settings: Mapping[str, Any] | None
    ) -> "Results":
        """Nothing is read yet."""
        return cls(files, studies, settings, {})

    def find(self, ours: Ours) -> Found:
        """The number of a pointer to a file, a study or a setting.

        Raises
        ------
        InputError : a file that cannot be read at all.
        """
        if ours.source == "none":
            return Found(absent=ours.name)
        if ours.source == "setting":
            return _setting(self.settings, ours)
        found = self._in_file(ours, ours.name)
        if ours.sigma_of and found.value is not None:
            file, column = ours.sigma_of
            spread = self._in_file(
                Ours(source=ours.source, name=file, where={}, near={}, columns=(column,), take="mean error"),
                file,
            )
            found = replace(found, sigma=spread.value if isinstance(spread.value, float) else float("nan"))
        if not ours.against or not isinstance(found.value, float):
            return found
        divisor = self._in_file(ours, ours.against)
        if not isinstance(divisor.value, float):
            return divisor
        return Found(value=found.value / divisor.value)

    def _in_file(self, ours: Ours, name: str) -> Found:
        path = (self.files if ours.source == "file" else self.studies).get(name)
        if path is None or not path.is_file():
            return Found(absent=_how_to_get(ours.source, name))
        if path not in self._read:
            self._read[path] = _content(path)
        content = self._read[path]
        try:
            if ours.axis:
                return Found(value=float(np.sort(np.ptp(content, axis=0))[-ours.axis]) * ours.times)
            return _of_table(content, ours) if isinstance(content, pd.DataFrame) else _of_tree(content, ours)
        except _AbsentError as absent:
            return Found(absent=f"{name}: {absent}")


class _AbsentError(Exception):
    """A row, column or key is not in the file."""


def _how_to_get(source: str, name: str) -> str:
    if source == "study":
        target = f"results/reproduction/{name}"
        return f"{target} is not there; snakemake {target}"
    return f"{name} is not among the results of this campaign"


def _content(path: Path) -> Any:
    try:
        if path.suffix == ".csv":
            return pd.read_csv(path)
        if path.suffix == ".parquet":
            return read_parquet(path)
        if path.suffix == ".ply":
            return read_mesh(path)[0].vertices_m * MM_PER_M
        text = path.read_text(encoding="utf-8")
        return yaml.safe_load(text) if path.suffix == ".yaml" else json.loads(text)
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise InputError(
            f"cannot be read: {error}", where=path, expected="a table, JSON or YAML", cure="Make it again"
        ) from error


def _of_table(table: pd.DataFrame, ours: Ours) -> Found:
    chosen = pd.Series(data=True, index=table.index)
    for name, wanted in ours.where.items():
        column = _column(table, name)
        chosen &= (column == wanted) if not isinstance(wanted, str) else (column.astype(str) == wanted)
    for name, (value, reach) in ours.near.items():
        chosen &= (pd.to_numeric(_column(table, name), errors="coerce") - value).abs() <= reach
    rows = table[chosen]
    if not len(rows):
        raise _AbsentError(f"no row with {_selection(ours)}")
    if ours.take == "count":
        known = _column(rows, ours.columns[0]).notna().sum()
        return Found(value=float(known), n=float(known))
    first = _column(rows, ours.columns[0])
    if not pd.api.types.is_numeric_dtype(first):
        return Found(value=_word(first.astype(str).tolist(), ours))
    values = np.stack([_column(rows, name).to_numpy(np.float64) for name in ours.columns], axis=1)
    if ours.over:
        values = values / _column(rows, ours.over).to_numpy(np.float64)[:, None]
    n = float(_column(rows, ours.n).sum()) if ours.n else float("nan")
    return _taken(values, ours, n, _column(rows, ours.sigma) if _named(ours.sigma) else None)


def _of_tree(content: Any, ours: Ours) -> Found:
    found = _at(content, ours.key)
    if isinstance(found, str):
        return Found(value=_word([found], ours))
    if isinstance(found, bool) or found is None:
        raise _AbsentError(f"{_dotted(ours.key)} is {found}")
    if ours.take == "count":
        return Found(value=float(len(found)))
    values = np.atleast_1d(np.asarray(found, dtype=np.float64))
    if ours.over:
        values = values / float(_at(content, _beside(ours.key, ours.over)))
    n = float(_at(content, _beside(ours.key, ours.n))) if ours.n else float("nan")
    sigma = pd.Series([_at(content, _beside(ours.key, ours.sigma))]) if _named(ours.sigma) else None
    return _taken(values, ours, n, sigma)


def _taken(values: ArrayF, ours: Ours, n: float, sigma: "pd.Series[Any] | None") -> Found:
    known = values[np.isfinite(values)].ravel()
    if not len(known):
        raise _AbsentError("no number there")
    if ours.take == "one" and len(known) != 1:
        raise _AbsentError(f"{len(known)} numbers with {_selection(ours)} instead of one")
    functions: dict[str, Callable[[ArrayF], Any]] = {
        "one": np.max, "mean": np.mean, "median": np.median, "sum": np.sum, "least": np.min,
        "largest": np.max, "rms": lambda v: np.sqrt(np.mean(v * v)),
        "mean error": lambda v: np.sqrt(np.mean(v * v) / len(v)), "largest size": lambda v: np.max(np.abs(v)),
    }  # fmt: skip
    value = float(functions[ours.take](known))
    spread = float("nan")
    if ours.sigma == "binomial":
        if not (0.0 <= value <= 1.0 and n > 0.0):
            raise _AbsentError(f"{value:g} of {n:g} is no share")
        spread = float(np.sqrt(value * (1.0 - value) / n))
    elif ours.sigma == "unit":
        spread = 1.0
    elif ours.sigma == "scatter" and len(known) > 1:
        spread = float(known.std(ddof=1))
    elif sigma is not None:
        spread = float(sigma.astype(float).max())
    return Found(value=value * ours.times, sigma=spread * ours.times, n=n)


def _setting(settings: Mapping[str, Any] | None, ours: Ours) -> Found:
    if settings is None:
        return Found(absent="the campaign is no twin")
    try:
        value = _at(settings, tuple(ours.name.split(".")))
    except _AbsentError as absent:
        return Found(absent=f"twin.light_sheet: {absent}")
    if isinstance(value, str):
        return Found(value=value)
    return Found(value=float(value) * ours.times)


def _word(words: list[str], ours: Ours) -> float | str:
    if len(set(words)) != 1:
        raise _AbsentError(f"{len(set(words))} words with {_selection(ours)} instead of one")
    if ours.words is None:
        return words[0]
    for begin, number in ours.words.items():
        if words[0].startswith(begin):
            return float(number)
    raise _AbsentError(f"found {words[0]!r}, which begins with none of {list(ours.words)}")


def _column(table: pd.DataFrame, name: str) -> "pd.Series[Any]":
    if name not in table.columns:
        raise _AbsentError(f"no column {name!r}")
    return table[name]


def _at(content: Any, key: tuple[Any, ...]) -> Any:
    here = content
    for part in key:
        known = isinstance(here, Mapping) and part in here
        known |= isinstance(here, list | tuple) and isinstance(part, int) and part < len(here)
        if not known:
            raise _AbsentError(f"no {_dotted(key)}")
        here = here[part]
    return here


def _beside(key: tuple[Any, ...], name: str) -> tuple[Any, ...]:
    return (*key[:-1], name)


def _named(sigma: str) -> bool:
    return sigma not in ("", *SPREADS)


def _dotted(key: tuple[Any, ...]) -> str:
    return ".".join(str(part) for part in key)


def _selection(ours: Ours) -> str:
    parts = [f"{name} {wanted}" for name, wanted in ours.where.items()]
    parts += [f"{name} within {reach:g} of {value:g}" for name, (value, reach) in ours.near.items()]
    return ", ".join(parts) or "any content"
