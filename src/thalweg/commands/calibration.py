"""Commands around calibrations: printed markers, calibrations and cameras of other programs, descriptions."""

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

from thalweg.commands.options import INTERIORS, LENSES, size
from thalweg.commands.parser import REQUIRED, Commands, Repeated, Row, refuse_overwriting, say_notes
from thalweg.commands.remedies import OF_CONTROL, of_a_campaign
from thalweg.core import InputError

if TYPE_CHECKING:
    from thalweg.core.calibration import Calibration


_ENDINGS: Final = {"colmap": (".txt",), "opencv": (".yaml", ".yml", ".json")}
"""Format of a camera file -> endings of its name by which it is known again."""


def add_calibration_commands(commands: Commands) -> None:
    """Add ``import-calibration``, ``import-camera``, ``export-camera`` and ``print-markers``."""
    commands.add(
        "import-calibration",
        "calibration of another program (Kalibr, 4x4 matrix) -> calibration file",
        _import_calibration,
        ("file", Path, "FILE", "Kalibr camchain, or text file with a 4x4 matrix"),
        *_imported("angle_deg, lever_m, focal_px, centre_px, distortion, time_s"),
        ("--block", str, None, "of a matrix: name of the sensor (default: %(default)s)", "lidar"),
        ("--target", str, None, "of a matrix: target frame, such as ics", ""),
        ("--source", str, None, "of a matrix: source frame, such as scs", ""),
    )
    commands.add(
        "calibrate-lens",
        "a checkerboard in several photographs -> interior orientation with covariance",
        _calibrate_lens,
        (
            "corners",
            [Path],
            "FILE",
            "photographs, with --board; or a table of image, column, row, x_px, y_px, with --size",
        ),
        ("--board", size, "CxR", "inner corners of the board, such as 7x5"),
        ("--size", size, "WxH", "image size of a table, pixels"),
        ("--spacing-m", float, "M", "distance of neighbouring corners", REQUIRED),
        ("--model", LENSES, None, "projection model of the lens", REQUIRED),
        ("--name", str, None, "name of the camera (default: %(default)s)", "camera"),
        ("-o --out", Path, "YAML", "calibration file to write", REQUIRED),
    )
    commands.add(
        "resect",
        "resection: image points of control points -> pose of each image with covariance",
        _resect,
        (
            "marks",
            [Path],
            "CSV",
            "image, point, x_px, y_px; or a table for each picture, named like it: label, x, y",
        ),
        (
            "--points",
            [Path],
            "FILE",
            "id, x, y, z (and sigmas, role) as CSV; XML of Metashape; metres",
            REQUIRED,
        ),
        ("--crs", str, "CRS", "map grid of the points, as EPSG:25833 (default: %(default)s)", "local"),
        ("--camera", Path, "FILE", "calibration, COLMAP or OpenCV file; else --free"),
        (
            "--interior",
            INTERIORS,
            None,
            "interior orientation of --camera; auto: weighted by its covariance if it has one that the "
            "marks do not contradict, else a guess (focal length 2 %%, ...) that is estimated with the poses",
            "auto",
        ),
        (
            "--free",
            _words,
            "WORDS",
            "what to estimate of the lens that all pictures share: focal; focal,k1; focal,centre,k1,k2",
            (),
        ),
        ("--size", size, "WxH", "with --free, without --camera: image size, pixels"),
        (
            "--photograph",
            Path,
            "FILE",
            "instead of --size, or beside it for EXIF: a picture (default: looked for beside the marks)",
        ),
        ("--sigma-px", float, "PX", "standard deviation of an image coordinate (default: %(default)s)", 1.0),
        (
            "--sigma-point",
            float,
            "M",
            "standard deviation of a control point coordinate (default: %(default)s)",
            0.01,
        ),
        (
            "--largest-sigma",
            float,
            "M",
            "refuse projection centres with a larger standard deviation (default: %(default)s)",
            5.0,
        ),
        ("-o --out", Path, "CSV", "table of poses and residuals to write", REQUIRED),
        settings={
            **OF_CONTROL,
            "images.fixed_camera.largest_sigma_m": "--largest-sigma",
            " (in a campaign images.fixed_camera.size_px)": "",
            **of_a_campaign(["images.adjustment.antenna.use"]),
        },
    )
    commands.add(
        "import-camera",
        "camera file of COLMAP, OpenCV, ROS or Metashape -> calibration file",
        _import_camera,
        ("file", Path, "FILE", "cameras.txt, YAML or JSON with a matrix, XML of Metashape"),
        *_imported("focal_px, centre_px, distortion, or a coefficient: k2"),
        ("--camera", int, "NUMBER", "number of the camera, if the file holds several"),
        ("--model", LENSES, None, "if a file of OpenCV does not state it"),
        ("--size-px", [int], ("WIDTH", "HEIGHT"), "if a file of OpenCV does not state it"),
        ("--block", str, "NAME", "name of the camera (default: %(default)s)", "camera"),
    )
    commands.add(
        "export-camera",
        "camera of a calibration file -> file of COLMAP or OpenCV, without sigmas",
        _export_camera,
        ("file", Path, "CALIBRATION_FILE", "such as camera.yaml"),
        ("out", Path, "OUT", "file to write: .txt (COLMAP); .yaml, .json"),
        ("--to", tuple(sorted(_ENDINGS)), None, "format of OUT", REQUIRED),
        ("--block", str, "NAME", "name of the camera, if the file holds several"),
    )
    commands.add(
        "print-markers",
        "coded markers of a calibration field, to print at true scale",
        _print_markers,
        ("sheets", Path, "OUT", "file .pdf, or a folder for images"),
        ("--ids", str, "FROM-TO", "numbers of markers (default: %(default)s)", "0-99"),
        ("--field", Path, "YAML", "field description; gives dictionary and sizes"),
        ("--module-mm", float, None, "side of a module, 2 to 18 millimetres (default: 12), without --field"),
        ("--force", bool, None, "overwrite files that exist"),
    )


