"""Covariances of image blocks on rendered pictures."""

import numpy as np
import pandas as pd
import pytest

from thalweg.core import GeometryError, read_parquet
from thalweg.settings.sections import BlockAdjustment
from thalweg_lab.studies import image_blocks
from thalweg_lab.studies.image_blocks import FACTORS, block_study, normalised, pooled

FACTOR = BlockAdjustment().interior_variance
BLOCK = {
    "seed": 0, "factor": FACTOR, "images": 10, "single": 1.0, "joint": 1.2, "independent": 20.0,
    "rms_mm": 30.0, "sigma_mm": 28.0, "rms_mdeg": 100.0, "sigma_mdeg": 120.0, "check": 0.5, "check_points": 2,
    "notes": "", "failure": "",
}  # fmt: skip


def test_normalised_squares_of_correlated_poses(rng):
    A = rng.normal(size=(24, 24))
    cov = A @ A.T
    values = [normalised((A @ rng.standard_normal(24)).reshape(4, 6), cov) for _ in range(2000)]
    single, joint, independent = np.transpose(values)
    # 2000 draws of 24 numbers: 0.7 % of the mean; single ones are correlated
    assert joint.mean() == pytest.approx(1.0, abs=0.03)
    assert single.mean() == pytest.approx(1.0, abs=0.05)
    # the variance of a mean square of n errors is 2 / n; that of 2000 draws is known to 5 %
    assert single.var() == pytest.approx(2 / independent[0], rel=0.2)
    assert joint.var() == pytest.approx(2 / 24, rel=0.2)


def test_images_that_err_as_one_count_once():
    own = np.diag([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])
    assert normalised(np.ones((5, 6)), np.kron(np.eye(5), own))[2] == pytest.approx(30.0)
    alike = np.kron(np.full((5, 5), 1.0) + 1e-9 * np.eye(5), own)
    assert normalised(np.ones((5, 6)), alike)[2] == pytest.approx(6.0, rel=1e-6)


def test_a_block_that_fails_is_a_line_of_its_own(tmp_path, monkeypatch):
    def fails(*_):
        raise GeometryError("no block", expected="one")

    monkeypatch.setattr(image_blocks, "rendered_block", fails)
    table = block_study(3, tmp_path)
    assert table["factor"].tolist() == list(FACTORS)
    assert set(table["failure"]) == {"no block; expected one."}
    # as the job of a seed hands them to the one that gathers
    table.to_parquet(tmp_path / "3.parquet", index=False)
    again = read_parquet(tmp_path / "3.parquet")
    pd.testing.assert_frame_equal(again, table, check_dtype=False)
    table = again[again["factor"] == FACTOR]
    both = pd.concat([pd.DataFrame([BLOCK]), table], ignore_index=True)
    assert pooled(both).loc["all poses jointly", "normalised"] == pytest.approx(1.2)
