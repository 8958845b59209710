"""Reading mesh files: what is read is what was written, and every fault is one line that names it."""

import json
import re
import struct
import zipfile
from base64 import b64decode, b64encode
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.exchange.gltf import export_gltf
from trimesh.visual import TextureVisuals

from mesoshell.errors import InputError
from mesoshell.geometry import read_usd
from mesoshell.geometry.image_texture import Look
from mesoshell.geometry.read import FORMATS, _parts, read_mesh, read_obj

DATA = Path(__file__).parents[1] / "data"
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
OFF = "OFF\n3 2 0\n0 0 0\n1 0 0\n0 1 0\n"
FACE = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"


def obj(folder: Path, text: str) -> Path:
    path = folder / "mesh.obj"
    path.write_text(text)
    return path


def test_every_corner_of_spot_is_read_as_written():
    lines = [line.split() for line in (DATA / "spot.obj").read_text().splitlines()]
    v = np.array([line[1:] for line in lines if line and line[0] == "v"], float)
    vt = np.array([line[1:3] for line in lines if line and line[0] == "vt"], float)
    f = np.array([[c.split("/")[:2] for c in line[1:]] for line in lines if line and line[0] == "f"], int) - 1
    points, faces, uv = read_obj(DATA / "spot.obj")
    assert uv is not None
    assert faces.shape == (5856, 3) and len(vt) == 3225
    np.testing.assert_array_equal(points[faces], v[f[..., 0]])
    np.testing.assert_array_equal(uv, vt[f[..., 1]])


def test_polygons_become_fans_in_their_order(tmp_path: Path):
    text = SQUARE + "usemtl B\nf 1 2 3 4\nusemtl A\nf 4 3 2\nusemtl B\nf 2 1 4 \\\n3 # turned over\n"
    faces = read_obj(obj(tmp_path, text))[1]
    assert faces.tolist() == [[0, 1, 2], [0, 2, 3], [3, 2, 1], [1, 0, 3], [1, 3, 2]]


def test_negative_numbers_count_from_the_last_vertex_read(tmp_path: Path):
    points, faces, _ = read_obj(obj(tmp_path, SQUARE + "f -4 -3 -2\n" + "v 5 0 0\nv 6 0 0\nv 6 1 0\nf -3 -2 -1\n"))
    assert points[faces[0]].tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    assert points[faces[1]].tolist() == [[5, 0, 0], [6, 0, 0], [6, 1, 0]]


def test_corners_without_texture_are_nan_and_none_if_all_are(tmp_path: Path):
    uv = read_obj(obj(tmp_path, SQUARE + "vt 0.25\nvt 1 0.5 0\nf 1/1 2/2/ 3/2/7\nf 1//1 3 4\n"))[2]
    assert uv is not None
    np.testing.assert_array_equal(uv[0], [[0.25, 0], [1, 0.5], [1, 0.5]])
    assert np.isnan(uv[1]).all()
    assert read_obj(obj(tmp_path, SQUARE + "vt 0 0\nf 1 2 3\n"))[2] is None


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (SQUARE + "f 1 2 9\n", "line 5: face refers to vertex 9, but there are 4"),
        (SQUARE + "f 1 2 0\n", "line 5: face refers to vertex 0, but vertex numbers start at 1 and 4 came before"),
        (SQUARE + "f 1 2 -5\n", "line 5: face refers to vertex -5, but vertex numbers start at 1 and 4 came before"),
        (SQUARE + "vt 0 0\nf 1/1 2/1 3/2\n", "line 6: face refers to texture vertex 2, but there are 1"),
        (SQUARE + "f 1 2\n", "line 5: a face needs 3 corners and this one has 2"),
        (SQUARE + "f 1 2 x\n", "line 5: invalid literal for int() with base 10: 'x'"),
        ("v 0 0\n", "line 1: needs 3 numbers and has 2"),
        ("v 0 0 zero\n", "line 1: could not convert string to float: 'zero'"),
    ],
)
def test_faults_of_obj_files_name_the_line(tmp_path: Path, text: str, fault: str):
    path = obj(tmp_path, text)
    with pytest.raises(InputError) as raised:
        read_mesh(path)
    assert str(raised.value) == f"{path}: {fault}"


