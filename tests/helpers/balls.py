"""A capture whose truth is known: a painted ellipsoid away from the origin, in units of its own, seen from a dome.

The colour of a point is its direction from the centre: red and blue across, green by height, with dark bands. It has no
shading, so that all views agree, or it is diffuse and lit by a flash at the camera; pixels are means over SUB² points.
"""

import json
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from mesoshell.io.image import write_png
from mesoshell.io.poses import FLIP
from mesoshell.neutex.cameras import Photo, photo_rays
from mesoshell.render.camera import look_at

CENTRE, AXES = np.array([3.0, -1.0, 2.0]), np.array([1.6, 1.2, 1.0])
SUB = 3


def photos(views: int = 16, size: int = 48, distance: float = 5.5) -> list[Photo]:
    """From a spiral over three quarters of a sphere."""
    f = size * 1.2
    found = []
    for i in range(views):
        z = 0.9 - 1.3 * (i + 0.5) / views
        turn = i * np.pi * (3 - 5**0.5)
        eye = CENTRE + distance * np.array([np.cos(turn) * (1 - z * z) ** 0.5, np.sin(turn) * (1 - z * z) ** 0.5, z])
        found.append(Photo(look_at(tuple(eye), tuple(CENTRE), (0.0, 0.0, 1.0)), (f, f, size / 2, size / 2), size, size))
    return found


def colour(u: np.ndarray) -> np.ndarray:
    """Linear, of unit directions (n, 3) from the centre."""
    band = 0.6 + 0.4 * np.sign(np.sin(6 * np.arctan2(u[:, 1], u[:, 0])))
    return np.stack([0.5 + 0.4 * u[:, 0], 0.5 + 0.4 * u[:, 2], 0.5 - 0.4 * u[:, 0]], axis=1) * band[:, None]


def picture(photo: Photo, flash: float | None = None) -> np.ndarray:
    """Linear premultiplied RGBA. flash: irradiance at distance 1 of a light at the camera."""
    offset = (np.arange(SUB) + 0.5) / SUB
    y, x, j, i = np.meshgrid(np.arange(photo.height), np.arange(photo.width), offset, offset, indexing="ij")
    o, d = photo_rays(photo, np.stack([(x + i).ravel(), (y + j).ravel()], axis=1))
    p, q = (o - CENTRE) / AXES, d / AXES
    a, b, c = (q * q).sum(1), (p * q).sum(1), (p * p).sum(1) - 1
    root = b * b - a * c
    t = (-b - np.sqrt(np.maximum(root, 0))) / a
    at = o + t[:, None] * d - CENTRE
    u = at / np.linalg.norm(at, axis=1, keepdims=True)
    lit = colour(u)
    if flash:
        n = at / AXES**2
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        lit = lit / np.pi * (flash * np.maximum(-(n * d).sum(1), 0) / t**2)[:, None]
    rgba = np.concatenate([lit, np.ones((len(u), 1))], axis=1) * (root > 0)[:, None]
    return rgba.reshape(photo.height, photo.width, SUB * SUB, 4).mean(axis=2).astype(np.float32)


def cloud(n: int = 500, noise: float = 0.02) -> np.ndarray:
    """Points near the surface."""
    random = np.random.default_rng(5)
    u = random.normal(size=(n, 3))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return CENTRE + u / np.linalg.norm(u / AXES, axis=1, keepdims=True) + noise * random.normal(size=(n, 3))


def write_colmap(folder: Path, photos: list[Photo], camera: str, points: np.ndarray, ending: str = "png") -> None:
    """A COLMAP model as text; camera: its model and parameters. Images are named 000.png and so on, and not written."""
    (folder / "sparse/0").mkdir(parents=True)
    model, *parameters = camera.split()
    size = f"{photos[0].width} {photos[0].height}"
    (folder / "sparse/0/cameras.txt").write_text(f"1 {model} {size} {' '.join(parameters)}\n")
    lines = []
    for i, photo in enumerate(photos):
        view = np.linalg.inv(photo.to_world @ FLIP)
        x, y, z, w = Rotation.from_matrix(view[:3, :3]).as_quat()
        lines += [f"{i + 1} {w} {x} {y} {z} {' '.join(map(str, view[:3, 3]))} 1 {i:03d}.{ending}", ""]
    (folder / "sparse/0/images.txt").write_text("\n".join(lines) + "\n")
    rows = (f"{i + 1} {' '.join(map(str, p))} 0 0 0 0.1\n" for i, p in enumerate(points))
    (folder / "sparse/0/points3D.txt").write_text("".join(rows))


def write_capture(folder: Path, views: int = 16, size: int = 48, flash: float | None = None) -> Path:
    """transforms.json, RGBA images, and points.ply."""
    import trimesh

    (folder / "images").mkdir(parents=True)
    said = photos(views, size)
    for i, photo in enumerate(said):
        write_png(folder / f"images/{i:03d}.png", picture(photo, flash))
    fx, fy, cx, cy = said[0].lens
    about = {"fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "w": size, "h": size}
    trimesh.PointCloud(cloud()).export(folder / "points.ply")
    about |= {"ply_file_path": "points.ply"} | ({"flash": flash} if flash else {})
    frames = [{"file_path": f"images/{i:03d}.png", "transform_matrix": p.to_world.tolist()} for i, p in enumerate(said)]
    (folder / "transforms.json").write_text(json.dumps({**about, "frames": frames}))
    return folder
