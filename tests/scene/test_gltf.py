"""A glTF file's camera and suns stand in the place of defaults, and the material grows on the nodes that are named.

`data/blender.glb` was written by Blender 5.0: a hill of two materials, a stone on which moss hangs, a camera on a turned and
scaled rig, a sun of 3 W/m² and a lamp. Blender's own numbers are below, in its frame: z up, so that x, y, z is x, z, −y here.
"""

import base64
import copy
import io
import json
import math
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation
from trimesh.visual.material import PBRMaterial

import mesoshell as ms
from mesoshell.errors import InputError
from mesoshell.geometry.image_texture import Look
from mesoshell.geometry.mesh import load_mesh, load_nodes
from mesoshell.geometry.read import read_mesh, read_nodes
from mesoshell.io.bundle import Bundle
from mesoshell.scene.gltf import LUX
from mesoshell.scene.materials import Material
from mesoshell.scene.settle import settle
from mesoshell.scene.unpack import read_scene_file, unpack
from tests.helpers import wearing

FILE = Path(__file__).parents[1] / "data" / "blender.glb"
#: `matrix_world` of the camera, without its parent's scale of 2, and of the sun.
CAMERA = np.array(
    [
        [1.1682448387145996, -0.11945131421089172, 1.6189303398132324, 2 * 6.374393463134766],
        [1.5946787595748901, 0.4575403034687042, -1.1169852018356323, 2 * -3.933154821395874],
        [-0.3036503195762634, 1.9432930946350098, 0.3625028133392334, 2 * 1.817082166671753],
    ]
) / 2  # fmt: skip
SUN = np.array([0.22134041786193848, -0.45962458848953247, 0.8600893616676331])
FROM_BLENDER = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])


@pytest.fixture
def material(tiny_bundle: Bundle) -> Material:
    return Material("tiny", tiny_bundle)


def test_blenders_camera_and_sun():
    told = read_scene_file(FILE)
    assert told.camera is not None
    np.testing.assert_allclose(told.camera[0][:3], FROM_BLENDER @ CAMERA, atol=1e-6)
    assert told.camera[1] == pytest.approx(2 * math.atan(36 * 54 / 96 / 2 / 45)) and told.aspect == pytest.approx(
        96 / 54
    )
    (sun,) = told.suns
    np.testing.assert_allclose(sun.direction, FROM_BLENDER @ SUN, atol=1e-6)
    np.testing.assert_allclose(sun.irradiance, [3, 1.5, 0.75])
    (lamp,) = told.lamps
    assert lamp.kind == "point" and not told.notes


def test_they_take_the_place_of_defaults(material: Material):
    scene = ms.Scene(FILE, material, size=(96, 54))
    still, told = settle(scene), read_scene_file(FILE)
    assert isinstance(still.camera, ms.Camera) and told.camera is not None
    np.testing.assert_array_equal(still.camera.to_world, told.camera[0])
    assert (still.camera.width, still.camera.height, still.camera.fov) == (96, 54, told.camera[1])
    assert [x.irradiance.tolist() for x in still.lights if isinstance(x, ms.Distant)] == [[3, 1.5, 0.75]]
    own = ms.Camera(ms.look_at((4.0, 3.0, 5.0), (0.0, 0.0, 0.0)), 0.7, 20, 16)
    other = settle(replace(scene, camera=own, lights=[(0.0, 1.0, 0.0)]))
    assert other.camera is own and len(other.lights) == 1 and other.lights[0].irradiance[0] == scene.irradiance  # type: ignore[union-attr]
    assert len(unpack(replace(scene, environment=np.ones((2, 4, 3), np.float32))).lights) == 1
    assert not unpack(replace(scene, suns=False)).lights
    once = unpack(scene)
    assert unpack(once) is once and unpack(still) is still


def test_other_proportions_are_said(material: Material):
    def notes(size: tuple[int, int]) -> str:
        mesh: Any = unpack(ms.Scene(FILE, material, size=size)).mesh
        return "\n".join(mesh.notes)

    assert "its camera is 1.78 times as wide as high: --size 512 288" in notes((512, 512))
    assert "wide as high" not in notes((512, 288))


