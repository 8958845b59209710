"""A run's newest snapshot is worn, another when it is chosen, and sheets and curves are shown beside it."""

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.cli.main import main
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.io.image import write_png
from mesoshell.io.surface import write_surface
from tests.helpers import growing, wearing
from tests.helpers.ports import free_port

pytest.importorskip("viser", reason="requires the extra viewer")

from mesoshell.viewer import refine as refining
from mesoshell.viewer import run as running
from mesoshell.viewer.page import Page
from mesoshell.viewer.run import NEWEST, RunPanel


class Handle:
    """An input or image of viser's, as far as it is read."""

    def __init__(self, **fields: Any):
        self.__dict__.update(fields)

    def on_update(self, call: Callable[[Any], None]) -> None:
        self.call = call

    def __setattr__(self, name: str, value: Any) -> None:
        """As viser's dropdown: options without the value choose the first, and that calls back at once."""
        super().__setattr__(name, value)
        if name == "options" and self.value not in value:
            self.value = value[0]
            self.call(None)

    def __enter__(self) -> "Handle":
        return self

    def __exit__(self, *_: object) -> None:
        pass


class Gui:
    """A page that keeps what is added to it."""

    def __init__(self) -> None:
        self.images: list[Handle] = []
        self.said: list[str] = []

    def add_folder(self, title: str, order: float) -> Handle:
        return Handle(title=title, order=order)

    def add_dropdown(self, label: str, options: tuple[str, ...], initial_value: str, hint: str) -> Handle:
        self.chosen = Handle(label=label, options=options, value=initial_value, hint=hint)
        return self.chosen

    def add_image(self, image: np.ndarray, visible: bool) -> Handle:
        self.images.append(Handle(image=image, visible=visible))
        return self.images[-1]


def snapshot(folder: Path, bundle: Bundle, images: int, grey: float | None = None) -> Path:
    (folder / "snapshots").mkdir(parents=True, exist_ok=True)
    path = folder / "snapshots" / f"{images:09d}.npz"
    write_bundle(path, bundle)
    if grey is not None:
        (folder / "sheets").mkdir(exist_ok=True)
        write_png(folder / "sheets" / f"{images:09d}.png", np.full((4, 6, 3), grey, np.float32))
    return path


@pytest.fixture
def folder(tiny_bundle: Bundle, tmp_path: Path) -> Path:
    run = tmp_path / "grass"
    snapshot(run, tiny_bundle, 1000, 0.0)
    snapshot(run, tiny_bundle, 2000, 1.0)
    (run / "config.json").write_text("{}")
    return run


@pytest.fixture
def opened(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Gui, RunPanel, list[Path]]]:
    monkeypatch.setattr(running, "EVERY", 3600.0)
    gui, worn = Gui(), []
    panel = RunPanel(
        gui, folder, folder / "snapshots" / "000002000.npz", lambda path: not worn.append(path), gui.said.append
    )
    yield gui, panel, worn
    panel.close()


def test_another_snapshot_is_worn_when_it_is_chosen(opened, folder: Path):
    gui, panel, worn = opened
    assert gui.chosen.options == (NEWEST, "2 kimg", "1 kimg") and worn == []
    assert gui.images[0].visible and gui.images[0].image.mean() == 255 and not gui.images[1].visible
    gui.chosen.value = "1 kimg"
    gui.chosen.call(None)
    assert worn == [folder / "snapshots" / "000001000.npz"] and gui.images[0].image.mean() == 0
    panel.refresh()
    assert len(worn) == 1


def test_the_newest_is_followed(opened, folder: Path, tiny_bundle: Bundle):
    gui, panel, worn = opened
    new = snapshot(folder, tiny_bundle, 3500)  # its sheet is not written yet
    panel.refresh()
    assert worn == [new] and gui.chosen.options[1] == "3.5 kimg" and not gui.images[0].visible
    snapshot(folder, tiny_bundle, 3500, 0.0)
    panel.refresh()
    assert worn == [new] and gui.images[0].visible and gui.images[0].image.mean() == 0
    gui.chosen.value = "2 kimg"
    panel.refresh()
    snapshot(folder, tiny_bundle, 5000)
    panel.refresh()
    assert worn[-1] == folder / "snapshots" / "000002000.npz"


