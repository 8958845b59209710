"""A shard: some tens of samples, rendered by one Blender process.

symbol   meaning
done     index, row of samples.jsonl, and what it cost (a line of log.jsonl)
fault    index and one line; the sample is not in the dataset, and the next run tries it again

One process a shard: whatever Blender leaks or breaks costs at most a shard. Blender renders into a scratch folder; the
image is written again from its pixels, because Cycles notes its render time in the header and a sample's bytes must be
reproducible. The image gets its name by a rename, so an image that has its name is whole: a shard that is rendered again
keeps it and makes its row again. One that cannot be read all the same is rendered again.
"""

import hashlib
import os
import socket
import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from mesoshell.datasets.blender.process import Blender, Crash
from mesoshell.errors import InputError
from mesoshell.io.atomic import read_file
from mesoshell.io.image import write_exr


@dataclass(frozen=True)
class Shard:
    """The samples of one process. command: replaces Blender's if given (see Blender)."""

    settings: Mapping[str, Any]
    folder: Path
    indices: tuple[int, ...]
    threads: int = 1
    command: tuple[str, ...] | None = None


@dataclass(frozen=True)
class Done:
    """A sample whose image has its name. log is None if the image was there before."""

    index: int
    row: dict[str, Any]
    log: dict[str, Any] | None


@dataclass(frozen=True)
class Fault:
    """A sample that could not be rendered; reason is one line."""

    index: int
    reason: str


def render_shard(shard: Shard) -> Iterator[Done | Fault]:
    """Each sample of the shard in turn. A crash costs its sample; a new process goes on with the next."""
    left = list(shard.indices)
    with tempfile.TemporaryDirectory(prefix="mesoshell-") as scratch:
        while left:
            try:
                with Blender(shard.settings, shard.threads, shard.command) as blender:
                    while left:
                        yield _sample(shard, blender, left[0], Path(scratch) / "image.exr")
                        left.pop(0)
            except (Crash, InputError, OSError) as fault:
                yield Fault(left.pop(0), str(fault))


def _sample(shard: Shard, blender: Blender, index: int, scratch: Path) -> Done | Fault:
    name = f"images/{index:06d}.exr"
    image = shard.folder / name
    there = image.exists() and _is_readable(image)
    start = time.perf_counter()
    answer = blender.render(index, None if there else scratch)
    if "fault" in answer:
        return Fault(index, answer["fault"])
    log = None
    try:
        if not there:
            log = _finish(scratch, image, answer, start)
        digest = hashlib.sha256(read_file(image)).hexdigest()
    except (InputError, OSError) as fault:
        return Fault(index, str(fault))
    return Done(index, {"index": index, "file": name, "sha256": digest, **answer["row"]}, log)


def _is_readable(image: Path) -> bool:
    """False for whatever OpenEXR raises: the image is then rendered anew. Threads ask; read_exr would silence the whole
    process's output for a moment."""
    try:
        with OpenEXR.File(str(image)) as file:
            return "RGBA" in file.channels()
    except Exception:
        return False


def _finish(scratch: Path, image: Path, answer: dict[str, Any], start: float) -> dict[str, Any]:
    """Move the scratch image to its name, and say what the sample cost."""
    rendered = time.perf_counter()
    try:
        with OpenEXR.File(str(scratch)) as file:
            pixels, cycles = file.channels()["RGBA"].pixels.astype(np.float32), _cycles_seconds(file.header())
    except Exception as error:
        raise InputError(scratch, "is no readable image") from error
    write_exr(image, pixels)
    seconds = answer["seconds"]
    stages = {"geometry": seconds["geometry"], "sync": max(0.0, seconds["blender"] - cycles), "cycles": cycles}
    stages["writing"] = time.perf_counter() - rendered
    stages["total"] = time.perf_counter() - start
    scratch.unlink()
    return {
        "index": answer["index"],
        "seconds": {stage: round(s, 4) for stage, s in stages.items()},
        "memory_mib": round(answer["memory"], 1),
        "worker": f"{socket.gethostname()}-{os.getpid()}",
    }


def _cycles_seconds(header: Mapping[str, Any]) -> float:
    """Cycles' own time in a file's header, as (hours:)minutes:seconds; 0 if it does not say."""
    seconds = 0.0
    for part in str(header.get("cycles.ViewLayer.render_time", "0")).split(":"):
        seconds = 60.0 * seconds + float(part)
    return seconds