@pytest.mark.parametrize(
    ("names", "grown"),
    [(("Hill",), 120), (("Moss",), 12), (("Stone",), 24), (("Stone", "Hill"), 144), (("m0",), 60), (("m1", "m0"), 120)],
)
def test_the_material_grows_on_what_is_named(material: Material, names: tuple[str, ...], grown: int):
    """A node has all its materials' triangles, and what hangs on it; a material has its own."""
    scene = unpack(ms.Scene(FILE, material, grow=names))
    whole = load_mesh(FILE)
    meshes: list[Any] = [scene.mesh, *scene.objects]
    assert len(meshes[0].faces) == grown and sum(len(m.faces) for m in meshes[1:]) == 144 - grown
    assert all(m.colour == pytest.approx((0.8,) * 3) for m in meshes[1:] if len(m.faces) > 24)
    together = np.concatenate([m.vertices[m.faces].reshape(-1, 9) for m in meshes])
    wanted = whole.vertices[whole.faces].reshape(-1, 9)
    assert len(together) == len(wanted)
    near = np.abs(together[:, None].reshape(-1, 1, 3, 3).mean(axis=2) - wanted.reshape(1, -1, 3, 3).mean(axis=2)).max(
        -1
    )
    assert near.min(axis=1).max() < 1e-6


@pytest.mark.slow  # nodes are told apart below, and test_also grows two of such a file by the command
def test_a_picture_of_a_blender_scene(material: Material):
    """As one of the same scene in loaded parts."""
    scene = ms.Scene(FILE, material, size=(48, 27), grow=("Hill",), thickness=0.1, scale=0.2)
    apart = unpack(scene)
    assert apart.grow == () and len(apart.objects) == 1
    one, other = (ms.render(s, "draft", max_samples=1) for s in (scene, apart))
    np.testing.assert_array_equal(one.rgba, other.rgba)
    assert one.rgba[..., 3].max() == 1 and any("a lamp is near" in note for note in one.notes)
    bare = ms.render(replace(scene, grow=()), "draft", max_samples=1)
    assert np.abs(bare.rgba - one.rgba).max() > 0.01  # the stone is grown over too


def test_a_name_that_is_not_there(material: Material):
    with pytest.raises(InputError, match=r"has no mesh named 'Hil': its names are Hill, Moss, Stone, m0, m1$"):
        unpack(ms.Scene(FILE, material, grow=("Hil",)))
    with pytest.raises(InputError, match=r"^grow: names meshes of a glTF file or a USD stage"):
        unpack(ms.Scene(FILE.with_name("spot.obj"), material, grow=("Hill",)))


def written(folder: Path, header: Any) -> Path:
    path = folder / "a.gltf"
    path.write_text(json.dumps(header))
    return path


def lit(node: dict, light: dict) -> dict:
    node = node | {"extensions": {"KHR_lights_punctual": {"light": 0}}}
    return {"nodes": [node], "extensions": {"KHR_lights_punctual": {"lights": [light]}}}


def seen(node: dict) -> dict:
    return {"nodes": [node | {"camera": 0}], "cameras": [{"type": "perspective", "perspective": {"yfov": 1}}]}


finite = st.floats(-2, 2).map(lambda x: round(x, 3))


@given(st.tuples(*[finite] * 4).filter(lambda q: sum(x * x for x in q) > 0.01), st.tuples(*[st.floats(0.1, 3)] * 3))
def test_a_turned_node_turns_its_camera(tmp_path_factory: pytest.TempPathFactory, q: tuple, scale: tuple):
    """Oracle: scipy's rotation of the same quaternion."""
    lens = {"type": "perspective", "perspective": {"yfov": 0.5}}
    node = {"camera": 0, "rotation": q, "translation": [1, 2, 3], "scale": [scale[0]] * 3}
    told = read_scene_file(written(tmp_path_factory.mktemp("x"), {"nodes": [node], "cameras": [lens]}))
    assert told.camera is not None and told.aspect is None
    np.testing.assert_allclose(told.camera[0][:3, :3], Rotation.from_quat(q).as_matrix(), atol=1e-9)
    np.testing.assert_array_equal(told.camera[0][:3, 3], [1, 2, 3])


