"""Several materials in one scene: each mesh shows its own, in both engines, and faults say of which they are."""

import json
import shlex
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.cli.grown import grown_of
from mesoshell.cli.main import main
from mesoshell.cli.options.render import Options
from mesoshell.errors import InputError
from mesoshell.geometry.mesh import Mesh
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.render.effects import plan_effects
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.render.tiles import RenderReport
from mesoshell.scene.growth import grows
from mesoshell.scene.materials import Material
from mesoshell.scene.render_shell import facts, marched_scene
from mesoshell.scene.settle import settle, with_textures
from mesoshell.scene.setup import describe_shell
from mesoshell.scene.unpack import unpack
from mesoshell.shell.render.renderer import _Renderer
from mesoshell.viewer.look import command, first_look
from tests.helpers import growing, wearing

DATA = Path(__file__).parents[1] / "data"
LIGHT = 3.0
#: All samples are summed, at places that do not depend on what else a ray meets.
QUALITY = PRESETS["draft"].with_changes(
    spacing="length", filtering=False, skip=0.0, early_stop=0.0, light_samples=0, max_depth=2, spp=1
)


def fog(bundle: Bundle, sigma: float, rho: tuple[float, float, float]) -> Material:
    """σ everywhere, and ρ toward light from above."""
    arrays = {name: array.copy() for name, array in bundle.arrays.items()}
    for name in ("decoder/sigma/kernel", "decoder/rho/kernel"):
        arrays[name][:] = 0
    arrays["decoder/sigma/bias"][:] = 3 + np.log(np.expm1(sigma / float(arrays["sigma_scale"])))
    arrays["decoder/rho/bias"][:] = 2 + np.log(np.expm1(rho))
    for name in (name for name in arrays if name.startswith("grid/")):
        arrays[name][:] = sigma
    return Material(f"fog of {sigma:g}", replace(bundle, arrays=arrays))


def plate(*at: float) -> Mesh:
    return wearing.moved(wearing.square(), *at)


def picture(scene: ms.Scene, engine: Any = "jax", **changes: Any) -> np.ndarray:
    return ms.render(scene, QUALITY.with_changes(**changes), engine=engine).rgba.astype(np.float64)


@pytest.mark.parametrize("engine", ["jax", "mitsuba"])
@pytest.mark.parametrize("swapped", [False, True])
def test_rays_pass_through_both(tiny_bundle: Bundle, engine: str, swapped: bool):
    """Level rays through two plates of fog: 1 − e^{−Σσ} of them is opaque, and the second plate is seen through the first."""
    near, far = (1.0, (0.3, 0.1, 0.05)), (0.4, (0.05, 0.2, 0.4))
    a, b = (fog(tiny_bundle, *x) for x in (near, far))
    first, second = plate(0, 0, 0), plate(1.5, 0, 0)
    scene = ms.Scene(first, a, also=[ms.Grown(second, b, thickness=0.5, scale=1.0)])
    if swapped:
        scene = ms.Scene(second, b, also=[ms.Grown(first, a, thickness=0.5, scale=1.0)])
    camera = ms.Camera(ms.look_at((-100.0, 0.5, 0.25), (0.0, 0.5, 0.25), (0.0, 0.0, 1.0)), 1e-3, 4, 4)
    scene = replace(scene, thickness=0.5, scale=1.0, camera=camera, lights=[(0.0, 0.0, 1.0)], irradiance=LIGHT, up="z")
    seen = picture(scene, engine, samples=64, spp=2**14)
    if engine == "mitsuba":  # draws where a path ends
        seen = seen.mean(axis=(0, 1))
    opacity = -np.expm1([-near[0], -far[0]])
    radiance = LIGHT * (opacity[0] * np.array(near[1]) + (1 - opacity[0]) * opacity[1] * np.array(far[1]))
    wanted = np.append(radiance, 1 - np.exp(-near[0] - far[0]))
    np.testing.assert_allclose(seen, np.broadcast_to(wanted, seen.shape), rtol=2e-3 if engine == "jax" else 0.02)


