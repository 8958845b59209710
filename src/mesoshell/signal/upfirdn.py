"""Up-sample, filter, down-sample, phase by phase.

Notation
x, y         samples before and after                                          (B, H, W, C)
g            filter, odd or even; 1D for one axis                               (n,)
u, d         factors: u − 1 zeros after each sample; every d-th sample is kept
a, b         samples added (negative: taken away) before and after at the rate u

y[i] = Σ_j g[n − 1 − k] x[j], k = uj + a − di in [0, n). The outputs i = p + mP, P = u/gcd(u, d), use the same taps: with
Q = d/gcd(u, d), y[p + mP] = Σ_t g[n − 1 − (ut + a − dp)] x[mQ + t], a sum of few shifted copies that a compiler makes in one
pass over memory. Its transpose has the same form, with u and d exchanged and g reversed; what automatic differentiation
makes of slices is 20 times slower. `docs/results/performance.md` compares both with the definition, which is in the tests.
"""

from math import ceil, gcd
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Float

from mesoshell.typing import Array


class Resampling(NamedTuple):
    """One axis of an operation; everything is static. filter: a tuple, which is hashable."""

    filter: tuple[float, ...]
    up: int
    down: int
    pad: tuple[int, int]

    def outputs(self, inputs: int) -> int:
        """Number of samples after, from the number before."""
        return (inputs * self.up + sum(self.pad) - len(self.filter)) // self.down + 1

    def transposed(self, inputs: int) -> "Resampling":
        """The transposed operation, from this one's outputs to its `inputs`."""
        n, before = len(self.filter), len(self.filter) - 1 - self.pad[0]
        after = (inputs - 1) * self.up + n - self.outputs(inputs) * self.down - before
        return Resampling(self.filter[::-1], self.down, self.up, (before, after))


def resample(x: Float[Array, "B H W C"], how: Resampling, axis: int) -> Array:
    """One axis (1 or 2), phase by phase."""
    return _linear(x, how, axis)


def _phases(x: Array, how: Resampling, axis: int) -> Array:
    outputs, inputs = how.outputs(x.shape[axis]), x.shape[axis]
    common = gcd(how.up, how.down)
    period, stride = how.up // common, how.down // common
    count = ceil(outputs / period)
    spans = [_taps(how, phase) for phase in range(period)]
    first = min(t for t, _ in spans)
    last = max(t + len(g) for t, g in spans) + stride * (count - 1)  # one past the last sample needed
    config = [(0, 0, 0)] * x.ndim
    config[axis] = (max(0, -first), max(0, last - inputs), 0)
    x = jax.lax.pad(x, jnp.zeros((), x.dtype), config)
    shift = max(0, -first)

    def shifted(t: int) -> Array:
        begin = t + shift
        return jax.lax.slice_in_dim(x, begin, begin + stride * (count - 1) + 1, stride=stride, axis=axis)

    phases = [sum((shifted(t + k) * g[k] for k in range(1, len(g))), shifted(t) * g[0]) for t, g in spans]
    y = phases[0] if period == 1 else jnp.stack(phases, axis=axis + 1)
    y = y.reshape(*x.shape[:axis], count * period, *x.shape[axis + 1 :])
    return jax.lax.slice_in_dim(y, 0, outputs, axis=axis)


def _taps(how: Resampling, phase: int) -> tuple[int, tuple[float, ...]]:
    """First t of a phase, and the taps from there on; a phase without taps has a zero one."""
    k0 = how.pad[0] - how.down * phase  # k at t = 0
    t = -(k0 // how.up)
    taps = how.filter[::-1][k0 + how.up * t :: how.up]
    return (t, taps) if taps else (0, (0.0,))


def _forward(x: Array, how: Resampling, axis: int) -> tuple[Array, int]:
    return _linear(x, how, axis), x.shape[axis]


def _backward(how: Resampling, axis: int, inputs: int, y: ArrayLike) -> tuple[Array]:
    return (_linear(jnp.asarray(y), how.transposed(inputs), axis),)


_linear: Any = jax.custom_vjp(_phases, nondiff_argnums=(1, 2))
_linear.defvjp(_forward, _backward)
