"""The path tracer's walk on many rays or sides at once, from NumPy and back."""

import mesoshell.pathtracer  # noqa: F401  isort: skip  (it makes Mitsuba ready)

from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from mesoshell.geometry.mesh import Mesh
from mesoshell.pathtracer import prism, traversal
from mesoshell.pathtracer.shells import Shells
from mesoshell.shell.geometry.batched_walk import Intervals
from mesoshell.shell.geometry.tracer import Trace
from tests.helpers.stability.oracles import assert_sorted_apart

#: Pieces of one ray that are kept, and moves after which a ray is given up.
MAX_PIECES, MAX_MOVES = 128, 4000


def leave_sides(d: np.ndarray, p: np.ndarray, n: np.ndarray) -> SimpleNamespace:
    """`walk.leave_side` on rows of rays from 0 and sides: t, u, h, inside and margin."""
    way, feet, posts = _vector(d), [_vector(p[:, k]) for k in (0, 1)], [_vector(n[:, k]) for k in (0, 1)]
    f = [dr.dot(way, dr.cross(a, b)) for a, b in zip(feet, posts, strict=True)]
    found = prism.leave_side(way, feet, posts, f)
    return SimpleNamespace(**{k: np.array(getattr(found, k)) for k in ("t", "u", "h", "inside", "margin")})


def leave_caps(d: np.ndarray, corners: np.ndarray) -> SimpleNamespace:
    """`walk.leave_cap`, upward: inside, margin and the barycentric coordinates (λ₀, λ₁)."""
    found: Any = prism.leave_cap(_vector(d), [_vector(corners[:, k]) for k in range(3)], 1)
    return SimpleNamespace(inside=np.array(found.inside), margin=np.array(found.margin), bary=np.array(found.bary).T)


def hits(mesh: Mesh, o: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Where rays meet the mesh as a scene of Mitsuba's: in world space, float32; infinite for none."""
    made = mi.Mesh("surface", len(mesh.vertices), len(mesh.faces))
    parameters = mi.traverse(made)
    parameters["vertex_positions"] = mi.Float(mesh.vertices.ravel())
    parameters["faces"] = mi.UInt32(mesh.faces.ravel().astype(np.uint32))
    parameters.update()
    scene = mi.load_dict({"type": "scene", "surface": made})
    found = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(_vector(o)), mi.Vector3f(_vector(d))))
    return np.where(np.array(found.is_valid()), np.array(found.t, np.float64), np.inf)


def trace(
    shells: Shells, o: np.ndarray, d: np.ndarray, end: np.ndarray | float = np.inf, outside: bool = False
) -> Trace:
    """All intervals of rays, each up to its end, in order and apart; outside: they are known to begin outside of the shell."""
    count = len(o)
    end = np.broadcast_to(np.asarray(end, np.float64), count)
    table = [dr.zeros(mi.Float64, count * MAX_PIECES) for _ in range(8)] + [dr.zeros(mi.UInt32, count * MAX_PIECES)]
    known = dr.full(mi.Bool, outside, count)
    pieces, moves = _collect(shells, _vector(o), _vector(d), mi.Float64(end), known, table)
    pieces = np.array(pieces)
    assert np.array(moves).max(initial=0) < MAX_MOVES and pieces.max(initial=0) < MAX_PIECES
    kept = np.arange(MAX_PIECES) < pieces[:, None]
    t0, t1, a0, b0, a1, b1, h0, h1, prism = (np.array(x).reshape(count, MAX_PIECES)[kept] for x in table)
    bary0, bary1 = np.stack([a0, b0], axis=1), np.stack([a1, b1], axis=1)
    found = Intervals(np.nonzero(kept)[0], prism.astype(np.int32), t0, t1, bary0, bary1, h0, h1)
    nowhere = np.full(count, -1, np.int32)
    traced = Trace(found, np.array(end), nowhere, np.zeros((count, 2), np.float32), len(found.ray), 0)
    assert_sorted_apart(traced)
    return traced


@dr.syntax
def _collect(shells, o, d, tmax, outside, table):
    """Fill the table with every ray's pieces; how many there are, and how many moves were made."""
    w = traversal.at_start(dr.zeros(mi.Float64, dr.width(o)), outside)
    index = dr.arange(mi.UInt32, dr.width(o)) * MAX_PIECES
    count, moves = dr.zeros(mi.UInt32, dr.width(o)), dr.zeros(mi.UInt32, dr.width(o))
    while (w.mode != traversal.OVER) & (moves < MAX_MOVES):
        w, piece, found = traversal.advance(shells, o, d, tmax, w)
        _keep(table, piece, index + dr.minimum(count, MAX_PIECES - 1), found)
        count += dr.select(found, mi.UInt32(1), mi.UInt32(0))
        moves += 1
    return count, moves


def _keep(table, piece, at, found):
    rows = [
        piece.t0,
        piece.t1,
        piece.bary0.x,
        piece.bary0.y,
        piece.bary1.x,
        piece.bary1.y,
        piece.h0,
        piece.h1,
        piece.prism,
    ]
    for buffer, value in zip(table, rows, strict=True):
        dr.scatter(buffer, value, at, found)


def _vector(x: np.ndarray) -> mi.Vector3d:
    return mi.Vector3d(np.ascontiguousarray(np.asarray(x, np.float64).T))
