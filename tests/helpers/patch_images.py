"""Datasets of patches that are made up."""

import json
from pathlib import Path

from data_gen.tiles import COLOURS
from mesoshell.io.dataset import Dataset, read_dataset
from tests.helpers import fog


def of_patches(folder: Path, instances: list[int]) -> Dataset:
    """Fog of many patches: picture i shows instances[i]."""
    return fog.write(folder, [fog.CAMERAS[i % 4] for i in range(len(instances))], instances=instances)


def of_tiles(folder: Path, tiles: list[int], colours: object = COLOURS) -> Dataset:
    """Fog of corner tiles: picture i shows tiles[i]."""
    of_patches(folder, tiles)
    file = folder / "manifest.json"
    manifest = {k: v for k, v in json.loads(file.read_text()).items() if k != "views"}
    file.write_text(json.dumps(manifest | {"tiles": colours}))
    return read_dataset(folder)
