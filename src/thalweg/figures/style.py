"""Look of all figures: style, size, colours, the mark of the digital twin, and how a figure is saved."""

import dataclasses
import re
import textwrap
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache, wraps
from inspect import signature
from io import BytesIO
from pathlib import Path
from typing import Any, Final, TypeVar

import matplotlib as mpl
import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import QuadMesh
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Colormap, ListedColormap, LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import StepPatch
from matplotlib.patheffects import withStroke
from matplotlib.text import Text
from matplotlib.ticker import LogFormatter, ScalarFormatter
from numpy.typing import ArrayLike
from PIL import Image, UnidentifiedImageError

from thalweg.core import AnyArray, ArrayF, ArrayU8, CoverageError, InputError, read_parquet


def read_picture(path: Path) -> ArrayU8:
    """A photograph as (h, w) or (h, w, 3) uint8, as its pixels lie: EXIF does not turn it.

    Raises
    ------
    InputError : the file is missing or no picture.
    """
    if not path.is_file():
        raise InputError("file not found", expected="a picture", where=path)
    try:
        with Image.open(path) as image:
            data = image if image.mode == "L" else image.convert("RGB")
            return np.asarray(data, dtype=np.uint8)
    except (UnidentifiedImageError, OSError, ValueError) as error:
        raise InputError(f"no picture ({error})", expected="JPEG or PNG", where=path) from error


WIDTH_MM: Final = 170.0
"""Width of every figure: the type area of an A4 page."""

MM_PER_INCH: Final = 25.4

BLUE: Final = "#0072B2"
VERMILION: Final = "#D55E00"
GREEN: Final = "#009E73"
PURPLE: Final = "#CC79A7"
ORANGE: Final = "#E69F00"
SKY: Final = "#56B4E9"
RED: Final = "#C1121F"
GREY: Final = "0.45"

HEIGHT_MAP: Final[Colormap] = cm.batlow
TIME_MAP: Final[Colormap] = cm.batlow
DEPTH_MAP: Final[Colormap] = cm.imola_r
INTENSITY_MAP: Final[Colormap] = cm.lipari
RING_MAP: Final[Colormap] = cm.hawaii
"""Perceptually uniform maps of F. Crameri, readable with colour blindness and in grey print."""

SIGMA_MAP: Final[Colormap] = ListedColormap(cm.lajolla_r(np.linspace(0.12, 0.92, 256)), "thalweg_sigma")
"""Light where a sigma is small, dark where it is large; without the ends that vanish on paper."""

RANGE_MAP: Final[Colormap] = ListedColormap(cm.navia(np.linspace(0.05, 0.93, 256)), "thalweg_range")
"""Dark where the scanner was near, light where it was far; without the ends that vanish on paper."""

REFLECTANCE_MAP: Final[Colormap] = ListedColormap(cm.grayC(np.linspace(0.2, 1.0, 256)), "thalweg_reflectance")
"""Dark where little light returns, but never black: black is where nothing returned."""

FIX_STYLE: Final[dict[str, tuple[str, str]]] = {
    "fixed": (BLUE, "."),
    "float": (ORANGE, "^"),
    "ppp": (GREEN, "."),
    "dgnss": (PURPLE, "v"),
    "sbas": (PURPLE, "<"),
    "omnistar": (PURPLE, ">"),
    "3d": (VERMILION, "x"),
    "2d": (VERMILION, "+"),
    "single": (VERMILION, "x"),
    "dead_reckoning": (GREY, "s"),
    "none": ("black", "1"),
}
"""Colour and marker of each fix of the position and INS tables, best first."""

FORMATS: Final = ("png", "pdf", "svg")

TWIN_MARK: Final = "digital twin"

HALO: Final = (withStroke(linewidth=2.2, foreground="white"),)
"""White rim that keeps lines and letters readable on a picture."""

TITLE_LETTERS: Final = 68
"""Letters of a line of the title that leave room for the mark of the twin."""

