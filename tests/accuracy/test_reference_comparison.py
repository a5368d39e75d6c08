"""The whole comparison: all tables, as measured and with registration, and the entry script's files."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.accuracy import bank_samples as bank
from thalweg.accuracy import CLOUD_TO_MESH, ComparisonSettings, compare_with_reference
from thalweg.core import read_table
from thalweg.core.geometry import write_mesh
from thalweg.settings.sections import Accuracy, ReferenceSettings
from thalweg.surface import Area

STATES = ["as measured", "with registration"]


def cloud(tmp_path: Path, rng: np.random.Generator, n: int = 6000) -> Path:
    """Points 5 cm behind the bank with 3 cm of white noise, which the stated covariance predicts."""
    xyz = bank.on_bank(rng, n) - 0.05 * bank.OUT + 0.03 * rng.normal(size=(n, 3))
    more = {"sigmas": (0.03, 0.03, 0.03), "correlations": (0.0, 0.0, 0.0)}
    range_m = rng.uniform(10.0, 14.0, n)
    return bank.write_cloud(tmp_path / "points.laz", xyz, range_m=range_m, **more)


def test_all_tables_of_an_offset_cloud(tmp_path, rng):
    settings = ComparisonSettings(correlation_s=0.1)
    path = cloud(tmp_path, rng)
    found = compare_with_reference(path, bank.bank_mesh(), area=Area(), settings=settings, registration=True)
    value = found.statistics.set_index(["registration", "points", "quantity"])["value"]
    assert list(found.statistics["registration"].unique()) == STATES
    before, after = value["as measured"]["all"], value["with registration"]["all"]
    assert before["bias"] == pytest.approx(-0.05, abs=0.002)
    assert abs(after["bias"]) < 0.002
    assert after["rmse"] == pytest.approx(0.03, rel=0.04)
    # the fit took part of the predicted errors away: no prediction, and no verdict on it
    assert not {"ratio", "predicted_rmse", "normalised_nmad", "ratio_low95"} & set(after.index)
    fitted = found.by_range.query("registration == 'with registration'")
    assert fitted["rmse_observed_m"].notna().all()
    assert fitted[["rmse_predicted_m", "ratio", "ratio_low95", "inside"]].isna().all(axis=None)
    # normal component of three equal sigmas: one of them; with the reference's 2 mm and 5 mm
    assert before["predicted_rmse"] == pytest.approx(np.sqrt(0.03**2 + 0.002**2 + 0.005**2), rel=1e-3)
    assert before["predicted_rmse_3d"] == pytest.approx(0.03 * np.sqrt(3.0), rel=1e-3)
    assert before["ratio"] < before["ratio_low95"]
    assert (
        found.by_range.groupby(["registration", "points"])["n"].sum().loc[("as measured", "all")]
        == before["n"]
    )
    assert list(found.spatial.columns[:3]) == ["registration", "points", "quantity"]
    assert list(found.spatial["registration"].unique()) == STATES
    sentences = {(s["registration"], s["points"]): s["words"] for s in found.facts["local_dependency"]}
    assert all(words.startswith("no local") for words in sentences.values())
    assert len(sentences) == len(found.facts["verdicts"]) == 4
    assert found.registration["done"]
    assert found.facts["registration"] == found.registration["words"]
    again = compare_with_reference(path, bank.bank_mesh(), area=Area(), settings=settings, registration=True)
    assert again.statistics.equals(found.statistics)
    assert again.spatial.equals(found.spatial)
    assert again.registration == found.registration


def test_without_registration_and_where_it_fails(tmp_path, rng, caplog):
    path, settings = cloud(tmp_path, rng, 2000), ComparisonSettings()
    plain = compare_with_reference(path, bank.bank_mesh(), area=Area(), settings=settings, registration=False)
    assert list(plain.statistics["registration"].unique()) == STATES[:1]
    assert plain.registration == {"done": False, "words": "no registration was asked for"}
    # a strip of 4 cm: all points of it on a line
    xyz = bank.place(np.linspace(1.0, 39.0, 1000), np.full(1000, 4.0), 0.0)
    line = bank.write_cloud(tmp_path / "line.laz", xyz)
    failed = compare_with_reference(line, bank.bank_mesh(), area=Area(), settings=settings, registration=True)
    assert list(failed.statistics["registration"].unique()) == STATES[:1]
    assert not failed.registration["done"]
    assert "no registration: all points lie on a line" in failed.registration["words"]
    assert "all points lie on a line" in caplog.text


def test_the_entry_script_writes_all_files(tmp_path, rng, repository):
    spec = importlib.util.spec_from_file_location(
        "compare_with_reference", repository / "workflow/scripts/compare_with_reference.py"
    )
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    write_mesh(tmp_path / "mesh.ply", bank.bank_mesh(), bank.FRAME, {})
    names = ("cloud_to_mesh.parquet", "statistics.csv", "by_range.csv", "spatial.csv", "registration.json")
    outputs = {Path(name).stem: tmp_path / name for name in names}
    error_model = tmp_path / "error_model.json"
    error_model.write_text(json.dumps({"correlation_s": 7.5}))
    script.main(
        error_model=error_model,
        points=cloud(tmp_path, rng),
        mesh=tmp_path / "mesh.ply",
        **outputs,
        crs="EPSG:25833",
        seed=3,
        accuracy=Accuracy(area={"min_height_m": 0.5}),
        reference=ReferenceSettings(),
    )
    table, facts = read_table(outputs["cloud_to_mesh"], CLOUD_TO_MESH)
    assert facts["area"] == "height from 0.5 m"
    assert facts["seed"] == 3
    assert facts["correlation_s"] == 7.5  # `auto`: as the survey shows it
    assert (table["up_m"] >= 0.5).all()
    assert facts["counts"]["outside_area"] > 0
    statistics = pd.read_csv(outputs["statistics"])
    assert statistics.query("quantity == 'n' and points == 'all'")["value"].iloc[0] == table["used"].sum()
    by_range = pd.read_csv(outputs["by_range"]).query("registration == 'as measured'")
    assert set(by_range["inside"]) <= {True, False}
    assert set(pd.read_csv(outputs["spatial"])["quantity"]) >= {"moran_i", "share_of_variance", "correlation"}
    assert json.loads(outputs["registration"].read_text())["done"]
