"""The page of a scene of Mitsuba's XML, by viser: its pictures from anywhere, and the sensor that sees one."""

from functools import partial
from typing import Any

import numpy as np

from mesoshell.render.camera import Camera
from mesoshell.render.quality import PRESETS
from mesoshell.scene.render_paths import MovedFile
from mesoshell.viewer.address import check_port, open_server
from mesoshell.viewer.browser import camera_of, reach
from mesoshell.viewer.eyes import EyesPage
from mesoshell.viewer.moved_file import FileLook, FilePicture, FileWorkshop
from mesoshell.viewer.settings import SIDES


class FilePage(EyesPage):
    """A viewer's page of a scene of Mitsuba's. url: where it is; close: end it. Raises InputError for an address that cannot
    be listened on."""

    def __init__(self, file: MovedFile, host: str = "127.0.0.1", port: int = 8080):
        check_port(host, port)
        super().__init__()
        self.work = FileWorkshop(file, self._show, self._say)
        try:
            self._server = open_server(host, port)
            self.url = f"http://{host}:{port}"
            self._begin_camera()
            self._build()
        except BaseException:
            if hasattr(self, "_server"):
                self._server.stop()
            self.work.close()
            raise
        self._server.on_client_connect(self._connected)
        self._server.on_client_disconnect(lambda client: self.work.leave(client.client_id))

    def close(self) -> None:
        self.work.close()
        self._server.stop()

    def _cost_of(self, picture: FilePicture) -> str:
        return _cost(picture)

    def _size(self) -> float:
        return self.work.file.distance

    def _begin_camera(self) -> None:
        """As the file's sensor, about what its middle shows; the axis nearest to its up is up."""
        camera, begin = self.work.file.camera, self._server.initial_camera
        eye, back, up = (camera.to_world[:3, k] for k in (3, 2, 1))
        axis = np.zeros(3)
        axis[np.abs(up).argmax()] = np.sign(up[np.abs(up).argmax()])
        self._server.scene.set_up_direction(axis)
        begin.position, begin.look_at = eye, eye - back * self.work.file.distance
        begin.near, begin.far = reach(self._size())
        begin.fov = camera.fov

    def _build(self) -> None:
        gui: Any = self._server.gui
        look = self.work.look
        with gui.add_folder("Picture"):
            self._quality = gui.add_dropdown("quality", tuple(PRESETS), initial_value=look.quality)
            sides = tuple(map(str, SIDES))
            self._side = gui.add_dropdown("pixels", sides, initial_value=str(look.side), hint="of the longer side")
            self._cost = gui.add_markdown("")
        with gui.add_folder("Save"):
            gui.add_button("PNG").on_click(partial(self._save_picture, "png"))
            gui.add_button("EXR").on_click(partial(self._save_picture, "exr"))
            gui.add_button("Sensor", hint="as it sees this, for the scene's file").on_click(self._save_sensor)
        self._fault = gui.add_markdown("")
        for each in (self._quality, self._side):
            each.on_update(lambda _: self.work.set(FileLook(self._quality.value, int(self._side.value))))
        for note in self.work.file.notes:
            self.work.say(note, note)

    def _save_sensor(self, event: Any) -> None:
        client = event.client
        camera = None if client is None else camera_of(client.camera)
        if client is not None and camera is not None:
            client.send_file_download("sensor.xml", sensor_xml(camera).encode(), save_immediately=True)


def _cost(picture: FilePicture) -> str:
    """What a picture's passes cost."""
    height, width = picture.rgba.shape[:2]
    return f"{width} × {height}, {picture.paths} paths a pixel; {1000 * picture.seconds:.0f} ms a pass"


def sensor_xml(camera: Camera) -> str:
    """A camera as a sensor of Mitsuba's, in place of the file's."""
    eye, back, up = (camera.to_world[:3, k] for k in (3, 2, 1))
    place = (
        f'{name}="{", ".join(f"{x:.9g}" for x in at)}"'
        for name, at in zip(("origin", "target", "up"), (eye, eye - back, up), strict=True)
    )
    return (
        f'<sensor type="perspective">\n    <string name="fov_axis" value="y"/>\n'
        f'    <float name="fov" value="{np.degrees(camera.fov):.9g}"/>\n'
        f'    <transform name="to_world"><lookat {" ".join(place)}/></transform>\n</sensor>\n'
    )
