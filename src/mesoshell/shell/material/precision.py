"""What a decoder loses in 16 bits, against float64.

Notation
x           decoder inputs at a point: F(u, v) + F(h), encoded h, α                   (N, I)
ω, ω′       toward the viewer, toward the light, both above the horizon              (N, 3), canonical
a           opacity 1 − e^{−σℓ} of a step ℓ: what a picture shows of σ               (N,)
aρ          its light; ρ alone is arbitrary where σ is 0                            (N, 3)

Short here means: weights, biases and the inputs of each layer are rounded to 16 bits; products are summed in float32, as matrix
units do, and each output stays in float32. So σ = 30·softplus cannot overflow, and softplus keeps its tail: eˣ turns an
absolute error of x into a relative one of σ, and bfloat16 is off by 0.03 at x = −10. Texture coordinates, directions before
their rounding, optical depths and radiance are float32 in any case.

The network is written a second time in NumPy: float64 needs no JAX setting there, and a compiler may drop roundings between
its operations. Tests compare it with `mesoshell.shell.material.decoder`.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.nets.mlp import Dense
from mesoshell.shell.material.decoder import Decoder

#: ℓ: a sample's share of a box's height, in a training picture.
STEP = 1 / 32
POINTS = 8192
SHORT = {"float16": np.dtype(np.float16), "bfloat16": jnp.dtype(jnp.bfloat16)}


def decoder_error(
    decoder: Decoder, feature: Float[np.ndarray, "V U C"], height: Float[np.ndarray, "R C"], octaves: int
) -> dict[str, Any]:
    """The bundle's `decoder_error`: for each type, of `sigma` (a) and `rho` (aρ) the root mean square of the error over that of
    the value, and the largest error over the largest value. None: a number overflows, so the type cannot be used.

    At fixed random texels, heights, parameters and directions of one texture, features in half precision as a bundle's are.
    """
    x, w, w_light = _points(decoder, feature, height, octaves)
    sigma, rho = decode(decoder, x, w, w_light, np.dtype(np.float64))
    a = -np.expm1(-STEP * sigma)
    said: dict[str, Any] = {}
    for name, kind in SHORT.items():
        short_sigma, short_rho = decode(decoder, x, w, w_light, kind)
        short_a = -np.expm1(-STEP * short_sigma.astype(np.float64))
        errors = {"sigma": _error(short_a, a), "rho": _error(short_a[:, None] * short_rho, a[:, None] * rho)}
        finite = np.isfinite([v for part in errors.values() for v in part.values()]).all()
        said[name] = errors if finite and np.isfinite(short_sigma).all() else None
    return said


def decode(
    decoder: Decoder,
    x: Float[np.ndarray, "N I"],
    w: Float[np.ndarray, "N 3"],
    w_light: Float[np.ndarray, "N 3"],
    kind: np.dtype,
) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N 3"]]:
    """σ and ρ with weights and activations of a type; in float32 for the 16-bit ones. Infinite or NaN where one overflows."""
    wide = np.float64 if kind == np.float64 else np.float32

    def rounded(a: Any) -> np.ndarray:
        return np.asarray(a).astype(kind).astype(wide)

    def dense(layer: Dense, x: np.ndarray) -> np.ndarray:
        return rounded(x) @ rounded(layer.kernel) + rounded(layer.bias)

    with np.errstate(over="ignore", invalid="ignore"):
        for layer in decoder.trunk:
            x = np.maximum(dense(layer, x), 0)
        sigma = wide(decoder.scale) * np.logaddexp(dense(decoder.sigma, x)[:, 0] - 3, 0)
        x = np.concatenate([x, w, w_light], axis=1)
        for layer in decoder.head:
            x = np.maximum(dense(layer, x), 0)
        return sigma, np.logaddexp(dense(decoder.rho, x) - 2, 0)


def _points(
    decoder: Decoder, feature: np.ndarray, height: np.ndarray, octaves: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x, ω and ω′ in float32."""
    rng = np.random.default_rng(0)
    row = rng.integers(len(height), size=POINTS)
    texel = feature.reshape(-1, feature.shape[-1])[rng.integers(feature.shape[0] * feature.shape[1], size=POINTS)]
    with np.errstate(over="ignore"):
        plane, profile = (v.astype(np.float16).astype(np.float32) for v in (texel, height[row]))
    h = ((row + 0.5) / len(height))[:, None]
    angle = np.pi * h * 2.0 ** np.arange(octaves)
    seen = [plane + profile, h, np.sin(angle), np.cos(angle)]
    appearance = decoder.trunk[0].kernel.shape[0] - sum(part.shape[1] for part in seen)
    x = np.concatenate([*seen, rng.uniform(size=(POINTS, appearance))], axis=1).astype(np.float32)
    toward = rng.normal(size=(2, POINTS, 3))
    toward[..., 2] = np.abs(toward[..., 2])
    w, w_light = (toward / np.linalg.norm(toward, axis=-1, keepdims=True)).astype(np.float32)
    return x, w, w_light


def _error(value: np.ndarray, true: np.ndarray) -> dict[str, float]:
    off, least = np.abs(value - true), np.finfo(np.float64).tiny
    rms = np.sqrt(np.mean(off**2) / max(np.mean(true**2), least))
    largest = off.max() / max(np.abs(true).max(), least)
    return {"rms": float(f"{rms:.3g}"), "largest": float(f"{largest:.3g}")}
