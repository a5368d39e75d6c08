"""Files that others made: soundings as text and GeoJSON, reference beds, recordings of real boats."""

import datetime as dt
import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from pyproj import CRS

from tests.conftest import check_whole
from thalweg.bathymetry import Transducer, against_reference, locate_soundings, read_other_soundings
from thalweg.bathymetry.banks import axis_of_track
from thalweg.core import GeometryError, Grid, InputError, LazWriter, LocalFrame, Trajectory, write_raster
from thalweg.figures.bathymetry.page import _beside, _surroundings
from thalweg.ingest.nmea import read_nmea
from thalweg.ingest.registry import read_positions
from thalweg.navigation.ins_gnss import PoseCorrelation, build_trajectory, states_along_course, with_stated
from thalweg.settings.sections import Bathymetry, EchoSounder

FRAME = LocalFrame(lat_deg=51.05, lon_deg=13.25, h_ell_m=300.0)
UTM = CRS("EPSG:25833")
CORNER = FRAME.to_map(np.zeros((1, 3)), UTM)[0]


# ---------------------------------------------------------------- soundings


def test_text_and_geojson_are_the_same_soundings_as_csv(tmp_path):
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(np.arange(0.0, 40.0, 2.0), (0.0, 10.0))
    xyz = CORNER + np.column_stack([x.ravel(), y.ravel(), -1 - rng.uniform(size=x.size)])
    table = pd.DataFrame(xyz.round(3), columns=["x", "y", "z"])
    table.to_csv(tmp_path / "a.csv", index=False)
    table.to_csv(tmp_path / "a.xyz", index=False, header=False, sep=" ")
    points = [
        {
            "type": "Feature",
            "properties": {"z": z},
            "geometry": {"type": "Point", "coordinates": [east, north]},
        }
        for east, north, z in table.to_numpy().tolist()
    ]
    collection = {"type": "FeatureCollection", "features": points}
    (tmp_path / "a.geojson").write_text(json.dumps(collection))
    found = [
        read_other_soundings([tmp_path / f"a.{kind}"], FRAME, UTM, Bathymetry())
        for kind in ("csv", "xyz", "geojson")
    ]
    assert len(found[0]) == len(table)
    assert found[0]["up_m"].to_numpy() == pytest.approx(xyz[:, 2] - CORNER[2], abs=2e-3)
    for other in found[1:]:
        pd.testing.assert_frame_equal(other, found[0])


# ---------------------------------------------------------------- reference beds


@pytest.fixture(scope="module")
def bed(tmp_path_factory):
    """A bed of 40 x 20 m that errs by 5 cm where 5 cm are foretold, and the true heights of its cells."""
    path = tmp_path_factory.mktemp("bed") / "bed.tif"
    grid = Grid.around(CORNER[None, :2] + np.array([[0.0, 0.0], [40.0, 20.0]]), 1.0, UTM, margin_m=0.0)
    centres = grid.centres_m()
    true = CORNER[2] - 1.0 - 0.01 * (centres[:, 0] - CORNER[0])
    rng = np.random.default_rng(2)
    bands = {
        "height_m": true + 0.05 * rng.standard_normal(len(true)),
        "sigma_m": np.full(len(true), 0.05),
        "sigma_common_m": np.full(len(true), 0.01),
        "distance_m": np.tile([0.5, 3.0], len(true))[: len(true)],
    }
    write_raster(path, grid, bands, tags={})
    return path, np.column_stack([centres, true])


def cloud(path: Path, points: np.ndarray, frame: Any) -> Path:
    with LazWriter(path, frame) as writer:
        writer.append(points)
    return path


def test_a_reference_cloud_is_averaged_by_cells(bed, tmp_path):
    path, true = bed
    rng = np.random.default_rng(3)
    several = np.repeat(true, 4, axis=0)
    several[:, :2] += rng.uniform(-0.3, 0.3, (len(several), 2))
    several[:, 2] += 0.05 * rng.standard_normal(len(several))
    settings = Bathymetry(table={"sigma_m": 0.05, "sigma_common_m": 0.0})
    for name, frame in (("flat.laz", UTM), ("with_heights.las", CRS("EPSG:25833+7837"))):
        found = against_reference(path, [cloud(tmp_path / name, several, frame)], UTM, settings)[name]
        assert found["n"] == len(true)
        # 5 cm of the bed; 5 cm of four points in a cell
        assert found["rmse_m"] == pytest.approx(np.hypot(0.05, 0.025), rel=0.08)
        # sigma: 5.1 cm of the bed, 2.5 cm of the reference
        assert found["normalised_square"] == pytest.approx(0.056**2 / (0.051**2 + 0.025**2), rel=0.15)
        assert len(found["classes"]) == 2
        rows = _beside(found)
        assert rows["n"].tolist()[0] == rows["n"].iloc[1:].sum() == len(true)


@pytest.mark.parametrize(
    ("frame", "words"), [(FRAME, "a local frame"), (CRS("EPSG:25832"), "ETRS89 / UTM zone 32N")]
)
def test_a_reference_cloud_of_another_system_is_refused(frame, words, bed, tmp_path):
    path, true = bed
    points = true - CORNER if isinstance(frame, LocalFrame) else true
    with pytest.raises(InputError, match=words) as told:
        against_reference(path, [cloud(tmp_path / "other.laz", points, frame)], UTM, Bathymetry())
    check_whole(told.value)
    assert "Transform it to campaign.crs" in str(told.value)


