"""What C++ libraries print is dropped, and the memory that they take is bounded, while they read and no longer."""

import os
import subprocess
import sys

from mesoshell.contained import silent


def test_what_is_printed_is_dropped(capfd) -> None:
    with silent(), silent():
        os.write(2, b"from C")
        print("from Python")
    os.write(2, b"later")
    assert capfd.readouterr() == ("", "later")


BOUNDED = """
import resource
import numpy as np
import pytest
from mesoshell.contained import bounded_memory

before = resource.getrlimit(resource.RLIMIT_AS)
with bounded_memory(2**28):
    assert np.empty(2**24, np.uint8).size == 2**24
    with pytest.raises(MemoryError):
        np.empty(2**30, np.uint8)
    with bounded_memory(2**40), pytest.raises(MemoryError):  # a wider one within does not widen it
        np.empty(2**30, np.uint8)
assert resource.getrlimit(resource.RLIMIT_AS) == before
assert np.empty(2**30, np.uint8).size == 2**30
"""


def test_memory_is_bounded_and_then_is_not() -> None:
    """In a process of its own: threads of others unmap what they held, and more would fit."""
    done = subprocess.run([sys.executable, "-c", BOUNDED], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