_MM_PER_TITLE_LINE: Final = 4.0
_MM_PER_LETTER: Final = 1.55
_MM_PER_HANDLE: Final = 9.0
_GLUE: Final = "\N{FIGURE SPACE}"
"""Stands for a space at which a title is not broken."""


@cache
def _parameters() -> Any:
    """Matplotlib's own defaults with the style on top: the user's matplotlibrc has no say."""
    style = Path(__file__).with_name("thalweg.mplstyle")
    settings = mpl.rc_params_from_file(style, use_default_template=True)
    return {key: value for key, value in settings.items() if not key.startswith("backend")}


def styled(draw: Callable[..., Figure]) -> Callable[..., Figure]:
    """Decorator: draw a figure in the style of the project, and leave out what has nothing to show.

    A panel without a value gives way to a sentence, a statistic of no value to a dash; a dollar sign in a
    name or title begins no formula. Where nothing is left, or the function fails on an input that holds no
    value, `CoverageError` is raised with the reason. Each of these functions takes ``twin`` besides its own
    keywords: true if the digital twin made the data, which the figure then says.
    """

    @wraps(draw)
    def inner(*args: Any, twin: bool = False, **kwargs: Any) -> Figure:
        """Draw under the house's style, whatever the user's own is."""
        with (
            mpl.rc_context(_parameters()),
            np.errstate(divide="ignore", invalid="ignore"),
            warnings.catch_warnings(),
        ):
            warnings.filterwarnings("ignore", _OF_NOTHING)
            figure = drawn(draw, *args, **kwargs)
            _leave_out_empty_panels(figure)
            if args or kwargs:  # formulas of our own stand in sketches without inputs alone
                _take_no_text_for_a_formula(figure)
            if twin:
                mark_twin(figure)
            return figure

    return inner


def drawn(draw: Callable[..., Figure], /, *args: Any, **kwargs: Any) -> Figure:
    """What a function draws of its inputs; where it fails on one that holds no value, that is the reason.

    Raises
    ------
    CoverageError : an input holds no value: a table, array or file with its columns.
    """
    try:
        return draw(*args, **kwargs)
    except (ArithmeticError, LookupError, ValueError, StopIteration) as error:
        inputs = signature(draw).bind(*args, **kwargs).arguments
        lacking = [words for name, value in inputs.items() for words in _lacking(name, value)]
        if not lacking:
            raise
        raise CoverageError(
            f"nothing to draw: {', '.join(lacking[:_MOST_REASONS])} ({error or type(error).__name__})",
            cure="See what the step that makes it counts as left out",
        ) from error


_OF_NOTHING: Final = (
    "Mean of empty slice|Degrees of freedom <= 0|All-NaN (slice|axis)|invalid value|divide by zero|"
    "No artists with labels found"
)
"""Warnings of statistics and legends of no value, which the figure itself says."""

_TABLES: Final[dict[str, Callable[[Path], pd.DataFrame]]] = {".parquet": read_parquet, ".csv": pd.read_csv}

_MOST_REASONS: Final = 4
"""Inputs without a value that an error names."""


def _lacking(name: str, value: Any) -> Iterator[str]:
    """What of an input of a figure holds no value, in words."""
    if isinstance(value, Path) and value.suffix in _TABLES and value.is_file():
        name, value = value.name, _TABLES[value.suffix](value)
    if isinstance(value, pd.DataFrame) and not value.empty:
        numbers = value.select_dtypes("number")
        empty = [str(column) for column in numbers if not np.isfinite(numbers[column].to_numpy(float)).any()]
        if empty:
            yield f"no number in {', '.join(empty[:_MOST_REASONS])} of all {len(value)} rows of '{name}'"
    elif isinstance(value, pd.DataFrame | np.ndarray | list | tuple | Mapping) and len(value) == 0:
        yield f"'{name}' is empty"
    elif isinstance(value, np.ndarray) and value.dtype.kind == "f" and not np.isfinite(value).any():
        yield f"no number in '{name}'"
    elif isinstance(value, list | tuple | Mapping):
        for each in value.values() if isinstance(value, Mapping) else value:
            yield from _lacking(name, each)
    elif dataclasses.is_dataclass(value):
        parts = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        for part, inner in parts.items():
            if not isinstance(inner, list | tuple | Mapping):  # notes, say, may be none
                yield from _lacking(f"{part} of {name}", inner)


