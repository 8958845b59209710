"""The object as four networks: density in the volume, colour on a sphere, and the maps between them (NeuTex, section 3).

Notation
y           a point of the box [−1, 1]³; d: unit direction from the camera
u           a point of the texture: a unit vector (their spherical UV)
F_σ         y → σ, per unit of the box
F_uv        y → u; no encoding, for a smooth map (their section 4.1)
F_uv⁻¹      u → y, the surface that the texture is wrapped on; no encoding
F_tex       (u, d) → c = softplus(b(u)) + r(u, d): a view-independent texture, and a view-dependent part
volume      a NeRF for comparison, in the same code: c from F_σ's features instead of from u
reflectance  F_σ gives a normal besides σ, F_tex gives lobes (neutex/brdf) instead of a colour, and r is not used

F_uv and F_uv⁻¹ are offsets from the projection from the box's centre, u = y/|y|, and from a sphere's surface: the paper gives
no initial maps, and training from these has no folds to undo. Colours are linear; a sum below 0, by r, is not clipped.
"""

from dataclasses import dataclass, field
from functools import partial
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp

from mesoshell.nets.encoding import HashConfig, encode_hash_grid, frequency, init_tables
from mesoshell.nets.mlp import Dense, apply_dense, apply_relu, init_dense, init_mlp
from mesoshell.neutex.brdf import Lobes
from mesoshell.numerics import normalise, softplus
from mesoshell.typing import Array, Float, Key, Scalar, Vec3

#: σ for a raw output of about 1: opaque within a tenth of the box; the bias makes it 0.5 at the start.
DENSITY, EMPTY = 25.0, -3.9
#: Radius of the sphere that F_uv⁻¹ begins as, and variance gain of both maps' and of r's last layers.
SPHERE, FLAT = 0.6, 1e-4


@dataclass(frozen=True)
class FieldConfig:
    """sigma, texture, uv, inverse: widths of the hidden layers; views: width of r's. encoding: of F_σ's and F_tex's inputs;
    octaves: of y, of u, of d. flash: for reflectance, E⊥ of the camera's light at distance 1, in the box's units."""

    sigma: tuple[int, ...] = (256,) * 8
    texture: tuple[int, ...] = (256,) * 4
    uv: tuple[int, ...] = (128, 128)
    inverse: tuple[int, ...] = (512, 512)
    views: int = 64
    encoding: Literal["frequency", "hash"] = "frequency"
    octaves: tuple[int, int, int] = (10, 10, 4)
    hash: HashConfig = field(default_factory=HashConfig)
    colour: Literal["texture", "volume", "reflectance"] = "texture"
    flash: float = 0.0


class Net(NamedTuple):
    """An encoding's tables (none of frequencies), hidden layers, and the last one."""

    tables: Float[Array, "L R C"] | tuple[()]
    hidden: list[Dense]
    last: Dense


class Field(NamedTuple):
    """sigma: F_σ; texture: b with features, of u or of F_σ's features; view: r; uv: F_uv; inverse: F_uv⁻¹."""

    sigma: Net
    texture: Net
    view: Net
    uv: Net
    inverse: Net


@partial(jax.jit, static_argnums=0)
def init_field(config: FieldConfig, key: Key[Array, ""]) -> Field:
    """Networks with random weights, all that the configuration calls for."""
    k = jax.random.split(key, 5)
    lit = config.colour == "reflectance"
    sigma = _net(config, k[0], config.octaves[0], config.sigma, 4 if lit else 1)
    if config.colour == "volume":
        texture = Net((), *_layers(k[1], config.sigma[-1], config.texture, 3))
    else:
        texture = _net(config, k[1], config.octaves[1], config.texture, 5 if lit else 3)
    inputs = config.texture[-1] + 3 * (1 + 2 * config.octaves[2])
    view = Net((), *_layers(k[2], inputs, (config.views,), 3, FLAT))
    return Field(
        sigma._replace(last=sigma.last._replace(bias=sigma.last.bias.at[0].add(EMPTY))),
        texture,
        view,
        Net((), *_layers(k[3], 3, config.uv, 3, FLAT)),
        Net((), *_layers(k[4], 3, config.inverse, 3, FLAT)),
    )


