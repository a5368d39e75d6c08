"""Inputs of a figure or page without anything in them, and what must not be seen of them."""

import dataclasses
import inspect
import re
import warnings
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from itertools import combinations, product
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.figure import Figure

from tests.sentences import of_html, too_long

STATES: Final = ("empty", "one", "equal", "nan")
"""No value, one, several of the same, several that are no number."""
_FEW: Final = 4


class CaughtError(BaseException):
    """A figure function was called: no test takes it for an error that it expects."""


def catch(*args: Any, **kwargs: Any) -> None:
    """In the place of a figure function, whose module's names are around this code."""
    from tests.figures.panel_states import CaughtError

    raise CaughtError(args, kwargs)


class NoSuchStateError(Exception):
    """The type of an input holds no such state."""


def in_state(value: Any, state: str) -> Any:
    """An input whose tables and arrays are in a state; texts, numbers and photographs stay.

    Raises
    ------
    NoSuchStateError : the type refuses the state.
    """
    if isinstance(value, pd.DataFrame):
        return _table(value, state)
    if isinstance(value, np.ndarray) and value.ndim and value.dtype != np.uint8:
        return _array(value, state)
    if isinstance(value, Mapping):
        return {key: in_state(each, state) for key, each in value.items()}
    if type(value) is list or type(value) is tuple:
        return type(value)(in_state(each, state) for each in value)
    if dataclasses.is_dataclass(value):
        return _parts(value, state)
    if isinstance(value, Path) and value.suffix == ".csv":
        target = value.with_name(f"{state}_{value.name}")
        _table(pd.read_csv(value), state).to_csv(target, index=False)
        return target
    if isinstance(value, Path) and value.suffix == ".parquet":
        table = pq.read_table(value)
        target = value.with_name(f"{state}_{value.name}")
        changed = pa.Table.from_pandas(_table(table.to_pandas(), state), table.schema, preserve_index=False)
        pq.write_table(changed, target)
        return target
    return value


def _table(table: pd.DataFrame, state: str) -> pd.DataFrame:
    if state in ("empty", "one"):
        return table.iloc[: int(state == "one")]
    if state == "equal":
        return table.iloc[:1].loc[lambda t: t.index.repeat(min(_FEW, len(table)))].reset_index(drop=True)
    found = table.iloc[: 10 * _FEW].copy()
    for name in found.select_dtypes("floating").columns:
        found[name] = np.full(len(found), np.nan, found[name].dtype)
    return found


def _array(array: Any, state: str) -> Any:
    if (array.ndim == 1 and len(array) <= 3) or array.shape in ((3, 3), (4, 4)):
        return array  # a place or a rotation, no list of values
    if state in ("empty", "one"):
        return array[: int(state == "one")]
    if state == "equal":
        return np.repeat(array[:1], min(_FEW, len(array)), axis=0)
    few = array[: 10 * _FEW]
    return np.full_like(few, np.nan) if few.dtype.kind == "f" else few


def _parts(value: Any, state: str) -> Any:
    changed = {
        field.name: in_state(getattr(value, field.name), state)
        for field in dataclasses.fields(value)
        if field.init
    }
    if state == "nan" and "valid" in changed:
        changed["valid"] = np.zeros_like(changed["valid"])
    try:
        return dataclasses.replace(value, **changed)
    except Exception as error:
        raise NoSuchStateError(str(error)) from error


def function_of(name: str) -> Callable[..., Any]:
    """The function of ``module:function``."""
    module, function = name.split(":")
    package = "" if module.startswith("thalweg_lab") else "thalweg."
    return getattr(import_module(package + module), function)


def cases(name: str, example: Mapping[str, Any]) -> Iterator[tuple[str, Callable[[], dict[str, Any]]]]:
    """What is tried: all inputs as they are or in a state, each table alone, each absent that may be."""
    yield "all there", lambda: dict(example)
    for state in STATES:
        yield f"all {state}", lambda s=state: {key: in_state(each, s) for key, each in example.items()}
    tables = [key for key, each in example.items() if isinstance(each, pd.DataFrame)]
    for key in tables if len(example) > 1 else []:
        for state in ("empty", "nan"):
            yield f"{key} {state}", lambda k=key, s=state: {**example, k: in_state(example[k], s)}
    for key, parameter in inspect.signature(function_of(name)).parameters.items():
        may_be_none = parameter.default is None or type(None) in get_args(parameter.annotation)
        if may_be_none and example.get(key) is not None:
            yield f"{key} absent", lambda k=key: {**example, k: None}
        if isinstance(example.get(key), list | dict):
            yield f"{key} none", lambda k=key: {**example, k: type(example[k])()}


# ---------------------------------------------------------------- what must not be seen


def faults(figure: Figure, laid_out: set[Any] | None = None) -> list[str]:
    """Axes and scales of colours without data, words of no number and, of a layout, words over words.

    ``laid_out`` holds outlines of figures that were laid out: one with the same words of the same places and
    sizes is not laid out again. Without it none is.
    """
    found = []
    if laid_out is not None and (outline := _outline(figure)) not in laid_out:
        laid_out.add(outline)
        found = _words_over_words(figure)
    scales = {ax for ax in figure.axes if hasattr(ax, "_colorbar")}
    for ax in figure.axes:
        name = ax.get_title(loc="left") or ax.get_title() or ax.get_ylabel() or ax.get_xlabel()
        if ax in scales:
            found += _faults_of_scale(ax)
        elif ax.get_visible() and ax.axison and not has_data(ax) and not any(has_data(t) for t in _twins(ax)):
            found.append(f"axes without data: {name!r}")
        limits = np.array([ax.get_xlim(), ax.get_ylim()])
        if not np.isfinite(limits).all():
            found.append(f"limits of axes: {name!r}")
    words = {text.get_text(): text for text in figure.findobj(lambda a: hasattr(a, "get_text"))}
    found += [f"words: {words_!r}" for words_ in words if re.search(r"\b(nan|inf|NaN|None|NaT)\b", words_)]
    return found