def colour_bar(
    axes: Axes | Sequence[Axes] | AnyArray,
    colours: Colormap,
    norm: Normalize | tuple[float, float],
    label: str,
    **look: Any,
) -> Colorbar:
    """The scale of colours of one panel or several.

    Parameters
    ----------
    axes : panels that share it; it takes its room from them.
    colours, norm : map, and what it spans; or the values at both ends.
    label : words, with the unit.
    look : further keywords of `Figure.colorbar`.
    """
    panels = list(np.ravel(np.array(axes, dtype=object)))
    scale = ScalarMappable(norm if isinstance(norm, Normalize) else Normalize(*norm), colours)
    return panels[0].figure.colorbar(scale, ax=panels, label=label, **look)


def show_plan(ax: Axes, low: ArrayF, high: ArrayF) -> None:
    """Make a panel a map of what lies between two corners (east, north), at equal scales."""
    ax.set(
        aspect="equal", xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="east / m", ylabel="north / m"
    )


def leave_out(ax: Axes, reason: str) -> None:
    """Put a sentence in the place of a panel; its title stays.

    Parameters
    ----------
    ax : the panel.
    reason : why nothing can be drawn, as ``no point has a sigma``.
    """
    for artist in (*ax.lines, *ax.collections, *ax.patches, *ax.images, *ax.texts):
        scale = getattr(artist, "colorbar", None)
        if scale is not None:
            scale.remove()
        artist.remove()
    legend = ax.get_legend()
    if legend is not None:
        legend.remove()
    ax.set_axis_off()
    ax.set_aspect("auto")
    lines = textwrap.wrap(f"Left out: {reason}.", max(int(_LETTERS_ACROSS * ax.get_position().width), 16))
    ax.text(0.0, 0.5, "\n".join(lines), transform=ax.transAxes, va="center", fontsize=8, gid="left-out")


def _leave_out_empty_panels(figure: Figure) -> None:
    """Sentences for panels without a value, dashes for numbers that are none.

    Raises
    ------
    CoverageError : no panel has a value.
    """
    panels = [ax for ax in figure.axes if ax.get_visible() and ax.axison and ax.get_label() != "<colorbar>"]
    places = [ax.get_position().bounds for ax in panels]
    full = {place for ax, place in zip(panels, places, strict=True) if _shows_a_value(ax)}
    empty = [ax for ax, place in zip(panels, places, strict=True) if place not in full]
    if empty and not full:
        names = dict.fromkeys(filter(None, (_quantity(ax) for ax in empty)))
        raise CoverageError(f"nothing to draw: no value of {', '.join(names)}")
    for ax in empty:
        own = [text.get_text() for text in ax.texts if re.search(r"\bno\b", text.get_text())]
        leave_out(ax, own[0] if own else f"no value of {_quantity(ax)}")
        _pass_on_labels(ax, [other for other in panels if other not in empty])
    for line in (line for ax in figure.axes for line in ax.lines):
        if line.get_marker() in (None, "None", "", " ") and _finite_points(line.get_xydata()) == 1:
            line.set_marker(".")  # a line of one point is not seen
    for text in _words_of(figure):
        if dashed(text.get_text()) != text.get_text():
            text.set_text(dashed(text.get_text()))


def _words_of(figure: Figure) -> list[Text]:
    """Titles, labels, legends and notes; no labels of ticks, which are made when they are asked for."""
    words = [each for each in figure.get_children() if isinstance(each, Text)]
    for ax in figure.axes:
        words += [each for each in ax.get_children() if isinstance(each, Text)]
        words += [ax.xaxis.label, ax.yaxis.label]
    for legend in filter(None, (*figure.legends, *(ax.get_legend() for ax in figure.axes))):
        words += [*legend.get_texts(), legend.get_title()]
    return words


