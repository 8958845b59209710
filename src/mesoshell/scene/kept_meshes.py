"""Meshes kept between renders: the second picture of a scanned mesh does not wait for its unwrapping (no JAX).

Notation
key         hash of the file's bytes, its suffix and this version
entry       KEY.npz in the cache: the arrays of a Mesh and its notes

Files of less than MIN_BYTES bytes are read anew, which takes a moment, and those that are of several files, glTF and USD. What
was not used for longest goes when all are more than MAX_BYTES.
"""

import hashlib
import os
from os import PathLike
from pathlib import Path

import numpy as np

from mesoshell import __version__
from mesoshell.geometry import read_usd
from mesoshell.geometry.mesh import Mesh, load_mesh
from mesoshell.geometry.read import file_of
from mesoshell.io.cache import cache_folder
from mesoshell.io.kept_arrays import keep_arrays, read_arrays
from mesoshell.kept import constant

MIN_BYTES, MAX_BYTES = 1 << 20, 1 << 30
MULTI_FILE_FORMATS = (".gltf", *read_usd.FORMATS)
ARRAYS = ("vertices", "faces", "uv", "normals")


def mesh_of(given: str | PathLike[str] | Mesh) -> Mesh:
    """A loaded mesh, or one from its file. Raises InputError."""
    return given if isinstance(given, Mesh) else kept_mesh(given)


def kept_mesh(path: str | PathLike[str]) -> Mesh:
    """A mesh file, read and mended; a large one from the cache if it was there before. Raises InputError as `load_mesh`."""
    file = file_of(path)
    try:
        large = (
            os.path.isfile(file) and file.suffix.lower() not in MULTI_FILE_FORMATS and file.stat().st_size >= MIN_BYTES
        )
        entry = cache_folder("meshes") / f"{_key(file)}.npz" if large else None
    except OSError:
        entry = None
    if entry is None:
        return load_mesh(file)  # which says why, if it cannot be read
    kept = read_arrays(entry, (*ARRAYS, "notes"))
    if kept is not None:
        vertices, faces, uv, normals = (kept[name] for name in ARRAYS)
        return constant(Mesh(vertices, faces, uv, normals, tuple(map(str, kept["notes"]))))
    mesh = load_mesh(file)
    arrays = {name: getattr(mesh, name) for name in ARRAYS}
    keep_arrays(entry, arrays | {"notes": np.array(mesh.notes, np.str_)}, MAX_BYTES)
    return mesh


def _key(file: Path) -> str:
    sha = hashlib.sha256(f"{__version__} {file.suffix.lower()} ".encode())
    with file.open("rb") as data:
        while part := data.read(1 << 20):
            sha.update(part)
    return sha.hexdigest()[:32]
