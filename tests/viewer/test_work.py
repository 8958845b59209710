"""Pictures refine, are abandoned when nobody waits, and textures grow beside them; no client holds up another."""

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.errors import InputError
from mesoshell.io.bundle import Bundle
from mesoshell.scene.materials import Material
from mesoshell.scene.settle import settle
from mesoshell.viewer import refine as refining
from mesoshell.viewer.look import command
from mesoshell.viewer.refine import RefinedPicture, refine
from mesoshell.viewer.work import Workshop
from tests.helpers import growing

MESH = Path(__file__).parents[1] / "data" / "suzanne.obj"
CAMERA = ms.Camera(ms.look_at((1.0, 2.0, 12.0), (0.0, 0.0, 0.0)), 0.6, 400, 300)
AWAY = ms.Camera(ms.look_at((1.0, 2.0, 12.0), (0.0, 9.0, 20.0)), 0.6, 400, 300)


@pytest.fixture(autouse=True)
def _small(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))
    monkeypatch.setattr(refining, "COARSE", 8)
    monkeypatch.setattr(refining, "PRESETS", dict.fromkeys(refining.PRESETS, ms.Quality(samples=4, pixel_samples=1)))


@pytest.fixture
def scene(tiny_bundle: Bundle) -> ms.Scene:
    return ms.Scene(MESH, Material("tiny", tiny_bundle), scale=0.4, size=(20, 15))


def never() -> bool:
    return False


def test_a_picture_refines_to_what_render_makes(scene: ms.Scene):
    still = settle(scene)
    steps = list(refine(still, "draft", never, most=3))
    assert [(s.rgba.shape, s.samples) for s in steps] == [((6, 8, 4), 1), *(((15, 20, 4), k) for k in (1, 2, 3))]
    made = ms.render(still, ms.Quality(samples=4, density="network"), max_samples=3)
    np.testing.assert_allclose(steps[-1].rgba, made.rgba, atol=1e-6)
    assert steps[-1].rendered.record["rays"] == 3 * 300 and steps[-1].effects is not None


@pytest.mark.parametrize("engine", ["jax", pytest.param("mitsuba", marks=pytest.mark.slow)])
def test_the_first_picture_is_half_a_chessboard(engine: str, scene: ms.Scene, monkeypatch: pytest.MonkeyPatch):
    """Its pixels of one colour are as all rays make them; each other is the mean of those beside it."""
    monkeypatch.setattr(refining, "COARSE", 16)
    begun = next(iter(refine(settle(scene), "draft", never, engine)))
    first = begun.rgba
    assert begun.rendered.record["rays"] == (first.shape[0] * first.shape[1] + 1) // 2 and not begun.whole
    monkeypatch.setattr(refining, "chessboard", lambda shape: np.ones(shape, bool))
    whole = next(iter(refine(settle(scene), "draft", never, engine))).rgba
    y, x = np.indices(first.shape[:2])
    known = (x + y) % 2 == 0
    np.testing.assert_allclose(first[known], whole[known], atol=1e-6)
    for y, x in np.argwhere(~known):
        beside = [
            first[b, a]
            for b, a in ((y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1))
            if 0 <= b < len(first) and 0 <= a < first.shape[1]
        ]
        np.testing.assert_allclose(first[y, x], np.mean(beside, axis=0), atol=1e-6)
    assert np.abs(first - whole)[~known].max() > 0.01
    np.testing.assert_array_equal(refining.filled(np.ones((1, 2, 4)), np.array([[True, False]])), np.ones((1, 2, 4)))
    assert not refining.filled(np.ones((1, 1, 4)), np.array([[False]])).any()


def test_a_small_picture_has_no_smaller_one(scene: ms.Scene):
    still = settle(replace(scene, size=(8, 6)))
    assert [s.rgba.shape for s in refine(still, "draft", never, most=1)] == [(6, 8, 4)]


def test_a_picture_to_compare_with_has_no_coarse_one(scene: ms.Scene):
    steps = list(refine(settle(scene), "draft", never, coarse=False, most=2))
    assert [(s.rgba.shape, s.samples) for s in steps] == [((15, 20, 4), k) for k in (1, 2)]


@pytest.mark.parametrize("polls", [1, 3, 4, 6])
def test_a_picture_that_nobody_waits_for_ends(scene: ms.Scene, polls: int):
    times = 0

    def stopped() -> bool:
        nonlocal times
        times += 1
        return times >= polls

    assert len(list(refine(settle(scene), "draft", stopped, most=50))) < 6 and times == polls


