"""Textures of materials that have a generator: made by `mesoshell texture`, which needs JAX, once for what a scene asks.

They are kept under $XDG_CACHE_HOME/mesoshell/textures (~/.cache without it), by what they are made of: the material's bytes,
the extent, the texels, the seed and the geometry parameters. Remove that folder at will.
"""

import hashlib
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mesoshell import __version__
from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, read_bundle
from mesoshell.io.material import digest
from mesoshell.shell.chart import fits, patches_of


class Asked(NamedTuple):
    """Of a texture: seed and parameters as a scene gives them, and texels a patch, at most the generator's own."""

    seed: int | None
    values: dict[str, float]
    texels: int


def textured(
    path: Path, bundle: Bundle, uv: Float[np.ndarray, "P 3 2"], asked: Asked
) -> tuple[Bundle, tuple[int, int], tuple]:
    """The material with a texture that covers a surface of corners uv (patches), the texture's origin (u, v), and a name for
    both: what has the same name is the same.

    Raises InputError where seed or geometry parameters are asked of a material that is one texture, or none can be made.
    """
    shape = {p.name: asked.values[p.name] for p in bundle.parameters if p.role == "beta" and p.name in asked.values}
    fixed = bundle.baked and asked.seed is None and not shape
    if bundle.generator is None and not fixed:
        raise InputError(
            path, f"has no generator: it is one texture, of one seed and one {next(iter(shape), 'geometry')}"
        )
    if fixed and bundle.wraps:
        return bundle, (0, 0), (path, (0, 0))
    origin, needed = patches_of(uv)
    if fixed:
        return bundle, origin, (path, origin)
    patches = needed.shape
    if not fits(patches, asked.texels, bundle.channels):
        raise InputError(path, f"the mesh would carry {patches[1]} × {patches[0]} patches: give a larger scale")
    file = _made(path, patches, asked._replace(seed=asked.seed or 0, values=shape))
    return read_bundle(file), origin, (file, origin)


def _made(path: Path, patches: tuple[int, ...], asked: Asked) -> Path:
    options = ["--extent", str(patches[1]), str(patches[0]), "--seed", str(asked.seed), "--texels", str(asked.texels)]
    options += [x for k, v in sorted(asked.values.items()) for x in ("--param", f"{k}={v!r}")]
    key = hashlib.sha256(repr((digest(path), __version__, options)).encode()).hexdigest()[:32]
    file = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "mesoshell" / "textures" / f"{key}.npz"
    if not file.exists():
        command = [sys.executable, "-m", "mesoshell", "texture", str(path), *options, "--out", str(file)]
        done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        if done.returncode:
            said = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
            raise InputError(path, f"no texture could be made with its generator (mesoshell texture): {said}")
    return file
