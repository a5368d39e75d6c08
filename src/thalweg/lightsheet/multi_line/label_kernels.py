"""Compiled loops of the line assignment: linking, rows, and the map of what is occupied and what is free."""

import numba as nb
import numpy as np

from thalweg.core.types import ArrayF, ArrayI, ArrayU8


@nb.njit(cache=True, nogil=True, error_model="numpy")
def link_rows(row: ArrayI, x: ArrayF, row_step: int, tolerance_px: float, gap_rows: int) -> ArrayI:
    """Number of the segment of each detection, linked from row to row.

    Detections (n,) are ordered by row. A segment goes on with the nearest detection to where its slope
    leads, if both are nearest to each other; it ends after ``gap_rows`` steps without one.
    """
    n = len(row)
    segment = np.full(n, -1, dtype=np.int64)
    last_row = np.empty(n, dtype=np.int64)
    last_x, slope = np.empty(n), np.empty(n)
    active = np.empty(n, dtype=np.int64)
    n_active, n_segments, i = 0, 0, 0
    while i < n:
        k = i
        while k < n and row[k] == row[i]:
            k += 1
        kept = 0
        for q in range(n_active):
            if row[i] - last_row[active[q]] <= gap_rows * row_step:
                active[kept] = active[q]
                kept += 1
        n_active = kept
        best_of = np.full(n_active, -1, dtype=np.int64)
        for q in range(n_active):
            s = active[q]
            steps = (row[i] - last_row[s]) / row_step
            limit = tolerance_px * (1.0 + 0.5 * (steps - 1.0))
            place = last_x[s] + slope[s] * (row[i] - last_row[s])
            nearest = limit
            for m in range(i, k):
                if abs(x[m] - place) < nearest:
                    nearest, best_of[q] = abs(x[m] - place), m
        for m in range(i, k):
            chosen, nearest = -1, np.inf
            for q in range(n_active):
                if best_of[q] == m:
                    s = active[q]
                    off = abs(x[m] - last_x[s] - slope[s] * (row[i] - last_row[s]))
                    if off < nearest:
                        nearest, chosen = off, s
            if chosen < 0:
                chosen = n_segments
                n_segments += 1
                slope[chosen] = 0.0
                active[n_active] = chosen
                n_active += 1
                best_of = np.append(best_of, -1)
            else:
                seen = (x[m] - last_x[chosen]) / (row[i] - last_row[chosen])
                slope[chosen] = 0.8 * slope[chosen] + 0.2 * min(max(seen, -1.0), 1.0)
            segment[m], last_row[chosen], last_x[chosen] = chosen, row[i], x[m]
        i = k
    return segment


@nb.njit(cache=True, nogil=True, error_model="numpy")
def row_marginals(
    row: ArrayI, unary: ArrayF, depth: ArrayF, missing: ArrayF, skip: float, smooth: float, step_cap_mm: float
) -> ArrayF:
    """Smallest cost of a whole row if one detection has one label, (n, L); inf where it cannot have it.

    Detections are ordered by row and within a row in the order of the labels. Labels grow strictly along a
    row; a label without detection costs ``missing`` (L,), a detection without label ``skip``, a change of
    depth (n, L) between neighbours ``smooth`` for each millimetre and label, up to a cap.
    """
    n, L = unary.shape
    out = np.full((n, L), np.inf)
    before = np.zeros(L + 1)
    for j in range(L):
        before[j + 1] = before[j] + missing[j]
    i = 0
    while i < n:
        end = i
        while end < n and row[end] == row[i]:
            end += 1
        K = end - i
        F, B = np.full((K, L), np.inf), np.full((K, L), np.inf)
        for k in range(K):
            for j in range(L):
                if not unary[i + k, j] < np.inf:
                    continue
                best = skip * k + before[j]
                for p in range(max(0, k - 4), k):
                    for q in range(j):
                        if F[p, q] < np.inf:
                            change = abs(depth[i + k, j] - depth[i + p, q]) / (j - q)
                            cost = F[p, q] + skip * (k - p - 1) + before[j] - before[q + 1]
                            cost += smooth * min(change, step_cap_mm)
                            best = min(best, cost)
                F[k, j] = best + unary[i + k, j]
        for k in range(K - 1, -1, -1):
            for j in range(L):
                if not unary[i + k, j] < np.inf:
                    continue
                best = skip * (K - 1 - k) + before[L] - before[j + 1]
                for p in range(k + 1, min(K, k + 5)):
                    for q in range(j + 1, L):
                        if B[p, q] < np.inf:
                            change = abs(depth[i + k, j] - depth[i + p, q]) / (q - j)
                            cost = B[p, q] + unary[i + p, q] + skip * (p - k - 1) + before[q] - before[j + 1]
                            cost += smooth * min(change, step_cap_mm)
                            best = min(best, cost)
                B[k, j] = best
                out[i + k, j] = F[k, j] + best
        i = end
    return out


