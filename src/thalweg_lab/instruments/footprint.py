"""The footprint of a laser beam, the echoes that a receiver reports, and the truth of each shot.

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

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.special import ndtr

from thalweg.core import AnyArray, ArrayB, ArrayF, ArrayI, ArrayU8, column, njit, table_kind
from thalweg.core.geometry import Hits, RayCaster
from thalweg_lab.random_numbers import generator
from thalweg_lab.river import Material
from thalweg_lab.settings import TwinLidar, TwinTls

STEP_M: Final = 0.05
"""An echo is a mixed one if it lies farther than this off the plane that its brightest cell has met."""

MIN_RANGE_M: Final = 0.4
PULSE_M: Final = 1.0
"""Surfaces nearer to each other than this give one echo (VLP-16 User Manual 63-9243 Rev. D, 6.1)."""
WEAKEST: Final = 0.1
"""Strength (reflectance times cosine of incidence) that a VLP-16 just sees at 100 m."""
DETECTION_WIDTH: Final = 0.2
"""Noise of the received signal at the limit of detection, as a share of the limit."""
CERTAIN: Final = 4.0
"""Signals that lie this many widths below the limit of detection are never seen."""

MANY_SHOTS: Final = 2.5e6
"""Shots whose truth is kept on average, of recordings with more than that."""
LIDAR_SHOTS: Final = table_kind(
    "twin_lidar_shots",
    2,
    [
        column("t_gps_s", "s", "adjusted standard GPS time of the shot; shots are 2.304 us apart"),
        *(column(f"{a}_m", "m", f"{a} of the surface point, wcs") for a in ("east", "north", "up")),
        column("material", "1", "material, numbers of the scene file; 255 is the own boat", pa.uint8()),
        column("return_number", "1", "1 is the nearest return of the shot", pa.uint8()),
        column("kind", "1", "0 surface, 1 mixed of several, 2 mirror ghost, 3 own boat", pa.uint8()),
    ],
)


class EchoKind(IntEnum):
    """What an echo is, for scoring filters."""

    SURFACE = 0
    MIXED = 1
    GHOST = 2
    HULL = 3


@dataclass(frozen=True, slots=True)
class ShotRandom:
    """Random numbers of one cause, by the number of the shot.

    Parameters
    ----------
    key : 64 bits that stand for seed and cause.
    """

    key: int

    @classmethod
    def of(cls, seed: int, cause: str) -> Self:
        """Numbers of a cause, for example ``"lidar noise"``."""
        return cls(int(generator(seed, cause).integers(0, 2**63)))

    def uniform(self, shot: ArrayI, count: int = 1) -> ArrayF:
        """Numbers (n, count) from [0, 1) for shots (n,).

        Examples
        --------
        >>> a = ShotRandom.of(1, "lidar noise")
        >>> bool(a.uniform(np.array([7]))[0, 0] == a.uniform(np.array([3, 7]), 2)[1, 0])
        True
        """
        out = np.empty((len(shot), count))
        _uniform(np.uint64(self.key), shot, out)
        return out

    def normal(self, shot: ArrayI, count: int = 1) -> ArrayF:
        """Standard normal numbers (n, count) for shots (n,), by Box and Muller (1958)."""
        out = np.empty((len(shot), count))
        _normal(np.uint64(self.key), shot, out)
        return out

    def exponential(self, shot: ArrayI, count: int = 1) -> ArrayF:
        """Numbers (n, count) of the exponential distribution with mean 1 for shots (n,)."""
        return np.asarray(-np.log1p(-self.uniform(shot, count)))


# ---------------------------------------------------------------- footprint


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
        t_hit_m=hits.t_hit_m[rows],
        primitive=hits.primitive[rows],
        single_normal=hits.single_normal[rows],
        single_uv=hits.single_uv[rows],
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
        range_m,
        energy * strength,
        point,
        normal,
        material,
        beam.pulse_m,
        beam.mixed,
        STEP_M,
        out.range_m,
        out.strength,
        out.point_wcs_m,
        out.material,
        out.kind,
    )
    return out


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
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


# ---------------------------------------------------------------- what a receiver makes of echoes


def limit(range_m: ArrayF, weakest: float) -> ArrayF:
    """Strength at the limit of detection; it grows with range squared (lidar equation, filled footprint)."""
    return np.asarray(weakest * (range_m / 100.0) ** 2)


def seen(
    strength: ArrayF, range_m: ArrayF, chance: ArrayF, *, weakest: float, width: float, dark_dropouts: bool
) -> ArrayB:
    """Which echoes are strong enough for their range.

    The receiver's noise has a standard deviation of ``width`` times the limit, so that a signal S passes the
    limit T with probability ``Phi((S / T - 1) / width)``.

    Parameters
    ----------
    strength, range_m : reflectance times cosine of incidence, and range; infinite ranges are not seen.
    chance : uniform random numbers of the same shape.
    weakest : strength that is just seen at 100 m.
    width : 0 gives a hard limit.
    dark_dropouts : false: all finite ranges are seen.
    """
    there = np.isfinite(range_m)
    if not dark_dropouts:
        return np.asarray(there)
    with np.errstate(divide="ignore", invalid="ignore"):
        margin = strength / limit(range_m, weakest) - 1.0
        if width == 0:
            return np.asarray(there & (margin >= 0))
        return np.asarray(there & (margin > -CERTAIN * width) & (chance < ndtr(margin / width)))


def range_sigma_m(range_m: ArrayF, strength: ArrayF, sigma_range_m: float, sigma_weak_m: float) -> ArrayF:
    """Standard deviation of the range noise of echoes.

    ``sigma^2 = sigma_range^2 + (sigma_weak (r / 100 m)^2 0.10 / strength)^2``: the error of timing a pulse
    goes with one over its power, and the power with strength over range squared.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        weak = sigma_weak_m * limit(range_m, WEAKEST) / strength
    return np.asarray(np.where(np.isfinite(range_m), np.hypot(sigma_range_m, weak), 0.0))