def test_transforms_of_parents_are_applied_and_matrices_go_by_columns(tmp_path: Path):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_euler("xyz", [0.3, 0.5, -0.2]).as_matrix(), [4, 5, 6]
    nodes = [
        {"matrix": matrix.T.ravel().tolist(), "children": [1]},
        {"translation": [0, 0, 2], "scale": [-3, 3, 3], "camera": 0},
    ]
    lens = {"type": "perspective", "perspective": {"yfov": 0.5}}
    header = {"nodes": nodes, "cameras": [lens], "scenes": [{"nodes": []}, {"nodes": [0]}], "scene": 1}
    camera = read_scene_file(written(tmp_path, header)).camera
    assert camera is not None
    np.testing.assert_allclose(camera[0][:3, 3], matrix[:3] @ [0, 0, 2, 1])
    np.testing.assert_allclose(camera[0][:3, 2], matrix[:3, 2], atol=1e-12)
    assert np.linalg.det(camera[0]) == pytest.approx(1)  # a mirrored node mirrors no picture
    assert read_scene_file(written(tmp_path, header | {"scene": 0})).camera is None


def test_a_suns_strength_is_in_lux(tmp_path: Path):
    (sun,) = read_scene_file(written(tmp_path, lit({}, {"type": "directional", "intensity": 2 * LUX}))).suns
    np.testing.assert_allclose(sun.direction, [0, 0, 1])
    np.testing.assert_allclose(sun.irradiance, 2)


@pytest.mark.parametrize(
    ("light", "cone"),
    [
        ({"type": "point"}, (0.0, 0.0)),
        ({"type": "spot"}, (0.0, math.pi / 4)),
        ({"type": "spot", "spot": {"innerConeAngle": 0.3, "outerConeAngle": 0.5}}, (0.3, 0.5)),
    ],
    ids=["point", "spot", "cone"],
)
def test_a_lamps_strength_is_in_candela(tmp_path: Path, light: dict, cone: tuple):
    light = light | {"intensity": 2 * LUX, "color": [1, 0.5, 0]}
    (lamp,) = read_scene_file(written(tmp_path, lit({"translation": [1, 2, 3]}, light))).lamps
    assert lamp.kind == light["type"] and lamp.cone == cone
    np.testing.assert_allclose(lamp.strength, [2, 1, 0])
    np.testing.assert_allclose(lamp.pose[:3, 3], [1, 2, 3])


@pytest.mark.parametrize(
    ("node", "light", "said"),
    [
        ({}, {"type": "point", "intensity": -1}, "its lamp Odd is left out: a point takes a strength of three numbers"),
        (
            {},
            {"type": "spot", "spot": {"innerConeAngle": 2, "outerConeAngle": 1}},
            "its lamp Odd is left out: a spot takes",
        ),
        ({"translation": [1e300, 0, 0]}, {"type": "point"}, "its lamp Odd is left out: a point takes a pose"),
        ({"scale": [0, 0, 0]}, {"type": "spot"}, ""),
        ({}, {"type": "point", "intensity": 0}, ""),
    ],
    ids=["negative", "cone", "far", "hidden", "dark"],
)
def test_a_lamp_that_cannot_be_does_not_stop_the_scene(tmp_path: Path, node: dict, light: dict, said: str):
    told = read_scene_file(written(tmp_path, lit({"name": "Odd"} | node, light)))
    assert not told.lamps and len(told.notes) == bool(said) and "".join(told.notes).startswith(said)


def test_faint_lamps_that_light_a_scene_alone_are_said(material: Material, tmp_path: Path):
    nodes: list[dict] = [{"name": "a", "mesh": 0, "children": [1]}, lit({"translation": [0, 0, 5]}, {})["nodes"][0]]
    header = triangles(nodes) | lit({}, {"type": "point", "intensity": 1.0}) | {"nodes": nodes}
    path = written(tmp_path, header)
    sky = np.ones((2, 4, 3), np.float32)
    given: list[tuple[Any, bool]] = [({}, True), ({"suns": False}, False), ({"environment": sky}, False)]
    for more, faint in given:
        mesh: Any = unpack(ms.Scene(path, material, **more)).mesh
        assert any("its lamps are faint" in note for note in mesh.notes) == faint


