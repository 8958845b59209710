"""Fourier maps: sinusoids in each channel, exact at any distance from the origin (MesoGAN, section 4.1).

Notation
K        sinusoids a channel; sinusoid k of channel c is row k C + c of what follows
f        frequency of a sinusoid, (f_v, f_u), in steps of 2⁻¹⁶ cycles a patch: integers          (K C, 2), int32
θ        drift of a sinusoid's phase along v, and along u, radians: a sum of I slow waves whose root mean square is
         `drift`
δ        frequencies of these, the same for all sinusoids, in the same steps                     (I, 2), int32
φ        phases: of the sinusoid, of its waves along v, and along u                              cycles, (B, 1 + 2 I, K C)
s = 2ᵇ   samples a patch; sample i lies at x = (i + ½)/s
i₀       index of the first sample along v and u: any integers, a tile's place in the plane       (2,), int32

Γ_c = Σ_k sin(2π(f_kc·x + φ_kc) + θ_kc(v) + θ_kc(u)) / √K; the paper has K = 1 and no drift. f·x = m(2i + 1)/2^(17 + b) with
integers m, so its fractional part is exact in integer arithmetic that wraps around, at any i; in float32, Γ at 4096 patches was
wrong by 0.08 in a test. And sin(a + b) = sin a cos b + cos a sin b: sines are computed on the two axes, and the plane takes
products of 2K numbers. A sample has the same value in every tile.

Without drift a texture nearly repeats itself where its sinusoids are in step again; a drift of some radians prevents that.
"""

import numpy as np
from jax import numpy as jnp

from mesoshell.numerics import product
from mesoshell.typing import Array, Float, Int

#: Frequencies are multiples of 2^−_BITS cycles a patch.
_BITS = 16


def draw_frequencies(rng: np.random.Generator, count: int, low: float, high: float) -> Int[np.ndarray, "count 2"]:
    """Uniform in the annulus low ≤ |f| < high, in cycles a patch; as integers in steps of 2⁻¹⁶."""
    radius = np.sqrt(rng.uniform(low**2, high**2, count))
    angle = rng.uniform(0, 2 * np.pi, count)
    inside = np.clip(radius * 2**_BITS, low * 2**_BITS + 1, high * 2**_BITS - 1)  # rounding moves them by less than 1
    return np.rint(inside[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)).astype(np.int32)


def rotate_frequencies(f: Int[np.ndarray, "C 2"], degrees: float) -> Int[np.ndarray, "C 2"]:
    """Frequencies of maps rotated about the origin, from v toward u."""
    sin, cos = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    return np.rint(f @ np.array([[cos, sin], [-sin, cos]])).astype(np.int32)


def draw_drift(rng: np.random.Generator, count: int) -> Int[np.ndarray, "count 2"]:
    """δ of up to half a cycle a patch, one in each of `count` equal parts."""
    parts = np.arange(count)[:, None] + rng.uniform(size=(count, 2))
    return np.rint(parts / max(count, 1) * 2 ** (_BITS - 1)).astype(np.int32)


def fourier_map(
    f: Int[Array, "KC 2"],
    slow: Int[Array, "I 2"],
    phase: Float[Array, "B J KC"],
    start: Int[Array, "2"],
    size: tuple[int, int],
    rate: int,
    waves: int = 1,
    drift: float = 0.0,
) -> Float[Array, "B {size[0]} {size[1]} C"]:
    """Γ on `size` (along v, u) samples of the grid of `rate` samples a patch, from sample `start` on. slow: δ; waves: K.

    Written as products: XLA would fuse sums of angles to sines on the whole plane, two to twenty times slower.
    """
    v, u = (_angles(f[:, axis], start[axis], size[axis], rate, phase.dtype)[None] for axis in (0, 1))
    v = v + 2 * jnp.pi * phase[:, :1]
    if len(slow):
        of_v, of_u = jnp.split(phase[:, 1:], 2, axis=1)
        v = v + drift * _drifted(slow[:, 0], of_v, start[0], size[0], rate)
        u = u + drift * _drifted(slow[:, 1], of_u, start[1], size[1], rate)
    v, u = (x.reshape(len(x), x.shape[1], waves, -1) for x in (v, u))
    left = jnp.concatenate([jnp.sin(v), jnp.cos(v)], axis=2)
    right = jnp.concatenate([jnp.cos(u), jnp.sin(u)], axis=2)
    if len(right) == 1:
        return jnp.einsum("bvkc,ukc->bvuc", left, right[0], precision="highest") / waves**0.5
    return jnp.einsum("bvkc,bukc->bvuc", left, right, precision="highest") / waves**0.5


def shifted_phase(
    f: Int[Array, "KC 2"], slow: Int[Array, "I 2"], phase: Float[Array, "B J KC"], shift: Float[Array, "2"]
) -> Float[Array, "B J KC"]:
    """Phases of the map moved by `shift` patches along (v, u): Γ′(x) = Γ(x − shift)."""
    by = shift.astype(phase.dtype) * 2.0**-_BITS
    cycles = (slow.astype(phase.dtype) * by[None]).T.reshape(-1, 1)
    waves = jnp.broadcast_to(cycles, (len(cycles), len(f)))
    return phase - jnp.concatenate([product(f.astype(phase.dtype), by)[None], waves])[None]


def _drifted(
    m: Int[Array, "I"], phase: Float[Array, "B I KC"], start: Int[Array, ""], size: int, rate: int
) -> Float[Array, "B n KC"]:
    """θ of unit power."""
    d, p = _angles(m, start, size, rate, phase.dtype), 2 * jnp.pi * phase
    pairs = ((jnp.sin(d), jnp.cos(p)), (jnp.cos(d), jnp.sin(p)))
    return sum(jnp.einsum("ni,bic->bnc", x, y, precision="highest") for x, y in pairs) * (2 / len(m)) ** 0.5


def _angles(m: Int[Array, "C"], start: Int[Array, ""], size: int, rate: int, dtype) -> Float[Array, "n C"]:
    """2π times the fractional part of f·x along one axis."""
    bits = _BITS + rate.bit_length()  # 17 + b
    i = start + jnp.arange(size, dtype=jnp.int32)
    wrapped = (m[None] * (2 * i + 1)[:, None]) & (2**bits - 1)
    return wrapped.astype(dtype) * jnp.asarray(2 * np.pi / 2**bits, dtype)
