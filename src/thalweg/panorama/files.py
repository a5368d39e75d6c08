"""Panoramas as files: JPEG with what viewers ask for (GPano), and a table with times, poses, seams.

**Are both views read as they were when the rig was calibrated?** Along the seam both lenses see the same
things. If one of the views is turned by half against the other they do not; that is found from the pictures
alone. The seam cannot tell views that are changed over, mirrored or upside down *both*: the same pixels still
lie on each other there, elsewhere.

**How far things are** in each direction is taken from the lidar cloud around. The cloud lies close in lines
and has gaps between them. Each cell holds the range of its nearest point; gaps up to a width take the nearest
range at their border (lower envelope); what is left is infinitely far: the sky, and the water, whose picture
is mostly a mirrored one, as far behind the surface as the mirrored thing lies before it. Taken at the range
of the surface, mirrored clouds came out twice as far off at the seam.
"""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy import ndimage
from scipy.spatial.transform import Rotation

from thalweg.calibration import LENSES, Rig, lens_view, read_rig_masks, read_views
from thalweg.core import (
    AnyArray,
    ArrayF,
    ArrayU8,
    CoverageError,
    InputError,
    LocalFrame,
    Rigid,
    column,
    frame_in_words,
    frame_of,
    iter_laz,
    laz_header,
    steps,
    table_kind,
    utc_text_from_gps,
    write_table,
)
from thalweg.images.model import ImagePoses
from thalweg.lidar import Photographs
from thalweg.panorama.compose import RIM_DEG, Composed, compose, correlation, overlap
from thalweg.panorama.sphere import default_width_px, level_attitude, pixels_of
from thalweg.settings.sections import Panorama, RigLens

# ---------------------------------------------------------------- ranges around a panorama

_NEAREST_M: Final = 0.4


