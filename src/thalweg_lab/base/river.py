"""Shape of the river reach: a sine-generated centre line, shores, bed with a thalweg, banks.

Flow coordinates: ``s`` along the centre line, 0 in the middle of the reach, ``n`` across it, positive to the
left of the flow. The angle of the centre line is ``theta(s) = theta_0 sin(2 pi s / lambda)`` (Langbein and
Leopold 1966) about the configured mean direction.

The water level is the same everywhere. With a weir the reach is what it impounds: the bed falls towards the
weir, and what lies behind is a backdrop at the same level.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from thalweg.core.types import AnyArray, ArrayF
from thalweg.settings.twin.scene import TwinScene
from thalweg_lab.base.banks import LAND_M, RELIEF_CELLS, WATER_M, embankment, meadow, ramp
from thalweg_lab.base.epochs import Stretch, stretch
from thalweg_lab.base.noise import fractal_noise, value_noise
from thalweg_lab.base.random import generator

_LINE_STEP_M: Final = 0.5
_BAR_TOP_M: Final = 0.25
"""Height of the gravel bar of a second epoch above the water."""

BAR_PLACE: Final = 0.06
"""Distance of its middle from the left shore as a share of the river's width."""

_SCOUR_M: Final = 0.7
"""Depth of the scour hole of a second epoch."""


@dataclass(slots=True)
class River:
    """Geometry of a reach; a pure function of the settings and the seed.

    Parameters
    ----------
    config : section ``twin.scene``.
    seed : seed of the campaign; the settings may name another one for the river.
    """

    config: TwinScene
    seed: int
    noise_seed: int = field(init=False)
    _line: CubicHermiteSpline = field(init=False)

    def __post_init__(self) -> None:
        if self.config.seed is not None:
            self.seed = self.config.seed
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

        They are the half width, but for the retreat of the left bank in a second epoch.
        """
        w = self.half_width(s_m)
        return w, w + self.retreat(s_m)

    def retreat(self, s_m: AnyArray) -> ArrayF:
        """How far the left bank has retreated, metres; zero where it has not."""
        s = np.asarray(s_m, dtype=np.float64)
        bump = self._changed("undercut_bank", s)
        return np.asarray(self.config.retreat_m * bump * (0.94 + 0.06 * self._along(s, 6.0, 7)))

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
        and before the weir. Negative where a gravel bar of a second epoch stands out of the water.
        """
        s, n = np.broadcast_arrays(np.asarray(s_m, dtype=np.float64), np.asarray(n_m, dtype=np.float64))
        c = self.config
        right, left = self.shores(s)
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
        dry_right, rough_right = embankment(c, s, np.maximum(right, 0.0), self.noise_seed)
        dry_left, rough_left = meadow(c, s, n, np.maximum(left, 0.0), self.bend(s), worn, self.noise_seed)
        if c.bridge:
            dry_left = np.maximum(dry_left, ramp(c, s, left))
        z = z + np.where(right > 0, dry_right, np.where(left > 0, dry_left, 0.0))
        # The bed is half as rough; at the water line both sides meet.
        rough = np.where(right > 0, rough_right, np.where(left > 0, rough_left, 0.5))
        noise = fractal_noise(s, n, 4.0, 8, self.noise_seed + 4, 0.6, cell_m=cell)
        return np.asarray(c.water_level_m + z + noise * rough * c.roughness_m)

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
            deep = deep + c.weir_pool_m * np.exp(-np.abs(before) / np.where(before > 0, length, 6.0))
        return np.asarray(deep)

    def _deposit_and_scour(self, s: ArrayF, n: ArrayF, d: ArrayF, left: ArrayF, t: ArrayF) -> ArrayF:
        width = self.config.width_m
        across = Stretch(0.0, 0.055 * width)
        bar = self._changed("gravel_bar", s) * across.bump(n - left + BAR_PLACE * width)
        hole = self._changed("scour", s) * Stretch(0.0, 0.1 * width).bump(n - t)
        # Where nothing changes both are zero, and adding zero changes no bit.
        return d - bar * (d + _BAR_TOP_M) + _SCOUR_M * hole

    def _changed(self, change: str, s: AnyArray) -> ArrayF:
        known = [c for c in self.config.changes if c == change]
        return stretch(self.config, known[0]).bump(s) if known else np.zeros(np.shape(s))

    def _along(self, s: ArrayF, wavelength_m: float, number: int) -> ArrayF:
        return value_noise(s, np.zeros_like(s), wavelength_m, self.noise_seed + number)
