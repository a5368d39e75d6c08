"""Commands around calibrations: printed markers, and calibrations of other programs."""

import argparse
import re
from pathlib import Path

from thalweg.core.errors import InputError


def add_calibration_commands(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add ``import-calibration`` and ``print-markers`` to the commands."""
    other = commands.add_parser(
        "import-calibration", help="calibration of another program (Kalibr, 4x4 matrix) -> calibration file"
    )
    other.add_argument(
        "file", type=Path, metavar="FILE", help="Kalibr camchain, or text file with a 4x4 matrix"
    )
    other.add_argument("out", type=Path, metavar="OUT", help="calibration file to write, .yaml")
    other.add_argument(
        "--sigma", action="append", default=[], type=_sigma, metavar="NAME=VALUE",
        help="a standard deviation that the file does not state: angle_deg, lever_m, focal_px, centre_px, "
        "distortion, time_s",
    )  # fmt: skip
    other.add_argument("--block", default="lidar", help="of a matrix: what it places (default: %(default)s)")
    other.add_argument("--target", default="", help="of a matrix: frame into which it turns, such as ics")
    other.add_argument("--source", default="", help="of a matrix: frame of the sensor, such as scs")
    other.set_defaults(command=_import_calibration)

    sheets = commands.add_parser(
        "print-markers", help="printed markers of a calibration field, in true scale"
    )
    sheets.add_argument("out", type=Path, metavar="OUT", help="file .pdf, or a folder for pictures")
    sheets.add_argument("--ids", default="0-99", metavar="FROM-TO", help="markers (default: %(default)s)")
    sheets.add_argument(
        "--field", type=Path, metavar="YAML", help="field description: its dictionary and sizes"
    )
    sheets.add_argument(
        "--module-mm", type=float, default=12.0, help="side of a module, millimetres (default: %(default)s)"
    )
    sheets.set_defaults(command=_print_markers)


def _print_markers(options: argparse.Namespace) -> int:
    from thalweg.calibration.field_description import read_field
    from thalweg.calibration.marker_sheets import MarkerLayout, write_sheets

    found = re.fullmatch(r"(\d{1,3})(?:-(\d{1,3}))?", options.ids)
    if found is None:
        raise InputError(
            f"markers {options.ids!r}", expected="one id or FROM-TO", cure="Write for instance --ids 0-63"
        )
    first, last = int(found[1]), int(found[2] or found[1])
    layout = (
        read_field(options.field).layout
        if options.field
        else MarkerLayout(module_m=options.module_mm / 1000.0)
    )
    written = write_sheets(options.out, range(first, last + 1), layout)
    print(f"Wrote {', '.join(str(path) for path in written[:3])}{' …' if len(written) > 3 else ''}")
    print("Print without scaling; the control line of each sheet is 100 mm long.")
    return 0


def _import_calibration(options: argparse.Namespace) -> int:
    from thalweg.core.calibration_file import write_calibration
    from thalweg.core.calibration_imports import import_kalibr, import_matrix
    from thalweg.ingest.recognise import KINDS, recognise

    kind, sigmas = recognise(options.file), dict(options.sigma)
    if options.out.exists():
        raise InputError("the file exists already", where=options.out, cure="Choose another name")
    if kind == "kalibr":
        found = import_kalibr(options.file, sigmas)
    elif kind == "matrix":
        found = import_matrix(
            options.file, sigmas, name=options.block, target=options.target, source=options.source
        )
    else:
        raise InputError(
            f"this is a {KINDS[kind]}", where=options.file, expected=f"{KINDS['kalibr']} or {KINDS['matrix']}"
        )
    write_calibration(options.out, found)
    print(f"Wrote {options.out}. Look at it with: thalweg describe {options.out}")
    return 0


def _sigma(text: str) -> tuple[str, float]:
    from thalweg.core.calibration_imports import SIGMAS

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
