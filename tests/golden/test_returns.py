"""Stored returns: what is told apart, and what a test hears of a change."""

import inspect
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest

from tests.golden import returns
from thalweg.core import rigid


@dataclass(frozen=True)
class Pair:
    """A value with two fields, one of them with gaps."""

    n: int
    depth_m: np.ndarray


PAIR = Pair(3, np.array([1.0, np.nan, 3.0]))


def test_a_value_is_told_by_its_fields() -> None:
    weighted = (1.0 * 1.0 + (1.0 + 0.2360679774) * 3.0) / 2.2360679774
    told = returns.summary({"pair": PAIR, "text": "4 points", "place": "a/4", "none": None})
    assert told == f".pair.n=3; .pair.depth_m[3:2]={weighted:.6g}~{5**0.5:.6g}; .text=4"
    assert returns.summary(pd.DataFrame({"a": [2.0, 2.0], "b": ["x", "y"]})) == ".a[2]=2~2"
    assert returns.summary([(1, "a"), (2, "b")]).startswith("[2]=")
    assert returns.summary(None) == ""


@pytest.mark.parametrize(
    "changed",
    [
        Pair(4, PAIR.depth_m),
        Pair(3, PAIR.depth_m[::-1]),
        Pair(3, np.array([1.0, 3.0])),
        Pair(3, PAIR.depth_m * 1.0001),
        (),
    ],
)
def test_a_change_is_seen_and_rounding_is_not(changed: object) -> None:
    before = returns.summary(PAIR)
    assert returns.compared(before, returns.summary(Pair(3, PAIR.depth_m * (1 + 1e-12)))) == []
    assert {was for was, _ in returns.compared(before, returns.summary(changed))} <= {*before.split("; ")}
    assert returns.compared(before, returns.summary(changed))


def test_a_watched_function_does_what_it_did() -> None:
    """Whoever imported it calls the same object; afterwards nothing is left of the watch."""
    name = f"{rigid.__name__}:exp_rotation"
    code, signature, turned = rigid.exp_rotation.__code__, inspect.signature(rigid.exp_rotation), np.eye(3)
    with returns.watched([name, f"{rigid.__name__}:no longer there"]) as heard:
        assert inspect.signature(rigid.exp_rotation) == signature
        for _ in range(returns.CALLS + 1):
            np.testing.assert_array_equal(rigid.exp_rotation(np.zeros(3)), turned)
    assert heard == {name: [returns.summary(turned)] * returns.CALLS}
    assert rigid.exp_rotation.__code__ is code
    assert not hasattr(rigid.exp_rotation, "__wrapped__")
    rigid.exp_rotation(np.zeros(3))
    assert len(heard[name]) == returns.CALLS


def test_calls_that_threads_make_in_any_order_are_not_compared() -> None:
    name = f"{rigid.__name__}:exp_rotation"
    with returns.watched([name]) as heard:
        rigid.exp_rotation(np.zeros(3))
        with ThreadPoolExecutor(1) as pool:
            pool.submit(rigid.exp_rotation, np.zeros(3)).result()
        assert list(heard) == [name]
    assert heard == {}


def test_a_test_fails_with_what_differs_and_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(returns, "MODE", "check")
    with pytest.raises(AssertionError, match=r"(?s)depth_m=1 is depth_m=2 now.*THALWEG_RETURNS=store pytest"):
        returns.differs("tests/a.py::test_b", ["depth_m=1 is depth_m=2 now"])
    returns.differs("tests/a.py::test_b", [])


def test_stored_rows_stand_for_functions_and_tests_that_exist() -> None:
    """Else they guard nothing; ``store`` drops what a test no longer calls, not a test that is gone."""
    gone = [
        f"{file}: {test}"
        for file, tests in returns.everything().items()
        for test in tests
        if f"def {test.split('::')[-1].split('[')[0]}("
        not in (returns.SOURCE.parent / test.split("::")[0]).read_text()
    ]
    assert gone == []
