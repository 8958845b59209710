"""The training loop of a fit: batches, occupancy, a log, checkpoints, resumption.

Alphabet
step        counted from 1; the schedule of the rates needs their total beforehand
minutes     wall time spent in steps, summed over resumptions
log         `log.jsonl`, one row every LOG_EVERY steps: step, minutes, mean loss, share of the decoding budget wanted
"""

import json
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

from mesoshell.io.records import read_rows
from mesoshell.train.checkpoint import Checkpoints
from mesoshell.train.fit import FitConfig, State, batches, make_refresh, make_step, start
from mesoshell.train.parallel import replicate, spread
from mesoshell.train.rays import ImageTable, RayTable

LOG_EVERY, REFRESH_EVERY = 50, 16
#: Seconds between checkpoints.
SAVE_EVERY = 120.0


def fit(
    config: FitConfig,
    table: RayTable,
    images: ImageTable,
    steps: int,
    run: Path,
    report: Callable[[dict, State], None] = lambda row, state: None,
) -> State:
    """Train for `steps` steps in all, from the newest checkpoint in `run` if there is one. report: sees each log row, and
    the state then; its own time is not counted."""
    state = replicate(start(config, images, steps))
    step, refresh = make_step(config, images, steps), make_refresh(config, images)
    rows = read_rows(run / "log.jsonl", ("minutes",))
    minutes = rows[-1]["minutes"] if rows else 0.0
    with Checkpoints(run / "checkpoints") as checkpoints:
        found = checkpoints.newest(state)
        done, state = found if found else (0, state)
        stream = batches(config, table, begin=done)
        losses, clock, saved = [], time.perf_counter(), time.perf_counter()
        for i in range(done + 1, steps + 1):
            keys = jax.random.split(jax.random.fold_in(jax.random.key(config.seed), i))
            if i % REFRESH_EVERY == 1 or i < 4 * REFRESH_EVERY:
                state = refresh(state, keys[0])
            state, loss, wanted = step(state, spread(next(stream)), keys[1])
            losses.append(float(loss))
            if i % LOG_EVERY == 0 or i == steps:
                now = time.perf_counter()
                minutes += (now - clock) / 60
                row = {"step": i, "minutes": round(minutes, 3), "loss": float(np.mean(losses)), "wanted": float(wanted)}
                with (run / "log.jsonl").open("a") as log:
                    log.write(json.dumps(row) + "\n")
                report(row, state)
                losses, clock = [], time.perf_counter()
            if time.perf_counter() - saved > SAVE_EVERY or i == steps:
                checkpoints.save(i, state)
                saved = time.perf_counter()
    return state
