"""The layers' operations by their definitions, slow and plain: what the fast ones are tested against.

Notation
x            samples                                                            (B, H, W, C)
g            filter                                                             (n, m)
w, s         weights (k, k, I, O), styles a sample (B, I)
"""

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.signal.filtered_lrelu import CLAMP, Activation
from mesoshell.signal.modulated import EPSILON
from mesoshell.typing import Array, Float


def upfirdn_plain(
    x: Float[Array, "B H W C"], filter_2d: Float[np.ndarray, "n m"], up: int, down: int, pad: list[int]
) -> Array:
    """Up-sample, filter and down-sample both axes by one depthwise convolution. pad: x before, x after, y before, y after."""
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


def filtered_lrelu_plain(x: Float[Array, "B H W C"], how: Activation) -> Array:
    """Up-sample, bend, down-sample, by depthwise convolutions."""
    row = how.row
    one = np.ones(1)
    up = one if row.up_filter is None else row.up_filter
    down = one if row.down_filter is None else row.down_filter
    x = upfirdn_plain(x, row.up_factor**2 * np.outer(up, up), row.up_factor, 1, list(how.pad))
    x = jnp.clip(jnp.where(x < 0, how.slope * x, x) * how.gain, -CLAMP, CLAMP)
    return upfirdn_plain(x, down if down.ndim == 2 else np.outer(down, down), 1, row.down_factor, [0] * 4)


def modulated_conv_plain(
    x: Float[Array, "B H W I"],
    w: Float[Array, "k k I O"],
    s: Float[Array, "B I"],
    g: Float[Array, ""],
    demodulate: bool,
    pad: int,
) -> Array:
    """The weights of each sample, one convolution a sample."""
    if demodulate:  # each to unit mean square: an output channel's weights, a sample's styles
        w = w / jnp.sqrt(jnp.mean(w**2, axis=(0, 1, 2), keepdims=True))
        s = s / jnp.sqrt(jnp.mean(s**2, axis=-1, keepdims=True))

    def one(x: Array, s: Array) -> Array:
        ws = w * s[None, None, :, None]
        if demodulate:
            ws = ws / jnp.sqrt(jnp.sum(ws**2, axis=(0, 1, 2), keepdims=True) + EPSILON)
        x = jnp.pad(x[None], ((0, 0), (pad, pad), (pad, pad), (0, 0)))
        return jax.lax.conv(
            x.transpose(0, 3, 1, 2),
            (g * ws).transpose(3, 2, 0, 1),
            (1, 1),
            "VALID",
            precision=jax.lax.Precision.HIGHEST,
        ).transpose(0, 2, 3, 1)[0]

    return jax.vmap(one)(x, s)
