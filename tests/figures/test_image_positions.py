"""Map of images, control points and their residuals (P2 Fig. 6 and 10)."""

import numpy as np
import pandas as pd

from tests.core.conftest import image_poses_of
from thalweg.figures.images.photographs import image_positions
from thalweg.images.model import ControlPoints

T0 = 178_649_913.4


def poses(n=20):
    """Images along a track to the east that look to the south; two without a pose."""
    k = np.arange(n, dtype=float)
    # x to the west, y down, z to the south
    R = [[-1.0, 0, 0], [0, 0, -1.0], [0, -1.0, 0]]
    centre = np.column_stack([2.0 * k, 0.0 * k, np.ones(n)])
    return image_poses_of(centre, R, T0 + k, 1e-4, oriented=~np.isin(k, [4, 11]))


def surveyed(names="ABCDE"):
    k = len(names)
    return ControlPoints(
        names=tuple(names),
        points_wcs_m=np.column_stack([np.linspace(0, 38, k), np.full(k, -12.0), np.ones(k)]),
        cov_wcs_m2=np.tile(1e-4 * np.eye(3), (k, 1, 1)),
        check=np.arange(k) % 2 == 1,
    )


def report():
    table = pd.DataFrame(
        {
            "point": list("ABCDE"),
            "role": ["control", "check", "control", "check", "left out"],
            "images": [4, 5, 6, 7, 0],
            "suspect": [False, False, True, False, False],
        }
    )
    for k, axis in enumerate(("east", "north", "up")):
        table[f"without_{axis}_mm"] = [3.0 + k, -4.0, 20.0, 4.0, np.nan]
        table[f"sigma_without_{axis}_mm"] = [5.0, 5.0, 5.0, 6.0, np.nan]
    return table


def test_everything_is_on_the_map(look, trajectory):
    figure = image_positions(poses(), surveyed(), report(), trajectory=trajectory, title="Test", twin=True)
    words = look.texts(figure)
    for text in (
        "n = 18 of 20 images",
        "2 control points",
        "2 check points",
        "digital twin",
        "suspect",
        "image without a pose, n = 2",
        "point seen in no image",
    ):
        assert text in words, text
    # of the check points: -4 and +4 mm
    assert "RMSE of 2 check points: east 4.0, north 4.0, up 4.0 mm" in words


def test_without_control_points(look):
    figure = image_positions(poses(), ControlPoints.none(), report().iloc[:0])
    assert "control point" not in look.texts(figure).split("|")[0]
