"""Geometry that varies over a texture: w at the corners of patches, and between them (MesoGAN, figure 10).

Notation
node         a corner of patches; a texture of P × Q patches, partial ones included, has (P + 1) × (Q + 1)
β(u, v)      geometry parameters at a place                                            (G,), normalised
w            at each node, of one z and the node's own β                               (1, P + 1, Q + 1, W)
window       the nodes about a tile, the outermost repeated beyond the texture
hat          weights of nodes for a sample: bilinear interpolation, one matrix per axis

w is interpolated, not β: halfway between leans of 350° and of 10° lies a mixture of both, not a lean of 180°.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.typing import Array


def count_nodes(size: tuple[int, int], texels: int) -> tuple[int, int]:
    """Nodes along (v, u) of a texture of `size` texels."""
    return -(-size[0] // texels) + 1, -(-size[1] // texels) + 1


def window(nodes: Any, first: tuple[int, int], count: int) -> Any:
    """count × count nodes of an array (1, P, Q, …), NumPy or JAX, from `first` on, which may lie outside."""
    v, u = (np.clip(np.arange(at, at + count), 0, n - 1) for at, n in zip(first, nodes.shape[1:3], strict=True))
    return nodes[:, v][:, :, u]


def hat(first: int, size: int, rate: float, before: int, count: int) -> Float[np.ndarray, "S N"]:
    """Weights of `count` nodes, the first of which lies `before` patches before 0, for samples (first + i + ½)/rate."""
    at = (first + np.arange(size) + 0.5) / rate + before
    return np.maximum(0.0, 1 - np.abs(at[:, None] - np.arange(count))).astype(np.float32)


def spread_out(
    nodes: Float[Array, "B P Q N"], along: tuple[Float[np.ndarray, "V P"], Float[np.ndarray, "U Q"]]
) -> Float[Array, "B V U N"]:
    """Values between nodes."""
    v, u = (jnp.asarray(a, nodes.dtype) for a in along)
    return jnp.einsum("vp,bpqn,uq->bvun", v, nodes, u, precision="highest")
