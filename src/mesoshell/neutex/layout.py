"""Layouts of a spherical texture as an image.

Notation
u           a unit vector
(x, y)      place in the image, [0, 1]², x right and y down
cubemap     six squares, 3 across and 2 down: +x −x +y over −y +z −z; each as seen from outside
latlong     twice as wide as high: azimuth across, from −π to π; +z on top
square      octahedron, unfolded: +z in the middle, −z in the corners

An image of `side` has side² pixels per square of the cubemap, 2 side × side for latlong, and side² for square.
"""

from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float as NumPyFloat

from mesoshell.typing import Array, Float, Vec2, Vec3

Layout = Literal["cubemap", "latlong", "square"]
LAYOUTS: tuple[Layout, ...] = ("cubemap", "latlong", "square")
#: Components below this count as 0.
TINY = 1e-30
#: Right, up and outward directions of each square of the cubemap.
FACES = np.array(
    [
        [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
        [[0, -1, 0], [0, 0, 1], [-1, 0, 0]],
        [[-1, 0, 0], [0, 0, 1], [0, 1, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
        [[0, 1, 0], [1, 0, 0], [0, 0, -1]],
    ],
    np.float32,
)


def shape(layout: Layout, side: int) -> tuple[int, int]:
    """(height, width) of an image."""
    return {"cubemap": (2 * side, 3 * side), "latlong": (side, 2 * side), "square": (side, side)}[layout]


def side_of(layout: Layout, height: int, width: int) -> int | None:
    """`side` of an image of this size, or None if the layout has no such image."""
    side = height // 2 if layout == "cubemap" else height
    return side if side and shape(layout, side) == (height, width) else None


def place(layout: Layout, u: Vec3, side: int) -> Vec2:
    """(x, y) of a direction. In a cubemap it stays half a pixel inside its square, so that no other square is mixed in."""
    if layout == "latlong":
        u = jnp.where(jnp.abs(u) < TINY, 0, u)  # XLA's atan2 of two subnormal numbers is NaN
        return jnp.stack([jnp.arctan2(u[1], u[0]) / (2 * jnp.pi) + 0.5, jnp.arccos(jnp.clip(u[2], -1, 1)) / jnp.pi])
    if layout == "square":
        p = u[:2] / jnp.sum(jnp.abs(u))
        folded = (1 - jnp.abs(p[::-1])) * jnp.where(p < 0, -1.0, 1.0).astype(p.dtype)
        p = jnp.where(u[2] < 0, folded, p)
        return jnp.stack([p[0] + 1, 1 - p[1]]) / 2
    axis = jnp.argmax(jnp.abs(u))
    face = 2 * axis + (u[axis] < 0).astype(axis.dtype)
    local = jnp.sum(jnp.asarray(FACES, u.dtype)[face] * u[None], axis=1)
    p = jnp.clip(jnp.stack([local[0] + local[2], local[2] - local[1]]) / (2 * local[2]), 0.5 / side, 1 - 0.5 / side)
    corner = jnp.stack([face % 3, face // 3]).astype(u.dtype)
    return (corner + p) / jnp.array([3, 2], u.dtype)


def directions(layout: Layout, side: int) -> NumPyFloat[np.ndarray, "h w 3"]:
    """u at the middle of each pixel."""
    h, w = shape(layout, side)
    y, x = np.meshgrid((np.arange(h) + 0.5) / h, (np.arange(w) + 0.5) / w, indexing="ij")
    if layout == "latlong":
        azimuth, polar = (x - 0.5) * 2 * np.pi, y * np.pi
        u = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=-1)
    elif layout == "square":
        p = np.stack([2 * x - 1, 1 - 2 * y], axis=-1)
        z = 1 - np.abs(p).sum(axis=-1, keepdims=True)
        folded = (1 - np.abs(p[..., ::-1])) * np.where(p < 0, -1, 1)
        u = np.concatenate([np.where(z < 0, folded, p), z], axis=-1)
    else:
        u = on_faces(
            np.stack([3 * x % 1, 2 * y % 1], axis=-1), np.floor(2 * y).astype(int) * 3 + np.floor(3 * x).astype(int)
        )
    return (u / np.linalg.norm(u, axis=-1, keepdims=True)).astype(np.float32)


def on_faces(p: NumPyFloat[np.ndarray, "*n 2"], face: np.ndarray) -> NumPyFloat[np.ndarray, "*n 3"]:
    """Points of the cube, from (x, y) in squares of the cubemap."""
    local = np.stack([2 * p[..., 0] - 1, 1 - 2 * p[..., 1], np.ones_like(p[..., 0])], axis=-1)
    return np.einsum("...i,...ij->...j", local, FACES[face])


def lookup(layout: Layout, image: Float[Array, "h w c"], u: Vec3) -> Float[Array, "c"]:
    """Bilinear lookup; latlong wraps in azimuth, all else is clamped."""
    h, w = image.shape[:2]
    side = side_of(layout, h, w)
    assert side, f"{h} x {w} pixels are not a {layout}"
    at = place(layout, u, side) * jnp.array([w, h], u.dtype) - 0.5
    low = jnp.floor(at)
    part = at - low
    i = low.astype(jnp.int32)
    x, y = jnp.stack([i[0], i[0] + 1]), jnp.clip(jnp.stack([i[1], i[1] + 1]), 0, h - 1)
    x = x % w if layout == "latlong" else jnp.clip(x, 0, w - 1)
    four = image[y[:, None], x[None, :]]
    rows = four[:, 0] * (1 - part[0]) + four[:, 1] * part[0]
    return rows[0] * (1 - part[1]) + rows[1] * part[1]


def checkerboard(layout: Layout, side: int, squares: int = 8) -> NumPyFloat[np.ndarray, "h w 3"]:
    """`squares` × `squares` of each face of a cube, light and dark, tinted by face: a test texture."""
    u = directions(layout, side)
    axis = np.abs(u).argmax(axis=-1)
    face = 2 * axis + (np.take_along_axis(u, axis[..., None], axis=-1)[..., 0] < 0)
    local = np.einsum("hwij,hwj->hwi", FACES[face], u)
    p = np.floor((local[..., :2] / local[..., 2:] + 1) / 2 * squares)
    light = np.where((p.sum(axis=-1) % 2) == 0, 0.85, 0.12)
    tint = np.array([[1, 0.55, 0.5], [0.55, 1, 1], [0.6, 1, 0.5], [1, 0.55, 1], [0.5, 0.65, 1], [1, 1, 0.5]])
    return (light[..., None] * tint[face]).astype(np.float32)
