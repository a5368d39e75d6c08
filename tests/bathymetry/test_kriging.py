"""Kriging against one system of all data, PyKrige, and fields of known covariance."""

import numpy as np
import pytest

from thalweg.bathymetry.kriging import (
    KINDS,
    CovarianceModel,
    Observations,
    error_covariance,
    fit_drift,
    krige,
    krige_by_pykrige,
    krige_dense,
)
from thalweg.core import GeometryError, UnsupportedError


def zigzag(n: int, rng: np.random.Generator, legs: int = 6) -> tuple[np.ndarray, np.ndarray]:
    u = np.linspace(0, legs, n, endpoint=False)
    side = np.where(u.astype(int) % 2 == 0, u % 1, 1 - u % 1)
    return np.column_stack([15.0 * u, 30.0 * (side - 0.5)]), u.astype(int)


def observed(n: int = 200, seed: int = 1, slow: float = 0.0) -> Observations:
    rng = np.random.default_rng(seed)
    places, line = zigzag(n, rng)
    return Observations(
        s_m=places[:, 0],
        n_m=places[:, 1],
        height_m=np.sin(places[:, 0] / 20) + 0.003 * places[:, 1] ** 2,
        sigma_white_m=rng.uniform(0.01, 0.03, n),
        sigma_slow_m=np.full(n, slow),
        t_s=np.arange(n) * 0.5,
        line=line,
    )


def model(kind: str = "exponential", **changes: float) -> CovarianceModel:
    return CovarianceModel(
        **{"kind": kind, "sill_m2": 0.4, "range_s_m": 50.0, "range_n_m": 8.0, "micro_m2": 1e-4} | changes
    )


