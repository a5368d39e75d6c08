"""Beds that rise in mid-river, rivers that flow uphill, shores below bed or water: asked, not refused."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pyproj
import pytest
import shapely

from thalweg.bathymetry import read_soundings
from thalweg.bathymetry.signs import asked_of_lake, asked_of_river, asked_of_shores
from thalweg.bathymetry.tables import water_of
from thalweg.cli import main
from thalweg.core import InputError
from thalweg.core.values import read_vectors
from thalweg.settings.sections import Bathymetry

UTM33 = pyproj.CRS.from_epsg(32633)
HALF_M = 10.0


def half_widths(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A river 20 m wide."""
    return np.full(len(s), HALF_M), np.full(len(s), HALF_M)


def river(seed: int, bed: str, *, shore_m: float = 100.0, shore_rise: float = 0.0) -> pd.DataFrame:
    """A zigzag over 300 m of a river between two shores, noise 3 cm."""
    rng = np.random.default_rng(seed)
    s = np.arange(0.0, 300.0, 0.8)
    n = 9.0 * (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * s / 25))
    up = {
        "bowl": 98.5 - 0.015 * (HALF_M**2 - n**2) - 0.001 * s,
        "depths": 1.5 + 0.015 * (HALF_M**2 - n**2),
        "one side": 97.5 - 0.1 * n - 0.004 * n**2,
        "bends": 97.5 - 0.1 * n * np.sin(s / 30) - 0.002 * n**2,
        "island": 97.0 + 0.01 * n**2 + 2.0 * np.exp(-((n / 3) ** 2)) * (np.abs(s - 150) < 40),
        "weir": 97.0 + 0.01 * n**2 + 1.5 * np.exp((s - 300) / 25),
        "flat": np.full(len(s), 97.0),
        "uphill": 97.0 + 0.01 * n**2 + 0.01 * s,
    }[bed] + rng.normal(0, 0.03, len(s))
    sounded = pd.DataFrame({"source": "sounding", "s_m": s, "n_m": n, "up_m": up, "sigma_white_m": 0.03})
    at = np.arange(0.0, 300.0, 5.0)
    shores = [
        pd.DataFrame(
            {
                "source": "bank",
                "s_m": at,
                "n_m": side * HALF_M,
                "up_m": shore_m + shore_rise * at + rng.normal(0, 0.05, len(at)),
                "sigma_white_m": 0.15,
            }
        )
        for side in (-1, 1)
    ]
    return pd.concat([sounded, *shores], ignore_index=True)


@pytest.mark.parametrize("seed", [71, 72, 73])
@pytest.mark.parametrize("bed", ["bowl", "one side", "bends", "island", "weir", "flat"])
def test_rivers_as_they_are_raise_no_question(bed, seed):
    """A thalweg at one bank, one that changes sides, an island, a weir, a plane."""
    table = river(seed, bed)
    assert asked_of_river(table, half_widths, depths=False) == []
    assert asked_of_shores(table, 100.3) == []


def test_a_river_that_flows_uphill_is_asked_about():
    """By its shores, or by its bed; depths below one level tell no fall."""
    by_shores = asked_of_river(river(75, "bowl", shore_rise=0.002), half_widths, depths=False)
    assert len(by_shores) == 1
    assert "the banks rise 0.51 m over 280 m" in by_shores[0]
    by_bed = asked_of_river(river(76, "uphill"), half_widths, depths=False)
    assert "the bed rises 2." in by_bed[0]
    assert asked_of_river(river(76, "uphill"), half_widths, depths=True) == []


@pytest.mark.parametrize(
    ("risen", "lean_m", "asked"), [(10, 0.1, "heights"), (9, 0.1, ""), (10, 0.31, ""), (10, 0.29, "depths")]
)
def test_thirds_of_stretches_by_hand(risen, lean_m, asked):
    """Eleven stretches of 30 m, 10 m wide to the left and 20 m to the right: one in 171 has ten by chance,
    one in 31 nine. The middle rises by 0.3 m over sides that lean, in one stretch each by 9 m.
    """
    rows = [
        {"source": "sounding", "s_m": 1e3 + 30 * k + at, "n_m": n, "up_m": 95.0 + up}
        for k in range(11)
        for at in (0.0, 29.9)
        for n, up in (
            (4.0, (9.0 if k == 4 else lean_m)),
            (-7.0, -(9.0 if k == 4 else lean_m)),
            (3.0, 0.3 if k < risen else -9.0),
            (-6.0, 0.3 if k < risen else -9.0),
        )
    ]
    found = asked_of_river(
        pd.DataFrame(rows),
        lambda s: (np.full(len(s), 10.0), np.full(len(s), 20.0)),
        depths=asked == "heights",
    )
    assert found == bool(asked) * [
        "the bed rises in mid-river: in 10 of 11 stretches the middle is above the sides, by 0.30 m in the "
        f"median. Are these {asked}? Then --{asked[:-1]}; bars all along the river look alike"
    ]


def test_shores_below_the_bed_or_the_water_are_asked_about():
    low = asked_of_shores(river(77, "bowl", shore_m=97.6), None)
    assert len(low) == 1
    assert "of the soundings lie above the shore beside them" in low[0]
    drowned = asked_of_shores(river(78, "bowl"), 101.4)
    assert drowned[0].startswith("the water stands 1.4")


