"""Did the camera stay the same through all pictures of a field?

A lens that is focused anew, a zoom that creeps or a sensor that is stabilised gives the later pictures
another interior orientation. One bundle with one camera then bends the field, and its residuals hardly tell.
So each place between two pictures is tried as the beginning of another camera constant and principal point:
as extra unknowns of the finished adjustment (a score test, Rao 1948), which takes no new adjustment.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2

from thalweg.calibration.field.bundle import Layout, Problem, State, marks_model
from thalweg.core.adjustment.solve import Adjusted
from thalweg.core.errors import GeometryError
from thalweg.core.types import ArrayF

_LEVEL: Final = 1e-4
"""Probability with which a steady camera is called changed."""
_LEAST_IMAGES: Final = 3
"""Pictures on either side of the place where a camera may have changed."""
_NOTED: Final = 0.3
_REFUSED: Final = 3.0
"""Bending of the field over its sigmas from which on it is told, and from which on it is refused."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraChange:
    """The most likely change of a camera in the course of the pictures.

    Parameters
    ----------
    camera : its name.
    before, since : last picture before and first picture after the change, by the order of the file names.
    constant : relative change of the camera constant, and ``sigma_constant``.
    shift_px : (2,) change of the principal point.
    probability : of a change at least as clear if the camera is steady, over all places that were tried.
    bend_m : root mean square of the change of the points if the change is accounted for.
    bend_sigmas : the same over that of their standard deviations.
    """

    camera: str
    before: str
    since: str
    constant: float
    sigma_constant: float
    shift_px: tuple[float, float]
    probability: float
    bend_m: float
    bend_sigmas: float

    @property
    def clear(self) -> bool:
        """It is no accident, and it matters."""
        return self.probability < _LEVEL and self.bend_sigmas > _NOTED

    @property
    def words(self) -> str:
        """What was found and what to do, for people."""
        x, y = self.shift_px
        return (
            f"the camera {self.camera} changed between {self.before} and {self.since}: camera constant by "
            f"{self.constant:+.3%} (sigma {self.sigma_constant:.3%}), principal point by {x:+.1f} and "
            f"{y:+.1f} pixels. The lens was focused or zoomed, or its stabiliser was on; that bends the "
            f"field by {self.bend_m * 1000:.2f} mm, {self.bend_sigmas:.1f} times its sigma. Take out the "
            "pictures before or since, or take all again with focus and zoom taped and the stabiliser off"
        )


def camera_changes(problem: Problem, adjusted: Adjusted[State], layout: Layout) -> list[CameraChange]:
    """The most likely change of each camera with enough pictures.

    Parameters
    ----------
    problem, adjusted, layout : a finished adjustment; pictures in the order in which they were taken.
    """
    x, block, used = adjusted.x, problem.block, problem.used
    part = marks_model(problem, layout, x)
    image = block.image[used]
    weight = 1.0 / block.sigma_px[used]
    residual = part.residual.reshape(-1, 2) * weight[:, None]
    by_camera = _by_interior(problem, x) * weight[:, None, None]
    n = len(block.images)
    square, side = np.zeros((n, 3, 3)), np.zeros((n, 3))
    np.add.at(square, image, np.swapaxes(by_camera, 1, 2) @ by_camera)
    np.add.at(side, image, (np.swapaxes(by_camera, 1, 2) @ residual[:, :, None])[:, :, 0])
    rows = part.jacobian
    pairs = np.zeros((n, len(layout.names), 3))
    weights = np.repeat(weight, 2)
    for i in range(n):
        mine = np.repeat(image == i, 2)
        pairs[i] = rows[mine].T @ (by_camera[image == i].reshape(-1, 3) * weights[mine, None])
    found = []
    for k, camera in enumerate(x.cameras):
        mine = np.flatnonzero(problem.camera == k)
        if len(mine) < 2 * _LEAST_IMAGES:
            continue
        # all sums run over the pictures since the change, the last one first
        S, g, B = (np.cumsum(a[mine][::-1], axis=0)[::-1] for a in (square, side, pairs))
        change = _likeliest(S, g, B, adjusted, layout)
        if change is not None:
            at, values, sigmas, probability = change
            names = [block.images[i] for i in mine]
            moved = (adjusted.cov[layout.points :] @ (B[at] @ values)).ravel()
            sigma = float(np.sqrt(np.diag(adjusted.cov)[layout.points :].mean()))
            bend = float(np.sqrt(np.square(moved).mean()))
            found.append(
                CameraChange(
                    camera=camera.name, before=names[at - 1], since=names[at], constant=float(values[0]),
                    sigma_constant=float(sigmas[0]), shift_px=(float(values[1]), float(values[2])),
                    probability=probability, bend_m=bend, bend_sigmas=bend / sigma,
                )
            )  # fmt: skip
    return found


def require_steady(changes: list[CameraChange]) -> None:
    """Refuse a field that a changed camera has bent far beyond its sigmas.

    Raises
    ------
    GeometryError : names the camera and the pictures between which it changed.
    """
    for change in changes:
        if change.clear and change.bend_sigmas > _REFUSED:
            found, _, cure = change.words.partition(". Take out")
            raise GeometryError(
                found, expected="one focus and one zoom for all pictures of a camera", cure=f"Take out{cure}"
            )


def _likeliest(
    S: ArrayF, g: ArrayF, B: ArrayF, adjusted: Adjusted[State], layout: Layout
) -> tuple[int, ArrayF, ArrayF, float] | None:
    """First picture after the change; (3,) relative constant and principal point, sigmas; probability."""
    tried = range(_LEAST_IMAGES, len(S) - _LEAST_IMAGES + 1)
    best: tuple[float, int, ArrayF, ArrayF] | None = None
    for at in tried:
        left = S[at] - B[at].T @ adjusted.cov @ B[at]
        scale = np.sqrt(np.maximum(np.diag(S[at]), 1e-30))
        # what the adjustment already knows leaves nothing to tell
        if np.linalg.eigvalsh(left / np.outer(scale, scale))[0] < 1e-9:
            continue
        values = -np.linalg.solve(left, g[at])
        score = float(values @ left @ values)
        if best is None or score > best[0]:
            best = score, at, values, np.sqrt(np.diag(np.linalg.inv(left)))
    if best is None:
        return None
    score, at, values, sigmas = best
    return at, values, sigmas, min(1.0, float(chi2.sf(score, 3)) * len(tried))


def _by_interior(problem: Problem, x: State) -> ArrayF:
    """(m, 2, 3) derivatives of used marks by the relative camera constant and by the principal point."""
    block, used = problem.block, problem.used
    image, point = block.image[used], block.point[used]
    local = np.einsum("mji,mj->mi", x.R[image], x.X[point] - x.C[image])
    out = np.zeros((len(image), 2, 3))
    for k, camera in enumerate(x.cameras):
        rows = problem.camera[image] == k
        _, _, by_parameters = camera.project_with_derivatives(local[rows])
        out[rows, :, 0] = by_parameters[:, :, :2] @ camera.parameters[:2]
        out[rows, :, 1:] = by_parameters[:, :, 2:4]
    return out