def density(config: FieldConfig, field: Field, y: Vec3) -> tuple[Scalar, Float[Array, "F"]]:
    """σ, and the last hidden features."""
    features = apply_relu(field.sigma.hidden, _encoded(config, field.sigma, y, config.octaves[0]))
    return DENSITY * softplus(apply_dense(field.sigma.last, features)[0]), features


def normal(field: Field, y: Vec3, features: Float[Array, "F"]) -> Vec3:
    """Normal of reflectance from density's `features`; initially it points away from the box's centre."""
    return normalise(y + apply_dense(field.sigma.last, features)[1:])


def lobes(config: FieldConfig, field: Field, u: Vec3) -> Lobes:
    """Lobes of reflectance at a point of the texture."""
    x = jax.nn.sigmoid(_applied(field.texture, _encoded(config, field.texture, u, config.octaves[1])))
    return Lobes(x[:3], x[3], 0.25 * x[4])


def to_texture(field: Field, y: Vec3) -> Vec3:
    """u = F_uv(y)."""
    return normalise(y + _applied(field.uv, y))


def to_surface(field: Field, u: Vec3) -> Vec3:
    """y = F_uv⁻¹(u)."""
    return SPHERE * u + _applied(field.inverse, u)


def texture(config: FieldConfig, field: Field, u: Vec3) -> tuple[Vec3, Float[Array, "F"]]:
    """softplus(b(u)), and the features that r takes."""
    return _base(field.texture, _encoded(config, field.texture, u, config.octaves[1]))


def view_reflectance(config: FieldConfig, field: Field, features: Float[Array, "F"], d: Vec3) -> Vec3:
    """r(u, d)."""
    return _applied(field.view, jnp.concatenate([features, frequency(d, config.octaves[2])]))


def radiance(config: FieldConfig, field: Field, y: Vec3, d: Vec3, features: Float[Array, "F"]) -> Vec3:
    """c at a point, with density's `features` there."""
    if config.colour == "volume":
        base, inner = _base(field.texture, features)
    else:
        base, inner = texture(config, field, to_texture(field, y))
    return base + view_reflectance(config, field, inner, d)


def _base(net: Net, x: Float[Array, "E"]) -> tuple[Vec3, Float[Array, "F"]]:
    features = apply_relu(net.hidden, x)
    return softplus(apply_dense(net.last, features)), features


def _applied(net: Net, x: Float[Array, "I"]) -> Float[Array, "O"]:
    return apply_dense(net.last, apply_relu(net.hidden, x))


def _encoded(config: FieldConfig, net: Net, x: Vec3, octaves: int) -> Float[Array, "E"]:
    if isinstance(net.tables, tuple):
        return frequency(x, octaves)
    return jnp.concatenate([x, encode_hash_grid(config.hash, net.tables, x)])


def _net(config: FieldConfig, key: Key[Array, ""], octaves: int, widths: tuple[int, ...], outputs: int) -> Net:
    k = jax.random.split(key)
    if config.encoding == "frequency":
        return Net((), *_layers(k[0], 3 * (1 + 2 * octaves), widths, outputs))
    return Net(init_tables(config.hash, k[1]), *_layers(k[0], 3 + config.hash.width, widths, outputs))


def _layers(
    key: Key[Array, ""], inputs: int, widths: tuple[int, ...], outputs: int, gain: float = 1.0
) -> tuple[list[Dense], Dense]:
    k = jax.random.split(key)
    return init_mlp(k[0], (inputs, *widths)), init_dense(k[1], widths[-1], outputs, gain)
