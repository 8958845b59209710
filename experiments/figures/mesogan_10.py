"""MesoGAN, figure 10: materials with a direction: python -m experiments.figures.mesogan_10

The bundled carpet, its pile combed along u, along v, and in whirls that an image draws.
"""

import numpy as np
from jaxtyping import Float

import mesoshell as ms
from experiments.figures.sheet import draw, over_white

COMBED = {"along u": 0.0, "along v": np.pi / 2, "whirls, by an image": "experiments/scenes/comb.exr"}
MESHES = {
    "experiments/scenes/plane.obj": (1 / 8, (0.0, 0.9, 0.8, 0.0, 0.0, 0.02, 42.0)),
    "src/mesoshell/assets/spot.obj": (0.2, (1.5, 0.9, -2.4, 0.0, 0.05, 0.15, 40.0)),
}


def picture(mesh: str, angle: float | str) -> Float[np.ndarray, "H W 3"]:
    """A mesh with the carpet combed so."""
    scale, camera = MESHES[mesh]
    scene = ms.Scene(
        mesh,
        ms.load_material("carpet"),
        scale=scale,
        params={"lean": 0.8, "lean_angle": angle, "hue": 0.6},
        camera=camera,
        size=(256, 256),
    )
    return over_white(ms.render(scene).rgba)


def main() -> None:
    draw("mesogan_10", [[picture(mesh, angle) for angle in COMBED.values()] for mesh in MESHES], [*COMBED])


if __name__ == "__main__":
    main()
