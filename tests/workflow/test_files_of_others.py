"""Soundings, a reference bed and a cloud from the air that others made, through the rules of bed and model.

The survey is that of the tiny campaign; what its rules made before the bed is copied. The files of others are
written from the twin's true ground, so that it is known what must come out.
"""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from pyproj import CRS

from tests.bands import band
from thalweg.bathymetry import OBSERVATIONS
from thalweg.core import LocalFrame, read_raster, read_table, write_raster
from thalweg.figures import SKY
from thalweg.figures.bathymetry.pictures import draw_bed_map
from thalweg.fusion import SOURCE_WORDS, Source, joined_parts
from thalweg_lab.instruments import simulate_uav
from thalweg_lab.settings import TwinConfig
from thalweg_lab.truth import true_bed_m

pytestmark = pytest.mark.workflow

SIGMA_M = 0.03
"""Noise of the soundings of others, and of the reference."""
SEED = 11
"""That of the tiny campaign: the river comes from it."""
UAV = {"spacing_m": 0.4, "sigma_shift_m": (0.05, 0.05, 0.15)}
SAME = ("soundings.parquet", "soundings.json", "banks.csv", "centre_line.csv", "water_level.json")
COPIED = {f"bathymetry/{name}": f"bathymetry/{name}" for name in SAME} | {
    "lidar/by_fused/points.laz": "lidar/points.laz",
    "orientation/trajectory_fused.parquet": "orientation/trajectory.parquet",
    "orientation/error_model.json": "orientation/error_model.json",
}
"""Of the tiny campaign, and what the one with files of others calls it."""


def write_files(folder: Path, tiny: Path, frame: LocalFrame, crs: CRS, twin: TwinConfig) -> None:
    """Sections of soundings between the boat's legs, the true bed as raster, what a drone sees as cloud."""
    rng, scene = np.random.default_rng(5), tiny / "simulation/truth/scene.npz"
    grid, bands, _ = read_raster(tiny / "bathymetry/bed.tif")
    known = np.isfinite(bands["height_m"].ravel())
    centres = grid.centres_m()
    local = frame.from_map(np.column_stack([centres, np.full(len(centres), frame.h_ell_m)]), crs)

    def on_map(places: np.ndarray, up_m: np.ndarray) -> np.ndarray:
        return frame.to_map(np.column_stack([places, up_m]), crs)

    true = np.full(len(centres), np.nan)
    true[known] = true_bed_m(scene, local[known, :2])
    seen = np.isfinite(true)
    height = np.full(len(centres), np.nan)
    height[seen] = on_map(local[seen, :2], true[seen])[:, 2]
    noise = SIGMA_M * rng.standard_normal(len(centres))
    write_raster(folder / "multibeam.tif", grid, {"height_m": height + noise}, tags={})
    # every fourteenth column of cells, 7 m, half a metre apart along it
    column = np.arange(len(centres)) % grid.columns
    taken = seen & (column % 14 == 3)
    table = pd.DataFrame(centres[taken], columns=["east", "north"])
    table["height"] = height[taken] + SIGMA_M * rng.standard_normal(taken.sum())
    table["section"] = column[taken]
    table.to_csv(folder / "others.csv", index=False, float_format="%.4f")
    simulate_uav(
        twin, SEED, frame, scene, folder / "air.laz", crs=crs.to_string(), out_effects=folder / "air.json"
    )


@pytest.fixture(scope="module")
def others(tiny_house):
    """Folders of results of the tiny campaign and of the one with files of others."""
    root = tiny_house.root
    tiny, ours = root / "results/tiny", root / "results/others"
    for name, copy in COPIED.items():
        (ours / copy).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(tiny / name, ours / copy)
    campaign: dict[str, Any] = yaml.safe_load((root / "config/campaigns/tiny.yaml").read_text())
    place = {key: campaign["campaign"][key] for key in ("crs", "origin")}
    frame, crs = LocalFrame(**place["origin"]), CRS.from_user_input(place["crs"])
    files = root / "files_of_others"
    files.mkdir()
    twin = TwinConfig(**campaign["twin"] | {"uav": UAV})
    write_files(files, tiny, frame, crs, twin)
    recorded = tiny / "simulation/logs"
    logs = {"ins": "ins.anpp", "positions": "ppk.pos", "lidar": "lidar.pcap", "depth": "echo.nmea"}
    settings = {
        "campaign": {"id": "others", "title": "Files of others", "seed": 1} | place,
        "logs": {key: [str(recorded / name)] for key, name in logs.items()}
        | {
            "soundings": [str(files / "others.csv")],
            "reference_bed": [str(files / "multibeam.tif")],
            "uav": [str(files / "air.laz")],
        },
        "mounts": {key: campaign["mounts"][key] for key in ("lidar", "antenna", "echo_sounder")},
        "orientation": {"position_source": "pos"},
        "bathymetry": {"table": {"column": "height", "line_column": "section", "sigma_m": SIGMA_M}}
        | {"drift": "fall", "model": "matern32"},  # as `tiny` chooses
    }
    path = root / "config/campaigns/others.yaml"
    path.write_text(yaml.safe_dump(settings))
    made = ("bathymetry/validation.json", "fusion/dtm.tif", "fusion/fit.json")
    tiny_house.snakemake(
        *(f"results/others/{name}" for name in made),
        *("--config", "campaign=others", "--allowed-rules", "krige_bed", "validate_bed", "build_dtm"),
    )
    path.unlink()
    yield tiny, ours
    # other tests of the tiny campaign look at what is there
    shutil.rmtree(ours)
    shutil.rmtree(files)


