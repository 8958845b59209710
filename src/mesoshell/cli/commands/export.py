"""`mesoshell export`: a run's newest material as a bundle."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from mesoshell.errors import InputError
from mesoshell.io.records import read_rows


@dataclass(frozen=True)
class Options:
    """Write a run's material, its generator included, as one file that needs nothing beside it."""

    #: Folder of a training run; or a file of exemplars, with --patch.
    run: tyro.conf.Positional[Path]
    #: The file to write.
    out: Path
    #: The snapshot of this many thousand images; the newest if not given.
    kimg: float | None = None
    #: Of exemplars (`mesoshell fit` of many patches): which patch, from 0 on.
    patch: int | None = None


def run(options: Annotated[Options, tyro.conf.arg(name="")]) -> None:
    """Write a run's material, its generator included, as one file that needs nothing beside it."""
    from mesoshell.io.bundle import read_bundle, write_bundle
    from mesoshell.io.surface import read_surface, write_surface
    from mesoshell.io.whole import probe_outputs
    from mesoshell.train.record import read_record
    from mesoshell.train.state import TrainConfig
    from mesoshell.train.surface import SurfaceTraining
    from mesoshell.train.textures_state import TexturesConfig

    probe_outputs((options.out,))
    if options.run.is_file():
        if options.kimg is not None:
            raise InputError("--kimg", f"is of runs; {options.run} is a file of exemplars")
        _patch(options)
        return
    if options.patch is not None:
        raise InputError("--patch", f"is of exemplars; {options.run} is no file")
    config = read_record(options.run)[0]
    if not isinstance(config, TrainConfig | TexturesConfig | SurfaceTraining):
        raise InputError(options.run, "holds a network and no generator: it can be evaluated, not exported")
    images, path = _snapshot(options.run, options.kimg)
    shell = not isinstance(config, SurfaceTraining)
    read, write = (read_bundle, write_bundle) if shell else (read_surface, write_surface)
    bundle: Any = read(path)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write(options.out, _scored(bundle, options.run, images))
    print(f"{options.out}: {images / 1000:g} kimg")


def _patch(options: Options) -> None:
    """One patch of exemplars as a material that repeats."""
    from mesoshell.io.bundle import write_bundle
    from mesoshell.io.exemplars import read_exemplars
    from mesoshell.train.export import patch_bundle

    exemplars = read_exemplars(options.run)
    count = len(exemplars.features)
    if options.patch is None or not 0 <= options.patch < count:
        raise InputError("--patch", f"{options.run} has {count} patches: say which, 0 to {count - 1}")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_bundle(options.out, patch_bundle(exemplars, options.patch))
    print(f"{options.out}: patch {options.patch}")


def newest_surface(run: Path) -> Any:
    """The newest surface material of a run, with its scores if it has been evaluated."""
    from mesoshell.io.surface import read_surface

    images, path = _snapshot(run, None)
    return _scored(read_surface(path), run, images)


def _snapshot(run: Path, kimg: float | None) -> tuple[int, Path]:
    """Images seen, and the file."""
    from mesoshell.train.record import snapshots

    found = snapshots(run)
    kept = [s for s in found if kimg is None or abs(s[0] - 1000 * kimg) < 1]
    if not kept:
        raise InputError("--kimg", f"there are snapshots at {', '.join(f'{n / 1000:g}' for n, _ in found)}")
    return kept[-1]


def _scored(bundle: Any, run: Path, images: int) -> Any:
    scores = run / "evaluation.jsonl"
    rows = read_rows(scores, ("name", "value", "kimg"))
    metrics = {row["name"]: row["value"] for row in rows if row["kimg"] == images / 1000}
    return replace(bundle, provenance=bundle.provenance | {"metrics": metrics})
