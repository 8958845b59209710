"""From fitted parameters to a bundle: half-precision pyramids, decoder, and the σ bounds that skip empty space.

Alphabet
grid l      (G, G, G_uv) cells of (h, v, u); holds the largest σ seen in the cell for filter levels in [l, l + 1)
margin      what each cell's maximum is multiplied by
excess      share of random points whose σ exceeds their cell's bound, measured on points that the grid has not seen

The bound is a measured one. Each cell's σ is looked at in PROBES random places, a tenth of a cell beyond its walls
included, at random levels, heights' filters and parameters. The share of unseen points above it, and the largest optical
depth that such a point can hide, go into the bundle's provenance as `grid_excess_share` and `grid_excess_sigma`.
"""

from collections.abc import Iterator
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.io.bundle import Bundle, Parameter
from mesoshell.shell.field import Layout, Material, Point, neural_field
from mesoshell.texture import mip
from mesoshell.train.fit import FitConfig, Parameters, layout_of, material_of
from mesoshell.typing import Array

CELLS_UV, CELLS_H, PROBES, MARGIN = 64, 32, 256, 1.5


def to_bundle(
    config: FitConfig,
    parameters: Parameters,
    declared: tuple[Parameter, ...],
    provenance: dict,
) -> Bundle:
    """A bundle of kind `shell`. declared: the dataset's parameters; provenance: config, dataset, commit, metrics."""
    layout = layout_of(config)
    material = half(material_of(parameters))
    appearance = sum(p.role == "alpha" for p in declared)
    grids = [g.astype(np.float16) for g in _grids(layout, material, appearance)]
    excess = _excess(layout, material, appearance, grids)
    arrays: dict[str, np.ndarray] = {"sigma_scale": np.asarray(parameters.decoder.scale, np.float32)}
    for i, level in enumerate(mip.build(parameters.feature)):
        arrays[f"features/{i}"] = np.asarray(level, np.float16)
    for i, level in enumerate(mip.build(parameters.height)):
        arrays[f"height/{i}"] = np.asarray(level[:, 0], np.float16)
    for i, grid in enumerate(grids):
        arrays[f"grid/{i}"] = grid
    arrays |= _decoder_arrays(parameters)
    return Bundle(
        kind="shell",
        texel_density=float(config.texels),
        channels=config.channels,
        height_octaves=config.octaves,
        parameters=declared,
        thickness=1.0,
        colour_space="linear Rec. 709",
        provenance=provenance | excess,
        arrays={k: np.asarray(v) for k, v in arrays.items()},
    )


def half(material: Material) -> Material:
    """The material with its features in half precision: what a bundle holds."""
    texture, height = jax.tree.map(lambda x: x.astype(jnp.float16), (material.texture, material.height))
    return material._replace(texture=texture, height=height)


def _decoder_arrays(parameters: Parameters) -> dict[str, np.ndarray]:
    d = parameters.decoder
    named = {f"trunk/{i}": x for i, x in enumerate(d.trunk)} | {f"head/{i}": x for i, x in enumerate(d.head)}
    named |= {"sigma": d.sigma, "rho": d.rho}
    kernels = {f"decoder/{k}/kernel": np.asarray(v.kernel, np.float32) for k, v in named.items()}
    return kernels | {f"decoder/{k}/bias": np.asarray(v.bias, np.float32) for k, v in named.items()}


def _grids(layout: Layout, material: Material, appearance: int) -> list[np.ndarray]:
    """Largest σ of every cell of every level, with the margin."""
    grids = []
    for level, (rows, columns) in enumerate(layout.sizes):
        shape = (CELLS_H, min(CELLS_UV, rows), min(CELLS_UV, columns))
        largest = jnp.zeros(shape)
        for key in _keys(level):
            corner = jnp.stack(jnp.meshgrid(*(jnp.arange(n, dtype=jnp.float32) for n in shape), indexing="ij"), -1)
            inside = corner + jax.random.uniform(key, corner.shape, minval=-0.1, maxval=1.1)
            xi = (inside.reshape(-1, 3) / jnp.array([shape], jnp.float32))[:, ::-1]
            sigma = _sigma(layout, material, xi, np.float32(level), appearance, key)
            largest = jnp.maximum(largest, sigma.reshape(shape))
        grids.append(np.minimum(np.asarray(largest) * MARGIN, np.finfo(np.float16).max))
    return grids


def _keys(level: int) -> Iterator[Array]:
    return iter(jax.random.split(jax.random.key(level), PROBES))


@partial(jax.jit, static_argnums=(0, 4))
def _sigma(layout: Layout, material: Material, xi: Array, level: Array, appearance: int, key: Array) -> Array:
    """σ at points of a level, with random heights' filters and parameters, and fractions of a level: half of them 0.

    Unfiltered features have the greatest extremes, and all of a close view is unfiltered.
    """
    k = jax.random.split(key, 3)
    n = xi.shape[0]
    at = level + jnp.maximum(jax.random.uniform(k[0], (n,), minval=-1.0), 0)
    radius = jnp.where(at == 0, 0.0, 2.0**at / (2 * layout.texel_density))
    deviation = radius * jax.random.uniform(k[1], (n,), maxval=2.0)
    alpha = jax.random.uniform(k[2], (n, appearance))
    points = Point(xi.at[:, 2].set(jnp.clip(xi[:, 2], 0, 1)), radius, deviation, alpha)
    return jax.lax.map(lambda p: neural_field(material, layout).density(p)[0], points, batch_size=4096)


def _excess(layout: Layout, material: Material, appearance: int, grids: list[np.ndarray]) -> dict[str, float]:
    """How often, and by how much, σ exceeds the bound at 200 000 new points of each of the finest three levels."""
    above, most, total = 0, 0.0, 0
    for level in range(min(3, len(grids))):
        key = jax.random.key(1000 + level)
        xi = jax.random.uniform(key, (200_000, 3))
        sigma = np.asarray(_sigma(layout, material, xi, np.float32(level), appearance, jax.random.fold_in(key, 1)))
        shape = np.array(grids[level].shape)
        cell = np.minimum((np.asarray(xi)[:, ::-1] * shape).astype(int), shape - 1)
        over = sigma - grids[level].astype(np.float32)[tuple(cell.T)]
        above, most, total = above + int((over > 0).sum()), max(most, float(over.max())), total + len(over)
    return {"grid_excess_share": above / total, "grid_excess_sigma": most}
