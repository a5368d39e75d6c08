"""The commands ``thalweg orient``, ``masks`` and ``frames``: and those of videos, without a campaign."""

import argparse
import os
import sys
from pathlib import Path
from typing import Final

from thalweg.commands.options import FOLDER, INTERIORS, PHOTOGRAPHS, XYZ
from thalweg.commands.parser import REQUIRED, Commands, say_notes
from thalweg.commands.remedies import OF_CONTROL, of_a_campaign

_EXAMPLES = 24
"""Photographs that the overview of masks shows."""
_MASKED: Final = ("water", "sky", "hull", "moved")
_SIGMA_GPS_BEGIN_S: Final = 0.5
"""Presumed: positions of a GoPro come some tenths of a second late, by how much no document states."""


def add_image_commands(commands: Commands) -> None:
    """Add ``orient``, ``masks`` and ``frames``."""
    commands.add(
        "frames",
        "video, or bag of ROS -> photographs with a table of their times",
        _frames,
        ("video", Path, "VIDEO", "MP4, MOV; bag"),
        ("--topic", str, "TOPIC", "of several cameras of a bag", ""),
        ("--every", float, "S", "time between frames (default: all frames)", 0.0),
        ("--begin", str, "UTC", "time of the first frame, ISO 8601 (default: as the container says)"),
        ("--sigma-begin", float, "S", "its standard deviation"),
        ("--out", Path, "FOLDER", "folder of the frames", REQUIRED),
        writes="times.csv",
    )
    commands.add(
        "masks",
        "photographs of a series -> masks of water, sky, own boat, what moved; a sheet to look at",
        _masks,
        PHOTOGRAPHS,
        (
            "--least-mirror",
            float,
            "R",
            "correlation with its reflection from which on the foreground is water; -1: always",
        ),
        ("--out", Path, "FOLDER", "folder of the masks", REQUIRED),
        description="Masks water that shows reflections, smooth and bright sky, and the own boat, which "
        "keeps its place in eight photographs or more; of a fixed camera also what moved. Parts that "
        "cannot be told apart stay unmasked, and the command says so.",
        writes="masks.csv",
        settings=of_a_campaign(["logs.time_lapse.images", "logs.time_lapse.interiors"]),
    )
    commands.add(
        "orient",
        "photographs and control points or positions -> poses with sigmas, lens, tie points, page",
        _orient,
        PHOTOGRAPHS,
        (
            "--points",
            [Path],
            "FILE",
            "id, x, y, z (and sigmas, role) as CSV; XML of Metashape; gcp_list.txt",
            [],
        ),
        (
            "--marks",
            Path,
            "FILE",
            "image, point, x_px, y_px from the upper left corner as CSV; XML of Metashape; gcp_list.txt; "
            "without --points of tie points",
        ),
        (
            "--positions",
            Path,
            "FILE",
            "image, x, y, z and accuracy of the projection centres, beside control points or instead",
        ),
        ("--crs", str, "CRS", "map grid of points and positions, as EPSG:25833; or local"),
        ("--camera", Path, "FILE", "calibration, COLMAP or OpenCV file (default: estimated)"),
        (
            "--interior",
            INTERIORS,
            None,
            "interior orientation; auto: weighted by its covariance if it has one, else estimated",
            "auto",
        ),
        ("--masks", Path, "FOLDER", "masks, black where no image point may lie"),
        (
            "--sigma-points",
            [float],
            XYZ,
            "standard deviations of control points that state none (default: 0.010 0.010 0.015)",
            (0.010, 0.010, 0.015),
        ),
        (
            "--sigma-px",
            float,
            "PX",
            "standard deviation of image points that state none (default: %(default)s)",
            0.5,
        ),
        ("--max-size", int, "PX", "longest side to which images are reduced (default: %(default)s)", 2000),
        ("--threads", int, "N", "threads (default: all cores)", os.cpu_count() or 1),
        FOLDER,
        description="Structure from motion and one adjustment with control points or positions of the camera "
        "inside. At least three control points, each measured in two photographs, or three positions off a "
        "line; points of role 'check' judge the result. Without either the photographs become a model in a "
        "frame of its own, without scale.",
        writes="index.html",
        settings={
            **OF_CONTROL,
            **of_a_campaign(["images.device"]),
            "images.adjustment.interior": "--interior",
            "images.mapping.interior": "--interior",
            "logs.time_lapse.images": "the photographs",
            "logs.time_lapse.interior": "--camera",
            "logs.time_lapse.interiors": "--camera",
            "mounts.calibration": "--camera",
            **of_a_campaign(
                [
                    "images.adjustment.antenna.use",
                    "images.clock",
                    "images.control.height_offset_m",
                    "images.mapping.cameras",
                    "images.mapping.lens",
                    "images.mapping.pairs",
                    "mounts.camera",
                ]
            ),
        },
    )


