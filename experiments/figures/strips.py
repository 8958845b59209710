"""Strips of parameters: what each parameter of the bundled generators does: python -m experiments.figures.strips

Seven values from the least to the greatest, all others by default, one camera and one light.
"""

import numpy as np
from jaxtyping import Float

import mesoshell as ms
from experiments.figures.sheet import draw, over_white

MATERIALS, VALUES, SIZE = ("lawn", "carpet", "fur"), 7, (128, 96)
CAMERA = (0.0, 0.55, 1.1, 0.0, 0.06, 0.0, 30.0)


def picture(material: ms.Material, name: str, value: float) -> Float[np.ndarray, "H W 3"]:
    """Six by six patches on a square with this value."""
    scene = ms.Scene(
        "experiments/scenes/plane.obj",
        material,
        scale=1 / 6,
        params={name: value},
        camera=CAMERA,
        size=SIZE,
        lights=[(0.6, 0.7, 0.4)],
    )
    return over_white(ms.render(scene).rgba)


def main() -> None:
    rows, names = [], []
    for name in MATERIALS:
        material = ms.load_material(name)
        for parameter in material.shell.parameters:
            values = np.linspace(*parameter.range, VALUES)
            rows.append([picture(material, parameter.name, float(x)) for x in values])
            names.append(f"{name}: {parameter.name}")
    draw("strips", rows, ["least", *[""] * (VALUES - 2), "greatest"], names, wide=1.4)


if __name__ == "__main__":
    main()
