"""Budgets: influences, correlations, draws through the finite chain, files and their mistakes, tables."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.lidar.exact_covariance import point_covariance, point_jacobian
from thalweg.budgets import (
    covariance,
    digits,
    influences,
    label,
    long_table,
    read_budget,
    rmse_mm,
    text_lines,
    totals_mm,
)
from thalweg.core import ConfigError, GeometryError, rotation_enu_body
from thalweg.settings.sections import LidarAccuracy

D = np.array([5.0, 10.0, 25.0, 50.0])


@pytest.fixture
def example(repository, tmp_path):
    """The budget that the manual shows."""
    (text,) = re.findall(r"```yaml\n(.*?)```", (repository / "docs/budgets.md").read_text(), re.S)
    path = tmp_path / "boat.yaml"
    path.write_text(text)
    return path


def test_the_example_of_the_manual_runs(example):
    budget = read_budget(example)
    table = influences(budget)
    assert set(table["input"]) == {*(item.key for item in budget.inputs), "correlations", "total"}
    across = table[table["input"] == "point.across"].set_index("distance_m")["influence_mm"]
    # in two directions, growing with the distance
    assert across[60.0] == pytest.approx(np.sqrt(2) * 0.53e-3 * 60e3)
    assert rmse_mm(budget) > 0


def test_totals_hold_the_covariance_terms(example):
    budget = read_budget(example)
    table = influences(budget).pivot_table(index="distance_m", columns="input", values="influence_mm")
    alone = (table.drop(columns=["total", "correlations"]) ** 2).sum(axis=1)
    shared = np.sign(table["correlations"]) * table["correlations"] ** 2
    np.testing.assert_allclose(alone + shared, table["total"] ** 2, rtol=1e-9)
    assert (table["correlations"].abs() > 0.1).all()
    # with another sign the total goes the other way
    other = replace(budget, correlations={pair: -v for pair, v in budget.correlations.items()})
    flipped = influences(other).pivot_table(index="distance_m", columns="input", values="influence_mm")
    np.testing.assert_allclose(flipped["correlations"], -table["correlations"])
    np.testing.assert_allclose(alone - shared, flipped["total"] ** 2, rtol=1e-9)


def test_normal_components_add_up_to_the_total(budgets):
    budget = budgets["p2_table1"]
    parts = [influences(budget, D, normal=n)["influence_mm"] ** 2 for n in np.eye(3)]
    np.testing.assert_allclose(sum(parts), influences(budget, D)["influence_mm"] ** 2, rtol=1e-9)


def test_budgets_and_points_share_one_formula(budgets):
    """The covariance of a budget is that of a lidar point with the same pose, mount and sigmas."""
    budget = budgets["p2_table1"]
    outer, inner = budget.frames
    sigma = {item.key: item.sigma_si for item in budget.inputs}
    xyz = D[:, None] * np.ones(3) / np.sqrt(3)
    n, R, A = len(D), outer.rotation(), outer.axes()
    assert budget.motion is not None
    rates, velocity = budget.motion.rates()
    J = point_jacobian(
        xyz,
        np.tile(R, (n, 1, 1)),
        inner.rotation(),
        np.array(inner.lever_m),
        np.tile(velocity, (n, 1)),
        np.tile(A @ rates, (n, 1)),
    )

    def block(name: str, axes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        turn = axes @ np.diag([sigma[f"{name}.{k}"] ** 2 for k in ("omega", "phi", "kappa")]) @ axes.T
        return turn, np.diag([sigma[f"{name}.{k}"] ** 2 for k in "xyz"])

    pose, mount = np.zeros((6, 6)), np.zeros((6, 6))
    pose[3:, 3:], pose[:3, :3] = block("ccs", A)
    mount[3:, 3:], mount[:3, :3] = block("scs", inner.axes())
    beam = LidarAccuracy(sigma_component_m=0.0173, divergence_mrad=0.0, sigma_weak_m=0.0, sigma_time_s=0.0)
    cov = point_covariance(J, np.tile(pose, (n, 1, 1)), mount, beam.variances(D, D), sigma["time"])
    np.testing.assert_allclose(covariance(budget, D), cov, rtol=1e-10, atol=1e-18)


def test_totals_agree_with_draws_through_the_chain(budgets, rng):
    """Nothing of the first-order formula is used: angles are changed and points sent through the chain."""
    budget = budgets["p2_table1"]
    n, d = 40_000, 25.0
    sigma = {item.key: item.sigma_si for item in budget.inputs}
    e = {key: rng.normal(size=n) * s for key, s in sigma.items()}
    outer, inner = budget.frames
    assert budget.motion is not None
    rates, velocity = budget.motion.rates()
    x = d / np.sqrt(3) + np.stack([e[f"point.{c}"] for c in "xyz"], axis=1)
    for frame in (inner, outer):
        angles = np.deg2rad(list(frame.angles_deg.values())) + np.stack(
            [e[f"{frame.name}.{k}"] for k in frame.angles_deg], axis=1
        )
        shift = np.asarray(frame.lever_m) + np.stack([e[f"{frame.name}.{c}"] for c in "xyz"], axis=1)
        if frame is outer:
            angles, shift = angles + e["time"][:, None] * rates, shift + e["time"][:, None] * velocity
        x = Rotation.from_euler("XYZ", angles).apply(x) + shift
    # a standard deviation from n draws is known to 1 / sqrt(2 n) = 0.35 %; four of them
    assert 1e3 * np.sqrt(np.var(x, axis=0).sum()) == pytest.approx(totals_mm(budget, [d])[0], rel=0.014)


def test_roll_pitch_and_heading_turn_about_their_own_axes(example):
    budget = read_budget(example)
    frame = budget.frames[0]
    angles = np.deg2rad(list(frame.angles_deg.values()))
    np.testing.assert_allclose(frame.rotation(), rotation_enu_body(*angles))
    for k, axis in enumerate(frame.axes().T):
        e = 1e-6 * np.eye(3)[k]
        numeric = (
            (rotation_enu_body(*(angles + e)) - rotation_enu_body(*(angles - e))) / 2e-6 @ frame.rotation().T
        )
        # rounding: 1e-16 / 1e-6
        np.testing.assert_allclose([numeric[2, 1], numeric[0, 2], numeric[1, 0]], axis, atol=1e-9)


@pytest.mark.parametrize("distances", [[0.0], [-5.0], [np.nan], [], [[5.0]]])
def test_distances_that_are_none(budgets, distances):
    with pytest.raises(GeometryError, match="above 0 m"):
        influences(budgets["p2_table1"], distances)


def test_a_normal_without_length(budgets):
    with pytest.raises(GeometryError, match="a length above 0"):
        influences(budgets["p2_table1"], normal=[0, 0, 0])
    with pytest.raises(GeometryError, match="survey"):
        rmse_mm(budgets["p2_table1"])


MISTAKES = {
    "status: assumed ": ("status: guessed ", "status: found 'guessed'"),
    "title: A small boat with an INS": ("titel: A small boat", "unknown key"),
    "direction: [1, 1, 0]": ("direction: [0, 0, 0]", "vector without length"),
    "distances_m: [10, 30, 60]": ("distances_m: [10, x]", "distances_m[1]: found 'x'"),
    "  time: {sigma: 1, unit: ms": ("  time: {sigma: -1, unit: deg", "a number of at least 0"),
    "scs.omega: {sigma: 0.05": ("scs.omgea: {sigma: 0.05", "Did you mean scs.omega"),
    "{roll: 0, pitch: 0, heading: 40}": ("{roll: 0, heading: 40}", "pitch is missing"),
    "to_m: 60,": ("to_m: 2,", "a distance above 8 m"),
    "value: 0.3": ("value: 1.3", "a number from -1 to 1"),
    "between: [ics.heading, ics.roll]": ("between: [ics.heading, ics.heading]", "two different inputs"),
    "provenance: published, source: data sheet of the lidar": (
        "provenance: sure, source: me",
        "found 'sure'",
    ),
    "lever_m: [-0.4, 0, -0.3]": ("lever_m: [-0.4, 0]", "a list of 3 numbers"),
}


@pytest.mark.parametrize("good", MISTAKES)
def test_each_mistake_is_told_with_its_line(example, good):
    text = example.read_text()
    bad, answer = MISTAKES[good]
    assert text.count(good) == 1
    example.write_text(text.replace(good, bad))
    with pytest.raises(ConfigError, match=re.escape(answer)) as error:
        read_budget(example)
    line = text[: text.index(good)].count("\n") + 1
    assert f"{example}:{line}: " in str(error.value) or "titel" in bad


def test_all_mistakes_come_at_once(example):
    text = example.read_text()
    for good, (bad, _) in MISTAKES.items():
        text = text.replace(good, bad)
    example.write_text(text)
    with pytest.raises(ConfigError) as error:
        read_budget(example)
    for _, answer in MISTAKES.values():
        assert answer in str(error.value), answer


def test_an_error_of_time_needs_a_motion(example):
    example.write_text(re.sub(r"motion:.*\n  angles.*\n  axes.*\n", "", example.read_text()))
    with pytest.raises(ConfigError, match="an error of time, but no motion"):
        read_budget(example)


def test_correlations_that_cannot_hold_together(example):
    more = "  - {between: [ics.roll, ics.pitch], value: 0.9}\n"
    more += "  - {between: [ics.pitch, ics.heading], value: -0.9}\n"
    example.write_text(example.read_text().replace("value: 0.3}\n", "value: 0.9}\n" + more))
    with pytest.raises(ConfigError, match="these cannot hold together"):
        read_budget(example)


def test_a_budget_based_on_another(example):
    path = example.with_name("better.yaml")
    path.write_text(
        "based_on: boat.yaml\ntitle: The same with a dual antenna\nsource: plan\nstatus: assumed\n"
        "inputs:\n  time: null\n"
        "  ics.heading: {sigma: 0.1, unit: deg, provenance: assumed, source: plan}\n"
    )
    old, new = read_budget(example), read_budget(path)
    assert {i.key for i in old.inputs} - {i.key for i in new.inputs} == {"time"}
    assert next(i for i in new.inputs if i.key == "ics.heading").sigma == 0.1
    assert new.frames == old.frames
    # what speaks of one budget is not taken over
    assert new.survey is None
    path.write_text(path.read_text().replace(", source: plan}", "}"))
    with pytest.raises(ConfigError, match=r"better\.yaml:7: inputs\.ics\.heading: source is missing"):
        read_budget(path)
    example.write_text(example.read_text() + "based_on: better.yaml\n")
    with pytest.raises(ConfigError, match=r"other: better\.yaml -> boat\.yaml -> better\.yaml"):
        read_budget(path)
    path.write_text("based_on: nowhere.yaml\n")
    with pytest.raises(ConfigError, match=r"better\.yaml:1: based_on: there is no file nowhere\.yaml"):
        read_budget(path)


def test_tables_of_a_budget(example, budgets):
    budget = read_budget(example)
    table = long_table(budget)
    total = table[table["input"] == "total"]
    np.testing.assert_array_equal(
        total["influence_mm"],
        1e3 * np.sqrt(np.trace(covariance(budget, total["distance_m"]), axis1=1, axis2=2)),
    )
    assert table["input"].iloc[-1] == "rmse"
    assert table["source"].iloc[-1] == "8 to 60 m: width of the river"
    lines = text_lines(budget)
    assert max(map(len, lines)) <= 100
    (row,) = [line for line in lines if line.startswith("  total")]
    assert row.split()[1:] == [f"{v:.1f}" for v in total["influence_mm"]]
    assert lines[-1] == f"  RMSE {rmse_mm(budget):.0f} mm over 8 to 60 m: width of the river"
    assert [digits(v) for v in (0.04, 0.06, 0.0)] == ["<0.1", "0.1", "0.0"]
    names = {item.key: label(budgets["p2_table1"], item) for item in budgets["p2_table1"].inputs}
    assert [names[key] for key in ("time", "ccs.omega", "scs.x", "point.z")] == [
        "Δt",
        "wcs ω ccs",
        "ccs X scs",
        "scs Z",
    ]
