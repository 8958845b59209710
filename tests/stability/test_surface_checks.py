"""`mesoshell stability` of surface materials: checks hold on sound scenes, and each of them is broken by what it looks for."""

from collections.abc import Callable
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
from mesoshell.surface_material.intersector import Hits, SurfaceIntersector
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
    assert not passing(hits._replace(t=hits.t - 0.1, front=np.zeros(count, bool)), front, 1e-3).any()


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("surface", lambda h: h._replace(face=np.full_like(h.face, -1))),
        ("hits", lambda h: h._replace(t=h.t + 0.1)),
        ("places", lambda h: h._replace(bary=h.bary[:, ::-1])),
    ],
)
def test_wrong_hits_are_seen(name: str, wrong: Callable[[Hits], Hits], monkeypatch: pytest.MonkeyPatch) -> None:
    right = SurfaceIntersector.meet
    monkeypatch.setattr(SurfaceIntersector, "meet", lambda self, o, d: wrong(right(self, o, d)))
    assert name in {c.name for c in ms.stability(scene(wearing.bundle()), rays=1000).broken}


def test_an_open_mesh_beside_an_object_and_one_that_is_not_seen() -> None:
    """What an object hides is not seen; a half of a ball shows its back to rays from below."""
    ball = wearing.ball()
    half = ball.vertices[ball.faces][..., 2].min(axis=1) > -1e-3
    bowl = check_mesh(ball.vertices, ball.faces[half], ball.uv[half], "bowl")
    camera = (0.0, -4.0, 0.5, 0.0, 0.0, 0.5, 40.0)
    lid = check_mesh(np.array([[-3, -2, -3], [3, -2, -3], [0, -2, 5.0]]), np.array([[0, 1, 2]]), None, "lid")
    open_ = ms.Scene(bowl, Material("dots", wearing.bundle()), scale=0.5, camera=camera, size=(32, 24))
    alone, hidden = (ms.stability(x, rays=1000) for x in (open_, replace(open_, objects=[lid])))
    away = ms.stability(replace(open_, camera=(0.0, -4.0, 0.5, 0.0, -9.0, 0.5, 40.0)), rays=1000)
    assert alone.broken == hidden.broken == away.broken == ()
    assert (alone.first >= 0).mean() > 0.1 and (hidden.first < 0).all() and (away.first < 0).all()
    assert "the camera does not see the mesh" in str(away)


@pytest.mark.parametrize("away", [3.0, 300.0, 3e4])
def test_a_sound_mesh_from_afar(away: float) -> None:
    """Distances are float32's: what they lose is no other surface."""
    camera = (0.0, -away, 0.3 * away, 0.0, 0.0, 0.0, 60.0 / away)
    far = ms.Scene(wearing.ball(), Material("dots", wearing.bundle()), scale=0.02, camera=camera, size=(32, 24))
    assert [c.name for c in ms.stability(far, rays=1000).broken if c.name in ("hits", "surface")] == []


def test_a_surface_material_beside_a_shell_is_checked(tiny_bundle) -> None:
    arrays = wearing.bundle().arrays
    broken = replace(
        wearing.bundle(),
        arrays=arrays | {"reflectance/last/bias": np.full_like(arrays["reflectance/last/bias"], np.nan)},
    )
    for bundle, faults in ((wearing.bundle(), set()), (broken, {"material", "network"})):
        beside = ms.Grown(wearing.moved(wearing.ball(), 3, 0, 0), Material("dots", bundle), scale=0.5)
        scene_ = ms.Scene(wearing.ball(), Material("tiny", tiny_bundle), scale=0.5, size=(24, 16), also=[beside])
        found = ms.stability(scene_, rays=1000, engine="mitsuba")
        own = [c for c in found.checks if c.said.startswith("dots: ")]
        assert {"hits", "places", "network", "surface"} <= {c.name for c in own}
        assert {c.name for c in found.broken if c in own} >= faults and (bool(faults) or not set(own) & {*found.broken})
