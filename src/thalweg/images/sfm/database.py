"""COLMAP's database of a block: cameras, images, features and what pairs have in common.

Image k of a block has the number k + 1 and the name ``k``: names of files may hold blanks, which COLMAP's
lists of pairs do not bear.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thalweg.images.sfm.camera import to_colmap
from thalweg.images.sfm.colmap import colmap
from thalweg.images.sfm.matching import Matches


def fill_database(
    path: Path,
    block: Matches,
    *,
    descriptor: NDArray[np.uint8] | None = None,
    images: Iterable[int] | None = None,
) -> list[str]:
    """Write the images that take part, their features and, where they are known, the geometries of pairs.

    Parameters
    ----------
    path : of the database; must not exist.
    block : images, features and pairs.
    descriptor : (n, 128) of the features, if pairs are still to be compared.
    images : those that are written; None: all that take part.

    Returns
    -------
    notes : differences between a camera and its model in COLMAP above a hundredth of a pixel.
    """
    pc = colmap()
    notes = []
    with pc.Database.open(path) as database:
        for key, start in enumerate(block.starts, start=1):
            camera, error_px = to_colmap(start, key)
            if error_px > 0.01:
                notes.append(
                    f"camera {start.camera.name!r} as {start.lens} differs by up to {error_px:.2f} px"
                )
            database.write_camera(camera, use_camera_id=True)
            rig = pc.Rig(rig_id=key)
            rig.add_ref_sensor(camera.sensor_id)
            database.write_rig(rig, use_rig_id=True)
        for k in sorted(block.order.tolist() if images is None else images):
            _write_image(pc, database, block, k)
            rows = slice(int(block.start[k]), int(block.start[k + 1]))
            database.write_keypoints(k + 1, np.ascontiguousarray(block.place[rows, :2]))
            if descriptor is not None:
                kind = pc.FeatureExtractorType.SIFT
                database.write_descriptors(
                    k + 1, pc.FeatureDescriptors(kind, np.ascontiguousarray(descriptor[rows]))
                )
        for m in np.flatnonzero(block.n_common).tolist():
            a, b = block.pairs[m].tolist()
            database.write_two_view_geometry(a + 1, b + 1, _geometry(pc, block, m))
    return notes


def _write_image(pc: Any, database: Any, block: Matches, k: int) -> None:
    camera = int(block.camera[k]) + 1
    image = pc.Image(name=str(k), camera_id=camera, image_id=k + 1)
    frame = pc.Frame(frame_id=k + 1, rig_id=camera)
    frame.add_data_id(image.data_id)
    database.write_image(image, use_image_id=True)
    database.write_frame(frame, use_frame_id=True)


def _geometry(pc: Any, block: Matches, m: int) -> Any:
    made = pc.TwoViewGeometry()
    made.config = int(block.config[m])
    F, E, H, pose = block.geometry[m]
    for name, matrix in (("F", F), ("E", E), ("H", H)):
        if np.isfinite(matrix[:, :3]).all():
            setattr(made, name, matrix[:, :3])
    if np.isfinite(pose).all():
        made.cam2_from_cam1 = pc.Rigid3d(pose)
    made.inlier_matches = block.common[block.pair_start[m] : block.pair_start[m + 1]]
    return made
