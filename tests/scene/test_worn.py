"""Nodes of a scene's file name the materials that grow on them, as options do: of a glTF file by `extras`, of a USD stage by
attributes, both as Blender writes its custom properties."""

import json
import shlex
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.exchange.gltf import export_gltf

from mesoshell.cli.described_scene import scene_of
from mesoshell.cli.grown import grown_of
from mesoshell.cli.options.render import Options
from mesoshell.errors import InputError
from mesoshell.geometry.mesh import Mesh
from mesoshell.render.camera import Camera
from mesoshell.scene.scene import Scene
from mesoshell.scene.unpack import unpack
from mesoshell.viewer.look import command, first_look

SQUARE = """
    point3f[] points = [({0}, 0, 0), ({1}, 0, 0), ({1}, 1, 0), ({0}, 1, 0)]
    int[] faceVertexCounts = [3, 3]
    int[] faceVertexIndices = [0, 1, 2, 0, 2, 3]
    texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] ( interpolation = "vertex" )
"""


def square(at: int) -> str:
    return SQUARE.format(at, at + 1)


def attributes(**values: Any) -> str:
    kinds = {str: "string", float: "double", int: "int", bool: "bool"}
    rows = (f"custom {kinds[type(x)]} mesoshell:{name} = {json.dumps(x)}" for name, x in values.items())
    return "\n".join(rows) + "\n"


def usd(folder: Path, hill: str = "", head: str = "", lawn: str = "", more: str = "") -> Path:
    """A hill, half of it of the material Lawn, and a head under a group; a post. With attributes."""
    subset = (
        'def GeomSubset "Half" ( prepend apiSchemas = ["MaterialBindingAPI"] )\n{\nuniform token elementType = "face"\n'
    )
    subset += 'uniform token familyName = "materialBind"\nint[] indices = [0]\nrel material:binding = </Lawn>\n}\n'
    path = folder / "stage.usda"
    path.write_text(
        f'#usda 1.0\n(\nupAxis = "Y"\n)\ndef Mesh "Hill"\n{{\n{hill}{square(0)}{subset}}}\n'
        f'def Xform "Body"\n{{\n{head}def Mesh "Head"\n{{\n{square(2)}}}\n}}\ndef Mesh "Post"\n{{\n{square(4)}}}\n'
        f'def Material "Lawn"\n{{\n{lawn}}}\n{more}'
    )
    return path


def gltf(folder: Path, **extras: dict[str, Any]) -> Path:
    """Triangles A, B, C in a row, of which A has the material Look; with extras."""
    corners, scene = [[0, 0, 0], [1, 0, 0], [0, 1, 0]], trimesh.Scene()
    for k, name in enumerate("ABC"):
        one = trimesh.Trimesh([[x + 2 * k, y, z] for x, y, z in corners], [[0, 1, 2]], process=False)
        scene.add_geometry(one, node_name=name, geom_name=name)
    files = export_gltf(scene, merge_buffers=True)
    described = json.loads(files["model.gltf"])
    described["materials"] = [{"name": "Look"}]
    for node in described["nodes"]:
        if "mesh" in node and node["name"] == "A":
            described["meshes"][node["mesh"]]["primitives"][0]["material"] = 0
    for x in (*described["nodes"], *described["materials"]):
        if x.get("name") in extras:
            x["extras"] = extras[x["name"]]
    files["model.gltf"] = json.dumps(described).encode()
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder / "model.gltf"


def described(path: Path, **options: Any) -> Scene:
    return scene_of(Options(path, **options))


def notes(path: Path) -> tuple[str, ...]:
    return grown_of(Options(path)).notes


def grown(scene: Scene) -> list[tuple[Any, ...]]:
    """Material, nodes, scale and parameters of each part."""
    return [(x.material.name, tuple(x.grow), x.scale, dict(x.params)) for x in (scene, *scene.also)]


def least(mesh: Any) -> float:
    assert isinstance(mesh, Mesh)
    return float(mesh.vertices[:, 0].min())


def test_prims_say_what_grows_on_them(tmp_path: Path):
    """The first material is the scene's own; what no prim names stands bare."""
    path = usd(
        tmp_path,
        attributes(material="turf", scale=0.25),
        attributes(material="pelt", hue=0.1),
        attributes(material="carpet"),
    )
    scene = described(path)
    assert grown(scene) == [
        ("turf", ("/Hill",), 0.25, {}),
        ("pelt", ("/Body",), None, {"hue": "0.1"}),
        ("carpet", ("/Lawn",), None, {}),
    ]
    still = unpack(scene)
    assert isinstance(still.mesh, Mesh) and len(still.mesh.faces) == 1  # the other face is Lawn's
    assert [(least(x.mesh), len(x.mesh.faces)) for x in still.also if isinstance(x.mesh, Mesh)] == [(2, 2), (0, 1)]
    assert [least(x) for x in still.objects] == [4]


