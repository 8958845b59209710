"""Fit one material to renders of one fixed slab: features, height feature and decoder together.

Alphabet
B, N, M     rays a step; candidate samples a ray; samples a step that are decoded
s           position along a ray in canonical length, 0 to the length of its intervals
occupancy   largest σ seen lately in each cell of (h, v, u): candidates in empty cells are not decoded
x, y        radiance; x/(1+x) of it, and alpha

The model of a pixel is the renderer's: spread samples over the intervals in proportion to canonical length, filter,
decode, sum optical depth, composite. Loss: mean squared error of x/(1+x) and alpha alike, to first order (`residual`). What
helped and what did not is in `docs/fitting.md`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from mesoshell.numerics import optical_depth
from mesoshell.render.composite import tonemap, weights
from mesoshell.render.cone import cone_gaussian
from mesoshell.shell import decoder as net
from mesoshell.shell.decoder import Decoder, direction, init_decoder
from mesoshell.shell.field import Layout, Material, Point, inputs, neural_field
from mesoshell.texture import mip
from mesoshell.texture.footprint import footprint
from mesoshell.train.parallel import mean_gradient
from mesoshell.train.rays import ImageTable, RayTable
from mesoshell.typing import Array, Bool, Float, Key, Scalar

#: Samples a tile of the network: forward and backward pass of one tile stay in a core's cache.
_TILE = 1024
#: 1 − y of the brightest target and prediction that count as such: a firefly is of radiance 99 (renders of the recipe stay
#: below 14), and a prediction never infinite.
_FIREFLY, _DARKEST = 1e-2, 1e-6


@dataclass(frozen=True)
class FitConfig:
    """Everything that a fit depends on beside the data. decoded: share of the candidates that a step has room to decode."""

    texels: int = 256
    channels: int = 32
    height_rows: int = 64
    octaves: int = 4
    trunk: tuple[int, ...] = (64, 64, 64)
    head: tuple[int, ...] = (64, 64)
    rays: int = 2048
    candidates: int = 96
    decoded: float = 0.45
    rate: float = 1e-2
    texture_rate: float = 3e-2
    final: float = 0.02
    seed: int = 0


class Parameters(NamedTuple):
    """What is optimised. feature: (H, W, C); height: (R, 1, C)."""

    feature: Float[Array, "H W C"]
    height: Float[Array, "R 1 C"]
    decoder: Decoder


class State(NamedTuple):
    """A fit under way; a pytree of arrays, so that any checkpoint format holds it."""

    parameters: Parameters
    optimiser: optax.OptState
    occupancy: Float[Array, "D H W"]
    step: Array


def layout_of(config: FitConfig) -> Layout:
    sizes = mip.level_sizes(config.texels, config.texels)
    return Layout(sizes, mip.level_sizes(config.height_rows, 1), float(config.texels), config.octaves)


def initialise(config: FitConfig, appearance: int) -> Parameters:
    """Small random features and a He-initialised decoder. appearance: number of α parameters."""
    keys = jax.random.split(jax.random.key(config.seed), 3)
    c = config.channels
    inputs = c + 1 + 2 * config.octaves + appearance
    return Parameters(
        feature=0.1 * jax.random.normal(keys[0], (config.texels, config.texels, c), jnp.float32),
        height=0.1 * jax.random.normal(keys[1], (config.height_rows, 1, c), jnp.float32),
        decoder=init_decoder(keys[2], inputs, config.trunk, config.head),
    )


def material_of(parameters: Parameters) -> Material:
    """Pyramids built from the finest level, as a generator's texture will be."""
    texture, height = (mip.pack(mip.build(x)) for x in (parameters.feature, parameters.height))
    return Material(texture, height, parameters.decoder)


class Candidates(NamedTuple):
    """Samples along rays, (B, N, …): ξ, canonical length each stands for, r, σ_h."""

    xi: Float[Array, "*batch 3"]
    length: Float[Array, "*batch"]
    radius: Float[Array, "*batch"]
    deviation: Float[Array, "*batch"]


def spread(t: Float[Array, "2 2"], xi: Float[Array, "2 2 3"], d: Array, cone: Scalar, jitter: Array) -> Candidates:
    """Samples of one ray in the unit box (J = 1), at equal canonical spacing, each jittered within its share."""
    n = jitter.shape[0]
    lengths = jnp.linalg.norm(xi[:, 1] - xi[:, 0] + 1e-12, axis=-1)
    total = jnp.sum(lengths)
    s = (jnp.arange(n, dtype=jitter.dtype) + jitter) / n * total
    second = (s > lengths[0]).astype(jnp.int32)
    share = jnp.clip((s - jnp.where(second == 1, lengths[0], 0.0)) / (lengths[second] + 1e-9), 0, 1)
    distance = t[second, 0] + share * (t[second, 1] - t[second, 0])
    points = xi[second, 0] + share[:, None] * (xi[second, 1] - xi[second, 0])
    half = total / n / 2
    g = jax.vmap(cone_gaussian, in_axes=(0, 0, None))(jnp.maximum(distance - half, 0), distance + half, cone)
    f = jax.vmap(footprint, in_axes=(None, None, 0, 0))(jnp.eye(3), d, g.along, g.across)
    return Candidates(points, jnp.full(n, total / n), f.minor, f.height)


