"""Programs that are kept between commands: one that was only half written is compiled anew, and nothing is said of it; of too
many the oldest go."""

import os
import subprocess
import sys
from pathlib import Path

COMMAND = """
import jax
from mesoshell.cli.compilation_cache import keep_compiled
from mesoshell.cli.ending import in_one_line
with in_one_line():
    seconds = keep_compiled()
    print(jax.jit(lambda x: 2 * x)(21))
"""


def said(cache: Path) -> tuple[int, str, str]:
    environment = os.environ | {"XDG_CACHE_HOME": str(cache)}
    done = subprocess.run([sys.executable, "-c", COMMAND], capture_output=True, text=True, env=environment)
    return done.returncode, done.stdout, done.stderr


def test_a_half_written_program_is_compiled_anew_without_a_word(tmp_path: Path) -> None:
    assert said(tmp_path) == (0, "42\n", "")
    kept = [path for path in tmp_path.rglob("*-cache")]
    assert kept
    for path in kept:
        path.write_bytes(path.read_bytes()[:100])
    assert said(tmp_path) == (0, "42\n", "")


def test_the_oldest_go_when_they_are_too_many(tmp_path: Path) -> None:
    room = tmp_path / "mesoshell" / "xla"
    room.mkdir(parents=True)
    for age, name in enumerate(("new", "old")):
        with open(room / f"{name}-cache", "wb") as file:
            file.truncate(600 << 20)
        os.utime(room / f"{name}-cache", (1e9 - age, 1e9 - age))
    assert said(tmp_path) == (0, "42\n", "")
    assert (room / "new-cache").exists() and not (room / "old-cache").exists()
