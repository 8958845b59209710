"""A viewer's page: who may open it, what it shows, and, where a browser is, that sliders and the mouse move the picture."""

import asyncio
import io
import os
import re
import shutil
import socket
import threading
import time
import urllib.request
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

import mesoshell as ms
from mesoshell.cli.main import main
from mesoshell.errors import InputError
from mesoshell.geometry.mesh import load_mesh
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.io.image import exr_bytes
from mesoshell.scene.materials import Material
from tests.helpers import wearing
from tests.helpers.ports import free_port

viser = pytest.importorskip("viser", reason="requires the extra viewer")
websockets = pytest.importorskip("websockets", reason="requires the extra viewer")

from mesoshell.scene.growth import growth_of  # noqa: E402
from mesoshell.viewer import downloads, settings  # noqa: E402
from mesoshell.viewer import look as looking_at  # noqa: E402
from mesoshell.viewer import refine as refining  # noqa: E402
from mesoshell.viewer.address import own_names  # noqa: E402
from mesoshell.viewer.browser import camera_of  # noqa: E402
from mesoshell.viewer.brush import grown_so_far  # noqa: E402
from mesoshell.viewer.look import command, scene_of_look  # noqa: E402
from mesoshell.viewer.page import ComparisonView, Page  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
MESH = Path(__file__).parents[1] / "data" / "suzanne.obj"
CHROMIUM = shutil.which("chromium")


