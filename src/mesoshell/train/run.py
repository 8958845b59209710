"""A training run: steps, a log, checkpoints, resumption, and a stop when something is not finite.

Notation
folder       config.json (what the run was begun with), log.jsonl, checkpoints/, snapshots/IMAGES.npz, sheets/IMAGES.png,
             board/ (TensorBoard's, if it is installed)
method       the functions that the loop calls (train/method); it knows no other difference between methods
log          a row every LOG_EVERY steps: kimg; images a second and the mean of the steps' Reports since the last row
stop         requested by SIGTERM or SIGINT: the current step is finished and saved; a second SIGINT ends the run at once

A killed run loses the steps after its newest checkpoint, SAVE_EVERY seconds at most. A resumed run takes the same steps, bit
for bit on a CPU, as one that was never stopped: batches and keys depend on the step alone. Of several hosts (train/hosts) the
first keeps the folder; with each step they agree whether to save and to stop.
"""

import contextlib
import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from mesoshell.errors import InputError
from mesoshell.interrupt import StopRequest
from mesoshell.io.image import write_png
from mesoshell.io.lock import alone_in
from mesoshell.train.checkpoint import Checkpoints
from mesoshell.train.hosts import broadcast_first, is_first, noticing, wait_for_all
from mesoshell.train.method import Data, Method, method_of
from mesoshell.train.parallel import ParallelStep, spread_step
from mesoshell.train.report import write_report
from mesoshell.train.run_config import RunConfig, forget_after, keep_record, read_record
from mesoshell.train.tensorboard import open_board
from mesoshell.train.transfer import transfer_from

LOG_EVERY = 16
SAVE_EVERY = 120.0


class Diverged(RuntimeError):
    """A loss or gradient is NaN or infinite; the text says which, when, and where the last good checkpoint is."""


def steps_of(config: RunConfig) -> int:
    """Steps of a run; a quotient that is whole but for its rounding counts as whole."""
    return math.ceil(round(config.kimg * 1000 / config.batch, 6))


def train(
    config: RunConfig,
    dataset: Data,
    folder: Path,
    how: str = "jit",
    show: Callable[[dict[str, float]], None] = lambda row: None,
    transfer: Path | None = None,
    again: bool = False,
) -> Any:
    """The state at config.kimg, trained from the newest checkpoint in `folder`, or from the start. show: sees each log row.
    transfer: folder of another run, or a snapshot, whose weights a new run begins with. again: whether to raise the signal that
    stopped the run again after all is saved, for the calling program.

    Raises InputError if the folder holds a run of another configuration, or one that is under way, or cannot be written, or the
    other run's weights do not fit; Diverged if something is not finite; HostLost if another host is lost.
    """
    method = method_of(config)
    config, data = method.adapt(config, dataset)
    transfer = transfer or _lent(folder)
    transfer_weights = transfer_from(config, data, transfer) if transfer and is_first() else None
    with (
        _recorded(config, dataset, folder, transfer),
        noticing(),
        Checkpoints(folder / "checkpoints") as checkpoints,
        StopRequest(again) as stop,
        _Book(folder, method, config, data, show) as book,
    ):
        batch_of = method.feed(config, data, jax.process_index(), jax.process_count())
        spread = spread_step(
            lambda state, batch, across: method.step(config, state, batch, across),
            config.batch,
            how,
            method.together(config),
        )
        steps = steps_of(config)
        done, begin = _begun(checkpoints, method.start(config, data, jax.random.key(config.seed)), transfer_weights)
        book.begin(done)
        names, state = leaf_names(method.parts(begin)), spread.place(begin)
        saved = time.perf_counter()
        batch = spread.share(batch_of(done)) if done < steps else None
        for i in range(done, steps):
            state, report, requests = spread.step(state, batch, (stop.requested, _due(saved)))
            if i + 1 < steps:
                batch = spread.share(batch_of(i + 1))  # while the device is at work
            book.hear(report)
            if not book.finite:
                raise Diverged(_divergence(i, report, names, checkpoints))
            stopping, due = _decided(requests, stop, saved)
            last = i + 1 == steps or stopping
            if (i + 1) % LOG_EVERY == 0 or last:
                book.row(i + 1)
            if due or last:
                checkpoints.save(i + 1, _kept(spread, state))
                saved = time.perf_counter()
            if last or (i + 1) % max(1, round(config.snapshot_kimg * 1000 / config.batch)) == 0:
                book.snapshot(_kept(spread, state))
            if last:
                break
        if done == steps:
            book.complete(_kept(spread, state))
        checkpoints.finish()
        book.end()
        wait_for_all()
        return spread.whole(state)


@contextlib.contextmanager
def _recorded(config: RunConfig, dataset: Data, folder: Path, transfer: Path | None) -> Iterator[None]:
    """The folder held for this run alone, with its record."""
    with alone_in(folder.resolve()) if is_first() else contextlib.nullcontext():
        keep_record(config, dataset, folder, transfer)
        yield


