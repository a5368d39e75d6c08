"""A scan of an object with what comes with it: images, panel, standing camera, reference, picked pairs."""

from pathlib import Path
from typing import Final

from thalweg.core.frames import LocalFrame
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.tank.plan import scan_plan
from thalweg_lab.tank.reference_mesh import picked_pairs, reference_mesh, write_reference
from thalweg_lab.tank.series import Basin, record_series, scanned_object
from thalweg_lab.tank.six_dof import build_panel, set_up

GROUND: Final = {"stepped": 1, "wreck": 0}
"""Material of the ground, which was not there when the object was scanned for its reference."""


def record_scan(twin: TwinConfig, seed: int, name: str, frame: LocalFrame, folder: Path, truth: Path) -> None:
    """Render and write a scan, see `thalweg_lab.tank.record`, and beside it ::

        <folder>/reference.ply   mesh of the object as a structured-light scanner gives it
        <folder>/pairs.csv       places that an operator picked in scan and mesh

    Parameters
    ----------
    twin, seed, frame : of the campaign.
    name : one of `thalweg_lab.tank.series.OBJECTS`.
    folder, truth : of logs and truth.

    Raises
    ------
    ConfigError : another name.
    """
    record_series(twin, seed, name, frame, folder, truth)
    basin = Basin.of(twin, seed)
    surface = scanned_object(name, seed)
    settings = basin.settings
    mesh = reference_mesh(surface, seed, resolution_mm=settings.reference_mm, without=(GROUND[name],))
    write_reference(folder / "reference.ply", mesh, surface, frame)
    plan = scan_plan(basin.true, seed, surface, lines=settings.scan_lines, step_mm=settings.scan_step_mm)
    tripod = set_up(plan.path, build_panel(seed))
    pairs = picked_pairs(mesh, tripod, seed, plan.name, n=4)
    pairs.to_csv(folder / "pairs.csv", index=False, float_format="%.5f")
