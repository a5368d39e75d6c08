"""The printed marker sheet: an ArUco tag with a checker crossing (saddle) at each corner.

Sheet coordinates ``(u, v)`` are in modules, u to the right and v downwards of the upright tag, from (0, 0)
to (10, 10), with half a module of white margin outside. The tag with its black border covers modules 2 to
8. The four saddles lie at (1, 1), (9, 1), (9, 9), (1, 9), a square of eight modules; they are what is
measured, since a crossing of black and white stays in place when it is blurred or overexposed, while the
edge of a tag moves.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from thalweg.core import ArrayF, ArrayU8, GeometryError, InputError, optional

cv2 = optional("cv2")

SHEET_MODULES: Final = 10
"""Side of the sheet without its margin."""
MARGIN_MODULES: Final = 0.5
TAG_MODULES: Final = (2, 8)
"""First and last module of the tag with its black border, in both directions."""
SADDLES_MODULES: Final[ArrayF] = np.array([[1.0, 1.0], [9.0, 1.0], [9.0, 9.0], [1.0, 9.0]])
"""(4, 2) the saddles in sheet coordinates: upper left, upper right, lower right, lower left."""
SADDLE_SQUARE_MODULES: Final = 8
TAG_CORNERS_MODULES: Final[ArrayF] = np.array([[2.0, 2.0], [8.0, 2.0], [8.0, 8.0], [2.0, 8.0]])
_PICTURES: Final = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".svg"}
"""Endings of a picture's name, which is no name for a folder of pictures."""
DICTIONARIES: Final = ("DICT_4X4_50", "DICT_4X4_100", "DICT_4X4_250", "DICT_4X4_1000")
"""All of ArUco that have 4x4 cells."""
DOTS_PER_MM: Final = 20
"""Of a printed page; 0.6, 0.8, 1 mm ... are whole numbers of dots, so no module is a dot too wide."""
PAGE_MM: Final = (210, 297)
CONTROL_LINE_MM: Final = 100
LEAST_PRINT_MM: Final = 2.0
"""Smallest module that is printed: crossings need two pixels a module or more, and the nearest pictures of a
field, from 2 m, have about a millimetre a pixel."""
MOST_PRINT_MM: Final = (PAGE_MM[0] - 10) / (SHEET_MODULES + 2 * MARGIN_MODULES)
"""Largest module that fits on A4 with 5 mm to each edge."""


@dataclass(frozen=True, slots=True)
class MarkerLayout:
    """Which tags are used and how large they are printed.

    Parameters
    ----------
    dictionary : name of a predefined ArUco dictionary of 4x4 tags, such as ``DICT_4X4_250``.
    module_m : side of one module of the sheets that ``sizes`` does not name.
    sizes : (first id, last id, module_m), both ids included.
    """

    dictionary: str = "DICT_4X4_250"
    module_m: float = 0.012
    sizes: tuple[tuple[int, int, float], ...] = ()

    def __post_init__(self) -> None:
        if self.dictionary not in DICTIONARIES:
            raise InputError(
                f"unknown dictionary '{self.dictionary}'", expected=f"one of {', '.join(DICTIONARIES)}"
            )
        for module in (self.module_m, *(size[2] for size in self.sizes)):
            if not 0.0 < module < 1.0:
                raise InputError(f"a module of {module} m", expected="between 0 and 1 m")

    @property
    def tags(self) -> Any:
        """The dictionary as OpenCV knows it."""
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))

    @property
    def n_ids(self) -> int:
        """How many tags the dictionary holds; ids run from 0."""
        return len(self.tags.bytesList)

    def module_of(self, marker: int) -> float:
        """Side of a module of this marker [m]."""
        for first, last, module_m in self.sizes:
            if first <= marker <= last:
                return module_m
        return self.module_m

    def saddles_m(self, marker: int) -> ArrayF:
        """(4, 3) the saddles of a flat sheet [m] about its centre: x right, y up, z out of the print."""
        flat = (SADDLES_MODULES - SHEET_MODULES / 2) * self.module_of(marker)
        return np.column_stack([flat[:, 0], -flat[:, 1], np.zeros(4)])


