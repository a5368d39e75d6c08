"""The viewer as a folder: a page with its program, and the nodes of the cloud as scripts beside it.

Browsers refuse a page from disk to fetch files, but let it load scripts: each node is a script that calls
the page with its points, compressed and in letters (base64). So is each panorama of a walk: pictures from
disk may be shown, but not drawn on by WebGL.
"""

import base64
import json
import re
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from importlib.resources import files
from io import BytesIO
from os.path import relpath
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import numpy as np
import pandas as pd
from cmcrameri import cm
from matplotlib.colors import Colormap, ListedColormap
from PIL import Image
from pyproj import CRS
from scipy.spatial.transform import Rotation

from thalweg.core import (
    AnyArray,
    ArrayF,
    ArrayU8,
    CoverageError,
    Frame,
    InputError,
    LocalFrame,
    Trajectory,
    final_path,
    frame_in_words,
    iter_laz,
    laz_header,
    read_table,
    unix_from_gps,
    utc_text_from_gps,
)
from thalweg.core.geometry import Node, build_octree
from thalweg.deformation.foreign import TEXT, read_points
from thalweg.figures import (
    BACK,
    HEIGHT_MAP,
    RANGE_MAP,
    REFLECTANCE_MAP,
    SIGMA_MAP,
    TIME_MAP,
    TWIN_MARK,
    count,
    front_page_of,
    robust_limits,
)
from thalweg.images.model import named_once
from thalweg.ingest.clouds import read_cloud
from thalweg.lidar import COLOUR_DIMENSIONS, CORRELATIONS, SIGMAS, UNSEEN_GREY
from thalweg.panorama import PANORAMAS

# ---------------------------------------------------------------- the page and its nodes

