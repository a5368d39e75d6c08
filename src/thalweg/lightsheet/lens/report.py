"""The calibration of the sensor's camera as a report: values, sigmas, what they rest on, what was lost."""

from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.lightsheet.lens.lens import LensCalibration

PUBLISHED_SIGMA: Final = 0.004 / 12.0
"""Of the camera constant over itself (P4 6.2)."""


def lens_report(found: LensCalibration) -> dict[str, Any]:
    """Facts for JSON.

    Parameters
    ----------
    found : of `thalweg.lightsheet.lens.lens.calibrate_lens`.

    Returns
    -------
    ``camera``: value, sigma and unit of each parameter; ``sigma_over_constant``: of the camera constant and
    of the principal point over it, beside P4's; ``correlations``, ``images``, ``scale_bars`` as rows;
    ``views``; ``adjustment``: counts, sigma0 with its band, object sigmas; ``rejected``; ``notes``.
    """
    camera = found.camera
    sigma = np.sqrt(np.maximum(np.diag(camera.cov), 0.0))
    values = {
        name: {"value": float(v), "sigma": float(s), "unit": "px" if k < 4 else "1"}
        for k, (name, v, s) in enumerate(zip(camera.parameter_names, camera.parameters, sigma, strict=True))
    }
    share = sigma[:4] / camera.parameters[0]
    network = found.measured.network
    return {
        "camera": values,
        "sigma_over_constant": {
            "camera_constant": float(share[:2].max()),
            "principal_point": float(share[2:].max()),
            "published_camera_constant": PUBLISHED_SIGMA,
            "over_published": float(share[:2].max() / PUBLISHED_SIGMA),
        },
        "correlations": _rows(found.correlations),
        "views": found.views,
        "images": _rows(found.images),
        "scale_bars": _rows(found.bars),
        "adjustment": network.report,
        "rejected": _rows(network.rejected),
        "notes": found.notes,
    }


def _rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a table; what is no number is none in JSON."""
    return [
        {str(key): None if isinstance(v, float) and not np.isfinite(v) else v for key, v in row.items()}
        for row in table.to_dict("records")
    ]
