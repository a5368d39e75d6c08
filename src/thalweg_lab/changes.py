"""Where and how the epochs of a river differ: functions of the settings alone.

Each change has a place of its own along the flow and acts inside it only. Vegetation that has grown is the
exception: bushes, grass and reeds are larger everywhere. Distances ``right_m`` count from the right shore of
the first epoch, behind it positive, and heights from the water level of the settings.

What is gone in the second epoch, such as a fallen tree that was cleared away, is a change that the first
epoch alone has. ``niche`` belongs to the first epoch, ``collapsed_niche`` to the second one, at the same
place. The patches share the bank with boulders that were moved; stones and plants on them move with them.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayF
from thalweg_lab.settings import Change, TwinScene

_PLACES: Final[dict[Change, tuple[float, float, float]]] = {
    # Share of the length, greatest half length in metres, and the same as a share of the length.
    "undercut_bank": (0.15, 45.0, 0.11),
    "moved_boulders": (0.02, 20.0, 0.11),
    "scour": (-0.10, 12.0, 0.11),
    "fallen_tree": (-0.22, 9.0, 0.11),
    "gravel_bar": (-0.34, 22.0, 0.11),
    "bank_retreat": (-0.20, 45.0, 0.075),
    "niche": (-0.095, 3.0, 0.024),
    "collapsed_niche": (-0.095, 3.0, 0.024),
    "change_patches": (0.08, 75.0, 0.145),
    "new_boulders": (0.245, 2.5, 0.02),
}

PATCH_M: Final = (6.0, 4.0)
"""Size of a displaced patch along the flow and up the slope; there half of the displacement is left."""
EDGE_M: Final = 0.5
"""Width of the soft edge of a patch, half of it on either side of its border."""
DISPLACEMENTS_M: Final = (0.10, -0.10, 0.20, -0.20, 0.06, -0.06, 0.03, -0.03, 0.50, -0.50)
"""Displacements of the patches along the normal of the slope, from upstream on; positive: deposition."""
_PITCH_M: Final = 7.5
"""From the middle of a patch to that of the next."""
_BY_BRIDGE_M: Final = 10.0
"""No patch lies nearer to the middle of the bridge."""

_CUT: Final = float(np.tan(np.deg2rad(65.0)))
"""Slope of the face that a retreat of the right bank leaves."""
NICHE_FLOOR_M: Final = 0.2
"""Height of the niche's floor above the water."""
NICHE_BACK_M: Final = 2.3
"""Distance behind the shore at which its back wall rises."""
NICHE_REACH_M: Final = 3.4
"""Behind the shore the niche, its back wall and its roof end within this distance."""
_BACK_WALL: Final = float(np.tan(np.deg2rad(75.0)))
_TALUS_M: Final = 0.45
"""Height of the heap of soil before the back wall after the collapse."""


def smoothstep(x: ArrayF) -> ArrayF:
    """0 below 0, 1 above 1, smooth to the first derivative between."""
    u = np.clip(x, 0.0, 1.0)
    return np.asarray(u * u * (3.0 - 2.0 * u))


def slope_width(config: TwinScene) -> float:
    """Horizontal width of the embankment's slope, metres."""
    return float(config.embankment_height_m / np.tan(np.deg2rad(config.embankment_slope_deg)))


@dataclass(frozen=True, slots=True)
class Stretch:
    """A part of the reach along the flow: its middle and half length, metres."""

    middle_m: float
    half_m: float

    def bump(self, s_m: AnyArray) -> ArrayF:
        """One in the middle, exactly zero outside, smooth to the first derivative."""
        x = (np.asarray(s_m, dtype=np.float64) - self.middle_m) / self.half_m
        return np.asarray(np.where(np.abs(x) < 1.0, (1.0 - np.minimum(x * x, 1.0)) ** 2, 0.0))

    def plateau(self, s_m: AnyArray, edge_m: float) -> ArrayF:
        """One inside, exactly zero outside, smooth within ``edge_m`` of both ends."""
        away = np.abs(np.asarray(s_m, dtype=np.float64) - self.middle_m)
        return smoothstep((self.half_m - away) / edge_m)

    def holds(self, s_m: AnyArray) -> ArrayB:
        """Whether places lie inside."""
        return np.asarray(np.abs(np.asarray(s_m) - self.middle_m) < self.half_m)


