"""What has moved is named with its numbers, and nothing else."""

import json

import numpy as np
import pandas as pd
import pytest

from .kept_numbers import SHARE, moved, numbers_of, shares, wider


def results(folder, *, heights_m=(1.0, 2.0, 6.0), sigma_m=0.02, more=()):
    folder.mkdir()
    kinds = ["wet", "dry", None]
    table = pd.DataFrame({"height_m": heights_m, "kind": kinds, "t_gps_s": [1.3e9, 1.3e9 + 1, np.nan]})
    table.to_csv(folder / "heights.csv", index=False)
    lens = {"sigma_m": sigma_m, "written": 3, "poses": [{"x": 1.0}, {"x": 3.0}]}
    (folder / "lens.json").write_text(json.dumps(lens))
    for name in more:
        (folder / name).write_text('{"x": 1}')
    return numbers_of(folder)


def test_a_table_holds_count_mean_and_standard_deviation(tmp_path):
    table = results(tmp_path / "a")
    assert {file for file, _ in table.index} == {"heights.csv", "lens.json"}
    assert table.loc[("heights.csv", "height_m")].tolist() == pytest.approx([3, 3.0, np.sqrt(14 / 3)])
    assert table.loc[("heights.csv", "kind")].tolist() == [2, 2, 0]
    assert table.loc[("heights.csv", "t_gps_s")].tolist() == [2, 1.3e9 + 0.5, 0.5]
    assert table.loc[("lens.json", ".poses[].x")].tolist() == [2, 2.0, 1.0]
    assert ("lens.json", ".written") not in table.index


def test_what_moves_is_named_and_rounding_is_not(tmp_path):
    kept = results(tmp_path / "a").assign(share=SHARE)
    limit_m = SHARE * np.sqrt(14 / 3)
    within = results(tmp_path / "b", heights_m=(1.0, 2.0, 6.0 + limit_m), sigma_m=0.02 * (1 + 0.9 * SHARE))
    assert [*moved(kept, within)] == []
    (line,) = moved(kept, results(tmp_path / "c", heights_m=(1.0, 2.0, 6.0 + 4 * limit_m)))
    assert line.startswith("heights.csv: height_m: n 3 -> 3, mean 3 -> 3.0028")
    (line,) = moved(kept, results(tmp_path / "d", sigma_m=0.02 * (1 + 2 * SHARE)))
    assert line.startswith("lens.json: .sigma_m: ")
    (line,) = moved(kept, results(tmp_path / "e", heights_m=(1.0, 2.0, np.nan)))
    assert "n 3 -> 2" in line
    more = results(tmp_path / "f", more=["new.json"])
    assert [*moved(kept, more)] == ["new.json: .x: only found"]
    assert [*moved(more.assign(share=SHARE), kept)] == ["new.json: .x: only kept"]


def test_files_that_depend_on_the_processor_have_wider_limits(tmp_path):
    found = results(tmp_path / "a")
    plain = results(tmp_path / "b", heights_m=(1.0, 2.0, 6.5))
    share = shares(found, plain)
    sd = np.sqrt(14 / 3)
    off = max(0.5 / 3, np.std([1.0, 2.0, 6.5]) - sd) / sd
    assert share[("heights.csv", "height_m")] == pytest.approx(10 * off)
    assert share[("heights.csv", "t_gps_s")] == 0.1
    assert share[("lens.json", ".sigma_m")] == SHARE
    kept = found.assign(share=share)
    assert [*moved(kept, plain)] == []
    assert [*moved(kept, results(tmp_path / "c", heights_m=(1.0, 2.0, 60.0)))]
    # a value that only one of the two has
    assert (shares(found, found.drop(("lens.json", ".sigma_m")))["lens.json"] >= 0.1).all()


def test_limits_that_another_processor_breaks_become_wider_and_no_others(tmp_path):
    kept = results(tmp_path / "a").assign(share=SHARE)
    found = results(tmp_path / "b", heights_m=(1.0, 2.0, 6.5))
    share = wider(kept, found)
    assert [*moved(kept.assign(share=share), found)] == []
    assert share[share != SHARE].index.tolist() == [("heights.csv", "height_m")]
    assert share.max() == pytest.approx(shares(kept, found).max())
