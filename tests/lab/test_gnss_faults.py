"""The receiver under a bridge, under leaves, on one frequency: kinds of solution, sigmas and errors."""

import json

import numpy as np
import pytest
from numpy.testing import assert_allclose
from sbp.client import Framer
from sbp.client.drivers.file_driver import FileDriver

from tests.bands import band
from tests.lab.conftest import ANTENNA_M, FRAME, SEED
from tests.lab.sheets import GROUND, scene_of, sheet
from thalweg.ingest.sbp import find_messages, read_sbp
from thalweg.ingest.tracks import read_pos
from thalweg_lab.instruments import (
    Solution,
    antenna_errors_m,
    multipath_errors_m,
    simulate_gnss,
    stated_sigmas_m,
)
from thalweg_lab.river import Material
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import Voyage, epochs


def twin(duration_s=25.0, **gnss):
    """A boat that goes straight down the river."""
    return TwinConfig.of_size("tiny", duration_s=duration_s, gnss=gnss, boat={"zigzag_deg": 0.0})


LEAVES = scene_of(GROUND, (sheet([60, 0, 0], [0, 300, 0], [0, 0, 300]), Material.LEAF))
"""A wall of leaves in the east of the whole track."""


def roof(t_s, half_along_m, above_m):
    """A level sheet over the track of the boat at a time, 80 m across it."""
    voyage = Voyage(twin(), SEED)
    t = np.array([voyage.start_gps_s + t_s])
    place = voyage.sensor_wcs_m(t, ANTENNA_M)[0]
    v = voyage.velocity_wcs_mps(t)[0] * [1, 1, 0]
    v /= np.linalg.norm(v)
    return sheet(place + np.array([0, 0, above_m]), half_along_m * v, 40.0 * np.array([-v[1], v[0], 0.0]))


@pytest.fixture
def record(tmp_path):
    """Record the receiver in a scene; facts and folder."""

    def run(name, config, scene=None):
        folder = tmp_path / name
        path = None if scene is None else folder / "scene.npz"
        if scene is not None:
            scene.write(path)
        facts = simulate_gnss(
            config,
            SEED,
            FRAME,
            folder / "rover.sbp",
            folder / "ppk.pos",
            lever_ics_antenna_m=ANTENNA_M,
            scene=path,
            out_effects=folder / "gnss.json",
        )
        assert json.loads((folder / "gnss.json").read_text()) == json.loads(
            json.dumps({"stream": "gnss", **facts})
        )
        return facts, folder

    return run


# ---------------------------------------------------------------- logs


def velocities(path):
    """North, east, down (n, 3) and their sigmas (n, 2) in m/s of MsgVelNED, which the reader leaves aside."""
    found = find_messages(np.frombuffer(path.read_bytes(), np.uint8))
    layout = np.dtype([("tow", "<u4"), ("ned", "<i4", 3), ("sigma", "<u2", 2), ("end", "u1", 2)])
    fields = found.payloads(np.flatnonzero(found.kind == 0x020E), layout.itemsize).view(layout)[:, 0]
    return fields["ned"] * 1e-3, fields["sigma"] * 1e-3


def test_the_velocities_have_their_stated_sigma_two_sided(record):
    _, exact = record("exact", twin(sigma_velocity_mps=0.0))
    _, noisy = record("noisy", twin())
    _, loud = record("loud", twin(sigma_velocity_mps=0.3))
    assert (exact / "ppk.pos").read_bytes() == (noisy / "ppk.pos").read_bytes()
    before, after = (read_sbp([f / "rover.sbp"]).positions for f in (exact, noisy))
    assert before.equals(after)
    t = after["t_gps_s"].to_numpy()
    true = Voyage(twin(), SEED).sensor_velocity_wcs_mps(t, ANTENNA_M)[:, [1, 0, 2]] * [1, 1, -1]
    # Whole millimetres per second.
    assert_allclose(velocities(exact / "rover.sbp")[0], true, atol=6e-4)
    for folder, sigma in ((noisy, 0.03), (loud, 0.3)):
        ned_mps, stated = velocities(folder / "rover.sbp")
        error = ned_mps - true
        n = error.size
        assert n > 800
        # Two-sided, four sigma of a standard deviation from n values.
        assert abs(error.std() / sigma - 1.0) < 4 / np.sqrt(2 * n)
        # New in each epoch: the correlation of neighbours is known to 1 / sqrt(n).
        assert abs(np.mean(error[1:] * error[:-1])) < 4 / np.sqrt(n) * sigma**2
        assert_allclose(stated, sigma, rtol=1e-9)


