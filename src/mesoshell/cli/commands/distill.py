"""The work of `mesoshell distill`. Imports JAX, so it is loaded only when it runs."""

from dataclasses import replace
from pathlib import Path

from mesoshell.cli.commands.export import newest_surface
from mesoshell.cli.compilation_cache import keep_compiled
from mesoshell.cli.learn import learn, said
from mesoshell.cli.options.distill import Options
from mesoshell.cli.queries import planned, written
from mesoshell.cli.subject import ShellSubject, Subject, from_afar, subject
from mesoshell.distill.error import errors_by_radius
from mesoshell.errors import InputError
from mesoshell.io.bundle import write_bundle
from mesoshell.io.patches import read_patches
from mesoshell.io.surface import SurfaceBundle, write_surface
from mesoshell.io.twin import Twin
from mesoshell.io.whole import probe_outputs
from mesoshell.train.record import snapshots
from mesoshell.train.surface import MIXED, fitted
from mesoshell.train.surface_snapshot import painter

#: Of a run's folder: its queries, and what is learned for the twin.
QUERIES, AFAR = "queries", "afar"


def distill(options: Options) -> None:
    """All of `mesoshell distill`."""
    run = _checked(options)
    probe_outputs(tuple(path for path in (options.out, options.twin) if path is not None))
    keep_compiled()
    of = subject(options)
    if options.out is not None:
        surface = _learned(of, run)
        options.out.parent.mkdir(parents=True, exist_ok=True)
        write_surface(options.out, surface)
        print(options.out)
    if options.twin is not None and isinstance(of, ShellSubject):
        twin = _twin(from_afar(of, options.curvature), run / AFAR)
        options.twin.parent.mkdir(parents=True, exist_ok=True)
        write_bundle(options.twin, replace(of.bundle, twin=twin))
        print(options.twin)


def _twin(of: ShellSubject, run: Path) -> Twin:
    """A material of wide footprints, and how different it looks at each."""
    surface, asked = _learned(of, run), of.settings
    looks = painter(fitted(of.config, read_patches(run / QUERIES))[0], snapshots(run)[-1][1])
    errors = errors_by_radius(of.answers, looks, asked.curvature, asked.narrowest, asked.widest)
    return Twin(surface, of.alpha, of.base, errors)


def _learned(of: Subject, run: Path) -> SurfaceBundle:
    """Queries, asked or there already, and what was learned from them."""
    least = of.config.batch // MIXED
    if of.settings.queries < least:
        raise InputError("--queries", f"{of.settings.queries} on a cylinder: a step takes {least}")
    if (known := planned(run / QUERIES)) not in (None, of.patches):
        raise InputError("--patches", f"{run / QUERIES} was begun with {known}, not {of.patches}")
    written(of.settings, of.answers, of.patches, run / QUERIES)
    said(run, learn(of.config, read_patches(run / QUERIES), run))
    return newest_surface(run)


def _checked(options: Options) -> Path:
    """The run's folder. Raises InputError."""
    for name, least in (("patches", 2), ("queries", 2), ("spp", 1)):
        value = getattr(options, name)
        if value is not None and value < least:
            raise InputError(f"--{name}", f"must be at least {least}, not {value}")
    first = options.out or options.twin
    if first is None:
        raise InputError("--out", "or --twin must name a file to write")
    for name, path in (("--out", options.out), ("--twin", options.twin)):
        if path is not None and path.suffix != ".npz":
            raise InputError(name, f"{path} must end in .npz")
    if options.twin is not None and options.out is not None and options.twin.resolve() == options.out.resolve():
        raise InputError("--twin", f"{options.twin} is what --out names too")
    if options.kimg is not None and not 0 < options.kimg < float("inf"):
        raise InputError("--kimg", f"must be above 0, not {options.kimg:g}")
    if options.thickness is not None and not 0 < options.thickness < 10:
        raise InputError("--thickness", f"must be above 0 and below 10, not {options.thickness:g}")
    return options.run or first.with_suffix("")
