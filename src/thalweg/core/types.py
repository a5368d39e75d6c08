"""Aliases for array types; shapes, units and frames stand in the docstrings."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

ArrayF = NDArray[np.float64]
ArrayF32 = NDArray[np.float32]
ArrayI = NDArray[np.int64]
ArrayU8 = NDArray[np.uint8]
ArrayB = NDArray[np.bool_]
AnyArray = NDArray[Any]
