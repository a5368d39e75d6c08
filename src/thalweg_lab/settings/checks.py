"""Rules between values of the section ``twin`` and those beside it."""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any, Final

from thalweg.core import Key, Mistake
from thalweg.settings import mistake, value_at
from thalweg.settings.sections import Orientation

_LEVELS: Final = 2
"""Default of ``light_sheet.calibration.levels`` and number of levels of the twin's object."""


def twin_mistakes(data: Mapping[str, Any], orientation: Orientation | None) -> Iterator[Mistake]:
    """Mistakes between the section ``twin`` and others.

    Parameters
    ----------
    data : the campaign as written.
    orientation : the section; None if it cannot be read.
    """
    twin = data["twin"]
    if orientation is not None:
        yield from _check_positions(twin, orientation)
    yield from check_sheet_twin(twin, data.get("light_sheet"))
    on_land = isinstance(value_at(twin, "field"), dict) or str(value_at(twin, "size")).startswith("field")
    if on_land and value_at(twin, "echo", "bed_survey"):
        yield mistake(
            "twin.echo.bed_survey",
            "a calibration field on land has no river bed",
            "bed_survey in a survey campaign",
            "Remove the line, or move it to a campaign on the river",
        )


def _check_positions(twin: Any, orientation: Orientation) -> Iterator[Mistake]:
    source, fixes = orientation.position_source, orientation.accept_fixes
    if source in {"sbet", "nmea", "gpx"}:
        yield mistake(
            "orientation.position_source",
            f"found {source!r}, but the twin does not write such logs",
            "pos, sbp, ppk or ins",
            "Write position_source: pos",
        )
    of_size = "single_frequency" if value_at(twin, "size") == "reach" else None
    mode = value_at(twin, "gnss", "mode") or of_size
    if mode == "single_frequency" and source != "ins" and "single" not in fixes:
        yield mistake(
            "orientation.accept_fixes",
            f"found {list(fixes)}, but twin.gnss.mode is single_frequency",
            "single among them: such a receiver never has a fixed solution",
            "Write accept_fixes: [single], or position_source: ins",
        )


def check_sheet_twin(twin: Any, light_sheet: Any) -> Iterator[Mistake]:
    """Mistakes in the twin's grid object.

    Parameters
    ----------
    twin, light_sheet : the sections of these names as written.
    """
    depths = value_at(twin, "light_sheet", "levels_mm")
    count = _LEVELS
    where: tuple[Key, ...] = ("twin", "light_sheet", "levels_mm")
    if isinstance(depths, list) and all(isinstance(d, int | float) for d in depths):
        count = len(depths)
        if any(low >= high for low, high in pairwise(depths)):
            yield mistake(
                where,
                f"found {depths}",
                "depths that grow from level to level",
                f"Write {sorted(set(depths))}",
            )
    levels = value_at(light_sheet, "calibration", "levels")
    levels = _LEVELS if levels is None else levels
    is_basin = value_at(twin, "light_sheet") is not None or str(value_at(twin, "size")).startswith("basin")
    if is_basin and isinstance(levels, int) and levels != count:
        yield mistake(
            ("light_sheet", "calibration", "levels") if value_at(light_sheet, "calibration") else where,
            f"light_sheet.calibration.levels is {levels}, the twin's object has {count}",
            "the same number of levels",
            f"Write light_sheet.calibration.levels: {count}",
        )
