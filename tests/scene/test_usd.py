"""A USD stage's meshes, camera and distant lights are read; what is damaged is one line.

The stages are written here by hand; tests/scene/test_blender_views has those that Blender writes."""

import resource
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import mesoshell as ms
from mesoshell.errors import InputError
from mesoshell.geometry import read_usd
from mesoshell.geometry.mesh import load_mesh, load_nodes
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.io.image import read_exr, write_exr
from mesoshell.render.light import environment, lookup
from mesoshell.render.quality import Quality
from mesoshell.scene.kept_meshes import mesh_of
from mesoshell.scene.materials import Material
from mesoshell.scene.mitsuba_xml import write_folder
from mesoshell.scene.settle import settle
from mesoshell.scene.unpack import read_scene_file, unpack
from mesoshell.viewer.look import command, first_look, scene_of_look

#: A square in the plane z = 0, of texture coordinates equal to positions.
SQUARE = """
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
        int[] faceVertexCounts = [4]
        int[] faceVertexIndices = [0, 1, 2, 3]
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] ( interpolation = "vertex" )
"""


def stage(folder: Path, body: str, head: str = 'upAxis = "Y"') -> Path:
    path = folder / "stage.usda"
    lines = body.replace("{ ", "{\n").replace(" }", "\n}")  # braces end lines
    path.write_text(f"#usda 1.0\n(\n    {head}\n)\n{lines}")
    return path


def mesh(name: str, more: str = "", kind: str = "", body: str = SQUARE) -> str:
    return f'    def Mesh "{name}" {kind}\n    {{\n{body}{more}\n    }}\n'


def test_memory_is_bounded_while_a_stage_is_read(tmp_path: Path):
    """A damaged one may ask for more than there is, and Linux would end the process when it is used."""
    path = stage(tmp_path, mesh("A"))
    free = resource.getrlimit(resource.RLIMIT_AS)
    with read_usd.open_stage(path):  # what a limit refuses: tests/test_contained
        assert resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY
    assert resource.getrlimit(resource.RLIMIT_AS) == free


def test_meshes_stand_where_they_are(tmp_path: Path):
    """Under transforms of all above them, and facing as their orientation says."""
    place = 'double3 xformOp:translate = (2, 3, 4)\n uniform token[] xformOpOrder = ["xformOp:translate"]\n'
    flip = 'float3 xformOp:scale = (1, 1, -2)\n uniform token[] xformOpOrder = ["xformOp:scale"]\n'
    left = 'uniform token orientation = "leftHanded"\n'
    body = f'def Xform "World"\n{{\n{place}{mesh("A")}{mesh("B", flip)}{mesh("C", left)}{mesh("D", flip + left)}}}\n'
    path = stage(tmp_path, body)
    for name, facing in (("A", 1), ("B", -1), ("C", -1), ("D", 1)):
        (one,), others = load_nodes(path, [(name,)])
        corners = one.vertices[one.faces].astype(np.float64)
        np.testing.assert_array_equal(np.unique(one.vertices, axis=0), [[2, 3, 4], [2, 4, 4], [3, 3, 4], [3, 4, 4]])
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        np.testing.assert_array_equal(normal, np.tile([0, 0, facing], (2, 1)))
        np.testing.assert_array_equal(one.uv, corners[..., :2] - [2, 3])
        assert len(others[0].faces) == 2  # the other three lie in one place
    assert len(load_nodes(path, [("/World",)])[0][0].faces) == 2
    with pytest.raises(InputError, match=r"its names are /World, /World/A, /World/B, /World/C, /World/D$"):
        load_nodes(path, [("Hill",)])


def test_what_is_not_seen_is_left_out(tmp_path: Path):
    off = 'token visibility = "invisible"\n'
    guide, proxy, render = (f'uniform token purpose = "{x}"\n' for x in ("guide", "proxy", "render"))
    hidden = f'def Xform "Hidden"\n{{\n{off}{mesh("D")}}}\n'
    path = stage(tmp_path, f"{mesh('A', off)}{mesh('B', guide)}{mesh('C', proxy)}{hidden}{mesh('E', render)}")
    assert [part.names for part in read_usd.parts(path)] == [["/E", "E"]]


