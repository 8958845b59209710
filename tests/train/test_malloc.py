"""What is freed stays with the process, in one of its own: it cannot be undone."""

import platform
import subprocess
import sys

import pytest

PROGRAM = """
import sys
import numpy as np
from mesoshell.train.malloc import keep_memory

def held():
    return int(next(line for line in open("/proc/self/status") if line.startswith("VmRSS")).split()[1])

if sys.argv[1] == "keep":
    keep_memory()
before = held()
block = np.ones(2**23)
del block
print(held() - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only glibc's malloc is told")
@pytest.mark.parametrize("how, kept", [("keep", True), ("leave", False)])
def test_freed_memory_is_kept(how: str, kept: bool) -> None:
    """64 MiB: all of it, and without nearly nothing."""
    found = subprocess.run([sys.executable, "-c", PROGRAM, how], capture_output=True, text=True, check=True)
    assert (int(found.stdout) > 60_000) is kept and (int(found.stdout) < 10_000) is not kept
