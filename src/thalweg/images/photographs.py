"""Photographs and surveyed points, and nothing else: an oriented block with covariances, as files."""

import json
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from pyproj import CRS

from thalweg.calibration import LENSES, Rig, read_camera, read_rig, read_views
from thalweg.core import ArrayB, ArrayF, InputError, LazWriter, LocalFrame, Trajectory
from thalweg.core.calibration import Source
from thalweg.images.bundle import (
    Boat,
    Interiors,
    Pieces,
    adjust_pieces,
    interiors_of,
    pieces_tables,
    summary_text,
    write_cameras,
)
from thalweg.images.control import (
    CameraPositions,
    MarkTable,
    frame_about,
    map_grid,
    matched_marks,
    read_all_control_points,
    read_all_marks,
    read_camera_positions,
)
from thalweg.images.masks import size_of
from thalweg.images.model import ControlPoints, ImageBlock, ImagePoses, triangulated, unknown_poses
from thalweg.images.sfm import (
    WIDEST_DEG,
    Known,
    block_facts,
    extract_features,
    image_table,
    main_block,
    map_images,
    match_images,
    read_times,
    to_the_rim,
)
from thalweg.ingest.photos import Images, find_images, named_images
from thalweg.settings.sections import (
    LOCAL,
    BlockAdjustment,
    ControlSettings,
    FeatureSettings,
    MappingSettings,
    Rig as RigSettings,
)

log = logging.getLogger("thalweg")

