"""Pictures and page of change between epochs, from a made-up bank of three hundred core points."""

import inspect
import json
import re
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from pyproj import CRS

from thalweg.core import Dsm, GeometryError, Grid, InputError, frame_of, write_raster, write_table
from thalweg.deformation import CHANGES, CORE_POINTS, VISIBILITY
from thalweg.deformation.foreign import SurfaceDifference, read_difference, write_difference
from thalweg.figures import save
from thalweg.figures.deformation import change_page, read_pair_facts
from thalweg.figures.deformation.heights import draw_height_difference
from thalweg.figures.deformation.maps import draw_change_map, draw_significance_map, read_pairs
from thalweg.figures.deformation.page import (
    contradiction,
    direction,
    head,
    largest_patches,
    limits,
    taken_off,
    verdict,
    write_change_page,
)
from thalweg.figures.deformation.statistics import (
    draw_retreat_along,
    draw_stable_ground,
    draw_volume_along,
    read_stable,
)
from thalweg.figures.deformation.together import draw_epochs_together
from thalweg.figures.deformation.views import (
    draw_change_profiles,
    draw_epochs_from_above,
    places_of,
    without_motion,
)
from thalweg.workflow.figures import read_figures

MOTION = dict.fromkeys(("east_m", "north_m", "up_m", "turn_east", "turn_north", "turn_up"), 0.0)


UNREGISTERED = {"model": "none", "areas": "none are drawn", "sigma": "unknown"}
WORDS = {"title": "a bank"}
BY_BOAT = {"by_boat": True, **WORDS}
FIGURES_YAML = Path(__file__).parents[2] / "workflow/figures.yaml"
ROOT = np.sqrt(0.5)


def volume(what, volume_m3, sigma_m3, area_m2):
    """A row of a table of volumes."""
    half = 1.96 * sigma_m3
    return {
        "what": what, "volume_m3": volume_m3, "sigma_m3": sigma_m3, "low_m3": volume_m3 - half,
        "high_m3": volume_m3 + half, "bias_m3": 0.1, "area_m2": area_m2, "not_seen_m2": 1.0,
    }  # fmt: skip


