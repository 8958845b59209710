"""Export to a bundle: a fitted patch with its pyramids and σ grid, or a generator's weights.

The share of unseen points above the σ grid, and the largest σ above it, go into the bundle's provenance as
`grid_excess_share` and `grid_excess_sigma`; the decoder's error in 16 bits as `decoder_error`, for a generator at one patch of
seed 0 with every geometry parameter in the middle of its range.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.io.bundle import Bundle, Parameter
from mesoshell.io.corner_tiles import SIDE
from mesoshell.io.exemplars import Exemplars
from mesoshell.shell.generator.generator import Averages, Generator, synthesise, synthesise_height
from mesoshell.shell.generator.model import GeneratorModel, generator_arrays, generator_fields, grown
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.shell.material.decoder import Decoder
from mesoshell.shell.material.density_bounds import bounds, new_points
from mesoshell.shell.material.field import Layout, Material
from mesoshell.shell.material.loader import decoder_of, load_device_material
from mesoshell.shell.material.precision import decoder_error
from mesoshell.texture import mip
from mesoshell.train.fit.state import Common, FitConfig
from mesoshell.train.gan.state import GanConfig, Learner
from mesoshell.typing import Array, Float

CELLS_UV, CELLS_H, PROBES = 64, 32, 256
#: Datasets show the unit box, so a material is as high as a patch is wide.
HEIGHT = 1.0


def to_bundle(
    config: FitConfig,
    common: Common,
    feature: Float[Array, "H W C"],
    declared: tuple[Parameter, ...],
    provenance: dict,
    colours: Sequence[Sequence[int]] | None = None,
) -> Bundle:
    """A bundle of kind `shell`. declared: the dataset's parameters; provenance: config, dataset, commit, metrics; colours: of
    the corner tiles, if the feature is a torus of them."""
    layout = config.layout
    levels = mip.build(feature), mip.build(common.height)
    whole = layout.sizes.index((layout.period, layout.period))  # a texel a patch: coarser levels average many tiles
    levels[0][whole + 1 :] = [jnp.broadcast_to(levels[0][-1], x.shape) for x in levels[0][whole + 1 :]]
    material = half(Material(mip.pack(levels[0]), mip.pack(levels[1]), common.decoder))
    grids = _grids(layout, material)
    if colours is not None:
        layout = replace(layout, colours=tuple(tuple(row) for row in colours))
        grids = [_any_neighbour(grid) for grid in grids]
    entries: dict[str, Any] = _excess(layout, material, grids)
    flat = np.asarray(feature), np.asarray(common.height)[:, 0]
    entries["decoder_error"] = decoder_error(common.decoder, *flat, config.octaves)
    arrays: dict[str, np.ndarray] = {}
    for i, level in enumerate(levels[0]):
        arrays[f"features/{i}"] = np.asarray(level, np.float16)
    for i, level in enumerate(levels[1]):
        arrays[f"height/{i}"] = np.asarray(level[:, 0], np.float16)
    for i, grid in enumerate(grids):
        arrays[f"grid/{i}"] = grid
    arrays |= decoder_arrays(common.decoder)
    return Bundle(
        kind="shell",
        texel_density=float(config.texels),
        channels=config.channels,
        height_octaves=config.octaves,
        parameters=declared,
        thickness=HEIGHT,
        colour_space="linear Rec. 709",
        provenance=provenance | entries,
        arrays={k: np.asarray(v) for k, v in arrays.items()},
        tiles=layout.colours,
    )


def patch_bundle(exemplars: Exemplars, patch: int) -> Bundle:
    """One of many patches that were fitted together, as a bundle. Its geometry is fixed: it has only appearance parameters.
    Raises InputError if it is a tile."""
    exemplars.check_periodic()
    feature, height = (jnp.asarray(x, jnp.float32) for x in (exemplars.features[patch], exemplars.height))
    side, channels = feature.shape[0], feature.shape[2]
    config = FitConfig(texels=side, channels=channels, height_rows=len(height), octaves=exemplars.height_octaves)
    common = Common(height[:, None], decoder_of(exemplars.decoder))
    alphas = tuple(p for p in exemplars.parameters if p.role == "alpha")
    beta = [float(x) for x in exemplars.beta[patch]]
    return to_bundle(config, common, feature, alphas, exemplars.provenance | {"patch": patch, "beta": beta})


def declared_parameters(manifest: dict[str, Any]) -> tuple[Parameter, ...]:
    """A dataset's parameters, as a bundle declares them."""
    return tuple(
        Parameter(
            n, p["role"], (float(p["range"][0]), float(p["range"][1])), float(p["default"]), p["unit"], p["meaning"]
        )
        for n, p in manifest["parameters"].items()
    )


def half(material: Material) -> Material:
    """The material with its features in half precision, as a bundle holds them."""
    texture, height = jax.tree.map(lambda x: x.astype(jnp.float16), (material.texture, material.height))
    return material._replace(texture=texture, height=height)


def generator_bundle(
    config: GanConfig,
    learner: Learner,
    averages: Averages,
    declared: tuple[Parameter, ...],
    provenance: dict,
) -> Bundle:
    """A bundle that makes textures, from a GAN's run."""
    made = learner.generator, averages, learner.decoder
    return generated_bundle(config.generator, *made, config.picture.octaves, declared, provenance)


