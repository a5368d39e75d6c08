"""Masks of a series of images: learned from a sample of it, then drawn image by image."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from thalweg.core.camera.model import Camera
from thalweg.core.errors import InputError
from thalweg.core.types import AnyArray, ArrayB, ArrayF32, ArrayU8
from thalweg.images.masks.features import (
    coarse_features,
    fine_features,
    read_reduced,
    scaled_to,
    shore_edges,
)
from thalweg.images.masks.geometry import depression, nominal_depression
from thalweg.images.masks.hull import LEAST_IMAGES, steady_parts
from thalweg.images.masks.learning import Sample, Scenery, labelled, learn_scenery, line_of, reaches_top
from thalweg.images.masks.mirror import mirror_level
from thalweg.images.masks.settings import HULL, LAND, SKY, WATER, MaskSettings
from thalweg.images.masks.sky import SkyModel, learn_sky, sky_pixels
from thalweg.images.model.poses import ImagePoses

_USUAL_LINE_DEG: Final = 3.0
_LINE_SPREAD_DEG: Final = 3.0
"""Water lines of banks lie so far below the horizon: a camera 1 m above the water, a bank 20 m away."""

_PRICE: Final = 0.02
"""Price of a mirror level one standard deviation off, in units of correlation."""

_LOOKS_OF_SKY: Final = 12
ASPECT: Final = 0.02
"""Proportions of a camera and of its images may differ by this share."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Horizons:
    """What is known of the horizon in the images of a series.

    Parameters
    ----------
    camera : of the full images; None: no poses.
    R_wcs_ccs : attitude of the images that have one, by name.
    sigma_deg : their standard deviation.
    """

    camera: Camera | None = None
    R_wcs_ccs: Mapping[str, AnyArray]
    sigma_deg: float

    @classmethod
    def of(cls, poses: ImagePoses | None, camera: Camera | None, settings: MaskSettings) -> "Horizons":
        """From approximate poses.

        Raises
        ------
        InputError : poses without a camera.
        """
        if poses is None or not poses.oriented.any():
            return cls(R_wcs_ccs={}, sigma_deg=np.inf)
        if camera is None:
            raise InputError(
                "approximate poses without a camera",
                expected="its interior orientation, at least from the data sheet",
                cure="Give the camera, or no poses",
            )
        known = np.flatnonzero(poses.oriented)
        variance = np.nan_to_num(np.trace(poses.cov_pose_wcs[known, 3:, 3:], axis1=1, axis2=2) / 3)
        sigma = max(float(np.rad2deg(np.sqrt(np.median(variance)))), settings.pose_sigma_deg)
        return cls(
            camera=camera,
            R_wcs_ccs={poses.images[k]: poses.R_wcs_ccs[k] for k in known},
            sigma_deg=sigma,
        )

    def below_deg(self, name: str, size_px: tuple[int, int]) -> ArrayF32:
        """Degrees below the horizon (h, w) of an image; for one without pose those of a middle image."""
        if self.camera is None or not self.R_wcs_ccs:
            return nominal_depression(size_px)
        R = self.R_wcs_ccs.get(name)
        if R is None:
            # The camera is fixed to the boat: where the horizon is does not depend on the heading.
            turns = np.stack(list(self.R_wcs_ccs.values()))
            middle = int(np.argsort(turns[:, 2, 2])[len(turns) // 2])
            R = turns[middle]
        return depression(self.camera, R, size_px)

    def price(self, below_deg: ArrayF32) -> ArrayF32 | None:
        """Price of a mirror level (h, w); None without poses."""
        if self.camera is None:
            return None
        sigma = np.hypot(self.sigma_deg, _LINE_SPREAD_DEG)
        return np.asarray(_PRICE * ((below_deg - _USUAL_LINE_DEG) / sigma) ** 2, dtype=np.float32)


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesModel:
    """What was learned from a series.

    Parameters
    ----------
    scenery : water, sky and land; None if no image showed both land and water.
    sky : sky and land pixel by pixel; None if there is no sky.
    hull : (h, w) own boat in images of ``size_px``.
    size_px : full size of most images.
    horizons : of the series.
    settings : how images are masked.
    notes : what a user should know about the whole series.
    """

    scenery: Scenery | None
    sky: SkyModel | None
    hull: ArrayB
    size_px: tuple[int, int]
    horizons: Horizons
    settings: MaskSettings
    notes: tuple[str, ...]

    def parts(self, image: ArrayU8, size_px: tuple[int, int], name: str) -> tuple[ArrayU8, list[str]]:
        """Parts (h, w) of an image at analysis size, in the codes of `mask_settings`, and notes.

        Parameters
        ----------
        image : (h, w, 3) reduced image.
        size_px : size of the full image.
        name : of its file, for the pose.
        """
        h, w = image.shape[:2]
        notes = []
        hull = np.zeros((h, w), dtype=np.bool_)
        if size_px == self.size_px:
            hull = _wider(enlarged(self.hull, (w, h)), self.settings.hull_margin_share * h)
        elif self.hull.any():
            notes.append("another size than most images: the own boat is not masked")
        out = np.full((h, w), LAND, dtype=np.uint8)
        if self.scenery is not None:
            found = self._lines(image, name, hull)
            if not (found < h).any():
                notes.append("no water line found")
            y = np.arange(h)[:, None]
            out[y >= found - self.settings.margin_share * h] = WATER
            if self.sky is not None:
                out[sky_pixels(self.sky, fine_features(image), (out == LAND) & ~hull)] = SKY
        out[hull] = HULL
        return out, notes

    def _lines(self, image: ArrayU8, name: str, hull: ArrayB) -> AnyArray:
        """First row of water (w,) in each column of an image at analysis size."""
        assert self.scenery is not None
        coarse = scaled_to(image, self.settings.analysis_px // 2)
        ch, cw = coarse.shape[:2]
        small = enlarged(hull, (cw, ch))
        sample = _sample(coarse, small, name, self.horizons)
        rows = line_of(self.scenery.model.log_probability(sample.features), sample, small, self.scenery)
        h, w = image.shape[:2]
        at = (np.arange(w) + 0.5) * cw / w - 0.5
        return np.interp(at, np.arange(cw), np.where(rows >= ch, 2 * ch, rows)) * h / ch


def learn_series(images: Mapping[str, Path], settings: MaskSettings, horizons: Horizons) -> SeriesModel:
    """Learn hull, water, sky and land from images spread over a series.

    Parameters
    ----------
    images : by name, in order; those that cannot be read are passed over.
    settings : how they are masked.
    horizons : what is known of the horizon.

    Raises
    ------
    InputError : no image can be read, or the camera has not their proportions.
    """
    rng = np.random.default_rng(settings.seed)
    chosen = np.unique(np.linspace(0, len(images) - 1, min(settings.sample_images, len(images))).astype(int))
    every = list(images.items())
    read = _readable([every[k] for k in chosen], settings) or _readable(every, settings)
    if not read:
        raise InputError(
            f"none of {len(images)} images can be read", expected="JPEG, PNG or TIFF",
            where=every[0][1].parent, cure="Copy the files again",
        )  # fmt: skip
    sizes = [size for _, _, size in read]
    size = max(sorted(set(sizes)), key=sizes.count)
    _check_proportions(horizons.camera, size)
    fine = [(name, image) for name, image, own in read if own == size]
    coarse = [(name, scaled_to(image, settings.analysis_px // 2)) for name, image in fine]
    notes = []
    hull = steady_parts([image for _, image in coarse])
    if len(coarse) < LEAST_IMAGES:
        notes.append(f"{len(coarse)} images are too few to find the own boat by what keeps its place")
    samples = [_sample(image, hull, name, horizons) for name, image in coarse]
    scenery = learn_scenery(samples, hull, rng)
    sky = None
    if scenery is None:
        notes.append("water and land cannot be told apart: only the own boat is masked")
    else:
        step = max(-(-len(fine) // _LOOKS_OF_SKY), 1)
        sky = _learned_sky([i for _, i in fine][::step], samples[::step], hull, scenery, rng)
        if sky is None:
            notes.append("no sky found in the series")
    return SeriesModel(
        scenery=scenery, sky=sky, hull=hull, size_px=size, horizons=horizons, settings=settings,
        notes=tuple(notes),
    )  # fmt: skip


def _readable(
    images: Sequence[tuple[str, Path]], settings: MaskSettings
) -> list[tuple[str, ArrayU8, tuple[int, int]]]:
    """Name, reduced image and full size of what can be read."""
    out = []
    for name, path in images:
        try:
            out.append((name, *read_reduced(path, settings.analysis_px)))
        except InputError:
            continue
    return out


def _check_proportions(camera: Camera | None, size_px: tuple[int, int]) -> None:
    if camera is None:
        return
    (w, h), (a, b) = camera.size_px, size_px
    if abs(w * b - a * h) > ASPECT * w * b:
        raise InputError(
            f"a camera of {w} x {h} pixels for images of {a} x {b}",
            expected="the same proportions",
            cure="Give the calibration of this camera, or no poses",
        )


def _sample(image: ArrayU8, hull: ArrayB, name: str, horizons: Horizons) -> Sample:
    h, w = image.shape[:2]
    below = horizons.below_deg(name, (w, h))
    level, _, agreement = mirror_level(image, hull, horizons.price(below))
    return Sample(
        features=coarse_features(image),
        below_deg=below,
        level=level,
        edge=shore_edges(image),
        mirror=agreement,
    )


def _learned_sky(
    images: Sequence[ArrayU8],
    samples: Sequence[Sample],
    hull: ArrayB,
    scenery: Scenery,
    rng: np.random.Generator,
) -> SkyModel | None:
    rough = []
    for image, sample in zip(images, samples, strict=True):
        log_p = scenery.model.log_probability(sample.features)
        part = labelled(log_p, line_of(log_p, sample, hull, scenery), hull)
        # Holes between leaves and white walls look alike in the rough: neither is a pattern.
        part[(part == SKY) & ~reaches_top(part == SKY)] = -1
        h, w = image.shape[:2]
        rough.append(cv2.resize(part, (w, h), interpolation=cv2.INTER_NEAREST))
    return learn_sky([fine_features(image) for image in images], rough, rng)


def enlarged(part: ArrayB, size_px: tuple[int, int]) -> ArrayB:
    """A part (h, w) at another size, its border smooth."""
    values = part.astype(np.float32)
    if (part.shape[1], part.shape[0]) == size_px:
        return part
    return np.asarray(cv2.resize(values, size_px, interpolation=cv2.INTER_LINEAR) >= 0.5)


def _wider(part: ArrayB, margin_px: float) -> ArrayB:
    k = 2 * max(round(margin_px), 1) + 1
    return np.asarray(cv2.dilate(part.astype(np.uint8), np.ones((k, k), np.uint8)).astype(np.bool_))
