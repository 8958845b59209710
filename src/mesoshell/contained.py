"""Contain libraries in C++ that read files of anyone's: what they print, the memory they take (standard library only)."""

import contextlib
import io
import os
import resource
import threading
from collections.abc import Iterator
from pathlib import Path

_HUSH = threading.RLock()


@contextlib.contextmanager
def hushed() -> Iterator[None]:
    """Drop what is printed: from C on descriptor 2, and through `sys.stdout`.

    Both belong to the whole process, so threads take turns: two that overlap would restore each other's redirection.
    """
    with _HUSH, contextlib.redirect_stdout(io.StringIO()):
        kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
        try:
            os.dup2(null, 2)
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            os.close(null)


@contextlib.contextmanager
def bounded(size: int) -> Iterator[None]:
    """Let this process map at most so many bytes more: what a damaged file asks for beyond is refused at once, where Linux
    would promise it and end the process later. Elsewhere nothing is bounded."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    try:
        mapped = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        yield
        return
    limit = mapped + size
    if soft != resource.RLIM_INFINITY:
        limit = min(limit, soft)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
