"""Strokes of a brush over a mesh on a viewer's page, by all its clients; each can be undone.

While a brush is on, its mesh, invisible, catches drags that begin on it; others still turn the camera. All clients share what
is painted, and what is undone.
"""

import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Collection, Mapping, MutableSequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mesoshell.errors import InputError
from mesoshell.render.camera import Camera, rays
from mesoshell.viewer.browser import camera_of
from mesoshell.viewer.canvas import Canvas, Hit
from mesoshell.viewer.look import Painting

#: Brush's radius as a share of the mesh's size: least, usual, most.
RADII = (0.01, 0.08, 0.3)
#: Radii between dabs of a stroke; most dabs between two places of the pointer; radii of a step that begins elsewhere.
SPACING, DABS, JUMP = 0.25, 8, 4.0
#: Seconds between pictures of a stroke: fewer, and none would be done before the next; strokes that can be undone.
SHOWN, UNDONE = 1.0, 50

#: What a name was painted with before, or after; None where nothing was.
Row = MutableSequence[Painting | None]


@dataclass
class Stroke:
    """A stroke under way. name: of what it paints; place: of the pointer, pixels; last: where its last dab was; drawn: if it
    has one; shown: when it was shown."""

    name: str
    place: np.ndarray
    last: Hit | None = None
    drawn: bool = False
    shown: float = 0.0