@pytest.fixture(scope="module")
def bank(tmp_path_factory):
    """Results of a campaign with one pair: a slope of 45 degrees to the south of a river along east.

    Right as seen from the river is west. At s = -5 m the bank lost 30 cm, at s = 5 m it gained 20 cm; the
    lowest row was under water in the first epoch; four core points are plants.
    """
    folder = tmp_path_factory.mktemp("deformation")
    s, up = (each.ravel() for each in np.meshgrid(np.arange(-10, 10.1, 0.5), np.arange(0, 3.1, 0.5)))
    k = len(s)
    rng = np.random.default_rng(4)
    distance = rng.normal(0.0, 0.02, k)
    state = np.full(k, "no significant change", dtype=object)
    for what, middle, size in (("erosion", -5.0, -0.3), ("deposition", 5.0, 0.2)):
        use = (np.abs(s - middle) <= 1.0) & (up > 1.0)
        distance[use] = size
        state[use] = what
    distance[(s == -5.0) & (up == 2.0)] = -0.35
    state[(s == 0.0) & (up > 1.0)] = "vegetation"
    state[up == 0.0] = "not seen in first"
    distance[up == 0.0] = np.nan
    known = np.isfinite(distance)
    place = {"core": np.arange(k), "east_m": 100.0 - s, "north_m": -20.0 - up, "up_m": up}
    normal = {"normal_east": np.zeros(k), "normal_north": np.full(k, ROOT), "normal_up": np.full(k, ROOT)}
    parts = {"sigma_field_m": 0.016, "sigma_white_m": 0.012, "sigma_registration_m": 0.0001}
    cores = {**place, **normal, "surface": np.ones(k, int), "scale_m": np.ones(k)}
    cores |= {"area_m2": np.full(k, 0.5), "s_m": s}
    changes = {
        **place, **normal, "scale_m": np.ones(k), "n_before": 9 * known, "n_after": np.full(k, 9),
        "distance_m": distance, **{name: np.where(known, value, np.nan) for name, value in parts.items()},
        "sigma_m": np.where(known, 0.02, np.nan), "lod95_m": np.where(known, 0.0392, np.nan),
        "p_value": np.ones(k), "q_value": np.ones(k), "significant": np.abs(distance) > 0.1, "state": state,
    }  # fmt: skip
    seen = {"core": np.arange(k), "seen_1": up > 0.0, "reason_1": np.where(up > 0.0, "", "water")}
    seen |= {"beams_through_1": np.zeros(k, int), "seen_2": np.full(k, True)}
    seen |= {"reason_2": np.full(k, ""), "beams_through_2": np.zeros(k, int)}
    write_table(folder / "core_points.parquet", frame_of(CORE_POINTS, cores), CORE_POINTS)
    write_table(folder / "changes_1-2.parquet", frame_of(CHANGES, changes), CHANGES)
    write_table(folder / "visibility_1-2.parquet", frame_of(VISIBILITY, seen), VISIBILITY)
    (folder / "changes_1-2.json").write_text(json.dumps({"control": "fdr", "level": 0.05}))
    facts = {
        "model": "shift", "parameters": MOTION | {"up_m": 0.05},
        "sigmas": MOTION | {"east_m": 0.01, "north_m": 0.03, "up_m": 0.01}, "test_statistic": 25.0,
        "degrees_of_freedom": 2, "p_value": 3.7e-6, "needed": True, "not_shown": [[1.0, 0.0, 0.0]],
        "stable_cores": 200, "candidates": 240, "areas": "what most of the bank agrees on", "n_areas": 1,
    }  # fmt: skip
    (folder / "registration_1-2.json").write_text(json.dumps(facts))
    # the registration took the deposition for stable ground
    np.savez(folder / "registration_1-2.npz", stable=known & (state != "erosion"))
    rows = [volume("erosion", -4.0, 0.25, 12.5), volume("deposition", 2.5, 0.2, 12.5)]
    pd.DataFrame([*rows, volume("net", -1.4, 0.9, 120.0)]).to_csv(folder / "volumes_1-2.csv", index=False)
    along = [
        {"s_from_m": start, "s_to_m": start + 10.0, **volume(what, v, 0.3, 10.0)}
        for what, both in (("erosion", (-4.0, 0.0)), ("deposition", (0.0, 2.5)), ("net", (-4.1, 2.7)))
        for start, v in zip((-10.0, 0.0), both, strict=True)
    ]
    pd.DataFrame(along).to_csv(folder / "volumes_along_1-2.csv", index=False)
    dod = volume("net", -1.7, 0.8, 118.0) | {"part": "net", "n_cells": 472}
    pd.DataFrame([dod]).to_csv(folder / "dod_1-2.csv", index=False)
    patch = {"cores": 25, "east_m": 0.0, "north_m": 0.0}
    pd.DataFrame(
        [
            patch | {"what": what, "area_m2": a, "volume_m3": v, "mean_distance_m": d, "up_m": u}
            | {"largest_distance_m": most}
            for what, a, v, d, u, most in (
                ("erosion", 12.5, -3.8, -0.302, 2.0, -0.35),
                ("deposition", 12.5, 2.5, 0.2, 2.0, 0.2),
                ("erosion", 1.0, -0.1, -0.1, 0.5, -0.35),
                ("erosion", 2.0, np.nan, np.nan, 0.1, np.nan),
            )
        ]
    ).to_csv(folder / "patches_1-2.csv", index=False)  # fmt: skip
    points, errors = [], []
    for i, name in enumerate(("spring", "autumn")):
        own = folder / "epochs" / name
        own.mkdir(parents=True)
        x, h = rng.uniform(-10, 10, 40_000), rng.uniform(0, 3, 40_000)
        lost = 0.3 * np.sqrt(2.0) * ((np.abs(x + 5) <= 1.25) & (h > 0.75)) * i
        xyz = np.stack([100.0 - x, -20.0 - h - lost, h + 0.05 * i], axis=1)
        boat = np.stack([np.linspace(90, 110, 20), np.full(20, -12.0), np.zeros(20)], axis=1)
        np.savez(own / "points.npz", xyz_m=xyz, boat_m=boat)
        groups = [
            {"name": "position", "correlation_s": 11.0, "lasts": "11 s"}
            | {"sigma": [0.01, 0.02, 0.03], "unit": "m"},
            {"name": "mount, rotation", "correlation_s": None, "lasts": "all the time"}
            | {"sigma": [0.001] * 3, "unit": "rad"},
            {"name": "images", "correlation_s": None, "lasts": "from node to node"}
            | {"sigma": [0.04] * 3 + [0.002] * 3, "unit": "m, rad"},
        ]
        about = {"name": name, "start_gps_s": 3e8 + 1e7 * i, "points": 40_000, "moments": 20}
        (own / "errors.json").write_text(json.dumps({**about, "groups": groups}))
        points.append(own / "points.npz")
        errors.append(own / "errors.json")

    forms = {
        "changes": "changes_{}.parquet", "visibility": "visibility_{}.parquet", "control": "changes_{}.json",
        "registrations": "registration_{}.json", "weights": "registration_{}.npz",
        "volumes": "volumes_{}.csv", "along": "volumes_along_{}.csv", "patches": "patches_{}.csv",
        "differences": "dod_{}.csv",
    }  # fmt: skip
    of_pair = {key: [folder / form.format("1-2")] for key, form in forms.items()}
    cores = folder / "core_points.parquet"
    return SimpleNamespace(**of_pair, core_points=cores, points=points, errors=errors, n=k)


