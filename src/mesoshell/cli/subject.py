"""What a surface material is distilled from: a neural shell, or a mesostructure's geometry. Imports JAX."""

from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import is_zipfile

import jax.numpy as jnp

from mesoshell.cli.options.distill import Options
from mesoshell.cli.options.render import parse_params
from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, read_bundle
from mesoshell.io.material import bundled, digest, find, normalised
from mesoshell.io.surface import KIND, kind_of
from mesoshell.mesostructure.render import Answers, Settings, of_geometry
from mesoshell.mesostructure.sources import PROCEDURES, source
from mesoshell.scene.defaults import EARTH
from mesoshell.scene.materials import read_params
from mesoshell.shell.scene import ready
from mesoshell.silhouette.material import SurfaceConfig
from mesoshell.train.presets import PRESETS
from mesoshell.train.surface import SurfaceTraining, surface_as
from mesoshell.train.teach import Teacher, answers

#: Of the networks' layers, of a shell: its reflectance has more to it than a woven surface's. Of the widest footprints alone a
#: network of 24 numbers a layer learned the median query to 4%, this to 2%.
WIDTHS = (64, 64, 64)
#: Radius of a shell's widest footprints, patches: twice as wide there is next to nothing left that differs from place to place.
#: And of the narrowest of its twin, which is there for wide ones alone: nearer, networks of this size look too different.
WIDEST, NARROWEST = 2.0, 0.25
#: Curvature that a shell is learned for, over the inverse of its thickness: below 1, so that it fits under its top.
CURVATURE = (-0.5, 0.75)
#: Of its twin, 1 / patch, and no more than that: of what is seen from so far, a patch is a small part.
FROM_AFAR = (-0.5, 0.5)
#: Texels of a twin along a patch: its narrowest footprints read two of them.
TEXELS = 4
#: Cylinders and queries on each. Curvature and the direction across are a cylinder's, but geometry has to be bent onto each.
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
    name, path = options.material, Path(options.material)
    if name in bundled() or path.is_dir() or path.suffix == ".npz" or (path.is_file() and is_zipfile(path)):
        return _shell(options)
    if name in PROCEDURES or path.is_file():
        return _geometry(options)
    raise InputError(
        name, f"neither a material, nor an image of heights, nor one of {', '.join((*bundled(), *PROCEDURES))}"
    )


def _shell(options: Options) -> ShellSubject:
    if options.spp is not None:
        raise InputError("--spp", "is of geometry: a shell is marched")
    path = find(options.material)
    if kind_of(path) == KIND:
        raise InputError(options.material, "is a surface material already")
    bundle = read_bundle(path)
    if not bundle.baked or not bundle.wraps:
        raise InputError(
            options.material, "is no texture that repeats: a surface material is one period, again and again"
        )
    values, maps = read_params(bundle, parse_params(options.param))
    if maps:
        raise InputError("--param", f"{next(iter(maps))} is an image: a surface material is the same everywhere")
    alpha, found = normalised(bundle, values), ready(bundle)
    thickness, base = options.thickness or bundle.thickness, options.base or EARTH
    if not all(0 <= v <= 1 for v in base):
        raise InputError("--base", "must be from 0 to 1: what is reflected of the light that falls on it")
    depth, colour = (jnp.asarray(x, jnp.float32) for x in (thickness, base))
    taught = answers(found.layout, Teacher(found.material, jnp.asarray(alpha), depth, colour))
    about = " ".join([options.material, digest(path)[:16], *options.param, *map(str, base)])
    patches, queries = options.patches or OF_SHELL[0], options.queries or OF_SHELL[1]
    curvature = options.curvature or (CURVATURE[0] / thickness, CURVATURE[1] / thickness)
    settings = Settings(about, thickness, curvature, queries, 1, 0, widest=WIDEST, finest=0.0)
    return ShellSubject(settings, patches, taught, _config(options, WIDTHS), bundle, tuple(map(float, alpha)), base)


def from_afar(subject: ShellSubject, curvature: tuple[float, float] | None) -> ShellSubject:
    """What a twin is distilled from: wide footprints alone. curvature: if another was asked for."""
    config = replace(subject.config, surface=replace(subject.config.surface, texels=TEXELS))
    fits = FROM_AFAR[0], min(FROM_AFAR[1], CURVATURE[1] / subject.settings.depth)
    settings = replace(subject.settings, narrowest=NARROWEST, curvature=curvature or fits)
    return replace(subject, settings=settings, config=config)


def _geometry(options: Options) -> Subject:
    for name in ("twin", "base", "param"):
        if getattr(options, name):
            raise InputError(f"--{name}", f"is of a shell: {options.material} is geometry")
    if (options.thickness or 0) > 1:
        raise InputError("--thickness", f"of geometry is at most 1, not {options.thickness:g}")
    tile, spp = source(options.material, options.thickness), options.spp or 16
    patches, queries = options.patches or OF_GEOMETRY[0], options.queries or OF_GEOMETRY[1]
    settings = Settings(options.material, tile.depth, options.curvature or (-1.0, 2.0), queries, spp, 0)
    return Subject(settings, patches, of_geometry(tile, spp), _config(options, SurfaceConfig.hidden))


def _config(options: Options, hidden: tuple[int, ...]) -> SurfaceTraining:
    config = surface_as(PRESETS[options.preset], hidden)
    return config if options.kimg is None else replace(config, kimg=options.kimg)
