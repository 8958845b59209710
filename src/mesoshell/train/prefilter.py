"""The correction of averaged features, so that a view from afar shows the mean of what near views show.

Notation
λ           level of the texture, and a footprint as wide as its texel
δ(λ, h)     what is added to features at level λ and height h; 0 at level 0                   (L, B, C)
ω, ω′, α    toward the viewer, toward the light, canonical, of the upper hemisphere; appearance
T           mean of unfiltered rays over the texture: π times radiance for E⊥ = 1, and opacity   (V, 4)
P           the same of rays that are filtered at level λ
rms         of P − T over all views, over the mean of T

A network of averaged features is not the average of the network: a field of grass had four fifths of its light from above, and
1.3 of it along the ground against the sun (1.8 at its horizon). What is wrong depends on height more than on place, so that
some numbers a level and height suffice. Features stay, F(h) stays, and so does what is not filtered.

Rays enter at the top and end at the base, or after REACH patches; they are not filtered along the height. T is of few rays, but
of many views: the loss is the product of two halves' differences, of rays that are their own, and so noise adds nothing to its
mean; a third part gives its scale.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Float

from mesoshell.errors import Argument, InputError
from mesoshell.io.bundle import Bundle
from mesoshell.io.bundle_arrays import BAKED
from mesoshell.limits import check_memory, check_seed
from mesoshell.numerics import optical_depth
from mesoshell.render.composite import weights
from mesoshell.shell.generator.texture_synthesis import TextureRequest, bake_bundle
from mesoshell.shell.material.field import Layout, Material, Point, neural_field
from mesoshell.shell.material.loader import DeviceMaterial, load_device_material
from mesoshell.train.export import grids_of
from mesoshell.train.update import descent
from mesoshell.typing import Array, Key, Scalar, Vec2, Vec3

#: Rows of δ.
ROWS = 32
#: Views that are learned from, and those that only measure; and unfiltered rays of a view in each of three parts.
VIEWS, HELD, RAYS, MANY = 3072, 192, 16, 96
#: Views a step, filtered rays of each, and of each that only measures.
BATCH, SOME, MORE = 64, 6, 96
#: Samples of a ray; and of one that is filtered at more than level FINE.
SAMPLES, FEW, FINE = 192, 96, 2
#: Patches after which a ray ends, and the flattest elevations: of the viewer (radians), and of the light (sine).
REACH, FLATTEST, LOWEST = 4.0, 0.035, 0.05
#: Patches along a side of a grown texture, which no ray from its middle leaves; and how many are grown.
GROWN, TEXTURES = 12, 3
#: Radiance is compared over its view's mean plus this; opacity counts so much.
DARK, OPACITY = 0.02, 2.0
RATE = 3e-2
_ADAM = optax.scale_by_adam()
#: Views that are measured together.
AT_ONCE = 8


class View(NamedTuple):
    """Directions and appearances, (V, …) each, and T by three parts of its rays, (V, 3, 4)."""

    toward: Any
    light: Any
    alpha: Any
    true: Any


class Gap(NamedTuple):
    """How far filtered views are from the mean of unfiltered ones, at a level, before and after. light: all radiance over all
    that there should be; rms: over views."""

    level: int
    light: tuple[float, float]
    rms: tuple[float, float]


def fit_correction(
    bundle: Bundle, name: str, steps: int = 300, seed: int = 0, show: Callable[[Gap], None] = lambda gap: None
) -> Bundle:
    """The material with its correction fitted, without a twin, which is of what was seen before. steps: of each level; show:
    called with what a level's correction mends.

    Raises InputError, about `name`, if it is one texture with edges, or needs more memory than there is; about `steps` and
    `seed`.
    """
    if steps < 1:
        raise InputError(Argument("steps"), "must be at least 1")
    check_seed(seed)
    old = ("correction",) if bundle.generator is None else ("correction", *BAKED)
    plain = {key: array for key, array in bundle.arrays.items() if not key.startswith(old)}
    made = replace(bundle, arrays=plain, twin=None)
    rng = np.random.default_rng(seed % 2**32)
    delta, gaps = _fit(_textures(made, name, rng), steps, rng, show)
    about = {"steps": steps, "seed": seed, "rms": [[round(x, 4) for x in gap.rms] for gap in gaps]}
    made.arrays["correction"] = delta.astype(np.float16)
    entries: dict[str, Any] = {"correction": about}
    if bundle.generator is None:
        grids, excess = grids_of(made)
        made.arrays.update(grids)
        entries |= excess
    return replace(made, provenance=bundle.provenance | entries)


def _textures(bundle: Bundle, name: str, rng: np.random.Generator) -> list[DeviceMaterial]:
    """What the correction is fitted to: the material's texture, or some that its generator grows, of any geometry."""
    if bundle.generator is None and not bundle.wraps:
        raise InputError(name, "is one texture with edges: correct the material that it was grown from")
    if bundle.generator is None:
        made = load_device_material(bundle)
        return [replace(made, layout=replace(made.layout, colours=None))]  # of tiles, their torus: each of them once
    side = GROWN * int(bundle.texel_density)
    check_memory(name, f"{TEXTURES} textures of {side} texels a side", 6 * TEXTURES * bundle.channels * side**2)
    ranges = {p.name: p.range for p in bundle.parameters if p.role == "beta"}
    some = []
    for _ in range(TEXTURES):
        wanted = TextureRequest(
            int(rng.integers(2**31)), {key: float(rng.uniform(*between)) for key, between in ranges.items()}
        )
        some.append(load_device_material(bake_bundle(bundle, name, (side, side), wanted)[0]))
    return some


