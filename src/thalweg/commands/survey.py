"""The commands ``thalweg ppk``, ``georeference``, ``align-strips``, ``view``, without a campaign."""

import argparse
from pathlib import Path
from typing import Any, Final

from thalweg.commands.options import FOLDER, GEODETIC, XYZ
from thalweg.commands.parser import REQUIRED, Commands, OneOf, Repeated, say_notes
from thalweg.commands.remedies import OF_A_FILE, of_a_campaign

OF_A_LOG: Final = {
    "campaign.origin": "--origin",
    "georeferencing.min_range_m": "--min-range",
    "georeferencing.max_range_m": "--max-range",
    "ins.body_axes": "--body-axes",
    "ins.sigma_position_m": "--sigma-position",
    "ins.time_scale": "--time-scale",
    "ins.upside_down": "--upside-down",
    "lidar.clock.first_packet_utc": "--first-packet",
    "lidar.clock.offset_s": "--time-offset",
    "lidar.model": "--model",
    "logs.gps_week": "--gps-week",
    "logs.lidar": "LIDAR",
    "logs.smrmsg": "--smrmsg",
    "orientation.max_attitude_gap_s": "--max-gap",
    **of_a_campaign(
        [
            "filters.below_water_m",
            "filters.max_sigma_m",
            "filters.water_line_ics_m",
            "lidar.data_port",
            "lidar.returns",
            "logs.positions",
            "logs.time_lapse.times",
        ]
    ),
}
"""Settings of a campaign -> the options of commands that read a lidar log and a trajectory."""

LOG: Final[tuple[Any, ...]] = (
    ("lidar", [Path], "LIDAR", "capture; parts in order of time"),
    (
        "--trajectory",
        [Path],
        "FILE",
        "poses: SBET, ANPP, Inertial Explorer, TUM, EuRoC, KITTI, trajectory.parquet of Thalweg",
        REQUIRED,
    ),
    ("--gps-week", int, "WEEK", "GPS week of the first record of an SBET"),
    ("--smrmsg", [Path], "FILE", "accuracies of an SBET", []),
    (
        "--origin",
        [float],
        GEODETIC,
        "origin of the local frame, or of the frame of a table of poses (default: middle of the track)",
    ),
    (
        "--body-axes",
        ("forward-right-down", "forward-left-up", "right-down-forward"),
        None,
        "body axes x-y-z in a table of poses",
    ),
    ("--time-scale", ("utc", "gps"), None, "time scale of a table of poses"),
    ("--upside-down", bool, None, "the sensor of the attitudes is mounted upside down"),
    ("--sigma-position", float, "M", "standard deviation of each axis, if the trajectory states none"),
    ("--sigma-attitude", float, "DEG", "standard deviation of each angle, if the trajectory states none"),
    OneOf(
        [
            ("--mount", Path, "FILE", "calibration file with the mounting of the lidar"),
            ("--lever", [float], XYZ, "lever arm of the lidar: forward, right, down in the body frame"),
        ],
        required=True,
    ),
    (
        "--angles",
        [float],
        ("OMEGA_DEG", "PHI_DEG", "KAPPA_DEG"),
        "boresight of the lidar in the body frame (default: 0 -90 0, spin axis backwards)",
        (0.0, -90.0, 0.0),
    ),
    (
        "--sigma-lever",
        float,
        "M",
        "standard deviation of the lever arm, each axis (default: %(default)s)",
        0.01,
    ),
    (
        "--sigma-angles",
        float,
        "DEG",
        "standard deviation of the boresight, each angle (default: %(default)s)",
        0.2,
    ),
    ("--first-packet", str, "UTC", "time of the first packet of a lidar without GPS, ISO 8601"),
    ("--time-offset", float, "S", "added to the times of the lidar", 0.0),
    ("--model", str, None, "lidar model, if its packets state a wrong one", "auto"),
    ("--max-gap", float, "S", "longest gap of the trajectory that is interpolated", 0.5),
    ("--min-range", float, "M", "shortest range (default: %(default)s)", 1.0),
    ("--max-range", float, "M", "longest range (default: %(default)s)", 100.0),
)
"""What a lidar log is, and where it was."""


