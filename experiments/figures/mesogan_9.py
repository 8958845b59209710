"""MesoGAN, figure 9: what mip maps are for: python -m experiments.figures.mesogan_9

A field of `turf` (packages/materials), from nearby to far away. One ray a pixel without a filter flickers from pixel to pixel;
one ray with it does not; 36 rays without it are what both are to show.
"""

import numpy as np
from jaxtyping import Float

import mesoshell as ms
from experiments.figures.sheet import draw, over_white

#: Distance of the camera, in patches.
DISTANCES, SIDE, PATCHES = (3.0, 15.0, 75.0), 144, 100
WAYS = {
    "no filter, 1 ray": {"filtering": False, "pixel_samples": 1},
    "mip maps, 1 ray": {"footprint": 1.0, "pixel_samples": 1},
    "no filter, 36 rays": {"filtering": False, "pixel_samples": 36},
}


def picture(distance: float, changes: dict) -> Float[np.ndarray, "H W 3"]:
    """The field aslant; its patches are 1 long."""
    scene = ms.Scene(
        "experiments/scenes/plane.obj",
        ms.load_material("turf"),
        scale=1 / PATCHES,
        seed=3,
        camera=(0.0, 0.55 * distance / PATCHES, 0.83 * distance / PATCHES, 0.0, 0.0, 0.0, 40.0),
        size=(SIDE, SIDE),
        lights=[(0.6, 0.5, 0.5)],
    )
    return over_white(ms.render(scene, samples=64, light_samples=0, **changes).rgba)


def main() -> None:
    rows = [[picture(distance, changes) for changes in WAYS.values()] for distance in DISTANCES]
    draw("mesogan_9", rows, [*WAYS], [f"{distance:g} patches away" for distance in DISTANCES])


if __name__ == "__main__":
    main()
