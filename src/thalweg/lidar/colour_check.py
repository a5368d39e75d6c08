r"""Whether a cloud and photographs fit each other, without truth: intensity of the lidar against brightness.

Where both show the same thing, edges of one are edges of the other. The points that a photograph shows give
pairs of intensity and brightness; less the means of their surroundings in the picture, because intensity
fades with range and light with shade. With the correlation :math:`r` of the :math:`n` pairs of a photograph,
:math:`-\tfrac{n}{2}\ln(1-r^2)` is the logarithm of the likelihood ratio of dependence against none, whatever
the sign: leaves are bright in the near infrared and dark to a camera.

The sum over photographs is computed again as if each had been taken some time later on the camera's path,
and as if the camera were turned about its axes. The optimum should lie at zero. Photographs that follow each
other show the same things and err together: how well the optimum is known follows from drawing the parts of
the *scene* anew (bootstrap), and to that comes what no number of them tells: shadows all fall to one side.
So clock and mount are tested on every survey.
"""

import logging
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from scipy.ndimage import uniform_filter
from scipy.spatial.transform import Rotation

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, Camera, CoverageError
from thalweg.images.model import ImagePoses
from thalweg.lidar.colour import (
    Lens,
    Photographs,
    choose_views,
    lens_of,
    read_picture,
    seen_pixels,
    survey_cloud,
    views_of,
)
from thalweg.settings.sections import Colour

SHIFTS: Final[Mapping[str, ArrayF]] = {
    "clock_s": np.round(np.linspace(-0.5, 0.5, 21), 6),
    **dict.fromkeys(("turn_x_deg", "turn_y_deg", "turn_z_deg"), np.round(np.linspace(-2, 2, 17), 6)),
}
"""What is tried: photographs later by so much; the camera turned about its x (right), y (down), z (ahead)."""
WARN_SIGMAS: Final = 3.0
"""An optimum farther from zero than that is warned of."""
COMMON_DEG: Final = 0.15
"""What edges of intensity and of brightness differ by in a whole scene though clock and mount are right, one
sigma: shadows, slanted beams, wet feet of stones. Turns that four surveys of the twin showed (tiny, demo,
tiny with seeds 101 and 102; twelve, 0.16 degrees rms, 0.34 at most) less what parts of these scenes scatter
(0.06); twelve values leave 0.10 to 0.24 (95 %)."""
DETECTED: Final = 1.645
"""Quantile of the chance, 95 %, with which an error of the size ``detects`` is called."""
_PARTS: Final = 24
"""Parts of the scene that are drawn anew, each with as many points: stretches along its longest axis."""
_SAMPLE: Final = 150_000
_VIEWS: Final = 2
_CELLS: Final = 12
"""Surroundings whose mean is taken out: this part of the width of the picture."""
_LEAST_PAIRS: Final = 8
_LEAST_PARTS: Final = 6
_DRAWS: Final = 300
_LONGEST_GAP_S: Final = 10.0
_DETERMINED: Final = 0.25
"""An optimum whose sigma is a larger share of what was tried is no optimum."""
_LOG = logging.getLogger("thalweg")


@dataclass(frozen=True, slots=True, kw_only=True)
class Overlay:
    """Points that a photograph shows.

    Parameters
    ----------
    xyz_m, intensity : (n, 3), (n,) points in the world and their intensity.
    brightness : (h, w) the picture in grey.
    centre_m, R_wcs_ccs : (3,), (3, 3) its pose.
    velocity_m_s, rate_rad_s : (3,), (3,) of the camera in the world; NaN where it is not known.
    part : (n,) part of the scene that each point belongs to, 0, 1 ...
    """

    xyz_m: ArrayF
    intensity: ArrayF
    brightness: AnyArray
    centre_m: ArrayF
    R_wcs_ccs: ArrayF
    velocity_m_s: ArrayF
    rate_rad_s: ArrayF
    part: ArrayI

    def moved(self, kind: str, by: float) -> tuple[ArrayF, ArrayF]:
        """Its pose, moved by one of `SHIFTS`."""
        if kind == "clock_s":
            turn = Rotation.from_rotvec(by * self.rate_rad_s).as_matrix()
            return self.centre_m + by * self.velocity_m_s, turn @ self.R_wcs_ccs
        return self.centre_m, self.R_wcs_ccs @ _turn("xyz".index(kind[5]), by)


