"""MesoGAN, figure 14: without random phases nothing is known beyond one patch: python -m experiments.figures.mesogan_14

3 × 3 patches. Left: the bundled lawn, which learned with phases drawn anew. Right: a generator that learned one patch at fixed
phases, four of them in all: it is the one in front at the left.
"""

import numpy as np
from jaxtyping import Float

import mesoshell as ms
from experiments.figures.known_phases import learned
from experiments.figures.sheet import draw, over_white
from mesoshell.scene.materials import Material

PATCHES = 3


def picture(material: Material, seed: int | None) -> Float[np.ndarray, "H W 3"]:
    """The patches aslant."""
    scene = ms.Scene(
        "experiments/scenes/plane.obj",
        material,
        scale=1 / PATCHES,
        seed=seed,
        camera=(-0.3, 0.95, 1.1, 0.0, 0.02, 0.03, 38.0),
        size=(320, 320),
        lights=[(0.6, 0.7, 0.4)],
    )
    return over_white(ms.render(scene).rgba)


def main() -> None:
    pictures = [picture(ms.load_material("lawn"), 1), picture(learned((PATCHES, PATCHES)), None)]
    draw("mesogan_14", [pictures], ("random phases", "fixed phases"), wide=3.4)


if __name__ == "__main__":
    main()
