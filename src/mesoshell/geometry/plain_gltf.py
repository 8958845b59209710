"""Write a glTF file's geometry as floats and triangles, where it holds what trimesh reads as something else.

Notation
buffer     bytes, of which a view is a part, and an accessor an array in a view           (count, columns)
normalized integers that stand for shares of the greatest, −1 to 1 or 0 to 1 (glTF 2.0, section 3.6.2.2)
sparse     some rows of an accessor are replaced by others, by their numbers
fan        triangles between a first vertex and each two that follow each other
moved      texture coordinates t stand for offset + scale t: KHR_texture_transform, by which quantizers keep their range
"""

import base64
from collections.abc import Container
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from mesoshell.limits import check_memory

#: Of an accessor: its numbers by their code, and its columns by its type.
NUMBERS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}
#: Modes of a primitive.
TRIANGLES, FAN = 4, 6
MOVED = "KHR_texture_transform"
#: Bytes that rewriting takes a row, base64 in the description included.
_ROW = 128


def plain(described: dict[str, Any], binary: memoryview | None, path: Path) -> None:
    """Rewrite positions, texture coordinates and indices that are quantized or sparse, and fans, in place, as buffers in the
    description. binary: of a .glb, its first buffer. Raises LookupError, TypeError, ValueError or OSError for a damaged file,
    and InputError for one that needs more memory than there is."""
    primitives = [p for mesh in described.get("meshes", []) for p in mesh.get("primitives", [])]
    accessors = described.get("accessors", [])
    fans = [p for p in primitives if p.get("mode") == FAN]
    slots = [(p, p["attributes"], name) for p in primitives for name in ("POSITION", "TEXCOORD_0")]
    slots += [(p, p, "indices") for p in primitives if p.get("mode") != FAN]
    slots = [(p, x, name) for p, x, name in slots if name in x]
    odd = [(p, x, name) for p, x, name in slots if _is_odd(accessors[x[name]], name)]
    if not odd and not fans:
        return
    moved = _moved(described, {p.get("material") for p, _, name in odd if name == "TEXCOORD_0"})
    odd = [s for s in slots if _is_odd(accessors[s[1][s[2]]], s[2]) or _mover(s[0], s[2], moved) is not None]
    written: dict[tuple[int, str, int | None], int] = {}
    for p, x, name in odd:
        written[x[name], name, _mover(p, name, moved)] = -1
    counts = [accessors[k]["count"] for k, _, _ in written]
    counts += [3 * accessors[p.get("indices", p["attributes"]["POSITION"])]["count"] for p in fans]
    check_memory(path, "its geometry", _ROW * sum(counts))
    source = _Source(described, [_bytes(x, binary, path.parent) for x in described.get("buffers", [])])
    for p in fans:
        points = accessors[p["attributes"]["POSITION"]]["count"]
        order = source.rows(accessors[p["indices"]], "indices")[:, 0] if "indices" in p else np.arange(points)
        first = np.repeat(order[:1], max(len(order) - 2, 0))
        triangles = np.stack([first, order[1 : 1 + len(first)], order[2:]], axis=1)
        p |= {"mode": TRIANGLES, "indices": _append(described, triangles.astype(np.uint32).reshape(-1, 1))}
    for number, name, material in written:
        rows = source.rows(accessors[number], name)
        if material is not None:
            scale, offset = moved[material]
            rows = (offset + scale * rows).astype(np.float32)
        written[number, name, material] = _append(described, rows)
    for p, x, name in odd:
        x[name] = written[x[name], name, _mover(p, name, moved)]


def _mover(primitive: dict[str, Any], name: str, moved: Container[int | None]) -> int | None:
    """The material that moves an accessor of a primitive, if any."""
    material = primitive.get("material")
    return material if name == "TEXCOORD_0" and material in moved else None


def _is_odd(accessor: dict[str, Any], name: str) -> bool:
    """trimesh counts texture coordinates down from 1 in their own type, which of integers wraps around."""
    whole = NUMBERS[accessor["componentType"]] != "<f4"
    short = name != "indices" and accessor.get("normalized", False)
    return "sparse" in accessor or (whole and (short or name == "TEXCOORD_0"))


