"""Numbers of a synchronised run: each under its own name; which variants are tried, with what."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from thalweg.clocks import Track
from thalweg.clocks.camera_offset import OffsetOptions
from thalweg.clocks.synchronise import (
    Synchronised,
    _numbers,
    antenna_track,
    offset_options,
    run_attitude,
    run_facts,
    synchronise_run,
)
from thalweg.core import ClockError, CoverageError, GeometryError, LocalFrame, rotation_enu_body

FRAME = LocalFrame(lat_deg=51.0, lon_deg=13.0, h_ell_m=120.0)


def test_every_number_of_a_run_stands_under_its_name():
    sigma = np.array([0.001, 2e-6, 0.003, 0.004, 0.005])
    clock = SimpleNamespace(
        offset_s=1.25, sigma_offset_s=0.001, drift=3e-6, sigma_drift=2e-6, jitter_s=0.02, sigma_jitter_s=0.007
    )
    found = _numbers(
        SimpleNamespace(
            clock=clock,
            run_offset_s=1.5,
            sigma_run_offset_s=0.0015,
            cov=np.diag(sigma**2),
            lever_ccs_antenna_m=np.array([0.1, -0.2, 0.3]),
            sigma0_squared=1.1,
            images=pd.DataFrame({"used": [True, False, True]}),
        )
    )
    expected = {
        "offset_s": 1.25, "sigma_offset_s": 0.001, "run_offset_s": 1.5, "sigma_run_offset_s": 0.0015,
        "drift_ppm": 3.0, "sigma_drift_ppm": 2.0, "jitter_s": 0.02, "sigma_jitter_s": 0.007,
        "dx_m": 0.1, "dy_m": -0.2, "dz_m": 0.3, "sigma_dx_m": 0.003, "sigma_dy_m": 0.004, "sigma_dz_m": 0.005,
        "sigma0_squared": 1.1, "images_used": 2,
    }  # fmt: skip
    assert list(found) == list(expected)
    assert_allclose(list(found.values()), list(expected.values()), rtol=1e-12)


def offset_of(name: str) -> SimpleNamespace:
    """A result whose numbers are of no interest but one."""
    clock = SimpleNamespace(
        offset_s=float(len(name)), sigma_offset_s=0.1, drift=0.0, sigma_drift=0.0, jitter_s=0.0,
        sigma_jitter_s=0.0, notes=("a note",),
    )  # fmt: skip
    motion = SimpleNamespace(speed_mps=1.0, speed_change_mps=2.0, turned_deg=3.0, turn_rate_degps=4.0)
    return SimpleNamespace(
        clock=clock, run_offset_s=0.0, sigma_run_offset_s=0.0, cov=np.diag(np.arange(1.0, 6.0)),
        lever_ccs_antenna_m=np.zeros(3), sigma0_squared=1.0, sigma0_low=0.8, sigma0_high=1.2,
        images=pd.DataFrame({"used": [True]}), names=("offset", "drift", "x", "y", "z"), R_ics_ccs=np.eye(3),
        motion=motion, facts={"images": 7},
    )  # fmt: skip


def line(n: int = 8, *, share: float = 0.3) -> Track:
    t = np.arange(float(n))
    return Track(
        t_gps_s=t,
        position_m=np.column_stack([t, 2 * t, 3 * t]),
        cov_m2=np.tile(np.eye(3), (n, 1, 1)),
        white_share=share,
    )


@pytest.mark.parametrize(
    ("ins", "refused", "used"),
    [
        (None, (), "positions"),
        ("ins", (), "positions and attitude"),
        ("ins", ("p2", "positions"), "positions and attitude"),
        (None, ("p2",), "positions"),
        ("ins", ("positions and attitude",), None),
        (None, ("positions",), None),
    ],
)
def test_variants_of_a_run(ins, refused, used, monkeypatch):
    """P2's own without correlations, drift and jitter; all errors; attitudes too. The last one counts."""
    asked = []

    def camera_offset(poses, track, *, ins, field_error, options):
        name = "positions and attitude" if ins else "p2" if field_error is None else "positions"
        asked.append((name, track.white_share, options))
        if name in refused:
            raise ClockError(f"no {name}", expected="more")
        return offset_of(name)

    monkeypatch.setattr("thalweg.clocks.synchronise.camera_offset", camera_offset)
    options = OffsetOptions(jitter_s=0.02, sigma_drift=1e-5, largest_sigma_s=0.05, largest_offset_s=9.0)
    how = {"ins": ins, "field_error": "shared", "options": options}
    if used is None:
        with pytest.raises(ClockError, match=f"no {refused[0]}"):
            synchronise_run("poses", line(), **how)
        return
    found = synchronise_run("poses", line(), **how)
    names = ["p2", "positions", *(["positions and attitude"] if ins else [])]
    assert (found.variant, found.result.clock.offset_s) == (used, len(used))
    assert found.variants["variant"].tolist() == names
    assert found.variants["refused"].tolist() == [
        f"no {name}; expected more." if name in refused else "" for name in names
    ]
    assert [name for name, _, _ in asked] == names
    assert [share for _, share, _ in asked] == [1.0, 0.3, 0.3][: len(names)]
    plain = asked[0][2]
    assert (plain.jitter_s, plain.sigma_drift, plain.largest_sigma_s, plain.largest_offset_s) == (
        0,
        0,
        np.inf,
        9,
    )
    assert all(o is options for _, _, o in asked[1:])


