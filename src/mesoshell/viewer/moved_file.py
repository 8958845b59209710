"""Pictures of a scene of Mitsuba's XML that refine, from wherever an eye looks."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from mesoshell.render.camera import Camera
from mesoshell.render.quality import PRESETS
from mesoshell.scene.render_paths import MovedFile
from mesoshell.viewer.look import with_size
from mesoshell.viewer.refine import COARSE, Abandoned
from mesoshell.viewer.views import View, Views

#: Most paths a pixel.
MOST = 1024


@dataclass(frozen=True)
class FileLook:
    """What is set. quality: a preset's name; side: pixels of the longer side."""

    quality: str = "normal"
    side: int = 256


class FilePicture(NamedTuple):
    """A picture on its way. rgba: linear, premultiplied; paths: of each pixel; seconds: of the last pass."""

    rgba: Float[np.ndarray, "H W 4"]
    paths: int
    seconds: float


class FileWorkshop(Views[FilePicture]):
    """Paints what eyes see of a scene of Mitsuba's, one picture after the other: they share its sensor."""

    def __init__(self, file: MovedFile, show: Callable[[Any], None], say: Callable[[str], None]):
        super().__init__(show, say)
        self.look, self.file = FileLook(), file
        self._start()

    def set(self, look: FileLook) -> None:
        """Show another look to all."""
        with self._changed:
            if look != self.look:
                self.look = look
                self._ask_all()

    def _refined(self, view: View[FilePicture], stopped: Callable[[], bool]) -> Iterator[FilePicture]:
        return refine_file(self.file, self.look, view.camera, stopped)


def refine_file(
    file: MovedFile, look: FileLook, camera: Camera, stopped: Callable[[], bool], most: int = MOST
) -> Iterator[FilePicture]:
    """Ever better pictures, up to `most` paths a pixel; first one of few pixels. Ends early once `stopped` says so."""

    def check(share: float) -> None:
        if stopped():
            raise Abandoned

    stages = [(look.side, look.quality, most)]
    if look.side > COARSE:
        stages.insert(0, (COARSE, "draft", 1))
    try:
        for side, quality, count in stages:
            begin = time.perf_counter()
            passes = file.passes(with_size(camera, side), PRESETS[quality])
            pixels = np.arange(passes.shape[0] * passes.shape[1])
            total = np.zeros((len(pixels), 4))
            for k in range(count):
                check(0.0)
                total += passes.render(k, pixels, check)
                now = time.perf_counter()
                yield FilePicture((total / (k + 1)).reshape(*passes.shape, 4), k + 1, now - begin)
                begin = time.perf_counter()
    except Abandoned:
        return