@pytest.fixture(scope="module")
def two(tiny_bundle: Bundle, tiled_bundle: Bundle) -> tuple[ms.Scene, ms.Scene, ms.Scene]:
    """Plates far beside each other, of one patch and of tiles, under maps and seeds of their own; and each alone."""
    image = np.linspace(0, 1, 16, dtype=np.float32).reshape(4, 4)
    given = {"thickness": 0.3, "scale": 0.5, "params": {"dryness": image}}, {"thickness": 0.2, "scale": 0.25, "seed": 3}
    at: Any = {
        "camera": (0.0, -2.0, 12.0, 0.0, 0.5, 0.0, 10.0),
        "size": (36, 12),
        "lights": [(0.2, 0.3, 1.0)],
        "up": "z",
    }
    a, b = Material("patch", tiny_bundle), Material("tiles", tiled_bundle)
    left, right = plate(-2, 0, 0), plate(1, 0, 0)
    both = ms.Scene(left, a, **given[0], **at, also=[ms.Grown(right, b, **given[1])])
    return both, ms.Scene(left, a, **given[0], **at), ms.Scene(right, b, **given[1], **at)


def test_images_of_parameters_have_sizes_of_their_own():
    """The small one is the large one with fewer pixels."""
    rows, columns = np.divmod(np.arange(64), 8)
    fine, coarse = (rows * columns / 49).reshape(8, 8).astype(np.float32), np.array([[0.2, 0.9]], np.float32)
    repeated = np.repeat(np.repeat(coarse, 8, axis=0), 4, axis=1)
    at: Any = {"scale": 0.5, "size": (16, 12), "camera": (0.5, 0.4, 3.0, 0.5, 0.5, 0.0, 20.0), "up": "z"}
    scene = ms.Scene(plate(0, 0, 0), ms.load_material("pelt"), params={"hue": fine, "value": coarse}, **at)
    seen = picture(scene)
    np.testing.assert_array_equal(seen, picture(replace(scene, params={"hue": fine, "value": repeated})))
    assert np.abs(seen - picture(replace(scene, params={"hue": fine}))).max() > 0.01


def test_each_shows_its_own_material(two: tuple[ms.Scene, ms.Scene, ms.Scene]):
    """Ground included, and where samples lie by density, skipped where nothing can be."""
    both, left, right = two
    changes = {"spacing": "density", "skip": 0.05}
    seen, wanted = picture(both, **changes), picture(left, **changes) + picture(right, **changes)
    assert wanted[:, :18, 3].max() == 1 == wanted[:, 18:, 3].max()
    np.testing.assert_allclose(seen, wanted, atol=1e-5)


def test_the_engines_agree(two: tuple[ms.Scene, ms.Scene, ms.Scene]):
    ours, theirs = picture(two[0], pixel_samples=16), picture(two[0], "mitsuba", spp=256, density="network")
    for columns in (slice(0, 18), slice(18, 36)):
        assert ours[:, columns, :3].mean() > 0.01
        np.testing.assert_allclose(ours[:, columns].mean(axis=(0, 1)), theirs[:, columns].mean(axis=(0, 1)), rtol=0.03)


def test_settled_it_is_the_same(two: tuple[ms.Scene, ms.Scene, ms.Scene]):
    still = settle(two[0])
    assert isinstance(still.also[0].mesh, Mesh) and still.also[0].thickness == 0.2
    np.testing.assert_array_equal(picture(still), picture(two[0]))


def test_its_facts_are_of_all(two: tuple[ms.Scene, ms.Scene, ms.Scene]):
    effects = ms.explain(two[0])
    assert "2 shells" in str(effects) and effects.corner_tiles.on and effects.varying_parameters.on
    alone = ms.explain(two[1])
    assert not alone.corner_tiles.on and alone.varying_parameters.on
    assert ms.render(two[0], "draft", max_samples=1).report["material"]["also"][0]["name"] == "tiles"


def test_the_default_camera_shows_all(tiny_bundle: Bundle):
    material = Material("tiny", tiny_bundle)
    alone = describe_shell(ms.Scene(plate(0, 0, 0), material)).camera
    both = describe_shell(ms.Scene(plate(0, 0, 0), material, also=[ms.Grown(plate(9, 0, 0), material)])).camera
    assert np.linalg.norm(both.to_world[:3, 3]) > 4 * np.linalg.norm(alone.to_world[:3, 3])


