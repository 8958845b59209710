"""Rays that are hard to march through a scene's shell.

Notation
o, d        origins and unit directions, float64                                          (R, 3), world
reach       distance from the origin of a point that is known to lie in the shell, NaN for none
surface     distance of a point of the surface underneath that the ray meets from the front, NaN for none
prism       that a ray is aimed at, −1 for none
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from mesoshell.geometry.mesh import Mesh
from mesoshell.geometry.normals import face_normals
from mesoshell.geometry.topology import pair_edges
from mesoshell.render.camera import Camera, rays
from mesoshell.shell.geometry.extrude import Shell

#: Origins of rays that are aimed, in sizes of the shell: near, and far.
NEAR, FAR = 3.0, 1000.0
#: Least cosine between a ray and all faces around the point of the surface that it is said to meet from the front.
FRONT = 0.05
#: Most directions toward a vertex.
ROUNDS = 64
#: Heights of the points that are known to lie in the shell.
INSIDE = (0.02, 0.98)


class Rays(NamedTuple):
    """Rays, and what is known of them."""

    o: Float[np.ndarray, "R 3"]
    d: Float[np.ndarray, "R 3"]
    reach: Float[np.ndarray, "R"]
    surface: Float[np.ndarray, "R"]
    prism: Int[np.ndarray, "R"]


def of_camera(camera: Camera, pixels: Int[np.ndarray, "R"], rng: np.random.Generator) -> Rays:
    """Rays through random points of these pixels, numbered row by row."""
    y, x = np.divmod(pixels, camera.width)
    o, d = rays(camera, np.stack([x, y], axis=1) + rng.uniform(size=(len(pixels), 2)))
    unknown = np.full(len(d), np.nan)
    return Rays(np.array(o), d, unknown, unknown, np.full(len(d), -1))


def aim_rays(shell: Shell, count: int, distance: float, rng: np.random.Generator) -> Rays:
    """Rays from all around through points that prisms share, in equal parts on vertices, posts, edges of the base and of the
    top, and sides. distance: of their origins, in sizes of the shell. Known to lie in the shell are points of posts and sides
    that have prisms all around."""
    kind = np.arange(count) % 5
    prism, k = rng.integers(0, len(shell.faces), count), rng.integers(0, 3, count)
    i, j = shell.faces[prism, k], shell.faces[prism, (k + 1) % 3]
    u = np.where(kind < 2, 0, rng.uniform(size=count))[:, None]
    ends = np.arange(count) // 5 % 2
    h = np.select([kind == 0, kind == 2, kind == 3], [ends, 0, 1], rng.uniform(*INSIDE, count))[:, None]
    base, post = shell.base.astype(np.float64), shell.offset.astype(np.float64)
    point = (1 - u) * (base[i] + h * post[i]) + u * (base[j] + h * post[j])
    known = ((kind == 1) & _surrounded(shell.faces, shell.neighbour >= 0, len(base))[i]) | (
        (kind == 4) & (shell.neighbour[prism, k] >= 0)
    )
    made = _through(shell, prism, point, _unit(rng.normal(size=(count, 3))), distance)
    return made._replace(reach=np.where(known, made.reach, np.nan))


def grazing(shell: Shell, count: int, angle: float, rng: np.random.Generator) -> Rays:
    """Rays through random points of the top, at an angle (radians) to it, into the shell."""
    prism, share = rng.integers(0, len(shell.faces), count), rng.dirichlet((1, 1, 1), count)
    top = (shell.base.astype(np.float64) + shell.offset)[shell.faces[prism]]
    inward = -_unit(np.cross(top[:, 1] - top[:, 0], top[:, 2] - top[:, 0]))
    along = _unit(np.cross(inward, rng.normal(size=(count, 3))))
    made = _through(shell, prism, np.einsum("rk,rki->ri", share, top), _unit(along + angle * inward), NEAR)
    return made._replace(reach=np.full(count, np.nan))


def at_the_front(mesh: Mesh, count: int, rng: np.random.Generator) -> Rays:
    """Rays through vertices and edges of the surface from in front of all faces there, so that none may pass: at most `count`,
    half of them each. Borders are left out, and places whose faces have no common front."""
    parts = [_at_vertices(mesh, count // 2, rng), _at_edges(mesh, count - count // 2, rng)]
    point, d = (np.concatenate(x) for x in zip(*parts, strict=True))
    distance = NEAR * float(np.ptp(mesh.vertices, axis=0).max())
    unknown, surface = np.full(len(d), np.nan), np.full(len(d), distance)
    return Rays(point - distance * d, d, unknown, surface, np.full(len(d), -1))


def _at_vertices(mesh: Mesh, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, and directions toward them from in front of all faces there."""
    v, faces = mesh.vertices.astype(np.float64), mesh.faces
    normal, closed = face_normals(v, faces), _surrounded(faces, pair_edges(faces).opposed, len(v))
    points, ways = [v[:0]], [v[:0]]
    for _ in range(min(-(-count // closed.sum()), ROUNDS) if closed.any() else 0):
        d = -_unit(mesh.normals + rng.normal(size=v.shape))
        lean = np.full(len(v), -1.0)
        np.maximum.at(lean, faces, np.einsum("fi,fki->fk", normal, d[faces]))
        met = rng.permutation(np.flatnonzero(closed & (lean < -FRONT)))
        points.append(v[met])
        ways.append(d[met])
    return np.concatenate(points)[:count], np.concatenate(ways)[:count]


def _at_edges(mesh: Mesh, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Points of edges, and directions toward them from in front of both faces there."""
    v, faces = mesh.vertices.astype(np.float64), mesh.faces
    normal, edges = face_normals(v, faces), pair_edges(faces)
    face, k = np.nonzero(edges.opposed)
    chosen = rng.integers(0, len(face), count) if len(face) else np.zeros(0, np.int64)
    face, k = face[chosen], k[chosen]
    u = rng.uniform(size=(len(face), 1))
    point = (1 - u) * v[faces[face, k]] + u * v[faces[face, (k + 1) % 3]]
    here, there = normal[face], normal[edges.partner[face, k] // 3]
    d = -_unit(here + there + rng.normal(size=here.shape))
    met = np.maximum(np.sum(here * d, axis=1), np.sum(there * d, axis=1)) < -FRONT
    return point[met], d[met]


def _surrounded(faces: Int[np.ndarray, "F 3"], shared: Bool[np.ndarray, "F 3"], count: int) -> Bool[np.ndarray, "V"]:
    """Vertices at which no edge is a border. shared: whether edge k of a face, from its vertex k on, has another face."""
    closed = np.ones(count, bool)
    for ends in (faces, np.roll(faces, -1, axis=1)):
        closed[ends[~shared]] = False
    return closed


def _through(shell: Shell, prism: np.ndarray, point: np.ndarray, d: np.ndarray, distance: float) -> Rays:
    """Rays through points of the shell, from `distance` sizes of it away."""
    ends = np.concatenate([shell.base, shell.base + shell.offset])
    away = distance * float(np.ptp(ends, axis=0).max())
    return Rays(point - away * d, d, np.full(len(d), away), np.full(len(d), np.nan), prism)


def _unit(x: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    return x / np.linalg.norm(x, axis=-1, keepdims=True)
