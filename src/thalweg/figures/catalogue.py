"""A catalogue of all campaigns of a folder of results: page, table, an item of STAC each.

The catalogue is read from results alone, and quickly: hashes come from the provenance beside the files,
extents from trajectories. What each campaign found for a mount, a clock or a sigma0 is set beside what the
others found, so that an instrument that was bumped is seen in the season in which it happened.
"""

import hashlib
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from html import unescape
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from matplotlib.figure import Figure
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.transform import Rotation

from thalweg.core import (
    ArrayF,
    LocalFrame,
    Rigid,
    ThalwegError,
    column,
    frame_of,
    read_json,
    table_kind,
    utc_text_from_gps,
    write_table,
)
from thalweg.core.calibration import read_calibration
from thalweg.figures.page import Page
from thalweg.figures.products import MAP_FILES, OWN_FILES, products_of
from thalweg.figures.style import BLUE, GREY, VERMILION, mark_twin, new_figure, styled

# ---------------------------------------------------------------- catalogue

LIMIT: Final = 3.0
"""Control limits in standard deviations (Shewhart 1931): one false alarm in 370 values."""
MEDIA: Final = {
    ".laz": "application/vnd.laszip",
    ".tif": "image/tiff; application=geotiff; profile=cloud-optimized",
    ".gpkg": "application/geopackage+sqlite3",
    ".parquet": "application/vnd.apache.parquet",
    ".yaml": "application/yaml",
    ".csv": "text/csv",
    ".pdf": "application/pdf",
}
"""Media types of the files that are assets of an item; other files are none."""
PAGES: Final = {
    "index.html": "front page",
    "viewer/index.html": "viewer",
    "panorama/index.html": "virtual walk",
    "accuracy/index.html": "accuracy",
    "bathymetry/index.html": "riverbed",
    "calibration/index.html": "calibration",
    "deformation/index.html": "change",
}
SIGMAS: Final = {
    "rmse_reference_m": "reference, without outliers: RMSE",
    "rmse_reference_predicted_m": "reference, without outliers: RMSE predicted",
    "rmse_bed_m": "riverbed: RMSE of left-out lines",
}

CATALOGUE: Final = table_kind(
    "catalogue",
    1,
    [
        column("campaign", "1", "id of the campaign", pa.string()),
        column("title", "1", "its title", pa.string()),
        column("twin", "1", "whether a digital twin wrote the logs", pa.bool_()),
        column("start_utc", "1", "first pose, UTC; empty: no trajectory", pa.string()),
        column("end_utc", "1", "last pose, UTC", pa.string()),
        column("west_deg", "deg", "western edge of the track (WGS 84)"),
        column("south_deg", "deg", "southern edge"),
        column("east_deg", "deg", "eastern edge"),
        column("north_deg", "deg", "northern edge"),
        column("chains", "1", "trajectories that carry clouds: ins, camera, fused", pa.string()),
        *(column(name, "m", words) for name, words in SIGMAS.items()),
        column("versions", "1", "versions of Thalweg that made its results", pa.string()),
        column("files", "1", "results with provenance", pa.int64()),
        column("bytes", "byte", "their size, folders left out", pa.int64()),
        column("sha256", "1", "hash over the hashes of its products, in their order", pa.string()),
        column("remarks", "1", "what is missing or mixed", pa.string()),
    ],
)

CONTROL: Final = table_kind(
    "control chart",
    1,
    [
        column("campaign", "1", "id of the campaign", pa.string()),
        column("start_utc", "1", "its first pose, UTC", pa.string()),
        column("quantity", "1", "result: position (m) or rotation of a mount, clock, or sigma0", pa.string()),
        column("unit", "1", "unit of value, sigma and mean", pa.string()),
        column("twin", "1", "campaigns of a digital twin are compared among themselves", pa.bool_()),
        column("value", "as stated", "what this campaign found"),
        column("sigma", "as stated", "its standard deviation"),
        column("mean_others", "as stated", "weighted mean of all other campaigns"),
        column("sigma_mean_others", "as stated", "standard deviation of that mean"),
        column("standardised", "1", "difference over its standard deviation"),
        column("outside", "1", "beyond the control limits of 3", pa.bool_()),
    ],
)


