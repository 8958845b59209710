"""Scenes of Mitsuba's with shells: what they ask for is found, paths carry the right amount of light, and what is off may be.

Most materials here are one density and one ρ everywhere, so that what comes out is known.
"""

from dataclasses import replace
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from mesoshell.errors import InputError
from mesoshell.geometry.mesh import load_mesh
from mesoshell.io.bundle import write_bundle
from mesoshell.pathtracer import texture_cache
from mesoshell.pathtracer.load import load_dict, load_file
from mesoshell.render.effects import Effect
from mesoshell.shell.geometry.extrude import extrude
from tests.helpers import caches, growing
from tests.helpers.path_traced import QUALITY, ROOT, SIZE, loaded, placed, scene, sensor, shell


def picture(parts: dict, spp: int = 64, seed: int = 0) -> np.ndarray:
    return np.array(mi.render(loaded(parts), spp=spp, seed=mi.UInt32(seed)))


def test_sums_and_draws_agree(materials) -> None:
    """The flat box by distant light: all samples summed, and collisions drawn, which is the same estimate with more noise."""
    made: Any = load_dict(scene(shell(materials, "rough")), QUALITY.with_changes(samples=256, weight_cut=0.0))
    context = made.integrator().context
    assert context.effects.quadrature.on

    def runs(first: int) -> np.ndarray:
        return np.stack([np.array(mi.render(made, spp=256, seed=mi.UInt32(k))) for k in range(first, first + 8)])

    summed = runs(0)
    context.effects = replace(context.effects, quadrature=Effect(False, "for the test"))
    drawn = runs(8)
    assert summed[..., :3].mean() > 1e-3 and 0.1 < summed[..., 3].mean() < 0.95
    for c in (1, 3):
        a, b = (x[..., c].mean(axis=(1, 2)) for x in (summed, drawn))
        assert abs(a.mean() - b.mean()) < 4 * np.sqrt((a.var() + b.var()) / 7)
    assert summed.std(axis=0).mean() < 0.5 * drawn.std(axis=0).mean()
    assert np.abs(drawn.mean(axis=0) - summed.mean(axis=0)).mean() < 0.05 * summed.mean()


def test_many_samples_are_lit_like_few(materials) -> None:
    """What a ray leaves unlit for their small weights does not grow with their number."""
    few, many = (
        np.array(mi.render(load_dict(scene(shell(materials, "rough")), QUALITY.with_changes(samples=n)), spp=256))
        for n in (48, 1024)
    )
    np.testing.assert_allclose(many[..., :3].mean(), few[..., :3].mean(), rtol=0.05)


def test_all_densities_that_are_asked_for_are_counted(materials) -> None:
    """Straight down on lit ground: a ray's samples, and as many on the way from the ground to the light."""
    down = mi.ScalarTransform4f().look_at([0.5, 0.5, 5], [0.5, 0.5, 0], [0, 1, 0])
    light = {"type": "directional", "direction": [0, 0, -1], "irradiance": 3.0}
    white = {"inner": {"type": "diffuse"}}
    parts = scene(shell(materials, "thin", asked=white), light=light, eye=sensor(to_world=down, fov=5))
    made = loaded(parts, QUALITY.with_changes(samples=16, skip=0.0, early_stop=0.0))
    mi.render(made, spp=1).numpy()
    assert made.integrator().context.queries == 2 * 16 * SIZE**2


POINT = {"type": "point", "position": [-0.5, 0.2, 1.5], "intensity": 10.0}
SKY = {"type": "constant"}
#: Over a field, so far off that a pixel is wider than a texel.
AFAR = sensor(to_world=mi.ScalarTransform4f().look_at([0.5, -0.4, 0.6], [0.5, 0.5, 0.0], [0, 0, 1]))


