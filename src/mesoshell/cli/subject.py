"""What a surface material is distilled from: a neural shell, or a mesostructure's geometry. Imports JAX."""

from dataclasses import dataclass, replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from mesoshell.cli.distill import Options
from mesoshell.cli.material import given
from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, read_bundle
from mesoshell.io.material import bundled, find, normalised
from mesoshell.mesostructure.render import Answers, Settings, of_geometry
from mesoshell.mesostructure.sources import PROCEDURES, source
from mesoshell.shell.scene import ready
from mesoshell.train.presets import PRESETS
from mesoshell.train.surface import SurfaceTraining, surface_as
from mesoshell.train.teach import Teacher, answers

#: Of the networks' layers, of a shell: its reflectance has more to it than a woven surface's. With 24 numbers a layer it is 4%
#: off from far away where this is 2%.
WIDTHS = (64, 64, 64)
#: Radius of a shell's widest footprints, patches: twice as wide there is next to nothing left that differs from place to place.
WIDEST = 2.0
#: Cylinders and queries on each. Curvature and the direction across are a cylinder's: many are better than large ones, but
#: geometry has to be bent onto each.
OF_SHELL, OF_GEOMETRY = (4096, 2048), (1024, 8192)


@dataclass(frozen=True, eq=False)
class Subject:
    """A dataset's settings, its number of cylinders and who answers; how it is learned."""

    settings: Settings
    patches: int
    answers: Answers
    config: SurfaceTraining


@dataclass(frozen=True, eq=False)
class ShellSubject(Subject):
    """A shell, its parameters, normalised, and the colour under it."""

    bundle: Bundle
    alpha: tuple[float, ...]
    base: tuple[float, float, float]


def subject(options: Options) -> Subject:
    """What the options name. Raises InputError."""
    name = options.material
    if name in PROCEDURES or (Path(name).is_file() and Path(name).suffix != ".npz" and name not in bundled()):
        return _geometry(options)
    if name not in bundled() and not Path(name).exists():
        known = ", ".join((*bundled(), *PROCEDURES))
        raise InputError(name, f"neither a material's .npz, nor an image of heights, nor one of {known}")
    return _shell(options)


def _shell(options: Options) -> ShellSubject:
    if options.spp is not None:
        raise InputError("--spp", "is of geometry: a shell is marched")
    path = find(options.material)
    bundle = read_bundle(path)
    if not bundle.baked or not bundle.wraps:
        raise InputError(
            options.material, "is no texture that repeats: a surface material is one period, again and again"
        )
    values, maps = given(bundle, options.param)
    if maps:
        raise InputError("--param", f"{next(iter(maps))} is an image: a surface material is the same everywhere")
    alpha, found = normalised(bundle, values), ready(bundle)
    thickness, base = options.thickness or 0.5, options.base or (0.09, 0.06, 0.035)
    if not all(np.isfinite(v) and v >= 0 for v in base):
        raise InputError("--base", "must be finite and not negative")
    depth, colour = (jnp.asarray(x, jnp.float32) for x in (thickness, base))
    taught = answers(found.layout, Teacher(found.material, jnp.asarray(alpha), depth, colour))
    about = " ".join([str(path.resolve()), *options.param, *map(str, base)])
    patches, queries = options.patches or OF_SHELL[0], options.queries or OF_SHELL[1]
    settings = Settings(about, thickness, options.curvature or (-1.0, 1.5), queries, 1, 0, WIDEST)
    config = _config(options)
    if options.preset != "tiny":
        config = replace(config, surface=replace(config.surface, hidden=WIDTHS))
    return ShellSubject(settings, patches, taught, config, bundle, tuple(map(float, alpha)), base)


def _geometry(options: Options) -> Subject:
    for name in ("twin", "base", "param"):
        if getattr(options, name):
            raise InputError(f"--{name}", f"is of a shell: {options.material} is geometry")
    tile, spp = source(options.material, options.thickness), options.spp or 8
    patches, queries = options.patches or OF_GEOMETRY[0], options.queries or OF_GEOMETRY[1]
    settings = Settings(options.material, tile.depth, options.curvature or (-1.0, 2.0), queries, spp, 0)
    return Subject(settings, patches, of_geometry(tile, spp), _config(options))


def _config(options: Options) -> SurfaceTraining:
    config = surface_as(PRESETS[options.preset])
    return config if options.kimg is None else replace(config, kimg=options.kimg)
