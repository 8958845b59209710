"""A request to stop, by signal, that long work heeds when it can."""

import signal
import threading
from types import FrameType
from typing import Any


def arrived() -> None:
    """An interrupt was heard: it is not raised again (cli/ending raises it until then), so that what follows can end."""
    if threading.current_thread() is threading.main_thread():
        signal.setitimer(signal.ITIMER_REAL, 0)


class StopRequest:
    """Whether SIGTERM or SIGINT has come since the context was entered. A second SIGINT is handled as before. again: the signal
    is raised again at the end. In a thread other than the main one it notices no signal."""

    def __init__(self, again: bool = False):
        self.requested, self.again = False, again
        self._before: dict[int, Any] = {}
        self._number = 0

    def __enter__(self) -> "StopRequest":
        if threading.current_thread() is threading.main_thread():
            numbers: list[int] = [signal.SIGTERM, signal.SIGINT]
            self._before = {number: signal.signal(number, self._heard) for number in numbers}
        return self

    def _heard(self, number: int, frame: FrameType | None) -> None:
        before = self._before[number]
        if number == signal.SIGINT and self.requested and callable(before):
            before(number, frame)
        self.requested, self._number = True, number

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)
        if self.again and self.requested and kind is None:
            signal.raise_signal(self._number)
