"""Mesh files to arrays, as they are written: nothing welded, dropped or mended.

Notation
N, M        vertices and triangles of the file; index: of one of them, counted from 0
uv          texture coordinates of each corner, NaN on corners without
look        diffuse colour and image of a glTF file's or a USD stage's material               (geometry/image_texture)
v, vt, f    an OBJ file's positions, texture coordinates and polygons; its other lines are ignored
n, m        an OBJ corner's position and texture number, from 1, or backwards from the last one read if negative

GLB, glTF, STL, 3MF and COLLADA are read by trimesh, with the transforms of their scene applied; axes and unit stay the
file's. USD: read_usd.
OBJ is read here, for five faults of trimesh's reader (5.2) that leave no trace: number 0 becomes the first vertex; a
negative number counts from the file's end; one face without vt drops every UV; so does one vt out of range; polygons
under several `usemtl` come back out of order. A polygon becomes a fan of triangles about its first corner. PLY and OFF:
read_ply, read_off.

Source: the OBJ specification (Wavefront, appendix B1).
"""

import logging
import os
import re
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from jaxtyping import Float, Int

from mesoshell.errors import InputError
from mesoshell.geometry import read_usd
from mesoshell.geometry.colour import colour_of, read_or_none
from mesoshell.geometry.image_texture import Look, Texture, codes_of
from mesoshell.geometry.read_gltf import check_buffers, load_gltf
from mesoshell.geometry.read_off import read_off
from mesoshell.geometry.read_ply import read_ply
from mesoshell.geometry.read_usd import Part
from mesoshell.geometry.unzip import check_archive, unzipped

COLLADA = (".dae", ".zae")
#: Of XML: trimesh needs packages of the extra `formats` for them.
XML = (".3mf", *COLLADA)
FORMATS = (".obj", ".ply", ".glb", ".gltf", ".off", ".stl", *XML, *read_usd.FORMATS)
NO_TEXTURE = -1
#: Where a line of an OBJ file goes on in the next one: of Unicode's private characters.
CONTINUED = "\ue000"
logging.getLogger("trimesh").addHandler(logging.NullHandler())  # it warns of materials on standard error

#: Positions, triangles, and corner UVs (None where no corner has one).
Arrays = tuple[Float[np.ndarray, "_ 3"], Int[np.ndarray, "_ 3"], Float[np.ndarray, "_ 3 2"] | None]


def file_of(path: str | PathLike[str]) -> Path:
    """The mesh's file: out of its archive, if it lies in one. Raises InputError for an archive of none, or of several."""
    return unzipped(path, FORMATS)


def read_mesh(path: str | PathLike[str]) -> Arrays:
    """The arrays of a mesh file of one of FORMATS, in float64. Raises InputError, in one line, if it has none."""
    path = file_of(path)
    with _one_line(path) as kind:
        own = {"OBJ": read_obj, "PLY": read_ply, "OFF": read_off}.get(kind)
        return _some(join_arrays([part.arrays for part in _parts(path)]) if own is None else own(path), path, kind)


def read_nodes(
    path: str | PathLike[str], groups: Sequence[Sequence[str]]
) -> tuple[list[Arrays], list[tuple[Arrays, Look]]]:
    """The meshes of each group of a glTF file's nodes or a USD stage's prims, by their names, with what hangs on them and is in
    no other group; and all its others, by their look. Raises InputError, in one line, for a group without triangles."""
    path = file_of(path)
    with _one_line(path):
        parts = _parts(path, apart=True)
        called = _called(parts)
        present = sorted({name for names in called for name in names})
        group_of: dict[str, int] = {}
        for k, names in enumerate(groups):
            for name in names:
                if name not in present:
                    paths = [x for x in present if x.startswith("/")]  # of a stage, whose names need not be unique
                    raise InputError(path, f"has no mesh named {name!r}: its names are {', '.join(paths or present)}")
                if group_of.setdefault(name, k) != k:
                    raise InputError(path, f"two materials are given for {name!r}")
        chosen = [next((group_of[x] for x in names if x in group_of), -1) for names in called]
        meshes = [
            join_arrays([part.arrays for part, own in zip(parts, chosen, strict=True) if own == k])
            for k in range(len(groups))
        ]
        for names, mesh in zip(groups, meshes, strict=True):
            if not len(mesh[1]):
                raise InputError(path, f"has no triangles under {', '.join(names)} that no other name covers")
        rest = [_worn(part) for part, own in zip(parts, chosen, strict=True) if own < 0 and len(part.arrays[1])]
        looks = dict.fromkeys(part.look for part in rest)
        return meshes, [(join_arrays([part.arrays for part in rest if part.look == look]), look) for look in looks]


