"""The commands ``thalweg bed``, ``flow``, ``plan-survey`` and ``refract``: riverbeds without a campaign."""

import argparse
from pathlib import Path

from thalweg.commands.parser import Commands
from thalweg.commands.remedies import OF_A_FILE, OF_A_RECORDING, of_a_campaign


def add_bathymetry_commands(commands: Commands) -> None:
    """Add ``bed``, ``flow``, ``plan-survey`` and ``refract``."""
    bed = commands.add_parser(
        "bed",
        help="bed of a river or a lake with standard deviations from a table of soundings, kriged in flow or "
        "map coordinates",
    )
    bed.add_argument(
        "table",
        type=Path,
        metavar="TABLE",
        help="soundings: any text with columns, in degrees or in metres, or points of a GIS",
    )
    bed.add_argument(
        "--crs",
        metavar="EPSG:...",
        help="coordinate system of the map, projected; a table in degrees needs none (its zone of UTM)",
    )
    value = bed.add_mutually_exclusive_group()
    value.add_argument("--height", metavar="COLUMN", help="column with heights of the bed (default: by name)")
    value.add_argument("--depth", metavar="COLUMN", help="column with depths below the water, likewise")
    bed.add_argument(
        "--columns",
        type=lambda text: text.split(","),
        metavar="NAMES",
        help="names of the columns in their order, where the table has none: lat,lon,depth_ft,-,time",
    )
    bed.add_argument(
        "--missing",
        type=float,
        action="append",
        default=[],
        metavar="VALUE",
        help="value that stands for none, beside the usual ones such as -9999 and, of a depth, 0",
    )
    bed.add_argument(
        "--valid",
        type=float,
        action="append",
        default=[],
        metavar="VALUE",
        help="value that is meant although it usually stands for none, such as 0",
    )
    bed.add_argument("--level", type=float, metavar="M", help="height of the water level; 0 with --depth")
    bed.add_argument(
        "--levels",
        type=Path,
        metavar="CSV",
        help="with --depth: levels of the water by day or time, columns date (UTC) and level",
    )
    bed.add_argument(
        "--coordinates",
        choices=("auto", "flow", "map"),
        default="auto",
        help="along and across the flow, or east and north; auto: east and north where nothing shows a river",
    )
    bed.add_argument(
        "--line", metavar="COLUMN", help="column with the name of the survey line (default: detected)"
    )
    bed.add_argument(
        "--banks",
        type=Path,
        metavar="FILE",
        help="both bank lines, or the water surface as a polygon (GeoJSON, Shapefile, GeoPackage, KML, GML, "
        "DXF; FILE?layer=NAME of several); with heights or --level also data",
    )
    bed.add_argument(
        "--centre-line",
        type=Path,
        metavar="FILE",
        help="one line of a GIS, or CSV with east, north, in downstream order (default: from banks or "
        "soundings)",
    )
    bed.add_argument("--islands", type=Path, metavar="FILE", help="polygons of islands, which are no bed")
    bed.add_argument(
        "--cell", type=_positive, metavar="M", help="cell size of the grid (default: by the soundings)"
    )
    bed.add_argument(
        "--out",
        type=Path,
        default=Path("bed"),
        metavar="FOLDER",
        help="folder of the results (default: %(default)s)",
    )
    bed.add_argument(
        "--sigma",
        type=_positive,
        default=0.02,
        metavar="M",
        help="standard deviation of a sounding, if the table has no column sigma (default: %(default)s)",
    )
    bed.add_argument(
        "--model",
        choices=("auto", "exponential", "matern32", "spherical"),
        default="auto",
        help="covariance function; auto: best in cross-validation of lines",
    )
    bed.add_argument(
        "--drift",
        choices=("auto", "none", "section", "section_width", "fall"),
        default="auto",
        help="trend that is removed before kriging: none, mean cross-section, that and a depth that grows "
        "where the river is narrower, slope along the river",
    )
    bed.add_argument(
        "--neighbours", type=int, default=48, metavar="N", help="data used for a cell (default: %(default)s)"
    )
    bed.add_argument(
        "--reach",
        type=_positive,
        default=2.0,
        metavar="RANGES",
        help="leave cells empty beyond this multiple of the range from data (default: %(default)s)",
    )
    bed.set_defaults(
        command=_bed,
        writes="bed.tif",
        settings={
            "campaign.crs": "--crs",
            "campaign.origin": "the origin",
            "bathymetry.reach": "--reach",
            "bathymetry.cell_m": "--cell",
            "bathymetry.line_turn_deg": "--line",
            "accuracy.area.polygon": "--islands",
            "accuracy.area": "--islands",
            **OF_A_RECORDING,
            **of_a_campaign(["bathymetry.engine"]),
        },
    )

    flow = commands.add_parser("flow", help="flow coordinates of points: along and across a centre line")
    flow.add_argument("points", type=Path, metavar="POINTS", help="CSV with east, north (or x, y)")
    flow.add_argument(
        "--centre-line",
        type=Path,
        required=True,
        metavar="FILE",
        help="one line of a GIS, or CSV with east, north, in downstream order",
    )
    flow.add_argument(
        "--out", type=Path, required=True, metavar="CSV", help="table to write, with s_m, n_m, fold"
    )
    flow.set_defaults(command=_flow, settings=OF_A_FILE | {"campaign.origin": "the origin"})

    plan = commands.add_parser(
        "plan-survey", help="survey lines between two banks, and the accuracy of the bed to expect"
    )
    plan.add_argument(
        "banks",
        type=Path,
        metavar="BANKS",
        help="bank lines, or the water surface as a polygon: GeoJSON, Shapefile, GeoPackage, KML, GML, DXF",
    )
    plan.add_argument(
        "--crs", required=True, metavar="EPSG:...", help="coordinate system of the banks, projected, metres"
    )
    plan.add_argument(
        "--pattern", choices=("zigzag", "sections", "along"), required=True, help="pattern of the lines"
    )
    plan.add_argument("--speed", type=_positive, required=True, metavar="M/S", help="speed of the boat")
    plan.add_argument(
        "--sigma",
        type=_positive,
        required=True,
        metavar="M",
        help="standard deviation wanted for 95 %% of the bed",
    )
    plan.add_argument(
        "--out",
        type=Path,
        default=Path("plan"),
        metavar="FOLDER",
        help="folder of the results (default: %(default)s)",
    )
    plan.add_argument(
        "--leg",
        type=_positive,
        metavar="M",
        help="distance of neighbouring lines (default: the largest that reaches --sigma)",
    )
    plan.add_argument(
        "--margin",
        type=_positive,
        default=2.0,
        metavar="M",
        help="distance from the banks (default: %(default)s)",
    )
    plan.add_argument(
        "--centre-line",
        type=Path,
        metavar="FILE",
        help="one line of a GIS, or CSV with east, north, in downstream order (default: from banks or "
        "soundings)",
    )
    plan.add_argument(
        "--variogram",
        type=Path,
        metavar="JSON",
        help="covariance function of the bed: variogram.json of `thalweg bed` or of a campaign",
    )
    plan.add_argument(
        "--relief",
        type=_positive,
        default=0.3,
        metavar="M",
        help="without --variogram: standard deviation of the bed about its mean, with ranges of half the "
        "width across the river and twice the width along it (default: %(default)s)",
    )
    plan.add_argument(
        "--sigma-sounding",
        type=_positive,
        default=0.05,
        metavar="M",
        help="standard deviation of a sounding (default: %(default)s)",
    )
    plan.add_argument("--power", type=_positive, metavar="W", help="power of the boat at this speed")
    plan.add_argument("--battery", type=_positive, metavar="WH", help="energy of one battery")
    plan.set_defaults(
        command=_plan,
        writes="plan.json",
        settings=OF_A_FILE
        | {
            "campaign.crs": "--crs",
            "campaign.origin": "the origin",
            "accuracy.area.polygon": "the outline",
            "accuracy.area": "the outline",
        },
    )

    refract = commands.add_parser(
        "refract",
        help="photogrammetric points of a bed seen through water -> heights corrected for refraction",
    )
    refract.add_argument("points", type=Path, metavar="CSV", help="columns x, y, z, or east, north, height")
    refract.add_argument(
        "--cameras",
        type=Path,
        required=True,
        metavar="CSV",
        help="projection centres: columns x, y, z, in the same frame",
    )
    level = refract.add_mutually_exclusive_group(required=True)
    level.add_argument("--level", type=float, metavar="M", help="height of the water surface")
    level.add_argument(
        "--water", metavar="COLUMN", help="column with the height of the water surface above each point"
    )
    refract.add_argument("--height", metavar="COLUMN", help="column with heights, if it is not z or height")
    refract.add_argument("--index", type=float, default=1.333, help="refractive index (default: %(default)s)")
    refract.add_argument(
        "--sigma-point", type=float, default=0.0, metavar="M", help="standard deviation of an apparent height"
    )
    refract.add_argument(
        "--sigma-water", type=float, default=0.0, metavar="M", help="standard deviation of the water level"
    )
    refract.add_argument(
        "--max-off-nadir",
        type=float,
        default=35.0,
        metavar="DEG",
        help="largest angle of a ray off the vertical (default: %(default)s)",
    )
    refract.add_argument("-o", "--out", type=Path, required=True, metavar="CSV", help="table to write")
    refract.set_defaults(command=_refract, settings=OF_A_FILE)


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r}; expected a number above zero")
    return value


