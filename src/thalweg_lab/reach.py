"""Shape of the river reach: a sine-generated centre line, shores, bed with a thalweg, banks.

Flow coordinates: ``s`` along the centre line, 0 in the middle of the reach, ``n`` across it, positive to the
left of the flow. The angle of the centre line is ``theta(s) = theta_0 sin(2 pi s / lambda)`` (Langbein and
Leopold 1966) about the configured mean direction.

The water level is the same everywhere, unless a fall tilts water and ground together. With a weir the reach
is what it impounds: the bed falls towards the weir, and what lies behind is a backdrop at the same level.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from thalweg.core import AnyArray, ArrayB, ArrayF, ConfigError, njit, prange
from thalweg_lab.changes import (
    Stretch,
    cut_of_niche,
    cut_of_retreat,
    patches,
    retreat_reach_m,
    slope_width,
    smoothstep,
    stretch,
)
from thalweg_lab.random_numbers import generator
from thalweg_lab.settings import Change, TwinScene

_LINE_STEP_M: Final = 0.5
_BAR_TOP_M: Final = 0.25
"""Height of the gravel bar of a second epoch above the water."""
BAR_PLACE: Final = 0.06
"""Distance of its middle from the left shore as a share of the river's width."""
_WEIR_POOL_M: Final = 1.8
"""How much deeper the bed is before the weir."""
_SCOUR_M: Final = 0.7
"""Depth of the scour hole of a second epoch."""

_BEHIND_CREST_M: Final = 1.0
"""A retreat of the right bank may reach so far behind its crest: the track stays."""

REACH_M: Final = 70.0
"""How far the land goes on behind the shores."""
LAND_M: Final = np.array([0.0, 1.1, 3.6, 11.0, 19.0, 34.0, REACH_M])
"""Distances behind the shore at which the cells of the terrain double, from the second one on."""
WATER_M: Final = np.array([0.0, 0.9, 2.1, 4.0, 8.0])
"""The same before the shore, in the water."""
RELIEF_CELLS: Final = np.array([1.0, 1.5, 3.0, 6.0, 12.0, 24.0, 40.0])
"""Smallest detail of the relief at these distances, in grid steps: as much as the cells carry."""
BALLAST_M: Final = 0.5
"""Height of the ballast under the track."""
TRACK_BEHIND_CREST_M: Final = 3.2
"""Distance of the track's middle from the crest."""
BRIDGE_CLEARANCE_M: Final = 4.2
"""Least height of the bridge above the water."""
GULLY_M: Final = 0.45
"""Depth of the deepest gullies."""

_ACROSS: Final = 401
"""Places across a given section at which its curve is computed."""

_WEEDS_BELOW_M: Final = 0.15
"""Weeds end so far below the surface."""

_MANY: Final = 100_000


# ---------------------------------------------------------------- reach