def _fit(
    textures: Sequence[DeviceMaterial], steps: int, rng: np.random.Generator, show: Callable[[Gap], None]
) -> tuple[Float[np.ndarray, "L B C"], list[Gap]]:
    """δ of all levels, from fine to coarse: each begins as the one before, and is 0 where that has the smaller rms."""
    layout = textures[0].layout
    learned, held = (
        [_views(texture, n // len(textures), rays, rng) for texture in textures]
        for n, rays in ((VIEWS, RAYS), (HELD, MANY))
    )
    channels = textures[0].material.texture.rows.shape[1]
    delta, gaps = np.zeros((len(layout.sizes), ROWS, channels), np.float32), []
    for level in range(1, len(layout.sizes)):
        before = _gap(textures, held, jnp.zeros((ROWS, channels)), level)
        row = jnp.asarray(delta[level - 1])
        state = _ADAM.init(row)
        for i in range(steps):
            k = i % len(textures)
            chosen = rng.choice(len(learned[k].true), BATCH, replace=False)
            some = jax.tree.map(lambda x, chosen=chosen: x[chosen], learned[k])
            key = jax.random.key(int(rng.integers(2**31)))
            gradient = _slope(layout, _samples(level), textures[k].material, row, np.float32(level), some, key)
            row, state = _updated(
                row, gradient, state, np.float32(RATE * (0.05 + 0.95 * np.cos(np.pi / 2 * i / steps) ** 2))
            )
        after = _gap(textures, held, row, level)
        if after[1] < before[1]:
            delta[level] = row
        else:
            after = before
        light, rms = zip(before, after, strict=True)
        gaps.append(Gap(level, light, rms))
        show(gaps[-1])
    return delta, gaps


@jax.jit
def _updated(row: Array, gradient: Array, state: optax.OptState, rate: Array) -> tuple[Array, optax.OptState]:
    updates, state = descent(_ADAM, row, state, gradient)
    return row - rate * updates, state


def _views(texture: DeviceMaterial, count: int, rays: int, rng: np.random.Generator) -> View:
    """Random views of a texture, half of them even over elevations and half over the sky."""
    even = rng.random(count) < 0.5
    up = np.where(even, rng.uniform(FLATTEST, np.pi / 2, count), np.arcsin(rng.uniform(np.sin(FLATTEST), 1, count)))
    toward, light = _unit(up, rng), _unit(np.arcsin(rng.uniform(LOWEST, 1, count)), rng)
    alpha = rng.uniform(size=(count, len(texture.names))).astype(np.float32)
    keys = jax.random.split(jax.random.key(int(rng.integers(2**31))), count)
    true = _true(texture.layout, (rays, SAMPLES), texture.material, (toward, light, alpha), keys)
    return View(toward, light, alpha, np.asarray(true))


def _unit(elevation: Float[np.ndarray, "V"], rng: np.random.Generator) -> Float[np.ndarray, "V 3"]:
    around = rng.uniform(0, 2 * np.pi, len(elevation))
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(around), flat * np.sin(around), np.sin(elevation)], axis=1).astype(np.float32)


@partial(jax.jit, static_argnums=(0, 1))
def _true(
    layout: Layout, counts: tuple[int, int], material: Material, views: tuple[Array, Array, Array], keys: Array
) -> Float[Array, "V 3 4"]:
    """T by three parts. counts: of rays of each, and of samples of a ray."""
    rays, samples = counts

    def one(view: tuple[tuple[Array, Array, Array], Array]) -> Array:
        every = _rays(layout, (3 * rays, samples), material, jnp.zeros(()), view[0], view[1])
        return every.reshape(3, rays, 4).mean(axis=1)

    return jax.lax.map(one, (views, keys), batch_size=4)


