"""MesoGAN, figure 13: one network for all parameters against a generator: python -m experiments.figures.mesogan_13 RUN [RUN …]

RUN: runs on pictures: of experiments/nerf_tex.py on carpet2, carpet4, carpet6 and carpet8, of experiments/nerf_tex_seed.py, and
of a generator. Two of each run's nearest renders, and what its newest snapshot makes from the same camera with the same light
and parameters; a network of seeds is asked for one that it has not seen. Scores are those of `mesoshell evaluate`.
"""

import argparse
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float

from experiments.figures.sheet import draw, over_white
from mesoshell.io.image import tonemap
from mesoshell.io.records import read_rows
from mesoshell.measure.evaluation import FILE
from mesoshell.train.gan.snapshot import ends
from mesoshell.train.gan.state import GanConfig
from mesoshell.train.method import method_of
from mesoshell.train.nerf_tex.network import NerfTexConfig
from mesoshell.train.run_config import read_record, snapshots

#: Which of the nearest renders, from their end; pixels of a picture.
SHOWN, SIDE, SCORE = (-1, -2), 128, "KID-EffLite0"
NAMES = ("render", "made", "render", "made")


def column(run: Path) -> tuple[str, list[Float[np.ndarray, "H W 3"]]]:
    """What a run is called, and its renders and pictures in turn."""
    config, data = read_record(run)
    if not isinstance(config, GanConfig | NerfTexConfig):
        raise SystemExit(f"{run}: is no run on pictures")
    method = method_of(config)
    config, dataset = method.adapt(config, method.read(config, data))
    images, newest = snapshots(run)[-1]
    near = jax.tree.map(lambda x: x[list(SHOWN)], ends(config, dataset)[1])  # the nearest is last
    made = method.load_predictor(config, newest)(near)
    what = named(config, len(dataset.manifest["parameters"]))
    rows = read_rows(run / FILE, ("name", "value", "kimg"))
    score = next((f"\n{SCORE} {x['value']:.3f}" for x in rows if (x["name"], x["kimg"]) == (SCORE, images / 1000)), "")
    shown = [over_white(enlarged(x)) for both in zip(near.image, made, strict=True) for x in both]
    return f"{what}, {images / 1000:g} kimg{score}", shown


def named(config: GanConfig | NerfTexConfig, count: int) -> str:
    """What a run is, by what differs. count: of its parameters."""
    if isinstance(config, NerfTexConfig):
        return "seed" if config.seeded else f"{count} parameters"
    if config.generator.planes == 3:
        return "triplanes"
    maps = {"off": "no Fourier maps", "frozen": "fixed phases", "random": "generator"}[config.generator.fourier]
    return maps if config.picture.filtering else "no mip levels"


def enlarged(picture: Float[np.ndarray, "S S 4"]) -> Float[np.ndarray, "H W 4"]:
    """A picture pixel by pixel, its highlights drawn in as in a run's sheets."""
    times = max(1, SIDE // len(picture))
    large = np.repeat(np.repeat(np.asarray(picture), times, axis=0), times, axis=1)
    return np.concatenate([tonemap(np.maximum(large[..., :3], 0)), large[..., 3:]], axis=2)


def compared(about: str | None) -> tuple[list[tuple[np.ndarray, ...]], tuple[str, ...]]:
    """Rows of pictures, and titles, of the runs that the command line names. about: what `--help` says."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, nargs="+", help="folder of a run")
    titles, columns = zip(*map(column, parser.parse_args().run), strict=True)
    return list(zip(*columns, strict=True)), titles


def main() -> None:
    draw("mesogan_13", *compared(__doc__), NAMES, wide=1.6)


if __name__ == "__main__":
    main()