def _take_no_text_for_a_formula(figure: Figure) -> None:
    """Words are drawn as they are: titles and names of users may hold dollar signs."""
    words = _words_of(figure)
    for axis in (axis for ax in figure.axes for axis in (ax.xaxis, ax.yaxis)):
        if not isinstance(axis.get_major_formatter(), ScalarFormatter | LogFormatter):  # names, no numbers
            words += axis.get_majorticklabels()
    for text in words:
        text.set_parse_math(False)


def _pass_on_labels(ax: Axes, others: list[Axes]) -> None:
    """The panel above one that is left out gets the numbers and words of the axis that both share."""
    place = ax.get_position()
    above = [
        other
        for other in others
        if other.get_shared_x_axes().joined(other, ax)
        and np.isclose(other.get_position().x0, place.x0)
        and other.get_position().y0 > place.y0
    ]
    if above:
        lowest = min(above, key=lambda other: other.get_position().y0)
        lowest.tick_params(labelbottom=True)
        lowest.set_xlabel(lowest.get_xlabel() or ax.get_xlabel())


def dashed(words: str) -> str:
    """Words with a dash for each number that is none, the sign of minus, and blanks between thousands.

    Examples
    --------
    >>> dashed("mean +nan cm of banana, -3 cm on 2021-05-12")
    'mean – cm of banana, −3 cm on 2021-05-12'
    >>> dashed("1,234,567 of 2,000.5 m, at 1, 234 and 0.1,200").split()
    ['1', '234', '567', 'of', '2', '000.5', 'm,', 'at', '1,', '234', 'and', '0.1,200']
    """
    words = re.sub(r"(?<![\w.)-])-(?=\d)", "\N{MINUS SIGN}", _NO_NUMBER.sub("–", words))
    return _THOUSANDS.sub(lambda found: found[0].replace(",", "\N{NO-BREAK SPACE}"), words)


def _quantity(ax: Axes) -> str:
    """What a panel shows, by the words of its axes."""
    labels = [
        re.split(r" / | \[", " ".join(label.split()))[0] for label in (ax.get_ylabel(), ax.get_xlabel())
    ]
    return " over ".join(filter(None, labels)) or ax.get_title(loc="left")


def _shows_a_value(ax: Axes) -> bool:
    """True if a panel holds anything finite; lines and bands across all of it are none."""
    # by identity: transforms of equal matrices are equal
    across = {id(each) for each in (ax.transAxes, ax.get_xaxis_transform(), ax.get_yaxis_transform())}
    if ax.images or ax.tables or not ax.has_data():
        return bool(ax.images or ax.tables) and all(_any_finite(image.get_array()) for image in ax.images)
    return (
        any(
            id(line.get_transform()) not in across and _finite_points(line.get_xydata()) > 0
            for line in ax.lines
        )
        or any(
            id(patch.get_data_transform()) not in across
            and (
                np.any(patch.get_data()[0])
                if isinstance(patch, StepPatch)
                else _finite_points(patch.get_extents().get_points()) > 0
            )
            for patch in ax.patches
        )
        or any(map(_collection_shows_a_value, ax.collections))
    )


def _collection_shows_a_value(collection: Any) -> bool:
    values, offsets = collection.get_array(), collection.get_offsets()
    if values is not None and not _any_finite(values):
        return False
    if np.any(offsets) or not len(offsets) or isinstance(collection, QuadMesh):
        return isinstance(collection, QuadMesh) or _finite_points(np.ma.filled(offsets, np.nan)) > 0
    return any(_finite_points(path.vertices) for path in collection.get_paths())


def _finite_points(xy: ArrayLike) -> int:
    return int(np.isfinite(np.asarray(xy, np.float64)).all(axis=1).sum())


