"""Textures of materials that have a generator: made by `mesoshell texture`, which needs JAX, once for what a scene asks.

They are kept under $XDG_CACHE_HOME/mesoshell/textures (~/.cache without it), by what they are made of: the material's bytes,
the extent, the texels, the seed and the geometry parameters. Remove that folder at will.

A geometry parameter that varies is asked for by an image with one pixel a node (shell/generator/nodes), in float32.
"""

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
from mesoshell.io.corner_tiles import seed_origin
from mesoshell.io.image import write_exr
from mesoshell.io.material import digest
from mesoshell.shell.geometry.chart import fits, patches_of


@dataclass(frozen=True)
class TextureKey:
    """Of a texture: seed and parameters as a scene gives them, and texels a patch, at most the generator's own. fields: of
    geometry parameters that vary, from (…, 2) coordinates in patches to (…) values in [0, 1]."""

    seed: int | None
    values: dict[str, float]
    texels: int
    fields: dict[str, Callable[[np.ndarray], np.ndarray]] = field(default_factory=dict)


def textured(
    path: Path, bundle: Bundle, uv: Float[np.ndarray, "P 3 2"], asked: TextureKey
) -> tuple[Bundle, tuple[int, int], tuple]:
    """The material with a texture that covers a surface of corners uv (patches), the texture's origin (u, v), and a name for
    both: what has the same name is the same.

    Raises InputError where seed or geometry parameters are asked of a material that is one texture, or none can be made.
    """
    shape = {p.name: asked.values[p.name] for p in bundle.parameters if p.role == "beta" and p.name in asked.values}
    seeded = asked.seed is not None and bundle.tiles is None
    fixed = bundle.baked and not seeded and not shape and not asked.fields
    if bundle.generator is None and not fixed:
        first = next(iter(shape | asked.fields), "geometry")
        raise InputError(path, f"has no generator: it is one texture, of one seed and one {first}")
    if fixed and bundle.wraps:
        begins = seed_origin(asked.seed or 0)
        return bundle, begins, (path, begins)
    origin, needed = patches_of(uv)
    if fixed:
        return bundle, origin, (path, origin)
    patches = needed.shape
    if not fits(patches, asked.texels, bundle.channels):
        raise InputError(path, f"the mesh would carry {patches[1]} × {patches[0]} patches: give a larger scale")
    file = _made(path, patches, replace(asked, seed=asked.seed or 0, values=shape), _images(asked, origin, patches))
    return read_bundle(file), origin, (file, origin)


def _images(
    asked: TextureKey, origin: tuple[int, int], patches: tuple[int, ...]
) -> dict[str, Float[np.ndarray, "V U"]]:
    """What varies, at the corners of patches, as an image over the texture: its last row lies at the least v."""
    along_v, along_u = (np.arange(n + 1.0) for n in patches)
    at = np.stack(np.meshgrid(origin[0] + along_u, origin[1] + along_v), axis=-1)
    return {name: values(at)[::-1].astype(np.float32) for name, values in sorted(asked.fields.items())}


def _made(path: Path, patches: tuple[int, ...], asked: TextureKey, images: dict[str, np.ndarray]) -> Path:
    options = ["--extent", str(patches[1]), str(patches[0]), "--seed", str(asked.seed), "--texels", str(asked.texels)]
    options += [x for k, v in sorted(asked.values.items()) for x in ("--param", f"{k}={v!r}")]
    of = (digest(path), __version__, options, *((name, image.tobytes()) for name, image in images.items()))
    key = hashlib.sha256(repr(of).encode()).hexdigest()[:32]
    file = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "mesoshell" / "textures" / f"{key}.npz"
    if not file.exists():
        with tempfile.TemporaryDirectory() as folder:
            for number, (name, image) in enumerate(images.items()):
                write_exr(f"{folder}/{number}.exr", np.repeat(image[..., None], 3, axis=-1), half=False)
                options += ["--param", f"{name}={folder}/{number}.exr"]
            _run(path, [*options, "--out", str(file)])
    return file


def _run(path: Path, options: list[str]) -> None:
    """Raise InputError unless `mesoshell texture` makes it."""
    command = [sys.executable, "-m", "mesoshell", "texture", str(path), *options]
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    if done.returncode:
        said = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise InputError(path, f"no texture could be made with its generator (mesoshell texture): {said}")
