"""Films are shot frame by frame and go on where they stopped; a frame is the picture that `render` makes."""

import json
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mesoshell as ms
from mesoshell.cli.main import main
from mesoshell.errors import InputError
from mesoshell.film import frame as framing
from mesoshell.film.shoot import RECORD, on_white
from mesoshell.io.bundle import Bundle, write_bundle
from mesoshell.io.image import linear_to_srgb, read_png, write_exr
from mesoshell.io.lock import alone_in
from mesoshell.scene.materials import Material
from mesoshell.scene.settle import settle
from tests.helpers import growing, wearing

MESH = Path(__file__).parents[1] / "data" / "suzanne.obj"
DRAFT: dict[str, Any] = {"quality": "draft", "samples": 4}


@pytest.fixture(autouse=True)
def _no_cache_at_home(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture
def scene(tiny_bundle: Bundle) -> ms.Scene:
    return ms.Scene(MESH, Material("tiny", tiny_bundle), scale=0.4, size=(16, 12))


@pytest.fixture
def times(monkeypatch: pytest.MonkeyPatch) -> list[ms.Scene]:
    """The scenes that were rendered."""
    rendered: list[ms.Scene] = []
    picture = framing._picture

    def counted(scene: ms.Scene, *rest: Any) -> Any:
        rendered.append(scene)
        return picture(scene, *rest)

    monkeypatch.setattr(framing, "_picture", counted)
    return rendered


def test_a_stopped_film_goes_on(
    scene: ms.Scene, times: list[ms.Scene], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    whole = ms.film(scene, tmp_path / "whole", orbit=4, **DRAFT)
    assert len(times) == len(whole.frames) == 4
    assert whole.flicker[0] is None and all(x is not None and 0 < x < 1 for x in whole.flicker[1:])

    def stopped(share: float, what: str) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        ms.film(scene, tmp_path / "cut", orbit=4, progress=stopped, **DRAFT)
    assert len(times) == 7
    again = ms.film(scene, tmp_path / "cut", orbit=4, **DRAFT)
    assert len(times) == 9 and again.flicker == whole.flicker
    for a, b in zip(whole.frames, again.frames, strict=True):
        assert a.read_bytes() == b.read_bytes()
    assert replace(ms.film(scene, tmp_path / "cut", orbit=4, **DRAFT), notes=again.notes) == again and len(times) == 9
    again.frames[2].unlink()  # a lost frame is made again
    ms.film(scene, tmp_path / "cut", orbit=4, **DRAFT)
    assert len(times) == 10 and again.frames[2].read_bytes() == whole.frames[2].read_bytes()


def test_another_films_frames_are_refused(scene: ms.Scene, tmp_path: Path):
    ms.film(scene, tmp_path / "film", orbit=2, **DRAFT)
    held = {p: p.read_bytes() for p in (tmp_path / "film").iterdir()}
    others: list[dict[str, Any]] = [{"orbit": 3}, {"dolly": 2}, {"orbit": 2, "samples": 5}]
    for other in others:
        with pytest.raises(InputError, match="holds another film's frames: remove the folder, or choose another"):
            ms.film(scene, tmp_path / "film", **(DRAFT | other))
    record = json.loads((tmp_path / "film" / RECORD).read_text())
    for damaged in ("{", *(json.dumps(record | {"frames": {"0": row}}) for row in (5, {}, {"seconds": "soon"}))):
        (tmp_path / "film" / RECORD).write_text(damaged)
        with pytest.raises(InputError, match="is no record of a film"):
            ms.film(scene, tmp_path / "film", orbit=2, **DRAFT)
    (tmp_path / "film" / RECORD).unlink()
    with pytest.raises(InputError, match=f"holds frames but no {RECORD}"):
        ms.film(scene, tmp_path / "film", orbit=2, **DRAFT)
    assert {p.name for p in held} == {p.name for p in (tmp_path / "film").iterdir()} | {RECORD}


def test_a_folder_has_one_film_at_a_time(scene: ms.Scene, tmp_path: Path):
    with alone_in(tmp_path / "film"), pytest.raises(InputError, match="another run is writing into it"):
        ms.film(scene, tmp_path / "film", orbit=1, **DRAFT)
    assert not list((tmp_path / "film").iterdir())
    assert len(ms.film(scene, tmp_path / "film", orbit=1, **DRAFT).frames) == 1


def test_a_film_that_ended_without_a_frame_does_not_count(scene: ms.Scene, tmp_path: Path):
    """Nor does a frame that its cluster wrote later."""
    ms.film(scene, tmp_path / "film", orbit=1, **DRAFT)
    record = json.loads((tmp_path / "film" / RECORD).read_text())
    (tmp_path / "film" / RECORD).write_text(json.dumps(record | {"frames": {}, "of": "another"}))
    made = ms.film(scene, tmp_path / "film", orbit=2, **DRAFT)
    assert len(made.frames) == 2 and all(frame.exists() for frame in made.frames)


def test_an_orbit_begins_and_a_dolly_ends_with_the_picture(scene: ms.Scene, tmp_path: Path):
    lit = replace(scene, lights=[(-0.3, 0.9, 0.2)], environment=np.full((4, 8, 3), 0.3, np.float32), up="y")
    ms.render(lit, **DRAFT).save(tmp_path / "still.png")
    made = ms.film(lit, tmp_path / "film", orbit=2, **DRAFT)
    assert made.frames[0].read_bytes() == (tmp_path / "still.png").read_bytes()
    assert made.frames[1].read_bytes() != made.frames[0].read_bytes()
    made = ms.film(lit, tmp_path / "dolly", dolly=2, far=3.0, **DRAFT)
    assert made.frames[1].read_bytes() == (tmp_path / "still.png").read_bytes()


@pytest.mark.parametrize("engine", ["jax", pytest.param("mitsuba", marks=pytest.mark.slow)])
def test_a_settled_scene_gives_the_same_picture(engine: Any, tmp_path: Path):
    """With a texture that is grown, and files of all kinds."""
    write_exr(tmp_path / "sky.exr", np.random.default_rng(0).uniform(0.1, 1, (4, 8, 3)).astype(np.float32))
    scene = ms.Scene(
        str(MESH),
        Material("grown", growing.bundle()),
        scale=1.0,
        params={"age": 4.0, "length": 2.5},
        seed=3,
        size=(16, 12),
        environment=tmp_path / "sky.exr",
        objects=[MESH],
    )
    still = settle(scene)
    assert still.seed is None and still.params == {"age": 4.0} and still.material.shell.baked
    a, b = (ms.render(x, engine=engine, quality="draft") for x in (scene, still))
    np.testing.assert_array_equal(a.rgba, b.rgba)
    assert a.rgba[..., 3].max() == 1 and not settle(scene, texture=False).material.shell.baked


def test_keys_change_what_they_say(scene: ms.Scene, times: list[ms.Scene], tmp_path: Path):
    keys = [{"frame": 0, "params": {"dryness": 0.0}}, {"frame": 2, "params": {"dryness": 1.0}, "thickness": 0.05}]
    made = ms.film(scene, tmp_path / "film", keys=keys, **DRAFT)
    assert [x.params["dryness"] for x in times] == [0.0, 0.5, 1.0] and {x.thickness for x in times} == {0.05}
    assert len({p.read_bytes() for p in made.frames}) == 3


@pytest.mark.parametrize(
    ("moves", "texels", "density"),
    [
        ({"orbit": 2}, 1e9, "baked"),
        ({"dolly": 2, "far": 4.0}, 1e9, "baked"),
        ({"dolly": 2, "far": 4.0}, 2.0, "network"),  # footprints reach 1 texel near, and 4 far
        ({"keys": [{"frame": 0, "params": {"dryness": x}} for x in (0.0, 1.0)]}, 1e9, "network"),
    ],
)
def test_a_film_has_its_density_from_one_source(moves, texels, density, scene: ms.Scene, tmp_path: Path, monkeypatch):
    """A grid if all frames may have one: of one frame's parameters, and not too far away."""
    if "keys" in moves:
        moves["keys"][1]["frame"] = 1
    asked, picture, camera = [], framing._picture, (-2.5, 1.25, 8.0, -2.5, 1.25, 4.1, 40.0)
    monkeypatch.setattr(framing, "_picture", lambda *given: asked.append(given[1].density) or picture(*given))
    monkeypatch.setattr("mesoshell.render.effects.MAX_TEXELS", texels)
    ms.film(replace(scene, camera=camera), tmp_path / "film", **moves, samples=28)
    assert asked == 2 * [density]


def test_keys_of_colour_on_a_grown_texture(times: list[ms.Scene], tmp_path: Path):
    """Geometry that is given once is grown once, and stays."""
    scene = ms.Scene(
        MESH, Material("grown", growing.bundle()), scale=1.0, size=(16, 12), params={"length": 2.5, "age": "1"}
    )
    made = ms.film(scene, tmp_path / "film", keys=[{"frame": 0}, {"frame": 1, "params": {"age": 9.0}}], **DRAFT)
    assert [x.params for x in times] == [{"age": 9.0}] * 2 and all(x.material.shell.baked for x in times)
    assert len(made.frames) == 2


def test_an_image_that_changed_is_another_film(scene: ms.Scene, tmp_path: Path):
    for value in (0.2, 0.9):
        write_exr(tmp_path / "dry.exr", np.full((4, 4, 3), value, np.float32))
        dry = replace(scene, params={"dryness": tmp_path / "dry.exr"})
        if value == 0.2:
            ms.film(dry, tmp_path / "film", orbit=1, **DRAFT)
            continue
        with pytest.raises(InputError, match="holds another film's frames"):
            ms.film(dry, tmp_path / "film", orbit=1, **DRAFT)


def test_keys_keep_the_size_of_a_camera(scene: ms.Scene, tmp_path: Path):
    camera = ms.Camera(ms.look_at((0.0, 2.0, 12.0), (0.0, 0.0, 0.0)), 0.6, 10, 6)
    keys = [{"frame": 0, "camera": [0, 2, 9, 0, 0, 0, 35]}]
    made = ms.film(replace(scene, camera=camera), tmp_path / "film", keys=keys, **DRAFT)
    assert read_png(made.frames[0]).shape[:2] == (6, 10)


@pytest.mark.slow
def test_geometry_that_changes_is_grown_for_each_frame(times: list[ms.Scene], tmp_path: Path):
    scene = ms.Scene(MESH, Material("grown", growing.bundle()), scale=1.0, size=(16, 12))
    keys = [{"frame": 0, "params": {"length": 1.0}}, {"frame": 1, "params": {"length": 3.0}}]
    made = ms.film(scene, tmp_path / "film", keys=keys, **DRAFT)
    assert made.frames[0].read_bytes() != made.frames[1].read_bytes()
    assert not any(x.material.shell.baked for x in times)


def test_an_mp4_holds_the_frames(scene: ms.Scene, tmp_path: Path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="requires the extra film")
    made = ms.film(scene, tmp_path / "film", orbit=3, **DRAFT)
    made.save(tmp_path / "film.mp4", fps=12.0)
    read = [
        imageio_ffmpeg.get_ffmpeg_exe(),
        "-i",
        str(tmp_path / "film.mp4"),
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-",
    ]
    done = subprocess.run(read, capture_output=True, check=True)
    for said in (b"Video: h264", b"16x12", b"12 fps", b"bt709"):
        assert said in done.stderr
    pictures = np.frombuffer(done.stdout, np.uint8).reshape(3, 12, 16, 3) / 255.0
    for picture, path in zip(pictures, made.frames, strict=True):
        assert np.abs(picture.mean(axis=2) - linear_to_srgb(on_white(path)).mean(axis=2)).mean() < 0.02
    for path, fps, fault in (("film.gif", 24.0, "must end in .mp4"), ("film.mp4", 0.0, "must be positive and finite")):
        with pytest.raises(InputError, match=fault):
            made.save(tmp_path / path, fps)


@pytest.mark.slow  # shells are filmed; the engine's own tests have its pictures
def test_a_surface_material_is_filmed(tmp_path: Path):
    scene = ms.Scene(MESH, Material("dots", wearing.bundle()), scale=0.4, size=(16, 12))
    made = ms.film(scene, tmp_path / "film", orbit=2, quality="draft")
    assert len(made.frames) == 2 and read_png(made.frames[1])[..., 3].max() > 0.5


def fault(capsys: pytest.CaptureFixture, *arguments: object) -> str:
    capsys.readouterr()
    with pytest.raises(SystemExit) as caught:
        main(["film", *map(str, arguments)])
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1, said
    return said


def test_the_command(tiny_bundle: Bundle, tmp_path: Path, capsys: pytest.CaptureFixture):
    write_bundle(tmp_path / "tiny.npz", tiny_bundle)
    (tmp_path / "keys.json").write_text('{"keys": [{"frame": 1, "params": {"dryness": 0.2}}]}')
    given = [MESH, "--material", tmp_path / "tiny.npz", "--size", 16, 12, "--quality", "draft", "--set", "samples=4"]
    main(["film", *map(str, [*given, "--keys", tmp_path / "keys.json", "--out", tmp_path / "film.mp4"])])
    said = capsys.readouterr().out
    assert said.startswith(f"{tmp_path / 'film.mp4'}: 2 frames, ") and "; flicker 0.0000, at most" in said
    assert (tmp_path / "film.mp4").exists()
    record = json.loads((tmp_path / "film.frames" / RECORD).read_text())
    assert list(record["frames"]) == ["0", "1"] and record["engine"] == "jax"
    out = "--out", tmp_path / "no"
    assert "--orbit: give one of --orbit, --dolly and --keys" in fault(capsys, *given, *out)
    assert "--dolly: give one of --orbit, --dolly and --keys" in fault(capsys, *given, *out, "--orbit", 3, "--dolly", 3)
    assert "--far: is where a --dolly begins: give --dolly too" in fault(capsys, *given, *out, "--orbit", 3, "--far", 4)
    assert "--orbit: must be from 1 to 100000 frames, not 0" in fault(capsys, *given, *out, "--orbit", 0)
    assert "--wind: " + str(tmp_path / "tiny.npz") + " has no lean" in fault(
        capsys, *given, *out, "--orbit", 2, "--wind", 0.5
    )
    assert "an MP4 has an even width and height, not 15 x 12" in fault(
        capsys, *given, "--orbit", 2, "--out", tmp_path / "no.mp4", "--size", 15, 12
    )
    assert "keys.json: no such file" in fault(capsys, *given, *out, "--keys", tmp_path / "none" / "keys.json")
    assert "scene.xml: is a scene of Mitsuba's, whose camera is not moved" in fault(capsys, "scene.xml", "--orbit", 2)
    assert not (tmp_path / "no").exists() and not (tmp_path / "no.mp4").exists()
