"""Photographs of meshes by Blender: a capture that is read, a flash as strong as it says, folders that are whole or absent."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mesoshell.datasets.blender import photograph as farm
from mesoshell.datasets.blender.photograph import FIELD_OF_VIEW, FLASH, LOWEST, PhotographConfig, dome, photograph
from mesoshell.errors import InputError
from mesoshell.geometry.mesh import check_mesh, load_mesh
from mesoshell.io.image import read_exr, write_png
from mesoshell.neutex.capture import read_capture

ROOT = Path(__file__).parents[3]
FEW = PhotographConfig(views=9, size=16, spp=4, paint=None, flash=False, up=1, points=200, noise=0.01, seed=0)
pytestmark = pytest.mark.skipif(
    not (ROOT / "data_gen/.venv/installed").exists(), reason="no Blender environment (Python 3.11): make blender"
)


def cow():
    return load_mesh(ROOT / "src/mesoshell/assets/spot.obj")


def test_a_dome_is_even_and_ends_where_it_says() -> None:
    for up in (1, 2):
        u = dome(replace(FEW, views=400, up=up))
        np.testing.assert_allclose(np.linalg.norm(u, axis=1), 1)
        assert u[:, up].min() == pytest.approx(LOWEST, abs=0.01) and u[:, up].max() > 0.99
        nearest = np.sort(np.linalg.norm(u[:, None] - u[None], axis=-1), axis=1)[:, 1]
        assert nearest.max() < 2 * nearest.min()


def test_a_capture_is_read_where_the_mesh_was(tmp_path) -> None:
    seen = []
    photograph(cow(), FEW, tmp_path / "a", seen.append)
    capture = read_capture(tmp_path / "a")
    assert seen == list(range(1, 10)) and len(capture.photos) == 9 and capture.agreement > 0.95
    vertices = cow().vertices
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    assert (capture.centre - capture.half < low).all() and (capture.centre + capture.half > high).all()
    assert capture.half < 1.2 * (high - low).max() and capture.points is not None and len(capture.points) > 150
    assert not list(tmp_path.glob("*.partial"))
    with pytest.raises(InputError, match="a: exists"):
        photograph(cow(), FEW, tmp_path / "a", seen.append)


def test_the_flash_is_as_strong_as_it_says(tmp_path) -> None:
    """A white wall that faces a camera: radiance is E⊥ times albedo over π, and at most what gloss adds."""
    square = np.array([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]], float)
    wall = check_mesh(square, np.array([[0, 1, 2], [0, 2, 3]]), None, "wall")
    write_png(tmp_path / "white.png", np.ones((4, 4, 3), np.float32))
    config = replace(FEW, views=40, flash=True, paint=tmp_path / "white.png", size=8)
    photograph(wall, config, tmp_path / "a", lambda n: None)
    about = json.loads((tmp_path / "a/transforms.json").read_text())
    eye = np.array(about["frames"][0]["transform_matrix"])[:3, 3]
    distance = np.linalg.norm(eye)
    assert about["flash"] == pytest.approx(FLASH * distance**2, rel=1e-6)
    middle = read_exr(tmp_path / "a/images/000.exr")[3:5, 3:5].mean(axis=(0, 1))
    wanted = FLASH * eye[1] / distance / math.pi
    assert 0.93 * wanted < middle[0] < 1.3 * wanted and FIELD_OF_VIEW < 1


def test_what_fails_leaves_nothing(tmp_path, monkeypatch) -> None:
    def shot(command, settings):
        yield 0
        raise InputError("blender", "ended")

    monkeypatch.setattr(farm, "_shot", shot)
    monkeypatch.setattr(farm, "read_exr", lambda path: np.zeros((16, 16, 4), np.float32))
    with pytest.raises(InputError, match="blender: ended"):
        photograph(cow(), FEW, tmp_path / "a", lambda n: None)
    assert not list(tmp_path.iterdir())
