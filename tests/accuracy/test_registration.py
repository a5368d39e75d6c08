"""Rigid registration: known motions come back, undetermined ones are named, sigmas hold, Open3D agrees."""

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from tests.accuracy import bank_samples as bank
from thalweg.accuracy import ComparisonSettings, after_motion, chi_square_band, register, registration
from thalweg.accuracy.reference_comparison import registration_facts
from thalweg.accuracy.registration import CELLS, register_places, share_within_blocks
from thalweg.core import GeometryError
from thalweg.surface import LEAST_VISIBLE, Distances, Motion, Surface, visible_motions
from thalweg_lab.random_numbers import gauss_markov, generator

SETTINGS = ComparisonSettings(correlation_s=20.0)
RELIEF_M = 0.6


@pytest.fixture(scope="module")
def rough():
    """Relief of decimetres: all six motions are visible."""
    return Surface(bank.bank_mesh(relief_m=RELIEF_M))


@pytest.fixture(scope="module")
def plane():
    return Surface(bank.bank_mesh())


def table_of(xyz: np.ndarray, surface: Surface, t: np.ndarray | None = None) -> pd.DataFrame:
    n = len(xyz)
    small = np.full(n, 0.03)
    measured = pd.DataFrame(
        {
            "t_gps_s": np.linspace(0.0, 1e7, n) if t is None else t,
            "range_m": np.full(n, 20.0),
            "sigma_normal_m": small,
            "sigma_3d_m": small,
        }
    )
    return after_motion(measured, xyz, surface, SETTINGS)


def displaced(xyz: np.ndarray, shift: list[float], rotation_deg: list[float]) -> tuple[np.ndarray, Motion]:
    """A cloud before a motion that would bring it back, and that motion."""
    centre = xyz.mean(axis=0)
    R = Rotation.from_rotvec(np.deg2rad(rotation_deg)).as_matrix()
    back = Motion(centre_m=centre, R=R, shift_m=np.array(shift))
    return centre + (xyz - centre - back.shift_m) @ R, back


def worst(found: Motion, xyz: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.linalg.norm(found.apply(xyz) - wanted, axis=1).max())


@pytest.mark.parametrize(
    ("shift", "rotation_deg"),
    [
        ([0.02, -0.03, 0.05], [0.0, 0.0, 0.0]),
        ([0.0, 0.0, 0.0], [0.3, -0.2, 0.4]),
        ([-0.15, 0.10, -0.12], [-0.5, 0.3, 0.2]),
    ],
)
def test_a_known_motion_comes_back(rough, rng, shift, rotation_deg):
    wanted = bank.on_bank(rng, 20_000, relief_m=RELIEF_M)
    xyz, _ = displaced(wanted, shift, rotation_deg)
    found = register(table_of(xyz, rough), rough, SETTINGS)
    assert found.undetermined == ()
    # the mesh's chords of 10 cm leave the waves by up to 2 mm; a motion of all averages that
    assert worst(found.motion, xyz, wanted) < 0.002


def test_vegetation_in_front_does_not_pull(rough, rng):
    """A fifth of the points stands 0.2 to 1 m in front: the median of all is off, the registration is not."""
    wanted = bank.on_bank(rng, 20_000, relief_m=RELIEF_M)
    xyz, _ = displaced(wanted, [0.02, -0.03, 0.05], [0.1, 0.0, -0.1])
    noisy = xyz + 0.02 * rng.normal(size=xyz.shape)
    noisy[::5] += rng.uniform(0.2, 1.0, (len(noisy[::5]), 1)) * bank.OUT
    found = register(table_of(noisy, rough), rough, SETTINGS)
    # 2 cm of noise over 20,000 points and visibilities of 0.2: a millimetre; the near end of the plants pulls
    assert worst(found.motion, xyz, wanted) < 0.012
    assert np.mean(table_of(xyz, rough)["distance_m"]) < -0.025
    assert np.mean(table_of(noisy, rough)["distance_m"]) > 0.03


def test_a_plane_leaves_three_motions_and_names_them(plane, rng):
    wanted = bank.on_bank(rng, 20_000)
    tilt = np.cross(bank.OUT, bank.EAST)  # an axis in the plane
    xyz, _ = displaced(wanted, (0.06 * bank.OUT).tolist(), (0.2 * tilt).tolist())
    noisy = xyz + 0.02 * rng.normal(size=xyz.shape)
    found = register(table_of(noisy, plane), plane, SETTINGS)
    assert len(found.undetermined) == 3
    assert sum("shift along" in name for name in found.undetermined) == 2
    (turn,) = (name for name in found.undetermined if "rotation" in name)
    assert "north 0.50, up 0.87" in turn
    assert not any("with" in name for name in found.undetermined)
    # held fixed: nothing along the plane, and no sigma there
    for direction in (bank.EAST, bank.UP_SLOPE):
        assert abs(found.motion.shift_m @ direction) < 1e-4
        assert direction @ found.cov[:3, :3] @ direction < 1e-12
    assert abs(found.rotation_rad @ bank.OUT) < 1e-5
    assert found.motion.shift_m @ bank.OUT == pytest.approx(0.06, abs=0.001)
    assert np.rad2deg(found.rotation_rad @ tilt) == pytest.approx(0.2, abs=0.01)
    assert (found.visibility < LEAST_VISIBLE).sum() == 3