def _imported(sigmas: str) -> tuple[Row, ...]:
    """Rows of commands that take a calibration of another program, which may state no standard deviations."""
    return (
        ("out", Path, "OUT", "calibration file to write, .yaml"),
        (
            "--sigma",
            Repeated(_sigma),
            "NAME=VALUE",
            f"a standard deviation that the file does not state: {sigmas}",
        ),
    )


def _words(text: str) -> tuple[str, ...]:
    return tuple(word.strip() for word in text.split(",") if word.strip())


def _print_markers(options: argparse.Namespace) -> int:
    from thalweg.calibration import MarkerLayout, write_sheets
    from thalweg.calibration.field import read_field

    found = re.fullmatch(r"(\d{1,3})(?:-(\d{1,3}))?", options.ids)
    first, last = (int(found[1]), int(found[2] or found[1])) if found else (1, 0)
    if first > last:
        raise InputError(
            f"markers {options.ids!r}",
            expected="one id, or FROM-TO in rising order",
            cure="Write for instance --ids 0-63",
        )
    if options.field and options.module_mm is not None:
        raise InputError(
            f"both --field {options.field} and --module-mm {options.module_mm:g}",
            expected="one of them: the field description states the sizes, and the adjustment takes its own",
            cure="Leave --module-mm out, or change module_m in the field description",
        )
    module_m = 12e-3 if options.module_mm is None else options.module_mm / 1000.0
    layout = read_field(options.field).layout if options.field else MarkerLayout(module_m=module_m)
    written = write_sheets(options.sheets, range(first, last + 1), layout, overwrite=options.force)
    print(f"Wrote {', '.join(str(path) for path in written[:3])}{' …' if len(written) > 3 else ''}")
    print("Print without scaling; the control line of each sheet is 100 mm long.")
    return 0


def _write(out: Path, calibration: "Calibration") -> int:
    from thalweg.core.calibration import write_calibration

    write_calibration(out, calibration)
    print(f"Wrote {out}. Look at it with: thalweg describe {out}")
    return 0


