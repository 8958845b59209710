"""Fit patches to their renders: a feature texture each; one decoder and one height feature for all (an auto-decoder).

Notation
K, G        patches; patches a step
B, R, N     rows a step, each of rays of one patch; rays a row; candidate samples a ray
occupancy   largest recent σ in each cell of (h, v, u) of a patch: candidates in empty cells are not decoded
share       finished share of the run, 0 to 1

A pixel is computed as in the renderer (train/fit/slab_pixels). The loss is, to first order, the mean squared error of x/(1+x)
and alpha. `docs/results/fitting.md` tells what helped and what did not.

With many patches a step sees G of them. In the first `stand` of the run the decoder learns from FEW patches, then from all, at
a falling rate; after `settle` of the run it is frozen and only textures are fitted, so that all have the same decoder.

Patches may be tiles of a torus: they lie side by side in one texture, and the decoder is trained to the end.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import optax

from mesoshell.shell.material.decoder import Decoder, init_decoder
from mesoshell.shell.material.field import Material, Point, neural_field
from mesoshell.shell.material.loader import decoder_of
from mesoshell.texture import mip
from mesoshell.texture.mip import Pyramid
from mesoshell.train.fit.patch_rays import FitData, Rays
from mesoshell.train.fit.slab_pixels import predict, residual
from mesoshell.train.fit.state import Common, FitConfig, FitReport, FitState, Own, material_of
from mesoshell.train.update import HERE, Across, descent, not_finite
from mesoshell.typing import Array, Float, Key, Scalar

#: Cells of an occupancy along h, and at most along v and u; its layers that are renewed in a step; decay of old values.
_DEPTH, _CELLS, _LAYERS, _FADE = 32, 64, 2, 0.8
#: Value of cells before they are first evaluated.
_UNSEEN = 1.5


def start(config: FitConfig, data: FitData, key: Key[Array, ""]) -> FitState:
    """Small random features, and a He-initialised decoder or the given one."""
    keys = jax.random.split(key, 3)
    c, side = config.channels, config.side
    count = 1 if config.tiles else config.patches
    decoder = init_decoder(keys[2], c + 1 + 2 * config.octaves + config.appearance, config.trunk, config.head)
    common = Common(0.1 * jax.random.normal(keys[1], (config.height_rows, 1, c), jnp.float32), decoder)
    if data.given is not None:
        height = jnp.asarray(data.given["height/0"], jnp.float32)
        common = Common(height[:, None], jax.tree.map(jnp.copy, decoder_of(data.given)))
    feature = 0.1 * jax.random.normal(keys[0], (count, side, side, c), jnp.float32)
    cells = min(2 * _CELLS if config.tiles else _CELLS, side)
    occupancy = jnp.full((count, _DEPTH, cells, cells), _UNSEEN, jnp.float32)
    own = Own(feature, jax.vmap(_adam().init)(feature), occupancy)
    return FitState(common, _adam().init(common), own, jnp.zeros((), jnp.int32), jnp.zeros((), jnp.int32))


def step(config: FitConfig, state: FitState, batch: Rays, across: Across = HERE) -> tuple[FitState, FitReport]:
    """One update of the decoder, and of the textures that the rows show. Pure."""
    group = jnp.zeros(1, batch.patch.dtype) if config.tiles else batch.patch[:: config.together]
    own = jax.tree.map(lambda x: x[group], state.own)

    def loss(feature: Array, common: Common) -> tuple[Scalar, Scalar]:
        height = mip.pack(mip.build(common.height))
        row = partial(_row_loss, config, height, common.decoder)
        textures = _pyramids(feature), own.occupancy
        if config.tiles:
            row = partial(row, *jax.tree.map(lambda x: x[0], textures))
            error, wanted = across.each(row)(batch)
        else:
            rows = jax.tree.map(lambda x: jnp.repeat(x, config.together, axis=0), textures)
            error, wanted = across.each(row)(*rows, batch)
        return jnp.mean(error), jnp.mean(wanted)

    which = 0 if config.given else (0, 1)
    (error, wanted), gradient = jax.value_and_grad(loss, which, has_aux=True)(own.feature, state.common)
    for_own, for_common = (gradient, jax.tree.map(jnp.zeros_like, state.common)) if config.given else gradient
    for_common, error, wanted = across.mean((for_common, error, wanted))
    alphas = batch.alpha
    if config.tiles:
        for_own = across.mean(for_own)
        alphas = alphas if across.everyone is None else across.everyone(alphas)[0]
    elif across.everyone is not None:
        everyone, mine = across.everyone, group.shape[0]
        group, own, for_own, alphas = jax.tree.map(lambda x: everyone(x)[0], (group, own, for_own, alphas))
        for_own = for_own * (mine / group.shape[0])  # a device's mean is over its own rows
    bad = not_finite((for_common, for_own))
    share = state.step.astype(error.dtype) / config.steps
    fall = config.final**share
    settled = (share >= config.settle) & (config.patches > 1) & (not config.tiles)
    common, common_adam = state.common, state.common_adam
    if not config.given:
        common, common_adam = _moved(jnp.where(settled, 0.0, config.rate * fall), common, common_adam, for_common)
    feature, adam = jax.vmap(partial(_moved, config.texture_rate * fall))(own.feature, own.adam, for_own)
    keys = jax.vmap(lambda k: jax.random.fold_in(jax.random.key(config.seed), k))(
        own.adam.count * config.patches + group
    )
    look = partial(_looked, config, common, alphas.reshape(-1, *alphas.shape[2:]))
    occupancy = across.each(look)(feature, own.occupancy, own.adam.count, keys)
    own = jax.tree.map(lambda all_, new: all_.at[group].set(new), state.own, Own(feature, adam, occupancy))
    new = FitState(common, common_adam, own, state.step + 1, state.images + config.batch)
    return new, FitReport(error, wanted, bad)


def _adam() -> optax.GradientTransformation:
    return optax.scale_by_adam(0.9, 0.99)


def _moved(rate: Scalar, tree: Any, memory: Any, gradient: Any) -> tuple[Any, Any]:
    updates, memory = descent(_adam(), tree, memory, gradient)
    return jax.tree.map(lambda x, u: x - rate * u, tree, updates), memory


def _pyramids(feature: Float[Array, "G H W C"]) -> Pyramid:
    """Pyramids built from the finest level, as for a generator's texture."""
    return jax.vmap(lambda f: mip.pack(mip.build(f)))(feature)