_TESTED: Final = 3
"""Files of a rig that are looked at whether they show both image circles; of others features tell."""
FILES: Final = (
    "image_poses.csv",
    "image_poses.parquet",
    "points.csv",
    "points.laz",
    "camera.yaml",
    "cameras.csv",
    "control_points.csv",
    "images.csv",
    "orientation.json",
)
"""What an oriented block is written to."""
_OF_THE_WORLD: Final = ("image_poses.parquet", "control_points.csv")
"""Files whose columns are metres of the world, or surveyed points: a model in its own frame has none."""
_MODEL_STEP: Final = 1e-5
"""Resolution of the tie points of a model, whose base is one, as LAZ."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotographBlock:
    """An oriented block of photographs.

    Parameters
    ----------
    found : adjusted pieces, poses of all images, facts.
    control : surveyed points in the world frame.
    crs : of the coordinates of all files, or `LOCAL`; None: a model in its own frame, without scale.
    marked : names of measured tie points, the last points of a piece, by the names of its images.
    """

    found: Pieces
    control: ControlPoints
    crs: str | None
    marked: Mapping[tuple[str, ...], tuple[str, ...]] = field(default_factory=dict)

    def coordinates(self, points_wcs_m: ArrayF) -> ArrayF:
        """Points (n, 3) of the world frame in the coordinates of the control points; NaN stays."""
        return in_crs(points_wcs_m, self.found.poses.frame, self.crs)

    def point_table(self) -> pd.DataFrame:
        """Tie points of all pieces: ``x_m, y_m, z_m``, ``images`` that show the point, ``piece``.

        Of a model ``x, y, z``; with measured tie points ``point``, their names.
        """
        tables = []
        for k, piece in enumerate(self.found.oriented):
            adjusted = piece.adjusted
            marks = adjusted.problem.block.mark_point[adjusted.used]
            shown = np.bincount(marks, minlength=len(adjusted.x.X))
            rows = np.flatnonzero(shown >= 2)
            xyz = self.coordinates(adjusted.x.X[rows] + adjusted.origin_m)
            table = pd.DataFrame(xyz, columns=_axes(self.crs)).assign(images=shown[rows], piece=k)
            if self.marked:
                names = self.marked.get(adjusted.problem.block.images, ())
                table["point"] = np.array([""] * (len(shown) - len(names)) + list(names), object)[rows]
            tables.append(table)
        return pd.concat(tables, ignore_index=True)

    def write(self, folder: Path, *, name: str) -> list[Path]:
        """Write poses, points, cameras, control points and facts into a folder.

        Parameters
        ----------
        folder : made if it is not there.
        name : of the survey, for the calibration file.

        Returns
        -------
        paths : of `FILES`; of a model without those that are metres of the world.
        """
        files = [file for file in FILES if self.crs is not None or file not in _OF_THE_WORLD]
        folder.mkdir(parents=True, exist_ok=True)
        facts = self.found.facts
        if self.crs is not None:
            self.found.poses.write(folder / "image_poses.parquet")
        pose_table(self.found.poses, self.crs).to_csv(
            folder / "image_poses.csv", index=False, float_format="%.9g"
        )
        points = self.point_table()
        digits = "%.3f" if self.crs is not None else "%.9g"
        points.to_csv(folder / "points.csv", index=False, float_format=digits)
        self._write_cloud(folder / "points.laz", points)
        source = Source(
            run=name,
            method="block adjustment of photographs",
            observations=facts["observations"],
            sigma0=facts["sigma0"],
        )
        write_cameras(folder / "camera.yaml", folder / "cameras.csv", self.found.oriented, source)
        images, control = pieces_tables(self.found)
        images.to_csv(folder / "images.csv", index=False, float_format="%.6g")
        if self.crs is not None:
            control.to_csv(folder / "control_points.csv", index=False, float_format="%.6g")
        stated = {"crs": self.crs, **facts}
        (folder / "orientation.json").write_text(json.dumps(stated, indent=2) + "\n", encoding="utf-8")
        return [folder / file for file in files]

    def _write_cloud(self, path: Path, points: pd.DataFrame) -> None:
        """The tie points as LAZ in the CRS of the control points, or without one in a local frame."""
        xyz = points[_axes(self.crs)].to_numpy()
        frame = None if self.crs in (None, LOCAL) else CRS.from_user_input(self.crs)
        step = 0.001 if self.crs is not None else _MODEL_STEP
        dimensions = {"images": ("u2", "photographs that show the point"), "piece": ("u2", "of the block")}
        with LazWriter(path, frame, scale_m=step, extra_dimensions=dimensions) as writer:
            writer.append(xyz, extra={key: points[key].to_numpy(np.uint16) for key in dimensions})


def _axes(crs: str | None) -> list[str]:
    return ["x", "y", "z"] if crs is None else ["x_m", "y_m", "z_m"]


def in_crs(points_wcs_m: ArrayF, frame: LocalFrame, crs: str | None) -> ArrayF:
    """Points (n, 3) of the world frame in a map grid, or as they are (`LOCAL`, None); NaN stays."""
    known = np.isfinite(points_wcs_m).all(axis=1)
    out = np.full(points_wcs_m.shape, np.nan)
    if crs in (None, LOCAL):
        out[known] = points_wcs_m[known]
    elif known.any():
        out[known] = frame.to_map(points_wcs_m[known], CRS.from_user_input(crs))
    return out


def pose_table(poses: ImagePoses, crs: str | None) -> pd.DataFrame:
    """A row for each image.

    Columns: ``image``, ``x_m, y_m, z_m`` of the projection centre, the quaternion ``qx, qy, qz, qw`` from
    the camera's frame (right, down, into the picture) to local east, north, up (to x, y, z of a local
    frame), ``sigma_x_m`` ... , ``sigma_rotation_x_deg`` ... about the axes of the world, ``rms_px``,
    ``reason`` why there is no pose. Of a model in its own frame (None) places are ``x, y, z`` with
    ``sigma_x`` ...
    """
    sigma = np.sqrt(np.diagonal(poses.cov_pose_wcs, axis1=1, axis2=2))
    places = in_crs(poses.centre_wcs_m, poses.frame, crs)
    columns: dict[str, Any] = {"image": list(poses.images)}
    columns |= dict(zip(_axes(crs), places.T, strict=True))
    columns |= dict(zip(("qx", "qy", "qz", "qw"), poses.quaternions.T, strict=True))
    for k, axis in enumerate(_axes(crs)):
        columns[f"sigma_{axis}"] = sigma[:, k]
    for k, axis in enumerate("xyz"):
        columns[f"sigma_rotation_{axis}_deg"] = np.rad2deg(sigma[:, 3 + k])
    return pd.DataFrame(columns | {"rms_px": poses.rms_px, "reason": list(poses.reasons)})


def what_is_given(
    images: Images,
    crs: str | None,
    control_points: Sequence[Path],
    marks: Path | None,
    positions: Path | None,
    section: ControlSettings,
) -> tuple[LocalFrame, ControlPoints, CameraPositions | None, dict[str, Path]]:
    """Frame, control points, positions of the camera and files of photographs, whose marks fit together.

    Parameters and errors as of `orient_photographs`, before the first photograph is looked at.
    """
    placed = [*control_points, *([] if positions is None else [positions])]
    if placed and crs is None:
        raise InputError("coordinates without a CRS", expected=f"a map grid, or {LOCAL}", where=placed[0])
    frame = frame_about(placed, crs=crs)
    if crs is not None and crs != LOCAL and placed:
        map_grid(crs, placed[0])
    points = read_all_control_points(
        control_points, frame, crs=crs, sigma_m=section.sigma_m, height_offset_m=section.height_offset_m
    )
    centres = None
    if positions is not None:
        centres = read_camera_positions(positions, frame, crs=crs, height_offset_m=section.height_offset_m)
    files = named_images(images)
    if marks is not None:
        sizes = [size_of(path) or (0, 0) for path in files.values()]
        table = read_all_marks([marks])
        meant = points if control_points else _without_coordinates(table)
        matched_marks(table, meant, tuple(files), sizes, tuple(files), sigma_px=section.sigma_px, where=marks)
    return frame, points, centres, files


def _without_coordinates(table: MarkTable) -> ControlPoints:
    """The points of a table of marks, whose places nobody knows, for the sake of their names."""
    names = tuple({name.strip().casefold(): name.strip() for name in table.point}.values())
    n = len(names)
    return ControlPoints(
        names=names,
        points_wcs_m=np.zeros((n, 3)),
        cov_wcs_m2=np.tile(np.eye(3), (n, 1, 1)),
        check=np.ones(n, np.bool_),
    )


def with_measured_points(
    block: ImageBlock, marks: Path, exposures: Sequence[str], *, sigma_px: float
) -> tuple[ImageBlock, tuple[str, ...]]:
    """The block with tie points that were measured by hand, behind its own, and their names.

    Points whose rays of two photographs or more do not meet are none.

    Parameters
    ----------
    marks : table as of `read_marks`.
    exposures : names of all photographs.
    sigma_px : of marks that state none.
    """
    table = read_all_marks([marks])
    points = _without_coordinates(table)
    sizes = [block.cameras[c].size_px for c in block.camera]
    found, _ = matched_marks(table, points, block.images, sizes, exposures, sigma_px=sigma_px, where=marks)
    places = triangulated(block, found, len(points.names))
    keep: ArrayB = np.isfinite(places[:, 0])
    index = len(block.points_block_m) + np.cumsum(keep) - 1
    rows = np.lexsort((found.image, found.point))
    rows = rows[keep[found.point[rows]]]
    return replace(
        block,
        points_block_m=np.concatenate([block.points_block_m, places[keep]]),
        mark_image=np.concatenate([block.mark_image, found.image[rows]]),
        mark_point=np.concatenate([block.mark_point, index[found.point[rows]]]),
        mark_px=np.concatenate([block.mark_px, found.xy_px[rows]]),
        sigma_px=np.concatenate([block.sigma_px, found.sigma_px[rows]]),
    ), tuple(name for name, k in zip(points.names, keep, strict=True) if k)


def orient_photographs(
    images: Images,
    *,
    crs: str | None,
    control_points: Sequence[Path] = (),
    marks: Path | None = None,
    positions: Path | None = None,
    camera: Path | None = None,
    masks: Path | None = None,
    features: FeatureSettings | None = None,
    mapping: MappingSettings | None = None,
    adjustment: BlockAdjustment | None = None,
    control: ControlSettings | None = None,
    rig: Rig | None = None,
    threads: int = 1,
    device: str = "auto",
    progress: Callable[[str], None] | None = None,
) -> PhotographBlock:
    """Orient photographs by what is known of them, without a boat: surveyed points, positions of the camera.

    Without either they are oriented in a frame of their own (`thalweg.images.bundle.run.model_block`).

    Parameters
    ----------
    images : photographs by name, or files and folders.
    crs : of coordinates ``x, y, z``; `LOCAL` for a frame of the surveyor's own. Results are in it, too. None
        where nothing has coordinates.
    control_points : tables as of `read_control_points`.
    marks : table of their image points, as of `read_marks`; without control points of tie points.
    positions : table as of `read_camera_positions`; without control points three or more, not on a line.
    camera : calibration, COLMAP or OpenCV file of the interior orientation; None: it is estimated.
    masks : folder of masks; see `extract_features`.
    features, mapping, adjustment, control : sections of a campaign file; None: their defaults.
    rig : calibration of two lenses whose files the photographs are, in place of ``camera``; each file has
        one pose, that of the front lens, and ``marks`` name images ``front/NAME`` and ``back/NAME``.
    threads : of features and matches.
    device : ``images.device``.
    progress : called with a line of text for each step.

    Raises
    ------
    InputError : photographs, points or marks that cannot be used, or no two photographs with common points.
    GeometryError : control points or positions, but fewer than three points that are measured in two
        photographs each and fewer than three positions, or such as do not fit the photographs.
    """
    own_frame = rig is None and not control_points and positions is None
    if own_frame and crs not in (None, LOCAL):
        raise InputError(
            f"the CRS {CRS.from_user_input(crs).name}, and nothing that has coordinates in it",
            expected="control points with marks, or positions of the camera",
            cure="Give these, or no CRS: the photographs are then oriented in a frame of their own",
        )
    say = progress or (lambda line: None)
    section = control or ControlSettings()
    frame, points, centres, files = what_is_given(
        images, crs, control_points, None if rig is not None else marks, positions, section
    )
    exposures = tuple(files)
    known = Known(cameras=() if camera is None else (read_camera(camera),))
    if rig is not None:
        known = Known(t_s={name: float(k) for k, name in enumerate(exposures)})
    mapped = _mapped(files, known, masks, features, mapping, rig, threads, device, say)
    blocks, marked = mapped.blocks, {}
    if marks is not None and rig is None and not control_points:
        both = [with_measured_points(b, marks, exposures, sigma_px=section.sigma_px) for b in blocks]
        blocks, marked = [b for b, _ in both], {b.images: names for b, names in both}
    say("adjustment in a frame of its own" if own_frame else "adjustment with control points")
    pieces = adjust_pieces(
        blocks,
        unknown_poses(frame, exposures),
        reasons=mapped.reasons,
        frame=frame,
        crs=crs,
        adjustment=adjustment or BlockAdjustment(),
        control=section,
        control_points=control_points,
        marks=marks,
        known=mapped.interiors,
        boat=None,
        centres=centres,
        rig=rig,
        own_frame=own_frame,
    )
    pieces.facts["structure_from_motion"] = mapped.facts
    block = PhotographBlock(found=pieces, control=points, crs=None if own_frame else crs, marked=marked)
    if marks is not None and marked:
        given = len(_without_coordinates(read_all_marks([marks])).names)
        used = block.point_table().query("point != ''")["point"].nunique()
        pieces.facts["measured_tie_points"] = {"given": given, "used": used}
        if used < given:
            pieces.facts["notes"].append(
                f"{given - used} of {given} measured tie points take no part: fewer than two of their marks "
                "are in photographs of the block and fit"
            )
    return block


@dataclass(frozen=True, slots=True, kw_only=True)
class _Mapped:
    """Blocks of photographs in frames of their own, known interiors, and why an image is in none."""

    blocks: Sequence[ImageBlock]
    interiors: Interiors
    reasons: dict[str, str]
    facts: dict[str, Any]


def _mapped(
    files: Mapping[str, Path],
    known: Known,
    masks: Path | None,
    features: FeatureSettings | None,
    mapping: MappingSettings | None,
    rig: Rig | None,
    threads: int,
    device: str,
    say: Callable[[str], None],
) -> _Mapped:
    """Features, pairs and structure from motion; with a rig of both views of each file."""
    say(f"features of {len(files)} photographs")
    if rig is not None:
        files = {f"{lens}/{name}": path for name, path in files.items() for lens in LENSES}
        times = {name: known.t_s.get(name.split("/", 1)[1], np.nan) for name in files}
        known = replace(known, of_folder=rig.cameras, t_s=times)
    found = extract_features(files, masks=masks, settings=features, threads=threads, rig=rig, device=device)
    say("pairs of photographs")
    inner = found if rig is None else found.chosen(found.within(rig, WIDEST_DEG))
    matches = match_images(inner, files, known=known, section=mapping, threads=threads, device=device)
    say("structure from motion")
    mapped = map_images(matches, settings=mapping, threads=threads, device=device)
    table = image_table(matches, mapped)
    why = {name: dict(zip(table["image"], table[name], strict=True)) for name in ("reason", "cause")}
    main_block(mapped, why["reason"], why["cause"])
    return _Mapped(
        blocks=mapped.pieces if rig is None else [to_the_rim(b, found, rig) for b in mapped.pieces],
        interiors=interiors_of(mapped.pieces, known.cameras[0] if known.cameras else None, known.of_folder),
        reasons=why["reason"],
        facts=block_facts(matches, mapped, table),
    )


def orient_rig_files(
    *,
    images: list[Path],
    calibration: list[Path],
    predictions: Path,
    trajectory: Path,
    control_points: list[Path],
    image_marks: list[Path],
    positions: Path,
    mounts: Path,
    poses: Path,
    control_report: Path,
    images_report: Path,
    facts: Path,
    campaign: dict[str, Any],
    rig: RigSettings,
    features: FeatureSettings,
    mapping: MappingSettings,
    adjustment: BlockAdjustment,
    control: ControlSettings,
    device: str,
    threads: int,
) -> None:
    """The files of a rig on a boat -> a pose of its front lens for each, with covariances.

    Parameters
    ----------
    images, calibration, control_points, image_marks : files of the survey. Boards are not looked for in
        views of a fisheye, where they are some pixels wide: control points count with a table of marks.
    predictions, trajectory, positions, mounts : of the boat, whose ``camera`` is the front lens.
    poses, control_report, images_report, facts : targets, as of the block of a camera.
    campaign : ``origin`` and ``crs``.
    rig, features, mapping, adjustment, control, device : of the campaign file.

    Raises
    ------
    InputError : files of another size or stitched ones, a lens that shows nothing.
    GeometryError : no block, see `orient_photographs`.
    """
    frame = LocalFrame(**campaign["origin"])
    found, expected = read_rig(calibration[0], rig), ImagePoses.read(predictions)
    known, files = (
        Known(t_s=read_times(predictions), trajectory=Trajectory.read(trajectory)),
        named_images(images),
    )
    for path in list(files.values())[:_TESTED]:
        read_views(path, rig)
    mapped = _mapped(files, known, None, features, mapping, found, threads, device, log.info)
    pieces = adjust_pieces(
        mapped.blocks,
        expected,
        reasons=mapped.reasons,
        frame=frame,
        crs=campaign["crs"],
        adjustment=adjustment,
        control=control,
        control_points=control_points,
        marks=image_marks[0] if image_marks else None,
        known=mapped.interiors,
        boat=Boat.read(positions, mounts) if adjustment.antenna.use else None,
        rig=found,
        progress=log.info,
    )
    pieces.poses.write(poses)
    for table, path in zip(pieces_tables(pieces), (images_report, control_report), strict=True):
        table.to_csv(path, index=False)
    told = {**pieces.facts, "structure_from_motion": mapped.facts}
    facts.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
    for line in summary_text(pieces.facts).splitlines():
        log.info(line)


def orient_files(
    *,
    images: list[Path],
    control_points: list[Path],
    marks: list[Path],
    positions: list[Path],
    interior: list[Path],
    masks: list[Path],
    folder: Path,
    campaign: dict[str, Any],
    features: FeatureSettings,
    mapping: MappingSettings,
    adjustment: BlockAdjustment,
    control: ControlSettings,
    device: str,
    threads: int,
) -> None:
    """The photographs of a campaign without a boat -> `FILES` in a folder.

    Parameters
    ----------
    images, control_points, marks, positions, interior, masks : files of ``logs.time_lapse``.
    campaign : ``id`` and ``crs``.
    features, mapping, adjustment, control, device : of ``images``.
    """
    block = orient_photographs(
        find_images(images).files,
        crs=campaign["crs"],
        control_points=control_points,
        marks=marks[0] if marks else None,
        positions=positions[0] if positions else None,
        camera=interior[0] if interior else None,
        masks=masks[0] if masks else None,
        features=features,
        mapping=mapping,
        adjustment=adjustment,
        control=control,
        threads=threads,
        device=device,
        progress=log.info,
    )
    block.write(folder, name=campaign["id"])
    for line in summary_text(block.found.facts).splitlines():
        log.info(line)
    for note in block.found.facts["notes"]:
        log.warning(note)