Found = tuple[str, str, float, float]
"""Quantity, unit, value, standard deviation."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A campaign as its results show it.

    ``row`` has the columns of `CATALOGUE`; ``poses`` and ``found`` are what it calibrated: mounts by name,
    and quantity, unit, value, sigma of all else; ``outline`` is the convex hull of the track, (n, 2)
    longitude and latitude in degrees.
    """

    row: dict[str, Any]
    poses: dict[str, Rigid]
    found: list[Found]
    outline: ArrayF | None
    assets: dict[str, dict[str, Any]]
    pages: dict[str, str]
    libraries: dict[str, str] = field(default_factory=dict)


def read_entries(results: Path) -> list[Entry]:
    """All campaigns of a folder of results, in the order of their time; those without a trajectory last."""
    folders = sorted(path for path in results.iterdir() if path.is_dir() and not path.name.startswith("."))
    entries = [
        read_entry(path)
        for path in folders
        if (path / "index.html").is_file() or (path / "orientation/trajectory.parquet").is_file()
    ]
    return sorted(entries, key=lambda each: (each.row["start_utc"] or "9", each.row["campaign"]))


def read_entry(folder: Path) -> Entry:
    """One campaign from its folder of results."""
    title, twin = _heading(folder / "index.html")
    outline, span, remarks = None, ("", ""), []
    track = folder / "orientation" / "trajectory.parquet"
    try:
        outline, span = _track(track)
    except FileNotFoundError:
        remarks.append("no trajectory")
    except (ThalwegError, ValueError, KeyError, OSError) as error:
        remarks.append(f"trajectory cannot be read ({error})")
    assets, versions, files, size, libraries, missing = _provenance(folder)
    if len(versions) > 1:
        remarks.append(f"made by several versions: {', '.join(versions)}")
    if missing:
        remarks.append(f"without provenance: {', '.join(missing)}")
    (west, south), (east, north) = (
        np.full((2, 2), np.nan) if outline is None else np.stack([outline.min(axis=0), outline.max(axis=0)])
    ).tolist()
    checksums = "".join(f"{name} {each.get('file:checksum', '')}\n" for name, each in sorted(assets.items()))
    chains = [
        name
        for name, file in (
            ("ins", "points.laz"),
            ("camera", "by_camera/points.laz"),
            ("fused", "by_fused/points.laz"),
        )
        if (folder / "lidar" / file).is_file()
    ]
    row = {
        "campaign": folder.name,
        "title": title or folder.name,
        "twin": twin,
        "start_utc": span[0],
        "end_utc": span[1],
        "west_deg": west,
        "south_deg": south,
        "east_deg": east,
        "north_deg": north,
        "chains": " ".join(chains),
        **_sigmas(folder / "summary.csv"),
        "versions": " ".join(versions),
        "files": files,
        "bytes": size,
        "sha256": hashlib.sha256(checksums.encode()).hexdigest(),
        "remarks": "; ".join(remarks),
    }
    pages = {href: words for href, words in PAGES.items() if (folder / href).is_file()}
    return Entry(row, *calibrated(folder), outline, assets, pages, libraries)


def _heading(page: Path) -> tuple[str, bool]:
    if not page.is_file():
        return "", False
    with page.open(encoding="utf-8") as stream:
        text = stream.read(20_000)
    found = re.search(r"<h1>(.*?)</h1>", text)
    return (unescape(found[1]) if found else ""), "Digital twin" in text


