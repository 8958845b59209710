"""One of several hosts trains in a child process; the parent prints how it ended. The fork comes before JAX is imported.

When a host is lost, JAX aborts the process from a compiler thread: it prints a trace, and Python code cannot print anything
more. So the child trains, and the parent passes on signals and what libraries print, and reports the end in one line.
"""

import contextlib
import ctypes
import os
import re
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from pathlib import Path

from mesoshell.cli.ending import run_command

#: Exit status if another host is lost: EX_TEMPFAIL, "try again", in sysexits.h.
LOST = 75
SAID_LOST = (
    "a host was lost, or ended with an error that it printed itself; start all hosts again: the run goes on from its "
    "newest checkpoint"
)
#: Printed by the coordination service when a host is lost, and by JAX when it ends the process; when a host never came.
_ABORTS = re.compile(r"^E\d+ .* coordination_service\w*\.cc|JAX distributed service detected fatal errors")
_UNMET = "/RegisterTask"
#: Where the service names the silent hosts; what it prints if the first host is silent.
_SILENT = re.compile(r"stopped sending heartbeats\):\s+((?:\d+\s+)+)")
_FIRST = "Failed to send RPC to coordination service"
#: Statuses with which all hosts end together, and can disconnect in order: done, and diverged.
_TOGETHER = (0, 1)
#: Linux's PR_SET_PDEATHSIG.
_DEATH_SIGNAL = 1


def run_in_child(work: Callable[[], None], run: Path) -> None:
    """Do a host's work in a child process, and end with its status. run: folder that the line about a lost host names."""
    reading, writing = os.pipe()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    child = os.fork()
    if child == 0:
        os.close(reading)
        _train(work, writing)
    os.close(writing)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: os.kill(child, number))
    noise = _Noise(reading)
    ended = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    noise.join(1.0)  # a process that the child started may still hold the pipe open
    if ended == -signal.SIGABRT and noise.fatal:
        lost = SAID_LOST.replace("a host", _lost(noise.fatal), 1)
        print(f"mesoshell: {run}: {'not all hosts came in time' if _UNMET in noise.fatal else lost}", file=sys.stderr)
        sys.exit(LOST)
    if ended < 0:
        print(f"mesoshell: {run}: ended by {signal.Signals(-ended).name}", file=sys.stderr)
        sys.exit(128 - ended)
    sys.exit(ended)


def _lost(fatal: str) -> str:
    """Which host is lost, if what JAX prints before it aborts names it."""
    silent = _SILENT.search(fatal)
    numbers = silent[1].split() if silent else ["0"] if _FIRST in fatal else []
    return f"host{'s'[: len(numbers) - 1]} {', '.join(numbers)}" if numbers else "a host"


def _train(work: Callable[[], None], writing: int) -> None:
    """The child: what Python prints goes where it went before, what libraries print goes to the parent. Unless all hosts end
    together, the process ends at once: an orderly disconnect would wait for hosts that wait for it."""
    os.setpgid(0, 0)  # Ctrl-C in a terminal comes once, from the parent
    with contextlib.suppress(OSError, AttributeError):  # not on a Mac
        ctypes.CDLL(None).prctl(_DEATH_SIGNAL, signal.SIGKILL)
    for name, number in (("stdout", 1), ("stderr", 2)):
        kept = open(os.dup(number), "w", buffering=1, errors="backslashreplace")  # noqa: SIM115 (to the end)
        setattr(sys, name, kept)
        os.dup2(writing, number)
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # gRPC's warnings of the same loss
    together = True
    try:
        status = run_command(work, "--debug" in sys.argv)
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    except BaseException:  # a bug, or --debug
        traceback.print_exc()
        status, together = 1, False
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError):
            stream.flush()
    if not together or status not in _TOGETHER:
        os._exit(status)
    sys.exit(status)


class _Noise(threading.Thread):
    """Passes on what libraries print, except that hosts connect; keeps what JAX prints as it aborts in `fatal`."""

    def __init__(self, reading: int):
        super().__init__(daemon=True)
        self.fatal, self._reading = "", reading
        self.start()

    def run(self) -> None:
        with os.fdopen(self._reading, errors="backslashreplace") as lines:
            for line in lines:
                if self.fatal or _ABORTS.search(line):
                    self.fatal += line
                elif not re.match(r"\[Gloo\] Rank \d+ is connected", line):
                    sys.stderr.write(line)