def _any_finite(values: ArrayLike | None) -> bool:
    return bool(np.isfinite(np.ma.filled(np.ma.asarray(values, np.float64), np.nan)).any())


Rows = TypeVar("Rows", ArrayF, pd.DataFrame)
_THOUSANDS: Final = re.compile(r"(?<![\w.,])\d{1,3}(?:,\d{3})+(?![\d,])")
_NO_NUMBER: Final = re.compile(r"[+−-]?\b(?:nan|inf)\b")
_LETTERS_ACROSS: Final = 100
"""Letters of a sentence in the place of a panel that is as wide as the page."""


def new_figure(height_mm: float, title: str) -> Figure:
    """An empty figure of the project's width with its title.

    Parameters
    ----------
    height_mm : height of the page part; each further line of the title adds to it.
    title : bold first lines; states n. Broken where it would run into the mark of the twin.
    """
    # "n = 5 points" stays together.
    together = re.sub(r"n = [\d\u00a0]+(?: \w+)?|\d s\b", lambda found: found[0].replace(" ", _GLUE), title)
    lines = textwrap.wrap(together.replace(" = ", f"{_GLUE}={_GLUE}"), TITLE_LETTERS)
    height_mm += _MM_PER_TITLE_LINE * (len(lines) - 1)
    figure = Figure(figsize=(WIDTH_MM / MM_PER_INCH, height_mm / MM_PER_INCH), layout="constrained")
    figure.suptitle("\n".join(lines).replace(_GLUE, " "), x=0.012, ha="left")
    return figure


