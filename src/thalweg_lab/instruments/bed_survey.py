"""A survey of the bed on foot: points by an RTK pole in strips across the shallow water about the track."""

from pathlib import Path
from typing import Any, Final

import numpy as np
from pyproj import CRS
from scipy.spatial import cKDTree

from thalweg.core.errors import CoverageError
from thalweg.core.frames import LocalFrame
from thalweg.core.types import ArrayF
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import generator
from thalweg_lab.base.river import River
from thalweg_lab.river.materials import Material
from thalweg_lab.river.scene import Scene
from thalweg_lab.voyage.motion import epochs
from thalweg_lab.voyage.motions import motion_of
from thalweg_lab.voyage.truth import write_effects

STRIP_M: Final = 0.8
"""From strip to strip along the river."""
STEP_M: Final = 0.5
"""From point to point across it."""
DEPTHS_M: Final = (0.1, 1.5)
"""Water in which a surveyor wades and a boat floats nearby."""
REACH_M: Final = 2.0
"""How far from the boat's track points are of use."""

_TRACK_HZ: Final = 5.0
_CARELESS_M: Final = 0.05
"""How far from its place in the strip a pole is put down."""


def bed_points(config: TwinConfig, seed: int, scene: Scene) -> ArrayF:
    """True places (n, 3) in wcs of the pole's tip on the bed.

    Raises
    ------
    CoverageError : the boat crossed no water that is shallow enough.
    """
    track = motion_of(config, seed).position_wcs_m(epochs(config, _TRACK_HZ))[:, :2]
    river = River(config.scene, seed)
    along, across = river.to_flow(track[:, 0], track[:, 1])
    s = np.arange(along.min() - REACH_M, along.max() + REACH_M, STRIP_M)
    n = np.arange(across.min() - REACH_M, across.max() + REACH_M, STEP_M)
    grid = np.stack(np.meshgrid(s, n, indexing="ij"), axis=-1).reshape(-1, 2)
    places = river.to_wcs(grid[:, 0], grid[:, 1])
    places = places + _CARELESS_M * generator(seed, "bed survey places").standard_normal(places.shape)
    places = places[cKDTree(track).query(places, distance_upper_bound=REACH_M)[0] <= REACH_M]
    level = scene.water_level_m
    above = np.column_stack([places, np.full(len(places), level)])
    depth = scene.only(Material.BED).caster().cast(above, np.tile([0.0, 0.0, -1.0], (len(above), 1))).t_hit_m
    low, high = DEPTHS_M
    wet = (depth >= low) & (depth <= high)
    if wet.sum() < 3:
        raise CoverageError(
            f"{int(wet.sum())} places in water of {low:g} to {high:g} m near the boat's track",
            expected="a bed that can be surveyed on foot",
            cure="Switch twin.echo.bed_survey off, or let the boat go nearer to the banks "
            "(twin.boat.bank_distance_m)",
        )
    return np.column_stack([places[wet], level - depth[wet]])


def simulate_bed_survey(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    scene: Path,
    out_bed: Path,
    *,
    crs: str,
    out_effects: Path | None = None,
) -> dict[str, Any]:
    """Survey the bed and write its points as CSV: east_m, north_m, h_ell_m, sigma_m.

    Parameters
    ----------
    config, seed, frame, scene : as in `thalweg_lab.instruments.echo.simulate_echo`.
    out_bed : target.
    crs : projected CRS of the campaign; heights are ellipsoidal.
    out_effects : where to write what was done to the points (JSON), beside the truth.

    Returns
    -------
    facts : number of points, and the common error of their heights.

    Raises
    ------
    CoverageError : see `bed_points`.
    """
    echo = config.echo
    points = bed_points(config, seed, Scene.read(scene))
    datum_m = echo.sigma_bed_datum_m * float(generator(seed, "bed survey datum").standard_normal())
    points = points + echo.sigma_bed_m * generator(seed, "bed survey").standard_normal(points.shape)
    points[:, 2] += datum_m
    rows = frame.to_map(points, CRS.from_user_input(crs)).tolist()
    lines = ["east_m,north_m,h_ell_m,sigma_m"]
    lines += [f"{east:.3f},{north:.3f},{height:.3f},{echo.sigma_bed_m:.3f}" for east, north, height in rows]
    out_bed.parent.mkdir(parents=True, exist_ok=True)
    out_bed.write_text("\n".join(lines) + "\n", encoding="ascii")
    facts = {"points": len(points), "datum_m": datum_m}
    write_effects(out_effects, "bed_survey", facts)
    return facts
