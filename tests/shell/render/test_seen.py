"""A picture is the same whether all of its texture is grown, or what its camera sees; and that is all that its rays meet."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.geometry.mesh import load_mesh
from mesoshell.io import kept_textures
from mesoshell.render.camera import Camera, look_at, rays
from mesoshell.render.quality import PRESETS
from mesoshell.scene import render_shell
from mesoshell.scene.materials import Material
from mesoshell.scene.setup import describe_shell
from mesoshell.shell.geometry.chart import patches_of
from mesoshell.shell.geometry.extrude import extrude
from mesoshell.shell.geometry.tracer import Boundary
from mesoshell.shell.render import seen
from tests.helpers import growing, wearing

SUZANNE = Path(__file__).parents[2] / "data" / "suzanne.obj"
QUALITY = PRESETS["draft"].with_changes(spp=1, density="network")


@pytest.mark.parametrize(
    ("thickness", "scale", "size", "most", "eye"),
    [
        (0.05, 0.1, (96, 64), 1 << 16, (-1.2, 2.4, 7.3)),
        (0.002, 0.1, (96, 64), 1 << 16, (-2.5, 1.4, 9.0)),  # lower than a pixel: gaps between rays
        (0.1, 0.2, (64, 64), 256, (-2.0, 1.5, 5.0)),  # fewer rays than pixels
        (0.2, 0.05, (96, 64), 1 << 16, (-2.5, 1.3, 5.2)),  # from within
    ],
)
def test_all_that_rays_meet_is_seen(
    thickness: float, scale: float, size: tuple[int, int], most: int, eye: Any, monkeypatch: pytest.MonkeyPatch
):
    """Rays through any place of the picture."""
    monkeypatch.setattr(seen, "RAYS", most)
    mesh = load_mesh(SUZANNE)
    shell = extrude(mesh, thickness, scale)
    boundary = Boundary(shell, mesh.faces)
    camera = Camera(look_at(eye, (-2.5, 1.25, 4.1)), 0.5, *size)
    origin, needed = patches_of(shell.uv)
    (among,) = seen.patches_seen(camera, ((mesh, shell),), ())
    patches = among(origin, needed.shape)
    rng = np.random.default_rng(0)
    o, d = rays(camera, rng.uniform(size=(20_000, 2)) * size)
    i = boundary.trace(o, d).intervals
    assert len(i.ray) > 1000
    bary = i.bary0 + rng.uniform(size=(len(i.ray), 1)) * (i.bary1 - i.bary0)
    weights = np.concatenate([bary, 1 - bary.sum(axis=1, keepdims=True)], axis=1)
    u, v = (np.floor(np.einsum("nk,nki->ni", weights, shell.uv[i.prism])).astype(int) - origin).T
    missed = (i.t1 - i.t0)[~patches[v, u]].sum() / (i.t1 - i.t0).sum()
    assert missed < 1e-4  # through gaps that are narrower than rays are apart: 2e-5 was seen
    assert (patches & needed).sum() < needed.sum() or thickness < 0.01


def test_each_mesh_has_what_is_seen_of_it():
    """Of two plates beside each other, one of them behind a wall."""
    near, far = wearing.square(), wearing.moved(wearing.square(), 2.0, 0.0, 0.0)
    grown = tuple((mesh, extrude(mesh, 0.05, 0.1)) for mesh in (near, far))
    wall = wearing.moved(wearing.square(), 2.0, 0.0, 1.0)
    camera = Camera(look_at((1.5, 0.5, 4.0), (1.5, 0.5, 0.0)), 1.0, 256, 256)
    counts = [
        [part((0, 0), (10, 10)).sum() for part in seen.patches_seen(camera, grown, some)] for some in ((), (wall,))
    ]
    assert counts[0] == [100, 100] and counts[1][0] == 100 and counts[1][1] < 50


def test_a_picture_is_the_same_with_what_it_sees_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A corner of a lawn; then the opposite one, whose tiles are added; then all of it, from the cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(kept_textures, "MIN_BYTES", 0)
    camera = Camera(look_at((0.1, 0.05, 0.6), (0.1, 0.1, 0.0), up=(0.0, 1.0, 0.0)), 0.5, 24, 24)
    plane = wearing.square()
    scene = ms.Scene(plane, Material("grown", growing.bundle()), scale=0.05, thickness=0.04, camera=camera, seed=3)
    opposite = replace(scene, camera=Camera(look_at((0.9, 0.8, 0.7), (0.9, 0.9, 0.0)), 0.5, 24, 24))

    def made() -> int:
        (tiles,) = tmp_path.glob("mesoshell/grown/*/tiles")
        return sum(tiles.read_bytes())

    one = ms.render(scene, QUALITY).rgba
    few = made()
    other = ms.render(opposite, QUALITY).rgba
    assert 0 < few < made() < 36 and one[..., 3].max() > 0 < other[..., 3].max()
    whole = describe_shell(scene).material  # as engine mitsuba and films have it
    assert made() == 36 and whole.arrays["features/0"][-20:, -20:].any()
    monkeypatch.setattr(kept_textures, "MIN_BYTES", 1 << 40)
    np.testing.assert_array_equal(ms.render(scene, QUALITY).rgba, one)
    monkeypatch.setattr(render_shell, "patches_seen", None)
    np.testing.assert_allclose(ms.render(scene, QUALITY).rgba, one, atol=1e-6)
    np.testing.assert_allclose(ms.render(opposite, QUALITY).rgba, other, atol=1e-6)
