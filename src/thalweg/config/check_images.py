"""Rules between values about photographs of the bank."""

from collections.abc import Iterator, Mapping
from typing import Any

from thalweg.core.mistakes import Mistake

_BESIDE = ("times", "control_points", "marks", "masks", "interior", "orientations")


def check_images(logs: Mapping[str, Any] | None, mounts: Any, images: Any, twin: Any) -> Iterator[Mistake]:
    """Mistakes in what belongs to images of the bank.

    Parameters
    ----------
    logs : ``logs.time_lapse`` as written.
    mounts, images, twin : the sections of these names as written.
    """
    given = logs if isinstance(logs, Mapping) else {}
    taken = bool(given.get("images")) or bool(_below(twin, "time_lapse"))
    if not taken:
        for key in _BESIDE:
            if given.get(key):
                yield Mistake(
                    path=("logs", "time_lapse", key),
                    found="files that belong to images, but there are none",
                    cure="State logs.time_lapse.images, or leave this out",
                )
        return
    placed = isinstance(mounts, Mapping) and ("camera" in mounts or "calibration" in mounts)
    if not placed:
        yield Mistake(
            path=("mounts",),
            found="images of the bank, but no place of the camera on the boat",
            cure="State mounts.camera, or name the calibration that found it as mounts.calibration",
        )
    adjusted = bool(given.get("images")) and not given.get("orientations")
    antenna = _below(images, "adjustment", "antenna", "use") is True
    if adjusted and not given.get("control_points") and not antenna:
        yield Mistake(
            path=("logs", "time_lapse"),
            found="images without control points",
            cure="State logs.time_lapse.control_points, or let the antenna's positions take their place: "
            "images.adjustment.antenna.use: true",
        )


def _below(section: Any, *keys: str) -> Any:
    """A value below a section as written, None if absent."""
    for key in keys:
        section = section.get(key) if isinstance(section, Mapping) else None
    return section