def test_facts_of_a_run():
    found = offset_of("positions")
    told = run_facts(Synchronised(result=found, variant="positions", variants=pd.DataFrame()))
    expected = {
        "variant": "positions",
        "sigma0_squared_band": [0.8, 1.2],
        "names": ["offset", "drift", "x", "y", "z"],
        "cov": np.diag(np.arange(1.0, 6.0)).tolist(),
        "R_ics_ccs": np.eye(3).tolist(),
        "motion": {"speed_mps": 1.0, "speed_change_mps": 2.0, "turned_deg": 3.0, "turn_rate_degps": 4.0},
        "images": 7,
        "notes": ["a note"],
    }
    assert told == told | expected | _numbers(found)
    found.R_ics_ccs = None
    assert run_facts(Synchronised(result=found, variant="p2", variants=pd.DataFrame()))["R_ics_ccs"] is None


def test_attitudes_and_options_of_a_run():
    degree = np.pi / 180
    states = pd.DataFrame(
        {
            "t_gps_s": [2.0, 1.0, 1.0, 3.0, np.nan],
            "roll_rad": [0.1, 0.2, 9.0, np.nan, 0.0],
            "pitch_rad": 0.05,
            "heading_rad": [1.0, 1.1, 9.0, 1.0, 1.0],
            "lat_deg": 51.3,
            "lon_deg": 13.4,
            "sigma_roll_rad": [0.02, 0.04, 9.0, 9.0, 9.0],
            "sigma_pitch_rad": 0.0,
        }
    )
    how = {"use_attitude": True, "attitude_time_s": 17.0, "high_pass_s": 33.0}
    found = run_attitude(states, FRAME, how)
    assert found.t_gps_s.tolist() == [1.0, 2.0]
    level = FRAME.R_wcs_enu(51.3, 13.4)
    assert_allclose(found.R_wcs_ics[0], level @ rotation_enu_body(0.2, 0.05, 1.1))
    # the median of what is stated; what is not stated, or as nothing, is that of the maker's table
    assert_allclose(found.sigma_rad, [0.03, 0.1 * degree, 0.2 * degree])
    assert (found.correlation_time_s, found.high_pass_s) == (17.0, 33.0)
    with pytest.raises(CoverageError, match="1 INS states"):
        run_attitude(states[1:3], FRAME, how)
    options = offset_options(
        {
            "largest_offset_s": 1.0,
            "largest_lever_m": 2.0,
            "sigma_drift_ppm": 3.0,
            "jitter_s": 0.04,
            "largest_sigma_s": 0.05,
        }
    )
    assert options.sigma_drift == pytest.approx(3e-6)
    stated = options.largest_offset_s, options.largest_lever_m, options.jitter_s, options.largest_sigma_s
    assert stated == (1.0, 2.0, 0.04, 0.05)


def test_a_track_of_the_best_kind_of_fix():
    """Six epochs of one kind are needed; sigmas and covariances stand where they belong."""
    n = 14
    fix = ["float"] * 7 + ["fixed"] * 7
    positions = pd.DataFrame(
        {
            "t_gps_s": [*np.arange(13.0, 0.0, -1.0), 1.0],
            "lat_deg": 51.0,
            "lon_deg": 13.0,
            "h_ell_m": 120.0 + np.arange(n),
            "sigma_east_m": 0.1,
            "sigma_north_m": 0.2,
            "sigma_up_m": 0.3,
            "cov_en_m2": 0.001,
            "cov_eu_m2": 0.002,
            "cov_nu_m2": np.nan,
            "fix": fix,
        }
    )
    how = {"correlation_time_s": 12.0, "white_share": 0.4}
    found = Track.from_table(positions, FRAME, **how)
    # rows 7 to 12 of the file, from the last one on; the other one of 1 s is left out
    assert found.t_gps_s.tolist() == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert_allclose(found.position_m[:, 2], np.arange(12.0, 6.0, -1.0), atol=1e-6)
    C = [[0.01, 0.001, 0.002], [0.001, 0.04, 0.0], [0.002, 0.0, 0.09]]
    assert_allclose(found.cov_m2, np.tile(C, (6, 1, 1)))
    assert (found.correlation_time_s, found.white_share) == (12.0, 0.4)
    lost = positions.assign(sigma_up_m=[0.3] * 9 + [np.nan] * 5)  # two fixed ones are left, and seven others
    assert Track.from_table(lost, FRAME, **how).t_gps_s.tolist() == np.arange(7.0, 14.0).tolist()
    assert len(Track.from_table(positions.assign(fix="none"), FRAME, **how).t_gps_s) == 13
    with pytest.raises(CoverageError, match="0 of 10 positions are usable"):
        Track.from_table(positions[2:12], FRAME, **how)
    table = antenna_track(found)
    assert_allclose(table[["east_m", "north_m", "up_m"]], found.position_m)
    assert table["t_gps_s"].tolist() == found.t_gps_s.tolist()


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"t_gps_s": np.arange(5.0)}, "5 epochs"),
        ({"t_gps_s": np.array([0.0, 1, 2, 2, 3, 4, 5, 6])}, "do not increase"),
        ({"white_share": 1.01}, r"white share 1\.01"),
        ({"white_share": -0.01}, r"white share -0\.01"),
        ({"correlation_time_s": 0.0}, r"correlation time 0\.0 s"),
        ({"cov_m2": np.zeros((8, 2, 2))}, r"covariances \(8, 2, 2\)"),
    ],
)
def test_tracks_that_are_none(changed, words):
    of = {name: getattr(line(), name) for name in ("t_gps_s", "position_m", "cov_m2")} | changed
    with pytest.raises(GeometryError, match=words):
        Track(**of)


def test_a_covariance_that_is_none():
    broken = Track(t_gps_s=line().t_gps_s, position_m=line().position_m, cov_m2=-line().cov_m2)
    with pytest.raises(GeometryError, match="a covariance of positions is not positive"):
        broken.covariance(broken.at([3.5]))
