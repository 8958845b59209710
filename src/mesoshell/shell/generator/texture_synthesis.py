"""A material synthesised for a surface: one texture over all of its chart, from a seed and parameters.

Notation
uv          texture coordinates of the shell's corners, in patches: any range
origin      (u, v) of the texture's first texel: whole patches below the least uv
β           geometry parameters, normalised; a field of one is its value at each place, as (u, v) ↦ β
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import jax
import numpy as np
from jaxtyping import Bool, Float

from mesoshell.errors import Argument, InputError
from mesoshell.io.bundle import Bundle
from mesoshell.io.kept_textures import Allocate, kept, key_of
from mesoshell.io.level_arrays import split
from mesoshell.io.material import parameter_vector
from mesoshell.shell.generator.bake import Share, bake
from mesoshell.shell.generator.model import generator_model, grown
from mesoshell.shell.generator.nodes import count_nodes
from mesoshell.shell.geometry.chart import fits, patches_of, span, texture_bytes


@dataclass(frozen=True)
class TextureRequest:
    """Settings of a texture. values: of parameters, in their units; fields: of geometry parameters that vary, from (…, 2)
    coordinates in patches to (…) values in [0, 1]; coarser: how many of the finest levels are left out; latent: another seed,
    and the share by which z goes from that of `seed` toward that of the other."""

    seed: int = 0
    values: dict[str, float] = field(default_factory=dict)
    fields: dict[str, Callable[[np.ndarray], np.ndarray]] = field(default_factory=dict)
    coarser: int = 0
    latent: tuple[int, float] | None = None


def grow(
    bundle: Bundle,
    name: str,
    uv: Float[np.ndarray, "P 3 2"],
    wanted: TextureRequest,
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[Bundle, tuple[int, int]]:
    """The bundle with a texture that covers the surface, and its origin (u, v). A large one is kept for the next render.

    Raises InputError, about `name`, if there is no generator, or the texture would not fit in memory.
    """
    texels = int(bundle.texel_density)
    _, (along, across) = span(uv)
    if not fits((along, across), texels, bundle.channels):
        raise InputError(Argument("scale"), f"the mesh would carry {across} × {along} patches: give a larger scale")
    origin, needed = patches_of(uv)
    size = needed.shape[0] * texels, needed.shape[1] * texels
    moved = {key: lambda at, f=f: f(at + np.array(origin)) for key, f in wanted.fields.items()}
    wanted = replace(wanted, fields=moved)

    def make(allocate: Allocate | None) -> Bundle:
        textured, share = bake_bundle(bundle, name, size, wanted, needed, progress, allocate)
        return replace(textured, provenance=textured.provenance | share._asdict())

    beta = _geometry(bundle, wanted, count_nodes(size, texels))
    settings = (
        sorted(wanted.values.items()),
        sorted(wanted.fields),
        wanted.coarser,
        wanted.latent,
        bundle.generator,
        bundle.parameters,
        jax.default_backend(),  # which rounds in its own way
    )
    key = key_of(bundle, beta, size, needed.tobytes(), wanted.seed, *settings)
    return kept(key, texture_bytes(needed.shape, texels, bundle.channels) >> 2 * wanted.coarser, make), origin


def bake_bundle(
    bundle: Bundle,
    name: str,
    size: tuple[int, int],
    wanted: TextureRequest,
    needed: Bool[np.ndarray, "P Q"] | None = None,
    progress: Callable[[float], None] = lambda share: None,
    allocate: Allocate | None = None,
) -> tuple[Bundle, Share]:
    """The bundle with a texture of `size` texels (V, U) in place of its generator; its defaults are the given values."""
    maker = generator_model(bundle, name)
    if maker.config.planes > 1:
        raise InputError(name, "has three planes per patch, which end at its sides: they make no larger texture")
    beta = _geometry(bundle, wanted, count_nodes(size, maker.config.texels))
    arrays = {key: array for key, array in bundle.arrays.items() if key.startswith(("decoder/", "sigma_scale"))}
    if maker.correction is not None:
        arrays["correction"] = maker.correction[wanted.coarser :]
        maker = replace(maker, correction=arrays["correction"])

    def in_memory(name: str, shapes: Sequence[tuple[int, ...]]) -> list[np.ndarray]:
        return split(np.zeros(sum(math.prod(shape) for shape in shapes), np.float16), shapes)

    def keep(name: str, shapes: Sequence[tuple[int, ...]]) -> list[np.ndarray]:
        levels = (allocate or in_memory)(name, shapes)
        arrays.update((f"{name}/{i}", level) for i, level in enumerate(levels))
        return levels

    begun = grown(maker, wanted.seed, beta, wanted.latent)
    share = bake(maker, begun, size, keep, needed, progress, wanted.coarser)
    parameters = tuple(replace(p, default=float(wanted.values.get(p.name, p.default))) for p in bundle.parameters)
    density = bundle.texel_density / 2**wanted.coarser
    made = replace(
        bundle, arrays=arrays, generator=None, twin=None, wraps=False, parameters=parameters, texel_density=density
    )
    said = {"seed": wanted.seed, "varies": sorted(wanted.fields)}
    said |= {} if wanted.latent is None else {"latent": list(wanted.latent)}
    return replace(made, provenance=bundle.provenance | said), share


def _geometry(bundle: Bundle, wanted: TextureRequest, nodes: tuple[int, int]) -> Float[np.ndarray, "*nodes G"]:
    """β of the texture; or at each corner of its patches, if it varies."""
    same = parameter_vector(bundle, wanted.values, "beta")
    if not wanted.fields:
        return same
    varying = np.broadcast_to(same, (*nodes, len(same))).copy()
    at = np.stack(np.meshgrid(np.arange(nodes[1]), np.arange(nodes[0])), axis=-1).astype(np.float64)
    names = [p.name for p in bundle.parameters if p.role == "beta"]
    for name, values in wanted.fields.items():
        varying[..., names.index(name)] = values(at)
    return varying


def field_of(
    image: Float[np.ndarray, "H W"], square: tuple[float, float], repeats: bool
) -> Callable[[np.ndarray], np.ndarray]:
    """Nearest-pixel lookup of an image over `square` patches along (u, v), its last row at v = 0; outside, the image repeats or
    is clamped."""
    shape = np.array(image.shape[::-1])

    def value(at: np.ndarray) -> np.ndarray:
        uv = at / np.array(square)
        uv = uv - np.floor(uv) if repeats else np.clip(uv, 0, 1)
        column, row = np.moveaxis(np.minimum((uv * shape).astype(int), shape - 1), -1, 0)
        return image[::-1][row, column]

    return value