def _samples(level: int) -> int:
    return SAMPLES if level <= FINE else FEW


def _rays(
    layout: Layout,
    counts: tuple[int, int],
    material: Material,
    level: Scalar,
    view: tuple[Vec3, Vec3, Array],
    key: Key[Array, ""],
) -> Float[Array, "R 4"]:
    """π times radiance and opacity of rays of one view, from random places. counts: of rays, and of samples of each; level: of
    the filter; 0 is no filter."""
    field, (toward, light, alpha) = neural_field(material, layout), view
    radius = jnp.where(level == 0, 0.0, 2.0**level / (2 * layout.texel_density))
    length = jnp.minimum(1 / toward[2], REACH)
    rays, samples = counts
    step = length / samples

    def ray(begin: Vec2, jitter: Scalar) -> Float[Array, "4"]:
        t = step * (jnp.arange(samples, dtype=jnp.float32) + jitter)

        def sample(t: Scalar) -> tuple[Scalar, Vec3]:
            xi = jnp.append(begin, 1.0) - t * toward
            sigma, features = field.density(Point(xi, radius, jnp.zeros(()), alpha))
            return sigma, field.transport(features, toward, light)

        sigma, rho = jax.vmap(sample)(t)
        share, through = weights(optical_depth(sigma, jnp.full(samples, step)))
        return jnp.append(jnp.pi * jnp.matmul(share, rho, precision="highest"), 1 - through)

    k = jax.random.split(key)
    low, high = (REACH + 0.5, GROWN - REACH - 0.5) if layout.open else (0.0, float(layout.period))
    begin = jax.random.uniform(k[0], (rays, 2), minval=low, maxval=high)
    return jax.vmap(ray)(begin, jax.random.uniform(k[1], (rays,)))


@partial(jax.jit, static_argnums=(0, 1))
def _halves(
    layout: Layout,
    counts: tuple[int, int],
    material: Material,
    row: Float[Array, "B C"],
    level: Scalar,
    views: View,
    key: Key[Array, ""],
) -> tuple[Float[Array, "V 4"], Float[Array, "V 4"]]:
    """P of each view by two halves of its rays, with `row` as δ of the level."""
    material = material._replace(correction=jnp.broadcast_to(row, (len(layout.sizes), *row.shape)))
    directions = views.toward, views.light, views.alpha
    one = lambda view, key: _rays(layout, counts, material, level, view, key)  # noqa: E731
    y = jax.vmap(one)(directions, jax.random.split(key, len(views.true)))
    return y[:, ::2].mean(axis=1), y[:, 1::2].mean(axis=1)


@partial(jax.jit, static_argnums=(0, 1))
def _slope(
    layout: Layout,
    samples: int,
    material: Material,
    row: Float[Array, "B C"],
    level: Scalar,
    views: View,
    key: Key[Array, ""],
) -> Float[Array, "B C"]:
    """Gradient of the loss with respect to δ of the level."""
    first, second, third = views.true.swapaxes(0, 1)
    over = 1 / (DARK + third[:, :3].mean(axis=1, keepdims=True))
    scale = jnp.concatenate([jnp.repeat(over, 3, axis=1), jnp.full((len(over), 1), OPACITY)], axis=1)

    def loss(row: Array) -> Scalar:
        a, b = _halves(layout, (SOME, samples), material, row, level, views, key)
        return ((a - first) * (b - second) * scale**2).mean()

    return jax.grad(loss)(row)


def _gap(
    textures: Sequence[DeviceMaterial], held: Sequence[View], row: Float[Array, "B C"], level: int
) -> tuple[float, float]:
    """(All radiance over all that there should be, rms) of held-out views."""
    first, second, true = [], [], []
    for texture, views in zip(textures, held, strict=True):
        for i in range(0, len(views.true), AT_ONCE):
            some = jax.tree.map(lambda x, i=i: x[i : i + AT_ONCE], views)
            how = texture.layout, (MORE, _samples(level)), texture.material
            a, b = _halves(*how, row, np.float32(level), some, jax.random.key(i))
            first.append(a[:, :3])
            second.append(b[:, :3])
            true.append(some.true[..., :3])
    a, b, parts = (np.concatenate(x).astype(np.float64) for x in (first, second, true))
    t = parts.mean(axis=1)
    apart = max(0.0, float(((a - parts[:, 0]) * (b - parts[:, 1])).mean())) ** 0.5
    mean = max(float(t.mean()), 1e-9)
    return float((a + b).mean() / 2) / mean, apart / mean
