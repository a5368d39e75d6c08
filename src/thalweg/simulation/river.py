"""Shape of the river reach: a sine-generated centre line, banks, bed with a thalweg.

Flow coordinates: ``s`` along the centre line, 0 in the middle of the reach, ``n`` across it, positive to the
left of the flow. The angle of the centre line is ``theta(s) = theta_0 sin(2 pi s / lambda)`` (Langbein and
Leopold 1966), so that on average the river flows to the east.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from thalweg.config.twin_scene import TwinScene
from thalweg.core.types import ArrayF
from thalweg.simulation.noise import fractal_noise, value_noise
from thalweg.simulation.random import generator

_LINE_STEP_M = 0.5


@dataclass(slots=True)
class River:
    """Geometry of a reach; a pure function of the settings and the seed.

    Parameters
    ----------
    config : section ``twin.scene``.
    seed : seed of the campaign.
    """

    config: TwinScene
    seed: int
    _noise: int = field(init=False)
    _line: CubicHermiteSpline = field(init=False)

    def __post_init__(self) -> None:
        self._noise = int(generator(self.seed, "river").integers(2**31))
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

    def angle(self, s_m: ArrayF) -> ArrayF:
        """Direction of the flow, radians from east, counter-clockwise."""
        phase = 2 * np.pi * np.asarray(s_m) / self.config.meander_length_m
        return np.asarray(np.deg2rad(self.config.meander_deg) * np.sin(phase))

    def curvature(self, s_m: ArrayF) -> ArrayF:
        """Curvature of the centre line, 1/m, positive to the left."""
        k = 2 * np.pi / self.config.meander_length_m
        return np.asarray(np.deg2rad(self.config.meander_deg) * k * np.cos(k * np.asarray(s_m)))

    def to_wcs(self, s_m: ArrayF, n_m: ArrayF) -> ArrayF:
        """East and north, shape (..., 2), of flow coordinates."""
        s, n = np.broadcast_arrays(np.asarray(s_m, dtype=np.float64), np.asarray(n_m, dtype=np.float64))
        theta = self.angle(s)
        normal = np.stack([-np.sin(theta), np.cos(theta)], axis=-1)
        return np.asarray(self._line(s) + n[..., None] * normal)

    def to_flow(self, east_m: ArrayF, north_m: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Flow coordinates of places near the river: the inverse of `to_wcs`, by Newton steps."""
        p = np.stack(np.broadcast_arrays(east_m, north_m), axis=-1).astype(np.float64)
        low, high = self._line.x[0], self._line.x[-1]
        s = np.clip(p[..., 0], low, high)
        n = np.zeros_like(s)
        for _ in range(12):
            theta = self.angle(s)
            d = p - self._line(s)
            along = d[..., 0] * np.cos(theta) + d[..., 1] * np.sin(theta)
            n = -d[..., 0] * np.sin(theta) + d[..., 1] * np.cos(theta)
            s = np.clip(s + along / np.maximum(1.0 - self.curvature(s) * n, 0.2), low, high)
        return s, n

    def half_width(self, s_m: ArrayF) -> ArrayF:
        """Distance of the shores from the centre line, metres."""
        s = np.asarray(s_m, dtype=np.float64)
        wave = value_noise(s, np.zeros_like(s), 37.0, self._noise + 1)
        return np.asarray(self.config.width_m / 2 * (1.0 + 0.06 * wave))

    def thalweg_n(self, s_m: ArrayF) -> ArrayF:
        """Where the bed is deepest across the river: towards the outer bank of a bend."""
        s = np.asarray(s_m, dtype=np.float64)
        greatest = np.deg2rad(self.config.meander_deg) * 2 * np.pi / self.config.meander_length_m
        bend = -self.curvature(s) / greatest if greatest > 0 else np.zeros_like(s)
        return np.asarray(0.35 * bend * self.half_width(s))

    def depth(self, s_m: ArrayF, n_m: ArrayF) -> ArrayF:
        """Depth below the water level without roughness: a parabola on each side of the thalweg."""
        s, n = np.asarray(s_m, dtype=np.float64), np.asarray(n_m, dtype=np.float64)
        w, t = self.half_width(s), self.thalweg_n(s)
        u = np.where(n > t, (n - t) / (w - t), (t - n) / (w + t))
        pools = 1.0 + 0.25 * value_noise(s, np.zeros_like(s), 45.0, self._noise + 2)
        return np.asarray(self.config.depth_m * pools * (1.0 - np.minimum(u, 1.0) ** 2))

    def height(self, s_m: ArrayF, n_m: ArrayF) -> ArrayF:
        """Up coordinate of bed and banks in wcs, with roughness."""
        c = self.config
        s, n = np.broadcast_arrays(np.asarray(s_m, dtype=np.float64), np.asarray(n_m, dtype=np.float64))
        w = self.half_width(s)
        right, left = -w - n, n - w
        wobble = 1.0 + 0.12 * value_noise(s, np.zeros_like(s), 23.0, self._noise + 3)
        rise = np.tan(np.deg2rad(c.embankment_slope_deg)) * np.maximum(right, 0.0) * wobble
        # The crest is rounded over half a metre of height.
        blunt = 0.5
        embankment = -blunt * np.logaddexp(-rise / blunt, -c.embankment_height_m / blunt)
        embankment -= -blunt * np.logaddexp(0.0, -c.embankment_height_m / blunt)
        meadow = 1.3 * (1.0 - np.exp(-np.maximum(left, 0.0) / 1.5)) + 0.03 * np.maximum(left, 0.0)
        dry = np.where(right > 0, embankment, meadow)
        z = np.where((right > 0) | (left > 0), dry, -self.depth(s, n))
        rough = fractal_noise(s, n, 4.0, 5, self._noise + 4) * c.roughness_m
        # The shore line itself stays where the half width says: roughness fades out beside it.
        fade = np.clip(np.maximum(np.maximum(right, left), -np.maximum(right, left)) / 1.0, 0.0, 1.0)
        under = np.where((right > 0) | (left > 0), 1.0, 0.5)
        return np.asarray(c.water_level_m + z + rough * fade * under)