class Seen:
    """What a workshop shows and says."""

    work: Workshop

    def __init__(self) -> None:
        self.pictures: list[tuple[Any, RefinedPicture]] = []
        self.lines: list[str] = []
        self.shares: list[float] = []
        self.changed = threading.Condition()

    def show(self, eye: Any) -> None:
        picture, _ = self.work.picture(eye)
        with self.changed:
            if picture is not None:
                self.pictures.append((eye, picture))
            self.changed.notify_all()

    def say(self, line: str) -> None:
        with self.changed:
            self.lines.append(line)
            self.changed.notify_all()

    def wait(self, until: Callable[[], Any]) -> None:
        with self.changed:
            assert self.changed.wait_for(until, timeout=120)


@pytest.fixture
def opened() -> Iterator[Callable[[ms.Scene], tuple[Workshop, Seen]]]:
    shops: list[Workshop] = []

    def make(scene: ms.Scene) -> tuple[Workshop, Seen]:
        seen = Seen()
        shops.append(Workshop(scene, seen.show, seen.say, seen.shares.append))
        seen.work = shops[-1]
        shops[-1].set(replace(shops[-1].look, side=20, quality="draft"))
        return shops[-1], seen

    yield make
    for shop in shops:
        shop.close()


def test_the_newest_wish_is_painted(scene: ms.Scene, opened):
    work, seen = opened(scene)
    for _ in range(5):
        work.see(1, AWAY)
    work.see(1, CAMERA)
    seen.wait(lambda: len(seen.pictures) >= 5 and seen.pictures[-1][1].samples >= 2)
    last = seen.pictures[-1][1]
    assert last.rgba.shape == (15, 20, 4) and last.rgba[..., 3].max() > 0.5
    before = len(seen.pictures)
    work.set(replace(work.look, base_colour=(1.0, 0.0, 0.0)))
    seen.wait(lambda: len(seen.pictures) > before + 3)
    assert work.scene(1).base_colour == (1.0, 0.0, 0.0)


def test_clients_take_turns_and_may_vanish(scene: ms.Scene, opened):
    work, seen = opened(scene)
    work.see(1, CAMERA)
    work.see(2, AWAY)
    seen.wait(lambda: all(sum(c == k for c, _ in seen.pictures) >= 3 for k in (1, 2)))
    work.leave(1)
    with seen.changed:
        begin = len(seen.pictures)
    seen.wait(lambda: len(seen.pictures) >= begin + 4)
    assert {c for c, _ in seen.pictures[begin + 1 :]} == {2}
    work.leave(7)  # that never was


def test_an_eye_has_a_quality_of_its_own(scene: ms.Scene, opened, monkeypatch: pytest.MonkeyPatch):
    few, many = (ms.Quality(samples=n, spacing="length", pixel_samples=1) for n in (4, 12))
    monkeypatch.setattr(refining, "PRESETS", {"draft": few, "normal": few, "reference": many})
    work, seen = opened(scene)
    work.see(1, CAMERA)
    work.see("beside", CAMERA, "reference")
    seen.wait(lambda: all(any(e == eye and p.samples > 1 for e, p in seen.pictures) for eye in (1, "beside")))
    queries = {eye: [p for e, p in seen.pictures if e == eye][-1].rendered.record for eye in (1, "beside")}
    each = {eye: r["queries"] / r["rays"] for eye, r in queries.items()}
    assert each["beside"] > 1.5 * each[1]
    assert next(p.rgba.shape for e, p in seen.pictures if e == "beside") == (15, 20, 4)  # with no coarse one before
    work.set(replace(work.look, base_colour=(0.5, 0.5, 0.5)))
    assert not work.picture("beside")[1]
    seen.wait(lambda: work.picture("beside")[1])
    work.leave("beside")
    assert work.picture("beside") == (None, False)


def test_workshops_of_one_hand_paint_in_turn(scene: ms.Scene, monkeypatch: pytest.MonkeyPatch):
    painting, most, lock = [0], [0], threading.Lock()

    def passes(*_: Any) -> Iterator[RefinedPicture]:
        for k in range(4):
            with lock:
                painting[0] += 1
                most[0] = max(most[0], painting[0])
            time.sleep(0.01)
            with lock:
                painting[0] -= 1
            yield RefinedPicture(np.zeros((2, 2, 4)), k + 1, 0.01, None, None, (), CAMERA, ms.Quality())  # type: ignore[arg-type]

    monkeypatch.setattr(refining, "_passes", passes)
    paint_lock, seen = threading.Lock(), [Seen(), Seen()]
    shops = [Workshop(scene, s.show, s.say, s.shares.append, paint_lock=paint_lock) for s in seen]
    try:
        for shop, s in zip(shops, seen, strict=True):
            s.work = shop
            shop.see(1, CAMERA)
        for s in seen:
            s.wait(lambda s=s: len(s.pictures) >= 4)
    finally:
        for shop in shops:
            shop.close()
    assert most[0] == 1


