"""Load glTF files by trimesh. What trimesh would read wrongly without a word is put right first, or refused."""

import io
import json
from pathlib import Path
from urllib.parse import unquote

import trimesh
from trimesh.resolvers import FilePathResolver

from mesoshell.errors import InputError
from mesoshell.geometry.plain_gltf import TRIANGLES, plain

#: Extensions without which no geometry can be read, where a file says that it needs them.
PACKED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression")
#: Modes of a primitive: triangles, and strips of them.
SOLID = (TRIANGLES, 5)


def check_buffers(path: Path) -> None:
    """Raise InputError unless a glTF file's buffers are in it, or whole in files of its folder or below."""
    described = json.loads(path.read_bytes())
    for buffer in described.get("buffers", []):
        uri = buffer.get("uri", "")
        if uri.startswith("data:"):
            continue
        name = unquote(uri)
        file, folder = (path.parent / name).resolve(), path.parent.resolve()
        if not name or not file.is_relative_to(folder):
            raise InputError(path, f"its buffer {uri!r} is no file of its folder")
        if not file.is_file():
            raise InputError(path, f"its buffer {uri!r} is missing")
        if file.stat().st_size < buffer["byteLength"]:
            sizes = f"it has {file.stat().st_size} of {buffer['byteLength']} bytes"
            raise InputError(path, f"its buffer {uri!r} is cut short: {sizes}")


def load_gltf(path: Path) -> tuple[trimesh.Scene, dict[str, str], list[dict]]:
    """A glTF file's scene, the file's names of its nodes, which need not be unique, and its materials, of names `called`.
    trimesh looks for files by their names as written, in which exporters encode spaces; makes names unique by others; takes
    cameras, and loops of lines, out of the graph, with what hangs on them; reads no texture coordinates of primitives without a
    material; and wants a scene, where a file without one holds all its nodes."""
    data = path.read_bytes()
    binary = path.suffix.lower() == ".glb"
    end = 20 + int.from_bytes(data[12:16], "little") if binary else len(data)
    described = json.loads(data[20:end] if binary else data)
    for name in described.get("extensionsRequired", []):
        if name in PACKED:
            raise InputError(path, f"needs {name}, which is not read: export it without compression")
    plain(described, memoryview(data)[end + 8 :] if binary else None, path)
    for part in [*described.get("buffers", []), *described.get("images", [])]:
        if not part.get("uri", "data:").startswith("data:"):
            part["uri"] = unquote(part["uri"])
    names = {}
    for k, node in enumerate(described.get("nodes", [])):
        names[f"node {k}"] = str(node.get("name", f"node {k}"))
        node["name"] = f"node {k}"
        node.pop("camera", None)
    materials = described.get("materials", [])
    for k, material in enumerate(materials):
        material["called"], material["name"] = material.get("name", ""), f"material {k}"
    described["materials"] = [*materials, {"name": f"material {len(materials)}"}]
    for mesh in described.get("meshes", []):
        solid = [x for x in mesh.get("primitives", []) if x.get("mode", TRIANGLES) in SOLID]
        mesh["primitives"] = solid or mesh.get("primitives", [])
        for primitive in mesh["primitives"]:
            primitive.setdefault("material", len(materials))
    for node in described.get("nodes", []):
        shown = described["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []
        if shown and shown[0].get("mode", TRIANGLES) not in SOLID:
            del node["mesh"]
    if not described.get("scenes"):
        below = {child for node in described.get("nodes", []) for child in node.get("children", [])}
        described["scenes"] = [{"nodes": [k for k in range(len(names)) if k not in below]}]
        described["scene"] = 0
    text = json.dumps(described).encode()
    if binary:
        text += b" " * (-len(text) % 4)
        size = (12 + 8 + len(text) + len(data) - end).to_bytes(4, "little")
        text = data[:8] + size + len(text).to_bytes(4, "little") + data[16:20] + text + data[end:]
    kind, near = path.suffix[1:].lower(), FilePathResolver(str(path))
    scene = trimesh.load_scene(io.BytesIO(text), file_type=kind, resolver=near, process=False)
    return scene, names, materials
