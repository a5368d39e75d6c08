"""What the residuals of the engine say of the noise: drawn with known sizes, and text by hand."""

import numpy as np
import pandas as pd
import pytest

from tests.ingest.writers import numbers
from thalweg.core import ArrayF
from thalweg.ingest.ppk.residuals import CODE_RATIO, PHASE_M, code_factors, phase_factor, read_residuals

WEIGHT = np.array([0.24, 0.2, 0.15, 0.1, 0.06, 0.03, 0.24, 0.2, 0.15, 0.1, 0.06, 0.03])
GROUPS = np.array(["G1"] * 6 + ["G2"] * 6)
N = 4096


def residuals(code: ArrayF, phase: ArrayF, *, fixed: bool = True) -> pd.DataFrame:
    """Residuals of 6 satellites on 2 frequencies; errors (epochs, 12) in units of what the engine takes."""
    n = len(code)
    size = PHASE_M / np.sqrt(WEIGHT)
    # differences to the first satellite of each frequency
    code, phase = ((e * size).reshape(n, 2, 6) for e in (CODE_RATIO * code, phase))
    code, phase = ((e - e[..., :1]).ravel() for e in (code, phase))
    return pd.DataFrame(
        {
            "t_gps_s": np.repeat(1e9 + np.arange(n), 12),
            "satellite": np.tile([f"G{k + 1:02d}" for k in range(6)] * 2, n),
            "group": np.tile(GROUPS, n),
            "code_m": code,
            "phase_m": phase,
            "weight": np.tile(WEIGHT, n),
            "fixed": fixed,
        }
    )


@pytest.mark.parametrize("size", [0.25, 1.0, 3.0])
def test_phase_factor_is_the_variance_in_units_of_the_engines(size):
    """A place was taken from 3 of 10 values an epoch: 7 are left, of which 7 / 10 of the square remains."""
    rng = np.random.default_rng(11)
    drawn = residuals(np.zeros((N, 12)), size * rng.standard_normal((N, 12)))
    # 28,672 values to spare: one in a thousand draws is off by 2.7 %
    assert phase_factor(drawn) == pytest.approx(size**2 * 10 / 7, rel=0.027)


def test_phase_factor_needs_thirty_fixed_epochs():
    rng = np.random.default_rng(12)
    few = residuals(np.zeros((29, 12)), 0.1 * rng.standard_normal((29, 12)))
    assert phase_factor(few) == 1.0
    assert phase_factor(residuals(*np.zeros((2, 40, 12)), fixed=False)) == 1.0


def test_phase_factor_of_a_single_value_to_spare():
    """Of 4 satellites nothing is left beside mean and place; a fifth, 5 mm off, leaves 20 mm2."""
    n = np.full(30, 4)
    n[7] = 5
    table = pd.DataFrame(
        {"t_gps_s": np.repeat(np.arange(30.0), n), "group": "G1", "weight": 0.25, "fixed": True}
    )
    table["phase_m"] = 0.0
    table.loc[32, "phase_m"] = 0.005
    assert table["t_gps_s"][32] == 7.0
    assert phase_factor(table) == pytest.approx(0.25 * 20e-6 / PHASE_M**2)
    assert phase_factor(table.drop(index=32)) == 1.0


def test_code_factors_tell_what_averages_out_from_what_stays():
    """New in each epoch: the same for all means. Half of the variance constant: half (1 + k) of it."""
    rng = np.random.default_rng(13)
    white, stays = rng.standard_normal((N, 12)), rng.standard_normal((1, 12))
    after, factors = code_factors(residuals(0.3 * white, np.zeros((N, 12))))
    assert after.tolist() == [2.0**k for k in range(13)]
    assert factors[:7] == pytest.approx(0.09 * 10 / 7, rel=0.15)
    _, grown = code_factors(residuals(0.3 * white + 0.3 * stays, np.zeros((N, 12))))
    assert factors[-1] < 1.0 < grown[-1]
    # one draw of 10 constant values gives all factors their size; their growth is exact
    assert (grown[1:-2] / factors[1:-2] - 1.0) / (grown[0] / factors[0] - 1.0) == pytest.approx(
        after[1:-2], rel=0.6
    )


def test_code_factors_need_epochs_and_satellites():
    assert code_factors(residuals(*np.ones((2, 29, 12)))) is None
    five = residuals(*np.ones((2, 40, 12)))
    assert code_factors(five[five["satellite"] < "G03"]) is None


STATUS = """\
$POS,2157,291606.000,2,3910935.1429,920902.9469,4937277.9736,0.0000,0.0000,0.0000
$CLK,2157,291606.000,2,1,10.876,0.000,0.000,0.000,0.000,0.000
$SAT,2157,291606.000,G09,1,316.6,30.0,-0.5539,0.0009,1,0,2,0,0,0,0,0,-1154303.91,205.761209,0.00000
$POS,2157,291607.000,1,3910933.8944,920903.2535,4937277.3509,0.0000,0.0000,0.0000
$SAT,2157,291607.000,G09,1,316.6,30.0,0.3236,-0.0012,1,0,2,0,0,0,0,0,-1154303.44,180.296872,0.00000
$SAT,2157,291607.000,G10,2,198.0,90.0,-0.7445,-0.0006,1,0,1,0,0,0,0,0,689725.95,165.159110,0.00000
$SAT,2157,291607.000,G13,1,296.6,39.3,9.0000,9.0000,0,0,0,0,0,0,0,0,0.0,0.0,0.0
"""


def test_the_status_file_is_read(tmp_path):
    path = tmp_path / "ppk.pos.stat"
    assert read_residuals(path).empty
    path.write_text(STATUS)
    table = read_residuals(path)
    # weights of 2 (1 + 4) and 2 (1 + 1); integers in the second epoch, where one ambiguity is none
    expected = numbers("""
        second group code_m phase_m weight fixed
        291606  G1  -0.5539  0.0009  0.10  False
        291607  G1   0.3236 -0.0012  0.10  True
        291607  G2  -0.7445 -0.0006  0.25  False
    """)
    found = table[[*expected.columns[1:]]].reset_index(drop=True)
    pd.testing.assert_frame_equal(found, expected.iloc[:, 1:])
    assert (table["t_gps_s"] - 2157 * 604800 + 1e9).tolist() == expected["second"].tolist()
