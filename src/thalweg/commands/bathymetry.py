"""The commands ``thalweg bed``, ``flow``, ``plan-survey`` and ``refract``: riverbeds without a campaign."""

import argparse
from pathlib import Path

from thalweg.commands.options import CENTRE_LINE, LINE, folder, positive
from thalweg.commands.parser import REQUIRED, Commands, OneOf, Repeated, say_notes
from thalweg.commands.remedies import OF_A_FILE, OF_A_RECORDING, OF_POINTS, of_a_campaign


def add_bathymetry_commands(commands: Commands) -> None:
    """Add ``bed``, ``flow``, ``plan-survey`` and ``refract``."""
    commands.add(
        "bed",
        "bed of a river or a lake with standard deviations from a table of soundings, kriged in flow or "
        "map coordinates",
        _bed,
        ("table", Path, "TABLE", "soundings: any text table in degrees or metres, or points of a GIS"),
        (
            "--crs",
            str,
            "EPSG:...",
            "coordinate system of the map, projected; a table in degrees needs none (its zone of UTM)",
        ),
        OneOf(
            [
                ("--height", str, "COLUMN", "column with heights of the bed (default: by name)"),
                ("--depth", str, "COLUMN", "column with depths below the water, likewise"),
            ]
        ),
        (
            "--columns",
            lambda text: text.split(","),
            "NAMES",
            "names of the columns in their order, where the table has none: lat,lon,depth_ft,-,time",
        ),
        (
            "--missing",
            Repeated(float),
            "VALUE",
            "no-data value, beside the usual ones: -9999 and the like and, for a depth, 0",
        ),
        ("--valid", Repeated(float), "VALUE", "usual no-data value that is valid here, such as 0"),
        ("--level", float, "M", "height of the water level; 0 with --depth"),
        (
            "--levels",
            Path,
            "CSV",
            "with --depth: levels of the water by day or time, columns date (UTC) and level",
        ),
        (
            "--coordinates",
            ("auto", "flow", "map"),
            None,
            "along and across the flow, or east and north; auto: east and north where nothing shows a river",
            "auto",
        ),
        ("--line", str, "COLUMN", "column with the name of the survey line (default: detected)"),
        (
            "--banks",
            Path,
            "FILE",
            "both bank lines, or the water surface as a polygon (GeoJSON, Shapefile, GeoPackage, KML, GML, "
            "DXF; FILE?layer=NAME of several); with heights or --level also data",
        ),
        CENTRE_LINE,
        ("--islands", Path, "FILE", "polygons of islands, excluded from the bed"),
        ("--cell", positive, "M", "cell size of the grid (default: by the soundings)"),
        folder("bed"),
        (
            "--sigma",
            positive,
            "M",
            "standard deviation of a sounding, if the table has no column sigma (default: %(default)s)",
            0.02,
        ),
        (
            "--model",
            ("auto", "exponential", "matern32", "spherical"),
            None,
            "covariance function; auto: best in cross-validation of lines",
            "auto",
        ),
        (
            "--drift",
            ("auto", "none", "section", "section_width", "fall"),
            None,
            "trend that is removed before kriging: none, mean cross-section, that and a depth that grows "
            "where the river is narrower, slope along the river",
            "auto",
        ),
        ("--neighbours", int, "N", "data used for a cell (default: %(default)s)", 48),
        (
            "--reach",
            positive,
            "RANGES",
            "leave cells empty beyond this multiple of the range from data (default: %(default)s)",
            2.0,
        ),
        writes="bed.tif",
        settings={
            **OF_POINTS,
            "bathymetry.reach": "--reach",
            "bathymetry.cell_m": "--cell",
            "bathymetry.line_turn_deg": "--line",
            "accuracy.area.polygon": "--islands",
            "accuracy.area": "--islands",
            **OF_A_RECORDING,
            **of_a_campaign(["bathymetry.engine"]),
        },
    )
    commands.add(
        "flow",
        "flow coordinates of points: along and across a centre line",
        _flow,
        ("points", Path, "POINTS", "CSV with east, north (or x, y)"),
        ("--centre-line", Path, "FILE", LINE, REQUIRED),
        ("--out", Path, "CSV", "table to write, with s_m, n_m, fold", REQUIRED),
        settings=OF_A_FILE | {"campaign.origin": "the origin"},
    )
    commands.add(
        "plan-survey",
        "survey lines between two banks, and the accuracy of the bed to expect",
        _plan,
        (
            "banks",
            Path,
            "BANKS",
            "bank lines, or the water surface as a polygon: GeoJSON, Shapefile, GeoPackage, KML, GML, DXF",
        ),
        ("--crs", str, "EPSG:...", "coordinate system of the banks, projected, metres", REQUIRED),
        ("--pattern", ("zigzag", "sections", "along"), None, "pattern of the lines", REQUIRED),
        ("--speed", positive, "M/S", "speed of the boat", REQUIRED),
        ("--sigma", positive, "M", "standard deviation wanted for 95 %% of the bed", REQUIRED),
        folder("plan"),
        (
            "--leg",
            positive,
            "M",
            "distance of neighbouring lines (default: the largest that reaches --sigma)",
        ),
        ("--margin", positive, "M", "distance from the banks (default: %(default)s)", 2.0),
        CENTRE_LINE,
        (
            "--variogram",
            Path,
            "JSON",
            "covariance function of the bed: variogram.json of `thalweg bed` or of a campaign",
        ),
        (
            "--relief",
            positive,
            "M",
            "without --variogram: standard deviation of the bed about its mean, with ranges of half the "
            "width across the river and twice the width along it (default: %(default)s)",
            0.3,
        ),
        ("--sigma-sounding", positive, "M", "standard deviation of a sounding (default: %(default)s)", 0.05),
        ("--power", positive, "W", "power of the boat at this speed"),
        ("--battery", positive, "WH", "energy of one battery"),
        writes="plan.json",
        settings=OF_A_FILE
        | {**OF_POINTS, "accuracy.area.polygon": "the outline", "accuracy.area": "the outline"},
    )
    commands.add(
        "refract",
        "photogrammetric points of a bed seen through water -> heights corrected for refraction",
        _refract,
        ("points", Path, "CSV", "columns x, y, z, or east, north, height"),
        ("--cameras", Path, "CSV", "projection centres: columns x, y, z, in the same frame", REQUIRED),
        OneOf(
            [
                ("--level", float, "M", "height of the water surface"),
                ("--water", str, "COLUMN", "column with the height of the water surface above each point"),
            ],
            required=True,
        ),
        ("--height", str, "COLUMN", "column with heights, if it is not z or height"),
        ("--index", float, None, "refractive index (default: %(default)s)", 1.333),
        ("--sigma-point", float, "M", "standard deviation of an apparent height", 0.0),
        ("--sigma-water", float, "M", "standard deviation of the water level", 0.0),
        (
            "--max-off-nadir",
            float,
            "DEG",
            "largest angle of a ray off the vertical (default: %(default)s)",
            35.0,
        ),
        ("-o --out", Path, "CSV", "table to write", REQUIRED),
        settings=OF_A_FILE,
    )


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
    say_notes(options, notes)
    if plan.sigma_95_m > options.sigma:
        print(f"note: {options.sigma:g} m was wanted; leave out --leg for legs that reach it")
    print(f"Wrote {options.out}/waypoints.gpx, waypoints.geojson, sigma.tif, plan.json")
    return 0
