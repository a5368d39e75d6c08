"""Damaged documents in JSON, YAML, XML and text end in a sentence, as damaged recordings do."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.calibration.test_field_description import GOOD as FIELD
from tests.core.test_calibration_imports import CHAIN, rows
from tests.images.test_control_tables import METASHAPE as MARKERS
from thalweg.budgets import read_budget
from thalweg.calibration import read_camera
from thalweg.calibration.field import read_facts, read_field
from thalweg.clocks import ClockModel
from thalweg.core import LocalFrame, ThalwegError, read_marked
from thalweg.core.calibration import read_kalibr, read_matrix
from thalweg.core.values import read_vectors
from thalweg.images import read_control_points, read_marks
from thalweg.ingest.ouster import describe_metadata
from thalweg.ingest.tracks import read_gpx
from thalweg.lightsheet.poses import read_standing_camera

MATRIX = "\n".join(" ".join(map(str, row)) for row in np.eye(4).tolist()) + "\n"
OPENCV = """%YAML:1.0
---
image_width: 752
image_height: 480
distortion_model: plumb_bob
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 458.6, 0., 367.2, 0., 457.2, 248.3, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.28, 0.07, 0.0002, 0.00002, 0. ]
"""
CLOCK = """thalweg_clock: 1
offset_s: 1.25
drift: 1.0e-06
reference_s: 100.0
cov: [[1.0e-06, 0.0], [0.0, 1.0e-12]]
sigma_jitter_s: null
source: ties
notes: [a, b]
"""
LENS = (
    '<?xml version="1.0" encoding="UTF-8"?><calibration><projection>frame</projection><width>4000</width>'
    "<height>3000</height><f>3000.5</f><cx>3.5</cx><cy>-2.5</cy><k1>0.01</k1><date>2026-05-11</date></calibration>"
)
GPX = '<?xml version="1.0"?><gpx version="1.1"><trk><trkseg>' + "".join(
    f'<trkpt lat="51.0{k}" lon="13.2{k}"><ele>1{k}</ele><time>2026-05-11T10:00:0{k}Z</time></trkpt>'
    for k in range(6)
) + "</trkseg></trk></gpx>"  # fmt: skip
GEOJSON = json.dumps(
    {
        "type": "FeatureCollection",
        "features": [
            {
                "type": "Feature",
                "properties": {"name": "left"},
                "geometry": {"type": kind, "coordinates": where},
            }
            for kind, where in (
                ("LineString", [[13.25, 51.05], [13.26, 51.06], [13.27, 51.07]]),
                ("Polygon", [[[13.25, 51.05], [13.26, 51.05], [13.26, 51.06], [13.25, 51.05]]]),
            )
        ],
    }
)
MARKED = json.dumps(
    {"kind": "mounts", "version": 1, "mounts": {"lidar": {"x_m": 1.0}, "camera": {"x_m": 2.0}}}
)
FACTS = json.dumps({"kind": "thalweg field", "version": 1, "points": 3, "notes": ["a"]})
STANDING = json.dumps(
    {
        "model": "perspective",
        "size_px": [4000, 3000],
        "parameters": dict.fromkeys(("fx", "fy", "cx", "cy", "k1", "k2", "k3", "p1", "p2"), 1.5),
    }
)
OUSTER = json.dumps(
    {"sensor_info": {"prod_line": "OS-0-128", "prod_sn": "1"}, "beam_intrinsics": {"a": [1, 2]}}
)
BUDGET = (Path(__file__).parents[2] / "resources/budgets/p2_table1.yaml").read_text(encoding="utf-8")
MARKS = "image,point,x,y\n" + "".join(f"IMG_{k}.JPG,A{k},{100 + k}.5,{200 + k}.25\n" for k in range(8))
CAMERAS = "# Camera list\n1 OPENCV 4000 3000 3000.5 3000.5 2000.0 1500.0 0.01 0.0 0.0 0.0\n"

FRAME = LocalFrame(lat_deg=50.5, lon_deg=13.7, h_ell_m=100.0)


def marked(path: Path) -> object:
    return read_marked(path, "mounts", kind="mounts", version=1, what="mounts", cure="Make it")


READERS: dict[str, tuple[str, str, Callable[[Path], Any]]] = {
    "matrix": ("a.txt", MATRIX, read_matrix),
    "kalibr": ("a.yaml", CHAIN.format(first=rows(np.eye(4)), second=rows(np.eye(4))), read_kalibr),
    "opencv": ("a.yaml", OPENCV, read_camera),
    "lens": ("a.xml", LENS, read_camera),
    "cameras": ("cameras.txt", CAMERAS, read_camera),
    "field": ("a.yaml", FIELD, read_field),
    "budget": ("a.yaml", BUDGET, read_budget),
    "clock": ("a.yaml", CLOCK, ClockModel.read),
    "marked": ("a.json", MARKED, marked),
    "facts": ("a.json", FACTS, read_facts),
    "standing": ("a.json", STANDING, read_standing_camera),
    "ouster": ("a.json", OUSTER, describe_metadata),
    "map": ("a.geojson", GEOJSON, read_vectors),
    "track": ("a.gpx", GPX, lambda path: read_gpx([path])),
    "markers": (
        "a.xml",
        MARKERS.format(*(f"{v:.4f}" for v in (4.1e5, 5.6e6, 99, 4.1e5, 5.6e6, 98))),
        read_marks,
    ),
    "points": (
        "a.xml",
        MARKERS.format(*(f"{v:.4f}" for v in (4.1e5, 5.6e6, 99, 4.1e5, 5.6e6, 98))),
        lambda path: read_control_points(path, FRAME, crs="EPSG:25833", sigma_m=(0.02, 0.02, 0.02)),
    ),
    "marks": ("a.csv", MARKS, read_marks),
}
"""Name of the file, what it holds, and who reads it."""
WORDS = (
    *(
        "null",
        "[]",
        "{}",
        '""',
        "true",
        "-1",
        "0",
        "1e999",
        "1e-999",
        "nan",
        "NaN",
        "Infinity",
        "9" * 400,
        '"a"',
    ),
    *("~", "a: b", "<!--", "]]>", "&#0;", "&b;", "*a", "&a", "!!int", "!!python/object:os.system", "<<: *a"),
    *(
        "[" * 3000,
        "{" * 3000,
        '{"a":' * 3000,
        "<a>" * 3000,
        "2026-13-40T99:99:99Z",
        "%s%n",
        "../../etc/passwd",
    ),
    *("\t", "\x00", "\ud7ff", "\r", "\ufeff", "0x1F", "1_000", "\u0661"),
)
"""What stands in the place of a word or a number."""


def misused(data: bytes, rng: np.random.Generator) -> bytes:
    """A text with another word or two in the place of one, or with damaged bytes."""
    text = data.decode()
    for _ in range(int(rng.integers(1, 3))):
        places = list(re.finditer(r"[\w.+-]+|\"[^\"]*\"|[\[\]{}:,<>=/]", text))
        if places:
            place = places[int(rng.integers(len(places)))]
            text = text[: place.start()] + WORDS[int(rng.integers(len(WORDS)))] + text[place.end() :]
    return text.encode("utf-8", "surrogatepass")


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", READERS)
def test_fuzz_of_documents(name, fuzz, tmp_path):
    """Right or refused in our words, within 10 s and 2 GB; never another error."""
    file, text, read = READERS[name]
    path = tmp_path / file
    read(_written(path, text.encode()))  # the sound one
    n = max(fuzz.count // 4, 1)
    for by in (misused, None):
        for data in fuzz.inputs(text.encode(), by=by, count=n):
            _written(path, data)
            try:
                read(path)
            except ThalwegError as error:
                told = str(error)
                assert str(path.name) in told or "line" in told, told
                assert len(told) < 3000, told
                assert not re.search(r"b'\\x|b\"\\x|GEOGCRS\[|PROJCRS\[|GEOGCS\[|PROJCS\[", told), told
                continue
            fuzz.was_read()


def _written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path