def test_copies_are_all_there(tmp_path: Path):
    """Of an instanceable prim, and of a PointInstancer's prototypes, which stand nowhere themselves."""
    rock = f'class Xform "_Rock"\n{{\n{mesh("Stone")}}}\n'
    at = 'double3 xformOp:translate = ({}, 0, 0)\n uniform token[] xformOpOrder = ["xformOp:translate"]\n'
    copy = "".join(
        f'def Xform "Copy{k}" ( instanceable = true\n inherits = </_Rock> )\n{{\n{at.format(10 * k)}}}\n'
        for k in (1, 2)
    )
    scattered = f"""def PointInstancer "Field" {{
        {at.format(100)}
        rel prototypes = [</Field/Kinds/Near>, </Field/Kinds/Far>]
        int[] protoIndices = [0, 1, 0]
        point3f[] positions = [(0, 0, 0), (5, 0, 0), (7, 0, 0)]
        float3[] scales = [(1, 1, 1), (2, 2, 2), (1, 1, 1)]
        int64[] invisibleIds = [2]
        def Scope "Kinds" {{ {mesh("Near")} {mesh("Far", at.format(0.5))} }}
    }}
    """
    found = read_usd.parts(stage(tmp_path, rock + copy + scattered))
    least = sorted((names[0], points[:, 0].min(), np.ptp(points[:, 0])) for names, (points, _, _), *_ in found)
    wanted = [("/Copy1/Stone", 10, 1), ("/Copy2/Stone", 20, 1), ("/Field", 100, 1), ("/Field", 106, 2)]
    assert [x[0] for x in least] == [x[0] for x in wanted]
    np.testing.assert_allclose([x[1:] for x in least], [x[1:] for x in wanted])


def test_prototypes_may_be_hidden_abstract_and_within_each_other(tmp_path: Path):
    """As exporters keep them: under a class, an over, or what is invisible; an instancer may repeat another."""
    at = 'double3 xformOp:translate = ({}, 0, 0)\n uniform token[] xformOpOrder = ["xformOp:translate"]\n'
    pair = "int[] protoIndices = [0, 0]\n point3f[] positions = [({}, 0, 0), ({}, 0, 0)]\n"
    for kind, hidden in (("class", ""), ("over", ""), ("def", 'token visibility = "invisible"\n')):
        body = f"""
        def PointInstancer "Outer" {{
            rel prototypes = [</Kinds/Inner>]
            {pair.format(10, 20)}
        }}
        {kind} Scope "Kinds" {{
            {hidden}
            def PointInstancer "Inner" {{
                rel prototypes = [</Kinds/Stone>]
                {at.format(100)} {pair.format(1, 2)}
            }}
            {mesh("Stone", at.format(0.5))}
        }}
        """
        found = read_usd.parts(stage(tmp_path, body))
        inside = [x for names, (x, _, _), *_ in found if names[0] == "/Outer"]
        assert sorted(x[:, 0].min() for x in inside) == [111.5, 112.5, 121.5, 122.5]


def test_holes_and_plain_pairs(tmp_path: Path):
    """A hole has no triangles; texture coordinates that are declared as pairs of numbers are those if they are `st`."""
    body = """
        point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
        int[] faceVertexCounts = [3, 3]
        int[] faceVertexIndices = [0, 1, 2, 0, 2, 3]
        int[] holeIndices = [0, 7]
        float2[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] ( interpolation = "vertex" )
        texCoord2f[] primvars:lightmap = [(9, 9), (9, 9), (9, 9), (9, 9)] ( interpolation = "vertex" )
    """
    ((_, (_, faces, uv), *_),) = read_usd.parts(stage(tmp_path, mesh("A", body=body)))
    assert faces.tolist() == [[0, 2, 3]] and uv.tolist() == [[[0, 0], [1, 1], [0, 1]]]


def test_the_first_time_code(tmp_path: Path):
    moves = "double3 xformOp:translate.timeSamples = {{ 10: (5, 0, 0), 20: (9, 0, 0), }}\n"
    order = 'uniform token[] xformOpOrder = ["xformOp:translate"]\n'
    body = mesh("A", moves.replace("{{", "{").replace("}}", "}") + order)
    for head, wanted in (('upAxis = "Y"', 5), ("startTimeCode = 20", 9)):
        ((_, (points, _, _), *_),) = read_usd.parts(stage(tmp_path, body, head))
        assert points[:, 0].min() == wanted


def test_a_changed_file_is_read_anew_while_its_fault_is_held(tmp_path: Path):
    with pytest.raises(InputError) as held:
        load_mesh(stage(tmp_path, mesh("A", body=SQUARE.replace("2, 3]", "2, 9]"))))
    assert len(load_mesh(stage(tmp_path, mesh("A"))).faces) == 2 and held.value.__cause__ is not None


def test_what_is_left_out_is_said(tmp_path: Path):
    body = f"""{mesh("A")}
    def Plane "Floor" {{
    }}
    def Xform "Tree" ( references = @./none.usda@ )
    {{
    }}
    def SkelRoot "Man" {{
    }}
    def Camera "Shifted" {{ float horizontalApertureOffset = 3 }}
    """
    notes = read_scene_file(stage(tmp_path, body)).notes
    for said in (
        "shapes that are no meshes are left out: Floor",
        "1 of its layers or references",
        "skeletons",
        "the shift of",
    ):
        assert any(said in note for note in notes)