@nb.njit(cache=True, nogil=True, error_model="numpy")
def add_points(
    grid: ArrayF,
    who: ArrayI,
    count: ArrayU8,
    corner: ArrayF,
    cell_mm: float,
    points: ArrayF,
    label: ArrayI,
    frame: int,
) -> int:
    """Put points (n, 3: x, y, depth) into cells (nx, ny, slots, 3); returns how many fell outside.

    ``who`` (nx, ny, slots, 2) gets the label and the frame. A cell keeps one point of each label and frame,
    and when it is full its first ones: they were there before a mistake could be.
    """
    outside = 0
    for i in range(len(points)):
        a = int(np.floor((points[i, 0] - corner[0]) / cell_mm))
        b = int(np.floor((points[i, 1] - corner[1]) / cell_mm))
        if a < 0 or b < 0 or a >= grid.shape[0] or b >= grid.shape[1]:
            outside += 1
            continue
        c = count[a, b]
        known = False
        for k in range(c):
            if who[a, b, k, 0] == label[i] and who[a, b, k, 1] == frame:
                known = True
        if known or c >= grid.shape[2]:
            continue
        for k in range(3):
            grid[a, b, c, k] = points[i, k]
        who[a, b, c, 0], who[a, b, c, 1] = label[i], frame
        count[a, b] = c + 1
    return outside


@nb.njit(cache=True, nogil=True, error_model="numpy")
def carve(
    free: ArrayU8,
    corner: ArrayF,
    voxel: ArrayF,
    points: ArrayF,
    slopes: ArrayF,
    end_mm: float,
    length_mm: float,
) -> None:
    """Mark voxels along rays above points (n, 3) as free: from ``end_mm`` above a point on, ``length_mm`` up.

    ``slopes`` (n, 2): change of x and y for each millimetre of depth.
    """
    step = 0.7 * min(voxel[0], voxel[2])
    steps = int(length_mm / step)
    for i in range(len(points)):
        for s in range(steps):
            up = end_mm + s * step
            a = int(np.floor((points[i, 0] - slopes[i, 0] * up - corner[0]) / voxel[0]))
            b = int(np.floor((points[i, 1] - slopes[i, 1] * up - corner[1]) / voxel[1]))
            c = int(np.floor((points[i, 2] - up - corner[2]) / voxel[2]))
            inside = 0 <= a < free.shape[0] and 0 <= b < free.shape[1] and 0 <= c < free.shape[2]
            if inside and free[a, b, c] < 255:
                free[a, b, c] += 1


@nb.njit(cache=True, nogil=True, error_model="numpy")
def look_up(
    grid: ArrayF,
    who: ArrayI,
    count: ArrayU8,
    corner: ArrayF,
    cell_mm: float,
    free: ArrayU8,
    voxel: ArrayF,
    places: ArrayF,
    slope: ArrayF,
    possible: ArrayU8,
    limits: ArrayF,
    frame: int,
    state: ArrayU8,
    off_mm: ArrayF,
) -> None:
    """What the map says of hypotheses (n, L, 3: x, y, depth) on camera rays with slopes (n, 2).

    A point supports a hypothesis only if it comes from another line and another frame: what one line says
    twice would be wrong twice. ``state`` (n, L) becomes 0 unknown, 1 supported, 2 contradicted, 3
    impossible (``possible`` is 0). ``off_mm`` is the difference of depth to the nearest supporting point.
    ``limits``: radius, tolerance, its growth per millimetre of distance, how far in front a surface must be
    to hide what is behind it, and how many rays must have gone through a voxel that is free.
    """
    radius, tolerance, growth, hidden_mm, rays = limits[0], limits[1], limits[2], limits[3], limits[4]
    reach = int(np.ceil(radius / cell_mm))
    n, L = possible.shape
    for i in range(n):
        for j in range(L):
            off_mm[i, j] = np.nan
            if possible[i, j] == 0:
                state[i, j] = 3
                continue
            x, y, d = places[i, j, 0], places[i, j, 1], places[i, j, 2]
            a = int(np.floor((x - corner[0]) / cell_mm))
            b = int(np.floor((y - corner[1]) / cell_mm))
            state[i, j] = 0
            best = np.inf
            for p in range(max(0, a - reach), min(grid.shape[0], a + reach + 1)):
                for q in range(max(0, b - reach), min(grid.shape[1], b + reach + 1)):
                    for c in range(count[p, q]):
                        if who[p, q, c, 0] == j or who[p, q, c, 1] == frame:
                            continue
                        dx, dy = grid[p, q, c, 0] - x, grid[p, q, c, 1] - y
                        r = np.sqrt(dx * dx + dy * dy)
                        if r > radius:
                            continue
                        dd = grid[p, q, c, 2] - d
                        share = abs(dd) / (tolerance + growth * r)
                        if share < 1.0 and share < best:
                            best = share
                            off_mm[i, j] = dd
                            state[i, j] = 1
            if state[i, j] == 1:
                continue
            u = int(np.floor((x - corner[0]) / voxel[0]))
            v = int(np.floor((y - corner[1]) / voxel[1]))
            w = int(np.floor((d - corner[2]) / voxel[2]))
            inside = 0 <= u < free.shape[0] and 0 <= v < free.shape[1] and 0 <= w < free.shape[2]
            if inside and free[u, v, w] >= rays:
                state[i, j] = 2
                continue
            # a known surface in front of the hypothesis on the same camera ray hides it
            up = hidden_mm
            hits = 0
            while up < 60.0 and hits < 2:
                a = int(np.floor((x - slope[i, 0] * up - corner[0]) / cell_mm))
                b = int(np.floor((y - slope[i, 1] * up - corner[1]) / cell_mm))
                if 0 <= a < grid.shape[0] and 0 <= b < grid.shape[1]:
                    for c in range(count[a, b]):
                        if who[a, b, c, 1] != frame and abs(grid[a, b, c, 2] - (d - up)) < 0.8:
                            hits += 1
                            break
                up += 0.7
            if hits >= 2:
                state[i, j] = 2