def _track(path: Path) -> tuple[ArrayF, tuple[str, str]]:
    """Convex hull of the track in longitude and latitude, and first and last time."""
    with path.open("rb") as stream:
        table = pq.read_table(stream, columns=["t_gps_s", "east_m", "north_m", "up_m"])
    origin = json.loads((table.schema.metadata or {})[b"meta"])["origin"]
    t, east, north, up = (table.column(k).to_numpy() for k in range(4))
    points = np.column_stack([east, north, up])
    valid = np.isfinite(points).all(axis=1)
    if not valid.any():
        raise ValueError("no valid pose")
    points, t = points[valid], t[valid]
    try:
        corners = points[ConvexHull(points[:, :2]).vertices]
    except QhullError:  # a track that is a point or a straight line
        corners = points[[int(np.argmin(t)), int(np.argmax(t))]]
    lat, lon, _ = LocalFrame(**origin).to_geodetic(corners)
    return np.column_stack([lon, lat]), (utc_text_from_gps(t.min(), 0), utc_text_from_gps(t.max(), 0))


def _provenance(
    folder: Path,
) -> tuple[dict[str, dict[str, Any]], list[str], int, int, dict[str, str], list[str]]:
    """Assets, versions, number and size of files, libraries, and products without provenance."""
    assets, missing, libraries, files, size = {}, [], {}, 0, 0
    for path in folder.rglob("*.meta.json"):
        output = path.with_name(path.name.removesuffix(".meta.json"))
        if output.is_file():
            files, size = files + 1, size + output.stat().st_size
    versions: set[str] = set()
    for output, words, _ in products_of(folder, (*MAP_FILES, *OWN_FILES)):
        if output.suffix not in MEDIA:
            continue
        name = output.relative_to(folder).as_posix()
        try:
            meta = json.loads(output.with_name(f"{output.name}.meta.json").read_text(encoding="utf-8"))
            versions.add(str(meta["thalweg"]))
            libraries = meta["libraries"]
            # multihash: function 0x12 (SHA-256), length 0x20 (STAC extension `file`)
            checksum = {"file:checksum": f"1220{meta['sha256']}"}
        except (OSError, ValueError, KeyError):
            missing.append(name)
            checksum = {}
        assets[name] = {
            "href": f"../{folder.name}/{name}",
            "title": words,
            "type": MEDIA[output.suffix],
            "roles": ["data"],
            "file:size": output.stat().st_size,
            **checksum,
        }
    return assets, sorted(versions), files, size, libraries, missing


def _sigmas(summary: Path) -> dict[str, float]:
    if not summary.is_file():
        return dict.fromkeys(SIGMAS, np.nan)
    values = pd.read_csv(summary).drop_duplicates("quantity").set_index("quantity")["value"]
    return {name: float(values.get(words, np.nan)) for name, words in SIGMAS.items()}


# ---------------------------------------------------------------- what was calibrated


def calibrated(folder: Path) -> tuple[dict[str, Rigid], list[Found]]:
    """Mounts, and clock and sigma0, that a campaign found itself.

    Values that it took from another campaign or from its settings are left out: they would count twice.
    """
    poses: dict[str, Rigid] = {}
    found: list[Found] = []
    files = [folder / "calibration" / f"{name}.yaml" for name in ("boat", "ins_lidar", "camera_lidar")]
    for file in [each for each in files if each.is_file()][:1]:
        calibration = read_calibration(file)
        poses = {block.name: calibration.pose(block.name) for block in calibration.blocks if block.is_pose}
    clocks = [folder / "timing" / "camera_clock.json", folder / "orientation" / "image_times.json"]
    for file in [each for each in clocks if each.is_file()][:1]:
        clock = read_json(file)
        if clock.get("offset_s") is not None and clock.get("sigma_offset_s"):
            found.append(("camera clock offset", "s", clock["offset_s"], clock["sigma_offset_s"]))
        run = clock.get("run") or clock
        if run.get("drift_ppm") is not None and run.get("sigma_drift_ppm"):
            found.append(("camera clock drift", "ppm", run["drift_ppm"], run["sigma_drift_ppm"]))
    for words, name in (("field", "calibration/camera.json"), ("cones", "calibration/camera_lidar.json")):
        file = folder / name
        if file.is_file():
            found += _sigma0(words, read_json(file))
    return poses, found


