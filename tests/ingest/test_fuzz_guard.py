"""The limits under which damaged inputs are read do bite."""

import signal
import sys
import time
from typing import Any

import numpy as np
import pytest


def hang(fuzz: Any, seen: list[bytes]) -> None:
    for data in fuzz.inputs(b"abc", limit_s=0.05):
        seen.append(data)
        time.sleep(20.0)


def test_an_endless_reader_fails(fuzz):
    seen: list[bytes] = []
    with pytest.raises(TimeoutError, match=r"input 0: not done within 0\.05 s"):
        hang(fuzz, seen)
    assert len(seen) == 1
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the cap of memory is for Linux only")
def test_a_greedy_reader_fails(fuzz):
    np.empty(1 << 30, dtype=np.uint8)
    with pytest.raises(MemoryError):
        np.empty(3 << 30, dtype=np.uint8)


def test_a_reader_that_refuses_all_fails(fuzz):
    n = sum(1 for _ in fuzz.inputs(b"abc", b"xyz"))
    assert n == fuzz.count
    with pytest.raises(AssertionError, match=f"0 of {n} inputs were read"):
        fuzz.check(read=0.1, troubled=0.1)


def test_a_reader_that_reports_nothing_fails(fuzz):
    for _ in fuzz.inputs(b"abc"):
        fuzz.was_read()
    with pytest.raises(AssertionError, match=r"0 of \d+ inputs were refused or reported"):
        fuzz.check(read=0.1, troubled=0.1)
