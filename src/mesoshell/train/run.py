"""A training run: steps, a log, checkpoints, resumption, and a stop when something is not finite.

Alphabet
folder       config.json (what the run was begun with), log.jsonl, checkpoints/, snapshots/IMAGES.npz, sheets/IMAGES.png,
             board/ (TensorBoard's, if it is installed)
method       what a run asks of the way it learns (train/method); the loop knows no other difference
log          a row every LOG_EVERY steps: kimg; images a second and the mean of the steps' Reports since the last row
stop         asked for by SIGTERM: the step in hand is finished and saved

A killed run loses what came after its newest checkpoint, SAVE_EVERY seconds at most. A resumed run takes the same steps, bit
for bit on a CPU, as one that was never stopped: batches and keys depend on the step alone.
"""

import json
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from mesoshell.io.image import write_png
from mesoshell.train.board import open_board
from mesoshell.train.checkpoint import Checkpoints
from mesoshell.train.method import Data, Method, method_of
from mesoshell.train.parallel import spread_step
from mesoshell.train.record import keep_record
from mesoshell.train.report import write_report
from mesoshell.train.stream import RunConfig
from mesoshell.train.transfer import lender

LOG_EVERY = 16
SAVE_EVERY = 120.0


class Diverged(RuntimeError):
    """A loss or gradient is NaN or infinite; the text says which, when, and where the last good checkpoint is."""


def train(
    config: RunConfig,
    dataset: Data,
    folder: Path,
    how: str = "jit",
    show: Callable[[dict[str, float]], None] = lambda row: None,
    transfer: Path | None = None,
) -> Any:
    """The state at config.kimg, trained from the newest checkpoint in `folder`, or from the start. show: sees each log row.
    transfer: folder of another run, whose weights a start begins with.

    Raises InputError if the folder holds a run of another configuration, or the other run's weights do not fit; Diverged if
    something is not finite.
    """
    method = method_of(config)
    config, seen = method.fitted(config, dataset)
    lend = lender(config, transfer) if transfer else None
    keep_record(config, dataset, folder, transfer)
    batch_of = method.feed(config, seen, jax.process_index(), jax.process_count())
    spread = spread_step(
        lambda state, batch, across: method.step(config, state, batch, across),
        config.batch,
        how,
        method.together(config),
    )
    begin = method.start(config, jax.random.key(config.seed))
    steps = int(np.ceil(config.kimg * 1000 / config.batch))
    snapshot = max(1, round(config.snapshot_kimg * 1000 / config.batch))
    with Checkpoints(folder / "checkpoints") as checkpoints, _Stop() as stop, _Book(folder) as book:
        found = checkpoints.newest(begin)
        if lend and not found:
            found = 0, lend(begin)
            checkpoints.save(*found)
        done, begin = found or (0, begin)
        names = leaf_names(method.parts(begin))
        state = spread.place(begin)
        logged = saved = time.perf_counter()
        heard: list[dict[str, float]] = []
        for i in range(done, steps):
            state, report = spread.step(state, spread.share(batch_of(i)))
            heard.append(_numbers(report))
            if np.asarray(report.bad).any() or not np.isfinite(list(heard[-1].values())).all():
                raise Diverged(_said(i, report, names, folder, checkpoints.manager.latest_step()))
            now, last = time.perf_counter(), i + 1 == steps
            if (i + 1) % LOG_EVERY == 0 or last or stop.asked:
                row = _row(config, i + 1, len(heard) * config.batch / (now - logged), heard)
                book.row(row)
                show(row)
                logged, heard = now, []
            if now - saved > SAVE_EVERY or last or stop.asked:
                checkpoints.save(i + 1, spread.whole(state))
                saved = time.perf_counter()
            if (i + 1) % snapshot == 0 or last or stop.asked:
                book.snapshot(method, config, seen, spread.whole(state))
            if stop.asked:
                break
        if jax.process_index() == 0:
            write_report(folder)
        return spread.whole(state)


def leaf_names(parts: dict[str, Any]) -> list[str]:
    """Names of the leaves that a report's `bad` speaks of."""
    return [
        name + jax.tree_util.keystr(path)
        for name, tree in parts.items()
        for path, _ in jax.tree_util.tree_leaves_with_path(tree)
    ]


class _Book:
    """What the first host writes: log rows, snapshots with their sheets, and the same for TensorBoard if it is installed."""

    def __init__(self, folder: Path):
        self.folder, self.board = folder, None

    def __enter__(self) -> "_Book":
        self.board = open_board(self.folder / "board") if jax.process_index() == 0 else None
        return self

    def row(self, row: dict[str, float]) -> None:
        if self.board:
            with (self.folder / "log.jsonl").open("a") as log:
                log.write(json.dumps(row) + "\n")
            self.board.row(row)

    def snapshot(self, method: Method, config: RunConfig, dataset: Data, state: Any) -> None:
        if self.board:
            for part in ("snapshots", "sheets"):
                (self.folder / part).mkdir(exist_ok=True)
            name = f"{int(state.images):09d}"
            method.save(self.folder / "snapshots" / f"{name}.npz", config, dataset, state)
            sheet = self.folder / "sheets" / f"{name}.png"
            write_png(sheet, method.sheet(config, dataset, state))
            self.board.sheet(sheet)

    def __exit__(self, *_: object) -> None:
        if self.board:
            self.board.close()


def _said(i: int, report: Any, names: list[str], folder: Path, good: int | None) -> str:
    bad = np.flatnonzero(np.asarray(report.bad))
    what = f"the gradient of {names[bad[0]]} is" if len(bad) else "a loss is"
    last = (
        f"the last good checkpoint is {folder / 'checkpoints' / str(good)}"
        if good is not None
        else "there is no checkpoint yet"
    )
    return f"step {i + 1}: {what} not finite; {last}"


def _row(config: RunConfig, steps: int, rate: float, heard: list[dict[str, float]]) -> dict[str, float]:
    row = {"kimg": steps * config.batch / 1000, "images_per_s": round(rate, 3)}
    return row | {k: float(f"{np.mean([numbers[k] for numbers in heard]):.5g}") for k in heard[0]}


def _numbers(report: Any) -> dict[str, float]:
    return {k: float(v) for k, v in report._asdict().items() if k != "bad"}


class _Stop:
    """Whether SIGTERM has come since the context was entered."""

    def __enter__(self) -> "_Stop":
        self.asked = False
        self._before = signal.signal(signal.SIGTERM, self._heard)
        return self

    def _heard(self, *_: object) -> None:
        self.asked = True

    def __exit__(self, *_: object) -> None:
        signal.signal(signal.SIGTERM, self._before)