def _refract(options: argparse.Namespace) -> int:
    from thalweg.bathymetry import correct_refraction, read_columns

    points, water = read_columns(options.points, height=options.height, water=options.water)
    table = correct_refraction(
        points,
        water if options.level is None else options.level,
        read_columns(options.cameras)[0],
        index=options.index,
        sigma_point_m=options.sigma_point,
        sigma_water_m=options.sigma_water,
        max_off_nadir_deg=options.max_off_nadir,
    )
    options.out.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(options.out, index=False, float_format="%.4f")
    for state, n in table["state"].value_counts().items():
        print(f"{n:>12,} {state}")
    wet = table[table["depth_m"].notna()]
    if len(wet):
        print(
            f"depth {wet['apparent_depth_m'].mean():.3f} m -> {wet['depth_m'].mean():.3f} m in the mean, "
            f"factor {wet['factor'].mean():.3f}, "
            f"sigma of the height {wet['sigma_height_m'].median():.3f} m (median)"
        )
    print(f"Wrote {options.out}")
    return 0


def _bed(options: argparse.Namespace) -> int:
    import numpy as np
    from pydantic import ValidationError

    from thalweg.bathymetry import (
        FlowLine,
        Levels,
        bed_of_table,
        map_crs,
        read_islands,
        read_line,
        read_soundings,
        usual_cell_m,
        water_of,
    )
    from thalweg.core import ConfigError, InputError, in_options
    from thalweg.figures import save
    from thalweg.figures.bathymetry import bed_picture
    from thalweg.fusion import map_of_bed
    from thalweg.settings.sections import Bathymetry

    soundings = read_soundings(
        options.table,
        None if options.crs is None else map_crs(options.crs, feet=True),
        column=options.depth or options.height,
        depth=None if options.depth is options.height is None else options.depth is not None,
        level_m=None if options.levels else options.level,
        line_column=options.line,
        sigma_m=options.sigma,
        order=options.columns,
        nothing=options.missing,
        keep=options.valid,
    )
    crs = soundings.crs
    notes: list[str] = []
    try:
        settings = Bathymetry(
            islands=[] if options.islands is None else read_islands(options.islands, crs, notes),
            cell_m=options.cell or usual_cell_m(soundings.places_m),
            model=options.model,
            drift=options.drift,
            neighbours=options.neighbours,
            reach=options.reach,
        )
    except ValidationError as error:
        raise ConfigError(
            "; ".join(f"{e['loc'][-1] if e['loc'] else ''}: {e['msg']}" for e in error.errors())
        ) from error
    if options.levels is not None:
        if not soundings.depth:
            raise InputError(
                "--levels with heights", expected="depths below these levels", cure="Heights need no levels"
            )
        soundings = soundings.above(Levels.read(options.levels))
    water = water_of(
        soundings,
        crs,
        settings,
        line=None if options.centre_line is None else read_line(options.centre_line, crs, notes),
        banks=options.banks,
        level_m=options.level,
        depths=soundings.depth and options.levels is None,
        coordinates=options.coordinates,
    )
    found = bed_of_table(soundings, crs, settings, water)
    relative = soundings.depth and options.level is None and options.levels is None
    found.write(
        options.out,
        {"heights": "above the water surface, metres" if relative else f"of {options.table.name}, metres"},
    )
    save(
        bed_picture(
            bed=options.out / "bed.tif",
            observations=found.bed.data,
            line=water.line if isinstance(water.line, FlowLine) else None,
            area=water.area,
            edge=water.edge,
            title=options.table.name,
            twin=False,
        ),
        options.out / "bed.png",
    )
    map_of_bed(options.out / "map.gpkg", found, soundings)
    bed, of = found.bed, found.validation
    print(f"{bed.facts['soundings']:,} soundings on {len(np.unique(soundings.line)):,} lines")
    print(f"  bed: {bed.facts['cells']:,} cells, median sigma {bed.facts['median sigma_m']:.3f} m")
    print(f"  {bed.model.reason}")
    print(
        f"  {of['lines']} left-out {of['left_out']}: rms {of['rmse_m']:.3f} m, bias {of['bias_m']:+.3f} m, "
        f"mean of squared error over variance {of['normalised_square']:.2f}, "
        f"{of['outside_95']:.1%} outside their 95 % interval"
    )
    print(f"  {soundings.crs.name}, cells of {settings.cell_m:g} m")
    for note in (*notes, *found.notes):
        print(f"note: {in_options(note, options.settings)}")
    course = ", centre_line.csv" if isinstance(water.line, FlowLine) else ""
    print(f"Wrote {options.out}/bed.tif, map.gpkg, bed.png, validation.json, methods.csv{course}")
    return 0