def test_faults_of_paths(tmp_path: Path):
    for path, fault in (
        (tmp_path, "is a folder, not a mesh file"),
        (tmp_path / "none.obj", "no such file"),
    ):
        with pytest.raises(InputError) as raised:
            read_mesh(path)
        assert str(raised.value) == f"{path}: {fault}"
    (tmp_path / "mesh.fbx").write_text("")
    with pytest.raises(
        InputError,
        match=r"unknown mesh format '\.fbx': use \.obj, .*, \.3mf, \.dae, \.zae, .*, \.usdz, or one of them in a \.zip$",
    ):
        read_mesh(tmp_path / "mesh.fbx")


@pytest.mark.parametrize(
    ("name", "content", "fault"),
    [
        ("mesh.ply", b"", r"is not a readable PLY file: its header .+$"),
        ("mesh.ply", PLY.encode(), r"is not a readable PLY file: its header .+$"),
        ("mesh.off", b"OFF\n", r"is not a readable OFF file: its header has no beginning, or no numbers$"),
        ("mesh.off", b"PLY\n3 1 0\n", r"is not a readable OFF file: its header has no beginning, or no numbers$"),
        ("mesh.off", (OFF + "3 0 1 2\n").encode(), r"is cut short: it has 4 of 5 lines of vertices and faces$"),
        ("mesh.gltf", b'{"buffers": [{"uri": "none.bin", "byteLength": 9}]}', r"its buffer 'none\.bin' is missing$"),
        ("mesh.gltf", b'{"buffers": [{"byteLength": 9}]}', r"its buffer '' is no file of its folder$"),
        (
            "mesh.gltf",
            b'{"buffers": [{"uri": "../a.bin", "byteLength": 9}]}',
            r"its buffer '\.\./a\.bin' is no file of its folder$",
        ),
        ("mesh.gltf", b'{"buffers": [{"uri": "%2e%2e/a.bin", "byteLength": 9}]}', r" is no file of its folder$"),
        ("mesh.gltf", b'{"buffers": [{"uri": "/etc/passwd", "byteLength": 9}]}', r" is no file of its folder$"),
        (
            "mesh.gltf",
            b'{"buffers": [{"uri": "mesh.gltf", "byteLength": 99}]}',
            r"is cut short: it has 53 of 99 bytes$",
        ),
        ("mesh.gltf", b"[]", r"is not a readable GLTF file"),
        ("mesh.glb", b"glTF\x02\0\0\0", r"is not a readable GLB file: its header is not that of GLB$"),
        (
            "mesh.ply",
            (PLY + FACE + "0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n").encode(),
            "face 0 refers to vertex 7, but there are 3$",
        ),
    ],
)
def test_unreadable_files_are_one_line(tmp_path: Path, name: str, content: bytes, fault: str):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=fault) as raised:
        read_mesh(tmp_path / name)
    assert "\n" not in str(raised.value) and str(raised.value).startswith(str(tmp_path / name))


def write_usd(path: Path, points: np.ndarray, faces: np.ndarray, uv: np.ndarray) -> None:
    """By OpenUSD itself."""
    Sdf, Usd, UsdGeom, UsdUtils = (read_usd.pxr(name) for name in ("Sdf", "Usd", "UsdGeom", "UsdUtils"))
    made = path.with_name("made.usdc") if path.suffix == ".usdz" else path
    stage = Usd.Stage.CreateNew(str(made))
    mesh = UsdGeom.Mesh.Define(stage, "/Ball")
    mesh.CreatePointsAttr(points.tolist())
    mesh.CreateFaceVertexCountsAttr([3] * len(faces))
    mesh.CreateFaceVertexIndicesAttr(faces.ravel().tolist())
    coordinates = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "vertex")
    coordinates.Set(uv.tolist())
    stage.Save()
    if made != path:
        UsdUtils.CreateNewUsdzPackage(str(made), str(path))


