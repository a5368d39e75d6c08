"""The commands ``thalweg compare-clouds`` and ``compare``: clouds and surface models, without a campaign."""

import argparse
from pathlib import Path

from thalweg.commands.options import CLOUDS, above_zero, count, direction, length, lengths, nodata, place
from thalweg.commands.parser import REQUIRED, Commands, Part, Repeated, say_notes
from thalweg.commands.remedies import OF_A_FILE, of_a_campaign


def add_deformation_commands(commands: Commands) -> None:
    """Add ``compare-clouds`` and ``compare``."""
    commands.add(
        "compare-clouds",
        "distances between two clouds along normals (M3C2) with limits and significance, or "
        "differences and volumes of two surface models",
        _compare,
        ("before", Path, "BEFORE", "first epoch: LAS, LAZ, PLY, E57, x y z text; GeoTIFF"),
        ("after", Path, "AFTER", "second epoch, in the same coordinate system"),
        ("-o --out", Path, "FILE", ".csv, .parquet, .laz; of two GeoTIFF .tif", REQUIRED),
        *(
            (
                f"--sigma-{name}",
                length,
                "M",
                f"standard deviation of the {which} cloud that neighbouring points share",
            )
            for name, which in (("a", "first"), ("b", "second"))
        ),
        (
            "--sigma-registration",
            length,
            "M",
            "standard deviation of the registration of the two clouds (default: %(default)s)",
            0.0,
        ),
        (
            "--core-every",
            count,
            "N",
            "every N-th point of BEFORE is a core point (default: as many as a cylinder holds); with c2c "
            "every N-th of AFTER is compared (default: all)",
        ),
        (
            "--scales",
            lengths("lengths in metres above zero"),
            "M,M,...",
            "radii for normals, of which the most planar is used (default: 1, 2, 4 cylinders, or 10, 20, 40 "
            "times the scatter of the points)",
        ),
        (
            "--cylinder",
            above_zero,
            "M",
            "radius of the cylinders (default: 3 times the spacing of the sparser cloud)",
        ),
        (
            "--reach",
            above_zero,
            "M",
            "half length of the cylinders along the normal (default: 30 times their radius)",
        ),
        ("--least-points", int, "N", "fewest points in a cylinder (default: %(default)s)", 5),
        (
            "--towards",
            direction,
            "E,N,U",
            "direction to which normals point, and in which a distance is positive (default: 0,0,1)",
            (0.0, 0.0, 1.0),
        ),
        (
            "--control",
            ("fdr", "none"),
            None,
            "5 %% are the false discovery rate (fdr), or the level of each test (default: %(default)s)",
            "fdr",
        ),
        (
            "--method",
            ("m3c2", "c2c"),
            None,
            "m3c2: along normals at core points of the first cloud, with limits; c2c: of each point of the "
            "second to the nearest one of the first, and to the plane of the nearest ones "
            "(default: %(default)s)",
            "m3c2",
        ),
        (
            "--correlation-m --correlation",
            length,
            "M",
            "length at which the correlation of shared errors is 1/e: sigmas of volumes of surface models, "
            "and of the mean distance of clouds (default: %(default)s)",
            0.0,
            {"dest": "correlation"},
        ),
        Part(
            "surface models (two GeoTIFF)",
            [
                (
                    "--nodata",
                    nodata,
                    "VALUE",
                    "value of missing heights, in addition to the declared one; none: there is no other",
                ),
                (
                    "--resample",
                    ("nearest", "bilinear"),
                    None,
                    "resample AFTER to the grid of BEFORE, if they differ",
                ),
                (
                    "--leave-out",
                    Repeated(str),
                    "FILE[?COLUMN=VALUE,...]",
                    "polygons (GeoPackage, Shapefile, GeoJSON, KML) to exclude, such as water; "
                    "may be repeated",
                ),
            ],
        ),
        settings={
            "deformation.scales_m": "--scales",
            "deformation.cylinder_radius_m": "--cylinder",
            "deformation.reach_m": "--reach",
            "deformation.least_in_cylinder": "--least-points",
            "deformation.towards": "--towards",
            "deformation.resample": "--resample",
            "deformation.control": "--control",
            "accuracy.area": "part of the cloud",
            "epochs.nodata": "--nodata",
            **OF_A_FILE,
        },
    )
    commands.add(
        "compare",
        "signed distances of a cloud from a reference mesh or cloud, with statistics",
        _compare_with_surface,
        ("cloud", Path, "CLOUD", CLOUDS),
        ("reference", Path, "REFERENCE", "mesh (PLY), or a cloud, which is meshed"),
        ("-o --out", Path, "FILE", ".csv, .parquet, .laz; .json and .html beside it", REQUIRED),
        (
            "--seen-from",
            place,
            "E,N,U",
            "point in front of the reference; distances towards it are positive (default: from above)",
        ),
        (
            "--max-distance",
            above_zero,
            "M",
            "largest distance that is compared (default: 100 times the usual side of the triangles, "
            "or a tenth of the extent of the reference)",
        ),
        (
            "--sigma-reference",
            length,
            "M",
            "standard deviation of the reference that its points share (default: 0)",
        ),
        ("--method", ("delaunay", "poisson"), None, "meshing method", "delaunay"),
        (
            "--cell",
            above_zero,
            "M",
            "cell to which a reference cloud is thinned (default: by their spacing and scatter)",
        ),
        (
            "--longest-edge",
            above_zero,
            "M",
            "triangles with longer edges become holes (default: 5 times their usual longest edge)",
        ),
        (
            "--clearance",
            length,
            "M",
            "reference points farther in front of the ground are plants (default: all points are ground)",
        ),
        ("--registration", bool, None, "also fit the cloud to the reference by a rigid motion"),
        settings={
            "reference.cell_m": "--cell",
            "reference.longest_edge_m": "--longest-edge",
            "reference.clearance_m": "--clearance",
            "reference.method": "--method",
            "reference.sigma_m": "--sigma-reference",
            "accuracy.max_distance_m": "--max-distance",
            "accuracy.registration": "--registration",
            "accuracy.area": "part of the reference",
            **of_a_campaign(["reference.isolated_radius_m", "reference.poisson_depth"]),
            **OF_A_FILE,
        },
    )


