"""The camera of a browser, as ours; and texts that it shows as they are."""

import html
from typing import Any

import numpy as np

from mesoshell.render.camera import Camera


def camera_of(client: Any) -> Camera | None:
    """A client's camera; None before its window has a size."""
    width, height = int(client.image_width), int(client.image_height)
    w, x, y, z = (float(n) for n in client.wxyz)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    if width < 1 or height < 1 or not 0 < client.fov < np.pi or not np.isfinite(rotation).all():
        return None
    to_world = np.eye(4)
    to_world[:3, :3] = rotation * [1, -1, -1]  # from a camera that looks along +z, y down
    to_world[:3, 3] = client.position
    return Camera(to_world, float(client.fov), width, height)


def reach(size: float) -> tuple[float, float]:
    """The nearest and the farthest that a browser draws of a scene of about this size, world."""
    return 1e-3 * size, 1e4 * size


def set_text(markdown: Any, text: str) -> None:
    """Show a text in a control for Markdown, if it is another one: names in it may come from a file, and are no HTML."""
    plain = html.escape(text, quote=False)
    if markdown.content != plain:
        markdown.content = plain
