"""Messages of long loops."""

import logging

import thalweg.core.errors as progress
from thalweg.core import steps


def test_a_long_loop_says_how_far_it_is_and_a_short_one_nothing(caplog, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    with caplog.at_level(logging.INFO):
        assert list(steps("abc", "letter")) == ["a", "b", "c"]
        assert not caplog.messages
        for _ in steps(range(4), "image"):
            now[0] += 3.0
        for _ in steps(iter("ab"), "block"):
            now[0] += 6.0
    assert caplog.messages == ["image 3 of 4", "block 2"]
