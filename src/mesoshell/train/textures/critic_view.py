"""The critic's view of a texture: decoded layers, and views from above and aslant, without tracing a ray.

Notation
y           a picture of the channels below                                       (S, S, CHANNELS)
SLICES      layers whose opacity is a channel
LIT         layers whose reflectance seen from above, under a random light, times opacity, is three channels
SLANTS      orthographic views aslant: layers sheared by so many texels over TOP, along (v, u)

Raw features would show the critic what no picture shows. Single layers do not show that blades lean; heights from above and
sheared sums do. A shear moves layers by whole texels, and fills in nothing from beyond the tile.
"""

import jax
import jax.numpy as jnp

from mesoshell.numerics import safe_sqrt
from mesoshell.shell.material import decoder as net
from mesoshell.shell.material.decoder import Decoder
from mesoshell.train.textures.depth_map import Above, from_above
from mesoshell.typing import Array, Float, Int, Key, Scalar, Vec3

LAYERS = 16
SLICES, LIT = tuple(range(1, LAYERS, 2)), tuple(range(2, LAYERS, 4))
#: Over TOP, in 1 / 128 patches.
SLANTS = ((32, 0), (0, 32), (-32, 0), (0, -32))
CHANNELS = len(SLICES) + 3 * len(LIT) + 2 + len(SLANTS)


def see(
    decoder: Decoder,
    octaves: int,
    feature: Float[Array, "S S C"],
    height: Float[Array, "R C"],
    alpha: Float[Array, "A"],
    light: Vec3,
) -> Float[Array, "S S I"]:
    """y of one texture, not normalised."""
    above = from_above(decoder, octaves, feature, height, alpha, LAYERS)
    slices = jnp.moveaxis(above.opacity[jnp.array(SLICES)], 0, -1)
    views = jnp.stack([_aslant(above, slant, feature.shape[0]) for slant in SLANTS], axis=-1)
    depth = jnp.stack([above.depth, above.cover], axis=-1)
    return jnp.concatenate([slices, _lit(decoder, above, light), depth, views], axis=-1)


def _lit(decoder: Decoder, above: Above, light: Vec3) -> Float[Array, "S S I"]:
    """Reflectance times opacity of the LIT layers, seen from above; 3ρ/(1 + 3ρ) keeps it below 1."""
    some = jnp.array(LIT)
    opacity, features = above.opacity[some], above.features[some]
    shape = (*opacity.shape, 3)
    up, toward = (jnp.broadcast_to(x, shape) for x in (jnp.array([0.0, 0.0, 1.0], light.dtype), light))
    rho = 3 * net.head(decoder, net.toward_viewer(decoder, features, up), toward)
    reflected = opacity[..., None] * rho / (1 + rho)
    return jnp.moveaxis(reflected, 0, 2).reshape(*opacity.shape[1:], -1)


def _aslant(above: Above, slant: tuple[int, int], side: int) -> Float[Array, "S S"]:
    """Mean height of what an oblique view meets first. Each layer is shifted against the view; beyond the tile is nothing."""
    n = above.opacity.shape[0]
    through, depth = jnp.ones((side, side), above.opacity.dtype), jnp.zeros((side, side), above.opacity.dtype)
    for i in reversed(range(n)):
        dv, du = (round(s * side / 128 * (1 - (i + 0.5) / n)) for s in slant)
        o = _moved(above.opacity[i], dv, du)
        depth, through = depth + through * o * ((i + 0.5) / n), through * (1 - o)
    return depth


def _moved(x: Float[Array, "S S"], dv: int, du: int) -> Float[Array, "S S"]:
    """x with what lies at (v + dv, u + du) at (v, u); nothing beyond its edges."""
    s = x.shape[0]
    padded = jnp.pad(x, ((max(-dv, 0), max(dv, 0)), (max(-du, 0), max(du, 0))))
    return jax.lax.slice(padded, (max(dv, 0), max(du, 0)), (max(dv, 0) + s, max(du, 0) + s))


def draw_light(key: Key[Array, ""]) -> Vec3:
    """A random direction of the upper hemisphere, with a cosine above 0.15."""
    u = jax.random.uniform(key, (2,), jnp.float32)
    c = 0.15 + 0.85 * u[0]
    s, turn = safe_sqrt(1 - c * c), 2 * jnp.pi * u[1]
    return jnp.stack([s * jnp.cos(turn), s * jnp.sin(turn), c])


def draw_turn(key: Key[Array, ""]) -> Int[Array, ""]:
    """One of the eight flips and quarter turns: 0 to 7, of which 0 is the identity and has three chances in ten. With equal
    ones, the critic could not tell turned textures from upright ones."""
    t = jax.random.randint(key, (), 0, 10)
    return jnp.where(t >= 8, 0, t)


def turned_angle(angle: Scalar, t: Int[Array, ""]) -> Scalar:
    """A direction in the plane, from u toward v in turns, after turn t of what has it."""
    angle = jnp.where(t & 1 != 0, -angle, angle)
    angle = jnp.where(t & 2 != 0, 0.5 - angle, angle)
    angle = jnp.where(t & 4 != 0, 0.25 - angle, angle)
    return angle - jnp.floor(angle)


def turn_view(y: Float[Array, "S S I"], t: Int[Array, ""]) -> Float[Array, "S S I"]:
    """y after turn t: v reversed (1), u reversed (2), both exchanged (4). Oblique views change places."""
    y = jnp.where(t & 1 != 0, _with_slants(jnp.flip(y, 0), (2, 1, 0, 3)), y)
    y = jnp.where(t & 2 != 0, _with_slants(jnp.flip(y, 1), (0, 3, 2, 1)), y)
    return jnp.where(t & 4 != 0, _with_slants(jnp.swapaxes(y, 0, 1), (1, 0, 3, 2)), y)


def _with_slants(y: Float[Array, "S S I"], order: tuple[int, ...]) -> Float[Array, "S S I"]:
    n = CHANNELS - len(SLANTS)
    return jnp.concatenate([y[..., :n], y[..., n:][..., jnp.array(order)]], axis=-1)
