"""A slow and clear intersection with many digits, to check the fast one.

Everything is done in another way: decimal numbers instead of floats, vectors and Snell's law step by step
instead of the conserved ``q``, halving of a signed volume instead of Newton's steps. Fifty milliseconds a
pixel; lenses without distortion only. It needs a fan that reaches the water as a whole.
"""

from dataclasses import dataclass
from decimal import Decimal, localcontext
from typing import Final

from thalweg.core import GeometryError
from thalweg.lightsheet.optics import Sensor

DIGITS: Final = 40
_SAMPLES: Final = 64

Vector = tuple[Decimal, Decimal, Decimal]
Matrix = tuple[Vector, Vector, Vector]


@dataclass(frozen=True, slots=True, kw_only=True)
class ExactPoint:
    """Point of the sheet on a ray: lcs, depth below the outer face, fan angle; with `DIGITS` digits."""

    xyz_lcs_mm: Vector
    depth_mm: Decimal
    fan_angle_rad: Decimal


def intersect_exactly(sensor: Sensor, x_px: float, y_px: float) -> ExactPoint | None:
    """The point of one pixel, the nearest one in the water; None where there is none.

    Raises
    ------
    GeometryError : a lens with distortion.
    """
    fx, fy, cx, cy, *distortion = (Decimal(float(p)) for p in sensor.camera.parameters)
    if any(distortion):
        raise GeometryError("a lens with distortion", expected="one without, for the reference")
    with localcontext() as context:
        context.prec = DIGITS + 10
        plate = _plate(sensor)
        R = _camera_rotation(sensor)
        ray = (_plain(x_px, cx) / fx, _plain(y_px, cy) / fy, Decimal(1))
        camera = _to_water(_vector(sensor.camera_origin_lcs_mm), _unit(_times(R, ray)), plate)
        if camera is None:
            return None
        L = _opk(*(Decimal(float(angle)) for angle in sensor.sheet.angles_rad))
        half, v = Decimal(float(sensor.sheet.half_angle_rad)), Decimal(float(sensor.sheet.v))
        origin = _vector(sensor.sheet.origin_lcs_mm)

        def beam(a: Decimal) -> tuple[Vector, Vector] | None:
            s = _sine(a)
            return _to_water(origin, _times(L, (s, v, -(1 - s * s - v * v).sqrt())), plate)

        def volume(a: Decimal) -> Decimal | None:
            other = beam(a)
            if other is None:
                return None
            across = _cross(camera[1], other[1])
            return _dot(_minus(other[0], camera[0]), across)

        steps = [half * (2 * k - _SAMPLES) / _SAMPLES for k in range(_SAMPLES + 1)]
        values = [volume(a) for a in steps]
        found: list[ExactPoint] = []
        for low, high, f_low, f_high in zip(steps, steps[1:], values, values[1:], strict=False):
            if f_low is None or f_high is None or f_low * f_high > 0:
                continue
            a = _halve(volume, low, high, f_low)
            point = _nearest(camera, beam(a))
            depth = -_dot(point, plate[0]) - plate[1]
            found.append(ExactPoint(xyz_lcs_mm=point, depth_mm=depth, fan_angle_rad=a))
        wet = [point for point in found if point.depth_mm >= 0]
        return min(wet, key=lambda point: point.depth_mm) if wet else None


def _halve(volume, low: Decimal, high: Decimal, f_low: Decimal) -> Decimal:  # type: ignore[no-untyped-def]
    while high - low > Decimal(10) ** -DIGITS:
        middle = (low + high) / 2
        f = volume(middle)
        if f * f_low > 0:
            low = middle
        else:
            high = middle
    return (low + high) / 2


def _to_water(
    origin: Vector, direction: Vector, plate: tuple[Vector, Decimal, tuple[Decimal, Decimal, Decimal]]
) -> tuple[Vector, Vector] | None:
    """Point on the outer face and unit direction in the water of a ray in air."""
    N, thickness, (n_air, n_glass, n_water) = plate
    if _dot(direction, N) >= 0:
        return None
    inner = _plus(origin, _scaled(direction, -_dot(origin, N) / _dot(direction, N)))
    glass = _refract(direction, N, n_air / n_glass)
    if glass is None:
        return None
    outer = _plus(inner, _scaled(glass, -thickness / _dot(glass, N)))
    water = _refract(glass, N, n_glass / n_water)
    return None if water is None else (outer, water)


def _refract(v: Vector, N: Vector, r: Decimal) -> Vector | None:
    c = -_dot(N, v)
    square = 1 - r * r * (1 - c * c)
    return None if square < 0 else _plus(_scaled(v, r), _scaled(N, r * c - square.sqrt()))


def _nearest(camera: tuple[Vector, Vector], beam: tuple[Vector, Vector] | None) -> Vector:
    """The point of the image ray that is nearest to the sub-beam."""
    assert beam is not None
    (P, p), (Q, q) = camera, beam
    off, pq = _minus(Q, P), _dot(p, q)
    return _plus(P, _scaled(p, (_dot(off, p) - _dot(off, q) * pq) / (1 - pq * pq)))


def _plate(sensor: Sensor) -> tuple[Vector, Decimal, tuple[Decimal, Decimal, Decimal]]:
    w = sensor.window
    x, y = Decimal(float(w.tilt_x_rad)), Decimal(float(w.tilt_y_rad))
    N = _times(_opk(x, y, Decimal(0)), (Decimal(0), Decimal(0), Decimal(1)))
    return N, Decimal(w.thickness_mm), (Decimal(w.n_air), Decimal(w.n_glass), Decimal(w.n_water))


def _camera_rotation(sensor: Sensor) -> Matrix:
    R = _opk(*(Decimal(float(angle)) for angle in sensor.camera_angles_rad))
    a, b, c = ((row[0], -row[1], -row[2]) for row in R)
    return a, b, c


def _opk(omega: Decimal, phi: Decimal, kappa: Decimal) -> Matrix:
    sw, cw, sp, cp, sk, ck = (f(angle) for angle in (omega, phi, kappa) for f in (_sine, _cosine))
    return (
        (cp * ck, -cp * sk, sp),
        (cw * sk + sw * sp * ck, cw * ck - sw * sp * sk, -sw * cp),
        (sw * sk - cw * sp * ck, sw * ck + cw * sp * sk, cw * cp),
    )


def _sine(a: Decimal) -> Decimal:
    """Taylor's series; the angles here are a few radians at most."""
    total = term = a
    k = 1
    while abs(term) > Decimal(10) ** -(DIGITS + 8):
        term *= -a * a / ((k + 1) * (k + 2))
        total += term
        k += 2
    return total


def _cosine(a: Decimal) -> Decimal:
    half = _sine(a / 2)
    return 1 - 2 * half * half


def _plain(value: float, origin: Decimal) -> Decimal:
    return Decimal(float(value)) - origin


def _vector(values) -> Vector:  # type: ignore[no-untyped-def]
    x, y, z = (Decimal(float(value)) for value in values)
    return x, y, z


def _dot(a: Vector, b: Vector) -> Decimal:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _scaled(a: Vector, s: Decimal) -> Vector:
    return a[0] * s, a[1] * s, a[2] * s


def _unit(a: Vector) -> Vector:
    return _scaled(a, 1 / _dot(a, a).sqrt())


def _times(M: Matrix, a: Vector) -> Vector:
    return _dot(M[0], a), _dot(M[1], a), _dot(M[2], a)