class Strokes(ABC):
    """Paintings by name, on a server's page. names: of them; node: of the mesh that catches drags; changed: called when what
    is shown has changed; say: with what is wrong with the mesh, empty if nothing is. Who inherits gives what its strokes paint,
    and how."""

    def __init__(
        self, server: Any, node: str, names: Collection[str], changed: Callable[[], None], say: Callable[[str], None]
    ):
        self._server, self._path, self._changed, self._say = server, node, changed, say
        self._before: dict[str, Row] = {name: deque(maxlen=UNDONE) for name in names}
        self._after: dict[str, Row] = {name: [] for name in names}
        self._now: dict[str, Painting] = {}
        self._shown: dict[str, Painting] = {}
        self._strokes: dict[int, Stroke] = {}
        self._canvas: Canvas | None = None
        self._of: Any = None
        self._node: Any = None
        self._lock, self._switching = threading.Lock(), threading.RLock()  # viser calls back where a control is set

    def _add_switch(self, gui: Any, hint: str) -> None:
        """The control that turns the brush on."""
        self._on = gui.add_checkbox("brush", False, hint=hint)
        self._on.on_update(self._switch)

    def _add_radius(self, gui: Any) -> None:
        """Controls of the brush's size, and those that undo."""
        least, usual, most = RADII
        self._radius = gui.add_slider("radius", least, most, 0.005, usual, hint="share of the mesh's size")
        gui.add_button("Undo").on_click(self._undo)
        gui.add_button("Redo").on_click(self._redo)
        gui.add_button("Clear", hint="take off all that is painted of it; Undo brings it back").on_click(self._clear)

    @property
    def painted(self) -> dict[str, Painting]:
        """What is shown, by name."""
        return dict(self._shown)

    @abstractmethod
    def _name_now(self) -> str:
        """What a stroke that begins now paints."""

    @abstractmethod
    def _mesh_now(self) -> Any:
        """What the canvas is made of; the same object as long as it stays the same."""

    @abstractmethod
    def _made(self, of: Any) -> Canvas:
        """The canvas."""

    @abstractmethod
    def _begun_image(self, canvas: Canvas, name: str) -> np.ndarray:
        """What is there before the first stroke."""

    @abstractmethod
    def _dabbed(
        self, canvas: Canvas, image: np.ndarray, stroke: Stroke, hit: Hit, radius: float, way: np.ndarray | None
    ) -> np.ndarray | None:
        """The image with a dab; None for none. radius: world; way: from the dab before; None where there was none near."""

    @abstractmethod
    def _shows_at_once(self, name: str) -> bool:
        """Whether a stroke shows as it is drawn, and not only at its end."""

    def _switch(self, _: Any) -> None:
        """On or off, with the mesh as it is now."""
        with self._switching:
            try:
                other = self._on.value and (self._node is None or self._of != self._mesh_now())
                if other:
                    self.prepare()
                    self._say("")
            except InputError as fault:
                self._say(str(fault))
                self._on.value = False
                return
            if other:
                assert self._canvas is not None
                if self._node is not None:
                    self._node.remove()
                top = self._canvas.vertices, self._canvas.faces
                self._node = self._server.scene.add_mesh_simple(self._path, *top, opacity=0.0, side="double")
                self._node.on_drag("left")(self._dragged)
            if self._node is not None:
                self._node.visible = self._on.value

    def renew(self) -> None:
        """Paint on the mesh as it is now."""
        self._switch(None)

    def prepare(self) -> None:
        """Make the mesh ready to paint on."""
        of = self._mesh_now()
        canvas = self._made(of)
        canvas.prepare()
        self._canvas, self._of = canvas, of

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
            self._strokes[client] = Stroke(self._name_now(), place)
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
        if dabs and self._shows_at_once(stroke.name) and now - stroke.shown > SHOWN:
            stroke.shown = now
            self._show()

    def end(self, client: int) -> None:
        """Show the whole stroke."""
        with self._lock:
            stroke = self._strokes.pop(client, None)
        if stroke is not None and stroke.drawn:
            self._show()

    def _dab(self, canvas: Canvas, image: np.ndarray, stroke: Stroke, hit: Hit) -> np.ndarray | None:
        """The image with a dab; None where the stroke has not come far enough for one."""
        radius = self._radius.value * canvas.size
        way = np.zeros(3) if stroke.last is None else hit.point - stroke.last.point
        far = float(np.linalg.norm(way))
        if stroke.last is not None and far < SPACING * radius:
            return None
        begins = stroke.last is None or far > JUMP * radius
        stroke.last = hit
        return self._dabbed(canvas, image, stroke, hit, radius, None if begins else way)

    def _image(self, canvas: Canvas, name: str) -> np.ndarray:
        """What is painted so far."""
        return self._now[name].image if name in self._now else self._begun_image(canvas, name)

    def _show(self) -> None:
        with self._lock:
            self._shown = dict(self._now)
        self._changed()

    def _undo(self, _: Any) -> None:
        """Take back the last stroke of what is painted now."""
        self._go(self._name_now(), self._before, self._after)

    def _redo(self, _: Any) -> None:
        """Draw the stroke that was taken back last, if none was drawn since."""
        self._go(self._name_now(), self._after, self._before)

    def _clear(self, _: Any) -> None:
        """Without paint, which can be undone."""
        name = self._name_now()
        if name in self._now:
            self._replace(name, None)

    def _go(self, name: str, to: Mapping[str, Row], back: Mapping[str, Row]) -> None:
        """To the last of one row of a parameter's paintings, with what is now at the end of the other."""
        with self._lock:
            if not to[name]:
                return
            self._part_strokes(name)
            back[name].append(self._now.get(name))
            self._put(name, to[name].pop())
        self._show()

    def _put(self, name: str, painting: Painting | None) -> None:
        """What is there now; the lock is held."""
        if painting is None:
            self._now.pop(name, None)
        else:
            self._now[name] = painting

    def _replace(self, name: str, painting: Painting | None) -> None:
        """With another painting, or none, which can be undone."""
        with self._lock:
            self._before[name].append(self._now.get(name))
            self._after[name].clear()
            self._put(name, painting)
            self._part_strokes(name)
        self._show()

    def _part_strokes(self, name: str) -> None:
        """What is drawn on of strokes under way is another stroke; the lock is held."""
        for stroke in self._strokes.values():
            stroke.drawn = stroke.drawn and stroke.name != name
