"""Three planes in place of a plane and a height feature: the baseline of MesoGAN, section 6.2.

Notation
plane        0 on (u, v), 1 on (u, h), 2 on (v, h), each of n × n texels a patch; F is the sum of the three
cell         a patch of surface. Each has planes of its own: those on (u, h) and (v, h) end at its sides
r, σ_h       standard deviations of the filter on the tangent plane, in patches, and along the height
T            texels of one plane's pyramid

Rows of the pyramid are ordered by cell (v, then u), then plane, then level.
"""

import jax.numpy as jnp

from mesoshell.texture import mip
from mesoshell.texture.mip import Pyramid, Sizes
from mesoshell.typing import Array, Float, Scalar, Vec3

PLANES = 3


def pack_planes(feature: Float[Array, "V U C3"], sizes: Sizes) -> Pyramid:
    """The pyramid of all cells, from their planes side by side in the channels: (V/n · U/n · 3T, C). sizes: of one plane."""
    texels = sizes[0][0]
    rows, columns = feature.shape[0] // texels, feature.shape[1] // texels
    planes = feature.reshape(rows, texels, columns, texels, PLANES, -1).transpose(0, 2, 4, 1, 3, 5)
    cells = planes.reshape(-1, texels, texels, planes.shape[-1])
    levels = mip.build(jnp.moveaxis(cells, 0, -2).reshape(texels, texels, -1))[: len(sizes)]
    channels = planes.shape[-1]
    by_cell = [jnp.moveaxis(x.reshape(-1, len(cells), channels), 1, 0) for x in levels]
    return Pyramid(jnp.concatenate(by_cell, axis=1).reshape(-1, channels))


def lookup_planes(
    pyramid: Pyramid, sizes: Sizes, cells: tuple[int, int], xi: Vec3, radius: Scalar, deviation: Scalar
) -> Float[Array, "C"]:
    """F at ξ. sizes: of one plane's levels; cells: how many there are along (v, u). As on a plane, the filter is as narrow as
    the narrower of its two axes."""
    texels = sizes[0][0]
    last = jnp.array(cells[::-1], xi.dtype) - 1
    cell = jnp.clip(jnp.floor(xi[:2]), 0, last)
    u, v = jnp.clip(xi[:2] - cell, 0, 1)
    at = cell.astype(jnp.int32)
    rows = sum(h * w for h, w in sizes)
    first = (at[1] * cells[1] + at[0]) * PLANES * rows
    flat = mip.level_of(radius, float(texels), len(sizes) - 1)
    side = mip.level_of(jnp.minimum(radius, deviation), float(texels), len(sizes) - 1)
    places = ((u, v, flat), (u, xi[2], side), (v, xi[2], side))
    features = [
        mip.lookup(pyramid, sizes, jnp.stack([x, y]), level, float(texels), first + k * rows)
        for k, (x, y, level) in enumerate(places)
    ]
    return features[0] + features[1] + features[2]
