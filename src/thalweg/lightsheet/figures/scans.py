"""Sections on scanned objects and on a strip of the bed for pages on a light-sheet sensor (P4 7, T 3.2)."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import pandas as pd

from thalweg.core.errors import InputError
from thalweg.figures.calibration.page import TWIN_NOTE, short, with_units
from thalweg.figures.page import Page
from thalweg.figures.style import count, plural

PICTURES: Final = {
    "sheet_image_": "sheet_image",
    "setup_of_": "scan_setup",
    "reference_of_": "scan_reference",
    "profile_of_": "scan_profile",
    "scan_": "scan_distances",
}
"""What names of a scan's pictures begin with, and the stem of the caption that belongs to them."""

SCAN_NOTE: Final = (
    "Distances are signed, positive in front of the reference, after the scan was fitted to it. Standard "
    "deviations are those before and after each outlier rule. The first rule is that of "
    "P4 Tables 2 and 3, three standard deviations of all points; the robust one takes median and NMAD."
)
STRIP_NOTE: Final = (
    "Each line gets its place from the boat's trajectory at the time of its pulse, and from the mount of the "
    "sensor. Sigmas of heights hold the errors of both; those within a line are of its measurement alone."
)
STRIP_TRAJECTORY: Final = {
    "fused": "The trajectory is that of INS, antenna positions and image poses together.",
    "ins": "The trajectory is that of the INS and the antenna positions: there are no images of the bank.",
}
LOST: Final = {
    "far": "points not on the object",
    "at_border": "points at a border of the mesh",
    "on_bad_lines": "points of lines with a bad pose",
}
"""Counts of `facts.json` that say why a point of a scan was not compared."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanFiles:
    """What is known about one scan: tables and reports by stem, pictures with their captions."""

    name: str
    tables: Mapping[str, pd.DataFrame]
    facts: Mapping[str, Mapping[str, Any]]
    pictures: Sequence[tuple[Path, str]] = field(default_factory=tuple)


def read_scans(
    names: Sequence[str], files: Sequence[Path], pictures: Sequence[Path], captions: Mapping[str, str]
) -> list[ScanFiles]:
    """Read the files of all scans, sorted by scan.

    Parameters
    ----------
    names : of the scans in the order of the page.
    files : tables ``<scan>/<stem>.csv`` and reports ``<scan>/<stem>.json``.
    pictures : ``<kind>_<scan>.png``, see `PICTURES`, or ``<scan>/<stem>.png``.
    captions : stem of a caption -> its words.

    Raises
    ------
    InputError : a file that belongs to none of the scans.
    """
    found = []
    for name in names:
        mine = [path for path in files if path.parent.name == name]
        kinds = [(path, kind_of(path, name)) for path in pictures]
        found.append(ScanFiles(
            name=name,
            tables={path.stem: pd.read_csv(path) for path in mine if path.suffix == ".csv"},
            facts={path.stem: json.loads(path.read_text(encoding="utf-8")) for path in mine
                   if path.suffix == ".json"},
            pictures=[(path, captions.get(kind, _words(kind))) for path, kind in kinds if kind],
        ))  # fmt: skip
    lost = [path for path in files if path.parent.name not in names]
    lost += [path for path in pictures if not any(kind_of(path, name) for name in names)]
    if lost:
        raise InputError(
            f"{lost[0].name} in '{lost[0].parent.name}' belongs to no scan",
            expected=f"files of {', '.join(names) or 'no scan'}", where="page on a light-sheet sensor",
        )  # fmt: skip
    return found


def kind_of(picture: Path, scan: str) -> str:
    """Stem of the caption of a picture of that scan; empty if the picture is not one of it.

    Examples
    --------
    >>> kind_of(Path("figures/scan_old_wreck.png"), "old_wreck"), kind_of(Path("scan_old_wreck.png"), "wreck")
    ('scan_distances', '')
    """
    if picture.parent.name == scan:
        return picture.stem
    return next((kind for start, kind in PICTURES.items() if picture.stem == f"{start}{scan}"), "")


def scan_section(page: Page, scan: ScanFiles) -> None:
    """One scanned object: what was found and left out, statistics beside P4's, levels, pictures."""
    page.section(f"Scan: {_words(scan.name)}").text(scan_words(scan))
    table, facts = scan.tables, scan.facts
    for warning in facts.get("facts", {}).get("warnings", ()):
        page.text(f"Warning: {warning}.")
    if "statistics" in table:
        page.text(SCAN_NOTE)
        _units(page, table["statistics"], "All lines, beside P4 Table 3 (statistics.csv)")
    if "profile" in table:
        _units(page, table["profile"], "The middle line by itself, beside P4 Table 2 (profile.csv)")
    levels = facts.get("facts", {}).get("levels")
    if levels:
        words = "Levels of the object; root mean square from the points' own plane of each (facts.json)"
        _units(page, pd.DataFrame(levels), words, digits=5)
    words = "Images, lines and points that were left out (counts.json, facts.json, lines.csv)"
    page.table(left_out(scan), words)
    for picture, words in scan.pictures:
        page.figure(picture, words)