def titled(function: Callable[..., Any], arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments whose ``title`` begins with that which the function has by default.

    Examples
    --------
    >>> def tree(title="Tree"): ...
    >>> titled(tree, {"title": "an oak"})
    {'title': 'Tree: an oak'}
    """
    own = signature(function).parameters.get("title")
    if own is None or own.default is own.empty or "title" not in arguments:
        return dict(arguments)
    return {**arguments, "title": f"{own.default}: {arguments['title']}"}


def mark_twin(figure: Figure) -> None:
    """Say in the corner that the digital twin made the data."""
    with mpl.rc_context(_parameters()):
        figure.text(
            0.988,
            1.0 - 1.8 / (MM_PER_INCH * figure.get_figheight()),
            TWIN_MARK,
            ha="right",
            va="top",
            fontsize=8,
            fontweight="bold",
            color="white",
            gid="twin-mark",
            bbox={"boxstyle": "round,pad=0.25", "facecolor": PURPLE, "edgecolor": "none"},
        )


def save(
    figure: Figure, path: Path | BytesIO, *, dpi: int = 200, note: str | None = None, title: bool = True
) -> None:
    """Write a figure as PNG, PDF or SVG; the same figure gives the same bytes.

    Parameters
    ----------
    figure : made by a function of this room.
    path : target, its suffix says the format; or a buffer, which gets a PNG.
    dpi : dots per inch of PNG and of pictures inside PDF and SVG.
    note : a comment inside a PNG, which `note_of` reads.
    title : false to take the title off, as for a paper whose caption tells it; panels fill its room.

    Raises
    ------
    InputError : a suffix other than png, pdf or svg.
    """
    kind = path.suffix.lower().lstrip(".") if isinstance(path, Path) else "png"
    if kind not in FORMATS:
        raise InputError(
            f"figure format '{kind}'",
            expected=f"one of {', '.join(FORMATS)}",
            where=str(path),
            cure="Name a file that ends so",
        )
    # A date or a version in the file would make two runs differ.
    undated = {"png": "Software", "pdf": "CreationDate", "svg": "Date"}
    metadata: dict[str, str | None] = {undated[kind]: None}
    if note is not None and kind == "png":
        metadata["Comment"] = note
    if isinstance(path, Path):
        path.parent.mkdir(parents=True, exist_ok=True)
    if not title:
        figure.suptitle("")
    with mpl.rc_context(_parameters()):
        figure.savefig(path, dpi=dpi, format=kind, metadata=metadata)


@styled
def empty_figure(title: str, reason: str) -> Figure:
    """A picture that has nothing to show and says why.

    Parameters
    ----------
    title : what it would have shown.
    reason : in words.
    """
    figure = new_figure(45.0, title)
    lines = textwrap.wrap(f"Nothing to show: {reason}", TITLE_LETTERS)
    figure.text(0.012, 0.55, "\n".join(lines), va="center", fontsize=9)
    return figure


def note_of(path: Path) -> str | None:
    """The comment inside a PNG; None if it holds none."""
    with Image.open(path) as picture:
        return picture.info.get("Comment")


NOTHING: Final = 1e-12
"""A number of a page below it is the rest of a computation."""


def number(value: float, digits: int = 3, decimals: int | None = None) -> str:
    """A number with so many significant digits; whole above a thousand, with thousands apart; nan: a dash.

    Where ``decimals`` are given they count instead of ``digits``.

    Examples
    --------
    >>> number(0.012345), number(-84.5361, 4), number(1234567.8).split(), number(-5.68e-14), number(np.nan)
    ('0.0123', '−84.54', ['1', '234', '568'], '0', '–')
    >>> number(10.4, 1), number(999.7).split()
    ('10', ['1', '000'])
    """
    if not np.isfinite(value):
        return "–"
    if abs(value) < NOTHING:
        return "0"
    form = (
        ",.0f"
        if abs(value) >= min(1000, 10**digits - 0.5)
        else f".{digits}g"
        if decimals is None
        else f".{decimals}f"
    )
    text = f"{value:{form}}"
    return text.replace(",", "\N{NO-BREAK SPACE}").replace("-", "\N{MINUS SIGN}")


def count(n: float) -> str:
    """A whole number with thousands apart: ``12 345``; nan: a dash.

    Examples
    --------
    >>> count(1234567).split()
    ['1', '234', '567']
    """
    return "–" if np.isnan(n) else f"{n:,.0f}".replace(",", "\N{NO-BREAK SPACE}")


def duration(seconds: float) -> str:
    """A length of time in the unit that reads best.

    Examples
    --------
    >>> duration(2.13), duration(754.0), duration(17862.2)
    ('2.1 s', '12.6 min', '5.0 h')
    """
    for longest, unit, words in ((120.0, 1.0, "s"), (7200.0, 60.0, "min")):
        if seconds < longest:
            return f"{seconds / unit:.1f} {words}"
    return f"{seconds / 3600.0:.1f} h"


def robust_limits(values: ArrayLike, low: float = 1.0, high: float = 99.0) -> tuple[float, float]:
    """Limits of a colour scale: percentiles of the finite values, never equal; (0, 1) without any value."""
    v = np.asarray(values, dtype=np.float64)
    v = v[np.isfinite(v)]
    if not v.size:
        return 0.0, 1.0
    a, b = (float(x) for x in np.percentile(v, [low, high]))
    if b - a > 1e-9 * max(abs(a), abs(b), 1e-6):
        return a, b
    half = 0.5 * abs(a) or 0.5
    return a - half, b + half


def fix_styles(fixes: Iterable[str]) -> list[tuple[str, str, str]]:
    """Fix, colour and marker of the fixes that occur, best first, unknown ones last.

    Examples
    --------
    >>> [fix for fix, _, _ in fix_styles(["single", "odd", "fixed", "fixed"])]
    ['fixed', 'single', 'odd']
    """
    met = set(fixes)
    known = [fix for fix in FIX_STYLE if fix in met]
    return [(fix, *FIX_STYLE.get(fix, (GREY, "."))) for fix in [*known, *sorted(met - set(FIX_STYLE))]]


def sentence(words: str) -> str:
    """A note as a sentence: a capital letter first and a full stop last."""
    return f"{words[0].upper()}{words[1:].rstrip('.')}." if words else ""


def plural(n: int, thing: str) -> str:
    """``1 gap``, ``2 gaps``, ``no gap``.

    Examples
    --------
    >>> [plural(n, "gap") for n in (0, 1, 2)]
    ['no gap', '1 gap', '2 gaps']
    """
    return f"{count(n) if n else 'no'} {thing}{'s' if n > 1 else ''}"


def legend_below(figure: Figure, *axes: Axes, title: str | None = None) -> None:
    """Put one legend of some axes below the figure, in as many columns as the width holds."""
    found = {k: h for ax in axes for h, k in zip(*ax.get_legend_handles_labels(), strict=True)}
    handles, labels = list(found.values()), list(found)
    if not handles:
        return
    widths = [_MM_PER_HANDLE + _MM_PER_LETTER * len(label) for label in labels]
    columns = 1
    for n in range(2, len(labels) + 1):
        if sum(float(part.max()) for part in np.array_split(np.array(widths), n)) <= WIDTH_MM - 4.0:
            columns = n
    figure.legend(handles, labels, loc="outside lower left", ncols=columns, title=title, alignment="left")


def round_length(wanted: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above ``wanted``.

    Examples
    --------
    >>> [round_length(x) for x in (0.7, 34.0, 1999.0)]
    [0.5, 20.0, 1000.0]
    """
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(power * max(f for f in (1, 2, 5) if f * power <= wanted * (1 + 1e-12)))


def length_text(length_m: float) -> str:
    """``5 m``, ``0.2 m`` or ``2 km``."""
    return f"{length_m / 1000:g} km" if length_m >= 1000 else f"{length_m:g} m"


def scale_bar(
    ax: Axes, *, span_m: float, colour: str = "black", xy: tuple[float, float] = (0.02, 0.045)
) -> float:
    """Draw a scale bar, in the lower left corner by default; returns its length in metres.

    Parameters
    ----------
    ax : axes with equal scales whose limits are set.
    span_m : width of the axes in metres.
    colour : of bar and text.
    xy : its left end as shares of the axes.
    """
    length_m = round_length(0.22 * span_m)
    width = length_m / span_m
    x, y = xy
    ax.plot(
        (x, x + width),
        (y, y),
        color=colour,
        lw=1.6,
        marker="|",
        ms=6,
        mew=1.2,
        transform=ax.transAxes,
        clip_on=False,
        zorder=9,
        gid="scale-bar",
        path_effects=HALO,
    )
    ax.annotate(
        length_text(length_m),
        (x + width / 2, y),
        xycoords="axes fraction",
        xytext=(0, 3),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=7,
        color=colour,
        zorder=9,
        gid="scale-text",
        path_effects=HALO,
    )
    return length_m


def north_arrow(
    ax: Axes, *, xy: tuple[float, float] = (0.965, 0.95), towards: Sequence[float] = (0.0, 26.0)
) -> None:
    """Draw a north arrow with its tip at ``xy``, which points ``towards`` north: right and up, in points."""
    ax.annotate(
        "N",
        xy=xy,
        xytext=(-towards[0], -towards[1]),
        xycoords="axes fraction",
        textcoords="offset points",
        ha="center",
        va="center",
        fontsize=8,
        fontweight="bold",
        zorder=9,
        gid="north-arrow",
        path_effects=HALO,
        arrowprops={"arrowstyle": "-|>", "lw": 1.2, "color": "black", "shrinkA": 4, "shrinkB": 0},
    )


def marks_in_free_corners(ax: Axes, points_en_m: ArrayF) -> None:
    """Scale bar and north arrow of a plan in the two corners where they hide fewest points.

    Parameters
    ----------
    ax : axes with equal scales whose limits are set.
    points_en_m : (n, 2) what is drawn.
    """
    low, high = np.transpose([ax.get_xlim(), ax.get_ylim()])
    share = (np.asarray(points_en_m) - low) / (high - low)
    span_m = float(high[0] - low[0])
    bar_share = round_length(0.22 * span_m) / span_m

    def hidden(box: tuple[float, float, float, float]) -> int:
        """Points within left, bottom, width, height."""
        start, size = np.array(box[:2]), np.array(box[2:])
        return int(np.sum(np.all((share >= start) & (share <= start + size), axis=1)))

    # The usual corners come first: they win where all are free.
    bars = {
        (x, y): hidden((x - 0.02, y - 0.045, bar_share + 0.05, 0.17))
        for y in (0.045, 0.87)
        for x in (0.02, 0.97 - bar_share)
    }
    bar = min(bars, key=lambda xy: bars[xy])
    arrows = {(x, y): hidden((x - 0.05, y - 0.25, 0.1, 0.3)) for y in (0.95, 0.25) for x in (0.955, 0.045)}
    same = {xy for xy in arrows if (xy[0] > 0.5, xy[1] > 0.5) == (bar[0] > 0.5, bar[1] > 0.5)}
    scale_bar(ax, span_m=span_m, xy=bar)
    north_arrow(ax, xy=min((xy for xy in arrows if xy not in same), key=lambda xy: arrows[xy]))


def raster_maps(
    title: str,
    extent_m: tuple[float, float, float, float],
    panels: Sequence[tuple[ArrayF, str, Mapping[str, Any]]],
    *,
    crs: str,
    margin_m: float = 0.0,
) -> tuple[Figure, list[Axes]]:
    """Maps of rasters of one extent, below each other, or side by side where they are tall.

    Parameters
    ----------
    title : of the figure.
    extent_m : west, east, south, north.
    panels : values (rows, columns), words of the colour bar, and keywords of ``imshow``.
    crs : name of the map.
    margin_m : free border about the rasters.
    """
    west, east, south, north = np.asarray(extent_m) + margin_m * np.array([-1.0, 1.0, -1.0, 1.0])
    ratio, n = float((north - south) / (east - west)), len(panels)
    columns = 1 if ratio < 1 / 1.3 else 3 if n == 3 else 2
    rows = -(-n // columns)
    height_mm = rows * (145.0 * ratio / columns + 21.0) + 10.0
    figure = new_figure(float(np.clip(height_mm, 80.0, 115.0 * rows)), title)
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for ax, (values, words, look) in zip(axes.ravel(), panels, strict=False):
        drawn = ax.imshow(values, extent=extent_m, interpolation="nearest", zorder=1, **look)
        row, column = np.nonzero(np.isfinite(values))
        share = np.stack([(column + 0.5) / values.shape[1], 1 - (row + 0.5) / values.shape[0]], axis=1)
        bar = figure.colorbar(drawn, ax=ax, shrink=0.85, pad=0.01, label=words)
        if isinstance(drawn.norm, LogNorm):
            bar.ax.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
            bar.ax.yaxis.set_minor_formatter(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "25" else "")
        ax.set(aspect="equal", xlim=(west, east), ylim=(south, north))
        ax.ticklabel_format(useOffset=False, style="plain")
        ax.locator_params(nbins=5 if columns == 1 else 3)
        marks_in_free_corners(
            ax, np.array(extent_m[::2]) + share * np.subtract(extent_m[1::2], extent_m[::2])
        )
    for ax in axes.ravel()[n:]:
        ax.remove()
    for ax in axes[-1]:
        ax.set_xlabel(f"east / m{', ' if columns == 1 else chr(10)}{crs}")
    for ax in axes[:, 0]:
        ax.set_ylabel("north / m")
    return figure, list(axes.ravel()[:n])


def thinned(rows: Rows, most: int) -> Rows:
    """Every so many-th row of a table or array: ``most`` of them at most.

    Examples
    --------
    >>> thinned(np.arange(7), 3)
    array([0, 3, 6])
    """
    return rows[:: max(1, -(-len(rows) // most))]


def plan_height_mm(span_x_m: float, span_y_m: float) -> float:
    """Height of a figure whose one panel shows an area of the given size at equal scales."""
    return 0.80 * WIDTH_MM * span_y_m / max(span_x_m, 1e-9) + 28.0
