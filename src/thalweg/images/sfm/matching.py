"""What pairs of images have in common, and the images themselves: the input of the mapper."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from thalweg.core.camera.model import Camera
from thalweg.core.types import ArrayI
from thalweg.images.model.files import Picture
from thalweg.images.sfm.camera import StartCamera
from thalweg.images.sfm.features import read_arrays

_FORMAT: Final = 1
GEOMETRY: Final = ("F", "E", "H", "pose")
"""Matrices of a pair of images, in this order."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchSettings:
    """Settings of the matching; names, units and defaults as in section ``images.mapping``."""

    min_inliers: int = 15
    max_ratio: float = 0.8
    max_error_px: float = 2.0

    @classmethod
    def from_section(cls, section: Mapping[str, Any]) -> Self:
        """From the section ``images.mapping`` of a campaign file."""
        return cls(**{name: section[name] for name in cls.__dataclass_fields__})


@dataclass(frozen=True, slots=True, kw_only=True)
class Matches:
    """Images, their features without descriptors, and what pairs of images have in common.

    Parameters
    ----------
    pictures : i images in natural order of their names, those with problems included.
    order : (o,) images that take part, in time.
    starts : interior orientations to begin with.
    camera : (i,) index into ``starts``; -1 for images that take no part.
    start, place : features as of `Features`.
    pairs : (m, 2) images that were compared.
    n_matches : (m,) matches before the geometry was asked.
    config : (m,) COLMAP's kind of the geometry, 0 for pairs without one.
    geometry : (m, 4, 3, 4) fundamental, essential matrix, homography (each in the first three columns) and
        pose of the second in the first camera; NaN where absent.
    pair_start : (m + 1,) common points of pair k are rows ``pair_start[k]`` to ``pair_start[k + 1]``.
    common : (c, 2) features in the first and in the second image, counted within each image.
    facts : JSON-able facts and notes.
    """

    pictures: tuple[Picture, ...]
    order: ArrayI
    starts: tuple[StartCamera, ...]
    camera: ArrayI
    start: ArrayI
    place: NDArray[np.float32]
    pairs: ArrayI
    n_matches: ArrayI
    config: ArrayI
    geometry: NDArray[np.float64]
    pair_start: ArrayI
    common: NDArray[np.uint32]
    facts: dict[str, Any]

    @property
    def n_common(self) -> ArrayI:
        """(m,) common points of each pair."""
        return np.diff(self.pair_start)

    def scale(self) -> float:
        """Pixels of the image for one of the picture in which features were looked for."""
        longest = max((max(self.pictures[k].size_px) for k in self.order), default=1)
        return max(1.0, longest / float(self.facts["max_size_px"]))

    def write(self, path: Path) -> None:
        """Write as ``.npz``; the same matches give the same bytes."""
        starts = [
            {
                "model": s.camera.model,
                "size_px": list(s.camera.size_px),
                "parameters": s.camera.parameters.tolist(),
                "cov": s.camera.cov.tolist(),
                "name": s.camera.name,
                "lens": s.lens,
                "known": s.known,
                "source": s.source,
            }
            for s in self.starts
        ]
        head = {
            "kind": "image_matches",
            "version": _FORMAT,
            "pictures": [asdict(picture) for picture in self.pictures],
            "starts": starts,
            "facts": self.facts,
        }
        path.parent.mkdir(parents=True, exist_ok=True)
        names = [n for n in self.__dataclass_fields__ if n not in ("pictures", "starts", "facts")]
        with path.open("wb") as file:
            np.savez_compressed(
                file, head=np.array(json.dumps(head)), **{name: getattr(self, name) for name in names}
            )

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read matches written by `write`.

        Raises
        ------
        InputError : no such file, or of another kind or version.
        """
        head, arrays = read_arrays(path, "image_matches", _FORMAT)
        starts = tuple(
            StartCamera(
                camera=Camera(
                    model=s["model"],
                    size_px=(s["size_px"][0], s["size_px"][1]),
                    parameters=np.array(s["parameters"], np.float64),
                    cov=np.array(s["cov"], np.float64),
                    name=s["name"],
                ),
                lens=s["lens"],
                known=s["known"],
                source=s["source"],
            )
            for s in head["starts"]
        )
        pictures = tuple(Picture(**{**p, "size_px": tuple(p["size_px"])}) for p in head["pictures"])
        return cls(pictures=pictures, starts=starts, facts=head["facts"], **arrays)
