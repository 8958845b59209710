"""MesoGAN, table 3: what the parts of the generator are for: python -m experiments.figures.mesogan_table3 RUN [RUN …]

RUN: runs on the same renders, as long: of experiments/carpet.py, no_mip.py, no_fourier.py, frozen_phases.py, triplane.py. Two
of the nearest renders, and what each run's newest snapshot makes from the same camera. Scores: `mesoshell evaluate`.
"""

from experiments.figures.mesogan_13 import NAMES, compared
from experiments.figures.sheet import draw


def main() -> None:
    draw("mesogan_table3", *compared(__doc__), NAMES, wide=1.6)


if __name__ == "__main__":
    main()
