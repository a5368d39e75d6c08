"""Budgets: influences, correlations, draws through the finite chain, files and their mistakes, tables."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from tests.lidar.exact_covariance import point_covariance, point_jacobian
from thalweg.budgets import (
    latex,
    long_table,
    page,
    read_budget,
    rmse_mm,
    statements,
    terminal_text,
    totals_mm,
    what_the_cells_tell,
)
from thalweg.budgets.budget import ball_coverage, covariance, influences
from thalweg.budgets.budget_page import WIDTH, Statement, digits, group_shares, label, own_totals
from thalweg.budgets.published import verdicts
from thalweg.core import ConfigError, GeometryError, rotation_enu_body
from thalweg.settings.sections import LidarAccuracy

D = np.array([5.0, 10.0, 25.0, 50.0])


@pytest.fixture
def example(repository: Path, tmp_path: Path) -> Path:
    """The budget that the manual shows."""
    (text,) = re.findall(r"```yaml\n(.*?)```", (repository / "docs/budgets.md").read_text(), re.S)
    path = tmp_path / "boat.yaml"
    path.write_text(text)
    return path


def test_the_example_of_the_manual_runs(example: Path) -> None:
    budget = read_budget(example)
    table = influences(budget)
    assert set(table["input"]) == {*(item.key for item in budget.inputs), "correlations", "total"}
    across = table[table["input"] == "point.across"].set_index("distance_m")["influence_mm"]
    # in two directions, growing with the distance
    assert across[60.0] == pytest.approx(np.sqrt(2) * 0.53e-3 * 60e3)
    assert rmse_mm(budget) > 0


def test_totals_hold_the_covariance_terms(example: Path) -> None:
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


def test_normal_components_add_up_to_the_total(budgets) -> None:
    budget = budgets["p2_table1"][0]
    parts = [influences(budget, D, normal=n)["influence_mm"] ** 2 for n in np.eye(3)]
    np.testing.assert_allclose(sum(parts), influences(budget, D)["influence_mm"] ** 2, rtol=1e-9)


def test_budgets_and_points_share_one_formula(budgets) -> None:
    """The covariance of a budget is that of a lidar point with the same pose, mount and sigmas."""
    budget = budgets["p2_table1"][0]
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


def test_totals_agree_with_draws_through_the_chain(budgets, rng: np.random.Generator) -> None:
    """Nothing of the first-order formula is used: angles are changed and points sent through the chain."""
    budget = budgets["p2_table1"][0]
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


def test_roll_pitch_and_heading_turn_about_their_own_axes(example: Path) -> None:
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


def test_a_ball_of_the_total(rng: np.random.Generator) -> None:
    same, line = np.eye(3)[None], np.diag([1.0, 0, 0])[None]
    # chi-square with 3 degrees of freedom at 3; the normal distribution at 1
    assert ball_coverage(same, [np.sqrt(3)])[0] == pytest.approx(0.608375, abs=1e-6)
    assert ball_coverage(line, [1.0])[0] == pytest.approx(0.682689, abs=1e-5)
    C = np.diag([9.0, 4.0, 0.3])
    draws = rng.normal(size=(400_000, 3)) * np.sqrt(np.diag(C))
    for radius in (1.0, 3.0, 7.0):
        share = np.mean(np.linalg.norm(draws, axis=1) <= radius)
        # standard error 0.08 %; four of them
        assert ball_coverage(C[None], [radius])[0] == pytest.approx(share, abs=0.0032)


@pytest.mark.parametrize("distances", [[0.0], [-5.0], [np.nan], [], [[5.0]]])
def test_distances_that_are_none(budgets, distances) -> None:
    with pytest.raises(GeometryError, match="above 0 m"):
        influences(budgets["p2_table1"][0], distances)


def test_a_normal_without_length(budgets) -> None:
    with pytest.raises(GeometryError, match="a length above 0"):
        influences(budgets["p2_table1"][0], normal=[0, 0, 0])
    with pytest.raises(GeometryError, match="survey"):
        rmse_mm(budgets["p2_table1"][0])


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
def test_each_mistake_is_told_with_its_line(example: Path, good: str) -> None:
    text = example.read_text()
    bad, answer = MISTAKES[good]
    assert text.count(good) == 1
    example.write_text(text.replace(good, bad))
    with pytest.raises(ConfigError, match=re.escape(answer)) as error:
        read_budget(example)
    line = text[: text.index(good)].count("\n") + 1
    assert f"{example}:{line}: " in str(error.value) or "titel" in bad


def test_all_mistakes_come_at_once(example: Path) -> None:
    text = example.read_text()
    for good, (bad, _) in MISTAKES.items():
        text = text.replace(good, bad)
    example.write_text(text)
    with pytest.raises(ConfigError) as error:
        read_budget(example)
    for _, answer in MISTAKES.values():
        assert answer in str(error.value), answer


def test_an_error_of_time_needs_a_motion(example: Path) -> None:
    example.write_text(re.sub(r"motion:.*\n  angles.*\n  axes.*\n", "", example.read_text()))
    with pytest.raises(ConfigError, match="an error of time, but no motion"):
        read_budget(example)


def test_correlations_that_cannot_hold_together(example: Path) -> None:
    more = "  - {between: [ics.roll, ics.pitch], value: 0.9}\n"
    more += "  - {between: [ics.pitch, ics.heading], value: -0.9}\n"
    example.write_text(example.read_text().replace("value: 0.3}\n", "value: 0.9}\n" + more))
    with pytest.raises(ConfigError, match="these cannot hold together"):
        read_budget(example)


def test_a_budget_based_on_another(example: Path) -> None:
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


@pytest.fixture
def facts():
    one = {
        "left_out": "none",
        "instead": "",
        "needed": True,
        "matched": 64,
        "by_sigma": 4,
        "missed": 0,
        "totals_missed": 0,
        "missed_cells": "",
        "lever_m": 0.16,
    }
    other = one | {"left_out": "lever arm", "missed": 1, "missed_cells": "ccs.omega at 5 m"}
    tables = ("p2_table1", "t_table3_1")
    rows = [row | {"table": table} for table in tables for row in (one, other)]
    known = {"n_starts": 9, "n_kept": 8, "n_equal": 7, "n_geometries": 6, "weakest": 0.1}
    return pd.DataFrame(rows), pd.DataFrame([known | {"table": table} for table in tables])


def test_the_page_has_every_cell_with_its_verdict(budgets, facts) -> None:
    said = statements(budgets["p2_table1"][0], budgets["t_table3_1"][0])
    text = page(
        budgets,
        camera="p2_table1",
        ins="t_table3_1",
        worth="72 of 132.",
        statements=said,
        assumptions=facts[0],
        solutions=facts[1],
    )
    for name in ("p2_table1", "t_table3_1"):
        table = verdicts(*budgets[name])
        for printed, value in zip(table["printed"], table["computed_mm"], strict=True):
            digits = len(printed.partition(".")[2]) + 1
            assert re.search(rf"\| {re.escape(printed)} / {value:.{digits}f} [✓≈σc] ", text), (name, printed)
    # the mount's kappa, at three and two distances; P2's phi at 50 m rests on fitted angles
    assert text.count("≈ |") >= 5
    assert text.count("σ |") >= 72
    assert "wcs φ ccs at 50 m (2.9 printed" in text
    assert "**What the cells of both tables tell.** 72 of 132." in text
    assert "Without 'lever arm' it is only: ccs.omega at 5 m." in text
    assert "order of 50 cm / 1197.5 ✗" in text
    for statement in said:
        assert statement.found in text
    assert "Of 9 starting points 7 of the best 8 end in the same cells, in at least 6 different" in text
    assert "each is an isolated point" in text
    assert "| none |  | 64 | 4 | 0 | 0 | 0.16 m |" in text
    assert "| lever arm |  | 64 | 4 | 1 | 0 | 0.16 m |" in text
    for name in ("p2_table1", "t_table3_1"):
        budget = budgets[name][0]
        cov = covariance(budget, D)
        total = np.sqrt(np.trace(cov, axis1=1, axis2=2))
        for k, one in ((1, "68.3 %"), (2, "95.4 %"), (3, "99.7 %")):
            shares = " | ".join(f"{100 * p:.1f} %" for p in ball_coverage(cov, k * total))
            assert f"| {budget.title} | {k} | {one} | {shares} |" in text
        for k, axis in enumerate(("east", "north", "up")):
            row = " | ".join(f"{1e3 * np.sqrt(c[k, k]):.1f}" for c in cov)
            assert f"| {budget.title} | {axis} | {row} |" in text
        third = " | ".join(f"{1e3 * t / np.sqrt(3):.1f}" for t in total)
        assert f"| {budget.title} | total / √3 | {third} |" in text
    assert "| budget | normal | 5 m | 10 m | 25 m | 50 m |\n| --- | --- | ---: | ---: | ---: | ---: |" in text
    later = budgets["sajo_2021"][0]
    assumed = sum(item.provenance == "assumed" for item in later.inputs)
    fitted = sum(item.provenance == "fitted" for item in later.inputs)
    assert f"{assumed + fitted} of {len(later.inputs)} sigmas are not published for this system." in text
    assert "- geometry and speeds: assumed" in text
    for column in re.findall(r"(?m)^\|.*$", text):
        assert column.endswith("|"), column


def test_the_page_tells_what_a_table_does_not_need_and_does_not_settle(budgets, facts) -> None:
    assumptions, solutions = facts
    lever = assumptions["left_out"] == "lever arm"
    spare = assumptions.assign(missed=0, missed_cells="")
    settled = spare.assign(needed=~lever, instead=np.where(lever, "0.2 m", ""))
    alone = {name: budgets[name] for name in ("p2_table1", "t_table3_1")}

    def text(assumptions: pd.DataFrame, weakest: float) -> str:
        return page(
            alone,
            camera="p2_table1",
            ins="t_table3_1",
            worth="",
            statements=[],
            assumptions=assumptions,
            solutions=solutions.assign(weakest=weakest),
        )

    line = text(spare, 1e-7)
    assert line.count("Not needed after all: lever arm.") == 2
    assert line.count("a whole line of geometries has these cells") == 2
    isolated = text(settled, 2e-6)
    assert isolated.count("Not settled by the table: lever arm (0.2 m does as well).") == 2
    assert "Every assumption that is thought to be needed is" in isolated
    assert "Without 'lever arm'" not in isolated
    assert "isolated point" in isolated
    # the first row is the table with all assumptions; three cells are too many for a sentence
    few = np.where(assumptions["table"] == "p2_table1", "a; b", "a; b; c")
    told = re.findall(r"Without .*", text(assumptions.assign(missed_cells=np.where(lever, few, "d")), 1.0))
    assert [line.partition(" Not")[0] for line in told] == ["Without 'lever arm' it is only: a; b."]


def test_small_pieces_of_tables_by_hand(budgets) -> None:
    said = Statement(text="t", source="s", holds={5.0: True, 10.0: False, 12.5: True}, found="")
    assert said.verdict == "holds at 5, 12.5 m only"
    assert replace(said, holds={5.0: False}).verdict == "does not hold"
    assert [digits("5.7", 5.678), digits("12", 12.34), digits("", 0.04), digits("", 0.06), digits("", 0)] == [
        "5.68",
        "12.3",
        "<0.1",
        "0.1",
        "0.0",
    ]
    camera, ins = budgets["p2_table1"][0], budgets["t_table3_1"][0]
    names = {item.key: label(camera, item) for item in camera.inputs}
    assert names["time"] == "Δt"
    assert names["ccs.omega"] == "wcs ω ccs"
    assert names["scs.x"] == "ccs X scs"
    assert names["point.z"] == "scs Z"
    # no distance from 0.1 to 200 m: the heading of a budget whose heading is exact never leads
    exact = replace(
        ins, inputs=tuple(replace(i, sigma=0.0) if i.key == "ics.kappa" else i for i in ins.inputs)
    )
    assert "it leads from nan m on" in statements(camera, exact)[2].found
    # groups add up to all; the totals cross where both are equal
    shares = group_shares(camera, D)
    np.testing.assert_allclose(shares.sum(axis=1), 1.0)
    rows = influences(camera, D)
    timing = rows[rows["input"] == "time"]["influence_mm"].to_numpy()
    np.testing.assert_allclose(shares["timing"], (timing / totals_mm(camera, D)) ** 2)
    (at,) = re.findall(r"equal at ([0-9.]+) m", statements(camera, ins)[3].found)
    assert abs(totals_mm(camera, [float(at)])[0] / totals_mm(ins, [float(at)])[0] - 1) < 0.01
    (half,) = re.findall(r"half of it at ([0-9.]+) m", statements(camera, ins)[0].found)
    turning = group_shares(camera, np.array([float(half)]))[["attitude", "boresight", "timing"]]
    assert turning.sum(axis=1).iloc[0] == pytest.approx(0.5, abs=0.01)


def test_printed_totals_agree_with_the_roots_of_their_cells() -> None:
    cells = pd.DataFrame(
        {
            "input": ["a", "b", "total", "a", "b", "total", "rmse"],
            "distance_m": [5.0, 5.0, 5.0, 10.0, 10.0, 10.0, np.nan],
            "value_mm": [3.0, 4.0, 5.4, 6.0, 8.0, 10.6, 7.0],
            "half_unit_mm": 0.5,
        }
    )
    table = own_totals(cells)
    assert table["distance_m"].tolist() == [5.0, 10.0]
    assert table["printed_mm"].tolist() == [5.4, 10.6]
    assert table["from_cells_mm"].tolist() == [5.0, 10.0]
    assert table["agrees"].tolist() == [True, False]


def test_the_terminal_text_is_narrow_and_complete(budgets) -> None:
    text = terminal_text(budgets, ("p2_table1", "t_table3_1"), worth="What the cells tell. " * 9)
    lines = text.splitlines()
    assert max(map(len, lines[:-1])) <= WIDTH
    marks = [mark for line in lines for mark in re.findall(r"\d ([=~i!c])(?=\s|$)", line)]
    # the mount's kappa, the translations, and what rests on fitted angles
    assert (marks.count("="), marks.count("~"), marks.count("i")) == (3, 5, 72)
    assert marks.count("c") >= 52
    assert "missed" in lines[-1]
    assert text.count("What the cells tell.") >= 8


def test_what_the_cells_tell_is_counted(budgets) -> None:
    text = what_the_cells_tell([budgets["p2_table1"], budgets["t_table3_1"]])
    assert "Of 132 cells and totals 126 are met within 1 %" in text
    assert "6 more within the rounding" in text
    assert "72 of the 132 are the printed sigma itself" in text
    assert "8 more are the same in any geometry" in text
    assert "37 to 44 of 68 (median 38, P2 Table 1) and 38 to 48 of 64 (median 39, T Table 3.1)" in text
    assert "52 cells that depend on the geometry" in text


def test_tables_for_latex_and_csv(budgets) -> None:
    budget, published = budgets["p2_table1"]
    text = latex(budget, published)
    assert text.count(r"\\") == len(budget.inputs) + 3
    assert r"${}^{\mathrm{wcs}}\omega_{\mathrm{ccs}}$ & 0.078\,$^\circ$ & 5.70 (5.7)" in text
    assert r"10.69 (10.5)$^{s}$" in text
    body = [line for line in text.splitlines() if line.endswith(r"\\") and "multicolumn" not in line]
    assert {line.replace(r"\\", "").count("&") for line in body} == {5}
    assert text.count("{") == text.count("}")
    table = long_table(budget, published)
    assert len(table) == 68
    assert table["verdict"].notna().all()
    assert not table["source"].eq("").where(table["input"] != "total", False).any()
    alone = long_table(budget, None)
    assert (alone["verdict"] == "").all()