@dataclass(slots=True)
class River:
    """Geometry of a reach; a pure function of the settings and the seed.

    Parameters
    ----------
    config : section ``twin.scene``.
    seed : seed of the campaign; the settings may name another one for the river.

    Raises
    ------
    ConfigError : the retreat of the right bank would reach the track behind its crest.
    """

    config: TwinScene
    seed: int
    noise_seed: int = field(init=False)
    _line: CubicHermiteSpline = field(init=False)

    def __post_init__(self) -> None:
        if self.config.seed is not None:
            self.seed = self.config.seed
        self._check_retreat()
        self.noise_seed = int(generator(self.seed, "river").integers(2**31))
        # The boat may leave the modelled reach for an instant while it turns: the line goes on.
        half = self.config.length_m / 2 + 50.0
        s = np.linspace(-half, half, 2 * int(half / _LINE_STEP_M) + 1)
        step = s[1] - s[0]
        nodes, weights = np.polynomial.legendre.leggauss(4)
        theta = self.angle(s[:-1, None] + step / 2 * (1 + nodes[None, :]))
        piece = np.stack([np.cos(theta) @ weights, np.sin(theta) @ weights], axis=1) * step / 2
        line = np.concatenate([np.zeros((1, 2)), np.cumsum(piece, axis=0)])
        line -= line[len(s) // 2]
        tangent = np.stack([np.cos(self.angle(s)), np.sin(self.angle(s))], axis=1)
        self._line = CubicHermiteSpline(s, line, tangent)

    def _check_retreat(self) -> None:
        c = self.config
        most = slope_width(c) + _BEHIND_CREST_M
        if "bank_retreat" in c.changes and retreat_reach_m(c) > most:
            raise ConfigError(
                f"twin.scene.retreat_m {c.retreat_m} cuts {retreat_reach_m(c):.1f} m into the right bank",
                expected=f"at most {most:.1f} m, its slope and a metre of its crest",
                cure="Lower twin.scene.retreat_m, or raise twin.scene.embankment_height_m",
            )

    def angle(self, s_m: AnyArray) -> ArrayF:
        """Direction of the flow, radians from east, counter-clockwise."""
        phase = 2 * np.pi * np.asarray(s_m) / self.config.meander_length_m
        swing = np.deg2rad(self.config.meander_deg) * np.sin(phase)
        return np.asarray(np.deg2rad(self.config.flow_deg) + swing)

    def curvature(self, s_m: AnyArray) -> ArrayF:
        """Curvature of the centre line, 1/m, positive to the left."""
        k = 2 * np.pi / self.config.meander_length_m
        return np.asarray(self.greatest_curvature * np.cos(k * np.asarray(s_m)))

    @property
    def greatest_curvature(self) -> float:
        """Greatest curvature of the centre line, 1/m."""
        return float(np.deg2rad(self.config.meander_deg) * 2 * np.pi / self.config.meander_length_m)

    def bend(self, s_m: AnyArray) -> ArrayF:
        """Curvature over the greatest one: 1 where the river turns left most, -1 where it turns right."""
        greatest = self.greatest_curvature
        return self.curvature(s_m) / greatest if greatest > 0 else np.zeros(np.shape(s_m))

    def to_wcs(self, s_m: AnyArray, n_m: AnyArray) -> ArrayF:
        """East and north, shape (..., 2), of flow coordinates."""
        s, n = np.broadcast_arrays(np.asarray(s_m, dtype=np.float64), np.asarray(n_m, dtype=np.float64))
        theta = self.angle(s)
        normal = np.stack([-np.sin(theta), np.cos(theta)], axis=-1)
        return np.asarray(self._line(s) + n[..., None] * normal)

    def to_flow(self, east_m: AnyArray, north_m: AnyArray) -> tuple[ArrayF, ArrayF]:
        """Flow coordinates of places near the river: the inverse of `to_wcs`, by Newton steps."""
        p = np.stack(np.broadcast_arrays(east_m, north_m), axis=-1).astype(np.float64)
        low, high = self._line.x[0], self._line.x[-1]
        flow = np.deg2rad(self.config.flow_deg)
        s = np.clip(p[..., 0] * np.cos(flow) + p[..., 1] * np.sin(flow), low, high)
        n = np.zeros_like(s)
        for _ in range(12):
            theta = self.angle(s)
            d = p - self._line(s)
            along = d[..., 0] * np.cos(theta) + d[..., 1] * np.sin(theta)
            n = -d[..., 0] * np.sin(theta) + d[..., 1] * np.cos(theta)
            s = np.clip(s + along / np.maximum(1.0 - self.curvature(s) * n, 0.2), low, high)
        return s, n

    def half_width(self, s_m: AnyArray) -> ArrayF:
        """Distance of the shores from the centre line, metres, in the first epoch."""
        s = np.asarray(s_m, dtype=np.float64)
        small = 0.35 * self._along(s, 8.0, 5) + 0.12 * self._along(s, 2.7, 6)
        return np.asarray(self.smooth_half_width(s) + small)

    def shores(self, s_m: AnyArray) -> tuple[ArrayF, ArrayF]:
        """Distances of the right and the left shore from the centre line, metres, both positive.

        They are the half width, but for the retreat of either bank in a second epoch.
        """
        w = self.half_width(s_m)
        return w + self.right_retreat(s_m), w + self.retreat(s_m)

    def retreat(self, s_m: AnyArray) -> ArrayF:
        """How far the left bank has retreated, metres; zero where it has not."""
        s = np.asarray(s_m, dtype=np.float64)
        bump = self._changed("undercut_bank", s)
        return np.asarray(self.config.retreat_m * bump * (0.94 + 0.06 * self._along(s, 6.0, 7)))

    def right_retreat(self, s_m: AnyArray) -> ArrayF:
        """How far the toe of the right bank has retreated, metres; zero where it has not."""
        s = np.asarray(s_m, dtype=np.float64)
        bump = self._changed("bank_retreat", s)
        return np.asarray(self.config.retreat_m * bump * (0.94 + 0.06 * self._along(s, 6.0, 10)))

    def lost(self, s_m: AnyArray, n_m: AnyArray) -> ArrayB:
        """Where the ground of the right bank has gone by more than a decimetre, and what stood on it."""
        s, n = np.broadcast_arrays(np.asarray(s_m, dtype=np.float64), np.asarray(n_m, dtype=np.float64))
        right = -self.half_width(s) - n
        if not {"bank_retreat", "niche", "collapsed_niche"} & set(self.config.changes):
            return np.zeros(s.shape, dtype=np.bool_)
        old, _ = embankment(self.config, s, np.maximum(right, 0.0), self.noise_seed)
        return np.asarray((right > 0) & (old - self._cut(s, right, old) > 0.1))

    def thalweg_n(self, s_m: AnyArray) -> ArrayF:
        """Where the bed is deepest across the river: towards the outer bank of a bend."""
        s = np.asarray(s_m, dtype=np.float64)
        return np.asarray(-0.35 * self.bend(s) * self.smooth_half_width(s))

    def shelf_width(self, s_m: AnyArray) -> tuple[ArrayF, ArrayF]:
        """Width of the shallow shelf along the right and the left shore, metres.

        The shelf of an inner bend is its point bar, nearly twice as wide.
        """
        s = np.asarray(s_m, dtype=np.float64)
        bend, half = self.bend(s), self.smooth_half_width(s)
        pair = []
        for inner, number in ((-bend, 8), (bend, 9)):
            wide = 1.0 + 0.9 * np.maximum(inner, 0.0) + 0.3 * self._along(s, 17.0, number)
            pair.append(np.minimum(self.config.shelf_width_m * wide, 0.3 * half))
        return pair[0], pair[1]

    def weir_s_m(self) -> float:
        """Where along the reach the crest of the weir stands."""
        return self.config.weir_place * self.config.length_m / 2

    def bridge_s_m(self) -> float:
        """Where along the reach the bridge crosses."""
        return self.config.bridge_place * self.config.length_m / 2

    def depth(self, s_m: AnyArray, n_m: AnyArray) -> ArrayF:
        """Depth below the water level without roughness, metres; 0 beyond the shores.

        From each shore the bed falls gently to the edge of the shelf and then, steeply on the outer and
        flatly on the inner bank, to the thalweg. The thalweg is deeper in pools, where the river is narrow,
        and before the weir. Negative where a gravel bar of a second epoch stands out of the water. Given
        sections take the place of all that: smooth curves through their depths, which pass into each other.
        """
        s, n = np.broadcast_arrays(np.asarray(s_m, dtype=np.float64), np.asarray(n_m, dtype=np.float64))
        c = self.config
        right, left = self.shores(s)
        if c.sections:
            return self._depth_by_sections(s, (n + right) / (left + right))
        shelf_right, shelf_left = self.shelf_width(s)
        t, bend = self.thalweg_n(s), self.bend(s)
        on_left = n > t
        half = np.where(on_left, left - t, right + t)
        x = np.maximum(np.where(on_left, left - n, right + n), 0.0)
        shelf = np.where(on_left, shelf_left, shelf_right)
        # 1.9: a flat point bar; 2.9: a channel that falls at once.
        steep = 2.4 + 0.5 * np.where(on_left, -bend, bend)
        q = np.clip((x - shelf) / (half - shelf), 0.0, 1.0)
        deep = np.maximum(self._deepest(s), 1.2 * c.shelf_depth_m)
        edge = c.shelf_depth_m * np.minimum(x / np.maximum(shelf, 1e-9), 1.0)
        d = edge + (deep - c.shelf_depth_m) * (1.0 - (1.0 - q) ** steep)
        return np.asarray(self._deposit_and_scour(s, n, d, left, t))

    def height(self, s_m: AnyArray, n_m: AnyArray) -> ArrayF:
        """Up coordinate of bed and banks in wcs, with roughness."""
        c = self.config
        s, n = np.broadcast_arrays(np.asarray(s_m, dtype=np.float64), np.asarray(n_m, dtype=np.float64))
        right_shore, left_shore = self.shores(s)
        right, left = -right_shore - n, n - left_shore
        over = np.maximum(right, left)
        cell = self.cell_m(over)
        worn = self._changed("undercut_bank", s)
        z = np.where(over > 0, 0.0, -self.depth(s, n))
        # Distance from the shore of the first epoch: a retreat cuts into the bank and moves nothing behind.
        gone = self.right_retreat(s)
        dry_right, rough_right = embankment(c, s, np.maximum(right + gone, 0.0), self.noise_seed)
        if gone.any():
            fresh = 0.5 + (rough_right - 0.5) * smoothstep(right / 0.8)
            rough_right = np.where(gone > 0, fresh, rough_right)
        dry_right = self._patched(s, right + gone, self._cut(s, right + gone, dry_right))
        dry_left, rough_left = meadow(c, s, n, np.maximum(left, 0.0), self.bend(s), worn, self.noise_seed)
        if worn.any():
            # A river that cuts its bank lifts no ground behind it.
            old, _ = meadow(
                c,
                s,
                n,
                np.maximum(n - self.half_width(s), 0.0),
                self.bend(s),
                np.zeros_like(s),
                self.noise_seed,
            )
            dry_left = np.where(worn > 0, np.minimum(dry_left, old), dry_left)
        if c.bridge:
            dry_left = np.maximum(dry_left, ramp(c, s, left))
        z = z + np.where(right > 0, dry_right, np.where(left > 0, dry_left, 0.0))
        # The bed is half as rough; at the water line both sides meet.
        rough = np.where(right > 0, rough_right, np.where(left > 0, rough_left, 0.5))
        noise = fractal_noise(s, n, 4.0, 8, self.noise_seed + 4, 0.6, cell_m=cell)
        return np.asarray(c.water_level_m + z + noise * rough * c.roughness_m - self.fallen_m(s))

    def fallen_m(self, s_m: ArrayLike) -> ArrayF:
        """How much lower water and ground lie than in the middle of the reach, metres."""
        return np.asarray(self.config.water_fall_m_per_km / 1000.0 * np.asarray(s_m, dtype=np.float64))

    def weed_height_m(self, s_m: AnyArray, n_m: AnyArray) -> ArrayF:
        """Height of the weeds above the bed, metres; 0 where none grow.

        They stand in patches of some metres, thin out towards their edges and end a hand below the surface.
        """
        c = self.config
        s, n = np.broadcast_arrays(np.asarray(s_m, dtype=np.float64), np.asarray(n_m, dtype=np.float64))
        if c.weeds_cover == 0:
            return np.zeros(s.shape)
        noise = value_noise(s, 2.0 * n, 9.0, self.noise_seed + 97)
        # The threshold that leaves the wanted share, from places all over the field of noise.
        rng = np.random.default_rng(self.noise_seed)
        x, y = rng.uniform(-1e4, 1e4, (2, 20_000))
        anywhere = value_noise(x, y, 9.0, self.noise_seed + 97)
        edge = float(np.quantile(anywhere, 1.0 - c.weeds_cover))
        tall = c.weeds_height_m * smoothstep((noise - edge) / 0.15)
        room = np.maximum(self.depth(s, n) - _WEEDS_BELOW_M, 0.0)
        return np.asarray(np.where(noise > edge, np.minimum(tall, room), 0.0))

    def cell_m(self, over_m: AnyArray) -> ArrayF:
        """Size of the smallest relief at a distance behind the shore (negative: in the water), metres."""
        over = np.asarray(over_m, dtype=np.float64)
        at = np.concatenate([-WATER_M[::-1], LAND_M])
        size = np.concatenate([RELIEF_CELLS[: len(WATER_M)][::-1], RELIEF_CELLS[: len(LAND_M)]])
        return np.asarray(self.config.grid_m * np.interp(over, at, size))

    def smooth_half_width(self, s_m: AnyArray) -> ArrayF:
        """As `half_width`, without the small bays and noses of the shores."""
        s = np.asarray(s_m, dtype=np.float64)
        return np.asarray(self.config.width_m / 2 * (1.0 + 0.06 * self._along(s, 37.0, 1)))

    def _deepest(self, s: ArrayF) -> ArrayF:
        c = self.config
        narrow = -self._along(s, 37.0, 1)
        deep = c.depth_m * (1.0 + 0.18 * self._along(s, 45.0, 2) + 0.12 * narrow)
        if c.weir:
            before = self.weir_s_m() - s
            length = min(60.0, 0.15 * c.length_m)
            # The impounded water deepens towards the weir; behind it the fall has scoured a shorter hole.
            deep = deep + _WEIR_POOL_M * np.exp(-np.abs(before) / np.where(before > 0, length, 6.0))
        return np.asarray(deep)

    def _depth_by_sections(self, s: ArrayF, u: ArrayF) -> ArrayF:
        """Depth at places along and across, ``u`` from 0 at the right shore to 1 at the left one."""
        c = self.config
        shares = np.array(c.sections)
        shares[:, [0, -1]] = 0.0
        across = PchipInterpolator(np.linspace(0.0, 1.0, shares.shape[1]), shares, axis=1)
        # as many tables of depths across as there are sections, fine enough to be linear in between
        fine = np.linspace(0.0, 1.0, _ACROSS)
        table = np.maximum(across(fine), 0.0)
        at = np.interp(s, np.linspace(-c.length_m / 2, c.length_m / 2, len(shares)), np.arange(len(shares)))
        low = np.minimum(at.astype(np.int64), max(len(shares) - 2, 0))
        blend = smoothstep(at - low)
        place = np.clip(u, 0.0, 1.0) * (_ACROSS - 1)
        k = np.minimum(place.astype(np.int64), _ACROSS - 2)
        rest = place - k
        high = np.minimum(low + 1, len(shares) - 1)
        one, other = ((1 - rest) * table[i, k] + rest * table[i, k + 1] for i in (low, high))
        return np.asarray(c.depth_m * ((1 - blend) * one + blend * other))

    def _deposit_and_scour(self, s: ArrayF, n: ArrayF, d: ArrayF, left: ArrayF, t: ArrayF) -> ArrayF:
        width = self.config.width_m
        across = Stretch(0.0, 0.055 * width)
        bar = self._changed("gravel_bar", s) * across.bump(n - left + BAR_PLACE * width)
        hole = self._changed("scour", s) * Stretch(0.0, 0.1 * width).bump(n - t)
        # Where nothing changes both are zero, and adding zero changes no bit.
        return d - bar * (d + _BAR_TOP_M) + _SCOUR_M * hole

    def _cut(self, s: ArrayF, right: ArrayF, z: ArrayF) -> ArrayF:
        """Height of the right bank where it has been cut; ``right`` from the shore of the first epoch."""
        c = self.config
        if "bank_retreat" in c.changes:
            gone = self.right_retreat(s)
            z = np.where(gone > 0, np.minimum(z, cut_of_retreat(right - gone)), z)
        for change in ("niche", "collapsed_niche"):
            if change in c.changes:
                z = cut_of_niche(c, s, right, z, talus=change == "collapsed_niche")
        return z

    def _patched(self, s: ArrayF, right: ArrayF, z: ArrayF) -> ArrayF:
        """Height with the patches that are displaced; ``right`` from the shore of the first epoch."""
        if "change_patches" in self.config.changes:
            for patch in patches(self.config):
                scale = self.bank_scale(patch.middle_s_m, patch.right_m)
                z = z + patch.rise(scale * (s - patch.middle_s_m), right)
        return z

    def bank_scale(self, s_m: float, right_m: float) -> float:
        """Metres along the right bank for a metre of ``s``, at a distance behind the first shore."""
        at = np.array(s_m)
        n = -float(self.half_width(at)) - right_m
        return 1.0 - float(self.curvature(at)) * n

    def _changed(self, change: Change, s: AnyArray) -> ArrayF:
        known = change in self.config.changes
        return stretch(self.config, change).bump(s) if known else np.zeros(np.shape(s))

    def _along(self, s: ArrayF, wavelength_m: float, number: int) -> ArrayF:
        return value_noise(s, np.zeros_like(s), wavelength_m, self.noise_seed + number)


# ---------------------------------------------------------------- profiles of the banks


def track_offset(config: TwinScene) -> float:
    """Distance of the track's middle behind the right shore, metres."""
    return slope_width(config) + TRACK_BEHIND_CREST_M


def embankment(config: TwinScene, s: ArrayF, right: ArrayF, seed: int) -> tuple[ArrayF, ArrayF]:
    """Height over the water of the right bank, metres, and how rough it is (1: as configured).

    Parameters
    ----------
    config : section ``twin.scene``.
    s : places along the flow, metres.
    right : distance behind the right shore, metres, at least 0.
    seed : seed of the noise.
    """
    c = config
    top, width = c.embankment_height_m, slope_width(c)
    wobble = (
        1.0 + 0.10 * value_noise(s, right, 23.0, seed + 20) + 0.05 * value_noise(s, right, 6.0, seed + 21)
    )
    rise = np.tan(np.deg2rad(c.embankment_slope_deg)) * right * wobble
    # Water runs down the slope: gullies that begin below the crest and end above the toe.
    on_slope = np.clip(right / width, 0.0, 1.0)
    reach = 4.0 * on_slope * (1.0 - on_slope)
    # Noise that is drawn out along the slope, bent a little.
    ridge = fractal_noise(
        s + 0.35 * value_noise(s, right, 4.0, seed + 22), 0.12 * right, 7.0, 3, seed + 23, ridged=True
    )
    gully = GULLY_M * reach * (np.maximum(ridge, 0.0) - 0.45)
    # The crest is rounded over half a metre of height.
    blunt = 0.35
    z = -blunt * np.logaddexp(-rise / blunt, -top / blunt) + blunt * np.logaddexp(0.0, -top / blunt)
    behind = right - width
    if c.railway:
        away = np.abs(behind - TRACK_BEHIND_CREST_M)
        z = z + BALLAST_M * smoothstep((2.4 - away) / 0.9)
    # Behind the track a ditch, then the side of the valley.
    far = np.maximum(behind - 7.5, 0.0)
    z = z - 0.9 * smoothstep((behind - 6.0) / 2.5)
    hills = fractal_noise(s, right, 40.0, 3, seed + 24)
    z = z + 0.34 * far * smoothstep(far / 15.0) + 1.8 * hills * smoothstep(far / 12.0)
    rough = 1.7 - 1.3 * smoothstep((behind + 0.6) / 1.2)
    # At the toe the slope meets the bed's roughness.
    rough = 0.5 + (rough - 0.5) * smoothstep(right / 0.8)
    return np.asarray(z + gully), np.asarray(rough)


def meadow(
    config: TwinScene, s: ArrayF, n: ArrayF, left: ArrayF, bend: ArrayF, worn: ArrayF, seed: int
) -> tuple[ArrayF, ArrayF]:
    """Height over the water of the left bank, metres, and how rough it is (1: as configured).

    Parameters
    ----------
    config : section ``twin.scene``.
    s, n : flow coordinates, metres.
    left : distance behind the left shore, metres, at least 0.
    bend : curvature over the greatest one, positive to the left: the left bank is the inner one.
    worn : 0 to 1, how far a flood has freshly cut the bank.
    seed : seed of the noise.
    """
    along = np.full_like(s, 3.3)
    outer = np.maximum(np.maximum(-bend, worn), 0.0)
    scarp = 1.35 + 0.35 * value_noise(s, along, 31.0, seed + 30) + 0.5 * worn
    beach = beach_width(s, bend, worn, seed)
    # Undercut outer banks stand nearly upright, inner ones are flat.
    edge = 0.32 * fractal_noise(s, along, 2.6, 4, seed + 32) * outer
    width = np.maximum(
        2.6 - 2.3 * outer**0.5 + 0.5 * value_noise(s, along, 13.0, seed + 33) * (1 - outer), 0.28
    )
    beach = np.maximum(beach + edge, 0.1)
    foot = 0.10 * np.minimum(left, beach)
    step = smoothstep((left - beach) / width)
    behind = np.maximum(left - beach - width, 0.0)
    ground = 0.018 * behind + 0.25 * value_noise(s, n, 14.0, seed + 34) * smoothstep(behind / 6.0)
    ground = ground + 0.9 * fractal_noise(s, n, 60.0, 2, seed + 35) * smoothstep((behind - 10.0) / 25.0)
    ground = ground + 0.2 * np.maximum(behind - 44.0, 0.0)
    z = foot + (scarp - 0.10 * beach) * step + ground
    face = 4.0 * step * (1.0 - step)
    rough = 0.5 + (0.7 + 1.3 * outer) * face + 0.2 * smoothstep(behind / 3.0)
    return np.asarray(z), np.asarray(rough)


def bridge_soffit_m(config: TwinScene) -> float:
    """Height of the lower edge of the bridge's girders above the water, metres."""
    return max(BRIDGE_CLEARANCE_M, config.embankment_height_m - 1.6)


def ramp(config: TwinScene, s: ArrayF, left: ArrayF) -> ArrayF:
    """Height over the water of the earth ramp that leads from the meadow to the bridge, metres.

    Deep below the ground where there is none; the higher of both is the surface.
    """
    top = bridge_soffit_m(config) + 1.15
    away = np.abs(s - config.bridge_place * config.length_m / 2)
    crest = top - 0.07 * np.maximum(left - 14.0, 0.0)
    front = np.maximum(3.0 - left, 0.0) / 0.6
    return np.asarray(crest - front - np.maximum(away - 3.6, 0.0) / 1.6)


def beach_width(s: ArrayF, bend: ArrayF, worn: ArrayF, seed: int) -> ArrayF:
    """Width of the gravel before the left bank, metres: wide on inner bends."""
    along = np.full_like(s, 3.3)
    inner = np.maximum(bend, 0.0) * (1.0 - worn)
    return np.asarray(0.25 + (3.2 + 1.4 * value_noise(s, along, 19.0, seed + 31)) * inner)


# ---------------------------------------------------------------- smooth noise over the plane


@njit(cache=True, error_model="numpy", inline="always")
def _lattice(ix, iy, seed):  # type: ignore[no-untyped-def]
    """Uniform number in [-1, 1) that belongs to a lattice point (integer mixing of splitmix64)."""
    h = np.uint64(ix) * np.uint64(0x9E3779B97F4A7C15)
    h ^= np.uint64(iy) * np.uint64(0xC2B2AE3D27D4EB4F)
    h += np.uint64(seed) * np.uint64(0x165667B19E3779F9)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    h ^= h >> np.uint64(31)
    return np.float64(h >> np.uint64(11)) * 2.0**-52 - 1.0


@njit(cache=True, error_model="numpy")
def _value(x, y, seed):  # type: ignore[no-untyped-def]
    fx, fy = np.floor(x), np.floor(y)
    ix, iy = np.int64(fx), np.int64(fy)
    u, v = x - fx, y - fy
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    a, b = _lattice(ix, iy, seed), _lattice(ix + 1, iy, seed)
    c, d = _lattice(ix, iy + 1, seed), _lattice(ix + 1, iy + 1, seed)
    low = a + (b - a) * u
    return low + (c + (d - c) * u - low) * v


@njit(cache=True, error_model="numpy")
def _sum(x, y, cell, longest_m, octaves, seed, gain, ridged):  # type: ignore[no-untyped-def]
    total, amplitude, wavelength = 0.0, 1.0, longest_m
    for octave in range(octaves):
        # An octave fades out between 2.5 and 1.5 cells a wave: a coarser mesh cannot carry it.
        weight = min(wavelength / cell - 1.5, 1.0)
        if weight <= 0.0:
            break
        value = _value(x / wavelength, y / wavelength, seed + 7919 * octave)
        if ridged:
            value = 1.0 - 2.0 * abs(value)
        total += weight * amplitude * value
        amplitude *= gain
        wavelength *= 0.5
    return total


@njit(cache=True, error_model="numpy")
def _few(x, y, cell, longest_m, octaves, seed, gain, ridged, out):  # type: ignore[no-untyped-def]
    for k in range(x.size):
        out[k] = _sum(x[k], y[k], cell[k], longest_m, octaves, seed, gain, ridged)


@njit(cache=True, error_model="numpy", parallel=True)
def _many(x, y, cell, longest_m, octaves, seed, gain, ridged, out):  # type: ignore[no-untyped-def]
    for k in prange(x.size):
        out[k] = _sum(x[k], y[k], cell[k], longest_m, octaves, seed, gain, ridged)


@njit(cache=True, error_model="numpy")
def seen_share(spacing, footprint):  # type: ignore[no-untyped-def]
    """Share of a detail that is left at a footprint: none from one spacing on (Nyquist); for kernels."""
    return min(max(spacing / footprint - 1.0, 0.0), 1.0)


@njit(cache=True, error_model="numpy")
def mixed(ix, iy, iz, seed):  # type: ignore[no-untyped-def]
    """A number in [0, 1) that belongs to a lattice point of space; for kernels."""
    h = ix * 374761393 + iy * 668265263 + iz * 2147483647 + seed * 1274126177
    h = (h ^ (h >> 29)) * 5871781006564002453
    h = (h ^ (h >> 32)) * 1181783497276652981
    return ((h >> 24) & 16777215) * 5.9604644775390625e-08


@njit(cache=True, error_model="numpy")
def chance_of(index, stream):  # type: ignore[no-untyped-def]
    """A number in [0, 1) that belongs to an index; for kernels."""
    h = np.uint64(index) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(stream) * np.uint64(0xC2B2AE3D27D4EB4F)
    h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    h ^= h >> np.uint64(31)
    return np.float64(h >> np.uint64(11)) * 2.0**-53


@njit(cache=True, error_model="numpy")
def noise_and_slope(x, y, z, seed):  # type: ignore[no-untyped-def]
    """Value noise of space in [-1, 1], of spacing 1, and its gradient; for kernels."""
    fx, fy, fz = np.floor(x), np.floor(y), np.floor(z)
    ix, iy, iz = np.int64(fx), np.int64(fy), np.int64(fz)
    x, y, z = x - fx, y - fy, z - fz
    u, v, w = x * x * (3 - 2 * x), y * y * (3 - 2 * y), z * z * (3 - 2 * z)
    a, b = mixed(ix, iy, iz, seed), mixed(ix + 1, iy, iz, seed)
    c, d = mixed(ix, iy + 1, iz, seed), mixed(ix + 1, iy + 1, iz, seed)
    e, f = mixed(ix, iy, iz + 1, seed), mixed(ix + 1, iy, iz + 1, seed)
    g, h = mixed(ix, iy + 1, iz + 1, seed), mixed(ix + 1, iy + 1, iz + 1, seed)
    ab, cd, ef, gh = a + (b - a) * u, c + (d - c) * u, e + (f - e) * u, g + (h - g) * u
    low, high = ab + (cd - ab) * v, ef + (gh - ef) * v
    below, above = (b - a) + ((d - c) - (b - a)) * v, (f - e) + ((h - g) - (f - e)) * v
    dx = (below + (above - below) * w) * 12 * x * (1 - x)
    dy = ((cd - ab) + ((gh - ef) - (cd - ab)) * w) * 12 * y * (1 - y)
    dz = (high - low) * 12 * z * (1 - z)
    return 2 * (low + (high - low) * w) - 1, dx, dy, dz


@njit(cache=True, error_model="numpy")
def noise_at(x, y, z, seed):  # type: ignore[no-untyped-def]
    """Value noise of space in [-1, 1], of spacing 1; for kernels."""
    return noise_and_slope(x, y, z, seed)[0]


def fractal_noise(
    x: ArrayF,
    y: ArrayF,
    longest_m: float,
    octaves: int,
    seed: int,
    gain: float = 0.55,
    *,
    cell_m: AnyArray | float = 1e-9,
    ridged: bool = False,
) -> ArrayF:
    """Sum of value noises; each octave has half the wavelength and ``gain`` times the amplitude.

    Parameters
    ----------
    x, y : places, metres; broadcast against each other.
    longest_m : wavelength of the first octave.
    octaves : how many of them.
    seed : seed of the field.
    gain : amplitude of an octave over that of the one before.
    cell_m : size of the cells that the noise is sampled with; octaves of less than 1.5 cells a wave are left
        out and those of more than 2.5 are whole.
    ridged : fold each octave, so that sharp crests stand between round hollows.

    Returns
    -------
    noise : within +-(1 + gain + gain^2 ...), smooth to the first derivative (ridged: continuous).
    """
    px, py, pc = np.broadcast_arrays(x, y, cell_m)
    flat = [np.ascontiguousarray(a, dtype=np.float64).reshape(-1) for a in (px, py, pc)]
    out = np.empty(px.size)
    # Threads cost more than they bring on few points.
    kernel = _many if px.size > _MANY else _few
    kernel(*flat, float(longest_m), int(octaves), int(seed), float(gain), ridged, out)
    return out.reshape(px.shape)


def value_noise(x: ArrayF, y: ArrayF, wavelength_m: float, seed: int) -> ArrayF:
    """Value noise in [-1, 1], smooth to the first derivative, of one wavelength."""
    return fractal_noise(x, y, wavelength_m, 1, seed)
