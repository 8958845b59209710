"""The network of a surface material: opacity, offset and reflectance of one query (Neural Materials on Curved Surfaces).

Notation
u            where a ray meets the bounding surface, in periods of the texture; it wraps around                    (2,)
r            standard deviation of the ray's footprint there, periods
ω, ω′        unit directions toward the viewer and the light; x and y along u and v, z outward                     (3,)
κ            curvature along the ray, 1 / period, positive seen from outside; an input of networks, normalised to −1 to 1 over
             the trained range
T            a module's texture: a pyramid whose levels are learned separately, and blurred during training
α            opacity: T_α(u), ω, κ → logit of α; or → the silhouette cosine c, of which α is a step
u′           u − offset · d · (ω_x, ω_y): T_d(u), ω, κ → d
ρ            T_ρ(u′), ω, ω′, κ → radiance over irradiance on the plane facing the light, of rays that meet something     1/sr

Opacity and offset do not depend on the light: `eval_opacity` is evaluated once for several lights.
"""

from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from mesoshell.nets.mlp import Dense, apply_dense, apply_relu, init_dense, init_mlp
from mesoshell.numerics import softplus
from mesoshell.texture import mip
from mesoshell.typing import Array, Float, Key, Scalar, Vec2, Vec3

#: Factor of the offset, periods.
OFFSET = 0.1
#: Width of α's step, as a cosine.
STEP = 0.01
#: Repetitions of a texture to each side that a blur reaches: six standard deviations of the widest blur.
AROUND = 6


@dataclass(frozen=True)
class SurfaceConfig:
    """texels: along a period at the finest level, a power of two; hidden: widths of each network; opacity: α itself, the
    silhouette cosine, or none (a ray that meets the surface meets the material); curvature: whether networks see κ; step: how
    wide α's step is, as a cosine; offset: periods."""

    texels: int = 256
    channels: int = 7
    hidden: tuple[int, ...] = (24, 24, 24)
    opacity: Literal["direct", "cosine", "none"] = "direct"
    curvature: bool = True
    step: float = STEP
    offset: float = OFFSET

    @property
    def sizes(self) -> mip.Sizes:
        return mip.level_sizes(self.texels, self.texels)


class Module(NamedTuple):
    """A texture's levels, finest first (n, n, C), and the network that reads it."""

    texture: list[Float[Array, "_n _n C"]]
    hidden: list[Dense]
    last: Dense


class Surface(NamedTuple):
    """The three modules."""

    opacity: Module
    offset: Module
    reflectance: Module


class BlurredSurface(NamedTuple):
    """A surface ready to be evaluated: pyramids of blurred textures in place of levels."""

    pyramids: tuple[mip.Pyramid, ...]
    surface: Surface


class SurfaceQuery(NamedTuple):
    """A query without its light. kappa: normalised to the trained range."""

    u: Vec2
    radius: Scalar
    w: Vec3
    kappa: Scalar


class OpacityEval(NamedTuple):
    """Results that do not depend on the light. cosine: c, if the network gives it, else 0; features: T_ρ(u′)."""

    alpha: Scalar
    cosine: Scalar
    features: Float[Array, "C"]


@partial(jax.jit, static_argnums=0)
def init_surface(config: SurfaceConfig, key: Key[Array, ""]) -> Surface:
    """Textures of small random numbers; initially an opaque surface."""

    def module(key: Array, inputs: int, out: int, bias: float = 0.0) -> Module:
        first, second, third = jax.random.split(key, 3)
        keys = jax.random.split(first, len(config.sizes))
        levels = [
            0.1 * jax.random.normal(k, (*size, config.channels), jnp.float32)
            for k, size in zip(keys, config.sizes, strict=True)
        ]
        hidden = init_mlp(second, (config.channels + inputs, *config.hidden))
        last = init_dense(third, config.hidden[-1], out, gain=0.1)
        return Module(levels, hidden, last._replace(bias=last.bias + bias))

    a, b, c = jax.random.split(key, 3)
    return Surface(module(a, 4, 1, 2.0), module(b, 4, 1), module(c, 7, 3))


@jax.jit
def blur_textures(surface: Surface, blur: Scalar) -> BlurredSurface:
    """Pyramids, each level blurred by `blur` texels (a standard deviation)."""
    return BlurredSurface(
        tuple(mip.pack([blur_texture(level, blur) for level in module.texture]) for module in surface), surface
    )


def blur_texture(texture: Float[Array, "n n C"], deviation: Scalar) -> Float[Array, "n n C"]:
    """A texture that wraps around, convolved with a Gaussian of this standard deviation in texels."""
    n = texture.shape[0]
    i = np.arange(n)
    apart = jnp.asarray(i[:, None] + n * np.arange(-AROUND, AROUND + 1), texture.dtype)
    wide = jnp.minimum(deviation, jnp.asarray(n, texture.dtype))  # all texels have the same weight then, to 1e-8
    weight = jnp.exp(-0.5 * (apart / wide) ** 2).sum(axis=1)
    weight = (weight / weight.sum())[(i[:, None] - i) % n]
    return jnp.einsum("ij,kl,jlc->ikc", weight, weight, texture, precision="highest")


def eval_opacity(config: SurfaceConfig, table: BlurredSurface, place: SurfaceQuery) -> OpacityEval:
    """α, and the features for `reflectance`."""
    surface, kappa = table.surface, place.kappa * jnp.asarray(config.curvature, place.kappa.dtype)
    level = mip.level_of(place.radius, float(config.texels), len(config.sizes) - 1)
    x = jnp.concatenate([place.w, kappa[None]])

    def ask(k: int, u: Vec2) -> Array:
        return mip.lookup(table.pyramids[k], config.sizes, u, level)

    raw = _answer(surface.opacity, jnp.concatenate([ask(0, place.u), x]))[0]
    cosine = jax.nn.sigmoid(raw - 4) if config.opacity == "cosine" else jnp.zeros_like(raw)
    alpha = {
        "direct": jax.nn.sigmoid(raw),
        "cosine": jax.nn.sigmoid((place.w[2] - cosine) / config.step),
        "none": jnp.ones_like(raw),
    }[config.opacity]
    way = _answer(surface.offset, jnp.concatenate([ask(1, place.u), x]))[0]
    return OpacityEval(alpha, cosine, ask(2, place.u - config.offset * way * place.w[:2]))


def reflectance(
    config: SurfaceConfig, table: BlurredSurface, place: SurfaceQuery, opacity: OpacityEval, light: Vec3
) -> Vec3:
    """ρ(ω, ω′)."""
    kappa = place.kappa * jnp.asarray(config.curvature, place.kappa.dtype)
    x = jnp.concatenate([opacity.features, place.w, light, kappa[None]])
    return softplus(_answer(table.surface.reflectance, x) - 2)


def _answer(module: Module, x: Float[Array, "I"]) -> Float[Array, "O"]:
    return apply_dense(module.last, apply_relu(module.hidden, x))
