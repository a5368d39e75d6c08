"""What a study is: rows of one seed, and tables and pages of the rows of all seeds.

A file in ``config/studies`` says how many seeds a study has, which `Study` it is and which files come out.
Two rules serve all of them: one runs some seeds, the other gathers the rows of all.
"""

import importlib
import logging
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from thalweg.core import ArrayF, InputError, ThalwegError, read_parquet

Tables = Mapping[str, pd.DataFrame]
"""Rows by the name of their table."""
Result = pd.DataFrame | str | Callable[[Path], None]
"""A table (CSV), a text, or what writes itself to a path."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Seed:
    """One survey of a study.

    Parameters
    ----------
    number : the seed.
    kind : of survey, where a study has several.
    folder : for files, deleted after the job.
    sizes : ``parameters`` of the study's file.
    """

    number: int
    kind: str
    folder: Path
    sizes: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """How a study is made.

    Parameters
    ----------
    rows : tables of one seed; the same names and columns for all seeds of a kind.
    results : from the rows of all seeds, in the order of kinds and seeds, and the study's own input files:
        what comes out, by the names of the study's ``outputs``.
    float_format : of numbers in CSV files; None: all digits.
    """

    rows: Callable[[Seed], Tables]
    results: Callable[[Tables, Sequence[Path]], Mapping[str, Result]]
    float_format: str | None = "%.6g"


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch:
    """Seeds of one kind that one job runs."""

    kind: str
    seeds: tuple[int, ...]


def read_studies(folder: Path) -> dict[str, dict[str, Any]]:
    """Files of a folder that state a study, by their names; others record campaigns."""
    entries = {path.stem: yaml.safe_load(path.read_text()) for path in sorted(folder.glob("*.yaml"))}
    return {name: entry for name, entry in entries.items() if "study" in entry}


def batches(entry: Mapping[str, Any]) -> dict[str, Batch]:
    """Jobs of a study by name.

    Parameters
    ----------
    entry : the study's file: ``parameters`` and ``jobs``. ``jobs.kinds`` gives first seed and number of seeds
        of each kind as numbers or as keys of ``parameters`` (``sizes.ins``); without it there is one kind of
        ``first_seed`` and ``seeds``. ``jobs.seeds_a_job`` is 1 unless given.
    """
    jobs = entry["jobs"]
    at_once = jobs.get("seeds_a_job", 1)
    found = {}
    for kind, size in jobs.get("kinds", {"survey": ("first_seed", "seeds")}).items():
        first, n = (_number(entry["parameters"], each) for each in size)
        for start in range(first, first + n, at_once):
            seeds = tuple(range(start, min(start + at_once, first + n)))
            ending = f"{seeds[0]}" if len(seeds) == 1 else f"{seeds[0]}_to_{seeds[-1]}"
            found[f"{kind}_{ending}"] = Batch(kind=kind, seeds=seeds)
    return found


def _number(sizes: Mapping[str, Any], given: int | str) -> int:
    found: Any = (
        reduce(lambda values, key: values[key], given.split("."), sizes) if isinstance(given, str) else given
    )
    return int(found)


def load(name: str) -> Study:
    """The study that ``module:name`` is.

    Raises
    ------
    InputError : there is no such module or no such study in it.
    """
    module, _, attribute = name.partition(":")
    try:
        found = getattr(importlib.import_module(module), attribute)
    except (ModuleNotFoundError, AttributeError) as error:
        raise InputError(f"no study {name}: {error}", expected="module:name of a Study") from error
    if not isinstance(found, Study):
        raise InputError(f"{name} is no study", expected="module:name of a Study")
    return found


def run_seeds(study: Study, batch: Batch, sizes: Mapping[str, Any], target: Path) -> None:
    """Run the seeds of a job and write their rows.

    Parameters
    ----------
    study : what is studied.
    batch : the seeds.
    sizes : ``parameters`` of the study's file.
    target : folder for one Parquet file a table.
    """
    logging.getLogger("thalweg").setLevel(logging.ERROR)
    parts = []
    for number in batch.seeds:
        with tempfile.TemporaryDirectory(prefix="thalweg_study_") as folder:
            seed = Seed(number=number, kind=batch.kind, folder=Path(folder), sizes=sizes)
            parts.append(study.rows(seed))
    target.mkdir(parents=True, exist_ok=True)
    for name, table in joined(parts).items():
        table.to_parquet(target / f"{name}.parquet", index=False)


def attempted(trial: Callable[[int], Mapping[str, Any]], seed: int) -> dict[str, Any]:
    """The row of a seed: ``seed``, ``failure`` and what the trial found; of one that failed, why."""
    try:
        return {"seed": seed, "failure": "", **trial(seed)}
    except ThalwegError as error:
        return {"seed": seed, "failure": str(error)}


def band_of_squares(n: int, level: float) -> tuple[float, float]:
    """Where the mean of n squared standard normal numbers lies, but for ``level`` of all cases."""
    from scipy.stats import chi2  # half a second, which each start of Snakemake would wait for

    low, high = (float(chi2.ppf(q, n)) / n if n else np.nan for q in (level / 2, 1 - level / 2))
    return low, high


def normalised_squares(error: ArrayF, cov: ArrayF) -> ArrayF:
    """``e^T C^-1 e`` (n,) of errors (n, k) with covariances (n, k, k)."""
    return np.asarray(np.einsum("ni,ni->n", error, np.linalg.solve(cov, error[:, :, None])[:, :, 0]))


def joined(parts: Sequence[Tables]) -> dict[str, pd.DataFrame]:
    """Tables of several seeds, one below the other."""
    names = dict.fromkeys(name for part in parts for name in part)
    return {
        name: pd.concat([part[name] for part in parts if name in part], ignore_index=True) for name in names
    }


def write_results(
    study: Study, rows: Sequence[Path], files: Sequence[Path], outputs: Mapping[str, Path]
) -> None:
    """Gather the rows of all jobs and write what comes out.

    Parameters
    ----------
    study : what is studied.
    rows : folders that `run_seeds` wrote, in their order.
    files : the study's own inputs.
    outputs : where each result goes.

    Raises
    ------
    InputError : the study gives other results than the ones that are asked for.
    """
    parts = [{path.stem: read_parquet(path) for path in sorted(folder.glob("*.parquet"))} for folder in rows]
    found = study.results(joined(parts), files)
    if set(found) != set(outputs):
        raise InputError(
            f"the study gives {sorted(found)}",
            expected=f"{sorted(outputs)}, as its file in config/studies says",
        )
    for name, result in found.items():
        if isinstance(result, pd.DataFrame):
            result.to_csv(outputs[name], index=False, float_format=study.float_format)
        elif isinstance(result, str):
            outputs[name].write_text(result, encoding="utf-8")
        else:
            result(outputs[name])
