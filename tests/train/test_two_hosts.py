"""Two processes on one machine train as one run: the same steps as one process takes, one log, one checkpoint."""

import json
import socket
import subprocess
import sys
from pathlib import Path

import fog
import jax
import numpy as np
import pytest

from mesoshell.cli.training import read_experiment
from mesoshell.io.dataset import read_dataset
from mesoshell.io.pack import pack_dataset
from mesoshell.train.checkpoint import Checkpoints
from mesoshell.train.state import start
from mesoshell.train.stream import fitted

EXPERIMENT = """
from dataclasses import replace
from mesoshell.train.presets import TINY
config = replace(
    TINY,
    generator=replace(TINY.generator, channel_base=32, channel_max=4, channels=4, layers=4),
    discriminator=replace(TINY.discriminator, size=8, channel_base=32, channel_max=4),
    picture=replace(TINY.picture, size=8, samples=4),
    kimg=0.012,
)
"""


def test_two_processes_train_one_run(tmp_path: Path) -> None:
    fog.write(tmp_path / "fog", [(0.6, 0.3, 1.6 + 0.4 * k) for k in range(8)], size=8)
    pack_dataset(read_dataset(tmp_path / "fog"), tmp_path / "packed")
    (tmp_path / "e.py").write_text(EXPERIMENT)
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]

    def command(run: str, *more: str) -> list[str]:
        given = ["train", str(tmp_path / "e.py"), "--data", str(tmp_path / "packed"), "--run", str(tmp_path / run)]
        return [sys.executable, "-c", "from mesoshell.cli.main import main; main()", *given, *more]

    both = [
        subprocess.Popen(
            command("two", "--coordinator", f"localhost:{port}", "--hosts", "2", str(i)),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        for i in (0, 1)
    ]
    alone = subprocess.run(command("one"), capture_output=True, text=True, timeout=300)
    said = [process.communicate(timeout=300)[0] for process in both]
    assert [process.returncode for process in both] == [0, 0], said
    assert alone.returncode == 0, alone.stderr
    config = fitted(read_experiment(tmp_path / "e.py"), read_dataset(tmp_path / "packed"))[0]
    like, found = start(config, jax.random.key(0)), {}
    for run in ("one", "two"):
        assert [p.name for p in (tmp_path / run / "checkpoints").iterdir() if p.name.isdigit()] == ["3"]
        assert len(list((tmp_path / run / "snapshots").iterdir())) == 1
        with Checkpoints(tmp_path / run / "checkpoints") as checkpoints:
            found[run] = checkpoints.newest(like)
    rows = [(tmp_path / run / "log.jsonl").read_text().splitlines() for run in ("one", "two")]
    assert len(rows[0]) == len(rows[1]) == 1
    one, two = (json.loads(r[0]) for r in rows)
    assert one["real"] == pytest.approx(two["real"], abs=1e-3)
    pairs = zip(jax.tree.leaves(found["one"]), jax.tree.leaves(found["two"]), strict=True)
    assert all(np.shape(a) == np.shape(b) and np.isfinite(b).all() for a, b in pairs)
