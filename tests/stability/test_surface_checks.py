"""`mesoshell stability` of surface materials: checks hold on sound scenes, and each of them is broken by what it looks for."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.geometry.mesh import check_mesh
from mesoshell.io.surface import SurfaceBundle
from mesoshell.scene.materials import Material
from mesoshell.stability.rays import at_the_front
from mesoshell.stability.surface_material import nearest, passing
from mesoshell.surface_material.intersector import Hits
from tests.helpers import wearing

NAMES = ["mesh", "offset", "surface", "places", "hits", "curvature", "material", "network", "radiance"]


def scene(bundle: SurfaceBundle, by: float = 0.0) -> ms.Scene:
    ball = wearing.moved(wearing.ball(), by, 0.0, 0.0)
    return ms.Scene(ball, Material("dots", bundle), scale=0.5, size=(32, 24))


@pytest.mark.parametrize("engine", ["jax", "mitsuba"])
def test_a_sound_scene(engine: Literal["jax", "mitsuba"]) -> None:
    found = ms.stability(scene(wearing.bundle()), rays=1000, engine=engine)
    assert found.broken == () and [c.name for c in found.checks] == NAMES
    assert found.kept is None and found.map().startswith(b"\x89PNG")
    assert 0.1 < (found.first >= 0).mean() < 1 and found.excess.max() < 1


def test_a_mesh_far_from_the_origin() -> None:
    found = ms.stability(scene(wearing.bundle(), 30000.0), rays=1000)
    assert "offset" in {c.name for c in found.broken}


def test_a_network_that_gives_nonsense() -> None:
    bundle = wearing.bundle()
    arrays = bundle.arrays | {"reflectance/last/bias": np.full_like(bundle.arrays["reflectance/last/bias"], np.nan)}
    found = ms.stability(scene(replace(bundle, arrays=arrays)), rays=1000)
    assert {c.name for c in found.broken} >= {"material", "network"}
    assert not {c.name for c in found.broken} & {"surface", "places", "hits"}


def test_float64_meets_the_nearest_triangle() -> None:
    """Planes one behind the other, seen from both sides; beside them nothing."""
    square = wearing.square()
    corners = np.concatenate([square.vertices[square.faces] + np.array([0, 0, z]) for z in (0.0, -1.0)])
    middle = square.vertices.mean(axis=0).astype(np.float64)
    o = middle + np.array([[0.1, 0.05, 2.0], [0.1, 0.05, -4.0], [50.0, 0.0, 2.0]])
    d = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    np.testing.assert_allclose(nearest(corners.astype(np.float64), o, d), [2.0, 3.0, np.inf], rtol=1e-12)
    assert nearest(np.zeros((0, 3, 3)), o, d).tolist() == [np.inf] * 3


def test_rays_that_go_through_are_seen() -> None:
    ball = check_mesh(wearing.ball().vertices, wearing.ball().faces, wearing.ball().uv, "ball")
    front = at_the_front(ball, 100, np.random.default_rng(0))
    count = len(front.d)
    hits = Hits(front.surface.copy(), np.zeros(count, np.int64), np.ones(count, bool), np.ones((count, 3)) / 3)
    assert count > 50 and not passing(hits, front, 1e-3).any()
    assert passing(hits._replace(t=hits.t + 0.1), front, 1e-3).all()
    assert passing(hits._replace(face=np.full(count, -1)), front, 1e-3).all()
    assert passing(hits._replace(front=np.zeros(count, bool)), front, 1e-3).all()
