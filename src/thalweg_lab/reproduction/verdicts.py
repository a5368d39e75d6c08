"""The whole ledger: every published number with its verdict, and the headlines of the thesis and its papers.

`thalweg_lab.reproduction.ledger` judges; here the entries of all files of ``resources/published`` come
together, one a row.

Numbers of T, P1 and P2 that need no campaign stand here: identities, arithmetic of printed numbers,
misprints. Functions as in `thalweg_lab.reproduction.ledger`: each takes the published numbers by the names of
their entries, so that nothing printed is typed in here, and the arguments of its entry (``with:``).
"""

import importlib
import math
import textwrap
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import yaml

from thalweg.accuracy import range_class
from thalweg.budgets import long_table, read_budget
from thalweg.calibration import PARAMETERS, Cone
from thalweg.core import ArrayF, Camera, ConfigError, Rigid, rotation_opk
from thalweg.ingest.velodyne import VLP16
from thalweg_lab.reproduction.files import Entry
from thalweg_lab.reproduction.ledger import (
    BUDGETS,
    FUNCTIONS,
    VERDICTS,
    Found,
    Results,
    by_class,
    judged,
    missing_words,
    ours_words,
    sentence,
    verdict_words,
)
from thalweg_lab.reproduction.paper_models import SMALL_RIVER_WIDTH_M, refract_as_printed

# ---------------------------------------------------------------- numbers that need no campaign

Published = Mapping[str, Any]

DISTANCES_M: Final = (5.0, 10.0, 25.0, 50.0)
"""Distances of P2 Table 1 and T Table 3.1."""
_SEED: Final = 1
_N: Final = 500
_TURN: Final = rotation_opk(0.4, -0.7, 2.1)


def _points(scale_m: float = 10.0) -> ArrayF:
    return np.random.default_rng(_SEED).uniform(-scale_m, scale_m, (_N, 3))


def _cells(published: Published, rows: list[str], distance_m: float) -> ArrayF:
    """Printed cells (n,) of rows ``[first, last]`` of a table at a distance, mm."""
    first, last = (int(row[1:]) for row in rows)
    return np.array([float(published[f"C{i:03d} {distance_m:g} m"]) for i in range(first, last + 1)])


# ---------------------------------------------------------------- equations


def transform_identity(published: Published) -> Found:
    """Largest difference of `Rigid.apply` from ``T + R x`` and of its inverse from ``R (x - X0)``, m.

    P1 eq. 1, 4, 7, 8.
    """
    T, shift, x = Rigid(R=_TURN, shift_m=np.array([0.3, -1.2, 0.8])), np.array([0.3, -1.2, 0.8]), _points()
    off = [T.apply(x) - (x @ _TURN.T + shift), T.inverse().apply(x) - (x - shift) @ _TURN]
    return Found(value=float(np.abs(off).max()), n=float(_N))


def chain_identity(published: Published) -> Found:
    """Largest difference of two transforms in a row from the product of their matrices, m (P2 eq. 3)."""
    first = Rigid(R=_TURN, shift_m=np.array([0.3, -1.2, 0.8]))
    second = Rigid(R=rotation_opk(-1.1, 0.2, 0.5), shift_m=np.array([5.0, 2.0, -1.0]))
    M = [np.block([[T.R, T.shift_m[:, None]], [np.zeros((1, 3)), np.ones((1, 1))]]) for T in (second, first)]
    x = _points()
    by_matrix = np.c_[x, np.ones(_N)] @ (M[0] @ M[1]).T
    return Found(value=float(np.abs((second @ first).apply(x) - by_matrix[:, :3]).max()), n=float(_N))


def _fisheye() -> Camera:
    parameters = np.array([800.0, 800.0, 1000.0, 990.0, 0.0, 0.0, 0.0, 0.0])
    return Camera(model="fisheye", size_px=(2000, 2000), parameters=parameters)


def fisheye_identity(published: Published) -> Found:
    """Largest difference of the fisheye camera from P1 eq. 2-3, px.

    Points up to 95 degrees off the axis, and one on it, where the equations have the limit ``x'_0``.
    """
    rng = np.random.default_rng(_SEED)
    alpha, around = rng.uniform(0.0, np.deg2rad(95.0), _N), rng.uniform(0.0, 2 * np.pi, _N)
    alpha[0] = 0.0
    X = np.stack([np.sin(alpha) * np.cos(around), np.sin(alpha) * np.sin(around), np.cos(alpha)], axis=1)
    across = np.hypot(X[:, 0], X[:, 1])
    unit = np.where(across[:, None] > 0, X[:, :2] / np.where(across > 0, across, 1.0)[:, None], 0.0)
    printed = np.array([1000.0, 990.0]) + 800.0 * alpha[:, None] * unit
    return Found(value=float(np.abs(_fisheye().project(7.0 * X) - printed).max()), n=float(_N))


