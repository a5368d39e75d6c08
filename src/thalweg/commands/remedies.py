"""Words of messages for readers of commands: what stands for a setting where there is no campaign."""

from collections.abc import Iterable
from typing import Final

_NO_COLUMNS: Final = {", or state their order: --columns x,y,z": "", ", or state all with --columns": ""}
OF_A_FILE: Final = {
    "campaign.crs": "the coordinate system in the file",
    **_NO_COLUMNS,
    "State --nodata 0 where they are no heights, or --nodata none where they are (in a campaign: nodata)": (
        "Declare the value of missing heights in the file"
    ),
    "(--nodata; in a campaign nodata)": "in the file",
}
"""Of commands that take from files what others state by options."""

OF_POINTS: Final = {"campaign.crs": "--crs", "campaign.origin": "the origin"}
"""Of commands that state the map grid of points."""
OF_CONTROL: Final = {**OF_POINTS, "images.control.crs": "--crs", **_NO_COLUMNS}
"""Of commands that take control points in a table."""


def of_a_campaign(settings: Iterable[str]) -> dict[str, str]:
    """Settings that a command has no option for: a campaign has them."""
    return {each: f"{each} of a campaign" for each in settings}


OF_A_RECORDING: Final = of_a_campaign(
    (
        *("logs.depth_date", "logs.depth", "logs.lidar", "logs.gps_week", "logs.smrmsg"),
        *("logs.ins", "logs.positions", "logs.time_lapse.times"),
        *("lidar.returns", "lidar.model", "lidar.data_port", "lidar.clock.offset_s"),
        *("georeferencing.min_range_m", "georeferencing.max_range_m"),
        *("ins.body_axes", "ins.time_scale", "orientation.sigma_position_m"),
    )
)
"""Of commands that read a recording of any kind, with nothing but what it states."""
