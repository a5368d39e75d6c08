"""How likely a pixel belongs to each part of an image: logistic regression on features and their products.

Learned anew from each series; nothing is known beforehand about the colour of a river or a sky.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np
from scipy.optimize import minimize

from thalweg.core.types import AnyArray, ArrayF, ArrayF32, ArrayI

_STEPS: Final = 60
_SHRINKAGE: Final = 1e-3
"""Weight of the squares of the coefficients: keeps the probabilities modest where classes do not overlap."""

_FAR: Final = 3.0
"""Features count up to so many standard deviations: beyond, their squares would rule."""


@dataclass(frozen=True, slots=True)
class PixelModel:
    """Coefficients of a regression.

    Parameters
    ----------
    mean, scale : (f,) of the features.
    weights : (p, classes) coefficients of 1, the features, and their products.
    products : whether products of features count as well; without them more of a feature never means less.
    loss : mean negative logarithm of the probability of the right class, classes weighing alike.
    """

    mean: ArrayF32
    scale: ArrayF32
    weights: ArrayF32
    loss: float
    products: bool = True

    @classmethod
    def learn(
        cls,
        features: ArrayF32,
        part: ArrayI,
        classes: int,
        start: "PixelModel | None" = None,
        products: bool = True,
    ) -> Self:
        """Fit by L-BFGS; all classes weigh alike, however many pixels they have.

        Parameters
        ----------
        features : (n, f) of sample pixels.
        part : (n,) their classes, from 0.
        classes : number of classes; one without samples gets no probability.
        start : an earlier model of the same features; keeps its scales.
        """
        mean = features.mean(axis=0) if start is None else start.mean
        scale = features.std(axis=0) + np.float32(1e-6) if start is None else start.scale
        x = _products(features, mean, scale, products)
        n = np.bincount(part, minlength=classes).astype(np.float64)
        weight = (1.0 / (np.maximum(n, 1) * max(int((n > 0).sum()), 1)))[part].astype(np.float32)[:, None]
        target = np.eye(classes, dtype=np.float32)[part]

        def cost(flat: ArrayF) -> tuple[float, ArrayF]:
            """Value and gradient of the loss at flat weights."""
            w = flat.reshape(-1, classes).astype(np.float32)
            p = np.exp(_log_shares(x @ w))
            loss = -float((weight * np.log(np.maximum((p * target).sum(axis=1, keepdims=True), 1e-12))).sum())
            slope = x.T @ ((p - target) * weight) + 2 * _SHRINKAGE * w
            return loss + _SHRINKAGE * float((w * w).sum()), slope.astype(np.float64).ravel()

        first = np.zeros((x.shape[1], classes)) if start is None else start.weights.astype(np.float64)
        found = minimize(cost, first.ravel(), jac=True, method="L-BFGS-B", options={"maxiter": _STEPS})
        return cls(mean, scale, found.x.reshape(-1, classes).astype(np.float32), float(found.fun), products)

    def log_probability(self, features: ArrayF32) -> ArrayF32:
        """Logarithms (..., classes) of the probabilities at features (..., f)."""
        flat = features.reshape(-1, features.shape[-1])
        out = _log_shares(_products(flat, self.mean, self.scale, self.products) @ self.weights)
        return out.reshape(*features.shape[:-1], self.weights.shape[1])


def _products(features: ArrayF32, mean: ArrayF32, scale: ArrayF32, products: bool) -> ArrayF32:
    """1, the standardised features, and their products, (n, p)."""
    z = np.clip((features - mean) / scale, -_FAR, _FAR).T
    f = len(z)
    out = np.empty((1 + f + (f * (f + 1) // 2 if products else 0), z.shape[1]), dtype=np.float32)
    out[0], out[1 : 1 + f] = 1.0, z
    at = 1 + f
    for i in range(f if products else 0):
        np.multiply(z[i], z[i:], out=out[at : at + f - i])
        at += f - i
    return out.T


def _log_shares(scores: AnyArray) -> ArrayF32:
    z = scores - scores.max(axis=1, keepdims=True)
    return np.asarray(z - np.log(np.exp(z).sum(axis=1, keepdims=True)))