@cache
def _turn(axis: int, by_deg: float) -> ArrayF:
    return np.asarray(Rotation.from_rotvec(np.deg2rad(by_deg) * np.eye(3)[axis]).as_matrix())


def _squares(overlay: Overlay, lens: Lens, centre_m: ArrayF, R: ArrayF, cell: AnyArray, parts: int) -> ArrayF:
    """Pairs about the means of their cells: number, squares and products (4, parts)."""
    rows, pixels, _ = seen_pixels(overlay.xyz_m, centre_m, R, lens, np.inf)
    column, row = pixels.astype(np.int64).T
    pairs = np.stack([overlay.intensity[rows], overlay.brightness[row, column]])
    of_cell = cell[rows]
    n = np.bincount(of_cell, minlength=1)
    enough = n[of_cell] >= _LEAST_PAIRS
    for values in pairs:
        values -= (np.bincount(of_cell, values) / np.maximum(n, 1))[of_cell]
    a, b = pairs[:, enough]
    part = overlay.part[rows][enough]
    return np.stack([np.bincount(part, w, parts) for w in (np.ones(len(part)), a * a, b * b, a * b)])


def _dependence(squares: ArrayF) -> ArrayF:
    """Logarithms of likelihood ratios, sums over photographs, of `_squares` (photographs, shifts, 4, ...)."""
    n, aa, bb, ab = np.moveaxis(squares, 2, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        r2 = np.nan_to_num(ab**2 / (aa * bb))
    return np.asarray((-0.5 * n * np.log1p(-np.minimum(r2, 1 - 1e-9))).sum(axis=0))


def score_shifts(
    overlays: Iterable[Overlay], camera: Camera, parts: int = _PARTS
) -> tuple[dict[str, ArrayF], float]:
    """Pairs of intensity and brightness, each photograph by itself.

    Parameters
    ----------
    overlays : of photographs.
    camera : of all.
    parts : parts of the scene.

    Returns
    -------
    squares : (photographs, shifts, 4, parts) for each of `SHIFTS`: number of pairs, sums of their squares and
        products; zero where a photograph tells nothing.
    rad_s : typical speed of the scene in the photographs, radians a second.
    """
    squares: dict[str, list[ArrayF]] = {kind: [] for kind in SHIFTS}
    speed: list[float] = []
    width, lens = camera.size_px[0] / _CELLS, lens_of(camera)
    for overlay in overlays:
        at = camera.project((overlay.xyz_m - overlay.centre_m) @ overlay.R_wcs_ccs)
        place = np.clip(np.nan_to_num(at // width), 0, _CELLS * 4).astype(np.int64)
        cell = place[:, 1] * (_CELLS * 4 + 1) + place[:, 0]
        for kind, values in SHIFTS.items():
            of_kind = np.zeros((len(values), 4, parts))
            if kind != "clock_s" or np.isfinite(overlay.velocity_m_s).all():
                for j, by in enumerate(values):
                    of_kind[j] = _squares(overlay, lens, *overlay.moved(kind, by), cell, parts)
            squares[kind].append(of_kind)
        range_m = np.median(np.linalg.norm(overlay.xyz_m - overlay.centre_m, axis=1))
        speed.append(float(np.linalg.norm(overlay.velocity_m_s) / range_m))
    still = not np.isfinite(speed).any()
    return {k: np.array(rows) for k, rows in squares.items()}, np.nan if still else float(np.nanmedian(speed))


def find_optima(squares: Mapping[str, ArrayF], rad_s: float) -> pd.DataFrame:
    """Where the sums over photographs are largest, and how well that is known.

    Parameters
    ----------
    squares, rad_s : as of `score_shifts`.

    Returns
    -------
    table : a row a kind of `SHIFTS`: ``quantity``, ``optimum``, ``sigma``, ``sigmas`` (optimum over sigma),
        ``detects`` (smallest error that is called with 95 % chance), ``dependence_at_zero`` and
        ``dependence_best`` (nats a pair), ``photographs``, ``pairs``, ``verdict``: ``fits``, ``shifted`` (by
        more than three sigmas), ``beyond`` (best at the end of what was tried) or ``cannot be told``.
    """
    rng = np.random.default_rng(0)
    rows = []
    for kind, of_kind in squares.items():
        by = SHIFTS[kind]
        used = of_kind[:, :, 0].any(axis=(1, 2))
        n = float(of_kind[used, :, 0].sum(axis=2).max(axis=1).sum()) if used.any() else 0.0
        parts = np.flatnonzero(of_kind[used, :, 0].any(axis=(0, 1)))
        row = {"quantity": kind, "photographs": int(used.sum()), "pairs": int(n)}
        if used.sum() < 2 or len(parts) < _LEAST_PARTS:
            rows.append(row | {"verdict": "cannot be told"})
            continue
        of_parts = of_kind[used][..., parts]
        whole = _dependence(of_parts.sum(axis=3))
        draws = rng.multinomial(len(parts), np.full(len(parts), 1 / len(parts)), size=_DRAWS)
        optimum = _peak(by, whole)
        # the same scene with other parts of it; what is common to all parts is seen by none of them
        found = [
            _peak(by, score) for some in np.split(draws, 20) for score in _dependence(of_parts @ some.T).T
        ]
        low, high = np.quantile(found, [0.16, 0.84])  # a second top far off would rule the variance
        common = np.deg2rad(COMMON_DEG) / rad_s if kind == "clock_s" else COMMON_DEG
        sigma = float(np.hypot((high - low) / 2, common))
        edge = abs(optimum) >= by[-1] - 1e-9
        doubtful = sigma > _DETERMINED * (by[-1] - by[0]) or whole.max() < 10
        verdict = (
            "cannot be told"
            if doubtful
            else "beyond"
            if edge
            else "shifted"
            if abs(optimum) > WARN_SIGMAS * sigma
            else "fits"
        )
        rows.append(
            row
            | {
                "optimum": optimum,
                "sigma": sigma,
                "sigmas": abs(optimum) / sigma,
                "detects": (WARN_SIGMAS + DETECTED) * sigma,
                "dependence_at_zero": float(whole[len(by) // 2]) / n,
                "dependence_best": float(whole.max()) / n,
                "verdict": verdict,
            }
        )
    columns = ["quantity", "optimum", "sigma", "sigmas", "detects", "dependence_at_zero", "dependence_best"]
    return pd.DataFrame(rows).reindex(columns=[*columns, "photographs", "pairs", "verdict"])


def _peak(by: ArrayF, score: ArrayF) -> float:
    """Where the largest value lies; between the steps by the parabola through it and its neighbours."""
    k = int(np.argmax(score))
    if k in (0, len(by) - 1):
        return float(by[k])
    low, top, high = score[k - 1 : k + 2]
    bend = low - 2 * top + high
    return float(by[k] + (0.5 * (low - high) / bend * (by[1] - by[0]) if bend else 0.0))


def check_colours(
    points: Path,
    poses: ImagePoses,
    images: Mapping[str, Path],
    masks: Mapping[str, Path],
    camera: Camera,
    settings: Colour,
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Compare the intensities of a cloud with the brightness of photographs.

    Parameters
    ----------
    points, settings : as `thalweg.lidar.colour_cloud` takes them.
    poses, images, masks, camera : see `thalweg.lidar.Photographs`.

    Returns
    -------
    table : see `find_optima`; what is shifted is warned of.
    curves : dependence over what was tried: quantity, shift, dependence (nats a pair).

    Raises
    ------
    InputError : the cloud lies in another frame, or a photograph cannot be read.
    CoverageError : no image can be used, or none shows enough points.
    """
    photographs = Photographs(poses=poses, images=images, masks=masks, camera=camera)
    views = views_of(points, [photographs], settings)
    sample = survey_cloud(points, views, settings, most=_SAMPLE)
    with ThreadPoolExecutor(max_workers=2) as pool:
        few = settings.model_copy(update={"views": _VIEWS})
        chosen = choose_views(sample, views, few, pool)
    order = np.argsort(chosen.view, axis=None, kind="stable")
    first = np.searchsorted(chosen.view.ravel()[order], np.arange(len(views.paths) + 1))
    shown = np.flatnonzero(np.diff(first) >= 10 * _LEAST_PAIRS)
    if not len(shown):
        raise CoverageError(
            "no photograph shows enough points of the cloud",
            expected="photographs of what the lidar scanned",
            cure="Look at lidar/coloured.csv, which says why points have no colour",
        )
    velocity, rate = _motion(views.t_gps_s, views.centre_m, views.R_wcs_ccs)
    part = _stretches(sample["xyz_m"], chosen.view.max(axis=1) >= 0)

    def overlays() -> Iterator[Overlay]:
        """One photograph after the other: they would not all fit into memory."""
        for v in shown:
            rows = order[first[v] : first[v + 1]] // chosen.view.shape[1]
            yield Overlay(
                xyz_m=sample["xyz_m"][rows],
                intensity=sample["intensity"][rows].astype(np.float64),
                brightness=grey_of(views.paths[v], camera),
                centre_m=views.centre_m[v],
                R_wcs_ccs=views.R_wcs_ccs[v],
                velocity_m_s=velocity[v],
                rate_rad_s=rate[v],
                part=part[rows],
            )

    squares, rad_s = score_shifts(overlays(), camera)
    table = find_optima(squares, rad_s)
    for row in table[table["verdict"].isin(["shifted", "beyond"])].to_dict("records"):
        _LOG.warning(
            "%s: intensity and brightness fit best at %+.3f +- %.3f, not at 0 (%.1f sigmas): "
            "check the clock and the mount of the camera",
            row["quantity"],
            row["optimum"],
            row["sigma"],
            row["sigmas"],
        )
    pairs = dict(zip(table["quantity"], table["pairs"], strict=True))
    curves = [
        (kind, by, value / max(pairs[kind], 1))
        for kind, of_kind in squares.items()
        for by, value in zip(SHIFTS[kind], _dependence(of_kind.sum(axis=3)), strict=True)
    ]
    return table, pd.DataFrame(curves, columns=["quantity", "shift", "dependence"])


def _stretches(xyz_m: ArrayF, shown: ArrayB) -> ArrayI:
    """Part of the scene (n,) of points (n, 3), along the longest axis, each with as many shown ones (n,)."""
    level = xyz_m[:, :2] - xyz_m[shown, :2].mean(axis=0)
    along = level @ np.linalg.svd(level[shown], full_matrices=False)[2][0]
    return np.searchsorted(np.quantile(along[shown], np.arange(1, _PARTS) / _PARTS), along)


def grey_of(path: Path, camera: Camera) -> AnyArray:
    """Brightness of a photograph (h, w), smoothed to about the footprint of a beam."""
    grey = read_picture(path, camera.size_px).mean(axis=2, dtype=np.float32)
    return uniform_filter(grey, max(3, camera.size_px[0] // 500))


def _motion(t_gps_s: ArrayF, centre_m: ArrayF, R_wcs_ccs: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Velocities and rates of turn (v, 3) from the photographs before and after; NaN at gaps and ends."""
    n = len(t_gps_s)
    velocity, rate = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    order = np.argsort(t_gps_s)
    before, at, after = order[:-2], order[1:-1], order[2:]
    span = t_gps_s[after] - t_gps_s[before]
    good = (span > 0) & (span < _LONGEST_GAP_S)
    before, at, after, span = before[good], at[good], after[good], span[good, None]
    if len(at):
        velocity[at] = (centre_m[after] - centre_m[before]) / span
        turned = Rotation.from_matrix(R_wcs_ccs[after] @ np.swapaxes(R_wcs_ccs[before], 1, 2))
        rate[at] = turned.as_rotvec() / span
    return velocity, rate