@pytest.fixture
def on_bank(bank):
    """What the figures of a pair are drawn from, by the names of their arguments."""
    return vars(bank) | {"spacing_m": 0.5, "twin": False} | BY_BOAT


@pytest.fixture
def shown(on_bank, look):
    """The words of a figure, of what it asks for."""

    def words(draw, **more):
        return look.texts(drawn_of(draw, on_bank | more))

    return words


def drawn_of(draw, known):
    """A figure of those arguments that it has."""
    return draw(**{key: known[key] for key in inspect.signature(inspect.unwrap(draw)).parameters})


@pytest.fixture
def pair(bank):
    return read_pairs(bank.changes, bank.core_points, 0.5, by_boat=True)[0]


@pytest.fixture
def all_facts(bank):
    names = "changes visibility control registrations volumes patches differences core_points"
    return read_pair_facts(*(getattr(bank, name) for name in names.split()))


@pytest.fixture
def facts(all_facts):
    return all_facts[0]


@pytest.fixture
def epochs(bank):
    return [json.loads(path.read_text()) for path in bank.errors]


STATED = {"name": "stated", "correlation_s": None, "lasts": "over 20 m", "unit": "m"}


def of_files(bank, k, folder, every=1):
    """Points and errors of an epoch, as if it came from files without a trajectory."""
    folder.mkdir()
    with np.load(bank.points[k]) as stored:
        np.savez(folder / "points.npz", xyz_m=stored["xyz_m"][::every], boat_m=np.empty((0, 3)))
    about = json.loads(bank.errors[k].read_text()) | {"groups": [STATED | {"sigma": [0.0, 0.0, 0.03]}]}
    (folder / "errors.json").write_text(json.dumps(about))
    return folder / "points.npz", folder / "errors.json"


# ---------------------------------------------------------------- the frame of the bank


def test_along_is_to_the_right_as_seen_from_the_river_and_into_leads_away_from_it(pair):
    assert pair.along == pytest.approx([-1.0, 0.0], abs=1e-9)
    assert pair.into == pytest.approx([0.0, -1.0], abs=1e-9)
    along, into = pair.on_bank(np.array([[97.0, -23.0]]))
    # the middle of the core points is 100, -21.5
    assert (along[0], into[0]) == pytest.approx((3.0, 1.5))
    assert pair.into_m == pytest.approx(pair.up_m - 1.5)


