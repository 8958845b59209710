"""The work of `mesoshell fit`. Imports JAX, so it is loaded only when it runs."""

import json
from dataclasses import asdict

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from mesoshell.cli.fit import Options
from mesoshell.errors import InputError
from mesoshell.io.bundle import Parameter, write_bundle
from mesoshell.io.checkout import commit
from mesoshell.io.dataset import Dataset, origin, read_dataset
from mesoshell.io.image import write_png
from mesoshell.io.whole import probe_folder, probe_outputs, read_file, replace_file
from mesoshell.limits import check_memory, check_seed
from mesoshell.train.export import declared, to_bundle
from mesoshell.train.fit import FitConfig, State
from mesoshell.train.holdout import score
from mesoshell.train.loop import fit
from mesoshell.train.rays import image_table, join, ray_table


def fit_to_bundle(options: Options) -> None:
    """All of `mesoshell fit`."""
    console = Console(stderr=True)
    config = _config(options)
    probe_outputs((options.out,))
    probe_folder(options.run, "--run")
    datasets = [read_dataset(d) for d in options.datasets]
    tests = [read_dataset(d) for d in options.test]
    parameters = _parameters(datasets)
    _one_patch(datasets + tests)
    record = _same_run(options, config)
    with console.status("finding the rays that meet the box"):
        table, images = join([(ray_table(d), image_table(d)) for d in datasets])
    if options.rays > len(table.image):
        raise InputError("--rays", f"{options.rays} a step: the datasets have {len(table.image)} that meet the box")
    options.run.mkdir(parents=True, exist_ok=True)
    replace_file(options.run / "config.json", record)
    console.print(f"{len(table.image):,} rays of {len(images.light):,} images", highlight=False)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("left"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("fitting", total=options.steps)

        def show(row: dict, state: State) -> None:
            bar.update(task, completed=row["step"], description=f"fitting, loss {row['loss']:.5f}")

        state = fit(config, table, images, options.steps, options.run, show)
    provenance = {"config": asdict(config), "steps": options.steps, "commit": commit(), "test": {}}
    provenance["datasets"] = [origin(d) for d in datasets]
    for dataset in tests:
        scores, pictures = score(config, state, dataset)
        provenance["test"][dataset.folder.name] = {k: round(v, 3) for k, v in scores._asdict().items()}
        console.print(f"{dataset.folder}: {_said(scores._asdict())}", highlight=False)
        write_png(options.run / f"{dataset.folder.name}.png", _sheet(pictures))
    bundle = to_bundle(config, state.parameters, parameters, provenance)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_bundle(options.out, bundle)
    print(options.out)


def _config(options: Options) -> FitConfig:
    for name in ("steps", "rays", "width"):
        if getattr(options, name) < 1:
            raise InputError(f"--{name}", "must be at least 1")
    if options.texels < 1 or options.texels & (options.texels - 1):
        raise InputError("--texels", f"{options.texels} is not a power of two")
    check_seed(options.seed)
    w = options.width
    # with gradients and two moments: 32 channels with their coarser levels, and the decoder's layers
    check_memory("--texels", f"a texture of {options.texels} texels a side", 4 * 4 * 43 * options.texels**2)
    check_memory("--width", f"layers of {w} numbers", 4 * 4 * 5 * w**2)
    check_memory("--rays", f"{options.rays} rays a step", 4 * options.rays * w)
    return FitConfig(texels=options.texels, rays=options.rays, trunk=(w, w, w), head=(w, w), seed=options.seed)


def _same_run(options: Options, config: FitConfig) -> bytes:
    """The record of a run, to be written to its folder. Raises InputError if that belongs to another configuration."""
    record = (json.dumps({"config": asdict(config), "steps": options.steps}, indent=1) + "\n").encode()
    path = options.run / "config.json"
    if path.exists() and read_file(path) != record:
        raise InputError(path, "this run was begun with another configuration; give another --run")
    return record


def _one_patch(datasets: list[Dataset]) -> None:
    """A fit needs the same geometry in every image: one patch, and no geometry parameter that varies."""
    for dataset in datasets:
        if dataset.manifest.get("patch", 0) is None:
            raise InputError(dataset.folder, "every image shows another geometry; render it with --patch 0 for a fit")
        if _geometry(dataset) != _geometry(datasets[0]):
            raise InputError(dataset.folder, "shows another geometry than the first dataset")
        free = [
            n for n, p in dataset.manifest["parameters"].items() if p["role"] == "beta" and n not in _fixed(dataset)
        ]
        if free:
            raise InputError(
                dataset.folder, f"its geometry varies with {', '.join(free)}; fix it with --param {free[0]}=VALUE"
            )


def _fixed(dataset: Dataset) -> dict[str, float]:
    return dataset.manifest.get("fixed_parameters", {})


def _geometry(dataset: Dataset) -> tuple[object, dict[str, float]]:
    beta = {n for n, p in dataset.manifest["parameters"].items() if p["role"] == "beta"}
    return dataset.manifest.get("patch", 0), {n: v for n, v in _fixed(dataset).items() if n in beta}


def _parameters(datasets: list[Dataset]) -> tuple[Parameter, ...]:
    kinds = [d.manifest["parameters"] for d in datasets]
    if not kinds:
        raise InputError("fit", "no dataset given")
    if any(k != kinds[0] for k in kinds):
        raise InputError(datasets[-1].folder, "has other parameters than the first dataset")
    return declared(datasets[0].manifest)


def _said(scores: dict[str, float]) -> str:
    return ", ".join(
        f"{k} {v:+.1%}" if k == "mean" else f"{k} {v:.2f}{'' if k == 'ssim' else ' dB'}" for k, v in scores.items()
    )


def _sheet(y: np.ndarray, columns: int = 6) -> np.ndarray:
    """Predicted images side by side, as linear radiance over black."""
    n, h, w = y.shape[:3]
    rows = -(-n // columns)
    sheet = np.zeros((rows * h, columns * w, 3), np.float32)
    for i in range(n):
        r, c = divmod(i, columns)
        sheet[r * h : (r + 1) * h, c * w : (c + 1) * w] = y[i, ..., :3]
    return sheet