@pytest.mark.parametrize(("angle", "size"), [(0, 1), (180, np.pi), (270, 1.5 * np.pi), (360, 2 * np.pi)])
def test_the_size_of_a_sun(tmp_path: Path, angle: float, size: float):
    body = f'def DistantLight "S" {{ float inputs:intensity = 1\n float inputs:angle = {angle} }}\n{mesh("A")}'
    np.testing.assert_allclose(read_scene_file(stage(tmp_path, body)).suns[0].irradiance, np.full(3, size), rtol=1e-6)


def shader(name: str, inputs: str) -> str:
    return f'''    def Material "{name}" {{
        token outputs:surface.connect = </{name}/Look.outputs:surface>
        def Shader "Look" {{
            uniform token info:id = "UsdPreviewSurface"
            token outputs:surface
            {inputs}
        }}
        def Shader "Read" {{
            uniform token info:id = "UsdUVTexture"
            asset inputs:file = @half.png@
            float3 outputs:rgb
        }}
    }}
'''


def bound(name: str, points: str = "") -> str:
    return f"rel material:binding = </{name}>"


API = '( prepend apiSchemas = ["MaterialBindingAPI"] )'


def test_subsets_and_their_colours(tmp_path: Path):
    """Six quads in a row, two of a subset of red, one of another whose image is half white, half black; the mesh is green."""
    Image.fromarray(np.repeat(np.array([[0, 255]], np.uint8), 3).reshape(1, 2, 3)).save(tmp_path / "half.png")
    points = ", ".join(f"({x}, {y}, 0)" for x in range(7) for y in (0, 1))
    corners = ", ".join(f"{2 * k}, {2 * k + 2}, {2 * k + 3}, {2 * k + 1}" for k in range(6))
    body = f"""
        point3f[] points = [{points}]
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = [{corners}]
        {bound("Green")}
        def GeomSubset "Lawn" {API} {{
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = [1, 4]
            {bound("Red")}
        }}
        def GeomSubset "Path" {API} {{
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = [4, 5]
            {bound("Checked")}
        }}
        def GeomSubset "All" {{
            uniform token elementType = "face"
            int[] indices = [0, 1, 2, 3, 4, 5]
        }}
    """
    looks = shader("Red", "color3f inputs:diffuseColor = (0.7, 0, 0)") + shader("Green", "float inputs:roughness = 1")
    looks += shader("Checked", "color3f inputs:diffuseColor.connect = </Checked/Read.outputs:rgb>")
    path = stage(tmp_path, mesh("Hill", kind=API, body=body) + looks + mesh("Bare"))
    parts = read_usd.parts(path)
    found = {
        (*part.names[1::2], *part.material[1::2]): (len(part.arrays[0]), len(part.arrays[1]), part.look.colour)
        for part in parts
    }
    red = pytest.approx((0.7, 0, 0))
    assert found == {
        ("All", "Hill", "Green"): (10, 6, (0.18, 0.18, 0.18)),
        ("Lawn", "All", "Hill", "Red"): (4, 2, red),
        ("Lawn", "Path", "All", "Hill", "Red"): (4, 2, red),  # two materials claim it
        ("Path", "All", "Hill", "Checked"): (4, 2, pytest.approx((0.5, 0.5, 0.5))),
        ("Bare",): (4, 2, None),
    }
    for name, faces, others in (
        ("/Hill/Lawn", 4, 3),
        ("Red", 4, 3),
        ("/Hill/Path", 4, 3),
        ("All", 12, 1),
        ("Hill", 12, 1),
    ):
        (grown,), rest = load_nodes(path, [(name,)])
        assert len(grown.faces) == faces and len(rest) == others
    assert len(read_usd.parts(path, apart=False)) == 2
    for spoil in (lambda: (tmp_path / "half.png").write_bytes(b"nonsense"), lambda: (tmp_path / "half.png").unlink()):
        spoil()
        assert {part.names[1]: part.look.colour for part in read_usd.parts(path)}["Path"] is None
        assert len(load_nodes(path, [("Lawn",)])[0][0].faces) == 4


def test_colours_by_other_ways(tmp_path: Path):
    """An interface's input, a binding for previews, displayColor; and inputs that are none stop no mesh."""
    tint = "color3f inputs:diffuseColor.connect = </{}.inputs:tint>"
    looks = shader("Tinted", tint.format("Tinted")).replace(
        "token outputs:surface.c", "color3f inputs:tint = (0.1, 0.2, 0.3)\n        token outputs:surface.c", 1
    )
    looks += shader("Odd", "color3f inputs:diffuseColor.connect = </Odd/Read.outputs:rgb>").replace(
        "asset inputs:file = @half.png@", 'string inputs:file = "half.png"'
    )
    looks += shader("None", 'token inputs:diffuseColor = "red"')
    body = "".join(
        mesh(name, more, kind=API, body=SQUARE.replace("0)", f"{k})"))
        for k, (name, more) in enumerate(
            {
                "A": bound("Tinted"),
                "B": "rel material:binding:preview = </Tinted>",
                "C": "color3f[] primvars:displayColor = [(0.2, 0, 0), (0.4, 0, 0)]",
                "D": bound("Odd"),
                "E": bound("None"),
            }.items()
        )
    )
    found = {part.names[0]: part.look.colour for part in read_usd.parts(stage(tmp_path, body + looks))}
    tinted = pytest.approx((0.1, 0.2, 0.3))
    assert found == {"/A": tinted, "/B": tinted, "/C": pytest.approx((0.3, 0, 0)), "/D": None, "/E": None}


