"""MesoGAN, figure 3: moved, a texture of fixed phases leaves what was learned: python -m experiments.figures.mesogan_3

From above, the same window moved along u: a generator that learned four patches, each at fixed phases, and the bundled lawn,
whose phases were drawn anew for every texture that it made in training. Each is baked once, 3 patches long.
"""

import mesoshell as ms
from experiments.figures.known_phases import above, learned
from experiments.figures.sheet import draw, over_white

MOVED = (0.0, 0.5, 1.0, 2.0)


def main() -> None:
    rows = []
    for material, more in ((learned((1, 3)), {}), (ms.load_material("lawn"), {"seed": 1})):
        strip = over_white(above(material, 3, **more))
        side = len(strip)
        rows.append([strip[:, round(x * side) : round((x + 1) * side)] for x in MOVED])
    draw("mesogan_3", rows, [f"moved by {x:g} patches" for x in MOVED], ("fixed phases", "random phases"))


if __name__ == "__main__":
    main()