def test_blenders_extras_say_the_same(tmp_path: Path):
    path = gltf(
        tmp_path, A={"mesoshell:material": "turf"}, B={"mesoshell:material": "pelt", "mesoshell:seed": 2, "other": [1]}
    )
    scene = described(path)
    assert grown(scene) == [("turf", ("A",), None, {}), ("pelt", ("B",), None, {})] and scene.also[0].seed == 2
    still = unpack(scene)
    assert (
        least(still.mesh) == 0
        and [least(x.mesh) for x in still.also] == [2]
        and [least(x) for x in still.objects] == [4]
    )


def test_a_material_of_the_file_names_one_too(tmp_path: Path):
    """It counts more than its node, on which nothing is left to grow."""
    path = gltf(tmp_path, A={"mesoshell:material": "turf"}, Look={"mesoshell:material": "carpet"})
    assert grown(described(path)) == [("carpet", ("Look",), None, {})]
    assert notes(path) == ("nothing is seen of what A would grow on",)


def test_options_count_more(tmp_path: Path):
    path = usd(tmp_path, attributes(material="turf", scale=0.25), attributes(material="pelt", hue=0.1))
    head = ("pelt", ("/Body",), None, {"hue": "0.1"})
    assert grown(described(path, grow=("Hill=carpet",))) == [head, ("carpet", ("Hill",), None, {})]
    assert grown(described(path, grow=("/Hill",))) == [("grass", ("/Hill",), None, {})]
    assert grown(described(path, material="fur")) == [("fur", (), None, {})]
    assert grown(described(path, material="fur", grow=("/Hill", "Body=pelt"))) == [
        ("fur", ("/Hill",), None, {}),
        ("pelt", ("Body",), None, {}),
    ]
    values = described(path, scale=0.5, param=("age=0.2", "/Body:hue=0.9", "pelt:value=0.3"))
    assert grown(values) == [("turf", ("/Hill",), 0.5, {"age": "0.2"}), (*head[:3], {"value": "0.3", "hue": "0.9"})]


def test_several_prims_of_one_material_are_one_mesh_unless_one_has_values(tmp_path: Path):
    again = f'def Mesh "Mat"\n{{\n{attributes(material="turf")}{square(6)}}}\n'
    path = usd(tmp_path, attributes(material="turf"), attributes(material="turf", age=0.5), more=again)
    assert grown(described(path)) == [("turf", ("/Hill", "/Mat"), None, {}), ("turf", ("/Body",), None, {"age": "0.5"})]


def test_files_lie_beside_the_stage(tmp_path: Path, monkeypatch):
    Image.new("L", (2, 2)).save(tmp_path / "comb.png")
    path = usd(tmp_path, attributes(material="carpet", lean_angle="comb.png"))
    monkeypatch.chdir("/")
    assert described(path).params == {"lean_angle": str(tmp_path / "comb.png")}


def test_what_is_hidden_is_said(tmp_path: Path):
    hidden = 'token visibility = "invisible"\n'
    path = usd(tmp_path, attributes(material="turf"), hidden + attributes(material="pelt"))
    assert grown(described(path)) == [("turf", ("/Hill",), None, {})]
    assert notes(path) == ("nothing is seen of what /Body would grow on",)


def test_a_file_without_any_is_grown_as_before(tmp_path: Path):
    assert grown(described(usd(tmp_path))) == [("grass", (), None, {})]


@pytest.mark.parametrize(
    "values, fault",
    [
        ({"material": "gras"}, "/Hill: gras: no such material"),
        ({"material": 3}, "/Hill: mesoshell:material is no text"),
        ({"scale": 0.2}, "/Hill: has mesoshell:scale, and no mesoshell:material"),
        ({"material": "turf", "scale": True}, "/Hill: mesoshell:scale is neither a text nor a number: True"),
        ({"material": "turf", "scale": "big"}, "/Hill:scale must be a number, not big"),
        ({"material": "turf", "length": 0.5}, "/Hill: turf has no 'length'; it has age, thickness"),
        ({"material": "turf", "thickness": -1}, "/Hill: thickness must be above 0, not -1"),
        ({"material": "turf", "age": 9}, "/Hill: age=9 lies outside [0, 1]"),
        ({"material": "turf", "age": "old.png"}, "/Hill: age=old.png is neither a number nor an image file"),
    ],
)
def test_faults_name_the_file_and_the_prim(tmp_path: Path, values: dict[str, Any], fault: str):
    path = usd(tmp_path, attributes(**values))
    with pytest.raises(InputError) as raised:
        described(path)
    assert str(raised.value).startswith(f"{path}: {fault}")
    assert grown(described(path, grow=("Hill=fur",))) == [("fur", ("Hill",), None, {})]  # an option counts instead