def test_visibility_does_not_depend_on_the_centre(rough, rng):
    """Rotations about another place are the same motions, with other shifts."""
    xyz = bank.on_bank(rng, 5000, relief_m=RELIEF_M)
    normal = rough.distances(xyz).normal
    found = []
    for aside in (np.zeros(3), np.array([5.0, -3.0, 2.0])):
        centre = xyz.mean(axis=0) + aside
        rates = np.hstack([normal, np.cross(xyz - centre, normal)])
        found.append(visible_motions(xyz, rates, centre)[0])
    assert found[0].min() > LEAST_VISIBLE
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)


def test_noise_of_the_reference_does_not_feign_relief(rng):
    """Triangles of 5 cm with 5 mm of noise look in all directions: the mean normals of cells do not."""
    mesh = bank.bank_mesh(20.0, 6.0, step_m=0.05)
    noisy = type(mesh)(
        vertices_m=mesh.vertices_m + 0.005 * rng.normal(size=(len(mesh.vertices_m), 1)) * bank.OUT,
        faces=mesh.faces,
        sigma_m=mesh.sigma_m,
    )
    surface = Surface(noisy)
    normals = noisy.face_normals()
    assert np.sqrt(np.mean((normals @ bank.EAST) ** 2)) > LEAST_VISIBLE
    xyz = bank.on_bank(rng, 20_000, length_m=20.0, width_m=6.0) - 0.05 * bank.OUT
    assert len(register(table_of(xyz, surface), surface, SETTINGS).undetermined) == 3


class Plane:
    """The plane of the bank without end; as fast as the trials below need it."""

    def distances(self, points_m: np.ndarray) -> Distances:
        n = len(points_m)
        distance = (points_m - bank.CORNER) @ bank.OUT
        return Distances(
            distance_m=distance,
            nearest_m=points_m - distance[:, None] * bank.OUT,
            normal=np.broadcast_to(bank.OUT, (n, 3)),
            face=np.zeros(n, dtype=np.int64),
            at_border=np.zeros(n, dtype=bool),
            sigma_m=np.zeros(n),
        )


TAU_S = 5.0
TRIALS = 60
TILTS = (np.cross(bank.OUT, bank.EAST), bank.EAST)
"""Axes in the plane: the first tilts the bank along the river, the second up its slope."""


def survey(
    rng: np.random.Generator, *, duration_s: float, plants: float = 0.0, n: int = 3000
) -> tuple[np.ndarray, np.ndarray]:
    """A cloud of the plane bank from one pass along it, with errors of the poses, and the points' times.

    The boat errs by 4 cm, its roll and heading by 0.3 degrees, all over `TAU_S`; the lidar by 2 cm. A share
    ``plants`` of the points stands in front, at places that are the same for all trials of a kind.
    """
    t = np.sort(rng.uniform(0.0, duration_s, n))
    boat = 4.5 + 31.0 * t / duration_s
    along, up = boat + rng.uniform(-4, 4, n), rng.uniform(0.5, 7.5, n)
    nodes = np.linspace(0.0, duration_s, int(20 * duration_s / TAU_S))

    def pose(sigma: float) -> np.ndarray:
        return np.interp(t, nodes, gauss_markov(rng, len(nodes), nodes[1], sigma, TAU_S))

    angle = np.deg2rad(0.3)
    error = pose(0.04) + pose(angle) * (up - 4.0) + pose(angle) * (along - boat) + rng.normal(0, 0.02, n)
    error += np.where(rng.random(n) < plants, rng.uniform(0.3, 1.0, n), 0.0)
    return bank.place(along, up, 0.0) + error[:, None] * bank.OUT, t


