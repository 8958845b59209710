"""A march whose density is baked: the network's picture, for a few of its evaluations.

Oracle: the same rays and samples with the network, unfiltered.
"""

from dataclasses import replace

import numpy as np
import pytest

from mesoshell.io.bundle import Bundle
from mesoshell.io.density_grid import K
from mesoshell.render.effects import plan_effects
from mesoshell.render.quality import Quality
from mesoshell.render.tiles import RenderReport
from mesoshell.scene.render_shell import facts
from mesoshell.shell.material.loader import load_device_material
from mesoshell.shell.render import media, renderer
from mesoshell.shell.render.renderer import render
from mesoshell.shell.render.scene import Medium, Scene
from tests.helpers import scenes

QUALITY = Quality(pixel_samples=4, samples=32, filtering=False, early_stop=0.05)
RAMP = np.broadcast_to(np.linspace(0, 1, 32, dtype=np.float32), (4, 32))


def shown(scene: Scene, **changes: object) -> tuple[np.ndarray, RenderReport]:
    quality = QUALITY.with_changes(**changes)
    plan = plan_effects(facts(scene), quality)
    assert plan.baked_density.on == (quality.density == "baked")
    return render(scene, quality, plan)


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """Mean difference of pixels, over their mean."""
    return float(np.abs(a - b).mean() / b.mean())


@pytest.fixture(autouse=True)
def fine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight columns a texel, between which the network is about linear."""
    monkeypatch.setattr("mesoshell.render.effects.MAX_NUMBERS", 1e9)
    monkeypatch.setattr(
        media, "grid_shape", lambda texture, varying, most: (*[2] * varying, *(8 * n for n in texture), K)
    )


#: Of tiles of 4 texels, a quarter lies so near a border that the grid reads the torus's neighbour.
CLOSE = {"one": 0.02, "varying": 0.02, "tiled": 0.05, "several": 0.04}


@pytest.mark.parametrize(
    ("kind", "lit"),
    [
        pytest.param("one", 8, marks=pytest.mark.slow),
        ("one", 1),
        pytest.param("varying", 8, marks=pytest.mark.slow),
        pytest.param("tiled", 1, marks=pytest.mark.slow),
        ("several", 8),
    ],
)
def test_it_is_the_networks_picture(kind: str, lit: int, tiny_bundle: Bundle, tiled_bundle: Bundle, monkeypatch):
    """Of lit samples the drawn ones alone ask the network."""
    scene = scenes.slab(tiled_bundle if kind == "tiled" else tiny_bundle)
    if kind == "varying":
        scene = replace(scene, maps={"dryness": RAMP})
    if kind == "several":
        other = Medium(load_device_material(tiled_bundle), scene.alpha, {"dryness": RAMP}, 1.0, prism=1, face=1)
        scene = replace(scene, others=(other,))
    monkeypatch.setattr(renderer, "RAYS", 100)  # tiles of which one has a part
    (baked, few), (network, many) = (shown(scene, density=how, light_samples=lit) for how in ("baked", "network"))
    assert network[..., :3].std() > 0.05 * network[..., :3].mean()
    assert apart(baked, network) < CLOSE[kind]
    np.testing.assert_allclose(baked.mean(axis=(0, 1)), network.mean(axis=(0, 1)), rtol=CLOSE[kind])
    assert few.counts["grid_reads"] >= many.counts["density_queries"] > few.counts["density_queries"] > 0
    assert many.counts["grid_reads"] == 0


def test_a_ray_stops_where_little_light_is_left(tiny_bundle: Bundle):
    """What lies behind is not lit, and loses at most the share of the light that is left there."""
    scene = scenes.slab(tiny_bundle)
    (whole, all_), (stopped, fewer) = (shown(scene, early_stop=share) for share in (0.0, 0.3))
    assert fewer.counts["density_queries"] < 0.9 * all_.counts["density_queries"]
    less = 1 - stopped[..., :3].sum() / whole[..., :3].sum()
    assert 0 < less < 0.3
    np.testing.assert_array_equal(stopped[..., 3], whole[..., 3])


def test_a_ground_under_it_is_shadowed_alike(tiny_bundle: Bundle):
    """So thin that most of what is seen is the ground."""
    scene = scenes.slab(tiny_bundle)
    thin = replace(scene, shell=replace(scene.shell, offset=0.05 * scene.shell.offset), base_colour=(0.5, 0.5, 0.5))
    (baked, few), (network, many) = (shown(thin, density=how) for how in ("baked", "network"))
    assert many.counts["surface_queries"] > 0 and "surface_queries" not in few.counts
    assert few.counts["grid_reads"] > many.counts["surface_queries"]
    np.testing.assert_allclose(baked.mean(axis=(0, 1)), network.mean(axis=(0, 1)), rtol=0.02)


def test_columns_are_seen_half_as_wide_from_twice_as_far(tiny_bundle: Bundle):
    """And a footprint is twice as wide; where no surface is seen, no column is."""
    scene = scenes.slab(tiny_bundle)
    pose = scene.camera.to_world.copy()
    at = np.array([0.5, 0.5, 0.0])
    pose[:3, 3] = at + 2 * (pose[:3, 3] - at)
    camera = replace(scene.camera, to_world=pose, fov=2 * np.arctan(np.tan(scene.camera.fov / 2) / 2))
    same_pixels = replace(camera, fov=scene.camera.fov)
    near, far, wide = (facts(replace(scene, camera=c)) for c in (scene.camera, camera, same_pixels))
    assert near.baked == 32 * 32 * K
    assert far.magnified == pytest.approx(near.magnified, rel=0.1)  # the same picture, about
    assert wide.magnified == pytest.approx(near.magnified / 2, rel=0.2)
    pose = pose.copy()
    pose[:3, :3] = pose[:3, :3] @ np.diag([-1.0, 1.0, -1.0])  # away from it
    blind = facts(replace(scene, camera=replace(scene.camera, to_world=pose)))
    assert blind.magnified == 0 and plan_effects(blind, QUALITY).baked_density.why == "no camera sees a surface"