# ---------------------------------------------------------------- maps


def test_change_map_counts_bare_ground_and_states_the_ends(bank, shown):
    words = shown(draw_change_map)
    n = bank.n - 41 - 4  # water and plants
    assert f"n = {n} core points" in words
    assert "from −35 to +20 cm, 1 beyond the scale" in words
    assert "n = 45" in words
    assert "negative: erosion, positive: deposition" in words


def test_significance_map_names_states_with_their_area(shown):
    words = shown(draw_significance_map)
    # 5 columns by 4 rows of half a square metre each, of 287
    assert "erosion: n = 20, 10 m² (7 %)" in words
    assert "vegetation: n = 4, 2 m² (1.4 %)" in words
    assert "not seen in first: n = 41, 20.5 m² (14 %)" in words
    assert "object" not in words


# ---------------------------------------------------------------- statistics


def test_stable_ground_leaves_significant_places_out_unless_it_was_drawn(bank, pair, tmp_path):
    (found,) = read_stable([pair], bank.registrations, bank.weights)
    deposited = pair.state == "deposition"
    assert deposited.sum() == 20
    assert found.registered[deposited].all()
    assert not found.unmoved[deposited].any()
    assert not found.registered[pair.state == "vegetation"].any()
    drawn = tmp_path / "registration_1-2.json"
    drawn.write_text(json.dumps(json.loads(bank.registrations[0].read_text()) | {"areas": "drawn"}))
    (found,) = read_stable([pair], [drawn], bank.weights)
    assert np.array_equal(found.unmoved, found.registered)


def test_where_no_ground_is_drawn_the_pictures_of_it_say_so(bank, pair, tmp_path):
    np.savez(tmp_path / "none.npz", stable=np.zeros(len(pair.state), bool))
    with pytest.raises(GeometryError, match="no core point lies on stable ground"):
        read_stable([pair], bank.registrations, [tmp_path / "none.npz"])


def test_stable_ground_is_held_against_the_standard_normal(shown):
    words = shown(draw_stable_ground)
    # 287 without water, plants and both patches; the patch of 20 cm is ten sigmas off
    assert "stable ground: n = 202" in words
    assert "all that the registration rests on: n = 222" in words


@pytest.mark.parametrize("tall", [False, True])
def test_difference_of_heights_is_drawn_with_its_sigma(look, tmp_path, tall):
    height = np.full((8, 30), 0.02)
    height[:, :3], height[2:5, 10:16], height[0, 29] = np.nan, -0.29, 2.5
    height = height.T if tall else height
    raster = Dsm(height, np.array([377_310.0, 5_656_780.0]), np.full(2, 0.5), CRS.from_epsg(25833), Path("a"))
    sigma = np.where(np.isfinite(height), 0.04, np.nan)
    found = SurfaceDifference(raster, sigma, pd.DataFrame(), [])
    write_difference(tmp_path / "dod_1-2.tif", found)
    back = read_difference(tmp_path / "dod_1-2.tif")
    assert_allclose(back.raster.height_m, height.astype(np.float32))
    assert back.raster.corner_m.tolist() == raster.corner_m.tolist()
    figure = draw_height_difference(differences=[tmp_path / "dod_1-2.tif"], **WORDS)
    words = look.texts(figure)
    assert "epochs 1 to 2, n = 216 cells, from −29 to +250 cm" in words
    assert "standard deviation, median 4.0 cm" in words
    assert "ETRS89 / UTM zone 33N" in words
    write_raster(
        tmp_path / "other.tif",
        Grid.around(np.zeros((1, 2)) + 1e5, 1.0, CRS.from_epsg(25833), margin_m=2),
        {"z": np.zeros((4, 4))},
    )
    with pytest.raises(InputError, match="bands z"):
        read_difference(tmp_path / "other.tif")