def test_lights_of_other_kinds_are_said(tmp_path: Path):
    told = read_scene_file(written(tmp_path, lit({"name": "Tube"}, {"type": "tube"})))
    assert told.notes == ("its lights of other kinds are left out: Tube",) and not told.lamps


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ({"nodes": [{"skin": 0}]}, ["its skins move nothing"]),
        ({"nodes": [{"mesh": 0}], "meshes": [{"weights": [0, 1]}]}, ["its morph targets move nothing"]),
        ({"nodes": [{"mesh": 0}], "meshes": [{"weights": [0, 0]}]}, []),
        (
            {"nodes": [{"extensions": {"EXT_mesh_gpu_instancing": {}}}]},
            ["its instances (EXT_mesh_gpu_instancing) are read as one mesh"],
        ),
    ],
)
def test_what_moves_or_repeats_meshes_and_is_not_read_is_said(tmp_path: Path, header: dict, said: list[str]):
    assert list(read_scene_file(written(tmp_path, header)).notes) == said


def test_what_cannot_be_taken_is_said(tmp_path: Path):
    cameras = [{"type": "orthographic"}, *[{"type": "perspective", "perspective": {"yfov": 0.5 + k}} for k in (0, 1)]]
    nodes = [{"camera": k, "name": name} for k, name in enumerate(("plan", "wide", "near"))]
    told = read_scene_file(written(tmp_path, {"nodes": nodes, "cameras": cameras}))
    assert told.camera is not None and told.camera[1] == 0.5
    assert told.notes == (
        "its camera plan is no perspective one: left out",
        "it has 2 cameras: wide, the first, is taken",
    )


@pytest.mark.parametrize(
    "header",
    [
        {"nodes": [{"camera": 3}], "cameras": []},
        {"nodes": [{"camera": 0}], "cameras": [{"type": "perspective"}]},
        {"nodes": [{"camera": 0}], "cameras": [{"type": "perspective", "perspective": {"yfov": 4.0}}]},
        seen({"scale": [0, 0, 0]}),
        seen({"translation": [1e300, 0, 0]}),
        seen({"matrix": [1, 2]}),
        lit({"scale": [0, 0, 0]}, {"type": "directional"}),
        lit({}, {"type": "directional", "color": "red"}),
        {"nodes": [{"children": [7]}]},
        {"nodes": 3},
        [],
    ],
    ids=str,
)
def test_damaged_cameras_and_lights_are_one_line(tmp_path: Path, header: Any):
    path = written(tmp_path, header)
    with pytest.raises(InputError, match="its cameras or lights cannot be read: ") as raised:
        read_scene_file(path)
    assert str(raised.value).startswith(str(path)) and "\n" not in str(raised.value)


def test_nodes_that_go_round_end(tmp_path: Path):
    assert read_scene_file(written(tmp_path, {"nodes": [{"children": [1]}, {"children": [0]}]})).camera is None


def test_a_header_without_its_end_is_one_line(tmp_path: Path):
    data = FILE.read_bytes()
    path = tmp_path / "short.glb"
    path.write_bytes(data[:12] + struct.pack("<I", 40) + data[16:])
    with pytest.raises(InputError) as raised:
        read_scene_file(path)
    assert "\n" not in str(raised.value)


def test_what_is_held_out_lies_under_the_picture(material: Material):
    """Over a picture of the objects alone it is the whole picture, where no grass stands before them or behind."""
    scene = ms.Scene(FILE, material, size=(96, 54), grow=("Hill",), thickness=0.05, scale=0.2)
    changes: Any = {"max_samples": 1, "light_samples": 0}
    whole, held = (ms.render(replace(scene, holdout=h), "draft", **changes).rgba for h in (False, True))
    gone = whole[..., 3] - held[..., 3]
    assert (gone > 0.99).mean() > 0.02 and gone.min() > -1e-6
    np.testing.assert_array_equal(held[gone > 0.99], 0)
    kept = gone < 1e-6
    assert 0.2 < kept.mean() < 1
    np.testing.assert_array_equal(held[kept], whole[kept])
    sky = np.ones((2, 4, 3), np.float32)
    under = ms.render(replace(scene, holdout=True, environment=sky), "draft", **changes).rgba
    assert under[..., 3].max() == 1 and under[gone > 0.99][..., 3].max() < 1e-6


