"""A generator in a bundle, and a texture's own numbers: latent, phases and height feature from a seed and parameters.

Notation
seed        of a material: z, and the phases φ of all Fourier maps, follow from it
t           how far z is on its way to that of another seed, whose phases are not used
β           geometry parameters, normalised to [0, 1]                             (G,), or (P, Q, G) on nodes
w           mapping(z, β)                                                          (1, W), or (1, P, Q, W) on nodes

The weights' names in a bundle are their places in the pytrees: generator/layers/0/weight is Generator.layers[0].weight.
"""

import math
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle
from mesoshell.shell.generator.generator import (
    Averages,
    Generator,
    Phases,
    draw_phases,
    init_averages,
    init_generator,
    map_latent,
)
from mesoshell.shell.generator.plan import GeneratorConfig
from mesoshell.shell.material.decoder import Decoder
from mesoshell.shell.material.loader import decoder_of
from mesoshell.typing import Array, Key


@dataclass(frozen=True, eq=False)
class GeneratorModel:
    """A generator with its averages, its decoder, octaves of the height encoding, and the correction of its levels that are
    kept."""

    config: GeneratorConfig
    generator: Generator
    averages: Averages
    decoder: Decoder
    octaves: int
    correction: Float[np.ndarray, "L B C"] | None = None


class Latent(NamedTuple):
    """Inputs of a texture's synthesis, from its seed and parameters. w: on nodes if geometry varies."""

    w: Float[Array, "1 *nodes W"]
    phases: Phases


def generator_arrays(generator: Generator, averages: Averages) -> dict[str, np.ndarray]:
    """The bundle's arrays of a generator."""
    return {name: np.asarray(x, np.float32) for name, x in _named((generator, averages)).items()}


def generator_fields(config: GeneratorConfig) -> dict[str, Any]:
    """The bundle's field `generator`."""
    return asdict(config)


def generator_model(bundle: Bundle, name: str) -> GeneratorModel:
    """The generator of a bundle. Raises InputError, about `name`, if it has none or its weights do not fit."""
    if bundle.generator is None:
        raise InputError(name, "holds one texture and no generator: it has no other seed, extent or geometry")
    try:
        config = GeneratorConfig(**bundle.generator)
        like = jax.eval_shape(lambda: (init_generator(config, jax.random.key(0)), init_averages(config)))
    except (TypeError, ValueError, ZeroDivisionError, OverflowError) as error:
        raise InputError(name, f"manifest.json: generator is not a configuration: {error}") from error
    named = _named(like)
    for key, expected in named.items():
        if key not in bundle.arrays:
            raise InputError(name, f"array {key} is missing")
        if bundle.arrays[key].shape != expected.shape:
            raise InputError(name, f"array {key} has shape {bundle.arrays[key].shape}; expected {expected.shape}")
    for key in bundle.arrays:
        if key.startswith("generator/") and key not in named:
            raise InputError(name, f"unexpected array {key!r}")
        if key.startswith("generator/magnitude/") and not bundle.arrays[key] > 0:
            raise InputError(name, f"array {key} is {bundle.arrays[key]}; a mean square must be above 0")
    if (config.texels, config.channels) != (bundle.texel_density, bundle.channels):
        raise InputError(name, "manifest.json: the generator's texels or channels differ from the material's")
    leaves = [jnp.asarray(bundle.arrays[key], jnp.float32) for key in named]
    generator, averages = jax.tree.unflatten(jax.tree.structure(like), leaves)
    decoder, correction = decoder_of(bundle.arrays), bundle.arrays.get("correction")
    return GeneratorModel(config, generator, averages, decoder, bundle.height_octaves, correction)


def grown(
    maker: GeneratorModel, seed: int, beta: Float[np.ndarray, "*nodes G"], latent: tuple[int, float] | None = None
) -> Latent:
    """The latent and the phases of a seed. latent: another seed, and t."""
    z, phases = _drawn(maker, seed)
    if latent is not None:
        z = slerp(z, _drawn(maker, latent[0])[0], latent[1])
    rows = jnp.asarray(beta, jnp.float32).reshape(math.prod(beta.shape[:-1]), beta.shape[-1])
    w = map_latent(maker.generator, jnp.broadcast_to(z, (len(rows), maker.config.z)), rows)
    return Latent(w.reshape(1, *beta.shape[:-1], w.shape[-1]), draw_phases(maker.config, phases, 1))


def _drawn(maker: GeneratorModel, seed: int) -> tuple[Float[Array, "1 Z"], Key[Array, ""]]:
    """z of a seed, and the key of its phases."""
    k = jax.random.split(jax.random.key(seed))
    return jax.random.normal(k[0], (1, maker.config.z), jnp.float32), k[1]


def slerp(a: Float[Array, "1 Z"], b: Float[Array, "1 Z"], t: float) -> Float[Array, "1 Z"]:
    """The direction between those of a and b on a great circle, which is all that a mapping network takes of z; straight where
    they lie on one line (Shoemake 1985)."""
    u, v = (x / jnp.maximum(jnp.linalg.norm(x), 1e-20) for x in (a, b))
    angle = 2 * jnp.arctan2(
        jnp.linalg.norm(u - v), jnp.linalg.norm(u + v)
    )  # arccos of a product is off by 3e-4 at its ends
    sine = jnp.sin(angle)
    apart = jnp.abs(sine) > 1e-3
    one, other = (jnp.where(apart, jnp.sin(s * angle) / jnp.where(apart, sine, 1.0), s) for s in (1 - t, t))
    return one * u + other * v


def _named(trees: tuple[Any, Any]) -> dict[str, Any]:
    """Leaves by name, in the order of flattening."""
    leaves = jax.tree_util.tree_leaves_with_path(trees)
    return {f"generator/{'/'.join(_step(s) for s in path[1:])}": leaf for path, leaf in leaves}


def _step(step: Any) -> str:
    return str(getattr(step, "name", getattr(step, "idx", "")))
