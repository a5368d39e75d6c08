"""Marks of control points for a campaign: from a table, or measured in the images."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd

from thalweg.core.types import ArrayU8
from thalweg.orientation.block_run import world_block
from thalweg.orientation.control_marks import COLUMNS, Boards, Loader, Measured, measure_boards
from thalweg.orientation.control_points import ControlMarks, ControlPoints
from thalweg.orientation.control_tables import matched_marks, read_marks
from thalweg.orientation.image_block import ImageBlock
from thalweg.orientation.image_poses import ImagePoses


def grey_loader(paths: Sequence[Path]) -> Loader:
    """Grey values by the name of an image, from folders and files."""
    where = {f.name: f for p in paths for f in (sorted(p.rglob("*")) if p.is_dir() else [p]) if f.is_file()}

    def load(name: str) -> ArrayU8 | None:
        path = where.get(Path(name).name)
        picture = (
            None
            if path is None
            else cv2.imread(str(path), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
        )
        return None if picture is None else np.asarray(picture, np.uint8)

    return load


def mask_loader(folder: Path | None) -> Loader:
    """Masks by the name of an image: the same name, or that with ``.png`` behind it or instead."""

    def load(name: str) -> ArrayU8 | None:
        if folder is None:
            return None
        base = Path(name)
        for option in (f"{base.name}.png", f"{base.stem}.png", base.name):
            if (folder / option).is_file():
                found = cv2.imread(str(folder / option), cv2.IMREAD_GRAYSCALE)
                return None if found is None else np.asarray(found, np.uint8)
        return None

    return load


def boards_of(section: Mapping[str, Any]) -> Boards:
    """From the section ``images.control``."""
    return Boards(
        size_m=section["board_m"],
        rim_share=section["rim_share"],
        upper_left=section["upper_left"],
        search_m=section["search_m"],
        least_px=section["least_board_px"],
        least_score=section["least_score"],
        least_images=section["least_images"],
    )


def marks_of_campaign(
    block: ImageBlock,
    control: ControlPoints,
    predictions: ImagePoses,
    section: Mapping[str, Any],
    *,
    tables: Sequence[Path],
    grey: Loader,
    mask: Loader,
) -> Measured:
    """Marks from the tables that are given, else measured, else none.

    Raises
    ------
    InputError : a table names what does not exist, or pixels outside of an image.
    GeometryError : the block cannot be put into the world to look for boards.
    """
    none = pd.DataFrame({name: [] for name in COLUMNS})
    if not len(control.names):
        return Measured(table=none, counts={}, notes=[])
    if tables:
        parts, counts = [], {"used": 0}
        for path in tables:
            marks, dropped = matched_marks(
                read_marks(path), control, block.images,
                [block.cameras[c].size_px for c in block.camera], predictions.images,
                sigma_px=section["sigma_px"], where=path,
            )  # fmt: skip
            parts.append(mark_rows(block, control, marks))
            counts["used"] += len(marks.image)
            for reason, n in dropped.items():
                counts[reason] = counts.get(reason, 0) + n
        return Measured(table=pd.concat(parts, ignore_index=True), counts=counts, notes=[])
    if not section["detect"]:
        note = "No table of marks, and images.control.detect is false: control points take no part"
        return Measured(table=none, counts={}, notes=[note])
    placed, start, _ = world_block(block, control, ControlMarks.none(), predictions)
    found = measure_boards(placed, control, boards_of(section), grey, mask)
    return Measured(table=found.table, counts=found.counts, notes=[*start.notes, *found.notes])


def mark_rows(block: ImageBlock, control: ControlPoints, marks: ControlMarks) -> pd.DataFrame:
    """Marks as rows of the table ``control_marks.csv``."""
    return pd.DataFrame(
        {
            "image": [block.images[i] for i in marks.image],
            "point": [control.names[k] for k in marks.point],
            "x_px": marks.xy_px[:, 0],
            "y_px": marks.xy_px[:, 1],
            "sigma_px": marks.sigma_px,
            "score": np.nan,
            "used": True,
            "reason": "",
        }
    )
