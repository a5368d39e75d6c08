"""Registration, volumes, patches and retreat of four to eight core points, with full covariances by hand."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp

from thalweg.deformation import coregistration, volumes
from thalweg.deformation.coregistration import coregister, design_of
from thalweg.deformation.field import ErrorField, ErrorGroup
from thalweg.deformation.volumes import _patches, _rows, estimate_retreat, estimate_volumes
from thalweg.settings.sections import Deformation

# ---------------------------------------------------------------- registration


def test_a_registration_has_the_covariance_of_weighted_least_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    """Parameters S d, covariance S (shared + white) S' with all cross terms, and the statistic of both."""
    monkeypatch.setattr(coregistration, "_LEAST", 20)
    rng = np.random.default_rng(21)
    k = 60
    cores = rng.uniform(-20.0, 20.0, (k, 3))
    normals = rng.standard_normal((k, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    true = np.array([0.02, -0.01, 0.03, 1e-3, -5e-4, 8e-4])
    middle = cores.mean(axis=0)
    arm = cores - middle
    # a small rotation w moves a point by w x arm: n . (w x arm) = w . (arm x n)
    H = np.array([[*n, *np.cross(a, n)] for n, a in zip(normals, arm, strict=True)])
    assert design_of(cores, normals, middle) == pytest.approx(H)
    white = rng.uniform(0.001, 0.003, k)
    group = ErrorGroup.from_sigmas("position", np.array([0.0, 1.0]), np.array([0.002, 0.001, 0.003]), 2.0)
    rows = rng.standard_normal((k, 6)) / 2
    field = ErrorField((group,), (sp.csr_matrix(rows),))
    distance = H @ true + white * rng.standard_normal(k)
    found = coregister(
        cores, normals, distance, white, np.ones(k, dtype=bool), field, Deformation(registration="rigid")
    )
    S = found.weights
    assert found.parameters == pytest.approx(S @ distance)
    np.testing.assert_allclose(S @ H, np.eye(6), atol=1e-9)
    assert found.parameters == pytest.approx(true, abs=0.01)
    sigma2 = np.array([0.002, 0.001, 0.003]) ** 2
    C = np.kron(np.array([[1.0, np.exp(-0.5)], [np.exp(-0.5), 1.0]]), np.diag(sigma2))
    total = rows @ C @ rows.T + np.diag(white**2)
    assert found.cov == pytest.approx(S @ total @ S.T)
    assert list(found.facts["sigmas"].values()) == pytest.approx(np.sqrt(np.diag(S @ total @ S.T)))
    statistic = found.parameters @ np.linalg.solve(S @ total @ S.T, found.parameters)
    assert found.facts["test_statistic"] == pytest.approx(statistic)
    assert found.facts["degrees_of_freedom"] == 6
    assert found.registered(distance) == pytest.approx(distance - H @ found.parameters)
    error = rng.standard_normal(k)
    assert found.of_errors(error) == pytest.approx(error - H @ (S @ error))


# ---------------------------------------------------------------- volumes

AREA = np.array([1.0, 2.0, 1.5, 0.5, 3.0])
DISTANCE = np.array([-0.5, -0.2, 0.4, 0.01, np.nan])
STATE = ["erosion", "erosion", "deposition", "no significant change", "not seen in second"]


@pytest.fixture
def compared() -> SimpleNamespace:
    """Five core points at 2, 7, 12, 13 and 14 m along the bank; errors that hang together."""
    rng = np.random.default_rng(22)
    root = 0.02 * rng.standard_normal((5, 5))
    shared, white = root @ root.T, np.diag(rng.uniform(0.01, 0.03, 5) ** 2)
    return SimpleNamespace(
        pair=SimpleNamespace(cores=pd.DataFrame({"area_m2": AREA, "s_m": [2.0, 7.0, 12.0, 13.0, 14.0]})),
        distance_m=DISTANCE,
        sigma_m=np.sqrt(np.diag(shared + white)),
        variances=lambda P: (np.diag(P @ shared @ P.T), np.diag(P @ white @ P.T)),
        draws=lambda n, seed: [np.array([0.3, 0.0, -0.3, 0.0, 0.0])] * n,
        cov=shared + white,
    )


@pytest.fixture
def table() -> pd.DataFrame:
    return pd.DataFrame(
        {
            "distance_m": DISTANCE,
            "state": STATE,
            "significant": [True, True, True, False, False],
            "east_m": [2.0, 7.0, 12.0, 13.0, 14.0],
            "north_m": 1.0,
            "up_m": [0.0, 0.5, 1.0, 1.5, 2.0],
        }
    )


def test_volumes_and_their_sigmas_by_hand(table: pd.DataFrame, compared: SimpleNamespace) -> None:
    found, along = estimate_volumes(table, compared, Deformation(station_m=10.0), 1)
    assert found["what"].tolist() == ["erosion", "deposition", "net"]
    assert found["volume_m3"].tolist() == pytest.approx([-0.9, 0.6, -0.295])
    weights = np.array([[1, 2, 0, 0, 0], [0, 0, 1.5, 0, 0], [1, 2, 1.5, 0.5, 0]])
    sigma = np.sqrt(np.diag(weights @ compared.cov @ weights.T))
    assert found["sigma_m3"].to_numpy() == pytest.approx(sigma)
    assert found["low_m3"].to_numpy() == pytest.approx(found["volume_m3"] - 1.959964 * sigma)
    assert found["high_m3"].to_numpy() == pytest.approx(found["volume_m3"] + 1.959964 * sigma)
    assert found["area_m2"].tolist() == pytest.approx([3.0, 1.5, 5.0])
    assert found["not_seen_m2"].tolist() == [3.0] * 3
    keys = ["what", "s_from_m", "s_to_m", "volume_m3", "area_m2", "not_seen_m2"]
    rows = along[keys].to_numpy(dtype=object).tolist()
    assert rows == [
        ["erosion", 0.0, 10.0, pytest.approx(-0.9), 3.0, 0.0],
        ["erosion", 10.0, 20.0, 0.0, 0.0, 3.0],
        ["deposition", 0.0, 10.0, 0.0, 0.0, 0.0],
        ["deposition", 10.0, 20.0, pytest.approx(0.6), 1.5, 3.0],
        ["net", 0.0, 10.0, pytest.approx(-0.9), 3.0, 0.0],
        ["net", 10.0, 20.0, pytest.approx(0.605), 2.0, 3.0],
    ]


def test_what_a_threshold_does_to_sums_by_hand(table: pd.DataFrame, compared: SimpleNamespace) -> None:
    """The limit is the smallest significant ratio, that of the second point: -0.2 m over its sigma."""
    compared.sigma_m = np.full(5, 0.1)
    found, _ = estimate_volumes(table, compared, Deformation(station_m=10.0), 1)
    # -0.5 + 0.3 is as far as the limit of 0.2 and counts; 0.4 - 0.3 is not
    assert found["bias_m3"].tolist() == pytest.approx([0.3, -0.6, 0.0])


def test_patches_and_their_columns_by_hand(table: pd.DataFrame) -> None:
    places = table[["east_m", "north_m", "up_m"]].to_numpy()
    state = np.array(STATE, dtype=object)
    assert _patches(places, state, 5.1).tolist() == [0, 0, 1, -1, -1]  # sqrt(25.25) m apart
    apart = _patches(places, state, 5.0)
    assert apart.tolist() == [0, 1, 2, -1, -1]
    rows = _rows(table, AREA, _patches(places, state, 5.1), SimpleNamespace(least_patch_m2=1.5))
    assert rows.to_numpy(dtype=object).tolist() == [
        ["erosion", 2, 3.0, pytest.approx(-0.9), pytest.approx(-0.35), -0.5, 4.5, 1.0, 0.25],
        ["deposition", 1, 1.5, pytest.approx(0.6), pytest.approx(0.4), 0.4, 12.0, 1.0, 1.0],
    ]
    assert len(_rows(table, AREA, apart, SimpleNamespace(least_patch_m2=1.6))) == 1


def test_retreat_of_a_line_by_hand(
    table: pd.DataFrame, compared: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two stretches, the second the mean of two points, in half a year."""
    products = np.array([[1.0, 0, 0, 0, 0], [0, 0.5, 0.5, 0, 0]])
    rows = pd.DataFrame({"line": ["bank line", "bank line"], "height_m": [1.0, 1.0]})
    monkeypatch.setattr(volumes, "lines_of_bank", lambda *_: (rows, products))
    found = estimate_retreat(table, compared, Deformation(), water_m=0.5, years=0.5)
    sigma = np.sqrt(np.diag(products @ compared.cov @ products.T))
    moved = np.array([-0.5, 0.1])
    assert found["nsm_m"].to_numpy() == pytest.approx(moved)
    assert found["sigma_m"].to_numpy() == pytest.approx(sigma)
    assert found["low_m"].to_numpy() == pytest.approx(moved - 1.959964 * sigma)
    assert found["high_m"].to_numpy() == pytest.approx(moved + 1.959964 * sigma)
    assert found["epr_m_a"].to_numpy() == pytest.approx(moved / 0.5)
    assert found["sigma_epr_m_a"].to_numpy() == pytest.approx(sigma / 0.5)
