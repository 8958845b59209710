"""Grown textures kept between renders: the second picture of a mesh does not wait for its texture (standard library and NumPy
only).

Notation
key         hash of all that a texture depends on: weights, size, patches needed, seed, parameters, levels kept
folder      one for each key, in the cache, its arrays mapped

Textures of less than MIN_BYTES are not kept, nor those of more than half of MAX_BYTES, nor any where the disk is nearly full.
What was not used for longest goes when all are more than MAX_BYTES.
"""

import contextlib
import hashlib
import json
import math
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mesoshell import __version__
from mesoshell.errors import InputError
from mesoshell.io.archive import MANIFEST
from mesoshell.io.atomic import new_array, new_folder
from mesoshell.io.bundle import Bundle, checked_manifest, read_bundle
from mesoshell.io.cache import cache_folder, forget, has_space
from mesoshell.io.level_arrays import split

MIN_BYTES, MAX_BYTES = 32 << 20, 4 << 30
ROOM = "grown"

#: Arrays NAME/0, NAME/1, … of these shapes, of float16 zeros, which lie one after the other in memory.
Allocate = Callable[[str, Sequence[tuple[int, ...]]], list[np.ndarray]]
#: Makes a texture, in arrays of the allocator that it is given, or in memory.
Make = Callable[[Allocate | None], Bundle]


def key_of(bundle: Bundle, beta: Float[np.ndarray, "*nodes G"], *rest: object) -> str:
    """The key of a texture. rest: what else it depends on, of types whose repr says all."""
    sha = hashlib.sha256(repr((__version__, rest, beta.shape)).encode())
    sha.update(np.ascontiguousarray(beta).data)
    for name, array in sorted(bundle.arrays.items()):
        sha.update(f"{name} {array.dtype} {array.shape}".encode())
        sha.update(np.ascontiguousarray(array).data)
    return sha.hexdigest()[:32]


def kept(key: str, size: int, make: Make) -> Bundle:
    """The texture of this key: from the cache, else made, and kept if it can be. size: bytes, about."""
    folder = cache_folder(ROOM) / key
    texture = _read(folder)
    if texture is not None:
        return texture
    if size < MIN_BYTES or size > MAX_BYTES // 2 or not has_space(ROOM, size):
        return make(None)
    try:
        with new_folder(folder) as new:
            made = to_folder(new, make)
    except InputError:  # a folder that cannot be written, or that another render has made meanwhile
        return _read(folder) or make(None)
    forget(folder.parent, MAX_BYTES, folder)
    return _read(folder) or made


def to_folder(folder: Path, make: Make) -> Bundle:
    """A texture made in mapped arrays of a new folder, and its manifest. Raises InputError or OSError."""
    allocate, names = in_folder(folder), set()

    def noted(name: str, shapes: Sequence[tuple[int, ...]]) -> list[np.ndarray]:
        names.add(name)
        return allocate(name, shapes)

    made = make(noted)
    for key, array in made.arrays.items():
        path = folder / f"{key}.npy"
        if key.rpartition("/")[0] not in names:
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, array)
    (folder / MANIFEST).write_bytes(checked_manifest(folder, made))
    return made


def in_folder(folder: Path) -> Allocate:
    """Makes mapped arrays in a folder (io/archive)."""

    def allocate(name: str, shapes: Sequence[tuple[int, ...]]) -> list[np.ndarray]:
        size = sum(math.prod(shape) for shape in shapes)
        (folder / f"{name}.json").write_text(json.dumps(shapes))
        return split(new_array(folder / f"{name}.npy", (size,), np.float16), shapes)

    return allocate


def _read(folder: Path) -> Bundle | None:
    """A texture that is there and whole; what is damaged is removed."""
    if not folder.exists():
        return None
    try:
        texture = read_bundle(folder)
    except (InputError, OSError):
        shutil.rmtree(folder, ignore_errors=True)
        return None
    with contextlib.suppress(OSError):  # of a cache that is read only
        os.utime(folder)
    return texture
