"""The page of a captured object, by viser: its pictures, its texture beside them, and a brush that paints one on the other."""

import threading
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mesoshell.errors import InputError
from mesoshell.io.image import exr_bytes, png_bytes, srgb_codes
from mesoshell.neutex.store import NeuTexModel, read_neutex
from mesoshell.render.quality import PRESETS
from mesoshell.viewer.address import check_port, open_server
from mesoshell.viewer.browser import reach
from mesoshell.viewer.captured import CapturedObject, ObjectLook, ObjectPicture, ObjectWorkshop
from mesoshell.viewer.eyes import EyesPage
from mesoshell.viewer.run import RunPanel
from mesoshell.viewer.settings import SIDES
from mesoshell.viewer.sun import Sphere, Sun
from mesoshell.viewer.texture_brush import TEXTURE, TextureBrush


class ObjectPage(EyesPage):
    """A viewer's page of an object. folder: of its run; snapshot: the file that is shown first; url: where it is; close: end
    it. Raises InputError for an address that cannot be listened on, and for a snapshot that is none."""

    def __init__(self, folder: Path, snapshot: Path, host: str = "127.0.0.1", port: int = 8080):
        check_port(host, port)
        super().__init__()
        self._changing = threading.Lock()
        self._shown_texture: Any = None
        self.work = ObjectWorkshop(read_neutex(snapshot), self._show, self._say)
        self._run: RunPanel | None = None
        try:
            self._server = open_server(host, port)
            self.url = f"http://{host}:{port}"
            self._begin_camera(self.work.object.model)
            self._build(folder, snapshot)
        except BaseException:
            if hasattr(self, "_server"):
                self._server.stop()
            self.work.close()
            raise
        self._server.on_client_connect(self._connected)
        self._server.on_client_disconnect(lambda client: self.work.leave(client.client_id))

    def close(self) -> None:
        if self._run is not None:
            self._run.close()
        self.work.close()
        self._server.stop()

    def _begin_camera(self, model: NeuTexModel) -> None:
        photo, begin = model.photos[0], self._server.initial_camera
        eye, back = photo.to_world[:3, 3], photo.to_world[:3, 2]
        self._server.scene.set_up_direction(tuple(self.work.object.up))
        begin.position, begin.look_at = eye, eye - back * max(float((eye - model.centre) @ back), 1e-9)
        begin.near, begin.far = reach(model.half)
        begin.fov = 2 * float(np.arctan(photo.height / 2 / photo.lens[1]))

    def _size(self) -> float:
        return self.work.object.model.half

    def _cost_of(self, picture: ObjectPicture) -> str:
        return _cost(picture)

    def _build(self, folder: Path, snapshot: Path) -> None:
        gui: Any = self._server.gui
        look, captured = self.work.look, self.work.object
        self._brush: TextureBrush | None = None
        self._checker: Any = None
        self._sun: Sun | None = None
        controls: list[Any] = []
        if captured.has_texture:
            with gui.add_folder("Texture", order=-3):
                self._image = gui.add_image(self._codes(look))
                hint = "where its squares are of one size, the texture can be painted on"
                self._checker = gui.add_checkbox("checkerboard", False, hint=hint)
            controls.append(self._checker)
            self._brush = TextureBrush(self._server, self.work, lambda: self._set(None))
            self._brush.upload.on_upload(self._take_image)
        if captured.is_lit:
            with gui.add_folder("Light"):
                model, hint = captured.model, "in place of the camera's flash"
                about = Sphere(model.centre, model.half)
                self._sun = Sun(self._server, model.photos[0].to_world, captured.up, about, hint, self._set)
        with gui.add_folder("Picture"):
            self._quality = gui.add_dropdown("quality", tuple(PRESETS), initial_value=look.quality)
            sides = tuple(map(str, SIDES))
            self._side = gui.add_dropdown("pixels", sides, initial_value=str(look.side), hint="of the longer side")
            self._cost = gui.add_markdown("")
        with gui.add_folder("Save"):
            gui.add_button("PNG").on_click(partial(self._save_picture, "png"))
            gui.add_button("EXR").on_click(partial(self._save_picture, "exr"))
            if captured.has_texture:
                gui.add_button("Texture", hint="as it is shown, a cubemap").on_click(self._save_texture)
                hint = "paint alone, a cubemap: what `mesoshell atlas render --texture` takes"
                gui.add_button("Paint", hint=hint).on_click(self._save_paint)
        self._fault = gui.add_markdown("")
        for each in (*controls, self._quality, self._side):
            each.on_update(self._set)
        self._run = RunPanel(gui, folder, snapshot, self._set_snapshot, partial(self.work.say, "run"))

    def _look(self) -> ObjectLook:
        return ObjectLook(
            None if self._brush is None else self._brush.painted.get(TEXTURE),
            self._checker is not None and self._checker.value,
            None if self._sun is None else self._sun.sun,
            self._quality.value,
            int(self._side.value),
        )

    def _set(self, _: Any) -> None:
        with self._changing:
            look = self._look()
            self.work.set(look)
            self._show_texture()
        if look.painted is not None:
            self.work.say("paint", "")

    def _take_image(self, event: Any) -> None:
        """An image that a browser sent."""
        assert self._brush is not None
        try:
            self._brush.put(event.target.value.content, "the image")
        except InputError as fault:
            self.work.say("image", str(fault))
        else:
            self.work.say("image", "")

    def _show_texture(self) -> None:
        """The texture beside the pictures, if it is another one."""
        look, captured = self.work.look, self.work.object
        wanted = captured, look.painted, look.checker
        if captured.has_texture and wanted != self._shown_texture:
            self._image.image = self._codes(look)
            self._shown_texture = wanted

    def _codes(self, look: ObjectLook) -> np.ndarray:
        return srgb_codes(self.work.object.shown(look))

    def _set_snapshot(self, path: Path) -> bool:
        """Another snapshot of the run; whether it can be shown."""
        try:
            captured = CapturedObject(read_neutex(path))
            captured.prepare()
        except InputError as fault:
            self.work.say("snapshot", str(fault))
            return False
        self.work.say("snapshot", "")
        self.work.set_object(captured)
        with self._changing:
            self._show_texture()
        if self._brush is not None:
            self._brush.renew()
        return True

    def _save_texture(self, event: Any) -> None:
        if event.client is not None:
            data = png_bytes(self.work.object.shown(self.work.look))
            event.client.send_file_download("texture.png", data, save_immediately=True)

    def _save_paint(self, event: Any) -> None:
        painted = self.work.look.painted
        self.work.say("paint", "nothing is painted yet" if painted is None else "")
        if painted is not None and event.client is not None:
            event.client.send_file_download("paint.exr", exr_bytes(painted.image), save_immediately=True)


def _cost(picture: ObjectPicture) -> str:
    """What a picture's passes cost."""
    (height, width), each = picture.rgba.shape[:2], f"{picture.samples} samples a ray"
    return f"{width} × {height}, {picture.rays} a pixel; {1000 * picture.seconds:.0f} ms a pass, {each}"