def stretch(scene: TwinScene, change: Change) -> Stretch:
    """Where along the reach a change acts; the whole reach for ``grown_vegetation``."""
    if change == "grown_vegetation":
        return Stretch(0.0, scene.length_m)
    place, half, share = _PLACES[change]
    return Stretch(place * scene.length_m, min(half, share * scene.length_m))


# ---------------------------------------------------------------- patches displaced along the normal


@dataclass(frozen=True, slots=True)
class Patch:
    """A part of the embankment's slope that is displaced along the normal of the slope.

    Parameters
    ----------
    middle_s_m, right_m : its middle: along the flow, and behind the right shore.
    displacement_m : along the outward normal.
    slope_rad : of the embankment.
    """

    middle_s_m: float
    right_m: float
    displacement_m: float
    slope_rad: float

    @property
    def name(self) -> str:
        """As ``patch_+0.10``."""
        return f"patch_{self.displacement_m:+.2f}"

    def rise(self, along_m: ArrayF, right_m: ArrayF) -> ArrayF:
        """What the patch adds to the height, metres.

        The displacement falls from one to zero within `EDGE_M` about the border, to one half on it, so that
        displacement times area of the patch is the volume, whatever the width of the edge. A plane that is
        displaced by d along its normal rises by ``d / cos(slope)``.

        Parameters
        ----------
        along_m : way from the patch's middle along the bank.
        right_m : distance behind the shore.
        """
        up_slope = (right_m - self.right_m) / np.cos(self.slope_rad)
        weight = _soft(along_m, PATCH_M[0]) * _soft(up_slope, PATCH_M[1])
        return np.asarray(self.displacement_m / np.cos(self.slope_rad) * weight)


def _soft(x: ArrayF, length_m: float) -> ArrayF:
    return smoothstep(((length_m + EDGE_M) / 2 - np.abs(x)) / EDGE_M)


def patches(scene: TwinScene) -> tuple[Patch, ...]:
    """As many patches as the middle of the embankment's slope has room for, at most `DISPLACEMENTS_M`."""
    where = stretch(scene, "change_patches")
    room = np.arange(where.middle_m - where.half_m + _PITCH_M / 2, where.middle_m + where.half_m, _PITCH_M)
    room = room[room + (PATCH_M[0] + EDGE_M) / 2 <= where.middle_m + where.half_m]
    if scene.bridge:
        room = room[np.abs(room - scene.bridge_place * scene.length_m / 2) > _BY_BRIDGE_M]
    slope, middle = np.deg2rad(scene.embankment_slope_deg), slope_width(scene) / 2
    return tuple(
        Patch(float(s), middle, d, float(slope)) for s, d in zip(room, DISPLACEMENTS_M, strict=False)
    )


# ---------------------------------------------------------------- cuts into the right bank


def cut_of_retreat(right_m: ArrayF) -> ArrayF:
    """Height of the fresh face above the water at distances behind the shore of the second epoch."""
    return np.asarray(_CUT * np.maximum(right_m, 0.0))


def retreat_reach_m(scene: TwinScene) -> float:
    """How far behind the first shore the greatest retreat of the right bank reaches, metres."""
    rise = np.tan(np.deg2rad(scene.embankment_slope_deg))
    return float(scene.retreat_m * _CUT / (_CUT - rise))


def cut_of_niche(scene: TwinScene, s: ArrayF, right_m: ArrayF, z: ArrayF, *, talus: bool) -> ArrayF:
    """Height of the floor and the back wall of a niche, where they are below ``z``.

    Parameters
    ----------
    scene : settings.
    s, right_m : places along the flow and behind the first shore.
    z : height of the bank without the niche.
    talus : whether the soil of the collapsed roof lies in a heap before the back wall.
    """
    floor = np.full_like(z, NICHE_FLOOR_M)
    if talus:
        x = np.clip((right_m - 0.3) / (NICHE_BACK_M + 0.2 - 0.3), 0.0, 1.0)
        # Steepest before the wall, flat at the water.
        floor = floor + _TALUS_M * x * x * (3.0 - 2.0 * x)
    hollow = np.minimum(z, np.maximum(floor, _BACK_WALL * (right_m - NICHE_BACK_M)))
    inside = stretch(scene, "niche").plateau(s, 0.6) * (right_m > 0)
    return np.asarray(z - inside * (z - hollow))
