"""A picture as tiles of rays on several threads, with a report of times and counts.

Notation
k           number of a sample in its pixel, the same for all pixels
R           rays of a tile
"""

import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from mesoshell.render.camera import Camera, pixel_grid, rays

#: (origins, directions, k, random numbers of the tile) -> RGBA, premultiplied: (R, 3), (R, 3) -> (R, 4).
Tile = Callable[[np.ndarray, np.ndarray, int, np.random.Generator], np.ndarray]


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
    camera: Camera, samples: int, size: int, tile: Tile, progress: Callable[[float], None]
) -> Float[np.ndarray, "H W 4"]:
    """Means over `samples` rays a pixel. size: most rays a tile; progress: called with the share done, 0 to 1.

    The picture does not depend on the number of threads: each tile draws its random numbers from its own seed."""
    pixels = camera.height * camera.width
    work = [(k, i) for k in range(samples) for i in range(0, pixels, size)]
    image = np.zeros((pixels, 4))

    def one(item: tuple[int, int]) -> tuple[int, np.ndarray]:
        k, first = item
        o, d = rays(camera, pixel_grid(camera, samples, k, slice(first, first + size)))
        return first, tile(np.ascontiguousarray(o), d, k, np.random.default_rng(item))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for done, (first, rgba) in enumerate(pool.map(one, work), start=1):
            image[first : first + len(rgba)] += rgba
            progress(done / len(work))
    return (image / samples).reshape(camera.height, camera.width, 4)