def test_volumes_along_the_bank(shown):
    words = shown(draw_volume_along)
    assert "erosion: −4.0 m³" in words
    assert "net: −1.4 m³" in words
    assert "2 stretches of 10 m" in words


# ---------------------------------------------------------------- views of clouds


def test_epochs_from_above(bank, look):
    figure = draw_epochs_from_above(points=bank.points, errors=bank.errors, **WORDS)
    words = look.texts(figure)
    assert "n = 80 000 points" in words
    assert "epoch 2, autumn" in words
    assert len(look.artists(figure, "track")) == 2


def test_an_epoch_of_files_has_no_boat_and_its_notes_stand_on_the_page(bank, facts, look, epochs, tmp_path):
    points, errors = of_files(bank, 1, tmp_path / "files")
    figure = draw_epochs_from_above(points=[bank.points[0], points], errors=[bank.errors[0], errors], **WORDS)
    assert len(look.artists(figure, "track")) == 1
    assert "files, no trajectory" in look.texts(figure)
    noted = replace(facts, control=facts.control | {"notes": ["No sigma is stated of scanner."]})
    html = change_page([epochs[0], json.loads(errors.read_text())], [noted]).html()
    for words in ("Epochs 1 to 2: No sigma is stated of scanner.", "stated of the files", "over 20 m"):
        assert words in html, words


def test_both_epochs_together_with_point_to_point_distances(on_bank, look):
    figure = drawn_of(draw_epochs_together, on_bank)
    words = look.texts(figure)
    assert "a) epoch 1, spring, seen from the river, heights not to scale" in words
    assert "n = 80 000 points" in words
    distance = np.asarray(look.artists(figure, "distances")[0].get_array())
    # 0.42 m across a slope of 45 degrees and 0.05 m up, to points some centimetres apart
    assert 0.27 < np.quantile(distance, 0.995) < 0.45
    assert np.quantile(distance, 0.5) < 0.08


def test_profiles_go_through_the_largest_and_the_lowest_change(bank, pair):
    places = places_of(pair, pd.read_csv(bank.patches[0]))
    # the largest distance of the lowest patch is that of the largest patch: one profile
    assert [place.words for place in places] == ["largest erosion, lowest erosion", "largest deposition"]
    core = places[0].core
    assert (pair.s_m[core], pair.up_m[core]) == (-5.0, 2.0)


def test_a_motion_is_taken_off_the_second_epoch():
    motion = MOTION | {"up_m": 0.2, "turn_up": 0.01}
    moved = without_motion(np.array([[11.0, 0.0, 0.0]]), motion, np.array([1.0, 0, 0]))
    # a turn of 10 mrad to the left at ten metres
    assert moved[0] == pytest.approx([11.0, -0.1, -0.2])


def test_profiles_show_both_epochs_registered(on_bank, look):
    figure = drawn_of(draw_change_profiles, on_bank)
    first = look.artists(figure, "first epoch")[0].get_xydata()
    second = look.artists(figure, "second epoch, registered")[0].get_xydata()
    # on the slope into = up - 1.5; where the bank went 30 cm, it is as much behind along the normal
    off = [(each[:, 0] + 1.5 - each[:, 1]) * ROOT for each in (first, second)]
    assert np.median(off[0]) == pytest.approx(0.0, abs=0.02)
    assert np.median(off[1]) == pytest.approx(0.3, abs=0.02)


# ---------------------------------------------------------------- page


def test_the_verdict_states_volumes_registration_and_what_was_not_seen(facts):
    words = verdict(facts)
    assert "−4.00 ± 0.25 m³ by erosion on 12.5 m²" in words
    assert (
        "net, with insignificant changes, −1.40 ± 0.90 m³, which is not significantly different from zero"
        in words
    )
    assert "patch of erosion has 12.5 m², −3.8 m³" in words
    assert "up +5.0 ± 1.0 cm: more than the errors of both surveys explain" in words
    assert "does not determine a shift along 90° (azimuth)" in words
    assert "20.5 m² (14.3 % of 144 m²) have no data in" in words


