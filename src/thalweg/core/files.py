"""Names of results while they are being written."""

from pathlib import Path
from typing import Final

UNFINISHED: Final = ".part-"
"""Start of the name of a folder with outputs of a running job, inside the folder where they will stand."""


def final_path(path: Path) -> Path:
    """Where a file will stand when its job is done; links from it to other files start there.

    Examples
    --------
    >>> final_path(Path("results/tiny/.part-0a1b/index.html")).as_posix()
    'results/tiny/index.html'
    """
    return Path(*(part for part in path.parts if not part.startswith(UNFINISHED)))