def test_the_same_mesh_in_every_format(tmp_path: Path):
    ball = trimesh.creation.icosphere(1)
    uv = np.random.default_rng(0).random((len(ball.vertices), 2))
    textured = trimesh.Trimesh(ball.vertices, ball.faces, visual=TextureVisuals(uv=uv), process=False)
    for kind in ("obj", "ply", "glb", "off", "stl", "3mf", "dae"):
        textured.export(tmp_path / f"ball.{kind}")
    with zipfile.ZipFile(tmp_path / "ball.zae", "w") as archive:
        archive.write(tmp_path / "ball.dae", "ball.dae")
    parts = export_gltf(trimesh.Scene(textured))
    for name, data in parts.items():
        data = data.replace(b'"gltf_buffer', b'"a%20buffer')  # as exporters write names with spaces
        (tmp_path / ("ball.gltf" if name.endswith(".gltf") else name.replace("gltf_", "a "))).write_bytes(data)
    for kind in read_usd.FORMATS:
        write_usd(tmp_path / f"ball{kind}", ball.vertices, ball.faces, uv)
    for kind in FORMATS:
        points, faces, read_uv = read_mesh(tmp_path / f"ball{kind}")
        np.testing.assert_allclose(points[faces], ball.vertices[ball.faces], atol=1e-6)
        if kind in (".glb", ".gltf", ".obj", ".dae", ".zae", *read_usd.FORMATS):
            assert read_uv is not None
            np.testing.assert_allclose(read_uv, uv[ball.faces], atol=1e-6)


def test_a_gltf_file_needs_neither_materials_nor_a_scene(tmp_path: Path):
    """Its primitives keep their texture coordinates, and all of its nodes are read."""
    ball = trimesh.creation.icosphere(1)
    uv = np.random.default_rng(0).random((len(ball.vertices), 2))
    textured = trimesh.Trimesh(ball.vertices, ball.faces, visual=TextureVisuals(uv=uv), process=False)
    files = export_gltf(trimesh.Scene(textured))
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
    described = json.loads(files["model.gltf"])
    for key in ("materials", "scenes", "scene"):
        described.pop(key, None)
    for mesh in described["meshes"]:
        for primitive in mesh["primitives"]:
            primitive.pop("material", None)
    (tmp_path / "model.gltf").write_text(json.dumps(described))
    (part,) = _parts(tmp_path / "model.gltf", apart=True)
    points, faces, read_uv = part.arrays
    np.testing.assert_allclose(points[faces], ball.vertices[ball.faces], atol=1e-6)
    assert read_uv is not None and (part.look, part.material) == (Look(), [])
    np.testing.assert_allclose(read_uv, uv[ball.faces], atol=1e-6)


def write_gltf(path: Path, arrays: dict[str, tuple[np.ndarray, dict[str, Any]]], mode: int = 4, **more: Any) -> None:
    """A .gltf or .glb of one primitive. arrays: by attribute, or "indices": rows, and what their accessor says beside them.
    Rows of 6 bytes lie 8 apart, as exporters align them."""
    codes = {"b": 5120, "B": 5121, "h": 5122, "H": 5123, "I": 5125, "f": 5126}
    data, views, accessors = b"", [], []

    def view(x: np.ndarray) -> int:
        nonlocal data
        row = x.dtype.itemsize * x.shape[1]
        stride = {"byteStride": 8} if row == 6 else {}
        text = b"".join(r.tobytes().ljust(8 if row == 6 else row, b"\0") for r in x)
        views.append({"buffer": 0, "byteOffset": len(data), "byteLength": len(text)} | stride)
        data += text + b"\0" * (-len(text) % 4)
        return len(views) - 1

    for rows, said in arrays.values():
        kind = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}[rows.shape[1]]
        accessor = {"bufferView": view(rows), "componentType": codes[rows.dtype.char], "count": len(rows), "type": kind}
        if "sparse" in said:
            where, values = said["sparse"]
            indices = {"bufferView": view(where), "componentType": codes[where.dtype.char]}
            said = {"sparse": {"count": len(where), "indices": indices, "values": {"bufferView": view(values)}}}
        accessors.append(accessor | said)
    numbers = {name: k for k, name in enumerate(arrays)}
    primitive = {"mode": mode, "attributes": {k: v for k, v in numbers.items() if k != "indices"}}
    primitive |= {k: more.pop(k) for k in ("material",) if k in more}
    described = {
        "asset": {"version": "2.0"},
        "meshes": [{"primitives": [primitive | {k: v for k, v in numbers.items() if k == "indices"}]}],
        "nodes": [{"mesh": 0, "scale": [2, 2, 2]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(data)}],
    } | more
    if path.suffix == ".gltf":
        described["buffers"][0]["uri"] = "data:;base64," + b64encode(data).decode()
        path.write_text(json.dumps(described))
        return
    text = json.dumps(described).encode()
    text += b" " * (-len(text) % 4)
    size = 12 + 8 + len(text) + 8 + len(data)
    head = struct.pack("<4sII", b"glTF", 2, size) + struct.pack("<I4s", len(text), b"JSON") + text
    path.write_bytes(head + struct.pack("<I4s", len(data), b"BIN\0") + data)


