"""What a scene of Mitsuba's does not call for is not in its program; what paths cannot honour of a quality is refused.

Oracles: the operations of the compiled kernels, counted by Dr.Jit, with one effect off and on; how often rays ask for the
boundary, where an effect is off for some rays of a kernel.
That pictures stay the same is tested beside what the effects do (test_paths, test_surface_material, test_direct).
"""

from dataclasses import replace

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.io.bundle import write_bundle
from mesoshell.pathtracer import traversal
from mesoshell.render.effects import Effect
from mesoshell.render.quality import PRESETS, Quality
from tests.helpers.path_traced import QUALITY, constant, loaded, placed, scene, shell

SUN = {"type": "directional", "direction": [-0.3, 0.2, -1.0], "irradiance": 3.0}
#: An effect, and what turns it on beside what it is in a plain scene of a depth: effects that it needs.
GATES = [
    ("filtering", 2, ()),
    ("bounces", 4, ("roulette",)),
    ("direct_light", 2, ()),
]
GATES += [
    pytest.param(*gate, marks=pytest.mark.slow)
    for gate in (
        ("anisotropic_filtering", 2, ("filtering",)),
        ("object_shadow", 2, ()),
        ("roulette", 8, ("bounces",)),
        ("environment", 2, ()),
        ("area_light", 2, ()),
    )
]


def operations(made) -> int:
    """Of the kernels that a picture takes."""
    mi.render(made, spp=1).numpy()  # what is computed once
    dr.kernel_history_clear()
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        mi.render(made, spp=1).numpy()
        return sum(k["operation_count"] for k in dr.kernel_history() if "operation_count" in k)


@pytest.mark.parametrize(("name", "depth", "more"), GATES)
def test_an_effect_that_is_off_is_not_compiled(materials, name: str, depth: int, more: tuple) -> None:
    made = loaded(scene(shell(materials, "thin"), light=SUN, depth=depth), QUALITY.with_changes(anisotropy=4))
    context = made.integrator().context
    plain = replace(context.effects, **{k: Effect(True, "for the test") for k in more})
    plain = replace(plain, quadrature=Effect(name in ("filtering", "anisotropic_filtering"), "for the test"))
    counts = []
    for on in (False, True):
        context.effects = replace(plain, **{name: Effect(on, "for the test")})
        counts.append(operations(made))
    assert 0 < counts[0] < counts[1], counts


def test_only_corner_tiles_are_hashed(materials, tiled_bundle) -> None:
    """Of the same constant, as one patch and as sixteen tiles: the same picture, and more operations."""
    write_bundle(materials / "tiled.npz", constant(tiled_bundle, 1.0, 0.2))
    made = [loaded(scene(shell(materials, name), light=SUN, depth=2), QUALITY) for name in ("thin", "tiled")]
    plain, tiled = (mi.render(each, spp=4).numpy() for each in made)
    assert plain[..., :3].mean() > 1e-3
    np.testing.assert_allclose(plain, tiled, rtol=1e-4, atol=1e-6)
    assert operations(made[0]) < operations(made[1])


@pytest.fixture
def questions(monkeypatch):
    """How often rays have asked what boundary they meet next."""
    count, ask = dr.zeros(mi.UInt32, 1), traversal._ask

    def counting(*arguments):
        dr.scatter_add(count, mi.UInt32(1), mi.UInt32(0))
        return ask(*arguments)

    monkeypatch.setattr(traversal, "_ask", counting)
    return lambda: int(count[0])


@pytest.mark.parametrize("name", ["shell_shadow", "camera_in_shell"])
def test_light_that_leaves_and_rays_from_outside_ask_less(materials, questions, name: str) -> None:
    """And it is the same picture, sample by sample: no light meets the shell again, no ray begins in it."""
    made = loaded(scene(shell(materials, "rough"), light=SUN))
    context = made.integrator().context
    plain = replace(context.effects, quadrature=Effect(False, "for the test"))
    assert not getattr(plain, name).on
    found = []
    for on in (False, True):
        context.effects, before = replace(plain, **{name: Effect(on, "for the test")}), questions()
        found.append((np.array(mi.render(made, spp=16)), questions() - before))
    (off, few), (full, many) = found
    assert 0 < few < many
    np.testing.assert_allclose(off, full, rtol=1e-5, atol=1e-6)


def test_a_convex_shell_under_the_sun_is_summed_however_deep_paths_may_go(materials) -> None:
    """It needs no bounce; beside a wall it does."""
    wall = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([0, 3, 0]).rotate([1, 0, 0], 90)}
    alone, beside = (
        loaded(scene(*shapes, light=SUN, depth=8)).integrator().context.effects
        for shapes in ([shell(materials, "thin")], [shell(materials, "thin"), wall])
    )
    assert alone.quadrature.on and not alone.bounces.on
    assert beside.bounces.on and beside.object_shadow.on and not beside.quadrature.on
    white = shell(materials, "thin", asked={"inner": {"type": "diffuse"}})
    assert loaded(scene(white, light=SUN, depth=8)).integrator().context.effects.bounces.on


def test_what_stands_beside_a_shell_is_not_forgotten(materials, folder) -> None:
    """Its own ground shadows a mesh that wears a surface material; an instance may hold other meshes than the shell's."""
    square = shell(materials, "thin")
    bsdf = {"type": "mesoshell", "material": str(folder / "half.npz"), "scale": 0.5}
    textured = {"type": "obj", "filename": str(folder / "square.obj"), "bsdf": bsdf}
    assert loaded(scene(square, textured, light=SUN)).integrator().context.effects.object_shadow.on
    group, instance = placed(materials, "thin", np.eye(4))
    group["other"] = {"type": "rectangle"}
    assert loaded(scene(group, instance, light=SUN)).integrator().context.effects.object_shadow.on


def test_light_from_below_a_face_is_shadowed_by_a_convex_mesh(materials) -> None:
    for direction, low in (([-0.3, 0.2, -1.0], False), ([-0.3, 0.2, 1.0], True), ([1.0, 0.0, 0.0], True)):
        plan = (
            loaded(scene(shell(materials, "thin"), light=SUN | {"direction": direction})).integrator().context.effects
        )
        assert plan.mesh_shadow.on == low


def test_spacing_that_paths_do_not_have_is_refused(materials) -> None:
    with pytest.raises(InputError, match=r"^spacing: 'interval' requires `engine` jax"):
        loaded(scene(shell(materials, "thin")), Quality(spacing="interval"))


def test_depths_are_the_scenes_own(materials) -> None:
    parts = scene(shell(materials, "thin"), depth=3)
    parts["integrator"]["rr_depth"] = 2
    quality = loaded(parts, PRESETS["reference"]).integrator().context.quality
    assert (quality.max_depth, quality.rr_depth) == (3, 2)
