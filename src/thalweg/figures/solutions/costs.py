"""How long the steps of a chain took, from the records beside their results."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path


def computing_seconds(steps: Mapping[str, Sequence[Path]]) -> dict[str, float]:
    """Wall time of the jobs that made some results, in seconds, for each chain.

    Parameters
    ----------
    steps : chain -> one result of each of its jobs. The record of a job is ``<result>.meta.json``; a result
        without one (made by hand, or copied) makes the time of its chain unknown, and the chain is left out.
    """
    out = {}
    for chain, results in steps.items():
        records = [Path(f"{str(result).rstrip('/')}.meta.json") for result in results]
        if records and all(record.is_file() for record in records):
            out[chain] = float(sum(json.loads(record.read_text())["wall_s"] for record in records))
    return out
