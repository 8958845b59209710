"""MesoGAN, figure 12: a surface under one generated texture, and under triplanes of each patch:
python -m experiments.figures.mesogan_12 OURS.npz TRIPLANE.npz

OURS, TRIPLANE: snapshots of a generator and of experiments/triplane.py, trained as long on the same renders. Triplanes end at
the sides of their patch, so each is a chart of its own, with planes of its own and a border to the next (benchmarks/triplane).
"""

import argparse
from pathlib import Path

from benchmarks.triplane import compared
from experiments.figures.sheet import draw, over_white

PATCHES, SIDE, QUALITY = 6, 384, "normal"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("ours", type=Path, help="a generator's snapshot")
    parser.add_argument("triplane", type=Path, help="a snapshot of a generator of triplanes")
    options = parser.parse_args()
    rows = compared(options.ours, options.triplane, PATCHES, SIDE, QUALITY)
    seconds = [row.report.seconds["wall"] for row in rows.values()]
    times = ("", f", {seconds[1] / seconds[0]:.1f} times the time")
    titles = [f"{name}: {s:.1f} s{more}" for name, s, more in zip(rows, seconds, times, strict=True)]
    draw("mesogan_12", [[over_white(row.image) for row in rows.values()]], titles, wide=3.6)


if __name__ == "__main__":
    main()