def _outline(figure: Figure) -> Any:
    """What a layout is made from: sizes, panels and words, whose digits count as one."""
    panels = tuple((ax.get_visible(), ax.axison, ax.get_position().bounds) for ax in figure.axes)
    words = tuple(re.sub(r"\d", "0", text.get_text()) for text in _headings(figure))
    legends = [*figure.legends, *filter(None, (ax.get_legend() for ax in figure.axes))]
    lengths = tuple(
        max((len(text.get_text()) for text in legend.get_texts()), default=0) for legend in legends
    )
    return tuple(figure.get_size_inches()), panels, words, lengths


def _words_over_words(figure: Figure) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        figure.draw_without_rendering()
    found = [f"warning: {each.message}" for each in caught]
    renderer = figure._get_renderer()
    boxes = [(text, text.get_window_extent(renderer)) for text in _headings(figure)]
    marks = [(text, text.get_window_extent(renderer)) for text in _ticks_and_legends(figure)]
    for (a, of_a), (b, of_b) in [*combinations(boxes, 2), *product(boxes, marks)]:
        wide = min(of_a.x1, of_b.x1) - max(of_a.x0, of_b.x0)
        tall = min(of_a.y1, of_b.y1) - max(of_a.y0, of_b.y0)
        if wide > 1.5 and tall > 1.5:
            found.append(f"words over words: {a.get_text()!r}, {getattr(b, 'get_text', b.__repr__)()!r}")
    return found


def _ticks_and_legends(figure: Figure) -> list[Any]:
    """Labels of ticks that are seen, and legends outside the panels."""
    found: list[Any] = list(figure.legends)
    for ax in (ax for ax in figure.axes if ax.get_visible() and ax.axison):
        for axis, limits in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
            low, high = sorted(limits)
            ticks = [each for each in axis.get_major_ticks() if low <= each.get_loc() <= high]
            found += [label for each in ticks for label in (each.label1, each.label2)]
    return [each for each in found if each.get_visible() and getattr(each, "get_text", lambda: "legend")()]


def has_data(ax: Any) -> bool:
    """True if an axes shows a finite value or a sentence; lines across all of it do not count."""
    own = ax.transData
    for line in ax.lines:
        xy = np.asarray(line.get_xydata(), dtype=float)
        seen = 2 if line.get_marker() in (None, "None", "", " ") else 1  # no one sees a line of one point
        if line.get_transform() is own and np.isfinite(xy).all(axis=1).sum() >= seen:
            return True
    for collection in ax.collections:
        values = collection.get_array()
        finite = values is None or np.isfinite(np.ma.filled(np.ma.asarray(values, float), np.nan)).any()
        if finite and _places(collection):
            return True
    for image in ax.images:
        if np.isfinite(np.ma.filled(np.ma.asarray(image.get_array(), float), np.nan)).any():
            return True
    for patch in ax.patches:
        corners = patch.get_path().vertices
        across = patch.get_data_transform() is not own
        if not across and len(corners) and np.isfinite(corners).any():
            return True
    return bool(ax.tables)


def _places(collection: Any) -> bool:
    offsets = np.ma.filled(np.ma.asarray(collection.get_offsets(), float), np.nan)
    if hasattr(collection, "_coordinates"):  # a mesh of cells
        return True
    paths = [path.vertices for path in collection.get_paths()]
    if not len(offsets) or np.any(offsets):
        return bool(np.isfinite(offsets).all(axis=1).any())
    return any(len(path) and np.isfinite(path).all(axis=1).any() for path in paths)


def _twins(ax: Any) -> list[Any]:
    return [each for each in ax.figure.axes if each is not ax and each.bbox.bounds == ax.bbox.bounds]


def _faults_of_scale(ax: Any) -> Iterator[str]:
    scale = ax._colorbar
    low, high = scale.mappable.get_clim()
    if low is None or not np.isfinite([low, high]).all() or not low < high:
        yield f"scale of colours from {low} to {high}: {ax.get_ylabel() or ax.get_xlabel()!r}"
    values = scale.mappable.get_array()
    if values is not None and not np.isfinite(np.ma.filled(np.ma.asarray(values, float), np.nan)).any():
        yield f"scale of colours without a value: {ax.get_ylabel() or ax.get_xlabel()!r}"


def _headings(figure: Figure) -> list[Any]:
    found = list(figure.texts)  # with the title
    for ax in figure.axes:
        if not ax.get_visible():
            continue
        found += [ax._left_title, ax.title, ax._right_title]
        found += [ax.xaxis.label, ax.yaxis.label] if ax.axison else []
        found += [text for text in ax.texts if text.get_gid() == "left-out"]
    return [text for text in found if text is not None and text.get_visible() and text.get_text().strip()]


def warned(call: Callable[[], Any]) -> tuple[Any, list[str]]:
    """What a function returns, and the warnings it gave on the way."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = call()
    return found, [f"warning: {each.message}" for each in caught]


def faults_of_page(html: str) -> list[str]:
    """Words of no number, tables without a row, and sentences that are long."""
    words = re.sub(r"<style>.*?</style>|<[^>]*>", " ", html, flags=re.DOTALL)
    found = [f"words: {each!r}" for each in re.findall(r".{0,40}\b(?:nan|NaN|NaT|inf|None)\b.{0,20}", words)]
    return (
        found
        + ["a table without a row"] * bool(re.search(r"<tbody>\s*</tbody>", html))
        + too_long(of_html(html))
    )
