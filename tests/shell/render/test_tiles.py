"""Tiles of rays: as many as memory holds, and the picture does not depend on them."""

import numpy as np
import pytest

from mesoshell.io.bundle import Bundle
from mesoshell.shell.render import renderer
from mesoshell.shell.render.renderer import RAYS, rays_a_tile, render
from tests.helpers import scenes


def test_a_tile_has_fewer_rays_where_each_has_much_to_reflect():
    assert rays_a_tile(28, 3) == RAYS and rays_a_tile(256, 16) < RAYS / 2
    assert all(12 * n * k * rays_a_tile(n, k) <= renderer.BYTES for n in (1, 28, 256) for k in (1, 3, 17))
    assert rays_a_tile(4096, 4096) >= 1 and rays_a_tile(256, 0) == RAYS


def test_a_picture_is_the_same_in_small_tiles(tiny_bundle: Bundle, monkeypatch: pytest.MonkeyPatch):
    scene = scenes.slab(tiny_bundle)
    effects = scenes.effects(scene, scenes.FULL)
    whole, _ = render(scene, scenes.FULL, effects)
    monkeypatch.setattr(renderer, "BYTES", 12 * 32 * 40)
    np.testing.assert_array_equal(render(scene, scenes.FULL, effects)[0], whole)
