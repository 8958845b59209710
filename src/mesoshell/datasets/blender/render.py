"""A dataset from its settings: what is missing, in shards, rendered here or on a cluster."""

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mesoshell.datasets.blender.cluster import connect, run_on_cluster
from mesoshell.datasets.blender.local import run_here
from mesoshell.datasets.blender.process import Blender, Crash
from mesoshell.datasets.blender.shard import Done, Fault, Shard
from mesoshell.errors import InputError
from mesoshell.io.dataset_writer import Collector, collecting

#: Most samples of a shard: as many must be rendered again if a process dies or a cluster's worker leaves.
SHARD = 25


@dataclass(frozen=True)
class Farm:
    """Who renders. workers: processes on this machine; scheduler: address of a Dask scheduler, used instead; threads: of a
    process, at least 2, since Blender waits for a single Cycles thread by spinning; command: replaces Blender's (see
    Blender)."""

    workers: int
    threads: int
    scheduler: str | None = None
    command: tuple[str, ...] | None = None


@dataclass(frozen=True)
class DatasetReport:
    """What a run did. missing: samples that were missing at its start; logs: what each new image cost."""

    missing: int
    logs: list[dict[str, Any]]
    faults: list[Fault]


def render_dataset(
    settings: Mapping[str, Any], count: int, folder: Path, farm: Farm, show: Callable[[int, int, Fault | None], None]
) -> DatasetReport:
    """Render the missing ones of samples 0 … count − 1 into the folder. show(finished, missing, fault or None) is called at the
    start and after each sample. Raises InputError for settings, a folder or a scheduler that cannot be used, before anything
    is written."""
    try:
        with Blender(settings, 1, farm.command) as blender:
            manifest = blender.manifest
    except Crash as crash:
        raise InputError("dataset", str(crash)) from None
    with contextlib.ExitStack() as stack:
        client = stack.enter_context(connect(farm.scheduler)) if farm.scheduler else None
        collector = stack.enter_context(collecting(folder, manifest, count))
        missing = collector.missing(count)
        show(0, len(missing), None)
        shards = _shards(settings, folder.resolve(), missing, farm)
        happening = run_on_cluster(shards, client) if client else run_here(shards, farm.workers)
        logs, faults = [], []
        with contextlib.closing(happening):
            for finished, event in enumerate(happening, start=1):
                fault = event if isinstance(event, Fault) else _add(collector, event)
                if fault:
                    faults.append(fault)
                elif isinstance(event, Done) and event.log:
                    logs.append(event.log)
                show(finished, len(missing), fault)
        collector.sort()
    return DatasetReport(len(missing), logs, faults)


def _add(collector: Collector, done: Done) -> Fault | None:
    try:
        collector.add(done.row, done.log)
    except OSError as error:
        return Fault(done.index, f"its row cannot be written: {error.strerror}")
    return None


def _shards(settings: Mapping[str, Any], folder: Path, missing: list[int], farm: Farm) -> list[Shard]:
    """Even shards: no worker waits while another has more than its share of a small dataset."""
    size = SHARD if farm.scheduler else max(1, min(SHARD, -(-len(missing) // farm.workers)))
    parts = [tuple(missing[i : i + size]) for i in range(0, len(missing), size)]
    return [Shard(settings, folder, part, farm.threads, farm.command) for part in parts]
