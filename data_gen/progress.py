"""Progress on standard output while Blender's own chatter there is thrown away.

Alphabet
    rate      images a minute since the start of this run
    left      time that the rest takes at that rate

Blender writes to file descriptor 1 from C, past Python's `sys.stdout`, so the descriptor itself is redirected.
"""

import os
import time
from typing import TextIO

INTERVAL_S = 10.0


def take_standard_output() -> TextIO:
    """A stream to what was standard output; descriptor 1 leads nowhere from now on."""
    kept = os.fdopen(os.dup(1), "w", buffering=1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.close(nowhere)
    return kept


class Progress:
    """One line at most every ten seconds, and one at the end."""

    def __init__(self, total: int, stream: TextIO) -> None:
        self.total, self.stream = total, stream
        self.made = 0
        self.start = self.said = time.monotonic()

    def step(self) -> None:
        self.made += 1
        now = time.monotonic()
        if now - self.said < INTERVAL_S and self.made < self.total:
            return
        self.said = now
        rate = self.made / max(now - self.start, 1e-9)
        left = (self.total - self.made) / rate
        line = f"{self.made}/{self.total} images, {60.0 * rate:.0f} images/min, {left / 60.0:.1f} min left"
        self.stream.write(line + "\n")
