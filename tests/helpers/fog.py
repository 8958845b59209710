"""A dataset of fog: a homogeneous unit box, whose images are known in closed form.

alpha = 1 − e^{−σℓ} for a ray that runs ℓ through the box, and radiance = ρ E⊥ alpha.
"""

import hashlib
import json
from pathlib import Path

import numpy as np

from mesoshell.io.dataset import Dataset, read_dataset
from mesoshell.io.image import write_exr
from mesoshell.render.camera import Camera, look_at, pixel_grid, rays

SIGMA, RHO, SIZE, FOV = 1.5, np.array([0.05, 0.1, 0.02]), 12, 0.5
IRRADIANCE = np.array([10.0, 8.0, 6.0])
CAMERAS = [(2.6, -1.4, 2.2), (-1.5, 0.4, 2.4), (0.4, 2.9, 1.6), (0.6, 0.3, 3.4)]


def through_box(o: np.ndarray, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distances at which rays enter and leave the unit box; the same where they miss it."""
    with np.errstate(divide="ignore"):
        ends = np.stack([-o / d, (1 - o) / d])
    near, far = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
    return near, np.maximum(far, near)


def write(
    folder: Path, cameras: list[tuple[float, float, float]], size: int = SIZE, instances: list[int] | None = None
) -> Dataset:
    """instances: which of many patches each picture shows; one patch if not given."""
    (folder / "images").mkdir(parents=True)
    rows = []
    for k, eye in enumerate(cameras):
        pose = look_at(eye, (0.5, 0.5, 0.5), (0.0, 0.0, 1.0))
        camera = Camera(pose, FOV, size, size)
        o, d = rays(camera, pixel_grid(camera, 1, 0))
        near, far = through_box(o, d)
        alpha = -np.expm1(-SIGMA * (far - near))[:, None]
        path = folder / f"images/{k:06d}.exr"
        image = np.concatenate([RHO * IRRADIANCE * alpha, alpha], axis=1).astype(np.float32)
        write_exr(path, image.reshape(size, size, 4))
        rows.append(
            {
                "index": k,
                "file": f"images/{k:06d}.exr",
                "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
                "seed": k,
                "size": [size, size],
                "parameters": {"age": 0.5 + k % 9},
                "camera_to_world": pose.tolist(),
                "fov": FOV,
                "radius": float(np.linalg.norm(np.subtract(eye, 0.5))),
                "light": [0.6, 0.0, 0.8],
                "irradiance": IRRADIANCE.tolist(),
                **({} if instances is None else {"instance": instances[k]}),
            }
        )
    manifest = {
        "schema": 1,
        "recipe": "fog",
        "version": 1,
        "alpha": "premultiplied",
        "field_of_view": FOV,
        "parameters": {"age": {"role": "alpha", "range": [0, 10], "default": 0.5, "unit": "", "meaning": "nothing"}},
        "radius_range": [1.0, 4.0],
        "size": [size, size],
        "samples_per_pixel": 1,
        "seed": 0,
        "count": len(rows),
        **({} if instances is None else {"patch": None, "views": 1}),
    }
    (folder / "manifest.json").write_text(json.dumps(manifest))
    (folder / "samples.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    return read_dataset(folder)