@pytest.mark.parametrize(
    "material, patches, eye, light, depth, off",
    [
        pytest.param("thin", 1, sensor(), SKY, 4, set(), marks=pytest.mark.slow),
        ("thin", 1, sensor(), POINT, 2, {"environment", "background", "filtering"}),
        pytest.param("rough", 40, AFAR, SKY, 4, set(), marks=pytest.mark.slow),
    ],
)
def test_effects_that_are_off_change_nothing(materials, material, patches, eye, light, depth, off) -> None:
    """What the plan leaves out is not needed: with everything compiled, the same picture within its noise, in each block of
    4 × 4 pixels. The ground is black, so that bounces can bring nothing."""
    asked = {"thickness": 1 / patches, "scale": 1 / patches}
    made = loaded(scene(shell(materials, material, asked=asked), light=light, depth=depth, eye=eye))
    context = made.integrator().context
    left_out = {name for name, effect in vars(context.effects).items() if not effect.on}
    others = {"shell_shadow", "object_shadow", "bounces", "roulette", "camera_in_shell", "quadrature"}
    others |= {
        "area_light",
        "varying_parameters",
        "varying_geometry",
        "surface_materials",
        "opacity",
        "twin",
        "corner_tiles",
        "baked_density",
    }
    assert left_out == off | others | {"anisotropic_filtering"}

    def means(first: int) -> np.ndarray:
        runs = (np.array(mi.render(made, spp=64, seed=mi.UInt32(k)))[..., :3] for k in range(first, first + 16))
        return np.stack([run.reshape(3, 4, 3, 4, 3).mean(axis=(1, 3)) for run in runs])

    gated = means(0)
    assert gated.mean() > 0.01
    every = {
        name: Effect(name not in ("quadrature", "surface_materials", "baked_density"), "for the test")
        for name in vars(context.effects)
    }
    context.effects = replace(context.effects, **every)
    full = means(16)
    noise = np.sqrt((gated.var(axis=0) + full.var(axis=0)) / 15)
    assert noise.mean() < 0.02 * gated.mean()
    assert (np.abs(gated.mean(axis=0) - full.mean(axis=0)) <= 4.5 * noise + 1e-6).all()


def test_over_dark_ground_little_is_lost_for_want_of_bounces(materials) -> None:
    """Ground of albedo 0.1 under a shell that lets half of the light through: a fortieth, as the docs say."""
    ground = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.1}}
    asked = {"inner": ground, "thickness": float(np.log(2)), "scale": 1.0}
    cut, traced = (
        loaded(scene(shell(materials, "thin", asked=asked), depth=8), QUALITY.with_changes(dark_ground=dark))
        for dark in (0.1, 0.0)
    )
    assert not cut.integrator().context.effects.bounces.on and traced.integrator().context.effects.bounces.on
    few, all_of_it = (np.array(mi.render(made, spp=2048))[..., :3].mean() for made in (cut, traced))
    assert 0.01 < 1 - few / all_of_it < 0.035


def test_a_white_furnace(materials) -> None:
    """Hard case 20: a dense field whose ρ integrates to 1, under a sky of 1, cannot be seen before it, nor from within."""
    sky = {"type": "constant"}
    square = shell(materials, "dense")
    square["bsdf"]["inner"] = {"type": "null"}
    for place in ([0.5, -1.6, 2.4], [0.4, 0.3, 0.5]):
        eye = sensor(to_world=mi.ScalarTransform4f().look_at(place, [0.5, 0.5, 0.4], [0, 0, 1]))
        found = picture(scene(square, light=sky, eye=eye), spp=8192)[..., :3]
        assert np.isfinite(found).all()
        np.testing.assert_allclose(found.mean(), 1, atol=1e-3)


@pytest.mark.slow
def test_a_white_furnace_within_glass(materials) -> None:
    """White ground, a dense field whose ρ integrates to 1, and glass about them: under a sky of 1 nothing can be seen."""
    square = shell(
        materials, "dense", asked={"thickness": 0.1, "scale": 0.1}
    )  # what stands within an exit of 0.4 is passed by
    square["bsdf"]["inner"] = {
        "type": "twosided",
        "b": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}},
    }
    glass = {"type": "sphere", "center": [0.5, 0.5, 0.4], "radius": 1.5, "bsdf": {"type": "dielectric", "int_ior": 1.5}}
    parts = scene(square, glass, light={"type": "constant"}, depth=-1)
    parts["integrator"]["rr_depth"] = 64
    found = picture(parts, spp=4096)[..., :3]
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found.mean(), 1, atol=3e-3)


def test_an_instance_is_the_shell_moved(materials) -> None:
    """Turned, moved and twice as high: seen with a camera and a light that were moved along, it is the same picture; and so it
    is mirrored, with the camera mirrored as well."""
    plain = picture(scene(shell(materials, "rough")), spp=256)
    turn = np.array(mi.ScalarTransform4f().translate([3, -2, 1]).rotate([0, 0, 1], 70).matrix, float)
    mirror = np.diag([-1.0, 1, 1, 1])
    for matrix in (turn, turn @ mirror):
        light = {"type": "directional", "direction": list(matrix[:3, :3] @ [-0.3, 0.2, -1.0]), "irradiance": 3.0}
        pose = matrix @ np.array(sensor()["to_world"].matrix, float)
        if matrix is not turn:
            pose = pose @ mirror
        moved = scene(*placed(materials, "rough", matrix), light=light, eye=sensor(to_world=mi.ScalarTransform4f(pose)))
        found = picture(moved, spp=256)
        found = found if matrix is turn else found[:, ::-1]
        assert np.abs(found - plain).mean() < 0.03 * plain.mean(), matrix


