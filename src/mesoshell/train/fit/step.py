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

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from mesoshell.errors import InputError
from mesoshell.io.exemplars import Exemplars, read_decoder
from mesoshell.io.material import digest, find
from mesoshell.shell.material.decoder import Decoder, init_decoder
from mesoshell.shell.material.field import Layout, Material, Point, neural_field
from mesoshell.shell.material.loader import decoder_of
from mesoshell.texture import mip
from mesoshell.texture.mip import Pyramid
from mesoshell.train.fit.patch_rays import Rays, Shots, rays_at
from mesoshell.train.fit.slab_pixels import predict, residual
from mesoshell.train.update import HERE, Across, descent, not_finite
from mesoshell.typing import Array, Bool, Float, Int, Key, Scalar

#: Patches that the decoder learns from at first.
FEW = 4
#: Cells of an occupancy along h, and at most along v and u; its layers that are renewed in a step; decay of old values.
_DEPTH, _CELLS, _LAYERS, _FADE = 32, 64, 2, 0.8
#: Value of cells before they are first evaluated.
_UNSEEN = 1.5


@dataclass(frozen=True)
class FitConfig:
    """Everything that a fit depends on beside the data. batch, rays: B, R; group: most patches a step; decoded: share of
    its candidates that a row may decode; rates fall to `final` of themselves; patches, appearance: K, and the number of α,
    which follow from the data, as tiles does: patches along the side of a torus, 0 where each is one of its own; kept: steps
    between snapshots; given: a material or exemplars whose decoder and F(h) are kept fixed; given_digest: of that file; held:
    held-out pictures of each patch, in each dataset."""

    texels: int = 256
    channels: int = 32
    height_rows: int = 64
    octaves: int = 4
    trunk: tuple[int, ...] = (64, 64, 64)
    head: tuple[int, ...] = (64, 64)
    batch: int = 8
    rays: int = 256
    group: int = 4
    candidates: int = 96
    decoded: float = 0.45
    rate: float = 1e-2
    texture_rate: float = 3e-2
    final: float = 0.02
    stand: float = 0.1
    settle: float = 0.7
    steps: int = 4000
    kept: int = 1000
    patches: int = 1
    appearance: int = 0
    tiles: int = 0
    given: str = ""
    given_digest: str = ""
    held: int = 0
    seed: int = 0

    @property
    def kimg(self) -> float:
        """Length of the run, thousands of rows."""
        return self.steps * self.batch / 1000

    @property
    def snapshot_kimg(self) -> float:
        return self.kept * self.batch / 1000

    @property
    def at_once(self) -> int:
        """G, a divisor of the rows of a step."""
        return max(g for g in range(1, min(self.group, self.patches) + 1) if self.batch % g == 0)

    @property
    def together(self) -> int:
        """Consecutive rows of a step that show one patch."""
        return self.batch // self.at_once

    @property
    def side(self) -> int:
        """Texels along the side of a texture."""
        return self.texels * max(self.tiles, 1)

    @property
    def layout(self) -> Layout:
        sizes, rows = mip.level_sizes(self.side, self.side), mip.level_sizes(self.height_rows, 1)
        return Layout(sizes, rows, float(self.texels), self.octaves, period=max(self.tiles, 1))


class Common(NamedTuple):
    """Parameters that all patches share. height: F(h)."""

    height: Float[Array, "R 1 C"]
    decoder: Decoder


class Own(NamedTuple):
    """State of each texture, of a patch or of a torus: F(u, v), its Adam state, and its occupancy."""

    feature: Float[Array, "K H W C"]
    adam: Any
    occupancy: Float[Array, "K D V U"]


class FitState(NamedTuple):
    """A fit under way; a pytree of arrays. images: rows seen."""

    common: Common
    common_adam: optax.OptState
    own: Own
    step: Int[Array, ""]
    images: Int[Array, ""]


class FitReport(NamedTuple):
    """Mean squared error; occupied candidates over the decoding budget; which leaves of the gradients are not finite."""

    error: Scalar
    wanted: Scalar
    bad: Bool[Array, "_leaves"]