def test_a_low_bridge_makes_one_outage(record):
    """A deck 1.5 m above the antenna and 20 m wide: seen from its middle it reaches down to 9 degrees."""
    config = twin(shadow=True, refix_s=5.0)
    scene = scene_of(GROUND, (roof(10.0, 10.0, 1.5), Material.WALL))
    facts, folder = record("bridge", config, scene)
    since0 = Voyage(config, SEED).start_gps_s
    for engine, table in (
        ("ppk", read_pos([folder / "ppk.pos"]).positions),
        ("rtk", read_sbp([folder / "rover.sbp"]).positions),
    ):
        gone = [span for span in facts["spans_not_fixed"][engine] if span[2] == "none"]
        assert len(gone) == 1, facts["spans_not_fixed"]
        begin, length, _ = gone[0]
        # 20 m at 2.4 m/s are 8.3 s under the deck; from its edges half of the sky is seen.
        assert 5.8 < begin < 9.0
        t = table["t_gps_s"].to_numpy() - since0
        assert not ((t > begin - 1e-3) & (t < begin + length - 1e-3)).any()
        holes = np.diff(t)
        assert np.sum(holes > 0.15) == 1
        assert holes.max() == pytest.approx(length + 0.1, abs=1e-3)
        kinds = table["fix"].value_counts().to_dict()
        assert kinds == {k: n for k, n in facts["solutions"][engine].items() if n and k != "none"}
        # Within 3 s of the start and at the end the deck is far away.
        assert (table["fix"][(t < 3) | (t > 24)] == "fixed").all()
        assert table["n_sats"].min() >= 4
    floats = {
        engine: sum(s[1] for s in facts["spans_not_fixed"][engine] if s[2] == "float")
        for engine in ("rtk", "ppk")
    }
    assert floats["rtk"] > floats["ppk"] + 3.0, "forward and backward fix sooner than forward alone"
    assert facts["sky"]["blocked"]["max"] > 15


def test_stated_sigmas_grow_with_the_dilution(record):
    """A wall of leaves in the east of the whole track: fixed still, with quarter weights there."""
    config = twin(8.0, shadow=True)
    facts, folder = record("leaves", config, LEAVES)
    table = read_pos([folder / "ppk.pos"]).positions
    assert facts["sky"]["dimmed"]["min"] > 3
    sigmas = table[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].to_numpy()
    assert (sigmas > [0.02, 0.02, 0.03]).all()
    # All satellites at a quarter of the weight would double them; geometry alone at most some more.
    assert (sigmas < 3 * np.array([0.02, 0.02, 0.03])).all()
    # One factor for errors and sigmas: the same draw, in units of the sigmas, as in the open.
    t = epochs(config, 10.0)
    error = FRAME.from_geodetic(table["lat_deg"], table["lon_deg"], table["h_ell_m"]) - Voyage(
        config, SEED
    ).sensor_wcs_m(t, ANTENNA_M)
    kinds = np.full(len(t), int(Solution.FIXED))
    unit = antenna_errors_m(config, SEED, "ppk", kinds, np.ones((len(t), 3)))
    # .pos states tenths of millimetres: 0.05 mm of 20 mm, and 0.06 mm in the position.
    assert_allclose(error / sigmas, unit, atol=0.02)


