"""Control points and marks as other programs write them: OpenDroneMap and Metashape.

Rows come out as texts by our own names of the columns, for `thalweg.images.control.tables`.
"""

import re
from pathlib import Path
from xml.etree import ElementTree

from thalweg.core.errors import InputError


def is_gcp_list(text: str) -> bool:
    """Whether a text begins with a CRS, as ``gcp_list.txt`` does."""
    first = next((line for line in text.splitlines() if line.strip()), "")
    return bool(re.match(r"\s*(EPSG:\d+|WGS84 UTM|\+proj=)", first, re.IGNORECASE))


def gcp_rows(path: Path, text: str) -> list[dict[str, str]]:
    """Rows ``x y z im_x im_y image [name]``; a point without name is known by its coordinates."""
    rows: list[dict[str, str]] = []
    unnamed: dict[tuple[str, ...], str] = {}
    numbered = [(k, line.split()) for k, line in enumerate(text.splitlines(), 1) if line.strip()]
    for number, cells in numbered[1:]:
        if cells[0].startswith("#"):
            continue
        if len(cells) < 6:
            raise InputError(
                f"{len(cells)} columns", expected="x y z im_x im_y image [name]", where=f"{path}:{number}"
            )
        name = cells[6] if len(cells) > 6 else unnamed.setdefault(tuple(cells[:3]), f"gcp{len(unnamed) + 1}")
        keys = ("x", "y", "z", "x_px", "y_px", "image")
        rows.append({**dict(zip(keys, cells, strict=False)), "id": name})
    return rows


def gcp_points(path: Path, text: str) -> tuple[list[dict[str, str]], str]:
    """Points of a ``gcp_list.txt``, each once, and its CRS."""
    points: dict[str, dict[str, str]] = {}
    for row in gcp_rows(path, text):
        first = points.setdefault(row["id"], row)
        if any(first[a] != row[a] for a in "xyz"):
            raise InputError(
                f"two places of {row['id']}", expected="the same coordinates in each row", where=path
            )
    return list(points.values()), next(line for line in text.splitlines() if line.strip()).strip()


def _metashape(path: Path, text: str) -> ElementTree.Element:
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(
            f"no XML ({error})", expected="markers as Metashape exports them", where=path
        ) from error
    if root.find(".//markers") is None:
        raise InputError("no markers", expected="markers as Metashape exports them", where=path)
    return root


def metashape_points(path: Path, text: str, crs: str | None) -> tuple[list[dict[str, str]], str | None]:
    """Markers with reference coordinates, and the CRS that the file states, or ``crs``."""
    root = _metashape(path, text)
    rows = []
    for marker in root.iter("marker"):
        reference = marker.find("reference")
        if reference is None or reference.get("x") is None:
            continue
        row = {"id": marker.get("label", ""), **{a: reference.get(a, "") for a in "xyz"}}
        for axis, name in zip("xyz", ("east", "north", "up"), strict=True):
            row[f"sigma_{name}_m"] = reference.get(f"s{axis}") or reference.get("sxyz") or ""
        row["role"] = "control" if reference.get("enabled", "true") in ("true", "1") else "check"
        rows.append(row)
    places = (".//markers/../reference", ".//coordinate_system/wkt", ".//coordinate_system", ".//reference")
    stated = [element.text for place in places if (element := root.find(place)) is not None]
    found = next((t.strip() for t in stated if t and t.strip()), None)
    return rows, found or crs


def metashape_marks(path: Path, text: str) -> tuple[list[dict[str, str]], dict[str, int]]:
    """Marks that a person has placed, and how many the program has guessed."""
    root = _metashape(path, text)
    cameras = {c.get("id"): c.get("label", "") for c in root.iter("camera") if c.get("label")}
    labels = {m.get("id"): m.get("label", "") for m in root.iter("marker") if m.get("label")}
    rows, guessed = [], 0
    for marker in root.iter("marker"):
        for location in marker.findall("location"):
            if location.get("pinned", "true") not in ("true", "1"):
                guessed += 1
                continue
            camera, point = location.get("camera_id"), marker.get("marker_id")
            if camera not in cameras or point not in labels:
                raise InputError(
                    f"a mark of camera {camera} and marker {point}", expected="both in the file", where=path
                )
            rows.append({
                "image": cameras[camera], "point": labels[point],
                "x_px": location.get("x", ""), "y_px": location.get("y", ""),
            })  # fmt: skip
    return rows, {"placed by the program, not by a person": guessed} if guessed else {}
