"""A scene of Mitsuba's XML is seen from anywhere as one whose sensor stands there."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.render.camera import Camera, look_at
from mesoshell.render.quality import PRESETS
from mesoshell.scene.render_paths import MovedFile, prepare_file
from mesoshell.viewer.moved_file import FileLook, refine_file
from tests.helpers.ports import free_port

pytest.importorskip("viser", reason="the viewer's extra is not installed: pip install mesoshell[viewer]")
from mesoshell.viewer.file_page import FilePage, sensor_xml

MESH = Path(__file__).parents[1] / "data" / "suzanne.obj"
DRAFT = PRESETS["draft"].with_changes(density="network")
ELSEWHERE = Camera(look_at((-5.0, 3.0, 8.0), (-2.4, 1.2, 4.1)), 0.6, 24, 16)


@pytest.fixture(scope="module")
def path(tiny_bundle: Bundle, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A head with a shell, and a turned and scaled sensor that says its horizontal angle."""
    folder = tmp_path_factory.mktemp("scene")
    write_bundle(folder / "tiny.npz", tiny_bundle)
    material, camera = ms.load_material(folder / "tiny.npz"), (0.5, 2.5, 9.0, -2.5, 1.25, 4.1, 30.0)
    return ms.write_scene(
        ms.Scene(MESH, material, scale=0.4, camera=camera, size=(20, 16)), folder / "made", quality="draft"
    )


def with_sensor(path: Path, sensor: str, name: str) -> Path:
    text = path.read_text()
    begin, end = text.index("<sensor"), text.index("</sensor>") + len("</sensor>")
    out = path.with_name(name)
    out.write_text(text[:begin] + sensor + text[end:])
    return out


def seen(passes: Any) -> np.ndarray:
    height, width = passes.shape
    return passes.render(0, np.arange(height * width), lambda share: None).reshape(height, width, 4)


def test_from_its_own_sensor_it_is_the_files_picture(path: Path):
    moved = MovedFile(path, DRAFT)
    assert (moved.camera.width, moved.camera.height) == (20, 16) and moved.effects is not None
    wanted = seen(prepare_file(path, DRAFT, 1).passes(None))
    np.testing.assert_allclose(seen(moved.passes(moved.camera, DRAFT)), wanted, atol=1e-4)
    assert wanted[..., 3].min() < wanted[..., 3].max()


def test_from_elsewhere_it_is_that_of_a_sensor_there(path: Path):
    """Which is what the page saves; and back again it is as before."""
    moved = MovedFile(path, DRAFT)
    first = seen(moved.passes(moved.camera, DRAFT))
    sides = '<integer name="width" value="24"/><integer name="height" value="16"/>'
    film = f'<film type="hdrfilm">{sides}<rfilter type="box"/></film>'
    text = sensor_xml(ELSEWHERE).replace("</sensor>", f'{film}<sampler type="independent"/></sensor>')
    there = with_sensor(path, text, "there.xml")
    wanted = seen(prepare_file(there, DRAFT, 1).passes(None))
    found = seen(moved.passes(ELSEWHERE, DRAFT))
    np.testing.assert_allclose(found[..., :3], wanted[..., :3], atol=1e-3)
    assert np.abs(found[..., :3]).max() > 0.05 and found.shape != first.shape
    np.testing.assert_array_equal(seen(moved.passes(moved.camera, DRAFT)), first)


def test_eyes_take_turns(path: Path):
    """Each has its own picture, whatever another one sees between its passes."""
    moved = MovedFile(path, DRAFT)
    alone = [seen(moved.passes(camera, DRAFT)) for camera in (moved.camera, ELSEWHERE)]
    both = [moved.passes(camera, DRAFT) for camera in (moved.camera, ELSEWHERE)]
    for wanted, passes in zip(alone, both, strict=True):
        np.testing.assert_array_equal(seen(passes), wanted)


def test_sensors_that_cannot_be_moved_are_refused(path: Path):
    flat = with_sensor(path, '<sensor type="orthographic"/>', "flat.xml")
    with pytest.raises(InputError, match=r"flat\.xml: its first sensor is no perspective one"):
        MovedFile(flat, DRAFT)
    crop = "".join(f'<integer name="crop_{x}" value="4"/>' for x in ("width", "height"))
    cropped = with_sensor(
        path, f'<sensor type="perspective"><film type="hdrfilm">{crop}</film></sensor>', "cropped.xml"
    )
    with pytest.raises(InputError, match=r"cropped\.xml: its film is cropped"):
        MovedFile(cropped, DRAFT)


def test_pictures_refine_until_nobody_waits(path: Path):
    moved, stops = MovedFile(path, DRAFT), [False]
    wide = Camera(ELSEWHERE.to_world, ELSEWHERE.fov, 300, 200)
    pictures = refine_file(moved, FileLook("draft", 160), wide, lambda: stops[0])
    shapes = [(x.rgba.shape[:2], x.paths) for x, _ in zip(pictures, range(3), strict=False)]
    assert shapes == [((85, 128), 1), ((107, 160), 1), ((107, 160), 2)]
    stops[0] = True
    assert list(pictures) == []


@pytest.fixture
def page(path: Path) -> Iterator[FilePage]:
    made = FilePage(MovedFile(path, DRAFT), port=free_port())
    yield made
    made.close()


def test_a_page_shows_it(page: FilePage):
    page.work._show = lambda eye: None  # no browser looks
    page._side.value = "128"
    page.work.see(1, ELSEWHERE)
    end = time.monotonic() + 120
    while page.work.picture(1)[0] is None and time.monotonic() < end:
        time.sleep(0.02)
    picture, _ = page.work.picture(1)
    assert picture is not None and max(picture.rgba.shape) == 128
    assert "Error" not in page._fault.content  # it has the file's notes
    begin = page._server.initial_camera
    camera = page.work.file.camera
    np.testing.assert_allclose(begin.position, camera.to_world[:3, 3])
    away = np.linalg.norm(begin.look_at - camera.to_world[:3, 3])
    assert (
        3 < away < 6
    )  # to the head, whatever else stands in the scene; at most a thousandth of it is too near to be drawn
    assert begin.near < 0.01 * away
