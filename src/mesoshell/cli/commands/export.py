"""`mesoshell export`: a run's material, or a patch of exemplars, as one file. Imports JAX."""

from pathlib import Path
from typing import Any

from mesoshell.cli.options.export import Options
from mesoshell.errors import InputError
from mesoshell.io.atomic import probe_outputs
from mesoshell.io.bundle import read_bundle, write_bundle
from mesoshell.io.exemplars import read_exemplars
from mesoshell.io.surface import read_surface, write_surface
from mesoshell.measure.evaluation import with_scores
from mesoshell.train.export import patch_bundle
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.run_config import read_record, snapshots
from mesoshell.train.surface.step import SurfaceTrainConfig
from mesoshell.train.textures.state import TexturesConfig


def run(options: Options) -> None:
    """All of `mesoshell export`."""
    probe_outputs((options.out,))
    what = _patch(options) if options.run.is_file() else _snapshot(options)
    print(f"{options.out}: {what}")


def _patch(options: Options) -> str:
    """Write one patch of exemplars as a material that repeats."""
    if options.kimg is not None:
        raise InputError("--kimg", f"requires a run's folder; {options.run} is a file of exemplars")
    exemplars = read_exemplars(options.run)
    count = len(exemplars.features)
    if options.patch is None or not 0 <= options.patch < count:
        raise InputError("--patch", f"{options.run} has {count} patches: say which, 0 to {count - 1}")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_bundle(options.out, patch_bundle(exemplars, options.patch))
    return f"patch {options.patch}"


def _snapshot(options: Options) -> str:
    """Write a run's material with its scores."""
    if options.patch is not None:
        raise InputError("--patch", f"requires a file of exemplars; {options.run} is not one")
    config = read_record(options.run)[0]
    if not isinstance(config, GanConfig | TexturesConfig | SurfaceTrainConfig):
        raise InputError(options.run, "holds a network but no generator: it can be evaluated, not exported")
    images, path = _chosen(options.run, options.kimg)
    shell = not isinstance(config, SurfaceTrainConfig)
    read, write = (read_bundle, write_bundle) if shell else (read_surface, write_surface)
    bundle: Any = with_scores(read(path), options.run, images)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write(options.out, bundle)
    return f"{images / 1000:g} kimg"


def _chosen(run: Path, kimg: float | None) -> tuple[int, Path]:
    """The snapshot to export: images seen, and its file."""
    saved = snapshots(run)
    kept = [s for s in saved if kimg is None or abs(s[0] - 1000 * kimg) < 1]
    if not kept:
        raise InputError("--kimg", f"there are snapshots at {', '.join(f'{n / 1000:g}' for n, _ in saved)}")
    return kept[-1]
