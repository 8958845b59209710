"""Up-sample, filter, down-sample: plainly, and as products with banded matrices (floor 2).

Alphabet
x, y         samples before and after                                          (B, H, W, C)
g            filter, odd or even; 1D for one axis                               (n,)
u, d         factors: u − 1 zeros after each sample; every d-th sample is kept
a, b         samples added (negative: taken away) before and after at the rate u

y[i] = Σ_k g[n − 1 − k] z[d·i + k], z being x with zeros between, and a and b around. One axis of that is a product with a
matrix whose band is `n` wide and which repeats itself every few rows; blocks of rows share one small dense matrix, so that
a filter runs at the rate of matrix products. `docs/performance.md` compares the two.
"""

from math import ceil, gcd
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.typing import Array

#: Output samples that share one product: fewer add overlap, more add multiplications with zero.
BLOCK = 16


class Resampling(NamedTuple):
    """One axis of an operation; everything is static."""

    filter: Float[np.ndarray, "n"]
    up: int
    down: int
    pad: tuple[int, int]

    def outputs(self, inputs: int) -> int:
        """Number of samples after, from the number before."""
        return (inputs * self.up + sum(self.pad) - len(self.filter)) // self.down + 1


def upfirdn_plain(
    x: Float[Array, "B H W C"], filter_2d: Float[np.ndarray, "n m"], up: int, down: int, pad: list[int]
) -> Array:
    """The definition, both axes at once, by one depthwise convolution. pad: x before, x after, y before, y after."""
    kernel = jnp.asarray(np.ascontiguousarray(filter_2d[::-1, ::-1, None, None]), x.dtype)
    # the convolution puts no zeros after the last sample: u − 1 of them come from the padding
    around = [(pad[2], pad[3] + up - 1), (pad[0], pad[1] + up - 1)]
    return jax.lax.conv_general_dilated(
        x,
        jnp.tile(kernel, (1, 1, 1, x.shape[-1])),
        window_strides=(down, down),
        padding=around,
        lhs_dilation=(up, up),
        dimension_numbers=("NHWC", "HWIO", "NHWC"),
        feature_group_count=x.shape[-1],
        precision=jax.lax.Precision.HIGHEST,
    )


def resample(x: Float[Array, "B H W C"], how: Resampling, axis: int) -> Array:
    """One axis (1 or 2) of the same, by blocks of rows of the banded matrix."""
    outputs = how.outputs(x.shape[axis])
    period = how.up // gcd(how.up, how.down)
    block = min(ceil(outputs / period), max(1, BLOCK // period)) * period
    step = block * how.down // how.up
    matrix, reach = _block_matrix(how, block)
    count = ceil(outputs / block)
    first = -(how.pad[0] // how.up)  # the first block's first input sample
    before, after = -first, first + step * (count - 1) + reach - x.shape[axis]
    windows = _pad(x, axis, before, after)
    parts = [jax.lax.slice_in_dim(windows, k * step, k * step + reach, axis=axis) for k in range(count)]
    stacked = jnp.stack(parts, axis=axis)
    band = jnp.asarray(matrix, x.dtype)
    spec = "oi,bkiwc->bkowc" if axis == 1 else "oi,bhkic->bhkoc"
    y = jnp.einsum(spec, band, stacked, precision=jax.lax.Precision.HIGHEST)
    y = y.reshape(*y.shape[:axis], count * block, *y.shape[axis + 2 :])
    return jax.lax.slice_in_dim(y, 0, outputs, axis=axis)


def _pad(x: Array, axis: int, before: int, after: int) -> Array:
    """Zeros around, or samples taken away, along one axis."""
    config = [(0, 0, 0)] * x.ndim
    config[axis] = (before, after, 0)
    return jax.lax.pad(x, jnp.zeros((), x.dtype), config)


def _block_matrix(how: Resampling, block: int) -> tuple[Float[np.ndarray, "o i"], int]:
    """Matrix of `block` outputs from the input samples that they reach, the first of which is −⌊a/u⌋ (before padding)."""
    taps, up = how.filter[::-1], how.up
    shift = how.pad[0] % up  # where the first input sample lies
    last = (block - 1) * how.down + len(taps) - 1
    reach = (last - shift) // up + 1 if last >= shift else 1
    k = up * np.arange(reach)[None] + shift - how.down * np.arange(block)[:, None]
    inside = (k >= 0) & (k < len(taps))
    return np.where(inside, taps[np.clip(k, 0, len(taps) - 1)], 0.0), reach
