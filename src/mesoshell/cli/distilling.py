"""The work of `mesoshell distill`. Imports JAX, so it is loaded only when it runs."""

from dataclasses import replace

from mesoshell.cli.apart import errors_by_radius
from mesoshell.cli.compiled import keep_compiled
from mesoshell.cli.distill import Options
from mesoshell.cli.export import newest_surface
from mesoshell.cli.mesostructures import planned, written
from mesoshell.cli.subject import ShellSubject, subject
from mesoshell.cli.training import learn
from mesoshell.errors import InputError
from mesoshell.io.bundle import write_bundle
from mesoshell.io.patches import read_patches
from mesoshell.io.surface import write_surface
from mesoshell.io.twin import Twin
from mesoshell.train.surface import MIXED, fitted
from mesoshell.train.surface_snapshot import painter


def distill(options: Options) -> None:
    """All of `mesoshell distill`."""
    for name, least in (("patches", 2), ("queries", 2), ("spp", 1)):
        value = getattr(options, name)
        if value is not None and value < least:
            raise InputError(f"--{name}", f"must be at least {least}, not {value}")
    run = options.run or options.out.with_suffix("")
    if options.out.suffix != ".npz":
        raise InputError("--out", f"{options.out} must end in .npz")
    if options.twin is not None and options.twin.resolve() == options.out.resolve():
        raise InputError("--twin", f"{options.twin} is what --out names too")
    if options.kimg is not None and not 0 < options.kimg < float("inf"):
        raise InputError("--kimg", f"must be above 0, not {options.kimg:g}")
    if options.thickness is not None and not 0 < options.thickness < 10:
        raise InputError("--thickness", f"must be above 0 and below 10, not {options.thickness:g}")
    keep_compiled()
    of = subject(options)
    least = of.config.batch // MIXED
    if of.settings.queries < least:
        raise InputError("--queries", f"{of.settings.queries} on a cylinder: a step takes {least}")
    if (known := planned(run / "queries")) not in (None, of.patches):
        raise InputError("--patches", f"{run / 'queries'} was begun with {known}, not {of.patches}")
    written(of.settings, of.answers, of.patches, run / "queries")
    data = read_patches(run / "queries")
    learn(of.config, data, run)
    surface = newest_surface(run)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_surface(options.out, surface)
    print(options.out)
    if options.twin is not None and isinstance(of, ShellSubject):
        looks = painter(fitted(of.config, data)[0], options.out)
        errors = errors_by_radius(of.answers, looks, of.settings.curvature, of.settings.widest)
        options.twin.parent.mkdir(parents=True, exist_ok=True)
        write_bundle(options.twin, replace(of.bundle, twin=Twin(surface, of.alpha, of.base, errors)))
        print(options.twin)
