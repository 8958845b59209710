"""Checkpoints of a run through orbax: the newest three, written whole or not at all.

Of several hosts only the first reads and writes them, so that in orbax no host waits for another. It holds the whole state
(train/parallel): a run of one host can go on with many, and the other way round.
"""

import contextlib
import gc
import logging
import shutil
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np
import orbax.checkpoint as ocp

from mesoshell.errors import InputError, one_line
from mesoshell.train.hosts import is_first

KEPT = 3
#: Part of the name that orbax gives to a checkpoint while it writes it.
_UNFINISHED = ".orbax-checkpoint-tmp"
#: New name, before its step, of a checkpoint that cannot be read, so that a run that goes on can write that step again.
UNREADABLE = "unreadable"


class Checkpoints:
    """The checkpoints of a run in `folder`; a context manager, which finishes writing at its end. It removes what a killed
    writer left, so a folder must have one writer. reading: write and remove nothing. last: step of the newest checkpoint read
    or written, known to every host."""

    def __init__(self, folder: Path, reading: bool = False):
        self.folder, self.reading, self.manager = folder.resolve(), reading, None
        self.last: int | None = None
        if not is_first() or (reading and not folder.is_dir()):
            return
        if reading:
            options = ocp.CheckpointManagerOptions(read_only=True, save_interval_steps=0)
        else:
            self.folder.mkdir(parents=True, exist_ok=True)
            for left in self.folder.glob(f"*{_UNFINISHED}*"):
                shutil.rmtree(left)
            options = ocp.CheckpointManagerOptions(max_to_keep=KEPT)
        if jax.process_count() > 1:
            options.create = False  # with processes named, orbax makes no folder
            options.multiprocessing_options = ocp.options.MultiprocessingOptions(0, {0}, "first")
        self.manager = ocp.CheckpointManager(self.folder, options=options)

    def __enter__(self) -> "Checkpoints":
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.finish()
        finally:
            if self.manager:
                self.manager.close()

    def save(self, step: int, tree: Any) -> None:
        """Begin to write a checkpoint. Raises InputError if it, or the one before, cannot be written."""
        self.last = step
        if self.manager:
            try:
                self.manager.save(step, args=ocp.args.StandardSave(tree))
            except Exception as error:
                raise self._unwritten(error) from error

    def finish(self) -> None:
        """Wait until the last checkpoint is written. Raises InputError if it cannot be."""
        if self.manager:
            try:
                self.manager.wait_until_finished()
                self.manager.check_for_errors()
            except Exception as error:
                raise self._unwritten(error) from error

    def newest(self, like: Any) -> tuple[int, Any] | None:
        """Step and state of the newest readable checkpoint, shaped as `like`; None if there is none at all. Newer unreadable
        ones are renamed, with a warning. Raises InputError if none is readable."""
        steps = sorted(self.manager.all_steps(), reverse=True) if self.manager else []
        faults: list[tuple[int, str]] = []
        for step in steps:
            with _unheard():
                try:
                    restored, fault = self._read(step, like), None
                except Exception as error:  # any error of orbax, tensorstore or JSON about a damaged file
                    restored, fault = None, one_line(str(error).split(". See full TensorStore")[0])
            if fault is None:
                self._set_aside(faults)
                self.last = step
                return step, restored
            faults.append((step, fault))
        if faults:
            raise InputError(self.folder, f"none of its checkpoints can be read; of {faults[0][0]}: {faults[0][1]}")
        return None

    def _read(self, step: int, like: Any) -> Any:
        abstract = jax.tree.map(ocp.utils.to_shape_dtype_struct, like)
        if jax.process_count() > 1:  # this host cannot put arrays on other hosts' devices
            abstract = jax.tree.map(lambda x: np.empty(x.shape, x.dtype), abstract)
        assert self.manager
        restored = self.manager.restore(step, args=ocp.args.StandardRestore(abstract))
        wrong = [
            x.shape for x, y in zip(*map(jax.tree.leaves, (restored, abstract)), strict=True) if x.shape != y.shape
        ]
        if wrong:
            raise ValueError(f"an array is of shape {wrong[0]}")
        return restored

    def _set_aside(self, faults: list[tuple[int, str]]) -> None:
        for step, fault in faults:
            path = self.folder / str(step)
            warnings.warn(f"{path}: cannot be read; using the checkpoint before it: {fault}", stacklevel=3)
            if not self.reading:
                aside = path.with_name(f"{UNREADABLE}.{step}")
                shutil.rmtree(aside, ignore_errors=True)  # the same step, damaged once before
                path.rename(aside)
        if faults and self.manager:
            self.manager.reload()

    def _unwritten(self, error: Exception) -> InputError:
        if isinstance(error, InputError):
            return error
        reason = getattr(error, "strerror", None) or str(error)
        return InputError(self.folder, f"cannot be written: {reason}")


@contextlib.contextmanager
def _unheard() -> Iterator[None]:
    """Silence errors of reads that orbax had begun and abandons after one fails, which Python prints one by one."""
    before, sys.unraisablehook = sys.unraisablehook, lambda error: None
    level = logging.root.manager.disable
    logging.disable(logging.CRITICAL)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
            gc.collect()
    finally:
        sys.unraisablehook = before
        logging.disable(level)
