"""The sources of positions that a campaign can choose."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from thalweg.core import InputError, write_table
from thalweg.ingest import GNSS_POSITION, INS_STATE
from thalweg.ingest.registry import read_positions
from thalweg.ingest.registry.positions import positions_from_states

NOTHING: dict[str, Any] = {"base": [], "nav": [], "ppk": {}, "base_position": {}}


def states() -> pd.DataFrame:
    n = 5
    table = pd.DataFrame({name: np.arange(n, dtype=float) for name in INS_STATE.names})
    return table.assign(
        fix="3d", system_status=np.uint16(0), filter_status=np.uint16(0), t_gps_s=3e8 + np.arange(n)
    )


def test_positions_inside_ins_states(tmp_path: Path) -> None:
    write_table(tmp_path / "states.parquet", states(), INS_STATE)
    table, report = read_positions("ins", [], states=tmp_path / "states.parquet", **NOTHING)
    assert report.stream == "positions"
    assert report.synchronised
    assert (report.t_first_s, report.t_last_s) == (3e8, 3e8 + 4)
    np.testing.assert_array_equal(table["lat_deg"], np.arange(5.0))
    write_table(tmp_path / "positions.parquet", table, GNSS_POSITION)


def test_an_unknown_source_is_answered_with_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'gps'; expected pos, sbp, nmea, ppk, sbet or ins"):
        read_positions("gps", [], states=tmp_path / "x", **NOTHING)


def test_an_indefinite_covariance_does_not_pass(tmp_path: Path) -> None:
    names = "latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) sdne(m) sdeu(m) sdun(m) age(s)"
    lines = [f"%  GPST                  {names} ratio"]
    for second in range(20):
        correlated = 0.05 if second == 7 else 0.0  # sdne above both sigmas: indefinite
        lines.append(
            f"2021/05/12 08:31:{second:02d}.000 51.05 13.25 300.0 1 12 0.02 0.02 0.03 {correlated} 0 0 0 9.9"
        )
    path = tmp_path / "track.pos"
    path.write_text("\n".join(lines) + "\n")
    table, report = read_positions("pos", [path], states=tmp_path / "x", **NOTHING)
    assert report.counts["covariances_replaced"] == 1
    assert table["cov_en_m2"].abs().max() < 1e-6
    np.testing.assert_allclose(positions_from_states(states())["sigma_up_m"], np.arange(5.0))


@pytest.mark.real
def test_ppk_through_the_sections_of_a_campaign(data_dir: Path, tmp_path: Path) -> None:
    log = data_dir / "sbp_piksi_rtk_2017/2017-05-12-v1.1.26.sbp"
    table, report = read_positions(
        "ppk",
        [log],
        states=tmp_path / "x",
        base=[],
        nav=[],
        ppk={"systems": ["GPS"], "elevation_mask_deg": 10.0},
        base_position={"base_from": "sbp"},
    )
    fixes = table["fix"].value_counts()
    assert fixes["fixed"] == pytest.approx(378, abs=3)  # PROVENANCE: Q1 378, Q2 22
    assert fixes.sum() == 400
    assert report.synchronised