def _import_calibration(options: argparse.Namespace) -> int:
    from thalweg.core.calibration import import_kalibr, import_matrix
    from thalweg.ingest.registry import KINDS, recognise

    kind, sigmas = recognise(options.file), dict(options.sigma)
    if kind == "kalibr":
        found = import_kalibr(options.file, sigmas)
    elif kind == "matrix":
        found = import_matrix(
            options.file, sigmas, name=options.block, target=options.target, source=options.source
        )
    else:
        raise InputError(
            f"this is a {KINDS[kind]}",
            where=options.file,
            expected=f"{KINDS['kalibr']} or {KINDS['matrix']}",
            cure="Use `thalweg import-camera`" if kind in _ENDINGS else "",
        )
    return _write(options.out, found)


def _resect(options: argparse.Namespace) -> int:
    from thalweg.calibration import interior_calibration
    from thalweg.core import global_test
    from thalweg.core.calibration import Source, write_calibration
    from thalweg.figures.images import fixed_camera_page, pose_history
    from thalweg.images import resect_pictures
    from thalweg.settings.sections import ControlSettings, FixedCamera

    beside = options.out.with_name(f"{options.out.stem}_residuals.csv")
    page, title = options.out.with_suffix(".html"), f"Pictures of a fixed camera: {options.out.stem}"
    lens = options.out.with_name(f"{options.out.stem}_camera.yaml")
    written = [options.out, beside, page, lens]
    refuse_overwriting(options, written)
    poses, residuals, facts, camera = resect_pictures(
        options.marks,
        options.points,
        options.camera,
        crs=options.crs,
        control=ControlSettings(sigma_px=options.sigma_px, sigma_m=(options.sigma_point,) * 3),
        settings=FixedCamera(largest_sigma_m=options.largest_sigma, interior=options.interior),
        free=options.free,
        size_px=options.size,
        photograph=options.photograph,
    )
    options.out.parent.mkdir(parents=True, exist_ok=True)
    poses.to_csv(options.out, index=False)
    residuals.to_csv(beside, index=False, float_format="%.3f")
    fixed_camera_page(
        facts,
        poses,
        {"history": pose_history(poses, title=title)},
        captions={"history": "Place of the camera in each picture less its mean, with standard deviations."},
        title=title,
    ).write(page)
    for row in poses.to_dict("records"):
        if row["refused"]:
            print(f"{row['image']}: no pose: {row['refused']}")
            continue
        worst = max(row["sigma_x_m"], row["sigma_y_m"], row["sigma_z_m"])
        test = global_test(row["sigma0"], row["redundancy"])
        print(
            f"{row['image']}: {row['x_m']:.3f} {row['y_m']:.3f} {row['z_m']:.3f} m, sigma up to "
            f"{worst:.3f} m, {row['points']} points, rms {row['rms_px']:.2f} px, sigma0 {test.sigma0:.2f} "
            f"({test.low:.2f} to {test.high:.2f} expected)"
        )
    for name, found in facts["lens"].items():
        print(f"{name:>4} {found['value']:12.6g} +- {found['sigma']:.2g}")
    if facts["lens"]:
        source = Source(
            run=options.out.stem,
            method="resection with an unknown lens",
            observations=2 * int(poses["points"][poses["refused"] == ""].sum()),
            sigma0=float(poses["sigma0"].max()),
        )
        write_calibration(lens, interior_calibration(camera, source))
    else:
        written.remove(lens)
    say_notes(options, facts["notes"])
    print(f"{facts['with_pose']} of {facts['pictures']} pictures have a pose")
    print(f"Wrote {', '.join(str(path) for path in written)}")
    return 0


