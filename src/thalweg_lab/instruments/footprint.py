"""The footprint of a laser beam: sub-rays that meet surfaces of their own and add up to echoes.

A beam is split into K cells, each a ray at a random place of the uniform disc of the footprint with an energy
of its own. The energies are exponential, as the intensity of fully developed speckle is (Goodman 2007, 3.2);
divided by their sum they follow the Dirichlet distribution D(1, ..., 1), whose sum of squares is 2 / (K + 1)
on average. On a plane the echo's place then scatters about the middle of the footprint with

    sigma = (divergence * range / 4) * sqrt(2 / (K + 1))

in each of two directions across the beam: a quarter of the diameter is the standard deviation of a uniform
disc (Lichti and Gordon 2004). Surfaces nearer to each other than the length of the pulse merge into one echo
at the range of their centre of energy. That is the mixed pixel; surfaces farther apart give echoes of
their own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Self

import numba as nb
import numpy as np

from thalweg.core.geometry.raycast import Hits, RayCaster
from thalweg.core.types import AnyArray, ArrayB, ArrayF, ArrayI, ArrayU8
from thalweg.settings.twin.lidar import TwinLidar, TwinTls
from thalweg_lab.instruments.shot_random import ShotRandom
from thalweg_lab.instruments.shots import EchoKind
from thalweg_lab.river.materials import Material

STEP_M: Final = 0.05
"""An echo is a mixed one if it lies farther than this off the plane that its brightest cell has met."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Echoes:
    """Up to K echoes of each of n shots, the nearest first.

    ``range_m`` (n, K) is infinite where there is none; ``strength`` (n, K) is the received power as that of
    reflectance times cosine of incidence, averaged over the whole footprint; ``point_wcs_m`` (n, K, 3) is the
    centre of energy of the surface points that were met, or with ``mixed`` off the point of the
    brightest cell; ``material`` (n, K) that of the brightest cell; ``kind`` (n, K) of `EchoKind`.
    """

    range_m: ArrayF
    strength: ArrayF
    point_wcs_m: ArrayF
    material: ArrayU8
    kind: ArrayU8

    @classmethod
    def none(cls, n: int, cells: int) -> "Echoes":
        """No echo of n shots."""
        return cls(
            range_m=np.full((n, cells), np.inf),
            strength=np.zeros((n, cells)),
            point_wcs_m=np.zeros((n, cells, 3)),
            material=np.zeros((n, cells), dtype=np.uint8),
            kind=np.zeros((n, cells), dtype=np.uint8),
        )

    @classmethod
    def single(
        cls, range_m: ArrayF, strength: ArrayF, point_wcs_m: ArrayF, material: ArrayU8, kind: EchoKind
    ) -> "Echoes":
        """One echo for each of n shots; infinite ranges are none."""
        return cls(
            range_m=range_m[:, None],
            strength=strength[:, None],
            point_wcs_m=point_wcs_m[:, None],
            material=material[:, None].astype(np.uint8),
            kind=np.full((len(range_m), 1), kind, dtype=np.uint8),
        )

    @classmethod
    def stacked(cls, parts: Sequence["Echoes"], cells: int) -> "Echoes":
        """Echoes of the shots of all parts, filled up to ``cells`` columns."""
        out = cls.none(sum(len(p.range_m) for p in parts), cells)
        first = 0
        for p in parts:
            rows = slice(first, first + len(p.range_m))
            for name in cls.__slots__:
                getattr(out, name)[rows, : p.range_m.shape[1]] = getattr(p, name)
            first = rows.stop
        return out

    @classmethod
    def beside(cls, parts: Sequence["Echoes"]) -> "Echoes":
        """Echoes of the same shots side by side; the nearer ones first."""
        names = cls.__slots__
        return cls(**{k: np.concatenate([getattr(p, k) for p in parts], axis=1) for k in names})

    def taken(self, rows: AnyArray) -> "Echoes":
        """The shots of some rows."""
        return type(self)(**{name: getattr(self, name)[rows] for name in self.__slots__})

    def only(self, keep: ArrayB) -> "Echoes":
        """These echoes without those that ``keep`` (n, K) tells not to."""
        return replace(self, range_m=np.where(keep, self.range_m, np.inf))

    @property
    def there(self) -> ArrayB:
        """Which echoes exist, (n, K)."""
        return np.isfinite(self.range_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Surfaces:
    """The scene as a laser sees it.

    Parameters
    ----------
    caster : mesh of the scene.
    material : (m,) material of each triangle.
    reflectance : by material, at the laser's wavelength.
    water_level_m : up coordinate of the water at rest.
    wet_band_m : everything up to this height above the water is wet.
    wet_reflectance : reflectance of wet things relative to dry ones.
    """

    caster: RayCaster
    material: ArrayU8
    reflectance: ArrayF
    water_level_m: float
    wet_band_m: float
    wet_reflectance: float

    def kinds(self, hits: Hits) -> ArrayU8:
        """Material (n,) that rays meet; any where they meet nothing."""
        return np.asarray(self.material[np.maximum(hits.primitive, 0)])

    def strength(self, kind: ArrayU8, normal: ArrayF, direction: ArrayF, up_m: ArrayF) -> ArrayF:
        """Reflectance times cosine of incidence (n,) at points of height ``up_m``."""
        cosine = np.abs(np.einsum("ni,ni->n", normal, direction))
        wet = up_m < self.water_level_m + self.wet_band_m
        return np.asarray(self.reflectance[kind] * cosine * np.where(wet, self.wet_reflectance, 1.0))


@dataclass(frozen=True, slots=True, kw_only=True)
class Beam:
    """How a beam spreads.

    Parameters
    ----------
    divergence_rad : full divergence.
    cells : number of sub-rays K.
    pulse_m : surfaces nearer to each other than this give one echo.
    mixed : echoes lie at the centre of energy; false: at the brightest cell.
    place, speckle : random places and energies of the cells.
    """

    divergence_rad: float
    cells: int
    pulse_m: float
    mixed: bool
    place: ShotRandom
    speckle: ShotRandom

    @classmethod
    def of(cls, settings: TwinLidar | TwinTls, seed: int, cause: str, *, pulse_m: float) -> Self:
        """The beam of a scanner's settings, with random numbers of its own named after ``cause``."""
        return cls(
            divergence_rad=settings.divergence_mrad / 1000,
            cells=settings.speckle_cells,
            pulse_m=pulse_m,
            mixed=settings.mixed_pixels,
            place=ShotRandom.of(seed, f"{cause} footprint"),
            speckle=ShotRandom.of(seed, f"{cause} speckle"),
        )

    def first_cell(self, direction: ArrayF, shot: ArrayI) -> ArrayF:
        """Direction (n, 3) of the first sub-ray of shots."""
        if self.divergence_rad == 0:
            return direction
        return _spread(direction, self.divergence_rad / 2, self.place.uniform(shot, 2))[:, 0]

    def other_cells(self, direction: ArrayF, shot: ArrayI) -> ArrayF:
        """Directions (n, K - 1, 3) of the other sub-rays of shots."""
        places = self.place.uniform(shot, 2 * self.cells)[:, 2:]
        return _spread(direction, self.divergence_rad / 2, np.ascontiguousarray(places))


def part_of(hits: Hits, rows: AnyArray) -> Hits:
    """Hits of some of the rays."""
    return Hits(
        t_hit_m=hits.t_hit_m[rows], primitive=hits.primitive[rows], normal=hits.normal[rows], uv=hits.uv[rows]
    )


def echoes_of(
    surfaces: Surfaces,
    beam: Beam,
    origin_wcs_m: ArrayF,
    direction_wcs: ArrayF,
    shot: ArrayI,
    first_direction: ArrayF,
    first: Hits,
) -> Echoes:
    """Noise-free echoes of shots whose first sub-ray has met a surface other than water.

    Parameters
    ----------
    surfaces, beam : scene and beam.
    origin_wcs_m, direction_wcs : (n, 3) axes of the beams.
    shot : (n,) numbers of the shots.
    first_direction, first : (n, 3) first sub-rays and what they hit.

    Notes
    -----
    Only beams whose first sub-ray meets something are worth the others: a thin target in front of sky or
    water returns the share of the shots that it fills of the footprint, and the others that touch it are
    lost. Water takes energy away, as it mirrors it elsewhere.
    """
    n, cells = len(shot), beam.cells if beam.divergence_rad > 0 else 1
    range_m, strength = np.empty((n, cells)), np.empty((n, cells))
    normal, point = np.empty((n, cells, 3)), np.empty((n, cells, 3))
    material = np.empty((n, cells), dtype=np.uint8)

    def meet(of: slice, origin: ArrayF, direction: ArrayF, hits: Hits) -> None:
        """Fill in what some of the parts of the beams have met."""
        shape = range_m[:, of].shape
        kind = surfaces.kinds(hits)
        met = np.isfinite(hits.t_hit_m) & (kind != Material.WATER)
        where = origin + np.where(met, hits.t_hit_m, 0.0)[:, None] * direction
        range_m[:, of] = np.where(met, hits.t_hit_m, np.inf).reshape(shape)
        strength[:, of] = surfaces.strength(kind, hits.normal, direction, where[:, 2]).reshape(shape)
        normal[:, of], point[:, of] = hits.normal.reshape(*shape, 3), where.reshape(*shape, 3)
        material[:, of] = kind.reshape(shape)

    meet(slice(0, 1), origin_wcs_m, first_direction, first)
    if cells > 1:
        others = beam.other_cells(direction_wcs, shot).reshape(-1, 3)
        origin = np.repeat(origin_wcs_m, cells - 1, axis=0)
        meet(slice(1, cells), origin, others, surfaces.caster.cast(origin, others))
    energy = beam.speckle.exponential(shot, cells)
    energy /= energy.sum(axis=1, keepdims=True)
    out = Echoes.none(n, cells)
    _merge(
        range_m, energy * strength, point, normal, material, beam.pulse_m, beam.mixed, STEP_M,
        out.range_m, out.strength, out.point_wcs_m, out.material, out.kind,
    )  # fmt: skip
    return out


@nb.njit(cache=True, error_model="numpy")
def _spread(direction: ArrayF, radius: float, places: ArrayF) -> Any:
    """Directions (n, k, 3) at uniform places of a disc about each direction; places (n, 2 k) in [0, 1)."""
    count = places.shape[1] // 2
    out = np.empty((len(direction), count, 3))
    for i in range(len(direction)):
        x, y, z = direction[i, 0], direction[i, 1], direction[i, 2]
        # Two directions across any third one, without a special case (Duff et al. 2017).
        sign = 1.0 if z >= 0 else -1.0
        a = -1.0 / (sign + z)
        b = x * y * a
        for k in range(count):
            r = radius * np.sqrt(places[i, 2 * k])
            turn = 2.0 * np.pi * places[i, 2 * k + 1]
            u, v = r * np.cos(turn), r * np.sin(turn)
            dx = x + u * (1.0 + sign * x * x * a) + v * b
            dy = y + u * sign * b + v * (sign + y * y * a)
            dz = z - u * sign * x - v * y
            scale = 1.0 / np.sqrt(dx * dx + dy * dy + dz * dz)
            out[i, k, 0], out[i, k, 1], out[i, k, 2] = dx * scale, dy * scale, dz * scale
    return out


@nb.njit(cache=True, error_model="numpy")
def _merge(  # type: ignore[no-untyped-def]
    range_m,
    power,
    point,
    normal,
    material,
    pulse,
    mixed,
    step,
    o_range,
    o_strength,
    o_point,
    o_material,
    o_kind,
):
    """Sort sub-rays by range and add up those that follow each other within a pulse length."""
    cells = range_m.shape[1]
    order = np.empty(cells, dtype=np.int64)
    for i in range(len(range_m)):
        for k in range(cells):
            place = k
            while place > 0 and range_m[i, order[place - 1]] > range_m[i, k]:
                order[place] = order[place - 1]
                place -= 1
            order[place] = k
        k, echo = 0, 0
        while k < cells and np.isfinite(range_m[i, order[k]]):
            first = k
            k += 1
            while k < cells and range_m[i, order[k]] - range_m[i, order[k - 1]] < pulse:
                k += 1
            total, best = 0.0, order[first]
            for c in order[first:k]:
                total += power[i, c]
                if power[i, c] > power[i, best]:
                    best = c
            if not total > 0.0:
                continue
            if mixed:
                length, off = 0.0, 0.0
                for c in order[first:k]:
                    share = power[i, c] / total
                    length += share * range_m[i, c]
                    for a in range(3):
                        o_point[i, echo, a] += share * point[i, c, a]
                        off += share * normal[i, best, a] * (point[i, c, a] - point[i, best, a])
                o_range[i, echo] = length
                o_kind[i, echo] = 1 if abs(off) > step else 0
            else:
                o_range[i, echo] = range_m[i, best]
                o_point[i, echo] = point[i, best]
            o_strength[i, echo] = total
            o_material[i, echo] = material[i, best]
            echo += 1
