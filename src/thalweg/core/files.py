"""Names of results that are being written, and files of others that are read with care: XML, pictures."""

from pathlib import Path
from typing import TYPE_CHECKING, Final
from xml.etree import ElementTree

import numpy as np

from thalweg.core.types import AnyArray

if TYPE_CHECKING:
    from numpy.typing import NDArray

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


class _Builder(ElementTree.TreeBuilder):
    """Builds trees of documents that declare no types: entities could read files, or grow without bound."""

    def doctype(self, name: str, public: str | None, system: str | None) -> None:
        """The parser calls this before any entity is declared."""
        raise ElementTree.ParseError(f"it declares a document type ({name}), which no survey program writes")


def parse_xml(text: str | bytes) -> ElementTree.Element:
    """Root of an XML document.

    Raises
    ------
    xml.etree.ElementTree.ParseError : no XML, or one with a document type and so perhaps entities.
    """
    parser = ElementTree.XMLParser(target=_Builder())
    parser.feed(text)
    root = parser.close()
    if not isinstance(root, ElementTree.Element):
        raise ElementTree.ParseError("no element found")
    return root


def decode_picture(data: "NDArray[np.uint8]", flags: int) -> AnyArray | None:
    """Pixels of a stored picture, as ``cv2.imdecode`` gives them; None if it is none.

    Neither is one whose head promises more than 2 ** 30 pixels: some kilobytes can stand for them.
    """
    import cv2

    try:
        picture = cv2.imdecode(data, flags) if data.size else None
    except cv2.error:
        return None
    return None if picture is None else np.asarray(picture)
