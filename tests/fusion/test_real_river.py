"""A real stream from its soundings to sections, volume and mesh (River Bottom Interpolator, Lujan).

170 soundings on 15 sections over 1.05 km, 24 m wide. The set has no water level: 3.0 m, which leaves some
bars dry, stands for one.
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pyproj import CRS, Transformer
from scipy.spatial import cKDTree

from thalweg.bathymetry import FlowLine, read_bank_lines
from thalweg.cli import main
from thalweg.core import LocalFrame
from thalweg.fusion import River, build_dtm, cut_sections, depths_along, export_river, long_profile, water_of
from thalweg.settings.sections import Fusion

GRID = CRS("EPSG:22175")
LEVEL_M = 3.0


def in_local_frame(line: FlowLine, path: Path) -> River:
    """The river of a map as the terrain model takes it: in a local frame."""
    lon, lat = Transformer.from_crs(GRID, 4326, always_xy=True).transform(*line.points_m.mean(axis=0))
    frame = LocalFrame(lat_deg=float(lat), lon_deg=float(lon), h_ell_m=0.0)

    def local(xy: np.ndarray) -> np.ndarray:
        return frame.from_map(np.column_stack([xy, np.full(len(xy), LEVEL_M)]), GRID)

    flow = FlowLine.through(local(line.points_m)[:, :2])
    shores, _ = read_bank_lines(path, GRID, line, None, (np.zeros((0, 2)), np.zeros(0)))
    s = np.arange(5.0, line.length_m - 5.0, 5.0)
    left, right = shores.half_widths_m(s)
    known = np.isfinite(left) & np.isfinite(right)
    tables = []
    for side, n in (("left", left), ("right", -right)):
        places = local(line.to_map(s[known], n[known]))
        tables.append(
            pd.DataFrame(
                {
                    "side": side,
                    "s_m": flow.to_flow(places[:, :2])[0],
                    "east_m": places[:, 0],
                    "north_m": places[:, 1],
                    "up_m": places[:, 2],
                    "sigma_across_m": 0.5,
                    "seen": True,
                }
            )
        )
    return River(flow=flow, banks=pd.concat(tables, ignore_index=True), frame=frame, crs=GRID)


@pytest.mark.real
def test_a_real_stream_becomes_sections_volume_and_mesh(data_dir, tmp_path, monkeypatch):
    monkeypatch.setattr("thalweg.figures.save", lambda *_: None)  # nobody looks at the bed's picture
    folder = data_dir / "river_bottom_interpolator" / "Lujan"
    points = json.loads((folder / "elevation_points.geojson").read_text())["features"]
    xyz = np.array([[*f["geometry"]["coordinates"][:2], f["properties"]["z"]] for f in points])
    pd.DataFrame(xyz, columns=["x", "y", "z"]).to_csv(tmp_path / "t.csv", index=False)
    lines = json.loads((folder / "cross_sections.geojson").read_text())["features"]
    lines.sort(key=lambda f: f["properties"]["s"])
    courses = [np.array(f["geometry"]["coordinates"]).reshape(-1, 2) for f in lines]
    features = [
        {
            "type": "Feature",
            "properties": {},
            "geometry": {"type": "LineString", "coordinates": [c[end].tolist() for c in courses]},
        }
        for end in (0, -1)
    ]
    banks = tmp_path / "banks.geojson"
    banks.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    words = ["--crs", "EPSG:22175", "--height", "z", "--cell", "1", "--banks", str(banks)]
    words += ["--model", "exponential", "--drift", "section_width", "--out", str(tmp_path / "bed")]
    assert main(["bed", str(tmp_path / "t.csv"), *words]) == 0

    river = in_local_frame(FlowLine.read(tmp_path / "bed/centre_line.csv"), banks)
    settings = Fusion.model_validate(
        {"sections": {"spacing_m": 8.0, "overbank_m": 0.0}, "fill": "interpolate", "mesh": {"edge_m": 4.0}}
    )
    model = build_dtm(tmp_path / "bed/bed.tif", {}, river.outline_m(), river.frame, settings)
    sections = cut_sections(model, river, settings)
    assert len(sections) > 100

    # areas of the measured sections by the trapezoid rule through their soundings
    s, n, _ = river.to_flow(xyz[:, :2])
    number = np.arange(len(xyz))
    for a, b in cKDTree(xyz[:, :2]).query_pairs(15.0):
        number[number == number[max(a, b)]] = number[min(a, b)]
    measured, modelled = [], []
    for k in np.unique(number):
        of = np.flatnonzero(number == k)[np.argsort(n[number == k])]
        near = min(sections, key=lambda section: abs(section.s_m - float(np.median(s[of]))))
        # between the outermost soundings of the section that lie in the water of the model
        inside = (n[of] > near.right_m) & (n[of] < near.left_m)
        if inside.sum() < 5 or abs(near.s_m - np.median(s[of])) > 5.0:
            continue
        at, depth = n[of][inside], LEVEL_M - xyz[of][inside, 2]
        there = LEVEL_M - np.interp(at, near.n_m, near.height_m)
        measured.append(np.trapezoid(depth, at))
        modelled.append(np.trapezoid(there, at))
    assert len(measured) >= 10
    ratio = np.array(modelled) / np.array(measured)
    assert np.sum(modelled) == pytest.approx(np.sum(measured), rel=0.05)
    assert np.median(np.abs(ratio - 1)) < 0.1

    _, water = water_of(model, river, settings)
    profile = long_profile(sections)
    assert water["without_height_m2"] == 0
    # bars stand out of the water: only what is below the level counts
    areas = [
        np.trapezoid(np.maximum(section.level_m - section.height_m, 0.0)[wet], section.n_m[wet])
        for section in sections
        for wet in [(section.n_m >= section.right_m) & (section.n_m <= section.left_m)]
    ]
    # in bends the outer half is longer than the centre line, which the sections do not know
    assert water["volume_m3"] == pytest.approx(np.trapezoid(areas, profile["s_m"]), rel=0.06)
    assert 0.005 < water["sigma_volume_m3"] / water["volume_m3"] < 0.3
    # deeper where narrower, as Krüger and others and P1 find on other rivers
    found = depths_along(profile)
    assert found["deeper_where_narrower"]

    facts = export_river(tmp_path / "exports", model, river, sections, settings)
    assert not facts["not_written"]
    assert facts["mesh"]["least_angle_deg"] >= 20
    assert facts["mesh"]["folded"] == 0
