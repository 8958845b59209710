"""A leaky ReLU at a higher rate, so that what it adds above the cutoff is filtered away (Alias-Free GAN, figure 4).

Notation
x, y         samples before and after                                          (B, H, W, C)
u, d         factors up and down
g_u, g_d     filters at the temporary rate: g_u separable, g_d separable or radial

y = down_d(g_d ∗ bend(u² g_u ∗ up_u(x))), where bend(x) = gain · lrelu(x), held within ±clamp. A radial filter is no product of
one along x and one along y but, being symmetric, the sum of a few: Σ λ_k e_k e_kᵀ over its eigenvectors, six for twelve taps.
"""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.signal.blocks import Filters, up_bend_down
from mesoshell.signal.schedule import LayerRow
from mesoshell.signal.upfirdn import Resampling, resample
from mesoshell.typing import Array

#: Eigenvalues below this share of the largest are rounding errors.
_NEGLIGIBLE = 1e-12
GAIN, CLAMP = 2**0.5, 256.0


@dataclass(frozen=True, eq=False)
class Activation:
    """A row's factors and filters, with the padding to use: (x before, x after, y before, y after) at the temporary rate."""

    row: LayerRow
    pad: tuple[int, int, int, int]

    @property
    def slope(self) -> float:
        return 1.0 if self.row.is_torgb else 0.2

    @property
    def gain(self) -> float:
        return 1.0 if self.row.is_torgb else GAIN


def filtered_lrelu(x: Float[Array, "B H W C"], how: Activation) -> Array:
    """Up-sample, bend, down-sample, the fastest way on the backend. The derivative is that of `along_axes`."""
    return _fast(x, how)


@partial(jax.custom_vjp, nondiff_argnums=(1,))
def _fast(x: Array, how: Activation) -> Array:
    row = how.row
    if row.up_filter is None or row.down_filter is None or row.up_factor % row.down_factor:
        return along_axes(x, how)
    return jax.lax.platform_dependent(x, cpu=lambda x: in_blocks(x, how), default=lambda x: along_axes(x, how))


_fast.defvjp(lambda x, how: (_fast(x, how), x), lambda how, x, back: jax.vjp(lambda x: along_axes(x, how), x)[1](back))


def in_blocks(x: Float[Array, "B H W C"], how: Activation) -> Array:
    """Block by block of rows and channels: half the time, or less, on a CPU."""
    row = how.row
    assert row.up_filter is not None and row.down_filter is not None
    filters = Filters(row.up_factor, row.down_factor, row.up_factor * row.up_filter, separable(row.down_filter))
    return up_bend_down(x, filters, how.pad, lambda t: _bent(t, how))


def along_axes(x: Float[Array, "B H W C"], how: Activation) -> Array:
    """One axis after the other, on all of x."""
    row = how.row
    if row.up_filter is not None:
        taps = tuple((row.up_factor * row.up_filter).tolist())
        along_x, along_y = (Resampling(taps, row.up_factor, 1, pad) for pad in (how.pad[:2], how.pad[2:]))
        x = resample(resample(x, along_y, 1), along_x, 2)
    elif any(how.pad):
        x = jax.lax.pad(x, jnp.zeros((), x.dtype), [(0, 0, 0), (*how.pad[2:], 0), (*how.pad[:2], 0), (0, 0, 0)])
    x = _bent(x, how)
    if row.down_filter is None:
        return x
    products = [
        [Resampling(tuple(g.tolist()), 1, row.down_factor, (0, 0)) for g in pair] for pair in separable(row.down_filter)
    ]
    parts = [resample(resample(x, along_x, 2), along_y, 1) for along_x, along_y in products]
    return sum(parts[1:], parts[0])


def separable(filter_: np.ndarray) -> list[tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]]:
    """Pairs (along x, along y) of filters, whose products sum to the symmetric 2D filter; a 1D filter is its own pair."""
    if filter_.ndim == 1:
        return [(filter_, filter_)]
    values, vectors = np.linalg.eigh(filter_)
    kept = np.abs(values) > _NEGLIGIBLE * np.abs(values).max()
    return [(vectors[:, k], values[k] * vectors[:, k]) for k in np.flatnonzero(kept)]


def _bent(x: Array, how: Activation) -> Array:
    return jnp.clip(how.gain * jnp.where(x < 0, how.slope * x, x), -CLAMP, CLAMP)
