"""The error that lists all mistakes of campaign files."""

from collections.abc import Sequence

from thalweg.core.errors import ConfigError
from thalweg.core.mistakes import Mistake


class CampaignError(ConfigError):
    """All mistakes of one or several campaign files, one a line.

    Parameters
    ----------
    mistakes : at least one.
    """

    def __init__(self, mistakes: Sequence[Mistake]) -> None:
        self.mistakes = tuple(mistakes)
        n = len(self.mistakes)
        lines = "\n".join(f"  {mistake}" for mistake in self.mistakes)
        head = f"{n} mistake{'s' if n > 1 else ''} in the campaign settings"
        super().__init__(f"{head}:\n{lines}")
        # The base class ends its text with a stop; here each line has one.
        self.args = (self.found,)
