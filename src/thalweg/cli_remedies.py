"""Words of messages for readers of commands: what stands for a setting where there is no campaign."""

from collections.abc import Iterable
from typing import Final

OF_A_FILE: Final = {
    "campaign.crs": "the coordinate system in the file",
    ", or state their order: --columns x,y,z": "",
    "State --nodata 0 where they are no heights, or --nodata none where they are (in a campaign: nodata)": (
        "Declare the value of missing heights in the file"
    ),
    "(--nodata; in a campaign nodata)": "in the file",
}
"""Of commands that take from files what others state by options."""


def of_a_campaign(settings: Iterable[str]) -> dict[str, str]:
    """Settings that a command has no option for: a campaign has them."""
    return {each: f"{each} of a campaign" for each in settings}
