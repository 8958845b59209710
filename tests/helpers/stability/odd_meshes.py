"""Random small meshes with what is wrong with meshes: slivers, folds, duplicates, isolated vertices, seams, mirrored charts."""

from typing import NamedTuple

import numpy as np
import trimesh

from mesoshell.geometry.mesh import Mesh, check_mesh

#: Distance of the parts of a scene, in sizes of one.
APART = 4.0


class Arrays(NamedTuple):
    """vertices (N, 3), faces (M, 3), corner UVs (M, 3, 2)."""

    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray


def odd_mesh(rng: np.random.Generator) -> Arrays:
    """One mesh of about unit size, with some of the faults."""
    shape = _SHAPES[rng.integers(len(_SHAPES))](rng)
    points, faces = np.array(shape.vertices, np.float64), np.array(shape.faces)
    points = points / max(np.ptp(points, axis=0).max(), 1e-9)
    faults = [fault for fault in _FAULTS if rng.random() < 0.4]
    for fault in faults:
        points, faces = fault(rng, points, faces)
    return Arrays(points, faces, _charts(rng, points, faces))


def scene_of(seed: int, count: int, away: float) -> Mesh:
    """Many odd meshes side by side, `away` from the origin, checked as one."""
    rng = np.random.default_rng(seed)
    parts = [odd_mesh(rng) for _ in range(count)]
    side = int(np.ceil(count ** (1 / 3)))
    place = APART * np.stack(np.unravel_index(np.arange(count), (side,) * 3), axis=1) + away
    first = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return check_mesh(
        np.concatenate([part.vertices + at for part, at in zip(parts, place, strict=True)]),
        np.concatenate([part.faces + k for part, k in zip(parts, first, strict=True)]),
        np.concatenate([part.uv for part in parts]),
        "odd",
    )


def _sheet(rng: np.random.Generator) -> trimesh.Trimesh:
    x, y = np.meshgrid(np.linspace(-1, 1, 4), np.linspace(-1, 1, 4), indexing="ij")
    i = np.arange(16).reshape(4, 4)
    a, b, c, d = (corner.ravel() for corner in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    points = np.stack([x, y, rng.normal() * x * x + rng.normal() * x * y], axis=-1).reshape(-1, 3)
    return _mesh(points, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]))


def _soup(rng: np.random.Generator) -> trimesh.Trimesh:
    return _mesh(rng.normal(size=(24, 3)), np.arange(24).reshape(8, 3))


def _fan(rng: np.random.Generator) -> trimesh.Trimesh:
    """Faces around a vertex, some of them folded over."""
    angle = np.sort(rng.uniform(0, 2 * np.pi, 9))
    rim = np.stack([np.cos(angle), np.sin(angle), rng.normal(size=9)], axis=1)
    k = np.arange(9)
    return _mesh(np.concatenate([np.zeros((1, 3)), rim]), np.stack([0 * k, 1 + k, 1 + (k + 1) % 9], axis=1))


def _mesh(points: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh:
    return trimesh.Trimesh(points, faces, process=False)


_SHAPES = (
    lambda rng: trimesh.creation.icosphere(rng.integers(0, 2)),
    lambda rng: trimesh.creation.box(rng.uniform(0.05, 1, 3)),
    lambda rng: trimesh.creation.torus(1.0, rng.uniform(0.1, 0.9), major_sections=6, minor_sections=5),
    lambda rng: trimesh.creation.cone(rng.uniform(0.05, 1), 1.0, sections=6),
    _sheet,
    _soup,
    _fan,
)


def _crumpled(rng: np.random.Generator, points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return points + 10.0 ** rng.uniform(-4, -0.5) * rng.normal(size=points.shape), faces


def _squeezed(rng: np.random.Generator, points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Thin in one direction: slivers."""
    return points * np.where(np.arange(3) == rng.integers(3), 10.0 ** rng.uniform(-5, 0), 1), faces


def _collapsed(rng: np.random.Generator, points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A vertex almost on the edge of two others of its face."""
    i, j, k = faces[rng.integers(len(faces))]
    points = points.copy()
    points[k] = (
        points[i] + rng.uniform(0, 1) * (points[j] - points[i]) + 10.0 ** rng.uniform(-12, -2) * rng.normal(size=3)
    )
    return points, faces


def _torn(rng: np.random.Generator, points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Some faces taken out."""
    return points, faces[rng.random(len(faces)) < 0.7] if len(faces) > 4 else faces


def _repeated(rng: np.random.Generator, points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Faces twice, also turned over; vertices twice; vertices of no face."""
    again = faces[rng.integers(0, len(faces), 2)]
    again[1] = again[1][::-1]
    double = faces.copy()
    double[rng.integers(len(faces)), rng.integers(3)] += len(points)
    points = np.concatenate([points, points, rng.normal(size=(2, 3))])
    return points, np.concatenate([double, again])


def _turned(rng: np.random.Generator, points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Some faces wound the other way."""
    return points, np.where(rng.random((len(faces), 1)) < 0.3, faces[:, ::-1], faces)


def _crowded(rng: np.random.Generator, points: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A further face on an edge that has its faces."""
    i, j, _ = faces[rng.integers(len(faces))]
    return np.concatenate([points, rng.normal(size=(1, 3))]), np.concatenate([faces, [[i, j, len(points)]]])


_FAULTS = (_crumpled, _squeezed, _collapsed, _torn, _repeated, _turned, _crowded)


def _charts(rng: np.random.Generator, points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Corner UVs: a plane's, or a chart a face, some of them mirrored, some without area."""
    corner = points[faces][..., :2].copy()
    if rng.random() < 0.5:
        corner += rng.integers(-2, 3, (len(faces), 1, 2))
    corner[rng.random(len(faces)) < 0.2] *= [-1, 1]
    corner[rng.random(len(faces)) < 0.1] = rng.normal(size=2)
    return corner
