"""A captured object's pictures are those that `atlas render` makes; a stroke lands where it was drawn, on the texture too."""

import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import mesoshell as ms
from mesoshell.cli.main import main
from mesoshell.errors import InputError
from mesoshell.io.image import exr_bytes, png_bytes
from mesoshell.neutex.edit import paint_of, read_edit
from mesoshell.neutex.field import Field
from mesoshell.neutex.render import picture, view
from mesoshell.neutex.store import NeuTexModel, write_neutex
from tests.helpers.octahedron import CONFIG, PHOTO, model, octahedron
from tests.helpers.ports import free_port

pytest.importorskip("viser", reason="requires the extra viewer")

from mesoshell.viewer import captured, texture_brush
from mesoshell.viewer.captured import CapturedObject, ObjectLook, photo_of, refine_object
from mesoshell.viewer.look import Painting
from mesoshell.viewer.object_page import ObjectPage
from mesoshell.viewer.texture_brush import TEXTURE

pytestmark = [pytest.mark.filterwarnings("ignore::DeprecationWarning"), pytest.mark.usefixtures("optimised")]
SIDE, CENTRE, HALF = 16, (3.0, -1.0, 2.0), 2.0
RED = [1.0, 0.0, 0.0, 1.0]


@pytest.fixture(autouse=True, scope="module")
def _small():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mesoshell.neutex.render.TILE", 256)
        patch.setattr(captured, "RAYS", 512)
        patch.setattr(captured, "QUADS", 8)
        for module in (captured, texture_brush):
            patch.setattr(module, "SIDE", SIDE)
        yield


def placed(field: Field, **changes: Any) -> NeuTexModel:
    """In a world of its own units, so dense that a ray ends where it enters."""
    dense = field.sigma._replace(last=field.sigma.last._replace(bias=field.sigma.last.bias.at[0].set(60.0)))
    m = PHOTO.to_world.copy()
    m[:3, 3] = np.array(CENTRE) + HALF * m[:3, 3]
    made = model(field._replace(sigma=dense), centre=CENTRE, half=HALF)
    return replace(
        made, photos=(PHOTO._replace(to_world=m),), tested=(), provenance={"config": {"samples": 32}}, **changes
    )


@pytest.fixture(scope="module")
def thing() -> NeuTexModel:
    field: Any = octahedron()
    return placed(field._replace(view=jax.tree.map(jnp.zeros_like, field.view)))


def camera(thing: NeuTexModel, side: int = 24) -> ms.Camera:
    return ms.Camera(thing.photos[0].to_world, 0.7, side, side)


def never() -> bool:
    return False


def test_a_picture_is_what_render_makes(thing: NeuTexModel):
    """Whose rays are cut into parts, and begin coarse."""
    captured_object, look = CapturedObject(thing), ObjectLook(side=40)
    first, second = refine_object(captured_object, look, camera(thing), never, 2)
    assert (first.rays, second.rays, first.samples) == (1, 2, 32)
    photo = photo_of(ms.Camera(thing.photos[0].to_world, 0.7, 40, 40))
    how = view(thing.config, thing.field, thing.quality("draft"))
    wanted = picture(thing.config, thing.field, thing.to_box(photo), how).rgba
    np.testing.assert_allclose(first.rgba, wanted, atol=1e-5)
    assert 0.1 < wanted[..., 3].mean() < 0.99 and not np.allclose(first.rgba, second.rgba)
    steps = [
        (x.rgba.shape[0], x.samples)
        for x in refine_object(captured_object, ObjectLook(side=256), camera(thing), never, 1)
    ]
    assert steps == [(128, 16), (256, 32)]
    assert list(refine_object(captured_object, look, camera(thing), lambda: True)) == []


def test_paint_is_what_an_edited_texture_shows(thing: NeuTexModel):
    image = np.random.default_rng(0).uniform(0, 1, (2 * SIDE, 3 * SIDE, 4)).astype(np.float32)
    image[..., :3] *= image[..., 3:]
    look = ObjectLook(Painting(image), side=24)
    (found,) = refine_object(CapturedObject(thing), look, camera(thing), never, 1)
    how = view(thing.config, thing.field, thing.quality("draft"), paint_of(thing, "cubemap", image, "replace"))
    wanted = picture(thing.config, thing.field, thing.to_box(photo_of(camera(thing))), how).rgba
    np.testing.assert_allclose(found.rgba, wanted, atol=1e-5)


def run_of(run: Path, **models: NeuTexModel) -> Path:
    """A run's folder, with snapshots by thousands of rays."""
    (run / "snapshots").mkdir(parents=True)
    (run / "config.json").write_text(json.dumps({"method": "atlas", "config": {}, "data": {}}))
    for name, made in models.items():
        write_neutex(run / "snapshots" / f"{int(name[1:]):09d}.npz", made)
    return run


