"""Rules between values about photographs of the bank."""

from collections.abc import Iterator, Mapping
from typing import Any

from thalweg.core.mistakes import Mistake

_BESIDE = ("times", "control_points", "marks", "masks", "interior", "interiors", "orientations")
_SOLVED = {"ins": "the INS's own filter", "sbet": "an Applanix trajectory"}


def check_images(
    logs: Mapping[str, Any] | None, mounts: Any, images: Any, twin: Any, orientation: Any = None
) -> Iterator[Mistake]:
    """Mistakes in what belongs to images of the bank.

    Parameters
    ----------
    logs : ``logs.time_lapse`` as written.
    mounts, images, twin, orientation : the sections of these names as written.
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
    source = _below(orientation, "position_source")
    if adjusted and not given.get("control_points") and not antenna:
        place = (
            "; positions that are part of the INS's solution cannot take their place"
            if source in _SOLVED
            else ", or let the antenna's positions take their place: images.adjustment.antenna.use: true"
        )
        yield Mistake(
            path=("logs", "time_lapse"),
            found="images without control points",
            cure=f"State logs.time_lapse.control_points{place}",
        )
    if antenna and source in _SOLVED and not given.get("orientations"):
        yield Mistake(
            path=("images", "adjustment", "antenna", "use"),
            found=f"true, with positions of {_SOLVED[source]} (orientation.position_source: {source})",
            expected="positions of a GNSS antenna: pos, sbp or ppk",
            cure="Such positions are those of the body's origin and not of the antenna, and the trajectory "
            "that the images are joined with has their GNSS inside: it would count twice. Write use: false "
            "and give control points, or name GNSS positions of the antenna and their position_source",
        )
    interiors = given.get("interiors")
    for folder, files in interiors.items() if isinstance(interiors, Mapping) else ():
        if isinstance(files, list) and len(files) != 1:
            yield Mistake(
                path=("logs", "time_lapse", "interiors", folder),
                found=f"{len(files)} files",
                expected="one interior orientation for the camera of a folder",
                cure="Name one file; a second camera has a folder of its own",
            )


def _below(section: Any, *keys: str) -> Any:
    """A value below a section as written, None if absent."""
    for key in keys:
        section = section.get(key) if isinstance(section, Mapping) else None
    return section
