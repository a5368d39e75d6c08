"""Laser lines on a checkerboard in a room: an arc, specks, a wall and a table beside it, boards cut off.

``python -m thalweg_lab.studies.by_hand.laser_room FIRST_SEED NUMBER`` prints for each kind of picture which
share of the places lies off the laser's light, which share of those without the flag of a piece apart does,
normalised squared errors on the board (1 if sigmas are right; mean, least, largest), and pictures refused.
"""

import sys
from typing import Final

import numpy as np

from thalweg.core import AnyArray, ArrayB, ArrayF, ThalwegError, optional
from thalweg.lightsheet.lines import LineFlag, LineSettings, detect_lines

cv2 = optional("cv2")

COLOURS: Final = {"red": (1.0, 0.12, 0.04), "green": (0.10, 1.0, 0.20)}
INNER: Final = (11, 7)
"""Inner corners of the board."""
_SIZE: Final = (720, 960)
_OFF_PX: Final = 3.0


def room_picture(seed: int, colour: str, *, cut: bool) -> tuple[AnyArray, ArrayF, ArrayB]:
    """A picture (720, 960, 3) as stored, the true x (720,) of the laser, and its rows on the board.

    Uneven light with a shadow, a board in perspective on a wall, a wooden table in front; the laser lies
    elsewhere on both. Its reflection draws an arc, glints draw specks. A Bayer mosaic; as it is, smoothed or
    sharpened; JPEG.
    """
    g = np.random.default_rng([seed, *colour.encode(), int(cut)])
    h, w = _SIZE
    laser_dn = g.uniform(70, 160)
    side = g.uniform(62, 80) if cut else g.uniform(38, 48)
    width, height = (INNER[0] + 1) * side, (INNER[1] + 1) * side
    turn = np.deg2rad(g.uniform(-12, 12))
    turned = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    middle = np.array([w * g.uniform(0.45, 0.55), h * g.uniform(0.38, 0.5)])
    if cut:
        middle[0] += g.choice([-1, 1]) * w * g.uniform(0.12, 0.3)
    plan = np.array([[0, 0], [width, 0], [width, height], [0, height]])
    seen = (plan - [width / 2, height / 2]) @ turned.T + middle + g.normal(0, 0.15 * side, (4, 2))
    y, x = np.mgrid[:h, :w] + 0.5
    to_plan = np.linalg.inv(cv2.getPerspectiveTransform(np.float32(plan), np.float32(seen)))
    uvw = np.stack([x, y, np.ones_like(x)], axis=-1) @ to_plan.T
    u, v = uvw[..., 0] / uvw[..., 2], uvw[..., 1] / uvw[..., 2]
    margin = 0.6 * side
    board = (u > -margin) & (u < width + margin) & (v > -margin) & (v < height + margin)
    dark = (u > 0) & (u < width) & (v > 0) & (v < height) & ((u // side + v // side) % 2 == 0)
    table = ~board & (y > 0.8 * h)
    wall = 0.35 + 0.1 * np.sin(x / 90) * np.cos(y / 70) + g.normal(0, 0.01, (h, w))
    wood = 0.3 + 0.08 * np.sin(y / 5 + 3 * np.sin(x / 120))
    albedo = np.where(board, np.where(dark, 0.12, 0.85), np.where(table, wood, wall))
    albedo = cv2.GaussianBlur(albedo, (0, 0), 0.9)
    tint = np.where(table[..., None], [1.0, 0.8, 0.6], np.where(board[..., None], 1.0, [0.95, 0.97, 1.0]))
    edge = g.uniform(0.3, 0.7) * w + 0.3 * (y - h / 2)
    light = g.uniform(110, 170) * (0.65 + 0.35 * x / w + 0.1 * y / h)
    light *= 1 - 0.5 * g.uniform(0.3, 1) / (1 + np.exp(-(x - edge) / 6))
    start = middle[0] + g.uniform(-0.25, 0.25) * width
    slope = g.uniform(-0.15, 0.15)
    on_board = (np.clip(start, 0.2 * w, 0.8 * w) if cut else start) + slope * (np.arange(h) + 0.5 - h / 2)
    half_width = g.uniform(2.5, 4.5)
    aside = np.where(table, (y - 0.8 * h) * g.uniform(-0.6, 0.6), g.choice([-1, 1]) * g.uniform(30, 70))
    aside = np.where(board, 0.0, aside)
    laser = laser_dn * np.exp(-2 * ((x - on_board[:, None] - aside) / half_width) ** 2) * albedo / 0.85
    at = np.clip(on_board, 0, w - 1).astype(int)
    true_px, rows_on_board = on_board + aside[np.arange(h), at], board[np.arange(h), at]
    centre, radius = (g.uniform(0.15, 0.85) * w, h * g.uniform(0.9, 1.15)), g.uniform(0.15, 0.3) * w
    away = np.abs(np.hypot(x - centre[0], 1.6 * (y - centre[1])) - radius) / g.uniform(2, 4)
    laser += laser_dn * g.uniform(0.35, 0.9) * np.exp(-2 * away**2) * ~board
    for _ in range(int(g.integers(8, 25))):
        px, py = g.uniform(0, w), g.uniform(0, h)
        if not board[int(py), int(px)]:
            height_dn = laser_dn * g.uniform(0.5, 2)
            laser += height_dn * np.exp(
                -2 * (((x - px) / g.uniform(2, 5)) ** 2 + ((y - py) / g.uniform(4, 14)) ** 2)
            )
    dn = (light * albedo)[..., None] * [0.92, 1.0, 0.8] * tint + laser[..., None] * np.array(COLOURS[colour])
    full_well = g.choice([4000, 13500])
    dn = (g.poisson(dn * full_well / 255) + g.normal(0, 8, dn.shape)) * 255 / full_well + 3
    mosaic = dn[..., 1].copy()
    mosaic[0::2, 0::2], mosaic[1::2, 1::2] = dn[0::2, 0::2, 0], dn[1::2, 1::2, 2]
    stored = cv2.cvtColor(np.clip(np.rint(mosaic), 0, 255).astype(np.uint8), cv2.COLOR_BayerBG2BGR)
    sharpness = g.integers(0, 3)
    if sharpness == 1:
        stored = cv2.GaussianBlur(stored, (0, 0), 1.2)
    if sharpness == 2:
        stored = cv2.addWeighted(stored, 1.8, cv2.GaussianBlur(stored, (0, 0), 1.5), -0.8, 0)
    _, data = cv2.imencode(".jpg", stored, [cv2.IMWRITE_JPEG_QUALITY, 90])
    return cv2.cvtColor(cv2.imdecode(data, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB), true_px, rows_on_board


def main(first_seed: int, number: int) -> None:
    """Print the table."""
    apart_bit = getattr(LineFlag, "APART", 0)
    for board in (None, INNER):
        for cut in (False, True):
            found, refused = [], 0
            for colour in COLOURS:
                for seed in range(first_seed, first_seed + number):
                    image, true_px, on_board = room_picture(seed, colour, cut=cut)
                    try:
                        points = detect_lines(image, LineSettings(across="rows", board=board))
                    except ThalwegError:
                        refused += 1
                        continue
                    row = np.clip(np.rint(points.y_px - 0.5).astype(int), 0, len(true_px) - 1)
                    off, apart = points.x_px - true_px[row], points.has(apart_bit)
                    wrong = np.abs(off) > _OFF_PX
                    square = (off / points.sigma_px)[~wrong & ~apart & on_board[row]] ** 2
                    found.append((wrong.mean(), wrong[~apart].mean(), square.mean()))
            line = f"board {board is not None!s:5} cut {cut!s:5} {refused} of {2 * number} refused"
            if found:
                every, believed, z2 = np.array(found).T
                line += f"; off {every.mean():.3f}, believed {believed.mean():.3f}"
                line += f"; normalised squares {z2.mean():.2f} ({z2.min():.2f} to {z2.max():.2f})"
            print(line, flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
