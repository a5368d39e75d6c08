"""Do the recordings of the light-sheet sensor belong together, and does the twin's object make sense?"""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from thalweg.core import Key, Mistake
from thalweg.settings.checks_files import IMAGE_ENDINGS
from thalweg.settings.sections import STREAM_KEYS, LightSheetLogs, Logs

NEEDED: Final[Mapping[str, str]] = {
    "sensor": "the design of the sensor",
    "camera_marks": "marks that its camera sees through air",
    "mark_points": "the coordinates of these marks",
    "grid_images": "the image of the laser on the grid object",
    "grid": "the grid object with the depths of its levels",
}
"""Keys of ``logs.light_sheet`` without which nothing can be calibrated."""

_PANEL: Final = "images of the panel and its depth in each"
_TOGETHER: Final[Mapping[str, tuple[str, str]]] = {
    "panel_images": ("panels", _PANEL),
    "panels": ("panel_images", _PANEL),
}
_ONE_FILE: Final = (
    "sensor",
    "camera_field",
    "camera_field_marks",
    "camera_marks",
    "mark_points",
    "grid",
    "panels",
)
_LEVELS: Final = 2
"""Default of ``light_sheet.calibration.levels`` and number of levels of the twin's object."""


def check_sheet_logs(logs: Logs, files: Mapping[str, tuple[str, ...]]) -> Iterator[Mistake]:
    """Mistakes between the recordings of the light-sheet sensor.

    Parameters
    ----------
    logs : the section as written.
    files : absolute paths by stream, patterns expanded; see `thalweg.settings.checks_files.check_files`.
    """
    sheet = logs.light_sheet
    if not sheet.given:
        return
    for name, what in NEEDED.items():
        if not getattr(sheet, name):
            yield _missing(name, f"{what}, beside logs.light_sheet.{sheet.given[0]}")
    for name, (other, what) in _TOGETHER.items():
        if getattr(sheet, name) and not getattr(sheet, other):
            yield _missing(other, f"{what}, beside logs.light_sheet.{name}")
    yield from _check_field(sheet)
    streams = {keys[1]: stream for stream, keys in STREAM_KEYS.items() if keys[0] == "light_sheet"}
    for name in _ONE_FILE:
        count = len(files.get(streams[name], ()))
        if count > 1:
            yield Mistake(
                path=("logs", "light_sheet", name),
                found=f"{count} files",
                expected="one file",
                cure="Name the one that belongs to these recordings; another day is another campaign",
            )
    images = _images(files.get(streams["grid_images"], ()))
    if images > 1:
        yield Mistake(
            path=("logs", "light_sheet", "grid_images"),
            found=f"{images} images",
            expected="one image of the laser on the grid object, to which the depths in grid belong",
            cure="Name one image; the others may serve in campaigns of their own, as a check",
        )
    for stream, keys in STREAM_KEYS.items():
        if keys[0] != "light_sheet" and logs.files(stream):
            yield Mistake(
                path=("logs", *keys),
                found="recordings of a boat beside those of the light-sheet sensor in a basin",
                expected="one of both in a campaign: the boat's logs would not be used",
                cure="Make a campaign of its own for them",
            )


def check_sheet_twin(twin: Any, light_sheet: Any) -> Iterator[Mistake]:
    """Mistakes in the twin's grid object.

    Parameters
    ----------
    twin, light_sheet : the sections of these names as written.
    """
    depths = _below(twin, "light_sheet", "levels_mm")
    count = _LEVELS
    where: tuple[Key, ...] = ("twin", "light_sheet", "levels_mm")
    if isinstance(depths, list) and all(isinstance(d, int | float) for d in depths):
        count = len(depths)
        if any(low >= high for low, high in pairwise(depths)):
            yield Mistake(
                path=where,
                found=f"found {depths}",
                expected="depths that grow from level to level",
                cure=f"Write {sorted(set(depths))}",
            )
    levels = _below(light_sheet, "calibration", "levels")
    levels = _LEVELS if levels is None else levels
    is_basin = _below(twin, "light_sheet") is not None or str(_below(twin, "size")).startswith("basin")
    if is_basin and isinstance(levels, int) and levels != count:
        yield Mistake(
            path=("light_sheet", "calibration", "levels") if _below(light_sheet, "calibration") else where,
            found=f"light_sheet.calibration.levels is {levels}, the twin's object has {count}",
            expected="the same number of levels",
            cure=f"Write light_sheet.calibration.levels: {count}",
        )


def _check_field(sheet: LightSheetLogs) -> Iterator[Mistake]:
    """A marker field has a description, and pictures or marks."""
    seen = [name for name in ("camera_field_images", "camera_field_marks") if getattr(sheet, name)]
    if seen and not sheet.camera_field:
        what = "markers and scale bars of the field"
        yield _missing("camera_field", f"{what}, beside logs.light_sheet.{seen[0]}")
    if sheet.camera_field and not seen:
        what = "pictures of the field, or camera_field_marks"
        yield _missing("camera_field_images", f"{what}, beside logs.light_sheet.camera_field")
    if len(seen) == 2:
        yield Mistake(
            path=("logs", "light_sheet", "camera_field_marks"),
            found="marks beside the pictures that they were measured in",
            expected="camera_field_images or camera_field_marks",
            cure="Leave one of both out",
        )


def _missing(name: str, expected: str) -> Mistake:
    return Mistake(
        path=("logs", "light_sheet", name),
        found="missing",
        expected=expected,
        cure=f"Add the line `{name}: [...]`; docs/light_sheet.md says what each file holds",
    )


def _images(paths: tuple[str, ...]) -> int:
    """Images among files and in folders; a folder that cannot be read is another check's."""
    count = 0
    for text in paths:
        path = Path(text)
        if not path.is_dir():
            count += 1
            continue
        try:
            count += sum(entry.suffix.lower() in IMAGE_ENDINGS for entry in path.iterdir())
        except OSError:
            continue
    return count


def _below(section: Any, *keys: str) -> Any:
    """A value below a section as written, None if absent."""
    for key in keys:
        section = section.get(key) if isinstance(section, Mapping) else None
    return section