def names_of_parts(path: str | PathLike[str]) -> list[list[str]]:
    """The names by which something may grow on each part of a glTF file's or a USD stage's meshes, as `read_nodes` takes them,
    of which the first that is given counts. Raises InputError, in one line, if it cannot be read."""
    path = file_of(path)
    with _one_line(path):
        parts = _parts(path, apart=True)
        return [names for names, part in zip(_called(parts), parts, strict=True) if len(part.arrays[1])]


def _called(parts: Sequence[Part]) -> list[list[str]]:
    """The names of each part, the nearest first."""
    owners = {owner for part in parts for owner in part.names}
    return [[*(x for x in part.material if x not in owners), *part.names] for part in parts]


def up_of_collada(path: str | PathLike[str]) -> str:
    """The axis that a COLLADA file says is up: "x", "y" or "z". Raises InputError, in one line, if it cannot be read."""
    with _one_line(path) as kind:
        if kind == "ZAE":
            with zipfile.ZipFile(path) as archive:
                data = archive.read(next(x for x in archive.namelist() if x.lower().endswith(".dae")))
        else:
            data = Path(path).read_bytes()
    said = re.search(rb"<up_axis>\s*([XYZ])_UP", data)
    return "y" if said is None else said[1].decode().lower()


def _worn(part: Part) -> Part:
    """A part, without its image if it has no texture coordinates for it."""
    uv = part.arrays[2]
    return (
        part
        if uv is not None and np.isfinite(uv.astype(np.float32)).all()
        else part._replace(look=Look(part.look.colour))
    )


@contextmanager
def _one_line(path: str | PathLike[str]) -> Iterator[str]:
    """The format of a whole file, OBJ, PLY, …; whatever its reader raises is an InputError."""
    file = Path(path)
    kind = file.suffix[1:].upper()
    if os.path.isdir(file):
        raise InputError(path, "is a folder, not a mesh file")
    if not os.path.isfile(file):
        raise InputError(path, "no such file")
    if file.suffix.lower() not in FORMATS:
        raise InputError(
            path, f"unknown mesh format '{file.suffix}': use {', '.join(FORMATS)}, or one of them in a .zip"
        )
    if file.suffix.lower() in XML and not (find_spec("lxml") and find_spec("collada")):
        raise InputError(path, "needs lxml and pycollada: pip install mesoshell[formats]")
    try:
        check_whole(file)
        yield kind
    except InputError:
        raise
    except Exception as fault:  # each reader of trimesh fails in its own ways
        known = isinstance(fault, ValueError | MemoryError | OSError)
        raise InputError(
            path, f"is not a readable {kind} file, or a damaged one{f' ({fault})' if known else ''}"
        ) from fault


def _some(arrays: Arrays, path: str | PathLike[str], kind: str) -> Arrays:
    if not len(arrays[1]) and kind != "OBJ":
        raise InputError(path, f"holds no triangles that can be read: not a complete {kind} file")
    return arrays


def check_indices(faces: Int[np.ndarray, "M 3"], count: int, source: str | PathLike[str]) -> None:
    """Raise InputError unless all faces refer to `count` vertices."""
    outside = np.argwhere((faces < 0) | (faces >= count))
    if len(outside):
        face, k = outside[0]
        raise InputError(source, f"face {face} refers to vertex {faces[face, k]}, but there are {count}")


