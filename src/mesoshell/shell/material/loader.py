"""A bundle's arrays in JAX, packed for lookup.

Notation
grid        largest σ over cells of (h, v, u), one grid a mip level; grid l bounds σ for levels in [l, l + 1)
"""

import hashlib
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.io.bundle import Bundle
from mesoshell.io.corner_tiles import SIDE
from mesoshell.io.level_arrays import flatten
from mesoshell.nets.mlp import Dense
from mesoshell.shell.material.corner_tiles import Origin, as_origin
from mesoshell.shell.material.decoder import Decoder
from mesoshell.shell.material.field import Layout, Material
from mesoshell.texture import mip
from mesoshell.typing import Array


class Grid(NamedTuple):
    """The σ bounds of all levels, flattened; origin: as of the material."""

    values: Float[Array, "G"]
    origin: Origin | None = None


@dataclass(frozen=True, eq=False)
class DeviceMaterial:
    """A bundle ready to be evaluated: arrays, and their static layout. densities: baked ones, as they are made
    (shell/material/baked_density)."""

    material: Material
    layout: Layout
    grid: Grid
    grid_shapes: tuple[tuple[int, int, int], ...]
    names: tuple[str, ...]
    #: Whether features of the finest level are corrected: those of a texture whose finer levels are left out.
    finest_corrected: bool = False
    densities: dict[Any, Array] = field(default_factory=dict, init=False)

    @cached_property
    def digest(self) -> str:
        """A hash of all that σ of the finest level depends on, wherever it begins."""
        layout, decoder, of = self.layout, self.material.decoder, self.material_for(filtering=False)
        finest = of.texture.rows[: layout.sizes[0][0] * layout.sizes[0][1]]
        sha = hashlib.sha256(repr(layout).encode())
        for x in jax.tree.leaves((finest, of.height, of.correction, decoder.trunk, decoder.sigma, decoder.scale)):
            sha.update(f"{x.dtype} {x.shape} ".encode() + np.asarray(x).tobytes())
        return sha.hexdigest()

    def material_for(self, filtering: bool) -> Material:
        """The material as it is read with filtering, or without: then no correction is looked up that is 0."""
        return self.material if filtering or self.finest_corrected else self.material._replace(correction=None)


def load_device_material(bundle: Bundle, origin: tuple[int, int] = (0, 0)) -> DeviceMaterial:
    """Pack a bundle's features for lookup. The arrays keep the bundle's precision; half is twice as fast to gather. On a CPU
    the mapped levels of a folder are not copied, if they lie one after the other.

    origin: (u, v), in whole patches, at which a texture with edges begins, or that of a seed of corner tiles.
    """
    a = bundle.arrays
    levels = [a[f"features/{i}"] for i in range(_count(a, "features/{}"))]
    varies = "heights/0" in a
    heights = [a[f"heights/{i}"] if varies else a[f"height/{i}"][None, None] for i in range(_count(a, "height/{}"))]
    grids = [a[f"grid/{i}"] for i in range(len(levels))]
    layout = Layout(
        tuple(x.shape[:2] for x in levels),
        tuple((x.shape[2], 1) for x in heights),
        float(bundle.texel_density),
        bundle.height_octaves,
        not bundle.wraps,
        nodes=heights[0].shape[:2] if varies else None,
        period=1 if bundle.tiles is None else SIDE,
        colours=bundle.tiles,
    )
    rows = flatten(levels).reshape(-1, bundle.channels)
    material = Material(
        mip.Pyramid(jax.device_put(rows, may_alias=not rows.flags.writeable)),
        mip.Pyramid(jnp.asarray(pack_heights(heights).reshape(-1, bundle.channels))),
        decoder_of(a),
        jnp.asarray(a["correction"]) if "correction" in a else None,
        as_origin(origin),
    )
    flat = np.concatenate([g.ravel() for g in grids]).astype(np.float32)
    names = tuple(p.name for p in bundle.parameters if p.role == "alpha")
    shapes = tuple(g.shape for g in grids)
    return DeviceMaterial(
        material, layout, Grid(jnp.asarray(flat), material.origin), shapes, names, bundle.finest_corrected
    )


def pack_heights(levels: list[Float[np.ndarray, "P Q _r C"]]) -> Float[np.ndarray, "P Q R C"]:
    """Levels of F(h) at each node, one after the other."""
    return np.concatenate(levels, axis=2)


def _count(arrays: dict[str, np.ndarray], key: str) -> int:
    n = 0
    while key.format(n) in arrays:
        n += 1
    return n


def decoder_of(a: dict[str, np.ndarray]) -> Decoder:
    """The decoder of a bundle's arrays."""

    def dense(name: str) -> Dense:
        return Dense(jnp.asarray(a[f"{name}/kernel"], jnp.float32), jnp.asarray(a[f"{name}/bias"], jnp.float32))

    def layers(name: str) -> list[Dense]:
        return [dense(f"{name}/{i}") for i in range(_count(a, name + "/{}/kernel"))]

    scale = jnp.asarray(a["sigma_scale"], jnp.float32)
    return Decoder(layers("decoder/trunk"), dense("decoder/sigma"), layers("decoder/head"), dense("decoder/rho"), scale)
