"""A material grown for a surface: one texture over all of its chart, from a seed and parameters (floor 4).

Alphabet
uv          texture coordinates of the shell's corners, in patches: any range
origin      (u, v) of the texture's first texel: whole patches below the least uv
needed      patches that the surface touches, or comes nearer to than REACH patches: lookups of far views reach over
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle
from mesoshell.shell.bake import Share, bake
from mesoshell.shell.generated import grown, maker_of
from mesoshell.shell.scene import normalised

REACH = 0.5
#: Bytes of a texture in memory, with its mips: a render that wants more has too many patches on its mesh.
MOST_BYTES = 6 * 2**30


def grow(
    bundle: Bundle,
    name: str,
    uv: Float[np.ndarray, "P 3 2"],
    seed: int,
    values: dict[str, float],
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[Bundle, tuple[int, int]]:
    """The bundle with a texture that covers the surface, and its origin (u, v). values: of parameters, in their units.

    Raises InputError, about `name`, if there is no generator, or the texture would not fit in memory.
    """
    texels = int(bundle.texel_density)
    low, high = _cells(uv)
    across, along = (int(n) for n in high.max(axis=0) - low.min(axis=0) + 1)
    if across * along * texels**2 * bundle.channels * 2 * 4 / 3 > MOST_BYTES:
        raise InputError("--scale", f"the mesh would carry {across} × {along} patches: give larger ones")
    origin, needed = patches_of(uv)
    size = needed.shape[0] * texels, needed.shape[1] * texels
    found, share = baked(bundle, name, size, seed, values, needed, progress)
    return replace(found, provenance=found.provenance | share._asdict()), origin


def baked(
    bundle: Bundle,
    name: str,
    size: tuple[int, int],
    seed: int,
    values: dict[str, float],
    needed: Bool[np.ndarray, "P Q"] | None = None,
    progress: Callable[[float], None] = lambda share: None,
    allocate: Callable[[str, tuple[int, ...]], np.ndarray] | None = None,
) -> tuple[Bundle, Share]:
    """The bundle with a texture of `size` texels (V, U) in place of its generator; its defaults are the given values."""
    maker = maker_of(bundle, name)
    if maker.config.planes > 1:
        raise InputError(name, "has three planes a patch, which end at its sides: no texture can be made of them")
    beta = normalised(bundle, values, "beta")
    arrays = {key: array for key, array in bundle.arrays.items() if key.startswith(("decoder/", "sigma_scale"))}

    def in_memory(key: str, shape: tuple[int, ...]) -> np.ndarray:
        return np.zeros(shape, np.float16)

    def keep(key: str, shape: tuple[int, ...]) -> np.ndarray:
        arrays[key] = (allocate or in_memory)(key, shape)
        return arrays[key]

    share = bake(maker, grown(maker, seed, beta), size, keep, needed, progress)
    parameters = tuple(replace(p, default=float(values.get(p.name, p.default))) for p in bundle.parameters)
    made = replace(bundle, arrays=arrays, generator=None, wraps=False, parameters=parameters)
    return replace(made, provenance=bundle.provenance | {"seed": seed}), share


def patches_of(uv: Float[np.ndarray, "P 3 2"]) -> tuple[tuple[int, int], Bool[np.ndarray, "V U"]]:
    """Origin (u, v), and which patches from there on are needed, by the triangles' bounding boxes."""
    low, high = _cells(uv)
    first = low.min(axis=0)
    needed = np.zeros((high.max(axis=0) - first + 1)[::-1], bool)
    for (u0, v0), (u1, v1) in zip(low - first, high - first, strict=True):
        needed[v0 : v1 + 1, u0 : u1 + 1] = True
    return (int(first[0]), int(first[1])), needed


def _cells(uv: Float[np.ndarray, "P 3 2"]) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest patch (u, v) that each triangle needs."""
    return tuple(np.floor(x).astype(int) for x in (uv.min(axis=1) - REACH, uv.max(axis=1) + REACH))
