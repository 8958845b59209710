"""NeuTex, figure 7: the surface that a noisy cloud taught, and the last one: python -m experiments.figures.neutex_7 RUN PHOTOS

RUN is of experiments/atlas_cloud_first.py, to its end, on PHOTOS whose cloud has much noise. Surfaces are F_uv⁻¹ of a sphere's
points, lit from the camera; the cloud is seen from there.
"""

import argparse
from pathlib import Path

import jax
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from trimesh.creation import icosphere

from experiments.figures.sheet import draw
from mesoshell.neutex.capture import read_capture
from mesoshell.neutex.field import to_surface
from mesoshell.neutex.store import NeuTexModel, read_neutex
from mesoshell.render.camera import Camera, look_at, pixel_grid, rays
from mesoshell.train.neutex.step import NeuTexTrainConfig
from mesoshell.train.run_config import read_record, snapshots

EYES, SIZE = ((1.6, 0.9, -2.4), (-2.4, 0.6, -1.6)), 320


def surface(model: NeuTexModel) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, in the box's units, and triangles."""
    ball = icosphere(subdivisions=6)
    y = jax.jit(jax.vmap(lambda u: to_surface(model.field, u)))(np.float32(ball.vertices))
    return np.asarray(y, np.float64), np.asarray(ball.faces)


def lit(vertices: np.ndarray, faces: np.ndarray, camera: Camera) -> np.ndarray:
    """As white clay with the light at the camera, triangles flat."""
    scene = EmbreeScene()
    corners = vertices[faces]
    TriangleMesh(scene, np.float32(corners))
    o, d = rays(camera, pixel_grid(camera, 1, 0))
    met = scene.run(np.float32(o), np.float32(d)).reshape(-1)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    shade = np.where(met < 0, 1.0, 0.15 + 0.8 * np.abs(np.einsum("ij,ij->i", across[met], d)))
    return shade.reshape(camera.height, camera.width)


def dots(points: np.ndarray, camera: Camera) -> np.ndarray:
    """A cloud, from a camera."""
    local = (points - camera.to_world[:3, 3]) @ camera.to_world[:3, :3]
    x, y = local[:, :2].T / -local[:, 2] / camera.spread
    column, row = np.round([x + camera.width / 2, camera.height / 2 - y]).astype(int)
    image = np.ones((camera.height, camera.width))
    for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
        image[np.clip(row + i, 0, SIZE - 1), np.clip(column + j, 0, SIZE - 1)] = 0.25
    return image


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="folder of the run")
    parser.add_argument("capture", type=Path, help="folder of its photographs")
    given = parser.parse_args()
    config, _ = read_record(given.run)
    assert isinstance(config, NeuTexTrainConfig)
    files = snapshots(given.run)
    taught = next(path for images, path in files if images >= 1000 * config.kimg * config.chamfer)
    models = [read_neutex(path) for path in (taught, files[-1][1])]
    capture = read_capture(given.capture)
    assert capture.points is not None
    cloud = capture.to_box(capture.points)
    cameras = [Camera(look_at(eye, (0, 0, 0)), 0.75, SIZE, SIZE) for eye in EYES]
    made = [surface(model) for model in models]
    rows = [[dots(cloud, camera), *(lit(*one, camera) for one in made)] for camera in cameras]
    draw("neutex_7", rows, ("cloud", "taught by it", "then by cycle, masks and pictures"))


if __name__ == "__main__":
    main()