@pytest.fixture(scope="module")
def folder(thing: NeuTexModel, tmp_path_factory: pytest.TempPathFactory) -> Path:
    sigma = thing.field.sigma
    thin = thing.field._replace(sigma=sigma._replace(last=sigma.last._replace(bias=sigma.last.bias.at[0].set(6.0))))
    return run_of(tmp_path_factory.mktemp("runs") / "octahedron", k1000=replace(thing, field=thin), k2000=thing)


@pytest.fixture(scope="module")
def page(folder: Path) -> Iterator[ObjectPage]:
    made = ObjectPage(folder, folder / "snapshots" / "000002000.npz", port=free_port())
    made._side.value = "128"
    yield made
    made.close()


@pytest.fixture
def brush(page: ObjectPage) -> Iterator[Any]:
    assert page._brush is not None
    page._brush.prepare()
    page._brush._colour.value = (255, 0, 0)
    yield page._brush
    while page._brush.painted:
        page._brush._undo(None)


def stroke(page: ObjectPage, brush: Any, x: float, y: float) -> None:
    seen = camera(page.work.object.model, 60)
    brush.begin(1, seen, np.array([x, y]))
    brush.end(1)


def seen_by(page: ObjectPage) -> np.ndarray:
    (shown,) = refine_object(
        page.work.object, replace(page.work.look, side=24), camera(page.work.object.model), never, 1
    )
    return shown.rgba


def test_a_stroke_lands_where_it_was_drawn(page: ObjectPage, brush: Any):
    before, texture = seen_by(page), page._image.image.copy()
    stroke(page, brush, 30.0, 30.0)
    assert page.work.look.painted is brush.painted[TEXTURE]
    after = seen_by(page)
    changed = np.abs(after - before).max(axis=-1)
    assert changed[10:14, 10:14].min() > 0.1 and (after[11:13, 11:13, 0] > after[11:13, 11:13, 2] + 0.3).all()
    np.testing.assert_allclose(after[..., 3], before[..., 3], atol=1e-5)
    y, x = np.nonzero(changed > 0.05)
    assert abs(y.mean() - 11.5) < 1.5 and abs(x.mean() - 11.5) < 1.5 and len(y) < 150
    assert 0 < (page._image.image != texture).any(axis=-1).mean() < 0.3
    brush._undo(None)
    assert page.work.look.painted is None
    np.testing.assert_array_equal(seen_by(page), before)
    np.testing.assert_array_equal(page._image.image, texture)
    brush._redo(None)
    np.testing.assert_array_equal(seen_by(page), after)


def test_no_cover_takes_paint_off(page: ObjectPage, brush: Any):
    brush.put(png_bytes(np.broadcast_to(np.array(RED, np.float32), (8, 16, 4))), "red.png")
    painted = brush.painted[TEXTURE].image
    np.testing.assert_allclose(painted, np.broadcast_to(RED, painted.shape), atol=1e-6)
    brush._cover.value = 0.0
    stroke(page, brush, 30.0, 30.0)
    brush._cover.value = 1.0
    assert 0.0 <= brush.painted[TEXTURE].image.min() < 0.2 and brush.painted[TEXTURE].image[..., 3].max() == 1


def test_images_of_any_layout_are_paint(page: ObjectPage, brush: Any):
    """By what their directions are; faults are said."""
    image = np.zeros((64, 128, 4), np.float32)
    image[:, 64:] = RED
    brush.put(exr_bytes(image), "half.exr")
    u = texture_brush.directions("cubemap", SIDE)
    half = np.where(u[..., 1] > 0, 1.0, 0.0)
    away = np.abs(brush.painted[TEXTURE].image[..., 0] - half)
    assert away[np.abs(u[..., 1]) > 0.15].max() < 1e-3
    for data, said in [
        (b"no image", "the image: "),
        (exr_bytes(np.full((8, 16, 4), 2.0, np.float32)), "the image: has coverage"),
        (png_bytes(np.ones((5, 7, 3), np.float32)), "the image: is 7 x 5 pixels, the proportions of no"),
        (exr_bytes(np.full((8, 16, 3), np.nan, np.float32)), "the image: has pixels that are not finite"),
    ]:
        with pytest.raises(InputError, match=said):
            brush.put(data, "the image")
        page._take_image(SimpleNamespace(target=SimpleNamespace(value=SimpleNamespace(content=data))))
        assert page._fault.content.startswith(said)
    page._take_image(SimpleNamespace(target=SimpleNamespace(value=SimpleNamespace(content=exr_bytes(image)))))
    assert page._fault.content == ""


