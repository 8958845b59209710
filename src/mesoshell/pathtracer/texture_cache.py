"""Textures of materials with a generator: made once for a scene's request by `mesoshell texture`, which needs JAX.

They are kept in the cache, by a hash of their inputs: the material's bytes, the extent, the texels, the seed and the geometry
parameters.

A geometry parameter that varies is passed as an image with one pixel per node (shell/generator/nodes), in float32.
"""

import contextlib
import hashlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mesoshell import __version__
from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, read_bundle
from mesoshell.io.cache import cache_folder, forget, has_space, remove
from mesoshell.io.corner_tiles import seed_origin
from mesoshell.io.image import write_exr
from mesoshell.io.kept_textures import MAX_BYTES
from mesoshell.io.material import digest
from mesoshell.shell.geometry.chart import fits, span, texture_bytes, texture_origin


@dataclass(frozen=True)
class TextureKey:
    """Request of a texture: seed and parameters as a scene gives them, and texels a patch, at most the generator's. fields: of
    geometry parameters that vary, from (…, 2) coordinates in patches to (…) values in [0, 1]."""

    seed: int | None
    values: dict[str, float]
    texels: int
    fields: dict[str, Callable[[np.ndarray], np.ndarray]] = field(default_factory=dict)


def with_texture(
    path: Path, bundle: Bundle, uv: Float[np.ndarray, "P 3 2"], wanted: TextureKey
) -> tuple[Bundle, tuple[int, int], tuple]:
    """The material with a texture that covers a surface of corners uv (patches), the texture's origin (u, v), and a key for
    both: equal keys mean equal textures.

    Raises InputError if a material of one fixed texture is given a seed or geometry parameters, or the texture cannot be made.
    """
    shape = {p.name: wanted.values[p.name] for p in bundle.parameters if p.role == "beta" and p.name in wanted.values}
    seeded = wanted.seed is not None and bundle.tiles is None
    fixed = bundle.baked and not seeded and not shape and not wanted.fields
    if bundle.generator is None and not fixed:
        first = next(iter(shape | wanted.fields), "geometry")
        raise InputError(path, f"has no generator: it is one texture, of one seed and one {first}")
    if fixed and bundle.wraps:
        begins = seed_origin(wanted.seed or 0)
        return bundle, begins, (path, begins)
    if fixed:
        begins = texture_origin(uv, bundle.extent)
        return bundle, begins, (path, begins)
    origin, patches = span(uv)
    if not fits(patches, wanted.texels, bundle.channels):
        raise InputError(path, f"the mesh would carry {patches[1]} × {patches[0]} patches: give a larger scale")
    images = _images(wanted, origin, patches)
    size = texture_bytes(patches, wanted.texels, bundle.channels)
    made, key = _made(path, patches, replace(wanted, seed=wanted.seed or 0, values=shape), images, size)
    return made, origin, (key, origin)


def _images(
    wanted: TextureKey, origin: tuple[int, int], patches: tuple[int, int]
) -> dict[str, Float[np.ndarray, "V U"]]:
    """Varying parameters at the corners of patches, as images over the texture, the last row at the least v."""
    along_v, along_u = (np.arange(n + 1.0) for n in patches)
    at = np.stack(np.meshgrid(origin[0] + along_u, origin[1] + along_v), axis=-1)
    return {name: values(at)[::-1].astype(np.float32) for name, values in sorted(wanted.fields.items())}


def _made(
    path: Path, patches: tuple[int, int], wanted: TextureKey, images: dict[str, np.ndarray], size: int
) -> tuple[Bundle, str]:
    """The texture, from the cache or made now, and its key. size: bytes, about."""
    options = ["--extent", str(patches[1]), str(patches[0]), "--seed", str(wanted.seed), "--texels", str(wanted.texels)]
    options += [x for k, v in sorted(wanted.values.items()) for x in ("--param", f"{k}={v!r}")]
    of = (digest(path), __version__, options, *((name, image.tobytes()) for name, image in images.items()))
    key = hashlib.sha256(repr(of).encode()).hexdigest()[:32]
    file = cache_folder("textures") / f"{key}.npz"
    if file.exists():
        with contextlib.suppress(InputError):  # it is damaged, or goes as it is read
            found = read_bundle(file)
            with contextlib.suppress(OSError):
                os.utime(file)
            return found, key
    remove(file)
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
    where = file.parent if os.access(file.parent, os.W_OK) and has_space("textures", size) else None
    with tempfile.TemporaryDirectory(prefix=".", dir=where) as folder:
        for number, (name, image) in enumerate(images.items()):
            write_exr(f"{folder}/{number}.exr", np.repeat(image[..., None], 3, axis=-1), half=False)
            options += ["--param", f"{name}={folder}/{number}.exr"]
        _run(path, [*options, "--out", f"{folder}/made.npz"])
        written = Path(folder, "made.npz")
        made = read_bundle(written)
        if where is not None and written.stat().st_size <= MAX_BYTES // 2:
            with contextlib.suppress(OSError):  # it cannot be kept
                os.replace(written, file)
                forget(file.parent, MAX_BYTES, file)
    return made, key


def _run(path: Path, options: list[str]) -> None:
    """Run `mesoshell texture`. Raises InputError if it fails."""
    command = [sys.executable, "-P", "-m", "mesoshell", "texture", str(path), *options]
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise InputError(path, f"no texture could be made with its generator (mesoshell texture): {reason}")