def test_instances_share_what_is_read_of_a_material(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    calls = []
    monkeypatch.setattr(read_usd, "_diffuse", lambda material, *_: calls.append(material.GetPath()))
    model = f"""def Xform "Model" {{
    {mesh("A", bound("Model/Look"), kind=API)}
    {shader("Look", "").replace("</Look.", "</Model/Look.")}
    }}
    """
    copies = "".join(f'def "Copy{k}" ( instanceable = true\n references = </Model> ) {{ }}\n' for k in range(4))
    assert len(read_usd.parts(stage(tmp_path, model + copies))) == 5
    assert len(calls) == 2  # of the model itself, and of its copies' prototype


LIT = "float inputs:intensity = 8\n float inputs:exposure = -1\n color3f inputs:color = (1, 0.5, 0)\n"


@pytest.mark.parametrize(
    ("light", "kind", "size", "strength"),
    [
        ('SphereLight "L" { float inputs:radius = 0.25', "sphere", (0.5, 0.5, 0.5), 4),
        ('SphereLight "L" { bool inputs:normalize = 1', "sphere", (1, 1, 1), 4 / (4 * np.pi)),
        ('SphereLight "L" { bool treatAsPoint = 1', "point", None, 4 * np.pi),
        ('SphereLight "L" { bool inputs:normalize = 1\n float inputs:radius = 0', "point", None, 1),
        ('RectLight "L" { float inputs:width = 3\n float inputs:height = 1', "rectangle", (3, 1, 3), 4),
        ('RectLight "L" { bool inputs:normalize = 1\n float inputs:width = 3', "rectangle", (3, 1, 3), 4 / 12),
        ('DiskLight "L" { bool inputs:normalize = 1', "disk", (1, 1, 1), 4 / np.pi),
    ],
)
def test_lamps(tmp_path: Path, light: str, kind: str, size: tuple | None, strength: float):
    """Within a frame of twice the size: what is normalised is so by its area in the world."""
    body = f"""{mesh("A")}
    def Xform "Rig" {{
        float3 xformOp:scale = (2, 2, 2)
        uniform token[] xformOpOrder = ["xformOp:scale"]
        def {light}\n {LIT} }}
    }}
    """
    (lamp,) = read_scene_file(stage(tmp_path, body)).lamps
    assert lamp.kind == kind
    if size is not None:
        np.testing.assert_allclose(np.linalg.norm(lamp.pose[:3, :2], axis=0), size[:2])
    np.testing.assert_allclose(lamp.strength, strength * np.array([1, 0.5, 0]), rtol=1e-6)


def test_a_sphere_with_a_cone_is_a_spot(tmp_path: Path):
    cone = "float inputs:shaping:cone:angle = 30\n float inputs:shaping:cone:softness = 0.2"
    light = f'def SphereLight "L" ( prepend apiSchemas = ["ShapingAPI"] ) {{ {LIT} {cone} }}\n{mesh("A")}'
    (lamp,) = read_scene_file(stage(tmp_path, light)).lamps
    assert lamp.kind == "spot"
    np.testing.assert_allclose(lamp.cone, np.radians([24, 30]))
    np.testing.assert_allclose(lamp.strength, 4 * np.pi * 0.25 * np.array([1, 0.5, 0]))


@pytest.mark.parametrize(
    ("angle", "kind"), [("90", "spot"), ("120", "spot"), ("180", "sphere"), (None, "sphere"), ("0", "")]
)
def test_wide_cones(tmp_path: Path, angle: str | None, kind: str):
    cone = "" if angle is None else f"float inputs:shaping:cone:angle = {angle}"
    light = f'def SphereLight "L" ( prepend apiSchemas = ["ShapingAPI"] ) {{ {LIT} {cone} }}\n{mesh("A")}'
    told = read_scene_file(stage(tmp_path, light))
    assert [lamp.kind for lamp in told.lamps] == ([kind] if kind else [])
    assert len(told.notes) == (not kind) and all("its lamp L is left out: a spot takes" in note for note in told.notes)


def test_beams_whose_shape_is_not_read_are_said(tmp_path: Path):
    api = '( prepend apiSchemas = ["ShapingAPI"] )'
    body = f"""{mesh("A")}
    def RectLight "Box" {api} {{ float inputs:shaping:cone:angle = 30 }}
    def SphereLight "Bulb" {api} {{ float inputs:shaping:focus = 3 }}
    def DiskLight "Plain" {api} {{ {LIT} }}
    """
    told = read_scene_file(stage(tmp_path, body))
    assert len(told.lamps) == 3 and told.notes == ("its shapes of lamps' beams are left out: Box, Bulb",)


def test_lamps_that_give_no_light_are_not_there(tmp_path: Path):
    body = f"""{mesh("A")}
    def SphereLight "Dark" {{ float inputs:intensity = 0 }}
    def RectLight "Flat" {{ float inputs:width = 0 }}
    def DiskLight "Hidden" {{
        float3 xformOp:scale = (0, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:scale"]
    }}
    def RectLight "Film" {{ asset inputs:texture:file = @film.exr@ }}
    """
    told = read_scene_file(stage(tmp_path, body))
    assert len(told.lamps) == 1 and "its images of lamps are left out: Film" in told.notes


@pytest.mark.parametrize("count", [3, 5, 7])
def test_polygons_are_fans_with_their_own_coordinates(tmp_path: Path, count: int):
    """Coordinates of corners, indexed; of another name than `st`."""
    angle = 2 * np.pi * np.arange(count) / count
    points = ", ".join(f"({x:.6f}, {y:.6f}, 0)" for x, y in zip(np.cos(angle), np.sin(angle), strict=True))
    uv = ", ".join(f"({k}, 0.5)" for k in range(count))
    body = f"""
        point3f[] points = [{points}]
        int[] faceVertexCounts = [{count}]
        int[] faceVertexIndices = {list(range(count))}
        texCoord2f[] primvars:UVMap = [{uv}] ( interpolation = "faceVarying" )
        int[] primvars:UVMap:indices = {list(range(count))[::-1]}
    """
    ((_, (_, faces, uv), *_),) = read_usd.parts(stage(tmp_path, mesh("A", body=body)))
    np.testing.assert_array_equal(faces, [[0, k, k + 1] for k in range(1, count - 1)])
    np.testing.assert_array_equal(uv[..., 0], count - 1 - faces)


def test_the_camera_the_suns_and_the_axis(tmp_path: Path, tiny_bundle: Bundle):
    turn = 'float xformOp:rotateX = -90\n uniform token[] xformOpOrder = ["xformOp:rotateX"]\n'
    lens = "float focalLength = 50\n float horizontalAperture = 36\n float verticalAperture = 24\n"
    body = f"""{mesh("Ground")}
    def Xform "Rig" {{
        double3 xformOp:translate = (0, 0, 5)
        float3 xformOp:scale = (3, 3, 3)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
        def Camera "First" {{ {lens} }}
    }}
    def Camera "Second" {{ {lens} }}
    def Camera "Flat" {{ token projection = "orthographic" }}
    def DistantLight "Sun" {{
        {turn} bool inputs:normalize = 1
        float inputs:intensity = 3
        float inputs:exposure = 1
        color3f inputs:color = (1, 0.5, 0.25)
    }}
    def DistantLight "Wide" {{
        float inputs:intensity = 2
        float inputs:angle = 60
        bool inputs:enableColorTemperature = 1
    }}
    def DistantLight "Off" {{ token visibility = "invisible" }}
    def CylinderLight "Tube" {{ float inputs:intensity = 9 }}
    """
    path = stage(tmp_path, body, 'upAxis = "Z"')
    told = read_scene_file(path)
    assert told.camera is not None and told.up == "z" and told.aspect == pytest.approx(1.5)
    np.testing.assert_allclose(told.camera[0], [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5], [0, 0, 0, 1]], atol=1e-12)
    assert told.camera[1] == pytest.approx(2 * np.arctan(24 / 2 / 50))
    sun, wide = told.suns
    np.testing.assert_allclose(sun.direction, [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(sun.irradiance, [6, 3, 1.5])
    np.testing.assert_allclose(wide.irradiance, np.full(3, 2 * np.pi * np.sin(np.pi / 6) ** 2), rtol=1e-6)
    assert told.notes == (
        "its camera Flat is no perspective one: left out",
        "it has 2 cameras: First, the first, is taken",
        "its lights of other kinds are left out: Tube",
    )
    scene = ms.Scene(path, Material("tiny", tiny_bundle), size=(30, 20))
    still = settle(scene)
    assert still.up == "z" and len(still.lights) == 2 and unpack(unpack(scene)).mesh is not None
    assert ms.render(scene, "draft", max_samples=1).rgba[..., 3].max() == 1
    mine = path.read_text().replace('upAxis = "Z"', 'upAxis = "Z"\n    doc = "Blender v5.0.1"')
    path.write_text(mine)
    np.testing.assert_allclose(read_scene_file(path).suns[0].irradiance, [24, 12, 6])


@pytest.mark.parametrize("suffix", read_usd.FORMATS)
@pytest.mark.parametrize(
    "content", [b"", b"nonsense", b"#usda 1.0\ndef Mesh {", b"PXR-USDC\0\0", b"PK\3\4", bytes(range(256))]
)
def test_what_is_no_stage_is_one_line(tmp_path: Path, suffix: str, content: bytes, capfd: pytest.CaptureFixture[str]):
    path = tmp_path / f"bad{suffix}"
    path.write_bytes(content)
    for read in (load_mesh, read_scene_file):
        with pytest.raises(InputError) as caught:
            read(path)
        assert str(caught.value).startswith(f"{path}: is no USD stage") and "\n" not in str(caught.value)
    said = capfd.readouterr()
    assert said.err == said.out == ""


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("", "holds no triangles"),
        (mesh("A", body="int[] faceVertexCounts = [3]\n"), "/A has 0 corners for faces of 3"),
        (mesh("A", body=SQUARE.replace("[4]", "[-4]")), "/A has 4 corners for faces of -4"),
        (mesh("A", body=SQUARE.replace("2, 3]", "2, 9]")), "/A refers to points that it does not have"),
        (mesh("A", body=SQUARE.replace("(1, 1, 0)", "(nan, 1, 0)")), "not finite"),
        (
            'def DistantLight "S" { float inputs:intensity = -3\n bool inputs:normalize = 1 }\n' + mesh("A"),
            "a sun has the irradiance",
        ),
        ('def Camera "C" { float focalLength = 0 }\n' + mesh("A"), "radians"),
        (
            'def DistantLight "S" { bool inputs:enableColorTemperature = 1\n float inputs:colorTemperature = nan }\n'
            + mesh("A"),
            "a temperature of nan kelvin",
        ),
        (
            'def PointInstancer "F" { rel prototypes = [</F/A>]\n int[] protoIndices = [0, 0]\n' + mesh("A") + "}\n",
            "/F repeats prototypes that it does not have, or at 0 of 2 places",
        ),
        (
            'def PointInstancer "F" { rel prototypes = [</F>]\n int[] protoIndices = [0]\n'
            "point3f[] positions = [(1, 0, 0)] }\n",
            "lies in more than 8 instancers",
        ),
    ],
)
def test_a_damaged_stage_is_one_line(tmp_path: Path, tiny_bundle: Bundle, body: str, said: str):
    path: Any = stage(tmp_path, body)
    with pytest.raises(InputError, match=said):
        settle(ms.Scene(path, Material("tiny", tiny_bundle)))


