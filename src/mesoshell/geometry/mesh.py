"""A triangle mesh, read, checked and mended, with a note on every mend.

Notation
V, F        vertices and triangles of the checked mesh; N vertices of the file, before welding
uv          texture coordinates of each corner, in UV units (the unit square is one texture image)
stretch     world length of one UV unit, √(area in the world / area in UV): the mean over the surface
index       in notes and errors, a vertex or triangle of the file, counted from 0 (OBJ errors name the line instead)

Frame: the file's own axes and unit. Float64 inside, float32 out.
Positions are welded when they are the same bits in float32 (−0 is 0). A triangle whose height is at most 1e-9 of its
longest edge counts as zero-area and is dropped: above that bound its normal, from float64 differences of float32
positions, is good to 1e-6.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike

import numpy as np
from jaxtyping import Bool, Float, Int

from mesoshell.errors import InputError
from mesoshell.geometry.colour import Colour
from mesoshell.geometry.image_texture import Look, Texture
from mesoshell.geometry.normals import vertex_normals
from mesoshell.geometry.read import check_indices, join_arrays, read_mesh, read_nodes
from mesoshell.geometry.topology import agree, inside_out, pair_edges
from mesoshell.geometry.unwrap import unwrap
from mesoshell.kept import constant

MIN_HEIGHT = 1e-9


#: Largest coordinate: with it the volume of a mesh does not overflow single precision.
FARTHEST = 1e12


@dataclass(frozen=True, eq=False)
class Mesh:
    """A mesh without zero-area or repeated faces and unused vertices; `notes` has one line for each thing mended; colour:
    diffuse albedo of what nothing grows on, where its file has one; texture: the same over its texture coordinates, where
    its file has an image, whose mean is the colour."""

    vertices: Float[np.ndarray, "V 3"]  # float32, no two alike
    faces: Int[np.ndarray, "F 3"]  # int32, counter-clockwise seen from outside
    uv: Float[np.ndarray, "F 3 2"]  # float32, a corner
    normals: Float[np.ndarray, "V 3"]  # float32, unit
    notes: tuple[str, ...]
    colour: Colour | None = None
    texture: Texture | None = None


def load_mesh(path: str | PathLike[str]) -> Mesh:
    """Read an OBJ, PLY, GLB, glTF, USD, OFF, STL, 3MF or COLLADA file, also in a .zip. Raises InputError, in one line, if
    it cannot be used."""
    return check_mesh(*read_mesh(path), str(path))


def load_nodes(path: str | PathLike[str], groups: Sequence[Sequence[str]]) -> tuple[list[Mesh], tuple[Mesh, ...]]:
    """Each group of a glTF file's nodes or a USD stage's prims, by their names, as one mesh, and all its others as one of each
    look; an empty first group stands for all others. Raises InputError, in one line, if it cannot be used."""
    rest = not groups[0]
    named, others = read_nodes(path, groups[1:] if rest else groups)
    if rest and not others:
        raise InputError(path, "every mesh is named for a further material: none is left for the scene's own")
    if rest:
        named, others = [join_arrays([arrays for arrays, _ in others]), *named], []
    bare = [_bare(*arrays, look, str(path)) for arrays, look in others]
    return [check_mesh(*arrays, str(path)) for arrays in named], tuple(mesh for some in bare for mesh in some)


def _bare(
    vertices: Float[np.ndarray, "N 3"],
    faces: Int[np.ndarray, "M 3"],
    uv: Float[np.ndarray, "M 3 2"] | None,
    look: Look,
    source: str,
) -> tuple[Mesh, ...]:
    """What nothing grows on: without an image no texture coordinates are needed, and a mesh without area is none."""
    if not len(_usable_faces(_check_arrays(vertices, faces, source), faces)[0]):
        return ()
    colour, texture = look
    if texture is None or uv is None:
        uv = np.tile(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), (len(faces), 1, 1))
    return (replace(check_mesh(vertices, faces, uv, source, bare=True), colour=colour, texture=texture),)


def check_mesh(
    vertices: Float[np.ndarray, "N 3"],
    faces: Int[np.ndarray, "M 3"],
    uv: Float[np.ndarray, "M 3 2"] | None,
    source: str,
    bare: bool = False,
) -> Mesh:
    """Check and mend a mesh given as arrays; corner UVs may be NaN. bare: nothing grows on it, so UVs stay as they are. Raises
    InputError(source, ...) if it cannot be used."""
    points = _check_arrays(vertices, faces, source)
    faces = _first_equal_row(points.view(np.int32))[faces]
    kept, notes = _usable_faces(points, faces)
    if not len(kept):
        raise InputError(source, f"every one of its {len(faces)} faces has zero area")
    faces, flip, more = _wind(points, faces[kept])
    notes += more
    if uv is not None:
        with np.errstate(over="ignore"):
            uv = uv[kept].astype(np.float32)
        uv[flip] = uv[flip][:, [0, 2, 1]]
    used, corner = np.unique(faces, return_inverse=True)
    points, faces = points[used], corner.reshape(-1, 3).astype(np.int32)
    more: list[str] = []
    if not bare or uv is None:
        uv, more = _check_uv(points, faces, uv, kept, source)
    normals, turned = vertex_normals(points.astype(np.float64), faces)
    if turned:
        more.append(f"normals of {count_of(turned, 'vertex', 'vertices')} turned to point out of every face around")
    return constant(Mesh(points, faces, uv, normals.astype(np.float32), (*notes, *more)))


def transform_mesh(mesh: Mesh, to_world: Float[np.ndarray, "4 4"], source: str) -> Mesh:
    """The mesh under an affine map, its faces still outward. Raises InputError(source, …) as `check_mesh`."""
    points = mesh.vertices.astype(np.float64) @ to_world[:3, :3].T + to_world[:3, 3]
    faces, uv = mesh.faces, mesh.uv
    if np.linalg.det(to_world[:3, :3]) < 0:
        faces, uv = faces[:, [0, 2, 1]], uv[:, [0, 2, 1]]
    return check_mesh(points, faces, uv, source)


def bounding_box(mesh: Mesh) -> Float[np.ndarray, "2 3"]:
    """The least and the greatest coordinates."""
    return np.stack([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])


def surface_area(mesh: Mesh) -> float:
    """Total area in the world."""
    return float(_doubled_areas(mesh.vertices[mesh.faces]).sum() / 2)


def uv_stretch(mesh: Mesh) -> float:
    """World length of one UV unit, averaged over the surface."""
    return float(np.sqrt(surface_area(mesh) / (_doubled_areas(mesh.uv).sum() / 2)))


def count_of(number: int | np.integer, one: str, many: str = "") -> str:
    """`1 face`, `2 faces`."""
    return f"{number} {one if number == 1 else many or one + 's'}"


def _check_arrays(
    vertices: Float[np.ndarray, "N 3"], faces: Int[np.ndarray, "M 3"], source: str
) -> Float[np.ndarray, "N 3"]:
    if not len(faces):
        raise InputError(source, "has no faces")
    with np.errstate(over="ignore"):
        points = np.ascontiguousarray(vertices, np.float32) + np.float32(0)  # -0 becomes 0
    wild = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(wild):
        raise InputError(source, f"vertex {wild[0]} is not finite: {vertices[wild[0]].tolist()}")
    check_indices(faces, len(points), source)
    far = np.flatnonzero(np.abs(points).max(axis=1) > FARTHEST)
    if len(far):
        raise InputError(source, f"vertex {far[0]} lies beyond {FARTHEST:g}: {vertices[far[0]].tolist()}")
    return points


def _first_equal_row(rows: Int[np.ndarray, "R C"]) -> Int[np.ndarray, "R"]:
    """For each row, the index of the first row that is the same."""
    order = np.lexsort(rows.T)
    new = np.append(True, (rows[order][1:] != rows[order][:-1]).any(axis=1))
    first = np.empty(len(rows), np.int64)
    first[order] = order[np.flatnonzero(new)][np.cumsum(new) - 1]
    return first


def _usable_faces(
    points: Float[np.ndarray, "N 3"], faces: Int[np.ndarray, "M 3"]
) -> tuple[Int[np.ndarray, "F"], list[str]]:
    corner = points[faces].astype(np.float64)
    longest = ((np.roll(corner, -1, axis=1) - corner) ** 2).sum(axis=-1).max(axis=1)
    flat = _doubled_areas(corner) <= MIN_HEIGHT * longest
    again = (_first_equal_row(np.sort(faces, axis=1)) != np.arange(len(faces))) & ~flat
    notes = []
    for what, where in (("zero-area", flat), ("repeated", again)):
        if where.any():
            notes.append(f"{count_of(where.sum(), f'{what} face')} dropped (first: index {np.argmax(where)})")
    return np.flatnonzero(~flat & ~again), notes


def _wind(
    points: Float[np.ndarray, "N 3"], faces: Int[np.ndarray, "F 3"]
) -> tuple[Int[np.ndarray, "F 3"], Bool[np.ndarray, "F"], list[str]]:
    """Faces with one winding per part, outward where it is closed; a mask of flipped faces; and notes."""
    edges = pair_edges(faces)
    winding = agree(edges)
    notes = []
    crowded = np.argwhere(edges.crowd > 2)
    if len(crowded):
        f, k = crowded[0]
        number = round((1 / edges.crowd[edges.crowd > 2]).sum())
        where = f"first: vertices {faces[f, k]}, {faces[f, (k + 1) % 3]}"
        notes.append(
            f"{count_of(number, 'edge')} with more than two faces: a border, except between faces of one surface ({where})"
        )
    if winding.flip.any():
        notes.append(f"winding of {count_of(winding.flip.sum(), 'face')} flipped to agree with the neighbours")
    if winding.one_sided.any():
        notes.append(
            f"{winding.one_sided.sum()} faces form a one-sided surface: it is cut where opposite windings meet"
        )
    wound = np.where(winding.flip[:, None], faces[:, [0, 2, 1]], faces)
    wrong = inside_out(points.astype(np.float64), wound, winding.part, pair_edges(wound))
    if wrong.all():
        notes.append("the whole mesh was inside out: flipped")
    elif wrong.any():
        notes.append(f"{wrong.sum()} of {len(wrong)} separate parts were inside out: flipped")
    out = wrong[winding.part]
    return np.where(out[:, None], wound[:, [0, 2, 1]], wound), winding.flip ^ out, notes


def _check_uv(
    points: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    uv: Float[np.ndarray, "F 3 2"] | None,
    kept: Int[np.ndarray, "F"],
    source: str,
) -> tuple[Float[np.ndarray, "F 3 2"], list[str]]:
    """The UVs if they can be used, else an unwrapping; `kept` are the faces' indices in the file."""
    wild = np.zeros(0, np.int64) if uv is None else np.flatnonzero(~np.isfinite(uv).all(axis=(1, 2)))
    fault, notes = "", []
    if uv is None:
        fault = "no UVs"
    elif len(wild):
        fault = f"{count_of(len(wild), 'face')} without finite UVs (first: index {kept[wild[0]]})"
    elif not _doubled_areas(uv).any():
        fault = "UVs without area"
    if uv is None or fault:
        uv, charts = unwrap(points, faces, source)
        notes.append(f"{fault}: unwrapped with xatlas into {count_of(charts, 'chart')}")
    flat = np.flatnonzero(_doubled_areas(uv) == 0)
    if len(flat):
        notes.append(f"{count_of(len(flat), 'face')} without area in UV (first: index {kept[flat[0]]})")
    return uv, notes


def _doubled_areas(corner: Float[np.ndarray, "F 3 D"]) -> Float[np.ndarray, "F"]:
    """Twice the areas of triangles in the plane or in space, in float64."""
    a, b, c = np.moveaxis(corner.astype(np.float64), 1, 0)
    (p, q) = (b - a, c - a)
    if corner.shape[-1] == 2:
        return np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
    return np.linalg.norm(np.cross(p, q), axis=1)
