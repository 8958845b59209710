"""The brush of a captured object's page: drags over the object paint a colour over its texture, linear premultiplied RGBA."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from mesoshell.geometry.mesh import Mesh
from mesoshell.io.image import picture_of, srgb_to_linear
from mesoshell.neutex.edit import checked_edit
from mesoshell.neutex.layout import Layout, directions, lookup, shape
from mesoshell.viewer.canvas import Canvas, Hit
from mesoshell.viewer.captured import SIDE, ObjectWorkshop, blank
from mesoshell.viewer.look import Painting
from mesoshell.viewer.strokes import Stroke, Strokes

TEXTURE = "texture"
#: Most lookups along a side of a texel of an image that is uploaded.
FINEST = 4


class TextureBrush(Strokes):
    """Paints an object on a server's page. changed: called when what is shown has changed."""

    def __init__(self, server: Any, work: ObjectWorkshop, changed: Callable[[], None]):
        self._work = work
        super().__init__(server, "/brush", (TEXTURE,), changed, partial(work.say, "brush"))
        gui = server.gui
        with gui.add_folder("Paint", order=-2):
            self._add_switch(gui, "drags on the object paint; beside it they turn the camera")
            self._colour = gui.add_rgb("colour", (200, 30, 30))
            self._cover = gui.add_slider("cover", 0.0, 1.0, 0.01, 1.0, hint="0 takes paint off")
            self._add_radius(gui)
            hint = f"PNG, JPEG or EXR over the texture, in any of its layouts; resampled to {SIDE} texels a side of a square"
            self.upload = gui.add_upload_button("Image", hint=hint)

    def put(self, data: bytes, name: str) -> None:
        """Paint the texture as an image file has it. Raises InputError, about `name`."""
        image = picture_of(data, name)
        self._replace(TEXTURE, Painting(as_cubemap(checked_edit(image, None, name), image)))

    def _name_now(self) -> str:
        return TEXTURE

    def _mesh_now(self) -> Mesh:
        return self._work.object.mesh

    def _made(self, of: Mesh) -> Canvas:
        return Canvas(of, shape=shape("cubemap", SIDE))

    def _shows_at_once(self, name: str) -> bool:
        return True

    def _dabbed(
        self, canvas: Canvas, image: np.ndarray, stroke: Stroke, hit: Hit, radius: float, way: np.ndarray | None
    ) -> np.ndarray | None:
        typed = np.clip(np.array(self._colour.value, np.float64), 0, 255)  # a picker takes larger numbers by keys
        cover = float(self._cover.value)
        return canvas.dab(image, hit, radius, [*(cover * srgb_to_linear(typed / 255)), cover])

    def _begun_image(self, canvas: Canvas, name: str) -> np.ndarray:
        return blank()


def as_cubemap(layout: Layout, image: Float[np.ndarray, "h w c"]) -> Float[np.ndarray, "_ _ 4"]:
    """An image of any layout, linear RGB or premultiplied RGBA, as a cubemap of RGBA, of means over its texels."""
    if image.shape[2] == 3:
        image = np.concatenate([image, np.ones_like(image[..., :1])], axis=2)
    fine = min(max(1, math.ceil((image.shape[0] * image.shape[1] / (6 * SIDE**2)) ** 0.5)), FINEST)
    u = directions("cubemap", SIDE * fine)
    looked = jax.vmap(lambda u: lookup(layout, jnp.asarray(image), u))(jnp.asarray(u.reshape(-1, 3)))
    height, width = shape("cubemap", SIDE)
    return np.asarray(looked).reshape(height, fine, width, fine, 4).mean(axis=(1, 3))