@pytest.mark.parametrize("kind", [".gltf", ".glb"])
def test_quantized_and_sparse_geometry_and_fans_of_a_gltf_file_are_read(tmp_path: Path, kind: str):
    """As exporters that save space write them: shares of the greatest integer, rows that replace others, a fan of a polygon."""
    rng = np.random.default_rng(0)
    ball = trimesh.creation.icosphere(1)
    corner = ball.vertices[ball.faces]
    points = np.round(32767 * ball.vertices).astype(np.int16)
    points[np.argmin(points[:, 0]), 0] = -32768  # the least integer is -1 too
    uv, faces = rng.integers(0, 65536, (len(points), 2)).astype(np.uint16), ball.faces.astype(np.uint16).reshape(-1, 1)
    short = {"normalized": True}
    path = tmp_path / f"a{kind}"
    write_gltf(path, {"POSITION": (points, short), "TEXCOORD_0": (uv, short), "indices": (faces, {})})
    found, order, read_uv = read_mesh(path)
    np.testing.assert_allclose(found[order], 2 * corner, rtol=0, atol=1.01 / 32767)
    assert read_uv is not None  # v of glTF goes down
    np.testing.assert_allclose(np.abs(read_uv - [0, 1]), uv[ball.faces] / 65535, atol=1e-6)

    where = np.array([[3], [5]], np.uint8)
    wrong = ball.vertices.astype(np.float32)
    wrong[[3, 5]] = 7.0
    sparse = {"sparse": (where, ball.vertices[[3, 5]].astype(np.float32))}
    write_gltf(path, {"POSITION": (wrong, sparse), "indices": (faces, {})})
    found, order, _ = read_mesh(path)
    np.testing.assert_allclose(found[order], 2 * corner, atol=1e-6)

    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    corners, third = np.array([[0], [1], [2], [3]], np.uint8), np.array([[2]], np.uint8)
    wrong = np.where(corners == 2, 0, corners).astype(np.uint8)
    for indices in ({}, {"indices": (corners, {})}, {"indices": (wrong, {"sparse": (third, third)})}):
        write_gltf(path, {"POSITION": (square, {})} | indices, mode=6)
        found, order, _ = read_mesh(path)
        np.testing.assert_allclose(found[order], 2 * square[[[0, 1, 2], [0, 2, 3]]], atol=1e-6)