@pytest.mark.parametrize("kind", [Solution.SINGLE, Solution.FLOAT, Solution.FIXED])
def test_errors_are_as_large_as_stated_two_sided_and_larger_with_multipath(kind):
    """Over seeds, one epoch each: with multipath the errors leave the band of the stated sigmas."""
    config = twin(8.0, multipath_m={1: 1.0, 2: 0.5, 3: 0.05}[int(kind)])
    growth = np.array([[1.3, 1.7, 2.1]])
    kinds = np.array([int(kind)])
    sigmas = stated_sigmas_m(config.gnss, kinds, growth)
    share = np.array([0.8])
    off, on = [], []
    for seed in range(300):
        error = antenna_errors_m(config, seed, "ppk", kinds, sigmas)
        off.append(error / sigmas)
        on.append((error + multipath_errors_m(config, seed, share)) / sigmas)
    low, high = band(3 * 300)
    assert low < np.mean(np.square(off)) < high
    extra = np.mean((0.8 * config.gnss.multipath_m / sigmas) ** 2)
    assert extra > 0.5
    assert low < np.mean(np.square(on)) / (1 + extra) < high
    assert np.mean(np.square(on)) > high


def test_multipath_is_in_no_sigma_and_moves_both_engines_alike(record):
    _, off = record("off", twin(8.0), LEAVES)
    facts, on = record("on", twin(8.0, multipath_m=0.5), LEAVES)
    moved = {}
    for name, reader, digits in (("ppk.pos", read_pos, 3e-4), ("rover.sbp", read_sbp, 1e-6)):
        a, b = (reader([f / name]).positions for f in (off, on))
        assert a.drop(columns=["lat_deg", "lon_deg", "h_ell_m"]).equals(
            b.drop(columns=["lat_deg", "lon_deg", "h_ell_m"])
        )
        places = [FRAME.from_geodetic(x["lat_deg"], x["lon_deg"], x["h_ell_m"]) for x in (a, b)]
        moved[name] = (places[1] - places[0], digits)
    assert_allclose(moved["ppk.pos"][0], moved["rover.sbp"][0], atol=3e-4)
    rms = np.sqrt(np.mean(moved["rover.sbp"][0] ** 2, axis=0))
    assert_allclose(rms, facts["multipath_rms_m"], rtol=1e-5)
    share = facts["sky"]["dimmed"]["mean"] / (facts["sky"]["dimmed"]["mean"] + facts["sky"]["free"]["mean"])
    # One observation: an error of each of three axes for each correlation time of 5 s; the 300 seeds of the
    # test above are the guard.
    low, high = band(3 * 12.0 / 5.0)
    assert low < np.mean(rms**2) / (0.5 * share) ** 2 < high


# ---------------------------------------------------------------- single frequency


def test_a_single_frequency_track_as_in_p1(record):
    config = twin(8.0, mode="single_frequency")
    facts, folder = record("single", config)
    pos, rover = read_pos([folder / "ppk.pos"]).positions, read_sbp([folder / "rover.sbp"]).positions
    assert facts["mode"] == "single_frequency"
    assert facts["solutions"]["ppk"]["single"] == len(pos) == len(rover) == facts["epochs"]
    names = ["sigma_east_m", "sigma_north_m", "sigma_up_m"]
    for table in (pos, rover):
        assert set(table["fix"]) == {"single"}
        assert_allclose(table[names], np.tile([0.6, 0.6, 1.0], (len(table), 1)), rtol=1e-6)
    places = [FRAME.from_geodetic(x["lat_deg"], x["lon_deg"], x["h_ell_m"]) for x in (pos, rover)]
    # One sky, one ionosphere: both programs find the same place, to the digits of .pos.
    assert_allclose(places[0], places[1], atol=2e-4)
    # No base: nothing comes over the radio, from sender 0.
    with FileDriver((folder / "rover.sbp").open("rb")) as driver, Framer(driver.read, None) as framer:
        assert {message.sender for message, _ in framer} == {0x2EFB}
