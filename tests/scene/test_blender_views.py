"""What Blender sees of a mesh is what is seen here, pixel on pixel, by each format that it writes; and so are its lamps."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

import mesoshell as ms
from mesoshell.geometry.mesh import Mesh
from mesoshell.io.bundle import Bundle
from mesoshell.io.image import read_exr, write_exr
from mesoshell.render.camera import pixel_grid, rays
from mesoshell.render.lamp import as_distant
from mesoshell.render.light import environment, lookup
from mesoshell.scene.materials import Material
from mesoshell.scene.settle import settle
from mesoshell.scene.unpack import read_scene_file
from mesoshell.scene.worn import read_worn

ROOT = Path(__file__).parents[2]
pytestmark = [
    pytest.mark.slow,  # Blender writes and draws a scene in eight formats first
    pytest.mark.skipif(
        not (ROOT / "data_gen/.venv/installed").exists(), reason="no Blender environment (Python 3.11): make blender"
    ),
]
#: From Blender's frame, whose z is up, to that of glTF and OBJ files.
Y_UP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


#: Red by the column, green by the row.
SKY = np.stack(np.broadcast_arrays(np.arange(1, 9) / 8, np.arange(1, 5)[:, None] / 4, 0.0), axis=-1).astype(np.float32)


#: Blocks of 64 pixels, 4 by 2 of them, each of another colour.
BOARD = np.kron(
    np.stack(np.broadcast_arrays(np.arange(40, 240, 50), np.arange(50, 250, 100)[:, None], 120), axis=-1).astype(
        np.uint8
    ),
    np.ones((64, 64, 1), np.uint8),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("blender")
    write_exr(made / "sky.exr", SKY, half=False)
    Image.fromarray(BOARD).save(made / "board.png")
    script = [ROOT / "data_gen/.venv/bin/python", ROOT / "tests/helpers/blender_view.py", made]
    subprocess.run(list(map(str, script)), check=True, capture_output=True)
    return made


@pytest.mark.parametrize("kind", ["glb", "gltf", "usda", "usdc", "usdz", "obj", "ply", "stl"])
def test_a_silhouette_is_blenders(folder: Path, tiny_bundle: Bundle, kind: str):
    """glTF files and USD stages bring their camera; for others it is Blender's, in the axes that the format usually has."""
    mask = np.asarray(Image.open(folder / "mask.png"))[..., 3] > 127
    height, width = mask.shape
    view = json.loads((folder / "view.json").read_text())
    scene = ms.Scene(folder / f"head.{kind}", Material("tiny", tiny_bundle), size=(width, height))
    still = settle(scene)
    frame = np.array(view["to_world"]) if still.up == "z" else Y_UP @ np.array(view["to_world"])
    camera = ms.Camera(frame, view["fov"], width, height)
    if kind in ("glb", "gltf", "usda", "usdc", "usdz"):
        assert isinstance(still.camera, ms.Camera)
        np.testing.assert_allclose(still.camera.to_world, frame, atol=1e-6)
        assert still.camera.fov == pytest.approx(view["fov"], rel=1e-6)
        camera = still.camera
    assert isinstance(still.mesh, Mesh)
    o, d = rays(camera, pixel_grid(camera, 1, 0))
    solid = trimesh.Trimesh(still.mesh.vertices, still.mesh.faces, process=False)
    seen = solid.ray.intersects_any(o, d).reshape(height, width)
    assert 0.1 < mask.mean() < 0.6
    assert (seen != mask).sum() <= 2  # a ray within rounding of an edge


@pytest.mark.parametrize("kind", ["glb", "gltf", "usda", "usdc", "usdz"])
def test_custom_properties_say_what_grows(folder: Path, kind: str):
    (worn,), _, notes = read_worn(folder / f"head.{kind}", ())
    assert worn.node.endswith("Monkey") and worn[1:] == ("pelt", {"scale": "0.25"}) and not notes