def test_prims_of_all_instancers_are_counted(tmp_path: Path, tiny_bundle: Bundle, monkeypatch: pytest.MonkeyPatch):
    """Few prims within each other are many."""

    def instancer(name: str, inner: str, prototype: str) -> str:
        points = ", ".join(f"({x}, 0, 0)" for x in range(9))
        given = f"int[] protoIndices = [{', '.join('0' * 9)}]\n point3f[] positions = [{points}]\n"
        return f'def PointInstancer "{name}" {{ rel prototypes = [{prototype}]\n{given}{inner} }}\n'

    inner = instancer("G", mesh("A"), "</F/G/A>")
    path: Any = stage(tmp_path, instancer("F", inner, "</F/G>"))
    monkeypatch.setattr(read_usd, "MAX_WALKED", 92)  # 1 and F, 9 times G, and 9 times 9 of A
    assert len(read_usd.parts(path)) == 81
    monkeypatch.setattr(read_usd, "MAX_WALKED", 91)
    with pytest.raises(InputError, match="its instancers repeat more than 91 prims"):
        settle(ms.Scene(path, Material("tiny", tiny_bundle)))


def test_without_openusd_its_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for name in [name for name in sys.modules if name.split(".")[0] == "pxr"] or ["pxr"]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=r"requires usd-core: pip install mesoshell\[usd\]$"):
        load_mesh(stage(tmp_path, mesh("A")))