def quantise(echo: Echoes, noise_m: ArrayF, max_range_m: float) -> tuple[ArrayI, ArrayI]:
    """Distances (n, K) in units of 2 mm (0 = none) and reflectivity 1 to 100, as the sensor reports them."""
    measured = np.where(echo.there, echo.range_m, 0.0) + noise_m
    there = echo.there & (measured <= max_range_m) & (echo.range_m >= MIN_RANGE_M)
    distance = np.where(there, np.clip(np.rint(measured / 0.002), 0, 65535), 0).astype(np.int64)
    brightness = np.clip(np.rint(100.0 * echo.strength), 1, 100).astype(np.int64)
    return distance, np.where(distance > 0, brightness, 0)


def choose(distance: ArrayI, strength: ArrayF, returns: str) -> tuple[ArrayI, ArrayI]:
    """Which echoes of shots are reported.

    Parameters
    ----------
    distance : (n, K) measured distance, 0 where there is no echo; each row with at least one.
    strength : (n, K).
    returns : ``strongest``, ``last`` or ``dual``.

    Returns
    -------
    last, other : columns (n,). With ``dual`` the other one is the strongest, or the second strongest where
        the strongest is the last, and the same where there is one only (VLP-16 User Manual 63-9243 Rev. D,
        9.3.2). Otherwise both are the one that is reported.
    """
    power: AnyArray = np.where(distance > 0, strength, -1.0)
    strongest = np.argmax(power, axis=1)
    last = np.argmax(distance, axis=1)
    if returns == "strongest":
        return strongest, strongest
    if returns == "last":
        return last, last
    row = np.arange(len(distance))
    power[row, strongest] = -1.0
    second = np.argmax(power, axis=1)
    there = power[row, second] > 0
    return last, np.where((strongest == last) & there, second, strongest)