def add_survey_commands(commands: Commands) -> None:
    """Add ``ppk``, ``georeference``, ``align-strips`` and ``view``."""
    commands.add(
        "ppk",
        "raw GNSS of rover and base -> track with tested standard deviations, page, KML",
        _ppk,
        ("rover", [Path], "ROVER", "SBP or RINEX observations"),
        (
            "--base",
            [Path],
            "FILE",
            "observations of the base; not needed if the SBP log of the rover holds the corrections",
        ),
        ("--nav", [Path], "FILE", "RINEX navigation", []),
        OneOf(
            [
                ("--base-position", [float], GEODETIC, "position of the base antenna, ellipsoidal height"),
                ("--base-ecef", [float], XYZ, "the same, geocentric"),
                (
                    "--base-from",
                    ("sbp", "rinex_header"),
                    None,
                    "position of the base as the log states it; a RINEX header may be metres off",
                ),
            ],
            required=True,
        ),
        (
            "--systems",
            [str],
            "SYSTEM",
            "satellite systems: GPS GLO GAL QZS BDS SBS (default: of GPS, GAL, QZS those of both logs)",
            "auto",
        ),
        ("--frequencies", str, None, "carriers: l1, l1+l2, l1+l2+l5 (default: %(default)s)", "l1+l2"),
        ("--elevation-mask", float, "DEG", "lowest elevation of a satellite (default: %(default)s)", 15.0),
        (
            "--direction",
            ("forward", "backward", "combined"),
            None,
            "direction of the filter (default: %(default)s)",
            "forward",
        ),
        (
            "--trusted-baseline",
            float,
            "KM",
            "ambiguity fixes over a longer baseline count as float (default: %(default)s)",
            20.0,
        ),
        FOLDER,
        writes="index.html",
        settings={
            "ppk.trusted_baseline_km": "--trusted-baseline",
            **of_a_campaign(
                [
                    "campaign.origin",
                    "ppk.least_fix_s",
                    "orientation.max_gap_s",
                    "orientation.max_attitude_gap_s",
                    "orientation.antenna_h_ell_m",
                    "orientation.sigma_position_m",
                    "orientation.accept_fixes",
                ]
            ),
        },
    )
    commands.add(
        "georeference",
        "lidar capture and trajectory -> cloud with a standard deviation for each point",
        _georeference,
        *LOG,
        ("--crs", str, "EPSG:...", "also write the cloud in this map grid"),
        ("--out", Path, "LAZ", "cloud to write", REQUIRED),
        settings={"campaign.crs": "--crs"} | OF_A_LOG,
    )
    commands.add(
        "align-strips",
        "lidar capture and trajectory -> trajectory corrected by overlapping passes, and its cloud",
        _align_strips,
        *LOG,
        ("--knot", float, "S", "interval of the corrections (default: %(default)s)", 0.5),
        ("--sigma-clock", float, "S", "prior standard deviation of the lidar's clock (default: exact)", 0.0),
        ("--stable", [Path], "CLOUD", "surfaces that are known: terrestrial scans, an earlier epoch", []),
        ("--crs", str, "EPSG:...", "map grid of --stable, if its files state none"),
        ("--sigma-stable", float, "M", "its standard deviation in each cell (default: %(default)s)", 0.01),
        ("--sigma-stable-shift", float, "M", "prior standard deviation of its datum (default: exact)", 0.0),
        FOLDER,
        writes="index.html",
        settings={
            "strips.knot_s": "--knot",
            "strips.sigma_clock_s": "--sigma-clock",
            "strips.sigma_stable_m": "--sigma-stable",
            "strips.sigma_stable_shift_m": "--sigma-stable-shift",
            "logs.stable": "--stable",
            "campaign.crs": "--crs",
            "images.control.crs": "--crs",
            **of_a_campaign(["strips.max_knots", "strips.sigma_range_m"]),
            **OF_A_LOG,
        },
    )
    commands.add(
        "view",
        "any cloud -> a page that opens from disk: turn, colour, measure points, distances, areas, volumes",
        _view,
        (
            "cloud",
            [Path],
            "CLOUD",
            "LAS, LAZ, PLY, E57, x y z text; several, such as those by INS, camera and all sensors, are "
            "told apart by colour",
        ),
        ("--title", str, None, "heading of the page (default: name of the file)"),
        ("--points", int, "N", "shown at most, thinned evenly (default: 1500000)"),
        (
            "--quantity",
            Repeated(str),
            "NAME",
            "extra dimension of a LAS or LAZ file to colour by, up to three (default: the first ones)",
        ),
        ("-o --out", Path, "FOLDER", "for the page and what belongs to it", REQUIRED),
        writes="index.html",
        settings=OF_A_FILE,
    )


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
    say_notes(options, solution.report.notes)
    print(f"Wrote {', '.join(file.name for file in [*files, page])} to {options.out}")
    return 0