def fisheye_round_trip(published: Published) -> Found:
    """Largest difference of a pixel from the image of its own ray, px."""
    px = np.random.default_rng(_SEED).uniform(100.0, 1900.0, (_N, 2))
    camera = _fisheye()
    return Found(value=float(np.abs(camera.project(camera.rays(px)) - px).max()), n=float(_N))


def _cone() -> Cone:
    return Cone(
        apex_m=np.array([2.0, 1.0, 0.3]), axis=np.array([0.2, -0.5, -0.9]), half_angle_rad=np.deg2rad(14.0)
    )


def _on_cone(cone: Cone) -> ArrayF:
    rng = np.random.default_rng(_SEED)
    z, around = rng.uniform(0.1, 1.0, _N), rng.uniform(0.0, 2 * np.pi, _N)
    circle = np.cos(around)[:, None] * cone.tangents[0] + np.sin(around)[:, None] * cone.tangents[1]
    return cone.apex_m + z[:, None] * cone.axis + (z * np.tan(cone.half_angle_rad))[:, None] * circle


def cone_condition(published: Published) -> Found:
    """Largest ``|x^2 + y^2 - z^2 tan^2(beta)|``, m^2, of points at which `Cone.see` finds no distance.

    In the cone's own frame (P1 eq. 5, P2 eq. 1-2): without its right side ``= 0`` P1 eq. 5 says nothing.
    """
    cone = _cone()
    p = _on_cone(cone)
    p -= cone.see(p).distance_m[:, None] * cone.see(p).normal
    R = np.stack([*cone.tangents, cone.axis])
    x, y, z = R @ (p - cone.apex_m).T
    left = x**2 + y**2 - z**2 * np.tan(cone.half_angle_rad) ** 2
    return Found(value=float(np.abs(left).max()), n=float(_N))


def cone_apex_as_printed(published: Published) -> Found:
    """Distance of a cone's apex from the origin of its own frame by P1 eq. 6 as printed, ``X_ap + R X``, m.

    ``R (X - X_ap)``, P2 eq. 1, puts it there exactly.
    """
    cone = _cone()
    R = np.stack([*cone.tangents, cone.axis])
    return Found(value=float(np.linalg.norm(cone.apex_m + R @ cone.apex_m)))


def printed_refraction_off(published: Published, *, angle_deg: float) -> Found:
    """How far the length of the refracted unit vector by the printed root is from 1 (P3 and P4 eq. 1)."""
    t = np.deg2rad(angle_deg)
    v = refract_as_printed(np.array([[np.sin(t), 0.0, -np.cos(t)]]), np.array([0.0, 0.0, 1.0]), 1.0, 1.52)
    return Found(value=abs(float(np.linalg.norm(v)) - 1.0))


def river_width(published: Published) -> Found:
    """Of the river of the study of echo sounder and light sheet, m."""
    return Found(value=SMALL_RIVER_WIDTH_M)


def classes_off(published: Published) -> Found:
    """Ranges whose class is not the D of ``D - 0.5 < d <= D + 0.5`` (P2 eq. 10), borders among them."""
    d = np.concatenate([np.arange(1.0, 100.0) + 0.5, np.random.default_rng(_SEED).uniform(0.6, 99.0, _N)])
    D = range_class(d)
    return Found(value=float((~((d > D - 0.5) & (d <= D + 0.5))).sum()), n=float(len(d)))


def cone_unknowns(published: Published, *, cones: int, of_each: int = 0) -> Found:
    """Unknowns of a calibration by cones: those of each cone and six of the relative orientation."""
    return Found(value=float(cones * (of_each or len(PARAMETERS)) + 6))


def cone_parameters(published: Published) -> Found:
    """Unknowns of a cone in this project."""
    return Found(value=float(len(PARAMETERS)))


# ---------------------------------------------------------------- arithmetic of printed numbers


def normal_share(published: Published, *, sigmas: float) -> Found:
    """Percent of a normal variable within so many sigmas."""
    return Found(value=100.0 * math.erf(sigmas / math.sqrt(2.0)))


def root_of_squares(published: Published, *, rows: list[str], distance_m: float) -> Found:
    """Root of the sum of the squares of a table's printed cells at a distance, mm (P2 eq. 8-9)."""
    return Found(value=float(np.linalg.norm(_cells(published, rows, distance_m))))


def root_of_named(published: Published, *, of: list[str]) -> Found:
    """Root of the sum of the squares of printed numbers."""
    return Found(value=float(np.linalg.norm([float(published[name]) for name in of])))


def largest_of(published: Published, *, of: list[str]) -> Found:
    """The largest of printed numbers."""
    return Found(value=max(float(published[name]) for name in of))


