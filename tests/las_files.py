"""Clouds on disk for tests."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from thalweg.core import Frame, LazWriter


def write_laz(path: Path, chunks: Iterable[Mapping[str, Any]], frame: Frame, **how: Any) -> int:
    """Write a cloud from chunks, each a mapping of the arguments of `LazWriter.append`; returns the count."""
    with LazWriter(path, frame, **how) as writer:
        for chunk in chunks:
            writer.append(**chunk)
    return writer.n_points
