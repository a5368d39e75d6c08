"""A block of images: who sees which point where, and a start for every pose and point.

This is what structure from motion hands to the adjustment. Pixels count from the upper left corner of the
image, as in `thalweg.core.camera.model`. The frame is either that of the structure-from-motion model (any
scale, any attitude) or, once the block has been transformed, the world frame wcs.
"""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Self

import numpy as np

from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError, InputError
from thalweg.core.types import ArrayF, ArrayI

_FORMAT: Final = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageBlock:
    """Images with poses, points, and the marks that join them.

    Parameters
    ----------
    cameras : interior orientations.
    images : i names, sorted.
    camera : (i,) index into ``cameras``.
    R_block_ccs : (i, 3, 3) rotations from the camera into the frame of the block.
    centre_block_m : (i, 3) projection centres; not metres before the block is scaled.
    points_block_m : (p, 3) object points.
    mark_image, mark_point : (m,) image and point of each measurement.
    mark_px : (m, 2) measured pixels.
    sigma_px : (m,) standard deviation of each coordinate of a measurement.

    Raises
    ------
    GeometryError : shapes that differ, or a mark of an image or a point that does not exist.
    """

    cameras: tuple[Camera, ...]
    images: tuple[str, ...]
    camera: ArrayI
    R_block_ccs: ArrayF
    centre_block_m: ArrayF
    points_block_m: ArrayF
    mark_image: ArrayI
    mark_point: ArrayI
    mark_px: ArrayF
    sigma_px: ArrayF

    def __post_init__(self) -> None:
        i, p, m = len(self.images), len(self.points_block_m), len(self.mark_image)
        shapes: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {
            "camera": (self.camera.shape, (i,)),
            "R_block_ccs": (self.R_block_ccs.shape, (i, 3, 3)),
            "centre_block_m": (self.centre_block_m.shape, (i, 3)),
            "points_block_m": (self.points_block_m.shape, (p, 3)),
            "mark_point": (self.mark_point.shape, (m,)),
            "mark_px": (self.mark_px.shape, (m, 2)),
            "sigma_px": (self.sigma_px.shape, (m,)),
        }
        for name, (found, expected) in shapes.items():
            if found != expected:
                raise GeometryError(f"{name}.shape={found}", expected=str(expected))
        for name, at, n in (("image", self.mark_image, i), ("point", self.mark_point, p)):
            if m and not (int(at.min()) >= 0 and int(at.max()) < n):
                raise GeometryError(f"a mark of {name} {int(at.max())}", expected=f"{name}s 0 to {n - 1}")

    def transformed(self, R: ArrayF, shift_m: ArrayF, scale: float) -> "ImageBlock":
        """The block in another frame: ``x -> scale R x + shift``."""
        return replace(
            self,
            R_block_ccs=R @ self.R_block_ccs,
            centre_block_m=scale * self.centre_block_m @ R.T + shift_m,
            points_block_m=scale * self.points_block_m @ R.T + shift_m,
        )

    def residuals_px(self) -> ArrayF:
        """Measured minus projected pixels (m, 2); NaN for points behind their camera."""
        out = np.empty_like(self.mark_px)
        for k in range(len(self.images)):
            rows = np.flatnonzero(self.mark_image == k)
            seen = self.points_block_m[self.mark_point[rows]] - self.centre_block_m[k]
            xy = self.cameras[self.camera[k]].project(seen @ self.R_block_ccs[k])
            out[rows] = self.mark_px[rows] - xy
        return out

    def write(self, path: Path) -> None:
        """Write all arrays and cameras as one ``.npz``."""
        cameras = [
            {
                "name": c.name,
                "model": c.model,
                "size_px": list(c.size_px),
                "parameters": c.parameters.tolist(),
                "cov": c.cov.tolist(),
            }
            for c in self.cameras
        ]
        head = {"kind": "image_block", "version": _FORMAT, "images": list(self.images), "cameras": cameras}
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            np.savez_compressed(
                file,
                head=np.array(json.dumps(head)),
                camera=self.camera,
                R_block_ccs=self.R_block_ccs,
                centre_block_m=self.centre_block_m,
                points_block_m=self.points_block_m,
                mark_image=self.mark_image,
                mark_point=self.mark_point,
                mark_px=self.mark_px,
                sigma_px=self.sigma_px,
            )

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a block written by `write`.

        Raises
        ------
        InputError : no such file, or of another kind or version.
        """
        if not path.is_file():
            raise InputError("file not found", expected="a block of images", where=path)
        try:
            with np.load(path, allow_pickle=False) as stored:
                arrays = {name: stored[name] for name in stored.files}
            head = json.loads(str(arrays.pop("head")))
        except (ValueError, KeyError, OSError) as error:
            raise InputError(f"no block of images ({error})", expected="an .npz", where=path) from error
        if (head.get("kind"), head.get("version")) != ("image_block", _FORMAT):
            raise InputError(
                f"{head.get('kind')} version {head.get('version')}",
                expected=f"image_block version {_FORMAT}",
                where=path,
                cure="Rebuild it with this version of Thalweg",
            )
        cameras = tuple(
            Camera(
                name=c["name"],
                model=c["model"],
                size_px=(c["size_px"][0], c["size_px"][1]),
                parameters=np.array(c["parameters"], np.float64),
                cov=np.array(c["cov"], np.float64),
            )
            for c in head["cameras"]
        )
        return cls(cameras=cameras, images=tuple(head["images"]), **arrays)
