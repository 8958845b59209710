"""MesoGAN, table 3: what the parts of the generator are for: python -m experiments.figures.mesogan_table3 RUN [RUN …]

RUN: runs on the same renders, as long: of experiments/carpet.py, no_mip.py, no_fourier.py, frozen_phases.py, triplane.py. Two
of the nearest renders, and what each run's newest snapshot makes from the same camera. Scores: `mesoshell evaluate`.
"""

import argparse
from pathlib import Path

from experiments.figures.mesogan_13 import column
from experiments.figures.sheet import draw


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, nargs="+", help="folder of a run")
    titles, columns = zip(*map(column, parser.parse_args().run), strict=True)
    names = ("render", "made", "render", "made")
    draw("mesogan_table3", list(zip(*columns, strict=True)), titles, names, wide=1.6)


if __name__ == "__main__":
    main()
