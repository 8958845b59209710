"""The network that turns features into extinction and reflectance (MesoGAN, equation 3).

Notation
F           F(u, v) + F(h)                                                    (C,)
h           height; the network's inputs are h and sin, cos of π·2ᵏ·h for `octaves` values of k
α           appearance parameters                                             (A,)
ω, ω′       toward the viewer, toward the light                               (3,), canonical
σ           scale · softplus(x − 3), 1 / canonical length: a box begins a fifth to a half transparent
ρ           softplus(y − 2), RGB, 1/sr

Equation 3 gives σ and ρ by one network. Free flight and transmittance need σ before a light is chosen, so the trunk takes F, h
and α only and gives σ; a head that also takes ω and ω′ gives ρ, and several lights share the trunk.
Training sees the upper hemisphere: ω is clamped to the horizon, and ρ fades to 0 as ω′ sinks 0.1 below it.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp

from mesoshell.io.bundle import FADE
from mesoshell.nets.mlp import Dense, apply_dense, apply_relu, init_dense, init_mlp, linear
from mesoshell.numerics import normalise, product, softplus
from mesoshell.typing import Array, Float, Key, Scalar, Vec3


class Decoder(NamedTuple):
    """Weights: trunk and head are hidden layers, sigma and rho the two linear outputs. scale is σ's."""

    trunk: list[Dense]
    sigma: Dense
    head: list[Dense]
    rho: Dense
    scale: Float[Array, ""]


@partial(jax.jit, static_argnums=(1, 2, 3))
def init_decoder(key: Key[Array, ""], inputs: int, trunk: tuple[int, ...], head: tuple[int, ...]) -> Decoder:
    """inputs = C + 1 + 2·octaves + A. trunk and head: widths of the hidden layers."""
    k = jax.random.split(key, 4)
    return Decoder(
        trunk=init_mlp(k[0], (inputs, *trunk)),
        sigma=init_dense(k[1], trunk[-1], 1, gain=1.0),
        head=init_mlp(k[2], (trunk[-1] + 6, *head)),
        rho=init_dense(k[3], head[-1], 3, gain=0.5),
        scale=jnp.asarray(30.0, jnp.float32),
    )


def encode_height(h: Scalar, octaves: int) -> Float[Array, "E"]:
    """(h, sin π2ᵏh, cos π2ᵏh …), k < octaves."""
    angle = jnp.pi * h * 2.0 ** jnp.arange(octaves, dtype=h.dtype)
    return jnp.concatenate([h[None], jnp.sin(angle), jnp.cos(angle)])


def trunk(decoder: Decoder, x: Float[Array, "*batch I"]) -> tuple[Float[Array, "*batch"], Float[Array, "*batch W"]]:
    """σ and the trunk's features. x: F, encoded h and α, concatenated."""
    features = apply_relu(decoder.trunk, x)
    raw = apply_dense(decoder.sigma, features)[..., 0]
    return decoder.scale * softplus(raw - 3), features


def toward_viewer(
    decoder: Decoder, features: Float[Array, "*batch W"], w: Float[Array, "*batch 3"]
) -> Float[Array, "*batch H"]:
    """The part of the head's first layer that all lights share, from trunk features and ω."""
    kernel, bias = decoder.head[0]
    shared = jnp.concatenate([features, above_horizon(w)], axis=-1)
    return apply_dense(Dense(kernel[: shared.shape[-1]], bias), shared)


def head(
    decoder: Decoder, shared: Float[Array, "*batch H"], w_light: Float[Array, "*batch 3"]
) -> Float[Array, "*batch 3"]:
    """ρ(ω, ω′) from `toward_viewer` and the canonical direction toward a light."""
    fade = jnp.clip(1 + w_light[..., 2:] / FADE, 0, 1)
    first = jax.nn.relu(shared + linear(above_horizon(w_light), decoder.head[0].kernel[-3:]))
    return fade * softplus(apply_dense(decoder.rho, apply_relu(decoder.head[1:], first)) - 2)


def above_horizon(w: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """The direction itself, or the nearest one on the horizon if it points below it."""
    return normalise(jnp.concatenate([w[..., :2], jnp.maximum(w[..., 2:], 0)], axis=-1))


def direction(inverse: Float[Array, "3 3"], d: Vec3) -> Vec3:
    """Canonical unit direction normalise(J⁻¹ d)."""
    return normalise(product(inverse, d))
