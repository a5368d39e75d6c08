"""Places of a line to sub-pixels, in compiled loops: Gaussian patches.

**Patches** are fitted by weighted least squares. Around a start, with ``n`` across and ``t`` along the line
::

    mu(n, t) = b + a_t (exp(-2 d^2 / w^2) + h H(d)),        d = n - m - s t

``m`` is the wanted place, ``w`` the half width at 1/e^2 (scale of least-squares matching), ``s`` the slope
inside the patch, ``b`` the background. ``H`` is the halo that some surfaces add on one side (see `halo`),
with its share ``h``; without it neither is in the model. The peak ``a`` is one for the patch, or one for
each row and eliminated from the normal equations (speckle and albedo change it from row to row).

With speckle weights a pixel weighs 1 / (read^2 + (wings a)^2 + photon mu + contrast^2 (mu - b)^2): the
score of a gamma distribution (quasi-likelihood; McCullagh and Nelder 1989, 9), for which flanks say as much
as the peak. Weights follow the model, not the grey values, so they do not pull; ``wings`` is where a
Gaussian ends and the diffraction's wings begin. The sigma of ``m`` is not that of the weights but ::

    sigma^2 = sum_ij u_i u_j s_i s_j rho_ij,        u = dm / dpixel

with the scatter ``s`` of each pixel and the correlation ``rho`` of neighbours; so it holds for any weights.
Saturated pixels say that the light was at least so much: they pull where the model lies below, else not.

Where no model of the noise is known (daylight taken away, Bayer interpolation, JPEG) the residuals ``r`` tell
the variance of ``m``, whatever their scatter and correlation, by what each row contributes (Newey and West
1987) ::

    v = sum_ij (1 - |i - j| / 6) S_i S_j / f,       S_i = sum_c u_ic r_ic,       |i - j| < 6

The fit has made the ``n`` sums of rows add up to zero; by ``f = 1 - sum_ij (1 - |i - j| / 6) / n^2`` they are
too small for that. Few rows tell a single ``v`` badly: neighbours along a line are to be averaged.
"""

from typing import Final

import numpy as np

from thalweg.core import AnyArray, ArrayF, ArrayF32, ArrayI, ArrayU8, njit

MEAN, SIGMA, WIDTH, PEAK, BACKGROUND, SLOPE, MISFIT, PIXELS, SATURATED_PIXELS, HALO, DEVIANCE, SEEN = range(
    12
)
"""Columns of what `fit_patches` returns; a place that did not converge is NaN. ``SEEN``: variance of the
place as the residuals show it, see the module.
"""
_NEAR_ROWS: Final = 5
"""Rows over which residuals count as correlated: interpolation of colours and compression, blocks of 8."""


