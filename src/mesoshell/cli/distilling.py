"""The work of `mesoshell distill`. Imports JAX, so it is loaded only when it runs."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from mesoshell.cli.apart import errors_by_radius
from mesoshell.cli.compiled import keep_compiled
from mesoshell.cli.distill import Options
from mesoshell.cli.export import newest_surface
from mesoshell.cli.material import given
from mesoshell.cli.mesostructures import written
from mesoshell.cli.training import learn
from mesoshell.errors import InputError
from mesoshell.io.bundle import read_bundle, write_bundle
from mesoshell.io.material import find, normalised
from mesoshell.io.patches import read_patches
from mesoshell.io.surface import write_surface
from mesoshell.io.twin import Twin
from mesoshell.mesostructure.render import Settings
from mesoshell.shell.scene import ready
from mesoshell.train.presets import PRESETS
from mesoshell.train.surface import fitted, surface_as
from mesoshell.train.surface_snapshot import painter
from mesoshell.train.teach import Teacher, answers


def distill(options: Options) -> None:
    """All of `mesoshell distill`."""
    for name in ("patches", "queries"):
        if getattr(options, name) < 2:
            raise InputError(f"--{name}", f"must be at least 2, not {getattr(options, name)}")
    if options.twin is not None and options.twin.resolve() == options.out.resolve():
        raise InputError("--twin", f"{options.twin} is what --out names too")
    if not 0 < options.thickness < 10:
        raise InputError("--thickness", f"must be above 0 and below 10, not {options.thickness:g}")
    if not all(np.isfinite(v) and v >= 0 for v in options.base):
        raise InputError("--base", "must be finite and not negative")
    keep_compiled()
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
    base, depth = (jnp.asarray(x, jnp.float32) for x in (options.base, options.thickness))
    teacher = Teacher(found.material, jnp.asarray(alpha), depth, base)
    run = options.run or options.out.with_suffix("")
    about = " ".join([str(path.resolve()), *options.param, *map(str, options.base)])
    settings = Settings(about, options.thickness, options.curvature, options.queries, 1, 0)
    taught = answers(found.layout, teacher)
    written(settings, taught, options.patches, run / "queries")
    config = surface_as(PRESETS[options.preset])
    config = config if options.kimg is None else replace(config, kimg=options.kimg)
    data = read_patches(run / "queries")
    learn(config, data, run)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    surface = newest_surface(run)
    write_surface(options.out, surface)
    print(options.out)
    if options.twin is not None:
        errors = errors_by_radius(taught, painter(fitted(config, data)[0], options.out), options.curvature)
        options.twin.parent.mkdir(parents=True, exist_ok=True)
        twin = Twin(surface, tuple(map(float, alpha)), options.base, errors)
        write_bundle(options.twin, replace(bundle, twin=twin))
        print(options.twin)
