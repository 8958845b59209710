"""PLY files to arrays, as they are written.

Notation
row         of an element: one vertex, or one face
list        a property that has a length of its own in each row: the corners of a face

trimesh's reader (5.2) refuses binary files whose faces do not all have the same number of corners, which Blender writes by
default, and drops texture coordinates.

Source: Turk 1994, The PLY polygon file format.
"""

from collections.abc import Iterator
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from mesoshell.errors import InputError

_SHORT = {"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"}
_LONG = {"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4", "float32": "f4"}
TYPES = _SHORT | _LONG | dict.fromkeys(("double", "float64"), "f8")
ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
#: What writers call a vertex's texture coordinates, and a face's corners.
UVS, CORNERS = (("s", "t"), ("u", "v"), ("texture_u", "texture_v")), ("vertex_indices", "vertex_index")
#: What is put behind a list's name for its length.
LENGTH = "'s length"


class Property(NamedTuple):
    """kind: NumPy's type; length: the type of a list's length, empty for a number."""

    name: str
    kind: str
    length: str = ""


class Element(NamedTuple):
    """count: of its rows."""

    name: str
    count: int
    properties: list[Property]


#: Numbers of all rows, or blocks of the lists of neighbouring rows that are as long, in order.
Column = Float[np.ndarray, "_"] | list[np.ndarray]


def read_ply(
    path: str | PathLike[str],
) -> tuple[Float[np.ndarray, "_ 3"], Int[np.ndarray, "_ 3"], Float[np.ndarray, "_ 3 2"] | None]:
    """Positions, triangles and corner UVs (None without any). A polygon becomes a fan about its first corner. Raises
    InputError, or ValueError for what is no such file."""
    head, _, data = Path(path).read_bytes().partition(b"end_header")
    order, elements = _header(head.decode("ascii", errors="replace"))
    body = data[data.index(b"\n") + 1 :]
    if order == "=":  # text, as if it were binary numbers
        body = np.array([float(word) for word in body.split()], np.float64).tobytes()
        elements = [
            Element(e.name, e.count, [p._replace(kind="f8", length=p.length and "f8") for p in e.properties])
            for e in elements
        ]
    columns = dict(_columns(body, elements, order))
    vertex, face = columns.get("vertex", {}), columns.get("face", {})
    vertex = {name: column for name, column in vertex.items() if not isinstance(column, list)}
    missing = [axis for axis in "xyz" if axis not in vertex]
    if missing:
        raise InputError(path, f"its vertices have no {missing[0]}")
    points = np.stack([np.asarray(vertex[axis], np.float64) for axis in "xyz"], axis=1)
    corners = next((face[name] for name in CORNERS if name in face), None)
    if corners is None:
        raise InputError(path, "has no faces: points alone cannot be grown over")
    triangles, row = _fans(corners)
    outside = np.flatnonzero(((triangles < 0) | (triangles >= len(points))).any(axis=1))
    if len(outside):
        bad = triangles[outside[0]]
        wrong = bad[(bad < 0) | (bad >= len(points))][0]
        raise InputError(path, f"face {row[outside[0]]} refers to vertex {wrong}, but there are {len(points)}")
    if "texcoord" in face:
        return points, triangles, _listed(path, face["texcoord"], corners)
    names = next((pair for pair in UVS if pair[0] in vertex and pair[1] in vertex), None)
    if names is None:
        return points, triangles, None
    return points, triangles, np.stack([np.asarray(vertex[name], np.float64) for name in names], axis=1)[triangles]


def _header(text: str) -> tuple[str, list[Element]]:
    """Byte order, and the elements."""
    order, elements = None, []
    for words in map(str.split, text.splitlines()[1:]):
        match words:
            case ["format", form, *_] if form in ORDERS:
                order = ORDERS[form]
            case ["element", name, count]:
                if int(count) < 0:
                    raise ValueError(f"its header says {count} of {name}")
                elements.append(Element(name, int(count), []))
            case ["property", "list", length, kind, name] if {length, kind} <= TYPES.keys():
                elements[-1].properties.append(Property(name, TYPES[kind], TYPES[length]))
            case ["property", kind, name] if kind in TYPES:
                elements[-1].properties.append(Property(name, TYPES[kind]))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise ValueError(f"its header has the line {' '.join(words)!r}")
    if order is None:
        raise ValueError("its header names no format")
    return order, elements


def _columns(data: bytes, elements: list[Element], order: str) -> Iterator[tuple[str, dict[str, Column]]]:
    """Columns of each element, by names."""
    at = 0
    for e in elements:
        blocks: list[np.ndarray] = []
        left = most = e.count
        while left:
            kind = _row(data, at, e, order)
            count = min(left, most, (len(data) - at) // max(kind.itemsize, 1))
            if not count:
                raise ValueError("it is cut short")
            rows = np.frombuffer(data, kind, count, at) if kind.itemsize else np.zeros(count, kind)
            same = np.ones(count, bool)
            for p in e.properties:
                same &= rows[p.name + LENGTH] == rows[p.name + LENGTH][0] if p.length else True
            good = count if same.all() else int(np.argmin(same))
            blocks.append(rows[:good])
            at, left, most = at + good * kind.itemsize, left - good, 2 * most if good == count else 1
        yield e.name, {p.name: _column(blocks, p) for p in e.properties}


def _column(blocks: list[np.ndarray], p: Property) -> Column:
    parts = [block[p.name] for block in blocks]
    return parts if p.length else np.concatenate([np.zeros(0), *parts])


def _row(data: bytes, at: int, e: Element, order: str) -> np.dtype:
    """NumPy's type of the row that begins here."""
    fields: list[Any] = []
    for p in e.properties:
        n: tuple[int, ...] = ()
        if p.length:
            begin, size = at + np.dtype(fields).itemsize, int(p.length[1])
            if begin + size > len(data):
                raise ValueError("it is cut short")
            length = np.frombuffer(data, order + p.length, 1, begin)[0]
            if not 0 <= length <= len(data):
                raise ValueError(f"a list has {length:g} entries")
            n = (int(length),)
            fields.append((p.name + LENGTH, order + p.length))
        fields.append((p.name, order + p.kind, n))
    return np.dtype(fields)


def _fans(corners: Column) -> tuple[Int[np.ndarray, "T 3"], Int[np.ndarray, "T"]]:
    """Triangles of polygons, in order, and the polygon of each."""
    triangles, rows, begin = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)], 0
    for block in corners:
        count, n = block.shape
        triangles.append(block.astype(np.int64)[:, _fan(n)].reshape(-1, 3))
        rows.append(np.repeat(np.arange(begin, begin + count), max(n - 2, 0)))
        begin += count
    return np.concatenate(triangles), np.concatenate(rows)


def _fan(n: int) -> Int[np.ndarray, "F 3"]:
    k = np.arange(1, max(n - 1, 1))
    return np.stack([0 * k, k, k + 1], axis=1)


def _listed(path: str | PathLike[str], given: Column, corners: Column) -> Float[np.ndarray, "T 3 2"]:
    """UVs of triangles that faces list for their corners; NaN in faces that list none."""
    uv, sizes = [row for block in given for row in block], [len(row) for block in corners for row in block]
    out = [np.zeros((0, 3, 2))]
    for k, (own, n) in enumerate(zip(uv, sizes, strict=True)):
        if len(own) not in (0, 2 * n):
            raise InputError(path, f"face {k} has {len(own)} texture coordinates for {n} corners")
        pairs = own.astype(np.float64).reshape(-1, 2) if len(own) else np.full((n, 2), np.nan)
        out.append(pairs[_fan(n)])
    return np.concatenate(out)
