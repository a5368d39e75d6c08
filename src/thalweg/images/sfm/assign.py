"""Interior orientations to begin with, and which one each image has."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from thalweg.core.camera.model import Camera
from thalweg.core.errors import GeometryError, InputError
from thalweg.core.types import ArrayI
from thalweg.images.model.cameras import ImageCamera, camera_note
from thalweg.images.model.files import Picture, with_problem
from thalweg.images.sfm.camera import (
    StartCamera,
    cameras_by_size,
    focal_from_exif,
    start_given,
    start_guessed,
)

_UNLIKE: Final = 1.08
"""Ratio of calibrated and stated focal length beyond which a note says so; EXIF rounds to millimetres."""
_OTHER_LENS: Final = 1.25
"""Ratio of calibrated and stated focal length beyond which they are not of one lens."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Interiors:
    """Given interior orientations: ``cameras`` told apart by the size of their pictures, and those
    ``of_folder`` for the images in a folder and below it. Either may be empty.
    """

    cameras: tuple[Camera, ...] = ()
    of_folder: Mapping[str, Camera] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Assigned:
    """Starts ``starts``, index ``camera`` (i,) of each image into them (-1: takes no part), ``pictures`` with
    the problems that came up, and ``notes``.
    """

    starts: tuple[StartCamera, ...]
    camera: ArrayI
    pictures: tuple[Picture, ...]
    notes: list[str]


def assign_cameras(
    pictures: Sequence[Picture],
    images: Mapping[str, Path],
    groups: Sequence[ImageCamera],
    given: Interiors,
    *,
    lens: str = "auto",
    interior: str = "auto",
) -> Assigned:
    """A start for each camera and each size of its pictures: as given, else by EXIF, else a guess.

    A camera whose focal length by EXIF contradicts the common interior orientation, while that of another
    camera does not, is another lens or zoom: its own focal length is the start.

    Parameters
    ----------
    pictures : of all images.
    images : their files by name.
    groups : which images one camera took.
    lens, interior : settings of the section ``images.mapping``.

    Raises
    ------
    InputError : no image is of a given camera's size; EXIF contradicts the given interior orientation; or it
        shall stay fixed, and none is given.
    """
    out, camera = list(pictures), np.full(len(pictures), -1, np.int64)
    at = {picture.name: k for k, picture in enumerate(pictures)}
    good = [(g, k) for g, group in enumerate(groups) for k in sorted(at[n] for n in group.images if n in at)]
    good = [(g, k) for g, k in good if not pictures[k].problem]
    size_of = {k: pictures[k].size_px for _, k in good}
    common = sorted(k for g, k in good if not groups[g].folder)
    by_size: dict[int, int] = {}
    if given.cameras and common:
        found, reasons = cameras_by_size([size_of[k] for k in common], given.cameras)
        by_size = dict(zip(common, found, strict=True))
        for k, reason in zip(common, reasons, strict=True):
            out[k] = with_problem(out[k], reason, "size") if reason else out[k]
    rows: dict[tuple[int, tuple[int, int]], list[int]] = {}
    for g, k in good:
        if not out[k].problem:
            rows.setdefault((g, size_of[k]), []).append(k)
    known: dict[tuple[int, tuple[int, int]], Camera] = {}
    for (g, size), some in rows.items():
        if groups[g].folder:
            own, reason = _scaled(given.of_folder[groups[g].folder], size)
            for k in some:
                out[k] = with_problem(out[k], reason, "size") if reason else out[k]
            if own is not None:
                known[g, size] = own
        elif given.cameras:
            known[g, size] = given.cameras[by_size[some[0]]]
    rows = {key: some for key, some in rows.items() if not out[some[0]].problem}
    paths = {key: images.get(out[some[0]].name) for key, some in rows.items()}
    known, notes = _agreeing(known, paths, groups)
    starts: list[StartCamera] = []
    for key in sorted(rows, key=lambda key: rows[key][0]):
        some, c = rows[key], len(starts)
        camera[some] = c
        if key in known:
            start = start_given(known[key], lens, fixed=interior != "estimated")
        elif interior == "fixed":
            raise InputError(
                f"the interior orientation shall stay as given, but none is given for {out[some[0]].name}",
                expected="a calibrated camera",
                where="images.mapping.interior",
                cure="Give an interior orientation, or choose estimated",
            )
        else:
            start = start_guessed(paths[key] or Path(out[some[0]].name), key[1], lens)
        starts.append(_named(start, key[0], groups, [s.camera.name for s in starts], given=key in known))
    sizes = {size for _, size in rows}
    if len(groups) == 1 and len(sizes) > 1 and not given.cameras:
        notes.append(f"images of {len(sizes)} sizes: each size has an interior orientation of its own")
    told = camera_note([group for g, group in enumerate(groups) if any(g == key[0] for key in rows)])
    return Assigned(
        starts=tuple(starts), camera=camera, pictures=tuple(out), notes=[*([told] if told else []), *notes]
    )


