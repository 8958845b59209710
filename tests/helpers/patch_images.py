"""A dataset of patches that is made up."""

from pathlib import Path

from mesoshell.io.dataset import Dataset
from tests.helpers import fog


def of_patches(folder: Path, instances: list[int]) -> Dataset:
    """Fog of many patches: picture i shows instances[i]."""
    return fog.write(folder, [fog.CAMERAS[i % 4] for i in range(len(instances))], instances=instances)