def _sigma0(words: str, facts: Any) -> list[Found]:
    """First ``sigma0`` of a file with its band of 95 %, whose width gives the standard deviation."""
    if isinstance(facts, dict):
        if "sigma0" in facts and "sigma0_band" in facts:
            low, high = facts["sigma0_band"]
            return [(f"sigma0 {words}", "1", float(facts["sigma0"]), (high - low) / (2 * 1.959964))]
        for value in facts.values():
            if found := _sigma0(words, value):
                return found
    return []


def _pose(name: str, pose: Rigid, first: Rigid) -> list[Found]:
    """Place, and rotation from the first campaign as a vector: its axes are those of the covariance.

    Angles would not do: at phi = 90 degrees omega and kappa are one rotation.
    """
    turn_deg = np.rad2deg(Rotation.from_matrix(pose.R @ first.R.T).as_rotvec())
    sigma = np.sqrt(np.diag(pose.cov))
    return [
        *((f"{name} place {x}", "m", float(pose.shift_m[k]), float(sigma[k])) for k, x in enumerate("xyz")),
        *(
            (f"{name} about {x}", "deg", float(turn_deg[k]), float(np.rad2deg(sigma[3 + k])))
            for k, x in enumerate("xyz")
        ),
    ]


def control_table(entries: Sequence[Entry]) -> pd.DataFrame:
    """Each calibrated value beside the weighted mean of all other campaigns; columns of `CONTROL`.

    A value is compared with the mean of the others, of which it is independent: the variance of the
    difference is the sum of both. A value that is outside the limits leaves the means of the others, the
    worst first, as long as half of them remain. Rotations are counted from that of the first campaign.
    Campaigns of a digital twin are compared among themselves.
    """
    first: dict[tuple[str, bool], Rigid] = {}
    rows: list[dict[str, Any]] = []
    for e in entries:
        about = {key: e.row[key] for key in ("campaign", "start_utc", "twin")}
        turned = [
            each
            for name, pose in e.poses.items()
            for each in _pose(name, pose, first.setdefault((name, e.row["twin"]), pose))
        ]
        rows += [
            about | dict(zip(("quantity", "unit", "value", "sigma"), each, strict=True))
            for each in (*turned, *e.found)
            if np.isfinite(each[2:]).all() and each[3] > 0
        ]
    table = pd.DataFrame(
        rows, columns=["campaign", "start_utc", "twin", "quantity", "unit", "value", "sigma"]
    )
    mean, sigma_mean = np.full(len(table), np.nan), np.full(len(table), np.nan)
    for _, group in table.groupby(["quantity", "twin"], sort=False):
        x, sigma = group["value"].to_numpy(float), group["sigma"].to_numpy(float)
        mean[group.index], sigma_mean[group.index] = _means_of_others(x, sigma)
    z = (table["value"] - mean) / np.hypot(table["sigma"].astype(float), sigma_mean)
    found = table.assign(
        mean_others=mean, sigma_mean_others=sigma_mean, standardised=z, outside=np.abs(z) > LIMIT
    )
    return frame_of(CONTROL, {name: found[name] for name in CONTROL.names})


def _means_of_others(x: ArrayF, sigma: ArrayF) -> tuple[ArrayF, ArrayF]:
    """Weighted mean of the others for each value, and its standard deviation; NaN for a lone value."""
    kept = np.ones(len(x), bool)
    while True:
        weight = np.where(kept, sigma**-2, 0.0)
        others = weight.sum() - weight
        with np.errstate(divide="ignore", invalid="ignore"):
            mean, sigma_mean = ((weight * x).sum() - weight * x) / others, others**-0.5
        lone = others <= 1e-9 * weight.sum()
        mean[lone] = sigma_mean[lone] = np.nan
        z = np.where(kept & ~lone, np.abs(x - mean) / np.hypot(sigma, sigma_mean), 0.0)
        worst = int(np.argmax(z))
        if z[worst] <= LIMIT or 2 * (kept.sum() - 1) < len(x) or kept.sum() < 3:
            return mean, sigma_mean
        kept[worst] = False