def cell_of(xi: Float[Array, "*batch 3"], shape: tuple[int, ...]) -> Array:
    """Flat index of the occupancy cell of a point; u and v wrap."""
    depth, rows, columns = shape
    uv = xi[..., :2] - jnp.floor(xi[..., :2])
    u = jnp.clip((uv[..., 0] * columns).astype(jnp.int32), 0, columns - 1)
    v = jnp.clip((uv[..., 1] * rows).astype(jnp.int32), 0, rows - 1)
    h = jnp.clip((xi[..., 2] * depth).astype(jnp.int32), 0, depth - 1)
    return (h * rows + v) * columns + u


class Batch(NamedTuple):
    """Rays of a step, with their images' lights looked up."""

    rays: RayTable
    light: Float[Array, "B 3"]
    irradiance: Float[Array, "B 3"]
    alpha: Float[Array, "B A"]


def decode(decoder: Decoder, x: Array, w: Array, light: Array) -> tuple[Array, Array]:
    """σ and ρ of many samples, in tiles that are computed again in the backward pass: activations stay in the cache."""

    def tile(rows: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        sigma, found = net.trunk(decoder, rows[0])
        return sigma, net.head(decoder, net.toward_viewer(decoder, found, rows[1]), rows[2])

    split = jax.tree.map(lambda a: a.reshape(-1, _TILE, a.shape[-1]), (x, w, light))
    sigma, rho = jax.lax.map(jax.checkpoint(tile), split)
    return sigma.reshape(-1), rho.reshape(-1, 3)


def predict(
    config: FitConfig, parameters: Parameters, batch: Batch, occupancy: Array, jitter: Array
) -> tuple[Float[Array, "B 4"], Bool[Array, "B"], Scalar]:
    """y of every ray, which rays had all their occupied candidates decoded, and the share of the budget wanted."""
    b, n = jitter.shape
    r = batch.rays
    all_ = jax.vmap(spread)(r.t, r.xi, r.direction, r.radius, jitter)
    flat = jax.tree.map(lambda x: x.reshape(b * n, *x.shape[2:]), all_)
    wide = flat.radius > 1 / occupancy.shape[1]  # a filter wider than a cell sees its neighbours
    depth = occupancy.reshape(-1)[cell_of(flat.xi, occupancy.shape)] * flat.length
    occupied = wide | (depth > 5e-3) | (config.decoded >= 1)
    budget = int(config.decoded * b * n) // _TILE * _TILE
    (chosen,) = jnp.nonzero(occupied, size=budget, fill_value=b * n - 1)
    wanted = jnp.sum(occupied)
    valid = jnp.arange(budget) < wanted
    some = jax.tree.map(lambda x: x[chosen], flat)
    ray = chosen // n
    complete = (wanted <= budget) | (jnp.arange(b) < ray[-1])
    points = Point(some.xi, some.radius, some.deviation, batch.alpha[ray])
    x = jax.vmap(inputs, in_axes=(None, None, 0))(material_of(parameters), layout_of(config), points)
    w = jax.vmap(direction, in_axes=(None, 0))(jnp.eye(3), -r.direction[ray])
    sigma, rho = decode(parameters.decoder, x, w, batch.light[ray])
    tau = jnp.where(valid, optical_depth(sigma, some.length), 0.0)
    taus = jnp.zeros(b * n).at[chosen].add(tau).reshape(b, n)
    share, transmittance = jax.vmap(weights)(taus)
    radiance = jnp.where(valid, share.reshape(-1)[chosen], 0.0)[:, None] * rho * batch.irradiance[ray]
    colour = jnp.zeros((b, 3)).at[ray].add(radiance)
    return (
        jnp.concatenate([tonemap(colour), 1 - transmittance[:, None]], axis=1),
        complete,
        wanted.astype(jnp.float32) / budget,
    )


def residual(y: Float[Array, "*batch 4"], target: Float[Array, "*batch 4"]) -> Float[Array, "*batch 4"]:
    """What the loss squares: (x − x̂) / (1 + x)², with a denominator that has no gradient, and what alpha is off.

    To first order that is the difference of y. But where the material cannot tell pixels apart, the best x is their mean
    (Lehtinen et al. 2018, section 3.4); the mean of y is darker, the more the pixels differ: 7% for grass over 4 × 4 of them.
    """
    dark, true = jnp.maximum(1 - y[..., :3], _DARKEST), jnp.maximum(1 - target[..., :3], _FIREFLY)
    colour = jnp.square(jax.lax.stop_gradient(dark)) * (1 / dark - 1 / true)
    return jnp.concatenate([colour, y[..., 3:] - target[..., 3:]], axis=-1)


def optimiser(config: FitConfig, steps: int) -> optax.GradientTransformation:
    """Adam with an exponential decay to `final` of the rate; textures learn faster than the network."""

    def adam(rate: float) -> optax.GradientTransformation:
        return optax.adam(optax.exponential_decay(rate, steps, config.final), 0.9, 0.99)

    net, maps = adam(config.rate), adam(config.texture_rate)
    labels: Any = ("map", "map", "net")
    return optax.multi_transform({"net": net, "map": maps}, Parameters(*labels))


def make_step(config: FitConfig, images: ImageTable, steps: int) -> Callable:
    """(State, RayTable of B rays, key) → (State, mean squared error, budget used), compiled."""
    transform = optimiser(config, steps)
    light, irradiance, alpha = (jnp.asarray(x) for x in images)

    def loss(p: Parameters, occupancy: Array, split: tuple[RayTable, Array]) -> tuple[Scalar, Scalar]:
        rays, jitter = split
        batch = Batch(rays, light[rays.image], irradiance[rays.image], alpha[rays.image])
        y, complete, used = predict(config, p, batch, occupancy, jitter)
        error = jnp.mean(jnp.square(residual(y, rays.target)), axis=1)
        return jnp.sum(jnp.where(complete, error, 0.0)) / jnp.sum(complete, dtype=error.dtype), used

    gradient_of = mean_gradient(loss)

    @jax.jit
    def step(state: State, rays: RayTable, key: Key[Array, ""]) -> tuple[State, Scalar, Scalar]:
        jitter = jax.random.uniform(key, (rays.image.shape[0], config.candidates))
        (error, used), gradient = gradient_of(state.parameters, state.occupancy, (rays, jitter))
        with jax.numpy_dtype_promotion("standard"):  # optax raises floats to integer powers
            updates, inner = transform.update(gradient, state.optimiser, state.parameters)
        parameters: Any = optax.apply_updates(state.parameters, updates)
        return State(parameters, inner, state.occupancy, state.step + 1), error, used

    return step


def make_refresh(config: FitConfig, images: ImageTable) -> Callable:
    """(State, key) → State with the occupancy renewed: old values fade, and one random point a cell is looked at."""
    layout = layout_of(config)
    alphas = jnp.asarray(images.alpha)

    @jax.jit
    def refresh(state: State, key: Key[Array, ""]) -> State:
        shape = state.occupancy.shape
        k = jax.random.split(key, 2)
        h, v, u = jnp.meshgrid(*(jnp.arange(s, dtype=jnp.float32) for s in shape), indexing="ij")
        corner = jnp.stack([u, v, h], axis=-1).reshape(-1, 3)
        xi = (corner + jax.random.uniform(k[0], corner.shape)) / jnp.array([shape[::-1]], jnp.float32)
        alpha = alphas[jax.random.randint(k[1], (xi.shape[0],), 0, alphas.shape[0])]
        field = neural_field(material_of(state.parameters), layout)
        zero = jnp.zeros(xi.shape[0])
        sigma = jax.lax.map(lambda p: field.density(p)[0], Point(xi, zero, zero, alpha), batch_size=4096)
        return state._replace(occupancy=jnp.maximum(0.8 * state.occupancy, sigma.reshape(shape)))

    return refresh


def start(config: FitConfig, images: ImageTable, steps: int) -> State:
    parameters = initialise(config, images.alpha.shape[1])
    full = jnp.full((32, 64, 64), 3.0, jnp.float32)  # everything is occupied until it has been seen empty
    return State(parameters, optimiser(config, steps).init(parameters), full, jnp.zeros((), jnp.int32))


def batches(config: FitConfig, table: RayTable, begin: int = 0) -> Iterator[RayTable]:
    """Random batches without end, each pass over the rays in a new order. begin: how many have been used before."""
    count = len(table.image)
    size = min(config.rays, count)
    per_pass = count // size
    number = begin
    while True:
        order = np.random.default_rng((config.seed, number // per_pass)).permutation(count)
        for i in range(number % per_pass, per_pass):
            yield RayTable(*(x[order[i * size : (i + 1) * size]] for x in table))
            number += 1