def test_what_quantizers_do_to_texture_coordinates_is_undone(tmp_path: Path):
    """They keep their range in a material's KHR_texture_transform. Accessors are shared, and the buffer is a file."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 1]], np.float32)
    uv, faces = (
        np.array([[0, 255], [51, 0], [102, 204], [255, 5]], np.uint8),
        np.array([[0, 1, 2, 1, 3, 2]], np.uint8).T,
    )
    whole, order = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.uint8), [[0, 1, 2], [1, 3, 2]]
    more = {"POSITION": (points, {}), "indices": (faces, {}), "TEXCOORD_0": (uv, {"normalized": True})}
    path = tmp_path / "a.gltf"
    write_gltf(path, more | {"OTHER": (whole, {})})
    described = json.loads(path.read_text())
    buffer = described["buffers"][0]
    (tmp_path / "a b.bin").write_bytes(b64decode(buffer["uri"].split(",")[1]))
    buffer["uri"] = "a%20b.bin"
    ranged = {"extensions": {"KHR_texture_transform": {"scale": [0.25, 3], "offset": [0.5, 0]}}}
    described["materials"] = [{"name": "a", "normalTexture": {"index": 0} | ranged}, {"name": "b"}, {"name": "c"}]
    (first,) = described["meshes"][0]["primitives"]
    counted = first | {"attributes": first["attributes"] | {"TEXCOORD_0": first["attributes"]["OTHER"]}}
    described["meshes"][0]["primitives"] = [first | {"material": 0}, first | {"material": 1}, counted | {"material": 2}]
    path.write_text(json.dumps(described))
    parts = {part.material[0]: part.arrays for part in _parts(path, apart=True)}
    share = uv / np.float32(255)
    for material, wanted in {"a": share * [0.25, 3] + [0.5, 0], "b": share, "c": whole}.items():
        found, triangles, read_uv = parts[material]
        np.testing.assert_allclose(found[triangles], 2 * points[order], atol=1e-6)
        assert read_uv is not None
        np.testing.assert_allclose(read_uv * [1, -1] + [0, 1], wanted[order], atol=1e-6)


@pytest.mark.parametrize("only_normals", [False, True])
def test_an_image_lies_where_quantizers_leave_it(only_normals: bool, tmp_path: Path):
    """The base colour's texture is found under its moved coordinates; what only a normal map says moves nothing."""
    points, faces = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32), np.array([[0, 1, 2]], np.uint8).T
    uv = np.array([[0, 255], [51, 0], [102, 204]], np.uint8)
    path = tmp_path / "a.glb"
    Image.new("RGB", (2, 2), (255, 0, 0)).save(tmp_path / "a.png")
    way = {"scale": [0.5, 0.5], "offset": [0.25, 0], "texCoord": 0}
    ranged, still = {"index": 0, "texCoord": 1, "extensions": {"KHR_texture_transform": way}}, {"index": 0}
    base = {"pbrMetallicRoughness": {"baseColorTexture": still if only_normals else ranged}}
    write_gltf(
        path,
        {"POSITION": (points, {}), "indices": (faces, {}), "TEXCOORD_0": (uv, {"normalized": True})},
        materials=[base | ({"normalTexture": ranged} if only_normals else {})],
        textures=[{"source": 0}],
        images=[{"uri": "a.png"}],
        material=0,
    )
    (part,) = _parts(path, apart=True)
    assert part.look.texture is not None
    read_uv = part.arrays[2]
    assert read_uv is not None
    wanted = uv / np.float32(255) * (1 if only_normals else 0.5) + (0 if only_normals else np.array([0.25, 0]))
    np.testing.assert_allclose(read_uv[0] * [1, -1] + [0, 1], wanted, atol=1e-6)


def test_damaged_or_packed_geometry_of_a_gltf_file_is_one_line(tmp_path: Path):
    ball, path = trimesh.creation.icosphere(1), tmp_path / "a.gltf"
    points, faces = ball.vertices.astype(np.float32), ball.faces.astype(np.uint16).reshape(-1, 1)
    plain = {"POSITION": (points, {}), "indices": (faces, {})}
    write_gltf(path, plain, extensionsRequired=["KHR_draco_mesh_compression"])
    with pytest.raises(InputError) as raised:
        read_mesh(path)
    assert (
        str(raised.value)
        == f"{path}: needs KHR_draco_mesh_compression, which is not read: export it without compression"
    )
    beyond = {"sparse": (np.array([[200]], np.uint8), points[:1])}
    cases = {
        "damaged": (points, beyond),
        "would take": (points, {"count": 10**13, "normalized": True, "componentType": 5121}),
    }
    for words, position in cases.items():
        write_gltf(path, plain | {"POSITION": position})
        with pytest.raises(InputError, match=rf"^{re.escape(str(path))}: [^\n]*{words}[^\n]*$"):
            read_mesh(path)


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_line_of_an_obj_file_may_go_on_in_the_next(tmp_path: Path, end: str):
    lines = ["v 0 0 0", "v 1 0 0", "v 0 1 0", "f 1 2 \\", "3", "f 1 2 9"]
    (tmp_path / "a.obj").write_bytes(end.join(lines[:-1]).encode())
    assert read_mesh(tmp_path / "a.obj")[1].tolist() == [[0, 1, 2]]
    (tmp_path / "a.obj").write_bytes(end.join(lines).encode())
    with pytest.raises(InputError, match="line 6: face refers to vertex 9"):
        read_mesh(tmp_path / "a.obj")