def distances_led_by(published: Published, *, rows: list[str], row: str) -> Found:
    """Distances of a table at which the printed cell of one row is the largest."""
    at = int(row[1:]) - int(rows[0][1:])
    led = [int(_cells(published, rows, d).argmax()) == at for d in DISTANCES_M]
    return Found(value=float(sum(led)), n=float(len(led)))


def distances_below(published: Published, *, of: str, than: str) -> Found:
    """Distances at which one printed total is below another."""
    below = [float(published[f"{of} {d:g} m"]) < float(published[f"{than} {d:g} m"]) for d in DISTANCES_M]
    return Found(value=float(sum(below)), n=float(len(below)))


def lidar_constant(published: Published, *, what: str) -> Found:
    """A constant that the reader decodes with: ``lasers``, or the ``vertical view`` of all, degrees."""
    view_deg = float(np.ptp(VLP16.elevation_deg))
    return Found(value={"lasers": float(VLP16.lasers), "vertical view": view_deg}[what])


def budget_lever(published: Published, *, name: str) -> Found:
    """Length of the inner lever arm of a stored budget, cm."""
    return Found(
        value=100.0 * float(np.linalg.norm(read_budget(BUDGETS / f"{name}.yaml").frames[-1].lever_m))
    )


def budget_ratio(published: Published, *, name: str, of: str, over: str, distance_m: float) -> Found:
    """Influence of an input of a stored budget over that of another at a distance."""
    table = long_table(read_budget(BUDGETS / f"{name}.yaml"))
    at = table[np.isclose(table["distance_m"], distance_m)]
    influence_mm = dict(zip(at["input"], at["influence_mm"].astype(float), strict=True))
    return Found(value=influence_mm[of] / influence_mm[over])


def shots_per_second(published: Published) -> Found:
    """Shots of a VLP-16 a second: 16 lasers each firing sequence."""
    return Found(value=float(VLP16.lasers / VLP16.firing_s))


ARITHMETIC: Final[dict[str, Callable[..., Found]]] = {
    function.__name__: function
    for function in (
        transform_identity,
        chain_identity,
        fisheye_identity,
        fisheye_round_trip,
        cone_condition,
        cone_apex_as_printed,
        printed_refraction_off,
        classes_off,
        river_width,
        cone_unknowns,
        cone_parameters,
        normal_share,
        root_of_squares,
        root_of_named,
        largest_of,
        distances_led_by,
        distances_below,
        shots_per_second,
        lidar_constant,
        budget_lever,
        budget_ratio,
    )
}
"""What the ledger may name in ``computed`` beside the functions of `thalweg_lab.reproduction.ledger`."""


# ---------------------------------------------------------------- the whole ledger

ITEMS: Final = (
    *(f"C{i:03d}" for i in range(1, 329)),
    *(f"E{i:02d}" for i in range(1, 31)),
    *(f"FW{i:02d}" for i in range(1, 40)),
)
"""Published items, misprints and ideas for future work."""
COMPUTED: Final = {**FUNCTIONS, **ARITHMETIC}
"""What entries of all files may name as ``computed``."""


def whole_ledger(entries: Iterable[Entry], results: Results, pages: Mapping[str, int]) -> pd.DataFrame:
    """A row for each entry as of `judged`, ``where`` with its page; misses first, then by the first item.

    Parameters
    ----------
    entries : of all files, see `thalweg_lab.reproduction.files.read_ledgers`.
    results : of all campaigns, with records and parts of the project.
    pages : section, figure or table of a source -> its page in the thesis, see `read_pages`.

    Raises
    ------
    InputError : a result cannot be read, or an entry names a function that does not exist.
    ConfigError : an entry stands at a place without a page.
    """
    table = judged(tuple(entries), results, COMPUTED)
    table["where"] = [f"{where} (p. {page_of(where, pages)})" for where in table["where"]]
    order = table["rows"].str.split().str[0].map(ITEMS.index), table["verdict"].map(VERDICTS.index)
    return table.iloc[np.lexsort(order)].reset_index(drop=True)


def headlines(ledger: pd.DataFrame, named: pd.DataFrame) -> pd.DataFrame:
    """Main results of the thesis and its papers: what is printed, ours, the verdict, and why in plain words.

    Parameters
    ----------
    ledger : see `whole_ledger`.
    named : columns ``entry, result, why``: name of an entry, what it is, and what its verdict is worth.

    Raises
    ------
    ConfigError : a name is no entry.
    """
    rows = {row["name"]: row for row in ledger.to_dict("records")}
    if unknown := [name for name in named["entry"] if name not in rows]:
        raise ConfigError(
            f"no entry {', '.join(unknown)}", where="headlines.csv", expected="names such as C051 RMSE"
        )
    chosen = [rows[name] for name in named["entry"]]
    return pd.DataFrame(
        {
            "result": named["result"],
            "place": [row["where"] for row in chosen],
            # cells of tables are printed without their unit
            "printed": [row["printed"] + f" {row['unit']}" * row["printed"][-1].isdigit() for row in chosen],
            "ours": [ours_words(row | {"n": math.nan}) or "none" for row in chosen],
            "verdict": [verdict_words(row) for row in chosen],
            "why": named["why"],
        }
    )


