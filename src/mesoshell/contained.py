"""Contain libraries in C++ that read files of anyone's: what they print, the memory they take (standard library only).

Both belong to the whole process, so threads take turns; other threads' messages are lost, and their allocations refused, too.
"""

import contextlib
import io
import os
import resource
import threading
from collections.abc import Iterator
from pathlib import Path

_TURN = threading.RLock()


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Drop what is printed, also at a crash: from C on descriptor 2, and through `sys.stdout`."""
    with _TURN, contextlib.redirect_stdout(io.StringIO()):
        try:
            kept = os.dup(2)
        except OSError:  # it is closed: nothing is printed
            yield
            return
        null = os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(null, 2)
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            os.close(null)


@contextlib.contextmanager
def bounded_memory(size: int) -> Iterator[None]:
    """Let this process map at most so many bytes more: what a damaged file asks for beyond is refused at once, where Linux
    would promise it and end the process later. Elsewhere nothing is bounded."""
    with _TURN:
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        if mapped := _mapped():
            limits = [mapped + size] + ([soft] if soft != resource.RLIM_INFINITY else [])
            resource.setrlimit(resource.RLIMIT_AS, (min(limits), hard))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def _mapped() -> int:
    """Bytes that this process maps; 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0