@pytest.mark.slow
def test_stretching_an_instance_stretches_its_slab(materials) -> None:
    """A slab of one σ and ρ, twice as high by its thickness or by its instance's scale, is one slab."""
    tall = picture(scene(shell(materials, "thin", asked={"thickness": 2.0, "scale": 2.0})), spp=256)
    found = picture(scene(*placed(materials, "thin", np.diag([1.0, 1, 2, 1]), {"scale": 2.0})), spp=256)
    assert np.abs(found - tall).mean() < 0.02 * tall.mean()


def dried(materials, value, eye: dict | None = None) -> np.ndarray:
    return picture(scene(shell(materials, "rough", asked={"dryness": value}), eye=eye), spp=128)


def texture(*pixels: float, axis: int = 0) -> dict:
    bitmap = mi.Bitmap(np.expand_dims(np.array(pixels, np.float32), (axis, 2)))
    return {"type": "bitmap", "bitmap": bitmap, "raw": True, "filter_type": "nearest"}


def test_a_texture_gives_a_parameter_over_the_surface(materials) -> None:
    """One that is the same everywhere is that number; one with two halves has the look of each number in its half."""
    low, high = (dried(materials, value) for value in (0.0, 2.0))
    assert np.abs(low - high).mean() > 0.05 * low.mean()
    np.testing.assert_allclose(dried(materials, texture(1.0, 1.0)), high, atol=1e-4)
    halves = dried(materials, texture(0.0, 1.0))
    assert np.abs(halves - low)[:, :4].mean() < 0.1 * np.abs(halves - high)[:, :4].mean()
    assert np.abs(halves - high)[:, -4:].mean() < 0.1 * np.abs(halves - low)[:, -4:].mean()


@pytest.mark.slow
def test_an_images_first_row_lies_where_the_files_v_is_1(materials) -> None:
    """Far up, seen from above."""
    above = sensor(to_world=mi.ScalarTransform4f().look_at([0.5, 0.5, 4.0], [0.5, 0.5, 0.0], [0, 1, 0]))
    low, high, rows = (dried(materials, value, above) for value in (0.0, 2.0, texture(1.0, 0.0, axis=1)))
    assert np.abs(rows - high)[:5].mean() < 0.1 * np.abs(rows - low)[:5].mean()
    assert np.abs(rows - low)[-5:].mean() < 0.1 * np.abs(rows - high)[-5:].mean()


def test_a_material_lies_on_a_file_as_it_does_in_the_other_engine(materials) -> None:
    """Mitsuba turns an OBJ file's v round; the shell's chart is the file's all the same."""
    for name in ("box.obj", "spot.obj"):
        path = materials / name if name == "box.obj" else ROOT / "tests/data" / name
        asked = {"material": str(materials / "rough.npz"), "thickness": 0.1, "scale": 0.5}
        square = {"type": "obj", "filename": str(path), "bsdf": {"type": "mesoshell", **asked}}
        ours = extrude(load_mesh(path), 0.1, 0.5)
        context = loaded(scene(square)).integrator().context
        found = np.array(context.shells.uv).reshape(-1, 3, 2)
        assert found.shape == ours.uv.shape
        np.testing.assert_allclose(found.mean(axis=1), ours.uv.mean(axis=1), atol=1e-4)


def test_a_shell_has_the_proportions_of_its_material(materials, tiny_bundle) -> None:
    """Without a thickness it is 1/25 of the square's diagonal high: 18 patches fit at a height of one, 4 at a quarter."""
    write_bundle(materials / "flat.npz", replace(tiny_bundle, thickness=0.25))
    for name, patches in (("rough", 18), ("flat", 4)):
        bsdf = {"type": "mesoshell", "material": str(materials / f"{name}.npz")}
        made: Any = load_dict(scene({"type": "obj", "filename": str(materials / "box.obj"), "bsdf": bsdf}))
        assert np.array(made.integrator().context.shells.uv).max() == patches


