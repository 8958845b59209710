"""Tangent frames of triangles from their texture coordinates.

Alphabet
P(u, v)     the affine map of one triangle from texture space to the world
∂u, ∂v      ∂P/∂u and ∂P/∂v, world length per unit of the given uv        (F, 3), in the triangle's plane
n           unit normal of the triangle                                   (F, 3)

With edges E_i = P_i − P_0 and (a_i, b_i) = uv_i − uv_0, i = 1, 2: E_i = a_i ∂u + b_i ∂v, a 2 × 2 system of determinant
det = a₁ b₂ − a₂ b₁ (twice the signed area in uv). Where det < 0 the chart is mirrored and (∂u, ∂v, n) is left-handed.
Where det is 0 to rounding no such frame exists: there ∂u, ∂v are unit, perpendicular and right-handed with n, and
`made_up` says so. Duff et al. 2017, "Building an orthonormal basis, revisited". Float64 inside, float32 out.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from mesoshell.geometry.normals import face_normals

#: det at most this share of the longest squared uv edge is 0: float32 texture coordinates hold no more.
LEAST_DETERMINANT = 1e-9


@dataclass(frozen=True)
class Frames:
    """One frame a triangle; float32."""

    along_u: Float[np.ndarray, "F 3"]
    along_v: Float[np.ndarray, "F 3"]
    normal: Float[np.ndarray, "F 3"]
    mirrored: Bool[np.ndarray, "F"]
    made_up: Bool[np.ndarray, "F"]

    @property
    def made_up_count(self) -> int:
        """How many triangles have no area in uv."""
        return int(self.made_up.sum())


def tangent_frames(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], uv: Float[np.ndarray, "F 3 2"]
) -> Frames:
    """Frames of triangles that have an area in the world; uv in UV units or in patches, and so is the result."""
    points = vertices.astype(np.float64)
    normal = face_normals(points, faces)
    corner, texture = points[faces], uv.astype(np.float64)
    edge = corner[:, 1:] - corner[:, :1]
    (a1, b1), (a2, b2) = np.moveaxis(texture[:, 1:] - texture[:, :1], 0, -1)
    det = a1 * b2 - a2 * b1
    longest = ((np.roll(texture, -1, axis=1) - texture) ** 2).sum(axis=-1).max(axis=1)
    made_up = np.abs(det) <= LEAST_DETERMINANT * longest
    safe = np.where(made_up, 1.0, det)[:, None]
    along_u = (b2[:, None] * edge[:, 0] - b1[:, None] * edge[:, 1]) / safe
    along_v = (a1[:, None] * edge[:, 1] - a2[:, None] * edge[:, 0]) / safe
    along_u[made_up], along_v[made_up] = _basis(normal[made_up])
    u, v, n = (x.astype(np.float32) for x in (along_u, along_v, normal))
    return Frames(u, v, n, (det < 0) & ~made_up, made_up)


def _basis(n: Float[np.ndarray, "G 3"]) -> tuple[Float[np.ndarray, "G 3"], Float[np.ndarray, "G 3"]]:
    x, y, z = n.T
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return (
        np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1),
        np.stack([b, sign + y * y * a, -y], axis=1),
    )
