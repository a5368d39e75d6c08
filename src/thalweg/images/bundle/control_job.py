"""Marks of control points for a campaign: from a table, or measured in the images."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np
import pandas as pd

from thalweg.core.errors import ThalwegError
from thalweg.core.types import ArrayU8
from thalweg.images.bundle.place import LEAST, points_lie
from thalweg.images.bundle.run import world_block
from thalweg.images.control.marks import COLUMNS, Boards, Loader, Measured, measure_boards
from thalweg.images.control.tables import matched_marks, read_marks
from thalweg.images.model.block import ImageBlock
from thalweg.images.model.control_points import ControlMarks, ControlPoints
from thalweg.images.model.files import find_mask
from thalweg.images.model.poses import ImagePoses
from thalweg.ingest.photos.files import by_any_name, named_images


def grey_loader(paths: Sequence[Path]) -> Loader:
    """Grey values by the name of an image, from folders and files."""
    files = named_images(paths) if paths else {}
    meant = by_any_name(list(files))

    def load(name: str) -> ArrayU8 | None:
        """The picture of that name; None if there is none or it is damaged."""
        path = files.get(meant.get(name, ""))
        return None if path is None else _picture(path, cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)

    return load


def mask_loader(folder: Path | None) -> Loader:
    """Masks by the name of an image: the same name, or that with ``.png`` behind it or instead."""

    def load(name: str) -> ArrayU8 | None:
        """The mask of that image; None if there is none."""
        if folder is None:
            return None
        same = folder / PurePosixPath(name).name
        path = find_mask(name, folder) or (same if same.is_file() else None)
        return None if path is None else _picture(path, cv2.IMREAD_GRAYSCALE)

    return load


def _picture(path: Path, flags: int) -> ArrayU8 | None:
    """Pixels (h, w) of a file; None if it is damaged."""
    stored = np.fromfile(path, np.uint8) if path.is_file() else np.empty(0, np.uint8)
    picture = cv2.imdecode(stored, flags) if stored.size else None
    return None if picture is None else np.asarray(picture, np.uint8)


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
    notes = [*start.notes, *found.notes]
    if found.table.loc[found.table["used"].astype(bool), "point"].nunique() < LEAST:
        where = points_lie(placed, control)
        notes.append(
            f"Of {len(control.names)} control points fewer than {LEAST} were found"
            + (f"; {where}" if where else "")
            + f". They are looked for within {3 * section['search_m']:g} m of where clock, trajectory and "
            "mount put them (images.control.search_m), as boards of images.control.board_m"
        )
    return Measured(table=found.table, counts=found.counts, notes=notes)


def marks_of_pieces(
    blocks: Sequence[ImageBlock],
    control: ControlPoints,
    predictions: ImagePoses,
    section: Mapping[str, Any],
    *,
    tables: Sequence[Path],
    grey: Loader,
    mask: Loader,
) -> Measured:
    """Marks in the images of all pieces of a block, the main one first, as of `marks_of_campaign`.

    A further piece in which nothing can be measured is left with a note.
    """
    found = [marks_of_campaign(blocks[0], control, predictions, section, tables=tables, grey=grey, mask=mask)]
    seen = set(blocks[0].images)
    counts, notes = dict(found[0].counts), list(found[0].notes)
    for k, block in enumerate(blocks[1:], 1):
        try:
            more = marks_of_campaign(
                block, control, predictions, section, tables=tables, grey=grey, mask=mask
            )
        except ThalwegError as error:
            notes.append(f"piece {k} of {len(block.images)} images: no control points ({error.found})")
            continue
        rows = ~more.table["image"].isin(seen)
        found.append(replace(more, table=more.table[rows]))
        seen |= set(block.images)
        notes += [f"piece {k}: {note}" for note in more.notes]
        if tables:  # a table has the marks of all pieces: what one lacks another may have
            counts["used"] += int(more.table[rows]["used"].sum())
            without = "in images without a pose"
            counts[without] = counts.get(without, 0) - int(more.table[rows]["used"].sum())
        else:
            for reason, n in more.counts.items():
                counts[reason] = counts.get(reason, 0) + n
    parts = [part.table for part in found if len(part.table)]
    table = pd.concat(parts, ignore_index=True) if parts else found[0].table
    return Measured(table=table, counts={r: n for r, n in counts.items() if n or r == "used"}, notes=notes)


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
