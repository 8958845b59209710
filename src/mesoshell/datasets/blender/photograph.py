"""Photographs of a mesh by Blender, as a capture that `mesoshell atlas train` reads: images, poses, a point cloud.

Notation
dome        directions from the mesh's middle, spread evenly over the part of the sphere above LOWEST, pole first; z or y up
distance    from the middle: where the mesh's bounding sphere fills FILL of the frame
cloud       points of the surface, by area, moved by a normal deviation of `noise` × the longest side of the bounding box
"""

import json
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mesoshell.datasets.blender.process import blender_command
from mesoshell.errors import InputError
from mesoshell.geometry.mesh import Mesh
from mesoshell.io.atomic import new_folder, replace_file
from mesoshell.io.image import read_exr, write_exr, write_png
from mesoshell.render.camera import look_at

#: Full angle of view, radians.
FIELD_OF_VIEW, FILL, LOWEST = 0.7, 0.85, -0.35
#: E⊥ of the flash at the camera's distance.
FLASH = 6.0


@dataclass(frozen=True)
class PhotographConfig:
    """views, size and spp of the photographs; paint: image file; flash: light from the camera alone; up: axis, 1 or 2."""

    views: int
    size: int
    spp: int
    paint: Path | None
    flash: bool
    up: int
    points: int
    noise: float
    seed: int


def photograph(mesh: Mesh, config: PhotographConfig, out: Path, show: Callable[[int], None]) -> None:
    """Write the capture's folder, whole or not at all. Raises InputError if it exists, or if Blender is missing or fails."""
    command = blender_command("data_gen.photographer")
    with new_folder(out) as folder:
        (folder / "images").mkdir()
        _write(mesh, config, folder, command, show)


def _write(
    mesh: Mesh, config: PhotographConfig, folder: Path, command: tuple[list[str], Path], show: Callable[[int], None]
) -> None:
    low, high = mesh.vertices.min(axis=0).astype(float), mesh.vertices.max(axis=0).astype(float)
    centre = (low + high) / 2
    distance = np.linalg.norm(mesh.vertices - centre, axis=1).max() / np.sin(FILL * FIELD_OF_VIEW / 2)
    up = tuple(np.eye(3)[config.up])
    poses = [look_at(tuple(centre + distance * u), tuple(centre), up).tolist() for u in dome(config)]
    suffix, write = ("exr", write_exr) if config.flash else ("png", write_png)
    with tempfile.TemporaryDirectory() as scratch:
        np.savez(Path(scratch) / "mesh.npz", vertices=mesh.vertices, faces=mesh.faces, uv=mesh.uv)
        settings = {
            "mesh": f"{scratch}/mesh.npz",
            "frames": [{"file": f"{scratch}/{i}.exr", "camera_to_world": m} for i, m in enumerate(poses)],
            "fov": FIELD_OF_VIEW,
            "size": config.size,
            "samples_per_pixel": config.spp,
            "paint": config.paint and str(config.paint.resolve()),
            "flash": FLASH * distance**2 if config.flash else None,
            "sun": np.roll([0.5, -0.35, 0.8], config.up - 2).tolist(),
            "threads": 0,
        }
        (Path(scratch) / "settings.json").write_text(json.dumps(settings))
        for i in _shot(command, f"{scratch}/settings.json"):
            write(folder / f"images/{i:03d}.{suffix}", read_exr(f"{scratch}/{i}.exr"))
            show(i + 1)
    _cloud(mesh, config, float((high - low).max())).export(folder / "points.ply")
    f, middle = config.size / 2 / np.tan(FIELD_OF_VIEW / 2), config.size / 2
    about = {"fl_x": f, "fl_y": f, "cx": middle, "cy": middle, "w": config.size, "h": config.size}
    about |= {"flash": settings["flash"]} if config.flash else {}
    frames = [{"file_path": f"images/{i:03d}.{suffix}", "transform_matrix": m} for i, m in enumerate(poses)]
    text = json.dumps({**about, "ply_file_path": "points.ply", "frames": frames}, indent=1)
    replace_file(folder / "transforms.json", f"{text}\n".encode())


def dome(config: PhotographConfig) -> Float[np.ndarray, "V 3"]:
    """Unit vectors, on a spiral whose turns are as far apart as the points on them."""
    i = (np.arange(config.views) + 0.5) / config.views
    height, turn = 1 - i * (1 - LOWEST), np.arange(config.views) * np.pi * (3 - 5**0.5)
    ring = np.sqrt(1 - height**2)
    across = ring * np.cos(turn), ring * np.sin(turn)
    directions = np.empty((config.views, 3))
    directions[:, config.up] = height
    directions[:, (config.up + 1) % 3], directions[:, (config.up + 2) % 3] = across
    return directions


def _shot(command: tuple[list[str], Path], settings: str) -> Iterator[int]:
    """Numbers of the photographs, as each is finished."""
    words, root = command
    with tempfile.TemporaryFile("w+", errors="replace") as errors:
        process = subprocess.Popen([*words, settings], cwd=root, stdout=subprocess.PIPE, stderr=errors, text=True)
        assert process.stdout
        try:
            with process.stdout:
                for line in process.stdout:
                    yield json.loads(line)["index"]
            status = process.wait()
        finally:
            process.kill()
            process.wait()
        if status:
            errors.seek(0)
            lines = [line for line in errors.read().splitlines() if line.strip()] or [f"exit status {status}"]
            raise InputError("blender", f"ended before all photographs were finished: {lines[-1].strip()}")


def _cloud(mesh: Mesh, config: PhotographConfig, side: float):
    import trimesh

    whole = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    points, _ = trimesh.sample.sample_surface(whole, config.points, seed=config.seed)  # type: ignore[attr-defined]
    moved = np.random.default_rng(config.seed).normal(size=points.shape) * config.noise * side
    return trimesh.PointCloud(points + moved)
