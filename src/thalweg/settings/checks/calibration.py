"""Do the recordings of a calibration field belong together, and is the camera's file there?"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from thalweg.core.mistakes import Mistake
from thalweg.settings.messages.paths import anchor, missing_cure
from thalweg.settings.sections.logs import CalibrationLogs

_NEEDED = {
    "reference_images": "images of the field by a hand-held camera",
}
_STATIC = {
    "position_images": "an image of the boat's camera at each static position",
    "position_scans": "a lidar capture of each static position",
}
_CLOCKS = {"clock_ties": "comparisons", "trigger_pulses": "pulses"}


def check_calibration_logs(
    logs: CalibrationLogs, *, jitter_s: object = None, has_run: bool = False
) -> Iterator[Mistake]:
    """Mistakes between the recordings of a calibration field or of a board; patterns are not expanded yet.

    ``jitter_s`` is ``calibration.clock.jitter_s`` as written, None if absent. ``has_run``: whether lidar and
    INS were recorded on the moving boat; their mount then needs no camera and no static positions.
    """
    given = {name: getattr(logs, name) for name in type(logs).model_fields}
    if logs.field:
        static = not has_run or any(given[name] for name in _STATIC)
        for name, what in (_NEEDED | _STATIC if static else _NEEDED).items():
            if not given[name]:
                yield Mistake(
                    path=("logs", "calibration", name),
                    found="missing",
                    expected=f"{what}, beside logs.calibration.field",
                    cure=f"Add the line `{name}: [...]`",
                )
    elif any(given[name] for name in (*_NEEDED, *_STATIC, "run_images")):
        yield Mistake(
            path=("logs", "calibration", "field"),
            found="missing",
            expected="the description of the field: cones, markers, scale bars, targets",
            cure="Write it as docs/calibration.md shows",
        )
    if len(logs.field) > 1:
        yield Mistake(
            path=("logs", "calibration", "field"),
            found=f"{len(logs.field)} files",
            expected="one description",
            cure="Put all cones and targets into one file",
        )
    if logs.board_images and not (logs.board_scans and logs.board_camera):
        lacking = "board_camera" if logs.board_scans else "board_scans"
        yield Mistake(
            path=("logs", "calibration", lacking),
            found="missing",
            expected="images, scans and the interior orientation of the camera",
            cure=f"Add the line `{lacking}: [...]`",
        )
    yield from _check_clock(logs, jitter_s)


def check_interior(chosen: Any, folder: Path) -> Iterator[Mistake]:
    """Is the file of ``calibration.boat_camera.interior`` there?

    Parameters
    ----------
    chosen : the value as written; what is no text is another check's.
    folder : folder of the campaign file.
    """
    if not isinstance(chosen, str) or not chosen:
        return
    where = ("calibration", "boat_camera", "interior")
    if "\0" in chosen:
        yield Mistake(
            path=where, found=f"found {chosen!r}", expected="a path", cure="Remove the character \\0"
        )
        return
    path = anchor(chosen, folder)
    if not path.is_file():
        yield Mistake(
            path=where,
            found=f"{chosen}: {'this is a folder' if path.is_dir() else 'no such file'}",
            expected=f"an interior orientation at {path}",
            cure="Name the file in it" if path.is_dir() else missing_cure(path),
        )


def _check_clock(logs: CalibrationLogs, jitter_s: object) -> Iterator[Mistake]:
    """One source of the camera's clock, in one file, that says all that is needed."""
    for name, what in _CLOCKS.items():
        count = len(getattr(logs, name))
        if count and not logs.run_images:
            yield Mistake(
                path=("logs", "calibration", "run_images"),
                found="missing",
                expected=f"the images whose times {name} tells; without images it would not be used",
                cure=f"Add the line `run_images: [...]`, or remove {name}",
            )
        if count > 1:
            yield Mistake(
                path=("logs", "calibration", name),
                found=f"{count} files",
                expected=f"one table of {what}",
                cure="Put all rows into one file",
            )
    if logs.clock_ties and logs.trigger_pulses:
        yield Mistake(
            path=("logs", "calibration", "clock_ties"),
            found="both clock_ties and trigger_pulses are given",
            expected="one of them: pulses say when each image was taken, ties how the camera's clock runs",
            cure="Remove clock_ties if the camera was triggered, else trigger_pulses",
        )
    if logs.clock_ties and not logs.display and jitter_s is None:
        yield Mistake(
            path=("calibration", "clock", "jitter_s"),
            found="missing",
            expected="the jitter of the camera's stamps, seconds: ties do not tell it",
            cure="State calibration.clock.jitter_s, or give logs.calibration.display",
        )