def test_nodes_of_a_file_carry_materials_of_their_own(tiny_bundle: Bundle):
    """A node that hangs on another is its own material's; what no name covers is the scene's, or stands bare."""
    material = Material("tiny", tiny_bundle)
    file = DATA / "blender.glb"

    def counts(grow: tuple[str, ...], *others: tuple[str, ...]) -> list[int]:
        scene = unpack(ms.Scene(file, material, grow=grow, also=[ms.Grown(None, material, grow=x) for x in others]))
        assert unpack(scene) is scene
        meshes: list[Any] = [scene.mesh, *(x.mesh for x in scene.also), *scene.objects]
        return [len(x.faces) for x in meshes]

    assert counts(("Hill",), ("Stone",)) == [120, 24]
    assert counts((), ("Stone",)) == [120, 24]
    assert counts(("Stone",), ("Moss",)) == [12, 12, 120]
    assert counts(("Moss",), ("Stone",), ("Hill",)) == [12, 12, 120]
    with pytest.raises(InputError, match="two materials are given for 'Hill'"):
        counts(("Hill",), ("Hill",))
    with pytest.raises(InputError, match="none is left for the scene's own"):
        counts((), ("Hill",), ("Stone",))


def test_written_for_mitsuba_it_is_the_same(two: tuple[ms.Scene, ms.Scene, ms.Scene], tmp_path: Path):
    both, _, _ = two
    kept = {}
    for one in (both.material, both.also[0].material):
        write_bundle(tmp_path / f"{one.name}.npz", one.shell)
        kept[one.name] = ms.load_material(tmp_path / f"{one.name}.npz")
    also = [replace(both.also[0], material=kept["tiles"], params={"dryness": np.full((2, 2), 0.75, np.float32)})]
    scene = replace(both, material=kept["patch"], also=also)
    path = ms.write_scene(scene, tmp_path / "made")
    names = {"scene.xml", "mesh.obj", "mesh1.obj", "material.npz", "material1.npz", "param0.exr", "param1_0.exr"}
    assert {file.name for file in path.parent.iterdir()} == names
    quality: Quality = QUALITY.with_changes(spp=64)
    made = ms.mitsuba.load_file(path, quality)
    import mitsuba as mi

    found, wanted = np.array(mi.render(made, spp=64)), picture(scene, "mitsuba", spp=64)
    for columns in (slice(0, 18), slice(18, 36)):
        np.testing.assert_allclose(found[:, columns].mean(axis=(0, 1)), wanted[:, columns].mean(axis=(0, 1)), rtol=0.03)


def test_a_surface_material_stands_beside_a_shell(tiny_bundle: Bundle):
    """By engine mitsuba: each is what it is alone, where neither is before the other."""
    shell, cloth = Material("tiny", tiny_bundle), Material("dots", wearing.constant(0.7, (0.2, 0.1, 0.05)))
    left, right = plate(-2, 0, 0), plate(1, 0, 0)
    at: Any = {"camera": (0.0, -2.0, 12.0, 0.0, 0.5, 0.0, 10.0), "size": (36, 12), "lights": [(0.2, 0.3, 1.0)]}
    both = ms.Scene(left, shell, thickness=0.3, scale=0.5, **at, also=[ms.Grown(right, cloth, scale=0.5)])
    alone = ms.Scene(left, shell, thickness=0.3, scale=0.5, **at), ms.Scene(right, cloth, scale=0.5, **at)
    how: Any = {"spp": 256, "density": "network"}
    found, each = picture(both, "mitsuba", **how), [picture(one, "mitsuba", **how) for one in alone]
    assert each[0][:, :18, 3].max() == 1 and 0.5 < each[1][:, 18:, 3].max() < 1
    for columns, wanted in ((slice(0, 18), each[0]), (slice(18, 36), each[1])):
        np.testing.assert_allclose(found[:, columns].mean(axis=(0, 1)), wanted[:, columns].mean(axis=(0, 1)), rtol=0.04)
    np.testing.assert_array_equal(picture(settle(both), "mitsuba", **how), found)
    plan: Any = ms.explain(both, engine="mitsuba")
    assert plan.shells.on and plan.surface_materials.on and plan.opacity.on


