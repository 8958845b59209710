"""`mesoshell distill`: a surface material from a neural shell or from geometry. Imports JAX."""

import json
from dataclasses import replace
from pathlib import Path

from mesoshell.cli.checks import at_least, ends_in, pairs_of
from mesoshell.cli.compilation_cache import keep_compiled
from mesoshell.cli.learn import learn, print_length
from mesoshell.cli.options.distill import Options
from mesoshell.cli.queries import write_queries
from mesoshell.distill.error import errors_by_radius
from mesoshell.distill.source import ShellSource, Source, from_afar, geometry_source, is_shell, shell_source
from mesoshell.errors import InputError
from mesoshell.io.atomic import probe_outputs
from mesoshell.io.bundle import write_bundle
from mesoshell.io.query_dataset import read_patches
from mesoshell.io.surface import SurfaceBundle, read_surface, write_surface
from mesoshell.io.twin import Twin
from mesoshell.measure.evaluation import with_scores
from mesoshell.train.run_config import snapshots
from mesoshell.train.surface.snapshot import load_predictor
from mesoshell.train.surface.step import MIXED, adapt

#: Folders inside the run's folder: its queries, and the twin's own run.
QUERIES, AFAR = "queries", "afar"


def run(options: Options) -> None:
    """All of `mesoshell distill`."""
    folder = _checked(options)
    probe_outputs(tuple(path for path in (options.out, options.twin) if path is not None))
    keep_compiled()
    source = source_of(options)
    if options.out is not None and isinstance(source, ShellSource) and source.bundle.tiles is not None:
        raise InputError(
            "--out", f"{options.material} has corner tiles, and a surface material repeats; --twin takes their mean"
        )
    if options.out is not None:
        surface = _learned(source, folder)
        options.out.parent.mkdir(parents=True, exist_ok=True)
        write_surface(options.out, surface)
        print(options.out)
    if options.twin is not None and isinstance(source, ShellSource):
        twin = _twin(from_afar(source, options.curvature), folder / AFAR)
        options.twin.parent.mkdir(parents=True, exist_ok=True)
        write_bundle(options.twin, replace(source.bundle, twin=twin))
        print(options.twin)


def source_of(options: Options) -> Source:
    """The source that the options name. Raises InputError, also for an option of another kind of source."""
    name = options.material
    given = {k: getattr(options, k) for k in ("thickness", "curvature", "patches", "queries", "preset", "kimg")}
    if is_shell(name):
        if options.spp is not None:
            raise InputError("--spp", f"requires geometry; {name} is a shell, which is marched")
        return shell_source(name, pairs_of("--param", options.param), options.base, **given)
    for option in ("twin", "base", "param"):
        if getattr(options, option):
            raise InputError(f"--{option}", f"requires a shell; {name} is not one")
    return geometry_source(name, options.spp, **given)


def _twin(source: ShellSource, folder: Path) -> Twin:
    """A surface material for wide footprints, and its error at each of them."""
    surface, settings = _learned(source, folder), source.settings
    looks = load_predictor(adapt(source.config, read_patches(folder / QUERIES))[0], snapshots(folder)[-1][1])
    errors = errors_by_radius(source.answers, looks, settings.curvature, settings.narrowest, settings.widest)
    return Twin(surface, source.alpha, source.base, errors)


def _learned(source: Source, folder: Path) -> SurfaceBundle:
    """Write the queries that are missing, and learn a surface material from them. Raises KeyboardInterrupt if the training was
    stopped: the same command goes on."""
    least, queries = source.config.batch // MIXED, folder / QUERIES
    if source.settings.queries < least:
        raise InputError("--queries", f"{source.settings.queries} on a cylinder: a step takes {least}")
    if (known := _planned(queries)) not in (None, source.patches):
        raise InputError("--patches", f"{queries} was begun with {known}, not {source.patches}")
    write_queries(source.settings, source.answers, source.patches, queries)
    state = learn(source.config, read_patches(queries), folder)
    print_length(folder, state)
    if int(state.images) < 1000 * source.config.kimg:
        raise KeyboardInterrupt
    images, path = snapshots(folder)[-1]
    return with_scores(read_surface(path), folder, images)


def _planned(queries: Path) -> int | None:
    """How many cylinders a dataset was begun with; None if it has no readable manifest."""
    try:
        return json.loads((queries / "manifest.json").read_text())["count"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _checked(options: Options) -> Path:
    """The run's folder. Raises InputError."""
    at_least(options, patches=2, queries=2, spp=1)
    files = [path for path in (options.out, options.twin) if path is not None]
    if not files:
        raise InputError("--out", "give it, or --twin, or both")
    for path in files:
        ends_in(path, ".npz")
    if len(files) == 2 and files[0].resolve() == files[1].resolve():
        raise InputError("--twin", f"{options.twin} is the same file as --out")
    if options.kimg is not None and not 0 < options.kimg < float("inf"):
        raise InputError("--kimg", f"must be above 0, not {options.kimg:g}")
    if options.thickness is not None and not 0 < options.thickness < 10:
        raise InputError("--thickness", f"must be above 0 and below 10, not {options.thickness:g}")
    return options.run or files[0].with_suffix("")
