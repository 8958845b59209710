"""Frames by several processes of this machine, each with cores of its own.

A process is told a shot, then tasks, and answers each with the frame or with what went wrong, all of it pickled, through its
standard input and output. It ends when its input does. A thread a process waits for its answers.
"""

import os
import pickle
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Generator, Iterator
from contextlib import suppress
from typing import Any

from mesoshell.errors import Argument, InputError
from mesoshell.film.frame import Crew, Made, Shot, Task, make_frame
from mesoshell.interrupt import arrived
from mesoshell.kept import constant
from mesoshell.scene.picture import Progress

#: What a process runs: its cores, before what counts them is imported.
PROGRAM = "import os; {cores} and os.sched_setaffinity(0, {cores}); from mesoshell.film.processes import serve; serve()"


def in_processes(count: int) -> Crew:
    """Frames by so many processes."""

    def crew(shot: Shot, tasks: Iterator[Task], frames: int, show: Progress) -> Generator[Made, None, None]:
        if not frames:
            return
        events: queue.SimpleQueue[Made | BaseException | None] = queue.SimpleQueue()
        turn = threading.Lock()
        told = pickle.dumps(shot)
        workers: list[_Worker] = []
        threads: list[threading.Thread] = []

        def work(worker: _Worker) -> None:
            try:
                worker.tell(told)
                while True:
                    with turn:
                        task = next(tasks, None)
                    if task is None:
                        break
                    events.put(worker.frame(task))
                events.put(None)
            except BaseException as fault:  # whoever iterates must see it
                events.put(fault)

        try:
            for cores in _cores(min(count, frames)):
                workers.append(_Worker(cores))
                thread = threading.Thread(target=work, args=(workers[-1],), daemon=True)
                thread.start()
                threads.append(thread)
            running = len(workers)
            while running:
                event = events.get()
                if isinstance(event, BaseException):
                    raise event
                if event is None:
                    running -= 1
                else:
                    yield event
        except BaseException:
            arrived()
            raise
        finally:
            for worker in workers:
                worker.end()
            for thread in threads:
                thread.join()

    return crew


class _Worker:
    """A process. cores: that it may use, None for all."""

    def __init__(self, cores: set[int] | None):
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 (`end` closes it)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", PROGRAM.format(cores=cores)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            start_new_session=True,  # an interrupt is this process's alone
            env={**os.environ, "XLA_PYTHON_CLIENT_PREALLOCATE": "false"},  # several may share a GPU
        )

    def tell(self, data: bytes) -> None:
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # it has ended: its answer says so
            self._process.stdin.write(data)
            self._process.stdin.flush()

    def frame(self, task: Task) -> Made:
        """A frame that it makes. Raises what it raised, and InputError if it ended."""
        assert self._process.stdout is not None
        self.tell(pickle.dumps(task))
        try:
            answer = pickle.load(self._process.stdout)
        except (EOFError, pickle.UnpicklingError):
            raise InputError(Argument("workers"), f"one ended at frame {task.k}: {self._last_words()}") from None
        if isinstance(answer, BaseException):
            raise answer
        return answer

    def end(self) -> None:
        if self._process.poll() is None:
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)  # with what it has begun itself
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout, self._errors):
            with suppress(BrokenPipeError):
                pipe.close()  # type: ignore[union-attr]

    def _last_words(self) -> str:
        code = self._process.wait()
        if code < 0:
            return f"{signal.Signals(-code).name}; fewer of them take less memory"
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"exit status {code}"


def _cores(count: int) -> list[set[int] | None]:
    """Each process's share of the cores: libraries have a thread a core, and more threads than cores hinder each other."""
    if not hasattr(os, "sched_getaffinity"):
        return [None] * count
    cores = sorted(os.sched_getaffinity(0))
    return [set(cores[k::count]) or {cores[k % len(cores)]} for k in range(count)]


def serve() -> None:
    """What a process does."""
    answers, requests = os.fdopen(os.dup(1), "wb"), sys.stdin.buffer
    os.dup2(2, 1)  # what libraries print is no answer
    shot = constant(pickle.load(requests))
    while True:
        try:
            task = pickle.load(requests)
        except EOFError:
            return
        try:
            answer: Any = make_frame(shot, task)
        except Exception as fault:
            answer = _told(fault)
        pickle.dump(answer, answers)
        answers.flush()


def _told(fault: Exception) -> Exception:
    """A fault as its maker hears of it: one that a user can mend, or a defect with its type in its text."""
    if isinstance(fault, MemoryError):
        return MemoryError(str(fault))
    return fault if isinstance(fault, InputError | OSError) else RuntimeError(f"{type(fault).__name__}: {fault}")
