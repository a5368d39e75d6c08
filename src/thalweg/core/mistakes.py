"""A mistake in a file that people write: all of them are told at once."""

from dataclasses import dataclass, field
from pathlib import Path

Key = str | int
"""A key of a mapping, or an index into a list."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mistake:
    """One mistake: where it stands, what was found, what was expected, what to do."""

    path: tuple[Key, ...] = ()
    found: str
    expected: str = ""
    cure: str = ""
    line: int = 0
    """Line in the file, from 1; 0 if unknown."""
    file: Path | None = field(default=None)

    @property
    def dotted(self) -> str:
        """Path in the file, for instance ``logs.lidar[1]``."""
        text = ""
        for key in self.path:
            text += f"[{key}]" if isinstance(key, int) else (f".{key}" if text else str(key))
        return text

    def __str__(self) -> str:
        where = str(self.file) if self.file else ""
        if self.line:
            where += f":{self.line}" if where else f"line {self.line}"
        parts = [p for p in (where, self.dotted) if p]
        text = ": ".join([*parts, self.found])
        if self.expected:
            text += f"; expected {self.expected}"
        text += "."
        if self.cure:
            cure = self.cure.rstrip(".")
            text += f" {cure}" if cure.endswith("?") else f" {cure}."
        return text
