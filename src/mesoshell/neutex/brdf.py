"""Reflection of light from one direction at a surface point (NeuTex, section 5.4, after Neural Reflectance Fields).

Notation
n, v, l     normal, directions to the viewer and to the light; unit vectors, h halfway between v and l
albedo      of the diffuse part; f₀: reflectance head on of the glossy part, the same for all colours; α: roughness squared
shade       (albedo/π + D F G / (4 n·v n·l)) n·l: D of GGX, G of Smith, height-correlated, F of Schlick; 0 where l lies behind

Finite for all unit vectors: n·v is not below 1e-3, α not below MIN_ROUGHNESS².
"""

from typing import NamedTuple

import jax.numpy as jnp

from mesoshell.numerics import normalise
from mesoshell.typing import Scalar, Vec3

MIN_ROUGHNESS = 0.08


class Lobes(NamedTuple):
    """Reflectance of a point of the texture."""

    albedo: Vec3
    roughness: Scalar
    specular: Scalar


def shade(of: Lobes, n: Vec3, v: Vec3, l: Vec3) -> Vec3:
    """Radiance toward v over irradiance on the plane that faces l."""
    h = normalise(v + l)
    nl, nv, nh, vh = (jnp.sum(a * b) for a, b in ((n, l), (n, v), (n, h), (v, h)))  # in full precision, on any backend
    nl, nv, nh, vh = jnp.maximum(nl, 0), jnp.maximum(nv, 1e-3), jnp.clip(nh, 0, 1), jnp.clip(vh, 0, 1)
    a = jnp.maximum(of.roughness, MIN_ROUGHNESS) ** 2
    d = a**2 / (jnp.pi * (nh**2 * (a**2 - 1) + 1) ** 2)
    # G / (4 n·v n·l), times n·l
    masked = nl / (2 * (nl * jnp.sqrt(a**2 + (1 - a**2) * nv**2) + nv * jnp.sqrt(a**2 + (1 - a**2) * nl**2)))
    f = of.specular + (1 - of.specular) * (1 - vh) ** 5
    return of.albedo / jnp.pi * nl + d * f * masked