def test_a_scene_that_no_picture_can_be_made_of_is_refused(scene: ms.Scene, opened):
    for change, said in (
        ({"params": {"dryness": float("nan")}}, "dryness"),
        ({"params": {"dryness": 5.0}}, "dryness"),
        ({"seed": 3}, "seed"),
        ({"irradiance": -1.0}, "irradiance"),
        ({"base_colour": (float("nan"), 0.0, 0.0)}, "base_colour"),
    ):
        with pytest.raises(InputError, match=said):
            opened(replace(scene, **change))


def test_a_fault_is_said_and_forgotten(scene: ms.Scene, opened):
    work, seen = opened(scene)
    work.see(1, CAMERA)
    work.set(replace(work.look, thickness=-1.0))
    seen.wait(lambda: any("thickness" in line for line in seen.lines))
    work.set(replace(work.look, thickness=0.2))
    seen.wait(lambda: seen.lines[-1] == "" and seen.pictures)


def test_a_further_material_has_a_look_of_its_own(scene: ms.Scene, tiny_bundle: Bundle, opened):
    """And only the texture that is asked for is grown."""
    lawn = ms.Grown(MESH, Material("lawn", growing.bundle()), scale=1.0, thickness=0.3)
    moss = ms.Grown(MESH, Material("moss", tiny_bundle), scale=0.4, name="stone")
    work, seen = opened(replace(scene, also=[lawn, moss]))
    work.see(1, CAMERA)
    seen.wait(lambda: seen.pictures)
    assert [sorted(x.params) for x in work.look.parts] == [["dryness"], ["age", "length"], ["dryness"]]
    grown, stone = work.look.also
    work.set(replace(work.look, also=(grown, replace(stone, params={"dryness": 0.9}, thickness=0.07))))
    shown = work.scene(1)
    assert (
        shown.also[1].params == {"dryness": 0.9} and shown.also[1].thickness == 0.07 and shown.params["dryness"] != 0.9
    )
    words = command(work.given, shown, work.look, "jax", 2).split()
    assert "stone:dryness=0.9" in words and "stone:thickness=0.07" in words and "lawn:length=2.0" in words
    old = work.still
    work.set(replace(work.look, also=(replace(grown, params={**grown.params, "length": 3.0}, seed=2), stone)))
    end = time.monotonic() + 120
    while work.still is old and time.monotonic() < end:
        time.sleep(0.05)
    assert work.still.also[0].material is not old.also[0].material and work.still.also[0].material.shell.baked
    assert work.still.material is old.material and work.still.also[1].material is old.also[1].material
    wanted = settle(replace(work.begun, also=[replace(work.begun.also[0], params={"length": 3.0}, seed=2)]))
    for name, array in wanted.also[0].material.shell.arrays.items():
        np.testing.assert_array_equal(work.still.also[0].material.shell.arrays[name], array)


def test_a_texture_that_cannot_be_grown_is_said_each_time(opened, monkeypatch: pytest.MonkeyPatch):
    """And other textures, and the old one, go on."""
    lawn = ms.Grown(MESH, Material("lawn", growing.bundle()), scale=1.0, thickness=0.3)
    work, seen = opened(ms.Scene(MESH, Material("own", growing.bundle()), scale=1.0, size=(20, 15), also=[lawn]))
    begun, there = work.look, work.still
    bad = replace(begun, seed=2**40)
    for _ in range(2):
        count = len(seen.lines)
        work.set(bad)
        seen.wait(lambda n=count: any("seed" in line for line in seen.lines[n:]))
        work.set(begun)
        seen.wait(lambda: seen.lines[-1] == "")
        assert work.still is there
    work.set(bad)
    seen.wait(lambda: "seed" in seen.lines[-1])
    work.set(replace(begun, also=(replace(begun.also[0], seed=3),)))
    end = time.monotonic() + 120
    while work.still is there and time.monotonic() < end:
        time.sleep(0.05)
    assert work.still.material is there.material and work.still.also[0].material is not there.also[0].material


@pytest.mark.slow
def test_a_texture_grows_beside_the_view(opened):
    work, seen = opened(ms.Scene(MESH, Material("grown", growing.bundle()), scale=1.0, size=(20, 15)))
    work.see(1, CAMERA)
    seen.wait(lambda: seen.pictures)
    old = work.still.material
    assert old.shell.baked
    work.set(replace(work.look, params={**work.look.params, "length": 3.0}, seed=2))
    end = time.monotonic() + 120
    while work.still.material is old and time.monotonic() < end:
        time.sleep(0.05)
    assert work.still.material is not old and work.still.material.shell.baked
    wanted = settle(replace(work.begun, params={"length": 3.0}, seed=2))
    for name, array in wanted.material.shell.arrays.items():
        np.testing.assert_array_equal(work.still.material.shell.arrays[name], array)
