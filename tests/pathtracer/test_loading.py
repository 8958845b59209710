"""What a scene holds after it is loaded, and what may be changed then."""

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

import mesoshell as ms
from mesoshell.errors import InputError
from mesoshell.io.bundle import write_bundle
from mesoshell.pathtracer import load
from mesoshell.pathtracer.facts import distant
from mesoshell.render.camera import pixel_radius
from mesoshell.scene.materials import Material
from tests.helpers import wearing
from tests.helpers.path_traced import QUALITY, SIZE, loaded, placed, scene, sensor, shell


def ground_of(parts: dict) -> float:
    return loaded(parts).integrator().context.facts.ground


def with_ground(materials: Path, reflectance: Any) -> dict:
    shape = shell(materials, "rough")
    shape["bsdf"] = shape["bsdf"] | {"inner": {"type": "diffuse", "reflectance": reflectance}}
    return shape


def test_ground_that_is_not_of_one_colour_may_be_bright(materials) -> None:
    """Dark where u and v are 0, and bright elsewhere."""
    dark, bright = ({"type": "rgb", "value": value} for value in (0.05, 0.9))
    board = {"type": "checkerboard", "color0": dark, "color1": bright}
    image: Any = mi.Bitmap(np.array([[[0.0] * 3, [0.8] * 3], [[0.8] * 3, [0.0] * 3]], np.float32))
    bitmap = {"type": "bitmap", "bitmap": image, "raw": True, "filter_type": "nearest"}
    assert [ground_of(scene(with_ground(materials, x))) for x in (dark, board, bitmap)] == [0.05, 1.0, 1.0]
    context = loaded(scene(with_ground(materials, board), depth=4)).integrator().context
    assert context.effects.bounces.on


def test_lights_that_change_show(materials) -> None:
    """Where light is summed too."""
    made = loaded(scene(shell(materials, "rough")))
    assert made.integrator().context.effects.quadrature.on
    before = np.array(mi.render(made, spp=4))
    parameters: Any = mi.traverse(made)
    parameters["light.irradiance.value"] = 2 * parameters["light.irradiance.value"]
    parameters.update()
    after = np.array(mi.render(made, spp=4))
    assert before[..., :3].mean() > 1e-3
    np.testing.assert_allclose(after[..., :3], 2 * before[..., :3], rtol=1e-4, atol=1e-7)


def test_pixels_of_parallel_rays_are_as_wide_everywhere(materials) -> None:
    view = mi.ScalarTransform4f().look_at([0.5, 0.5, 3.0], [0.5, 0.5, 0.0], [0, 1, 0]).scale([0.5, 0.5, 1])
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}
    made = loaded(scene(shell(materials, "rough"), eye={"type": "orthographic", "to_world": view, "film": film}))
    eye, sampler = made.sensors()[0], made.sensors()[0].sampler()
    ray, _ = eye.sample_ray_differential(0, 0.5, mi.Point2f(0.4, 0.6), mi.Point2f(0.5))
    ray.scale_differential(sampler.sample_count() ** -0.5)  # as a render does
    cone = made.integrator().context.camera_ray(ray, sampler)
    for t in (1e-2, 1.0, 30.0):
        np.testing.assert_allclose(float((cone.spread * (t + cone.apex))[0]), pixel_radius(1 / SIZE), rtol=1e-3)
    assert np.isfinite(np.array(mi.render(made, spp=2))).all()


def test_another_value_compiles_no_other_kernel(materials, tiled_bundle) -> None:
    """Kernels read values, sizes, seeds and lights, and have none of them as constants."""
    write_bundle(materials / "tiled.npz", tiled_bundle)
    made = loaded(scene(shell(materials, "tiled", asked={"dryness": 0.3, "seed": 4})))
    context = made.integrator().context
    (material,) = context.media.materials
    light = [x for vector in distant(made.emitters()[0]) for x in vector]
    numbers = [context.extent, context.shells.size, *context.shells.centre, *material.first_tile, *light]
    numbers += context.media._values.values()
    assert len(numbers) > 12 and all(x.state != dr.VarState.Literal for x in numbers)


def test_another_variant_is_said(materials, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(load, "LOADED", "cuda_ad_rgb")
    with pytest.raises(InputError, match="mesoshell was loaded in cuda_ad_rgb: set that again"):
        loaded(scene(shell(materials, "rough")))


def test_a_group_that_nothing_shows_is_not_there(materials) -> None:
    group, _ = placed(materials, "dense", np.eye(4))
    floor = {"type": "rectangle"}
    alone, beside = (np.array(mi.render(loaded(scene(*x)), spp=4)) for x in ((floor,), (group, floor)))
    np.testing.assert_array_equal(beside, alone)
    made = loaded(scene(group, shell(materials, "rough")))
    assert len(made.integrator().context.media.media) == 1


def test_its_integrator_paints_a_scene_without_shells() -> None:
    parts = scene({"type": "rectangle"}, depth=3)
    ours = loaded(parts | {"integrator": {"type": "mesoshell_path", "max_depth": 3}})
    seen, wanted = (np.array(mi.render(x, spp=256)) for x in (ours, mi.load_dict(parts)))
    assert wanted[..., :3].mean() > 0.05
    np.testing.assert_allclose(seen, wanted, atol=0.02)


def test_a_tiny_scene_is_seen(materials) -> None:
    """By a camera nearer than most sensors see."""
    eye, target = (1e-6 * np.array(x) for x in ((0.5, -1.6, 2.4), (0.5, 0.5, 0.4)))
    away = mi.ScalarTransform4f().look_at(eye.tolist(), target.tolist(), [0, 0, 1])
    group, instance = placed(materials, "rough", np.diag([1e-6, 1e-6, 1e-6, 1.0]))
    made = loaded(scene(group, instance, eye=sensor(to_world=away, near_clip=1e-10)), QUALITY)
    large = loaded(scene(shell(materials, "rough")), QUALITY)
    small, usual = (np.array(mi.render(x, spp=16))[..., 3].mean() for x in (made, large))
    assert usual > 0.1
    np.testing.assert_allclose(small, usual, rtol=0.05)


def test_a_described_scene_may_be_tiny(tiny_bundle) -> None:
    """Its camera stands nearer than a sensor of Mitsuba's usually sees."""
    scene_ = ms.Scene(wearing.ball(1e-6), Material("tiny", tiny_bundle), size=(24, 24))
    ours = ms.render(scene_, "draft").rgba[..., 3].mean()
    theirs = ms.render(scene_, "draft", engine="mitsuba", spp=16).rgba[..., 3].mean()
    assert ours > 0.1
    np.testing.assert_allclose(theirs, ours, rtol=0.05)