def test_a_reference_raster_of_another_system_is_refused(bed, tmp_path):
    grid = Grid.around(np.array([[5e5, 5e6], [5.0001e5, 5.0001e6]]), 5.0, CRS("EPSG:25832"), margin_m=0.0)
    write_raster(tmp_path / "a.tif", grid, {"h": np.ones(grid.rows * grid.columns)}, tags={})
    with pytest.raises(InputError, match="a raster in ETRS89 / UTM zone 32N") as told:
        against_reference(bed[0], [tmp_path / "a.tif"], UTM, Bathymetry())
    check_whole(told.value)


def test_the_page_says_how_the_cloud_of_the_surroundings_lies():
    assert _surroundings({"fitted": False, "why": "no cloud (logs.uav)"}) == "No cloud (logs.uav)."
    fit = {
        "fitted_shift_m": [0.02, -0.03, 0.05],
        "sigma_shift_m": [0.01, 0.01, 0.004],
        "cells": 900,
        "blocks": 12,
        "median_before_m": 0.06,
        "median_after_m": 0.001,
        "spread_after_m": 0.03,
        "undetermined": [],
    }
    words = _surroundings(fit)
    assert "+2.0 ± 1.0, -3.0 ± 1.0, +5.0 ± 0.4 cm east, north and up" in words
    assert "+6.0 cm in the median before and +0.1 cm after" in words
    assert "left alone" not in words
    held = fit | {"undetermined": ["shift along (east 1.00)"], "sigma_left_alone_m": 0.1}
    assert "left alone: shift along (east 1.00); each may move its points by 10.0 cm" in _surroundings(held)


# ---------------------------------------------------------------- recordings of real boats


def of_boat(path: Path, date: dt.date | None = None) -> tuple[pd.DataFrame, dict[str, Any], Trajectory]:
    """Soundings of a recording with depths and positions, as a survey without an INS makes them."""
    log = read_nmea([path], date)
    positions, _ = read_positions(
        "nmea", [path], states=None, date=date, base=[], nav=[], ppk={}, base_position={}
    )
    frame = LocalFrame(
        lat_deg=float(positions["lat_deg"].iloc[0]), lon_deg=float(positions["lon_deg"].iloc[0]), h_ell_m=0.0
    )
    measured = with_stated(positions, sigma_position_m=(3.0, 3.0, 5.0), antenna_h_ell_m=2.0)
    how = {"accept_fixes": sorted(set(measured["fix"])), "max_gap_s": 2.5}
    states = states_along_course(measured, frame, **how, sigma_level_deg=2.0, sigma_course_deg=5.0)
    trajectory, _ = build_trajectory(
        measured,
        states,
        frame,
        lever_ics_antenna_m=(0.0, 0.0, -2.0),
        sigma_lever_m=(0.1, 0.1, 0.1),
        sigma_attitude_rad=np.deg2rad([2.0, 2.0, 5.0]),
        max_attitude_gap_s=2.5,
        **how,
    )
    table, facts = locate_soundings(
        log.depths,
        trajectory,
        PoseCorrelation(position_s=60.0, attitude_s=20.0, white_share=0.1, receiver_s=1.0),
        Transducer(lever_ics_m=np.array([0.0, 0.0, 0.5]), cov_m2=0.01 * np.eye(3)),
        EchoSounder(),
        Bathymetry(),
        water_line_ics_m=0.0,
    )
    return table, facts, trajectory


def test_depths_of_a_powerboat_and_of_a_yacht(data_dir):
    """Every sentence is a sounding or has a reason; depths are those of gpsd's figures (PROVENANCE.md)."""
    folder = data_dir / "nmea_gpsd_depth"
    table, facts, _ = of_boat(folder / "humminbird-M37.log")
    assert facts["pings"] == sum(facts["by_reason"].values()) == 33
    assert facts["by_reason"]["no time"] == 1
    used = table[table["used"]]
    assert len(used) >= 30
    assert 2.0 <= used["range_m"].min() < used["range_m"].max() <= 2.6
    # half a metre below the water line, level boat
    assert (used["depth_m"] - used["range_m"]).to_numpy() == pytest.approx(0.5, abs=1e-6)
    table, facts, _ = of_boat(folder / "bundg_zeus_9.log")
    # DPT and DBT of the same pings: one of them counts
    assert (facts["pings"], facts["of_other_sentences"]) == (149, 148)
    assert facts["by_reason"][""] >= 140
    assert table.loc[table["used"], "range_m"].between(5.2, 6.7).all()
    # sigmas of a receiver without a base
    assert (table.loc[table["used"], "sigma_slow_m"] > 3.0).all()


def test_a_boat_at_rest_without_a_date_is_refused_with_a_reason(data_dir):
    path = data_dir / "nmea_gpsd_depth" / "sounder.log"
    with pytest.raises(InputError, match="0 usable positions of 122"):
        of_boat(path)
    # with a date it has soundings, but no river: the boat does not move
    table, facts, trajectory = of_boat(path, dt.date(2012, 1, 19))
    assert facts["by_reason"]["no time"] == 1
    assert table.loc[table["used"], "range_m"].between(2.3, 2.5).all()
    with pytest.raises(GeometryError, match=r"logs\.centre_line"):
        axis_of_track(trajectory.position_wcs_m[trajectory.valid][:, :2])
