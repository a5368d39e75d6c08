"""Random numbers of single shots that depend on nothing but the seed, the cause and the number of the shot.

A stream that is drawn one number after the other shifts as soon as one shot draws more or fewer than before.
Here each number is a hash of its place (counter-based generator; Salmon et al. 2011), so that switching one
effect leaves the numbers of all others as they were, only the shots that need numbers pay for them, and the
size of the pieces that a recording is made in does not matter. The hash is the finaliser of SplitMix64
(Steele, Lea and Flood 2014), applied twice.
"""

from dataclasses import dataclass
from typing import Any, Self

import numba as nb
import numpy as np

from thalweg.core.types import ArrayF, ArrayI
from thalweg_lab.base.random import generator


@dataclass(frozen=True, slots=True)
class ShotRandom:
    """Random numbers of one cause, by the number of the shot.

    Parameters
    ----------
    key : 64 bits that stand for seed and cause.
    """

    key: int

    @classmethod
    def of(cls, seed: int, cause: str) -> Self:
        """Numbers of a cause, for example ``"lidar noise"``."""
        return cls(int(generator(seed, cause).integers(0, 2**63)))

    def uniform(self, shot: ArrayI, count: int = 1) -> ArrayF:
        """Numbers (n, count) from [0, 1) for shots (n,).

        Examples
        --------
        >>> a = ShotRandom.of(1, "lidar noise")
        >>> bool(a.uniform(np.array([7]))[0, 0] == a.uniform(np.array([3, 7]), 2)[1, 0])
        True
        """
        out = np.empty((len(shot), count))
        _uniform(np.uint64(self.key), shot, out)
        return out

    def normal(self, shot: ArrayI, count: int = 1) -> ArrayF:
        """Standard normal numbers (n, count) for shots (n,), by Box and Muller (1958)."""
        out = np.empty((len(shot), count))
        _normal(np.uint64(self.key), shot, out)
        return out

    def exponential(self, shot: ArrayI, count: int = 1) -> ArrayF:
        """Numbers (n, count) of the exponential distribution with mean 1 for shots (n,)."""
        return np.asarray(-np.log1p(-self.uniform(shot, count)))


@nb.njit(cache=True, error_model="numpy", inline="always")
def _hashed(key: Any, shot: Any, place: Any) -> float:
    """A number from [0, 1) of 53 bits."""
    z = key + np.uint64(shot) * np.uint64(0x9E3779B97F4A7C15)
    for _ in range(2):
        z += np.uint64(place + 1) * np.uint64(0xD1B54A32D192ED03)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@nb.njit(cache=True, error_model="numpy")
def _uniform(key: Any, shot: ArrayI, out: ArrayF) -> None:
    for i in range(len(shot)):
        for k in range(out.shape[1]):
            out[i, k] = _hashed(key, shot[i], k)


@nb.njit(cache=True, error_model="numpy")
def _normal(key: Any, shot: ArrayI, out: ArrayF) -> None:
    for i in range(len(shot)):
        for k in range(0, out.shape[1], 2):
            # 1 - u is never zero, so that its logarithm is finite.
            length = np.sqrt(-2.0 * np.log(1.0 - _hashed(key, shot[i], k)))
            angle = 2.0 * np.pi * _hashed(key, shot[i], k + 1)
            out[i, k] = length * np.cos(angle)
            if k + 1 < out.shape[1]:
                out[i, k + 1] = length * np.sin(angle)