def check_whole(path: Path) -> None:
    """Raise InputError if the file is shorter than its header says: readers ignore what is missing, or allocate memory for it
    first."""
    size, kind = path.stat().st_size, path.suffix.lower()
    with path.open("rb") as file:
        head = file.read(2**16)
    if kind == ".stl" and not _is_text_stl(head):
        count = int.from_bytes(head[80:84], "little")
        if size < 84 or size < 84 + 50 * count:
            raise InputError(
                path, f"is cut short: it has {size} bytes and says {count} faces, which are {84 + 50 * count}"
            )
    if kind == ".glb":
        stated = int.from_bytes(head[8:12], "little")
        if head[:4] != b"glTF" or size < 20:
            raise InputError(path, "is not a readable GLB file: its header is not that of GLB")
        if stated > size:
            raise InputError(path, f"is cut short: it has {size} of {stated} bytes")
    if kind == ".gltf":
        check_buffers(path)
    if kind in (".3mf", ".zae"):
        check_archive(path, (".model", ".dae"))
    if kind == ".off":
        lines = [line for line in (x.split(b"#")[0].split() for x in path.read_bytes().splitlines()) if line]
        words = [*lines[0][1:], *(lines[1] if len(lines[0]) == 1 and len(lines) > 1 else ())] if lines else []
        if len(words) < 2 or not lines[0][0].endswith(b"OFF"):
            raise InputError(path, "is not a readable OFF file: its header has no beginning, or no numbers")
        wanted, present = sum(map(int, words[:2])), len(lines) - (1 if len(lines[0]) > 1 else 2)
        if present < wanted:
            raise InputError(path, f"is cut short: it has {present} of {wanted} lines of vertices and faces")
    if kind == ".ply":
        lines = head.partition(b"end_header")[0].splitlines()
        if not head.startswith(b"ply") or b"end_header" not in head:
            raise InputError(path, "is not a readable PLY file: its header has no beginning or no end")
        counts = [int(words[2]) for words in map(bytes.split, lines) if words[:1] == [b"element"]]
        if sum(counts) > size:
            raise InputError(path, f"is cut short: it has {size} bytes for {sum(counts)} elements")


def _is_text_stl(head: bytes) -> bool:
    return head.lstrip()[:5].lower() == b"solid" and b"facet" in head.lower() and b"\0" not in head


def _parts(path: str | PathLike[str], apart: bool = False) -> Sequence[Part]:
    """Each mesh of a file in world space, and the names of its node and of those it hangs on, from itself upward. apart: with
    their materials; of a USD stage, each subset for itself."""
    if Path(path).suffix.lower() in read_usd.FORMATS:
        return read_usd.parts(path, apart)
    gltf = Path(path).suffix.lower() in (".glb", ".gltf")
    scene, names, materials = load_gltf(Path(path)) if gltf else (trimesh.load_scene(str(path), process=False), {}, [])
    parents, parts, looks = scene.graph.transforms.parents, [], dict[str, tuple[list[str], Look]]()
    codes: dict[int, np.ndarray] = {}
    for node in scene.graph.nodes_geometry:
        pose, name = scene.graph[node]
        part = scene.geometry[name]
        if not isinstance(part, trimesh.Trimesh):
            continue
        corner, position = np.asarray(part.faces, np.int64).reshape(-1, 3), np.asarray(part.vertices, np.float64)
        check_indices(corner, len(position), path)
        if np.linalg.det(pose[:3, :3]) < 0:
            corner = corner[:, ::-1]
        uv = getattr(part.visual, "uv", None)
        if uv is None or len(uv) != len(position):
            uv = np.full((len(position), 2), np.nan)
        owners, above = [node], parents.get(node)
        while above is not None and above != scene.graph.base_frame and above not in owners:
            owners.append(above)
            above = parents.get(above)
        place = position @ pose[:3, :3].T + pose[:3, 3]
        called: list[str] = []
        look = Look()
        material = getattr(part.visual, "material", None)
        if apart and material is not None:
            key = str(getattr(material, "name", ""))
            if key not in looks:
                looks[key] = _look(material, materials, codes)
            called, look = looks[key]
        arrays = place, corner, np.asarray(uv, np.float64)[:, :2][corner]
        parts.append(Part([names[owner] for owner in owners if owner in names], arrays, look, called))
    return parts


def _look(material: Any, materials: Sequence[dict], codes: dict[int, np.ndarray]) -> tuple[list[str], Look]:
    """The name and the look of a part's material. materials: of the file; codes: of images that several may share."""
    name = str(getattr(material, "name", "")).removeprefix("material ")
    if not name.isdigit() or int(name) >= len(materials):
        return [], Look()
    described = materials[int(name)]
    called = [described["called"]] if isinstance(described["called"], str) and described["called"] else []
    return called, read_or_none(
        lambda: _diffuse(described, getattr(material, "baseColorTexture", None), codes)
    ) or Look()