@pytest.mark.parametrize(
    ("stage", "seen"),
    [("sky.usda", "sky"), ("mapped.usdc", "sky"), ("upright.usda", "sky"), ("turned.usdz", "turned")],
)
def test_a_stages_sky_is_blenders(folder: Path, tiny_bundle: Bundle, stage: str, seen: str):
    """Blender's colours differ by a few percent of one another."""
    still = settle(ms.Scene(folder / stage, Material("tiny", tiny_bundle)))
    assert isinstance(still.environment, np.ndarray) and still.lights == ()
    assert still.up == ("y" if stage == "upright.usda" else "z")
    for k in range(8):
        angle = (k + 0.5) * np.pi / 4
        toward = np.array([np.cos(angle), np.sin(angle), 0.4]) / np.sqrt(1.16)
        if still.up == "y":
            toward = Y_UP[:3, :3] @ toward
        here = lookup(environment(still.environment, 1 if still.up == "y" else 2), toward[None])[0]
        there = read_exr(folder / f"{seen}_{k}.exr")[..., :3].mean(axis=(0, 1))
        np.testing.assert_allclose(here, there, rtol=0.1)


@pytest.mark.parametrize("up", [1, 2])
def test_a_sky_lies_as_blenders(folder: Path, up: int):
    """Blender's colours differ by a few percent of one another; columns by an eighth, rows by a quarter."""
    for k in range(8):
        angle = (k + 0.5) * np.pi / 4
        toward = np.array([np.cos(angle), np.sin(angle), 0.4]) / np.sqrt(1.16)
        if up == 1:
            toward = Y_UP[:3, :3] @ toward
        here = lookup(environment(SKY, up), toward[None])[0]
        there = read_exr(folder / f"sky_{k}.exr")[..., :3].mean(axis=(0, 1))
        np.testing.assert_allclose(here, there, rtol=0.1)


@pytest.mark.parametrize(
    "file",
    [
        *(f"{x}.usdc" for x in ("point", "bare", "spot", "rectangle", "disk")),
        *(f"{x}.glb" for x in ("point", "bare", "spot")),
    ],
)
def test_a_lamp_is_as_bright_as_blenders(folder: Path, file: str):
    """On a white floor 2 below it."""
    told = read_scene_file(folder / file)
    (lamp,) = told.lamps
    direction, irradiance = as_distant(lamp, np.zeros((1, 3)))
    seen = read_exr(folder / Path(file).with_suffix(".exr"))[..., :3].mean(axis=(0, 1))
    np.testing.assert_allclose(irradiance * direction[2 if told.up == "z" else 1] / np.pi, seen, rtol=0.01)
    assert lamp.kind == {"bare": "point", "point": "sphere" if told.up == "z" else "point"}.get(
        Path(file).stem, Path(file).stem
    )


@pytest.mark.parametrize(
    ("file", "engine"),
    [("board.glb", "jax"), ("board.gltf", "mitsuba"), ("board.usdc", "mitsuba"), ("board.usdz", "jax")],
)
def test_an_image_lies_on_a_board_as_in_blender(folder: Path, tiny_bundle: Bundle, file: str, engine: Any):
    """Whose texture coordinates are turned, stretched, and repeat the image. Compared where all neighbours are alike."""
    seen = read_exr(folder / "board.exr")[..., :3]
    around = np.stack([np.roll(seen, (y, x), axis=(0, 1)) for y in (-1, 0, 1) for x in (-1, 0, 1)])
    inside = np.ptp(around, axis=0).max(axis=-1) < 0.01
    assert inside.mean() > 0.4 and len(np.unique(seen[inside].round(2), axis=0)) == 8  # every colour
    scene = ms.Scene(folder / file, Material("tiny", tiny_bundle), grow=("Lawn",), size=(24, 24), thickness=0.01)
    made = ms.render(scene, engine=engine, quality="draft").rgba[..., :3]
    np.testing.assert_allclose(made[inside], seen[inside], rtol=0.01, atol=0.002)