def _row_loss(
    config: FitConfig, height: Pyramid, decoder: Decoder, texture: Pyramid, occupancy: Array, row: Rays
) -> tuple[Scalar, Scalar]:
    """Mean squared error over the rays with all candidates decoded, and occupied candidates over the budget."""
    jitter = jax.random.uniform(jax.random.wrap_key_data(row.key), (config.rays, config.candidates), jnp.float32)
    jitter = jitter.astype(row.target.dtype)
    y, complete, wanted = predict(
        config.layout, config.decoded, Material(texture, height, decoder), row, occupancy, jitter
    )
    error = jnp.mean(jnp.square(residual(y, row.target)), axis=1)
    return jnp.sum(jnp.where(complete, error, 0.0)) / jnp.maximum(jnp.sum(complete, dtype=error.dtype), 1), wanted


def _looked(
    config: FitConfig, common: Common, alphas: Array, feature: Array, occupancy: Array, count: Array, key: Array
) -> Float[Array, "D V U"]:
    """An occupancy with its next _LAYERS renewed: old values decay, and σ is evaluated at a random point a cell, with the
    appearance of a random ray."""
    depth, rows, columns = occupancy.shape
    first = count * _LAYERS % depth
    some = jax.lax.dynamic_slice_in_dim(occupancy, first, _LAYERS)
    h, v, u = jnp.meshgrid(*(jnp.arange(s, dtype=feature.dtype) for s in some.shape), indexing="ij")
    corner = jnp.stack([u, v, h + first.astype(feature.dtype)], axis=-1).reshape(-1, 3)
    at = corner + jax.random.uniform(key, corner.shape, jnp.float32).astype(feature.dtype)
    period = config.layout.period
    xi = at * jnp.array([[period / columns, period / rows, 1 / depth]], feature.dtype)
    field = neural_field(material_of(common, feature), config.layout)
    zero = jnp.zeros((), feature.dtype)
    alpha = alphas[jax.random.permutation(jax.random.fold_in(key, 1), len(xi)) % len(alphas)]
    sigma = jax.lax.map(lambda x: field.density(Point(x[0], zero, zero, x[1]))[0], (xi, alpha), batch_size=4096)
    return jax.lax.dynamic_update_slice_in_dim(
        occupancy, jnp.maximum(_FADE * some, sigma.reshape(some.shape)), first, 0
    )
