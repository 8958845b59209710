"""How a command ends: by one line that says the fault, whatever libraries print and whenever it is interrupted."""

import contextlib
import io
import os
import re
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

from mesoshell.cli.spoken import spoken
from mesoshell.errors import InputError, one_line

#: Seconds after which an interrupt that a library swallowed is raised again.
AGAIN = 1.5


@contextlib.contextmanager
def in_one_line() -> Iterator[None]:
    """Warnings become one line each, none of arithmetic; names print whatever bytes they are of; Ctrl-C is heard."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    with warnings.catch_warnings(), _interrupts():
        warnings.showwarning = _show
        if not any(action == "error" for action, *_ in warnings.filters):  # as tests ask for
            warnings.simplefilter("ignore", RuntimeWarning)
        yield


def flushed() -> None:
    """Write out what standard output holds. Raises BrokenPipeError if nobody reads, InputError if it cannot be written."""
    try:
        sys.stdout.flush()
    except OSError as error:
        with contextlib.suppress(OSError, ValueError):  # else Python tries again at its end, and complains
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            raise
        raise InputError("standard output", f"cannot be written: {error.strerror}") from error


def concluded(work: Callable[[], None], debug: bool = False) -> int:
    """Do the work; say in one line on standard error what it raises, unless `debug`. Returns the exit status."""
    try:
        with in_one_line():
            _done(work)
    except BrokenPipeError:
        return 141  # as a program that SIGPIPE ends
    except (InputError, OSError, MemoryError) as fault:
        if debug:
            raise
        print(f"mesoshell: {_said(fault)}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("mesoshell: interrupted", file=sys.stderr)
        return 130
    return 0


def _done(work: Callable[[], None]) -> None:
    """Do the work, and write out what it printed."""
    try:
        work()
    except OSError as fault:
        if fault.filename is None:  # perhaps what could not be printed: it is still held, and fails again
            flushed()
        raise
    flushed()


def _said(fault: Exception) -> str:
    """One line of an error that is the system's."""
    if isinstance(fault, OSError):
        where = f"{fault.filename}: " if fault.filename is not None else ""
        return one_line(f"{where}{fault.strerror or fault}")
    return spoken(fault) if isinstance(fault, InputError) else one_line(f"out of memory: {fault}")


@contextlib.contextmanager
def usage() -> Iterator[None]:
    """A fault of the command line, which the parser draws in a box, as one line."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            yield
    except SystemExit as end:
        if end.code not in (0, None):
            print(f"mesoshell: {_boxed(said.getvalue())}", file=sys.stderr)
        raise


def _boxed(text: str) -> str:
    """The sentence of a box: what is above its first rule, or the list of what is missing with the first of each text."""
    lines = [line.strip("│ ") for line in text.splitlines()]
    lines = [line for line in lines if not line.startswith(("╭", "╰"))]
    end = next((i for i, line in enumerate(lines) if line.startswith("──")), len(lines))
    helped = re.search(r"(mesoshell[\w -]*--help)", " ".join(lines))
    said = one_line(" ".join(lines[:end]).strip() or "not a command that is known")
    return f"{said} (see {helped.group(1) if helped else 'mesoshell --help'})"


def _show(message: Warning | str, category: type[Warning], *_: object) -> None:
    print(f"mesoshell: warning: {one_line(str(message))}", file=sys.stderr)


@contextlib.contextmanager
def _interrupts() -> Iterator[None]:
    """Raise an interrupt again until it gets here: libraries that are being imported, or called back, swallow some."""
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        signal.setitimer(signal.ITIMER_REAL, AGAIN)
        raise KeyboardInterrupt

    def ignored(what: Any) -> None:
        if not isinstance(what.exc_value, KeyboardInterrupt):
            said(what)

    before, said = signal.signal(signal.SIGALRM, interrupt), sys.unraisablehook
    signal.signal(signal.SIGINT, interrupt)
    # of one that a callback of the collector's swallowed, Python would print the traceback
    sys.unraisablehook = ignored
    try:
        yield
    finally:
        sys.unraisablehook = said
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        signal.signal(signal.SIGINT, signal.default_int_handler)
