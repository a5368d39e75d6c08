"""Columns of LAS points: what Thalweg calls them, and how they are packed into LAS types."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import laspy
import numpy as np

from thalweg.core.errors import GeometryError
from thalweg.core.las.header import LazHeader
from thalweg.core.types import AnyArray

ExtraDimension = tuple[str, str] | tuple[str, str, float]
"""Type (numpy code such as ``f4``, ``u1``), description with unit, and optionally the scale of an integer."""

OPTIONAL: Final = {"classification": np.uint8, "point_source_id": np.uint16, "user_data": np.uint8}
"""LAS dimensions that may be given and are read back under their own names."""

_TEXT_BYTES: Final = 32


def columns_of(points: Any, header: LazHeader) -> dict[str, AnyArray]:
    """Columns of a laspy point record, as `iter_laz` describes them."""
    n = len(points)
    dimensions = set(points.point_format.dimension_names)
    xyz = np.empty((n, 3))
    for axis, name in enumerate("XYZ"):
        xyz[:, axis] = points.array[name] * header.scales_m[axis] + header.offsets_m[axis]
    columns: dict[str, AnyArray] = {"xyz_m": xyz, "t_gps_s": np.full(n, np.nan)}
    if header.has_time:
        columns["t_gps_s" if header.standard_time else "t_week_s"] = np.array(points["gps_time"])
    for name in ("intensity", "return_number", "number_of_returns", *OPTIONAL):
        if name in dimensions:
            columns[name] = np.array(points[name])
    if "red" in dimensions:
        columns["rgb"] = np.stack([points[name] for name in ("red", "green", "blue")], axis=-1)
    for name in header.extra_dimensions:
        columns[name] = np.array(points[name])
    return columns


def extra_params(name: str, spec: ExtraDimension) -> Any:
    """Laspy's description of an extra dimension."""
    scales, offsets = (np.array([spec[2]]), np.zeros(1)) if len(spec) == 3 else (None, None)
    return laspy.ExtraBytesParams(
        name=name, type=np.dtype(spec[0]), description=spec[1], scales=scales, offsets=offsets
    )


def check_extra_texts(extra: Mapping[str, ExtraDimension], path: Path) -> None:
    """Refuse names and descriptions that LAS would cut.

    Raises
    ------
    GeometryError : a text is longer than 32 bytes.
    """
    for name, spec in extra.items():
        for text in (name, spec[1]):
            if len(text.encode()) > _TEXT_BYTES:
                raise GeometryError(
                    f"'{text}' has {len(text.encode())} bytes",
                    expected=f"at most {_TEXT_BYTES} (LAS extra bytes)",
                    where=path,
                )


def sixteen_bit(name: str, values: AnyArray, path: Path) -> AnyArray:
    """Bring 8-bit values to 16 bit (x 256); 16-bit ones stay.

    Raises
    ------
    GeometryError : another type, whose range is not known.
    """
    if values.dtype == np.uint8:
        return values.astype(np.uint16) * np.uint16(256)
    if values.dtype == np.uint16:
        return values
    raise GeometryError(f"'{name}' of type {values.dtype}", expected="uint8 or uint16", where=path)


def integers(name: str, values: AnyArray, dtype: np.dtype[Any], path: Path) -> AnyArray:
    """Round to an integer type, checked.

    Raises
    ------
    GeometryError : a value is not finite or does not fit.
    """
    if values.dtype == dtype:
        return values
    rounded = np.rint(values)
    limits = np.iinfo(dtype)
    if not np.all((rounded >= limits.min) & (rounded <= limits.max)):
        raise GeometryError(
            f"values of '{name}' do not fit {dtype} ({np.min(rounded)} to {np.max(rounded)} stored)",
            expected=f"{limits.min} to {limits.max}",
            where=path,
        )
    return rounded.astype(dtype)