@njit(cache=True, error_model="numpy", nogil=True)
def fit_patches(
    dn: ArrayF32,
    bits: ArrayU8,
    row: ArrayI,
    x_px: ArrayF,
    rows: ArrayI,
    ranges: ArrayI,
    guess: ArrayF,
    start_slope: ArrayF,
    half_across: ArrayF,
    half_width: ArrayF,
    free_slope: AnyArray,
    speckle_weights: bool,
    peak_per_row: bool,
    measured_only: bool,
    noise: ArrayF,
    rho: ArrayF,
    saturation: float,
    table: ArrayF,
    iterations: int,
) -> ArrayF:
    """Fit a patch at each start; returns (n, 12), see `MEAN`.

    Parameters
    ----------
    dn, bits : green image, bits 1 measured and 2 saturated.
    row, x_px : (n,) row index and place in the row.
    rows, ranges, guess : from `windows.patch_windows`.
    start_slope : (n,) slope to start from, or to keep where ``free_slope`` is false; across per along.
    half_across : (n,) half width of the patch.
    half_width : (n,) typical half width of the line: start and weak observation (30 %) of ``w``.
    free_slope : (n,) whether the slope is unknown.
    speckle_weights, peak_per_row : see the module.
    measured_only : whether interpolated pixels are left out.
    noise : read^2, photon, contrast^2, wings. rho : correlation of the speckle.
    saturation : grey value from which on a pixel is saturated.
    table : halo as `halo.halo_table` makes it, (1, 2) for none.
    """
    n = row.size
    out = np.full((n, 12), np.nan)
    longest, widest = ranges.shape[1], 1
    for i in range(n):
        used = ranges[i, : rows[i, 1] - rows[i, 0]]
        widest = max(widest, int(np.max(used[:, 1]) - np.min(used[:, 0])))
    grid = np.zeros((longest, widest))
    peak, aa, ga, sums = np.empty(longest), np.empty(longest), np.empty(longest), np.empty(longest)
    ap = np.empty((longest, 5))
    normal, g, step, unit = np.empty((5, 5)), np.empty(5), np.zeros(5), np.zeros(5)
    unit[0] = 1.0
    par, frame, scatter = np.zeros(5), np.empty(2), np.empty(3)
    with_halo = table.shape[0] > 2
    for i in range(n):
        frame[0], frame[1] = row[i], x_px[i]
        h_n, slope = half_across[i], start_slope[i]
        top, count = rows[i, 0], rows[i, 1] - rows[i, 0]
        a, b, lowest, highest, pixels = guess[i]
        if pixels < 6:
            continue
        one_peak = not peak_per_row
        bins = 1 if one_peak else count
        peak[:bins] = a
        par[0], par[1], par[2], par[3], par[4] = 0.0, half_width[i], b, slope, 0.0
        scatter[1], scatter[2] = noise[1], noise[2]
        scatter[0] = noise[0] + (noise[3] * a) ** 2
        constant = 1.0 / (scatter[0] + noise[1] * max(b + 0.5 * a, 0.0) + noise[2] * 0.25 * a * a)
        n_par = 5 if with_halo else (4 if free_slope[i] else 3)
        converged = last = False
        for turn in range(iterations + 1):
            _accumulate(
                dn,
                bits,
                top,
                count,
                ranges[i],
                frame,
                par,
                peak,
                one_peak,
                speckle_weights,
                constant,
                measured_only,
                scatter,
                saturation,
                table,
                normal,
                g,
                aa,
                ga,
                ap,
            )
            for z in range(bins):
                if aa[z] > 0.0:
                    for p in range(n_par):
                        g[p] -= ap[z, p] * ga[z] / aa[z]
                        for k in range(n_par):
                            normal[p, k] -= ap[z, p] * ap[z, k] / aa[z]
            # weak observations: the usual width to 30 %, the slope to 0.5, no halo to 0.2
            normal[1, 1] += 1.0 / 0.09
            g[1] += (np.log(half_width[i]) - np.log(par[1])) / 0.09
            normal[2, 2] += 1e-9 * constant
            if n_par > 3:
                # a slope that must stay is observed very well
                stiff = 4.0 if free_slope[i] else 1e12
                normal[3, 3] += stiff
                g[3] += (slope - par[3]) * stiff
            if with_halo:
                normal[4, 4] += 1.0 / 0.04
                g[4] -= par[4] / 0.04
            if last:
                break
            for p in range(n_par):
                normal[p, p] *= 1.02
            step[3:] = 0.0
            if not _solve(normal, g, step, n_par):
                break
            shrink = max(1.0, abs(step[0]) / (0.4 * par[1]), abs(step[1]) / 0.3)
            step /= shrink
            par[0] += step[0]
            par[1] = min(max(par[1] * np.exp(step[1]), 0.5), 4.0 * h_n + 1.0)
            par[2] = min(max(par[2] + step[2], lowest - 0.1 * (highest - lowest)), highest)
            par[3] += step[3]
            par[4] = min(max(par[4] + step[4], -0.05), 1.0)
            a = 0.0
            for z in range(bins):
                if aa[z] > 0.0:
                    change = ga[z] / (aa[z] * shrink)
                    for p in range(n_par):
                        change -= ap[z, p] * step[p] / aa[z]
                    peak[z] = min(max(peak[z] + change, 0.25 * peak[z]), 4.0 * peak[z])
                    a = max(a, peak[z])
            for z in range(bins):
                peak[z] = max(peak[z], 0.01 * a, 1e-6)
            if not abs(par[0]) <= h_n:
                break
            settled = abs(step[0]) < 5e-4 and abs(step[1]) < 5e-3 and turn > 1
            # slow but bounded: the last step says how well it stands
            if settled or (turn == iterations - 1 and abs(step[0]) < 0.05):
                converged = last = True
        step[3:] = 0.0
        if converged and _solve(normal, unit, step, n_par):
            _report(
                dn,
                bits,
                top,
                count,
                ranges[i],
                frame,
                par,
                peak,
                one_peak,
                speckle_weights,
                constant,
                measured_only,
                scatter,
                saturation,
                table,
                rho,
                aa,
                ap,
                step,
                grid,
                sums,
                out[i],
            )
    return out