def test_only_marched_shells_hold_out(material: Material, tmp_path: Path):
    scene = ms.Scene(FILE, material, holdout=True)
    with pytest.raises(InputError, match=r"^holdout: objects are held out by `engine` jax alone"):
        ms.render(scene, "draft", engine="mitsuba")
    with pytest.raises(InputError, match=r"^holdout: dots is a surface material"):
        ms.render(replace(scene, material=Material("dots", wearing.bundle())), "draft")
    with pytest.raises(InputError, match=r"^holdout: a scene of Mitsuba's holds no objects out"):
        ms.write_scene(scene, tmp_path / "scene")
    assert not (tmp_path / "scene").exists()


TRIANGLE = base64.b64encode(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32).tobytes()).decode()
LENS = {"type": "perspective", "perspective": {"yfov": 0.5}}


def triangles(nodes: list[dict]) -> dict:
    """A header whose nodes with a mesh each have the triangle (0, 0, 0), (1, 0, 0), (0, 1, 0)."""
    view = {"buffer": 0, "byteLength": 36}
    accessor = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}
    return {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": 36, "uri": f"data:application/octet-stream;base64,{TRIANGLE}"}],
        "bufferViews": [view],
        "accessors": [accessor],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "cameras": [LENS],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
        "nodes": nodes,
    }


def test_a_mesh_may_hang_on_a_camera(tmp_path: Path):
    """trimesh takes cameras out of its graph, with what hangs on them."""
    nodes = [
        {"name": "Rig", "translation": [5, 0, 0], "children": [1]},
        {"name": "Camera", "camera": 0, "translation": [0, 7, 0], "children": [2], "mesh": 0},
        {"name": "Camera", "mesh": 0, "translation": [0, 0, 9]},
    ]
    path = written(tmp_path, triangles(nodes))
    points, faces, _ = read_mesh(path)
    assert len(faces) == 2
    np.testing.assert_allclose(np.sort(points[:, 2]), [0, 0, 0, 9, 9, 9])
    np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], [[5, 7, 0], [6, 8, 9]])
    camera = read_scene_file(path).camera
    assert camera is not None
    np.testing.assert_allclose(camera[0][:3, 3], [5, 7, 0])


def test_names_are_the_files(tmp_path: Path):
    """They need not be unique; trimesh's are."""
    nodes: list[dict] = [{"name": "world", "children": [1, 2, 3, 4]}]
    nodes += [{"name": name, "mesh": 0, "translation": [k, 0, 0]} for k, name in enumerate(("Tree", "Tree", "Rock"))]
    path = written(tmp_path, triangles([*nodes, {"mesh": 0, "translation": [9, 0, 0]}]))
    grown, others = read_nodes(path, [("Tree",)])
    ((rest, look),) = others
    assert len(grown[0][1]) == 2 and len(rest[1]) == 2 and look == Look()
    assert len(read_nodes(path, [("world",)])[0][0][1]) == 4
    with pytest.raises(InputError, match=r"its names are Rock, Tree, node 4, world$"):
        read_nodes(path, [("Bush",)])


@pytest.mark.parametrize("textured", [False, True])
def test_what_nothing_grows_on_has_its_materials_colours(tmp_path: Path, textured: bool):
    """Of an image the mean, as light: half of it is white."""
    names = ("Ground", "Red", "Black", "Red too", "Bare")
    nodes: list[dict] = [{"name": name, "mesh": k, "translation": [k, 0, 0]} for k, name in enumerate(names)]
    header: dict[str, Any] = triangles(nodes) | {"scenes": [{"nodes": [*range(5)]}]}
    (mesh,) = header["meshes"]
    pbr: list[dict] = [{"baseColorFactor": [0.6, 0.1, 0.0, 1]}, {"baseColorFactor": [0, 0, 0, 1]}]
    header["materials"] = [{"name": f"m{k}", "pbrMetallicRoughness": x} for k, x in enumerate(pbr)]
    header["meshes"] = [copy.deepcopy(mesh) for _ in nodes]
    for k, material in ((1, 0), (2, 1), (3, 0)):
        header["meshes"][k]["primitives"][0]["material"] = material
    if textured:
        data = io.BytesIO()
        Image.fromarray(np.repeat(np.array([[0, 255]], np.uint8), 3).reshape(1, 2, 3)).save(data, "PNG")
        header["images"] = [{"uri": "data:image/png;base64," + base64.b64encode(data.getvalue()).decode()}]
        header["textures"] = [{"source": 0}]
        pbr[0]["baseColorTexture"] = {"index": 0}
    _, others = load_nodes(written(tmp_path, header), [("Ground",)])
    share = 0.5 if textured else 1.0
    found = {len(m.faces) if m.colour else "bare": m.colour for m in others}
    assert found == {2: pytest.approx((0.6 * share, 0.1 * share, 0)), 1: (0, 0, 0), "bare": None} and len(others) == 3


