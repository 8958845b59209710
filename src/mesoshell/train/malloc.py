"""Memory that a process keeps for itself.

XLA frees a step's buffers after the step. glibc's malloc gives them back to the system, which then clears each page anew when
the next step touches it: a quarter of a step's time on a CPU. Kept, a process holds what it needed at most.
"""

import ctypes

#: Of <malloc.h>: free memory at a heap's end before any is given back, and sizes from which blocks are mapped by themselves.
TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
#: As much as can be said.
MOST = 2**31 - 1


def keep_memory() -> None:
    """Have malloc keep what is freed, where it is glibc's; elsewhere nothing."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # not glibc, no symbols of the process itself, Windows
        return
    mallopt(TRIM_THRESHOLD, MOST)
    mallopt(MMAP_THRESHOLD, MOST)