def _compare(options: argparse.Namespace) -> int:
    from thalweg.core import InputError

    rasters = [path.suffix.lower() in {".tif", ".tiff"} for path in (options.before, options.after)]
    if any(rasters) and not all(rasters):
        raise InputError(
            f"{options.before.name} and {options.after.name}",
            expected="two clouds or two surface models (.tif)",
        )
    if options.method == "c2c":
        if all(rasters):
            raise InputError("--method c2c of two surface models", expected="two clouds")
        return _compare_nearest(options)
    return _compare_surfaces(options) if all(rasters) else _compare_clouds(options)


def _compare_nearest(options: argparse.Namespace) -> int:
    from thalweg.core import ConfigError
    from thalweg.deformation import CLOUD_TO_CLOUD
    from thalweg.deformation.foreign import compare_nearest, write_changes

    if options.sigma_a is not None or options.sigma_b is not None:
        raise ConfigError(
            "--sigma-a or --sigma-b with --method c2c",
            expected="no sigmas: distances to nearest points have none",
            cure="Use --method m3c2 for limits and significance",
        )
    table, frame, notes = compare_nearest(
        options.before, options.after, every=options.core_every or 1, towards=options.towards
    )
    write_changes(options.out, table, frame, CLOUD_TO_CLOUD)
    nearest, plane = table["distance_m"], table["plane_distance_m"]
    print(f"{len(table):,} points of the second cloud")
    print(
        f"  to the nearest point: mean {nearest.mean():.4g} m, median {nearest.median():.4g} m, "
        f"largest {nearest.max():.4g} m"
    )
    print(f"  to the plane of the nearest: mean {plane.mean():+.4g} m, median {plane.median():+.4g} m")
    say_notes(options, notes)
    print(f"Wrote {options.out}")
    return 0


def _compare_surfaces(options: argparse.Namespace) -> int:
    import numpy as np

    from thalweg.core import read_dsm
    from thalweg.core.values import read_vectors
    from thalweg.deformation.foreign import HeightErrors, difference_of_surfaces, write_difference

    before, after = (read_dsm(path, nodata=options.nodata) for path in (options.before, options.after))
    stated = (
        HeightErrors.of_bands(surface, options.correlation or None)
        if sigma is None
        else HeightErrors(sigma, options.correlation)
        for surface, sigma in ((before, options.sigma_a), (after, options.sigma_b))
    )
    found = difference_of_surfaces(
        before,
        after,
        (next(stated), next(stated)),
        sigma_registration_m=options.sigma_registration,
        resample=options.resample,
        leave_out=[read_vectors(each) for each in options.leave_out],
    )
    if (options.sigma_a or options.sigma_b) and not options.correlation:
        found.notes.append(
            "No --correlation-m is stated: errors of cells count as independent, so that sigmas of volumes "
            "are the least that there can be."
        )
    write_difference(options.out, found)
    height = found.raster.height_m[np.isfinite(found.raster.height_m)]
    print(f"{found.raster.height_m.size:,} cells, {len(height):,} with a difference")
    print(f"  mean {height.mean():+.4f} m, median {np.median(height):+.4f} m, std {height.std(ddof=1):.4f} m")
    for row in found.volumes.to_dict("records"):
        text = f"  {row['part']}: {row['area_m2']:,.1f} m2"
        if row["volume_m3"] == row["volume_m3"]:
            text += f", {row['volume_m3']:+,.1f} m3"
        if row["sigma_m3"] == row["sigma_m3"]:
            text += f" (sigma {row['sigma_m3']:,.1f}; 95 % {row['low_m3']:+,.1f} to {row['high_m3']:+,.1f})"
        print(text)
    say_notes(options, found.notes)
    print(f"Wrote {options.out}")
    return 0


