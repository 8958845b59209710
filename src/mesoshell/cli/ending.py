"""How a command ends: a fault is one line and an exit status, whatever libraries print and whenever it is interrupted."""

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
    """Print each warning as one line, but none of arithmetic; print names of any bytes; let Ctrl-C through."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    with warnings.catch_warnings(), _interrupts():
        warnings.showwarning = _show
        if not any(action == "error" for action, *_ in warnings.filters):  # as tests ask for
            warnings.simplefilter("ignore", RuntimeWarning)
        yield


def flush_output() -> None:
    """Flush standard output. Raises BrokenPipeError if nobody reads, InputError if it cannot be written."""
    try:
        sys.stdout.flush()
    except OSError as error:
        with contextlib.suppress(OSError, ValueError):  # else Python flushes again when it ends, and complains
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            raise
        raise InputError("standard output", f"cannot be written: {error.strerror}") from error


def run_command(work: Callable[[], None], debug: bool = False) -> int:
    """Do the work, and return the exit status. A fault is one line on standard error, or a traceback with `debug`."""
    try:
        with in_one_line():
            _done(work)
    except BrokenPipeError:
        return 141  # as a shell reports a program that SIGPIPE ends
    except (InputError, OSError, MemoryError) as fault:
        if debug:
            raise
        print(f"mesoshell: {_message(fault)}", file=sys.stderr)
        return 2
    except RuntimeError as fault:
        if debug or not str(fault).startswith("RESOURCE_EXHAUSTED"):  # as a device says that its memory is
            raise
        print(f"mesoshell: out of memory: {one_line(str(fault))}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("mesoshell: interrupted", file=sys.stderr)
        return 130
    return 0


def _done(work: Callable[[], None]) -> None:
    """Do the work, and flush what it printed."""
    try:
        work()
    except SystemExit:
        flush_output()
        raise
    except OSError as fault:
        if fault.filename is None:  # perhaps an error of printing: flushing what is still buffered fails again
            flush_output()
        raise
    flush_output()


def _message(fault: Exception) -> str:
    """A fault as one line."""
    if isinstance(fault, OSError):
        where = f"{fault.filename}: " if fault.filename is not None else ""
        return one_line(f"{where}{fault.strerror or fault}")
    return spoken(fault) if isinstance(fault, InputError) else one_line(f"out of memory: {fault}")


@contextlib.contextmanager
def usage(verb: str = "") -> Iterator[None]:
    """Print an error of the parser, which draws it in a box, as one line. verb: of the command line, if it has one."""
    captured = io.StringIO()
    try:
        with contextlib.redirect_stderr(captured):
            yield
    except SystemExit as end:
        if end.code not in (0, None):
            print(f"mesoshell: {_boxed(captured.getvalue(), verb)}", file=sys.stderr)
        raise


def _boxed(text: str, verb: str) -> str:
    """The text above the first rule in the parser's box, and the command whose help tells more."""
    lines = [line.strip("│ ") for line in text.splitlines()]
    lines = [line for line in lines if not line.startswith(("╭", "╰"))]
    if len(lines) > 1 and set(lines[1]) == {"-"}:  # without a box: a title and a rule
        lines = lines[2:]
    end = next((i for i, line in enumerate(lines) if line.startswith("──") or set(line) == {"-"}), len(lines))
    helped = re.search(r"(mesoshell \w[\w -]*--help)", " ".join(lines))
    message = _plain(one_line(" ".join(lines[:end]).strip() or "unknown command"))
    return f"{message} (see {helped.group(1) if helped else ' '.join(['mesoshell', *verb.split(), '--help'])})"


def _plain(message: str) -> str:
    """The parser's message without what it says of None, which nobody types: of wrong values what an option takes alone."""
    found = re.match(r"Error parsing (\S+): no type matching (.+?) could be instantiated from \[(.*?)\]\. ", message)
    if found is None:
        return re.sub(r"'None', |, 'None'", "", message)
    option, kinds, values = found.groups()
    takes = " or ".join(kind.strip("{}") for kind in kinds.split("|") if kind != "{None}")
    return f"{option} takes {takes}, not {values.replace(chr(39), '').replace(',', '')}"


def _show(message: Warning | str, category: type[Warning], *_: object) -> None:
    print(f"mesoshell: warning: {one_line(str(message))}", file=sys.stderr)


@contextlib.contextmanager
def _interrupts() -> Iterator[None]:
    """Raise an interrupt again until it arrives: a library that is being imported, or its callbacks, may swallow it."""
    main = threading.current_thread() is threading.main_thread()
    if not main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        signal.setitimer(signal.ITIMER_REAL, AGAIN)
        raise KeyboardInterrupt

    def ignored(what: Any) -> None:
        if not isinstance(what.exc_value, KeyboardInterrupt):
            hook(what)

    before, hook = signal.signal(signal.SIGALRM, interrupt), sys.unraisablehook
    signal.signal(signal.SIGINT, interrupt)
    # Python would print the traceback of an interrupt that a garbage collector's callback swallowed
    sys.unraisablehook = ignored
    try:
        yield
    finally:
        sys.unraisablehook = hook
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        signal.signal(signal.SIGINT, signal.default_int_handler)