@pytest.fixture(scope="module")
def page(tiny_bundle: Bundle, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
        patch.setattr(refining, "COARSE", 64)
        cheap = dict.fromkeys(refining.PRESETS, ms.Quality(samples=4, pixel_samples=1))
        for module in (refining, looking_at, settings):
            patch.setattr(module, "PRESETS", cheap)
        made = Page(ms.Scene(MESH, Material("tiny", tiny_bundle), scale=0.4), port=free_port())
        made._settings._side.value = "128"
        yield made
        made.close()


def test_the_page_is_there(page: Page):
    with urllib.request.urlopen(page.url) as answer:
        assert answer.status == 200 and b"<html" in answer.read().lower()


@pytest.mark.parametrize(("origin", "status"), [("http://evil.example", 403), ("null", 403), (None, 101), ("own", 101)])
def test_sockets_of_other_pages_are_refused(page: Page, origin: str | None, status: int):
    async def opened() -> int:
        given: Any = page.url if origin == "own" else origin
        try:
            async with websockets.connect(
                page.url.replace("http", "ws"), origin=given, subprotocols=[f"viser-v{viser.__version__}"]
            ):
                return 101
        except websockets.exceptions.InvalidStatus as refused:
            return refused.response.status_code

    assert asyncio.run(opened()) == status


def test_who_may_open_a_page_of_all_addresses():
    here = {"127.0.0.1", "localhost"}
    assert own_names("127.0.0.1") == here and own_names("box.example") == {"box.example", *here}
    assert socket.gethostname() in own_names("0.0.0.0") and "" not in own_names("0.0.0.0")


def test_a_port_that_is_taken_is_said(page: Page, tiny_bundle: Bundle):
    port = int(page.url.rpartition(":")[2])
    with pytest.raises(InputError, match=rf"^port: 127\.0\.0\.1:{port} cannot be listened on"):
        Page(ms.Scene(MESH, Material("tiny", tiny_bundle), scale=0.4), port=port)
    for wrong in (-1, 0, 70_000):
        with pytest.raises(InputError, match=r"^port: must be from 1 to 65535"):
            Page(ms.Scene(MESH, Material("tiny", tiny_bundle), scale=0.4), port=wrong)


def test_a_port_that_was_taken_in_the_meantime(page: Page, tiny_bundle: Bundle, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("mesoshell.viewer.page.check_port", lambda host, port: None)
    port = int(page.url.rpartition(":")[2])
    before = threading.active_count()
    with pytest.raises(InputError, match=rf"^port: 127\.0\.0\.1:{port} was taken in the meantime$"):
        Page(ms.Scene(MESH, Material("tiny", tiny_bundle), scale=0.4), port=port)
    end = time.monotonic() + 30
    while threading.active_count() > before:
        assert time.monotonic() < end, "threads of the page go on"
        time.sleep(0.1)


def test_a_browsers_camera_is_ours():
    """Oracle: viser's own camera frame, which looks along +z with y down."""

    class Seen:
        image_width, image_height, fov = 120, 80, 0.7
        position = np.array([1.0, 2.0, 3.0])
        wxyz = viser.transforms.SO3.exp(np.array([0.3, -0.8, 0.4])).wxyz

    camera = camera_of(Seen)
    assert camera is not None
    rotation = viser.transforms.SO3(Seen.wxyz).as_matrix()
    np.testing.assert_allclose(camera.to_world[:3, :3] @ [0, 0, -1], rotation @ [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(camera.to_world[:3, :3] @ [0, 1, 0], rotation @ [0, -1, 0], atol=1e-12)
    np.testing.assert_array_equal(camera.to_world[:3, 3], Seen.position)
    assert (camera.width, camera.height, camera.fov) == (120, 80, 0.7)
    Seen.image_width = 0
    assert camera_of(Seen) is None


def looking(page: Page) -> ms.Camera:
    """The page's first camera, 200 by 160 pixels."""
    still = page.work.still.camera
    assert isinstance(still, ms.Camera)
    return ms.Camera(still.to_world, still.fov, 200, 160)


class Eye:
    """A camera of viser's, as far as it is read."""

    def __init__(self, camera: ms.Camera):
        self.image_width, self.image_height, self.fov = camera.width, camera.height, camera.fov
        self.position = camera.to_world[:3, 3]
        self.wxyz = viser.transforms.SO3.from_matrix(camera.to_world[:3, :3] * [1, -1, -1]).wxyz

    def on_update(self, _: Any) -> None:
        pass


class Drag:
    """An event of viser's, as far as it is read: the pointer in shares of the window."""

    def __init__(self, camera: ms.Camera, phase: str, place: tuple[float, float]):
        self.client, self.client_id, self.phase = type("Client", (), {"camera": Eye(camera)})(), 1, phase
        self.start_screen_pos = self.end_screen_pos = place


class Asked:
    """A click of client 1, to whom files are sent."""

    def __init__(self, sent: dict[str, bytes]):
        self.client_id, self.client, self.sent = 1, self, sent

    def send_file_download(self, name: str, data: bytes, save_immediately: bool) -> None:
        assert save_immediately
        self.sent[name] = data


def drag(page: Page, *places: tuple[float, float]) -> None:
    page._brushes[0].prepare()
    phases = ["start", *["update"] * (len(places) - 2), "end"]
    for phase, place in zip(phases, places, strict=True):
        asyncio.run(page._brushes[0]._dragged(Drag(looking(page), phase, place)))


@pytest.fixture
def brush(page: Page) -> Iterator[Any]:
    yield page._brushes[0]
    for _ in range(4):
        page._brushes[0]._undo(None)


def test_a_stroke_becomes_an_image_and_is_taken_back(page: Page, brush: Any):
    assert brush.painted == {} and page.work.look.painted == {}
    drag(page, (0.5, 0.5), (0.5, 0.5))
    first = brush.painted["dryness"]
    assert page.work.look.painted == {"dryness": first}
    assert page._panels[0].params["dryness"].disabled
    changed = first.image != first.image.min()
    assert 20 < changed.sum() < 0.5 * changed.size and first.image.max() > 0.99
    drag(page, (0.5, 0.5), (0.6, 0.55), (0.65, 0.6), (-2.0, 0.5))
    assert (brush.painted["dryness"].image != first.image).sum() > 100
    brush._undo(None)
    assert brush.painted["dryness"] is first
    brush._clear(None)
    brush._clear(None)
    assert brush.painted == {} and not page._panels[0].params["dryness"].disabled
    brush._undo(None)
    assert brush.painted["dryness"] is first
    brush._undo(None)
    brush._undo(None)
    assert brush.painted == {} and page.work.look.painted == {} and not page._panels[0].params["dryness"].disabled


def test_names_of_files_are_no_html(page: Page):
    page.work.say("it", "<script>alert(1)</script> & more")
    assert page._fault.content == "&lt;script&gt;alert(1)&lt;/script&gt; &amp; more"
    page.work.say("it", "")


def test_growth_is_painted_too(page: Page, brush: Any):
    """Where the brush mows, nothing grows; the command line takes the image."""
    brush._name.value = "growth"
    brush._choose()
    assert brush._value.value == 0
    usual, brush._radius.value = brush._radius.value, 0.3
    for _ in range(3):
        drag(page, (0.5, 0.5), (0.5, 0.5))
    brush._radius.value = usual
    mown = brush.painted["growth"].image
    assert mown.min() < 0.01 and mown.max() == 1 and 20 < (mown < 1).sum() < 0.5 * mown.size
    camera = looking(page)
    scene = scene_of_look(page.work.begun, page.work.still, page.work.look, camera, False)
    assert scene.growth is mown
    faces = [len(growth_of(x).shell.faces) / len(growth_of(x).mesh.faces) for x in (scene, page.work.still)]
    assert faces[0] < faces[1]
    line = command(page.work.given, scene, page.work.look, "jax", 1)
    assert "--growth growth.exr" in line and "growth=" not in line
    for _ in range(3):
        brush._undo(None)
    assert brush.painted == {}
    brush._name.value = "dryness"
    brush._choose()


def test_a_ground_brighter_than_white_is_white(page: Page):
    usual, page._base.value = page._base.value, (105, 1900, -3)
    try:
        red, green, blue = page._look().base_colour
    finally:
        page._base.value = usual
    assert 0 < red < 1 and (green, blue) == (1, 0)


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (512, 512), (2000, 1000)])
def test_a_scenes_own_growth_is_painted_on(shape: tuple[int, int]):
    image = np.random.default_rng(0).random(shape).astype(np.float32)
    found = grown_so_far(image, 64)
    assert found.shape == (64, 64) and np.isin(found, image).all()
    np.testing.assert_array_equal(grown_so_far(None, 8), np.ones((8, 8)))


def test_what_was_taken_back_is_drawn_again(page: Page, brush: Any):
    drag(page, (0.5, 0.5), (0.5, 0.5))
    first = brush.painted["dryness"]
    drag(page, (0.6, 0.5), (0.6, 0.5))
    second = brush.painted["dryness"]
    for _ in range(3):
        brush._undo(None)
    for wanted in (first, second, second):
        brush._redo(None)
        assert brush.painted["dryness"] is wanted
    brush._undo(None)
    drag(page, (0.4, 0.5), (0.4, 0.5))
    third = brush.painted["dryness"]
    brush._redo(None)  # a new stroke has no other after it
    assert brush.painted["dryness"] is third


@pytest.mark.parametrize(("x", "sign"), [(0.35, -1), (0.65, 1)])
def test_a_stroke_paints_where_it_is_drawn(page: Page, brush: Any, x: float, sign: int):
    """Left and right of the picture's middle: what is painted most lies on that side of the mesh."""
    drag(page, (x, 0.5), (x, 0.5))
    place, texel, _ = brush._canvas._samples
    heavy = brush.painted["dryness"].image.ravel()[texel] > 0.9
    camera = looking(page)
    sideways = (place[heavy] + brush._canvas._centre - camera.to_world[:3, 3]) @ camera.to_world[:3, 0]
    assert heavy.any() and (sign * sideways > 0).all()


def test_an_angle_is_combed_along_the_stroke(page: Page, brush: Any, monkeypatch: pytest.MonkeyPatch):
    """To the right, by each face's own u and v; a click alone combs nothing."""
    angle = replace(brush._parameters["dryness"], unit="rad", range=(0.0, 2 * np.pi))
    monkeypatch.setitem(brush._parameters, "dryness", angle)
    drag(page, (0.5, 0.5), (0.5, 0.5))
    assert brush.painted == {}
    drag(page, *((x, 0.5) for x in np.linspace(0.4, 0.6, 30)))
    _, texel, face = brush._canvas._samples
    image = brush.painted["dryness"].image
    combed = np.flatnonzero(image.ravel()[texel] != np.median(image))
    du, dv = (brush._canvas._toward_uv[face[combed]] @ looking(page).to_world[:3, 0]).T
    off = (image.ravel()[texel[combed]] - np.arctan2(dv, du) / (2 * np.pi) + 0.5) % 1 - 0.5
    assert len(combed) > 100 and np.median(np.abs(off)) < 0.1


def test_a_stroke_beside_the_mesh_paints_nothing(page: Page, brush: Any):
    drag(page, (0.01, 0.01), (0.02, 0.01), (0.02, 0.02))
    assert brush.painted == {}


class Watching:
    """A client of viser's, as far as it is read: what it was shown."""

    def __init__(self, page: Page):
        self.client_id, self.scene, self.shown, self.changed = 7, self, [], threading.Condition()
        self.camera = Eye(looking(page))

    def set_background_image(self, image: np.ndarray, format: str, jpeg_quality: int) -> None:
        with self.changed:
            self.shown.append(image)
            self.changed.notify_all()

    def wait(self, until: Any) -> None:
        with self.changed:
            assert self.changed.wait_for(until, timeout=120)


@pytest.fixture
def watching(page: Page, monkeypatch: pytest.MonkeyPatch) -> Iterator[Watching]:
    seen = Watching(page)
    monkeypatch.setattr(page._server, "get_clients", lambda: {7: seen})
    page._connected(seen)
    yield seen
    page._with.value = "nothing"
    page._forget(7)


def test_a_picture_is_compared_with_another_quality(page: Page, watching: Watching, monkeypatch: pytest.MonkeyPatch):
    """Of equal pictures the errors are none; what shows something else is not compared with."""
    watching.wait(lambda: page.work.picture(7)[1])
    page._with.value = "reference"
    watching.wait(lambda: "reference: " in page._settings.cost.content)
    page._mode.value = "error"
    watching.wait(lambda: "FLIP" in page._settings.cost.content)
    compared_picture, same = page.work.picture(ComparisonView(7))
    assert same and compared_picture is not None
    page.work.leave(7)
    page.work.leave(ComparisonView(7))
    with monkeypatch.context() as patch:
        patch.setattr(page.work, "picture", lambda eye: (compared_picture, True))
        page._mode.value = "wipe"
        assert watching.shown[-1].max() == 255
        page._mode.value = "error"
        assert "FLIP 0.0000" in page._settings.cost.content and watching.shown[-1].max() < 10
        page._with.value = "nothing"
        assert page._settings.cost.content.count("a pixel") == 1 and watching.shown[-1].max() == 255
        patch.setattr(page.work, "picture", lambda eye: (compared_picture, eye == 7))
        page._with.value = "draft"
        assert page._settings.cost.content.endswith("draft: under way")


def test_a_field_of_quality_says_what_it_costs(page: Page, watching: Watching):
    panel, work, fields = page._settings, page.work, page._settings._fields

    watching.wait(lambda: panel._views)
    assert fields["samples"].visible and not fields["environment_samples"].visible and "max_depth" not in fields
    assert "pixel_samples" not in fields and "density" not in fields
    fields["samples"].value = 6
    fields["samples"].value = 7  # of which alone a picture is seen
    assert work.look.changes == {"samples": 7} and panel._said.content == "`samples` 4 → 7: under way"
    watching.wait(lambda: "evaluations a ray" in panel._said.content)
    found = re.fullmatch(
        r"`samples` 4 → 7: \d+ → \d+ ms a pass, ([\d.]+) → ([\d.]+) evaluations a ray", panel._said.content
    )
    assert found is not None and float(found[2]) > 1.3 * float(found[1])
    picture, _ = work.picture(7)
    assert picture is not None and picture.rendered.record["quality"]["samples"] == 7
    fields["visibility"].value = "sample"
    assert work.look.changes == {"samples": 7, "visibility": "sample"}
    for name, wrong in (("early_stop", 2.0), ("early_stop", float("nan")), ("samples", -3), ("samples", 10**9)):
        fields[name].value = wrong
        assert work.look.changes == {"samples": 7, "visibility": "sample"} and name in panel._said.content
        assert fields[name].value == getattr(work.look.settings, name)  # what is used
    told = panel._said.content
    shown = len(watching.shown)
    watching.wait(lambda: len(watching.shown) > shown + 2)
    assert panel._said.content == told  # until there is another change
    panel._preset.value = "draft"
    assert work.look.quality == "draft" and work.look.changes == {} and fields["samples"].value == 4
    panel._preset.value = "normal"


def test_costs_of_other_views_are_not_compared(page: Page, watching: Watching, monkeypatch: pytest.MonkeyPatch):
    panel, fields = page._settings, page._settings._fields

    watching.wait(lambda: panel._views)
    fields["samples"].value = 5
    watching.wait(lambda: "ms a pass" in panel._said.content)
    views = list(panel._views)
    watching.camera.position = watching.camera.position * 1.1
    page._moved(watching)
    watching.wait(lambda: panel._views[-1] is not views[-1])
    assert len(panel._views[-1][1]) == 1
    picture, views = page.work.picture(7)[0], list(panel._views)
    assert picture is not None
    for samples, more in ((1, 0), (2, 1)):  # the first pass has what came before it
        other = replace(picture.camera, fov=0.3, to_world=picture.camera.to_world + np.eye(4))
        panel.see(picture._replace(samples=samples, camera=other), page.work.look)
        assert sum(view is not views[-1] for view in list(panel._views)[-1:]) == more
    panel._preset.value = "draft"
    panel._preset.value = "normal"


@pytest.mark.parametrize(
    ("side", "current", "whole"), [(128, True, True), (64, True, True), (128, False, True), (128, True, False)]
)
def test_a_picture_that_is_under_way_is_not_saved(page: Page, watching: Watching, monkeypatch, side, current, whole):
    watching.wait(lambda: page.work.picture(7)[0] is not None)
    made = page.work.picture(7)[0]
    assert made is not None
    shown = made._replace(rgba=np.zeros((side, side, 4), np.float32), whole=whole)
    monkeypatch.setattr(page.work, "picture", lambda eye: (shown, current))
    monkeypatch.setattr(downloads, "PATIENCE", 0.3)
    sent: list[str] = []
    client = SimpleNamespace(send_file_download=lambda name, data, save_immediately: sent.append(name))
    page._downloads._picture("png", SimpleNamespace(client_id=7, client=client))
    assert sent == (["mesoshell.png"] if (side, current, whole) == (128, True, True) else [])
    assert page._fault.content == ("" if sent else "the picture is not whole yet: save it later")
    page.work.say("save", "")


def test_an_image_lights_the_scene(page: Page):
    sky = np.full((4, 8, 3), 0.5, np.float32)
    page._light.take(viser.UploadedFile("C:\\skies\\noon sky.exr", exr_bytes(sky)))
    try:
        look = page.work.look
        assert look.sky is not None and look.sky.name == "noon sky.exr"
        np.testing.assert_array_equal(look.sky.radiance, sky)
        page._light.take(viser.UploadedFile("../x.exr", b"no image"))
        assert (
            page._fault.content == "x.exr: is neither an OpenEXR file nor one of Radiance (.hdr)"
            and page.work.look.sky is look.sky
        )
        page._light.take(viser.UploadedFile("<img src=x onerror=alert(1)>`\n.exr", exr_bytes(-sky)))
        said = page._fault.content
        assert (
            said.startswith("_img src_x onerror_alert_1____.exr: holds negative light")
            and page.work.look.sky is look.sky
        )
        page._light.take(viser.UploadedFile("", exr_bytes(sky)))
        look = page.work.look
        assert page._fault.content == "" and look.sky is not None and look.sky.name == "environment.exr"
    finally:
        page._light.under.value = False
    assert page.work.look.sky is None


def test_a_material_stands_beside_another(tiny_bundle: Bundle, monkeypatch: pytest.MonkeyPatch):
    """With values of its own, and the light and the camera of both."""
    monkeypatch.setattr(refining, "COARSE", 64)
    monkeypatch.setattr(refining, "PRESETS", dict.fromkeys(refining.PRESETS, ms.Quality(samples=4, pixel_samples=1)))
    scene = ms.Scene(MESH, Material("tiny", tiny_bundle), scale=0.4, params={"dryness": 0.3})
    page = Page(scene, port=free_port(), beside=ms.Scene(MESH, Material("other", tiny_bundle), scale=0.8))
    page._settings._side.value = "128"
    try:
        assert page.beside is not None and page._other is not None and page._with.value == "other"
        seen = Watching(page)
        monkeypatch.setattr(page._server, "get_clients", lambda: {7: seen})
        page._connected(seen)
        beside = page.beside
        seen.wait(lambda: page._settings.cost.content.count("a pixel") == 2)
        page._other.params["dryness"].value = 0.9
        page._light.sun.on.value = True
        assert page.work.look.params == {"dryness": 0.3} and page.beside.look.params == {"dryness": 0.9}
        assert page.beside.look.sun == page.work.look.sun is not None
        assert page.work.look.thickness is not None and page.beside.look.thickness == 2 * page.work.look.thickness
        seen.wait(lambda: beside.picture(ComparisonView(7))[1] and page.work.picture(7)[1])
        page._with.value = "nothing"
        assert not beside._views
    finally:
        page.close()
    assert not any(thread.is_alive() for work in (page.work, beside) for thread in work._threads)


def test_each_material_of_a_scene_has_sliders_and_a_brush(tiny_bundle: Bundle, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(refining, "COARSE", 64)
    monkeypatch.setattr(refining, "PRESETS", dict.fromkeys(refining.PRESETS, ms.Quality(samples=4, pixel_samples=1)))
    away = wearing.moved(load_mesh(MESH), 3.0, 0.0, 0.0)
    stone = ms.Grown(away, Material("moss", tiny_bundle), scale=0.4, params={"dryness": 0.2}, name="far/stone")
    page = Page(
        ms.Scene(MESH, Material("tiny", tiny_bundle), scale=0.4, params={"dryness": 0.3}, also=[stone]),
        port=free_port(),
    )
    try:
        assert [panel.folder.label for panel in page._panels] == ["Material: tiny", "Material: moss on far/stone"]
        page._panels[1].params["dryness"].value = 0.9
        assert page.work.look.params == {"dryness": 0.3} and page.work.look.also[0].params == {"dryness": 0.9}
        brush = page._brushes[1]
        brush.prepare()
        camera = page.work.still.camera
        assert isinstance(camera, ms.Camera)
        middle = away.vertices.mean(axis=0).astype(float)
        eye = middle + 8 * camera.to_world[:3, 2]
        near = ms.Camera(ms.look_at(tuple(eye), tuple(middle)), 0.6, 60, 60)
        brush.begin(1, near, np.array([30.0, 30.0]))
        brush.end(1)
        own, other = page.work.look.parts
        assert set(other.painted) == {"dryness"} and not own.painted and page._panels[1].params["dryness"].disabled
        sent: dict[str, bytes] = {}
        event = SimpleNamespace(
            client=SimpleNamespace(send_file_download=lambda name, data, **how: sent.update({name: data}))
        )
        brush._download(event)
        (file,) = sent
        assert re.fullmatch(r"far_stone-[0-9a-f]{8}_dryness\.exr", file)
        shown = scene_of_look(page.work.begun, page.work.still, page.work.look, near, False)
        assert isinstance(shown.also[0].params["dryness"], np.ndarray) and shown.params == {"dryness": 0.3}
        assert f"far/stone:dryness={file}" in command(page.work.given, shown, page.work.look, "jax", 1)
    finally:
        page.close()


def test_a_scene_of_mitsuba_s_is_downloaded(tiny_bundle: Bundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """What is painted is in it; a material that is in no file is said."""
    monkeypatch.setattr(refining, "PRESETS", dict.fromkeys(refining.PRESETS, ms.Quality(samples=4, pixel_samples=1)))
    write_bundle(tmp_path / "tiny.npz", tiny_bundle)
    for material in (ms.load_material(tmp_path / "tiny.npz"), Material("tiny", tiny_bundle)):
        page = Page(ms.Scene(MESH, material, scale=0.4), port=free_port())
        try:
            drag(page, (0.5, 0.5), (0.5, 0.5))
            page.work.see(1, looking(page))
            monkeypatch.setattr(page.work, "picture", lambda eye: (eye, True))
            sent: dict[str, bytes] = {}
            page._downloads._scene(Asked(sent))
            if material.name == "tiny":
                assert (
                    not sent
                    and page._fault.content == "tiny: is a material in no file: write its bundle, and load that"
                )
            else:
                with zipfile.ZipFile(io.BytesIO(sent["scene.zip"])) as file:
                    assert {"scene/scene.xml", "scene/param0.exr", "scene/material.npz"} <= set(file.namelist())
        finally:
            page.close()


def test_the_command_says_its_faults(tiny_bundle: Bundle, tmp_path: Path, capsys: pytest.CaptureFixture, page: Page):
    write_bundle(tmp_path / "tiny.npz", tiny_bundle)
    port = page.url.rpartition(":")[2]
    for given, said in (
        (["scene.xml"], "scene.xml: is a scene of Mitsuba's, which requires --engine mitsuba"),
        (["scene.xml", "--engine", "mitsuba"], "scene.xml: no such file"),
        (["scene.xml", "--engine", "mitsuba", "--up", "z"], "--up: is set in scene.xml"),
        (
            ["scene.xml", "--engine", "mitsuba", "--beside", "fur"],
            "--beside: scene.xml is a scene of Mitsuba's, which has",
        ),
        (
            [MESH, "--material", tmp_path / "tiny.npz", "--port", port],
            f"--port: 127.0.0.1:{port} cannot be listened on",
        ),
        ([tmp_path / "none.obj", "--material", tmp_path / "tiny.npz", "--port", free_port()], "none.obj: no such file"),
    ):
        capsys.readouterr()
        with pytest.raises(SystemExit) as caught:
            main(["view", *map(str, given)])
        assert caught.value.code == 2
        fault = capsys.readouterr().err
        assert said in fault and fault.count("\n") == 1


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("no browser (chromium)")
    driver = pytest.importorskip("playwright.sync_api", reason="no driver of browsers (playwright)")
    with driver.sync_playwright() as running:
        yield running.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--enable-unsafe-swiftshader"])


def picture(tab: Any) -> np.ndarray:
    """What lies behind the panel, left of it."""
    shot = Image.open(io.BytesIO(tab.screenshot())).convert("RGB")
    return np.asarray(shot, np.float64)[:, : shot.width // 2]


def settles(tab: Any, until: Any, seconds: float = 60.0) -> np.ndarray:
    """The first picture for which this holds."""
    end = time.monotonic() + seconds
    while not until(seen := picture(tab)):
        assert time.monotonic() < end, "the picture never came"
        time.sleep(0.3)
    return seen


def handle_of_the_sun(page: Page) -> np.ndarray:
    """Where the first client sees it, in pixels."""
    client = next(iter(page._server.get_clients().values()))
    camera = camera_of(client.camera)
    assert camera is not None
    x, y, z, _ = np.linalg.inv(camera.to_world) @ [*page._light.sun._handle.position, 1]
    return np.array([camera.width / 2 - x / z / camera.spread, camera.height / 2 + y / z / camera.spread])


@pytest.mark.slow
def test_in_a_browser(page: Page, browser: Any):
    tab, other = (browser.new_page(viewport={"width": 900, "height": 600}) for _ in range(2))
    tab.goto(page.url)
    first = settles(tab, lambda x: x.std() > 10)
    tab.get_by_text("sun", exact=True).wait_for()
    tab.get_by_role("checkbox").first.click()
    lit = settles(tab, lambda x: np.abs(x - first).mean() > 1)
    sun = page.work.look.sun
    x, y = handle_of_the_sun(page)
    tab.mouse.move(x, y)
    tab.mouse.down()
    tab.mouse.move(x + 40, y + 30, steps=6)
    tab.mouse.up()
    lit = settles(tab, lambda x: np.abs(x - lit).mean() > 1)
    assert page.work.look.sun != sun and np.hypot(*(handle_of_the_sun(page) - [x + 40, y + 30])) < 10
    tab.mouse.move(200, 300)
    tab.mouse.down()
    tab.mouse.move(320, 330, steps=4)
    tab.mouse.up()
    settles(tab, lambda x: np.abs(x - lit).mean() > 1)
    other.goto(page.url)
    settles(other, lambda x: x.std() > 10)
    other.mouse.down()
    other.close()  # in the midst of a frame
    before = picture(tab)
    tab.get_by_role("checkbox").first.click()
    settles(tab, lambda x: np.abs(x - before).mean() > 1)
    with tab.expect_download(timeout=60_000) as saved:
        tab.get_by_role("button", name="PNG").click()
    with Image.open(saved.value.path()) as kept:
        assert kept.format == "PNG"
    tab.get_by_role("button", name="Command").click()
    tab.get_by_text("mesoshell render").wait_for()
    tab.get_by_text("Paint", exact=True).click()
    tab.get_by_text("brush", exact=True).wait_for()
    tab.get_by_role("checkbox").first.click()
    time.sleep(2)  # the mesh that catches drags is on its way
    tab.mouse.move(300, 300)
    tab.mouse.down()
    tab.mouse.move(330, 310, steps=6)
    tab.mouse.up()
    end = time.monotonic() + 60
    while not page.work.look.painted:
        assert time.monotonic() < end, "nothing was painted"
        time.sleep(0.2)
    assert np.ptp(page.work.look.painted["dryness"].image) > 0.3
    tab.close()


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_a_minute_of_random_input(page: Page, browser: Any, seed: int):
    """Clicks, drags, keys and wheels anywhere, by two clients of which one comes and goes: no error in the page or here, no
    thread that ends, no growth of memory to speak of; and at the end the picture still follows the camera."""
    random, faults, sizes = np.random.default_rng(seed), [], []
    hooked, threading.excepthook = threading.excepthook, lambda args: faults.append(repr(args.exc_value))
    tab = browser.new_page(viewport={"width": 900, "height": 600})
    left = "The user aborted a request"  # a dialog of the browser's, by a key
    tab.on("pageerror", lambda fault: None if left in str(fault) else faults.append(str(fault)))
    tab.goto(page.url)
    settles(tab, lambda x: x.std() > 10)
    other, end = None, time.monotonic() + 60
    try:
        while time.monotonic() < end:
            if random.random() < 0.02:
                if other is None:
                    other = browser.new_page(viewport={"width": 500, "height": 400})
                    other.goto(page.url)
                else:
                    other.close()
                    other = None
            poke(tab if other is None or random.random() < 0.7 else other, random)
            sizes.append(resident())
    finally:
        threading.excepthook = hooked
        if other is not None:
            other.close()
    assert not faults and all(thread.is_alive() for thread in page.work._threads)
    assert not [said for said in page.work._faults.values() if re.match(r"\w*(Error|Exception)\b", said)]
    early, late = np.array_split(sizes[len(sizes) // 4 :], 2)  # at first it compiles for each size of picture
    assert late.max() < early.max() + 300 * 2**20
    tab.reload()
    before = settles(tab, lambda x: x.std() > 5)
    end = time.monotonic() + 60
    while np.abs(picture(tab) - before).mean() < 0.5:
        assert time.monotonic() < end, "the picture stands still"
        tab.mouse.move(200, 300)
        tab.mouse.down()
        tab.mouse.move(290, 330, steps=4)
        tab.mouse.up()
        time.sleep(1)
    tab.close()


def poke(tab: Any, random: np.random.Generator) -> None:
    """One random thing that a user may do."""
    x, y, u, v = (float(k) for k in random.random(4) * [900, 600, 900, 600])
    kind = random.integers(6)
    if kind == 0:
        tab.mouse.click(x, y)
    elif kind == 1:
        tab.mouse.move(x, y)
        tab.mouse.down()
        tab.mouse.move(u, v, steps=3)
        tab.mouse.up()
    elif kind == 2:
        tab.mouse.move(x, y)
        tab.mouse.wheel(0, float(random.integers(-300, 300)))
    elif kind == 3:
        tab.keyboard.press(str(random.choice(["Tab", "Escape", "ArrowLeft", "ArrowUp", "Backspace", "7", "-", "."])))
    elif kind == 4:
        tab.mouse.click(750 + x / 9, y)  # the panel
    else:
        tab.mouse.move(750 + x / 9, y)
        tab.mouse.down()
        tab.mouse.move(750 + u / 9, y + 3, steps=2)
        tab.mouse.up()


def resident() -> int:
    """Bytes of this process's memory."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
