"""Numbers of a synchronised run: each under its own name."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
from numpy.testing import assert_allclose

from thalweg.clocks.synchronise import _numbers


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