def test_what_cannot_be_is_said(tiny_bundle: Bundle):
    shell, surface = Material("tiny", tiny_bundle), Material("dots", wearing.bundle())
    mesh = plate(0, 0, 0)

    def beside(**more: Any) -> ms.Scene:
        return ms.Scene(mesh, shell, also=[ms.Grown(mesh, surface, **more)])

    for make, said in (
        (lambda: ms.Grown(mesh, surface, thickness=0.1), "^dots:thickness: dots is a surface material: it has none"),
        (lambda: ms.Grown(mesh, surface, params={"x": 1.0}, name="rug"), "^rug:params: dots is a surface material"),
        (
            lambda: ms.explain(ms.Scene(mesh, shell, also=[ms.Grown(mesh, surface)])),
            "^also: dots is a surface material: be",
        ),
        (
            lambda: ms.stability(ms.Scene(mesh, shell, also=[ms.Grown(mesh, surface)])),
            "^also: dots is a surface material",
        ),
        (lambda: ms.explain(beside(scale=0.0), engine="mitsuba"), "^dots:scale: must be above 0"),
        (lambda: ms.Scene(mesh, surface, also=[ms.Grown(mesh, shell)]), "^also: dots is a surface material"),
        (lambda: ms.Grown(None, shell), "^also: tiny takes either a mesh or `grow`"),
        (lambda: ms.Grown(mesh, shell, grow=["Rug"]), "^also: tiny takes either a mesh or `grow`"),
        (lambda: ms.Grown(None, shell, grow="Rug"), "^grow: must be a list"),
    ):
        with pytest.raises(InputError, match=said):
            make()
    for further, said in (
        (ms.Grown(mesh, shell, params={"wet": 1.0}), "^tiny:params: "),
        (ms.Grown(mesh, shell, thickness=-1.0), "^tiny:thickness: must be positive"),
        (ms.Grown(mesh, shell, seed=1), "^tiny:seed: tiny is one texture"),
        (ms.Grown(None, shell, grow=["Rug"]), "^grow: names meshes of a glTF file or a USD stage"),
        (ms.Grown("none.obj", shell), "^none.obj: no such file"),
    ):
        for use in (describe_shell, settle, ms.explain):
            if use is settle and further.seed is not None:
                continue  # a seed is looked at when textures are laid
            with pytest.raises(InputError, match=said):
                use(ms.Scene(mesh, shell, also=[further]))


def test_options_name_them(tiny_bundle: Bundle, tmp_path: Path):
    odd, moss = tmp_path / "a=b.obj", tmp_path / "lr=1" / "moss.npz"
    odd.write_text("")
    moss.parent.mkdir()
    write_bundle(moss, tiny_bundle)
    options = Options(
        Path("room.glb"),
        grow=("Hill", "Rug=carpet", "Mat=carpet", f"Stone=old={moss}"),
        object=(Path("stone.obj"), Path("cat.obj=fur"), odd),
        param=("age=0.3", "carpet:lean=0.5", "carpet:scale=0.1", "fur:seed=3", "fur:length=0.4", f"{moss}:scale=0.2"),
    )
    named = grown_of(options, ms.load_material("grass"))
    assert named.grow == ("Hill",) and named.objects == (Path("stone.obj"), odd) and named.params == {"age": "0.3"}
    rug, stone, cat = named.also
    assert (stone.material.name, stone.grow, stone.scale) == (str(moss), ("Stone=old",), 0.2)
    assert (rug.material.name, rug.grow, rug.mesh, rug.scale) == ("carpet", ("Rug", "Mat"), None, 0.1)
    assert rug.params == {"lean": "0.5"} and cat.params == {"length": "0.4"}
    assert (cat.material.name, cat.mesh, cat.seed, cat.thickness) == ("fur", Path("cat.obj"), 3, None)
    scene = ms.Scene("room.glb", rug.material, also=named.also, camera=ms.Camera(np.eye(4), 0.7, 8, 8), up="y")
    words = command(scene, scene, first_look(scene), "jax", 4).split()
    for text in ("Rug=carpet", "Mat=carpet", "carpet:lean=0.5", "carpet:scale=0.1", "cat.obj=fur", "cat:length=0.4"):
        assert text in words


def test_names_are_of_one_thing_each():
    """A stem that names something else too is no name; a node that is called as a material is not set apart."""
    options = Options(
        Path("room.glb"),
        grow=("Rug=carpet", "fur=carpet", "Mat=carpet", "Hill=turf"),
        object=(Path("a/leaf.obj=fur"), Path("b/leaf.obj=fur"), Path("Hill.obj=pelt"), Path("turf.obj=pelt")),
        param=("fur:length=0.4", "b/leaf.obj:length=0.2", "fur:growth=g.png", "a/leaf.obj:growth=none", "Hill:age=0.7"),
    )
    group, hill, a, b, over, stem = grown_of(options, ms.load_material("grass")).also
    assert (group.called, group.grow, hill.called, hill.params) == (
        "carpet",
        ("Rug", "fur", "Mat"),
        "Hill",
        {"age": "0.7"},
    )
    assert [x.called for x in (a, b, over, stem)] == ["a/leaf.obj", "b/leaf.obj", "Hill.obj", "turf.obj"]
    assert (a.params, b.params, over.params) == ({"length": "0.4"}, {"length": "0.2"}, {})
    assert (a.growth, b.growth) == (None, "g.png")
    with pytest.raises(InputError, match=r"leaf:length: leaf is not among the further materials: these are"):
        grown_of(replace(options, param=("leaf:length=0.2",)), ms.load_material("grass"))