def cloud_ranges(
    xyz_wcs_m: ArrayF, centre_wcs_m: ArrayF, R_wcs_pcs: ArrayF, *, cell_deg: float, reach_m: float
) -> AnyArray:
    """Least range (rows, columns) of points (n, 3) around a place, metres; infinite where there is none.

    Parameters
    ----------
    xyz_wcs_m : the cloud.
    centre_wcs_m, R_wcs_pcs : place (3,) and attitude (3, 3) of the panorama.
    cell_deg : width of a cell; at most some degrees.
    reach_m : points farther away do not count.
    """
    columns = 2 * round(180.0 / cell_deg)
    local = (xyz_wcs_m - centre_wcs_m) @ R_wcs_pcs
    r = np.linalg.norm(local, axis=1)
    near = (r <= reach_m) & (r > _NEAREST_M)
    uv = pixels_of(local[near], columns)
    column = np.clip(uv[:, 0].astype(np.int64), 0, columns - 1)
    row = np.clip(uv[:, 1].astype(np.int64), 0, columns // 2 - 1)
    out = np.full((columns // 2, columns), np.inf)
    np.minimum.at(out, (row, column), r[near])
    return out


def fill_gaps(ranges_m: AnyArray, *, gap_deg: float) -> AnyArray:
    """Ranges (rows, columns) without the gaps of a cloud.

    Parameters
    ----------
    ranges_m : `cloud_ranges`.
    gap_deg : cells so near to a point take its range, the nearest of several (lower envelope).
    """
    cell = 180.0 / len(ranges_m)
    out = ranges_m.copy()
    reach = round(gap_deg / 2 / cell)
    if reach > 0 and np.isfinite(out).any():
        # around the panorama once, so that its left border knows the right one
        wide = np.concatenate([out[:, -reach:], out, out[:, :reach]], axis=1)
        known = np.isfinite(wide)
        distance, index = ndimage.distance_transform_edt(~known, return_indices=True)
        nearest = ndimage.minimum_filter(wide, size=3)[tuple(index)]
        filled = np.where(known | (distance > reach), wide, nearest)
        out = filled[:, reach:-reach]
    return out


def inverse_range(ranges_m: AnyArray, width_px: int) -> AnyArray:
    """Inverse ranges (W / 2, W) at all pixels of a panorama, 1/m: linear between the middles of cells."""
    rows, columns = ranges_m.shape
    with np.errstate(divide="ignore"):
        inverse = np.where(np.isfinite(ranges_m), 1.0 / ranges_m, 0.0)
    u = (np.arange(width_px) + 0.5) / width_px * columns - 0.5
    v = np.clip((np.arange(width_px // 2) + 0.5) / (width_px // 2) * rows - 0.5, 0, rows - 1)
    i, j = np.floor(v).astype(np.int64), np.floor(u).astype(np.int64)
    fv, fu = (v - i).astype(np.float32)[:, None], (u - j).astype(np.float32)
    inverse = inverse.astype(np.float32)
    tall = (1 - fv) * inverse[i] + fv * inverse[np.minimum(i + 1, rows - 1)]
    # around the panorama once: the last column is beside the first
    return (1 - fu) * tall[:, j % columns] + fu * tall[:, (j + 1) % columns]


# ---------------------------------------------------------------- are both views read as calibrated?

TURNED: Final = "turned by half against each other"
_AGREES: Final = 0.6
_CLEARLY: Final = 0.3

Views = Mapping[str, ArrayU8]


def reading_that_fits(views: Views, rig: Rig) -> str:
    """The way in which both views agree along the seam: "" as they are, or `TURNED`.

    Another one is told only if it agrees clearly and the given one does not.
    """
    turned = [
        {**views, name: np.ascontiguousarray(views[name][::-1, ::-1])} for name in LENSES
    ]  # nearly the same, but for principal points that lie beside the middle
    far = np.zeros((64, 128))
    score = []
    for read in (views, *turned):
        _, even, usable = overlap(read, rig, np.eye(3), far, None, np.ones(3))
        grey = [ndimage.gaussian_filter(even[lens].mean(axis=2), (2, 1)) for lens in LENSES]
        score.append(float(np.nan_to_num(correlation(grey[0], grey[1], usable), nan=-1.0)))
    other = max(score[1:])
    return TURNED if other > _AGREES and other > score[0] + _CLEARLY else ""


# ---------------------------------------------------------------- files

_AXES: Final = ("east", "north", "up")
PANORAMAS: Final = table_kind(
    "panoramas",
    1,
    [
        column("panorama", "1", "name of the file", pa.string()),
        column("image", "1", "name of the file of the rig", pa.string()),
        column("t_gps_s", "s", "time of exposure, adjusted standard GPS time"),
        column("sigma_t_s", "s", "its standard deviation"),
        column("mode", "1", "where things are taken to be: depth, sphere, none", pa.string()),
        column("width_px", "px", "width; the height is half of it", pa.int32()),
        *(column(f"{a}_m", "m", f"{a} of the middle of the rig, wcs") for a in _AXES),
        *(column(f"sigma_{a}_m", "m", f"standard deviation of {a}") for a in _AXES),
        *(column(f"q{a}", "1", f"quaternion of R_wcs_pcs, {a} (scalar last)") for a in "xyzw"),
        *(
            column(f"sigma_rotation_{a}_deg", "deg", f"standard deviation of the rotation about {a}")
            for a in _AXES
        ),
        column("heading_deg", "deg", "of the middle of the picture, from grid north clockwise"),
        column("lat_deg", "deg", "latitude of the middle of the rig"),
        column("lon_deg", "deg", "longitude of the middle of the rig"),
        column("h_ell_m", "m", "its ellipsoidal height"),
        *(
            column(f"gain_{c}", "1", f"light of the back lens over that of the front lens, {c}")
            for c in ("red", "green", "blue")
        ),
        column("gain_sigma", "1", "relative standard deviation of a gain"),
        column("seam_rms_px", "px", "rms of the shifts of both lenses across the seam; NaN: no texture"),
        column("seam_places", "1", "places of the seam with texture", pa.int32()),
        column("agreement", "1", "correlation of both lenses where they overlap"),
        column("shown", "1", "share of the pixels that a lens shows"),
        column("ranged", "1", "share of the cells whose range is from the cloud, before gaps are filled"),
    ],
)
_GPANO: Final = """<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>
<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">
<rdf:Description rdf:about="" xmlns:GPano="http://ns.google.com/photos/1.0/panorama/"
 GPano:UsePanoramaViewer="True" GPano:ProjectionType="equirectangular"
 GPano:PoseHeadingDegrees="{heading:.3f}" GPano:PosePitchDegrees="0" GPano:PoseRollDegrees="0"
 GPano:FullPanoWidthPixels="{width}" GPano:FullPanoHeightPixels="{height}"
 GPano:CroppedAreaImageWidthPixels="{width}" GPano:CroppedAreaImageHeightPixels="{height}"
 GPano:CroppedAreaLeftPixels="0" GPano:CroppedAreaTopPixels="0"/>
</rdf:RDF></x:xmpmeta><?xpacket end="w"?>"""
_TESTED: Final = 5
"""Exposures in which lenses that are turned against each other are looked for."""
_GPS_IFD: Final = 0x8825


def write_panorama(
    path: Path, picture: ArrayU8, *, heading_deg: float, llh: ArrayF, t_gps_s: float, quality: int
) -> None:
    """Write a panorama with its projection (XMP GPano), place and time (EXIF).

    Parameters
    ----------
    path : target, ``.jpg``.
    picture : (h, 2 h, 3) uint8, sRGB.
    heading_deg : of its middle, from north clockwise.
    llh : latitude, longitude (degrees), ellipsoidal height (m).
    t_gps_s : time of exposure, adjusted standard GPS time.
    quality : of the JPEG.
    """
    from PIL import Image

    height, width = picture.shape[:2]
    exif = Image.Exif()
    gps: dict[int, Any] = {
        1: "N" if llh[0] >= 0 else "S",
        2: _sexagesimal(abs(float(llh[0]))),
        3: "E" if llh[1] >= 0 else "W",
        4: _sexagesimal(abs(float(llh[1]))),
        5: 0 if llh[2] >= 0 else 1,
        6: Fraction(round(abs(float(llh[2])) * 1000), 1000),
    }
    exif.get_ifd(_GPS_IFD).update(gps)
    text = utc_text_from_gps(t_gps_s)
    exif[0x0132] = text[:19].replace("-", ":").replace("T", " ")
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.ascontiguousarray(picture)).save(
        path,
        format="JPEG",
        quality=quality,
        exif=exif,
        xmp=_GPANO.format(heading=heading_deg % 360.0, width=width, height=height).encode(),
    )


def _sexagesimal(angle_deg: float) -> tuple[Fraction, Fraction, Fraction]:
    minutes, seconds = divmod(round(angle_deg * 3600 * 10_000), 60 * 10_000)
    degrees, minutes = divmod(minutes, 60)
    return Fraction(degrees), Fraction(minutes), Fraction(seconds, 10_000)


def make_panoramas(
    files: Mapping[str, Path],
    poses: ImagePoses,
    rig: Rig,
    points: Path | None,
    settings: Panorama,
    out_folder: Path,
    out_table: Path,
) -> pd.DataFrame:
    """Panoramas of a survey.

    Parameters
    ----------
    files : of the rig, by name.
    poses : of the front lens at these files; those without a pose are told and left out.
    rig : calibrated.
    points : LAZ in the frame of the poses, for ``depth``; None: there is no cloud.
    settings : section ``panorama``.
    out_folder : for the pictures, each of the name of its file.
    out_table : table kind ``panoramas``.

    Returns
    -------
    table : as written.

    Raises
    ------
    InputError : a file cannot be read or is no dual fisheye; the cloud lies in another frame; lenses are
        turned against each other; a mask is wanted and there is none.
    CoverageError : no file has a pose, or ``depth`` without a cloud.
    """
    log = logging.getLogger("thalweg")
    for name, reason in zip(poses.images, poses.reasons, strict=True):
        if reason:
            log.warning("%s: no panorama: %s", name, reason)
    rows = [k for k in range(len(poses.images)) if poses.oriented[k] and poses.images[k] in files]
    rows = rows[:: settings.every]
    if not rows:
        raise CoverageError(
            f"none of {len(files)} files of the rig has a pose",
            expected="files of the time of the survey",
            cure="Check rig.clock and rig.times.utc_offset against the time of the trajectory",
        )
    if settings.mode == "depth" and points is None:
        raise CoverageError(
            "panorama.mode is depth, and there is no lidar cloud",
            expected="a cloud that says how far things are",
            cure="Set panorama.mode: sphere with panorama.radius_m, or add logs.lidar",
        )
    _check_reading([files[poses.images[k]] for k in rows[:_TESTED]], rig)
    masks = read_rig_masks(rig)
    if settings.boat == "mask" and not masks:
        raise InputError(
            "panorama.boat is mask, and no lens has a mask",
            expected="a picture of the size of the upright view, 0 where the boat is",
            where="rig",
            cure="State rig.front.mask and rig.back.mask, or set panorama.boat: keep",
        )
    used = masks if settings.boat == "mask" else {}
    width = settings.width_px or default_width_px(rig.cameras["front"])
    places = [_place(poses.pose(k), rig) for k in rows]
    maps = None
    if settings.mode == "depth":
        maps = _range_maps(points, places, poses.frame, settings)
        for k, near in zip(rows, maps, strict=True):
            if not np.isfinite(near).any():
                log.warning(
                    "%s: no point of the cloud within %g m: taken outside the time of the lidar? Things "
                    "count as infinitely far, and near ones are seen twice at the seam",
                    poses.images[k],
                    settings.reach_m,
                )
    found = []
    for i, k in enumerate(steps(rows, "panorama")):
        name = poses.images[k]
        inverse, ranged = _inverse(maps, i, settings, width)
        R_front_pcs = poses.R_wcs_ccs[k].T @ places[i].R
        result = compose(read_views(files[name], rig.settings), rig, R_front_pcs, inverse, masks=used)
        file = out_folder / f"{Path(name).stem}.jpg"
        row = _row(file.name, name, poses, k, places[i], result, settings.mode, width, ranged)
        write_panorama(
            file,
            result.picture,
            heading_deg=row["heading_deg"],
            llh=np.array([row["lat_deg"], row["lon_deg"], row["h_ell_m"]]),
            t_gps_s=float(poses.t_gps_s[k]),
            quality=settings.jpeg_quality,
        )
        found.append(row)
    table = frame_of(PANORAMAS, {name: [row[name] for row in found] for name in PANORAMAS.names})
    write_table(out_table, table, PANORAMAS, {"axes_deg": rig.axes_deg, "base_m": rig.base_m})
    return table


def rig_photographs(files: Mapping[str, Path], poses: ImagePoses, rig: Rig) -> list[Photographs]:
    """Both lenses of a rig as photographs for the colours of a cloud, named ``front/NAME`` and ``back/NAME``.

    Parameters
    ----------
    files : of the rig, by name.
    poses : of the front lens at these files.
    rig : calibrated.
    """
    found = []
    for lens, place in rig.T_front_lens.items():
        placed = [poses.pose(k) @ place if poses.oriented[k] else None for k in range(len(poses.images))]
        lost = np.full((3, 3), np.nan)
        names = tuple(f"{lens}/{name}" for name in poses.images)
        settings: RigLens = getattr(rig.settings, lens)
        mask = settings.mask
        found.append(
            Photographs(
                poses=replace(
                    poses,
                    images=names,
                    centre_wcs_m=np.array([lost[0] if T is None else T.shift_m for T in placed]),
                    R_wcs_ccs=np.array([lost if T is None else T.R for T in placed]),
                    cov_pose_wcs=np.array([np.full((6, 6), np.nan) if T is None else T.cov for T in placed]),
                ),
                images={f"{lens}/{name}": path for name, path in files.items()},
                masks={} if mask is None else {name: Path(mask) for name in names},
                camera=rig.cameras[lens],
                cut=partial(lens_view, lens=settings),
                file_px=rig.settings.size_px,
                widest_rad=float(np.deg2rad(rig.settings.field_of_view_deg / 2 - RIM_DEG)),
            )
        )
    return found


def _check_reading(files: Sequence[Path], rig: Rig) -> None:
    """Refuse views that fit each other only if they are read in another way."""
    read = [reading_that_fits(read_views(path, rig.settings), rig) for path in files]
    other = max(set(read), key=read.count)
    if other and read.count(other) > len(read) / 2:
        raise InputError(
            f"both lenses agree along the seam only if they are {other}, in {read.count(other)} of "
            f"{len(read)} files",
            expected="views as the rig was calibrated",
            where=files[read.index(other)],
            cure="Correct rig.front and rig.back (box_px, turn_deg), or take the camera's original files; "
            "calibrate again if they were read in this way there, too",
        )


def _place(front: Rigid, rig: Rig) -> Rigid:
    """``T_wcs_pcs`` of a panorama: the middle of the rig, level, with the covariance of the front lens."""
    to_middle = Rigid(R=np.eye(3), shift_m=rig.centre_front_m)
    middle = front @ to_middle
    return Rigid(R=level_attitude(front.R), shift_m=middle.shift_m, cov=middle.cov)


def _range_maps(
    points: Path | None, places: Sequence[Rigid], frame: LocalFrame, settings: Panorama
) -> list[AnyArray]:
    """Least ranges around each place before gaps are filled."""
    assert points is not None
    header = laz_header(points)
    if header.frame != frame:
        raise InputError(
            f"a cloud in the frame {frame_in_words(header.frame)}",
            expected=f"that of the poses, {frame_in_words(frame)}",
            where=points,
        )
    rows = round(180.0 / settings.cell_deg)
    maps = [np.full((rows, 2 * rows), np.inf) for _ in places]
    for chunk in iter_laz(points):
        for i, place in enumerate(places):
            seen = cloud_ranges(
                chunk["xyz_m"], place.shift_m, place.R, cell_deg=settings.cell_deg, reach_m=settings.reach_m
            )
            maps[i] = np.minimum(maps[i], seen)
    return maps


def _inverse(
    maps: Sequence[AnyArray] | None, i: int, settings: Panorama, width: int
) -> tuple[AnyArray, float]:
    """Inverse ranges (W / 2, W), and the share of cells that the cloud fills."""
    if maps is not None:
        filled = fill_gaps(maps[i], gap_deg=settings.gap_deg)
        return inverse_range(filled, width), float(np.isfinite(maps[i]).mean())
    inverse = 1.0 / settings.radius_m if settings.mode == "sphere" else 0.0
    return np.full((width // 2, width), inverse), 0.0


def _row(
    file: str,
    image: str,
    poses: ImagePoses,
    k: int,
    place: Rigid,
    result: Composed,
    mode: str,
    width: int,
    ranged: float,
) -> dict[str, Any]:
    view = place.R[:, 2]
    lat, lon, height = (float(a) for a in poses.frame.to_geodetic(place.shift_m))
    q = Rotation.from_matrix(place.R).as_quat(canonical=True)
    return {
        "panorama": file,
        "image": image,
        "t_gps_s": float(poses.t_gps_s[k]),
        "sigma_t_s": float(poses.sigma_t_s[k]),
        "mode": mode,
        "width_px": width,
        **{f"{a}_m": float(place.shift_m[i]) for i, a in enumerate(_AXES)},
        **{f"sigma_{a}_m": float(place.sigma_shift_m[i]) for i, a in enumerate(_AXES)},
        **{f"q{a}": float(q[i]) for i, a in enumerate("xyzw")},
        **{
            f"sigma_rotation_{a}_deg": float(np.rad2deg(place.sigma_rotation_rad[i]))
            for i, a in enumerate(_AXES)
        },
        "heading_deg": float(np.rad2deg(np.arctan2(view[0], view[1])) % 360.0),
        "lat_deg": lat,
        "lon_deg": lon,
        "h_ell_m": height,
        **{f"gain_{c}": float(result.gains[i]) for i, c in enumerate(("red", "green", "blue"))},
        "gain_sigma": result.gain_sigma,
        "seam_rms_px": result.seam_rms_px,
        "seam_places": len(result.seam_px),
        "agreement": result.agreement,
        "shown": float(result.shown.mean()),
        "ranged": ranged,
    }
