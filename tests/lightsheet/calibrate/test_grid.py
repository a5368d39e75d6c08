"""Description of the grid object: what is read, and what is refused."""

import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.lightsheet.calibrate import lines
from thalweg.core import ConfigError, GeometryError
from thalweg.lightsheet.calibration import parse_grid, read_grid


def test_the_description_holds_levels_and_gaps(tmp_path):
    path = tmp_path / "grid.yaml"
    path.write_text(
        lines.OBJECT.replace("sigma_mm: 0.05}\ngrid", "sigma_mm: 0.04}\nsigma_common_mm: 0.03\ngrid")
    )
    grid = read_grid(path)
    assert [level.name for level in grid.levels] == ["grid", "plate"]
    assert_array_equal(grid.depths_mm, [60.0, 150.0])
    # own variances and the common one: exact sums
    assert_allclose(
        grid.cov_depths_mm2, [[0.05**2 + 0.03**2, 0.03**2], [0.03**2, 0.04**2 + 0.03**2]], rtol=1e-15
    )
    assert grid.gaps_x_mm.shape == (24, 2)
    assert_allclose(grid.gaps_x_mm[:2], [[9.0, 14.0], [23.0, 28.0]])
    assert_allclose(grid.gaps_y_mm, [[5.0, 105.0]])


def test_gaps_may_be_listed():
    text = lines.OBJECT.replace("{bar_mm: 9.0, gap_mm: 5.0, gaps: 24}", "{gaps_mm: [[4, 9], [17, 21.5]]}")
    assert_array_equal(parse_grid(text).gaps_x_mm, [[4.0, 9.0], [17.0, 21.5]])


def test_all_mistakes_are_told_at_once_with_their_lines():
    text = """\
thalweg_grid: 2
name: x
levels:
  - {name: a, pattern: mesh, depth_mm: deep, sigma_mm: 0.05}
  - {name: b, pattern: plate, depth_mm: 150.0}
grid:
  along_x: {bar_mm: 9.0, gap_mm: 5.0, gaps: 2.5}
  along_y: {gaps_mm: [[5, 4]]}
lid: 3
"""
    with pytest.raises(ConfigError) as error:
        parse_grid(text)
    told = str(error.value)
    assert "8 mistakes" not in told or told.count("\n") == 8
    for line, word in (
        (1, "thalweg_grid"),
        (4, "pattern"),
        (4, "depth_mm"),
        (5, "sigma_mm"),
        (7, "whole number"),
        (8, "gaps_mm"),
        (9, "lid"),
    ):
        assert any(f"line {line}:" in row and word in row for row in told.splitlines()), (line, word, told)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("depth_mm: 60.0", "depth_mm: 170.0"), ["swapped", "170", "150", "Exchange"]),
        (("pattern: grid, depth", "pattern: plate, depth"), ["swapped", "light passes a grid"]),
        (("depth_mm: 150.0", "depth_mm: 64.0"), ["4.00 mm apart", "10 mm", "Move the plate"]),
        (("pattern: plate", "pattern: grid"), ["deepest level", "plate"]),
        (
            ("  - {name: plate, pattern: plate, depth_mm: 150.0, sigma_mm: 0.05}\n", ""),
            ["1 level (grid)", "two or three", "Put a plate"],
        ),
    ],
    ids=["swapped depths", "swapped patterns", "too close", "no plate", "one level"],
)
def test_an_object_that_cannot_calibrate_is_refused(change, words):
    text = lines.OBJECT.replace(*change)
    assert text != lines.OBJECT
    with pytest.raises(GeometryError) as error:
        parse_grid(text)
    for word in words:
        assert word in str(error.value)


def test_a_file_that_is_missing_or_empty_is_told(tmp_path):
    with pytest.raises(ConfigError, match="no such file"):
        read_grid(tmp_path / "none.yaml")
    (tmp_path / "empty.yaml").write_text("")
    with pytest.raises(ConfigError, match="thalweg_grid: 1"):
        read_grid(tmp_path / "empty.yaml")
