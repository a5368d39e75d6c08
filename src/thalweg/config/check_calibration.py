"""Do the recordings of a calibration field belong together?"""

from collections.abc import Iterator

from thalweg.config.logs import CalibrationLogs
from thalweg.core.mistakes import Mistake

_NEEDED = {
    "reference_images": "images of the field by a hand-held camera",
    "position_images": "an image of the boat's camera at each static position",
    "position_scans": "a lidar capture of each static position",
}


def check_calibration_logs(logs: CalibrationLogs) -> Iterator[Mistake]:
    """Mistakes between the recordings of a calibration field or of a board; patterns are not expanded yet."""
    given = {name: getattr(logs, name) for name in type(logs).model_fields}
    if logs.field:
        for name, what in _NEEDED.items():
            if not given[name]:
                yield Mistake(
                    path=("logs", "calibration", name),
                    found="missing",
                    expected=f"{what}, beside logs.calibration.field",
                    cure=f"Add the line `{name}: [...]`",
                )
    elif any(given[name] for name in (*_NEEDED, "run_images")):
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