def test_a_lake_that_is_deepest_at_its_shores_is_asked_about():
    rng = np.random.default_rng(79)
    xy = rng.uniform(-50, 50, (400, 2))
    outline = shapely.box(-52, -52, 52, 52)
    inside = 52 - np.abs(xy).max(axis=1)
    assert asked_of_lake(outline, xy, 95.0 - 0.1 * inside, depths=False) == []
    assert "--depth" in asked_of_lake(outline, xy, 1.0 + 0.1 * inside, depths=False)[0]
    assert asked_of_lake(outline, xy, rng.normal(95, 1, 400), depths=False) == []


def geojson(path: Path, epsg: int | None, shapes: list[dict], properties: list[dict]) -> Path:
    features = [
        {"type": "Feature", "properties": p, "geometry": g} for g, p in zip(shapes, properties, strict=True)
    ]
    stated = (
        {"crs": {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{epsg}"}}} if epsg else {}
    )
    path.write_text(json.dumps({"type": "FeatureCollection", **stated, "features": features}))
    return path


def points_in(epsg: int) -> tuple[list[dict], list[dict]]:
    """Soundings near 15.001 E, 48.75 N, in a zone of UTM."""
    table = river(80, "bowl").iloc[:375]
    east, north = 500_000.0 + table["s_m"], 5_400_000.0 + table["n_m"]
    x, y = pyproj.Transformer.from_crs(32633, epsg, always_xy=True).transform(east, north)
    shapes = [{"type": "Point", "coordinates": list(place)} for place in zip(x, y, strict=True)]
    return shapes, [{"h": float(h)} for h in table["up_m"]]


def test_a_file_that_states_another_map_than_the_user_gets_a_word(tmp_path):
    """Places of zone 32 come onto zone 33 with a note; those of Argentina are refused."""
    path = geojson(tmp_path / "zone32.geojson", 32632, *points_in(32632))
    how = {"column": "h", "depth": False, "level_m": None, "line_column": None, "sigma_m": 0.03}
    found = read_soundings(path, UTM33, **how)
    told = "zone32.geojson states WGS 84 / UTM zone 32N: its places were transformed to WGS 84 / UTM zone 33N"
    assert told in found.notes
    assert np.median(found.places_m[:, 0]) == pytest.approx(500_150.0, abs=1.0)
    same = read_soundings(geojson(tmp_path / "zone33.geojson", 32633, *points_in(32633)), UTM33, **how)
    assert not any("transformed" in note for note in same.notes)
    shapes = [{"type": "Point", "coordinates": [5_596_816.0 + 9 * k, 6_189_399.0 + k**2]} for k in range(9)]
    far = geojson(tmp_path / "far.geojson", 22175, shapes, [{"h": 2.0 + k} for k in range(9)])
    with pytest.raises(InputError, match=r"which states POSGAR 98 / Argentina 5.*campaign.crs: without it"):
        read_soundings(far, UTM33, **how)
    lines = [{"type": "LineString", "coordinates": [[500_000.0 + k, 5_400_000.0] for k in range(3)]}]
    drawn = read_vectors(geojson(tmp_path / "bank.geojson", 25833, lines, [{}])).on_map(UTM33)
    assert "bank.geojson states ETRS89 / UTM zone 33N: its places were" in drawn.notes[-1]


def test_a_level_far_from_the_heights_of_an_outline_is_asked_about(tmp_path):
    ring = [[0, 0], [90, 0], [90, 80], [0, 80], [0, 0]]
    corners = [[500_000.0 + x, 5_400_000.0 + y, 52.0] for x, y in ring]
    outline = geojson(tmp_path / "o.geojson", 32633, [{"type": "Polygon", "coordinates": [corners]}], [{}])
    rng = np.random.default_rng(81)
    xy = rng.uniform(10, 70, (60, 2)) + np.array([500_000.0, 5_400_000.0])
    table = pd.DataFrame({"east": xy[:, 0], "north": xy[:, 1], "h": rng.normal(48, 0.5, 60)})
    table.to_csv(tmp_path / "t.csv", index=False)
    soundings = read_soundings(
        tmp_path / "t.csv", UTM33, column="h", depth=False, level_m=None, line_column=None, sigma_m=0.03
    )
    for level, asked in ((52.2, False), (55.0, True)):
        found = water_of(soundings, UTM33, Bathymetry(), banks=outline, level_m=level)
        assert any("lies 3.0 m above the outline" in note for note in found.notes) is asked


def test_the_command_asks_in_its_output_and_in_its_report(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("thalweg.figures.save", lambda *_: None)
    monkeypatch.setattr("thalweg.bathymetry.variogram._STEPS", 12)
    table = river(82, "depths").iloc[:375]
    pd.DataFrame(
        {"east": 500_000.0 + table["s_m"], "north": 5_400_000.0 + table["n_m"], "z": table["up_m"]}
    ).to_csv(tmp_path / "t.csv", index=False)
    words = ["--crs", "EPSG:32633", "--height", "z", "--cell", "4", "--model", "matern32", "--drift", "none"]
    assert main(["bed", str(tmp_path / "t.csv"), *words, "--out", str(tmp_path / "o")]) == 0
    assert "note: the bed rises in mid-river" in capsys.readouterr().out
    notes = json.loads((tmp_path / "o" / "validation.json").read_text())["notes"]
    assert any("Are these depths? Then --depth" in note for note in notes)
