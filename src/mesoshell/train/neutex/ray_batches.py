"""Rays of photographs, step by step, and which photographs are held out.

Notation
batch        rays a step: two thirds through the object's masks, one third beside them, from all views but the held-out ones
step         counted from 0; what step i sees depends on the seed, the capture and i alone, so that a run may resume
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mesoshell.errors import InputError
from mesoshell.neutex.cameras import rays_of
from mesoshell.neutex.capture import Capture, read_capture
from mesoshell.typing import Array, Float, Int

#: Views that the paper holds out; a capture with fewer views than these need holds out one in eight.
HELD = (6, 13, 30, 35)


class Rays(NamedTuple):
    """A batch, in the box's units. noise: seed of a row's random numbers; point: of the cloud; u: of the texture."""

    o: Float[Array, "B 3"]
    d: Float[Array, "B 3"]
    rgb: Float[Array, "B 3"]
    mask: Float[Array, "B"]
    noise: Int[Array, "B"]
    point: Float[Array, "B 3"]
    u: Float[Array, "B 3"]


def recorded_capture(data: dict[str, Any], side: int) -> Capture:
    """The capture that a run's record names."""
    return read_capture(Path(data["folder"]), data.get("background"), side)


def held_out(capture: Capture) -> tuple[list[int], list[int]]:
    """Views to learn from, and views to test with."""
    n = len(capture.photos)
    tested = list(HELD if n > max(HELD) else range(7, n, 8))
    return [i for i in range(n) if i not in tested], tested


def rays_for(batch: int, seed: int, capture: Capture, host: int = 0, hosts: int = 1) -> Callable[[int], Rays]:
    """This host's rays of step i. Raises InputError if hosts cannot share them evenly."""
    if batch % hosts:
        raise InputError("batch", f"{batch} rays do not come evenly from {hosts} hosts")
    learned, _ = held_out(capture)
    photos = [capture.photos[v] for v in learned]
    masks, rgb = (
        np.concatenate([x[v].reshape(-1, *x[v].shape[2:]) for v in learned]) for x in (capture.masks, capture.rgb)
    )
    inside, beside = np.flatnonzero(masks >= 0.5), np.flatnonzero(masks < 0.5)
    cloud = np.zeros((1, 3)) if capture.points is None else capture.to_box(capture.points)
    foreground = batch - (batch // 3 if len(beside) else 0)

    def at(step: int) -> Rays:
        random = np.random.default_rng([seed, step])
        pixel = np.concatenate([random.choice(inside, foreground), random.choice(beside, batch - foreground)])
        noise, u = random.integers(2**31 - 1, size=batch), random.normal(size=(batch, 3))
        point = cloud[random.integers(len(cloud), size=batch)]
        # hosts have equal numbers of both kinds of rays, to within one
        mine = slice(host, None, hosts)
        o, d = rays_of(photos, pixel[mine])
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        rgb_here, masks_here = rgb[pixel[mine]], masks[pixel[mine]]
        rows = capture.to_box(o), d, rgb_here, masks_here, noise[mine], point[mine], u[mine]
        return Rays(*(x.astype(np.int32 if x.dtype.kind == "i" else np.float32) for x in rows))  # type: ignore[arg-type]

    return at
