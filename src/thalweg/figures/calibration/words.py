"""What the reports of a calibration's jobs say, in sentences for its page."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.figures.style import count, plural

HELD_PPM: Final = 1e-3
"""A drift with a smaller sigma was not estimated."""


def clock_words(facts: Mapping[str, Any]) -> str:
    """Offset, drift and jitter of a camera's clock, from the report of its synchronisation."""
    keys = ("sigma_offset_s", "jitter_s", "sigma_jitter_s")
    offset_ms, jitter_ms, of_jitter_ms = (1e3 * facts[key] for key in keys)
    words = (
        f"GPS time minus the camera's stamp is {facts['offset_s']:+.4f} s, sigma {offset_ms:.1f} ms, at the "
        f"middle of the run; drift {facts['drift_ppm']:+.0f} ppm, sigma {facts['sigma_drift_ppm']:.0f} ppm. "
        f"Single images are off by {jitter_ms:.1f} ms (standard deviation, sigma {of_jitter_ms:.1f} ms). It "
        f"rests on {plural(int(facts['images_used']), 'image')} and on {facts['variant']}; sigma0 squared "
        f"{facts['sigma0_squared']:.2f}."
    )
    low, high = facts["sigma0_squared_band"]
    return words + f" Right sigmas would leave it between {low:.2f} and {high:.2f}."


def clock_variants(facts: Mapping[str, Any]) -> pd.DataFrame:
    """Table of the same clock under different assumptions; refused ones have no numbers."""
    columns = {
        "variant": ("variant", 1.0),
        "offset_s": ("offset_s", 1.0),
        "sigma_offset_s": ("sigma_offset_ms", 1e3),
        "drift_ppm": ("drift_ppm", 1.0),
        "sigma_drift_ppm": ("sigma_drift_ppm", 1.0),
        "jitter_s": ("jitter_ms", 1e3),
        "sigma0_squared": ("sigma0_squared", 1.0),
        "images_used": ("images", 1.0),
    }
    rows = pd.DataFrame(list(facts.get("variants", [])))
    out = {
        name: rows[key] if factor == 1.0 else factor * rows[key].astype(np.float64)
        for key, (name, factor) in columns.items()
        if key in rows
    }
    table = pd.DataFrame(out)
    if "sigma_drift_ppm" in table:  # held at zero: no result
        table.loc[table["sigma_drift_ppm"] < HELD_PPM, ["drift_ppm", "sigma_drift_ppm"]] = np.nan
    return table


def stability_words(facts: Mapping[str, Any]) -> str:
    """How evenly a camera takes its images, from the report on photographs of a running clock."""
    words = (
        f"Of {count(int(facts['photographs']))} photographs of a running clock "
        f"{count(int(facts['read']))} were read. Intervals: mean {facts['mean_s']:.4f} s, standard deviation "
        f"{1e3 * facts['std_s']:.1f} ms without the share of the display's step "
        f"({1e3 * facts['raw_std_s']:.1f} ms as read), from {plural(int(facts['pairs']), 'pair')} of "
        "neighbours."
    )
    return " ".join([words, *facts.get("notes", [])])


def left_out(facts: Mapping[str, Any]) -> list[str]:
    """Remarks of the report of a field or of a camera: its notes; without any, what it rejected by reason."""
    lines = [
        note[:1].upper() + note[1:] + ("" if note.endswith(".") else ".") for note in facts.get("notes", [])
    ]
    if lines:  # they name what was rejected
        return lines
    rejected = pd.DataFrame(list(facts.get("rejected", [])), columns=["what", "name", "reason"])
    for (what, reason), part in rejected.groupby(["what", "reason"], sort=True):
        names = ", ".join(part["name"].astype(str).head(5)) + (" ..." if len(part) > 5 else "")
        lines.append(f"{plural(len(part), str(what))} left out, {reason}: {names}.")
    return lines


def process_words(facts: Mapping[str, Any]) -> str:
    """What a run about the cones says of the errors of its poses, and where the prior counts; "" if nothing.

    Parameters
    ----------
    facts : of `thalweg.calibration.ins_lidar.file.read_mount_result`.
    """
    processes = facts.get("processes", {})
    if not processes:
        return ""
    found, open_ = (
        [name.replace("_", " ") for name, fact in processes.items() if fact["told_by_survey"] is known]
        for known in (True, False)
    )
    words = ["Errors of the poses are estimated from the run; what the campaign states of them is a prior."]
    words += [f"The run determines {', '.join(found)}."] if found else []
    words += [
        f"It says little of {', '.join(open_)}: there the width of the prior counts. The sigmas hold all "
        "values that run and prior leave possible."
    ] if open_ else []  # fmt: skip
    return " ".join(words)


def process_table(facts: Mapping[str, Any]) -> pd.DataFrame:
    """A row for each parameter of the errors of the poses: stated, estimated, range of 95 %."""
    rows = [
        {
            "parameter": name.replace("_", " "),
            **{key: float(fact[key]) for key in ("stated", "estimated", "low", "high")},
            "determined by": "run" if fact["told_by_survey"] else "prior and run",
        }
        for name, fact in facts.get("processes", {}).items()
    ]
    return pd.DataFrame(rows)
