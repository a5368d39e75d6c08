"""As many threads as a job is worth: starting and joining them costs more than a few thousand rays."""

from collections.abc import Iterator
from contextlib import contextmanager

import numba as nb


@contextmanager
def threads_for(n: int, *, each: int) -> Iterator[None]:
    """Let compiled loops run in so many threads that each gets at least ``each`` of ``n`` elements.

    The number of threads belongs to the calling thread, and is set back afterwards.

    Examples
    --------
    >>> with threads_for(100, each=4096):
    ...     nb.get_num_threads()
    1
    """
    before = nb.get_num_threads()
    wanted = min(before, max(1, n // each))
    if wanted == before:
        yield
        return
    nb.set_num_threads(wanted)
    try:
        yield
    finally:
        nb.set_num_threads(before)