def _flow(options: argparse.Namespace) -> int:
    import numpy as np
    import pandas as pd

    from thalweg.bathymetry import read_line
    from thalweg.core import InputError
    from thalweg.core.values import check_degrees
    from thalweg.ingest import read_places

    line = read_line(options.centre_line)
    table, found = read_places(options.points, None, any_system=True)
    places = found.xy_m
    known = np.isfinite(places).all(axis=1)
    check_degrees(places[known], where=options.points, cure="Name the columns lat, lon")
    s, n, fold = np.full(len(places), np.nan), np.full(len(places), np.nan), np.ones(len(places), dtype=bool)
    s[known], n[known], fold[known] = line.to_flow(places[known])
    if fold.all():
        raise InputError(
            f"none of {len(table):,} places lies beside the centre line",
            expected="places along it",
            where=options.points,
            cure="Look whether both are in one coordinate system, and in metres",
        )
    columns = {c.name: table.text(k) for k, c in enumerate(table.columns)}
    pd.DataFrame(columns | {"s_m": s, "n_m": n, "fold": fold}).to_csv(
        options.out, index=False, float_format="%.6f"
    )
    print(f"{len(table):,} places, {int(fold.sum()):,} beyond the ends or where perpendiculars meet")
    if not known.all():
        print(f"note: {int((~known).sum()):,} rows without coordinates")
    print(f"Wrote {options.out}")
    return 0


