"""The march through shells agrees with the JAX engine's, which is tested against references of its own."""

from dataclasses import replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mesoshell.geometry.mesh import Mesh, load_mesh
from mesoshell.pathtracer import traversal
from mesoshell.pathtracer.shells import Shells
from mesoshell.shell.geometry.extrude import Shell, extrude
from mesoshell.shell.geometry.tracer import Boundary
from tests.helpers.path_traced import surface

DATA = Path(__file__).parents[1] / "data"


@dr.syntax
def marched(shells, scene, o, d, outside):
    """Length inside the shells, where the first piece begins, and how many pieces there are."""
    met = scene.ray_intersect_preliminary(mi.Ray3f(mi.Point3f(o), mi.Vector3f(d)))
    tmax = dr.select(met.is_valid(), mi.Float64(met.t), dr.inf)
    w = traversal.at_start(dr.zeros(mi.Float64, dr.width(o)), outside)
    length, first = dr.zeros(mi.Float64, dr.width(o)), dr.full(mi.Float64, dr.inf, dr.width(o))
    count, moves = dr.zeros(mi.UInt32, dr.width(o)), dr.zeros(mi.UInt32, dr.width(o))
    while (w.mode != traversal.OVER) & (moves < 4000):
        w, piece, found = traversal.advance(shells, o, d, tmax, w)
        length += dr.select(found, piece.t1 - piece.t0, 0)
        first = dr.select(found & (first == dr.inf), piece.t0, first)
        count += dr.select(found, mi.UInt32(1), mi.UInt32(0))
        moves += 1
    return length, first, count, moves


def compared(mesh: Mesh, shell: Shell, o: np.ndarray, d: np.ndarray, outside: bool) -> tuple[np.ndarray, ...]:
    """(length, first) of both engines, rays in float32; and how many moves were made."""
    o, d = (x.astype(np.float32).astype(np.float64) for x in (o, d))
    vectors = mi.Vector3d(o.T.copy()), mi.Vector3d(d.T.copy())
    ours = marched(Shells([shell]), surface(mesh), *vectors, dr.full(mi.Bool, outside, len(o)))
    found = Boundary(shell, mesh.faces).trace(o, d, exact=True).intervals
    length = np.bincount(found.ray, found.t1 - found.t0, len(o))
    first = np.full(len(o), np.inf)
    np.minimum.at(first, found.ray, found.t0)
    return length, first, np.array(ours[0]), np.array(ours[1]), np.array(ours[3])


