"""The brush of a viewer's page: drags over the mesh paint a parameter, or how high it grows, or comb an angle along the stroke.

While the brush is on, the shell's top, invisible, catches drags that begin on it; others still turn the camera. A stroke
shows about once a second as it is drawn, or at its end where it grows another texture. All clients share the images, and
what is undone.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, MutableSequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from mesoshell.geometry.mesh import Mesh
from mesoshell.io.bundle import Parameter
from mesoshell.io.image import exr_bytes
from mesoshell.render.camera import Camera, rays
from mesoshell.scene.scene import Grown, Scene
from mesoshell.viewer.browser import camera_of
from mesoshell.viewer.canvas import Canvas, Hit
from mesoshell.viewer.look import GROWTH, Painting, PartLook, image_of, parts_of
from mesoshell.viewer.work import Workshop

#: Brush's radius as a share of the mesh's size: least, usual, most.
RADII = (0.01, 0.08, 0.3)
#: Radii between dabs of a stroke; most dabs between two places of the pointer; radii of a step that begins elsewhere.
SPACING, DABS, JUMP = 0.25, 8, 4.0
#: Seconds between pictures of a stroke: fewer, and none would be done before the next; strokes that can be undone.
SHOWN, UNDONE = 1.0, 50

#: How high the material grows, painted like a parameter of geometry.
HEIGHT = Parameter(GROWTH, "beta", (0.0, 1.0), 1.0, "1", "share of the thickness; nothing grows at 0")

#: What a parameter was painted with before, or after; None where it was a number.
Row = MutableSequence[Painting | None]


@dataclass
class Stroke:
    """A stroke under way. name: of its parameter; place: of the pointer, pixels; last: where its last dab was; drawn: if it has
    one; shown: when it was shown."""

    name: str
    place: np.ndarray
    last: Hit | None = None
    drawn: bool = False
    shown: float = 0.0


class Brush:
    """Paints a material on a server's page. part: 0 is the scene's own, 1 and on are its further ones; title: of its folder;
    changed: called when what is shown has changed."""

    def __init__(self, server: Any, work: Workshop, changed: Callable[[], None], part: int = 0, title: str = "Paint"):
        self._server, self._work, self._changed, self._index = server, work, changed, part
        self._parameters: Mapping[str, Parameter] = {
            name: p for name, p in self._begun.material.parameters.items() if name in self._look.params
        } | {GROWTH: HEIGHT}
        self._before: dict[str, Row] = {name: deque(maxlen=UNDONE) for name in self._parameters}
        self._after: dict[str, Row] = {name: [] for name in self._parameters}
        self._now: dict[str, Painting] = {}
        self._shown: dict[str, Painting] = {}
        self._strokes: dict[int, Stroke] = {}
        self._canvas: Canvas | None = None
        self._lift: float | None = None
        self._node: Any = None
        self._lock, self._switching = threading.Lock(), threading.Lock()
        gui = server.gui
        with gui.add_folder(title, expand_by_default=False):
            names = tuple(self._parameters)
            self._on = gui.add_checkbox("brush", False, hint="drags on the mesh paint; beside it they turn the camera")
            self._name = gui.add_dropdown("parameter", names, initial_value=names[0])
            self._value = gui.add_slider("value", 0.0, 1.0, 0.005, 1.0, hint="that the brush paints")
            self._along = gui.add_checkbox("along the stroke", True, hint="comb: the angle is the stroke's direction")
            least, usual, most = RADII
            self._radius = gui.add_slider("radius", least, most, 0.005, usual, hint="share of the mesh's size")
            gui.add_button("Undo").on_click(self._undo)
            gui.add_button("Redo").on_click(self._redo)
            gui.add_button("Image").on_click(self._download)
        self._on.on_update(self._switch)
        self._name.on_update(lambda _: self._choose())
        self._choose()

    @property
    def _look(self) -> PartLook:
        return self._work.look.parts[self._index]

    @property
    def _begun(self) -> Scene | Grown:
        return parts_of(self._work.begun)[self._index]

    @property
    def painted(self) -> dict[str, Painting]:
        """What is shown, by parameter."""
        return dict(self._shown)

    def _choose(self) -> None:
        """Another parameter: its range, and whether it is an angle."""
        p = self._parameters[self._name.value]
        low, high = p.range
        self._value.min, self._value.max, self._value.step = low, high, (high - low) / 200
        self._value.value = low if p is HEIGHT else high
        self._along.visible = is_angle(p)

    def _switch(self, _: Any) -> None:
        """On or off, with the shell's top as thick as it is now."""
        with self._switching:
            if self._on.value and (self._node is None or self._lift != self._look.thickness):
                self.prepare()
                assert self._canvas is not None
                if self._node is not None:
                    self._node.remove()
                top = self._canvas.vertices, self._canvas.faces
                self._node = self._server.scene.add_mesh_simple(
                    f"/brush{self._index}", *top, opacity=0.0, side="double"
                )
                self._node.on_drag("left")(self._dragged)
            if self._node is not None:
                self._node.visible = self._on.value

    def prepare(self) -> None:
        """Make the mesh ready to paint on."""
        mesh, self._lift = parts_of(self._work.still)[self._index].mesh, self._look.thickness
        assert isinstance(mesh, Mesh)
        canvas = Canvas(mesh, self._lift or 0.0)
        canvas.prepare()
        self._canvas = canvas

    async def _dragged(self, event: Any) -> None:
        """A pointer that draws; in order, since it is awaited."""
        camera = camera_of(event.client.camera)
        if camera is None:
            return
        size = np.array([camera.width, camera.height])
        if event.phase == "start":
            self.begin(event.client_id, camera, np.array(event.start_screen_pos) * size)
        self.draw(event.client_id, camera, np.array(event.end_screen_pos) * size)
        if event.phase == "end":
            self.end(event.client_id)

    def begin(self, client: int, camera: Camera, place: np.ndarray) -> None:
        """A stroke, which `_undo` takes back. place: of the pointer, in pixels."""
        with self._lock:
            self._strokes[client] = Stroke(self._name.value, place)
        self.draw(client, camera, place)

    def draw(self, client: int, camera: Camera, place: np.ndarray) -> None:
        """Dabs from where the pointer was to where it is."""
        stroke, canvas = self._strokes.get(client), self._canvas
        if stroke is None or canvas is None:
            return
        with self._lock:
            before, begin = self._now.get(stroke.name), stroke.place
            image, dabs = self._image(canvas, stroke.name), 0
            steps = 1 if stroke.last is None else min(DABS, 1 + int(np.linalg.norm(place - begin)))
            for share in np.arange(1, steps + 1) / steps:
                o, d = rays(camera, (begin + share * (place - begin))[None])
                hit = canvas.hit(o[0], d[0])
                new = None if hit is None else self._dab(canvas, image, stroke, hit)
                if hit is None:
                    stroke.last = None
                elif new is not None:
                    image, dabs = new, dabs + 1
            stroke.place = place
            if dabs:
                if not stroke.drawn:
                    self._before[stroke.name].append(before)
                    self._after[stroke.name].clear()
                stroke.drawn = True
                self._now[stroke.name] = Painting(image)
        now = time.perf_counter()
        if dabs and self._parameters[stroke.name].role == "alpha" and now - stroke.shown > SHOWN:
            stroke.shown = now
            self._show()

    def end(self, client: int) -> None:
        """Show the whole stroke."""
        stroke = self._strokes.pop(client, None)
        if stroke is not None and stroke.drawn:
            self._show()

    def _dab(self, canvas: Canvas, image: np.ndarray, stroke: Stroke, hit: Hit) -> np.ndarray | None:
        """The image with a dab; None where the stroke has not come far enough for one."""
        parameter, radius = self._parameters[stroke.name], self._radius.value * canvas.size
        way = np.zeros(3) if stroke.last is None else hit.point - stroke.last.point
        far = float(np.linalg.norm(way))
        if stroke.last is not None and far < SPACING * radius:
            return None
        begins = stroke.last is None or far > JUMP * radius
        stroke.last = hit
        if is_angle(parameter) and self._along.value:
            return None if begins else canvas.comb(image, hit, radius, way)
        low, high = parameter.range
        return canvas.dab(image, hit, radius, (self._value.value - low) / (high - low))

    def _image(self, canvas: Canvas, name: str) -> np.ndarray:
        """What is painted so far; at first, the parameter's number everywhere."""
        if name in self._now:
            return self._now[name].image
        if name == GROWTH:
            return grown_so_far(self._begun.growth, canvas.side)
        low, high = self._parameters[name].range
        share = np.clip((self._look.params[name] - low) / (high - low), 0, 1)
        return np.full((canvas.side,) * 2, share, np.float32)

    def _show(self) -> None:
        with self._lock:
            self._shown = dict(self._now)
        self._changed()

    def _undo(self, _: Any) -> None:
        """Take back the last stroke of the parameter; before the first, it is a number again."""
        self._go(self._name.value, self._before, self._after)

    def _redo(self, _: Any) -> None:
        """Draw the stroke of the parameter that was taken back last, if none was drawn since."""
        self._go(self._name.value, self._after, self._before)

    def _go(self, name: str, to: Mapping[str, Row], back: Mapping[str, Row]) -> None:
        """To the last of one row of a parameter's paintings, with what is now at the end of the other."""
        with self._lock:
            if not to[name]:
                return
            for stroke in self._strokes.values():  # what is drawn on is another stroke
                stroke.drawn = stroke.drawn and stroke.name != name
            back[name].append(self._now.get(name))
            painting = to[name].pop()
            if painting is None:
                self._now.pop(name, None)
            else:
                self._now[name] = painting
        self._show()

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