def _lent(folder: Path) -> Path | None:
    """Whose weights a run begins with that was killed before its first checkpoint."""
    if not (folder / "config.json").exists() or any(x.name.isdigit() for x in (folder / "checkpoints").glob("*")):
        return None
    lent = read_record(folder)[1].get("transfer")
    return None if lent is None else Path(lent)


def _begun(checkpoints: Checkpoints, begin: Any, transfer_weights: Callable[[Any], Any] | None) -> tuple[int, Any]:
    """Steps done, and the state after them, from the first host: its newest checkpoint, else lent weights, else `begin`."""
    latest = checkpoints.newest(begin)
    if transfer_weights and not latest:
        latest = 0, transfer_weights(begin)
        checkpoints.save(*latest)
    good = -1 if latest is None else latest[0]
    good, state = broadcast_first((good, begin if latest is None else latest[1]))
    checkpoints.last = None if good < 0 else int(good)
    return max(int(good), 0), state


def _due(saved: float) -> bool:
    """Whether it is time for a checkpoint, by the first host's clock."""
    return is_first() and time.perf_counter() - saved > SAVE_EVERY


def _decided(requests: Sequence[Any], stop: StopRequest, saved: float) -> tuple[bool, bool]:
    """Whether to stop and to save after this step: as all hosts requested, or, with one host, as of now."""
    if jax.process_count() == 1:
        return stop.requested, _due(saved)
    return bool(requests[0]), bool(requests[1])


def _kept(spread: ParallelStep, state: Any) -> Any:
    """The whole state on the first host, which writes it; None on the others, which need not fetch it."""
    return spread.whole(state) if is_first() else None


def leaf_names(parts: dict[str, Any]) -> list[str]:
    """Names of the leaves in the order of a report's `bad`."""
    return [
        name + jax.tree_util.keystr(path)
        for name, tree in parts.items()
        for path, _ in jax.tree_util.tree_leaves_with_path(tree)
    ]


class _Book:
    """Collects reports of steps, and on the first host writes log rows, snapshots with their sheets and report.html, and the
    same for TensorBoard if it is installed."""

    def __init__(self, folder: Path, method: Method, config: RunConfig, dataset: Any, show: Callable):
        self.folder, self.method, self.config, self.dataset, self.show = folder, method, config, dataset, show
        self.board, self.finite = None, True
        self.heard: list[dict[str, float]] = []
        self.logged = time.perf_counter()

    def __enter__(self) -> "_Book":
        self.board = open_board(self.folder / "board") if is_first() else None
        return self

    def begin(self, done: int) -> None:
        """Drop log rows of steps that a killed run took and this one takes again."""
        if self.board:
            forget_after(self.folder / "log.jsonl", "kimg", done * self.config.batch / 1000)
        self.logged = time.perf_counter()

    def hear(self, report: Any) -> None:
        report = jax.device_get(report)
        self.heard.append({k: float(v) for k, v in report._asdict().items() if k != "bad"})
        self.finite = not report.bad.any() and bool(np.isfinite(list(self.heard[-1].values())).all())

    def row(self, steps: int) -> None:
        now = time.perf_counter()
        row = {"kimg": steps * self.config.batch / 1000}
        row["images_per_s"] = round(len(self.heard) * self.config.batch / (now - self.logged), 3)
        row |= {k: float(f"{np.mean([numbers[k] for numbers in self.heard]):.5g}") for k in self.heard[0]}
        self.logged, self.heard = now, []
        if self.board:
            path = self.folder / "log.jsonl"
            try:
                with path.open("a") as log:
                    log.write(json.dumps(row) + "\n")
            except OSError as error:  # a write's names no file
                raise InputError(path, f"cannot be written: {error.strerror}") from error
            self.board.row(row)
        self.show(row)

    def complete(self, state: Any) -> None:
        """The snapshot of a run's end, if it was killed before that was there."""
        if self.board and not (self.folder / "snapshots" / f"{int(state.images):09d}.npz").exists():
            self.snapshot(state)

    def snapshot(self, state: Any) -> None:
        if self.board:
            for part in ("snapshots", "sheets"):
                (self.folder / part).mkdir(exist_ok=True)
            name = f"{int(state.images):09d}"
            self.method.save(self.folder / "snapshots" / f"{name}.npz", self.config, self.dataset, state)
            sheet = self.folder / "sheets" / f"{name}.png"
            write_png(sheet, self.method.sheet(self.config, self.dataset, state))
            self.board.sheet(sheet)

    def end(self) -> None:
        if self.board:
            write_report(self.folder)

    def __exit__(self, *_: object) -> None:
        if self.board:
            self.board.close()


def _divergence(i: int, report: Any, names: list[str], checkpoints: Checkpoints) -> str:
    bad = np.flatnonzero(np.asarray(report.bad))
    what = f"the gradient of {names[bad[0]]} is" if len(bad) else "a loss is"
    good = checkpoints.last
    last = (
        "there is no checkpoint yet"
        if good is None
        else f"the last good checkpoint is {checkpoints.folder / str(good)}"
    )
    return f"step {i + 1}: {what} not finite; {last}"
