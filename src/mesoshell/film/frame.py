"""One frame of a film: a scene, rendered and written, in this process or another one.

Notation
crew        who makes frames: it is given a shot and tasks, and gives each frame as it is made, in any order. It takes tasks as
            it is free to do them
shot        what all frames of a film share: the settled scene, and how it is rendered
change      fields of the scene that differ in a frame; of `params` those that do, and of `also`, by its number, what does
"""

import os
import time
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from mesoshell.io.image import write_png
from mesoshell.render.quality import Quality
from mesoshell.scene.picture import Picture, Progress
from mesoshell.scene.prepare import prepare
from mesoshell.scene.scene import Grown, Scene

PartT = TypeVar("PartT", Scene, Grown)


@dataclass(frozen=True, eq=False)
class Shot:
    """What all frames share. compiled: folder where JAX keeps what it compiles for a frame, None for nowhere."""

    still: Scene
    quality: Quality
    engine: str
    compiled: str | None = None

    def scene(self, change: Mapping[str, Any]) -> Scene:
        """The scene of a frame."""
        also = list(self.still.also)
        for k, own in change.get("also", {}).items():
            also[k] = _with(also[k], own)
        return _with(self.still, {**change, "also": tuple(also)})


def _with(part: PartT, change: Mapping[str, Any]) -> PartT:
    return replace(part, **{**change, "params": {**part.params, **change.get("params", {})}})


class Task(NamedTuple):
    """A frame to make: its number, what changes, and its file."""

    k: int
    change: Mapping[str, Any]
    path: Path


class Made(NamedTuple):
    """A frame that is there: its number, the seconds that it took, and what the user should know, a line each."""

    k: int
    seconds: float
    notes: tuple[str, ...]


#: A shot, tasks, how many these are, and a callback with the share of a frame that is done, of those who make one at a time.
Crew = Callable[[Shot, Iterator[Task], int, Progress], Generator[Made, None, None]]


def make_frame(shot: Shot, task: Task, progress: Progress = lambda share: None) -> Made:
    """Render a frame and write it. Raises InputError."""
    begin = time.perf_counter()
    if shot.compiled is not None:
        keep_compiled(shot.compiled)
    picture = _picture(shot.scene(task.change), shot.quality, shot.engine, progress)
    write_png(task.path, picture.rgba)
    return Made(task.k, round(time.perf_counter() - begin, 3), picture.notes)


def compiled_in() -> str | None:
    """The folder where JAX keeps what it compiles, which is made if it is not there."""
    import jax

    folder = jax.config.values["jax_compilation_cache_dir"]
    if folder is not None:
        with suppress(OSError):
            os.makedirs(folder, exist_ok=True)
    return folder


def keep_compiled(folder: str) -> None:
    """Keep what JAX compiles in the folder of another process, unless that is another machine's."""
    import jax

    if jax.config.values["jax_compilation_cache_dir"] != folder and os.path.isdir(folder):
        jax.config.update("jax_compilation_cache_dir", folder)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def _picture(scene: Scene, quality: Quality, engine: str, progress: Progress) -> Picture:
    return prepare(scene, quality, engine).picture(progress)
