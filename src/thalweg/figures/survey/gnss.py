"""One page on a post-processed GNSS track: plan, standard deviations over time, which fixes were refused."""

from typing import Final

import numpy as np
import pandas as pd

from thalweg.core import CoverageError, LocalFrame, ThalwegError, Trajectory
from thalweg.figures import Finding, Page, count, empty_figure, plural
from thalweg.figures.survey.maps import survey_map, trajectory_sheet
from thalweg.ingest.ppk import REFUSALS, PpkSolution
from thalweg.navigation.ins_gnss import build_trajectory, states_along_course

_ALL_FIXES: Final = ["fixed", "float", "single", "dgnss", "sbas", "ppp"]


def gnss_page(solution: PpkSolution, *, title: str) -> Page:
    """The page of a PPK solution.

    Parameters
    ----------
    solution : of `run_ppk`.
    title : heading.
    """
    facts, table = solution.report.details, solution.positions
    sigma = table[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].median().to_numpy()
    fixed = (
        f"{100 * facts['fix_ratio']:.1f} % of {count(facts['n_rover_epochs'])} epochs have fixed ambiguities"
    )
    page = Page(
        title,
        f"{fixed}.",
        [
            Finding("epochs with fixed ambiguities", f"{100 * facts['fix_ratio']:.1f} %"),
            Finding("float", f"{count(facts['n_float'])} of {count(facts['n_rover_epochs'])}"),
            Finding("without a position", count(facts["n_none"])),
            Finding("distance of the base, median", f"{facts['baseline_m'] / 1000:.2f} km"),
            Finding(
                "standard deviations, median",
                f"{100 * np.hypot(*sigma[:2]):.1f} cm in plan, {100 * sigma[2]:.1f} cm in height",
            ),
        ],
    )
    page.section("Figures")
    try:
        trajectory = _track(table)
        page.figure(
            survey_map(trajectory, table, title=title), "Plan view; epochs that are not fixed are marked."
        )
        page.figure(
            trajectory_sheet(trajectory, title=title),
            "Standard deviations along the track and over time, and gaps. The attitude is no measurement: a "
            "boat that is level and heads along its course.",
        )
    except ThalwegError as error:  # a track too short to draw is a result all the same
        page.figure(empty_figure(title, str(error)), "No picture.")
    page.section("Fixes")
    refused = [(REFUSALS[why], n) for why, n in facts["n_fixes_refused"].items()]
    page.table(
        pd.DataFrame(refused, columns=["fixed epochs that count as float, because", "n"]),
        "Ambiguity fixes that were not trusted.",
    )
    by_fix = table.groupby("fix")[["sigma_east_m", "sigma_north_m", "sigma_up_m"]].median()
    by_fix.insert(0, "n", table.groupby("fix").size())
    units = {name: "m" for name in by_fix.columns if name != "n"}
    page.table(by_fix.reset_index(), "Positions, and medians of their standard deviations.", units, digits=3)
    page.section("Notes").lines(list(solution.report.notes) or ["none"])
    return page


def _track(table: pd.DataFrame) -> Trajectory:
    """The antenna's track as a trajectory in a frame of its own."""
    placed = table.dropna(subset=["lat_deg", "lon_deg", "h_ell_m"])
    if len(placed) < 2:
        raise CoverageError(f"{plural(len(placed), 'position')}: no track", expected="two at least")
    lat_deg, lon_deg, h_ell_m = (float(placed[name].median()) for name in ("lat_deg", "lon_deg", "h_ell_m"))
    frame = LocalFrame(lat_deg=lat_deg, lon_deg=lon_deg, h_ell_m=h_ell_m)
    step_s = float(np.median(np.diff(placed["t_gps_s"])))
    states = states_along_course(
        table,
        frame,
        accept_fixes=_ALL_FIXES,
        max_gap_s=2.5 * step_s,
        sigma_level_deg=3.0,
        sigma_course_deg=10.0,
    )
    found, _ = build_trajectory(
        table,
        states,
        frame,
        lever_ics_antenna_m=(0.0, 0.0, 0.0),
        sigma_lever_m=(0.0, 0.0, 0.0),
        accept_fixes=_ALL_FIXES,
        max_gap_s=2.5 * step_s,
        max_attitude_gap_s=2.5 * step_s,
        sigma_attitude_rad=(0.05, 0.05, 0.2),
    )
    return found
