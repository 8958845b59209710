"""Textures of any extent on a disk: python -m benchmarks.extent --sides 2048 16384 [--folder FOLDER]

Bakes square textures of a small random generator, one after the other, into folders as `mesoshell texture --out FOLDER` does;
renders a field that carries all of one, from eye height, with each engine in a process of its own; and removes them. Memory is
the most of RssAnon that was seen, every 10 ms: what the process asked for and holds. Pages of the mapped files are not in it;
the system takes those back when it likes. The first side includes compilation.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Literal

import jax

import mesoshell as ms
from mesoshell.io.bundle import Bundle
from mesoshell.io.kept_textures import to_folder
from mesoshell.shell.generator.bake import patches_a_tile
from mesoshell.shell.generator.generator import init_averages, init_generator
from mesoshell.shell.generator.plan import GeneratorConfig, halo_cost
from mesoshell.shell.generator.texture_synthesis import TextureRequest, bake_bundle
from mesoshell.shell.material.decoder import init_decoder
from mesoshell.train.export import generated_bundle

#: A camera at eye height, in sides of the field: from, to, field of view; the pictures' side in pixels.
EYE, SIDE = (0.0, 0.02, 0.5, 0.0, 0.0, 0.35, 50.0), 512


def random_generator(texels: int, base: int, most: int) -> tuple[GeneratorConfig, Bundle]:
    """Random weights; the decoder is the default's size."""
    config = GeneratorConfig(texels=texels, channel_base=base, channel_max=most)
    keys, octaves = jax.random.split(jax.random.key(0)), 4
    decoder = init_decoder(keys[1], config.channels + 1 + 2 * octaves, (64, 64), (64, 64))
    generator = init_generator(config, keys[0])
    return config, generated_bundle(config, generator, init_averages(config), decoder, octaves, (), {})


class Watch:
    """Bytes of this process that are no file's: the most while the context is open."""

    def __enter__(self) -> "Watch":
        self.most, self._done = self._now(), threading.Event()
        self._thread = threading.Thread(target=self._look)
        self._thread.start()
        return self

    @staticmethod
    def _now() -> int:
        lines = Path("/proc/self/status").read_text().splitlines()
        return 1024 * next(int(line.split()[1]) for line in lines if line.startswith("RssAnon"))

    def _look(self) -> None:
        while not self._done.wait(0.01):
            self.most = max(self.most, self._now())

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self._thread.join()


def bake(bundle: Bundle, side: int, folder: Path) -> tuple[float, int, int]:
    """Seconds, most bytes of memory, and bytes on disk, of a texture of `side` texels a side."""
    folder.mkdir()
    begin = time.perf_counter()
    with Watch() as watch:
        to_folder(
            folder,
            lambda allocate: bake_bundle(bundle, "random", (side, side), TextureRequest(), allocate=allocate)[0],
        )
    return time.perf_counter() - begin, watch.most, sum(p.stat().st_size for p in folder.rglob("*.npy"))


def look(folder: Path, engine: Literal["jax", "mitsuba"], picture: Path) -> None:
    """Print seconds of reading and set-up, seconds of a picture, and the most bytes of memory."""
    begin = time.perf_counter()
    with Watch() as watch:
        material = ms.load_material(folder)
        patches = material.shell.arrays["features/0"].shape[0] / material.shell.texel_density
        scene = ms.Scene("experiments/scenes/plane.obj", material, scale=1 / patches, camera=EYE, size=(SIDE, SIDE))
        made = ms.render(scene, engine=engine)
    seconds = made.report["seconds"]
    rendered = seconds["total"] - seconds["setup"]
    print(time.perf_counter() - begin - rendered, rendered, watch.most)
    made.save(picture)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sides", type=int, nargs="+", default=[2048])
    parser.add_argument("--texels", type=int, default=256, help="texels a patch")
    parser.add_argument("--base", type=int, default=1024, help="channels of a layer: base over twice its cutoff")
    parser.add_argument("--most", type=int, default=16, help="channels of a layer, at most")
    parser.add_argument("--folder", type=Path, default=None, help="where to write; the system's own otherwise")
    parser.add_argument("--engines", nargs="*", default=["jax", "mitsuba"], help="what renders the field, if anything")
    parser.add_argument("--keep", type=Path, default=None, help="folder for the pictures")
    parser.add_argument("--look", nargs=3, default=None, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.look:
        look(Path(options.look[0]), options.look[1], Path(options.look[2]))
        return
    if options.keep is not None:
        options.keep.mkdir(parents=True, exist_ok=True)
    config, bundle = random_generator(options.texels, options.base, options.most)
    tile = patches_a_tile(options.texels) * options.texels
    print(f"tiles of {tile}², {halo_cost(config, tile):.2f} times the work of what they keep\n")
    print("| side | baked, s | texels a second | most memory, MiB | on disk, MiB |", end="")
    print("".join(f" {engine}: set-up, s | a picture, s | most memory, MiB |" for engine in options.engines))
    print("|---" * (5 + 3 * len(options.engines)) + "|")
    for side in options.sides:
        with tempfile.TemporaryDirectory(dir=options.folder) as scratch:
            folder = Path(scratch) / "texture"
            seconds, most, written = bake(bundle, side, folder)
            rate = side**2 / seconds
            row = f"| {side} | {seconds:.1f} | {rate:,.0f} | {most / 2**20:.0f} | {written / 2**20:.0f} |"
            for engine in options.engines:
                picture = (options.keep or Path(scratch)) / f"{side}_{engine}.png"
                command = [sys.executable, "-m", "benchmarks.extent", "--look", str(folder), engine, str(picture)]
                done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
                set_up, rendered, held = map(float, done.stdout.split()[-3:])
                row += f" {set_up:.1f} | {rendered:.1f} | {held / 2**20:.0f} |"
            print(row, flush=True)
            shutil.rmtree(folder)


if __name__ == "__main__":
    main()