def test_a_net_volume_beyond_its_band_is_called_different_from_zero(facts):
    table = facts.volumes.assign(low_m3=-3.0, high_m3=-0.5)
    assert "which is significantly different from zero" in verdict(replace(facts, volumes=table))
    with pytest.raises(InputError, match="0 rows 'net'"):
        verdict(replace(facts, volumes=table[table["what"] != "net"]))


def test_words_where_nothing_was_found(epochs, facts):
    calm = replace(facts, patches=facts.patches.iloc[:0], registration={"model": "none"})
    assert "not registered" in verdict(calm)
    assert largest_patches(calm.patches).startswith("No connected patch")
    assert "No stable areas were drawn" in limits([facts])
    drawn = replace(facts, registration={**facts.registration, "areas": "drawn"})
    assert "drawn by hand" in limits([drawn])
    html = change_page(epochs[:1], [calm]).html()
    assert "deformation.registration is none" in html


def test_the_lead_gives_both_volumes_what_was_taken_off_and_why_they_differ(facts):
    lead, findings = head([facts])
    assert lead.startswith(
        "Epochs 1 to 2: the net volume is not significant at 95 %. Net along normals −1.40 ± 0.90 m³ on "
        "120 m² of surface, by heights −1.70 ± 0.80 m³ on 118 m² of the map. They cover different areas"
    )
    assert "Warning" not in lead
    rows = {each.quantity: (each.value, each.verdict) for each in findings}
    assert rows["net volume by heights"] == ("−1.70 ± 0.80 m³", "significant at 95 %")
    assert rows["height offset removed from the second epoch"] == (
        "+5.0 ± 1.0 cm",
        "from the majority of the bank",
    )


@pytest.mark.parametrize(
    ("by_heights", "sigma", "words"),
    [
        (-3.1, 0.8, ""),
        (-3.3, 0.8, "contradict each other"),
        (1.0, 0.8, "have opposite signs"),
        (0.4, 2.0, ""),
    ],
)
def test_two_volumes_that_contradict_each_other_are_a_warning(facts, by_heights, sigma, words):
    """−1.4 ± 0.9 m³ along normals: 1.96 times the larger sigma apart, or of two signs and one beyond it."""
    table = facts.difference.assign(volume_m3=by_heights, sigma_m3=sigma)
    other = replace(facts, difference=table)
    told = contradiction(other)
    assert bool(told) == bool(words)
    assert words in told
    assert told in head([other])[0]


def test_without_a_sigma_and_drawn_ground_there_is_no_verdict(epochs, facts):
    volumes = facts.volumes.assign(low_m3=-3.0, high_m3=-0.5)
    registration = UNREGISTERED | {"would_be": MOTION | {"up_m": -0.204}}
    silent = replace(facts, registration=registration, volumes=volumes)
    lead, findings = head([silent])
    assert "no verdict: no standard deviation is stated or estimated for both epochs" in lead
    assert "a common offset may remain. The majority of the surface suggests −20.4 cm" in lead
    assert not [each for each in findings if "significant" in each.verdict]
    assert findings[4].value == "none"
    assert "the majority of the surface suggests −20.4 cm" in findings[4].verdict
    words = verdict(silent)
    assert "on which there is no verdict" in words
    assert "different from zero" not in words
    assert "which may be change or an offset" in words
    assert "a common offset of the epochs may remain" in limits([silent])
    html = change_page(epochs[:1], [silent]).html()
    assert "not registered (no stable ground is drawn" in html


def test_areas_of_drawn_ground_stand_on_the_page(epochs, facts):
    areas = [
        {"east_m": 10.0, "north_m": 5.0, "places": 30, "off_m": 0.012},
        {"east_m": 70.0, "north_m": 5.0, "places": 4, "off_m": None},
    ]
    told = {"areas": "drawn", "n_areas": 2, "by_area": areas, "sigma": "stated"}
    told |= {"sigma_from": "the stated sigmas"}
    drawn = replace(facts, registration=facts.registration | told)
    assert taken_off(drawn.registration) == ("+5.0 ± 1.0 cm", "from drawn ground, 2 areas")
    html = change_page(epochs[:1], [drawn]).html()
    assert "stable areas that lie apart" in html
    assert "standard deviation is by the stated sigmas" in html