def _diffuse(described: dict, image: Any, codes: dict[int, np.ndarray]) -> Look:
    """Of a material as the file has it, and its image; nothing if an image is named and not there. The mean of an image that is
    moved, of other texture coordinates than the first, or beside gloss, for which trimesh changes it."""
    glossy = described.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness")
    base = described.get("pbrMetallicRoughness", {}) if glossy is None else glossy
    factor, texture = ("baseColorFactor", "baseColorTexture") if glossy is None else ("diffuseFactor", "diffuseTexture")
    given = base.get(factor, (1, 1, 1))
    if texture not in base:
        return Look(colour_of(given))
    if image is None:
        return Look()
    mean, times = colour_of(given, image), colour_of(given)
    moved = "KHR_texture_transform" in base[texture].get("extensions", {})
    if glossy is not None or moved or base[texture].get("texCoord", 0) != 0 or times is None:
        return Look(mean)
    if id(image) not in codes:
        codes[id(image)] = codes_of(image)
    return Look(mean, Texture(codes[id(image)], times))


def join_arrays(parts: Sequence[Arrays]) -> Arrays:
    """Several meshes as one."""
    points, faces, uvs, count = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], [np.zeros((0, 3, 2))], 0
    for position, corner, uv in parts:
        points.append(position)
        faces.append(corner + count)
        uvs.append(np.full((len(corner), 3, 2), np.nan) if uv is None else uv)
        count += len(position)
    return np.concatenate(points), np.concatenate(faces), _or_none(np.concatenate(uvs))


def read_obj(path: str | PathLike[str]) -> Arrays:
    """All polygons of an OBJ file as triangles. Raises InputError that names the line at fault."""
    points: list[list[float]] = []
    texture: list[list[float]] = []
    corners: list[list[tuple[int, int]]] = []
    lines: list[int] = []
    data = Path(path).read_bytes()
    if data.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in data[:4096]:
        raise InputError(path, "is not text of ASCII or UTF-8 (UTF-16, or binary)")
    text, number = data.decode("utf-8-sig", errors="replace").replace("\r\n", "\n"), 0
    for line in text.replace("\\\n", CONTINUED).splitlines():
        number += 1 + line.count(CONTINUED)
        line = line.replace(CONTINUED, " ")
        key, *words = line.split("#", 1)[0].split() or [""]
        try:
            if key == "v":
                points.append(_numbers(words, 3))
            elif key == "vt":
                texture.append(_numbers([*words, "0"] if len(words) == 1 else words, 2))
            elif key == "f":
                fan = _fan([_corner(word, len(points), len(texture)) for word in words])
                corners.extend(fan)
                lines.extend([number] * len(fan))
        except ValueError as fault:
            raise InputError(path, f"line {number}: {fault}") from None
    table = np.array(corners, np.int64).reshape(-1, 3, 2)
    for kind, index, size in (("vertex", table[..., 0], len(points)), ("texture vertex", table[..., 1], len(texture))):
        beyond = np.argwhere(index >= size)
        if len(beyond):
            face, k = beyond[0]
            fault = f"line {lines[face]}: face refers to {kind} {index[face, k] + 1}, but there are {size}"
            raise InputError(path, fault)
    uv = np.array([*texture, [np.nan, np.nan]])[table[..., 1]]
    return np.array(points).reshape(-1, 3), table[..., 0], _or_none(uv)


def _or_none(uv: Float[np.ndarray, "M 3 2"]) -> Float[np.ndarray, "M 3 2"] | None:
    return None if np.isnan(uv).all() else uv


def _numbers(words: list[str], count: int) -> list[float]:
    if len(words) < count:
        raise ValueError(f"needs {count} numbers and has {len(words)}")
    return [float(word) for word in words[:count]]


def _fan(polygon: list[tuple[int, int]]) -> list[list[tuple[int, int]]]:
    if len(polygon) < 3:
        raise ValueError(f"a face needs 3 corners and this one has {len(polygon)}")
    return [[polygon[0], polygon[k], polygon[k + 1]] for k in range(1, len(polygon) - 1)]


def _corner(word: str, points: int, texture: int) -> tuple[int, int]:
    """`n`, `n/m`, `n//l` or `n/m/l` as indices from 0; a missing m is NO_TEXTURE, which picks the NaN at the end."""
    n, m, *_ = [*word.split("/"), ""]
    return _index(n, points, "vertex"), _index(m, texture, "texture vertex") if m else NO_TEXTURE


def _index(word: str, size: int, kind: str) -> int:
    written = int(word)
    index = written - 1 if written > 0 else written + size
    if written == 0 or index < 0:
        raise ValueError(f"face refers to {kind} {written}, but {kind} numbers start at 1 and {size} came before")
    return index