# ---------------------------------------------------------------- truth of single shots
#
# The point of a surface is where the echo arose in the footprint: the centre of energy of what the parts of
# the beam met, or the point of the brightest part if the twin makes no mixed pixels. The point of a mixed
# return lies between the surfaces, that of a ghost on the surface above the water that the mirrored beam
# came back from, and that of the own boat on the boat. The noise of the range is not in it; the beam's
# offset across itself is.
#
# A long recording has more shots than anybody needs to judge it by, so the truth is kept of whole packets
# drawn at random: each with the same chance, such that about 2.5 million shots are drawn, or all if there
# are fewer. The chance (``share``), the number of packets fired and of those drawn stand in the table's
# facts. A packet that is not drawn has no rows; a shot of a drawn packet has a row for each of its returns,
# so none if it has no return. Packets that the log lost later may be among them.


def drawn_packets(seed: int, n_packets: int, shots_per_packet: int) -> tuple[ArrayB, float]:
    """Which packets (n_packets,) keep the truth of their shots, and the chance that each of them had."""
    share = min(1.0, MANY_SHOTS / max(n_packets * shots_per_packet, 1))
    return generator(seed, "lidar truth packets").random(n_packets) < share, share


class ShotWriter:
    """Writes table kind ``twin_lidar_shots`` piece by piece; does nothing without a path.

    Parameters
    ----------
    path : target, ``.parquet``, or None.
    facts : JSON-able facts of the whole table.
    """

    def __init__(self, path: Path | None, facts: Mapping[str, Any]) -> None:
        self._writer: pq.ParquetWriter | None = None
        meta = json.dumps(dict(facts)).encode()
        self._schema = LIDAR_SHOTS.with_metadata({**(LIDAR_SHOTS.metadata or {}), b"meta": meta})
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(path, self._schema, compression="zstd")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.close()

    def add(
        self, t_gps_s: ArrayF, point_wcs_m: ArrayF, material: ArrayU8, return_number: AnyArray, kind: ArrayU8
    ) -> None:
        """Add returns: (n,) times, (n, 3) points, (n,) materials, numbers and kinds."""
        if self._writer is None:
            return
        arrays = [t_gps_s, *point_wcs_m.T, material, return_number.astype("uint8"), kind]
        columns = [pa.array(a, type=f.type) for a, f in zip(arrays, self._schema, strict=True)]
        self._writer.write_table(pa.Table.from_arrays(columns, schema=self._schema))


# ---------------------------------------------------------------- random numbers of single shots
#
# A stream that is drawn one number after the other shifts as soon as one shot draws more or fewer than
# before. Here each number is a hash of its place (counter-based generator; Salmon et al. 2011), so that
# switching one effect leaves the numbers of all others as they were, only the shots that need numbers pay
# for them, and the size of the pieces that a recording is made in does not matter. The hash is the
# finaliser of SplitMix64 (Steele, Lea and Flood 2014), applied twice.


@njit(cache=True, error_model="numpy", inline="always")
def _hashed(key: Any, shot: Any, place: Any) -> float:
    """A number from [0, 1) of 53 bits."""
    z = key + np.uint64(shot) * np.uint64(0x9E3779B97F4A7C15)
    for _ in range(2):
        z += np.uint64(place + 1) * np.uint64(0xD1B54A32D192ED03)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit(cache=True, error_model="numpy")
def _uniform(key: Any, shot: ArrayI, out: ArrayF) -> None:
    for i in range(len(shot)):
        for k in range(out.shape[1]):
            out[i, k] = _hashed(key, shot[i], k)


@njit(cache=True, error_model="numpy")
def _normal(key: Any, shot: ArrayI, out: ArrayF) -> None:
    for i in range(len(shot)):
        for k in range(0, out.shape[1], 2):
            # 1 - u is never zero, so that its logarithm is finite.
            length = np.sqrt(-2.0 * np.log(1.0 - _hashed(key, shot[i], k)))
            angle = 2.0 * np.pi * _hashed(key, shot[i], k + 1)
            out[i, k] = length * np.cos(angle)
            if k + 1 < out.shape[1]:
                out[i, k + 1] = length * np.sin(angle)
