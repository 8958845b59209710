"""Unwrapping: no chart mirrored or stretched, whatever the unit, and a crash of xatlas stays its own."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from mesoshell.errors import InputError
from mesoshell.geometry import unwrap as unwrapping
from mesoshell.geometry.mesh import check_mesh, load_mesh, uv_stretch
from mesoshell.geometry.unwrap import parts_of, unwrap

SUZANNE = load_mesh(Path(__file__).parents[1] / "data" / "suzanne.obj")
STRIP = np.array([[0.0, 0, 0], [8, 0, 0], [8, 1, 0], [0, 1, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def tangents(vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """∂P/∂(u, v) of each triangle (F, 2, 3), from the two edges that it maps, and the determinant of these in uv (F,)."""
    corner, chart = vertices.astype(np.float64)[faces], uv.astype(np.float64)
    edges, steps = corner[:, 1:] - corner[:, :1], chart[:, 1:] - chart[:, :1]
    return np.linalg.solve(steps, edges), np.linalg.det(steps)


def test_an_unwrapping_is_not_mirrored_and_keeps_proportions():
    uv = SUZANNE.uv
    assert uv.min() >= 0 and 0.9 < uv.max() <= 1
    along, area = tangents(SUZANNE.vertices, SUZANNE.faces, uv)
    assert (area > 0).all()
    sizes = np.median(np.linalg.norm(along, axis=2), axis=0)
    np.testing.assert_allclose(sizes, uv_stretch(SUZANNE), rtol=0.1)


def test_an_unwrapped_strip_has_one_scale():
    uv, charts = unwrap(STRIP, FACES)
    u, v = np.moveaxis(tangents(STRIP, FACES, uv)[0], 1, 0)
    assert charts == 1
    np.testing.assert_allclose(np.linalg.norm(u, axis=1), np.linalg.norm(v, axis=1), rtol=1e-2)
    np.testing.assert_allclose((u * v).sum(axis=1), 0, atol=1e-2 * (u * u).sum())


@pytest.mark.parametrize("size", [1e-30, 1e-3, 1e12])
def test_unwrapping_does_not_depend_on_the_unit(size: float):
    scaled = (SUZANNE.vertices * np.float64(size)).astype(np.float32)
    uv, charts = unwrap(scaled, SUZANNE.faces)
    assert 50 < charts < 100 and uv.min() >= 0 and 0.9 < uv.max() <= 1


def test_a_module_of_the_working_folder_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "xatlas.py").write_text("raise SystemExit(3)\n")
    monkeypatch.chdir(tmp_path)
    ball = trimesh.creation.icosphere(1)
    assert unwrapping._in_child(np.asarray(ball.vertices), np.asarray(ball.faces), np.zeros(80, np.int64)) is not None


def test_where_xatlas_dies_it_is_asked_again_and_then_given_up(monkeypatch: pytest.MonkeyPatch):
    asked = []

    def die(vertices: np.ndarray, faces: np.ndarray, parts: np.ndarray) -> None:
        asked.append(vertices)

    monkeypatch.setattr(unwrapping, "_in_child", die)
    with pytest.raises(InputError, match=r"^strip: has no usable UVs, and xatlas cannot unwrap it: give it UVs$"):
        check_mesh(STRIP, FACES, None, "strip")
    assert len(asked) == 2 and 0 < np.abs(asked[0] - asked[1]).max() < 0.2


@pytest.mark.slow
def test_a_sphere_that_kills_xatlas_is_unwrapped():
    ball = trimesh.creation.icosphere(6)
    uv, charts = unwrap(np.array(ball.vertices), np.array(ball.faces))
    assert charts > 1 and np.isfinite(uv).all()


def test_a_large_mesh_is_cut_into_parts_of_one_scale(monkeypatch: pytest.MonkeyPatch):
    """Charts of all parts lie apart in one atlas, none mirrored, and a part's patches are as large as another's."""
    monkeypatch.setattr(unwrapping, "PART", 200)
    parts = parts_of(SUZANNE.vertices[SUZANNE.faces].mean(axis=1).astype(np.float64))
    assert len(np.unique(parts)) == 4
    uv, charts = unwrap(SUZANNE.vertices, SUZANNE.faces)
    assert 50 < charts < 150 and uv.min() >= 0 and 0.9 < uv.max() <= 1
    along, area = tangents(SUZANNE.vertices, SUZANNE.faces, uv)
    assert (area > 0).all()
    sizes = np.linalg.norm(along, axis=2).mean(axis=1)
    each = [np.median(sizes[parts == k]) for k in range(4)]
    np.testing.assert_allclose(each, np.median(sizes), rtol=0.05)
    assert area.sum() / 2 < 1  # twice the areas: charts that lay on each other could fill more
    shared = np.zeros((512, 512), int)
    for k in range(4):
        cells = np.unique((uv[parts == k].mean(axis=1) * 511).astype(int), axis=0)
        shared[tuple(cells.T)] += 1
    assert (shared > 1).mean() < 0.001


def test_small_meshes_are_one_part():
    assert not parts_of(np.random.default_rng(0).random((9999, 3))).any()
    assert len(np.unique(parts_of(np.random.default_rng(0).random((10_000, 3))))) == 2
