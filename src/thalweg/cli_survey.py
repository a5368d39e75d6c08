"""The command ``thalweg ppk``: a GNSS track of anybody's, without a campaign."""

import argparse
from pathlib import Path
from typing import Any


def add_survey_commands(commands: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Add ``ppk``."""
    ppk = commands.add_parser(
        "ppk", help="raw GNSS of a rover and a base -> track with standard deviations that hold, page, KML"
    )
    ppk.add_argument("rover", type=Path, nargs="+", metavar="ROVER", help="SBP or RINEX observations")
    ppk.add_argument(
        "--base",
        type=Path,
        nargs="+",
        metavar="FILE",
        help="the same of the base; not needed where the rover's SBP holds the corrections",
    )
    ppk.add_argument("--nav", type=Path, nargs="+", default=[], metavar="FILE", help="RINEX navigation")
    place = ppk.add_mutually_exclusive_group(required=True)
    place.add_argument(
        "--base-position",
        type=float,
        nargs=3,
        metavar=("LAT_DEG", "LON_DEG", "H_ELL_M"),
        help="antenna of the base, ellipsoidal height",
    )
    place.add_argument("--base-ecef", type=float, nargs=3, metavar=("X_M", "Y_M", "Z_M"))
    place.add_argument(
        "--base-from",
        choices=("sbp", "rinex_header"),
        help="as the log states it; the header of RINEX may be metres off",
    )
    ppk.add_argument(
        "--systems", nargs="+", default=["GPS"], metavar="SYSTEM", help="of GPS GLO GAL QZS BDS SBS"
    )
    ppk.add_argument("--frequencies", default="l1+l2", help="l1, l1+l2, l1+l2+l5 (default: %(default)s)")
    ppk.add_argument("--elevation-mask", type=float, default=15.0, metavar="DEG")
    ppk.add_argument("--direction", choices=("forward", "backward", "combined"), default="forward")
    ppk.add_argument(
        "--trusted-baseline",
        type=float,
        default=20.0,
        metavar="KM",
        help="fixes over a longer baseline count as float (default: %(default)s)",
    )
    ppk.add_argument("--out", type=Path, required=True, metavar="FOLDER")
    ppk.set_defaults(command=_ppk)


def _ppk(options: argparse.Namespace) -> int:
    from thalweg.figures.survey import gnss_page
    from thalweg.ingest.ppk import PpkOptions, run_ppk, write_solution

    base: dict[str, Any] = {
        "base_llh": options.base_position,
        "base_ecef_m": options.base_ecef,
        "base_from": options.base_from,
    }
    section = {
        "systems": options.systems,
        "frequencies": options.frequencies,
        "elevation_mask_deg": options.elevation_mask,
        "direction": options.direction,
        "trusted_baseline_km": options.trusted_baseline,
    }
    solution = run_ppk(options.rover, options.base, options.nav, PpkOptions.from_sections(section, base))
    name = options.rover[0].name
    files = write_solution(solution, options.out, name=name)
    page = options.out / "index.html"
    gnss_page(solution, title=f"GNSS track of {name}").write(page)
    facts = solution.report.details
    refused = sum(facts["n_fixes_refused"].values())
    print(
        f"{facts['n_fixed']:,} fixed, {facts['n_float']:,} float, {facts['n_single']:,} single, "
        f"{facts['n_none']:,} without a position; {refused:,} fixes refused; baseline "
        f"{facts['baseline_m'] / 1000:.2f} km"
    )
    print("\n".join(f"note: {note}" for note in solution.report.notes))
    print(f"Wrote {', '.join(file.name for file in [*files, page])} to {options.out}")
    return 0
