"""White markers: two modes with light to one side, told by brightness, and brought down by the width."""

from dataclasses import replace

import numpy as np
import pytest

from thalweg.lightsheet.lines import LineFlag, LinePoints, pooled_shift, without_shift
from thalweg.lightsheet.lines.albedo import WidthShift
from thalweg_lab.random_numbers import generator
from thalweg_lab.studies.sensors.sheet_scans import METHODS, STUDIED, WET_PAPER, marker_bias

CHOSEN = {name: METHODS[name] for name in ("matching as P4 4.1", "matching, width corrected")}


def test_wet_paper_gives_two_modes_and_the_width_takes_most_of_it_away() -> None:
    """C080, C322: 0.20 -> 0.13 mm in all, 0.17 -> 0.07 mm after three sigmas, on 8 lines of 1024 pixels.

    Here 6 lines of 512.
    """
    table = marker_bias([STUDIED[0], WET_PAPER], lines=6, size="tiny", methods=CHOSEN).set_index(
        ["share", "method"]
    )
    none, paper = (table.xs(share, level="share") for share in (0.0, 0.5))
    before, after = (paper.loc[name] for name in CHOSEN)
    # detected and flagged: shape, and brightness, which knows nothing of the shape
    assert before["bimodal"]
    assert before["by_brightness"]
    # the lobe goes along the laser: to greater depth, beside the plane
    assert before["shift_mm"] < -0.05
    assert after["corrected"]
    assert after["coefficient"] < -4 * after["sigma_coefficient"]
    assert after["std_mm"] < 0.75 * before["std_mm"]
    assert after["std_kept_mm"] < 0.55 * before["std_kept_mm"]
    # without such light nothing is moved, and over-exposure alone shifts nothing
    assert not none.loc["matching, width corrected", "corrected"]
    assert not none["by_brightness"].any()
    # 0.12 mm beside 0.35 mm, in images of 512 pixels
    assert none.loc["matching as P4 4.1", "std_mm"] < 0.45 * before["std_mm"]


def facts(k: float, sigma: float, edges: float = 10.0) -> dict[str, float]:
    return {"width_shift": k, "sigma_width_shift": sigma, "width_shift_edges": edges}


def test_pooled_coefficients_have_the_sigma_of_their_scatter() -> None:
    rng = generator(1, "pooled")
    errors = []
    for _ in range(200):
        sigma = rng.uniform(0.05, 0.2, 30)
        pooled = pooled_shift(
            [facts(-0.3 + s * e, s) for s, e in zip(sigma, rng.standard_normal(30), strict=True)]
        )
        errors.append((pooled.coefficient + 0.3) / pooled.sigma)
    # 200 of them: 5 %; a factor that never falls below one makes them a little small
    assert np.std(errors) == pytest.approx(1.0, abs=0.2)
    assert pooled.applied
    assert pooled.edges == 300


def test_images_without_a_coefficient_take_no_part() -> None:
    none = {"width_shift": 0.0, "sigma_width_shift": float("nan"), "width_shift_edges": 1.0}
    alone = pooled_shift([facts(-0.3, 0.05)])
    assert pooled_shift([none, facts(-0.3, 0.05), {}]) == alone
    assert alone.applied
    nothing = pooled_shift([none, {}])
    assert not nothing.applied
    assert nothing.edges == 0
    # images that contradict each other prove nothing
    assert not pooled_shift([facts(-0.6, 0.05), facts(0.6, 0.05), facts(-0.2, 0.05)]).applied


@pytest.mark.parametrize("angle_rad", [0.0, np.pi / 2])
def test_only_saturated_points_move_along_their_measurement(angle_rad: float) -> None:
    n = 4
    points = LinePoints(
        line=np.zeros(n, np.int64),
        piece=np.zeros(n, np.int64),
        x_px=np.full(n, 50.0),
        y_px=np.full(n, 60.0),
        sigma_px=np.full(n, 0.1),
        angle_rad=np.full(n, angle_rad),
        peak_dn=np.full(n, 100.0),
        width_px=np.array([5.0, 8.0, 8.0, 3.0]),
        background_dn=np.zeros(n),
        rows=np.ones(n, np.int64),
        flags=np.array([0, int(LineFlag.SATURATED), 0, int(LineFlag.SATURATED)]),
        counts={"points": n},
        facts={"width_unsaturated_px": 5.0},
    )
    moved = without_shift(points, WidthShift(-0.3, 0.02, 40, True))
    along = (moved.x_px - 50.0) * np.cos(angle_rad) + (moved.y_px - 60.0) * np.sin(angle_rad)
    np.testing.assert_allclose(along, [0.0, 0.9, 0.0, -0.6], atol=1e-12)
    np.testing.assert_allclose(np.hypot(moved.x_px - 50, moved.y_px - 60), np.abs(along), atol=1e-12)
    np.testing.assert_allclose(moved.sigma_px, np.hypot(0.1, [0.0, 0.06, 0.0, 0.04]))
    assert moved.facts["width_shift_applied"] == 1.0
    assert without_shift(moved, WidthShift(-0.3, 0.02, 40, True)) is moved  # once is enough
    assert without_shift(points, WidthShift(-0.3, 0.02, 40, False)) is points
    bare = replace(points, facts={})
    assert without_shift(bare, WidthShift(-0.3, 0.02, 40, True)) is bare
