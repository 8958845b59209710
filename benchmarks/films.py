"""How much films flicker, and what less of it costs: python -m benchmarks.films [--frames N] [--size N]

Flicker (film/flicker) and seconds a frame of spot with bundled materials, endless and of one fitted patch, at three qualities:
on an orbit of 5° a frame, and on a dolly that halves the distance every four frames.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

import mesoshell as ms
from mesoshell.film.motion import Motion, rotate_about
from mesoshell.film.shoot import plan_motion, shoot
from mesoshell.geometry.mesh import bounding_box
from mesoshell.io.material import bundled_materials
from mesoshell.render.quality import PRESETS, Quality
from mesoshell.scene.kept_meshes import mesh_of

MESH = Path("tests/data/spot.obj")
MATERIALS = ("grass", "turf", "lawn", "carpet")
STEP = np.radians(5)
QUALITIES = {"draft": PRESETS["draft"], "normal": PRESETS["normal"], "16 a pixel": Quality(pixel_samples=16)}


def orbit(count: int, still: ms.Scene) -> Motion:
    """A part of a turn around the middle of the mesh."""
    assert isinstance(still.camera, ms.Camera)
    camera, pivot = still.camera, bounding_box(mesh_of(still.mesh)).astype(np.float64).mean(axis=0)
    return Motion(count, lambda k: {"camera": rotate_about(camera, pivot, 1, STEP * k)})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=5)
    parser.add_argument("--size", type=int, default=128)
    given = parser.parse_args()
    print(f"{'material':<9} {'motion':<6} {'quality':<10} {'flicker':>8} {'at most':>8} {'s a frame':>10}")
    for name in (name for name in MATERIALS if name in bundled_materials()):
        scene = ms.Scene(MESH, ms.load_material(name), size=(given.size, given.size))
        moves = {
            "orbit": lambda still: orbit(given.frames, still),
            "dolly": plan_motion(scene, dolly=given.frames, far=2 ** ((given.frames - 1) / 4)),
        }
        for motion, move in moves.items():
            for quality, settings in QUALITIES.items():
                with tempfile.TemporaryDirectory() as folder:
                    made = shoot(scene, move, Path(folder) / "film", settings)
                known = [x for x in made.flicker if x is not None]
                seconds = np.median(made.seconds[1:])  # the first compiles
                print(
                    f"{name:<9} {motion:<6} {quality:<10} {np.mean(known):8.4f} {max(known):8.4f} {seconds:10.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
