"""Lengths of comparisons by the data: clouds of 1 mm, of a bank, of a tile, of 5 km."""

import json
from pathlib import Path

import numpy as np
import pytest

from thalweg.cli import main
from thalweg.core import ConfigError
from thalweg.deformation.foreign import compare_clouds, compare_with_surface
from thalweg.deformation.foreign.clouds import lengths_by_data
from thalweg.surface import Texture, meshing_by_data, texture_of

ABOVE = np.array([[0.5, 0.5, 100.0]])
SCALES = {
    "object of 1 mm": (1e-3, 5e-6),
    "bank of 30 m": (30.0, 0.004),
    "tile of 200 m": (200.0, 0.05),
    "valley of 5 km": (5000.0, 0.5),
}
"""Width and noise, metres."""


def cloud(seed: int, width_m: float, noise_m: float, n: int = 4000, lift: float = 0.0) -> np.ndarray:
    """Random places of a gentle surface, lifted by a share of its width along the normal's vertical part."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 1, (2, n))
    z = 0.05 * np.sin(4 * x) + 0.03 * np.cos(3 * y) + lift
    points = width_m * np.column_stack([x, y, z])
    points[:, 2] += rng.normal(0, noise_m, n)
    return points


def written(path: Path, points: np.ndarray) -> Path:
    np.savetxt(path, points, fmt="%.12g")
    return path


@pytest.mark.parametrize("what", SCALES)
def test_spacing_and_scatter_are_measured_at_any_scale(what):
    """Of random places in a square: spacing 1 over the root of the density; curvature adds to the noise."""
    width, noise = SCALES[what]
    texture = texture_of(cloud(901, width, noise), ABOVE * width)
    assert texture.spacing_m == pytest.approx(width / np.sqrt(4000), rel=0.08)
    assert 0.9 * noise < texture.scatter_m < 1.35 * noise + 1e-3 * texture.spacing_m


def test_noise_wider_than_the_spacing_is_measured_too():
    """Neighbours are sought in the view, not in space, where they would be those of equal noise."""
    texture = texture_of(cloud(902, 1.0, 0.05), ABOVE)
    assert texture.scatter_m == pytest.approx(0.05, rel=0.1)
    assert texture.spacing_m == pytest.approx(1 / np.sqrt(4000), rel=0.08)
    # a mean of the points of a cell: as uncertain as a twentieth of its width
    n = (texture.cell_m / texture.spacing_m) ** 2
    assert texture.scatter_m / np.sqrt(n) == pytest.approx(texture.cell_m / 20)


@pytest.mark.parametrize("what", SCALES)
def test_a_cloud_against_itself_is_zero_and_whole(what, tmp_path):
    """With plants, a stray point and doubled points in it."""
    width, noise = SCALES[what]
    points = cloud(903, width, noise)
    points[:300, 2] += np.linspace(0, 0.1, 300) * width
    points = np.concatenate([points, points[:50], [[2.0 * width, 2.0 * width, width]]])
    path = written(tmp_path / "a.xyz", points)
    table, _, facts, notes = compare_with_surface(path, path, {}, registration=True)
    assert facts["counts"]["compared"] == facts["counts"]["points"] == len(points)
    assert (table["distance_m"] == 0.0).all()
    assert facts["all"]["rmse_m"] == facts["without_outliers"]["rmse_m"] == 0.0
    assert facts["registration"]["reason"] == "all points are points of the reference"
    assert any("are points of the reference: their distance is zero" in note for note in notes)


@pytest.mark.parametrize("what", SCALES)
def test_a_lift_is_found_at_any_scale(what, tmp_path):
    """By a hundredth of the width, along normals of slopes that are known; by mesh and by M3C2."""
    width, noise = SCALES[what]
    before, after = cloud(904, width, noise), cloud(905, width, noise, lift=0.01)
    files = written(tmp_path / "a.xyz", before), written(tmp_path / "b.xyz", after)
    x, y = after[:, 0] / width, after[:, 1] / width
    slope = np.hypot(0.2 * np.cos(4 * x), 0.09 * np.sin(3 * y))
    expected = 0.01 * width / np.sqrt(1 + slope**2)
    table, _, facts, _ = compare_with_surface(files[1], files[0], {})
    used = table["used"].to_numpy()
    assert used.mean() > 0.93
    np.testing.assert_allclose(
        np.mean(table["distance_m"][used] - expected[used]), 0.0, atol=0.0004 * width / 10 + 0.05 * noise
    )
    assert set(facts["lengths"]) == {"spacing_m", "scatter_m", "cell_m", "longest_edge_m", "max_distance_m"}
    changes, _, notes = compare_clouds(*files, {}, core_every=None)
    assert (changes["state"] == "deposition").mean() > 0.98
    assert changes["distance_m"].mean() == pytest.approx(expected.mean(), rel=0.02)
    assert any("cylinders of radius" in note for note in notes)
    # each cylinder holds some 28 points, but a thousand core points are the least of 4,000
    assert len(changes) == 1000
    assert any("1 of 4 points is a core point" in note for note in notes)


def test_what_is_stated_stays():
    points = cloud(906, 30.0, 0.004)
    chosen, texture = meshing_by_data(
        points, 30 * ABOVE, {"cell_m": 0.7, "clearance_m": 0.3, "sigma_m": None}
    )
    assert (chosen.cell_m, chosen.clearance_m, chosen.sigma_m) == (0.7, 0.3, 0.0)
    assert chosen.longest_edge_m > 0.7
    edge = meshing_by_data(points, 30 * ABOVE, {"longest_edge_m": 3.0})[0]
    assert (edge.longest_edge_m, edge.cell_m) == (3.0, texture.cell_m)
    with pytest.raises(ConfigError, match=r"longest_edge_m 0.01 is below.*reference\.cell_m"):
        meshing_by_data(points, 30 * ABOVE, {"longest_edge_m": 0.01, "cell_m": 1.0})
    two = [Texture(0.1, 0.002, texture.frame), Texture(0.4, 0.3, texture.frame)]
    by_data = lengths_by_data(two, {"least_points": 7})
    assert by_data.radius_m == pytest.approx(1.2)
    assert by_data.scales_m == pytest.approx((3.0, 6.0, 12.0))
    assert by_data.half_length_m == pytest.approx(36.0)
    assert by_data.least_points == 7
    stated = lengths_by_data(two, {"radius_m": 2.0, "scales_m": (0.5,)})
    assert (stated.radius_m, stated.scales_m, stated.half_length_m) == (2.0, (0.5,), 60.0)


def test_points_a_metre_apart_need_no_option(tmp_path, capsys):
    """And lengths that do not fit are refused with options of the command."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(30.0), np.arange(20.0)))
    first = written(tmp_path / "a.xyz", np.column_stack([x, y, 0.01 * x]))
    second = written(tmp_path / "b.xyz", np.column_stack([x + 0.5, y + 0.5, 0.01 * x + 0.2]))
    out = tmp_path / "o.csv"
    assert main(["compare", str(second), str(first), "-o", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "lengths: spacing 1 m" in printed
    assert "longest edge 7.07 m" in printed
    facts = json.loads(out.with_suffix(".json").read_text())
    assert facts["all"]["bias_m"] == pytest.approx(0.195, abs=0.001)
    assert main(["compare", str(second), str(first), "-o", str(out), "--force", "--longest-edge", "0.9"]) == 2
    told = capsys.readouterr().err
    assert "Raise --longest-edge above the spacing" in told
    assert "reference." not in told

    clouds = ["compare-clouds", str(first), str(second), "--force", "-o", str(out)]
    assert main(clouds) == 0
    assert "1 m apart" in capsys.readouterr().out
    for words, cure in (
        (["--cylinder", "0.3", "--scales", "3"], "Raise --cylinder above the spacing"),
        (["--scales", "0.5"], "Raise --scales"),
    ):
        assert main([*clouds, *words]) == 2
        told = capsys.readouterr().err
        assert cure in told
        assert "coordinate system" not in told


def test_the_page_and_its_figures_say_one_thing(tmp_path):
    """The lead gives the RMSE of the figures, and beside it that without outliers."""
    before, after = cloud(907, 30.0, 0.004), cloud(908, 30.0, 0.004)
    after[:200, 2] += 2.0
    files = written(tmp_path / "a.xyz", before), written(tmp_path / "b.xyz", after)
    out = tmp_path / "o.csv"
    assert main(["compare", str(files[1]), str(files[0]), "-o", str(out)]) == 0
    facts = json.loads(out.with_suffix(".json").read_text())
    page = out.with_suffix(".html").read_text()
    raw, kept = (
        f"{100 * facts[name]['rmse_m']:.1f}\N{NO-BREAK SPACE}cm" for name in ("all", "without_outliers")
    )
    assert raw != kept
    assert f"The cloud lies {raw} (RMSE) from its reference, {kept} without" in page


@pytest.mark.real
def test_two_planes_without_any_option(data_dir):
    """Clouds of py4dgeo, 1 m apart, -0.1 m; its own M3C2 at nine of the points: mean -0.100323 m."""
    files = [data_dir / "py4dgeo_planes" / f"plane_horizontal_t{k}.xyz" for k in (1, 2)]
    table, _, _ = compare_clouds(*files, {}, core_every=None)
    assert len(table) == table["distance_m"].notna().sum() == 441
    assert table["distance_m"].mean() == pytest.approx(-0.1, abs=5e-4)
    exact, _, _ = compare_clouds(*files, {"radius_m": 2.0, "scales_m": (0.5, 1.0, 2.0)})
    assert exact["distance_m"].iloc[:3].to_numpy() == pytest.approx(
        [-0.10269281, -0.09957772, -0.10179986], abs=1e-6
    )
    found, _, facts, _ = compare_with_surface(files[1], files[0], {})
    assert facts["all"]["bias_m"] == pytest.approx(-0.1, abs=5e-4)
    assert found["used"].mean() > 0.9