def _calibrate_lens(options: argparse.Namespace) -> int:
    from thalweg.calibration import calibrate_lens, corners_of_pictures, lens_calibration_file, read_corners

    if not options.name.isidentifier():
        raise InputError(f"a camera named {options.name!r}", expected="a name such as camera or front")
    if options.board:
        corners, size, missed = corners_of_pictures(options.corners, options.board)
        run = f"{len(options.corners)} pictures"
    else:
        if len(options.corners) > 1 or not options.size:
            raise InputError(
                f"{len(options.corners)} files, neither --board nor --size",
                expected="photographs and --board COLUMNSxROWS, or one table of corners and --size WxH",
            )
        corners, size, missed = read_corners(options.corners[0]), options.size, {}
        run = options.corners[0].name
    found = calibrate_lens(corners, size, spacing_m=options.spacing_m, model=options.model, name=options.name)
    sigmas = found.camera.cov.diagonal() ** 0.5
    for name, value, sigma in zip(found.camera.parameter_names, found.camera.parameters, sigmas, strict=True):
        print(f"{name:>4} {value:12.6g} +- {sigma:.2g}")
    used = found.corners["used"]
    print(
        f"{used.sum():,} of {len(used):,} corners in {found.corners['image'].nunique()} pictures, rms "
        f"{found.rms_px:.3f} px, up to {found.corners.loc[used, 'angle_deg'].max():.0f} degrees from the axis"
    )
    for picture, why in (missed | found.left_out).items():
        print(f"left out: {picture}: {why}")
    for corner in found.rejected:
        print(f"rejected: {corner}")
    return _write(options.out, lens_calibration_file(found, run=run))


def _import_camera(options: argparse.Namespace) -> int:
    from thalweg.core.calibration import import_camera
    from thalweg.ingest.registry import KINDS, recognise

    kind = recognise(options.file)
    if kind not in (*_ENDINGS, "metashape_lens"):
        raise InputError(
            f"this is a {KINDS[kind]}",
            where=options.file,
            expected=f"{KINDS['colmap']}, {KINDS['opencv']} or {KINDS['metashape_lens']}",
            cure="Use `thalweg import-calibration`" if kind in ("kalibr", "matrix") else "",
        )
    if not options.block.isidentifier():
        raise InputError(f"a camera named {options.block!r}", expected="a name such as camera or reference")
    found = import_camera(
        options.file,
        dict(options.sigma),
        kind=kind,
        number=options.camera,
        model=options.model,
        name=options.block,
        size_px=tuple(options.size_px) if options.size_px else None,
    )
    if held := found.blocks[0].facts.get("held"):
        print(f"held at their values, sigma zero: {', '.join(held)}; not so? --sigma {held[0]}=...")
    return _write(options.out, found)


def _export_camera(options: argparse.Namespace) -> int:
    from thalweg.calibration import SUFFIX, camera_of
    from thalweg.core import write_colmap, write_opencv
    from thalweg.core.calibration import read_calibration

    if options.out.suffix.lower() not in _ENDINGS[options.to]:
        raise InputError(
            f"the name '{options.out.name}' for a file of {options.to}",
            expected=f"one that ends in {' or '.join(_ENDINGS[options.to])}",
            cure="Camera files are known again by their endings",
        )
    calibration = read_calibration(options.file)
    known = [b.name.removesuffix(SUFFIX) for b in calibration.blocks if b.name.endswith(SUFFIX)]
    block = options.block or (known[0] if len(known) == 1 else "")
    if block not in known:
        raise InputError(
            f"{'no camera ' + repr(block) if block else f'{len(known)} cameras'} in the calibration",
            where=options.file,
            expected=f"one of {', '.join(known)}" if known else f"a block such as camera{SUFFIX}",
            cure="Name one with --block" if known else "Name the calibration of a camera, camera.yaml",
        )
    camera = camera_of(calibration, block)
    if options.to == "colmap":
        write_colmap(options.out, {1: camera})
    else:
        write_opencv(options.out, camera)
    print(f"Wrote {options.out}: camera {block}, without the sigmas and correlations of {options.file}.")
    return 0


def _sigma(text: str) -> tuple[str, float]:
    from thalweg.core.calibration import SIGMAS

    name, _, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = -1.0
    if name not in SIGMAS or not 0 <= number < float("inf"):
        raise argparse.ArgumentTypeError(
            f"{text!r}; expected one of {', '.join(SIGMAS)} with a value: lever_m=0.002"
        )
    return name, number