def _orient(options: argparse.Namespace) -> int:
    from thalweg.core import ConfigError
    from thalweg.figures.images import image_positions, orientation_page
    from thalweg.images import orient_photographs
    from thalweg.images.bundle import pieces_tables, summary_text
    from thalweg.ingest.photos import find_images
    from thalweg.settings.sections import BlockAdjustment, ControlSettings, FeatureSettings

    if options.points and not options.marks:
        raise ConfigError(
            "control points without marks",
            expected="--marks: where the photographs show them",
            where="thalweg orient",
        )
    if (options.points or options.positions) and not options.crs:
        raise ConfigError(
            "coordinates without a CRS",
            expected="--crs EPSG:... of the map grid, or --crs local",
            where="thalweg orient",
        )
    found = orient_photographs(
        find_images(options.photographs).files,
        control_points=options.points,
        marks=options.marks,
        positions=options.positions,
        crs=options.crs,
        camera=options.camera,
        masks=options.masks,
        features=FeatureSettings(max_size_px=options.max_size),
        adjustment=BlockAdjustment(interior=options.interior),
        control=ControlSettings(sigma_m=tuple(options.sigma_points), sigma_px=options.sigma_px),
        threads=options.threads,
        progress=lambda line: print(f"... {line}", file=sys.stderr),
    )
    name = options.out.resolve().name
    written = found.write(options.out, name=name)
    page, title = options.out / "index.html", f"Photographs of {name}"
    images, control = pieces_tables(found.found)
    # the map is one of metres
    drawn = () if found.crs is None else ("places",)
    orientation_page(
        found.found.facts,
        images,
        control,
        {n: image_positions(found.found.poses, found.control, control, title=title) for n in drawn},
        captions={
            "places": "Projection centres, control and check points with residual vectors: adjusted minus "
            "surveyed, as if the point's own coordinates had taken no part."
        },
        title=title,
    ).write(page)
    print(summary_text(found.found.facts))
    print(f"Wrote {', '.join(str(path) for path in [page, *written])}")
    return 0


def _masks(options: argparse.Namespace) -> int:
    from thalweg.figures import save
    from thalweg.figures.images import example_names, mask_view, read_examples
    from thalweg.images.masks import known_camera, make_masks_of_cameras
    from thalweg.ingest.photos import find_images, named_images
    from thalweg.settings.sections import MaskSettings

    images = named_images(find_images(options.photographs).files)
    settings = MaskSettings()
    if options.least_mirror is not None:
        settings = MaskSettings(least_mirror=options.least_mirror)
    found = make_masks_of_cameras(images, options.out, settings, known_camera([], [], {}))
    found.to_csv(options.out / "masks.csv", index=False)
    pictures = read_examples(example_names(found, _EXAMPLES, tail=0.0), images, options.out)
    title = f"Masks of {options.out.resolve().name}"
    save(mask_view(found, pictures, title=title), options.out / "overview.png")
    for row in found.to_dict("records"):
        shares = [f"{part} {100 * row[f'{part}_share']:.1f} %" for part in ("usable", *_MASKED)]
        untold = f"cannot tell: {row['cannot_tell']}" if row["cannot_tell"] else ""
        print(f"{row['image']}: {'; '.join(filter(None, (', '.join(shares), untold, row['note'])))}")
    say_notes(options, found.attrs["notes"])
    print(f"Wrote {len(found)} masks, masks.csv and overview.png in {options.out}")
    return 0


def _frames(options: argparse.Namespace) -> int:
    from datetime import datetime

    from thalweg.core import ConfigError
    from thalweg.ingest import read_head
    from thalweg.ingest.photos import write_frames
    from thalweg.ingest.recorders import begin_by_gps, is_bag, is_gopro, write_bag_images

    head = read_head(options.video)
    if is_bag(head, 0):
        table = write_bag_images(options.video, options.out, options.topic, options.every)
        print(f"{len(table)} images with the stamps of their headers, taken as UTC. In a campaign file:")
        print(f"  logs: {{time_lapse: {{images: [{options.out}], times: [{options.out / 'times.csv'}]}}}}")
        return 0
    try:
        begin = None if options.begin is None else datetime.fromisoformat(options.begin)
    except ValueError as error:
        raise ConfigError(
            f"--begin {options.begin!r}",
            expected="a time such as 2026-05-12T09:30:00.25Z",
            where="thalweg frames",
        ) from error
    sigma_s = options.sigma_begin
    if begin is None and is_gopro(head, 0) and (begin := begin_by_gps(options.video)):
        sigma_s = _SIGMA_GPS_BEGIN_S if sigma_s is None else sigma_s
        print(
            f"note: Begin {begin:%Y-%m-%dT%H:%M:%S.%f}Z by the camera's GPS: its container holds local time. "
            f"Standard deviation {sigma_s:.3g} s"
            + (", presumed: the receiver's delay is not documented" if options.sigma_begin is None else "")
        )
    found = write_frames(
        options.video, options.out, every_s=options.every, begin=begin, sigma_begin_s=sigma_s
    )
    say_notes(options, found.notes)
    print(f"{len(found.table)} frames, {found.table['since_begin_s'].iloc[-1]:.3f} s. In a campaign file:")
    print(f"  logs: {{time_lapse: {{images: [{options.out}], times: [{options.out / 'times.csv'}]}}}}")
    clock = f"sigma_offset_s: {found.sigma_offset_s:.3g}, jitter_s: {found.jitter_s:.2g}"
    print(f"  images: {{clock: {{{clock}}}}}")
    return 0