def _named(
    start: StartCamera, g: int, groups: Sequence[ImageCamera], taken: Sequence[str], *, given: bool
) -> StartCamera:
    """A start with a name of its own: that of the given camera, else of the group, with a number if taken."""
    base = start.camera.name if given and len(groups) == 1 else groups[g].name
    name, n = base, 1
    while name in taken:
        n += 1
        name = f"{base}_{n}"
    return replace(start, camera=replace(start.camera, name=name))


def _scaled(camera: Camera, size_px: tuple[int, int]) -> tuple[Camera | None, str]:
    if camera.size_px == size_px:
        return camera, ""
    try:
        return camera.scaled(size_px), ""
    except GeometryError:
        w, h = camera.size_px
        return None, f"{size_px[0]} x {size_px[1]} pixels, the camera has {w} x {h}"


def _agreeing(
    known: Mapping[tuple[int, tuple[int, int]], Camera],
    paths: Mapping[tuple[int, tuple[int, int]], Path | None],
    groups: Sequence[ImageCamera],
) -> tuple[dict[tuple[int, tuple[int, int]], Camera], list[str]]:
    """Given cameras whose focal length is about the one that the EXIF of one of their images states.

    EXIF rounds to whole millimetres, which explains some percent.

    Returns
    -------
    known : without those that are of another lens, where another camera is of the given one.
    notes : differences that rounding hardly explains.

    Raises
    ------
    InputError : another lens or zoom.
    """
    ratio: dict[tuple[int, tuple[int, int]], tuple[float, float]] = {}
    for key, camera in known.items():
        path = paths.get(key)
        stated = None if path is None or camera.model == "fisheye" else focal_from_exif(path)
        if stated is not None:
            ratio[key] = float(camera.parameters[0] / stated), stated
    kept, notes = dict(known), []
    for key, (off, stated) in ratio.items():
        camera = known[key]
        if 1 / _UNLIKE < off < _UNLIKE:
            continue
        if 1 / _OTHER_LENS < off < _OTHER_LENS:
            notes.append(
                f"the focal length of {camera.name} is {camera.parameters[0]:.0f} px, EXIF states "
                f"{stated:.0f} px: is the calibration that of this camera and zoom?"
            )
            continue
        fits = any(
            other is camera and k in ratio and 1 / _OTHER_LENS < ratio[k][0] < _OTHER_LENS
            for k, other in known.items()
        )
        if not fits:
            path = paths[key]
            raise InputError(
                f"a focal length of {camera.parameters[0]:.0f} px in the interior orientation {camera.name}, "
                f"and {stated:.0f} px by the EXIF of the images", where="" if path is None else path.name,
                expected="the calibration of this camera at this zoom",
                cure="Name the right calibration (logs.time_lapse.interior, mounts.calibration), or none: "
                "the interior orientation is then estimated",
            )  # fmt: skip
        del kept[key]
        notes.append(
            f"{groups[key[0]].name}: {len(groups[key[0]].images)} images with a focal length of "
            f"{stated:.0f} px by EXIF are not of the given interior orientation "
            f"({camera.parameters[0]:.0f} px): theirs is estimated"
        )
    return kept, notes
