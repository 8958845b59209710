"""The brush of a viewer's page: drags over the mesh paint a parameter, or how high it grows, or comb an angle along the stroke.

What catches drags is the shell's top. A stroke shows about once a second as it is drawn, or at its end where it grows another
texture.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float

from mesoshell.geometry.mesh import Mesh
from mesoshell.io.bundle import Parameter
from mesoshell.io.image import exr_bytes
from mesoshell.scene.scene import Grown, Scene
from mesoshell.viewer.canvas import Canvas, Hit
from mesoshell.viewer.look import GROWTH, PartLook, image_of, parts_of
from mesoshell.viewer.strokes import Stroke, Strokes
from mesoshell.viewer.work import Workshop

#: How high the material grows, painted like a parameter of geometry.
HEIGHT = Parameter(GROWTH, "beta", (0.0, 1.0), 1.0, "1", "share of the thickness; nothing grows at 0")


class Brush(Strokes):
    """Paints a material on a server's page. part: 0 is the scene's own, 1 and on are its further ones; title: of its folder;
    changed: called when what is shown has changed."""

    def __init__(self, server: Any, work: Workshop, changed: Callable[[], None], part: int = 0, title: str = "Paint"):
        self._work, self._index = work, part
        self._parameters: Mapping[str, Parameter] = {
            name: p for name, p in self._begun.material.parameters.items() if name in self._look.params
        } | {GROWTH: HEIGHT}
        super().__init__(server, f"/brush{part}", self._parameters, changed, partial(work.say, f"brush{part}"))
        gui = server.gui
        with gui.add_folder(title, expand_by_default=False):
            names = tuple(self._parameters)
            self._add_switch(gui, "drags on the mesh paint; beside it they turn the camera")
            self._name = gui.add_dropdown("parameter", names, initial_value=names[0])
            self._value = gui.add_slider("value", 0.0, 1.0, 0.005, 1.0, hint="that the brush paints")
            self._along = gui.add_checkbox("along the stroke", True, hint="comb: the angle is the stroke's direction")
            self._add_radius(gui)
            gui.add_button("Image").on_click(self._download)
        self._name.on_update(lambda _: self._choose())
        self._choose()

    @property
    def _look(self) -> PartLook:
        return self._work.look.parts[self._index]

    @property
    def _begun(self) -> Scene | Grown:
        return parts_of(self._work.begun)[self._index]

    def _choose(self) -> None:
        """Another parameter: its range, and whether it is an angle."""
        p = self._parameters[self._name.value]
        low, high = p.range
        self._value.min, self._value.max, self._value.step = low, high, (high - low) / 200
        self._value.value = low if p is HEIGHT else high
        self._along.visible = is_angle(p)

    def _name_now(self) -> str:
        return self._name.value

    def _mesh_now(self) -> tuple[Mesh, float]:
        """The mesh, and how thick the shell on it is now."""
        mesh = parts_of(self._work.still)[self._index].mesh
        assert isinstance(mesh, Mesh)
        return mesh, self._look.thickness or 0.0

    def _made(self, of: tuple[Mesh, float]) -> Canvas:
        return Canvas(*of)

    def _shows_at_once(self, name: str) -> bool:
        return self._parameters[name].role == "alpha"

    def _dabbed(
        self, canvas: Canvas, image: np.ndarray, stroke: Stroke, hit: Hit, radius: float, way: np.ndarray | None
    ) -> np.ndarray | None:
        parameter = self._parameters[stroke.name]
        if is_angle(parameter) and self._along.value:
            return None if way is None else canvas.comb(image, hit, radius, way)
        low, high = parameter.range
        return np.clip(canvas.dab(image, hit, radius, (self._value.value - low) / (high - low)), 0, 1)

    def _begun_image(self, canvas: Canvas, name: str) -> np.ndarray:
        """The parameter's number everywhere."""
        if name == GROWTH:
            return grown_so_far(self._begun.growth, canvas.shape[0])
        low, high = self._parameters[name].range
        share = np.clip((self._look.params[name] - low) / (high - low), 0, 1)
        return np.full(canvas.shape, share, np.float32)

    def _download(self, event: Any) -> None:
        """The image of the parameter, as `--param NAME=NAME.exr` takes it."""
        name = self._name.value
        if name in self._now and event.client is not None:
            data = exr_bytes(np.repeat(self._now[name].image[..., None], 3, axis=2), half=False)
            event.client.send_file_download(image_of(self._begun, name), data, save_immediately=True)


def grown_so_far(image: Any, side: int) -> Float[np.ndarray, "N N"]:
    """A scene's image of growth at the canvas's size: its nearest pixels; white without one."""
    if image is None:
        return np.ones((side, side), np.float32)
    row, column = ((np.arange(side) + 0.5) / side * n for n in image.shape)
    return image[np.ix_(row.astype(int), column.astype(int))].astype(np.float32)


def is_angle(parameter: Parameter) -> bool:
    """Whether it goes round: an angle in the surface, from u toward v."""
    low, high = parameter.range
    return parameter.unit == "rad" and abs(high - low - 2 * np.pi) < 1e-6