def test_a_mirror_shows_the_shell(materials) -> None:
    """A camera that looks at a mirror sees what its own mirror image sees without it."""
    behind = mi.ScalarTransform4f().look_at([0.5, -1.6, 2.4], [0.5, 0.5, 0.4], [0, 0, 1])
    pose = np.diag([1.0, -1, 1, 1]) @ np.array(behind.matrix, float) @ np.diag([-1.0, 1, 1, 1])
    pose[1, 3] += 2 * -1.0
    wall = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, -1, 0]).rotate([1, 0, 0], -90).scale(20),
    }
    wall["bsdf"] = {"type": "twosided", "inner": {"type": "conductor", "material": "none"}}
    lit = {"type": "directional", "direction": [-0.3, -0.5, -1.0], "irradiance": 3.0}
    eye = sensor(to_world=mi.ScalarTransform4f(pose))
    direct = picture(scene(shell(materials, "rough"), light=lit), spp=256)[..., :3]
    seen = picture(scene(shell(materials, "rough"), wall, light=lit, depth=3, eye=eye), spp=1024)[..., :3][:, ::-1]
    assert direct.mean() > 1e-3 and np.abs(seen - direct).mean() < 0.05 * direct.mean()


def test_a_file_is_read_and_its_integrator_keeps_its_depth(materials, tmp_path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(f"""<scene version="3.0.0">
        <integrator type="path"><integer name="max_depth" value="$depth"/></integrator>
        <sensor type="perspective">
            <film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="4"/></film>
            <transform name="to_world"><lookat origin="0.5, -1.6, 2.4" target="0.5, 0.5, 0.4" up="0, 0, 1"/></transform>
        </sensor>
        <emitter type="constant"/>
        <bsdf type="mesoshell" id="turf"><string name="material" value="{materials / "thin.npz"}"/>
            <float name="thickness" value="1"/><integer name="scale" value="1"/></bsdf>
        <shape type="obj"><string name="filename" value="{materials / "box.obj"}"/><ref id="turf"/></shape></scene>""")
    made: Any = load_file(path, depth=3)
    assert made.integrator().max_depth == 3 and made.integrator().context.shells.size == 1
    assert "SmoothDiffuse" in str(made.shapes()[0].bsdf())
    assert np.array(mi.render(made, spp=4)).mean() > 0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"material": "gras"}, "gras: no such material"),
        ({"dryness": 7.0}, r"dryness=7 lies outside \[0, 2\]"),
        ({"dryess": 1.0}, "no parameter 'dryess'; did you mean dryness?"),
        ({"thickness": -1.0}, "thickness: must be positive and finite, not -1"),
        ({"seed": 3}, "has no generator"),
        ({"second": {"type": "diffuse"}}, "2 BSDFs within a mesoshell BSDF"),
        ({"dryness": True}, "dryness must be a number or a texture"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(materials, change, said) -> None:
    with pytest.raises(InputError, match=said) as fault:
        load_dict(scene(shell(materials, "rough", asked=change)))
    assert "\n" not in str(fault.value)


@pytest.mark.slow  # tests/io/test_kept_textures has the cache, test_generator_cli both engines
def test_a_generators_texture_is_made_once(materials, tmp_path, tmp_path_factory, monkeypatch) -> None:
    """By `mesoshell texture`, in a process of its own; the second time it is read."""
    monkeypatch.setenv("XDG_CACHE_HOME", caches.own(tmp_path / "cache", tmp_path_factory))
    write_bundle(materials / "grown.npz", growing.bundle())
    parts = scene(shell(materials, "grown", asked={"seed": 3, "length": 2.5, "age": 4.0}))
    made = picture(parts, spp=4)
    assert [p.suffix for p in (tmp_path / "cache/mesoshell/textures").iterdir()] == [".npz"]
    monkeypatch.setattr(texture_cache.subprocess, "run", None)
    np.testing.assert_allclose(picture(parts, spp=4), made, atol=1e-6)
    monkeypatch.undo()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "other"))
    with pytest.raises(InputError, match="length=7 lies outside"):
        loaded(scene(shell(materials, "grown", asked={"length": 7.0})))


