"""The page of a viewer, by viser: sliders and buttons of a workshop, and its pictures behind them.

The server listens on the address that it is given, answers sockets that its own page opens (their Origin), and takes no path
from the browser: what is saved is downloaded there.
"""

import io
import socket
import threading
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import viser
import websockets.asyncio.server

from mesoshell.errors import Argument, InputError
from mesoshell.io.image import exr_bytes, linear_to_srgb, png_bytes, srgb_to_linear
from mesoshell.render.camera import Camera
from mesoshell.render.quality import PRESETS
from mesoshell.scene.mitsuba_xml import write_folder
from mesoshell.scene.scene import Scene
from mesoshell.viewer.browser import camera_of
from mesoshell.viewer.brush import Brush
from mesoshell.viewer.look import Look, command, generated
from mesoshell.viewer.refine import Shown
from mesoshell.viewer.work import Workshop

SIDES = (128, 256, 384, 512, 768, 1024)
#: Quality of the pictures' JPEG, 0 to 100.
JPEG = 85


class Page:
    """A viewer's page. url: where it is; close: end it. Raises InputError for an address that cannot be listened on, and as
    `settled` does."""

    def __init__(
        self,
        scene: Scene,
        engine: str = "jax",
        host: str = "127.0.0.1",
        port: int = 8080,
        progress: Any = lambda share: None,
    ):
        _check_port(host, port)
        self._engine, self._changing = engine, threading.Lock()
        self._pictures: dict[int, Shown] = {}
        self.work = Workshop(scene, self._show, self._say, self._grown, engine, progress)
        with _own_sockets(host, port):
            self._server = viser.ViserServer(host=host, port=port, label="mesoshell", verbose=False)
        self.url = f"http://{host}:{port}"
        self._begin_camera()
        self._brush: Brush | None = None
        self._build()
        self._server.on_client_connect(self._connected)
        self._server.on_client_disconnect(lambda client: self._forget(client.client_id))
        self._server.request_share_url = lambda verbose=True: None  # or any client could open a tunnel to this machine

    def close(self) -> None:
        self._server.stop()
        self.work.close()

    def _begin_camera(self) -> None:
        still, server = self.work.still, self._server
        assert isinstance(still.camera, Camera)
        eye, m = still.camera.to_world[:3, 3], still.camera.to_world
        middle = np.asarray(still.mesh.vertices, np.float64)  # type: ignore[union-attr]
        middle = (middle.min(axis=0) + middle.max(axis=0)) / 2
        server.scene.set_up_direction("+y" if still.up == "y" else "+z")
        server.initial_camera.position = eye
        server.initial_camera.look_at = eye - m[:3, 2] * max(float((eye - middle) @ m[:3, 2]), 1e-9)
        server.initial_camera.fov = still.camera.fov

    def _build(self) -> None:
        gui: Any = self._server.gui
        work, look = self.work, self.work.look
        gui.configure_theme(show_logo=False, show_share_button=False)
        parameters = work.begun.material.parameters
        with gui.add_folder(f"Material: {work.given.material.name}"):
            self._params = {name: _slider(gui, name, parameters[name], value) for name, value in look.params.items()}
            tiled = not generated(work.begun) and getattr(work.begun.material.bundle, "tiles", None) is not None
            self._seed = (
                gui.add_number("seed", look.seed, min=-(2**31), max=2**32 - 1, step=1)
                if generated(work.begun) or tiled
                else None
            )
            self._thickness = None
            if look.thickness is not None:
                t = look.thickness
                self._thickness = gui.add_slider(
                    "thickness", t / 10, t * 3, t / 50, t, hint="height of the shell, in the mesh's unit"
                )
            self._given_base = look.base_colour
            self._ground = tuple(round(255 * float(x)) for x in linear_to_srgb(np.array(look.base_colour)))
            self._base = gui.add_rgb("ground", self._ground, hint="colour of the surface under the shell")
            self._bar = gui.add_progress_bar(0.0, visible=False)
        if look.params:
            self._brush = Brush(self._server, work, self._paint)
        with gui.add_folder("Light"):
            self._lit = gui.add_checkbox("sun", False, hint="one light from here, in place of the scene's")
            self._azimuth = gui.add_slider("azimuth", -180.0, 180.0, 1.0, -40.0, hint="degrees from the first camera")
            self._elevation = gui.add_slider("elevation", -10.0, 90.0, 1.0, 45.0, hint="degrees above the horizon")
        with gui.add_folder("Picture"):
            self._quality = gui.add_dropdown("quality", tuple(PRESETS), initial_value=look.quality)
            self._side = gui.add_dropdown(
                "pixels", tuple(map(str, SIDES)), initial_value=str(look.side), hint="of the longer side"
            )
            self._cost = gui.add_markdown("")
        with gui.add_folder("Save"):
            gui.add_button("PNG").on_click(partial(self._save, "png"))
            gui.add_button("EXR").on_click(partial(self._save, "exr"))
            gui.add_button("Scene", hint="of Mitsuba's, with its meshes and images, zipped").on_click(self._save_scene)
            gui.add_button("Command").on_click(self._say_command)
            self._command = gui.add_markdown("")
        with gui.add_folder("Effects", expand_by_default=False):
            self._effects = gui.add_markdown("")
        self._fault = gui.add_markdown("")
        inputs = [*self._params.values(), self._seed, self._thickness, self._base, self._lit]
        for each in [*inputs, self._azimuth, self._elevation, self._quality, self._side]:
            if each is not None:
                each.on_update(self._set)

    def _look(self) -> Look:
        red, green, blue = (float(x) for x in srgb_to_linear(np.array(self._base.value, np.float64) / 255))
        return Look(
            params={name: float(slider.value) for name, slider in self._params.items()},
            seed=0 if self._seed is None else int(self._seed.value),
            thickness=None if self._thickness is None else float(self._thickness.value),
            # eight bits are not the colour that was given
            base_colour=self._given_base if tuple(self._base.value) == self._ground else (red, green, blue),
            painted={} if self._brush is None else self._brush.painted,
            sun=(self._azimuth.value, self._elevation.value) if self._lit.value else None,
            quality=self._quality.value,
            side=int(self._side.value),
        )

    def _set(self, _: Any) -> None:
        with self._changing:
            self.work.set(self._look())

    def _paint(self) -> None:
        """Show what was painted; a painted parameter's slider rests."""
        assert self._brush is not None
        painted = self._brush.painted
        for name, slider in self._params.items():
            slider.disabled = name in painted
        self._set(None)

    def _connected(self, client: Any) -> None:
        client.camera.on_update(lambda _: self._moved(client))
        self._moved(client)

    def _moved(self, client: Any) -> None:
        with self._changing:
            camera = camera_of(client.camera)
            if camera is not None:
                self.work.see(client.client_id, camera)

    def _forget(self, number: int) -> None:
        self.work.leave(number)
        self._pictures.pop(number, None)

    def _show(self, number: int, picture: Shown) -> None:
        client = self._server.get_clients().get(number)
        if client is None:  # it left in the meantime
            self._forget(number)
            return
        self._pictures[number] = picture
        rgb = np.clip(picture.rgba[..., :3] + 1 - picture.rgba[..., 3:], 0, 1)
        image = np.round(255 * linear_to_srgb(rgb)).astype(np.uint8)
        client.scene.set_background_image(image, format="jpeg", jpeg_quality=JPEG)
        record = picture.rendered.record
        each = f", {record['queries'] / record['rays']:.1f} evaluations a ray" if record["rays"] else ""
        height, width = image.shape[:2]
        self._cost.content = (
            f"{width} × {height}, {picture.samples} a pixel; {1000 * picture.seconds:.0f} ms a pass{each}"
        )
        text = "\n".join(f"- {line}" for line in str(picture.effects or "").splitlines())
        if self._effects.content != text:
            self._effects.content = text

    def _say(self, line: str) -> None:
        if self._fault.content != line:
            self._fault.content = line

    def _grown(self, share: float) -> None:
        self._bar.visible = share < 1
        self._bar.value = 100 * share

    def _save(self, kind: str, event: Any) -> None:
        picture = self._pictures.get(event.client_id)
        if picture is not None and event.client is not None:
            data = png_bytes(picture.rgba) if kind == "png" else exr_bytes(picture.rgba)
            event.client.send_file_download(f"mesoshell.{kind}", data, save_immediately=True)

    def _save_scene(self, event: Any) -> None:
        if event.client_id not in self._pictures or event.client is None:
            return
        packed = io.BytesIO()
        with TemporaryDirectory() as parent:
            folder = Path(parent) / "scene"
            try:
                write_folder(self.work.described(event.client_id), folder, PRESETS[self._quality.value])
            except (InputError, OSError) as fault:
                self.work.say("scene", str(fault))
                return
            with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as file:
                for path in sorted(folder.iterdir()):
                    file.write(path, f"scene/{path.name}")
        self.work.say("scene", "")
        event.client.send_file_download("scene.zip", packed.getvalue(), save_immediately=True)

    def _say_command(self, event: Any) -> None:
        picture = self._pictures.get(event.client_id)
        if picture is not None:
            work = self.work
            line = command(work.given, work.scene(event.client_id), work.look, self._engine, picture.samples)
            self._command.content = f"    {line}"