def mark_name(marker: int, corner: int) -> str:
    """Name of one saddle, for instance ``17/0``."""
    return f"{marker}/{corner}"


def parse_mark(name: str) -> tuple[int, int]:
    """Marker and corner of a mark's name.

    Raises
    ------
    InputError : not of the form ``17/0``.
    """
    marker, _, corner = name.partition("/")
    if not (marker.isdigit() and corner in {"0", "1", "2", "3"}):
        raise InputError(f"'{name}' is no mark", expected="marker/corner with a corner from 0 to 3, as 17/0")
    return int(marker), int(corner)


def sheet_picture(marker: int, layout: MarkerLayout, pixels_per_module: int) -> ArrayU8:
    """Picture of a printed sheet with its margin.

    Sheet coordinates (u, v) lie at pixel ``((u + 0.5) * pixels_per_module, (v + 0.5) * pixels_per_module)``
    if (0, 0) is the upper left corner of the picture.

    Parameters
    ----------
    marker : id of the tag.
    layout : dictionary of the tags.
    pixels_per_module : an even number, because the margin is half a module wide.

    Returns
    -------
    (11 k, 11 k) of 0 (black) and 255 (white), k pixels per module.

    Raises
    ------
    GeometryError : an odd number of pixels, or an id that the dictionary does not hold.
    """
    if pixels_per_module < 2 or pixels_per_module % 2:
        raise GeometryError(f"{pixels_per_module} pixels per module", expected="an even number from 2")
    if not 0 <= marker < layout.n_ids:
        raise GeometryError(f"marker {marker}", expected=f"0 to {layout.n_ids - 1} ({layout.dictionary})")
    first, last = TAG_MODULES
    modules = np.full((SHEET_MODULES, SHEET_MODULES), 255, np.uint8)
    modules[first:last, first:last] = cv2.aruco.generateImageMarker(layout.tags, marker, last - first)
    corner = np.zeros_like(modules)
    corner[0, 1] = corner[1, 0] = 1
    for turns in range(4):
        modules[np.rot90(corner, turns) == 1] = 0
    picture = np.kron(modules, np.ones((pixels_per_module, pixels_per_module), np.uint8))
    margin = round(MARGIN_MODULES * pixels_per_module)
    return np.pad(picture, margin, constant_values=255).astype(np.uint8)


