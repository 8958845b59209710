"""What eyes see: one thread paints their pictures; the newest wish counts. An eye's first picture is painted to its end,
whatever is wished for meanwhile, if that takes not too long: else nothing would be seen while a camera, or a slider, moves
faster than a picture takes.

Notation
view        what one eye sees: its camera, and a number that grows with each wish. A client has an eye, or several to compare
"""

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from mesoshell.errors import InputError
from mesoshell.render.camera import Camera

#: Seconds of rest before what takes long is begun: while a camera moves, there are only coarse pictures, and nothing has to be
#: abandoned.
PAUSE = 0.25
#: Seconds that a first picture may take although there is a newer wish: compiling, or a pass of paths, takes more.
PATIENCE = 0.5
PictureT = TypeVar("PictureT")


@dataclass
class View(Generic[PictureT]):
    """camera: of any size with its proportions; quality: None for the look's; wish: its number; painted: that of the picture
    under way; left: its steps; given: pictures of these so far; late: when the first should be there, as `time.monotonic` has
    it; shown: how many there were of this wish; picture: the last one; rest: until when nothing is begun."""

    camera: Camera
    quality: str | None = None
    wish: int = 1
    painted: int = 0
    left: Iterator[PictureT] | None = None
    given: int = 0
    late: float = 0.0
    shown: int = 0
    picture: PictureT | None = None
    rest: float = 0.0

    def ask(self) -> None:
        """Another picture is wished for."""
        self.wish, self.shown = self.wish + 1, 0
        self.rest = time.monotonic() + PAUSE if self.quality is not None else 0.0

    @property
    def waits(self) -> bool:
        """Whether there is more to paint."""
        return self.painted != self.wish or self.left is not None

    @property
    def urgent(self) -> bool:
        """Whether it waits for its coarse picture, or for the first one after it."""
        return self.quality is None and self.shown < 2 and self.waits

    @property
    def is_late(self) -> bool:
        """Whether nobody waits for what it paints: there is a newer wish, and this one's first picture was there, or takes
        long."""
        given = self.given > 0 or self.quality is not None or time.monotonic() > self.late
        return self.painted != self.wish and given


class Views(ABC, Generic[PictureT]):
    """Paints what eyes see. show: called with an eye whose picture has refined; say: with a line for all, empty when a fault is
    over. Callbacks come from threads of its own. Who inherits gives `_refined`, and begins by `_start`."""

    def __init__(
        self, show: Callable[[Any], None], say: Callable[[str], None], paint_lock: AbstractContextManager | None = None
    ):
        """paint_lock: what those that paint in turn share."""
        self._show, self._tell = show, say
        self._faults: dict[Hashable, str] = {}
        self._views: dict[Hashable, View[PictureT]] = {}
        self._changed, self._open, self._turn = threading.Condition(), True, 0
        self._paint_lock, self._telling = paint_lock or threading.Lock(), threading.Lock()
        self._threads: list[threading.Thread] = []

    @abstractmethod
    def _refined(self, view: View[PictureT], stopped: Callable[[], bool]) -> Iterator[PictureT]:
        """Ever better pictures of what a view shows now. Ends early once `stopped` says so."""

    def _start(self, *others: Callable[[], None]) -> None:
        """Begin to paint. others: what runs in threads beside it, until it is closed."""
        self._threads = [threading.Thread(target=run, daemon=True) for run in (self._paint, *others)]
        for thread in self._threads:
            thread.start()

    def see(self, eye: Hashable, camera: Camera, quality: str | None = None) -> None:
        """An eye looks from here. quality: of its pictures alone, which have no coarse one before; None: the look's."""
        with self._changed:
            view = self._views.setdefault(eye, View(camera, wish=0))
            view.camera, view.quality = camera, quality
            view.ask()
            self._changed.notify_all()

    def leave(self, eye: Hashable) -> None:
        """An eye is gone."""
        with self._changed:
            view = self._views.pop(eye, None)
            if view is not None:
                view.ask()
                view.late = 0.0
            self._changed.notify_all()
        for of in ("picture", "save"):
            self.say((of, eye), "")

    def knows(self, eye: Hashable) -> bool:
        """Whether an eye looks, and is painted for."""
        with self._changed:
            return self._open and eye in self._views

    def picture(self, eye: Hashable) -> tuple[PictureT | None, bool]:
        """The last picture of an eye, and whether it shows what is wished for now. If not, that is of a moment ago."""
        with self._changed:
            view = self._views.get(eye)
            return (None, False) if view is None else (view.picture, view.shown > 0)

    def close(self) -> None:
        """End all threads."""
        with self._changed:
            self._open = False
            self._changed.notify_all()
        for thread in self._threads:
            thread.join()

    def say(self, of: Hashable, line: str) -> None:
        """Say what is wrong with a thing; an empty line once nothing is."""
        with self._telling:
            if self._faults.get(of, "") != line:
                self._faults[of] = line
                self._tell("  \n".join(x for x in self._faults.values() if x))

    def _ask_all(self) -> None:
        """All views show something else now; the lock is held."""
        for view in self._views.values():
            view.ask()
        self._changed.notify_all()

    def _next(self) -> tuple[Hashable, View[PictureT]] | None:
        """The eye whose turn it is: those that wait for their first pictures first, then each in turn. Waits for one; None at
        the end."""
        with self._changed:
            while self._open:
                waiting = [(eye, v) for eye, v in self._views.items() if v.waits]
                waiting = [(eye, v) for eye, v in waiting if v.urgent] or waiting
                now = time.monotonic()
                ready = [(eye, v) for eye, v in waiting if v.rest <= now]
                if ready:
                    self._turn += 1
                    eye, view = ready[self._turn % len(ready)]
                    if view.painted != view.wish:
                        view.painted, view.given, view.late = view.wish, 0, time.monotonic() + PATIENCE
                        view.left = self._refined(view, lambda view=view: view.is_late or not self._open)
                    return eye, view
                self._changed.wait(min(v.rest for _, v in waiting) - now if waiting else None)
        return None

    def _paint(self) -> None:
        while (turn := self._next()) is not None:
            (eye, view), made = turn, False
            assert view.left is not None
            try:
                with self._paint_lock:
                    picture = next(view.left, None)
                made = True
                with self._changed:
                    if picture is None:
                        view.left = None
                        continue
                    if view.is_late:
                        continue
                    view.picture, view.given = picture, view.given + 1
                    if view.painted == view.wish:
                        if view.quality is None and view.shown == 0:
                            view.rest = time.monotonic() + PAUSE
                        view.shown += 1
                self.say(("picture", eye), "")
                self._show(eye)
            except (
                Exception
            ) as fault:  # the page goes on, and says it; what could not be sent, the next picture replaces
                view.left = view.left if made else None
                if self.knows(eye):
                    self.say(("picture", eye), fault_line(fault))


def fault_line(fault: Exception) -> str:
    """A fault as a page says it."""
    return str(fault) if isinstance(fault, InputError) else f"{type(fault).__name__}: {fault}"
