"""The page of a viewer, by viser: sliders and buttons of a workshop, and its pictures behind them.

The server listens on the address that it is given, answers sockets that its own page opens (their Origin), and takes no path
from the browser: what is saved is downloaded there (viewer/downloads).
"""

import threading
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mesoshell.errors import InputError
from mesoshell.geometry.mesh import Mesh, bounding_box
from mesoshell.io.image import linear_to_srgb, srgb_codes, srgb_to_linear
from mesoshell.io.surface import KIND
from mesoshell.render.camera import Camera
from mesoshell.render.quality import PRESETS
from mesoshell.scene.materials import load_material
from mesoshell.scene.scene import Grown, Scene
from mesoshell.viewer.address import check_port, open_server
from mesoshell.viewer.browser import camera_of, reach, set_text
from mesoshell.viewer.brush import Brush
from mesoshell.viewer.compare import difference, over_white, wipe
from mesoshell.viewer.downloads import Downloads
from mesoshell.viewer.light import LightPanel
from mesoshell.viewer.look import Look, PartLook, parts_of
from mesoshell.viewer.panel import Panel
from mesoshell.viewer.refine import RefinedPicture
from mesoshell.viewer.settings import SettingsPanel
from mesoshell.viewer.sun import Sphere
from mesoshell.viewer.work import Workshop

#: Quality of the pictures' JPEG, 0 to 100.
JPEG = 85
NOTHING = "nothing"


class ComparisonView(NamedTuple):
    """The eye by which a client sees what its picture is compared with."""

    client: int