def _moved(described: dict[str, Any], materials: set[int | None]) -> dict[int | None, tuple[np.ndarray, np.ndarray]]:
    """Scale and offset of these materials' texture coordinates, which their textures then no longer say. Textures that move
    them otherwise than each other, or turn them, go on saying so."""
    found = {}
    for k in materials - {None}:
        material = described["materials"][k]
        glossy = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness", {})
        parts = (material, material.get("pbrMetallicRoughness", {}), glossy)
        textures = [x for part in parts for x in part.values() if isinstance(x, dict) and "index" in x]
        said = [(x, x.get("extensions", {}).get(MOVED, {})) for x in textures]
        said = [(x, how) for x, how in said if how.get("texCoord", x.get("texCoord", 0)) == 0]
        ways = {(*how.get("scale", (1, 1)), *how.get("offset", (0, 0)), how.get("rotation", 0)) for _, how in said}
        if len(ways) != 1 or (way := ways.pop())[4] != 0 or way == (1, 1, 0, 0, 0):
            continue
        found[k] = np.array(way[:2], np.float32), np.array(way[2:4], np.float32)
        for texture, _ in said:
            texture.get("extensions", {}).pop(MOVED, None)
            texture["texCoord"] = 0
    return found


def _bytes(buffer: dict[str, Any], binary: memoryview | None, folder: Path) -> bytes | memoryview:
    uri = buffer.get("uri")
    if uri is None:
        return b"" if binary is None else binary
    if uri.startswith("data:"):
        return base64.b64decode(uri[uri.index(",") + 1 :])
    if not (file := (folder / unquote(uri)).resolve()).is_relative_to(folder.resolve()):
        raise ValueError(f"its buffer {uri!r} is no file of its folder")
    return file.read_bytes()


class _Source:
    """A description and the bytes of its buffers."""

    def __init__(self, described: dict[str, Any], buffers: list[bytes | memoryview]) -> None:
        self._views, self._buffers = described.get("bufferViews", []), [memoryview(x) for x in buffers]

    def rows(self, accessor: dict[str, Any], name: str) -> np.ndarray:
        """(count, columns): of an attribute float32, else integers."""
        kind, columns = np.dtype(NUMBERS[accessor["componentType"]]), COLUMNS[accessor["type"]]
        shape = accessor["count"], columns
        rows = self._array(accessor, shape, kind).copy() if "bufferView" in accessor else np.zeros(shape, kind)
        if (sparse := accessor.get("sparse")) is not None:
            which, several = sparse["indices"], sparse["count"]
            where = self._array(which, (several, 1), np.dtype(NUMBERS[which["componentType"]]))[:, 0]
            rows[where] = self._array(sparse["values"], (several, columns), kind)
        if name == "indices":
            return rows
        if accessor.get("normalized", False) and kind.kind != "f":
            rows = np.maximum(rows / np.float32(np.iinfo(kind).max), -1)
        return rows.astype(np.float32)

    def _array(self, part: dict[str, Any], shape: tuple[int, int], kind: np.dtype) -> np.ndarray:
        """The array that begins in a view."""
        view, begin = self._views[part["bufferView"]], part.get("byteOffset", 0)
        start = view.get("byteOffset", 0)
        data = self._buffers[view["buffer"]][start : start + view["byteLength"]]
        return np.ndarray(shape, kind, data, begin, (view.get("byteStride", kind.itemsize * shape[1]), kind.itemsize))


def _append(described: dict[str, Any], rows: np.ndarray) -> int:
    """The number of a new accessor of these rows, in a buffer of its own."""
    data = np.ascontiguousarray(rows).tobytes()
    buffers, views = described.setdefault("buffers", []), described.setdefault("bufferViews", [])
    uri = "data:application/octet-stream;base64," + base64.b64encode(data).decode()
    buffers.append({"uri": uri, "byteLength": len(data)})
    views.append({"buffer": len(buffers) - 1, "byteLength": len(data)})
    code = next(k for k, v in NUMBERS.items() if np.dtype(v) == rows.dtype)
    kind = next(k for k, n in COLUMNS.items() if n == rows.shape[1])
    described["accessors"].append(
        {"bufferView": len(views) - 1, "componentType": code, "count": len(rows), "type": kind}
    )
    return len(described["accessors"]) - 1
