"""The work of `mesoshell train`. Imports JAX, so it is loaded only when it runs."""

import json
import sys
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from mesoshell.cli.compilation_cache import keep_compiled
from mesoshell.cli.host_process import LOST, SAID_LOST
from mesoshell.cli.options.train import Options
from mesoshell.errors import InputError
from mesoshell.io.whole import probe_folder
from mesoshell.measure.operations import count_operations
from mesoshell.train.experiment import check_recipe, experiment_of, of_length, read_data
from mesoshell.train.hosts import HostLost, is_first, join
from mesoshell.train.malloc import keep_memory
from mesoshell.train.method import Data, method_of
from mesoshell.train.run import Diverged, train
from mesoshell.train.stream import RunConfig


def train_from(options: Options) -> None:
    """All of `mesoshell train`."""
    keep_compiled()
    config, recipe = experiment_of(options.experiment, options.preset)
    config = of_length(config, options.kimg)
    dataset = read_data(config, options.data, options.run)
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
