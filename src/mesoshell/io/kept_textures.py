"""Grown textures kept between renders, tile by tile: another picture of a mesh waits for what it is the first to show (standard
library and NumPy only).

Notation
key         hash of all that a texture depends on: weights, size, seed, parameters, levels kept
folder      one for each key, in the cache: `texture`, a material whose arrays are mapped, and `tiles`, a byte for each tile
wanted      the tiles that are asked for, by rows (A, B); there: those that are made already

Textures of less than MIN_BYTES are not kept, nor those of more than half of MAX_BYTES, nor any where the disk is nearly full.
What was not used for longest goes when all are more than MAX_BYTES. A tile has the same numbers whoever makes it and when, and
counts as made once it is whole: so processes may add to one texture without waiting for each other.
"""

import hashlib
import json
import math
import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from mesoshell import __version__
from mesoshell.errors import InputError
from mesoshell.io.archive import MANIFEST
from mesoshell.io.atomic import new_array, new_folder, replace_file
from mesoshell.io.bundle import Bundle, checked_manifest, read_bundle
from mesoshell.io.cache import cache_folder, forget
from mesoshell.io.level_arrays import split

MIN_BYTES, MAX_BYTES = 32 << 20, 4 << 30
ROOM, TEXTURE, TILES = "grown", "texture", "tiles"

#: Arrays NAME/0, NAME/1, … of these shapes, of float16 zeros, which lie one after the other in memory.
Allocate = Callable[[str, Sequence[tuple[int, ...]]], list[np.ndarray]]
#: Which tiles.
Tiles = Bool[np.ndarray, "A B"]
#: Makes some tiles of a texture that has others already, in arrays of the allocator that it is given, or in memory.
Make = Callable[[Allocate | None, Tiles, Tiles], Bundle]


def key_of(bundle: Bundle, beta: Float[np.ndarray, "*nodes G"], *rest: object) -> str:
    """The key of a texture. rest: what else it depends on, of types whose repr says all."""
    sha = hashlib.sha256(repr((__version__, rest, beta.shape)).encode())
    sha.update(np.ascontiguousarray(beta).data)
    for name, array in sorted(bundle.arrays.items()):
        sha.update(f"{name} {array.dtype} {array.shape}".encode())
        sha.update(np.ascontiguousarray(array).data)
    return sha.hexdigest()[:32]


def kept(key: str, size: int, make: Make, needed: Tiles, seen: Callable[[], Tiles] | None = None) -> Bundle:
    """The texture of this key with the tiles that are needed: from the cache, else made, and kept if it can be. size: bytes,
    about, of the whole texture; seen: those of the tiles that are wanted now, asked for unless all are there."""
    folder = cache_folder(ROOM) / key
    texture, there = _read(folder), _there(folder, needed)
    if texture is not None and not (needed & ~there).any():
        return texture
    wanted, nothing = needed if seen is None else needed & seen(), np.zeros_like(needed)
    texture = _completed(folder, make, wanted)
    if texture is not None:
        return texture
    if folder.exists() or size < MIN_BYTES or size > MAX_BYTES // 2 or not _room(size):
        return make(None, wanted, nothing)
    try:
        with new_folder(folder) as new:
            (new / TEXTURE).mkdir()
            made = to_folder(new / TEXTURE, lambda allocate: make(allocate, wanted, nothing))
            (new / TILES).write_bytes(wanted.tobytes())
    except InputError:  # a folder that cannot be written, or that another render has made meanwhile
        return _completed(folder, make, wanted) or make(None, wanted, nothing)
    forget(folder, MAX_BYTES)
    return _read(folder) or made


def _completed(folder: Path, make: Make, wanted: Tiles) -> Bundle | None:
    """A texture that is kept, with the tiles that it lacked; None if it is not there whole, or cannot be written."""
    texture, there = _read(folder), _there(folder, wanted)
    lacking = wanted & ~there
    if texture is None or not lacking.any():
        return texture
    try:
        make(_again(folder / TEXTURE), lacking, there)
        replace_file(folder / TILES, (there | lacking).tobytes())
    except (InputError, OSError, ValueError):  # a cache that is read only, or was emptied meanwhile
        return None
    return _read(folder)


def _there(folder: Path, tiles: Tiles) -> Tiles:
    """The tiles that are made of a texture that has so many; none if their list is not there, or of another length."""
    try:
        return np.frombuffer((folder / TILES).read_bytes(), bool).reshape(tiles.shape)
    except (OSError, ValueError):
        return np.zeros_like(tiles)


def _again(folder: Path) -> Allocate:
    """The arrays of a folder, to be written to."""

    def allocate(name: str, shapes: Sequence[tuple[int, ...]]) -> list[np.ndarray]:
        return split(np.load(folder / f"{name}.npy", mmap_mode="r+", allow_pickle=False), shapes)

    return allocate


def to_folder(folder: Path, make: Callable[[Allocate], Bundle]) -> Bundle:
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
        texture = read_bundle(folder / TEXTURE)
        os.utime(folder)
    except (InputError, OSError):
        shutil.rmtree(folder, ignore_errors=True)
        return None
    return texture


def _room(size: int) -> bool:
    """Whether the disk has three times as much left."""
    near = cache_folder(ROOM)
    while not near.exists() and near != near.parent:
        near = near.parent
    try:
        return shutil.disk_usage(near).free > 3 * size
    except OSError:
        return False