def _log_of(options: argparse.Namespace) -> tuple[Any, Any, Any, Any, list[str]]:
    """Reader and clock of a log, its trajectory, how it becomes a cloud, and what was noticed."""
    from datetime import datetime

    from thalweg.calibration import resolve_mounts
    from thalweg.core import InputError, Rigid, gps_from_unix
    from thalweg.core.calibration import read_calibration
    from thalweg.ingest import LidarOptions
    from thalweg.ingest.registry import lidar_reader
    from thalweg.lidar import LogSettings, clock_by_hand
    from thalweg.settings.sections import Filters, Georeferencing, LidarAccuracy, Mounts

    trajectory, notes = _read_trajectory(options)
    reader = lidar_reader(options.lidar, LidarOptions(model=options.model))
    first = None
    if options.first_packet is not None:
        try:
            when = datetime.fromisoformat(options.first_packet)
        except ValueError as error:
            raise InputError(
                f"--first-packet {options.first_packet!r}",
                expected="a time in ISO 8601 such as 2026-05-12T09:30:00.25Z",
                cure="Write date and time with their zone",
            ) from error
        if when.tzinfo is None:
            raise InputError(
                f"--first-packet {options.first_packet!r} names no zone",
                expected="UTC, such as 2026-05-12T09:30:00Z",
                cure="Add Z for UTC, or +02:00",
            )
        first = float(gps_from_unix(when.timestamp()))
    clock = clock_by_hand(reader, reader.scan().clock, first_t_gps_s=first, offset_s=options.time_offset)
    if options.mount is not None:
        mounts = resolve_mounts({}, read_calibration(options.mount))
    else:
        omega, phi, kappa = options.angles
        lidar = {
            "lever_ics_m": options.lever,
            "omega_deg": omega,
            "phi_deg": phi,
            "kappa_deg": kappa,
            "sigma_lever_m": [options.sigma_lever] * 3,
            **{f"sigma_{name}_deg": options.sigma_angles for name in ("omega", "phi", "kappa")},
        }
        section = Mounts.model_validate({"lidar": lidar}, strict=False).model_dump(mode="json")
        mounts = resolve_mounts(section, None)
    how = Georeferencing(min_range_m=options.min_range, max_range_m=options.max_range).model_dump()
    how.pop("export_map")
    # whose boat, and whether it is one, nobody knows here
    no_boat = Filters(
        hull_low_ics_m=None,
        hull_high_ics_m=None,
        below_water_m=None,
        mirror_ghosts=False,
        isolated_neighbours=0,
    )
    settings = LogSettings(
        mount=Rigid.from_mount(mounts["lidar"]), beam=LidarAccuracy(), filters=no_boat, **how
    )
    return reader, clock, trajectory, settings, notes


def _georeference(options: argparse.Namespace) -> int:
    import json

    from thalweg.lidar import export_map, georeference_log

    reader, clock, trajectory, settings, notes = _log_of(options)
    table = georeference_log(reader, clock, trajectory, settings, options.out)
    written = [options.out]
    if options.crs:
        written.append(options.out.with_name(f"{options.out.stem}_map.laz"))
        export_map(options.out, written[1], options.crs)
    facts = options.out.with_suffix(".json")
    reasons = {row["reason"]: int(row["n"]) for row in table.to_dict("records")}
    facts.write_text(json.dumps({"points": reasons, "notes": notes}, indent=2) + "\n", encoding="utf-8")
    for row in table.to_dict("records"):
        if row["n"]:
            print(f"{row['n']:>12,} {row['words']}")
    say_notes(options, notes)
    print(f"Wrote {', '.join(str(path) for path in [*written, facts])}")
    return 0


def _align_strips(options: argparse.Namespace) -> int:
    from dataclasses import replace

    import numpy as np

    from thalweg.core import in_options
    from thalweg.figures.survey import strips_page
    from thalweg.lidar import adjust_strips, error_model_of_log, georeference_log, read_stable, thin_log
    from thalweg.navigation.ins_gnss import PoseCorrelation
    from thalweg.settings.sections import Orientation, Strips

    reader, clock, trajectory, settings, notes = _log_of(options)
    strips = Strips(
        knot_s=options.knot,
        sigma_clock_s=options.sigma_clock,
        sigma_stable_m=options.sigma_stable,
        sigma_stable_shift_m=options.sigma_stable_shift,
    )
    surfaces, assumed = read_stable(options.stable, trajectory.frame, options.crs)
    model = error_model_of_log(
        reader, clock, trajectory, settings, positions_t_gps_s=None, lever_ics_antenna_m=np.zeros(3),
        settings=Orientation().error_model.model_dump(),
    )  # fmt: skip
    trajectory = model.apply(trajectory, np.zeros(3))
    options.out.mkdir(parents=True, exist_ok=True)
    model.write(options.out / "error_model.json")
    correlation = PoseCorrelation.of_survey(
        options.out / "error_model.json", receiver_s=float(np.median(np.diff(trajectory.t_gps_s)))
    )
    found = adjust_strips(
        thin_log(reader, clock, trajectory, settings),
        trajectory,
        settings.mount,
        correlation.chains(trajectory, np.zeros(3)),
        strips,
        surfaces,
    )
    found.write(options.out)
    exact = replace(settings, mount=found.mount.with_cov(np.zeros((6, 6))))
    georeference_log(reader, clock, found.of_lidar, exact, options.out / "points.laz")
    page = options.out / "index.html"
    notes = [in_options(note, options.settings) for note in [*notes, *model.notes, *assumed]]
    said = [in_options(note, options.settings) for note in found.facts["notes"]]
    strips_page(found, title=f"Strips of {options.lidar[0].name}", twin=False, notes=notes).write(page)
    print(
        f"{found.facts['planes']:,} plane spots seen again: {1e3 * found.facts['distance_before_m']:.1f} mm "
        f"apart before, {1e3 * found.facts['distance_after_m']:.1f} mm after"
    )
    print("\n".join(f"not told by the bank: {name}" for name in found.facts["not_told"]))
    print("\n".join(f"note: {note}" for note in [*said, *notes]))
    print(f"Wrote {', '.join(sorted(path.name for path in options.out.iterdir()))} to {options.out}")
    return 0


