"""MesoGAN, figure 8: scenes with global illumination: python -m experiments.figures.mesogan_8 [--spp 64]

Path-traced by Mitsuba: a room with a carpet, a cow with fur, a head of grass and a mirror; the same room with one material, of
three ages; a field of corner tiles under sun and sky.
"""

import argparse

import mesoshell as ms
import mesoshell.pathtracer
from experiments.figures.sheet import draw, over_white
from mesoshell.pathtracer.passes import as_rgba

import mitsuba as mi  # isort: skip  (after mesoshell.pathtracer)

SCENES = {"room.xml": "grass, young to dry", "materials.xml": "carpet, fur, grass", "meadow.xml": "a field"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spp", type=int, default=64)
    spp = parser.parse_args().spp
    pictures = []
    for name in SCENES:
        scene = ms.mitsuba.load_file(f"experiments/scenes/{name}", width=280, height=210)
        pictures.append(over_white(as_rgba(mi.render(scene, spp=spp))))
    draw("mesogan_8", [pictures], [*SCENES.values()], wide=3.4)


if __name__ == "__main__":
    main()
