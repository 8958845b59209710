"""Which patches of the plane a surface's chart lies on (NumPy only).

Notation
uv          texture coordinates of a surface's corners, in patches: any range
needed      patches that the surface touches, or comes within REACH patches of: lookups from afar reach them
"""

import numpy as np
from jaxtyping import Bool, Float

REACH = 0.5
#: A corner so little before a patch is of that patch.
ROUNDING = 1e-3
#: Most bytes of a texture in memory, with its mips: more means too many patches on the mesh.
MAX_BYTES = 6 * 2**30


def fits(patches: tuple[int, ...], texels: int, channels: int) -> bool:
    """Whether a texture of so many patches (V, U) fits in memory, in half precision."""
    return patches[0] * patches[1] * texels**2 * channels * 2 * 4 / 3 <= MAX_BYTES


def patches_of(uv: Float[np.ndarray, "P 3 2"]) -> tuple[tuple[int, int], Bool[np.ndarray, "V U"]]:
    """Origin (u, v), and which patches from there on are needed, by the triangles' bounding boxes."""
    low, high = cells(uv)
    first = low.min(axis=0)
    needed = np.zeros((high.max(axis=0) - first + 1)[::-1], bool)
    for (u0, v0), (u1, v1) in zip(low - first, high - first, strict=True):
        needed[v0 : v1 + 1, u0 : u1 + 1] = True
    return (int(first[0]), int(first[1])), needed


def texture_origin(uv: Float[np.ndarray, "P 3 2"], size: tuple[float, float]) -> tuple[int, int]:
    """Origin (u, v) of a texture of `size` patches (V, U) that is given: the first patch that is needed, or, along an axis on
    which the texture is smaller than that, the first that the surface touches."""
    first, needed = patches_of(uv)
    touched = np.floor(uv.min(axis=(0, 1)) + ROUNDING).astype(int)
    u, v = (f if s >= n else int(t) for f, t, s, n in zip(first, touched, size[::-1], needed.shape[::-1], strict=True))
    return u, v


def cells(uv: Float[np.ndarray, "P 3 2"]) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest patch (u, v) that each triangle needs."""
    return tuple(np.floor(x).astype(int) for x in (uv.min(axis=1) - REACH, uv.max(axis=1) + REACH))
