"""Write a glTF file's geometry as floats and triangles, where it holds what trimesh reads as something else.

Notation
buffer     bytes, of which a view is a part, and an accessor an array in a view           (count, columns)
normalized integers that stand for shares of the greatest, −1 to 1 or 0 to 1 (glTF 2.0, section 3.6.2.2)
sparse     some rows of an accessor are replaced by others, by their numbers
fan        triangles between a first vertex and each two that follow each other
moved      texture coordinates t stand for offset + scale t: KHR_texture_transform, by which quantizers keep their range
"""

import base64
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
_ROW = 64


def plain(described: dict[str, Any], binary: bytes | None, path: Path) -> None:
    """Rewrite positions, texture coordinates and indices that are quantized or sparse, and fans, in place, as buffers in the
    description. binary: of a .glb, its first buffer. Raises LookupError, TypeError, ValueError or OSError for a damaged file,
    and InputError for one that needs more memory than there is."""
    primitives = [p for mesh in described.get("meshes", []) for p in mesh.get("primitives", [])]
    accessors = described.get("accessors", [])
    slots = [(p["attributes"], name) for p in primitives for name in ("POSITION", "TEXCOORD_0")]
    slots = [(x, name) for x, name in [*slots, *((p, "indices") for p in primitives)] if name in x]
    odd = {(x[name], name) for x, name in slots if _is_odd(accessors[x[name]], name)}
    fans = [p for p in primitives if p.get("mode") == FAN]
    if not odd and not fans:
        return
    counts = [accessors[k]["count"] for k, _ in odd]
    counts += [3 * accessors[p.get("indices", p["attributes"]["POSITION"])]["count"] for p in fans]
    check_memory(path, "its geometry", _ROW * sum(counts))
    source = _Source(described, [_bytes(x, binary, path.parent) for x in described.get("buffers", [])])
    moved = _moved(described, {p.get("material") for p in primitives if (_uv(p), "TEXCOORD_0") in odd})
    written: dict[tuple[int, str, int], int] = {}
    for p in primitives:
        for x, name in [(p["attributes"], "POSITION"), (p["attributes"], "TEXCOORD_0"), (p, "indices")]:
            material = p.get("material", -1) if name == "TEXCOORD_0" and p.get("material") in moved else -1
            if name not in x or ((x[name], name) not in odd and material < 0):
                continue
            key = (x[name], name, material)
            if key not in written:
                rows = source.rows(accessors[x[name]], name)
                if material >= 0:
                    scale, offset = moved[material]
                    rows = (offset + scale * rows).astype(np.float32)
                written[key] = _append(described, rows)
            x[name] = written[key]
    for p in fans:
        points = accessors[p["attributes"]["POSITION"]]["count"]
        order = source.rows(accessors[p["indices"]], "indices")[:, 0] if "indices" in p else np.arange(points)
        first = np.repeat(order[:1], max(len(order) - 2, 0))
        triangles = np.stack([first, order[1 : 1 + len(first)], order[2:]], axis=1)
        p |= {"mode": TRIANGLES, "indices": _append(described, triangles.astype(np.uint32).reshape(-1, 1))}


def _uv(primitive: dict[str, Any]) -> int:
    return primitive["attributes"].get("TEXCOORD_0", -1)


def _is_odd(accessor: dict[str, Any], name: str) -> bool:
    """trimesh counts texture coordinates down from 1 in their own type, which of integers wraps around."""
    whole = NUMBERS[accessor["componentType"]] != "<f4"
    short = name != "indices" and accessor.get("normalized", False)
    return "sparse" in accessor or (whole and (short or name == "TEXCOORD_0"))


def _moved(described: dict[str, Any], materials: set[int | None]) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Scale and offset of these materials' texture coordinates, which their textures then no longer say."""
    found = {}
    for k in materials - {None}:
        assert k is not None
        material = described["materials"][k]
        textures = [*material.values(), *material.get("pbrMetallicRoughness", {}).values()]
        textures = [x for x in textures if isinstance(x, dict) and MOVED in x.get("extensions", {})]
        said = [x["extensions"][MOVED] for x in textures]
        if said and said[0].get("rotation", 0) == 0 and all(x == said[0] for x in said):
            found[k] = tuple(
                np.array(said[0].get(n, d), np.float32) for n, d in (("scale", [1, 1]), ("offset", [0, 0]))
            )
            for texture in textures:
                del texture["extensions"][MOVED]
    return found


def _bytes(buffer: dict[str, Any], binary: bytes | None, folder: Path) -> bytes:
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

    def __init__(self, described: dict[str, Any], buffers: list[bytes]) -> None:
        self._views, self._buffers = described.get("bufferViews", []), buffers

    def rows(self, accessor: dict[str, Any], name: str) -> np.ndarray:
        """(count, columns): of an attribute float32, else integers."""
        kind, columns, count = (
            np.dtype(NUMBERS[accessor["componentType"]]),
            COLUMNS[accessor["type"]],
            accessor["count"],
        )
        if "bufferView" in accessor:
            rows = self._array(accessor, (count, columns), kind).copy()
        else:
            rows = np.zeros((count, columns), kind)
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
