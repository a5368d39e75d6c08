"""How every command looks: a description and an example in its help, and ``--force`` before it overwrites."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from thalweg.core import InputError

EXAMPLES: Final = {
    "new-campaign": "mulde_2026 --from-logs ~/surveys/mulde",
    "check-config": "config/campaigns/mulde_2026.yaml",
    "describe": "my.pcap rover.sbp ins.anpp",
    "summary": "results/mulde_2026",
    "budget": "resources/budgets/p2_table1.yaml",
    "schema": "> schema.json",
    "bed": "soundings.csv --crs EPSG:32633 --height z --banks banks.geojson --cell 1 --out bed",
    "flow": "points.csv --centre-line line.csv --out flow.csv",
    "plan-survey": "banks.geojson --crs EPSG:32633 --pattern zigzag --speed 1 --sigma 0.1",
    "refract": "points.csv --cameras cameras.csv --level 174.80 --sigma-water 0.02 -o bed.csv",
    "import-calibration": "camchain.yaml camera.yaml --sigma focal_px=0.5 --sigma centre_px=0.5",
    "import-camera": (
        "cameras.txt camera.yaml --sigma focal_px=0.5 --sigma centre_px=0.5 --sigma distortion=1e-4"
    ),
    "export-camera": "camera.yaml cameras.txt --to colmap",
    "print-markers": "markers.pdf --ids 0-63",
    "calibrate-lens": "photos/*.png --board 7x5 --spacing-m 0.095 --model fisheye -o lens.yaml",
    "resect": "marks.csv --points points.csv --camera lens.yaml --sigma-px 0.5 -o poses.csv",
    "compare-clouds": "2019.laz 2021.laz --sigma-a 0.03 --sigma-b 0.03 -o changes.laz",
    "compare": "boat.laz tls.laz --seen-from 412004,5650970,152 -o distances.laz",
    "fetch": "river_bottom_interpolator",
    "frames": "video.mp4 --every 0.5 --out frames",
    "masks": "photos --out masks",
    "orient": "photos --points points.csv --marks marks.csv --crs EPSG:25833 --out block",
    "ppk": "rover.sbp --base base.obs --nav base.nav --base-position 51.05 13.25 243.0 --out track",
    "georeference": (
        "lidar.pcap --trajectory sbet.out --gps-week 2157 --lever -0.42 0 -0.18 "
        "--sigma-position 0.05 --sigma-attitude 0.1 --crs EPSG:25833 --out cloud.laz"
    ),
    "align-strips": (
        "lidar.pcap --trajectory sbet.out --gps-week 2157 --lever -0.42 0 -0.18 "
        "--sigma-position 0.05 --sigma-attitude 0.1 --out strips"
    ),
    "view": "boat.laz -o page",
    "cluster": "status",
    "catalogue": "results",
    "costs": "results",
    "verify": "results/mulde_2026",
}
"""One call of each command, without its name; the page of single commands shows the same."""


class Parser(argparse.ArgumentParser):
    """A parser that gives each command with an output ``out`` the option ``--force``."""

    def add_argument(self, *names: Any, **options: Any) -> argparse.Action:
        """Add an argument, and ``--force`` beside ``out``."""
        action = super().add_argument(*names, **options)
        if action.dest == "out":
            super().add_argument("--force", action="store_true", help=f"overwrite {action.metavar}")
        return action


class Commands:
    """The commands of a parser.

    Parameters
    ----------
    parser : of ``thalweg``.
    """

    def __init__(self, parser: argparse.ArgumentParser) -> None:
        self.by_name = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=Parser)

    def add_parser(self, name: str, *, help: str, description: str = "") -> argparse.ArgumentParser:
        """A new command.

        Parameters
        ----------
        name : of the command; `EXAMPLES` has a call of it.
        help : one line for the list of commands.
        description : above the options; the line of the list if empty.

        Returns
        -------
        argparse.ArgumentParser
            To add arguments to.
        """
        return self.by_name.add_parser(
            name,
            help=help,
            description=description or f"{help[0].upper()}{help[1:]}.",
            epilog=f"Example: thalweg {name} {EXAMPLES[name]}",
        )


def refuse_overwriting(options: argparse.Namespace, more: Sequence[Path] = ()) -> None:
    """Refuse an output that is there, before any work is done.

    Parameters
    ----------
    options : of a command; where ``out`` is a folder, ``writes`` names a file that the command writes there.
    more : files that it writes beside ``out``.

    Raises
    ------
    InputError : one of these files exists, and ``--force`` is not given.
    """
    out = getattr(options, "out", None)
    for path in (out / getattr(options, "writes", ""), *more) if out and not options.force else ():
        if path.is_file():
            raise InputError(
                "the file exists already", where=path, cure="Choose another name, or overwrite with --force"
            )
