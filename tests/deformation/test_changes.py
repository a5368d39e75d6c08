"""Two epochs of a boat: registration, sigmas of registered distances, volumes, visibility, classes."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2

from tests.bands import band
from thalweg.core import ArrayF, GeometryError
from thalweg.deformation import (
    YEAR_S,
    Compared,
    Epoch,
    ErrorField,
    Registration,
    classify_changes,
    compare_epochs,
    estimate_retreat,
    estimate_volumes,
    find_jumps,
    fit_series,
    measure_pair,
    observe_visibility,
    place_core_points,
    register_pair,
    registered_distances,
    series_of_epochs,
)
from thalweg.deformation.changes import is_bare, measure_epoch
from thalweg.deformation.coregistration import coregister_network
from thalweg.deformation.field import ErrorGroup, joint_fields
from thalweg.deformation.visibility import beams_through
from thalweg.settings.sections import Deformation
from thalweg.surface import Area

EVERYWHERE = Area()
SETTINGS = Deformation(core_spacing_m=0.5, scales_m=[0.5, 1.0], reach_m=2.0)


def bank(rng: np.random.Generator, n: int, *, length_m: float = 30.0, waves_m: float = 0.8) -> ArrayF:
    """Points (n, 3) of a slope of 45 degrees with waves along it, so that it shows all shifts."""
    along, up = rng.uniform(0.0, length_m, n), rng.uniform(0.5, 4.5, n)
    north = up + waves_m * (np.sin(along * 2.0 * np.pi / 10.0) + np.sin(up * 2.0 * np.pi / 6.0))
    return np.column_stack([along, north, up])


def epoch(
    xyz_m: ArrayF,
    *,
    name: str = "epoch",
    start_gps_s: float = 0.0,
    seconds: float = 20.0,
    sigma_m: float = 0.0,
    sigma_rad: float = 0.0,
    noise_m: float = 0.0,
    time_s: float = 10.0,
    path: Callable[[ArrayF], ArrayF] | None = None,
) -> Epoch:
    """An epoch whose points were measured when the boat passed them, 10 m before the bank."""
    t = np.arange(0.05, seconds, 0.1)
    length = float(np.ptp(xyz_m[:, 0])) or 1.0
    low = float(xyz_m[:, 0].min())
    boat = (
        np.column_stack([low + length * t / seconds, np.full(len(t), -10.0), np.full(len(t), 1.0)])
        if path is None
        else path(t)
    )
    moment = np.clip(((xyz_m[:, 0] - low) / length * len(t)).astype(np.int64), 0, len(t) - 1)
    groups = (
        ErrorGroup.from_sigmas("position", t, np.full(3, sigma_m), time_s),
        ErrorGroup.from_sigmas("attitude", t, np.full(3, sigma_rad), time_s),
    )
    white = np.zeros((len(xyz_m), 6))
    white[:, [0, 3, 5]] = noise_m**2
    return Epoch(
        name=name,
        start_gps_s=start_gps_s,
        xyz_m=xyz_m,
        moment=moment,
        white_m2=white,
        several_returns=np.zeros(len(xyz_m), dtype=bool),
        t_s=t,
        boat_m=boat,
        scanner_m=boat,
        groups=groups,
        levers=np.zeros((2, len(t), 3, 3)),
        water_m=np.zeros(len(t)),
    )


def with_errors(given: Epoch, rng: np.random.Generator) -> Epoch:
    """The epoch with errors of its poses and its noise drawn and put into its points."""
    errors = []
    for group in given.groups:
        decay = np.exp(-np.diff(group.t_s, prepend=group.t_s[0] - 1e9) / group.correlation_s)
        process = np.zeros((len(group.t_s), 3))
        for k in range(len(process)):
            before = process[k - 1] if k else 0.0
            process[k] = decay[k] * before + np.sqrt(1.0 - decay[k] ** 2) * rng.standard_normal(3)
        errors.append(np.einsum("kij,kj->ki", group.root, process)[given.moment])
    arm = given.xyz_m - given.boat_m[given.moment]
    noise = np.sqrt(given.white_m2[:, [0, 3, 5]]) * rng.standard_normal(given.xyz_m.shape)
    return replace(given, xyz_m=given.xyz_m + errors[0] + np.cross(errors[1], arm) + noise)


def two_epochs(seed: int = 1, n: int = 20_000, **errors: float) -> tuple[Epoch, Epoch]:
    rng = np.random.default_rng(seed)
    first = epoch(bank(rng, n), name="first", **errors)
    return first, epoch(bank(rng, n), name="second", start_gps_s=1e6, **errors)


def compared(before: Epoch, after: Epoch, settings: Deformation = SETTINGS) -> Compared:
    pair = measure_pair(place_core_points([before, after], settings, EVERYWHERE), before, after, settings)
    return registered_distances(pair, register_pair(pair, settings))


def test_the_sigma_that_an_epoch_reports_is_the_root_of_the_mean_square(rng):
    """2 cm, and seven times as much in a quarter of the time: root of (3 + 49) / 4 times 2 cm."""
    given = epoch(bank(rng, 50), sigma_m=0.02, sigma_rad=0.001)
    position, attitude = given.groups
    worse = np.where(np.arange(len(position.t_s)) < len(position.t_s) / 4, 7.0, 1.0)
    given = replace(given, groups=(replace(position, root=position.root * worse[:, None, None]), attitude))
    told = [group["sigma"] for group in given.report()["groups"]]
    assert np.allclose(told, [[0.02 * np.sqrt(13.0)] * 3, [0.001] * 3])


# ---------------------------------------------------------------- core points


@pytest.mark.parametrize("slope", [0.0, 0.4, 1.0, 3.0])
def test_core_points_stand_for_the_area_of_the_surface(slope):
    rng = np.random.default_rng(3)
    east, north = rng.uniform(0.0, 20.0, (2, 150_000))
    height = np.column_stack([east, north, 0.3 * east + slope * north])
    cores = place_core_points([epoch(height), epoch(height, start_gps_s=1.0)], SETTINGS, EVERYWHERE)
    area = 400.0 * np.sqrt(1.0 + 0.3**2 + slope**2)
    assert cores["area_m2"].sum() == pytest.approx(area, rel=0.04)
    assert set(cores["surface"]) == {1}


def test_core_points_also_stand_on_the_last_surface_where_the_first_is_far():
    rng = np.random.default_rng(4)
    first = bank(rng, 20_000)
    moved = first.copy()
    inside = (first[:, 0] > 10.0) & (first[:, 0] < 16.0)
    moved[inside, 1] += 2.0
    cores = place_core_points([epoch(first), epoch(moved, start_gps_s=1.0)], SETTINGS, EVERYWHERE)
    second = cores[cores["surface"] == 2]
    assert len(second) > 50
    assert second["east_m"].between(9.0, 17.0).all()
    # the boat passes on the south side, and normals point to it
    assert (cores["normal_north"] < 0.0).mean() > 0.99


# ---------------------------------------------------------------- registration


def test_a_shift_of_five_centimetres_is_found_and_needed():
    before, after = two_epochs(noise_m=0.01, sigma_m=0.005)
    shift = np.array([0.03, -0.05, 0.02])
    found = compared(before, replace(after, xyz_m=after.xyz_m + shift)).registration
    sigma = np.sqrt(np.diag(found.cov))[:3]
    assert found.parameters[:3] == pytest.approx(shift, abs=0.012)
    assert (np.abs(found.parameters[:3] - shift) < 4 * sigma).all()
    assert found.facts["needed"]
    assert not found.facts["not_shown"]


def test_what_the_ground_does_not_show_is_left_alone_and_named():
    rng = np.random.default_rng(5)
    before, after = (epoch(bank(rng, 20_000, waves_m=0.0), noise_m=0.01, sigma_m=0.01) for _ in range(2))
    found = compared(before, replace(after, xyz_m=after.xyz_m + np.array([0.3, 0.0, 0.0]))).registration
    lost = np.array(found.facts["not_shown"])[:, :3]  # along the bank, and up the slope
    assert np.abs(lost @ [0.0, -1.0, 1.0]).max() < 0.05
    assert np.linalg.matrix_rank(lost, tol=0.1) == 2
    assert found.parameters[0] == pytest.approx(0.0, abs=0.01)


def test_epochs_far_apart_and_stable_ground_that_moved_are_refused():
    before, after = two_epochs(noise_m=0.005, sigma_m=0.003)
    far = replace(after, xyz_m=after.xyz_m + np.array([0.0, 0.0, 0.8]))
    with pytest.raises(GeometryError, match=r"lies 0\.[78]\d m off the first.*largest_shift_m"):
        compared(before, far)
    moved = after.xyz_m.copy()
    moved[after.xyz_m[:, 0] < 8.0, 2] += 0.1
    areas = [
        [(0.0, -2.0), (8.0, -2.0), (8.0, 8.0), (0.0, 8.0)],
        [(9.0, -2.0), (20.0, -2.0), (20.0, 8.0), (9.0, 8.0)],
        [(21.0, -2.0), (30.0, -2.0), (30.0, 8.0), (21.0, 8.0)],
    ]
    with pytest.raises(GeometryError, match=r"stable area 1 of 3 lies \+0\.0[3-9].*leave it out"):
        compared(before, replace(after, xyz_m=moved), SETTINGS.replace(stable=areas))


# ---------------------------------------------------------------- sigmas


def test_distances_and_volumes_err_as_predicted():
    """Twelve pairs with drawn errors: normalised squares within the 99 % band of their own draws."""
    first, second = two_epochs(n=6_000, sigma_m=0.03, sigma_rad=0.002, noise_m=0.02, time_s=6.0)
    rng = np.random.default_rng(7)
    settings = SETTINGS.replace(core_spacing_m=1.0)
    cores = place_core_points([first, second], settings, EVERYWHERE)
    squares, volumes, alone = [], [], []
    for _ in range(12):
        pair = measure_pair(cores, with_errors(first, rng), with_errors(second, rng), settings)
        found = registered_distances(pair, register_pair(pair, settings))
        use = np.isfinite(found.distance_m)
        squares.append(np.mean((found.distance_m[use] / found.sigma_m[use]) ** 2))
        product = np.where(use & (cores["s_m"].to_numpy() > 5.0), cores["area_m2"].to_numpy(), 0.0)
        sigma = np.sqrt(sum(found.variances(product[None])))[0]
        volumes.append(product @ np.nan_to_num(found.distance_m) / sigma)
        independent = np.sqrt(np.sum((product * np.nan_to_num(found.sigma_m)) ** 2))
        alone.append(product @ np.nan_to_num(found.distance_m) / independent)
    assert 0.7 < np.mean(squares) < 1.3
    low, high = chi2.ppf([0.005, 0.995], 12)
    assert low < np.sum(np.square(volumes)) < high
    assert np.sum(np.square(alone)) > 2.0 * high  # cells taken as independent


def test_predicted_variances_are_those_of_draws():
    first, second = two_epochs(n=6_000, sigma_m=0.03, sigma_rad=0.002, noise_m=0.02, time_s=6.0)
    found = compared(first, second, SETTINGS.replace(core_spacing_m=1.0))
    draws = np.array(list(found.draws(600, seed=3)))
    known = np.isfinite(found.distance_m)
    ratio = draws[:, known].var(axis=0) / found.sigma_m[known] ** 2
    assert ratio.mean() == pytest.approx(1.0, abs=0.06)
    products = np.stack([known * 1.0, known * (found.pair.cores["s_m"].to_numpy() > 0)])
    drawn = np.nan_to_num(draws) @ products.T
    assert drawn.var(axis=0) == pytest.approx(sum(found.variances(products)), rel=0.25)


def test_common_mounts_cancel_between_epochs():
    """The same error of the lever arm in both epochs moves both clouds alike."""
    first, second = two_epochs(noise_m=0.01)

    def with_mount(given: Epoch) -> Epoch:
        t = given.t_s
        mount = type(given.groups[0]).from_sigmas("mount, shift", t, np.full(3, 0.1), np.inf)
        return replace(given, groups=(*given.groups, mount))

    pairs = [with_mount(first), with_mount(second)]
    settings = SETTINGS.replace(registration="none")
    own = compared(pairs[0], pairs[1], settings).sigma_field_m
    common = settings.replace(errors=settings.errors.replace(common_mounts=True))
    assert np.nanmedian(own) == pytest.approx(0.1 * np.sqrt(2.0), rel=0.02)
    assert np.nanmax(compared(pairs[0], pairs[1], common).sigma_field_m) < 1e-6


# ---------------------------------------------------------------- volumes and classes


def full(before: Epoch, after: Epoch, settings: Deformation = SETTINGS):
    """Table with final states, patches, volumes, by the steps of the rule."""
    pair = measure_pair(place_core_points([before, after], settings, EVERYWHERE), before, after, settings)
    table, found, _ = compare_epochs(pair.cores, before, after, register_pair(pair, settings), settings, 1)
    places = found.pair.found
    seen = observe_visibility(places.cores_m, places.normals, places.n, (before, after), settings)
    table, patches = classify_changes(table, found, seen, settings)
    return table, patches, *estimate_volumes(table, found, settings, 1), seen


def test_a_displaced_patch_has_its_volume():
    before, after = two_epochs(n=60_000, noise_m=0.01, sigma_m=0.005)
    moved = after.xyz_m.copy()
    inside = (moved[:, 0] > 12.0) & (moved[:, 0] < 18.0)
    moved[inside, 1] += 0.3  # away from the river
    table, patches, volumes, along, _ = full(before, replace(after, xyz_m=moved))
    erosion = volumes.set_index("what").loc["erosion"]
    # 0.3 m to the north over 6 m of bank of 4 m of height: V = 0.3 * 6 * 4, whatever the waves do
    assert erosion["volume_m3"] == pytest.approx(-7.2, rel=0.08)
    assert abs(erosion["volume_m3"] + 7.2) < 4 * erosion["sigma_m3"] + 0.5
    assert volumes.set_index("what").loc["net", "volume_m3"] == pytest.approx(-7.2, rel=0.15)
    assert patches.iloc[0]["what"] == "erosion"
    assert patches.iloc[0]["east_m"] == pytest.approx(15.0, abs=0.5)
    stretches = along[along["what"] == "net"]
    assert stretches["volume_m3"].sum() == pytest.approx(volumes.set_index("what").loc["net", "volume_m3"])
    assert (table["state"] == "erosion").sum() > 100


def test_what_was_not_seen_is_not_eroded_but_free_space_is():
    """The second epoch has a hole in its cloud, and another place where its beams went through."""
    before, after = two_epochs(n=40_000, noise_m=0.01)
    xyz = after.xyz_m
    hole = (xyz[:, 0] > 5.0) & (xyz[:, 0] < 9.0)
    gone = (xyz[:, 0] > 18.0) & (xyz[:, 0] < 23.0)
    far = xyz.copy()
    beam = xyz[gone] - after.scanner_m[after.moment[gone]]
    far[gone] += beam * (6.0 / np.linalg.norm(beam, axis=1))[:, None]  # the same beams, 6 m farther
    second = replace(
        after,
        xyz_m=far[~hole],
        moment=after.moment[~hole],
        white_m2=after.white_m2[~hole],
        several_returns=after.several_returns[~hole],
    )
    table, _, volumes, _, seen = full(before, second)
    in_hole = table["east_m"].between(6.0, 8.0).to_numpy() & (seen["reason_1"] == "").to_numpy()
    through = table["east_m"].between(19.5, 21.5).to_numpy() & (table["normal_north"] < 0).to_numpy()
    through &= table["up_m"].between(1.0, 4.0).to_numpy() & (seen["reason_1"] == "").to_numpy()
    assert set(table["state"][in_hole]) == {"not seen in second"}
    assert set(seen["reason_2"][in_hole]) == {"not swept"}
    assert (table["state"][through] == "erosion").mean() > 0.95
    assert volumes["not_seen_m2"].iloc[0] > 15.0


def test_reasons_of_not_seen():
    """A wall behind another one, a place below the water, one out of range and one at a grazing angle."""
    rng = np.random.default_rng(8)
    east, up = rng.uniform(0.0, 30.0, 30_000), rng.uniform(0.5, 8.0, 30_000)
    wall = epoch(np.column_stack([east, np.full(30_000, 5.0), up]))
    settings = SETTINGS.replace(visibility=SETTINGS.visibility.replace(max_range_m=40.0))
    cores = np.array(
        [[15.0, 5.0, 3.0], [15.0, 9.0, 3.0], [15.0, 0.0, -0.5], [15.0, 90.0, 3.0], [15.0, -2.0, 6.0]]
    )
    normals = np.array([[0.0, -1.0, 0.0]] * 4 + [[0.0, 0.35, 0.94]])
    n = np.zeros((5, 2), dtype=np.int64)
    n[0] = 10
    seen = observe_visibility(cores, normals, n, (wall, wall), settings)
    assert seen["reason_1"].tolist() == ["", "occlusion", "water", "range", "incidence"]


def test_beams_count_only_where_they_pass_the_surface_and_end_behind_it():
    rng = np.random.default_rng(9)
    n = 40_000
    wall = epoch(np.column_stack([rng.uniform(0, 30, n), np.full(n, 8.0), rng.uniform(0.5, 4.5, n)]))
    settings = SETTINGS
    cores = np.array([[15.0, 2.0, 2.0], [15.0, 7.9, 2.0], [15.0, 12.0, 2.0]])
    normals = np.tile([0.0, -1.0, 0.0], (3, 1))
    through = beams_through(cores, normals, wall, settings)
    assert through[0] >= 3  # in front of the wall: passed
    assert through[1] == 0  # on the wall
    assert through[2] == 0  # behind it


def test_plants_and_objects_are_no_erosion():
    before, after = two_epochs(n=60_000, noise_m=0.01, sigma_m=0.003)
    rng = np.random.default_rng(10)
    xyz = after.xyz_m.copy()
    boulder = np.linalg.norm(xyz - xyz[np.argmin(np.abs(xyz - [20.0, 2.5, 2.5]).sum(axis=1))], axis=1) < 1.0
    xyz[boulder, 1] -= 0.8
    bush = (xyz[:, 0] > 8.0) & (xyz[:, 0] < 10.0)
    xyz[bush, 1] -= rng.uniform(0.0, 1.2, bush.sum())
    table, patches, _, _, _ = full(before, replace(after, xyz_m=xyz))
    states = table["state"]
    assert (states[table["east_m"].between(8.4, 9.6)] == "vegetation").mean() > 0.9
    assert 3 <= (states == "object").sum() <= 40
    assert "erosion" not in set(patches["what"])


def test_the_family_of_all_distances_keeps_its_level():
    before, after = two_epochs(n=6_000, sigma_m=0.03, noise_m=0.02)
    settings = SETTINGS.replace(core_spacing_m=1.0, control="family", draws=100)
    pair = measure_pair(place_core_points([before, after], settings, EVERYWHERE), before, after, settings)
    none = Registration(
        np.zeros(6),
        np.zeros((6, 6)),
        np.zeros((len(pair.cores), 6)),
        np.zeros((6, len(pair.cores))),
        pair.bare,
        {},
    )
    table, found, facts = compare_epochs(pair.cores, before, after, none, settings, 1)
    limit = facts["limit_of_normalised_distance"]
    assert 2.2 < limit < 4.2  # above a single test's 1.96, below Bonferroni's for several hundred
    z = np.abs(found.distance_m) / found.sigma_m
    assert (table["significant"] == (z >= limit)).all()


def test_a_series_shows_retreat_and_an_epoch_that_jumps():
    rng = np.random.default_rng(11)
    errors = {"sigma_m": 0.005, "noise_m": 0.01}
    epochs = []
    for i in range(5):
        xyz = bank(rng, 8_000)
        xyz[xyz[:, 0] < 8.0, 1] += 0.1 * i  # a quarter of the bank retreats by 0.1 m a year
        xyz[:, 2] += 0.2 * (i == 2)  # a base station with wrong heights
        epochs.append(epoch(xyz, name=f"epoch {i}", start_gps_s=i * 365.25 * 86_400.0, **errors))
    cores = place_core_points(epochs, SETTINGS.replace(core_spacing_m=1.0), EVERYWHERE)
    found = series_of_epochs(cores, epochs, SETTINGS.replace(core_spacing_m=1.0))
    fitted = fit_series(found.years, found.height_m, found.sigma_m)
    bare, moving = cores["east_m"] > 9.5, cores["east_m"] < 6.5
    rate = fitted["trend_m_a"] / cores["normal_north"]  # along north
    assert rate[moving & (cores["normal_north"] < -0.5)].median() == pytest.approx(0.1, abs=0.01)
    z = fitted["trend_m_a"][bare] / fitted["sigma_trend_m_a"][bare]
    assert np.nanmean(z**2) < 2.5
    jumps = find_jumps(found.raw_m, found.sigma_apart_m, limit=2.0)
    assert [jump.epoch for jump in jumps if jump.flagged] == [2]


def several(n: int, rng: np.random.Generator, **errors: float) -> list[Epoch]:
    """Epochs of one bank a year apart, without drawn errors."""
    return [epoch(bank(rng, 5_000), name=f"epoch {i}", start_gps_s=i * YEAR_S, **errors) for i in range(n)]


def test_all_epochs_are_registered_in_one_adjustment_that_closes():
    """Shifts of four epochs, a quarter of the bank that moved in one, and a hole in another."""
    rng = np.random.default_rng(31)
    errors = {"sigma_m": 0.004, "noise_m": 0.01}
    shift = np.array([[0.0, 0.0, 0.0], [0.04, -0.03, 0.05], [-0.05, 0.02, 0.0], [0.01, 0.06, -0.04]])
    epochs = []
    for given, moved in zip(several(4, rng, **errors), shift, strict=True):
        xyz = given.xyz_m + moved
        if moved[0] == -0.05:
            xyz[xyz[:, 0] < 7.0, 1] += 0.5
        epochs.append(replace(given, xyz_m=xyz))
    hole = (epochs[3].xyz_m[:, 0] > 20.0) & (epochs[3].xyz_m[:, 0] < 24.0)
    kept = {
        name: getattr(epochs[3], name)[~hole] for name in ("xyz_m", "moment", "white_m2", "several_returns")
    }
    epochs[3] = replace(epochs[3], **kept)
    settings = SETTINGS.replace(core_spacing_m=1.0)
    cores = place_core_points(epochs, settings, EVERYWHERE)
    found = series_of_epochs(cores, epochs, settings)
    motions = found.network.parameters
    assert motions.sum(axis=0) == pytest.approx(np.zeros(6), abs=1e-12)
    assert motions[1:, :3] - motions[0, :3] == pytest.approx(shift[1:], abs=0.012)
    # heights of the network close by themselves, whatever is summed up; pairs by themselves do not
    steps = np.diff(found.height_m, axis=0)
    assert np.nanmax(np.abs(steps.sum(axis=0) - found.height_m[-1])) < 1e-12
    assert found.misclosure.rms_m > 1e-5
    assert found.network.facts["stable_cores"] < found.network.facts["candidates"]
    still = cores["east_m"].between(9.0, 18.0).to_numpy()
    assert np.nanmax(np.abs(np.nanmedian(found.height_m[:, still], axis=1))) < 0.01


def test_two_epochs_in_a_network_are_registered_as_a_pair():
    before, after = two_epochs(n=8_000, sigma_m=0.01, noise_m=0.01)
    after = replace(after, xyz_m=after.xyz_m + np.array([0.03, 0.0, -0.02]))
    settings = SETTINGS.replace(core_spacing_m=1.0)
    cores = place_core_points([before, after], settings, EVERYWHERE)
    pair = measure_pair(cores, before, after, settings)
    alone = register_pair(pair, settings)
    one, two = (measure_epoch(cores, each, settings) for each in (before, after))
    along, white = np.array([one.cut.along_m, two.cut.along_m]), np.array([one.white_m, two.white_m])
    fields = joint_fields([one.field, two.field])
    places, normals = pair.found.cores_m, pair.found.normals
    network = coregister_network(places, normals, along, white, pair.bare, fields, settings)
    assert network.facts["model"] == "shift+heading"
    apart = network.parameters[1] - network.parameters[0]
    # weights of noise and field differ by what both epochs' weights make of each other
    assert apart == pytest.approx(alone.parameters, abs=2e-4)
    differs = np.hstack([-np.eye(6), np.eye(6)])
    sigma = np.sqrt(np.diag(differs @ network.cov @ differs.T))[[0, 1, 2, 5]]
    assert sigma == pytest.approx(np.sqrt(np.diag(alone.cov))[[0, 1, 2, 5]], rel=0.1)


def test_a_network_predicts_the_errors_of_its_heights():
    """Three epochs, fields drawn by the library: registered means and their weighted sums."""
    rng = np.random.default_rng(33)
    epochs = several(3, rng, sigma_m=0.03, sigma_rad=0.002, noise_m=0.02, time_s=6.0)
    settings = SETTINGS.replace(core_spacing_m=1.0)
    cores = place_core_points(epochs, settings, EVERYWHERE)
    every = [measure_epoch(cores, each, settings) for each in epochs]
    fields = joint_fields([each.field for each in every])
    white = np.array([each.white_m for each in every])
    along = np.array([each.cut.along_m for each in every])
    places = cores[["east_m", "north_m", "up_m"]].to_numpy()
    normals = cores[["normal_east", "normal_north", "normal_up"]].to_numpy()
    network = coregister_network(
        places, normals, along, white, is_bare(np.array([e.cut.std_m for e in every]).T), fields, settings
    )
    products = np.array([np.ones(len(cores)), cores["s_m"] > 0]) / len(cores)
    known = np.isfinite(white).all(axis=0)
    products[:, ~known] = 0.0
    left, sums = [], []
    for _ in range(300):
        error = np.array([each.field.draw(rng) for each in every]) + np.nan_to_num(
            white
        ) * rng.standard_normal(white.shape)
        motion = np.einsum("eafk,fk->ea", network.weights, error)
        rest = error - motion @ network.design.T
        left.append(rest[:, known])
        sums.append(rest @ products.T)
    ratio = np.var(left, axis=0) / network.variances(fields, white)[:, known]
    assert ratio.mean(axis=1) == pytest.approx(np.ones(3), abs=0.08)
    # 300 draws tell a variance to 8 %
    assert np.var(sums, axis=0) == pytest.approx(network.variances(fields, white, products), rel=0.3)


def test_a_stable_area_that_moved_between_two_of_the_epochs_is_refused():
    rng = np.random.default_rng(34)
    epochs = several(3, rng, sigma_m=0.003, noise_m=0.005)
    moved = epochs[2].xyz_m.copy()
    moved[moved[:, 0] < 8.0, 2] += 0.1
    areas = [
        [(float(low), -2.0), (low + 9.0, -2.0), (low + 9.0, 8.0), (float(low), 8.0)] for low in (0, 10, 20)
    ]
    settings = SETTINGS.replace(core_spacing_m=1.0, stable=areas)
    given = [*epochs[:2], replace(epochs[2], xyz_m=moved)]
    with pytest.raises(GeometryError, match=r"stable area 1 of 3 lies \+0\.0.* between epochs 2 and 3"):
        series_of_epochs(place_core_points(given, settings, EVERYWHERE), given, settings)
    far = [*epochs[:2], replace(epochs[2], xyz_m=epochs[2].xyz_m + np.array([0.0, 0.0, 0.9]))]
    with pytest.raises(GeometryError, match=r"epoch 3 lies 0\.\d+ m off the one before"):
        series_of_epochs(place_core_points(far, settings, EVERYWHERE), far, settings.replace(stable=None))


def test_a_tenth_of_the_correlation_time_and_half_the_sigma_are_seen():
    """Forty pairs of unchanged ground: the mean of the bank errs more than these fields say."""
    first, second = two_epochs(n=6_000, sigma_m=0.03, noise_m=0.01, time_s=10.0)
    settings = SETTINGS.replace(core_spacing_m=1.0, registration="none")
    cores = place_core_points([first, second], settings, EVERYWHERE)
    rng = np.random.default_rng(35)
    right: dict[str, list[float]] = {"stated": [], "a tenth of the time": [], "half the sigma": []}
    for _ in range(40):
        pair = measure_pair(cores, with_errors(first, rng), with_errors(second, rng), settings)
        use = np.isfinite(pair.found.distance_m)
        row = np.where(use, 1.0 / use.sum(), 0.0)
        mean = float(row @ np.nan_to_num(pair.found.distance_m))
        noise = float(np.sum((row * np.nan_to_num(pair.white_m)) ** 2))
        for name, time, size in (
            ("stated", 1.0, 1.0),
            ("a tenth of the time", 0.1, 1.0),
            ("half the sigma", 1.0, 0.5),
        ):
            groups = tuple(
                replace(g, correlation_s=time * g.correlation_s, root=size * g.root)
                for g in pair.field.groups
            )
            field = ErrorField(groups, pair.field.rows)
            right[name].append(mean**2 / (float(field.combined(row[None]).variances()[0]) + noise))
    low, high = chi2.ppf([0.005, 0.995], 40)
    assert low < sum(right["stated"]) < high
    assert sum(right["a tenth of the time"]) > high
    assert sum(right["half the sigma"]) > high


def test_both_lines_of_a_bank_retreat_by_what_was_cut_off_and_their_sigmas_hold():
    """A third of the bank moves by 0.6 m; the movement of the other stretches is error, forty times."""
    settings = SETTINGS.replace(core_spacing_m=1.0, registration="none", line_height_m=1.5)
    rng = np.random.default_rng(21)
    before, after = two_epochs(n=4_000, noise_m=0.01, sigma_m=0.02, time_s=5.0)
    cores = place_core_points([before, after], settings, EVERYWHERE)
    normalised = []
    for _ in range(40):
        first, second = with_errors(before, rng), with_errors(after, rng)
        moved = second.xyz_m.copy()
        moved[moved[:, 0] < 12.0, 1] += 0.6
        pair = measure_pair(cores, first, replace(second, xyz_m=moved), settings)
        found = registered_distances(pair, register_pair(pair, settings))
        table = pd.DataFrame({"distance_m": found.distance_m, "state": "no significant change"})
        lines = estimate_retreat(table, found, settings, water_m=0.0, years=2.0)
        assert set(lines["line"]) == {"bank line", "bank top"}
        assert lines["epr_m_a"].to_numpy() == pytest.approx(lines["nsm_m"].to_numpy() / 2.0)
        east = cores["east_m"].to_numpy()
        right = np.polyfit(east, cores["s_m"].to_numpy(), 1)[0] > 0
        starts = lines["s_from_m" if right else "s_to_m"] * (1 if right else -1) + east.mean()
        cut, still = starts < 6.0, starts > 13.0
        assert lines.loc[cut, "nsm_m"].to_numpy() == pytest.approx(-0.6, abs=0.15)
        normalised.append(np.mean((lines["nsm_m"] / lines["sigma_m"])[still] ** 2))
    low, high = band(2 * len(normalised))  # two stretches of a pair err by themselves
    assert low < np.mean(normalised) < high
