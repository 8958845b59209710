"""One thread paints what eyes see: the newest wish counts, but an eye's first picture is painted to its end."""

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import mesoshell as ms
from mesoshell.viewer import views
from mesoshell.viewer.views import View, Views

CAMERAS = [ms.Camera(ms.look_at((1.0, 2.0, 9.0 + k), (0.0, 0.0, 0.0)), 0.6, 20, 16) for k in range(4)]
STEPS = 3


class Painter(Views[tuple[int, int]]):
    """Pictures are numbers of a camera and a step. moves: which camera is wished for while a step of a picture is under way, by
    that picture's camera and the step."""

    def __init__(self, moves: dict[tuple[int, int], int], quality: str | None = None):
        self.moves, self.quality, self.seen = moves, quality, []
        self.done = threading.Event()
        super().__init__(self._shown, lambda line: None)
        self._start()

    def _refined(self, view: View, stopped: Callable[[], bool]) -> Iterator[tuple[int, int]]:
        number = next(k for k, camera in enumerate(CAMERAS) if camera is view.camera)
        for step in range(STEPS):
            if (number, step) in self.moves:
                self.see(1, CAMERAS[self.moves[number, step]], self.quality)
            if stopped():
                return
            yield number, step

    def _shown(self, eye: Any) -> None:
        picture, current = self.picture(eye)
        self.seen.append((picture, current))
        if current and picture is not None and picture[1] == STEPS - 1:
            self.done.set()


def painted(moves: dict[tuple[int, int], int], quality: str | None = None) -> list[Any]:
    painter = Painter(moves, quality)
    try:
        painter.see(1, CAMERAS[0], quality)
        assert painter.done.wait(30)
    finally:
        painter.close()
    return painter.seen


def test_a_picture_refines():
    assert painted({}) == [((0, step), True) for step in range(STEPS)]


def test_what_cannot_be_sent_is_said_and_the_next_picture_comes(monkeypatch: pytest.MonkeyPatch):
    lines: list[str] = []
    monkeypatch.setattr(Painter, "say", lambda self, of, line: lines.append(line))
    shown = Painter._shown

    def lost(self: Painter, eye: Any) -> None:
        shown(self, eye)
        if len(self.seen) == 1:
            raise RuntimeError("lost")

    monkeypatch.setattr(Painter, "_shown", lost)
    assert painted({}) == [((0, step), True) for step in range(STEPS)]
    assert lines[:3] == ["", "RuntimeError: lost", ""]


def test_while_a_camera_moves_there_are_first_pictures():
    """They are shown as what was wished for a moment ago."""
    wished = {(0, 0): 1, (1, 0): 2, (2, 0): 3}
    assert painted(wished) == [((k, 0), False) for k in range(3)] + [((3, step), True) for step in range(STEPS)]


def test_what_comes_after_a_first_picture_is_abandoned():
    assert painted({(0, 1): 1}) == [((0, 0), True), *(((1, step), True) for step in range(STEPS))]


def test_a_first_picture_that_takes_long_is_abandoned(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(views, "PATIENCE", -1.0)
    assert painted({(0, 0): 1}) == [((1, step), True) for step in range(STEPS)]


def test_pictures_of_a_quality_of_their_own_are_abandoned():
    """They have no coarse one before, and take long."""
    assert painted({(0, 0): 1, (1, 0): 2}, "reference") == [((2, step), True) for step in range(STEPS)]