def test_what_is_saved_can_be_rendered(page: ObjectPage, brush: Any, tmp_path: Path):
    stroke(page, brush, 30.0, 30.0)
    sent: dict[str, bytes] = {}
    event: Any = SimpleNamespace(
        client_id=1, client=SimpleNamespace(send_file_download=lambda name, data, **how: sent.update({name: data}))
    )
    page._save_paint(event)
    page._save_texture(event)
    (tmp_path / "paint.exr").write_bytes(sent["paint.exr"])
    layout, image = read_edit(tmp_path / "paint.exr", None)
    assert layout == "cubemap"
    np.testing.assert_allclose(image, brush.painted[TEXTURE].image, atol=0.01)
    (tmp_path / "texture.png").write_bytes(sent["texture.png"])
    shown = page.work.object.shown(page.work.look)
    np.testing.assert_allclose(read_edit(tmp_path / "texture.png", None)[1], np.clip(shown, 0, 1), atol=0.01)


def test_clients_see_pictures_and_other_snapshots(page: ObjectPage, monkeypatch: pytest.MonkeyPatch):
    shown: list[np.ndarray] = []
    pose = camera(page.work.object.model, 64)
    rotation = pose.to_world[:3, :3] * [1, -1, -1]
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat()
    eye = SimpleNamespace(
        image_width=64,
        image_height=64,
        fov=0.7,
        wxyz=(w, x, y, z),
        position=pose.to_world[:3, 3],
        on_update=lambda call: None,
    )
    client: Any = SimpleNamespace(
        client_id=5, camera=eye, scene=SimpleNamespace(set_background_image=lambda image, **how: shown.append(image))
    )
    monkeypatch.setattr(page._server, "get_clients", lambda: {5: client})
    page._connected(client)
    wait(lambda: len(shown) > 1)
    assert shown[-1].shape == (128, 128, 3) and shown[-1].std() > 10 and "32 samples a ray" in page._cost.content
    assert page._run is not None
    before, old = seen_by(page), page.work.object
    assert page._brush is not None
    page._brush._on.value = True
    assert page._brush._of is old.mesh
    page._run._which.value = "1 kimg"
    page._run.refresh()
    wait(lambda: page.work.object is not old)
    count = len(shown)
    wait(lambda: len(shown) > count + 1)
    assert not np.allclose(seen_by(page), before, atol=0.01)
    wait(lambda: page._brush is not None and page._brush._of is page.work.object.mesh)
    page._brush._on.value = False
    page._run._which.value = "newest"
    page._run.refresh()
    page.work.leave(5)


def test_a_surface_that_cannot_be_painted_on_is_said(page: ObjectPage, monkeypatch: pytest.MonkeyPatch):
    def fails(*given: Any) -> Any:
        raise InputError("the object", "has no faces")

    there = page.work.object
    assert page._brush is not None
    with monkeypatch.context() as patch:
        patch.setattr(captured, "check_mesh", fails)
        page.work.set_object(CapturedObject(there.model))
        page._brush._on.value = True
        assert not page._brush._on.value and page._fault.content == "the object: has no faces"
    page.work.set_object(there)
    page._brush._on.value = True
    assert page._brush._on.value and page._fault.content == ""
    page._brush._on.value = False


def wait(until: Any) -> None:
    end = time.monotonic() + 120
    while not until():
        assert time.monotonic() < end
        time.sleep(0.02)


@pytest.mark.parametrize("colour", ["volume", pytest.param("reflectance", marks=pytest.mark.slow)])
def test_what_an_object_has_not_has_no_control(colour: Any, tmp_path: Path):
    config = replace(CONFIG, colour=colour, flash=1.0)
    run = run_of(tmp_path / "run", k2000=replace(placed(octahedron(config)), config=config))
    page = ObjectPage(run, run / "snapshots" / "000002000.npz", port=free_port())
    try:
        assert (page._brush is None) is (colour == "volume") and (page._sun is None) is (colour == "volume")
        before = seen_by(page)
        if page._sun is not None:
            page._sun.on.value = True
            assert page.work.look.sun == (-40.0, 45.0) and not np.allclose(seen_by(page), before)
    finally:
        page.close()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["{run}", "--thickness", "0.1"], "--thickness: is of a scene, and {run} is an object"),
        (["{run}", "--material", "pelt"], "--material: is of a scene, and {run} is an object"),
        (["{run}", "--no-suns"], "--no-suns: is of a scene, and {run} is an object"),
        (["{run}", "--beside", "pelt"], "--beside: is of a scene, and {run} is an object"),
        (
            ["x.obj", "--material", "{run}"],
            "--material: {run} is a run of an object, which is no material: give it as the mesh",
        ),
        (["{run}", "--port", "0"], "--port: must be from 1 to 65535, not 0"),
    ],
)
def test_the_command_says_its_faults(options: list[str], said: str, folder: Path, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as caught:
        main(["view", *(x.format(run=folder) for x in options)])
    assert caught.value.code == 2 and capsys.readouterr().err == f"mesoshell: {said.format(run=folder)}\n"