def test_one_name_of_two_nodes_says_one_thing(tmp_path: Path):
    path = gltf(tmp_path, A={"mesoshell:material": "turf"}, B={"mesoshell:material": "pelt"})
    path.write_text(path.read_text().replace('"name": "B"', '"name": "A"'))
    with pytest.raises(InputError, match="A: several nodes or materials have this name, and attributes that differ"):
        described(path)


def test_what_has_no_name_grows_nothing(tmp_path: Path):
    """Nor does anything else: the user says then what does."""
    path = gltf(tmp_path, Look={"mesoshell:material": "turf"})
    path.write_text(path.read_text().replace('"name": "Look", ', ""))
    with pytest.raises(
        InputError, match="what a node without a name would grow on: --material or --grow names what grows"
    ):
        described(path)
    assert grown(described(path, material="fur")) == [("fur", (), None, {})]


def test_an_option_covers_what_the_file_says(tmp_path: Path):
    """A material's name, which is nearer than the node that names another; and the only node that names one."""
    path = gltf(tmp_path, A={"mesoshell:material": "turf"})
    assert grown(described(path, grow=("Look=carpet",))) == [("carpet", ("Look",), None, {})]
    assert grown(described(path, grow=("A=carpet",))) == [("carpet", ("A",), None, {})]
    assert [least(x) for x in unpack(described(path, grow=("A=carpet",))).objects] == [2]


def test_the_first_in_the_file_is_the_scenes_own(tmp_path: Path):
    path = gltf(
        tmp_path,
        A={"mesoshell:material": "turf", "mesoshell:seed": 1.0},
        B={"mesoshell:material": "turf"},
        C={"x": "y" * 999},
    )
    scene = described(path)
    assert grown(scene) == [("turf", ("A",), None, {}), ("turf", ("B",), None, {})] and scene.seed == 1
    far = gltf(tmp_path, A={"mesoshell:material": "y" * 999})
    with pytest.raises(InputError, match="A: yyy"):
        described(far)


def test_values_of_a_stage(tmp_path: Path):
    """A pair of numbers, a file as an asset; without a value, or as a relationship, there is none."""
    Image.new("L", (2, 2)).save(tmp_path / "comb.png")
    hill = attributes(material="carpet", lean_angle="comb.png") + "custom double2 mesoshell:latent = (8, 0.5)\n"
    hill += (
        "custom double mesoshell:scale\nrel mesoshell:like = </Post>\ncustom asset mesoshell:growth = @./comb.png@\n"
    )
    scene = described(usd(tmp_path, hill, "custom string mesoshell:material = None\n"))
    assert grown(scene) == [("carpet", ("/Hill",), None, {"lean_angle": str(tmp_path / "comb.png")})]
    assert scene.latent == (8, 0.5) and scene.growth == str(tmp_path / "comb.png")


def test_subsets_and_copies_have_the_nearest_name(tmp_path: Path):
    """A mesh of which subsets leave nothing; a prototype, which stands nowhere itself, and its material, which does."""
    kinds = (
        f'def Mesh "Kind" ( prepend apiSchemas = ["MaterialBindingAPI"] )\n{{\n{attributes(material="fur")}{square(0)}'
    )
    kinds += "rel material:binding = </Lawn>\n}\n"
    field = 'def PointInstancer "Field"\n{\nrel prototypes = [</Field/Kind>]\nint[] protoIndices = [0]\n'
    field += f"point3f[] positions = [(8, 0, 0)]\n{kinds}}}\n"
    path = usd(tmp_path, attributes(material="turf"), "", attributes(material="carpet"), field)
    path.write_text(path.read_text().replace("int[] indices = [0]", "int[] indices = [0, 1]"))
    assert grown(described(path)) == [("carpet", ("/Lawn",), None, {})]
    assert notes(path) == ("nothing is seen of what /Hill, /Field/Kind would grow on",)
    still = unpack(described(path))
    assert isinstance(still.mesh, Mesh) and len(still.mesh.faces) == 4 and still.mesh.vertices[:, 0].max() == 9


def test_a_viewers_command_names_the_same_scene(tmp_path: Path):
    path = usd(tmp_path, attributes(material="turf", scale=0.25), attributes(material="pelt", hue=0.1, scale=0.5))
    scene = described(path)
    given = replace(
        scene, also=[replace(x, params={k: float(str(v)) for k, v in x.params.items()}) for x in scene.also]
    )
    words = command(given, replace(given, camera=Camera(np.eye(4), 0.7, 8, 8), up="y"), first_look(given), "jax", 4)
    read = {
        name: tuple(b for a, b in pairwise(shlex.split(words)) if a == f"--{name}")
        for name in ("grow", "param", "material")
    }
    (material,) = read.pop("material")
    again = described(path, material=material, **read, scale=0.25)
    assert [x[:3] for x in grown(again)] == [x[:3] for x in grown(scene)] and again.also[0].params["hue"] == "0.1"
