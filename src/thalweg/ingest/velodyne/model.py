"""Velodyne models with 1206-byte packets: geometry, timing, units; and the choice of the model.

Sources: VLP-16 User Manual 63-9243 Rev. D, chapter 9 (tables 9-1 and 9-2, sections 9.2 to 9.5; also Puck
Hi-Res); HDL-32E User Manual 63-9113 (laser angles and timing); VLP-32C User Manual 63-9325, chapter 9.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np

from thalweg.core import ArrayF, ArrayI, UnsupportedError

DATA_SIZE: Final = 1206
POSITION_SIZE: Final = 512

BLOCKS: Final = 12
BLOCK_SIZE: Final = 100
BLOCK_FLAG: Final = 0xFFEE
"""First two bytes of each data block, read big-endian."""
SHOTS: Final = 32
"""Shots of a block: one firing of 32 lasers, or two of 16."""
HOUR_US: Final = 3_600_000_000

STRONGEST: Final = 0x37
LAST: Final = 0x38
DUAL: Final = 0x39
RETURN_MODES: Final[Mapping[int, str]] = {STRONGEST: "strongest", LAST: "last", DUAL: "dual"}


@dataclass(frozen=True, kw_only=True)
class Model:
    """One model of scanner.

    Attributes
    ----------
    name : as in ``lidar.model``.
    product : product byte of its packets.
    elevation_deg : (k,) vertical angle of the lasers in the order of the data block.
    azimuth_deg : (k,) added to the azimuth of the block.
    vertical_m : (k,) height of each laser above the sensor's origin, added to z: beams cross in front of the
        axis, at the lens.
    firing_s : time from one firing of all lasers to the next, recharge included.
    delay_s : (k,) time of each laser behind the first one of its firing.
    range_unit_m : unit of distances.
    dual : dual-return packets are understood.
    """

    name: str
    product: int
    elevation_deg: ArrayF
    azimuth_deg: ArrayF
    vertical_m: ArrayF
    firing_s: float
    delay_s: ArrayF
    range_unit_m: float
    dual: bool

    @property
    def lasers(self) -> int:
        """Number of lasers, k."""
        return int(self.elevation_deg.size)

    @cached_property
    def ring(self) -> ArrayI:
        """Rank (k,) of each laser by elevation: 0 is the lowest."""
        return np.argsort(np.argsort(self.elevation_deg)).astype(np.int64)

    @property
    def vertical_by_ring_m(self) -> ArrayF:
        """Height (k,) above the sensor's origin by ring, lowest first."""
        return self.vertical_m[np.argsort(self.elevation_deg)]

    @property
    def block_s(self) -> float:
        """Time covered by one data block."""
        return self.firing_s * SHOTS / self.lasers

    def packet_s(self, mode: int) -> float:
        """Time from one packet of a return mode to the next."""
        return (BLOCKS // 2 if mode == DUAL else BLOCKS) * self.block_s

    @cached_property
    def shots(self) -> ArrayF:
        """Facts of the 32 shots of a block: delay in seconds, share of the azimuth gap, cosine and sine of
        the elevation, ring, laser, azimuth offset in radians (7, 32).
        """
        firings = SHOTS // self.lasers
        delay_s = (np.arange(firings)[:, None] * self.firing_s + self.delay_s).ravel()
        each = np.stack(
            [
                np.cos(np.radians(self.elevation_deg)),
                np.sin(np.radians(self.elevation_deg)),
                self.ring,
                np.arange(self.lasers),
                np.radians(self.azimuth_deg),
            ]
        )
        return np.vstack([delay_s, delay_s / self.block_s, np.tile(each, firings)])

    def vertical_offset_m(self, corrected: bool) -> ArrayF:
        """Height of the 32 shots of a block above the origin, or zeros if they are switched off."""
        return np.tile(self.vertical_m, SHOTS // self.lasers) if corrected else np.zeros(SHOTS)


VLP16: Final = Model(
    name="VLP-16",
    product=0x22,
    elevation_deg=np.array([-15.0, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15]),
    azimuth_deg=np.zeros(16),
    # rounded to 0.1 mm in table 9-1
    vertical_m=1e-3
    * np.array([11.2, -0.7, 9.7, -2.2, 8.1, -3.7, 6.6, -5.1, 5.1, -6.6, 3.7, -8.1, 2.2, -9.7, 0.7, -11.2]),
    firing_s=55.296e-6,
    delay_s=np.arange(16.0) * 2.304e-6,
    range_unit_m=0.002,
    dual=True,
)
HI_RES: Final = Model(
    name="Puck Hi-Res",
    product=0x24,
    # table 9-1 rounds to 0.01 degrees; the lasers stand 4/3 degrees apart
    elevation_deg=np.array([-30.0, 2, -26, 6, -22, 10, -18, 14, -14, 18, -10, 22, -6, 26, -2, 30]) / 3,
    azimuth_deg=np.zeros(16),
    vertical_m=1e-3
    * np.array([7.4, -0.9, 6.5, -1.8, 5.5, -2.7, 4.6, -3.7, 3.7, -4.6, 2.7, -5.5, 1.8, -6.5, 0.9, -7.4]),
    firing_s=55.296e-6,
    delay_s=np.arange(16.0) * 2.304e-6,
    range_unit_m=0.002,
    dual=True,
)
_HDL32E_ELEVATION_DEG: Final = np.array([
    -30.67, -9.33, -29.33, -8.00, -28.00, -6.67, -26.67, -5.33, -25.33, -4.00, -24.00, -2.67, -22.67, -1.33,
    -21.33, 0.00, -20.00, 1.33, -18.67, 2.67, -17.33, 4.00, -16.00, 5.33, -14.67, 6.67, -13.33, 8.00, -12.00,
    9.33, -10.67, 10.67,
])  # fmt: skip
HDL32E: Final = Model(
    name="HDL-32E",
    product=0x21,
    elevation_deg=_HDL32E_ELEVATION_DEG,
    azimuth_deg=np.zeros(32),
    vertical_m=-0.028956 * np.tan(np.radians(_HDL32E_ELEVATION_DEG)),  # 1.14 inch from the axis
    firing_s=46.08e-6,
    delay_s=np.arange(32.0) * 1.152e-6,
    range_unit_m=0.002,
    dual=False,
)
_VLP32C_ELEVATION_DEG: Final = np.array([
    -25.0, -1.0, -1.667, -15.639, -11.31, 0.0, -0.667, -8.843, -7.254, 0.333, -0.333, -6.148, -5.333, 1.333,
    0.667, -4.0, -4.667, 1.667, 1.0, -3.667, -3.333, 3.333, 2.333, -2.667, -3.0, 7.0, 4.667, -2.333, -2.0,
    15.0, 10.333, -1.333,
])  # fmt: skip
_VLP32C_AZIMUTH_DEG: Final = np.array([
    1.4, -4.2, 1.4, -1.4, 1.4, -1.4, 4.2, -1.4, 1.4, -4.2, 1.4, -1.4, 4.2, -1.4, 4.2, -1.4,
    1.4, -4.2, 1.4, -4.2, 4.2, -1.4, 1.4, -1.4, 1.4, -1.4, 1.4, -4.2, 4.2, -1.4, 1.4, -1.4,
])  # fmt: skip
VLP32C: Final = Model(
    name="VLP-32C",
    product=0x28,
    elevation_deg=_VLP32C_ELEVATION_DEG,
    azimuth_deg=_VLP32C_AZIMUTH_DEG,
    vertical_m=-0.0424 * np.tan(np.radians(_VLP32C_ELEVATION_DEG)),
    firing_s=55.296e-6,
    delay_s=np.arange(32.0) // 2 * 2.304e-6,  # two lasers at a time
    range_unit_m=0.004,
    dual=False,
)

MODELS: Final = (VLP16, HI_RES, HDL32E, VLP32C)
_BY_NAME: Final = {model.name.upper(): model for model in MODELS} | {
    "VLP16": VLP16,
    "PUCK": VLP16,
    "PUCK LITE": VLP16,
    "HDL32E": HDL32E,
    "VLP32C": VLP32C,
}
"""Names in capitals; the Puck LITE shares product byte and geometry with the VLP-16."""
_NAMES: Final = ", ".join(model.name for model in MODELS)

PRODUCTS: Final[Mapping[int, str]] = {
    0x20: "HDL-64E",
    0x23: "VLP-32A/B",
    0x31: "Velarray",
    0x63: "VLS-128",
    0xA1: "VLS-128",
    **{model.product: model.name for model in MODELS},
}
"""Models by the product byte, those that are not read too."""


def product_name(product: int) -> str:
    """Name of a product byte, for messages."""
    return f"{PRODUCTS.get(product, 'unknown model')} (product byte 0x{product:02x})"


def choose_model(setting: str, product: int, where: str) -> tuple[Model, str]:
    """Model to decode for, and a note if the packets disagree with the setting.

    Parameters
    ----------
    setting : ``"auto"`` or the name of a model.
    product : most frequent product byte of the packets.
    where : file, for the message.

    Raises
    ------
    UnsupportedError : the setting or, on ``"auto"``, the product byte names another model.
    """
    if setting.lower() == "auto":
        known = next((model for model in MODELS if model.product == product), None)
        if known is None:
            raise UnsupportedError(
                f"packets of a {product_name(product)}",
                expected=_NAMES,
                where=where,
                cure="If it is one of these all the same (old firmware errs there), set lidar.model to it",
            )
        return known, ""
    known = _BY_NAME.get(setting.upper())
    if known is None:
        raise UnsupportedError(
            f"lidar.model '{setting}'",
            expected=f"auto, {_NAMES}",
            where=where,
            cure="Only these models are implemented: set lidar.model",
        )
    if product == known.product:
        return known, ""
    return known, (
        f"The packets say {product_name(product)}, but lidar.model says {known.name}: decoded as "
        f"{known.name}. Old and pre-production firmware writes a wrong product byte; if walls look bent, "
        "this is why."
    )
