"""Training rays: pixels of a dataset with their intervals in the unit box, found by the same march that renders use.

Alphabet
o, d        ray origin and direction; world and canonical frame are the same in the unit box
ξ0, ξ1      canonical ends of an interval                                     (3,)
y           x / (1 + x) of the pixel's radiance, and its alpha                (4,)

Rays that miss the box are black in data and model alike: they are left out. The unit box is a shell like any other: a
square of two triangles, extruded by 1, whose diagonal cuts a ray into at most two intervals.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from mesoshell.io.dataset import Dataset, Sample, load_images
from mesoshell.render.camera import Camera, pixel_grid, pixel_radius, rays
from mesoshell.shell.boundary import Boundary
from mesoshell.shell.extrude import Shell


class RayTable(NamedTuple):
    """One row a ray, NumPy on the host and JAX in a step: image index, pixel (row by row), direction, cone radius at
    distance 1, both intervals, target y.

    direction (R, 3); t (R, 2, 2) as [interval, end]; xi (R, 2, 2, 3); target (R, 4). An interval that is not there has t0 = t1.
    """

    image: Any
    pixel: Any
    direction: Any
    radius: Any
    t: Any
    xi: Any
    target: Any


class ImageTable(NamedTuple):
    """One row an image: direction toward the light, E⊥, normalised appearance parameters."""

    light: Float[np.ndarray, "N 3"]
    irradiance: Float[np.ndarray, "N 3"]
    alpha: Float[np.ndarray, "N A"]


def unit_box() -> Shell:
    """The canonical slab: [0, 1]² at height 0, extruded by 1, texture coordinates equal to positions."""
    base = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    return Shell(
        base=base,
        offset=np.tile(np.array([0, 0, 1], np.float32), (4, 1)),
        faces=faces,
        uv=base[faces][:, :, :2],
        neighbour=np.array([[-1, -1, 1], [0, -1, -1]], np.int32),
        neighbour_edge=np.array([[-1, -1, 0], [2, -1, -1]], np.int32),
        mesh_face=np.arange(2, dtype=np.int32),
        notes=(),
    )


def image_table(dataset: Dataset) -> ImageTable:
    """Lights and parameters of a dataset; parameters of role "alpha" only, each mapped to [0, 1] by its range."""
    columns = []
    for name, declared in dataset.manifest["parameters"].items():
        if declared["role"] == "alpha":
            low, high = declared["range"]
            columns.append([(s.parameters[name] - low) / (high - low) for s in dataset.samples])
    alpha = np.asarray(columns, np.float32).reshape(len(columns), len(dataset.samples)).T
    return ImageTable(
        np.array([s.light for s in dataset.samples], np.float32),
        np.array([s.irradiance for s in dataset.samples], np.float32),
        np.ascontiguousarray(alpha),
    )


def ray_table(dataset: Dataset) -> RayTable:
    """All rays of a dataset that meet the box."""
    shell = unit_box()
    boundary = Boundary(shell, shell.faces, opaque=False)
    images = load_images(dataset)
    parts = []
    for begin in range(0, len(dataset.samples), 8):  # several images a trace: each has a fixed cost
        some = range(begin, min(begin + 8, len(dataset.samples)))
        o, d, radius = (np.concatenate(x) for x in zip(*(_pixel_rays(dataset.samples[i]) for i in some), strict=True))
        index = np.repeat(np.array(some, np.int32), len(o) // len(some))
        pixel = np.tile(np.arange(len(o) // len(some), dtype=np.int32), len(some))
        pixels = images[some.start : some.stop].reshape(-1, 4)
        t, xi = box_intervals(boundary, shell, o, d)
        hits = np.flatnonzero(t[:, 0, 1] > t[:, 0, 0])
        colour = pixels[hits, :3]
        target = np.concatenate([colour / (1 + colour), pixels[hits, 3:]], axis=1)
        parts.append((index[hits], pixel[hits], d[hits], radius[hits], t[hits], xi[hits], target))
    return RayTable(*(_joined(column) for column in zip(*parts, strict=True)))


def join(tables: list[tuple[RayTable, ImageTable]]) -> tuple[RayTable, ImageTable]:
    """Rays and images of several datasets as one."""
    first = np.cumsum([0] + [len(images.light) for _, images in tables])
    moved = [r._replace(image=r.image + first[i].astype(np.int32)) for i, (r, _) in enumerate(tables)]
    images = ImageTable(*(np.concatenate(x) for x in zip(*(i for _, i in tables), strict=True)))
    return RayTable(*(np.concatenate(x) for x in zip(*moved, strict=True))), images


def _pixel_rays(sample: Sample) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Origins, directions and cone radii of all pixels of one image, row by row."""
    camera = Camera(np.asarray(sample.camera_to_world, np.float64), sample.fov, *sample.size)
    o, d = rays(camera, pixel_grid(camera, 1, 0))
    return o, d, np.full(len(o), pixel_radius(camera.spread))


def box_intervals(
    boundary: Boundary, shell: Shell, o: Float[np.ndarray, "R 3"], d: Float[np.ndarray, "R 3"]
) -> tuple[Float[np.ndarray, "R 2 2"], Float[np.ndarray, "R 2 2 3"]]:
    """t and ξ at both ends of each ray's first two intervals (a unit box has no third)."""
    i = boundary.trace(o, d).intervals
    rank = np.arange(len(i.ray)) - np.searchsorted(i.ray, i.ray)
    i = type(i)(*(x[rank < 2] for x in i))
    rank = rank[rank < 2]
    t = np.zeros((len(o), 2, 2), np.float32)
    xi = np.zeros((len(o), 2, 2, 3), np.float32)
    t[i.ray, rank] = np.stack([i.t0, i.t1], axis=1)
    corners = shell.uv[i.prism]
    for end, (bary, h) in enumerate(((i.bary0, i.h0), (i.bary1, i.h1))):
        weights = np.concatenate([bary, 1 - bary.sum(axis=1, keepdims=True)], axis=1)
        xi[i.ray, rank, end] = np.concatenate([np.einsum("ik,ikc->ic", weights, corners), h[:, None]], axis=1)
    return t, xi


def _joined(column: tuple) -> np.ndarray:
    joined = np.concatenate(column)
    return joined.astype(np.float32) if joined.dtype == np.float64 else joined
