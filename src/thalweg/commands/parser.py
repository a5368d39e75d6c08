"""How every command looks: options as rows, an example in its help, and ``--force`` before it overwrites.

A row is names, kind, placeholder, help, and the default if there is one (`REQUIRED`: there is none, and the
option must be given). The kind is what makes a value of the text (`Path`, `float`, a function), a tuple of
choices, ``bool`` for a switch, ``[kind]`` for one value or more (as many as the placeholder has names), or
`Repeated`. A last entry holds further words of `argparse`.
"""

import argparse
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from thalweg.core import InputError, in_options

Row = tuple[Any, ...]
EXIT_MISTAKE: Final = 2
"""Of a process whose user, or whose file, made a mistake."""
REQUIRED: Final = object()
"""In place of a default."""


class Repeated(NamedTuple):
    """The kind of an option that may stand several times."""

    kind: Callable[[str], Any] = str


class OneOf(NamedTuple):
    """Options of which one is given at most, or just one if `required`."""

    rows: Iterable[Row]
    required: bool = False


class Part(NamedTuple):
    """Options below a title of their own in the help."""

    title: str
    rows: Iterable[Row]


def add_options(to: Any, rows: Iterable[Row | OneOf | Part]) -> None:
    """Add options to a parser or to a group of one; see the head of this module for rows."""
    for row in rows:
        if isinstance(row, OneOf):
            add_options(to.add_mutually_exclusive_group(required=row.required), row.rows)
        elif isinstance(row, Part):
            add_options(to.add_argument_group(row.title), row.rows)
        else:
            _add(to, *row)


def _add(
    to: Any, names: str, kind: Any, place: Any, words: str, default: Any = None, more: Any = None
) -> None:
    how: dict[str, Any] = {"help": words}
    if kind is bool:
        to.add_argument(names, action="store_true", **how)
        return
    if isinstance(kind, Repeated):
        how |= {"action": "append"}
        kind, default = kind.kind, []
    if isinstance(kind, list):
        how["nargs"] = len(place) if isinstance(place, tuple) else "+"
        kind = kind[0]
    how |= {"choices": kind} if isinstance(kind, tuple) else {"type": kind}
    how |= {"required": True} if default is REQUIRED else {} if default is None else {"default": default}
    to.add_argument(*names.split(), metavar=place, **how, **(more or {}))


EXAMPLES: Final = {
    "new-campaign": "mulde_2026 --from-logs ~/surveys/mulde",
    "check-config": "config/campaigns/mulde_2026.yaml",
    "init": "surveys",
    "run": "tiny --cores 2",
    "workflow-path": "",
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

    def add(
        self,
        name: str,
        words: str,
        run: Callable[[argparse.Namespace], int],
        *rows: Row | OneOf | Part,
        description: str = "",
        **defaults: Any,
    ) -> None:
        """Add a command and its options.

        Parameters
        ----------
        name, words, description : see `add_parser`.
        run : what it does; its exit status.
        rows : its options.
        defaults : ``writes`` (see `refuse_overwriting`); ``settings``: what stands for settings in messages.
        """
        parser = self.add_parser(name, help=words, description=description)
        add_options(parser, rows)
        parser.set_defaults(command=run, **defaults)

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


def say_notes(options: argparse.Namespace, notes: Iterable[str]) -> None:
    """Print what a command noticed, in the words of its options."""
    for note in notes:
        print(f"note: {in_options(note, getattr(options, 'settings', {}))}")