@pytest.mark.parametrize("mown", [False, True])
def test_a_command_names_the_same_scene(mown: bool):
    """What the viewer says is read back as what it was said of: no value is another mesh's too."""
    options = Options(
        Path("room.glb"),
        grow=("Rug=carpet", "Mat=carpet", "Cat=carpet"),
        object=(Path("far/a.obj=fur"), Path("b.obj=fur")),
        param=(
            "Cat:lean=0.2",
            "a:length=0.3",
            "b:seed=4",
            *(("carpet:growth=g.png", "Cat:growth=none") if mown else ()),
        ),
    )
    also = grown_of(options, ms.load_material("grass")).also
    scene = ms.Scene("room.glb", ms.load_material("grass"), also=also, camera=ms.Camera(np.eye(4), 0.7, 8, 8), up="y")
    look = first_look(
        replace(scene, also=[replace(x, params={k: float(str(v)) for k, v in x.params.items()}) for x in also])
    )
    words = shlex.split(command(scene, scene, look, "jax", 4))
    read: Any = {name: tuple(b for a, b in pairwise(words) if a == f"--{name}") for name in ("grow", "object", "param")}
    read["object"] = tuple(map(Path, read["object"]))
    again = grown_of(replace(options, **read), ms.load_material("grass")).also
    for one, other in zip(also, again, strict=True):
        assert (one.called, one.grow, one.mesh, one.growth) == (other.called, other.grow, other.mesh, other.growth)
        assert all(float(str(other.params[k])) == float(str(x)) for k, x in one.params.items())
        assert (one.seed or 0) == (other.seed or 0)


