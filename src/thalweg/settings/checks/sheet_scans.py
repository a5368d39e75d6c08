"""Is each scan of the light-sheet sensor complete?"""

from collections.abc import Iterator, Mapping
from typing import Final

from thalweg.core.mistakes import Mistake
from thalweg.settings.light_sheet.scans import SCAN_PARTS, SERIES, scan_stream
from thalweg.settings.sections.logs import STREAM_KEYS, Logs

_NEEDED: Final = {
    "images": "images of the sensor",
    "panel": "coordinates of the panel's marks",
    "marks": "marks in the pictures of the standing camera",
    "camera": "interior orientation of the standing camera",
}


def check_scans(logs: Logs, files: Mapping[str, tuple[str, ...]]) -> Iterator[Mistake]:
    """Mistakes in ``logs.light_sheet.scans``.

    Parameters
    ----------
    logs : the section as written.
    files : absolute paths by stream, patterns expanded; see `thalweg.settings.checks.files.check_files`.
    """
    for name, scan in logs.light_sheet.scans.items():
        where = ("logs", "light_sheet", "scans", name)
        if name in SERIES or name in STREAM_KEYS:
            yield Mistake(
                path=where, found=f"a scan called {name}",
                expected="a name that no other series of images has",
                cure="Call the scan by its object",
            )  # fmt: skip
            continue
        for part, what in _NEEDED.items():
            if not getattr(scan, part):
                yield Mistake(
                    path=(*where, part), found="missing", expected=what,
                    cure=f"Add the line `{part}: [...]`; docs/light_sheet.md says what each file holds",
                )  # fmt: skip
        for one, other in (("reference", "pairs"), ("pairs", "reference")):
            if getattr(scan, one) and not getattr(scan, other):
                yield Mistake(
                    path=(*where, other), found="missing", expected=f"both reference and pairs, beside {one}",
                    cure="Pick three or more places that scan and mesh both show",
                )  # fmt: skip
        for part in SCAN_PARTS[1:]:
            count = len(files.get(scan_stream(name, part), ()))
            if count > 1:
                yield Mistake(
                    path=(*where, part), found=f"{count} files", expected="one file",
                    cure="Name the one of this scan; another scan gets a name of its own",
                )  # fmt: skip
