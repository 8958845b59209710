"""The work of `mesoshell train`. Imports JAX, so it is loaded only when it runs."""

import json
import runpy
import sys
import time
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from mesoshell.cli.compiled import keep_compiled
from mesoshell.cli.hosts import LOST, SAID_LOST
from mesoshell.cli.memory import keep_memory
from mesoshell.cli.train import Options
from mesoshell.errors import InputError
from mesoshell.io.whole import probe_folder
from mesoshell.measure.operations import count_operations
from mesoshell.train.hosts import HostLost, is_first, join
from mesoshell.train.method import Data, method_of
from mesoshell.train.presets import PRESETS
from mesoshell.train.record import read_record
from mesoshell.train.run import Diverged, train
from mesoshell.train.stream import RunConfig


def train_from(options: Options) -> None:
    """All of `mesoshell train`."""
    keep_compiled()
    config, recipe = experiment_of(options.experiment, options.preset)
    config = of_length(config, options.kimg)
    begun = read_record(options.run)[1] if (options.run / "config.json").exists() else {}
    dataset = method_of(config).read(config, {**begun, "folder": options.data})
    check_recipe(options.experiment, recipe, dataset)
    if options.coordinator is not None:
        join(options.coordinator, options.hosts)
    elif options.hosts is not None:
        raise InputError("--hosts", "needs --coordinator HOST:PORT")
    if options.dry_run:
        print(_plan(config, dataset))
        return
    said(options.run, learn(config, dataset, options.run, options.parallel, options.transfer))


def said(run: Path, state: Any) -> None:
    """Print how far a run is."""
    print(f"{run}: {int(state.images) / 1000:.3f} kimg")


def of_length(config: Any, kimg: float | None) -> Any:
    """The configuration with another `kimg`, if one is given. Raises InputError."""
    if kimg is None:
        return config
    if not (np.isfinite(kimg) and kimg > 0):
        raise InputError("--kimg", f"must be above 0 and finite, not {kimg}")
    return replace(config, kimg=kimg)


def learn(
    config: RunConfig,
    dataset: Data,
    run: Path,
    how: Literal["jit", "pmap"] = "jit",
    transfer: Path | None = None,
) -> Any:
    """Train, with a bar and lines on the console, and return the state; exit status 1 if something is not finite, hosts.LOST if
    a host is lost."""
    if is_first():  # the others write nothing
        probe_folder(run, "--run")
    keep_memory()
    console = Console(stderr=True, highlight=False)
    for warning in getattr(dataset, "warnings", ()):
        console.print(f"warning: {dataset.folder}: {warning}", soft_wrap=True, markup=False)
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("left"), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("compiling", total=config.kimg)

        def show(row: dict[str, float]) -> None:
            said = " ".join(f"{k} {row[k]:.3g}" for k in method_of(config).losses)
            line = f"{row['kimg']:.3f} kimg, {row['images_per_s']:.2f} images/s, losses {said}"
            bar.update(task, completed=row["kimg"], description=line)
            if not console.is_terminal:
                console.print(line, soft_wrap=True)

        try:
            state = train(config, dataset, run, how, show, transfer)
        except Diverged as fault:
            console.print(f"mesoshell: {run}: {fault}", soft_wrap=True, markup=False)
            sys.exit(1)
        except HostLost:
            console.print(f"mesoshell: {run}: {SAID_LOST}", soft_wrap=True, markup=False)
            sys.exit(LOST)
    return state


def read_experiment(path: Path, preset: str | None = None) -> Any:
    """The `config` of an experiment file, a TrainConfig or a ParametricConfig, or its `variant` of a preset. Raises InputError
    if it does not run or lacks it."""
    return experiment_of(path, preset)[0]


def experiment_of(path: Path, preset: str | None = None) -> tuple[Any, str | None]:
    """The same and the `recipe` that the file is about, if it says so. It is executed once."""
    wanted = "config" if preset is None else "variant"
    defined = _defined(path)
    found = defined.get(wanted)
    try:
        config = found(PRESETS[preset]) if preset is not None and callable(found) else found
    except SystemExit as end:
        raise InputError(path, f"`variant` ends the program (sys.exit: {end.code!r})") from None
    except Exception as error:
        raise InputError(path, f"{type(error).__name__}: {error}") from error
    if not isinstance(config, RunConfig):
        of = {"config": "that is", "variant": "that makes of a TrainConfig"}[wanted]
        raise InputError(
            path,
            f"defines no `{wanted}` {of} a TrainConfig, a TexturesConfig, a ParametricConfig, a SurfaceTraining or an "
            "AtlasTraining (mesoshell.train.state, .textures_state, .parametric, .surface and .atlas)",
        )
    return config, defined.get("recipe")


def check_recipe(path: Path, recipe: str | None, dataset: Data) -> None:
    """Raises InputError if an experiment is about a `recipe` and the dataset is of another."""
    if recipe not in (None, dataset.recipe):
        raise InputError(dataset.folder, f"its recipe is {dataset.recipe}; {path.name} is about {recipe}")


def _defined(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise InputError(path, "no such file")
    try:
        return runpy.run_path(str(path))
    except SystemExit as end:
        raise InputError(path, f"ends the program (sys.exit: {end.code!r}) instead of defining an experiment") from None
    except Exception as error:
        raise InputError(path, f"{type(error).__name__}: {error}") from error


def _plan(config: RunConfig, dataset: Data) -> str:
    """What a run would be: parameters, memory, and time by operations over this machine's matrix rate."""
    method = method_of(config)
    config, dataset = method.fitted(config, dataset)
    state = jax.eval_shape(lambda: method.start(config, dataset, jax.random.key(0)))
    batch = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), method.feed(config, dataset, 0, 1)(0))
    memory = jax.jit(lambda s, b: method.step(config, s, b)).lower(state, batch).compile().memory_analysis()
    about = {k: v for k, v in asdict(config).items() if k in ("batch", "kimg", "precision")}
    lines = [json.dumps(about)]
    lines += [
        f"{name}: {_numbers(tree):,} parameters, {_bytes(tree) / 2**20:.1f} MiB"
        for name, tree in method.parts(state).items()
    ]
    lines.append(f"state (with what optimisers and averages hold): {_bytes(state) / 2**20:.1f} MiB")
    if memory is not None:
        lines.append(f"a step's activations: {memory.temp_size_in_bytes / 2**20:.0f} MiB")
    work, rate = count_operations(lambda s, b: method.step(config, s, b), state, batch), _matrix_rate()
    steps = config.kimg * 1000 / config.batch
    lines.append(
        f"the dearest step is {work / 1e9:.3g} GFLOP; at this machine's matrix rate, {rate / 1e9:.0f} GFLOP/s, at least "
        f"{work / rate:.2g} s: {rate / work:.3g} steps a second at most, {steps * work / rate / 3600:.2g} hours in all"
    )
    return "\n".join(lines)


def _numbers(tree: object) -> int:
    return sum(int(np.prod(x.shape)) for x in jax.tree.leaves(tree))


def _bytes(tree: object) -> int:
    return sum(int(np.prod(x.shape)) * x.dtype.itemsize for x in jax.tree.leaves(tree))


def _matrix_rate() -> float:
    """Operations a second of a float32 product of 2048² matrices: the best of three."""
    a = jnp.ones((2048, 2048), jnp.float32)
    product = jax.jit(partial(jnp.matmul, precision="highest"))
    product(a, a).block_until_ready()
    best = 1e9
    for _ in range(3):
        begin = time.perf_counter()
        product(a, a).block_until_ready()
        best = min(best, time.perf_counter() - begin)
    return 2 * 2048**3 / best