def dome(more: str, kind: str = "DomeLight", name: str = "Sky") -> str:
    return f'def {kind} "{name}"\n{{\n{more}\n}}\n'


def test_a_dome_is_an_environment(tmp_path: Path, tiny_bundle: Bundle):
    """Its colour everywhere; suns stay; what is asked for takes its place."""
    glow = "float inputs:intensity = 3\nfloat inputs:exposure = 1\ncolor3f inputs:color = (1, 0.5, 0.25)\n"
    path = stage(tmp_path, mesh("A") + dome(glow) + dome("", name="Other") + 'def DistantLight "Sun"\n{\n}\n')
    scene = ms.Scene(path, Material("tiny", tiny_bundle))
    still = settle(scene)
    assert isinstance(still.environment, np.ndarray) and len(still.lights) == 1
    np.testing.assert_allclose(still.environment, np.broadcast_to([6, 3, 1.5], still.environment.shape))
    assert any("lights of other kinds are left out: Other" in note for note in mesh_of(still.mesh).notes)
    own = np.ones((2, 4, 3), np.float32)
    assert settle(replace(scene, environment=own)).environment is own
    for change in ({"suns": False}, {"lights": [(0.0, 1.0, 0.0)]}):
        assert settle(replace(scene, **change)).environment is None


