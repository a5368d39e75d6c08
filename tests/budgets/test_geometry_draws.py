"""Random geometries of a budget."""

import numpy as np

from thalweg.budgets.published import drawn


def test_draws_are_the_same_for_a_seed_and_keep_the_length_of_the_lever_arm(budgets) -> None:
    budget = budgets["p2_table1"][0]
    first, again = list(drawn(budget, 200)), list(drawn(budget, 200))
    assert [b.frames for b in first] == [b.frames for b in again]
    assert first[0].frames != next(drawn(budget, 1, seed=2)).frames
    length = np.linalg.norm(budget.frames[1].lever_m)
    levers = np.array([b.frames[1].lever_m for b in first])
    np.testing.assert_allclose(np.linalg.norm(levers, axis=1), length)
    assert {b.frames[0].lever_m for b in first} == {(0.0, 0.0, 0.0)}
    angles = np.array([list(b.frames[1].angles_deg.values()) for b in first])
    # uniform over a full turn: mean 0 +- 7.3, standard deviation 104 degrees
    assert (np.abs(angles.mean(axis=0)) < 30).all()
    np.testing.assert_allclose(angles.std(axis=0), 360 / np.sqrt(12), rtol=0.12)
    # nothing else changes
    assert first[0].inputs == budget.inputs
    assert first[0].motion == budget.motion
