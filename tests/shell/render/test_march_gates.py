"""What a scene does not call for is not computed in JAX: the same picture without it, for fewer operations.

Oracle: the same render with the effect switched on by hand. Lowered programs are counted in test_kernels.
"""

from dataclasses import replace

import numpy as np
import pytest

from mesoshell.io.bundle import Bundle
from mesoshell.render.camera import Camera, look_at
from mesoshell.render.effects import MARCH, Effect, plan_effects
from mesoshell.render.light import Distant, environment
from mesoshell.render.quality import Quality
from mesoshell.render.tiles import RenderReport
from mesoshell.scene.render_shell import facts
from mesoshell.shell.geometry.extrude import extrude, patches_per_uv
from mesoshell.shell.material.loader import load_device_material
from mesoshell.shell.render.renderer import render
from mesoshell.shell.render.scene import Scene
from tests.helpers import scenes

QUALITY = Quality(pixel_samples=1, samples=20, anisotropy=1, density="network")


@pytest.fixture(scope="module")
def slab(tiny_bundle: Bundle) -> Scene:
    return scenes.slab(tiny_bundle)


def shown(scene: Scene, *forced: str) -> tuple[np.ndarray, RenderReport]:
    """A picture by the plan, but for effects that are on whatever it says."""
    plan = plan_effects(facts(scene), QUALITY)
    assert not any(getattr(plan, name).on for name in forced)
    return render(scene, QUALITY, replace(plan, **{name: Effect(True, "for the test") for name in forced}))


@pytest.mark.parametrize("name", ["mesh_shadow", "object_shadow"])
def test_a_convex_mesh_alone_needs_no_shadow_rays(slab: Scene, name: str) -> None:
    (off, without), (on, with_it) = shown(slab), shown(slab, name)
    assert off[..., :3].mean() > 1e-3
    np.testing.assert_array_equal(off, on)
    assert without.counts.get("shadow_rays", 0) == 0 < with_it.counts["shadow_rays"]


def test_near_footprints_need_no_filter(slab: Scene) -> None:
    """Of 4 texels a patch, none is as small as a pixel; the programs with and without are counted in test_kernels."""
    off, on = shown(slab)[0], shown(slab, "filtering")[0]
    np.testing.assert_allclose(off, on, rtol=1e-5, atol=1e-7)


def test_a_footprint_is_in_pixels(tiny_bundle: Bundle) -> None:
    """A third of a pixel is a whole one of a picture with three times as many a side, whose every third ray is the same."""
    mesh = scenes.slab_mesh()
    shell = extrude(mesh, 1 / 40, 1 / 40)

    sun = Distant(np.array([0.0, 0.6, 0.8]), np.ones(3))

    def picture(side: int, footprint: float) -> np.ndarray:
        camera = Camera(look_at((0.5, -0.4, 0.6), (0.5, 0.5, 0.0), (0.0, 0.0, 1.0)), 0.7, side, side)
        of = load_device_material(tiny_bundle), camera, (sun,), None, np.array([0.5], np.float32)
        field = Scene(mesh, shell, *of, patches_per_uv=patches_per_uv(mesh, shell))
        quality = QUALITY.with_changes(footprint=footprint, light_samples=0, anisotropy=4)
        return render(field, quality, plan_effects(facts(field), quality))[0]

    narrow, wide, fine = picture(11, 1 / 3), picture(11, 1.0), picture(33, 1.0)[1::3, 1::3]
    np.testing.assert_allclose(narrow, fine, rtol=1e-4, atol=1e-5)
    assert np.abs(wide - fine).max() > 0.01


def test_a_field_needs_only_what_it_is_given(tiny_bundle: Bundle) -> None:
    """40 × 40 patches from afar, under a sky: with all effects that marched rays can have, the same picture."""
    mesh = scenes.slab_mesh()
    shell = extrude(mesh, 1 / 40, 1 / 40)
    camera = Camera(look_at((0.5, -0.4, 0.6), (0.5, 0.5, 0.0), (0.0, 0.0, 1.0)), 0.7, 16, 16)
    sky = environment(np.random.default_rng(0).uniform(size=(4, 8, 3)).astype(np.float32), 2)
    of = load_device_material(tiny_bundle), camera, (), sky, np.array([0.5], np.float32)
    field = Scene(mesh, shell, *of, patches_per_uv=patches_per_uv(mesh, shell), transparent=False)
    assert field.patches_per_uv == 40
    plan = plan_effects(facts(field), QUALITY)
    others = {"twin", "baked_density"}  # which make another picture
    every = replace(plan, **{name: Effect(True, "for the test") for name in MARCH.can - others})
    off, on = (render(field, QUALITY, effects)[0] for effects in (plan, every))
    assert off[..., :3].std() > 1e-2 and off[-1, :, :3].mean() > 1e-3
    np.testing.assert_array_equal(off, on)


def test_without_light_nothing_is_asked_for_it(slab: Scene) -> None:
    """Density alone is decoded, and alpha is that of the lit picture."""
    lit, lit_report = shown(slab)
    image, report = shown(replace(slab, lights=()))
    assert (image[..., :3] == 0).all() and report.counts.get("transport_queries", 0) == 0
    assert lit_report.counts["transport_queries"] > 0
    np.testing.assert_array_equal(image[..., 3], lit[..., 3])


def test_a_transparent_background_is_not_looked_up(slab: Scene) -> None:
    """An environment that lights, and is not seen, leaves alpha as it is; seen, it fills what the shell lets through."""
    sky = environment(np.full((4, 8, 3), 0.5, np.float32), 2)
    lit = replace(slab, environment=sky)
    off, on = shown(lit)[0], shown(replace(lit, transparent=False))[0]
    np.testing.assert_allclose(on[..., :3], off[..., :3] + 0.5 * (1 - off[..., 3:]), atol=1e-6)
    assert (on[..., 3] == 1).all()