def _compare_clouds(options: argparse.Namespace) -> int:
    import numpy as np

    from thalweg.deformation.foreign import compare_clouds, write_changes

    table, frame, notes = compare_clouds(
        options.before,
        options.after,
        {
            "scales_m": options.scales,
            "radius_m": options.cylinder,
            "half_length_m": options.reach,
            "least_points": options.least_points,
            "control": options.control,
        },
        core_every=options.core_every,
        towards=options.towards,
        sigma_m=(options.sigma_a, options.sigma_b),
        sigma_registration_m=options.sigma_registration,
        correlation_m=options.correlation,
    )
    write_changes(options.out, table, frame)
    distance = table["distance_m"].dropna()
    print(f"{len(table):,} core points, {len(distance):,} with a distance")
    print(f"  mean {distance.mean():+.4g} m, median {distance.median():+.4g} m, std {distance.std():.4g} m")
    print(f"  level of detection (95 %), median: {np.nanmedian(table['lod95_m']):.4g} m")
    for state, n in table["state"].value_counts().items():
        print(f"  {state}: {n:,}")
    say_notes(options, notes)
    print(f"Wrote {options.out}")
    return 0


def _compare_with_surface(options: argparse.Namespace) -> int:
    import json

    from thalweg.core import in_options
    from thalweg.deformation.foreign import DISTANCES, compare_with_surface, write_changes
    from thalweg.figures.accuracy import CAPTIONS, cloud_page, distance_histogram, distances_in_plan

    table, frame, facts, notes = compare_with_surface(
        options.cloud,
        options.reference,
        {
            "sigma_m": options.sigma_reference,
            "method": options.method,
            "cell_m": options.cell,
            "longest_edge_m": options.longest_edge,
            "clearance_m": options.clearance or None,
        },
        seen_from_m=options.seen_from,
        max_distance_m=options.max_distance,
        registration=options.registration,
    )
    write_changes(options.out, table, frame, DISTANCES)
    facts |= {
        "cloud": str(options.cloud),
        "reference": str(options.reference),
        "notes": [in_options(note, options.settings) for note in notes],
    }
    beside = options.out.with_suffix(".json")
    beside.write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")
    for words, n in facts["counts"].items():
        print(f"{n:>12,} {words.replace('_', ' ')}")
    lengths = (
        f"{words.removesuffix('_m').replace('_', ' ')} {m:.3g} m" for words, m in facts["lengths"].items()
    )
    print(f"lengths: {', '.join(lengths)}")
    shown = {name: facts[name] for name in ("all", "without_outliers")}
    moved = facts.get("registration", {})
    if moved.get("done"):
        shown["after registration, without outliers"] = moved["without_outliers"]
    for name, one in shown.items():
        print(
            f"{name.replace('_', ' ')}: mean {one['bias_m']:+.4g} m, std {one['std_m']:.4g} m, RMSE "
            f"{one['rmse_m']:.4g} m, median {one['median_m']:+.4g} m, NMAD {one['nmad_m']:.4g} m, "
            f"95 % within {one['p95_m']:.4g} m"
        )
    page, title = options.out.with_suffix(".html"), f"{options.cloud.name} and {options.reference.name}"
    pictures = {"distances_in_plan": distances_in_plan(table, title=title)}
    pictures["distance_histogram"] = distance_histogram(table, title=title)
    cloud_page(facts, pictures, captions=CAPTIONS, title=f"Accuracy: {title}").write(page)
    say_notes(options, notes)
    print(f"Wrote {options.out}, {beside}, {page}")
    return 0
