"""The grid in which σ of a material's finest texture level is kept, by either engine: its shape, and its place in the cache.

Notation
S           columns of the grid along a texel; column i is (i + ½) / S texels from the border
K           rows along the height, at (k + ½) / K
α           appearance parameters, normalised; one that differs where the material is, is baked at 0 and 1, the others at their
            one value

σ is linear between columns, rows and values of α. The network has edges that are sharper than a texel: with two columns a texel
σ of grass is off by half as much as with one. (Interpolating what softplus takes keeps edges sharp, and loses a quarter of all
density: blades are thin.)

A grid that takes a while to make is kept in the cache, by a hash of all that it depends on; what was not used for longest goes
when all are more than MAX_BYTES.
"""

import hashlib
import math
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from mesoshell import __version__
from mesoshell.io.bundle import Bundle
from mesoshell.io.cache import cache_folder
from mesoshell.io.kept_arrays import keep_arrays, read_arrays

K = 64
#: Numbers of a grid that is kept, at least; bytes of all that are kept, at most.
MIN_KEPT, MAX_BYTES = 2**20, 2**30


def grid_shape(texture: tuple[int, ...], varying: int, most: int) -> tuple[int, ...]:
    """Shape of a grid, (2, …, S V, S U, K), with S = 2 where that holds at most so many numbers. texture: shape of its finest
    level, (V, U, …); varying: parameters that do."""
    shapes = [(*[2] * varying, s * texture[0], s * texture[1], K) for s in (2, 1)]
    return next((s for s in shapes if math.prod(s) <= most), shapes[-1])


def kept_grid(
    of: tuple[object, ...], shape: tuple[int, ...], make: Callable[[], Float[np.ndarray, "N"]]
) -> Float[np.ndarray, "N"]:
    """A grid's numbers in half precision, from the cache or made. of: all else that they depend on."""
    key = hashlib.sha256(repr((__version__, *of, shape)).encode()).hexdigest()[:32]
    entry, keeps = cache_folder("densities") / f"{key}.npz", math.prod(shape) >= MIN_KEPT
    kept = read_arrays(entry, ["sigma"]) if keeps else None
    if kept is not None:
        return kept["sigma"]
    made = make()
    if keeps:
        keep_arrays(entry, {"sigma": made}, MAX_BYTES)
    return made


def in_half(sigma: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """σ in half precision, what is above its range at its end."""
    return np.minimum(sigma, np.finfo(np.float16).max).astype(np.float16)


def finest_digest(bundle: Bundle) -> str:
    """A hash of all that σ of the finest level depends on."""
    sha, others = hashlib.sha256(), ("features/", "grid/", "decoder/head/", "decoder/rho/", "generator/")
    for name in ("features/0", *(k for k in sorted(bundle.arrays) if not k.startswith(others))):
        array = np.ascontiguousarray(bundle.arrays[name])
        sha.update(f"{name} {array.dtype} {array.shape} ".encode() + array.tobytes())
    fields = (bundle.texel_density, bundle.wraps, bundle.height_octaves, bundle.finest_corrected)
    sha.update(repr(fields).encode())
    return sha.hexdigest()
