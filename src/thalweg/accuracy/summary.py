"""Key numbers of a campaign in one table: quantity, value, unit, where it comes from."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.core import read_json

COLUMNS = ["quantity", "value", "unit", "source"]
Row = tuple[str, float, str]
"""Quantity, value, unit."""
REFERENCE_FIGURES = {
    "n": "reference, without outliers: points compared",
    "bias": "reference, without outliers: mean distance",
    "rmse": "reference, without outliers: RMSE",
    "nmad": "reference, without outliers: NMAD",
    "predicted_rmse": "reference, without outliers: RMSE predicted",
    "ratio": "reference, without outliers: predicted / observed",
    "ratio_low95": "  95 % acceptance band, lower limit",
    "ratio_high95": "  95 % acceptance band, upper limit",
}
"""Quantities of the comparison with a reference that a surveyor looks at first."""


def summary_table(
    streams: Path,
    trajectory: Path,
    counts: Path | None = None,
    *,
    positions: Path | None = None,
    images: Path | None = None,
    soundings: Path | None = None,
    bed: Path | None = None,
    reference: Path | None = None,
    truth: Path | None = None,
) -> pd.DataFrame:
    """Collect the figures that a surveyor looks at first.

    Parameters
    ----------
    streams : table of the time axis (CSV).
    trajectory : summary of the trajectory (JSON).
    counts : what became of the lidar points (CSV), or None without a lidar.
    positions : integrity report of the positions (JSON); only post-processed ones tell of fixes.
    images : facts of the adjustment of photographs (JSON), or None where there is none.
    soundings : what became of the soundings (JSON), or None without any.
    bed : validation of the riverbed by left-out lines (JSON), or None where there is none.
    reference : statistics of the comparison with a reference (CSV), or None where there is none.
    truth : statistics against the twin's truth (CSV), or None for a real campaign.

    Returns
    -------
    Columns ``quantity, value, unit, source``.
    """
    parts: list[tuple[Path | None, Callable[[Path], Iterator[Row]]]] = [
        (streams, _stream_rows),
        (positions, _fix_rows),
        (trajectory, _trajectory_rows),
        (counts, _point_rows),
        (images, _image_rows),
        (soundings, _sounding_rows),
        (bed, _bed_rows),
        (reference, _reference_rows),
        (truth, _truth_rows),
    ]
    rows = [(*row, path.name) for path, rows_of in parts if path is not None for row in rows_of(path)]
    return pd.DataFrame(rows, columns=COLUMNS).astype({"value": float})


def _stream_rows(streams: Path) -> Iterator[Row]:
    """How long each stream runs, and what was lost of it."""
    for stream in _records(streams):
        name = stream["stream"]
        yield f"{name}: duration", stream["duration_s"], "s"
        yield f"{name}: records lost or damaged", stream["lost_records"], "1"
        yield f"{name}: bytes lost", stream["lost_bytes"], "1"


def _trajectory_rows(trajectory: Path) -> Iterator[Row]:
    """Positions that were used, nodes with a pose, gaps."""
    poses = read_json(trajectory)
    share = poses["n_positions_used"] / poses["n_positions"] if poses["n_positions"] else 0.0
    yield "positions used", 100 * share, "%"
    yield "trajectory nodes with a valid pose", poses["n_nodes_valid"], "1"
    without = poses.get("n_states", 0) - poses["n_nodes_valid"]
    yield "INS states without a valid pose", max(without, 0), "1"
    lengths_s = [length for _, length in poses.get("gaps", [])]
    yield "gaps in the trajectory", len(lengths_s), "1"
    yield "gaps in the trajectory, together", sum(lengths_s), "s"
    yield "longest gap in the trajectory", max(lengths_s, default=0.0), "s"


def _point_rows(counts: Path) -> Iterator[Row]:
    """What became of the lidar points."""
    points = _records(counts)
    yield "lidar points decoded", sum(row["n"] for row in points), "1"
    yield from ((f"  {row['words']}", row["n"], "1") for row in points if row["n"])


def _sounding_rows(soundings: Path) -> Iterator[Row]:
    """What became of the soundings."""
    reasons = read_json(soundings)["by_reason"]
    yield "georeferenced soundings", reasons.pop(""), "1"
    yield from ((f"  left out: {why}", n, "1") for why, n in reasons.items() if n)


def _fix_rows(positions: Path) -> Iterator[Row]:
    """What raw GNSS gave: fixed epochs, those that were not trusted, how far away the base was."""
    facts = read_json(positions)["details"]
    if "fix_ratio" in facts:
        yield "GNSS epochs with fixed ambiguities", 100 * facts["fix_ratio"], "%"
        yield "GNSS fixes that were not trusted", sum(facts["n_fixes_refused"].values()), "1"
        yield "distance of the GNSS base, median", facts["baseline_m"] / 1e3, "km"
        yield "distance of the GNSS base, largest", facts["baseline_max_m"] / 1e3, "km"


def _image_rows(images: Path) -> Iterator[Row]:
    """Poses of the photographs, and their check points as the adjustment foretold them."""
    facts = read_json(images)
    yield "photographs with a pose", facts["images"], "1"
    yield "photographs without a pose", facts["images_without_pose"], "1"
    checks = facts["check_points"] or {"points": 0}
    yield "check points", checks["points"], "1"
    if checks["points"]:
        for axis in ("east", "north", "up"):
            yield f"check points: RMSE {axis}", checks["rmse_mm"][axis] / 1e3, "m"
            yield f"check points: RMSE {axis} predicted", checks["predicted_mm"][axis] / 1e3, "m"
        yield "check points: NEES (1: as predicted)", checks["normalised"], "1"


def _bed_rows(bed: Path) -> Iterator[Row]:
    """How well the riverbed foretells lines of soundings that it did not see."""
    facts = read_json(bed)
    yield "riverbed: left-out lines", facts["lines"], "1"
    yield "riverbed: RMSE of left-out lines", facts["rmse_m"], "m"
    yield "riverbed: NEES (1: as predicted)", facts["normalised_square"], "1"
    yield "riverbed: outside the interval of 95 %", 100 * facts["outside_95"], "%"


def _reference_rows(reference: Path) -> Iterator[Row]:
    """As measured, with the outlier rule, and the RMSE without it."""
    table = [row for row in _records(reference) if row["registration"] == "as measured"]
    inside, everything = (
        {row["quantity"]: row for row in table if row["points"] == points}
        for points in ("without outliers", "all")
    )
    for key, text in REFERENCE_FIGURES.items():
        yield text, inside[key]["value"], inside[key]["unit"]
    for key, text in {"n": "points compared", "bias": "mean distance", "rmse": "RMSE"}.items():
        yield f"reference, all points: {text}", everything[key]["value"], everything[key]["unit"]
    yield "reference: outliers", 100 * (1 - inside["n"]["value"] / everything["n"]["value"]), "%"


def _truth_rows(truth: Path) -> Iterator[Row]:
    """Of a twin: bare ground against the truth."""
    table = _records(truth)
    ground = {row["quantity"]: row for row in table if row["points"] == "bare ground"}
    for key, text in {
        "rmse": "bare ground: RMSE against the truth of the twin",
        "predicted_rmse": "bare ground: RMSE predicted",
        "normalised_squared_error": "bare ground: NEES",
        "consistent_low95": "  if sigmas are consistent: above (95 %)",
        "consistent_high95": "  if sigmas are consistent: below (95 %)",
    }.items():
        yield text, ground[key]["value"], ground[key]["unit"]
    names = ("consistent_low95", "normalised_squared_error", "consistent_high95")
    low, found, high = (ground[name]["value"] for name in names)
    yield "  inside that band (1: yes, 0: no)", low <= found <= high, "1"
    gross = {row["quantity"]: row["value"] for row in table if row["points"].endswith("gross errors")}
    yield "bare ground: RMSE with gross errors", gross["rmse"], "m"
    yield "bare ground: gross errors", gross["gross_errors"], "1"
    yield "bare ground: share of all points", 100 * ground["share_of_points"]["value"], "%"


def summary_lines(table: pd.DataFrame) -> list[str]:
    """The table as aligned text lines for a terminal."""
    lines = []
    for row in table.to_dict("records"):
        value = _number_text(float(row["value"]))
        unit = "" if row["unit"] == "1" else row["unit"]
        lines.append(f"  {row['quantity']:52s} {value:>16s} {unit}".rstrip())
    return lines


def _number_text(number: float) -> str:
    """A figure of the summary as people read it."""
    if pd.isna(number):
        return "-"
    return f"{number:,.0f}" if number == round(number) else f"{number:,.3f}"


def _records(path: Path) -> list[dict[str, Any]]:
    return [{str(key): value for key, value in row.items()} for row in pd.read_csv(path).to_dict("records")]
