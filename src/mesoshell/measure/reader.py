"""A reader of parameters: ridge regression on features of pictures (NumPy only).

Notation
X            features of N pictures, each over its deviation, less the mean                 (N, D)
T            parameters, normalised                                                         (N, P)
λ            ridge: for each parameter, the one in RIDGES with the least leave-one-out error
K            X Xᵀ / D
error        root of the mean square of read − true, over pictures

It finds only what is linear in the features: compare its error on generated pictures with its error on unseen renders, and both
with the parameter's deviation, the error of always answering the mean (0.29 for a uniform one).
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

RIDGES = np.logspace(-4, 3, 29)


class Reader(NamedTuple):
    """T of X is (X − mean) · weights + bias."""

    mean: Float[np.ndarray, "D"]
    weights: Float[np.ndarray, "D P"]
    bias: Float[np.ndarray, "P"]


def learn(x: Float[np.ndarray, "N D"], t: Float[np.ndarray, "N P"]) -> Reader:
    """The reader of renders and their parameters. With N pictures K is N × N, however many features there are."""
    mean, deviation = x.mean(axis=0, dtype=np.float64), np.maximum(x.std(axis=0, dtype=np.float64), 1e-9)
    bias = t.mean(axis=0, dtype=np.float64)
    a, rest = (x - mean) / deviation, t - bias
    values, vectors = np.linalg.eigh(a @ a.T / a.shape[1])
    turned = vectors.T @ rest
    inverses = 1 / (np.maximum(values, 0)[None] + RIDGES[:, None])  # (R, N)
    dual = vectors @ (inverses[..., None] * turned)  # (R, N, P)
    # less what the mean takes along of each row: else a row could be told from the sum of the others
    leverage = inverses @ (vectors**2).T - 1 / (len(x) * RIDGES[:, None])
    left_out = np.mean(
        (dual / leverage[..., None]) ** 2, axis=1
    )  # what each picture is missed by if it is not learned from
    best = dual[np.argmin(left_out, axis=0), :, np.arange(t.shape[1])].T
    return Reader(mean, a.T @ best / a.shape[1] / deviation[:, None], bias)


def read(reader: Reader, x: Float[np.ndarray, "M D"]) -> Float[np.ndarray, "M P"]:
    """Parameters, of features."""
    return (x - reader.mean) @ reader.weights + reader.bias


def error(predicted: Float[np.ndarray, "M P"], true: Float[np.ndarray, "M P"]) -> Float[np.ndarray, "P"]:
    """Root mean square error of each parameter."""
    return np.sqrt(np.mean((predicted - true) ** 2, axis=0))