@pytest.mark.parametrize(
    ("motion", "words"),
    [
        ([0.0, 0.0, -1.0], "a shift upward"),
        ([-1.0, 0.0, 0.1], "a shift along 90° (azimuth)"),
        ([0.0, 0.0, 0.1, 0.9], "a rotation about up"),
        ([0.0, 0.0, 0.1, 0.2, -0.9, 0.1], "a rotation about north"),
    ],
)
def test_directions_in_words(motion, words):
    assert direction(motion) == words


def test_the_page_holds_all_tables_and_pictures(bank, facts, epochs, tmp_path):
    picture = tmp_path / "volume_along.png"
    save(draw_volume_along(along=bank.along, **BY_BOAT), picture, dpi=50)
    truth = {"1-2": pd.DataFrame({"measure": ["specificity", "new_one"], "value": [0.99, 2.0], "n": [10, 1]})}
    polygon = {"kind": "erosion", "area_m2": 24.0, "true_m3": -2.4, "sigma_m3": 0.25, "measured_m2": 23.0}
    known = {"cores": 140, "measured_m3": -2.0, "expected_m3": -2.25}
    polygons = pd.DataFrame(
        [{"name": "patch_-0.10", **polygon, **known}, {"name": "niche", **polygon, **known, "cores": 0}]
    )
    html = change_page(
        epochs,
        [facts, facts],
        pictures=[picture],
        captions={"volume_along": "Bars of volume."},
        truth=truth,
        polygons={"1-2": polygons},
        title="Change of the bank",
        twin=True,
    ).html()
    for words in (
        "Bars of volume.",
        "positions, time-correlated",
        "mounting angles of the scanner",
        "share of unchanged ground that was called unchanged",
        "new one",
        "<td>patch −0.10</td>",
        "error over sigma",
        "at most 5 % did not change",
        "<td>water</td>",
        "2021-",  # the start of the first epoch
        "The digital twin made these data",
        "Volumes of the difference of heights",
    ):
        assert words in html, words
    assert html.count("by erosion on") == 2
    assert "<td>niche</td>" not in html  # nobody saw it
    assert "digital twin" not in change_page(epochs, [facts]).html()


def test_movement_of_both_lines_is_drawn_in_centimetres(look, tmp_path):
    rows = [
        {"line": line, "height_m": h, "s_from_m": start, "s_to_m": start + 5.0, "cores": 4, "nsm_m": moved}
        for line, h, moved in (("bank line", 0.5, -0.3), ("bank top", 2.5, 0.1))
        for start in (-5.0, 0.0)
    ]
    table = pd.DataFrame(rows).assign(sigma_m=0.05)
    table = table.assign(low_m=table["nsm_m"] - 0.1, high_m=table["nsm_m"] + 0.1, epr_m_a=0.0)
    table.to_csv(tmp_path / "retreat_1-2.csv", index=False)
    figure = draw_retreat_along(retreat=[tmp_path / "retreat_1-2.csv"], **BY_BOAT)
    assert "bank line, n = 2 stretches, at a height of +0.50 m" in look.texts(figure)
    assert figure.axes[0].lines[0].get_ydata() == pytest.approx(-30.0)


