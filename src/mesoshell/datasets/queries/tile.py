"""One period of a mesostructure, and copies of it bent onto a cylinder (NumPy only).

Notation
u, v, h      texture coordinates, one period each, and height over the bounding surface, all in texture units; h ≤ 0
D            depth: everything lies in −D ≤ h ≤ 0, and a solid body below
κ            curvature of the cylinder, 1 / texture unit: positive if it is seen from outside, 0 if flat, negative from within
s, y         arc length across the cylinder's axis, and along it, on the bounding surface, from the patch's middle
φ, (a, b)    the patch lies on the texture turned and shifted: (u, v) = Rot(φ) (s, y) + (a, b)
P            place in the world: the origin is the patch's middle, x runs across the axis, y along it, z outward
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

#: Of the solid body: strips across the axis, and how far it reaches where it does not close around the axis.
STRIPS, REACH = 1024, 60.0


@dataclass(frozen=True, eq=False)
class Tile:
    """Triangles of one period, diffuse from both sides, with linear albedos at their vertices; body: the albedo beneath."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    albedo: Float[np.ndarray, "V 3"]
    depth: float
    body: tuple[float, float, float]


@dataclass(frozen=True)
class PatchPlacement:
    """How a patch lies on the texture and on the cylinder."""

    curvature: float
    turn: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)

    def texture(self, sy: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
        """(u, v) of (s, y)."""
        return sy @ _rotation(self.turn).T + np.array(self.shift)


def patch(
    tile: Tile, placing: PatchPlacement, reach: tuple[float, float]
) -> tuple[Float[np.ndarray, "N 3"], Int[np.ndarray, "M 3"], Float[np.ndarray, "N 3"]]:
    """Vertices in the world, faces and albedos of all triangles whose middle has |s| and |y| within reach, once round the
    cylinder at most, and of the body."""
    reach = (min(reach[0], np.pi / max(abs(placing.curvature), 1e-9)), reach[1])
    box = np.array([[x * reach[0], y * reach[1]] for x in (-1, 1) for y in (-1, 1)])
    (low, high), (least, most) = ((x.min(axis=0), x.max(axis=0)) for x in (placing.texture(box), tile.vertices[:, :2]))
    cells = [np.arange(np.floor(a), np.ceil(b) + 1) for a, b in zip(low - most, high - least, strict=True)]
    shifts = np.stack(np.meshgrid(*cells, indexing="ij"), axis=-1).reshape(-1, 1, 2)
    back = _rotation(placing.turn)
    sy = (tile.vertices[None, :, :2] + shifts - np.array(placing.shift)) @ back
    middle = sy[:, tile.faces].mean(axis=2)
    copy, face = np.nonzero((np.abs(middle) <= np.array(reach)).all(axis=-1))
    corners = copy[:, None] * len(tile.vertices) + tile.faces[face]
    used, faces = np.unique(corners, return_inverse=True)
    height = tile.vertices[used % len(tile.vertices), 2]
    points = bent(sy.reshape(-1, 2)[used], height, placing.curvature)
    body, below = _body(tile.depth, placing.curvature)
    albedo = [tile.albedo[used % len(tile.vertices)], np.broadcast_to(np.array(tile.body), body.shape)]
    return (
        np.concatenate([points, body]),
        np.concatenate([faces.reshape(-1, 3), below + len(points)]),
        np.concatenate(albedo),
    )


def bent(sy: Float[np.ndarray, "*n 2"], height: Float[np.ndarray, "*n"], curvature: float) -> Float[np.ndarray, "*n 3"]:
    """P of (s, y, h)."""
    angle = curvature * sy[..., 0]
    x = sy[..., 0] * np.sinc(angle / np.pi) + height * np.sin(angle)
    drop = sy[..., 0] * np.sin(angle / 2) * np.sinc(angle / (2 * np.pi))  # (1 − cos κs) / κ
    return np.stack([x, sy[..., 1], height * np.cos(angle) - drop], axis=-1)


def frame(sy: Float[np.ndarray, "*n 2"], curvature: float) -> Float[np.ndarray, "*n 3 3"]:
    """Unit tangents across and along the axis, and the outward normal, as rows."""
    angle = curvature * sy[..., 0]
    c, s, o, l = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    rows = [[c, o, -s], [o, l, o], [s, o, c]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def _body(depth: float, curvature: float) -> tuple[np.ndarray, np.ndarray]:
    """The surface h = −D, closed around the axis where that lies within REACH."""
    far = REACH if curvature == 0 else min(REACH, np.pi / abs(curvature))
    s, y = np.meshgrid(np.linspace(-far, far, STRIPS + 1), np.array([-REACH, REACH]), indexing="ij")
    points = bent(np.stack([s, y], axis=-1).reshape(-1, 2), np.full(s.size, -depth), curvature)
    i = 2 * np.arange(STRIPS)[:, None]
    return points, np.concatenate([i + np.array([0, 2, 3]), i + np.array([0, 3, 1])])


def _rotation(angle: float) -> Float[np.ndarray, "2 2"]:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])
