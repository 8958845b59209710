"""What runs where if JAX has an accelerator: the same picture, with the walk on the host's CPU."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from mesoshell.io.bundle import Bundle, write_bundle


@pytest.mark.slow  # a process of its own, with a device more
def test_an_accelerator_has_all_but_the_walk(tiny_bundle: Bundle, tmp_path: Path):
    write_bundle(tmp_path / "tiny.npz", tiny_bundle)
    command = [sys.executable, "-m", "tests.helpers.accelerator", str(tmp_path / "tiny.npz")]
    done = subprocess.run(command, cwd=Path(__file__).parents[3], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    said = json.loads(done.stdout.splitlines()[-1])
    assert said["walk"] == [0] and said["chart"] == said["decoder"] == said["density"] == [1]
    assert said["differ"] < 1e-6