@styled
def control_chart(table: pd.DataFrame) -> Figure:
    """Standardised differences of all calibrated values in the order of time, with the control limits."""
    shown = table.dropna(subset=["standardised"])
    campaigns = list(dict.fromkeys(shown["campaign"]))
    quantities = list(dict.fromkeys(shown["quantity"]))
    title = (
        f"Calibrated values of each campaign beside the mean of all others, n = {len(shown)} values of "
        f"{len(campaigns)} campaigns"
    )
    names_mm = 12 + 1.4 * max(map(len, campaigns), default=0)
    height_mm = 18 + names_mm + 13 * max(len(quantities), 1)
    figure = new_figure(height_mm, title)
    if shown["twin"].any():
        mark_twin(figure)
    if shown.empty:
        figure.text(0.5, 0.5, "fewer than two campaigns found the same quantity", ha="center")
        return figure
    # By hand: a constrained layout keeps room for names below each of the rows.
    figure.set_layout_engine("none")
    height_mm = 25.4 * figure.get_figheight()
    room = {"left": 0.17, "right": 0.985, "bottom": names_mm / height_mm, "top": 1 - 18 / height_mm}
    axes = figure.subplots(
        len(quantities), 1, sharex=True, squeeze=False, gridspec_kw={**room, "hspace": 0.4}
    )
    axes = axes[:, 0]
    for ax, quantity in zip(axes, quantities, strict=True):
        group = shown[shown["quantity"] == quantity]
        x = [campaigns.index(name) for name in group["campaign"]]
        z = group["standardised"].to_numpy()
        reach = max(LIMIT + 1.0, float(np.abs(z).max()) * 1.15)
        ax.axhspan(-LIMIT, LIMIT, color=GREY, alpha=0.18, lw=0)
        ax.axhline(0.0, color=GREY, lw=0.6)
        ax.plot(x, z, color=BLUE, lw=0.7)
        outside = group["outside"].to_numpy(bool)
        ax.plot(np.array(x)[~outside], z[~outside], "o", color=BLUE, ms=3)
        ax.plot(np.array(x)[outside], z[outside], "D", color=VERMILION, ms=5, clip_on=False)
        ax.set_ylim(-reach, reach)
        ax.set_ylabel(quantity.replace(" ", "\n", 1), rotation=0, ha="right", va="center", fontsize=7)
        ax.tick_params(labelsize=7)
    step = max(1, len(campaigns) // 20)
    axes[-1].set_xticks(
        range(0, len(campaigns), step), campaigns[::step], rotation=60, ha="right", fontsize=7
    )
    axes[-1].set_xlabel(
        "campaigns in the order of time; upwards: difference [its standard deviation], grey: within 3",
        fontsize=8,
    )
    return figure


# ---------------------------------------------------------------- what is written


def stac_item(entry: Entry) -> dict[str, Any]:
    """The campaign as an item of STAC 1.0 (GeoJSON); addresses are relative to ``catalogue/items``."""
    row = entry.row
    if entry.outline is None:
        geometry: dict[str, Any] | None = None
    elif len(entry.outline) < 3:
        geometry = {"type": "LineString", "coordinates": entry.outline.round(7).tolist()}
    else:
        ring = np.vstack([entry.outline, entry.outline[:1]]).round(7).tolist()
        geometry = {"type": "Polygon", "coordinates": [ring]}
    plain = {k: (None if isinstance(v, float) and not np.isfinite(v) else v) for k, v in row.items()}
    times = {"start_datetime": row["start_utc"], "end_datetime": row["end_utc"]} if row["start_utc"] else {}
    item = {
        "type": "Feature",
        "stac_version": "1.0.0",
        "stac_extensions": ["https://stac-extensions.github.io/file/v2.1.0/schema.json"],
        "id": row["campaign"],
        "geometry": geometry,
        "properties": {
            "datetime": None,
            "title": row["title"],
            **times,
            **{
                f"thalweg:{k}": plain[k] for k in ("twin", "chains", "versions", "sha256", "remarks", *SIGMAS)
            },
            "thalweg:libraries": entry.libraries,
        },
        "links": [
            {"rel": "related", "href": f"../../{row['campaign']}/{href}", "type": "text/html", "title": words}
            for href, words in entry.pages.items()
        ],
        "assets": {name: {**each, "href": f"../{each['href']}"} for name, each in entry.assets.items()},
    }
    if entry.outline is not None:
        item["bbox"] = [round(row[k], 7) for k in ("west_deg", "south_deg", "east_deg", "north_deg")]
    return item


def chosen(
    entries: Iterable[Entry],
    *,
    box_deg: Sequence[float] | None = None,
    start_utc: str = "",
    end_utc: str = "",
) -> list[Entry]:
    """Campaigns that touch a box (west, south, east, north, degrees) and a span of time (ISO 8601, UTC)."""
    kept = []
    for entry in entries:
        row = entry.row
        if box_deg is not None:
            west, south, east, north = box_deg
            apart = row["east_deg"] < west or row["west_deg"] > east
            if entry.outline is None or apart or row["north_deg"] < south or row["south_deg"] > north:
                continue
        if start_utc and (not row["end_utc"] or row["end_utc"] < start_utc):
            continue
        if end_utc and (not row["start_utc"] or row["start_utc"] > end_utc):
            continue
        kept.append(entry)
    return kept


def write_catalogue(entries: Sequence[Entry], out: Path) -> pd.DataFrame:
    """Write ``index.html``, ``campaigns.parquet``, ``control.csv`` and ``items/<id>.json``.

    Parameters
    ----------
    entries : campaigns, in the order of time.
    out : folder ``catalogue`` beside the campaigns.

    Returns
    -------
    DataFrame
        The control chart, columns of `CONTROL`.
    """
    (out / "items").mkdir(parents=True, exist_ok=True)
    rows = pd.DataFrame([entry.row for entry in entries], columns=CATALOGUE.names)
    write_table(out / "campaigns.parquet", rows, CATALOGUE)
    for entry in entries:
        text = json.dumps(stac_item(entry), indent=1, ensure_ascii=False)
        (out / "items" / f"{entry.row['campaign']}.json").write_text(text + "\n", encoding="utf-8")
    control = control_table(entries)
    control.to_csv(out / "control.csv", index=False, float_format="%.9g")
    catalogue_page(entries, rows, control).write(out / "index.html")
    return control


def catalogue_page(entries: Sequence[Entry], rows: pd.DataFrame, control: pd.DataFrame) -> Page:
    """The page of the catalogue."""
    twins = int(rows["twin"].sum())
    lead = f"{len(rows)} campaigns" + (f", {twins} of a digital twin." if twins else ".")
    page = Page("Catalogue of campaigns", lead, folded=False)
    outside = control[control["outside"]]
    page.section("Remarks")
    remarks = [f"{e.row['campaign']}: {e.row['remarks']}" for e in entries if e.row["remarks"]]
    remarks += [
        f"{r['campaign']}: {r['quantity']} {r['value']:.6g} {r['unit']} is {abs(r['standardised']):.1f}"
        f" standard deviations from the mean of the others, {r['mean_others']:.6g}"
        for r in outside.to_dict("records")
    ]
    page.lines(remarks or ["Nothing is missing, and no calibrated value is outside its control limits."])
    page.section("Campaigns")
    page.links(
        {
            f"../{e.row['campaign']}/{next(iter(e.pages))}": (
                e.row["title"],
                f"{e.row['start_utc'][:10] or 'no time'}; " + ", ".join(e.pages.values()),
            )
            for e in entries
            if e.pages
        }
    )
    shown = rows.drop(columns=["title", "sha256", "remarks"])
    page.table(shown, "All campaigns in the order of time; the same as campaigns.parquet.", digits=8)
    page.section("Calibration over the season")
    page.text(
        "Each value is compared with the weighted mean of all other campaigns. A diamond is more than three "
        "standard deviations away: a mount that was moved, a clock that jumps, or sigmas that are too small."
    )
    page.figure(control_chart(control), "Calibrated values with control limits (control.csv).")
    return page