def fitted(config: FitConfig, shots: Shots) -> tuple[FitConfig, Shots]:
    """The configuration adapted to the data, with the given decoder. Raises InputError if that does not fit them."""
    config = replace(config, patches=len(shots.learned), appearance=shots.alpha.shape[1], tiles=shots.tiles)
    if config.given:
        config, shots = _given(config, shots)
    return config, shots


def _given(config: FitConfig, shots: Shots) -> tuple[FitConfig, Shots]:
    """With a material's decoder and height feature. Raises InputError if the decoder takes other inputs than the data give."""
    path = find(config.given)
    arrays, appearance = read_decoder(path)
    decoder, height = decoder_of(arrays), arrays["height/0"]
    widths = {name: tuple(len(layer.bias) for layer in getattr(decoder, name)) for name in ("trunk", "head")}
    config = replace(config, channels=height.shape[1], height_rows=len(height), given_digest=digest(path), **widths)
    inputs, there = config.channels + 1 + 2 * config.octaves + config.appearance, len(decoder.trunk[0].kernel)
    if there != inputs:
        raise InputError(config.given, f"its decoder takes {there} numbers; the data give {inputs}")
    declared = shots.manifest["parameters"].items()
    theirs = [(p.name, p.range) for p in appearance]
    ours = [(name, (float(p["range"][0]), float(p["range"][1]))) for name, p in declared if p["role"] == "alpha"]
    if theirs != ours:
        raise InputError(config.given, f"its decoder takes {_listed(theirs)}; the data give {_listed(ours)}")
    return config, replace(shots, given=arrays)


def _listed(parameters: list[tuple[str, tuple[float, float]]]) -> str:
    return ", ".join(f"{name} from {low:g} to {high:g}" for name, (low, high) in parameters) or "no parameter"


def feed(config: FitConfig, shots: Shots, host: int = 0, hosts: int = 1) -> Callable[[int], Rays]:
    """This host's rows of step i. Raises InputError if hosts cannot share them."""
    if config.batch % hosts:
        raise InputError("batch", f"{config.batch} is no multiple of the {hosts} hosts")
    mine = range(host * config.batch // hosts, (host + 1) * config.batch // hosts)

    def at(step: int) -> Rays:
        learning = step < config.stand * config.steps and not config.given and not config.tiles
        few = max(FEW, config.at_once) if learning else config.patches
        drawn = np.random.default_rng([config.seed, step])
        group = drawn.permutation(min(few, config.patches))[: config.at_once]
        keys = drawn.integers(0, 2**32, (config.batch, 2), np.uint32)
        rows = []
        for row in mine:
            patch = int(group[row // config.together])
            random = np.random.default_rng([config.seed, step, row + 1])
            pixels = shots.learned[patch]
            rows.append(rays_at(shots, pixels[random.integers(len(pixels), size=config.rays)], patch, keys[row]))
        return Rays(*(np.stack(column) for column in zip(*rows, strict=True)))

    return at


def start(config: FitConfig, shots: Shots, key: Key[Array, ""]) -> FitState:
    """Small random features, and a He-initialised decoder or the given one."""
    keys = jax.random.split(key, 3)
    c, side = config.channels, config.side
    count = 1 if config.tiles else config.patches
    decoder = init_decoder(keys[2], c + 1 + 2 * config.octaves + config.appearance, config.trunk, config.head)
    common = Common(0.1 * jax.random.normal(keys[1], (config.height_rows, 1, c), jnp.float32), decoder)
    if shots.given is not None:
        height = jnp.asarray(shots.given["height/0"], jnp.float32)
        common = Common(height[:, None], jax.tree.map(jnp.copy, decoder_of(shots.given)))
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


def material_of(common: Common, feature: Float[Array, "H W C"]) -> Material:
    """The material of one texture."""
    return Material(mip.pack(mip.build(feature)), mip.pack(mip.build(common.height)), common.decoder)


def texture_of(config: FitConfig, state: FitState, patch: int) -> Float[Array, "H W C"]:
    """The texture that holds a patch."""
    return state.own.feature[0 if config.tiles else patch]


def given(exemplars: Exemplars) -> Callable[[int], Material]:
    """The material of each patch of stored exemplars."""
    height = jnp.asarray(exemplars.height, jnp.float32)[:, None]
    common = Common(height, decoder_of(exemplars.decoder))
    return lambda k: material_of(common, jnp.asarray(exemplars.features[k], jnp.float32))


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
