"""How much a film flickers: what differs between two frames beside what the camera's known motion explains.

Notation
x           point of the surface, the mesh half a shell higher, that a pixel of the later frame sees; world
warped      the earlier frame, as seen where the later one sees the same points                                     (H, W, 3)
flicker     mean FLIP of the later frame against the warped one, over the pixels whose point both frames see

Where grass is seen before no surface, beyond outlines, nothing is known of its motion: such pixels are left out. Warping is
bilinear, which blurs, and within a shell points move otherwise than its middle; so even a perfect film has some flicker, and
films are compared at the same motion and size.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from jaxtyping import Bool, Float, Int
from scipy.ndimage import map_coordinates

from mesoshell.geometry.mesh import Mesh
from mesoshell.measure.flip import flip_map
from mesoshell.render.camera import Camera, pixel_grid, rays

#: Two distances are of one point if they differ by less, in parts of the distance.
SAME = 1e-3
#: Share of pixels that both frames must see.
MIN_SHARE = 0.01


@dataclass(frozen=True, eq=False)
class FrameView:
    """A camera, and the triangles before it: (F, 3, 3) corners, in the same order in each frame; world."""

    camera: Camera
    corners: Float[np.ndarray, "F 3 3"]

    def hit(
        self, origins: Float[np.ndarray, "R 3"], directions: Float[np.ndarray, "R 3"]
    ) -> tuple[Int[np.ndarray, "R"], Float[np.ndarray, "R"]]:
        """Triangle (−1 for none) and distance of the nearest hit."""
        centre = self.corners.mean(axis=(0, 1))
        scene = EmbreeScene()
        TriangleMesh(scene, np.ascontiguousarray(self.corners - centre, np.float32))
        o, d = ((x).astype(np.float32) for x in (origins - centre, directions))
        met = scene.run(np.ascontiguousarray(o), np.ascontiguousarray(d), output=True)
        return met["primID"], met["tfar"]


def frame_view(camera: Camera, grown: Sequence[tuple[Mesh, float]], objects: tuple[Mesh, ...] = ()) -> FrameView:
    """What a frame sees: meshes that are grown, raised by half of their thickness (world), and objects."""
    corners = [(m.vertices + m.normals * np.float64(t / 2))[m.faces] for m, t in (*grown, *((x, 0.0) for x in objects))]
    return FrameView(camera, np.concatenate(corners))


def reproject(before: FrameView, now: FrameView) -> tuple[Float[np.ndarray, "P 2"], Bool[np.ndarray, "P"]]:
    """Image points in the earlier frame of what each pixel of the later one sees, and whether the earlier one sees it too."""
    o, d = rays(now.camera, pixel_grid(now.camera, 1, 0))
    face, _ = now.hit(o, d)
    met = np.flatnonzero(face >= 0)
    x = _moved(now.corners[face[met]], before.corners[face[met]], o[met], d[met])
    camera = before.camera
    local = (x - camera.to_world[:3, 3]) @ camera.to_world[:3, :3]
    depth = np.where(local[:, 2] < 0, -local[:, 2], np.inf)
    half = np.array([camera.width, camera.height]) / 2
    at = half + local[:, :2] * [1, -1] / (depth[:, None] * camera.spread)
    length = np.linalg.norm(local, axis=1)
    eye = np.broadcast_to(camera.to_world[:3, 3], x.shape)
    nearest, distance = before.hit(eye, (x - eye) / length[:, None])
    inside = ((at > 0) & (at < 2 * half)).all(axis=1) & np.isfinite(depth)
    visible = inside & ((nearest == face[met]) | (np.abs(distance - length) < SAME * length))
    points, valid = np.zeros((len(face), 2)), np.zeros(len(face), bool)
    points[met], valid[met] = at, visible
    return points, valid


def flicker(
    earlier: Float[np.ndarray, "H W 3"], later: Float[np.ndarray, "H W 3"], before: FrameView, now: FrameView
) -> float | None:
    """Flicker of two frames, linear Rec. 709 as a screen shows them; None if they share too little."""
    points, valid = reproject(before, now)
    if valid.mean() < MIN_SHARE:
        return None
    valid = valid.reshape(later.shape[:2])
    x, y = (points.T - 0.5).reshape(2, *valid.shape)
    warped = np.stack([map_coordinates(earlier[..., k], [y, x], order=1, mode="nearest") for k in range(3)], axis=-1)
    return float(flip_map(np.where(valid[..., None], warped, later), later)[valid].mean())


def _moved(
    here: Float[np.ndarray, "M 3 3"],
    there: Float[np.ndarray, "M 3 3"],
    o: Float[np.ndarray, "M 3"],
    d: Float[np.ndarray, "M 3"],
) -> Float[np.ndarray, "M 3"]:
    """Where rays meet the planes of triangles, carried along with these to where they were."""
    e1, e2 = here[:, 1] - here[:, 0], here[:, 2] - here[:, 0]
    p, s = np.cross(d, e2), o - here[:, 0]
    determinant = (e1 * p).sum(axis=1)
    safe = np.where(np.abs(determinant) > 1e-300, determinant, 1.0)
    u = (s * p).sum(axis=1) / safe
    v = (d * np.cross(s, e1)).sum(axis=1) / safe
    weights = np.stack([1 - u - v, u, v], axis=1)
    return np.einsum("mk,mkj->mj", weights, there)
