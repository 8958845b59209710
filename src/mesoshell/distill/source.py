"""What a surface material is distilled from: a neural shell, or a mesostructure's geometry. Imports JAX.

Notation
cylinder    of one curvature, with a patch of the source bent onto it; a dataset holds queries of many cylinders
footprint   of a query: standard deviation of the pixel's, in patches
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import is_zipfile

import jax.numpy as jnp

from mesoshell.datasets.queries.render import Answers, Settings, of_geometry
from mesoshell.datasets.queries.sources import PROCEDURES, source
from mesoshell.errors import Argument, InputError
from mesoshell.io.bundle import Bundle, read_bundle
from mesoshell.io.material import PARAMS, WITH, bundled_materials, digest, find, parameter_vector
from mesoshell.io.surface import KIND, kind_of
from mesoshell.scene.materials import read_params
from mesoshell.shell.geometry.extrude import EARTH
from mesoshell.shell.material.loader import load_device_material
from mesoshell.surface_material.network import SurfaceConfig
from mesoshell.train.gan.presets import PRESETS
from mesoshell.train.surface.shell_teacher import Teacher, answers
from mesoshell.train.surface.step import SurfaceTrainConfig, surface_config

#: Widths of the network's layers for a shell, whose reflectance varies more than a woven surface's: at the widest footprints,
#: layers of 24 reached a median error of 4%, these 2%.
WIDTHS = (64, 64, 64)
#: Widest footprint of a shell: at twice that, hardly anything varies from place to place. And the narrowest of its twin: below
#: it, networks of this size have too large an error.
WIDEST, NARROWEST = 2.0, 0.25
#: Curvatures that a shell is learned for, times its thickness: below 1, for the shell must fit under its top.
CURVATURE = (-0.5, 0.75)
#: Curvatures of its twin, 1 / patch, within the former: a mesh seen from far away bends little over a patch.
FROM_AFAR = (-0.5, 0.5)
#: Texels of a twin along a patch, two for its narrowest footprint.
TEXELS = 4
#: Cylinders, and queries on each. More cylinders show more curvatures and directions, but geometry must be bent onto each.
OF_SHELL, OF_GEOMETRY = (4096, 2048), (1024, 8192)


@dataclass(frozen=True, eq=False)
class Source:
    """What a surface material learns from. answers: to queries; settings, patches: of their dataset, and its number of
    cylinders; config: of the training."""

    settings: Settings
    patches: int
    answers: Answers
    config: SurfaceTrainConfig


@dataclass(frozen=True, eq=False)
class ShellSource(Source):
    """A shell, its normalised parameters, and the colour of the surface under it, linear RGB."""

    bundle: Bundle
    alpha: tuple[float, ...]
    base: tuple[float, float, float]


def is_shell(name: str) -> bool:
    """Whether this names a shell's material, or a file or folder of one, rather than geometry."""
    path = Path(name)
    return (
        name in (*bundled_materials(), *WITH)
        or path.is_dir()
        or path.suffix == ".npz"
        or (path.is_file() and is_zipfile(path))
    )


def shell_source(
    name: str,
    params: Mapping[str, str],
    base: tuple[float, float, float] | None = None,
    *,
    thickness: float | None = None,
    curvature: tuple[float, float] | None = None,
    patches: int | None = None,
    queries: int | None = None,
    preset: str = "small",
    kimg: float | None = None,
) -> ShellSource:
    """A shell, marched by JAX. name: of its material; params: values by name; base: colour of the surface under it, linear RGB;
    thickness: periods; curvature: least and greatest, 1 / period; patches, queries: cylinders, and queries on each; preset:
    size of the network; kimg: thousands of queries to learn from. Raises InputError if it is no texture that wraps around."""
    path = find(name)
    if kind_of(path) == KIND:
        raise InputError(name, "is a surface material already")
    bundle = read_bundle(path)
    if not bundle.baked or not bundle.wraps:
        raise InputError(name, "is no texture that repeats: a surface material is one period, repeated")
    values, maps = read_params(bundle, params)
    if maps:
        raise InputError(PARAMS, f"{next(iter(maps))} is an image: a surface material is the same everywhere")
    alpha, loaded = parameter_vector(bundle, values), load_device_material(bundle)
    thickness, base = thickness or bundle.thickness, base or EARTH
    if not all(0 <= v <= 1 for v in base):
        raise InputError(Argument("base"), "must be from 0 to 1: the share of light that it reflects")
    depth, colour = (jnp.asarray(x, jnp.float32) for x in (thickness, base))
    taught = answers(loaded.layout, Teacher(loaded.material, jnp.asarray(alpha), depth, colour))
    about = " ".join([name, digest(path)[:16], *(f"{k}={v}" for k, v in params.items()), *map(str, base)])
    bends = curvature or (CURVATURE[0] / thickness, CURVATURE[1] / thickness)
    settings = Settings(about, thickness, bends, queries or OF_SHELL[1], 1, 0, widest=WIDEST, finest=0.0)
    config = _config(preset, kimg, WIDTHS)
    return ShellSource(settings, patches or OF_SHELL[0], taught, config, bundle, tuple(map(float, alpha)), base)


def from_afar(source: ShellSource, curvature: tuple[float, float] | None) -> ShellSource:
    """The source of a twin: wide footprints only. curvature: if other than FROM_AFAR."""
    config = replace(source.config, surface=replace(source.config.surface, texels=TEXELS))
    fits = FROM_AFAR[0], min(FROM_AFAR[1], CURVATURE[1] / source.settings.depth)
    settings = replace(source.settings, narrowest=NARROWEST, curvature=curvature or fits)
    return replace(source, settings=settings, config=config)


def geometry_source(
    name: str,
    spp: int | None = None,
    *,
    thickness: float | None = None,
    curvature: tuple[float, float] | None = None,
    patches: int | None = None,
    queries: int | None = None,
    preset: str = "small",
    kimg: float | None = None,
) -> Source:
    """Geometry, traced by Mitsuba. name: of a procedure, or an image of heights; spp: light paths a query; the others: as of
    `shell_source`. Raises InputError."""
    if name not in PROCEDURES and not Path(name).is_file():
        known = ", ".join((*bundled_materials(), *PROCEDURES))
        raise InputError(name, f"neither a material, nor an image of heights, nor one of {known}")
    if (thickness or 0) > 1:
        raise InputError(Argument("thickness"), f"of geometry is at most 1, not {thickness:g}")
    tile, paths = source(name, thickness), spp or 16
    settings = Settings(name, tile.depth, curvature or (-1.0, 2.0), queries or OF_GEOMETRY[1], paths, 0)
    config = _config(preset, kimg, SurfaceConfig.hidden)
    return Source(settings, patches or OF_GEOMETRY[0], of_geometry(tile, paths), config)


def _config(preset: str, kimg: float | None, hidden: tuple[int, ...]) -> SurfaceTrainConfig:
    config = surface_config(PRESETS[preset], hidden)
    return config if kimg is None else replace(config, kimg=kimg)
