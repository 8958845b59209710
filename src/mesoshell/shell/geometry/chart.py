"""Which patches of the plane a surface's chart lies on (NumPy only).

Notation
uv          texture coordinates of a surface's corners, in patches: any range
needed      patches that the surface touches, or comes within REACH patches of: lookups from afar reach them
"""

import numpy as np
from jaxtyping import Bool, Float, Int

REACH = 0.5
#: A corner so little before a patch is of that patch.
ROUNDING = 1e-3
#: Most bytes of a texture in memory, with its mips: more means too many patches on the mesh.
MAX_BYTES = 6 * 2**30


def texture_bytes(patches: tuple[int, ...], texels: int, channels: int) -> int:
    """Of a texture of so many patches (V, U) with its mips, in half precision."""
    return patches[0] * patches[1] * texels**2 * channels * 2 * 4 // 3


def fits(patches: tuple[int, ...], texels: int, channels: int) -> bool:
    """Whether a texture of so many patches (V, U) fits in memory."""
    return texture_bytes(patches, texels, channels) <= MAX_BYTES


def span(uv: Float[np.ndarray, "P 3 2"]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Origin (u, v) of the patches that are needed, and how many there are along v and u."""
    low, high = uv.min(axis=(0, 1)), uv.max(axis=(0, 1))
    first, last = _cell(low - REACH), _cell(high + REACH)
    return (int(first[0]), int(first[1])), (int(last[1] - first[1]) + 1, int(last[0] - first[0]) + 1)


def patches_of(uv: Float[np.ndarray, "P 3 2"]) -> tuple[tuple[int, int], Bool[np.ndarray, "V U"]]:
    """Origin (u, v), and which patches from there on are needed, by the triangles' bounding boxes."""
    origin, patches = span(uv)
    u0, v0 = (_cell(uv.min(axis=1) - REACH) - origin).T
    u1, v1 = (_cell(uv.max(axis=1) + REACH) - origin).T + 1
    boxes = np.zeros((patches[0] + 1, patches[1] + 1), np.int32)  # so many more cover a patch than the one before
    for v, u, more in ((v0, u0, 1), (v0, u1, -1), (v1, u0, -1), (v1, u1, 1)):
        np.add.at(boxes, (v, u), more)
    return origin, boxes.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0


def texture_origin(uv: Float[np.ndarray, "P 3 2"], size: tuple[float, float]) -> tuple[int, int]:
    """Origin (u, v) of a texture of `size` patches (V, U) that is given: the first patch that is needed, or, along an axis on
    which the texture is smaller than that, the first that the surface touches."""
    first, patches = span(uv)
    touched = _cell(uv.min(axis=(0, 1)) + ROUNDING)
    u, v = (f if s >= n else int(t) for f, t, s, n in zip(first, touched, size[::-1], patches[::-1], strict=True))
    return u, v


def _cell(uv: Float[np.ndarray, "*n 2"]) -> Int[np.ndarray, "*n 2"]:
    return np.floor(uv).astype(np.int64)