def test_scenes_are_joined_with_their_transforms(tmp_path: Path):
    box, scene = trimesh.creation.box(), trimesh.Scene()
    scene.add_geometry(box, transform=np.diag([-2.0, 1, 1, 1]))
    scene.add_geometry(box, transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    scene.add_geometry(trimesh.PointCloud(np.ones((4, 3))))
    scene.export(str(tmp_path / "scene.glb"))
    points, faces, uv = read_mesh(tmp_path / "scene.glb")
    assert uv is None and len(faces) == 24
    np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], [[-1, -0.5, -0.5], [5.5, 0.5, 0.5]])
    a, b, c = np.moveaxis(points[faces], 1, 0)
    volumes = np.einsum("fi,fi->f", a, np.cross(b, c)).reshape(2, 12).sum(axis=1) / 6
    np.testing.assert_allclose(np.sort(volumes), [1, 2])  # a mirrored part still faces outward


def test_an_off_file_may_have_any_polygons(tmp_path: Path):
    """As fans; with colours, comments, counts beside the name. Of other dimensions, or with wrong corners, it is refused."""
    rim = [f"{np.cos(a):.6f} {np.sin(a):.6f} 0 255 0 0" for a in 2 * np.pi * np.arange(5) / 5]
    body = "\n".join([*rim, "0 0 1", "5 4 3 2 1 0 0.5 0.5 0.5  # below", "3 0 1 5", "4 1 2 3 5"])
    path = tmp_path / "mesh.off"
    for head in ("OFF\n# five, and a top\n6 3 0\n", "COFF 6 3 0\n"):
        path.write_text(head + body + "\n")
        points, faces, uv = read_mesh(path)
        assert len(points) == 6 and uv is None
        assert faces.tolist() == [[4, 3, 2], [4, 2, 1], [4, 1, 0], [0, 1, 5], [1, 2, 3], [1, 3, 5]]
    for text, said in (
        (OFF + "3 0 1 2\n3 0 1 7\n", "line 7: face refers to a vertex beyond 3"),
        (OFF + "3 0 1 2\n3 0 1\n", "line 7: a face of 3 has 2 corners"),
        (OFF.replace("1 0 0", "1 0") + "3 0 1 2\n3 0 1 2\n", "line 4: needs 3 numbers and has 2"),
        ("4OFF\n3 1 0\n0 0 0 1\n1 0 0 1\n0 1 0 1\n3 0 1 2\n", "is of 4OFF, whose vertices are not of three numbers"),
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=said):
            read_mesh(path)


@pytest.mark.parametrize("mode", [0, 1, 2, 3, 4, 5])
def test_what_hangs_on_lines_is_read(tmp_path: Path, mode: int):
    """A node of lines or points, or of triangles, with another below it."""
    corners, order = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32), np.array([0, 1, 2], np.uint32)
    data = corners.tobytes() + order.tobytes()
    primitive = {"attributes": {"POSITION": 0}, "indices": 1}
    accessors = [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}]
    accessors.append({"bufferView": 1, "componentType": 5125, "count": 3, "type": "SCALAR"})
    described = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "children": [1]}, {"mesh": 1, "translation": [0, 0, 2]}],
        "meshes": [{"primitives": [primitive | {"mode": mode}]}, {"primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 12}],
        "buffers": [{"byteLength": 48, "uri": "data:application/octet-stream;base64," + b64encode(data).decode()}],
    }
    (tmp_path / "a.gltf").write_text(json.dumps(described))
    points, faces, _ = read_mesh(tmp_path / "a.gltf")
    assert len(faces) == (2 if mode in (4, 5) else 1) and points[faces[-1], 2].tolist() == [2, 2, 2]