def _slider(gui: Any, name: str, parameter: Any, value: float) -> Any:
    low, high = parameter.range
    unit = "" if parameter.unit == "1" else f" [{parameter.unit}]"
    hint = f"{parameter.meaning} (default {parameter.default:g})"
    return gui.add_slider(name + unit, low, high, (high - low) / 200, min(max(value, low), high), hint=hint)


@contextmanager
def _own_sockets(host: str, port: int) -> Iterator[None]:
    """Servers that begin here answer sockets of their own page alone, or of programs that send no Origin."""
    # viser prints a table of addresses; the command says its own line
    serve: Any = websockets.asyncio.server.serve
    places = [f"http://{name.lower()}" for name in _own_names(host)]
    origins = [None, *(f"{place}:{port}" for place in places), *(places if port == 80 else ())]
    websockets.asyncio.server.serve = partial(serve, origins=origins)  # type: ignore
    try:
        with redirect_stdout(io.StringIO()):
            yield
    finally:
        websockets.asyncio.server.serve = serve


def _own_names(host: str) -> set[str]:
    """What browsers may call a server that listens on `host`: of all addresses, this machine's names and addresses."""
    names = {host, "127.0.0.1", "localhost"}
    if host in ("", "0.0.0.0"):
        own = socket.gethostname()
        names |= {own, socket.getfqdn()}
        with suppress(OSError):
            names |= {str(entry[4][0]) for entry in socket.getaddrinfo(own, None)}
        with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as route:
            route.connect(("192.0.2.1", 9))  # sends nothing, and tells the address that others see
            names.add(route.getsockname()[0])
    return names


def _check_port(host: str, port: int) -> None:
    """Raise InputError unless the port is free: viser would take another one and not say so."""
    if not 0 < port < 65536:
        raise InputError(Argument("port"), f"must be from 1 to 65535, not {port}")
    try:
        socket.getaddrinfo(host, port)
    except OSError as fault:
        raise InputError(Argument("host"), f"{host} is no address of this machine: {fault}") from fault
    try:
        with socket.socket() as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind((host, port))
    except OSError as fault:
        raise InputError(Argument("port"), f"{host}:{port} cannot be listened on: {fault}") from fault