def scan_words(scan: ScanFiles) -> str:
    """The scan in sentences: points, lines, poses, what was predicted, whether two modes were found."""
    merged = scan.facts["counts"]["merged"]
    words = [f"{plural(merged['images'], 'image')} with {count(merged['points'])} points of the line."]
    facts, profile = scan.facts.get("facts"), scan.facts.get("profile")
    if facts is None:
        return " ".join([*words, "There is no reference to compare with."])
    bad = len(facts["images_with_bad_pose"])
    words.append(
        f"{count(facts['counts']['used'])} points lie on the {facts['reference']}; "
        f"{plural(bad, 'line')} with a bad pose."
    )
    honesty = facts["honesty"]
    words.append(
        f"Root mean square of the distances {honesty['rms_mm']:.3f} mm, predicted "
        f"{honesty['predicted_mm']:.3f} mm; of the distances over their sigmas "
        f"{honesty['rms_over_sigma']:.2f}."
    )
    if profile is not None:
        words.append(
            f"Middle line: {profile['rms_mm']:.3f} mm root mean square; distribution with "
            f"{profile['bimodality']}."
        )
    return " ".join(words)


def left_out(scan: ScanFiles) -> pd.DataFrame:
    """Reasons and numbers of what was not compared."""
    rows = _lost_points(scan.facts["counts"])
    facts = scan.facts.get("facts")
    if facts is not None:
        rows += [(words, int(facts["counts"][name])) for name, words in LOST.items()]
    if "lines" in scan.tables:
        reasons = scan.tables["lines"]["reason"].dropna().astype(str).value_counts()
        rows += [(f"lines not judged: {reason}", int(n)) for reason, n in reasons.items()]
    return pd.DataFrame(rows, columns=["left out", "number"])


def strip_page(
    counts: Mapping[str, Any], pictures: Sequence[tuple[Path, str]], *, title: str, twin: bool = False
) -> Page:
    """The page on a strip of the bed under the boat.

    Parameters
    ----------
    counts : ``counts.json`` of the strip: ``lines, merged, images_left_out, times, trajectory``.
    pictures : PNG files with their captions.
    title : heading.
    twin : true if the digital twin made the recordings.
    """
    merged, times = counts["merged"], counts.get("times", {})
    words = (
        f"{plural(int(merged['images']), 'image')} of the bed by the light-sheet sensor under the boat, with "
        f"{count(int(merged['points']))} points in the world (bed.laz)."
    )
    page = Page(title, words)
    if twin:
        page.text(TWIN_NOTE)
    page.text(f"{STRIP_NOTE} {STRIP_TRAJECTORY[counts['trajectory']]}")
    rows = [
        *_lost_points(counts),
        ("images without a pulse", len(times.get("images_without_pulse", ()))),
        ("pulses without an image", len(times.get("pulses_without_image_s", ()))),
    ]
    page.section("What was left out")
    page.table(pd.DataFrame(rows, columns=["left out", "number"]), "Images, pulses and points (counts.json)")
    page.section("Figures")
    for picture, caption in pictures:
        page.figure(picture, caption)
    return page


def _lost_points(counts: Mapping[str, Any]) -> list[tuple[str, int]]:
    """Images by reason, line points by status, and points whose image has no pose."""
    rows = [(f"images: {reason}", n) for reason, n in _numbers(counts.get("images_left_out", {})).items()]
    rows += [(f"line points: {_words(name)}", int(n)) for name, n in counts.get("lines", {}).items()
             if name not in ("line_points", "points")]  # fmt: skip
    return [*rows, ("points of images without a pose", int(counts["merged"]["points_without_pose"]))]


def _numbers(images: Mapping[str, Any]) -> dict[str, int]:
    """Number of images by reason, from the reason of each image."""
    return {str(reason): int(n) for reason, n in pd.Series(images, dtype=object).value_counts().items()}


def _words(stem: str) -> str:
    return stem.replace("_", " ")


def _units(page: Page, table: pd.DataFrame, caption: str, *, digits: int = 4) -> None:
    shown, units = with_units(short(table, digits))
    page.table(shown, caption, units)
