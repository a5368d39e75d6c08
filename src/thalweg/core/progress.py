"""How far a long step is, for people who wait."""

import logging
import time
from collections.abc import Iterable, Iterator, Sized
from typing import Final, TypeVar

T = TypeVar("T")
EVERY_S: Final = 5.0
"""People look up after some seconds; a log of an hour stays below a thousand lines."""
log = logging.getLogger(__name__)


def steps(items: Iterable[T], what: str) -> Iterator[T]:
    """The items one by one, with a message every 5 seconds; none where all of them take less.

    Jobs write the message to their log, where `make demo` reads it, and commands to the terminal.

    Parameters
    ----------
    items : what a loop works on.
    what : in plain words and the singular, such as ``image``.
    """
    of = f" of {len(items)}" if isinstance(items, Sized) else ""
    last_s = time.monotonic()
    for k, item in enumerate(items):
        if time.monotonic() - last_s > EVERY_S:
            last_s = time.monotonic()
            log.info("%s %d%s", what, k + 1, of)
        yield item


def to_terminal() -> None:
    """Show the messages of `steps` on a terminal, each in the place of the one before."""
    handler = logging.StreamHandler()
    handler.terminator = "\r"
    handler.setFormatter(logging.Formatter("  %(message)s\033[K"))
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    log.propagate = False
