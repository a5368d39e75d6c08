"""Files of an orthophoto: a picture, and a world file that says where its pixels are."""

from pathlib import Path

import cv2
import numpy as np

from thalweg.lightsheet.scanning.ortho import Orthophoto


def write_orthophoto(found: Orthophoto, picture: Path, world: Path) -> None:
    """Write an orthophoto.

    Parameters
    ----------
    found : the orthophoto.
    picture : PNG, north (larger y) up; black where nothing was seen.
    world : world file (six lines): width of a cell, two zeros, minus its height, centre of the upper left
        cell, in metres of the grid's frame.
    """
    grid = found.grid
    done, data = cv2.imencode(".png", np.ascontiguousarray(found.picture()[:, :, ::-1]))
    assert done
    picture.write_bytes(data.tobytes())
    top = grid.y0_m + grid.cell_m * (grid.height_m.shape[0] - 1)
    numbers = (grid.cell_m, 0.0, 0.0, -grid.cell_m, grid.x0_m, top)
    world.write_text("".join(f"{value:.9f}\n" for value in numbers))
