"""`make test-gpu` needs an accelerator and says so; no test keeps JAX from one."""

import os
import re
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]


def test_without_an_accelerator_it_ends_in_one_line():
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.accelerator", "--find"],
        cwd=TESTS.parent,
        env=os.environ | {"JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert re.fullmatch(r"mesoshell: no accelerator: JAX finds cpu only; install JAX for yours, .*\n", done.stderr)


def test_no_hard_case_chooses_the_device():
    chooses = re.compile("jax_platform|JAX_PLATFORM|default_device|jax.devices")
    files = [
        TESTS / "conftest.py",
        *(p for d in ("stability", "helpers/stability") for p in (TESTS / d).glob("*.py") if p != Path(__file__)),
    ]
    assert [p.name for p in files if chooses.search(p.read_text())] == []