def _read_trajectory(options: argparse.Namespace) -> tuple[Any, list[str]]:
    """Trajectory of any kind, and what its reader and its builder noticed."""
    import numpy as np

    from thalweg.core import InputError, LocalFrame, Trajectory
    from thalweg.ingest import TrackOptions
    from thalweg.ingest.registry import read_poses
    from thalweg.navigation.ins_gnss import trajectory_from_states

    first = options.trajectory[0]
    if first.suffix == ".parquet":
        return Trajectory.read(first), []
    origin = None
    if options.origin:
        lat, lon, h = options.origin
        origin = LocalFrame(lat_deg=lat, lon_deg=lon, h_ell_m=h)
    how = TrackOptions(
        gps_week=options.gps_week,
        smrmsg=tuple(options.smrmsg),
        frame=origin,
        body_axes=options.body_axes,
        time_scale=options.time_scale,
        sigma_position_m=options.sigma_position,
        sigma_attitude_deg=options.sigma_attitude,
        upside_down=options.upside_down,
    )
    log = read_poses(options.trajectory, None, how)
    states = log.states
    sigmas = states[["sigma_roll_rad", "sigma_pitch_rad", "sigma_heading_rad"]].to_numpy(np.float64)
    if options.sigma_attitude is None and not np.isfinite(sigmas).all():
        raise InputError(
            "the trajectory states no standard deviations of its attitude",
            expected="one for each angle",
            where=first,
            cure="Give --smrmsg beside an SBET, or --sigma-attitude in degrees",
        )
    if origin is None:
        lat, lon, h = (float(states[name].median()) for name in ("lat_deg", "lon_deg", "h_ell_m"))
        origin = LocalFrame(lat_deg=lat, lon_deg=lon, h_ell_m=h)
    angle = np.deg2rad(options.sigma_attitude if options.sigma_attitude is not None else np.nan)
    built, what = trajectory_from_states(
        states,
        origin,
        max_attitude_gap_s=options.max_gap,
        sigma_attitude_rad=np.full(3, angle),
        sigma_position_m=None if options.sigma_position is None else [options.sigma_position] * 3,
    )
    return built, [*log.report.notes, *what.notes]


def _view(options: argparse.Namespace) -> int:
    from thalweg.core import ConfigError
    from thalweg.figures.viewer import MOST_POINTS, read_view, read_views, write_viewer

    most = MOST_POINTS if options.points is None else options.points
    if most < 1:
        raise ConfigError(f"--points {most}", expected="1 or more", where="thalweg view")
    first, *others = options.cloud
    if others and options.quantity:
        raise ConfigError("--quantity with several clouds", expected="one cloud", where="thalweg view")
    view = read_views(options.cloud, most) if others else read_view(first, most, options.quantity or None)
    title = options.title or ", ".join(path.name for path in options.cloud)
    n = write_viewer(view, options.out, title=title, most_points=most)
    lacking = [
        name
        for name, values in (
            ("colours", view.rgb),
            ("intensities", view.intensity),
            ("standard deviations", view.sigma_m),
            ("times", view.t_gps_s),
        )
        if values is None
    ]
    print(f"{n:,} of {view.n_total:,} points")
    if lacking:
        print(f"note: the cloud states no {', no '.join(lacking)}")
    print(f"Wrote {options.out / 'index.html'}: open it in a browser; hand on the folder as a whole")
    return 0