def generated_bundle(
    config: GeneratorConfig,
    generator: Generator,
    averages: Averages,
    decoder: Decoder,
    octaves: int,
    declared: tuple[Parameter, ...],
    provenance: dict,
) -> Bundle:
    """A bundle that makes textures: the generator's and the decoder's weights, and no texture."""
    feature, height = (np.asarray(x) for x in _patch(config, generator, averages, decoder, octaves))
    entries = {"decoder_error": decoder_error(decoder, feature, height, octaves)}
    return Bundle(
        kind="shell",
        texel_density=float(config.texels),
        channels=config.channels,
        height_octaves=octaves,
        parameters=declared,
        thickness=HEIGHT,
        colour_space="linear Rec. 709",
        provenance=provenance | entries,
        arrays=decoder_arrays(decoder) | generator_arrays(generator, averages),
        wraps=False,
        generator=generator_fields(config),
    )


@partial(jax.jit, static_argnums=(0, 4))
def _patch(
    g: GeneratorConfig, generator: Generator, averages: Averages, decoder: Decoder, octaves: int
) -> tuple[Float[Array, "V U C"], Float[Array, "R C"]]:
    """F and F(h) of one patch of seed 0; with three planes, sums of their texels at the same places."""
    side = g.texels
    w, phases = grown(GeneratorModel(g, generator, averages, decoder, octaves), 0, np.full(g.betas, 0.5, np.float32))
    corner = jnp.zeros(2, jnp.int32)
    texture = synthesise(g, generator, averages, w, phases, corner, (side, side))
    feature = texture.feature[0].reshape(side, side, g.planes, g.channels).sum(axis=2)
    return feature, synthesise_height(g, generator, w)[0]


def decoder_arrays(d: Decoder) -> dict[str, np.ndarray]:
    """The decoder's arrays by their keys in a bundle, float32."""
    named = {f"trunk/{i}": x for i, x in enumerate(d.trunk)} | {f"head/{i}": x for i, x in enumerate(d.head)}
    named |= {"sigma": d.sigma, "rho": d.rho}
    kernels = {f"decoder/{k}/kernel": np.asarray(v.kernel, np.float32) for k, v in named.items()}
    biases = {f"decoder/{k}/bias": np.asarray(v.bias, np.float32) for k, v in named.items()}
    return kernels | biases | {"sigma_scale": np.asarray(d.scale, np.float32)}


def grids_of(bundle: Bundle) -> tuple[dict[str, np.ndarray], dict[str, float]]:
    """The σ grid's arrays of a texture that wraps, and how far σ is above it."""
    made = load_device_material(bundle)
    grids = _grids(replace(made.layout, colours=None), made.material)
    if bundle.tiles is not None:
        grids = [_any_neighbour(grid) for grid in grids]
    return {f"grid/{i}": grid for i, grid in enumerate(grids)}, _excess(made.layout, made.material, grids)


def _grids(layout: Layout, material: Material) -> list[np.ndarray]:
    """Bounds of every cell of every level."""
    most = CELLS_UV if layout.period == 1 else 2 * CELLS_UV
    shapes = [(CELLS_H, min(most, rows), min(most, columns)) for rows, columns in layout.sizes]
    all_ = np.array([[0.0, 0.0], [layout.period, layout.period]])
    return [bounds(layout, material, level, shape, all_, PROBES) for level, shape in enumerate(shapes)]


def _any_neighbour(grid: np.ndarray) -> np.ndarray:
    """Bounds that hold for any neighbouring tiles. The outermost cells of a tile interpolate texels of its neighbours, so each
    takes the largest bound of all tiles at its place along the edge."""
    layers, side = grid.shape[0], grid.shape[1]
    if side < SIDE:
        return grid
    tiles = grid.reshape(layers, SIDE, side // SIDE, SIDE, side // SIDE).copy()
    tiles[..., [0, -1]] = tiles[..., [0, -1]].max(axis=(1, 3, 4), keepdims=True)
    tiles[:, :, [0, -1]] = tiles[:, :, [0, -1]].max(axis=(1, 2, 3), keepdims=True)
    return tiles.reshape(grid.shape)


def _excess(layout: Layout, material: Material, grids: list[np.ndarray]) -> dict[str, float]:
    """How often, and by how much, σ exceeds the bound at 200 000 new points of each of the finest three levels."""
    above, most, total = 0, 0.0, 0
    for level in range(min(3, len(grids))):
        place = (jnp.zeros(2), jnp.full(2, 16.0 * layout.period if layout.colours else float(layout.period)))
        xi, sigma = new_points(layout, material, np.float32(level), 200_000, place, jax.random.key(1000 + level))
        shape = np.array(grids[level].shape)
        uv = np.asarray(jax.vmap(layout.on_texture)(xi[:, :2]))
        at = np.stack([np.asarray(xi[:, 2]), uv[:, 1], uv[:, 0]], axis=1)
        cell = np.minimum((at * shape).astype(int), shape - 1)
        over = np.asarray(sigma) - grids[level].astype(np.float32)[tuple(cell.T)]
        above, most, total = above + int((over > 0).sum()), max(most, float(over.max())), total + len(over)
    return {"grid_excess_share": above / total, "grid_excess_sigma": most}