@pytest.mark.parametrize(("duration_s", "plants"), [(400.0, 0.0), (120.0, 0.0), (400.0, 0.1)])
def test_sigmas_of_shift_and_tilt_are_consistent(duration_s, plants):
    """Errors over predicted sigmas have the size they should have: neither larger nor smaller."""
    rng = generator(17, f"registration {duration_s} {plants}")
    settings = ComparisonSettings(correlation_s=TAU_S)
    squared, beyond, pulled = [], 0, []
    for _ in range(TRIALS):
        xyz, t = survey(rng, duration_s=duration_s, plants=plants)
        found = register(table_of(xyz, Plane(), t), Plane(), settings)
        values = np.array([found.motion.shift_m @ bank.OUT, *(found.rotation_rad @ a for a in TILTS)])
        C = found.cov
        variances = [bank.OUT @ C[:3, :3] @ bank.OUT, *(a @ C[3:, 3:] @ a for a in TILTS)]
        squared.append(values**2 / variances)
        pulled.append(values[0])
        size, limit = found.significance()
        beyond += size > limit
    # the square of Student's t with B - 1 degrees of freedom has this expectation, and nearly the spread of a
    # chi-square with one value a trial; 99 % for each of three kinds
    size_of_errors = np.mean(squared, axis=0) / ((found.blocks - 1) / (found.blocks - 3))
    low, high = chi_square_band(TRIALS, 0.99)
    assert size_of_errors.max() < high, size_of_errors
    assert size_of_errors[:2].min() > low, size_of_errors
    # a tilt up the slope is measured anew in each sweep: half of its error is white in time, and for that the
    # covariance is too large by up to what sums over blocks hold of the other half
    assert size_of_errors[2] > share_within_blocks(found.block_s, TAU_S) * low, size_of_errors
    # 5 % are meant; 60 trials know that to 2.8 %: 3.3 of these
    assert 0.0 < beyond / TRIALS < 0.143


@pytest.mark.parametrize("tilt_deg", [0.3, 0.5, 0.8])
def test_a_planted_tilt_is_more_than_poses_explain(tilt_deg):
    """A tilt of the whole cloud up the slope, as of a wrong mount, in a survey of twelve blocks."""
    xyz, t = survey(generator(3, "planted tilt"), duration_s=120.0)
    settings = ComparisonSettings(correlation_s=TAU_S)
    for tilt, more in ((0.0, False), (tilt_deg, True)):
        tilted, _ = displaced(xyz, [0.0, 0.0, 0.0], (tilt * bank.EAST).tolist())
        before = table_of(tilted, Plane(), t)
        found = register(before, Plane(), settings)
        size, limit = found.significance()
        assert (size > limit) == more, (size, limit)
        words = registration_facts(found, before, before)["words"]
        assert ("This is more than errors that change with time explain, by 12 time blocks" in words) == more
        assert ("This is within what errors" in words) != more
        assert ("an error of the mount or of the reference" in words) == more
        sigma = np.rad2deg(np.sqrt(bank.EAST @ found.cov[3:, 3:] @ bank.EAST))
        # found with four sigmas; the tilt of the errors themselves is within them
        assert np.rad2deg(found.rotation_rad @ bank.EAST) == pytest.approx(tilt, abs=4 * sigma)
        assert sigma < 0.1


def test_facts_say_what_was_removed(plane, rng):
    xyz = bank.on_bank(rng, 5000) - 0.055 * bank.OUT + 0.02 * rng.normal(size=(5000, 3))
    before = table_of(xyz, plane)
    found = register(before, plane, SETTINGS)
    after = after_motion(before, found.motion.apply(xyz), plane, SETTINGS)
    facts = json.loads(json.dumps(registration_facts(found, before, after)))
    change = facts["change"]["all"]
    assert change["bias_before_m"] == pytest.approx(-0.055, abs=0.001)
    assert change["share_of_bias_removed"] > 0.98
    assert change["rmse_after_m"] == pytest.approx(0.02, abs=0.001)
    assert "from -55 to 0 mm" in facts["words"].replace("-0", "0")
    assert "more than errors that change with time explain" in facts["words"]
    assert "Not determined by this surface, and left: shift along" in facts["words"]
    R, centre = np.array(facts["rotation_matrix"]), np.array(list(facts["centre_m"].values()))
    again = centre + (xyz - centre) @ R.T + np.array(list(facts["shift_m"].values()))
    np.testing.assert_allclose(again, found.motion.apply(xyz), atol=1e-9)


def test_a_short_survey_is_too_short_to_test(plane):
    """Five blocks for three motions: a spread of nothing."""
    xyz, t = survey(generator(5, "short"), duration_s=50.0)
    before = table_of(xyz, plane, t)
    found = register(before, plane, ComparisonSettings(correlation_s=TAU_S))
    assert (found.cov, found.significance(), found.blocks_needed) == (None, None, 6)
    facts = registration_facts(found, before, before)
    assert (
        "too short to test that, or to give its sigmas: it is worth 5 time blocks of 10 s, 6 are needed"
        in (facts["words"])
    )
    assert facts["sigma_shift_m"] == {"east": None, "north": None, "up": None}
    json.dumps(facts, allow_nan=False)