def sheet_page(marker: int, layout: MarkerLayout) -> Image.Image:
    """A4 page in true scale (`DOTS_PER_MM`) with the sheet, its id, and a control line of 100 mm.

    Raises
    ------
    GeometryError : the sheet is larger than the page or too small for a camera, or no such id.
    """
    _check_printable(marker, layout)
    module_mm = layout.module_of(marker) * 1000.0
    side = round((SHEET_MODULES + 2 * MARGIN_MODULES) * module_mm * DOTS_PER_MM)
    width, height = (mm * DOTS_PER_MM for mm in PAGE_MM)
    top = 20 * DOTS_PER_MM
    picture = Image.fromarray(sheet_picture(marker, layout, 20)).resize(
        (side, side), Image.Resampling.NEAREST
    )
    page = Image.new("L", (width, height), 255)
    left = (width - side) // 2
    page.paste(picture, (left, top))
    draw = ImageDraw.Draw(page)
    # a thin cutting line just outside the white margin
    draw.rectangle((left - 1, top - 1, left + side, top + side), outline=0, width=1)
    text_y = top + side + 4 * DOTS_PER_MM
    font = ImageFont.load_default(size=5 * DOTS_PER_MM)
    words = f"{layout.dictionary}  marker {marker}  module {module_mm:g} mm"
    draw.text((width // 2, text_y), words, fill=0, font=font, anchor="mt")
    line_y, half = text_y + 14 * DOTS_PER_MM, CONTROL_LINE_MM * DOTS_PER_MM // 2
    draw.line((width // 2 - half, line_y, width // 2 + half - 1, line_y), fill=0, width=4)
    for end in (width // 2 - half, width // 2 + half - 4):
        draw.rectangle((end, line_y - 2 * DOTS_PER_MM, end + 3, line_y + 2 * DOTS_PER_MM), fill=0)
    words = f"{CONTROL_LINE_MM} mm outside: measure this line; print at 100 %, do not fit to the page"
    small = ImageFont.load_default(size=4 * DOTS_PER_MM)
    draw.text((width // 2, line_y + 4 * DOTS_PER_MM), words, fill=0, font=small, anchor="mt")
    return page.point(lambda grey: 255 if grey > 127 else 0, mode="1")


def write_sheets(
    path: Path, ids: Iterable[int], layout: MarkerLayout, *, overwrite: bool = False
) -> list[Path]:
    """Write sheets for printing in true scale; nothing is written if one of them cannot be.

    Parameters
    ----------
    path : a file ``.pdf`` (a page each), or a folder for ``marker_017.png``.
    ids : markers; each once.
    layout : dictionary and sizes.
    overwrite : replace files that exist.

    Returns
    -------
    The written files.

    Raises
    ------
    InputError : no id or an id twice; a file exists; a name that is neither a PDF nor a folder.
    GeometryError : an id outside the dictionary, or a module that cannot be printed or seen.
    """
    wanted = list(ids)
    if not wanted or len(set(wanted)) != len(wanted):
        twice = sorted({i for i in wanted if wanted.count(i) > 1})
        found = f"markers {twice} are asked for twice" if wanted else "no marker is asked for"
        raise InputError(found, expected="each marker once: a marker that exists twice cannot be told apart")
    for marker in wanted:
        _check_printable(marker, layout)
    one_file = path.suffix.lower() == ".pdf"
    if path.suffix.lower() in _PICTURES or (not one_file and path.is_file()):
        raise InputError(
            f"'{path.name}' is the name of a {'file' if path.is_file() else 'picture'}",
            where=path,
            expected="a file .pdf, or a folder for one picture a marker",
        )
    files = [path] if one_file else [path / f"marker_{marker:03d}.png" for marker in wanted]
    there = [file for file in files if file.exists()]
    if there and not overwrite:
        raise InputError(
            f"{there[0].name} exists already" + (f", and {len(there) - 1} more" if there[1:] else ""),
            where=path,
            cure="Choose another name, or overwrite with --force",
        )
    dots_per_inch = DOTS_PER_MM * 25.4
    if one_file:
        path.parent.mkdir(parents=True, exist_ok=True)
        pages = _pages(wanted, layout)
        first = next(pages)
        first.save(path, "PDF", resolution=dots_per_inch, save_all=True, append_images=pages)
        return files
    path.mkdir(parents=True, exist_ok=True)
    for file, page in zip(files, _pages(wanted, layout), strict=True):
        page.save(file, dpi=(dots_per_inch, dots_per_inch))
    return files


def _check_printable(marker: int, layout: MarkerLayout) -> None:
    """Refuse an id that the dictionary does not hold, and a module that paper or camera cannot show."""
    if not 0 <= marker < layout.n_ids:
        raise GeometryError(f"marker {marker}", expected=f"0 to {layout.n_ids - 1} ({layout.dictionary})")
    module_mm = layout.module_of(marker) * 1000.0
    # 1e-9: millimetres come through metres
    if module_mm < LEAST_PRINT_MM - 1e-9:
        raise GeometryError(
            f"marker {marker} with modules of {module_mm:.4g} mm",
            expected=f"at least {LEAST_PRINT_MM:g} mm: a camera needs two pixels a module, which are about "
            "2 mm from 2 m away",
            cure="Choose modules of 12 mm for 3 to 7 m",
        )
    if module_mm > MOST_PRINT_MM:
        width_mm = (SHEET_MODULES + 2 * MARGIN_MODULES) * module_mm
        raise GeometryError(
            f"marker {marker} with modules of {module_mm:.4g} mm is {width_mm:.0f} mm wide",
            expected=f"modules up to {MOST_PRINT_MM:.1f} mm: at most {PAGE_MM[0] - 10} mm on A4",
            cure="Choose a smaller module",
        )


def _pages(ids: Sequence[int], layout: MarkerLayout) -> Iterator[Image.Image]:
    return (sheet_page(marker, layout) for marker in ids)