@pytest.mark.slow
def test_a_texture_is_as_fine_as_its_camera_sees(materials, tmp_path, tmp_path_factory, monkeypatch) -> None:
    """From far off a quarter of the texels are made, and the picture is that of them all."""
    monkeypatch.setenv("XDG_CACHE_HOME", caches.own(tmp_path / "cache", tmp_path_factory))
    write_bundle(materials / "far.npz", growing.bundle())
    away = mi.ScalarTransform4f().look_at([0.5, -7.0, 11.0], [0.5, 0.5, 0.4], [0, 0, 1])
    parts = scene(shell(materials, "far", asked={"seed": 3}), eye=sensor(to_world=away))
    exact = QUALITY.with_changes(skip=0.0, footprint=1.0)
    coarse = loaded(parts, exact)
    assert coarse.integrator().context.media.materials[0].density == growing.TEXELS / 4
    monkeypatch.setattr("mesoshell.pathtracer.load.texels_needed", lambda *_: growing.TEXELS)
    fine = loaded(parts, exact)
    assert fine.integrator().context.media.materials[0].density == growing.TEXELS
    one, other = (np.array(mi.render(x, spp=4)) for x in (coarse, fine))
    assert one[..., :3].max() > 1e-3
    np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-5)


def test_misplaced_elements_are_refused(materials, tmp_path) -> None:
    square = shell(materials, "rough")
    sphere = {"type": "sphere", "bsdf": square["bsdf"]}
    within = square | {"bsdf": {"type": "twosided", "inner": square["bsdf"]}}
    other = scene(square) | {"integrator": {"type": "volpath"}}
    for parts, said in (
        (scene(sphere), "a 'sphere' is not a mesh"),
        (scene(within), "within a 'twosided'"),
        (other, "integrator 'volpath' does not support shells"),
        (scene(square) | {"shape1": {"type": "nothing"}}, "nothing"),
    ):
        with pytest.raises(InputError, match=said) as fault:
            load_dict(parts)
        assert "\n" not in str(fault.value)
    (tmp_path / "bad.xml").write_text("<scene version='3.0.0'><shape></scene>")
    for path, said in ((tmp_path / "none.xml", "no such file"), (tmp_path / "bad.xml", "bad.xml")):
        with pytest.raises(InputError, match=said):
            load_file(path)


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("f 1/1 2/2 3/3\n", "1 repeated face dropped"),
        ("v 0.5 0 0\nf 1/1 5/1 2/2\n", "1 zero-area face dropped (first: index 2)"),
        ("v 0 0.3 1.5\nv 1 0.3 1.5\nf 2/2 1/1 5/4 6/3\n", "thickness reduced at"),
    ],
)
def test_what_was_mended_is_said(materials, tmp_path, more, said) -> None:
    """A face that comes again, one without area, and a wall at which a shell of this height would fold: as pictures without."""
    (tmp_path / "box.obj").write_text((materials / "box.obj").read_text() + more)
    square = shell(materials, "thin") | {"filename": str(tmp_path / "box.obj")}
    made = loaded(scene(square))
    notes = made.integrator().context.notes
    assert any(said in note for note in notes), notes
    found = np.array(mi.render(made, spp=4))
    assert np.isfinite(found).all() and found[..., 3].max() > 0


def test_a_camera_may_come_later(materials) -> None:
    """A sensor that is handed to mi.render shows what it shows in the scene."""
    other = sensor(to_world=mi.ScalarTransform4f().look_at([2.0, 1.6, 1.4], [0.5, 0.5, 0.4], [0, 0, 1]))
    within, without = loaded(scene(shell(materials, "rough"), eye=other)), loaded(scene(shell(materials, "rough")))
    one, two = (np.array(mi.render(s, spp=16, sensor=mi.load_dict(other))) for s in (within, without))
    np.testing.assert_array_equal(one, two)
    assert one.std() > 0.01


def test_a_scene_without_shells_is_mitsubas_own() -> None:
    parts = {"type": "scene", "integrator": {"type": "path"}, "light": {"type": "constant"}, "sensor": sensor()}
    np.testing.assert_allclose(np.array(mi.render(load_dict(parts), spp=1))[..., :3], 1, atol=1e-6)


@pytest.mark.slow  # docs/tutorials/library.md grows it there, in both engines
def test_the_bundled_grass_grows_on_spot() -> None:
    parts = scene(light={"type": "constant"}, depth=3) | {
        "spot": {
            "type": "obj",
            "filename": str(ROOT / "tests/data/spot.obj"),
            "bsdf": {"type": "mesoshell", "material": "grass"},
        },
        "sensor": sensor(to_world=mi.ScalarTransform4f().look_at([1.5, 0.9, -2.4], [0, 0.05, 0.15], [0, 1, 0])),
    }
    found = picture(parts, spp=16)
    assert np.isfinite(found).all() and found[SIZE // 2, SIZE // 2, 1] > found[SIZE // 2, SIZE // 2, 2]
