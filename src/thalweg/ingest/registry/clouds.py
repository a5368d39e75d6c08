"""Formats of finished point clouds."""

from pathlib import Path
from typing import Final

from thalweg.ingest import Cloud
from thalweg.ingest.registry.base import Format


def _cloud(path: Path) -> Cloud:
    from thalweg.ingest.clouds import read_cloud

    return read_cloud(path)


CLOUDS: Final = tuple(
    Format(kind=kind, words=words, streams=("reference", "cloud"), magic=(magic,), cloud=_cloud)
    for kind, words, magic in (
        ("las", "LAS/LAZ cloud", b"LASF"),
        ("ply", "PLY cloud or mesh", b"ply"),
        ("e57", "E57 cloud", b"ASTM-E57"),
    )
)
