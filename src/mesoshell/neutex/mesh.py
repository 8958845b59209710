"""The surface that the texture is wrapped on, as triangles.

Notation
cube        six squares of n × n quads, as in the cubemap: no triangle crosses a side of the texture's image
lattice     corners of the cube's quads in whole numbers, 0 to n on each axis; squares share those on an edge
wrap        F_uv⁻¹ of the lattice's directions u, with normals n: closed, as F_uv⁻¹ is continuous on the sphere, and smooth
T           transmittance along y + (REACH − s) n, from outside inward
vertices    the wrap's, moved along n to where T is a half; squares have their own copies, equal at a lattice point. A vertex
            moves with its neighbours, by Laplace's equation on the lattice's edges, if its path begins inside (σ there is at
            least half of σ where T is a half), or if T stays above a half. All move less where a triangle would fold

Texture coordinates stay half a pixel inside their square, so that no other square is mixed in.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import spsolve

from mesoshell.nets.batches import run
from mesoshell.nets.mlp import in_tiles
from mesoshell.neutex.field import Field, FieldConfig, density, to_surface
from mesoshell.neutex.layout import on_faces
from mesoshell.typing import Array

#: Farthest that a vertex moves, in the box's units, and samples of σ from there to as far inside.
REACH, SAMPLES = 0.1, 48
#: Least cosine by which a triangle may turn; rounds in which the corners of others move by 0.7 of what they did.
LEVEL, ROUNDS = 0.5, 24


class TexturedMesh(NamedTuple):
    """uv: of the cubemap's image, v upward; u: directions of the vertices; normals: unit, outward."""

    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "T 3"]
    uv: Float[np.ndarray, "V 2"]
    u: Float[np.ndarray, "V 3"]
    normals: Float[np.ndarray, "V 3"]


def extract_mesh(config: FieldConfig, field: Field, n: int, side: int) -> TexturedMesh:
    """In the box's units; n: quads a side of the cube; side: pixels a side of the cubemap's squares."""
    grid = np.linspace(0, 1, n + 1)
    y, x = np.meshgrid(grid, grid, indexing="ij")
    square = np.tile(np.stack([x, y], axis=-1).reshape(-1, 2), (6, 1))
    face = np.repeat(np.arange(6), (n + 1) ** 2)
    lattice = np.round((on_faces(square, face) + 1) / 2 * n).astype(int)
    one, of = np.unique(lattice, axis=0, return_inverse=True)
    # equal angles, not equal lengths: triangles of one size on the sphere
    u = np.tan((2 * one / n - 1) * np.pi / 4)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    of, faces = of.ravel(), _triangles(n)
    points = np.asarray(_surface(field, u.astype(np.float32)), np.float64)
    normals = _normals(points, of[faces], u)
    points = points + _moves(config, field, points, normals, of[faces])[:, None] * normals
    normals = _normals(points, of[faces], u)
    inset = np.clip(0.5 + np.tan((square - 0.5) * np.pi / 2) / 2, 0.5 / side, 1 - 0.5 / side)
    at = (inset + np.stack([face % 3, face // 3], axis=1)) / np.array([3, 2])
    return TexturedMesh(points[of], faces, np.stack([at[:, 0], 1 - at[:, 1]], axis=1), u[of], normals[of])


def _normals(points: np.ndarray, faces: np.ndarray, otherwise: np.ndarray) -> Float[np.ndarray, "V 3"]:
    """Vertex normals from the faces around, by area; otherwise: normals of vertices whose faces have no area."""
    across = np.repeat(_across(points, faces), 3, axis=0)
    total = np.stack([np.bincount(faces.ravel(), across[:, k], len(points)) for k in range(3)], axis=1)
    return np.where(total.any(axis=1, keepdims=True), _unit(total), otherwise)


def _moves(
    config: FieldConfig, field: Field, points: np.ndarray, normals: np.ndarray, faces: np.ndarray
) -> Float[np.ndarray, "V"]:
    """How far each vertex moves outward."""
    move, reached = run(lambda *x: _surface_near(config, field, *x), np.float32(points), np.float32(normals))
    reached = reached > 0
    move = np.where(reached, move.astype(np.float64), 0)
    if reached.any() and not reached.all():
        a, b = faces.ravel(), np.roll(faces, 1, axis=1).ravel()  # each edge occurs once from each of its sides
        edges = csr_array((np.ones(len(a)), (a, b)), (len(points), len(points)))
        laplace = (diags_array(edges.sum(axis=1)) - edges).tocsr()
        move[~reached] = spsolve(laplace[~reached][:, ~reached].tocsc(), -laplace[~reached][:, reached] @ move[reached])
    before = _facing(points, faces)
    for _ in range(ROUNDS):
        turn = np.einsum("ti,ti->t", before, _facing(points + move[:, None] * normals, faces))
        move[faces[turn < LEVEL]] *= 0.7  # once each, however many faces
    return move


def _facing(points: np.ndarray, faces: np.ndarray) -> Float[np.ndarray, "T 3"]:
    """Unit normals of triangles, 0 of those without area."""
    return _unit(_across(points, faces))


def _across(points: np.ndarray, faces: np.ndarray) -> Float[np.ndarray, "T 3"]:
    """Normals of triangles, of length twice their area."""
    a, b, c = np.moveaxis(points[faces], 1, 0)
    return np.cross(b - a, c - a)


def _unit(x: np.ndarray) -> np.ndarray:
    return x / np.maximum(np.linalg.norm(x, axis=1, keepdims=True), 1e-300)


@partial(jax.jit, static_argnums=0)
def _surface_near(config: FieldConfig, field: Field, y: Array, n: Array, count: Array) -> tuple[Array, Array]:
    """Where T is a half, and whether it reaches a half from outside."""
    step = 2 * REACH / SAMPLES
    outward = REACH - step * (jnp.arange(SAMPLES, dtype=jnp.float32) + 0.5)

    def one(y: Array, n: Array) -> tuple[Array, Array]:
        sigma = jax.lax.map(lambda t: density(config, field, y + t * n)[0], outward)
        deep = jnp.cumsum(sigma) * step  # −ln T at the end of each sample
        i = jnp.argmax(deep >= jnp.log(2.0))
        share = 1 - (deep[i] - jnp.log(2.0)) / jnp.maximum(sigma[i] * step, 1e-12)
        reached = (deep[-1] >= jnp.log(2.0)) & (sigma[0] < 0.5 * sigma[i])
        return REACH - step * (i.astype(jnp.float32) + share), reached.astype(jnp.float32)

    return in_tiles(jax.vmap(one), count, (y, n), ((0, jnp.float32), (0, jnp.float32)))


def _triangles(n: int) -> Int[np.ndarray, "T 3"]:
    """Counter-clockwise seen from outside."""
    number = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    quads = np.stack([np.stack([a, d, c], -1), np.stack([a, c, b], -1)], axis=2).reshape(-1, 3)
    return np.concatenate([quads + face * (n + 1) ** 2 for face in range(6)])


@jax.jit
def _surface(field: Field, u):
    return jax.vmap(lambda u: to_surface(field, u))(u)
