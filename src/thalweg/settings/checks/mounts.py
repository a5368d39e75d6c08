"""What ``mounts.calibration`` names: is it there, is it a calibration, and does it place the sensors?"""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from thalweg.core.errors import ThalwegError
from thalweg.core.mistakes import Key, Mistake
from thalweg.core.yaml_lines import read_yaml
from thalweg.settings.base.mounts import is_calibration_path
from thalweg.settings.messages.paths import anchor, missing_cure

if TYPE_CHECKING:
    from thalweg.core.calibration.model import Calibration
    from thalweg.settings.campaign import Campaign

SENSORS = ("lidar", "camera", "antenna", "echo_sounder")
"""What a boat's calibration places, as in `thalweg.core.calibration.model`."""

SETTING: tuple[Key, ...] = ("mounts", "calibration")

_NEEDED = ("lidar", "antenna")
"""Without their places there are no points."""

_TOLD = 3
"""Mistakes of a calibration file that are told with the setting; `thalweg describe` tells all."""


def check_mounts_calibration(mounts: Any, campaign_id: Any, folder: Path) -> Iterator[Mistake]:
    """Mistakes in ``mounts.calibration`` and in the file that it names.

    Whether a *campaign* of that name exists is seen where all campaigns are: `thalweg.settings.files.load`.

    Parameters
    ----------
    mounts : section ``mounts`` as written.
    campaign_id : ``campaign.id`` as written.
    folder : folder of the campaign file.
    """
    chosen = mounts.get("calibration") if isinstance(mounts, dict) else None
    if not isinstance(chosen, str) or not chosen:
        return
    if not is_calibration_path(chosen):
        yield from _given_twice(mounts, SENSORS, chosen)
        if chosen == campaign_id:
            yield Mistake(
                path=SETTING,
                found="the campaign names itself",
                expected="another campaign, or a calibration file",
                cure="Remove the line: a calibration campaign starts from the values of its section mounts",
            )
        return
    if "\0" in chosen:
        yield Mistake(
            path=SETTING, found=f"found {chosen!r}", expected="a path", cure="Remove the character \\0"
        )
        return
    path = anchor(chosen, folder)
    found = _file(chosen, path)
    if isinstance(found, Mistake):
        yield found
        return
    yield from _given_twice(mounts, [name for name in SENSORS if name in found], chosen)
    yield from _check_places(found, mounts, chosen)


def _given_twice(mounts: Mapping[str, Any], sensors: Iterable[str], chosen: str) -> Iterator[Mistake]:
    for name in sensors:
        if mounts.get(name) is not None:
            yield Mistake(
                path=("mounts", name),
                found=f"both mounts.calibration ({chosen}) and mounts.{name} are given",
                expected="one of them",
                cure=f"Remove mounts.{name}: the calibration holds it; or remove mounts.calibration",
            )


def _file(chosen: str, path: Path) -> "Calibration | Mistake":
    """The calibration of a file, or what is wrong with it."""
    from thalweg.core.calibration.files import MARK, check_calibration  # numpy, which few campaigns need

    if not path.is_file():
        folder = path.is_dir()
        return Mistake(
            path=SETTING,
            found=f"{chosen}: {'this is a folder' if folder else 'no such file'}",
            expected=f"a calibration file at {path}",
            cure="Name the file in it, boat.yaml" if folder else missing_cure(path),
        )
    document = read_yaml(path)
    if not document.mistakes and not (isinstance(document.data, dict) and MARK in document.data):
        return Mistake(
            path=SETTING,
            found=f"{chosen} is no calibration file",
            expected=f"a file that begins with {MARK}: 1, or the id of a calibration campaign",
            cure=_other_file(document.data, path),
        )
    try:
        calibration, mistakes = check_calibration(path)
    except ThalwegError as error:
        calibration, mistakes = None, [Mistake(found=error.found, expected=error.expected)]
    if calibration is not None and not mistakes:
        return calibration
    n, told = len(mistakes), " ".join(str(mistake) for mistake in mistakes[:_TOLD])
    more = f" And {n - _TOLD} more" if n > _TOLD else ""
    return Mistake(
        path=SETTING,
        found=f"{chosen} holds {n} mistake{'s' if n > 1 else ''}: {told}{more}".rstrip("."),
        expected="a calibration file without mistakes",
        cure=f"Correct {path}, and look at it with `thalweg describe`",
    )


def _other_file(data: Any, path: Path) -> str:
    """What to do with a file that is something else."""
    keys = data if isinstance(data, dict) else {}
    if "campaign" in keys:
        return f"This is a campaign file: write its id, calibration: {path.stem}"
    if "thalweg_field" in keys:
        return "This describes a calibration field: name what came out of it, boat.yaml"
    if keys.get("kind") == "thalweg mounts":
        return "These are the mounts of a campaign: name the calibration that they come from, boat.yaml"
    return "Calibrations of other programs come in by `thalweg import-calibration`"


def _check_places(calibration: "Calibration", mounts: Mapping[str, Any], chosen: str) -> Iterator[Mistake]:
    """Lidar and antenna have a place, in the calibration or in the campaign file."""
    try:
        found = calibration.to_mounts()
    except ThalwegError as error:
        yield Mistake(
            path=SETTING, found=f"{chosen}: {error.found}", expected=error.expected, cure=error.cure
        )
        return
    blocks = ", ".join(block.name for block in calibration.blocks)
    if not found:
        yield Mistake(
            path=SETTING,
            found=f"{chosen} holds the blocks {blocks}, and none of them is a place on the boat",
            expected=f"at least one of {', '.join(SENSORS)}",
            cure="Name the calibration of the boat, boat.yaml",
        )
        return
    for name in _NEEDED:
        if name not in found and not _stated(mounts.get(name)):
            yield Mistake(
                path=SETTING,
                found=f"{chosen} holds the blocks {blocks}, and the campaign states no place of the {name}",
                expected=f"the place of the {name} in the calibration, or mounts.{name}.lever_ics_m",
                cure="Name the calibration of the boat, boat.yaml, or add the section "
                f"`{name}: {{lever_ics_m: [x, y, z]}}`",
            )


def _stated(mount: Any) -> bool:
    """Whether a section places its sensor: zeros stand where nothing is known."""
    lever = mount.get("lever_ics_m") if isinstance(mount, dict) else None
    return isinstance(lever, list) and any(value != 0 for value in lever)


def mount_sources(campaign: "Campaign") -> dict[str, str]:
    """Where the place of each sensor comes from, in words; ``""`` where nothing is stated.

    Parameters
    ----------
    campaign : a valid one, whose ``mounts.calibration`` is an id or an absolute path.

    Raises
    ------
    ThalwegError : the calibration file cannot be read.
    """
    chosen, section = campaign.mounts.calibration, campaign.mounts
    sources = {
        name: "the campaign file" if "lever_ics_m" in getattr(section, name).model_fields_set else ""
        for name in SENSORS
    }
    if chosen is None:
        return sources
    if not is_calibration_path(chosen):
        return dict.fromkeys(SENSORS, f"the calibration campaign {chosen}")
    from thalweg.core.calibration.files import read_calibration

    calibration = read_calibration(Path(chosen))
    words = f"{Path(chosen).name}, run {calibration.source.run}"
    return sources | {name: words for name in SENSORS if name in calibration}