@njit(cache=True, error_model="numpy", nogil=True)
def _solve(a: ArrayF, g: ArrayF, out: ArrayF, n: int) -> bool:
    """Solve a positive definite system of up to five unknowns by Cholesky; false if it is not definite."""
    low = np.zeros((5, 5))
    for i in range(n):
        for j in range(i + 1):
            total = a[i, j]
            for k in range(j):
                total -= low[i, k] * low[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                low[i, i] = np.sqrt(total)
            else:
                low[i, j] = total / low[j, j]
    for i in range(n):
        total = g[i]
        for k in range(i):
            total -= low[i, k] * out[k]
        out[i] = total / low[i, i]
    for i in range(n - 1, -1, -1):
        total = out[i]
        for k in range(i + 1, n):
            total -= low[k, i] * out[k]
        out[i] = total / low[i, i]
    return True


@njit(cache=True, error_model="numpy", nogil=True)
def _correlated(v: ArrayF, rows: int, columns: int, rho: ArrayF) -> float:
    """Sum over all pairs of v_i v_j rho_ij on a grid; rho (lag + 1, 2 lag + 1) by rows down, columns
    across.
    """
    lag = rho.shape[0] - 1
    total = 0.0
    for i in range(rows):
        for j in range(columns):
            value = v[i, j]
            if value == 0.0:
                continue
            total += value * value
            near = 0.0
            for q in range(1, lag + 1):
                if j + q < columns:
                    near += rho[0, lag + q] * v[i, j + q]
            for p in range(1, lag + 1):
                if i + p >= rows:
                    break
                for q in range(-lag, lag + 1):
                    if 0 <= j + q < columns:
                        near += rho[p, lag + q] * v[i + p, j + q]
            total += 2.0 * value * near
    return total


@njit(inline="always", cache=True, error_model="numpy", nogil=True)
def _halo(table: ArrayF, d: float) -> tuple[float, float]:
    """Value and slope of the halo at a distance from the line's centre, linear in the table."""
    at = (d + table[0, 0]) * table[0, 1]
    k = int(at)
    if at < 0.0 or k + 2 >= table.shape[0]:
        return 0.0, 0.0
    part = at - k
    value = table[k + 1, 0] + part * (table[k + 2, 0] - table[k + 1, 0])
    return value, table[k + 1, 1] + part * (table[k + 2, 1] - table[k + 1, 1])


@njit(cache=True, error_model="numpy", nogil=True, fastmath={"contract", "reassoc", "nsz"})
def _accumulate(
    dn: ArrayF32,
    bits: ArrayU8,
    top: int,
    count: int,
    ranges: ArrayI,
    frame: ArrayF,
    par: ArrayF,
    peak: ArrayF,
    one_peak: bool,
    speckle: bool,
    constant: float,
    measured_only: bool,
    noise: ArrayF,
    saturation: float,
    table: ArrayF,
    normal: ArrayF,
    g: ArrayF,
    aa: ArrayF,
    ga: ArrayF,
    ap: ArrayF,
) -> None:
    """Normal equations of a patch: ``normal`` (5, 5) and ``g`` of m, ln w, b, s, h; ``aa, ga, ap`` of the
    peaks.

    ``frame``: row, x. ``par``: m, w, b, s, h. Along a row the exponential follows by two
    products, because its argument is quadratic.
    """
    m, w, b, s, h = par[0], par[1], par[2], par[3], par[4]
    with_halo = table.shape[0] > 2
    read2, photon, contrast2 = noise[0], noise[1], noise[2]
    f = 2.0 / (w * w)
    growth = np.exp(-2.0 * f)
    normal[:] = 0.0
    g[:] = 0.0
    aa[: 1 if one_peak else count] = 0.0
    ga[: 1 if one_peak else count] = 0.0
    ap[: 1 if one_peak else count] = 0.0
    n00 = n01 = n02 = n03 = n11 = n12 = n13 = n22 = n23 = n33 = 0.0
    g0 = g1 = g2 = g3 = g4 = n04 = n14 = n24 = n34 = n44 = 0.0
    for i in range(count):
        z = 0 if one_peak else i
        height = peak[z]
        a00 = ag = a0 = a1 = a2 = a3 = a4 = 0.0
        first = ranges[i, 0]
        along = top + i - frame[0]
        d = first + 0.5 - frame[1] - m - s * along
        e = np.exp(-f * d * d)
        q = np.exp(-f * (2.0 * d + 1.0))
        for c in range(first, ranges[i, 1]):
            if e < 1e-30:
                e = np.exp(-f * d * d)
                q = np.exp(-f * (2.0 * d + 1.0))
            flag = bits[top + i, c]
            if not measured_only or flag & 1:
                shape = e
                j4 = extra = 0.0
                if with_halo:
                    value, rise = _halo(table, d)
                    shape += h * value
                    j4 = height * value
                    extra = -height * h * rise
                light = height * shape
                mu = b + light
                weight = constant
                if speckle:
                    weight = 1.0 / (read2 + photon * max(mu, 0.0) + contrast2 * light * light)
                if flag & 2 and mu >= saturation:
                    weight = 0.0
                residual = dn[top + i, c] - mu
                core = 2.0 * f * height * e * d
                j0 = core + extra
                j1 = core * d  # by ln w
                j3 = j0 * along
                w0 = weight * j0
                w1 = weight * j1
                w3 = weight * j3
                we = weight * shape
                n00 += w0 * j0
                n01 += w0 * j1
                n02 += w0
                n03 += w0 * j3
                n11 += w1 * j1
                n12 += w1
                n13 += w1 * j3
                n22 += weight
                n23 += w3
                n33 += w3 * j3
                g0 += w0 * residual
                g1 += w1 * residual
                g2 += weight * residual
                g3 += w3 * residual
                a00 += we * shape
                ag += we * residual
                a0 += we * j0
                a1 += we * j1
                a2 += we
                a3 += we * j3
                if with_halo:
                    w4 = weight * j4
                    n04 += w4 * j0
                    n14 += w4 * j1
                    n24 += w4
                    n34 += w4 * j3
                    n44 += w4 * j4
                    g4 += w4 * residual
                    a4 += we * j4
            e *= q
            q *= growth
            d += 1.0
        aa[z] += a00
        ga[z] += ag
        ap[z, 0] += a0
        ap[z, 1] += a1
        ap[z, 2] += a2
        ap[z, 3] += a3
        ap[z, 4] += a4
    normal[0, 0], normal[0, 1], normal[0, 2], normal[0, 3] = n00, n01, n02, n03
    normal[1, 1], normal[1, 2], normal[1, 3] = n11, n12, n13
    normal[2, 2], normal[2, 3], normal[3, 3] = n22, n23, n33
    normal[0, 4], normal[1, 4], normal[2, 4], normal[3, 4], normal[4, 4] = n04, n14, n24, n34, n44
    g[0], g[1], g[2], g[3], g[4] = g0, g1, g2, g3, g4
    for p in range(5):
        for k in range(p):
            normal[p, k] = normal[k, p]


@njit(cache=True, error_model="numpy", nogil=True)
def _report(
    dn: ArrayF32,
    bits: ArrayU8,
    top: int,
    count: int,
    ranges: ArrayI,
    frame: ArrayF,
    par: ArrayF,
    peak: ArrayF,
    one_peak: bool,
    speckle: bool,
    constant: float,
    measured_only: bool,
    noise: ArrayF,
    saturation: float,
    table: ArrayF,
    rho: ArrayF,
    aa: ArrayF,
    ap: ArrayF,
    inverse: ArrayF,
    grid: ArrayF,
    sums: ArrayF,
    out: ArrayF,
) -> None:
    """Sigma of m by the influence of each pixel on it; misfit, saturated pixels, peaks, variance seen."""
    m, w, b, s, h = par[0], par[1], par[2], par[3], par[4]
    left = ranges[0, 0]
    right = ranges[0, 1]
    for i in range(count):
        left = min(left, ranges[i, 0])
        right = max(right, ranges[i, 1])
    right = min(right, left + grid.shape[1])
    grid[:count, : right - left] = 0.0
    independent = misfit = deviance = 0.0
    pixels = saturated = 0
    f = 2.0 / (w * w)
    contrast = np.sqrt(noise[2])
    for i in range(count):
        z = 0 if one_peak else i
        along = top + i - frame[0]
        sums[i] = 0.0
        for c in range(ranges[i, 0], min(ranges[i, 1], right)):
            flag = bits[top + i, c]
            if measured_only and flag & 1 == 0:
                continue
            d = c + 0.5 - frame[1] - m - s * along
            e = np.exp(-f * d * d)
            value, rise = _halo(table, d)
            shape = e + h * value
            light = peak[z] * shape
            mu = b + light
            scatter2 = noise[0] + noise[1] * max(mu, 0.0)
            weight = 1.0 / (scatter2 + noise[2] * light * light) if speckle else constant
            pixels += 1
            if flag & 2:
                if abs(d) < w:
                    saturated += 1
                if mu >= saturation:
                    continue
            core = 2.0 * f * peak[z] * e * d
            j0 = core - peak[z] * h * rise
            share = shape / aa[z] if aa[z] > 0.0 else 0.0
            influence = inverse[0] * (j0 - share * ap[z, 0]) + inverse[1] * (core * d - share * ap[z, 1])
            influence += inverse[2] * (1.0 - share * ap[z, 2]) + inverse[3] * (j0 * along - share * ap[z, 3])
            influence += inverse[4] * (peak[z] * value - share * ap[z, 4])
            influence *= weight
            independent += influence * influence * scatter2
            # clipped light scatters less
            grid[i, c - left] = influence * contrast * light * (0.5 if flag & 2 else 1.0)
            residual = dn[top + i, c] - mu
            sums[i] += influence * residual
            variance = scatter2 + noise[2] * light * light
            misfit += residual * residual / variance
            deviance += residual * residual / variance + np.log(variance)
    centre = 0 if one_peak else min(max(int(frame[0]) - top, 0), count - 1)
    out[0] = m
    out[1] = np.sqrt(independent + _correlated(grid, count, right - left, rho))
    out[2] = w
    out[3] = peak[centre]
    out[4] = b
    out[5] = s
    out[6] = misfit / max(pixels, 1)
    out[7] = pixels
    out[8] = saturated
    out[9] = h
    out[10] = deviance
    seen, pairs = 0.0, 0.0
    for i in range(count):
        for k in range(max(0, i - _NEAR_ROWS), min(count, i + _NEAR_ROWS + 1)):
            near = 1.0 - abs(i - k) / (_NEAR_ROWS + 1.0)
            seen += near * sums[i] * sums[k]
            pairs += near
    if count > 2 * _NEAR_ROWS:
        out[11] = seen / (1.0 - pairs / count**2)
