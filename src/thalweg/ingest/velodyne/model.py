"""Constants of the Velodyne VLP-16 and the choice of the model.

Source: VLP-16 User Manual 63-9243 Rev. D, chapter 9 (tables 9-1 and 9-2, sections 9.2 to 9.5).
"""

from collections.abc import Mapping
from typing import Final

import numpy as np

from thalweg.core.errors import UnsupportedError
from thalweg.core.types import ArrayF, ArrayI

DATA_SIZE: Final = 1206
POSITION_SIZE: Final = 512
DATA_PORT: Final = 2368
POSITION_PORT: Final = 8308

BLOCKS: Final = 12
BLOCK_SIZE: Final = 100
BLOCK_FLAG: Final = 0xFFEE
"""First two bytes of each data block, read big-endian."""
LASERS: Final = 16

FIRING_S: Final = 55.296e-6
"""Time from one firing of all 16 lasers to the next, recharge included."""
LASER_S: Final = 2.304e-6
"""Time from one laser to the next."""
BLOCK_S: Final = 2 * FIRING_S
"""Time covered by one data block: two firings."""
PACKET_S: Final[Mapping[int, float]] = {0x37: 12 * BLOCK_S, 0x38: 12 * BLOCK_S, 0x39: 6 * BLOCK_S}
"""Time from one packet to the next, by return mode."""

RANGE_UNIT_M: Final = 0.002
HOUR_US: Final = 3_600_000_000

STRONGEST: Final = 0x37
LAST: Final = 0x38
DUAL: Final = 0x39
RETURN_MODES: Final[Mapping[int, str]] = {STRONGEST: "strongest", LAST: "last", DUAL: "dual"}

ELEVATION_DEG: Final[ArrayF] = np.array(
    [-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15], dtype=np.float64
)
"""Vertical angle of the lasers in firing order (table 9-1)."""

VERTICAL_CORRECTION_M: Final[ArrayF] = 1e-3 * np.array(
    [11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2]
)
"""Height of each laser above the sensor's origin, added to z (table 9-1, rounded there to 0.1 mm)."""

RING: Final[ArrayI] = np.argsort(np.argsort(ELEVATION_DEG)).astype(np.int64)
"""Rank of each laser by elevation: 0 is -15 degrees, 15 is +15 degrees."""

VLP16_PRODUCT: Final = 0x22
PRODUCTS: Final[Mapping[int, str]] = {
    0x20: "HDL-64E",
    0x21: "HDL-32E",
    VLP16_PRODUCT: "VLP-16",
    0x23: "VLP-32A/B",
    0x24: "Puck Hi-Res",
    0x28: "VLP-32C",
    0x31: "Velarray",
    0x63: "VLS-128",
    0xA1: "VLS-128",
}
"""Models by the product byte; Puck LITE shares 0x22 with the VLP-16, and so does its geometry."""


def product_name(product: int) -> str:
    """Name of a product byte, for messages."""
    return f"{PRODUCTS.get(product, 'unknown model')} (product byte 0x{product:02x})"


def choose_model(setting: str, product: int, where: str) -> tuple[str, str]:
    """Model to decode for, and a note if the packets disagree with the setting.

    Parameters
    ----------
    setting : ``"auto"`` or ``"VLP-16"``.
    product : most frequent product byte of the packets.
    where : file, for the message.

    Raises
    ------
    UnsupportedError : the setting or, on ``"auto"``, the product byte names another model.
    """
    if setting.upper() in ("VLP-16", "VLP16", "PUCK", "PUCK LITE"):
        if product == VLP16_PRODUCT:
            return "VLP-16", ""
        return "VLP-16", (
            f"The packets say {product_name(product)}, but lidar.model says VLP-16: decoded as VLP-16. "
            "Old and pre-production firmware writes a wrong product byte; if walls look bent, this is why."
        )
    if setting.lower() != "auto":
        raise UnsupportedError(
            f"lidar.model '{setting}'",
            expected="'auto' or 'VLP-16'",
            where=where,
            cure="Only the VLP-16 and the Puck LITE are implemented: set lidar.model",
        )
    if product != VLP16_PRODUCT:
        raise UnsupportedError(
            f"packets of a {product_name(product)}",
            expected=product_name(VLP16_PRODUCT),
            where=where,
            cure="If it is a VLP-16 all the same (old firmware errs there), set lidar.model to VLP-16",
        )
    return "VLP-16", ""