CELLS = np.stack(np.meshgrid(np.linspace(2, 80, 12), np.linspace(-14, 14, 9)), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("slow_time_s", [0.0, 10.0])
def test_kernel_equals_one_system_of_all(kind, slow_time_s):
    data, of = observed(slow=0.03), model(kind, slow_time_s=slow_time_s)
    height, sigma = krige(data, CELLS, of, neighbours=len(data), octants=False)
    expected = krige_dense(data, CELLS, of)
    np.testing.assert_allclose(height, expected[0], atol=1e-9)
    np.testing.assert_allclose(sigma, expected[1], atol=1e-9)


def functions_of(places: np.ndarray) -> np.ndarray:
    """A drift: fall and a parabola across."""
    return np.column_stack([places[:, 0] / 40.0, (places[:, 1] / 12.0) ** 2])


def rough(places: np.ndarray) -> np.ndarray:
    """Twice the relief near the banks."""
    return 1.0 + np.clip((np.abs(places[:, 1]) - 7.0) / 2.0, 0.0, 1.0)


@pytest.mark.parametrize("slow_time_s", [0.0, 10.0])
def test_drift_and_rough_margins_equal_universal_kriging_of_all(slow_time_s):
    data, of = observed(slow=0.03), model("exponential", slow_time_s=slow_time_s)
    both, roughness = (
        (functions_of(data.places_m), functions_of(CELLS)),
        (rough(data.places_m), rough(CELLS)),
    )
    value, cov = fit_drift(data, both[0], of, roughness[0])
    rest = data.lifted(data.height_m - both[0] @ value)
    height, sigma = krige(
        rest, CELLS, of, neighbours=len(data), octants=False, drift=(*both, cov), roughness=roughness
    )
    expected = krige_dense(data, CELLS, of, functions=both, roughness=roughness)
    np.testing.assert_allclose(height + both[1] @ value, expected[0], atol=1e-9)
    np.testing.assert_allclose(sigma, expected[1], atol=1e-9)
    # an unknown drift costs certainty, most where no datum is near
    known = krige_dense(rest, CELLS, of, roughness=roughness)[1]
    assert (sigma >= known - 1e-12).all()
    assert (sigma / known).max() > 1.01


@pytest.mark.parametrize("kind", KINDS)
def test_pykrige_gives_the_same(kind):
    data = observed()
    even = Observations(
        **{name: getattr(data, name) for name in ("s_m", "n_m", "height_m", "t_s", "line")},
        sigma_white_m=np.full(len(data), 0.02),
        sigma_slow_m=np.zeros(len(data)),
    )
    height, sigma = krige_by_pykrige(even, CELLS, model(kind))
    expected = krige_dense(even, CELLS, model(kind))
    np.testing.assert_allclose(height, expected[0], atol=1e-6)
    np.testing.assert_allclose(sigma, expected[1], atol=1e-6)


def test_pykrige_refuses_what_it_cannot_hold():
    with pytest.raises(UnsupportedError, match="2001 soundings"):
        krige_by_pykrige(observed(2001), CELLS, model())


@pytest.mark.parametrize("octants", [True, False])
def test_any_chunk_gives_the_same_bytes(octants):
    data = observed(600, slow=0.03)
    whole = krige(data, CELLS, model(slow_time_s=5.0), octants=octants)
    parts = krige(data, CELLS, model(slow_time_s=5.0), octants=octants, chunk=7)
    assert whole[0].tobytes() == parts[0].tobytes()
    assert whole[1].tobytes() == parts[1].tobytes()


def test_covariance_of_errors_is_that_of_one_system_and_of_simulated_errors():
    """Its diagonal is kriging's variance; sums of errors of drawn fields have the variance that it says."""
    data, of = observed(60, slow=0.03), model(slow_time_s=10.0)
    cells = CELLS[::4]
    g = (1.0 + 0.02 * np.abs(data.n_m), 1.0 + 0.02 * np.abs(cells[:, 1]))
    cov = error_covariance(data, cells, of, roughness=g)
    np.testing.assert_allclose(np.diag(cov), krige_dense(data, cells, of, roughness=g)[1] ** 2, atol=1e-9)
    # drawn from the model: field at data and cells, noise, errors that last
    places = np.vstack([data.places_m, cells])
    h = np.hypot(
        (places[:, None, 0] - places[None, :, 0]) / 50.0, (places[:, None, 1] - places[None, :, 1]) / 8.0
    )
    field = np.outer(np.concatenate(g), np.concatenate(g)) * 0.4 * np.exp(-3 * h)
    lasting = 0.03**2 * np.exp(-np.abs(data.t_s[:, None] - data.t_s[None]) / 10.0)
    rng, n = np.random.default_rng(8), len(data)
    drawn = rng.multivariate_normal(np.zeros(len(places)), field, 300, method="eigh")
    errors = drawn[:, :n] + rng.multivariate_normal(np.zeros(n), lasting, 300, method="eigh")
    errors += np.sqrt(data.sigma_white_m**2 + 1e-4 * g[0] ** 2) * rng.standard_normal((300, n))
    sums = [
        (krige_dense(data.lifted(z), cells, of, roughness=g)[0] - true).sum()
        for z, true in zip(errors, drawn[:, n:], strict=True)
    ]
    assert np.mean(np.square(sums)) / cov.sum() == pytest.approx(1.0, abs=0.25)


def test_sigma_is_that_of_the_bed_two_sided():
    """Fields of known covariance and errors that last: normalised squares, modelled and not."""
    rng = np.random.default_rng(5)
    places, line = zigzag(240, rng)
    cells = places[rng.choice(240, 60, replace=False)] + rng.normal(0, [0.5, 0.2], (60, 2))
    of = model("matern32", range_s_m=60.0, range_n_m=20.0, sill_m2=0.09, micro_m2=0.0, slow_time_s=10.0)
    both = np.concatenate([places, cells]) / [60.0, 20.0]
    apart = np.linalg.norm(both[:, None] - both[None], axis=2)
    root = np.linalg.cholesky(0.09 * of.correlation(apart) + 1e-9 * np.eye(300))
    t = np.arange(240) * 0.25
    last = np.linalg.cholesky(np.exp(-np.abs(t[:, None] - t[None]) / 10.0) + 1e-12 * np.eye(240))
    squares, naive = [], []
    for _ in range(120):
        field = root @ rng.standard_normal(300)
        z = field[:240] + 0.02 * rng.standard_normal(240) + 0.05 * (last @ rng.standard_normal(240))
        data = Observations(
            s_m=places[:, 0],
            n_m=places[:, 1],
            height_m=z,
            sigma_white_m=np.full(240, 0.02),
            sigma_slow_m=np.full(240, 0.05),
            t_s=t,
            line=line,
        )
        for out, time in ((squares, 10.0), (naive, 0.0)):
            height, sigma = krige(data, cells, CovarianceModel(**vars_of(of) | {"slow_time_s": time}))
            out.append(np.mean(((height - field[240:]) / sigma) ** 2))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.08)
    assert np.mean(naive) > 1.5  # taken as independent, errors that last make sigmas too small


def vars_of(of: CovarianceModel) -> dict:
    return {name: getattr(of, name) for name in of.__dataclass_fields__}


def test_bad_observations_are_named():
    data = observed(10)
    with pytest.raises(GeometryError, match="height_m: 1 of 10 values are no numbers"):
        data.lifted(np.where(np.arange(10) == 3, np.nan, data.height_m))
    with pytest.raises(GeometryError, match="1 soundings"):
        krige(data.where(slice(0, 1)), CELLS, model())
    with pytest.raises(UnsupportedError, match="gaussian"):
        model("gaussian")
