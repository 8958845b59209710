"""A mesostructure as geometry on a mesh: the reference for a surface material (NumPy and Embree).

Notation
period       world length of one period of the texture; u and v of the mesh are counted in periods
P, n         point and interpolated unit normal of the mesh at (u, v): a vertex (u, v, h) of the tile comes to P + period h n

A mesh whose coordinates span a whole number of periods along u or v is taken to close there, as a torus does: geometry goes on
across the seam. Elsewhere a triangle that does not lie within one chart is left out, so seams show the bare body.
"""

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Float, Int

from mesoshell.datasets.queries.tile import Tile
from mesoshell.geometry.mesh import Mesh, uv_stretch

#: An edge longer than this many times its length in the texture crosses a seam.
LONGEST = 3.0
#: Tolerance of a whole number of periods.
WHOLE = 1e-3


def apply_mesostructure(
    tile: Tile, mesh: Mesh, period: float
) -> tuple[Float[np.ndarray, "N 3"], Int[np.ndarray, "M 3"], Float[np.ndarray, "N 3"]]:
    """Vertices in the world, faces and albedos of the mesostructure all over a mesh, and of the body beneath it."""
    periods = uv_stretch(mesh) / period
    uv = mesh.uv.astype(np.float64) * periods
    low, high = np.floor(uv.min(axis=(0, 1))), np.ceil(uv.max(axis=(0, 1)))
    least, span = uv.min(axis=(0, 1)), np.ptp(uv, axis=(0, 1))
    closed = (np.abs(span - np.round(span)) < WHOLE) & (span > 0.5)
    around = np.where(closed, np.round(span), 0)
    uv = np.where(closed, least + (uv - least) * around / np.where(closed, span, 1), uv)
    chart = _Chart(uv)
    points, faces, colours, count = [], [], [], 0
    for shift in np.stack(np.meshgrid(*map(np.arange, low - 1, high + 1), indexing="ij"), axis=-1).reshape(-1, 2):
        at = tile.vertices[:, :2] + shift
        face, bary = chart.locate(np.where(closed, least + (at - least) % np.where(closed, around, 1), at))
        if (face < 0).all():
            continue
        place, normal = (np.einsum("vk,vki->vi", bary, x[mesh.faces[face]]) for x in (mesh.vertices, mesh.normals))
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        world = place + period * tile.vertices[:, 2:] * normal
        middle = at[tile.faces].mean(axis=1)
        once = ((middle >= least) & (middle < least + around) | ~closed).all(axis=1)
        kept = tile.faces[(face[tile.faces] >= 0).all(axis=1) & once]
        kept = kept[_short(world[kept], tile.vertices[kept] * period)]
        points.append(world)
        faces.append(kept + count)
        colours.append(tile.albedo)
        count += len(world)
    body = mesh.vertices - period * tile.depth * mesh.normals
    points.append(body)
    faces.append(mesh.faces + count)
    colours.append(np.broadcast_to(np.array(tile.body), body.shape))
    every = np.concatenate(faces)
    used, renumbered = np.unique(every, return_inverse=True)
    return np.concatenate(points)[used], renumbered.reshape(-1, 3), np.concatenate(colours)[used]


class _Chart:
    """Finds points of the texture on a mesh, by Embree rays along the third axis."""

    def __init__(self, uv: Float[np.ndarray, "F 3 2"]):
        self.uv, self.centre = uv, uv.mean(axis=(0, 1))
        corners = np.concatenate([uv - self.centre, np.zeros((*uv.shape[:2], 1))], axis=-1)
        self.scene = EmbreeScene()
        TriangleMesh(self.scene, np.ascontiguousarray(corners, np.float32))

    def locate(self, at: Float[np.ndarray, "V 2"]) -> tuple[Int[np.ndarray, "V"], Float[np.ndarray, "V 3"]]:
        """The face that holds each point, −1 for none, and barycentric coordinates there."""
        origin = np.concatenate([at - self.centre, np.ones((len(at), 1))], axis=1).astype(np.float32)
        down = np.tile(np.array([0, 0, -1], np.float32), (len(at), 1))
        hits = self.scene.run(np.ascontiguousarray(origin), down, output=True)
        face = np.where(hits["geomID"] < 0, -1, hits["primID"]).astype(np.int64)
        a, b, c = np.moveaxis(self.uv[face], 1, 0)
        p, q, r = b - a, c - a, at - a
        area = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
        area = np.where(area == 0, 1, area)
        x = (r[:, 0] * q[:, 1] - r[:, 1] * q[:, 0]) / area
        y = (p[:, 0] * r[:, 1] - p[:, 1] * r[:, 0]) / area
        return face, np.stack([1 - x - y, x, y], axis=1)


def _short(world: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Whether no edge of a triangle is much longer in the world than in the texture."""
    longest, wanted = (np.linalg.norm(np.roll(x, -1, axis=1) - x, axis=-1).max(axis=1) for x in (world, flat))
    return longest <= LONGEST * np.maximum(wanted, 1e-9)