class Page:
    """A viewer's page. beside: a scene that it may be compared with; run: folder of the training that made the material; url:
    where it is; close: end it. Raises InputError for an address that cannot be listened on, and as `settle` does."""

    def __init__(
        self,
        scene: Scene,
        engine: str = "jax",
        host: str = "127.0.0.1",
        port: int = 8080,
        progress: Any = lambda share: None,
        beside: Scene | None = None,
        run: Path | None = None,
    ):
        check_port(host, port)
        self._engine, self._changing = engine, threading.Lock()
        self._joining, self._latest = threading.Lock(), 0
        self.work, self.beside = self._workshops(scene, beside, progress)
        try:
            self._server = open_server(host, port)
            self.url = f"http://{host}:{port}"
            self._begin_camera()
            self._brushes: dict[int, Brush] = {}
            self._run: Any = None
            self._build(run)
        except BaseException:
            if hasattr(self, "_server"):
                self._server.stop()
            for work in self._works():
                work.close()
            raise
        self._server.on_client_connect(self._connected)
        self._server.on_client_disconnect(lambda client: self._forget(client.client_id))

    def _workshops(self, scene: Scene, beside: Scene | None, progress: Any) -> tuple[Workshop, Workshop | None]:
        """Of the scene and of what it may be compared with; they paint in turn."""
        paint_lock = threading.Lock()
        work = Workshop(scene, self._show, self._say, self._grown, self._engine, progress, paint_lock)
        if beside is None:
            return work, None
        try:
            beside = replace(beside, camera=work.still.camera)
            return work, Workshop(
                beside, self._show, self._say_other, self._grown_other, self._engine, progress, paint_lock
            )
        except BaseException:
            work.close()
            raise

    def close(self) -> None:
        if self._run is not None:
            self._run.close()
        for work in self._works():
            work.close()
        self._server.stop()

    def _begin_camera(self) -> None:
        still, server = self.work.still, self._server
        assert isinstance(still.camera, Camera)
        eye, m = still.camera.to_world[:3, 3], still.camera.to_world
        middle, radius = self._about()
        server.initial_camera.near, server.initial_camera.far = reach(radius)
        server.scene.set_up_direction("+y" if still.up == "y" else "+z")
        server.initial_camera.position = eye
        server.initial_camera.look_at = eye - m[:3, 2] * max(float((eye - middle) @ m[:3, 2]), 1e-9)
        server.initial_camera.fov = still.camera.fov

    def _about(self) -> Sphere:
        """The scene's own mesh."""
        assert isinstance(self.work.still.mesh, Mesh)
        low, high = bounding_box(self.work.still.mesh).astype(np.float64)
        return Sphere((low + high) / 2, float(np.linalg.norm(high - low)) / 2)

    def _build(self, run: Path | None) -> None:
        gui: Any = self._server.gui
        work, look = self.work, self.work.look
        name, parts = work.begun.material.name if run is None else run.name, parts_of(work.begun)
        names = [f": {name}", *(f": {_called(part)}" for part in work.begun.also)]
        self._panels = [
            Panel(gui, part, own, f"Material{name}", self._set)
            for part, own, name in zip(parts, look.parts, names, strict=True)
        ]
        self._other: Panel | None = None
        if self.beside is not None:
            title = f"Beside it: {self.beside.given.material.name}"
            self._other = Panel(gui, self.beside.begun, self.beside.look, title, self._set)
        with self._panels[0].folder:
            self._given_base = look.base_colour
            self._ground = tuple(round(255 * float(x)) for x in linear_to_srgb(np.array(look.base_colour)))
            self._base = gui.add_rgb("ground", self._ground, hint="colour of the surface under the shell")
        if work.begun.material.kind != KIND:
            names = names if len(names) > 1 else [""]
            self._brushes = {
                k: Brush(self._server, work, self._paint, k, f"Paint{name}")
                for k, (part, name) in enumerate(zip(parts, names, strict=True))
                if part.material.kind != KIND
            }
        say = partial(work.say, "environment")
        self._light = LightPanel(self._server, work.still, self._about(), self._set, say)
        self._settings = SettingsPanel(gui, self._engine, look, self._set)
        with gui.add_folder("Compare", expand_by_default=self.beside is not None):
            first = NOTHING if self.beside is None else self.beside.given.material.name
            names = {NOTHING: None, **dict.fromkeys(PRESETS), first: None}
            hint = "the same in another quality, or the material beside it"
            self._with = gui.add_dropdown("with", tuple(names), initial_value=first, hint=hint)
            self._mode = gui.add_dropdown("show", ("wipe", "error"), hint="both pictures, or FLIP, where they differ")
            self._wipe = gui.add_slider("wipe", 0.0, 1.0, 0.01, 0.5, hint="what is compared with is right of it")
        self._downloads = Downloads(gui, work, self._engine)
        with gui.add_folder("Effects", expand_by_default=False):
            self._effects = gui.add_markdown("")
        self._fault, self._other_fault = gui.add_markdown(""), gui.add_markdown("")
        self._base.on_update(self._set)
        if run is not None:
            from mesoshell.viewer.run import RunPanel  # training needs JAX

            self._run = RunPanel(gui, run, Path(work.given.material.name), self._set_material, partial(work.say, "run"))
        self._with.on_update(lambda _: self._compare())
        self._mode.on_update(lambda _: self._show_all())
        self._wipe.on_update(lambda _: self._show_all() if self._mode.value == "wipe" else None)

    def _look(self) -> Look:
        typed = np.clip(np.array(self._base.value, np.float64), 0, 255)  # a picker takes larger numbers by keys
        red, green, blue = (float(x) for x in srgb_to_linear(typed / 255))
        own, *others = (
            PartLook(**panel.look(), painted=self._brushes[k].painted if k in self._brushes else {})
            for k, panel in enumerate(self._panels)
        )
        return Look(
            **vars(own),
            also=tuple(others),
            # eight bits are not the colour that was given
            base_colour=self._given_base if tuple(self._base.value) == self._ground else (red, green, blue),
            **self._light.look(),
            **self._settings.look(),
        )

    def _set(self, _: Any) -> None:
        with self._changing:
            look = self._look()
            self.work.set(look)
            if self.beside is not None and self._other is not None:
                self.beside.set(replace(look, **self._other.look(), painted={}))

    def _set_material(self, snapshot: Path) -> bool:
        """Another snapshot of the run; whether it can be shown."""
        try:
            self.work.set_material(load_material(snapshot))
        except InputError as fault:
            self.work.say("snapshot", str(fault))
            return False
        self.work.say("snapshot", "")
        return True

    def _paint(self) -> None:
        """Show what was painted."""
        for k, brush in self._brushes.items():
            self._panels[k].rest(brush.painted)
        self._set(None)

    def _connected(self, client: Any) -> None:
        client.camera.min_orbit_distance = reach(self._about().radius)[0]
        client.camera.on_update(lambda _: self._moved(client))
        self._moved(client)

    def _moved(self, client: Any) -> None:
        with self._changing:
            camera = camera_of(client.camera)
            if camera is not None:
                self.work.see(client.client_id, camera)
                self._see_comparison(client.client_id, camera)

    def _comparison(self) -> tuple[Workshop, str | None] | None:
        """Whose pictures are compared with, and in which quality: None for the look's."""
        name = self._with.value
        if name in PRESETS:
            return self.work, name
        return None if self.beside is None or name == NOTHING else (self.beside, None)

    def _see_comparison(self, number: int, camera: Camera) -> None:
        """What a client compares with, from the same place."""
        comparison = self._comparison()
        if comparison is not None:
            work, quality = comparison
            work.see(ComparisonView(number), camera, quality)

    def _compare(self) -> None:
        """With something else: what was compared with before is seen no longer."""
        with self._changing:
            for number, client in self._server.get_clients().items():
                self._leave_comparison(number)
                camera = camera_of(client.camera)
                if camera is not None:
                    self._see_comparison(number, camera)
        self._show_all()

    def _leave_comparison(self, number: int) -> None:
        for work in self._works():
            work.leave(ComparisonView(number))

    def _works(self) -> tuple[Workshop, ...]:
        return (self.work,) if self.beside is None else (self.work, self.beside)

    def _forget(self, number: int) -> None:
        self.work.leave(number)
        self._leave_comparison(number)

    def _show(self, eye: int | ComparisonView) -> None:
        """A picture has refined."""
        number = eye.client if isinstance(eye, ComparisonView) else eye
        client = self._server.get_clients().get(number)
        if client is None:  # it left in the meantime
            self._forget(number)
            return
        with self._joining:
            self._join(client)

    def _show_all(self) -> None:
        """What is compared, or how, has changed; only the last change is shown."""
        self._latest += 1
        this_call = self._latest
        for client in self._server.get_clients().values():
            with self._joining:
                if this_call == self._latest:
                    self._join(client)

    def _join(self, client: Any) -> None:
        """Send a client its picture, with what it is compared with if that shows the same, or while a camera moves about the
        same."""
        picture, current = self.work.picture(client.client_id)
        if picture is None:
            return
        comparison, name, lines = self._comparison(), self._with.value, [_cost(picture)]
        compared_picture = None
        if comparison is not None:
            other, up_to_date = comparison[0].picture(ComparisonView(client.client_id))
            moving = not current and not up_to_date and comparison[0] is self.beside
            if (current and up_to_date) or (moving and other and other.rgba.shape == picture.rgba.shape):
                compared_picture = other
            if moving and self._mode.value == "error":
                return  # it would show how far the camera moved
            if compared_picture is None and comparison[0] is self.beside and (picture.samples == 1 or not current):
                return  # while a camera moves, both materials or none
        if compared_picture is None:
            image = over_white(picture.rgba)
            lines += [] if comparison is None else [f"{name}: under way"]
        else:
            lines.append(f"{name}: {_cost(compared_picture)}")
            if self._mode.value == "error" and picture.rgba.shape == compared_picture.rgba.shape:
                image, flip = difference(picture.rgba, compared_picture.rgba)
                lines.append(f"FLIP {flip:.4f} between them")
            else:
                image = wipe(picture.rgba, compared_picture.rgba, self._wipe.value)
        client.scene.set_background_image(srgb_codes(image), format="jpeg", jpeg_quality=JPEG)
        self._settings.cost.content = "  \n".join(lines)
        if current:
            self._settings.see(picture, self.work.look)
        set_text(self._effects, "\n".join(f"- {line}" for line in str(picture.effects or "").splitlines()))

    def _say(self, line: str) -> None:
        set_text(self._fault, line)

    def _say_other(self, line: str) -> None:
        set_text(self._other_fault, line)

    def _grown(self, share: float) -> None:
        self._panels[0].grown(share)

    def _grown_other(self, share: float) -> None:
        assert self._other is not None
        self._other.grown(share)


def _called(part: Grown) -> str:
    """A further material, and which one where it has a name of its own."""
    name = part.material.name
    return name if part.called == name else f"{name} on {part.called}"


def _cost(picture: RefinedPicture) -> str:
    """What a picture's passes cost."""
    height, width = picture.rgba.shape[:2]
    record = picture.rendered.record
    each = f", {record['queries'] / record['rays']:.1f} evaluations a ray" if record["rays"] else ""
    where = "a pixel" if picture.whole else "for every other pixel"
    return f"{width} × {height}, {picture.samples} {where}; {1000 * picture.seconds:.0f} ms a pass{each}"
