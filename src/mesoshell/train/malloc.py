"""Have malloc keep freed memory.

XLA frees a step's buffers after the step. glibc's malloc gives them back to the system, which then clears each page anew when
the next step touches it: a quarter of a step's time on a CPU. With this, a process stays at its peak size.
"""

import ctypes

#: M_TRIM_THRESHOLD, free memory at the heap's end before any is given back, and M_MMAP_THRESHOLD, from <malloc.h>.
TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
#: The largest int.
MAX_THRESHOLD = 2**31 - 1


def keep_memory() -> None:
    """Have glibc's malloc keep what is freed; with another malloc, do nothing."""
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # not glibc, no symbols of the process itself, Windows
        return
    mallopt(TRIM_THRESHOLD, MAX_THRESHOLD)
    mallopt(MMAP_THRESHOLD, MAX_THRESHOLD)