def _plan(options: argparse.Namespace) -> int:

    import numpy as np

    from thalweg.bathymetry import BedModel, CovarianceModel, map_crs, plan_survey, read_bank_lines, read_line
    from thalweg.core import InputError, read_json

    crs = map_crs(options.crs)
    notes: list[str] = []
    line = None if options.centre_line is None else read_line(options.centre_line, crs, notes)
    nothing = (np.empty((0, 2)), np.empty(0))
    banks, _ = read_bank_lines(options.banks, crs, line, None, nothing, notes)
    if options.variogram is None:
        left, right = banks.half_widths_m(np.linspace(0, banks.line.length_m, 500))
        width = float(np.nanmedian(left + right))
        model = CovarianceModel(
            kind="matern32", sill_m2=options.relief**2, range_s_m=2 * width, range_n_m=width / 2
        )
        source = f"assumed: {options.relief:g} m, ranges {2 * width:.0f} m along and {width / 2:.0f} m across"
    else:
        try:
            model = BedModel.of_report(read_json(options.variogram)).covariance
        except (ValueError, KeyError, TypeError) as error:
            raise InputError(
                f"{error!r}",
                where=options.variogram,
                expected="variogram.json of `thalweg bed` or of a campaign",
            ) from error
        source = str(options.variogram)
    plan = plan_survey(
        banks,
        crs,
        model,
        pattern=options.pattern,
        sigma_m=options.sigma,
        leg_m=options.leg,
        margin_m=options.margin,
        sigma_sounding_m=options.sigma_sounding,
    )
    seconds = plan.length_m / options.speed
    facts = {
        "pattern": plan.pattern,
        "leg_m": plan.leg_m,
        "length_m": plan.length_m,
        "time_s": seconds,
        "waypoints": len(plan.waypoints_m),
        "wanted_sigma_m": options.sigma,
        "sigma_95_m": plan.sigma_95_m,
        "median_sigma_m": float(np.nanmedian(plan.sigma_m)),
        "covariance": source,
    }
    text = f"{plan.pattern}, legs of {plan.leg_m:.1f} m: {plan.length_m:,.0f} m, {seconds / 60:.0f} min"
    if options.power is not None:
        facts["energy_wh"] = options.power * seconds / 3600
        text += f", {facts['energy_wh']:.0f} Wh"
        if options.battery is not None:
            facts["batteries"] = facts["energy_wh"] / options.battery
            text += f" ({facts['batteries']:.1f} batteries)"
    plan.write(options.out, facts)
    print(text)
    print(
        f"  95 % of the bed known to {plan.sigma_95_m:.3f} m, half of it to {facts['median_sigma_m']:.3f} m"
    )
    print(f"  covariance {source}")
    for note in notes:
        print(f"note: {note}")
    if plan.sigma_95_m > options.sigma:
        print(f"note: {options.sigma:g} m was wanted; leave out --leg for legs that reach it")
    print(f"Wrote {options.out}/waypoints.gpx, waypoints.geojson, sigma.tif, plan.json")
    return 0
