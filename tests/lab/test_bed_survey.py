"""The survey of the bed on foot: where its points are, how they err, and how the processing reads them."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.lab.conftest import FRAME, SEED, short
from thalweg.ingest.tracks import read_bed_survey
from thalweg_lab.instruments import simulate_bed_survey
from thalweg_lab.instruments.bed import DEPTHS_M, REACH_M, bed_points
from thalweg_lab.river import Material


def test_points_lie_on_the_bed_in_shallow_water_near_the_track(twin, scene):
    found = bed_points(twin.config, SEED, scene)
    # two sides of a track of 10 m, 4 m wide, a point each 0.8 by 0.5 m, less where it is too deep
    assert 20 < len(found) < 160
    depth = scene.water_level_m - found[:, 2]
    assert depth.min() >= DEPTHS_M[0]
    assert depth.max() <= DEPTHS_M[1]
    nearest = scene.only(Material.BED).caster().closest_points(found).distance_m
    # the ray caster works in single precision
    assert nearest.max() < 1e-4
    t = twin.voyage.start_gps_s + np.linspace(-2.0, 6.0, 200)
    away = cKDTree(twin.voyage.position_wcs_m(t)[:, :2]).query(found[:, :2])[0]
    assert away.max() < REACH_M + 0.1


def test_the_file_is_what_the_reader_takes_and_errs_as_stated(twin, scene, tmp_path):
    config = short(echo={"bed_survey": True, "sigma_bed_m": 0.02, "sigma_bed_datum_m": 0.1})
    path = tmp_path / "bed.csv"
    facts = simulate_bed_survey(
        config, SEED, FRAME, twin.path("scene.npz"), path, crs="EPSG:25833", out_effects=tmp_path / "e.json"
    )
    survey = read_bed_survey([path], FRAME, "EPSG:25833")
    error = survey.points_wcs_m - bed_points(config, SEED, scene)
    n = len(error)
    assert facts["points"] == n
    assert set(survey.sigma_m) == {0.02}
    # four sigmas of a mean and of a standard deviation of n values
    assert error.mean(axis=0) == pytest.approx([0.0, 0.0, facts["datum_m"]], abs=4 * 0.02 / np.sqrt(n))
    assert error.std(axis=0) == pytest.approx([0.02] * 3, rel=4 / np.sqrt(2 * n))
    assert facts["datum_m"] != 0.0
    again = tmp_path / "again.csv"
    simulate_bed_survey(config, SEED, FRAME, twin.path("scene.npz"), again, crs="EPSG:25833")
    assert again.read_bytes() == path.read_bytes()
