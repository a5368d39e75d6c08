"""Exterior orientations of images with their covariances: what every way of orienting images hands on.

The pose of an image is ``T_wcs_ccs``: projection centre in the world frame and ``R_wcs_ccs``. Its error is
``(dx, dtheta)`` as of `thalweg.core.trajectory`: a shift of the projection centre in wcs and a small rotation
vector in wcs, ``R_true = exp([dtheta]x) R_estimated``. Images that share tie points err alike; the table
keeps the covariance of each image with the next one, which is what an interpolation between both needs.
"""

from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import pyarrow as pa
from scipy.spatial.transform import Rotation

from thalweg.core import (
    ArrayB,
    ArrayF,
    LocalFrame,
    Rigid,
    column,
    frame_of,
    read_table,
    table_kind,
    write_table,
)

_PARTS: Final = ("east", "north", "up", "rotation_east", "rotation_north", "rotation_up")
_UNITS: Final = ("m", "m", "m", "rad", "rad", "rad")
_LOWER: Final = [(i, j) for i in range(6) for j in range(i + 1)]

IMAGE_POSES = table_kind(
    "image_poses",
    1,
    [
        column("image", "1", "name of the file", pa.string()),
        column("t_gps_s", "s", "adjusted standard GPS time of the exposure; NaN if not known"),
        column("sigma_t_s", "s", "its standard deviation"),
        column("oriented", "1", "whether the image has a pose", pa.bool_()),
        column("reason", "1", "why it has none", pa.string()),
        *(column(f"{a}_m", "m", f"{a} of the projection centre in wcs") for a in ("east", "north", "up")),
        *(column(f"q{a}", "1", f"quaternion of R_wcs_ccs, {a} (scalar last)") for a in "xyzw"),
        *(
            column(f"cov_{_PARTS[i]}_{_PARTS[j]}", f"{_UNITS[i]} {_UNITS[j]}", "covariance of two errors")
            for i, j in _LOWER
        ),
        *(
            column(
                f"next_{_PARTS[i]}_{_PARTS[j]}",
                f"{_UNITS[i]} {_UNITS[j]}",
                "covariance of this image's first with the next oriented image's second error",
            )
            for i in range(6)
            for j in range(6)
        ),
        column("n_marks", "1", "tie points and control points measured in the image", pa.int64()),
        column("rms_px", "px", "root mean square of their residuals; NaN if not known"),
    ],
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImagePoses:
    """Poses ``T_wcs_ccs`` of a series of images, in the order of their names' times.

    Parameters
    ----------
    frame : the world frame.
    images : n names.
    t_gps_s, sigma_t_s : (n,) time of exposure and its standard deviation; NaN where not known.
    oriented : (n,) whether the image has a pose; the values of others are NaN.
    reasons : n texts, why an image has none; empty for the others.
    centre_wcs_m : (n, 3) projection centres.
    R_wcs_ccs : (n, 3, 3) rotations.
    cov_pose_wcs : (n, 6, 6) covariance of (dx, dtheta) in wcs, metres and radians.
    cov_next : (n, 6, 6) covariance of an image's error with that of the next oriented image; zero for the
        last one.
    n_marks, rms_px : (n,) image measurements and the rms of their residuals.
    """

    frame: LocalFrame
    images: tuple[str, ...]
    t_gps_s: ArrayF
    sigma_t_s: ArrayF
    oriented: ArrayB
    reasons: tuple[str, ...]
    centre_wcs_m: ArrayF
    R_wcs_ccs: ArrayF
    cov_pose_wcs: ArrayF
    cov_next: ArrayF
    n_marks: ArrayF
    rms_px: ArrayF
    facts: dict[str, Any] = field(default_factory=dict)
    """JSON-able facts about the whole series: where it comes from, sigma0."""

    def pose(self, k: int) -> Rigid:
        """``T_wcs_ccs`` of image k with its covariance."""
        return Rigid(R=self.R_wcs_ccs[k], shift_m=self.centre_wcs_m[k], cov=self.cov_pose_wcs[k])

    @property
    def quaternions(self) -> ArrayF:
        """(n, 4) of ``R_wcs_ccs``, scalar last; NaN without a pose."""
        out = np.full((len(self.images), 4), np.nan)
        if self.oriented.any():
            out[self.oriented] = Rotation.from_matrix(self.R_wcs_ccs[self.oriented]).as_quat()
        return out

    def with_times(self, t_gps_s: ArrayF, sigma_t_s: ArrayF) -> "ImagePoses":
        """The same poses with other times of exposure."""
        return replace(self, t_gps_s=t_gps_s, sigma_t_s=sigma_t_s)

    def write(self, path: Path) -> None:
        """Write as Parquet table of kind ``image_poses``."""
        columns: dict[str, Any] = {
            "image": list(self.images),
            "t_gps_s": self.t_gps_s,
            "sigma_t_s": self.sigma_t_s,
            "oriented": self.oriented,
            "reason": list(self.reasons),
            "n_marks": self.n_marks,
            "rms_px": self.rms_px,
        }
        columns |= {f"{a}_m": self.centre_wcs_m[:, i] for i, a in enumerate(_PARTS[:3])}
        columns |= {f"q{a}": values for a, values in zip("xyzw", self.quaternions.T, strict=True)}
        columns |= {f"cov_{_PARTS[i]}_{_PARTS[j]}": self.cov_pose_wcs[:, i, j] for i, j in _LOWER}
        columns |= {
            f"next_{_PARTS[i]}_{_PARTS[j]}": self.cov_next[:, i, j] for i in range(6) for j in range(6)
        }
        meta = {**self.facts, "origin": asdict(self.frame)}
        write_table(path, frame_of(IMAGE_POSES, columns), IMAGE_POSES, meta)

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read poses written by `write`."""
        table, meta = read_table(path, IMAGE_POSES)
        n = len(table)
        cov = np.empty((n, 6, 6))
        following = np.empty((n, 6, 6))
        for i, j in _LOWER:
            cov[:, i, j] = cov[:, j, i] = table[f"cov_{_PARTS[i]}_{_PARTS[j]}"].to_numpy()
        for i in range(6):
            for j in range(6):
                following[:, i, j] = table[f"next_{_PARTS[i]}_{_PARTS[j]}"].to_numpy()
        oriented = table["oriented"].to_numpy(dtype=np.bool_)
        R = np.full((n, 3, 3), np.nan)
        if oriented.any():
            R[oriented] = Rotation.from_quat(table[["qx", "qy", "qz", "qw"]].to_numpy()[oriented]).as_matrix()
        return cls(
            frame=LocalFrame(**meta.pop("origin")),
            images=tuple(table["image"]),
            t_gps_s=table["t_gps_s"].to_numpy(),
            sigma_t_s=table["sigma_t_s"].to_numpy(),
            oriented=oriented,
            reasons=tuple(table["reason"].fillna("")),
            centre_wcs_m=table[["east_m", "north_m", "up_m"]].to_numpy(),
            R_wcs_ccs=R,
            cov_pose_wcs=cov,
            cov_next=following,
            n_marks=table["n_marks"].to_numpy(dtype=np.float64),
            rms_px=table["rms_px"].to_numpy(),
            facts=meta,
        )


def unknown_poses(frame: LocalFrame, names: tuple[str, ...]) -> ImagePoses:
    """Names of images of which nothing is known beforehand."""
    n = len(names)
    return ImagePoses(
        frame=frame,
        images=names,
        t_gps_s=np.full(n, np.nan),
        sigma_t_s=np.full(n, np.nan),
        oriented=np.zeros(n, np.bool_),
        reasons=("",) * n,
        centre_wcs_m=np.full((n, 3), np.nan),
        R_wcs_ccs=np.full((n, 3, 3), np.nan),
        cov_pose_wcs=np.full((n, 6, 6), np.nan),
        cov_next=np.full((n, 6, 6), np.nan),
        n_marks=np.full(n, np.nan),
        rms_px=np.full(n, np.nan),
    )
