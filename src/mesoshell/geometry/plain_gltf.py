"""Write a glTF file's geometry as floats and triangles, where it holds what trimesh reads as something else.

Notation
buffer     bytes, of which a view is a part, and an accessor an array in a view           (count, columns)
normalized integers that stand for shares of the greatest, −1 to 1 or 0 to 1 (glTF 2.0, section 3.6.2.2)
sparse     some rows of an accessor are replaced by others, by their numbers
fan        triangles between a first vertex and each two that follow each other
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


def plain(described: dict[str, Any], binary: bytes | None, path: Path) -> bool:
    """Rewrite accessors of positions, texture coordinates and indices that are normalized or sparse, and fans, in place; all
    buffers then lie in the description. binary: of a .glb, its first buffer. Returns whether anything was rewritten. Raises
    LookupError, TypeError, ValueError or OSError for a damaged file, and InputError for one that needs more memory than there
    is."""
    primitives = [p for mesh in described.get("meshes", []) for p in mesh.get("primitives", [])]
    slots = [(p, p["attributes"], name) for p in primitives for name in ("POSITION", "TEXCOORD_0")]
    slots = [(p, where, name) for p, where, name in [*slots, *((p, p, "indices") for p in primitives)] if name in where]
    odd = [s for s in slots if _is_odd(described["accessors"][s[1][s[2]]])]
    fans = [p for p in primitives if p.get("mode") == FAN]
    if not odd and not fans:
        return False
    check_memory(path, "its geometry", sum(48 * described["accessors"][where[name]]["count"] for _, where, name in odd))
    buffers = [_bytes(x, binary, path.parent) for x in described.get("buffers", [])]
    described |= {"buffers": described.get("buffers", []), "bufferViews": described.get("bufferViews", [])}
    for buffer, data in zip(described["buffers"], buffers, strict=True):
        buffer |= {"uri": _uri(data), "byteLength": len(data)}
    for _, where, name in odd:
        where[name] = _append(described, _rows(described, described["accessors"][where[name]], buffers))
    for p in fans:
        points = described["accessors"][p["attributes"]["POSITION"]]["count"]
        order = (
            _rows(described, described["accessors"][p["indices"]], buffers)[:, 0]
            if "indices" in p
            else np.arange(points)
        )
        triangles = np.stack([np.full(max(len(order) - 2, 0), order[0]), order[1:-1], order[2:]], axis=1)
        p |= {"mode": TRIANGLES, "indices": _append(described, triangles.astype(np.uint32).reshape(-1, 1))}
    return True


def _is_odd(accessor: dict[str, Any]) -> bool:
    return "sparse" in accessor or (accessor.get("normalized", False) and NUMBERS[accessor["componentType"]] != "<f4")


def _bytes(buffer: dict[str, Any], binary: bytes | None, folder: Path) -> bytes:
    uri = buffer.get("uri")
    if uri is None:
        return b"" if binary is None else binary
    if uri.startswith("data:"):
        return base64.b64decode(uri[uri.index(",") + 1 :])
    if not (file := (folder / unquote(uri)).resolve()).is_relative_to(folder.resolve()):
        raise ValueError(f"its buffer {uri!r} is no file of its folder")
    return file.read_bytes()


def _uri(data: bytes) -> str:
    return "data:application/octet-stream;base64," + base64.b64encode(data).decode()


def _rows(described: dict[str, Any], accessor: dict[str, Any], buffers: list[bytes]) -> np.ndarray:
    """(count, columns): float32, or integers that are not normalized."""
    kind, columns, count = np.dtype(NUMBERS[accessor["componentType"]]), COLUMNS[accessor["type"]], accessor["count"]
    if "bufferView" in accessor:
        rows = _array(described, accessor, (count, columns), kind, buffers).copy()
    else:
        rows = np.zeros((count, columns), kind)
    if (sparse := accessor.get("sparse")) is not None:
        which, several = sparse["indices"], sparse["count"]
        where = _array(described, which, (several, 1), np.dtype(NUMBERS[which["componentType"]]), buffers)[:, 0]
        rows[where] = _array(described, sparse["values"], (several, columns), kind, buffers)
    if accessor.get("normalized", False) and kind.kind != "f":
        return np.maximum(rows / np.float32(np.iinfo(kind).max), np.float32(-1)).astype(np.float32)
    return rows


def _array(
    described: dict[str, Any], part: dict[str, Any], shape: tuple[int, int], kind: np.dtype, buffers: list[bytes]
) -> np.ndarray:
    """The array that begins in a view."""
    view, begin = described["bufferViews"][part["bufferView"]], part.get("byteOffset", 0)
    start = view.get("byteOffset", 0)
    data = buffers[view["buffer"]][start : start + view["byteLength"]]
    stride = view.get("byteStride", kind.itemsize * shape[1])
    return np.ndarray(shape, kind, data, begin, (stride, kind.itemsize))


def _append(described: dict[str, Any], rows: np.ndarray) -> int:
    """The number of a new accessor of these rows, in a buffer of its own."""
    data = np.ascontiguousarray(rows).tobytes()
    described["buffers"].append({"uri": _uri(data), "byteLength": len(data)})
    described["bufferViews"].append({"buffer": len(described["buffers"]) - 1, "byteLength": len(data)})
    code = next(k for k, v in NUMBERS.items() if np.dtype(v) == rows.dtype)
    kind = next(k for k, n in COLUMNS.items() if n == rows.shape[1])
    view = len(described["bufferViews"]) - 1
    described["accessors"].append({"bufferView": view, "componentType": code, "count": len(rows), "type": kind})
    return len(described["accessors"]) - 1
