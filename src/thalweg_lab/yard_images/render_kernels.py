"""Loops over the pixels of a picture of the yard: edges, shadows, light."""

import numba as nb
import numpy as np

from thalweg.core.types import ArrayB, ArrayF, ArrayF32, ArrayI, ArrayU8

# Open3D brings an old TBB into the process, which numba would try first and complain about.
nb.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]


def turned(rays_ccs: ArrayF32, R_wcs_ccs: ArrayF) -> ArrayF32:
    """Rays (n, 3) in wcs."""
    out = np.empty_like(rays_ccs)
    _turned(rays_ccs, np.ascontiguousarray(R_wcs_ccs), out)
    return out


def edges(
    eye: ArrayF, rays: ArrayF32, t_m: ArrayF32, primitive: ArrayI, thing: ArrayI, normal: ArrayF32
) -> ArrayB:
    """Pixels (h, w) that meet another surface than a neighbour does.

    Parameters
    ----------
    eye : (3,) projection centre.
    rays : (h, w, 3) directions.
    t_m : (h, w) distances.
    primitive : (h, w) triangles, -1 for none.
    thing : (m,) thing of each triangle.
    normal : (m, 3) of each triangle.
    """
    out = np.zeros(t_m.shape, dtype=np.bool_)
    _edges(eye, rays, t_m, primitive, thing, normal, out)
    return out


def unlike_corners(state: ArrayU8, primitive: ArrayI, thing: ArrayI, step: int) -> tuple[ArrayU8, ArrayB]:
    """Shadow of all pixels from that of some, and which pixels need a ray of their own.

    Parameters
    ----------
    state : (a, b) 0 shade, 1 sun, 2 nothing met: of each ``step``-th pixel in each direction.
    primitive : (h, w) triangle of each pixel, -1 for none.
    thing : (m,) thing of each triangle.
    step : between known pixels.
    """
    out = np.zeros(primitive.shape, dtype=np.uint8)
    open_ = np.zeros(primitive.shape, dtype=np.bool_)
    _unlike(state, primitive, thing, step, out, open_)
    return out, open_


def surface_light(
    albedo: ArrayF32,
    normal: ArrayF32,
    sunlit: ArrayF32,
    open_sky: ArrayF32,
    sun: ArrayF,
    sun_colour: ArrayF,
    sky_colour: ArrayF,
    ground_colour: ArrayF,
) -> ArrayF32:
    """Light (n, 3) from matt surfaces.

    Parameters
    ----------
    albedo, normal : (n, 3) colours and normals toward the viewer.
    sunlit, open_sky : (n,) share of the sun and of the sky that is not hidden.
    sun : (3,) direction.
    sun_colour, sky_colour, ground_colour : (3,) light of sun, sky and of the ground around.
    """
    out = np.empty_like(albedo)
    _lit(albedo, normal, sunlit, open_sky, sun, sun_colour, sky_colour, ground_colour, out)
    return out


@nb.njit(cache=True, error_model="numpy", parallel=True)
def _turned(rays, R, out):  # type: ignore[no-untyped-def]
    for i in nb.prange(len(rays)):
        x, y, z = np.float64(rays[i, 0]), np.float64(rays[i, 1]), np.float64(rays[i, 2])
        for k in range(3):
            out[i, k] = R[k, 0] * x + R[k, 1] * y + R[k, 2] * z


@nb.njit(cache=True, error_model="numpy", inline="always")
def _differ(eye, rays, t, primitive, thing, normal, y0, x0, y1, x1):  # type: ignore[no-untyped-def]
    a, b = primitive[y0, x0], primitive[y1, x1]
    if a == b:
        return False
    if a < 0 or b < 0 or thing[a] != thing[b]:
        return True
    alike = normal[a, 0] * normal[b, 0] + normal[a, 1] * normal[b, 1] + normal[a, 2] * normal[b, 2]
    if alike < 0.97:
        return True
    off, way = 0.0, 0.0
    for k in range(3):
        d = t[y1, x1] * rays[y1, x1, k] - t[y0, x0] * rays[y0, x0, k]
        off += d * normal[a, k]
        way += d * d
    return abs(off) > 0.001 + 0.25 * np.sqrt(way)


@nb.njit(cache=True, error_model="numpy", parallel=True)
def _edges(eye, rays, t, primitive, thing, normal, out):  # type: ignore[no-untyped-def]
    h, w = t.shape
    for y in nb.prange(h):
        for x in range(w):
            found = False
            if x + 1 < w:
                found = _differ(eye, rays, t, primitive, thing, normal, y, x, y, x + 1)
            if not found and x > 0:
                found = _differ(eye, rays, t, primitive, thing, normal, y, x, y, x - 1)
            if not found and y + 1 < h:
                found = _differ(eye, rays, t, primitive, thing, normal, y, x, y + 1, x)
            if not found and y > 0:
                found = _differ(eye, rays, t, primitive, thing, normal, y, x, y - 1, x)
            out[y, x] = found


@nb.njit(cache=True, error_model="numpy", parallel=True)
def _unlike(state, primitive, thing, step, out, open_):  # type: ignore[no-untyped-def]
    h, w = primitive.shape
    rows, columns = state.shape
    for y in nb.prange(h):
        for x in range(w):
            p = primitive[y, x]
            if p < 0:
                continue
            j, i = y // step, x // step
            j1 = min(j + 1, rows - 1) if y % step else j
            i1 = min(i + 1, columns - 1) if x % step else i
            s = state[j, i]
            same = s != 2 and state[j, i1] == s and state[j1, i] == s and state[j1, i1] == s
            if same:
                for a in (j, j1):
                    for b in (i, i1):
                        q = primitive[a * step, b * step]
                        same = same and q >= 0 and thing[q] == thing[p]
            if same:
                out[y, x] = s
            else:
                open_[y, x] = True


@nb.njit(cache=True, error_model="numpy", parallel=True)
def _lit(albedo, normal, sunlit, open_sky, sun, sun_colour, sky, ground, out):  # type: ignore[no-untyped-def]
    for i in nb.prange(len(albedo)):
        facing = normal[i, 0] * sun[0] + normal[i, 1] * sun[1] + normal[i, 2] * sun[2]
        direct = max(facing, 0.0) * sunlit[i]
        up = 0.5 + 0.5 * normal[i, 2]
        for k in range(3):
            around = open_sky[i] * (up * sky[k] + (1 - up) * ground[k])
            out[i, k] = albedo[i, k] * (direct * sun_colour[k] + around)
