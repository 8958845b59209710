"""Textures of any extent on a disk: python -m benchmarks.extent --sides 2048 16384 [--folder FOLDER]

Bakes square textures of a small random generator, one after the other, into mapped files as `mesoshell texture --out FOLDER`
does, and removes them. Memory is the most of RssAnon that was seen, every 10 ms: what the process asked for and holds. Pages
of the mapped files are not in it; the system takes those back when it likes. The first side includes compilation.
"""

import argparse
import shutil
import tempfile
import threading
import time
from pathlib import Path

import jax
import numpy as np

from mesoshell.shell.generator.bake import bake, patches_a_tile
from mesoshell.shell.generator.generator import init_averages, init_generator
from mesoshell.shell.generator.model import GeneratorModel, grown
from mesoshell.shell.generator.plan import GeneratorConfig, halo_cost
from mesoshell.shell.material.decoder import init_decoder


def maker(texels: int, base: int, most: int) -> GeneratorModel:
    """Random weights; the decoder is the default's size."""
    config = GeneratorConfig(texels=texels, channel_base=base, channel_max=most)
    keys, octaves = jax.random.split(jax.random.key(0)), 4
    decoder = init_decoder(keys[1], config.channels + 1 + 2 * octaves, (64, 64), (64, 64))
    return GeneratorModel(config, init_generator(config, keys[0]), init_averages(config), decoder, octaves)


def anonymous() -> int:
    """Bytes of this process that are no file's."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("RssAnon"))


class Watch:
    """The most of `anonymous` while the context is open."""

    def __enter__(self) -> "Watch":
        self.most, self._done = anonymous(), threading.Event()
        self._thread = threading.Thread(target=self._look)
        self._thread.start()
        return self

    def _look(self) -> None:
        while not self._done.wait(0.01):
            self.most = max(self.most, anonymous())

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()


def one(maker: GeneratorModel, side: int, folder: Path) -> tuple[float, int, int]:
    """Seconds, most bytes of memory, and bytes on disk, of a texture of `side` texels a side."""

    def allocate(key: str, shape: tuple[int, ...]) -> np.ndarray:
        path = folder / f"{key}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        return np.lib.format.open_memmap(path, "w+", np.float16, shape)

    begin = time.perf_counter()
    with Watch() as watch:
        bake(maker, grown(maker, 0, np.zeros(0, np.float32)), (side, side), allocate)
    seconds, written = time.perf_counter() - begin, sum(p.stat().st_size for p in folder.rglob("*.npy"))
    shutil.rmtree(folder)
    return seconds, watch.most, written


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sides", type=int, nargs="+", default=[2048])
    parser.add_argument("--texels", type=int, default=256, help="texels a patch")
    parser.add_argument("--base", type=int, default=1024, help="channels of a layer: base over twice its cutoff")
    parser.add_argument("--most", type=int, default=16, help="channels of a layer, at most")
    parser.add_argument("--folder", type=Path, default=None, help="where to write; the system's own otherwise")
    options = parser.parse_args()
    made = maker(options.texels, options.base, options.most)
    tile = patches_a_tile(options.texels) * options.texels
    print(f"tiles of {tile}², {halo_cost(made.config, tile):.2f} times the work of what they keep\n")
    print("| side | seconds | texels a second | most memory, MiB | on disk, MiB |\n|---|---|---|---|---|")
    for side in options.sides:
        with tempfile.TemporaryDirectory(dir=options.folder) as scratch:
            seconds, most, written = one(made, side, Path(scratch) / "texture")
        rate = side**2 / seconds
        print(f"| {side} | {seconds:.1f} | {rate:,.0f} | {most / 2**20:.0f} | {written / 2**20:.0f} |", flush=True)


if __name__ == "__main__":
    main()