MOST_POINTS: Final = 1_500_000
"""Points of a viewer: some 25 megabytes on disk."""
SIGMA_LEAST_M: Final = 1e-4
SIGMA_STEPS: Final = 254
SIGMA_DECADES: Final = 5
"""Sigmas from 0.1 mm to 10 m stand in a byte by their logarithm: steps of 4.6 %; 0: not known."""
WALK_POINTS: Final = 500_000
"""Points over panoramas: the pictures show more than they do."""
_WALK_PX: Final = 4096
"""Wider panoramas are reduced for the walk: not every graphics card takes more."""
_MOST_PHOTOGRAPHS: Final = 65_535
_LONGEST_UNIT: Final = 6
_LEAD: Final = 0.5
"""Share of the best cloud among the points of a survey's page; those by other trajectories have the rest."""
_HELD: Final = 4
"""Of a cloud with more points than so many times those shown, only every so many-th is read into memory."""
RAMPS: Final[Mapping[str, Colormap]] = {
    "height": HEIGHT_MAP,
    "intensity": REFLECTANCE_MAP,
    "sigma": SIGMA_MAP,
    "time": TIME_MAP,
    "range": RANGE_MAP,
}
DIFFERENCES: Final[Colormap] = ListedColormap(0.85 * cm.vik(np.linspace(0, 1, 256)), "thalweg_differences")
"""Darker than it is: white would vanish on a light ground."""
MOST_EXTRAS: Final = 3
_MOST: Final = 0.5
"""A colour that so many points have is the first one that the page shows."""
_FIRST: Final = ("distance", "lod95", "sigma")
"""Begins of the names of extra dimensions that come before others."""
UNITS: Final = {"height": "m", "intensity": "", "sigma": "m", "time": "s", "range": "m"}


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A cloud to be shown; each quantity but the positions may be missing.

    Parameters
    ----------
    xyz_m : (n, 3) east, north, up in the frame.
    frame : local frame, map projection, or None if unknown.
    n_total : points of the cloud, of which these are a part.
    rgb : (n, 3) 8-bit colours.
    coloured : (n,) which points have a colour.
    intensity, range_m, t_gps_s : (n,).
    image : (n,) number of the photograph that shows the point best, -1: none.
    sigma_m : (n, 3) standard deviations east, north, up.
    extras : further quantities, three at most: values (n,), NaN where unknown, and unit.
    clouds : names of several clouds, which the quantity ``cloud`` tells apart: 1, 2 ...
    """

    xyz_m: ArrayF
    frame: Frame
    n_total: int
    rgb: ArrayU8 | None = None
    coloured: AnyArray | None = None
    intensity: AnyArray | None = None
    sigma_m: AnyArray | None = None
    range_m: AnyArray | None = None
    t_gps_s: ArrayF | None = None
    image: AnyArray | None = None
    extras: Mapping[str, tuple[ArrayF, str]] = field(default_factory=dict)
    clouds: Sequence[str] = ()


_COLUMNS: Final = ("xyz_m", "rgb", "coloured", "intensity", "sigma_m", "range_m", "t_gps_s", "image")
"""Quantities of a `View` that each of its points has."""


def read_view(path: Path, most_points: int = MOST_POINTS, quantities: Sequence[str] | None = None) -> View:
    """A cloud of anybody's: LAS and LAZ with all that Thalweg writes, PLY, E57, tables of x y z.

    Parameters
    ----------
    path : the cloud.
    most_points : to be shown; of far larger LAS and LAZ files each k-th point is held.
    quantities : extra dimensions to be shown; None: three, distances and their limits first.

    Raises
    ------
    InputError : it cannot be read, or has no such quantity.
    """
    las = path.suffix.lower() in {".las", ".laz"}
    if quantities and not las:
        raise InputError(f"quantities of {path.suffix}", expected="a LAS or LAZ file", where=path)
    if path.suffix.lower() in TEXT:
        points = read_points(path)
        return View(xyz_m=points.xyz_m, frame=points.frame, n_total=len(points.xyz_m))
    if not las:
        cloud = read_cloud(path)
        return View(
            xyz_m=cloud.points,
            frame=cloud.frame,
            n_total=len(cloud.points),
            rgb=cloud.rgb,
            intensity=cloud.intensity,
            t_gps_s=_known(cloud.t_gps_s),
        )
    header = laz_header(path)
    every = max(1, -(-header.n_points // (_HELD * most_points)))
    extras = _extras(path, header.extra_dimensions, quantities)
    wanted = ("xyz_m", "t_gps_s", "intensity", "rgb", "n_views", "image", "range", *SIGMAS, *extras)
    parts: dict[str, list[AnyArray]] = {}
    at = 0
    for chunk in iter_laz(path):
        for name in wanted:
            if name in chunk:
                # a copy: a view would keep the whole piece
                parts.setdefault(name, []).append(chunk[name][-at % every :: every].copy())
        at += len(chunk["xyz_m"])
    if not parts:
        raise CoverageError("a cloud of no points", expected="points to show", where=path)
    found = {name: np.concatenate(each) for name, each in parts.items()}
    sigmas = [found[name] for name in SIGMAS if name in found]
    rgb = found.get("rgb")
    if rgb is not None:
        # some programs store 8 bits where 16 belong
        rgb = (rgb >> 8 if rgb.max(initial=0) > 255 else rgb).astype(np.uint8)
    return View(
        xyz_m=found["xyz_m"],
        frame=header.frame,
        n_total=at,
        rgb=rgb if rgb is not None and rgb.any() else None,
        coloured=found["n_views"] > 0 if "n_views" in found else None,
        intensity=found["intensity"] if found.get("intensity", np.zeros(1)).any() else None,
        sigma_m=np.stack(sigmas, axis=1) if len(sigmas) == len(SIGMAS) else None,
        range_m=found.get("range"),
        t_gps_s=_known(found.get("t_gps_s")),
        image=found.get("image"),
        extras={name: (found[name].astype(np.float64), unit) for name, unit in extras.items()},
    )


def read_views(
    paths: Sequence[Path],
    most_points: int = MOST_POINTS,
    *,
    names: Sequence[str] = (),
    lead: float | None = None,
) -> View:
    """Several clouds in one frame, told apart by the quantity ``cloud``: 1, 2 ... in the order of the files.

    Such are the clouds of one survey by its trajectories: by INS, by camera, by all sensors. Where one has
    colours, points of the others have none; any other quantity is shown if all of them have it.

    Parameters
    ----------
    paths : as of `read_view`.
    most_points : of all together.
    names : of the clouds; without them those of the files.
    lead : share of the points that the first cloud takes, the others as many each; None: none is preferred.

    Raises
    ------
    InputError : one cannot be read, or lies in another frame than the first.
    """
    rest = len(paths) - 1
    shares = [1 / len(paths)] * len(paths) if lead is None else [lead, *[(1 - lead) / rest] * rest]
    most = [int(share * most_points) for share in shares]
    views = [read_view(path, points) for path, points in zip(paths, most, strict=True)]
    for path, view in zip(paths, views, strict=True):
        if view.frame != views[0].frame:
            raise InputError(
                f"a cloud in the frame {frame_in_words(view.frame)}",
                expected=f"that of {paths[0].name}, {frame_in_words(views[0].frame)}",
                where=path,
                cure="Transform it, or give it a page of its own",
            )
    n_total = sum(view.n_total for view in views)
    if lead is not None:
        views = [_thinned(view, points) for view, points in zip(views, most, strict=True)]
    if any(view.rgb is not None for view in views):
        views = [_with_colours(view) for view in views]
    columns = {name: [getattr(view, name) for view in views] for name in _COLUMNS}
    number = np.repeat(np.arange(1.0, len(views) + 1), [len(view.xyz_m) for view in views])
    common = [name for name in views[0].extras if all(name in view.extras for view in views)]
    extras = {
        name: (np.concatenate([view.extras[name][0] for view in views]), views[0].extras[name][1])
        for name in common[: MOST_EXTRAS - 1]
    }
    return View(
        frame=views[0].frame,
        n_total=n_total,
        extras={**extras, "cloud": (number, "")},
        clouds=list(names) or [path.name for path in paths],
        **{k: np.concatenate(v) for k, v in columns.items() if all(each is not None for each in v)},
    )


def _shares(view: View, shown: AnyArray) -> list[float]:
    """Shares of several clouds among the points that are shown."""
    number = view.extras["cloud"][0][shown] if view.clouds else np.empty(0)
    return [round(float(np.mean(number == k + 1)), 4) for k in range(len(view.clouds))]


def _thinned(view: View, most_points: int) -> View:
    """The same with so many points at most, evenly in space."""
    if len(view.xyz_m) <= most_points:
        return view
    rows = np.concatenate([node.rows for node in build_octree(view.xyz_m, most_points)])
    columns = {name: getattr(view, name) for name in _COLUMNS}
    return replace(
        view,
        extras={name: (values[rows], unit) for name, (values, unit) in view.extras.items()},
        **{name: values[rows] for name, values in columns.items() if values is not None},
    )


def _with_colours(view: View) -> View:
    """The same beside clouds in colour: points without a colour or a photograph say so."""
    n, has = len(view.xyz_m), view.rgb is not None
    return replace(
        view,
        rgb=view.rgb if has else np.full((n, 3), UNSEEN_GREY, dtype=np.uint8),
        coloured=np.full(n, has) if view.coloured is None else view.coloured,
        image=np.full(n, -1) if view.image is None else view.image,
    )


def _extras(
    path: Path, dimensions: Mapping[str, tuple[str, str]], quantities: Sequence[str] | None
) -> dict[str, str]:
    """Extra dimensions to be shown, and their units, which descriptions end in."""
    shown = {"range", "ring", *SIGMAS, *CORRELATIONS, *COLOUR_DIMENSIONS}
    others = [name for name in dimensions if name not in shown]
    first = sorted(others, key=lambda name: [not name.startswith(word) for word in _FIRST])[:MOST_EXTRAS]
    names = first if quantities is None else list(dict.fromkeys(quantities))
    unknown = [name for name in names if name not in dimensions]
    if unknown or len(names) > MOST_EXTRAS:
        raise InputError(
            f"quantities {', '.join(unknown or names)}",
            expected=f"{MOST_EXTRAS} at most of {', '.join(dimensions) or 'none: the file holds no more'}",
            where=path,
        )
    units = {name: dimensions[name][1].rpartition(",")[2].strip() for name in names}
    return {name: unit if len(unit) <= _LONGEST_UNIT else "" for name, unit in units.items()}


def _known(t_gps_s: ArrayF | None) -> ArrayF | None:
    """Times, if each of them is known."""
    return t_gps_s if t_gps_s is not None and np.isfinite(t_gps_s).all() else None


def write_viewer(
    view: View,
    folder: Path,
    *,
    title: str,
    twin: bool = False,
    most_points: int = MOST_POINTS,
    trajectory: Trajectory | None = None,
    photographs: Mapping[int, Sequence[str]] | None = None,
    panoramas: Sequence[Mapping[str, Any]] = (),
    first_alone: bool = False,
    grid: Mapping[str, Any] | None = None,
) -> int:
    """Write ``index.html`` and the folder ``nodes`` beside it.

    Parameters
    ----------
    view : the cloud.
    folder : target; nodes of an earlier viewer in it are removed.
    title : heading.
    twin : whether a digital twin made the cloud: the page says so.
    most_points : the cloud is thinned evenly to so many at most.
    trajectory : path of the boat in the same frame, drawn as a line.
    photographs : name, address and, if there is one, address of the panorama, by number of ``view.image``.
    panoramas : of a walk; their pictures are in the folder ``views``.
    first_alone : of several clouds the page shows the first one until others are asked for.
    grid : map grid in which the page gives coordinates, too, as `grid_of` makes it.

    Returns
    -------
    n : points that are shown.

    Raises
    ------
    CoverageError : there are no points.
    InputError : coordinates in degrees, or not finite.
    """
    if isinstance(view.frame, CRS) and view.frame.is_geographic:
        raise InputError(
            f"a cloud in degrees ({view.frame.name})",
            expected="coordinates in metres",
            cure="Transform it to a map projection, such as UTM",
        )
    if not np.isfinite(view.xyz_m).all():
        raise InputError("coordinates that are not finite", expected="a place for each point")
    tree = build_octree(view.xyz_m, most_points)
    n_shown = sum(len(node.rows) for node in tree)
    shown = np.concatenate([node.rows for node in tree])
    columns, facts = _columns(view, shown)
    facts |= {"colour": _first_colour(view, tree[0].rows, first_alone), "grid": grid}
    if view.image is not None and photographs and len(photographs) <= _MOST_PHOTOGRAPHS:
        place = pd.Series(np.arange(1, len(photographs) + 1), index=list(photographs))
        columns["image"] = place.reindex(view.image, fill_value=0).to_numpy().astype("<u2")[:, None]
        facts["columns"].append(["image", 1, 2])
    nodes = folder / "nodes"
    nodes.mkdir(parents=True, exist_ok=True)
    for old in nodes.glob("r*.js"):
        old.unlink()
    for node in tree:
        (nodes / f"r{node.key}.js").write_text(_script(node, view.xyz_m, columns), encoding="ascii")
    root = tree[0]
    facts |= {
        "n": n_shown,
        "corner": root.corner_m.tolist(),
        "size": root.size_m,
        **_first_look(view.xyz_m[shown]),
        "nodes": {node.key: [len(node.rows), float(f"{node.spacing_m:.3g}")] for node in tree},
        "photographs": [list(each) for each in (photographs or {}).values()],
        "panoramas": list(panoramas),
        "clouds": list(view.clouds),
        "shares": _shares(view, shown),
        "shown": 1 if first_alone else 2 ** len(view.clouds) - 1,
        "track": [] if trajectory is None else _track(trajectory),
        "ramps": {name: base64.b64encode(_ramp(ramp)).decode() for name, ramp in _ramps(facts).items()},
        "sigma": [SIGMA_LEAST_M, SIGMA_DECADES * np.log(10) / SIGMA_STEPS],
    }
    thinned = "" if n_shown == view.n_total else f", thinned to {count(n_shown)} for the browser"
    clouds = "a point cloud" if len(view.clouds) < 2 else f"{len(view.clouds)} clouds"
    lead = f"{len(panoramas)} panoramas and {clouds}" if panoramas else clouds[0].upper() + clouds[1:]
    lead = f"{lead} of {count(view.n_total)} points{thinned}. {_place(view.frame)}"
    parts = {
        "title": escape(title),
        "lead": escape(lead),
        "mark": f'<span class="mark">{TWIN_MARK}</span>' if twin else "",
        "back": BACK.format(quote(home)) if (home := front_page_of(folder / "index.html")) else "",
        "style": _text("viewer.css"),
        "program": _text("viewer.js"),
        # no text of the data can end the script that holds it, or begin a comment in it
        "data": json.dumps(facts, allow_nan=False).replace("<", "\\u003c"),
    }
    # in one pass: a title that looks like a part stays a title
    page = re.sub(r"\{\{(\w+)\}\}", lambda part: parts[part[1]], _text("viewer.html"))
    (folder / "index.html").write_text(page, encoding="utf-8")
    return n_shown


def write_survey_viewer(
    *,
    points: list[Path],
    trajectory: list[Path],
    gains: list[Path],
    images: list[Path],
    rig_images: list[Path],
    table: list[Path],
    page: Path,
    nodes: Path,
    title: str,
    twin: bool,
    crs: str = "local",
    names: Sequence[str] = (),
    pictures: Path | None = None,
    views: Path | None = None,
) -> None:
    """Cloud of a survey, photographs and panoramas -> the page of the cloud, or of the walk.

    Parameters
    ----------
    points : the cloud, and those beside it; none: the places of the panoramas alone.
    trajectory : of the boat, if there is one.
    names : of the clouds, where they are several.
    gains : which photograph has which number in the cloud, if it has colours.
    images, rig_images : files of the boat's camera and of the rig.
    table : of panoramas (table kind ``panoramas``), if there are any.
    page, nodes : target.
    pictures, views : folder of the panoramas, and one for their scripts: the page becomes a walk.
    title : of the campaign.
    twin : whether a digital twin made the data.
    crs : map grid of the campaign, or ``local``.
    """
    assert nodes == page.parent / "nodes", "the page looks for its nodes beside it"
    rows = read_table(table[0], PANORAMAS)[0] if table else pd.DataFrame(columns=PANORAMAS.names)
    path = Trajectory.read(trajectory[0]) if trajectory else None
    most = MOST_POINTS if views is None else WALK_POINTS
    if len(points) > 1:
        view = read_views(points, most, names=names, lead=_LEAD)
    elif points:
        view = read_view(points[0], most)
    else:
        xyz = rows[["east_m", "north_m", "up_m"]].to_numpy()
        view = View(xyz_m=xyz, frame=None if path is None else path.frame, n_total=len(xyz))
    write_viewer(
        view,
        page.parent,
        title=f"{'Point cloud' if views is None else 'Virtual walk'}: {title}",
        twin=twin,
        most_points=most,
        trajectory=path,
        photographs=_photographs(pd.read_csv(gains[0]), images, rig_images, rows, page) if gains else None,
        panoramas=[] if pictures is None or views is None else _walk(rows, pictures, views),
        first_alone=True,
        grid=grid_of(view, crs),
    )


def _photographs(
    gains: pd.DataFrame, images: list[Path], rig_images: list[Path], panoramas: pd.DataFrame, page: Path
) -> dict[int, tuple[str, ...]]:
    """Name, address and address of the panorama of each photograph, by its number in the cloud."""
    files, of_rig = (named_once(each) if each else {} for each in (images, rig_images))
    here = final_path(page).parent
    walk = Path(relpath(here.parent / "panorama/index.html", here)).as_posix()
    made = set(panoramas["image"])
    found: dict[int, tuple[str, ...]] = {}
    for name, number in zip(gains["image"].astype(str), gains["number"], strict=True):
        # those of a rig are named LENS/NAME
        file = files[name] if name in files else of_rig[name.partition("/")[2]]
        address = Path(relpath(file.absolute(), here.absolute())).as_posix()
        own = [f"{walk}#panorama={Path(name).stem}"] if Path(name).name in made else []
        found[int(number)] = (name, quote(address), *own)
    return found


def _walk(rows: pd.DataFrame, pictures: Path, views: Path) -> list[dict[str, Any]]:
    """Panoramas in the order of time as the page takes them; their pictures as scripts."""
    views.mkdir(parents=True, exist_ok=True)
    for old in views.glob("*.js"):
        old.unlink()
    found = []
    for _, row in rows.sort_values("t_gps_s").iterrows():
        name, file = Path(row["panorama"]).stem, pictures / row["panorama"]
        data = file.read_bytes()
        if row["width_px"] > _WALK_PX:
            with Image.open(file) as picture:
                small = picture.resize((_WALK_PX, _WALK_PX // 2), Image.Resampling.BOX)
            buffer = BytesIO()
            small.save(buffer, "JPEG", quality=88)
            data = buffer.getvalue()
        script = f'thalwegPanorama({json.dumps(name)},"{base64.b64encode(data).decode()}")\n'
        (views / f"{name}.js").write_text(script, encoding="utf-8")
        axes = Rotation.from_quat([row[f"q{a}"] for a in "xyzw"]).as_matrix().T
        found.append(
            {
                "name": name,
                "at": [round(float(row[f"{a}_m"]), 4) for a in ("east", "north", "up")],
                "sigma": [round(float(row[f"sigma_{a}_m"]), 4) for a in ("east", "north", "up")],
                "axes": axes.round(7).tolist(),
                "heading": round(float(row["heading_deg"]), 3),
                "utc": utc_text_from_gps(float(row["t_gps_s"]))[:21].replace("T", " "),
            }
        )
    return found


def _first_look(xyz_m: ArrayF) -> dict[str, Any]:
    """Middle of nearly all points and how wide they lie: the first view; lowest and highest of all."""
    low, high = np.transpose([robust_limits(xyz_m[:, axis]) for axis in range(3)])
    heights = [float(xyz_m[:, 2].min()), float(xyz_m[:, 2].max()) + 0.01]
    return {"middle": ((low + high) / 2).tolist(), "extent": float((high - low).max()), "heights": heights}


def _first_colour(view: View, even: AnyArray, first_alone: bool) -> str:
    """What tells most of the cloud that is shown first: photographs, distances, else heights.

    ``even``: points evenly in space, as the eye weighs them; near the boat there are many more.
    """
    rows = even[view.extras["cloud"][0][even] == 1] if view.clouds and first_alone else even
    distances = {
        name: np.isfinite(v[rows]) for name, (v, _) in view.extras.items() if name.startswith("dist")
    }
    known = {"rgb": np.zeros(1)} if view.rgb is None else {"rgb": np.ones(1)}
    if view.rgb is not None and view.coloured is not None:
        known["rgb"] = view.coloured[rows]
    return next((name for name, told in (known | distances).items() if np.mean(told) >= _MOST), "height")


def grid_of(view: View, crs: str) -> dict[str, Any] | None:
    """A map grid and polynomials of the second degree to it from the local frame of a cloud.

    None for ``local``, and for a cloud that lies on a map already.
    """
    if not isinstance(view.frame, LocalFrame) or crs == "local":
        return None
    onto = CRS.from_user_input(crs)
    low, high = view.xyz_m.min(axis=0), view.xyz_m.max(axis=0) + 0.01
    steps = np.stack(np.meshgrid(*[np.linspace(-1, 1, 4)] * 3), axis=-1).reshape(-1, 3)
    middle, half = (low + high) / 2, (high - low) / 2
    places = view.frame.to_map(middle + half * steps, onto)
    about = places.mean(axis=0)
    one, (x, y, z) = np.ones(len(steps)), steps.T
    terms = np.stack([one, x, y, z, x * x, x * y, x * z, y * y, y * z, z * z], axis=1)
    found = np.linalg.lstsq(terms, places - about, rcond=None)[0]
    return {
        "name": f"{onto.name} ({crs})" if onto.name != crs else crs,
        "middle": middle.tolist(),
        "half": half.tolist(),
        "about": about.tolist(),
        "terms": found.T.tolist(),
    }


def _text(name: str) -> str:
    """A file of this package."""
    return (files("thalweg.figures.viewer") / name).read_text(encoding="utf-8")


def _place(frame: Frame) -> str:
    """The frame in words."""
    match frame:
        case LocalFrame():
            return (
                f"East, north, up from {frame.lat_deg:.6f}°, {frame.lon_deg:.6f}°, "
                f"{frame.h_ell_m:.2f} m above the ellipsoid."
            )
        case CRS():
            return f"Coordinates: {frame.name}."
        case _:
            return "The file does not state its coordinate system."


def _track(trajectory: Trajectory, most: int = 2000) -> list[list[float] | None]:
    """Positions of a path, thinned; None where a stretch of it is not to be used."""
    step = max(1, len(trajectory.t_gps_s) // most)
    return [
        [round(float(x), 3) for x in place] if valid else None
        for place, valid in zip(trajectory.position_wcs_m[::step], trajectory.valid[::step], strict=True)
    ]


def _ramps(facts: Mapping[str, Any]) -> dict[str, Colormap]:
    """Maps of all quantities; of those on both sides of zero the one that is grey between."""
    extras = {
        name: DIFFERENCES if facts["limits"][name][0] < 0 < facts["limits"][name][1] else HEIGHT_MAP
        for name in facts["extras"]
    }
    return {**RAMPS, **extras}


def _ramp(ramp: Colormap) -> bytes:
    """256 colours."""
    return np.round(255 * ramp(np.linspace(0, 1, 256))[:, :3]).astype(np.uint8).tobytes()


def _scaled(values: AnyArray, limits: Sequence[float], steps: int) -> AnyArray:
    """Values between limits as whole numbers 0..steps; those outside take the nearest."""
    low, high = limits
    return np.round(np.clip((values - low) / max(high - low, 1e-12), 0, 1) * steps)


def _columns(view: View, shown: AnyArray) -> tuple[dict[str, AnyArray], dict[str, Any]]:
    """Quantities as whole numbers, each (n, k) in the order of the page, and what they mean."""
    columns: dict[str, AnyArray] = {}
    height = robust_limits(view.xyz_m[shown, 2])
    limits: dict[str, tuple[float, float]] = {"height": height}
    facts: dict[str, Any] = {}
    if view.rgb is not None:
        columns["rgb"] = view.rgb
    if view.coloured is not None:
        columns["coloured"] = view.coloured.astype(np.uint8)[:, None]
    if view.intensity is not None:
        limits["intensity"] = robust_limits(view.intensity[shown])
        columns["intensity"] = _scaled(view.intensity, limits["intensity"], 255).astype(np.uint8)[:, None]
    if view.sigma_m is not None:
        known = np.isfinite(view.sigma_m) & (view.sigma_m > 0)
        place = np.log10(np.where(known, view.sigma_m, 1.0) / SIGMA_LEAST_M) / SIGMA_DECADES
        step = 1 + np.round(np.clip(place, 0, 1) * SIGMA_STEPS)
        columns["sigma"] = np.where(known, step, 0).astype(np.uint8)
        whole = np.linalg.norm(view.sigma_m[shown], axis=1)
        if known.any():
            limits["sigma"] = robust_limits(whole[np.isfinite(whole) & (whole > 0)])
    if view.range_m is not None:
        limits["range"] = (0.0, float(np.nanmax(view.range_m[shown])))
        columns["range"] = _scaled(view.range_m, limits["range"], 255).astype(np.uint8)[:, None]
    if view.t_gps_s is not None:
        first, last = float(view.t_gps_s[shown].min()), float(view.t_gps_s[shown].max())
        limits["time"] = (0.0, last - first)
        columns["time"] = _scaled(view.t_gps_s - first, limits["time"], 65535).astype("<u2")[:, None]
        facts["unix"] = float(unix_from_gps(np.array([first]))[0])
    codes = []
    for name, (values, _) in view.extras.items():
        known = np.isfinite(values)
        low, high = robust_limits(values[shown][known[shown]]) if known[shown].any() else (0.0, 1.0)
        if name == "cloud" and view.clouds:
            low, high = 1.0, float(max(len(view.clouds), 2))
        elif low < 0 < high:
            low, high = -max(-low, high), max(-low, high)
        limits[name] = (low, high)
        codes.append(np.where(known, 1 + _scaled(np.where(known, values, low), (low, high), 254), 0))
    if codes:
        columns["extra"] = np.stack(codes, axis=1).astype(np.uint8)
    facts["extras"] = list(view.extras)
    facts["columns"] = [[name, values.shape[1], values.dtype.itemsize] for name, values in columns.items()]
    facts["limits"] = limits
    facts["units"] = UNITS | {name: unit for name, (_, unit) in view.extras.items()}
    return columns, facts


def _script(node: Node, xyz_m: ArrayF, columns: Mapping[str, AnyArray]) -> str:
    """Points of a node: each byte of each coordinate of each quantity in a row, which compresses best."""
    place = (xyz_m[node.rows] - node.corner_m) * (65536 / node.size_m)
    rows = [np.clip(place, 0, 65535).astype("<u2"), *(values[node.rows] for values in columns.values())]
    planes = [
        np.ascontiguousarray(values[:, axis]).view(np.uint8).reshape(len(values), -1)[:, byte].tobytes()
        for values in rows
        for axis in range(values.shape[1])
        for byte in range(values.dtype.itemsize)
    ]
    letters = base64.b64encode(zlib.compress(b"".join(planes), 6)).decode()
    return f'thalwegNode("{node.key}","{letters}")\n'