def test_a_dome_alone(tmp_path: Path, tiny_bundle: Bundle):
    """A black one is none, so default lights stand; a faint one is said to be; one of no light is left out."""

    def found(more: str) -> tuple[ms.Scene, str]:
        still = settle(ms.Scene(stage(tmp_path, mesh("A") + dome(more)), Material("tiny", tiny_bundle)))
        return still, " ".join(mesh_of(still.mesh).notes)

    black, said = found("float inputs:intensity = 0\n")
    assert black.environment is None and len(black.lights) == 3 and "sky" not in said
    faint, said = found("float inputs:intensity = 0.05\n")
    assert faint.environment is not None and faint.lights == () and "its sky is faint, and it has no sun" in said
    wrong, said = found("float inputs:intensity = -1\n")
    assert wrong.environment is None and len(wrong.lights) == 3 and "its sky is left out: /Sky holds a number" in said


def test_a_sky_turns_with_the_axis_that_is_up(tmp_path: Path, tiny_bundle: Bundle):
    """The stage's directions stay where they are, whatever axis a scene is given as up."""
    sky = np.random.default_rng(0).random((16, 32, 3), np.float32)
    write_exr(tmp_path / "sky.exr", sky, half=False)
    scene = ms.Scene(
        stage(tmp_path, mesh("A") + dome("asset inputs:texture:file = @./sky.exr@\n")), Material("t", tiny_bundle)
    )
    y, z = (settle(replace(scene, up=up)).environment for up in ("y", "z"))
    assert isinstance(y, np.ndarray) and isinstance(z, np.ndarray)
    np.testing.assert_array_equal(y, np.roll(sky, 8, axis=1))  # its middle lies toward +x, the image's toward +z
    d = np.random.default_rng(1).normal(size=(4000, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    there, here = lookup(environment(y, 1), d), lookup(environment(z, 2), d)
    assert np.corrcoef(there.ravel(), here.ravel())[0, 1] > 0.7  # pixels of another grid
    assert abs(np.corrcoef(there.ravel(), lookup(environment(y, 2), d).ravel())[0, 1]) < 0.2
    share = np.sin((np.arange(16) + 0.5) / 16 * np.pi)[:, None, None]
    assert (z * share).sum() == pytest.approx((sky * share).sum(), rel=0.02)  # light is kept


def test_a_share_of_a_column_is_interpolated(tmp_path: Path):
    """A turn about the pole neither loses nor doubles light."""
    sky = np.zeros((4, 8, 3), np.float32)
    sky[1, 2] = 8
    write_exr(tmp_path / "sky.exr", sky, half=False)
    turn = 'float xformOp:rotateY = 11.25\n uniform token[] xformOpOrder = ["xformOp:rotateY"]\n'
    path = stage(tmp_path, mesh("A") + dome("asset inputs:texture:file = @./sky.exr@\n" + turn))
    told = read_scene_file(path).sky
    assert told is not None
    made = told.radiance("y")
    assert made is not None
    np.testing.assert_allclose(made[1, :, 0], [0, 0, 0, 2, 6, 0, 0, 0], atol=1e-5)


@pytest.mark.parametrize(
    ("axis", "more", "toward"),
    [
        ("Y", "", (0, 0, 1)),
        ("Z", 'uniform token poleAxis = "Z"\n', (0, -1, 0)),
        ("Z", "", (0, -1, 0)),
        ("Y", 'uniform token poleAxis = "Y"\n', (0, 0, 1)),
        ("Y", 'float xformOp:rotateY = 90\n uniform token[] xformOpOrder = ["xformOp:rotateY"]\n', (1, 0, 0)),
        ("Y", 'float3 xformOp:scale = (3, 3, 3)\n uniform token[] xformOpOrder = ["xformOp:scale"]\n', (0, 0, 1)),
    ],
)
def test_where_a_sky_is_bright(tmp_path: Path, axis: str, more: str, toward: tuple[float, float, float]):
    """As OpenUSD says: the image's middle is +z, or −y about a pole of z. Those of `DomeLight` have a pole of y."""
    sky = np.full((8, 16, 3), 0.01, np.float32)
    sky[3:5, 7:9] = 1
    sky[3:5, 3:5, 1] = 0.5  # a quarter to the left: +x of the dome's own frame
    write_exr(tmp_path / "sky.exr", sky, half=False)
    given = "asset inputs:texture:file = @./sky.exr@\n" + more
    told = read_scene_file(stage(tmp_path, mesh("A") + dome(given, "DomeLight_1"), f'upAxis = "{axis}"'))
    assert told.sky is not None and told.up == axis.lower()
    made = told.sky.radiance(axis.lower())
    assert made is not None
    made, d = environment(made, 1 if axis == "Y" else 2), np.array(toward, np.float64)
    beside = (0, 0, -1) if toward == (1, 0, 0) else (1, 0, 0)
    assert lookup(made, np.array([beside], np.float64))[0, 1] == pytest.approx(0.5)
    assert lookup(made, d[None])[0, 0] == 1 and lookup(made, -d[None])[0, 0] == pytest.approx(0.01)
    assert lookup(made, np.roll(d, 1)[None])[0, 0] == pytest.approx(0.01)


@pytest.mark.parametrize("fault", ["missing", "damaged", "empty", "negative", "cube"])
def test_a_sky_that_cannot_be_read_is_left_out(tmp_path: Path, tiny_bundle: Bundle, fault: str):
    sky = np.ones((2, 4, 3), np.float32)
    if fault == "negative":
        sky[0, 0] = -1
    if fault != "missing":
        write_exr(tmp_path / "sky.exr", sky, half=False)
    if fault == "damaged":
        (tmp_path / "sky.exr").write_bytes((tmp_path / "sky.exr").read_bytes()[:90])
    if fault == "empty":
        (tmp_path / "sky.exr").write_bytes(b"")
    given = "asset inputs:texture:file = @./sky.exr@\n"
    given += 'token inputs:texture:format = "cubeMapVerticalCross"\n' if fault == "cube" else ""
    scene = ms.Scene(stage(tmp_path, mesh("A") + dome(given)), Material("tiny", tiny_bundle))
    still = settle(scene)
    assert still.environment is None and len(still.lights) == 3
    assert any(note.startswith("its sky is left out: ./sky.exr: ") for note in mesh_of(still.mesh).notes)


def test_a_stages_sky_is_exported_and_brought_by_the_viewers_command(tmp_path: Path, tiny_bundle: Bundle):
    """The folder holds the map as it lies here; the command line names the stage, which has its sky, and no other."""
    write_exr(tmp_path / "sky.exr", np.random.default_rng(0).random((4, 8, 3), np.float32), half=False)
    given = "asset inputs:texture:file = @./sky.exr@\n"
    path = stage(tmp_path, mesh("A") + dome(given), 'upAxis = "Z"')
    write_bundle(tmp_path / "tiny.npz", tiny_bundle)
    scene = ms.Scene(path, ms.load_material(tmp_path / "tiny.npz"), size=(8, 8))
    still = settle(scene)
    write_folder(scene, tmp_path / "folder", Quality())
    np.testing.assert_array_equal(read_exr(tmp_path / "folder" / "sky.exr"), still.environment)
    look, camera = first_look(still), still.camera
    assert isinstance(camera, ms.Camera)
    shown = command(scene, scene_of_look(still, still, look, camera, True), look, "jax", 1)
    assert str(path) in shown and "--no-suns" not in shown and "--environment" not in shown and "--light" not in shown
    sun = replace(look, sun=(0.5, 0.5))
    assert "--light" in command(scene, scene_of_look(still, still, sun, camera, True), sun, "jax", 1)


READS = "UsdPrimvarReader_float2"
#: Of black and the code 128.
MEAN = [0.2158 / 2] * 3


@pytest.mark.parametrize(
    ("by", "more", "lies", "mean"),
    [
        ("", "", True, MEAN),
        (READS, "", True, MEAN),
        (READS, 'string inputs:varname = "st"', True, MEAN),
        (READS, 'string inputs:varname = "lightmap"', False, MEAN),
        ("UsdTransform2d", "", False, MEAN),
        ("", 'token inputs:sourceColorSpace = "sRGB"', True, MEAN),
        ("", 'token inputs:sourceColorSpace = "raw"', False, [0.25] * 3),
        ("", "float4 inputs:scale = (1, 1, 1, 1)", True, MEAN),
        ("", "float4 inputs:scale = (0.5, 1, 1, 1)", False, [MEAN[0] / 2, *MEAN[1:]]),
        ("", "float4 inputs:bias = (0.1, 0, 0, 0)", False, [MEAN[0] + 0.1, *MEAN[1:]]),
    ],
)
def test_an_image_is_kept_where_it_shows_as_it_is(tmp_path: Path, by: str, more: str, lies: bool, mean: list[float]):
    """One that is moved, or of other values or texture coordinates, has its mean alone."""
    Image.fromarray(np.repeat(np.array([[0, 128]], np.uint8), 3).reshape(1, 2, 3)).save(tmp_path / "half.png")
    looks = shader("Checked", "color3f inputs:diffuseColor.connect = </Checked/Read.outputs:rgb>")
    place = f"""float2 inputs:st.connect = </Checked/Place.outputs:result>
        }}
        def Shader "Place" {{
            uniform token info:id = "{by}"
            {more}
            float2 outputs:result"""
    looks = looks.replace("float3 outputs:rgb", f"float3 outputs:rgb\n            {place if by else more}")
    body = 'texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] ( interpolation = "vertex" )'
    (part,) = read_usd.parts(stage(tmp_path, mesh("A", f"{bound('Checked')}\n{body}", kind=API) + looks))
    assert part.look.colour == pytest.approx(mean, abs=2e-3) and (part.look.texture is not None) == lies