def test_each_mesh_of_a_material_has_values_of_its_own():
    """A node's or a file's count more than its material's, wherever they stand."""
    options = Options(
        Path("room.glb"),
        grow=("Rug=carpet", "Mat=carpet", "ns:Cat=carpet"),
        object=(Path("far/a.obj=fur"), Path("b.obj=fur")),
        param=(
            "a:length=0.2",
            "fur:length=0.4",
            "fur:thickness=0.1",
            "Rug:lean=0.3",
            "carpet:lean=0.1",
            "ns:Cat:seed=2",
        ),
    )
    mats, rug, cat, a, b = grown_of(options, ms.load_material("grass")).also
    assert [x.grow for x in (mats, rug, cat)] == [("Mat",), ("Rug",), ("ns:Cat",)]
    assert [x.called for x in (mats, rug, cat, a, b)] == ["Mat", "Rug", "ns:Cat", "a", "b"]
    assert [x.params for x in (mats, rug, cat)] == [{"lean": "0.1"}, {"lean": "0.3"}, {"lean": "0.1"}] and cat.seed == 2
    assert (a.params, b.params) == ({"length": "0.2"}, {"length": "0.4"}) and a.thickness == b.thickness == 0.1


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            ["--param", "carpet:lean=0.5"],
            "--param: carpet:lean: carpet is not among the further materials: there is none",
        ),
        (["--object", "x.obj=fur", "--param", "carpet:lean=1"], "these are fur"),
        (["--object", "x.obj=fur", "--param", "fur:scale=wide"], "--param: fur:scale must be a number, not wide"),
        (["--object", "x.obj=fur", "--param", "fur:seed=1.5"], "--param: fur:seed must be a whole number, not 1.5"),
        (
            ["--object", "x.obj=fur", "--param", "fur:latent=3"],
            "--param: fur:latent must be SEED,SHARE, as 8,0.5, not 3",
        ),
        (["--object", "x.obj=hay"], "hay"),
        (["--grow", "Rug=fur"], "--grow: names meshes of a glTF file or a USD stage"),
        (["--grow", "Rug="], "--grow: names meshes of a glTF file or a USD stage"),
    ],
)
def test_the_command_says_its_faults(options: list[str], said: str, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as caught:
        main(["render", str(DATA / "spot.obj"), *options])
    fault = capsys.readouterr().err
    assert caught.value.code == 2 and fault.count("\n") == 1 and said in fault


def test_the_command_grows_two(tiny_bundle: Bundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    write_bundle(Path("tiny.npz"), tiny_bundle)
    given = [
        "--material",
        "tiny.npz",
        "--grow",
        "Stone=tiny.npz",
        "--param",
        "tiny.npz:dryness=1.5",
        "--size",
        "24",
        "16",
    ]
    main(["render", str(DATA / "blender.glb"), *given, "--quality", "draft", "--out", "two"])
    record = json.loads(Path("two.json").read_text())
    assert [x["parameters"] for x in record["material"]["also"]] == [{"dryness": "1.5"}]


def test_meshes_of_one_material_share_it(two: tuple[ms.Scene, ms.Scene, ms.Scene]):
    """Rocks of one moss are decoded by one program, called once a wave; a rock of other values apart."""
    both, _, _ = two
    more = [replace(both.also[0], mesh=plate(k, 3, 0)) for k in range(3)]
    dry = replace(both.also[0], mesh=plate(0, 6, 0), params={"dryness": 2.0})
    made = marched_scene(describe_shell(replace(both, also=[*more, dry])))
    renderer = _Renderer(made, QUALITY, plan_effects(facts(made), QUALITY), RenderReport())
    assert [len(made.media), len(renderer.media.each)] == [5, 3]
    prisms = np.array([m.prism for m in made.media])
    parts = {id(decoding): own.tolist() for decoding, own in renderer.media.parts(prisms)}
    assert sorted(parts.values()) == [[0], [1, 2, 3], [4]]
    assert made.media[1].device_material is made.media[4].device_material


def test_a_mesh_shades_anothers_shell(two: tuple[ms.Scene, ms.Scene, ms.Scene]):
    """As it does where nothing grows on it, ground and shell; and it is no object, which holdout would leave out."""
    _, left, _ = two
    roof = plate(-1.5, 0, 5)
    at: Any = {"camera": (-1.5, -4.0, 2.0, -1.5, 0.5, 0.0, 16.0), "lights": [(0.0, 0.0, 1.0)]}
    lit, bare = replace(left, **at), replace(left, **at, objects=[roof])
    grown = replace(lit, also=[ms.Grown(roof, left.material, thickness=0.1, scale=0.5)])
    pictures = [picture(scene) for scene in (lit, bare, grown, replace(grown, holdout=True))]
    np.testing.assert_allclose(pictures[2], pictures[1], atol=1e-6)
    np.testing.assert_array_equal(pictures[3], pictures[2])
    assert pictures[1][..., :3].sum() < 0.7 * pictures[0][..., :3].sum()
    held = replace(left, objects=[plate(1, 0, 0)], holdout=True, also=[ms.Grown(plate(-0.5, 0, 0), left.material)])
    alpha = picture(held)[..., 3]
    assert alpha[:, 26:].max() == 0 and alpha[:, :26].max() == 1


def test_a_part_is_enclosed_as_it_is_alone(tiny_bundle: Bundle):
    """A tube sees itself in half of the directions, and does beside a field of a thousand times its area."""
    material = Material("tiny", tiny_bundle)
    tube = wearing.turned(wearing.moved(wearing.tube(0.4, 1.0), 0, 0, 3))
    field = replace(wearing.square(), vertices=(100 * wearing.square().vertices).astype(np.float32))
    alone, beside = (
        facts(marched_scene(describe_shell(scene))).enclosed
        for scene in (
            ms.Scene(tube, material, thickness=0.05),
            ms.Scene(field, material, thickness=0.05, also=[ms.Grown(tube, material, thickness=0.05)]),
        )
    )
    assert alone > 0.3 and beside > alone - 0.05


def test_a_setting_of_one_regrows_no_other(monkeypatch: pytest.MonkeyPatch):
    """Nor does a film of wind, nor a viewer's slider."""
    growing.without_grids(monkeypatch)
    carpet, lawn = (Material(name, growing.bundle()) for name in ("carpet", "lawn"))
    scene = ms.Scene(plate(0, 0, 0), carpet, thickness=0.5, also=[ms.Grown(plate(2, 0, 0), lawn, thickness=0.5)])
    begun = settle(scene, texture=False)
    still = with_textures(begun, but=(0,))
    assert grows(begun.also[0]) and not grows(still.also[0]) and grows(still)
    again = settle(still)
    assert again.also[0].material is still.also[0].material and not grows(again)