@pytest.mark.parametrize(
    ("more", "lies"), [({}, True), ({"texCoord": 1}, False), ({"extensions": {"KHR_texture_transform": {}}}, False)]
)
def test_an_image_is_kept_where_it_is_not_moved(tmp_path: Path, more: dict, lies: bool):
    """One that is moved, or lies on other texture coordinates, has its mean alone."""
    image = Image.fromarray(np.array([[[255, 0, 0], [0, 0, 0]]], np.uint8))
    material = PBRMaterial(baseColorTexture=image, baseColorFactor=[128, 255, 255, 255])
    visual = trimesh.visual.TextureVisuals(uv=np.eye(4, 2), material=material)  # type: ignore[attr-defined]
    solid = trimesh.Trimesh(np.eye(4, 3), [[0, 1, 2], [0, 2, 3]], visual=visual, process=False)
    trimesh.Scene(solid).export(str(tmp_path / "a.gltf"))
    header = json.loads((tmp_path / "a.gltf").read_text())
    header["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] |= more
    (tmp_path / "a.gltf").write_text(json.dumps(header))
    ((_, look),) = read_nodes(tmp_path / "a.gltf", [])[1]
    assert look.colour == pytest.approx((0.25, 0, 0), abs=2e-3) and (look.texture is not None) == lies
    if look.texture is not None:
        np.testing.assert_allclose(look.texture.image, [[[0.5, 0, 0], [0, 0, 0]]], atol=4e-3)


def test_what_nothing_grows_on_needs_neither_uvs_nor_area(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    nodes: list[dict] = [{"children": [1, 2, 3]}, {"name": "a", "mesh": 0}]
    nodes += [{"name": "b", "mesh": 0, "translation": [3, 0, 0]}, {"name": "c", "mesh": 0, "scale": [0, 0, 0]}]
    monkeypatch.setattr("mesoshell.geometry.mesh.unwrap", lambda v, f, s: (np.zeros((len(f), 3, 2), np.float32), 1))
    path = written(tmp_path, triangles(nodes))
    (others,) = load_nodes(path, [("a",)])[1]
    assert len(others.faces) == 1 and not any("unwrapped" in note for note in others.notes)
    nodes[0]["children"] = [1, 3]
    assert load_nodes(written(tmp_path, triangles(nodes)), [("a",)])[1] == ()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"objects": "a.obj"}, "^objects: must be a list"),
        ({"grow": "Hill"}, "^grow: must be a list of names"),
        ({"size": (0, 5)}, "^size: 0 x 5 has no pixels"),
        ({"size": (10**6, 10**6)}, "^size: a picture of 1000000 x 1000000"),
    ],
)
def test_values_of_other_kinds(material: Material, changes: dict, said: str):
    with pytest.raises(InputError, match=said):
        ms.render(replace(ms.Scene(FILE, material), **changes), "draft")


def test_faint_suns_are_said(tmp_path: Path):
    told = read_scene_file(written(tmp_path, lit({}, {"type": "directional", "intensity": 3.0})))
    assert told.notes[0].startswith("its suns are so faint that they may be in W/m²")
    with pytest.raises(InputError, match="a sun has the irradiance"):
        read_scene_file(written(tmp_path, lit({}, {"type": "directional", "intensity": -3})))
