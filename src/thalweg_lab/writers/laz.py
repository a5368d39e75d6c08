"""Terrestrial scans as LAZ 1.4 (ASPRS LAS 1.4 R15), point format 6."""

from pathlib import Path

import laspy
import numpy as np
from laspy.vlrs.known import WktCoordinateSystemVlr
from pyproj import CRS

from thalweg.core.frames import LocalFrame
from thalweg.core.las.header import VLR_RECORD, VLR_USER, frame_json, frame_wkt
from thalweg.core.types import AnyArray, ArrayF


def write_scan(
    path: Path,
    points_m: ArrayF,
    reflectance: ArrayF,
    frame: CRS | LocalFrame,
    station: int,
    *,
    return_number: AnyArray | None = None,
    number_of_returns: AnyArray | None = None,
) -> None:
    """Write one scan position.

    Parameters
    ----------
    path : target, ``.laz``.
    points_m : (n, 3) coordinates, in the CRS or in a local frame.
    reflectance : (n,) 0 to 1, written as intensity 0 to 65535.
    frame : reference system of the coordinates: a map grid, or the local frame.
    station : number of the scan position, written as point source id.
    return_number, number_of_returns : (n,) of each point, 1 the nearest; all 1 by default.
    """
    head = laspy.LasHeader(point_format=6, version="1.4")
    head.scales = np.full(3, 0.001)
    head.offsets = np.floor(points_m.min(axis=0)) if len(points_m) else np.zeros(3)
    if isinstance(frame, LocalFrame):
        # As Thalweg's own files say it: without a word, coordinates pass for those of the campaign's grid.
        head.vlrs.append(WktCoordinateSystemVlr(frame_wkt(frame)))
        head.global_encoding.wkt = True
        facts = frame_json(frame, has_time=False)
        head.vlrs.append(laspy.VLR(VLR_USER, VLR_RECORD, "frame and format version, JSON", facts))
    else:
        head.add_crs(frame)
    cloud = laspy.LasData(head)
    cloud.x, cloud.y, cloud.z = points_m.T
    intensity: AnyArray = np.clip(np.rint(reflectance * 65535), 0, 65535).astype(np.uint16)
    cloud.intensity = intensity
    ones: AnyArray = np.ones(len(points_m), dtype=np.uint8)
    cloud.return_number = ones if return_number is None else return_number.astype(np.uint8)
    cloud.number_of_returns = ones if number_of_returns is None else number_of_returns.astype(np.uint8)
    cloud.point_source_id = np.full(len(points_m), station, dtype=np.uint16)
    path.parent.mkdir(parents=True, exist_ok=True)
    cloud.write(str(path))