def errors_m(folder: Path, tiny: Path) -> np.ndarray:
    """Differences of the bed from the reference, cell by cell."""
    grid, bands, _ = read_raster(folder / "bathymetry/bed.tif")
    height = bands["height_m"].ravel()
    truth, of = read_raster(tiny.parents[1] / "files_of_others/multibeam.tif")[:2]
    row, column = truth.at(grid.centres_m())
    inside = (row >= 0) & np.isfinite(height)
    return height[inside] - of["height_m"][row[inside], column[inside]]


def test_soundings_of_others_make_the_bed_better(others):
    tiny, ours = others
    data = read_table(ours / "bathymetry/observations.parquet", OBSERVATIONS)[0]
    told = pd.read_csv(tiny.parents[1] / "files_of_others/others.csv")
    assert (data["source"] == "table").sum() == len(told) > 100
    before, after = (errors_m(folder, tiny) for folder in (tiny, ours))
    assert np.sqrt(np.nanmean(after**2)) < 0.8 * np.sqrt(np.nanmean(before**2))


def test_the_reference_bed_judges_the_bed(others):
    tiny, ours = others
    found = json.loads((ours / "bathymetry/validation.json").read_text())["reference"]["multibeam.tif"]
    errors = errors_m(ours, tiny)
    assert found["n"] == np.isfinite(errors).sum() > 1000
    assert found["rmse_m"] == pytest.approx(np.sqrt(np.nanmean(errors**2)), rel=1e-3)
    # One observation: soundings every few metres leave some three dozen places that err by themselves. The
    # guard is `bed_study`, of 40 rivers.
    low, high = band(36)
    assert low < found["normalised_square"] < high
    assert sum(part["n"] for part in found["classes"].values()) == found["n"]


def test_the_cloud_from_the_air_is_fitted_and_joined(others):
    tiny, ours = others
    true = json.loads((tiny.parents[1] / "files_of_others/air.json").read_text())["shift_m"]
    fit = json.loads((ours / "fusion/fit.json").read_text())
    shift, sigma = (np.array(fit[name]) for name in ("fitted_shift_m", "sigma_shift_m"))
    assert (np.abs(shift + true) < 3 * np.hypot(sigma, 0.01)).all()
    assert abs(fit["median_before_m"]) > 0.1 > 5 * abs(fit["median_after_m"])
    parts = joined_parts(ours / "fusion/model.laz")
    assert {Source.BED, Source.LIDAR, Source.SURROUNDINGS} <= set(parts)
    model = read_raster(ours / "fusion/dtm.tif")[1]
    of_air = model["source"] == float(Source.SURROUNDINGS)
    assert of_air.sum() > 100
    # the motion's own sigma is in that of the cells
    assert np.nanmin(model["sigma"][of_air]) > 0.5 * sigma[2]


def test_the_map_shows_the_cloud_from_the_air(others):
    """P1 Fig. 3 and 6: lidar, soundings, bed coloured by depth and the drone's cloud on one map."""
    tiny, ours = others
    campaign = yaml.safe_load((tiny.parents[1] / "config/campaigns/tiny.yaml").read_text())["campaign"]
    folder = ours / "bathymetry"
    figure = draw_bed_map(
        bed=folder / "bed.tif", banks=folder / "banks.csv", line=folder / "centre_line.csv",
        level=folder / "water_level.json", soundings=folder / "soundings.parquet",
        model=ours / "fusion/model.laz", crs=campaign["crs"], origin=campaign["origin"],
        title="others", twin=True,
    )  # fmt: skip
    ax = figure.axes[0]
    drawn = {line.get_label(): line for line in ax.lines}
    low, high = np.sort(ax.get_xlim()), np.sort(ax.get_ylim())
    colours = []
    for source in (Source.SURROUNDINGS, Source.LIDAR):
        east, north = drawn[SOURCE_WORDS[source]].get_data()
        inside = (east > low[0]) & (east < low[1]) & (north > high[0]) & (north < high[1])
        assert inside.sum() > 500
        colours.append(drawn[SOURCE_WORDS[source]].get_color())
    assert colours == ["0.75", SKY]
    assert drawn["soundings"].get_color() == "black"
    assert "UTM zone 33N" in figure.axes[1].get_xlabel()