def test_what_cannot_be_registered(plane, rng):
    few = table_of(bank.on_bank(rng, 60), plane)
    with pytest.raises(GeometryError, match="60 points to register; expected at least 100"):
        register(few, plane, SETTINGS)
    line = table_of(bank.place(np.linspace(1, 39, 500), np.full(500, 4.0), 0.0), plane)
    with pytest.raises(GeometryError, match="all points lie on a line"):
        register(line, plane, SETTINGS)
    tilted, _ = displaced(bank.on_bank(rng, 3000), [0.0, 0.0, 0.0], [0.0, 14.0, 0.0])
    wide = ComparisonSettings(max_distance_m=8.0)
    with pytest.raises(GeometryError, match=r"wanders off.*10 degrees"):
        register(table_of(tilted, plane).assign(used=True), plane, wide)


def test_full_steps_circle_on_stony_ground_and_shorter_ones_do_not(rng, monkeypatch):
    """On the twin's banks nearest places jumped between faces, 0.02 to 3 mm to and fro, for ever."""
    smooth = bank.bank_mesh(step_m=0.1)
    stones = smooth.vertices_m + 0.04 * rng.standard_normal((len(smooth.vertices_m), 1)) * bank.OUT
    surface = Surface(dataclasses.replace(smooth, vertices_m=stones))
    xyz = bank.on_bank(rng, 2_000) + 0.05 * rng.standard_normal((2_000, 3)) + [0.0, 0.02, 0.03]
    table = table_of(xyz, surface)
    found = register(table, surface, SETTINGS)
    assert found.iterations < registration.MOST_ITERATIONS
    assert found.last_step_m < registration.JITTER * found.spread_m
    # 2,000 points of 6 cm about the surface leave the offset of 36 mm uncertain by 1.5 mm; four of these
    assert found.motion.shift_m @ bank.OUT == pytest.approx(
        -(0.02 * bank.OUT[1] + 0.03 * bank.OUT[2]), abs=0.006
    )
    monkeypatch.setattr(registration, "LEAST_GAIN", -np.inf)
    monkeypatch.setattr(registration, "JITTER", 0.0)
    with pytest.raises(GeometryError, match="no convergence"):
        register(table, surface, SETTINGS)


def test_sigmas_of_shift_and_rotation_keep_their_names_and_units(plane, rng):
    """East, north, up 1, 2, 3 mm; 0.01, 0.02, 0.03 degrees."""
    before = table_of(bank.on_bank(rng, 3000), plane)
    sigma = np.array([0.001, 0.002, 0.003, *np.deg2rad([0.01, 0.02, 0.03])])
    turn = Rotation.from_rotvec(np.deg2rad([0.1, -0.2, 0.3])).as_matrix()
    found = dataclasses.replace(
        register(before, plane, SETTINGS),
        cov=np.diag(sigma**2),
        motion=Motion(centre_m=np.array([7.0, 8.0, 9.0]), R=turn, shift_m=np.array([0.01, -0.02, 0.03])),
    )
    facts = registration_facts(found, before, before)
    assert facts["centre_m"] == {"east": 7.0, "north": 8.0, "up": 9.0}
    assert facts["shift_m"] == {"east": 0.01, "north": -0.02, "up": 0.03}
    assert facts["sigma_shift_m"] == pytest.approx({"east": 0.001, "north": 0.002, "up": 0.003})
    assert facts["rotation_deg"] == pytest.approx({"east": 0.1, "north": -0.2, "up": 0.3})
    assert facts["sigma_rotation_deg"] == pytest.approx({"east": 0.01, "north": 0.02, "up": 0.03})


def test_a_cloud_without_times_rests_on_cells_in_plan(rough, rng, monkeypatch):
    """As many points as may take part, each once; cells of the area over their number."""
    wanted = bank.on_bank(rng, 6000, relief_m=RELIEF_M)
    xyz, _ = displaced(wanted, [0.02, -0.03, 0.05], [0.1, -0.1, 0.1])
    monkeypatch.setattr(registration, "MOST_POINTS", 5000)
    fit, given = registration._fit, []

    def seen(points, *rest):
        given.append(points)
        return fit(points, *rest)

    monkeypatch.setattr(registration, "_fit", seen)
    found = register_places(xyz, rough, 0.5)
    assert (len(given[0]), len(np.unique(given[0], axis=0))) == (5000, 5000)
    assert worst(found.motion, xyz, wanted) < 0.003
    span = np.ptp(given[0][:, :2], axis=0)
    assert found.cell_m == pytest.approx(np.sqrt(span[0] * span[1] / CELLS), rel=0.01)
    assert found.cells == pytest.approx(CELLS, rel=0.35)
    assert found.cov is not None
    assert found.n == pytest.approx(5000, rel=0.01)
