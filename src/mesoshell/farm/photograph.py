"""Photographs of a mesh by Blender, as a capture that `mesoshell atlas train` reads: images, poses, a point cloud (floor 5).

Alphabet
dome        directions from the mesh's middle, spread evenly over the part of the sphere above LOWEST, pole first; z or y up
distance    from the middle: where the mesh's bounding sphere fills FILL of the frame
cloud       points of the surface, by area, moved by a normal deviation of `noise` × the longest side of the bounding box
"""

import json
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mesoshell.errors import InputError
from mesoshell.farm.blender import blender_command
from mesoshell.geometry.mesh import Mesh
from mesoshell.io.image import read_exr, write_exr, write_png
from mesoshell.io.whole import replace_file
from mesoshell.render.camera import look_at

#: Full angle of view, radians.
FIELD_OF_VIEW, FILL, LOWEST = 0.7, 0.85, -0.35
#: E⊥ of the flash at the camera's distance.
FLASH = 6.0


@dataclass(frozen=True)
class Shooting:
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


def photograph(mesh: Mesh, shooting: Shooting, out: Path, show: Callable[[int], None]) -> None:
    """Write the capture's folder. Raises InputError if it exists, or Blender is not there or fails."""
    if out.exists():
        raise InputError(out, "exists")
    vertices = np.asarray(mesh.vertices, np.float64)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre = (low + high) / 2
    radius = np.linalg.norm(vertices - centre, axis=1).max()
    distance = radius / np.sin(FILL * FIELD_OF_VIEW / 2)
    poses = [
        look_at(tuple(centre + distance * u), tuple(centre), tuple(np.eye(3)[shooting.up])) for u in dome(shooting)
    ]
    partial = out.with_name(out.name + ".partial")
    (partial / "images").mkdir(parents=True, exist_ok=True)
    suffix = "exr" if shooting.flash else "png"
    with tempfile.TemporaryDirectory() as scratch:
        np.savez(Path(scratch) / "mesh.npz", vertices=vertices, faces=mesh.faces, uv=mesh.uv)
        frames = [{"file": f"{scratch}/{i}.exr", "camera_to_world": m.tolist()} for i, m in enumerate(poses)]
        settings = {
            "mesh": f"{scratch}/mesh.npz",
            "frames": frames,
            "fov": FIELD_OF_VIEW,
            "size": shooting.size,
            "samples_per_pixel": shooting.spp,
            "paint": shooting.paint and str(shooting.paint.resolve()),
            "flash": FLASH * distance**2 if shooting.flash else None,
            "sun": np.roll([0.5, -0.35, 0.8], shooting.up - 2).tolist(),
            "threads": 0,
        }
        for i in _shot(settings):
            image = read_exr(f"{scratch}/{i}.exr")
            (write_exr if shooting.flash else write_png)(partial / f"images/{i:03d}.{suffix}", image)
            show(i + 1)
    _cloud(mesh, shooting, float((high - low).max())).export(partial / "points.ply")
    f = shooting.size / 2 / np.tan(FIELD_OF_VIEW / 2)
    about = {
        "fl_x": f,
        "fl_y": f,
        "cx": shooting.size / 2,
        "cy": shooting.size / 2,
        "w": shooting.size,
        "h": shooting.size,
        "ply_file_path": "points.ply",
        "frames": [
            {"file_path": f"images/{i:03d}.{suffix}", "transform_matrix": m.tolist()} for i, m in enumerate(poses)
        ],
    }
    if shooting.flash:
        about["flash"] = FLASH * distance**2
    replace_file(partial / "transforms.json", (json.dumps(about, indent=1) + "\n").encode())
    partial.rename(out)


def dome(shooting: Shooting) -> Float[np.ndarray, "V 3"]:
    """Unit vectors, on a spiral whose turns are as far apart as the points on them."""
    i = (np.arange(shooting.views) + 0.5) / shooting.views
    height, turn = 1 - i * (1 - LOWEST), np.arange(shooting.views) * np.pi * (3 - 5**0.5)
    ring = np.sqrt(1 - height**2)
    across = ring * np.cos(turn), ring * np.sin(turn)
    found = np.empty((shooting.views, 3))
    found[:, shooting.up] = height
    found[:, (shooting.up + 1) % 3], found[:, (shooting.up + 2) % 3] = across
    return found


def _shot(settings: Mapping[str, object]):
    """Numbers of the photographs, as they are there."""
    command, root = blender_command("data_gen.photographer")
    with tempfile.TemporaryFile("w+", errors="replace") as errors:
        process = subprocess.Popen(
            [*command, json.dumps(settings)], cwd=root, stdout=subprocess.PIPE, stderr=errors, text=True
        )
        assert process.stdout
        try:
            for line in process.stdout:
                yield json.loads(line)["index"]
            status = process.wait()
        finally:
            process.kill()
            process.wait()
        if status:
            errors.seek(0)
            said = [line for line in errors.read().splitlines() if line.strip()] or [f"exit status {status}"]
            raise InputError("blender", f"ended before all photographs were there: {said[-1].strip()}")


def _cloud(mesh: Mesh, shooting: Shooting, side: float):
    import trimesh

    whole = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    points, _ = trimesh.sample.sample_surface(whole, shooting.points, seed=shooting.seed)  # type: ignore[attr-defined]
    moved = np.random.default_rng(shooting.seed).normal(size=points.shape) * shooting.noise * side
    return trimesh.PointCloud(points + moved)