def test_curves_are_drawn_once_there_are_some(opened, folder: Path):
    gui, panel, _ = opened
    rows = [{"kimg": k, "images_per_s": 2.0, "radiance": 1 / k, "transmittance": 0.1} for k in (1.0, 2.0)]
    (folder / "log.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    panel.refresh()
    height, width, _ = gui.images[1].image.shape
    assert gui.images[1].visible and height > width and gui.images[1].image.std() > 10
    score = {"name": "KID", "kimg": 2.0, "images": 100, "value": 0.1, "low": 0.05, "high": 0.2}
    (folder / "evaluation.jsonl").write_text(json.dumps(score) + "\n")
    panel.refresh()
    assert gui.images[1].image.shape[0] > height and set(gui.said) == {""}
    (folder / "log.jsonl").write_text("[]\n")
    for _ in range(2):  # as long as it is so
        panel.refresh()
        assert gui.said[-1].startswith(str(folder / "log.jsonl"))


def test_a_snapshot_that_is_gone_is_the_newest(opened, folder: Path):
    gui, panel, worn = opened
    gui.chosen.value = "1 kimg"
    panel.refresh()
    (folder / "snapshots" / "000001000.npz").unlink()
    panel.refresh()
    assert gui.chosen.value == NEWEST and worn[-1] == folder / "snapshots" / "000002000.npz"


def test_a_damaged_sheet_is_said(opened, folder: Path):
    gui, panel, _ = opened
    (folder / "sheets" / "000002000.png").write_bytes(b"\x89PNG no picture")
    panel.refresh()
    assert "cannot identify image" in gui.said[-1]


def test_the_folder_is_looked_at_now_and_then(folder: Path, tiny_bundle: Bundle, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(running, "EVERY", 0.05)
    worn: list[Path] = []
    panel = RunPanel(
        Gui(), folder, folder / "snapshots" / "000002000.npz", lambda path: not worn.append(path), [].append
    )
    try:
        new = snapshot(folder, tiny_bundle, 3000)
        end = time.monotonic() + 60
        while not worn and time.monotonic() < end:
            time.sleep(0.02)
        assert worn == [new]
    finally:
        panel.close()


def test_the_command_says_what_is_wrong_with_a_run(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture):
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "config.json").write_text("{}")
    (tmp_path / "fitted").mkdir()
    (tmp_path / "fitted" / "config.json").write_text('{"method": "fit"}')
    for given, said in (
        ([folder, "--material", "fur"], f"--material: is the newest snapshot of {folder}"),
        ([tmp_path / "empty"], f"{tmp_path / 'empty'}: has no snapshots yet"),
        (["none.obj", "--material", folder], "none.obj: no such file"),
        ([folder, "--beside", "no_such"], "no_such: no such material"),
        ([tmp_path / "fitted"], f"{tmp_path / 'fitted'}: is a run of fit, whose snapshots are no materials"),
    ):
        with pytest.raises(SystemExit) as caught:
            main(["view", *map(str, given)])
        fault = capsys.readouterr().err
        assert caught.value.code == 2 and said in fault and fault.count("\n") == 1


@pytest.mark.parametrize("kind", ["shell", pytest.param("surface", marks=pytest.mark.slow)])
def test_a_run_is_seen_on_a_page(
    kind: str, folder: Path, tiny_bundle: Bundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A snapshot that is chosen is what the scene then wears, and is painted."""
    monkeypatch.setattr(running, "EVERY", 3600.0)
    monkeypatch.setattr(refining, "PRESETS", dict.fromkeys(refining.PRESETS, ms.Quality(samples=4, pixel_samples=1)))
    made = tiny_bundle if kind == "shell" else wearing.bundle()
    write: Any = write_bundle if kind == "shell" else write_surface
    names = [folder / "snapshots" / f"{images:09d}.npz" for images in (1000, 2000)]
    for k, path in enumerate(names):
        write(path, replace(made, provenance={"made": k}))
    mesh = Path(__file__).parents[1] / "data" / "suzanne.obj"
    page = Page(ms.Scene(mesh, ms.load_material(names[1]), scale=0.4), port=free_port(), run=folder)
    there = SimpleNamespace(client_id=1, scene=SimpleNamespace(set_background_image=lambda *_, **__: None))
    monkeypatch.setattr(page._server, "get_clients", lambda: {1: there})
    camera = page.work.still.camera
    assert isinstance(camera, ms.Camera)
    page.work.see(1, ms.Camera(camera.to_world, camera.fov, 40, 30))

    def settles(until: Callable[[], bool]) -> None:
        end = time.monotonic() + 100
        while not until():
            assert time.monotonic() < end and page._fault.content == ""
            time.sleep(0.05)

    try:
        for choice, wanted in (("1 kimg", 0), (NEWEST, 1)):
            page._run._which.value = choice
            settles(lambda wanted=wanted: page.work.still.material.provenance == {"made": wanted})
            page.work.see(1, ms.Camera(camera.to_world, camera.fov, 40, 30))
            settles(lambda: page.work.picture(1)[1])
            assert page.work.given.material.name == str(names[wanted])
        for data, said in ((b"half of one", "000009999.npz"), (None, "has other parameters than")):
            new = folder / "snapshots" / f"00000999{8 + (data is not None)}.npz"
            other = growing.bundle() if kind == "shell" else tiny_bundle
            new.write_bytes(data) if data is not None else write_bundle(new, other)
            page._run._worn = names[0]
            page._run._which.value = NEWEST
            page._run.refresh()
            assert said in page._fault.content
            new.unlink()
        assert page.work.still.material.provenance == {"made": 1}
    finally:
        page.close()
