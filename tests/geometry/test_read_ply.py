"""PLY files as Blender, MeshLab and trimesh write them: any polygons, either byte order, text, texture coordinates."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from mesoshell.errors import InputError
from mesoshell.geometry.read import read_mesh
from mesoshell.geometry.read_ply import TYPES

FORMS = ("ascii", "binary_little_endian", "binary_big_endian")
CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}


def write(path: Path, form: str, elements: list[tuple[str, list[tuple[str, ...]], list[list[Any]]]]) -> Path:
    """elements: name, properties as (type, name) or (length's type, type, name), and rows; a list is a row's entry."""
    head, body = ["ply", f"format {form} 1.0", "comment by hand"], b""
    order = ">" if "big" in form else "<"
    for name, properties, rows in elements:
        head.append(f"element {name} {len(rows)}")
        head += [f"property {'list ' if len(p) == 3 else ''}{' '.join(p)}" for p in properties]
        for row in rows:
            words: list[str] = []
            for p, value in zip(properties, row, strict=True):
                values = value if len(p) == 3 else [value]
                kind = order + CODES[TYPES[p[-2]]] * len(values)
                if len(p) == 3:
                    body += b"" if form == "ascii" else struct.pack(order + CODES[TYPES[p[0]]], len(values))
                    words.append(str(len(values)))
                body += b"" if form == "ascii" else struct.pack(kind, *values)
                words += [repr(x) for x in values]
            body += (" ".join(words) + "\n").encode() if form == "ascii" else b""
    path.write_bytes("\n".join([*head, "end_header", ""]).encode() + body)
    return path


CUBE = [[float(x), float(y), float(z)] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
XYZ = [("float", "x"), ("double", "y"), ("float32", "z")]
FACES = [("uchar", "uint", "vertex_indices")]
polygons = st.lists(st.integers(3, 6).flatmap(lambda n: st.permutations(range(8)).map(lambda p: p[:n])), min_size=1)


@given(st.sampled_from(FORMS), polygons)
def test_polygons_become_fans_in_order(tmp_path_factory: pytest.TempPathFactory, form: str, faces: list[list[int]]):
    path = tmp_path_factory.getbasetemp() / "fans.ply"
    points, triangles, uv = read_mesh(write(path, form, [("vertex", XYZ, CUBE), ("face", FACES, [[f] for f in faces])]))
    np.testing.assert_array_equal(points, CUBE)
    assert uv is None
    np.testing.assert_array_equal(triangles, [[f[0], f[k], f[k + 1]] for f in faces for k in range(1, len(f) - 1)])


@pytest.mark.parametrize("form", FORMS)
def test_other_properties_and_elements_are_passed_over(tmp_path: Path, form: str):
    vertices = [[k % 3, *p, 0.5 * k] for k, p in enumerate(CUBE)]
    kinds = [("uchar", "red"), *XYZ, ("float", "quality")]
    faces = [[1, [0, 1, 2], [9.0, 8.0]], [2, [2, 3, 5, 4], []], [3, [5, 6], [1.0]]]
    face = [("short", "flags"), ("int", "int", "vertex_index"), ("uchar", "double", "more")]
    edges = [[0, 1], [1, 2]]
    elements = [("edge", [("int", "a"), ("int", "b")], edges), ("vertex", kinds, vertices), ("face", face, faces)]
    points, triangles, _ = read_mesh(write(tmp_path / "a.ply", form, elements))  # type: ignore[arg-type]
    np.testing.assert_array_equal(points, CUBE)
    np.testing.assert_array_equal(triangles, [[0, 1, 2], [2, 3, 5], [2, 5, 4]])


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("names", [("s", "t"), ("u", "v"), ("texture_u", "texture_v")])
def test_texture_coordinates_of_vertices(tmp_path: Path, form: str, names: tuple[str, str]):
    vertices = [[*p, 0.1 * k, 1 - 0.1 * k] for k, p in enumerate(CUBE)]
    kinds = [*XYZ, *(("double", name) for name in names)]
    faces = [[[0, 1, 3, 2]], [[4, 5, 7]]]
    _, triangles, uv = read_mesh(write(tmp_path / "a.ply", form, [("vertex", kinds, vertices), ("face", FACES, faces)]))
    assert uv is not None
    np.testing.assert_allclose(uv[..., 0], 0.1 * triangles)
    np.testing.assert_allclose(uv[..., 1], 1 - 0.1 * triangles)


@pytest.mark.parametrize("form", FORMS)
def test_texture_coordinates_of_corners(tmp_path: Path, form: str):
    """As MeshLab lists them, some faces having none."""
    kinds = [*FACES, ("uchar", "double", "texcoord")]
    faces = [[[0, 1, 3, 2], [0, 0, 1, 0, 1, 1, 0, 1]], [[4, 5, 7], []]]
    _, _, uv = read_mesh(write(tmp_path / "a.ply", form, [("vertex", XYZ, CUBE), ("face", kinds, faces)]))
    assert uv is not None
    np.testing.assert_array_equal(uv[:2], [[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]])
    assert np.isnan(uv[2]).all()
    wrong = [[[0, 1, 3], [0, 0, 1]]]
    with pytest.raises(InputError, match=r"face 0 has 3 texture coordinates for 3 corners$"):
        read_mesh(write(tmp_path / "b.ply", form, [("vertex", XYZ, CUBE), ("face", kinds, wrong)]))


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_what_trimesh_writes(tmp_path: Path, encoding: str):
    ball = trimesh.creation.icosphere(2)
    ball.export(tmp_path / "ball.ply", encoding=encoding)
    points, triangles, _ = read_mesh(tmp_path / "ball.ply")
    np.testing.assert_allclose(points, ball.vertices, atol=1e-6)
    np.testing.assert_array_equal(triangles, ball.faces)


@pytest.mark.parametrize("form", FORMS)
def test_faults_are_one_line(tmp_path: Path, form: str):
    whole = write(tmp_path / "a.ply", form, [("vertex", XYZ, CUBE), ("face", FACES, [[[0, 1, 2]], [[3, 4, 9, 5]]])])
    with pytest.raises(InputError, match=r"face 1 refers to vertex 9, but there are 8$"):
        read_mesh(whole)
    data = whole.read_bytes()
    for name, damaged, fault in (
        ("short", data[:-3], "it is cut short"),
        ("word", data.replace(b"double", b"triple"), "triple"),
        ("form", data.replace(form.encode(), b"binary_middle"), "binary_middle"),
        ("none", data.replace(b"element face 2", b"element face 0"), "holds no triangles"),
        ("less", data.replace(b"element face 2", b"element face -2"), "its header says -2 of face"),
        ("flat", data.replace(b"32 z", b"32 w"), "its vertices have no z"),
        ("points", data.replace(b"vertex_indices", b"corners"), "has no faces: points alone"),
        ("line", data.replace(b"comment", b"remark!"), "its header has the line 'remark! by hand'"),
    ):
        path = tmp_path / f"{name}.ply"
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=fault) as raised:
            read_mesh(path)
        assert str(raised.value).startswith(f"{path}: ") and "\n" not in str(raised.value)


@pytest.mark.parametrize("form", FORMS)
def test_an_axis_that_is_a_list_is_none(tmp_path: Path, form: str):
    kinds = [("uchar", "float", "x"), *XYZ[1:]]
    vertices = [[[p[0]], *p[1:]] for p in CUBE]
    with pytest.raises(InputError, match=r"its vertices have no x$"):
        read_mesh(write(tmp_path / "a.ply", form, [("vertex", kinds, vertices), ("face", FACES, [[[0, 1, 2]]])]))
