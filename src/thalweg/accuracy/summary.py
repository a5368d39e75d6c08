"""Key numbers of a campaign in one table: quantity, value, unit, where it comes from."""

from pathlib import Path
from typing import Any

import pandas as pd

from thalweg.core import read_json

COLUMNS = ["quantity", "value", "unit", "source"]
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
    rows: list[tuple[str, float, str, str]] = []
    for stream in _records(streams):
        rows.append((f"{stream['stream']}: duration", stream["duration_s"], "s", streams.name))
        rows.append(
            (f"{stream['stream']}: records lost or damaged", stream["lost_records"], "1", streams.name)
        )
        rows.append((f"{stream['stream']}: bytes lost", stream["lost_bytes"], "1", streams.name))
    if positions is not None:
        rows += _fix_rows(positions)
    poses = read_json(trajectory)
    share = poses["n_positions_used"] / poses["n_positions"] if poses["n_positions"] else 0.0
    rows.append(("positions used", 100 * share, "%", trajectory.name))
    rows.append(("trajectory nodes with a valid pose", float(poses["n_nodes_valid"]), "1", trajectory.name))
    without = float(poses["n_states"] - poses["n_nodes_valid"]) if "n_states" in poses else 0.0
    rows.append(("INS states without a valid pose", max(without, 0.0), "1", trajectory.name))
    gaps = poses.get("gaps", [])
    rows.append(("gaps in the trajectory", float(len(gaps)), "1", trajectory.name))
    rows.append(("gaps in the trajectory, together", sum(length for _, length in gaps), "s", trajectory.name))
    longest = max((length for _, length in gaps), default=0.0)
    rows.append(("longest gap in the trajectory", longest, "s", trajectory.name))
    if counts is not None:
        points = _records(counts)
        rows.append(("lidar points decoded", sum(row["n"] for row in points), "1", counts.name))
        rows += [(f"  {row['words']}", row["n"], "1", counts.name) for row in points if row["n"]]
    if images is not None:
        rows += _image_rows(images)
    if soundings is not None:
        reasons = read_json(soundings)["by_reason"]
        rows.append(("georeferenced soundings", float(reasons.pop("")), "1", soundings.name))
        rows += [(f"  left out: {why}", float(n), "1", soundings.name) for why, n in reasons.items() if n]
    if bed is not None:
        rows += _bed_rows(bed)
    if reference is not None:
        rows += _reference_rows(reference)
    if truth is not None:
        rows += _truth_rows(truth)
    return pd.DataFrame(rows, columns=COLUMNS)


def _fix_rows(positions: Path) -> list[tuple[str, float, str, str]]:
    """What raw GNSS gave: fixed epochs, those that were not trusted, how far away the base was."""
    facts = read_json(positions)["details"]
    if "fix_ratio" not in facts:
        return []
    refused = float(sum(facts["n_fixes_refused"].values()))
    return [
        ("GNSS epochs with fixed ambiguities", 100 * facts["fix_ratio"], "%", positions.name),
        ("GNSS fixes that were not trusted", refused, "1", positions.name),
        ("distance of the GNSS base, median", facts["baseline_m"] / 1e3, "km", positions.name),
        ("distance of the GNSS base, largest", facts["baseline_max_m"] / 1e3, "km", positions.name),
    ]


def _image_rows(images: Path) -> list[tuple[str, float, str, str]]:
    """Poses of the photographs, and their check points as the adjustment foretold them."""
    facts = read_json(images)
    rows = [
        ("photographs with a pose", float(facts["images"]), "1", images.name),
        ("photographs without a pose", float(facts["images_without_pose"]), "1", images.name),
    ]
    checks = facts["check_points"]
    if not checks or not checks["points"]:
        return [*rows, ("check points", 0.0, "1", images.name)]
    rows.append(("check points", float(checks["points"]), "1", images.name))
    for axis in ("east", "north", "up"):
        rows.append((f"check points: RMSE {axis}", checks["rmse_mm"][axis] / 1e3, "m", images.name))
        rows.append(
            (f"check points: RMSE {axis} predicted", checks["predicted_mm"][axis] / 1e3, "m", images.name)
        )
    normalised = checks["normalised"]
    rows.append(("check points: NEES (1: as predicted)", normalised, "1", images.name))
    return rows


def _bed_rows(bed: Path) -> list[tuple[str, float, str, str]]:
    """How well the riverbed foretells lines of soundings that it did not see."""
    facts = read_json(bed)
    return [
        ("riverbed: left-out lines", float(facts["lines"]), "1", bed.name),
        ("riverbed: RMSE of left-out lines", facts["rmse_m"], "m", bed.name),
        ("riverbed: NEES (1: as predicted)", facts["normalised_square"], "1", bed.name),
        ("riverbed: outside the interval of 95 %", 100 * facts["outside_95"], "%", bed.name),
    ]


def _reference_rows(reference: Path) -> list[tuple[str, float, str, str]]:
    """As measured, with the outlier rule, and the RMSE without it."""
    table = [row for row in _records(reference) if row["registration"] == "as measured"]
    inside = {row["quantity"]: row for row in table if row["points"] == "without outliers"}
    everything = {row["quantity"]: row for row in table if row["points"] == "all"}
    rows = [
        (text, inside[key]["value"], inside[key]["unit"], reference.name)
        for key, text in REFERENCE_FIGURES.items()
    ]
    for key, text in {"n": "points compared", "bias": "mean distance", "rmse": "RMSE"}.items():
        rows.append(
            (
                f"reference, all points: {text}",
                everything[key]["value"],
                everything[key]["unit"],
                reference.name,
            )
        )
    share = 100 * (1 - inside["n"]["value"] / everything["n"]["value"])
    rows.append(("reference: outliers", share, "%", reference.name))
    return rows


def _truth_rows(truth: Path) -> list[tuple[str, float, str, str]]:
    """Of a twin: bare ground against the truth."""
    wanted = {
        "rmse": "bare ground: RMSE against the truth of the twin",
        "predicted_rmse": "bare ground: RMSE predicted",
        "normalised_squared_error": "bare ground: NEES",
        "consistent_low95": "  if sigmas are consistent: above (95 %)",
        "consistent_high95": "  if sigmas are consistent: below (95 %)",
    }
    ground = {row["quantity"]: row for row in _records(truth) if row["points"] == "bare ground"}
    rows: list[tuple[str, float, str, str]] = [
        (text, ground[key]["value"], ground[key]["unit"], truth.name) for key, text in wanted.items()
    ]
    consistent = ground["consistent_low95"]["value"] <= ground["normalised_squared_error"]["value"]
    consistent &= ground["normalised_squared_error"]["value"] <= ground["consistent_high95"]["value"]
    rows.append(("  inside that band (1: yes, 0: no)", float(consistent), "1", truth.name))
    with_gross = {r["quantity"]: r for r in _records(truth) if r["points"].endswith("gross errors")}
    rows.append(("bare ground: RMSE with gross errors", with_gross["rmse"]["value"], "m", truth.name))
    rows.append(("bare ground: gross errors", with_gross["gross_errors"]["value"], "1", truth.name))
    share = 100 * ground["share_of_points"]["value"]
    rows.append(("bare ground: share of all points", share, "%", truth.name))
    return rows


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