def rays(rng: np.random.Generator, count: int, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """From a sphere toward its inside."""
    o = rng.normal(size=(count, 3))
    o *= distance / np.linalg.norm(o, axis=1, keepdims=True)
    d = rng.uniform(-0.6, 0.6, size=(count, 3)) - o
    return o, d / np.linalg.norm(d, axis=1, keepdims=True)


@pytest.mark.parametrize("name", [pytest.param("spot.obj", marks=pytest.mark.slow), "cross.obj"])
def test_rays_from_outside_meet_the_same_shell(name) -> None:
    """A closed mesh whose shell overlaps itself in its creases, and an open one that is not a manifold."""
    mesh = load_mesh(DATA / name)
    size = float(np.ptp(mesh.vertices, axis=0).max())
    mesh = replace(mesh, vertices=((mesh.vertices - mesh.vertices.mean(axis=0)) / size).astype(np.float32))
    o, d = rays(np.random.default_rng(0), 4000, 2.5)
    length, first, ours, our_first, moves = compared(mesh, extrude(mesh, 0.05, 0.1), o, d, outside=True)
    assert (length > 0).sum() > 400 and moves.max() < 4000
    np.testing.assert_allclose(ours, length, rtol=0, atol=1e-5)
    some = length > 1e-5
    np.testing.assert_allclose(our_first[some], first[some], rtol=0, atol=1e-5)


def test_rays_that_begin_inside_are_found_there() -> None:
    mesh = load_mesh(DATA / "spot.obj")
    rng = np.random.default_rng(1)
    _, d = rays(rng, 3000, 2.5)
    vertex = rng.integers(len(mesh.vertices), size=3000)
    o = mesh.vertices[vertex] + 0.02 * mesh.normals[vertex]
    length, first, ours, our_first, moves = compared(mesh, extrude(mesh, 0.05, 0.1), o, d, outside=False)
    assert (first < 1e-5).sum() > 2000 and moves.max() < 4000
    wrong = np.abs(ours - length) > 1e-5
    assert wrong.mean() < 2e-3, "three shells may overlap where a ray begins"
    np.testing.assert_allclose(our_first[~wrong], first[~wrong], rtol=0, atol=1e-5)


@pytest.mark.parametrize("d", [(0.0, 0.0, 0.0), (np.nan, 0.0, 1.0), (np.inf, 0.0, 0.0), (0.0, 0.0, 1.0)])
def test_degenerate_rays_end(d) -> None:
    mesh = load_mesh(DATA / "spot.obj")
    shells, scene = Shells([extrude(mesh, 0.05, 0.1)]), surface(mesh)
    o = mi.Vector3d(0.0, 3.0, 0.0)
    length, _, _, moves = marched(shells, scene, o, mi.Vector3d(*d), dr.full(mi.Bool, False, 1))
    assert np.array(length)[0] == 0 and np.array(moves)[0] < 100


def test_two_shells_are_one_march() -> None:
    """A second shell elsewhere adds its own length and changes nothing of the first's."""
    mesh = load_mesh(DATA / "spot.obj")
    other = replace(mesh, vertices=(mesh.vertices + np.array([0, 0, 3], np.float32)).astype(np.float32))
    o, d = np.tile([[0.05, 0.4, -4.0]], (50, 1)), np.tile([[0.0, 0.0, 1.0]], (50, 1))
    o[:, 0] += np.linspace(-0.3, 0.3, 50)
    vectors = mi.Vector3d(o.T.copy()), mi.Vector3d(d.T.copy())
    nothing = mi.load_dict({"type": "scene"})
    both = [extrude(m, 0.05, 0.1) for m in (mesh, other)]
    alone, together = (
        np.array(marched(Shells(s), nothing, *vectors, dr.full(mi.Bool, True, 50))[0]) for s in (both[:1], both)
    )
    assert (alone > 0).any()
    np.testing.assert_allclose(together, 2 * alone, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", ["spot.obj", "cross.obj"])
def test_a_march_from_the_boundary_itself_comes_to_an_end(name) -> None:
    """From base points, tops and middles of posts, along edges, posts and at random: where a ray can meet what it stands on
    again and again without getting on. As paths do, known to be outside or not."""
    mesh = load_mesh(DATA / name)
    shell, rng = extrude(mesh, 0.05, 0.1), np.random.default_rng(2)
    corner = shell.faces[rng.integers(len(shell.faces), size=6000)]
    base, offset = shell.base[corner].astype(np.float64), shell.offset[corner].astype(np.float64)
    o = base[:, 0] + rng.choice([0.0, 0.5, 1.0], size=(6000, 1)) * offset[:, 0]
    ways = np.stack(
        [base[:, 1] - base[:, 0], offset[:, 0], -offset[:, 0], base[:, 2] + offset[:, 2] - o, rng.normal(size=o.shape)]
    )
    d = ways[rng.integers(len(ways), size=6000), np.arange(6000)]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o, d = (mi.Vector3d(x.astype(np.float32).astype(np.float64).T.copy()) for x in (o, d))
    for outside in (True, False):
        length, _, _, moves = marched(Shells([shell]), surface(mesh), o, d, dr.full(mi.Bool, outside, 6000))
        assert np.array(moves).max() < 1000 and np.isfinite(np.array(length)).all()
