"""Geometry on a mesh: closed where coordinates close, bare at seams, and where the mesh's normals say."""

import numpy as np
import pytest
import trimesh

from mesoshell.datasets.queries.dress import apply_mesostructure
from mesoshell.datasets.queries.sources import of_heights
from mesoshell.geometry.mesh import Mesh, uv_stretch

RING, TUBE, AROUND, ACROSS = 1.0, 0.4, 60, 24


@pytest.fixture(scope="module")
def torus() -> Mesh:
    p, t = np.meshgrid(np.arange(AROUND) / AROUND, np.arange(ACROSS) / ACROSS, indexing="ij")
    normal = np.stack(
        [
            np.cos(2 * np.pi * t) * np.cos(2 * np.pi * p),
            np.sin(2 * np.pi * t),
            -np.cos(2 * np.pi * t) * np.sin(2 * np.pi * p),
        ],
        axis=-1,
    )
    ring = np.stack([np.cos(2 * np.pi * p), 0 * p, -np.sin(2 * np.pi * p)], axis=-1)
    points = (RING * ring + TUBE * normal).reshape(-1, 3).astype(np.float32)
    faces, uv = [], []
    for a in range(AROUND):
        for b in range(ACROSS):
            square = [(a, b), (a + 1, b), (a + 1, b + 1), (a, b + 1)]
            number = [i % AROUND * ACROSS + j % ACROSS for i, j in square]
            place = [(i / AROUND * 5.0, j / ACROSS * 2.0) for i, j in square]
            for k in ((0, 1, 2), (0, 2, 3)):
                faces.append([number[i] for i in k])
                uv.append([place[i] for i in k])
    return Mesh(
        points, np.array(faces, np.int32), np.array(uv, np.float32), normal.reshape(-1, 3).astype(np.float32), ()
    )


def bumps():
    v, u = np.meshgrid(np.arange(12) / 12, np.arange(12) / 12, indexing="ij")
    return of_heights(np.sin(2 * np.pi * u) * np.cos(2 * np.pi * v), 0.1)


def test_a_torus_of_whole_periods_is_closed(torus) -> None:
    """Around its texture's seams too: no triangle is missing there, and none is there twice."""
    tile, period = bumps(), float(uv_stretch(torus))
    points, faces, albedo = apply_mesostructure(tile, torus, period)
    assert len(points) == len(albedo)
    outer = faces[: len(faces) - len(torus.faces)]
    assert len(outer) == 5 * 2 * len(tile.faces)
    one, of = np.unique(np.round(points, 5), axis=0, return_inverse=True)
    mesh = trimesh.Trimesh(one, of.ravel()[outer], process=False)
    assert mesh.is_watertight and mesh.euler_number == 0
    away = np.hypot(np.hypot(points[:, 0], points[:, 2]) - RING, points[:, 1])
    assert TUBE - 0.105 * period < away.min() and away.max() <= TUBE + 1e-6


def test_a_square_of_whole_periods_is_no_torus() -> None:
    """It counts as closed by its coordinates; what would reach from one side to the other is left out."""
    corners = np.array([[0, 0], [4, 0], [4, 4], [0, 4]], np.float32)
    points = np.concatenate([corners, np.zeros((4, 1), np.float32)], axis=1)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    up = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
    square = Mesh(points, faces, corners[faces], up, ())
    tile = bumps()
    made, of, _ = apply_mesostructure(tile, square, 1.0)
    outer = of[: len(of) - 2]
    assert 0.9 < len(outer) / (16 * len(tile.faces)) < 1
    edge = np.linalg.norm(made[outer] - made[np.roll(outer, 1, axis=1)], axis=-1)
    assert edge.max() < 3 * np.hypot(1 / 12, 1 / 12) + 0.1


def test_seams_elsewhere_stay_bare(torus) -> None:
    """Of a number of periods that is not whole, what crosses the seam is left out, and nothing else."""
    tile, period = bumps(), float(uv_stretch(torus)) / 1.1  # 5.5 times 2.2 periods
    _, faces, _ = apply_mesostructure(tile, torus, period)
    outer = len(faces) - len(torus.faces)
    assert 0.85 < outer / (5.5 * 2.2 * len(tile.faces)) < 1