def test_a_page_of_many_epochs_names_those_that_jump(all_facts, epochs):
    jump = {"n": 200, "before_m": 0.2, "after_m": -0.21, "share": 0.9, "flagged": True, "name": "autumn"}
    jumps = {"epochs": [jump | {"epoch": 1}], "closure": {"n": 190, "mean_m": 0.0, "rms_m": 0.013}}
    jumps["network"] = {
        "parameters": [MOTION | {"up_m": 0.02}, MOTION | {"up_m": -0.02}, MOTION],
        "sigmas": [MOTION | {"up_m": 0.003, "turn_up": 1e-4}] * 3,
        "stable_cores": 210,
    }
    line = {"line": "bank line", "height_m": 0.5, "s_from_m": 0.0, "s_to_m": 5.0, "cores": 4, "n_epochs": 3}
    rates = pd.DataFrame([line | {"lrr_m_a": -0.31, "sigma_lrr_m_a": 0.02}])
    text = change_page(epochs, all_facts, series=(jumps, rates)).html()
    assert "Check epoch 2 (autumn)" in text
    assert "by 1.3 cm (root mean square of n = 190" in text
    assert "+20.0 ± 3.0" in text
    assert "poses of the photographs, shift" in text
    assert "poses of the photographs, rotation" in text
    assert "0.11" in text  # 2 mrad in degrees
    assert "stable core points: 210" in text
    assert "−0.31" in text or "-0.31" in text


def test_the_limits_of_epochs_of_files_stand_on_the_page(facts):
    assert "have no trajectory" not in limits([facts])
    unseen = facts.visibility.assign(seen_2=False, reason_2="no trajectory")
    assert "either empty or not observed" in limits([replace(facts, visibility=unseen)])


def test_pictures_and_page_of_files_speak_of_no_boat_river_or_bank(bank, look, tmp_path):
    """Captions, titles, axes and text of a campaign of which no epoch has a trajectory."""
    points, errors = zip(*(of_files(bank, k, tmp_path / f"{k}", 20) for k in range(2)), strict=True)
    (tmp_path / "registration_1-2.json").write_text(json.dumps(UNREGISTERED | {"would_be": MOTION}))
    line = {"height_m": 0.5, "s_from_m": 0.0, "s_to_m": 5.0, "cores": 4, "nsm_m": 0.1, "low_m": 0.0}
    moved = pd.DataFrame([{"line": name, **line, "high_m": 0.2} for name in ("bank line", "bank top")])
    moved.to_csv(tmp_path / "retreat_1-2.csv", index=False)
    jumps = [
        {"epoch": i, "name": f"{i}", "n": 9, "before_m": 0.1, "after_m": 0.1, "share": 0.9, "flagged": i == 1}
        for i in range(3)
    ]
    told = {"epochs": jumps, "closure": {"rms_m": 0.01, "n": 9}, "network": {"would_be": {}}}
    (tmp_path / "jumps.json").write_text(json.dumps(told))
    rate = {"n_epochs": 3, "lrr_m_a": -0.3, "sigma_lrr_m_a": 0.02}
    moved.assign(**rate).to_csv(tmp_path / "rates.csv", index=False)
    known = vars(bank) | {
        "points": points, "errors": errors, "registrations": [tmp_path / "registration_1-2.json"],
        "retreat": [tmp_path / "retreat_1-2.csv"], "spacing_m": 0.5, "by_boat": False,
        "series": [tmp_path / "jumps.json", tmp_path / "rates.csv"], "truth": [], "polygons": [],
        "pictures": [], "captions": {}, "page": tmp_path / "index.html", "title": "a dune", "twin": True,
    }  # fmt: skip
    found = {}
    for row in read_figures(FIGURES_YAML).rows:
        module, _, name = (row.draw or "").partition(":")
        if row.kind == "change":
            found[f"caption of {row.name}"] = row.caption_of_files or row.caption
            if row.name != "height_difference":  # from files of other kinds, see above
                found[row.name] = look.texts(drawn_of(getattr(import_module(module), name), known))
    drawn_of(write_change_page, known)
    found["page"] = known["page"].read_text()
    spoken = {name: re.findall(r"\b(?:river|boat|bank)s?\b.{0,40}", words) for name, words in found.items()}
    assert not {name: words for name, words in spoken.items() if words}
    assert len(found) == 9 + 8 + 1
    assert "Rates of contour and upper edge" in found["page"]
