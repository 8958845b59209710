"""What datasets cost: python -m benchmarks.datasets {stages,memory,reader} FOLDER_OR_RECIPE ...

stages   seconds a sample by stage, bytes and memory, from the logs of dataset folders
memory   most memory of one Blender process after some tens and after 500 changing scenes (small images), a recipe
reader   images a second of the feed over packed folders, against copying the same bytes
"""

import argparse
import itertools
import json
import tempfile
import time
from pathlib import Path

import numpy as np

from mesoshell.datasets.blender.process import Blender
from mesoshell.datasets.blender.render import SHARD
from mesoshell.io.dataset import read_dataset
from mesoshell.train.loader import Feed

SCENES = 500
BATCH, BATCHES = 8, 500


def stages(folders: list[str]) -> None:
    print("| dataset | images | geometry | sync | Cycles | writing | total s | bytes | most MiB |\n" + "|---" * 9 + "|")
    for folder in map(Path, folders):
        logs = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
        mean = {stage: np.mean([log["seconds"][stage] for log in logs]) for stage in logs[0]["seconds"]}
        size = np.mean([path.stat().st_size for path in (folder / "images").iterdir()])
        seconds = " | ".join(f"{mean[stage]:.3f}" for stage in ("geometry", "sync", "cycles", "writing", "total"))
        print(f"| {folder} | {len(logs)} | {seconds} | {size:.0f} | {max(log['memory_mib'] for log in logs):.0f} |")


def memory(recipes: list[str]) -> None:
    print(f"| recipe | after {SHARD} scenes | after 100 | after {SCENES}, MiB |\n|---|---|---|---|")
    for recipe in recipes:
        settings = {"recipe": recipe, "seed": 0, "size": 16, "samples_per_pixel": 1, "denoise": False}
        settings |= {"coverage": None, "fixed": {}, "patch": None}
        with tempfile.TemporaryDirectory() as scratch, Blender(settings, 2) as blender:
            held = [blender.render(i, Path(scratch) / "a.exr")["memory"] for i in range(SCENES)]
        print(f"| {recipe} | {held[SHARD - 1]:.0f} | {held[99]:.0f} | {held[-1]:.0f} |")


def reader(folders: list[str]) -> None:
    print("| packed | size | images/s | time over copying |\n|---|---|---|---|")
    for folder in folders:
        dataset = read_dataset(folder)
        batches = Feed(dataset, BATCH).after(0)
        next(batches)
        start = time.perf_counter()
        for batch in itertools.islice(batches, BATCHES):
            assert batch.image.shape[0] == BATCH
        seconds = time.perf_counter() - start
        image = np.zeros((BATCH, *dataset.samples[0].size[::-1], 4), np.float16)
        start = time.perf_counter()
        for _ in range(BATCHES):
            image.copy()
        copying = time.perf_counter() - start
        rate = BATCH * BATCHES / seconds
        size = dataset.samples[0].size[0]
        print(f"| {folder} | {size}² | {rate:.0f} | {seconds / copying:.1f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("stages", "memory", "reader"))
    parser.add_argument("names", nargs="+")
    options = parser.parse_args()
    {"stages": stages, "memory": memory, "reader": reader}[options.what](options.names)


if __name__ == "__main__":
    main()
