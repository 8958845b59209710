"""Decoder inputs at all (u, v) of two axes, at one height (shell/material/field has them for one point).

Notation
(v, u)      coordinates along each axis, in patches                               (V,), (U,)
at          height, filter and appearance, the same for all; its (u, v) is ignored
nodes       of F(h), if geometry varies (shell/generator/nodes)
"""

import jax
import jax.numpy as jnp

from mesoshell.shell.material import decoder as net
from mesoshell.shell.material.field import Layout, Material, Point, correction, inputs, spread_of
from mesoshell.texture import mip
from mesoshell.texture.mip import Pyramid
from mesoshell.typing import Array, Float, Scalar


def inputs_on_lattice(
    material: Material, layout: Layout, v: Float[Array, "V"], u: Float[Array, "U"], at: Point
) -> Float[Array, "V U I"]:
    """The inputs of every (u, v)."""
    if layout.cells is not None or layout.colours is not None:
        one = lambda v, u: inputs(material, layout, at._replace(xi=jnp.stack([u, v, at.xi[2]])))  # noqa: E731
        return jax.vmap(jax.vmap(one, (None, 0)), (0, None))(v, u)
    if layout.open and material.origin is not None:
        first = material.origin.astype(jnp.int32).astype(u.dtype)
        u, v = u - first[0], v - first[1]
    u, v = u / layout.period, v / layout.period
    level = mip.level_of(at.radius, layout.texel_density, len(layout.sizes) - 1)
    level_h = mip.level_of(at.height_deviation, float(layout.height_sizes[0][0]), len(layout.height_sizes) - 1)
    plane = mip.lookup_lattice(
        material.texture, layout.sizes, v, u, level, layout.texel_density if layout.open else None
    )
    plane += jnp.broadcast_to(correction(material, layout, at.xi[2], spread_of(at)), plane.shape)
    if layout.nodes is None:
        profile = mip.lookup_height(material.height, layout.height_sizes, at.xi[2], level_h)[None, None]
    else:
        profile = _between_nodes(material.height, layout, layout.nodes, (v, u), (at.xi[2], level_h))
    told = jnp.concatenate([net.encode_height(at.xi[2], layout.octaves), at.alpha])
    return jnp.concatenate([plane + profile, jnp.broadcast_to(told, (*plane.shape[:2], len(told)))], axis=-1)


def _between_nodes(
    pyramid: Pyramid, layout: Layout, nodes: tuple[int, int], along: tuple[Array, Array], at: tuple[Scalar, Scalar]
) -> Float[Array, "V U C"]:
    """F(h) at every (u, v), from F(h) of all nodes. at: h and level."""
    first = jnp.arange(nodes[0] * nodes[1]) * sum(h for h, _ in layout.height_sizes)
    every = jax.vmap(lambda row: mip.lookup_height(pyramid, layout.height_sizes, *at, first=row))(first)
    hats = [_hat(x, n) for x, n in zip(along, nodes, strict=True)]
    return jnp.einsum("vp,uq,pqc->vuc", *hats, every.reshape(*nodes, -1), precision="highest")


def _hat(at: Float[Array, "n"], nodes: int) -> Float[Array, "n m"]:
    """Weights of the nodes for each position on an axis."""
    apart = jnp.clip(at, 0, nodes - 1)[:, None] - jnp.arange(nodes, dtype=at.dtype)[None]
    return jnp.maximum(0, 1 - jnp.abs(apart))
