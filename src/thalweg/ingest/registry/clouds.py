"""Formats of finished point clouds."""

from pathlib import Path
from typing import Any, Final

from thalweg.ingest import Cloud
from thalweg.ingest.registry.base import Format, Recording


def _cloud(path: Path) -> Cloud:
    from thalweg.ingest.clouds import read_cloud

    return read_cloud(path)


def _describe(kind: str, files: list[Path], options: dict[str, Any]) -> Recording:
    return Recording(kind=kind, report=_cloud(files[0]).report)


CLOUDS: Final = tuple(
    Format(
        kind=kind,
        words=words,
        streams=("reference", "stable", "cloud"),
        magic=(magic,),
        cloud=_cloud,
        describe=_describe,
    )
    for kind, words, magic in (
        ("las", "LAS/LAZ cloud", b"LASF"),
        ("ply", "PLY cloud or mesh", b"ply"),
        ("e57", "E57 cloud", b"ASTM-E57"),
    )
)
