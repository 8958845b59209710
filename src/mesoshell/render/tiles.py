"""A picture as tiles of rays on several threads, with a report of times and counts.

Notation
k           number of a sample in its pixel, the same for all pixels
n           its steps along the sequences of its pixel (render/sequence)
R           rays of a tile
P           pixels of a pass
"""

import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from mesoshell.render.camera import Camera, centred, in_pixel, outward, rays
from mesoshell.render.sequence import GOLDEN, Draws, draws_at

#: (origins, directions, shift, what numbers are drawn from, check) -> RGBA, premultiplied: (R, 3), (R, 3) -> (R, 4). shift: of
#: samples along their rays, in [0, 1); it differs between the rays of a pixel. check: called now and then; raises to end it.
TileRenderer = Callable[[np.ndarray, np.ndarray, float, Draws, Callable[[], None]], np.ndarray]


@dataclass
class RenderReport:
    """Seconds by stage and counts of a render; notes: what the user should know. A stage's seconds are summed over threads, so
    only `wall` compares with a clock."""

    seconds: dict[str, float] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    lock: threading.Lock = field(default_factory=threading.Lock)

    def time(self, stage: str, since: float, **counts: int) -> float:
        """Add the seconds since `since`, and counts, to a stage; return the time now."""
        now = time.perf_counter()
        with self.lock:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + now - since
        self.count(**counts)
        return now

    def count(self, **more: int) -> None:
        with self.lock:
            for name, value in more.items():
                self.counts[name] = self.counts.get(name, 0) + int(value)


def render_tiles(
    camera: Camera, samples: int, size: int, tile: TileRenderer, progress: Callable[[float], None]
) -> Float[np.ndarray, "H W 4"]:
    """Means over `samples` rays a pixel. size: most rays a tile; progress: called with the share done, 0 to 1.

    The picture depends neither on the number of threads nor on the tiles: what a ray draws is its pixel's."""
    pixels = np.arange(camera.height * camera.width)
    image = np.zeros((len(pixels), 4))
    each = [_Ray(centred(samples, k), (k + 0.5) / samples) for k in range(samples)]
    for part, rgba, share in _tiles(camera, each, pixels, size, tile, lambda: None):
        image[part] += rgba
        progress(share)
    return (image / samples).reshape(camera.height, camera.width, 4)


def render_pass(
    camera: Camera,
    k: int,
    pixels: Int[np.ndarray, "P"],
    size: int,
    tile: TileRenderer,
    progress: Callable[[float], None],
) -> Float[np.ndarray, "P 4"]:
    """Ray k of these pixels, numbered row by row, of a sequence that may end anywhere. Otherwise as `render_tiles`. progress:
    also called within tiles, from their threads; what it raises ends the pass."""
    rgba, n, done = np.zeros((len(pixels), 4)), outward(k), [0.0]
    each = [_Ray(n, (0.5 + n * GOLDEN) % 1)]
    for part, some, share in _tiles(camera, each, pixels, size, tile, lambda: progress(done[0])):
        rgba[part], done[0] = some, share
        progress(share)
    return rgba


def threads(pixels: int, size: int) -> int:
    """Threads that a pass of so many pixels keeps busy. size: most rays a tile."""
    return min(os.cpu_count() or 1, -(-pixels // size))


class _Ray(NamedTuple):
    """A ray of every pixel: n, and the shift of samples along it."""

    n: float
    shift: float


def _tiles(
    camera: Camera,
    each: Sequence[_Ray],
    pixels: np.ndarray,
    size: int,
    tile: TileRenderer,
    check: Callable[[], None],
) -> Iterator[tuple[slice, np.ndarray, float]]:
    """Tiles in order, as they are done: which of the pixels, their RGBA, and the share done."""
    work = [(ray, first) for ray in each for first in range(0, len(pixels), size)]
    y, x = np.divmod(pixels, camera.width)
    corners = np.stack([x, y], axis=1)

    def one(item: tuple[_Ray, int]) -> tuple[slice, np.ndarray]:
        check()
        ray, first = item
        part = slice(first, first + size)
        o, d = rays(camera, corners[part] + in_pixel(ray.n))
        return part, tile(np.ascontiguousarray(o), d, ray.shift, draws_at(corners[part], ray.n), check)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            for done, (part, rgba) in enumerate(pool.map(one, work), start=1):
                yield part, rgba, done / len(work)
        finally:
            pool.shutdown(cancel_futures=True)  # where it ends early
