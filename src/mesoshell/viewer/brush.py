"""The brush of a viewer's page: drags over the mesh paint a parameter, or comb an angle along the stroke.

While the brush is on, the shell's top, invisible, catches drags that begin on it; others still turn the camera. A stroke
shows as it is drawn, or at its end where it grows another texture.
"""

import threading
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np

from mesoshell.geometry.mesh import Mesh
from mesoshell.io.bundle import Parameter
from mesoshell.io.image import exr_bytes
from mesoshell.render.camera import rays
from mesoshell.viewer.browser import camera_of
from mesoshell.viewer.canvas import Canvas, Hit, Painting
from mesoshell.viewer.work import Workshop

#: Brush's radius as a share of the mesh's size: least, usual, most; its dabs along a stroke, in radii; most dabs between two
#: places of the pointer.
RADII, SPACING, DABS = (0.01, 0.08, 0.3), 0.25, 32


class Brush:
    """Paints on a server's page. changed: called when what is shown has changed."""

    def __init__(self, server: Any, work: Workshop, changed: Callable[[], None]):
        self._server, self._work, self._changed = server, work, changed
        self._parameters: Mapping[str, Parameter] = {
            name: p for name, p in work.begun.material.parameters.items() if name in work.look.params
        }
        self._before: dict[str, list[Painting | None]] = {}
        self._now: dict[str, Painting] = {}
        self._shown: dict[str, Painting] = {}
        self._last: dict[int, tuple[np.ndarray, Hit | None]] = {}
        self._lock, self._node = threading.Lock(), None
        gui = server.gui
        with gui.add_folder("Paint", expand_by_default=False):
            names = tuple(self._parameters)
            self._on = gui.add_checkbox("brush", False, hint="drags on the mesh paint; beside it they turn the camera")
            self._name = gui.add_dropdown("parameter", names, initial_value=names[0])
            self._value = gui.add_slider("value", 0.0, 1.0, 0.005, 1.0, hint="that the brush paints")
            self._along = gui.add_checkbox("along the stroke", True, hint="comb: the angle is the stroke's direction")
            least, usual, most = RADII
            self._radius = gui.add_slider("radius", least, most, 0.005, usual, hint="share of the mesh's size")
            gui.add_button("Undo").on_click(self._undo)
            gui.add_button("Image").on_click(self._download)
        self._on.on_update(lambda _: self._switch())
        self._name.on_update(lambda _: self._choose())
        self._choose()

    @property
    def painted(self) -> dict[str, Painting]:
        """What is shown, by parameter."""
        return dict(self._shown)

    @cached_property
    def _canvas(self) -> Canvas:
        still = self._work.still
        assert isinstance(still.mesh, Mesh)
        return Canvas(still.mesh, still.thickness or 0.0)

    def _choose(self) -> None:
        """Another parameter: its range, and whether it is an angle."""
        p = self._parameters[self._name.value]
        low, high = p.range
        self._value.min, self._value.max, self._value.step = low, high, (high - low) / 200
        self._value.value = high
        self._along.visible = is_angle(p)

    def _switch(self) -> None:
        if self._node is None and self._on.value:
            canvas = self._canvas
            canvas.prepare()  # before a stroke waits for it
            self._node = self._server.scene.add_mesh_simple(
                "/brush", canvas.vertices, canvas.faces, opacity=0.0, side="double"
            )
            self._node.on_drag("left")(self._dragged)
        if self._node is not None:
            self._node.visible = self._on.value

    async def _dragged(self, event: Any) -> None:
        """A pointer that draws; in order, since it is awaited."""
        camera = camera_of(event.client.camera)
        if camera is None:
            return
        place = np.array([event.end_screen_pos[0] * camera.width, event.end_screen_pos[1] * camera.height])
        if event.phase == "start":
            begin = np.array([event.start_screen_pos[0] * camera.width, event.start_screen_pos[1] * camera.height])
            self.begin(event.client_id, self._name.value)
            self.draw(event.client_id, camera, begin)
        self.draw(event.client_id, camera, place)
        if event.phase == "end":
            self._last.pop(event.client_id, None)
            self._show()
        elif self._parameters[self._name.value].role == "alpha":
            self._show()

    def begin(self, client: int, name: str) -> None:
        """A stroke, which `_undo` takes back."""
        with self._lock:
            self._before.setdefault(name, []).append(self._now.get(name))
            self._last.pop(client, None)

    def draw(self, client: int, camera: Any, place: np.ndarray) -> None:
        """Dabs from where the pointer was to where it is, in pixels."""
        name = self._name.value
        parameter, canvas, radius = self._parameters[name], self._canvas, self._radius.value * self._canvas.size
        with self._lock:
            image = self._image(name)
            before, last = self._last.get(client, (place, None))
            steps = 1 if last is None else min(DABS, 1 + int(np.linalg.norm(place - before)))
            for share in np.arange(1, steps + 1) / steps:
                at = before + share * (place - before)
                hit = canvas.hit(*(x[0] for x in rays(camera, at[None])))
                if hit is None:
                    last = None
                    continue
                way = None if last is None else hit.point - last.point
                if way is not None and np.linalg.norm(way) < SPACING * radius and share < 1:
                    continue
                if is_angle(parameter) and self._along.value:
                    if way is not None and np.linalg.norm(way) > 0:
                        image = canvas.comb(image, hit, radius, way)
                else:
                    low, high = parameter.range
                    image = canvas.dab(image, hit, radius, (self._value.value - low) / (high - low))
                last = hit
            self._now[name] = Painting(image)
            self._last[client] = place, last

    def _image(self, name: str) -> np.ndarray:
        """What is painted so far; at first, the parameter's number everywhere."""
        if name in self._now:
            return self._now[name].image
        low, high = self._parameters[name].range
        share = np.clip((self._work.look.params[name] - low) / (high - low), 0, 1)
        return np.full((self._canvas.side,) * 2, share, np.float32)

    def _show(self) -> None:
        with self._lock:
            self._shown = dict(self._now)
        self._changed()

    def _undo(self, _: Any) -> None:
        """Take back the last stroke of the parameter; before the first, it is a number again."""
        name = self._name.value
        with self._lock:
            if not self._before.get(name):
                return
            before = self._before[name].pop()
            if before is None:
                self._now.pop(name, None)
            else:
                self._now[name] = before
        self._show()

    def _download(self, event: Any) -> None:
        """The image of the parameter, as `--param NAME=NAME.exr` takes it."""
        name = self._name.value
        if name in self._now and event.client is not None:
            data = exr_bytes(np.repeat(self._now[name].image[..., None], 3, axis=2), half=False)
            event.client.send_file_download(f"{name}.exr", data, save_immediately=True)


def is_angle(parameter: Parameter) -> bool:
    """Whether it goes round: an angle in the surface, from u toward v."""
    low, high = parameter.range
    return parameter.unit == "rad" and abs(high - low - 2 * np.pi) < 1e-6