def told(ledger: pd.DataFrame, chosen: pd.DataFrame) -> str:
    """For the terminal: what was not run, the counts, and the headlines without their reasons."""
    lines = missing_words(ledger)
    text = "Not run here:\n" * bool(lines) + "".join(f"  {line}\n" for line in lines) + "\n"
    text += textwrap.fill(f"Of the published numbers {sentence(ledger)}.", 100) + "\n\n"
    text += by_class(ledger).to_string(index=False) + "\n\n"
    for row in chosen.to_dict("records"):
        words = f"{row['result']}: printed {row['printed']}; ours {row['ours']}; {row['verdict']}."
        text += textwrap.fill(words, 100, subsequent_indent="    ") + "\n"
    return text


def page_of(where: str, pages: Mapping[str, int]) -> int:
    """Page of the thesis on which the first place of ``where`` stands (its papers have the thesis's pages).

    ``P2 6.1.2, eq. 6`` is looked up as such, then shorter by a word or a number, to the paper itself.

    Raises
    ------
    ConfigError : not even the paper has a page.
    """
    words = where.split(",")[0].split(" and ")[0]
    while words:
        if words in pages:
            return pages[words]
        cut = max(words.rfind(" "), words.rfind("."))
        words = words[:cut].rstrip() if cut > 0 else ""
    raise ConfigError(
        f"no page of {where!r}", where="pages.yaml", expected="a section, figure or table of it"
    )


def read_pages(path: Path) -> dict[str, int]:
    """Pages by places such as ``P4 6.3`` and ``T Fig. 3.5``."""
    tree = yaml.safe_load(path.read_text(encoding="utf-8"))
    return {
        (paper if place == "title" else f"{paper} {place}"): int(page)
        for paper, places in tree["pages"].items()
        for place, page in places.items()
    }


def missing_items(entries: Iterable[Entry]) -> list[str]:
    """Items without an entry, and rows that are no item."""
    found = {row for entry in entries for row in entry.rows}
    return [item for item in ITEMS if item not in found] + sorted(found - set(ITEMS))


# ---------------------------------------------------------------- what entries may point to


def recorded(files: Iterable[Path]) -> dict[str, tuple[Any, Path]]:
    """Recorded tables by the result that they were taken from: ``full/accuracy/chains.csv`` below the
    results, ``chain_study.csv`` below ``results/reproduction``.

    A picked JSON file comes back as the tree that its keys were picked from.

    Parameters
    ----------
    files : tables of ``docs/validation``, and the files of ``config/studies`` that say what was recorded.
    """
    by_suffix: dict[str, list[Path]] = {".csv": [], ".yaml": []}
    for path in files:
        by_suffix[path.suffix].append(path)
    tables = {path.stem: path for path in by_suffix[".csv"]}
    found: dict[str, tuple[Any, Path]] = {}
    for study in by_suffix[".yaml"]:
        entry = yaml.safe_load(study.read_text(encoding="utf-8"))
        for table, wanted in entry.get("tables", {}).items():
            if table not in tables:
                continue
            content = pd.read_csv(tables[table], keep_default_na=False, na_values=["", "nan", "NaN"])
            name = wanted["file"].removeprefix("results/").removeprefix("reproduction/")
            picked = wanted.get("pick")
            file = Path("docs/validation") / f"{table}.csv"
            found[name] = (_tree(content, picked) if picked else content), file
    return found


def _tree(content: pd.DataFrame, picked: Mapping[str, str]) -> dict[Any, Any]:
    values = dict(zip(content["key"], content["value"], strict=True))
    tree: dict[Any, Any] = {}
    for key, dotted in picked.items():
        *parents, last = (int(part) if part.isdigit() else part for part in dotted.split("."))
        here = tree
        for part in parents:
            here = here.setdefault(part, {})
        here[last] = values.get(key)
    return tree


def is_function(name: str) -> bool:
    """True if ``module:name`` can be imported."""
    module, _, attribute = name.partition(":")
    try:
        return hasattr(importlib.import_module(module), attribute)
    except ImportError:
        return False


def parts_of(rules: Iterable[str], figures: Iterable[str]) -> dict[str, Callable[[str], bool]]:
    """Whether rules, functions and figures exist, by `thalweg_lab.reproduction.files.NAMES`."""
    known_rules, known_figures = frozenset(rules), frozenset(figures)
    return {"rule": known_rules.__contains__, "figure": known_figures.__contains__, "function": is_function}
